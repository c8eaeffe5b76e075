//! Line plots and stacked bars as SVG, and SVG as PNG.
//!
//! Text uses DejaVu Sans, which is built in for PNG, so that pictures look the same on a machine without fonts.
//! Colours are the palette of Okabe and Ito (2008), told apart with every common form of colour blindness.

use std::fmt::Write;

use resvg::{tiny_skia, usvg};

use crate::error::ReportError;
use crate::lettering::outlined;

/// Colours of series, in order: blue, vermillion, bluish green, reddish purple, orange, sky blue.
pub const PALETTE: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// Colour of text, and of reference data.
const INK: &str = "#1b2733";
/// Colour of axes and secondary text.
const SOFT: &str = "#5a6875";
/// Colour of grid lines.
const GRID: &str = "#e4e8ec";

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line through the points; broken where a value is not finite.
    Line,
    /// A marker at each point.
    Markers,
    /// Both.
    Both,
}

/// The colour of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// The n-th colour of [`PALETTE`] (dashed from the seventh on).
    Series(usize),
    /// Dark, with the n-th hollow marker: for experiments and other references.
    Reference(usize),
}

/// Points with a name.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// `[x, y]` in the units of the axes.
    pub points: Vec<[f64; 2]>,
    /// Line, markers or both.
    pub style: Style,
    /// Colour.
    pub ink: Ink,
    /// `[x, low, high]`: a shaded band, empty for none.
    pub band: Vec<[f64; 3]>,
}

impl Series {
    /// A line in the n-th colour.
    pub fn line(name: impl Into<String>, n: usize, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, style: Style::Line, ink: Ink::Series(n), band: Vec::new() }
    }

    /// A line with markers in the n-th colour.
    pub fn both(name: impl Into<String>, n: usize, points: Vec<[f64; 2]>) -> Self {
        Self { style: Style::Both, ..Self::line(name, n, points) }
    }

    /// Hollow dark markers: the n-th reference.
    pub fn reference(name: impl Into<String>, n: usize, points: Vec<[f64; 2]>) -> Self {
        Self { style: Style::Markers, ink: Ink::Reference(n), ..Self::line(name, n, points) }
    }
}

/// Spacing of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Even.
    Linear,
    /// Decades; values <= 0 are left out.
    Log,
}

/// One axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Label with unit.
    pub label: String,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Fixed ends; absent: those of the data.
    pub range: Option<[f64; 2]>,
}

impl Axis {
    /// A linear axis over the data.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis over the data.
    pub fn log(label: impl Into<String>) -> Self {
        Self { scale: Scale::Log, ..Self::linear(label) }
    }
}

/// How many times as far a series reaches as the next one when it is cut.
const LOUDER: f64 = 3.0;

/// A second scale on the right: `right = left · factor`.
#[derive(Clone, Debug)]
pub struct RightAxis {
    /// Label with unit.
    pub label: String,
    /// Factor from the left scale.
    pub factor: f64,
}

/// A plot of one or more series. [`LinePlot::svg`] draws it.
#[derive(Clone, Debug)]
pub struct LinePlot {
    /// Title, shown above.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Second vertical scale.
    pub right: Option<RightAxis>,
    /// What is drawn, in order.
    pub series: Vec<Series>,
    /// Width and height, px.
    pub size: [f64; 2],
}

