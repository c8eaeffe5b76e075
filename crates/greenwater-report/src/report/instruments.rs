//! The parts of a report that show what instruments recorded.

use serde_json::{Value, json};

use super::{Report, file_name, reference_series};
use crate::measure::{Impact, Measured};
use crate::page::{Block, Cells, Figure, Table};
use crate::plot::{LinePlot, RightAxis, Series};
use crate::words::{join, number, quantity};

/// How the numbers of an impact are made.
const IMPACT_WORDS: &str = "Peak: the highest single sample; it depends on the time step of an incompressible method. Peak of means: the highest mean over \
     0.05 \u{221a}(H/g), which does not. Rise time: from a tenth to nine tenths of the peak. Impulse: the integral over the run. Quasi-static \
     mean: from 1.1 to 1.9 \u{221a}(H/g) after a tenth of the peak is first reached. Mean over time: over the whole run (trapezoidal rule).";

/// The numbers of an impact for `report.json`.
pub(super) fn impact_json(impact: &Impact) -> Value {
    json!({
        "peak": impact.peak.value, "peak_time": impact.peak.time, "mean_peak": impact.mean_peak.map(|peak| peak.value),
        "rise_time": impact.rise_time, "arrival": impact.arrival, "impulse": impact.impulse, "quasi_static": impact.quasi_static,
    })
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
            let place = position
                .filter(|p| !p.position.is_empty())
                .map_or(String::new(), |p| format!(" at ({}) m", p.position.iter().map(|x| number(*x)).collect::<Vec<_>>().join(", ")));
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
                "Raw pressure at {name}, neither smoothed nor thinned. The height of single spikes is noise as much as impact: compare the means, too."
            );
            figures.push(Figure { name: format!("probe-{}-{}", i + 1, file_name(name)), svg: plot.svg(), caption });
        }
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
            rows.push(self.row(&format!("{name}: peak"), |m| at(m, &|p| share(p.peak.value, m))));
            rows.push(self.row(&format!("{name}: time of the peak"), |m| at(m, &|p| quantity(Some(p.peak.time), "s"))));
            rows.push(self.row(&format!("{name}: peak of means"), |m| {
                at(m, &|p| p.impact.mean_peak.map_or("no data".to_owned(), |peak| share(peak.value, m)))
            }));
            rows.push(self.row(&format!("{name}: rise time"), |m| at(m, &|p| quantity(p.impact.rise_time, "s"))));
            rows.push(self.row(&format!("{name}: impulse"), |m| at(m, &|p| quantity(Some(p.impact.impulse), "Pa s"))));
            rows.push(self.row(&format!("{name}: quasi-static mean"), |m| {
                at(m, &|p| p.impact.quasi_static.map_or("no data".to_owned(), |mean| share(mean, m)))
            }));
            rows.push(self.row(&format!("{name}: mean over time"), |m| at(m, &|p| share(p.mean, m))));
        }
        blocks.push(Block::Table(Table { caption: IMPACT_WORDS.into(), head: self.head("probe"), rows, cells: Cells::Numbers }));
        blocks
    }

    pub(super) fn loads_and_gauges(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut figures = Vec::new();
        for (kind, tables) in [
            ("load", self.runs.iter().map(|run| &run.loads).collect::<Vec<_>>()),
            ("gauge", self.runs.iter().map(|run| &run.gauges).collect()),
        ] {
            let mut names: Vec<&str> = Vec::new();
            for name in tables.iter().flat_map(|table| table.names()).filter(|name| *name != "time") {
                if !names.contains(&name) {
                    names.push(name);
                }
            }
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
                    let caption = format!("The {kind} {name} as recorded.");
                    figures.push(Figure { name: format!("{kind}-{}", file_name(name)), svg: plot.svg(), caption });
                }
            }
        }
        if figures.is_empty() {
            return vec![Block::Notice("The case asks for no loads and no gauges.".into())];
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
            let at = |m: &Measured, say: &dyn Fn(&Impact) -> String| {
                m.loads.iter().find(|l| l.name == name).map_or("no data".to_owned(), |l| say(&l.impact))
            };
            rows.push(self.row(&format!("{name}: peak"), |m| at(m, &|i| quantity(Some(i.peak.value), unit))));
            rows.push(self.row(&format!("{name}: peak of means"), |m| at(m, &|i| quantity(i.mean_peak.map(|p| p.value), unit))));
            rows.push(self.row(&format!("{name}: rise time"), |m| at(m, &|i| quantity(i.rise_time, "s"))));
            rows.push(self.row(&format!("{name}: impulse"), |m| at(m, &|i| quantity(Some(i.impulse), &format!("{unit} s")))));
            rows.push(self.row(&format!("{name}: quasi-static mean"), |m| at(m, &|i| quantity(i.quasi_static, unit))));
        }
        if !rows.is_empty() {
            blocks.push(Block::Table(Table { caption: IMPACT_WORDS.into(), head: self.head("load"), rows, cells: Cells::Numbers }));
        }
        blocks
    }
}
