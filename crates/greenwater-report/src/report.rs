//! Puts a report together: reads runs, measures, draws, writes.

mod instruments;
mod methods;

use std::fs;
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};

use rayon::prelude::*;
use serde_json::{Value, json};

use crate::error::ReportError;
use crate::flow::{FlowSheet, Panel, View};
use crate::measure::{FRONT_LEVELS, HEIGHT_LEVELS, Measured};
use crate::page::{Block, Cells, Figure, Page, Section, Table};
use crate::plot::{Axis, LinePlot, Series, Style, png};
use crate::run::{Frame, Outcome, Reference, Run, Spread};
use crate::words::{self, join, number, quantity, signed_percent};

/// Largest lead in time over a reference that is accepted, percent either way.
///
/// Converged inviscid codes lead the dam-break experiments by 10 to 19 %: gate and bed friction.
const ACCEPTED_LEAD: f64 = 20.0;

/// Where a report lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportPaths {
    /// The page.
    pub html: PathBuf,
    /// The numbers.
    pub json: PathBuf,
    /// The figures, SVG and PNG.
    pub figures: Vec<PathBuf>,
}

/// Writes `index.html`, `report.json` and `figures/` for the given run folders into `out`, from stored data only.
///
/// Each file is written under a temporary name and renamed, `report.json` first: a folder that holds it is a report, finished or not.
/// What a run did not leave is said in the page.
///
/// # Errors
/// If the list is empty, a path is no run folder, or `out` cannot be written.
pub fn write_report(runs: &[PathBuf], out: &Path) -> Result<ReportPaths, ReportError> {
    let runs = Run::read_all(runs)?;
    let report = Report::of(&runs);
    let create =
        |path: &Path| fs::create_dir_all(path).map_err(|source| ReportError::Io { action: "create", path: path.to_owned(), source });
    let (html, json, figures_dir) = (out.join("index.html"), out.join("report.json"), out.join("figures"));
    create(out)?;
    write_file(&json, format!("{:#}\n", report.json()).as_bytes())?;
    create(&figures_dir)?;
    let page = report.page(out);
    // Turning drawings into pictures is most of the time, and none knows of another.
    let drawn: Vec<&Figure> = page.figures().collect();
    let pictures: Vec<Vec<u8>> = drawn.par_iter().map(|figure| png(&figure.name, &figure.svg)).collect::<Result<_, _>>()?;
    let mut figures = Vec::new();
    for (figure, png) in drawn.into_iter().zip(&pictures) {
        for (extension, bytes) in [("svg", figure.svg.as_bytes()), ("png", png.as_slice())] {
            let path = figures_dir.join(format!("{}.{extension}", figure.name));
            write_file(&path, bytes)?;
            figures.push(path);
        }
    }
    write_file(&html, page.html().as_bytes())?;
    Ok(ReportPaths { html, json, figures })
}

/// Writes a file under a temporary name beside it and renames it.
fn write_file(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
    let write = || {
        let mut file = fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        drop(file);
        fs::rename(&temporary, path)
    };
    write().map_err(|source| {
        // The error that matters is the first one; a left-over temporary file is harmless.
        let _ = fs::remove_file(&temporary);
        ReportError::Io { action: "write", path: path.to_owned(), source }
    })
}

/// A checked quantity of `report.json`.
#[derive(Clone, Debug, PartialEq)]
struct Check {
    what: String,
    method: String,
    unit: &'static str,
    value: f64,
    low: f64,
    high: f64,
    source: &'static str,
}

impl Check {
    fn pass(&self) -> bool {
        self.value >= self.low && self.value <= self.high
    }
}

/// Runs with their numbers.
struct Report<'a> {
    runs: &'a [Run],
    numbers: Vec<Measured>,
    references: &'a [Reference],
}

impl<'a> Report<'a> {
    fn of(runs: &'a [Run]) -> Self {
        // Runs of one comparison share their references; take the first list that has any.
        let references = runs.iter().map(|run| run.provenance.compare.references.as_slice()).find(|r| !r.is_empty()).unwrap_or(&[]);
        let numbers = runs.iter().map(|run| Measured::of(run, references)).collect();
        Self { runs, numbers, references }
    }

    fn pressure_scale(&self) -> Option<f64> {
        self.numbers.iter().find_map(|m| m.pressure_scale)
    }

    /// Head of a table with one column a method.
    fn head(&self, first: &str) -> Vec<String> {
        std::iter::once(first.to_owned()).chain(self.numbers.iter().map(|m| m.name.clone())).collect()
    }