impl LinePlot {
    /// An empty plot of 720 x 420 px with linear axes.
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            x: Axis::linear(x_label),
            y: Axis::linear(y_label),
            right: None,
            series: Vec::new(),
            size: [720.0, 420.0],
        }
    }

    /// Fits the vertical axis to the quieter series where others reach more than three times as far, which would leave of them a line along the
    /// bottom; two series stay whole at the least. Answers names and ends of those that are cut.
    pub fn cut_to_quieter(&mut self) -> Vec<(String, [f64; 2])> {
        let values = |series: &Series| series.points.iter().map(|point| point[1]).filter(|y| y.is_finite()).collect::<Vec<f64>>();
        let ends = |values: Vec<f64>| {
            let ends = values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &y| [low.min(y), high.max(y)]);
            (ends[0] <= ends[1]).then_some(ends)
        };
        let reach = |[low, high]: [f64; 2]| low.abs().max(high.abs());
        let mut found: Vec<(String, [f64; 2])> =
            self.series.iter().filter_map(|series| Some((series.name.clone(), ends(values(series))?))).collect();
        found.sort_by(|a, b| reach(b.1).total_cmp(&reach(a.1)));
        let louder = |pair: &[(String, [f64; 2])]| reach(pair[1].1) > 0.0 && reach(pair[0].1) > LOUDER * reach(pair[1].1);
        let cut = (1..found.len().saturating_sub(1)).rev().find(|&cut| louder(&found[cut - 1..=cut])).unwrap_or(0);
        let rest = found.split_off(cut);
        if cut > 0 {
            let [low, high] = rest.iter().fold([0.0f64; 2], |[low, high], (_, ends)| [low.min(ends[0]), high.max(ends[1])]);
            let margin = 0.05 * (high - low);
            self.y.range = Some([if low < 0.0 { low - margin } else { low }, high + margin]);
        }
        found
    }

    /// Whether no series has a point that can be drawn.
    pub fn is_empty(&self) -> bool {
        !self.series.iter().any(|series| {
            series.points.iter().any(|p| self.x.scale.shows(p[0]) && self.y.scale.shows(p[1]))
                || series.band.iter().any(|b| self.x.scale.shows(b[0]) && self.y.scale.shows(b[1]))
        })
    }

    /// The plot as an SVG document.
    pub fn svg(&self) -> String {
        let [width, height] = self.size;
        let mut svg = Svg::new(width, height);
        svg.text([16.0, 24.0], Anchor::Start, "ink title", INK, 15.0, &self.title);
        let top = legend(&mut svg, &self.legend_entries(), 16.0, 46.0, width - 32.0) + 14.0;

        let y = Ticks::over(&self.y, self.extent(1), 6);
        let label_width = y.labels().map(|label| text_width(label, 12.0)).fold(0.0, f64::max);
        let left = (label_width + 46.0).max(58.0);
        let right_ticks = self.right.as_ref().map(|right| {
            let ends = [y.low * right.factor, y.high * right.factor];
            (right, Ticks::over(&Axis { range: Some(ends), ..self.y.clone() }, ends, 6))
        });
        let right = match &right_ticks {
            Some((_, ticks)) => 46.0 + ticks.labels().map(|label| text_width(label, 12.0)).fold(0.0, f64::max),
            None => 24.0,
        };
        let area = Area { left, top, right: width - right, bottom: height - 50.0 };
        // A linear horizontal axis ends with the data, so that the picture is filled.
        let mut x_axis = self.x.clone();
        let [from, to] = self.extent(0);
        if x_axis.scale == Scale::Linear && from < to {
            x_axis.range.get_or_insert([from, to]);
        }
        let x = Ticks::over(&x_axis, [from, to], 8);

        svg.grid(&area, &x, &y);
        svg.open_clip(&area);
        for series in &self.series {
            series.draw(&mut svg, &area, &x, &y);
        }
        svg.close_clip();
        svg.axes(&area, &x, &y, &self.x.label, &self.y.label);
        if let Some((right, ticks)) = right_ticks {
            for (value, label) in &ticks.at {
                let at = area.bottom - ticks.fraction(*value) * area.height();
                svg.line([area.right, at], [area.right + 4.0, at], "soft-line", SOFT, 1.0);
                svg.text([area.right + 8.0, at + 4.0], Anchor::Start, "soft", SOFT, 12.0, label);
            }
            svg.upright_text([width - 10.0, 0.5 * (area.top + area.bottom)], "ink", INK, 12.5, &right.label);
        }
        svg.finish()
    }

    fn legend_entries(&self) -> Vec<(Ink, Key, &str)> {
        self.series.iter().map(|series| (series.ink, Key::Series(series.style), series.name.as_str())).collect()
    }

    /// Least and greatest value along axis 0 or 1.
    fn extent(&self, axis: usize) -> [f64; 2] {
        let scale = if axis == 0 { self.x.scale } else { self.y.scale };
        let bands = |series: &Series| {
            let of = |b: &[f64; 3]| if axis == 0 { vec![b[0]] } else { vec![b[1], b[2]] };
            series.band.iter().flat_map(of).collect::<Vec<f64>>()
        };
        self.series
            .iter()
            .flat_map(|series| series.points.iter().map(|p| p[axis]).chain(bands(series)))
            .filter(|&v| scale.shows(v))
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
    }
}

