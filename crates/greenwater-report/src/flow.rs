//! Pictures of the particles, coloured by pressure.

use std::fmt::Write;

use crate::plot::{Anchor, Area, Axis, Scale, Svg, Ticks, short};
use crate::run::{Frame, Scales};

/// Viridis at even steps from 0 to 1: perceptually uniform, and readable with every common colour blindness.
/// Source: van der Walt & Smith (2015), released to the public domain.
const VIRIDIS: [u32; 33] = [
    0x440154, 0x470d60, 0x48186a, 0x482374, 0x472d7b, 0x453781, 0x424086, 0x3e4989, 0x3b528b, 0x375b8d, 0x33638d, 0x2f6b8e, 0x2c728e,
    0x297a8e, 0x26828e, 0x23898e, 0x21918c, 0x1f988b, 0x1fa088, 0x22a785, 0x28ae80, 0x32b67a, 0x3fbc73, 0x4ec36b, 0x5ec962, 0x70cf57,
    0x84d44b, 0x98d83e, 0xaddc30, 0xc2df23, 0xd8e219, 0xece51b, 0xfde725,
];
/// Number of colours in a picture.
const LEVELS: usize = 64;
/// Most particles drawn in one panel; more are thinned to one a cell, the nearest to the viewer.
const MOST: usize = 20_000;
/// Colour of wall particles.
const WALL: &str = "#9aa5ae";
/// Colour of fluid without a known pressure.
const UNKNOWN: &str = "#c9a227";

/// Colour of a pressure fraction as `#rrggbb`; clipped to 0 ... 1.
pub fn color(fraction: f64) -> String {
    let place = fraction.clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f64;
    let low = (place.floor() as usize).min(VIRIDIS.len() - 2);
    let part = place - low as f64;
    let mix = |shift: u32| {
        let (a, b) = ((VIRIDIS[low] >> shift) & 255, (VIRIDIS[low + 1] >> shift) & 255);
        (f64::from(a) + part * (f64::from(b) - f64::from(a))).round() as u32
    };
    format!("#{:02x}{:02x}{:02x}", mix(16), mix(8), mix(0))
}

/// Which way the particles are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View {
    /// Axis that runs to the right.
    pub across: usize,
    /// Axis that runs upwards.
    pub up: usize,
    /// Axis along which one looks; `None` in 2D.
    pub depth: Option<usize>,
}

impl View {
    /// The plane itself in 2D; in 3D from the side, along the last horizontal axis, gravity down.
    pub fn of(dimension: usize, scales: &Scales) -> Self {
        if dimension < 3 {
            let up = scales.up_axis.filter(|&up| up < 2).unwrap_or(1);
            return Self { across: 1 - up, up, depth: None };
        }
        let up = scales.up_axis.filter(|&up| up < 3).unwrap_or(2);
        let across = usize::from(up == 0);
        Self { across, up, depth: Some(3 - up - across) }
    }
}

/// What stands in one panel.
#[derive(Clone, Debug)]
pub enum Panel {
    /// A frame with the text above it.
    Picture {
        /// Text above, such as the true time.
        heading: String,
        /// The particles.
        frame: Frame,
        /// Pressure that takes the last colour, Pa; `None`: pressures are not coloured.
        pressure_scale: Option<f64>,
        /// Particle spacing, m.
        spacing: f64,
    },
    /// A sentence in place of a picture.
    Message(String),
}

/// A sheet of panels with one colour scale and one set of axes.
#[derive(Clone, Debug)]
pub struct FlowSheet {
    /// Title, shown above.
    pub title: String,
    /// Heads of the columns; may be empty.
    pub columns: Vec<String>,
    /// Panels in rows of equal length.
    pub rows: Vec<Vec<Panel>>,
    /// Part of space that is shown: `[min, max]` across and up, m.
    pub window: [[f64; 2]; 2],
    /// The view.
    pub view: View,
    /// Pressure that takes the last colour, Pa.
    pub pressure_scale: Option<f64>,
}