    /// A table row with one cell a method.
    fn row(&self, name: &str, cell: impl Fn(&Measured) -> String) -> Vec<String> {
        std::iter::once(name.to_owned()).chain(self.numbers.iter().map(cell)).collect()
    }

    fn references(&self, quantity: &str) -> Vec<&'a Reference> {
        self.references.iter().filter(|r| r.quantity == quantity && r.scaling().is_some()).collect()
    }

    // ---- numbers ----------------------------------------------------------------------------------------------

    fn checks(&self) -> Vec<Check> {
        let mut checks = Vec::new();
        for m in &self.numbers {
            let check =
                |what: String, unit, value, low, high, source| Check { what, method: m.name.clone(), unit, value, low, high, source };
            let finished = f64::from(u8::from(m.completed));
            checks.push(check("finished".into(), "1", finished, 1.0, 1.0, "DONE in the run folder"));
            if let Some(lost) = m.lost_particles {
                checks.push(check("lost particles".into(), "1", lost as f64, 0.0, 0.0, "summary.json"));
            }
            for reference in self.references("front") {
                let leads = m.leads.iter().filter(|l| l.quantity == "front" && l.reference == reference.name);
                if let Some(worst) = leads.map(|l| l.percent).max_by(|a, b| a.abs().total_cmp(&b.abs())) {
                    checks.push(check(
                        format!("largest lead of the front over {}, 1.5 <= Z <= 3.5", reference.name),
                        "% of time",
                        worst,
                        -ACCEPTED_LEAD,
                        ACCEPTED_LEAD,
                        "front.csv against the reference",
                    ));
                }
            }
        }
        checks
    }

    fn json(&self) -> Value {
        let spread = |s: Spread| json!({"min": s.min, "median": s.median, "max": s.max});
        let methods: Vec<Value> = self
            .numbers
            .iter()
            .zip(self.runs)
            .map(|(m, run)| {
                let probes: serde_json::Map<String, Value> = m
                    .probes
                    .iter()
                    .map(|p| {
                        let mut value = instruments::impact_json(&p.impact);
                        value["mean"] = json!(p.mean);
                        (p.name.clone(), value)
                    })
                    .collect();
                let loads: serde_json::Map<String, Value> =
                    m.loads.iter().map(|l| (l.name.clone(), instruments::impact_json(&l.impact))).collect();
                let energy = m.energy.map(
                    |e| json!({"initial": e.initial, "final": e.last, "max_rise": e.max_rise, "loss": e.loss(), "unit": m.energy_unit}),
                );
                let phases: serde_json::Map<String, Value> =
                    m.phases.iter().map(|(name, seconds)| (name.clone(), json!(seconds))).collect();
                let leads: Vec<Value> = m
                    .leads
                    .iter()
                    .map(|l| json!({"quantity": l.quantity, "reference": l.reference, "level": l.level, "lead_percent": l.percent}))
                    .collect();
                json!({
                    "name": m.name, "preset": m.preset, "completed": m.completed, "error": error_text(run),
                    "end_time": m.end_time, "steps": m.steps, "wall_seconds": m.wall_seconds, "dt": spread(m.dt),
                    "iterations": m.iterations.map(spread), "particles": m.particles,
                    "pressure_noise": m.pressure_noise,
                    "density_percentiles": {"p01": m.density.p01, "p99": m.density.p99},
                    "volume_error": m.volume_error, "worst_volume_error": m.worst_volume_error, "energy": energy, "front": m.front,
                    "residual_height": m.residual_height, "probes": probes, "loads": loads, "lost_particles": m.lost_particles,
                    "leads": leads, "phases": phases, "missing": run.notes,
                })
            })
            .collect();
        let acceptance: Vec<Value> = self
            .checks()
            .iter()
            .map(|c| {
                json!({"what": c.what, "method": c.method, "unit": c.unit, "value": c.value, "low": c.low,
                       "high": c.high, "pass": c.pass(), "source": c.source})
            })
            .collect();
        let findings: Vec<Value> =
            words::findings(&self.numbers).iter().map(|f| json!({"headline": f.headline, "detail": f.detail})).collect();
        json!({"format": 1, "title": self.title(), "methods": methods, "acceptance": acceptance, "findings": findings})
    }

    // ---- page -------------------------------------------------------------------------------------------------

    fn title(&self) -> String {
        let provenance = &self.runs[0].provenance;
        [&provenance.title, &provenance.case].into_iter().find(|t| !t.is_empty()).cloned().unwrap_or("Runs".into())
    }

    fn page(&self, out: &Path) -> Page {
        let provenance = &self.runs[0].provenance;
        let names: Vec<String> = self.numbers.iter().map(|m| m.name.clone()).collect();
        let mut subtitle = if names.len() == 1 { names[0].clone() } else { format!("{} compared", join(&names)) };
        if !provenance.case.is_empty() {
            subtitle = format!("Case {}: {subtitle}", provenance.case);
        }
        Page {
            title: self.title(),
            subtitle,
            head: self.overview(),
            sections: vec![
                Section::new("The flow", self.flow()),
                Section::new("Front and residual height", self.fronts()),
                Section::new("Wall pressure", self.pressures()),
                Section::new("Loads and gauges", self.loads_and_gauges()),
                Section::new("Energy", self.energies()),
                Section::new("Density and pressure noise", self.quality()),
                Section::new("Distinctions of the methods", self.distinctions()),
                Section::new("Cost", self.cost()),
                Section::new("Checks", self.check_table()),
                Section::new("How this was made", self.making(out)),
            ],
            footer: format!("Written by greenwater-report {} from stored run folders. SI units throughout.", env!("CARGO_PKG_VERSION")),
        }
    }

    fn overview(&self) -> Vec<Block> {
        let findings = words::findings(&self.numbers).into_iter().map(|f| (f.headline, f.detail)).collect();
        let mut blocks = vec![Block::Cards(findings)];
        let rows = self.runs.iter().zip(&self.numbers).map(|(run, m)| {
            let provenance = &run.provenance;
            let counts = run.summary.particles.unwrap_or(provenance.particles);
            let title = if provenance.method_title.is_empty() { "not said" } else { &provenance.method_title };
            vec![
                m.name.clone(),
                title.to_owned(),
                m.preset.clone(),
                format!("{} fluid + {} wall", counts.fluid, counts.wall),
                m.steps.map_or("not known".into(), |n| n.to_string()),
                m.wall_seconds.map_or("not known".into(), words::duration),
                run.summary.threads.or(provenance.threads).map_or("not known".into(), |n| n.to_string()),
                outcome_text(run),
            ]
        });
        let head = ["run", "method", "preset", "particles", "steps", "wall time", "threads", "outcome"];
        blocks.push(Block::Table(Table {
            caption: "What was run.".into(),
            head: head.map(str::to_owned).into(),
            rows: rows.collect(),
            cells: Cells::Words,
        }));
        for (run, m) in self.runs.iter().zip(&self.numbers) {
            if let Some(error) = error_text(run) {
                let place = quantity(run.frames.last().map(|f| f.time), "s");
                blocks.push(Block::Notice(format!("{} stopped early: {error}. Last frame at {place}.", m.name)));
            }
            if !run.notes.is_empty() {
                blocks.push(Block::Notice(format!("{}: {}.", m.name, run.notes.join("; "))));
            }
        }
        let scales = |run: &Run| {
            let s = &run.provenance.scales;
            [s.spacing, s.height, s.width, s.rest_density, s.viscosity, s.gravity].map(|v| v.map(f64::to_bits))
        };
        if self.runs.iter().any(|run| run.provenance.case != self.runs[0].provenance.case || scales(run) != scales(&self.runs[0])) {
            blocks.push(Block::Notice("These runs are of different cases or resolutions: compare their numbers with care.".into()));
        }
        blocks.push(Block::Text("Departures from the methods as printed:".into()));
        let departures = self.runs.iter().zip(&self.numbers).flat_map(|(run, m)| {
            let list = &run.provenance.departures;
            let none = list.is_empty().then(|| format!("{}: none.", m.name));
            list.iter().map(|text| format!("{}: {text}", m.name)).chain(none).collect::<Vec<_>>()
        });
        blocks.push(Block::List(departures.collect()));
        blocks
    }

    // ---- flow -------------------------------------------------------------------------------------------------

    fn flow(&self) -> Vec<Block> {
        if self.runs.iter().all(|run| run.frames.is_empty()) {
            return vec![Block::Notice("No frames were stored, so the flow cannot be shown.".into())];
        }
        let times = self.picture_times();
        let columns: Vec<Vec<Panel>> = self.runs.iter().map(|run| panels(run, &times)).collect();
        let dimension = self.runs[0].provenance.dimension;
        let view = View::of(dimension, &self.runs[0].provenance.scales);
        let Some(window) = self.window(&columns, view) else {
            return vec![Block::Notice("The frames hold no particles, so the flow cannot be shown.".into())];
        };
        let (rows, heads) = if let [single] = columns.as_slice() {
            let mut rows: Vec<Vec<Panel>> = single.chunks(2).map(<[Panel]>::to_vec).collect();
            if let Some(last) = rows.last_mut().filter(|row| row.len() < 2 && single.len() > 1) {
                last.push(Panel::Message(String::new()));
            }
            (rows, Vec::new())
        } else {
            let rows = (0..times.len()).map(|i| columns.iter().map(|column| column[i].clone()).collect()).collect();
            (rows, self.numbers.iter().map(|m| m.name.clone()).collect())
        };
        let sheet = FlowSheet {
            title: "Particles coloured by pressure".into(),
            columns: heads,
            rows,
            window,
            view,
            pressure_scale: self.pressure_scale(),
        };
        let axes = ["x", "y", "z"];
        let seen = match view.depth {
            None => " Grey: wall particles.".to_owned(),
            Some(depth) => format!(
                " Side view on the {}-{} plane, looking along {}, gravity down; the particles nearest to the viewer are shown, walls are left out.",
                axes[view.across], axes[view.up], axes[depth]
            ),
        };
        let order = if self.runs.len() == 1 { "Times in reading order" } else { "One row a time, one column a method" };
        let caption = format!(
            "{order}, the same colours everywhere; each panel gives the true time of its frame \
             (the stored frame nearest to the asked time). Look at how even the colours are: steps and speckles are pressure \
             noise.{seen}"
        );
        vec![Block::Figure(Figure { name: "flow".into(), svg: sheet.svg(), caption })]
    }

    /// The asked times, or six evenly spread over the frames.
    fn picture_times(&self) -> Vec<f64> {
        let asked = self.runs.iter().map(|run| &run.provenance.compare.times).find(|times| !times.is_empty());
        if let Some(times) = asked {
            return times.clone();
        }
        let all = || self.runs.iter().flat_map(|run| &run.frames).map(|frame| frame.time);
        let first = all().fold(f64::INFINITY, f64::min);
        let last = all().fold(f64::NEG_INFINITY, f64::max);
        if first == last { vec![first] } else { (0..6).map(|i| first + (last - first) * f64::from(i) / 5.0).collect() }
    }

    /// The part of space to show: the tank with its walls, no higher than the fluid gets.
    fn window(&self, columns: &[Vec<Panel>], view: View) -> Option<[[f64; 2]; 2]> {
        let empty = [f64::INFINITY, f64::NEG_INFINITY];
        let (mut across, mut up, mut fluid_top) = (empty, empty, f64::NEG_INFINITY);
        let mut spacing: f64 = 0.0;
        let add = |range: &mut [f64; 2], v: f64| {
            if v.is_finite() {
                *range = [range[0].min(v), range[1].max(v)];
            }
        };
        // Particles that flew off must not shrink the picture: the tank, where known, is the bound.
        let tank = self.runs.iter().find_map(|run| run.provenance.scales.tank.as_ref());
        let bound = |axis: usize| Some([*tank?.min.get(axis)?, *tank?.max.get(axis)?]).filter(|[a, b]| a < b);
        for panel in columns.iter().flatten() {
            let Panel::Picture { frame, spacing: s, .. } = panel else { continue };
            spacing = spacing.max(*s);
            for (point, kind) in frame.points.iter().zip(&frame.kind) {
                add(&mut across, point[view.across]);
                add(&mut up, point[view.up]);
                if *kind == 0 && point[view.up].is_finite() {
                    fluid_top = fluid_top.max(point[view.up]);
                }
            }
        }
        let pad = 4.0 * spacing;
        let limit = |range: [f64; 2], axis: usize| match bound(axis) {
            // The same margin on both sides: what flew over a wall is no reason to shift the tank.
            Some([low, high]) if axis == view.across => [low - spacing, high + spacing],
            Some([low, high]) => [range[0].clamp(low - pad, low - spacing), range[1].clamp(high, high + pad)],
            None => range,
        };
        if across[0] >= across[1] || up[0] > up[1] {
            return None;
        }
        let (mut across, mut up) = (limit(across, view.across), limit(up, view.up));
        if fluid_top.is_finite() {
            up[1] = up[1].min(fluid_top + 0.08 * (up[1] - up[0])).max(up[0] + 0.1 * (across[1] - across[0]));
        }
        across = [across[0] - 0.5 * spacing, across[1] + 0.5 * spacing];
        up = [up[0] - 0.5 * spacing, up[1] + 0.5 * spacing];
        Some([across, up])
    }

    // ---- front ------------------------------------------------------------------------------------------------

    fn fronts(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let plots = [
            (
                "front",
                "Front position",
                &FRONT_LEVELS[..],
                "Front position of each method against the references (markers). A curve to the left of the markers is ahead of them; the axis ends soon after them.",
            ),
            (
                "residual_height",
                "Residual height at the back wall",
                &HEIGHT_LEVELS[..],
                "Height of the water at the back wall. A curve below the markers, where there are any, falls too early.",
            ),
        ];
        for (column, title, levels, caption) in plots {
            if !self.runs.iter().any(|run| run.front.numbers(column).iter().any(|v| v.is_finite())) {
                blocks.push(Block::Notice(format!("{title}: no run stored it in front.csv.")));
                continue;
            }
            let references = self.references(column);
            // The first reference fixes the dimensionless axes; the others are converted to them.
            let axes = references.first().and_then(|r| Some((r.scaling()?, &r.time_label, &r.value_label)));
            let ((time_scale, value_scale), x_label, y_label) = match axes {
                Some((scaling, time, value)) => (scaling, format!("T = {time}"), format!("Z = {value}")),
                None => ((1.0, 1.0), "time [s]".into(), format!("{} [m]", title.to_lowercase())),
            };
            let mut plot = LinePlot::new(title, x_label, y_label);
            plot.size = [1100.0, 480.0];
            for (i, run) in self.runs.iter().enumerate() {
                let points = run.front.against_time(column).into_iter();
                let scaled = points.map(|p| [p[0] * time_scale, p[1] * value_scale]).collect();
                plot.series.push(Series::line(&self.numbers[i].name, i, scaled));
            }
            for (i, reference) in references.iter().enumerate() {
                plot.series.extend(reference_series(reference, i, time_scale, value_scale));
            }
            if column == "front" {
                // What follows the arrival at the far wall is flat and would squeeze the part that matters.
                let arrivals = self.numbers.iter().filter_map(|m| crate::measure::peak(&times(&m.front), &values(&m.front)));
                let arrival = arrivals.map(|p| p.time * time_scale).fold(0.0, f64::max);
                let last = plot.series.iter().filter(|s| s.style == Style::Markers).flat_map(|s| &s.points);
                // Where there are markers they end with the arrival; a run may rise again later, over the wall.
                let shown = last.map(|p| 1.3 * p[0]).reduce(f64::max).unwrap_or(1.1 * arrival);
                let end = plot.series.iter().flat_map(|s| &s.points).map(|p| p[0]).filter(|t| t.is_finite()).fold(0.0, f64::max);
                plot.x.range = Some([0.0, shown.min(end)]).filter(|[start, end]| start < end);
            }
            let sources: Vec<String> =
                references.iter().filter(|r| !r.source.is_empty()).map(|r| format!("{}: {}", r.name, r.source)).collect();
            let sources = if sources.is_empty() { String::new() } else { format!(" Sources: {}.", sources.join("; ")) };
            blocks.push(figure(column.replace('_', "-"), &plot, format!("{caption}{sources}")));
            blocks.push(self.lead_table(column, title, levels, &references));
        }
        blocks
    }

    fn lead_table(&self, column: &str, title: &str, levels: &[f64], references: &[&Reference]) -> Block {
        let mut rows = Vec::new();
        for reference in references {
            for m in &self.numbers {
                let cell = |level: &f64| {
                    m.leads
                        .iter()
                        .find(|l| l.quantity == column && l.reference == reference.name && l.level == *level)
                        .map_or("\u{2013}".to_owned(), |l| signed_percent(0.01 * (l.percent * 10.0).round() / 10.0))
                };
                let name = format!("{} over {}", m.name, reference.name);
                rows.push(std::iter::once(name).chain(levels.iter().map(cell)).collect::<Vec<_>>());
            }
        }
        if rows.is_empty() {
            return Block::Text(format!("{title}: no reference of this case can be compared with, so there is no lead to state."));
        }
        let head = std::iter::once("lead in time".to_owned()).chain(levels.iter().map(|z| format!("Z = {z}")));
        Block::Table(Table {
            caption: format!(
                "{title}: lead in time over the reference, 100 (T_ref \u{2212} T) / T_ref. Positive: the method is early. \
                 A dash: one of the two does not reach that Z."
            ),
            head: head.collect(),
            rows,
            cells: Cells::Numbers,
        })
    }

    // ---- energy -----------------------------------------------------------------------------------------------

    fn energies(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut figures = Vec::new();
        let mut totals = LinePlot::new("Total energy", "time [s]", "total / initial total [1]");
        totals.size = [1100.0, 380.0];
        for (i, (run, m)) in self.runs.iter().zip(&self.numbers).enumerate() {
            let Some(budget) = m.energy else {
                blocks.push(Block::Notice(format!("{}: energy.csv has no positive total to compare with.", m.name)));
                continue;
            };
            let mut plot = LinePlot::new(format!("Energies, {}", m.name), "time [s]", "energy / initial total [1]");
            plot.size = if self.runs.len() == 1 { [1100.0, 440.0] } else { [640.0, 420.0] };
            for (k, name) in ["kinetic", "potential", "elastic", "total"].into_iter().enumerate() {
                let points: Vec<[f64; 2]> = run.energy.against_time(name).into_iter().map(|p| [p[0], p[1] / budget.initial]).collect();
                if points.iter().any(|p| p[1].is_finite()) {
                    if name == "total" {
                        totals.series.push(Series::line(&m.name, i, points.clone()));
                    }
                    plot.series.push(Series::line(name, k, points));
                }
            }
            let rule = if m.driven {
                "The total may fall (dissipation, impact); it rises where the work that is done on the fluid is more."
            } else {
                "The total may fall (dissipation, impact) but must not rise."
            };
            let caption = format!("Energies of {} over the total at the start. {rule}", m.name);
            figures.push(Figure { name: format!("energy-{}", file_name(&m.name)), svg: plot.svg(), caption });
        }
        if figures.is_empty() {
            return blocks;
        }
        if figures.len() > 1 {
            let caption = "Total energy of each method over its start: how much each dissipates, and when.";
            blocks.push(figure("energy-total".into(), &totals, caption.into()));
        }
        blocks.push(Block::Figures(figures));
        let energy =
            |m: &Measured, say: &dyn Fn(&crate::measure::EnergyBudget) -> String| m.energy.as_ref().map_or("not known".to_owned(), say);
        blocks.push(Block::Table(Table {
            caption: "Total energy: start, end, highest rise above the start and loss at the end, both relative to the start.".into(),
            head: self.head("energy"),
            rows: vec![
                self.row("at the start", |m| energy(m, &|e| quantity(Some(e.initial), &m.energy_unit))),
                self.row("at the end", |m| energy(m, &|e| quantity(Some(e.last), &m.energy_unit))),
                self.row("highest rise", |m| energy(m, &|e| signed_percent(e.max_rise))),
                self.row("loss at the end", |m| energy(m, &|e| signed_percent(e.loss()))),
            ],
            cells: Cells::Numbers,
        }));
        blocks
    }

    // ---- quality ----------------------------------------------------------------------------------------------

    fn quality(&self) -> Vec<Block> {
        let plot = |title: &str, y: &str| {
            let mut plot = LinePlot::new(title, "time [s]", y);
            plot.size = [640.0, 420.0];
            plot
        };
        let mut density = plot("Density, 1st to 99th percentile", "density / rest density [1]");
        let mut noise = plot("Pressure noise", "noise / \u{3c1}gH [1]");
        let mut volume = plot("Volume error", "volume error [1]");
        volume.size = [1100.0, 340.0];
        noise.y = Axis::log(noise.y.label);
        for (i, (run, m)) in self.runs.iter().zip(&self.numbers).enumerate() {
            let quality = &run.quality;
            let edges = quality.numbers("time").iter().zip(quality.numbers("density_p01")).zip(quality.numbers("density_p99"));
            let band = edges.map(|((&t, &low), &high)| [t, low, high]).filter(|b| b.iter().all(|v| v.is_finite())).collect();
            let mean = Series { band, ..Series::line(&m.name, i, quality.against_time("density_mean")) };
            density.series.push(mean);
            // The exact start of a column at rest would stretch the logarithmic axis over round-off.
            let above_round_off = |p: &[f64; 2]| p[1].is_nan() || p[1] > 1e-9;
            let values = quality.against_time("pressure_noise").into_iter().filter(above_round_off).collect();
            noise.series.push(Series::line(&m.name, i, values));
            volume.series.push(Series::line(&m.name, i, quality.against_time("volume_error")));
        }
        let references: Vec<&Reference> = self.references.iter().filter(|r| r.quantity == "pressure_noise").collect();
        for (k, reference) in references.iter().enumerate() {
            let time_scale = reference.time_scale.filter(|t| t.is_finite() && *t > 0.0).unwrap_or(1.0);
            let points = reference.points.iter().map(|p| [p[0] / time_scale, p[1]]).collect();
            noise.series.push(Series::reference(&reference.name, k, points));
        }
        let mut blocks = Vec::new();
        let mut figures = Vec::new();
        let wanted = [
            (
                "density",
                density,
                "Band: from the 1st to the 99th percentile of the fluid inside, away from the surface; line: the mean. A narrow band at 1 is what an incompressible fluid has.",
            ),
            (
                "pressure-noise",
                noise,
                "RMS residual of a local linear fit of the pressure over neighbours within 3 spacings, interior fluid, over \u{3c1}gH; logarithmic axis. Lower is smoother.",
            ),
        ];
        for (name, plot, caption) in wanted {
            if plot.is_empty() {
                blocks.push(Block::Notice(format!("{}: no run stored it in quality.csv.", plot.title)));
            } else {
                figures.push(Figure { name: name.into(), svg: plot.svg(), caption: caption.into() });
            }
        }
        if !figures.is_empty() {
            blocks.push(Block::Figures(figures));
        }
        if volume.is_empty() {
            blocks.push(Block::Notice(format!("{}: no run stored it in quality.csv.", volume.title)));
        } else {
            let caption = "Volume of the fluid against its volume at the start, relative. Below zero: the fluid is squeezed.";
            blocks.push(figure("volume-error".into(), &volume, caption.into()));
        }
        let relative = |v: Option<f64>| v.map_or("not known".to_owned(), |v| signed_percent(v - 1.0));
        blocks.push(Block::Table(Table {
            caption: "Density relative to rest over all frames, volume error at the end and at its worst, particles that left the tank, and pressure noise (median of the frames from a quarter to half of the end time).".into(),
            head: self.head("quality"),
            rows: vec![
                self.row("density, 1st percentile", |m| relative(m.density.p01)),
                self.row("density, 99th percentile", |m| relative(m.density.p99)),
                self.row("volume error", |m| m.volume_error.map_or("not known".into(), signed_percent)),
                self.row("volume error, worst of all frames", |m| m.worst_volume_error.map_or("not known".into(), signed_percent)),
                self.row("lost particles", |m| m.lost_particles.map_or("not known".into(), |n| n.to_string())),
                self.row("pressure noise over \u{3c1}gH", |m| quantity(m.pressure_noise, "")),
            ],
            cells: Cells::Numbers,
        }));
        if !references.is_empty() {
            let rows = references.iter().map(|reference| {
                let median = crate::measure::median(reference.points.iter().map(|p| p[1]));
                vec![reference.name.clone(), quantity(median, ""), reference.source.clone()]
            });
            blocks.push(Block::Table(Table {
                caption: "Pressure noise measured with other codes, as the case gives it.".into(),
                head: ["code", "noise over \u{3c1}gH", "source"].map(str::to_owned).into(),
                rows: rows.collect(),
                cells: Cells::Words,
            }));
        }
        blocks
    }

    // ---- distinctions, cost, checks, making -------------------------------------------------------------------
}