impl Scale {
    fn shows(self, value: f64) -> bool {
        value.is_finite() && (self == Self::Linear || value > 0.0)
    }
}

impl Series {
    fn draw(&self, svg: &mut Svg, area: &Area, x: &Ticks, y: &Ticks) {
        let place = |px: f64, py: f64| {
            (x.scale.shows(px) && y.scale.shows(py))
                .then(|| [area.left + x.fraction(px) * area.width(), area.bottom - y.fraction(py) * area.height()])
        };
        let color = self.ink.color();
        if !self.band.is_empty() {
            let upper = self.band.iter().filter_map(|b| place(b[0], b[2]));
            let lower = self.band.iter().rev().filter_map(|b| place(b[0], b[1]));
            let outline: Vec<_> = thin(upper.map(Some).collect()).into_iter().chain(thin(lower.map(Some).collect())).collect();
            let d = path_data(&outline);
            let _ = write!(svg.body, r#"<path d="{d}Z" fill="{color}" fill-opacity="0.18"/>"#);
        }
        let placed: Vec<Option<[f64; 2]>> = self.points.iter().map(|p| place(p[0], p[1])).collect();
        if self.style != Style::Markers {
            let dash = match self.ink {
                Ink::Series(n) if n >= PALETTE.len() => r#" stroke-dasharray="6 3""#,
                _ => "",
            };
            let class = self.ink.class();
            let d = path_data(&thin(placed.clone()));
            let _ =
                write!(svg.body, r#"<path d="{d}"{class} fill="none" stroke="{color}" stroke-width="1.8" stroke-linejoin="round"{dash}/>"#);
        }
        if self.style != Style::Line {
            for at in placed.into_iter().flatten() {
                svg.marker(at, self.ink);
            }
        }
    }
}

impl Ink {
    fn color(self) -> &'static str {
        match self {
            Self::Series(n) => PALETTE[n % PALETTE.len()],
            Self::Reference(_) => INK,
        }
    }

    fn class(self) -> &'static str {
        match self {
            Self::Series(_) => "",
            Self::Reference(_) => r#" class="ink-line""#,
        }
    }
}

/// Drops points of long lines that cannot be seen, keeping the first, least, greatest and last of each half pixel.
/// Lines that run backwards in x are left as they are.
fn thin(points: Vec<Option<[f64; 2]>>) -> Vec<Option<[f64; 2]>> {
    let forward = points.windows(2).all(|w| !matches!((w[0], w[1]), (Some(a), Some(b)) if b[0] < a[0]));
    if points.len() < 2000 || !forward {
        return points;
    }
    let mut kept = Vec::new();
    let column = |p: &Option<[f64; 2]>| p.map(|p| (2.0 * p[0]) as i64);
    for group in points.chunk_by(|a, b| column(a) == column(b)) {
        let height = |i: &usize| group[*i].map_or(0.0, |p| p[1]);
        let order = |a: &usize, b: &usize| height(a).total_cmp(&height(b));
        let mut keep = vec![0, group.len() - 1];
        keep.extend((0..group.len()).min_by(order));
        keep.extend((0..group.len()).max_by(order));
        keep.sort_unstable();
        keep.dedup();
        kept.extend(keep.into_iter().map(|i| group[i]));
    }
    kept
}

fn path_data(points: &[Option<[f64; 2]>]) -> String {
    let mut d = String::new();
    let mut pen_up = true;
    for point in points {
        match point {
            None => pen_up = true,
            Some([x, y]) => {
                let _ = write!(d, "{}{} {}", if pen_up { 'M' } else { 'L' }, short(*x), short(*y));
                pen_up = false;
            }
        }
    }
    d
}

/// Horizontal bars made of named parts, such as seconds by phase.
#[derive(Clone, Debug)]
pub struct StackedBars {
    /// Title, shown above.
    pub title: String,
    /// Label of the horizontal axis, with unit.
    pub x_label: String,
    /// One bar each.
    pub bars: Vec<Bar>,
}

/// One bar.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Name at the left.
    pub name: String,
    /// `(name, length)` of each part; a name keeps its colour in all bars.
    pub parts: Vec<(String, f64)>,
}