impl FlowSheet {
    /// The sheet as an SVG document 1100 px wide.
    pub fn svg(&self) -> String {
        let width = 1100.0;
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(1).max(1);
        let (margin_left, margin_right, gap) = (60.0, 24.0, 26.0);
        let panel_width = (width - margin_left - margin_right - gap * (columns - 1) as f64) / columns as f64;
        let [[left, right], [bottom, top]] = self.window;
        let panel_height = (panel_width * (top - bottom) / (right - left)).clamp(60.0, 700.0);
        let mut svg = Svg::new(width, 0.0);
        svg.text([16.0, 24.0], Anchor::Start, "ink title", "#1b2733", 15.0, &self.title);
        self.color_bar(&mut svg, 40.0);
        let mut y = 108.0;
        if !self.columns.is_empty() {
            for (i, name) in self.columns.iter().enumerate() {
                let x = margin_left + (panel_width + gap) * i as f64;
                svg.text([x, y + 10.0], Anchor::Start, "ink title", "#1b2733", 14.0, name);
            }
            y += 22.0;
        }
        let names = ["x [m]", "y [m]", "z [m]"];
        let axis = |range: [f64; 2]| Axis { label: String::new(), scale: Scale::Linear, range: Some(range) };
        let across = Ticks::over(&axis(self.window[0]), self.window[0], (panel_width / 70.0) as usize + 1);
        let up = Ticks::over(&axis(self.window[1]), self.window[1], (panel_height / 55.0) as usize + 1);
        for (r, row) in self.rows.iter().enumerate() {
            let last = r + 1 == self.rows.len();
            for (c, panel) in row.iter().enumerate() {
                let x = margin_left + (panel_width + gap) * c as f64;
                let area = Area { left: x, top: y + 18.0, right: x + panel_width, bottom: y + 18.0 + panel_height };
                match panel {
                    Panel::Message(text) => {
                        let d = frame_outline(&area);
                        let _ = write!(svg.body, r##"<path d="{d}" class="grid-line" fill="none" stroke="#e4e8ec"/>"##);
                        let lines = wrap(text, panel_width - 30.0, 12.0);
                        let middle = 0.5 * (area.top + area.bottom) - 8.0 * (lines.len() as f64 - 1.0);
                        for (i, line) in lines.iter().enumerate() {
                            let at = [0.5 * (area.left + area.right), middle + 16.0 * i as f64];
                            svg.text(at, Anchor::Middle, "soft", "#5a6875", 12.0, line);
                        }
                    }
                    Panel::Picture { heading, frame, pressure_scale, spacing } => {
                        svg.text([x, y + 12.0], Anchor::Start, "soft", "#5a6875", 12.0, heading);
                        // The colours are made for a light ground, also on a dark page.
                        let d = frame_outline(&area);
                        let _ = write!(svg.body, r##"<path d="{d}" class="panel" fill="#ffffff"/>"##);
                        self.particles(&mut svg, &area, frame, *pressure_scale, *spacing);
                        let _ = write!(svg.body, r##"<path d="{d}" class="soft-line" fill="none" stroke="#5a6875"/>"##);
                    }
                }
                for (value, label) in across.at.iter().filter(|_| last) {
                    let at = area.left + across.fraction(*value) * area.width();
                    svg.line([at, area.bottom], [at, area.bottom + 4.0], "soft-line", "#5a6875", 1.0);
                    svg.text([at, area.bottom + 17.0], Anchor::Middle, "soft", "#5a6875", 11.5, label);
                }
                for (value, label) in up.at.iter().filter(|_| c == 0) {
                    let at = area.bottom - up.fraction(*value) * area.height();
                    svg.line([area.left - 4.0, at], [area.left, at], "soft-line", "#5a6875", 1.0);
                    svg.text([area.left - 8.0, at + 4.0], Anchor::End, "soft", "#5a6875", 11.5, label);
                }
                if last {
                    let at = [0.5 * (area.left + area.right), area.bottom + 35.0];
                    svg.text(at, Anchor::Middle, "ink", "#1b2733", 12.0, names[self.view.across]);
                }
                if c == 0 {
                    svg.upright_text([16.0, 0.5 * (area.top + area.bottom)], "ink", "#1b2733", 12.0, names[self.view.up]);
                }
            }
            y += 18.0 + panel_height + 14.0;
        }
        svg.height = y + 36.0;
        svg.finish()
    }

    fn color_bar(&self, svg: &mut Svg, top: f64) {
        let Some(scale) = self.pressure_scale else { return };
        let (left, long) = (60.0, 420.0);
        for level in 0..LEVELS {
            let x = left + long * level as f64 / LEVELS as f64;
            let fill = color((level as f64 + 0.5) / LEVELS as f64);
            let w = short(long / LEVELS as f64 + 0.4);
            let _ = write!(svg.body, r#"<rect x="{}" y="{top}" width="{w}" height="12" fill="{fill}"/>"#, short(x));
        }
        for quarter in 0..=4 {
            let fraction = 0.25 * f64::from(quarter);
            let x = left + long * fraction;
            svg.line([x, top + 12.0], [x, top + 16.0], "soft-line", "#5a6875", 1.0);
            svg.text([x, top + 29.0], Anchor::Middle, "ink", "#1b2733", 11.0, &fraction.to_string());
            let pascal = format!("{} Pa", crate::words::number((fraction * scale).round()));
            svg.text([x, top + 43.0], Anchor::Middle, "soft", "#5a6875", 11.0, &pascal);
        }
        let at = [left + long + 56.0, top + 10.0];
        svg.text(at, Anchor::Start, "ink", "#1b2733", 12.0, "pressure over \u{3c1}gH, clipped at both ends");
        if self.view.depth.is_some() {
            return;
        }
        let below = [at[0], top + 29.0];
        let _ = write!(svg.body, r#"<circle cx="{}" cy="{}" r="4.5" fill="{WALL}"/>"#, short(below[0] + 5.0), short(below[1] - 4.0));
        svg.text([below[0] + 16.0, below[1]], Anchor::Start, "soft", "#5a6875", 12.0, "wall particles");
    }

    /// Draws each colour as one path of dots, in tenths of a pixel.
    fn particles(&self, svg: &mut Svg, area: &Area, frame: &Frame, pressure_scale: Option<f64>, spacing: f64) {
        let [[left, right], [bottom, top]] = self.window;
        let (sx, sy) = (10.0 * area.width() / (right - left), 10.0 * area.height() / (top - bottom));
        let mut dots: Vec<Dot> = Vec::new();
        for (i, point) in frame.points.iter().enumerate() {
            let (x, y) = ((point[self.view.across] - left) * sx, (top - point[self.view.up]) * sy);
            let margin = 100.0;
            let inside = x > -margin && x < 10.0 * area.width() + margin && y > -margin && y < 10.0 * area.height() + margin;
            if !inside {
                continue;
            }
            let wall = frame.kind.get(i).is_some_and(|&kind| kind != 0);
            if wall && self.view.depth.is_some() {
                continue;
            }
            let pressure = frame.pressure.get(i).copied().unwrap_or(f64::NAN);
            let layer = match pressure_scale {
                _ if wall => Layer::Wall,
                Some(scale) if pressure.is_finite() => {
                    Layer::Pressure(((pressure / scale).clamp(0.0, 1.0) * LEVELS as f64).min(LEVELS as f64 - 1.0) as usize)
                }
                _ => Layer::Unknown,
            };
            let depth = self.view.depth.map_or(0.0, |axis| point[axis]);
            dots.push(Dot { at: [x.round() as i64, y.round() as i64], depth, layer });
        }
        let mut size = (0.95 * spacing * sx).max(8.0);
        if self.view.depth.is_some() {
            // Looking along x to the right and y up, the nearest has the largest z; with z up, the smallest y.
            let towards = if self.view.up == 1 { -1.0 } else { 1.0 };
            dots.sort_by(|a, b| (towards * a.depth).total_cmp(&(towards * b.depth)));
            dots = thin(dots, (0.5 * size) as i64);
        }
        while dots.len() > MOST {
            size = size.max(10.0);
            dots = thin(dots, (0.5 * size) as i64);
            if dots.len() > MOST {
                size *= 1.3;
            }
        }
        dots.sort_by_key(|dot| dot.layer);
        let mut body = String::new();
        for group in dots.chunk_by(|a, b| a.layer == b.layer) {
            let stroke = match group[0].layer {
                Layer::Wall => WALL.to_owned(),
                Layer::Unknown => UNKNOWN.to_owned(),
                Layer::Pressure(level) => color((level as f64 + 0.5) / LEVELS as f64),
            };
            let _ = write!(body, r#"<path stroke="{stroke}" d=""#);
            for dot in group {
                let _ = write!(body, "M{} {}h1", dot.at[0], dot.at[1]);
            }
            body.push_str(r#""/>"#);
        }
        let (x, y, w, h) = (short(area.left), short(area.top), short(area.width()), short(area.height()));
        let _ = write!(
            svg.body,
            r#"<svg x="{x}" y="{y}" width="{w}" height="{h}" viewBox="0 0 {} {}" overflow="hidden"><g fill="none" stroke-linecap="round" stroke-width="{}">{body}</g></svg>"#,
            short(10.0 * area.width()),
            short(10.0 * area.height()),
            short(size)
        );
    }
}

/// A single picture of particles as an SVG document, in a window that holds all of them.
pub fn preview(title: &str, dimension: usize, frame: Frame, scales: &Scales) -> String {
    let view = View::of(dimension, scales);
    let spacing = scales.spacing.unwrap_or(0.0);
    let window = [view.across, view.up].map(|axis| {
        let range = frame.points.iter().map(|point| [point[axis], point[axis]]).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let [low, high] = range.unwrap_or([0.0, 1.0]);
        [low - 2.0 * spacing, high + 2.0 * spacing]
    });
    let count = |kind: u8| frame.kind.iter().filter(|&&k| k == kind).count();
    let heading = format!("{} fluid and {} wall particles, spacing {spacing} m", count(0), count(1));
    let pressure_scale = scales.pressure();
    let panel = Panel::Picture { heading, frame, pressure_scale, spacing };
    FlowSheet { title: title.to_owned(), columns: Vec::new(), rows: vec![vec![panel]], window, view, pressure_scale }.svg()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Layer {
    Wall,
    Unknown,
    Pressure(usize),
}

#[derive(Clone, Copy, Debug)]
struct Dot {
    at: [i64; 2],
    depth: f64,
    layer: Layer,
}

/// Keeps the first dot (the nearest to the viewer) of each cell.
fn thin(dots: Vec<Dot>, cell: i64) -> Vec<Dot> {
    let cell = cell.max(1);
    let mut taken = std::collections::BTreeSet::new();
    dots.into_iter().filter(|dot| taken.insert((dot.at[0].div_euclid(cell), dot.at[1].div_euclid(cell)))).collect()
}

fn frame_outline(area: &Area) -> String {
    format!("M{} {}h{}v{}h-{}Z", short(area.left), short(area.top), short(area.width()), short(area.height()), short(area.width()))
}

fn wrap(text: &str, width: f64, size: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if crate::plot::text_width(line, size) + crate::plot::text_width(word, size) + size < width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