fn times(points: &[[f64; 2]]) -> Vec<f64> {
    points.iter().map(|p| p[0]).collect()
}

fn values(points: &[[f64; 2]]) -> Vec<f64> {
    points.iter().map(|p| p[1]).collect()
}

fn figure(name: String, plot: &LinePlot, caption: String) -> Block {
    Block::Figure(Figure { name, svg: plot.svg(), caption })
}

/// One panel an asked time.
fn panels(run: &Run, times: &[f64]) -> Vec<Panel> {
    let Some(last) = run.frames.last() else {
        return vec![Panel::Message("no frames were stored".into()); times.len()];
    };
    // Half a frame interval late is still the nearest frame; later than that, the run did not get there.
    let intervals = run.frames.windows(2).map(|pair| pair[1].time - pair[0].time);
    let slack = 0.5 * intervals.fold(0.0, f64::max) + 1e-9 * last.time.abs();
    let mut ended = false;
    times
        .iter()
        .map(|&asked| {
            let beyond = asked > last.time + slack;
            if beyond && std::mem::replace(&mut ended, true) {
                return Panel::Message(format!("nothing at {} s: the run ended at {} s", number(asked), number(last.time)));
            }
            let distance = |i: &usize| (run.frames[*i].time - asked).abs();
            let nearest = (0..run.frames.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
            let time = run.frames[nearest].time;
            let note = if beyond {
                format!(" (last frame; {} s was asked)", number(asked))
            } else if (time - asked).abs() > 5e-4 * last.time.abs() {
                format!(" ({} s was asked)", number(asked))
            } else {
                String::new()
            };
            match run.frame(nearest) {
                Ok(frame) => Panel::Picture {
                    heading: format!("t = {time:.4} s{note}"),
                    spacing: run.provenance.scales.spacing.filter(|s| *s > 0.0).unwrap_or_else(|| guess_spacing(&frame)),
                    pressure_scale: run.provenance.scales.pressure(),
                    frame,
                },
                Err(error) => Panel::Message(error.to_string()),
            }
        })
        .collect()
}

/// A dot size for a frame whose run does not state its spacing: as if the particles filled their bounding box.
fn guess_spacing(frame: &Frame) -> f64 {
    let finite = || frame.points.iter().filter(|p| p[0].is_finite() && p[1].is_finite());
    let extent = |axis: usize| {
        let (low, high) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[axis]), h.max(p[axis])));
        (high - low).max(0.0)
    };
    (extent(0) * extent(1) / finite().count().max(1) as f64).sqrt()
}