impl StackedBars {
    /// The bars as an SVG document.
    pub fn svg(&self) -> String {
        let mut names: Vec<&str> = Vec::new();
        for (name, _) in self.bars.iter().flat_map(|bar| &bar.parts) {
            if !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
        let width = 1100.0;
        let entries: Vec<(Ink, Key, &str)> = names.iter().enumerate().map(|(i, name)| (Ink::Series(i), Key::Swatch, *name)).collect();
        let mut svg = Svg::new(width, 0.0);
        svg.text([16.0, 24.0], Anchor::Start, "ink title", INK, 15.0, &self.title);
        let top = legend(&mut svg, &entries, 16.0, 46.0, width - 32.0) + 14.0;
        let label_width = self.bars.iter().map(|bar| text_width(&bar.name, 12.5)).fold(0.0, f64::max);
        let (row, thick) = (38.0, 24.0);
        let bottom = top + row * self.bars.len() as f64 + 6.0;
        let area = Area { left: label_width + 32.0, top, right: width - 90.0, bottom };
        let total = |bar: &Bar| bar.parts.iter().map(|(_, v)| v).filter(|v| v.is_finite()).sum::<f64>();
        let longest = self.bars.iter().map(total).fold(0.0, f64::max);
        let x = Ticks::over(&Axis::linear(""), [0.0, if longest > 0.0 { longest } else { 1.0 }], 8);
        svg.grid(&area, &x, &Ticks { low: 0.0, high: 1.0, scale: Scale::Linear, at: Vec::new() });
        for (i, bar) in self.bars.iter().enumerate() {
            let y = top + row * i as f64 + 0.5 * (row - thick) + 3.0;
            let mut from = 0.0;
            for (name, value) in bar.parts.iter().filter(|(_, v)| v.is_finite() && *v > 0.0) {
                let n = names.iter().position(|known| known == name).unwrap_or(0);
                let (start, end) = (x.fraction(from), x.fraction(from + value));
                let _ = write!(
                    svg.body,
                    r#"<rect x="{}" y="{}" width="{}" height="{thick}" fill="{}"/>"#,
                    short(area.left + start * area.width()),
                    short(y),
                    short((end - start) * area.width()),
                    Ink::Series(n).color()
                );
                from += value;
            }
            let middle = y + 0.5 * thick + 4.5;
            svg.text([area.left - 10.0, middle], Anchor::End, "ink", INK, 12.5, &bar.name);
            let end = area.left + x.fraction(from) * area.width() + 8.0;
            svg.text([end, middle], Anchor::Start, "soft", SOFT, 12.0, &crate::words::number(from));
        }
        svg.axes(&area, &x, &Ticks { low: 0.0, high: 1.0, scale: Scale::Linear, at: Vec::new() }, &self.x_label, "");
        svg.height = bottom + 50.0;
        svg.finish()
    }
}

/// What stands before a name in a legend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    /// As the series is drawn.
    Series(Style),
    /// A filled square.
    Swatch,
}

