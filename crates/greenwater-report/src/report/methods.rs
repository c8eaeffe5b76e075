//! The parts of a report that tell the methods apart: what they do, what they cost, how the runs were made.

use std::path::Path;

use super::{Report, limits, relative};
use crate::measure::Measured;
use crate::page::{Block, Cells, Figure, Table};
use crate::plot::{Axis, Bar, LinePlot, PALETTE, Series, StackedBars};
use crate::run::{Run, Spread};
use crate::words::{number, quantity};

impl Report<'_> {
    pub(super) fn distinctions(&self) -> Vec<Block> {
        let mut aspects: Vec<&str> = Vec::new();
        for row in self.runs.iter().flat_map(|run| &run.provenance.distinctions) {
            if !aspects.contains(&row.aspect.as_str()) {
                aspects.push(&row.aspect);
            }
        }
        if aspects.is_empty() {
            return vec![Block::Notice("The runs do not say how their methods differ.".into())];
        }
        let rows = aspects.iter().map(|aspect| {
            let of = |run: &Run| {
                let row = run.provenance.distinctions.iter().find(|row| row.aspect == *aspect);
                row.map_or("\u{2013}".to_owned(), |row| row.value.clone())
            };
            std::iter::once((*aspect).to_owned()).chain(self.runs.iter().map(of)).collect()
        });
        vec![Block::Table(Table {
            caption: "What each method does.".into(),
            head: self.head("aspect"),
            rows: rows.collect(),
            cells: Cells::Words,
        })]
    }

    pub(super) fn cost(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        // Phases in order of their greatest share in any method: by seconds, those of the slowest method would leave the others little but "other".
        let mut phases: Vec<(&str, f64)> = Vec::new();
        for m in &self.numbers {
            let whole: f64 = m.phases.iter().map(|(_, seconds)| seconds).sum();
            for (name, seconds) in &m.phases {
                let share = seconds / whole;
                match phases.iter_mut().find(|(known, _)| known == name) {
                    Some((_, greatest)) => *greatest = greatest.max(share),
                    None => phases.push((name, share)),
                }
            }
        }
        phases.sort_by(|a, b| b.1.total_cmp(&a.1));
        let seconds_of = |m: &Measured, phase: &str| m.phases.iter().find(|(name, _)| name == phase).map(|(_, s)| *s);
        let rest_of = |m: &Measured| {
            let rest = m.wall_seconds? - m.phases.iter().map(|(_, s)| s).sum::<f64>();
            (rest > 0.0).then_some(rest)
        };
        if phases.is_empty() {
            blocks.push(Block::Notice("No run stored its cost by phase in summary.json.".into()));
        } else {
            let shown = if phases.len() >= PALETTE.len() { PALETTE.len() - 1 } else { phases.len() };
            let bars = self.numbers.iter().map(|m| {
                let mut parts: Vec<(String, f64)> =
                    phases[..shown].iter().map(|(name, _)| ((*name).to_owned(), seconds_of(m, name).unwrap_or(0.0))).collect();
                let minor: f64 = phases[shown..].iter().filter_map(|(name, _)| seconds_of(m, name)).sum();
                parts.push(("other".into(), minor + rest_of(m).unwrap_or(0.0)));
                Bar { name: m.name.clone(), parts }
            });
            let chart =
                StackedBars { title: "Computing time by phase".into(), x_label: "wall-clock time [s]".into(), bars: bars.collect() };
            blocks.push(Block::Figure(Figure {
                name: "cost".into(),
                svg: chart.svg(),
                caption: "Where the time goes. The number at the end of a bar is its sum in seconds; other: phases that are small in every method, and time outside any phase, output included.".into(),
            }));
        }
        let cell = |m: &Measured, seconds: Option<f64>| {
            let Some(seconds) = seconds else { return "\u{2013}".to_owned() };
            let share = m.wall_seconds.filter(|w| *w > 0.0).map_or(String::new(), |w| format!(" \u{b7} {:.1} %", 100.0 * seconds / w));
            let each = m.per_particle_step(seconds).map_or(String::new(), |us| format!(" \u{b7} {} \u{b5}s", number(us)));
            format!("{} s{share}{each}", number(seconds))
        };
        let mut rows: Vec<Vec<String>> = phases.iter().map(|(phase, _)| self.row(phase, |m| cell(m, seconds_of(m, phase)))).collect();
        if !phases.is_empty() {
            rows.push(self.row("not in a phase", |m| cell(m, rest_of(m))));
        }
        rows.push(self.row("whole run", |m| cell(m, m.wall_seconds)));
        blocks.push(Block::Table(Table {
            caption: "Seconds, share of the wall-clock time, and microseconds per particle and step (fluid and wall particles counted)."
                .into(),
            head: self.head("phase"),
            rows,
            cells: Cells::Numbers,
        }));
        let spread = |s: Spread, unit: &str| {
            let parts = [s.min, s.median, s.max].map(|v| v.map_or("\u{2013}".to_owned(), number));
            format!("{} / {} / {} {unit}", parts[0], parts[1], parts[2]).trim_end().to_owned()
        };
        let cheapest = self.numbers.iter().filter_map(Measured::seconds_per_step).fold(f64::INFINITY, f64::min);
        let mut rows = vec![
            self.row("steps", |m| m.steps.map_or("not known".into(), |n| n.to_string())),
            self.row("time step: least / median / greatest", |m| spread(m.dt, "s")),
            self.row("solver iterations a step: least / median / greatest", |m| match m.iterations {
                Some(iterations) => spread(iterations, ""),
                None if m.steps.is_some() => "no solver".into(),
                None => "not known".into(),
            }),
            self.row("cost of a step", |m| quantity(m.seconds_per_step().map(|s| 1e3 * s), "ms")),
            self.row("cost of a step over the cheapest method", |m| quantity(m.seconds_per_step().map(|s| s / cheapest), "")),
        ];
        rows.push(
            std::iter::once("what bounded the step, share of the logged steps".to_owned()).chain(self.runs.iter().map(limits)).collect(),
        );
        blocks.push(Block::Table(Table { caption: "Steps.".into(), head: self.head("steps"), rows, cells: Cells::Numbers }));
        let mut dt = LinePlot::new("Time step", "time [s]", "time step [s]");
        let mut iterations = LinePlot::new("Solver iterations", "time [s]", "iterations a step [1]");
        dt.y = Axis::log(dt.y.label);
        (dt.size, iterations.size) = ([640.0, 420.0], [640.0, 420.0]);
        for (i, run) in self.runs.iter().enumerate() {
            dt.series.push(Series::line(&self.numbers[i].name, i, run.steps.against_time("dt")));
            if run.steps.numbers("iterations").iter().any(|n| *n > 0.0) {
                iterations.series.push(Series::line(&self.numbers[i].name, i, run.steps.against_time("iterations")));
            }
        }
        let wanted = [
            ("time-step", dt, "Time step of each method over the run; logarithmic axis."),
            ("iterations", iterations, "Iterations of the pressure solver a step; methods without a solver are not shown."),
        ];
        let figures: Vec<Figure> = wanted
            .into_iter()
            .filter(|(_, plot, _)| !plot.is_empty())
            .map(|(name, plot, caption)| Figure { name: name.into(), svg: plot.svg(), caption: caption.into() })
            .collect();
        if !figures.is_empty() {
            blocks.push(Block::Figures(figures));
        }
        blocks
    }

    pub(super) fn check_table(&self) -> Vec<Block> {
        let rows = self.checks().into_iter().map(|c| {
            let band = if c.low == c.high { number(c.low) } else { format!("{} to {}", number(c.low), number(c.high)) };
            let verdict = if c.pass() { "pass" } else { "FAIL" };
            let unit = if c.unit == "1" { "" } else { c.unit };
            vec![c.what.clone(), c.method.clone(), quantity(Some((c.value * 100.0).round() / 100.0), unit), band, verdict.to_owned()]
        });
        vec![Block::Table(Table {
            caption: "Each measured value against its accepted range; the same list stands in report.json.".into(),
            head: ["check", "method", "value", "accepted", "verdict"].map(str::to_owned).into(),
            rows: rows.collect(),
            cells: Cells::Words,
        })]
    }

    pub(super) fn making(&self, out: &Path) -> Vec<Block> {
        let mut blocks = Vec::new();
        let row = |name: &str, of: &dyn Fn(&Run) -> String| -> Vec<String> {
            let cell = |run: &Run| Some(of(run)).filter(|text| !text.trim().is_empty()).unwrap_or("not known".into());
            std::iter::once(name.to_owned()).chain(self.runs.iter().map(cell)).collect()
        };
        let rows = vec![
            row("program", &|run| format!("{} {}", run.provenance.program, run.provenance.version)),
            row("started", &|run| run.provenance.started.clone()),
            row("machine", &|run| {
                let m = &run.provenance.machine;
                let cores = m.cores.map_or(String::new(), |n| format!("{n} cores"));
                [m.cpu.clone(), cores, m.os.clone(), m.arch.clone()].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join(", ")
            }),
            row("kernel", &|run| {
                let k = &run.provenance.kernel;
                format!("{}, h = {} ({} spacings)", k.name, quantity(k.smoothing_length_m, "m"), quantity(k.h_over_spacing, ""))
            }),
            row("spacing", &|run| quantity(run.provenance.scales.spacing, "m")),
            row("fluid at the start", &|run| {
                let s = &run.provenance.scales;
                format!("{} wide, {} high", quantity(s.width, "m"), quantity(s.height, "m"))
            }),
            row("\u{3c1}gH", &|run| quantity(run.provenance.scales.pressure(), "Pa")),
            row("time step rule", &|run| run.provenance.time_step_rule.clone()),
        ];
        blocks.push(Block::Table(Table {
            caption: "Where the numbers come from.".into(),
            head: self.head("provenance"),
            rows,
            cells: Cells::Words,
        }));
        let mut commands: Vec<String> = self.runs.iter().map(|run| run.provenance.command.join(" ")).filter(|c| !c.is_empty()).collect();
        commands.dedup();
        if !commands.is_empty() {
            blocks.push(Block::Text("Command:".into()));
            blocks.push(Block::Code(commands.join("\n")));
        }
        blocks.push(Block::Text("Files behind this page:".into()));
        let files = [
            "case.toml",
            "case.resolved.toml",
            "provenance.json",
            "summary.json",
            "frames/frames.pvd",
            "energy.csv",
            "front.csv",
            "probes.csv",
            "gauges.csv",
            "loads.csv",
            "quality.csv",
            "steps.csv",
            "FAILED.json",
        ];
        let mut links = vec![("report.json".to_owned(), "report.json".to_owned())];
        for (run, m) in self.runs.iter().zip(&self.numbers) {
            if let Some(base) = relative(out, &run.dir) {
                let present = files.iter().filter(|file| run.dir.join(file).exists());
                links.extend(present.map(|file| (format!("{}/{file}", m.name), format!("{base}/{file}"))));
            }
        }
        blocks.push(Block::Links(links));
        blocks
    }
}