/// Share of each limit among the logged steps.
fn limits(run: &Run) -> String {
    let names = run.steps.text("limit");
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for name in names.iter().filter(|name| !name.is_empty()) {
        match counts.iter_mut().find(|(known, _)| known == name) {
            Some((_, count)) => *count += 1,
            None => counts.push((name, 1)),
        }
    }
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let total: usize = counts.iter().map(|(_, count)| count).sum();
    let say = |(name, count): &(&str, usize)| format!("{name} {:.0} %", 100.0 * *count as f64 / total as f64);
    if counts.is_empty() { "not known".into() } else { counts.iter().map(say).collect::<Vec<_>>().join(", ") }
}

fn outcome_text(run: &Run) -> String {
    let end = quantity(run.end_time(), "s");
    match &run.outcome {
        Outcome::Finished if run.completed() => format!("finished at t = {end}"),
        Outcome::Finished => format!("stopped early at t = {end}"),
        Outcome::Failed(_) => format!("failed at t = {end}"),
        Outcome::Unfinished => format!("not finished: stopped, or still running, at t = {end}"),
    }
}

/// The error of a failed run, with field, particle and step where known.
fn error_text(run: &Run) -> Option<String> {
    let Outcome::Failed(failure) = &run.outcome else { return None };
    let mut text = if failure.error.is_empty() { "the error was not recorded".to_owned() } else { failure.error.clone() };
    let mut place = Vec::new();
    place.extend(failure.field.as_ref().map(|field| format!("field {field}")));
    place.extend(failure.particle.map(|particle| format!("particle {particle}")));
    place.extend(failure.time.map(|time| format!("t = {} s", number(time))));
    place.extend(failure.step.map(|step| format!("step {step}")));
    if !place.is_empty() {
        text.push_str(&format!(" ({})", place.join(", ")));
    }
    Some(text)
}