/// Draws a legend in rows; returns the lower end of the last row.
fn legend(svg: &mut Svg, entries: &[(Ink, Key, &str)], left: f64, mut y: f64, width: f64) -> f64 {
    if entries.is_empty() {
        return y - 16.0;
    }
    let mut x = left;
    for (ink, key, name) in entries {
        let advance = 30.0 + text_width(name, 12.5) + 20.0;
        if x > left && x + advance > left + width {
            x = left;
            y += 20.0;
        }
        let middle = y - 4.0;
        if let Key::Series(Style::Line | Style::Both) = key {
            let _ = write!(
                svg.body,
                r#"<path d="M{} {middle}h22"{} fill="none" stroke="{}" stroke-width="2.4"/>"#,
                short(x),
                ink.class(),
                ink.color()
            );
        }
        if let Key::Series(Style::Markers | Style::Both) = key {
            svg.marker([x + 11.0, middle], *ink);
        }
        if *key == Key::Swatch {
            let (left, top, fill) = (short(x + 9.0), short(middle - 6.0), ink.color());
            let _ = write!(svg.body, r#"<rect x="{left}" y="{top}" width="13" height="13" fill="{fill}"/>"#);
        }
        svg.text([x + 29.0, y], Anchor::Start, "ink", INK, 12.5, name);
        x += advance;
    }
    y
}

/// Rough width of a text in DejaVu Sans, px.
pub(crate) fn text_width(text: &str, size: f64) -> f64 {
    let em = |c: char| match c {
        'i' | 'j' | 'l' | '.' | ',' | ':' | ';' | '|' | '\'' | 'I' => 0.31,
        ' ' | 'f' | 't' | 'r' | '(' | ')' | '[' | ']' | '/' | '-' => 0.4,
        'm' | 'w' | 'M' | 'W' | '%' | '@' => 0.95,
        c if c.is_uppercase() => 0.72,
        _ => 0.63,
    };
    size * text.chars().map(em).sum::<f64>()
}

/// The plotting area, px.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Area {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

impl Area {
    pub fn width(&self) -> f64 {
        self.right - self.left
    }

    pub fn height(&self) -> f64 {
        self.bottom - self.top
    }
}

/// Ends and labelled marks of an axis.
#[derive(Clone, Debug)]
pub(crate) struct Ticks {
    pub low: f64,
    pub high: f64,
    pub scale: Scale,
    pub at: Vec<(f64, String)>,
}

impl Ticks {
    /// About `wanted` round marks over the data, or over the fixed range of the axis.
    pub fn over(axis: &Axis, data: [f64; 2], wanted: usize) -> Self {
        let [mut low, mut high] = axis.range.unwrap_or(data);
        if !(low.is_finite() && high.is_finite() && low <= high) {
            [low, high] = if axis.scale == Scale::Log { [0.1, 1.0] } else { [0.0, 1.0] };
        }
        match axis.scale {
            Scale::Linear => {
                if low == high {
                    let pad = if low == 0.0 { 1.0 } else { 0.1 * low.abs() };
                    (low, high) = (low - pad, high + pad);
                }
                let step = round_step((high - low) / wanted as f64);
                let (first, last) = match axis.range {
                    Some(_) => ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor()),
                    None => {
                        let ends = ((low / step + 1e-9).floor(), (high / step - 1e-9).ceil());
                        (low, high) = (ends.0 * step, ends.1 * step);
                        ends
                    }
                };
                let marks = (last - first).clamp(0.0, 100.0) as usize;
                let at = (0..=marks).map(|i| (first + i as f64) * step).map(|v| (v, tick_label(v, step))).collect();
                Self { low, high, scale: axis.scale, at }
            }
            Scale::Log => {
                let (bottom, top) = (low.log10(), high.log10());
                let (mut first, mut last) = (bottom.floor(), top.ceil());
                if first == last {
                    (first, last) = (first - 1.0, last + 1.0);
                }
                if axis.range.is_none() {
                    // Wide data end at decades; narrow data end at 1, 2 or 5 times a decade.
                    let fits = |v: f64| last - first > 3.0 || (v >= low / 2.6 && v <= high * 2.6);
                    let ends: Vec<f64> = log_marks(first, last, &[1.0, 2.0, 5.0]).into_iter().filter(|v| fits(*v)).collect();
                    low = ends.iter().copied().filter(|v| *v <= low).fold(f64::NAN, f64::max);
                    high = ends.iter().copied().filter(|v| *v >= high).fold(f64::NAN, f64::min);
                    if low.is_nan() || high.is_nan() || low == high {
                        (low, high) = (10f64.powf(first), 10f64.powf(last));
                    }
                }
                let parts: &[f64] = if (high / low).log10() <= 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
                let stride = (((high / low).log10() / wanted as f64).ceil()).max(1.0) as usize;
                let at = log_marks(first, last, parts)
                    .into_iter()
                    .filter(|v| *v >= low * (1.0 - 1e-9) && *v <= high * (1.0 + 1e-9))
                    .step_by(if parts.len() == 1 { stride } else { 1 })
                    .map(|v| (v, crate::words::number(v)))
                    .collect();
                Self { low, high, scale: axis.scale, at }
            }
        }
    }

    pub fn fraction(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Log => (value / self.low).log10() / (self.high / self.low).log10(),
        }
    }

    fn labels(&self) -> impl Iterator<Item = &str> {
        self.at.iter().map(|(_, label)| label.as_str())
    }
}

