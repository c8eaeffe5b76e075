//! The parts of a report that show what instruments recorded.

use serde_json::{Value, json};

use super::{Report, file_name, reference_series};
use crate::measure::{Impact, Measured};
use crate::page::{Block, Cells, Figure, Table};
use crate::plot::{LinePlot, RightAxis, Series};
use crate::run::{Probe, Reference};
use crate::words::{join, number, quantity};

/// How the numbers of an impact are made.
const IMPACT_WORDS: &str = "Peak: the greatest row in size; it depends on the time step of an incompressible method. Peak of means: the greatest mean over \
     0.05 \u{221a}(H/g), which does not. Arrival: the first rise through a tenth of the peak of means. Rise time: from a tenth to nine tenths of \
     it. Impulse: the integral over the run, exact for loads, by the trapezoidal rule for pressures. Quasi-static mean: from 1.1 to \
     1.9 \u{221a}(H/g) after the arrival. What stands from the start (a tenth of the peak of means, or more, over the first \
     0.05 \u{221a}(H/g)) has no arrival and no rise time; where that is so with one method, the mean is from 1.1 to 1.9 \u{221a}(H/g) after the start \
     of the run with all.";

/// The numbers of an impact for `report.json`.
pub(super) fn impact_json(impact: &Impact) -> Value {
    json!({
        "peak": impact.peak.value, "peak_time": impact.peak.time, "mean_peak": impact.mean_peak.map(|peak| peak.value),
        "rise_time": impact.rise_time, "arrival": impact.arrival, "impulse": impact.impulse, "quasi_static": impact.quasi_static,
        "from_start": impact.from_start,
    })
}

/// Cuts a plot to the series that others drown; says so, with a space ahead.
fn cut_to_quieter(plot: &mut LinePlot, unit: &str) -> String {
    let said = |(name, [low, high]): (String, [f64; 2])| {
        format!(" The picture is cut: {name} goes from {} to {} {unit}.", number(low), number(high))
    };
    plot.cut_to_quieter().into_iter().map(said).collect()
}