/// A name that is safe in file names and links.
fn file_name(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c.to_ascii_lowercase() } else { '-' }).collect()
}

/// The address of `target` seen from the folder `from`; `None` if either does not exist.
fn relative(from: &Path, target: &Path) -> Option<String> {
    let (from, target) = (fs::canonicalize(from).ok()?, fs::canonicalize(target).ok()?);
    let (from, target): (Vec<Component>, Vec<Component>) = (from.components().collect(), target.components().collect());
    let shared = from.iter().zip(&target).take_while(|(a, b)| a == b).count();
    if shared == 0 {
        return None;
    }
    let ups = std::iter::repeat_n("..".to_owned(), from.len() - shared);
    let downs = target[shared..].iter().map(|part| percent_encode(&part.as_os_str().to_string_lossy()));
    Some(ups.chain(downs).collect::<Vec<_>>().join("/")).map(|path| if path.is_empty() { ".".into() } else { path })
}

fn percent_encode(text: &str) -> String {
    let safe = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    text.bytes().map(|b| if safe(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

/// A published curve as the `n`-th reference of a plot whose axes are time in s times `per_time` and the value in SI units times
/// `per_value`, with the band of its spread; none if its own scales are not usable.
fn reference_series(reference: &Reference, n: usize, per_time: f64, per_value: f64) -> Option<Series> {
    let (time, value) = reference.scaling()?;
    let points: Vec<[f64; 2]> = reference.points.iter().map(|p| [p[0] / time * per_time, p[1] / value * per_value]).collect();
    let around = |(&[t, z], spread): (&[f64; 2], &f64)| [t, z - spread / value * per_value, z + spread / value * per_value];
    let band: Vec<[f64; 3]> = points.iter().zip(&reference.spread).map(around).collect();
    let name = if band.is_empty() { reference.name.clone() } else { format!("{}, with its spread", reference.name) };
    Some(Series { band, ..Series::reference(name, n, points) })
}