fn log_marks(first: f64, last: f64, parts: &[f64]) -> Vec<f64> {
    let decades = (last - first).clamp(0.0, 60.0) as i32;
    (0..=decades).flat_map(|i| parts.iter().map(move |part| part * 10f64.powf(first + f64::from(i)))).collect()
}

/// The next of 1, 2, 5 times a power of ten.
fn round_step(raw: f64) -> f64 {
    let decade = 10f64.powf(raw.log10().floor());
    let lead = raw / decade;
    decade
        * if lead <= 1.0 + 1e-9 {
            1.0
        } else if lead <= 2.0 {
            2.0
        } else if lead <= 5.0 {
            5.0
        } else {
            10.0
        }
}

fn tick_label(value: f64, step: f64) -> String {
    let value = if value.abs() < 1e-9 * step { 0.0 } else { value };
    if value.abs() >= 1e6 || step < 1e-4 {
        return crate::words::number(value);
    }
    let digits = (-step.log10().floor()).max(0.0) as usize;
    format!("{value:.digits$}").replace('-', "\u{2212}")
}

/// Where a text is held.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// An SVG document under construction. Colours stand in attributes (for files) and in classes (for pages,
/// which may restyle them for dark screens).
pub(crate) struct Svg {
    pub width: f64,
    pub height: f64,
    pub body: String,
}