impl Report<'_> {
    pub(super) fn pressures(&self) -> Vec<Block> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.runs.iter().flat_map(|run| run.probes.names()).filter(|name| *name != "time") {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let mut blocks = Vec::new();
        let (mut figures, mut silent) = (Vec::new(), Vec::new());
        for (i, name) in names.iter().enumerate() {
            let position = self.runs.iter().flat_map(|run| &run.provenance.probes).find(|probe| probe.name == *name);
            let place = |p: &Probe| {
                let along = p.on.as_ref().map_or(String::new(), |wall| format!(", on {wall}"));
                format!(" at ({}) m{along}", p.position.iter().map(|x| number(*x)).collect::<Vec<_>>().join(", "))
            };
            let place = position.filter(|p| !p.position.is_empty()).map_or(String::new(), place);
            let mut plot = LinePlot::new(format!("Pressure at {name}{place}"), "time [s]", "pressure [Pa]");
            plot.size = if names.len() == 1 { [1100.0, 440.0] } else { [640.0, 420.0] };
            plot.right = self.pressure_scale().map(|scale| RightAxis { label: "fraction of \u{3c1}gH".into(), factor: 1.0 / scale });
            for (k, run) in self.runs.iter().enumerate() {
                plot.series.push(Series::line(&self.numbers[k].name, k, run.probes.against_time(name)));
            }
            for (k, reference) in self.references(&format!("probe:{name}")).iter().enumerate() {
                plot.series.extend(reference_series(reference, k, 1.0, 1.0));
            }
            if plot.is_empty() {
                silent.push((*name).to_owned());
                continue;
            }
            let caption = format!(
                "Raw pressure at {name}, neither smoothed nor thinned. The height of single spikes is noise as much as impact: compare the means, too.{}",
                cut_to_quieter(&mut plot, "Pa")
            );
            figures.push(Figure { name: format!("probe-{}-{}", i + 1, file_name(name)), svg: plot.svg(), caption });
        }
        blocks.extend(self.not_drawn("probe", "probes.csv", &names));
        if !silent.is_empty() {
            blocks.push(Block::Notice(format!("No finite pressure was stored for {}.", join(&silent))));
        }
        if figures.is_empty() {
            blocks.push(Block::Notice("No run stored wall pressures in probes.csv.".into()));
            return blocks;
        }
        blocks.push(Block::Figures(figures));
        let share = |pressure: f64, m: &Measured| match m.pressure_scale {
            Some(scale) => format!("{} Pa ({} \u{3c1}gH)", number(pressure), number(pressure / scale)),
            None => format!("{} Pa", number(pressure)),
        };
        let mut rows = Vec::new();
        for name in &names {
            let at = |m: &Measured, say: &dyn Fn(&crate::measure::ProbeNumbers) -> String| {
                m.probes.iter().find(|p| p.name == *name).map_or("no data".to_owned(), say)
            };
            let impact = |m: &Measured| m.probes.iter().find(|p| p.name == *name).map(|p| p.impact);
            rows.extend(self.impact_rows(name, impact, share, "Pa s"));
            rows.push(self.row(&format!("{name}: mean over time"), |m| at(m, &|p| share(p.mean, m))));
        }
        let caption = format!("{IMPACT_WORDS} Mean over time: over the whole run (trapezoidal rule).");
        blocks.push(Block::Table(Table { caption, head: self.head("probe"), rows, cells: Cells::Numbers }));
        blocks
    }

    pub(super) fn loads_and_gauges(&self) -> Vec<Block> {
        let mut figures = Vec::new();
        let mut blocks = Vec::new();
        for (kind, file, tables) in [
            ("load", "loads.csv", self.runs.iter().map(|run| &run.loads).collect::<Vec<_>>()),
            ("gauge", "gauges.csv", self.runs.iter().map(|run| &run.gauges).collect()),
        ] {
            let mut names: Vec<&str> = Vec::new();
            for name in tables.iter().flat_map(|table| table.names()).filter(|name| *name != "time") {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
            blocks.extend(self.not_drawn(kind, file, &names));
            for name in names {
                let unit = tables.iter().map(|table| table.unit(name)).find(|unit| !unit.is_empty()).unwrap_or_default();
                let mut plot = LinePlot::new(format!("{kind} {name}"), "time [s]", format!("{name} [{unit}]"));
                for (k, table) in tables.iter().enumerate() {
                    plot.series.push(Series::line(&self.numbers[k].name, k, table.against_time(name)));
                }
                for (k, reference) in self.references(&format!("{kind}:{name}")).iter().enumerate() {
                    plot.series.extend(reference_series(reference, k, 1.0, 1.0));
                }
                if !plot.is_empty() {
                    let caption = format!("The {kind} {name} as recorded.{}", cut_to_quieter(&mut plot, unit));
                    figures.push(Figure { name: format!("{kind}-{}", file_name(name)), svg: plot.svg(), caption });
                }
            }
        }
        if figures.is_empty() {
            blocks.push(Block::Notice("The case asks for no loads and no gauges.".into()));
            return blocks;
        }
        blocks.push(Block::Figures(figures));
        let mut names: Vec<(&str, &str)> = Vec::new();
        for load in self.numbers.iter().flat_map(|m| &m.loads) {
            if !names.iter().any(|(name, _)| *name == load.name) {
                names.push((&load.name, &load.unit));
            }
        }
        let mut rows = Vec::new();
        for (name, unit) in names {
            let impact = |m: &Measured| m.loads.iter().find(|l| l.name == name).map(|l| l.impact);
            rows.extend(self.impact_rows(name, impact, |value, _| quantity(Some(value), unit), &format!("{unit} s")));
        }
        if !rows.is_empty() {
            blocks.push(Block::Table(Table { caption: IMPACT_WORDS.into(), head: self.head("load"), rows, cells: Cells::Numbers }));
        }
        blocks
    }

    /// The references of a kind for which no run has a column, `there` being the columns of `file`.
    fn not_drawn(&self, kind: &str, file: &str, there: &[&str]) -> Vec<Block> {
        let of_kind = self.references.iter().filter_map(|r| Some((r, r.quantity.strip_prefix(kind)?.strip_prefix(':')?)));
        let lacking = of_kind.filter(|(_, name)| !there.contains(name));
        let say = |(reference, name): (&Reference, &str)| {
            let columns: Vec<String> = there.iter().map(|name| format!("`{name}`")).collect();
            let has = if columns.is_empty() { "which no run has".to_owned() } else { format!("which has {}", join(&columns)) };
            Block::Notice(format!(
                "The reference {} is not drawn: its quantity is `{}`, and there is no column `{name}` in {file}, {has}.",
                reference.name, reference.quantity
            ))
        };
        lacking.map(say).collect()
    }

    /// The rows of one instrument: its impact with each method, values said by `say`, impulses in `unit`.
    fn impact_rows(
        &self,
        name: &str,
        of: impl Fn(&Measured) -> Option<Impact>,
        say: impl Fn(f64, &Measured) -> String,
        unit: &str,
    ) -> Vec<Vec<String>> {
        let row = |what: &str, cell: &dyn Fn(&Impact, &Measured) -> String| {
            self.row(&format!("{name}: {what}"), |m| of(m).map_or("no data".to_owned(), |impact| cell(&impact, m)))
        };
        let none = || "\u{2013}".to_owned();
        let stands = self.numbers.iter().filter_map(&of).any(|impact| impact.stands_from_the_start());
        let mean = if stands { "mean from the start" } else { "quasi-static mean" };
        vec![
            row("peak", &|i, m| say(i.peak.value, m)),
            row("time of the peak", &|i, _| quantity(Some(i.peak.time), "s")),
            row("peak of means", &|i, m| i.mean_peak.map_or_else(none, |peak| say(peak.value, m))),
            row("arrival", &|i, _| match i.arrival {
                Some(time) => quantity(Some(time), "s"),
                None if i.stands_from_the_start() => "stands from the start".to_owned(),
                None => none(),
            }),
            row("rise time", &|i, _| i.rise_time.map_or_else(none, |time| quantity(Some(time), "s"))),
            row("impulse", &|i, _| quantity(Some(i.impulse), unit)),
            row(mean, &|i, m| if stands { i.from_start } else { i.quasi_static }.map_or_else(none, |mean| say(mean, m))),
        ]
    }
}