impl Svg {
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, body: String::new() }
    }

    pub fn text(&mut self, at: [f64; 2], anchor: Anchor, class: &str, fill: &str, size: f64, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let weight = if class.contains("title") { r#" font-weight="bold""# } else { "" };
        let _ = write!(
            self.body,
            r#"<text x="{}" y="{}" text-anchor="{anchor}" class="{class}" fill="{fill}" font-size="{size}"{weight}>{}</text>"#,
            short(at[0]),
            short(at[1]),
            escape(text)
        );
    }

    /// Text that reads upwards, centred at a point.
    pub fn upright_text(&mut self, at: [f64; 2], class: &str, fill: &str, size: f64, text: &str) {
        let _ = write!(
            self.body,
            r#"<text transform="translate({} {}) rotate(-90)" text-anchor="middle" class="{class}" fill="{fill}" font-size="{size}">{}</text>"#,
            short(at[0]),
            short(at[1]),
            escape(text)
        );
    }

    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], class: &str, stroke: &str, width: f64) {
        let _ = write!(
            self.body,
            r#"<path d="M{} {}L{} {}" class="{class}" stroke="{stroke}" stroke-width="{width}"/>"#,
            short(from[0]),
            short(from[1]),
            short(to[0]),
            short(to[1])
        );
    }

    pub fn grid(&mut self, area: &Area, x: &Ticks, y: &Ticks) {
        for (value, _) in &x.at {
            let at = area.left + x.fraction(*value) * area.width();
            self.line([at, area.top], [at, area.bottom], "grid-line", GRID, 1.0);
        }
        for (value, _) in &y.at {
            let at = area.bottom - y.fraction(*value) * area.height();
            self.line([area.left, at], [area.right, at], "grid-line", GRID, 1.0);
        }
    }

    pub fn axes(&mut self, area: &Area, x: &Ticks, y: &Ticks, x_label: &str, y_label: &str) {
        self.line([area.left, area.top], [area.left, area.bottom], "soft-line", SOFT, 1.0);
        self.line([area.left, area.bottom], [area.right, area.bottom], "soft-line", SOFT, 1.0);
        for (value, label) in &x.at {
            let at = area.left + x.fraction(*value) * area.width();
            self.line([at, area.bottom], [at, area.bottom + 4.0], "soft-line", SOFT, 1.0);
            self.text([at, area.bottom + 18.0], Anchor::Middle, "soft", SOFT, 12.0, label);
        }
        for (value, label) in &y.at {
            let at = area.bottom - y.fraction(*value) * area.height();
            self.line([area.left - 4.0, at], [area.left, at], "soft-line", SOFT, 1.0);
            self.text([area.left - 8.0, at + 4.0], Anchor::End, "soft", SOFT, 12.0, label);
        }
        let middle = [0.5 * (area.left + area.right), 0.5 * (area.top + area.bottom)];
        self.text([middle[0], area.bottom + 39.0], Anchor::Middle, "ink", INK, 12.5, x_label);
        if !y_label.is_empty() {
            self.upright_text([18.0, middle[1]], "ink", INK, 12.5, y_label);
        }
    }

    /// What follows is clipped to the area, in the same coordinates.
    pub fn open_clip(&mut self, area: &Area) {
        // Two pixels more, so that a line along the edge keeps its width.
        let (x, y) = (short(area.left - 2.0), short(area.top - 2.0));
        let (w, h) = (short(area.width() + 4.0), short(area.height() + 4.0));
        let _ = write!(self.body, r#"<svg x="{x}" y="{y}" width="{w}" height="{h}" viewBox="{x} {y} {w} {h}" overflow="hidden">"#);
    }

    pub fn close_clip(&mut self) {
        self.body.push_str("</svg>");
    }

    fn marker(&mut self, at: [f64; 2], ink: Ink) {
        let (n, paint) = match ink {
            Ink::Series(n) => (n, format!(r#"fill="{}""#, ink.color())),
            Ink::Reference(n) => (n, format!(r#"class="ink-line" fill="none" stroke="{INK}" stroke-width="1.5""#)),
        };
        let (x, y) = (short(at[0]), short(at[1]));
        let d = match n % 4 {
            0 => format!("M{x} {y}m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z"),
            1 => format!("M{x} {y}m-3.6 -3.6h7.2v7.2h-7.2Z"),
            2 => format!("M{x} {y}m0 -4.8l4.6 8.2h-9.2Z"),
            _ => format!("M{x} {y}m0 -5l5 5l-5 5l-5 -5Z"),
        };
        let _ = write!(self.body, r#"<path d="{d}" {paint}/>"#);
    }

    pub fn finish(self) -> String {
        let (w, h) = (short(self.width), short(self.height));
        format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w} {h}" width="{w}" height="{h}" font-family="'DejaVu Sans', Verdana, Arial, sans-serif"><rect class="ground" width="{w}" height="{h}" fill="#ffffff"/>{}</svg>"##,
            self.body
        )
    }
}

/// A coordinate with at most one decimal.
pub(crate) fn short(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
}

/// Text that is safe between tags and inside attributes.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;").replace('\'', "&#39;")
}

/// Why an SVG could not become a PNG.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PngError {
    /// The SVG text cannot be understood.
    #[error("the svg cannot be understood: {0}")]
    Svg(#[from] usvg::Error),
    /// The picture would have no pixels, or too many.
    #[error("{width} x {height} px at scale {scale} is no picture that can be drawn; choose a scale in (0, 8]")]
    Size {
        /// Width of the SVG, px.
        width: f32,
        /// Height of the SVG, px.
        height: f32,
        /// Asked scale, dimensionless.
        scale: f32,
    },
    /// The PNG encoder failed.
    #[error("the png encoder failed: {0}")]
    Encode(String),
}

/// The SVG document `svg`, called `name` in errors, as PNG with two pixels a unit.
///
/// # Errors
/// As [`png_from_svg`].
pub fn png(name: &str, svg: &str) -> Result<Vec<u8>, ReportError> {
    png_from_svg(svg, PNG_SCALE).map_err(|error| ReportError::Raster { figure: name.to_owned(), reason: error.to_string() })
}

/// Pixels of a PNG figure per unit of its SVG.
const PNG_SCALE: f32 = 2.0;

/// An SVG document as PNG, `scale` pixels a unit. Text is drawn letter by letter in the built-in font, as plots write it.
///
/// # Errors
/// If the SVG is malformed, or the picture has no size.
pub fn png_from_svg(svg: &str, scale: f32) -> Result<Vec<u8>, PngError> {
    let drawn = outlined(svg).map_err(usvg::Error::ParsingFailed)?;
    let tree = usvg::Tree::from_str(&drawn, &usvg::Options::default())?;
    let (width, height) = (tree.size().width(), tree.size().height());
    let too_large = PngError::Size { width, height, scale };
    let (w, h) = ((width * scale).ceil(), (height * scale).ceil());
    if !(w >= 1.0 && h >= 1.0 && w * h <= 4e8) {
        return Err(too_large);
    }
    let mut pixels = tiny_skia::Pixmap::new(w as u32, h as u32).ok_or(too_large)?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| PngError::Encode(error.to_string()))
}
