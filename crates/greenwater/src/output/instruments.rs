//! Tables of the instruments: `probes.csv`, `gauges.csv`, `loads.csv`.

use std::io;

use super::folder::OutputError;
use super::tables::Table;
use crate::case::Setup;
use crate::observe::{LoadMean, View, gauge_unit};
use crate::scheme::Medium;

/// The tables that the case asks for.
pub(super) struct Instruments<const D: usize> {
    probes: Option<Table>,
    gauges: Option<Table>,
    loads: Option<Table>,
    means: Vec<LoadMean<D>>,
    next: f64,
    written: Option<u64>,
}

impl<const D: usize> Instruments<D> {
    /// Starts the tables with `table(name, header)`; those without columns are not made.
    pub fn create(setup: &Setup<D>, table: impl Fn(&str, &str) -> Result<Table, OutputError>) -> Result<Self, OutputError> {
        let make = |name: &str, columns: Vec<String>| {
            if columns.is_empty() { Ok(None) } else { table(name, &format!("time [s],{}", columns.join(","))).map(Some) }
        };
        Ok(Self {
            probes: make("probes.csv", setup.probes.iter().map(|probe| format!("{} [Pa]", probe.name)).collect())?,
            gauges: make("gauges.csv", setup.gauges.iter().map(|gauge| format!("{} [{}]", gauge.name, gauge_unit(&gauge.kind))).collect())?,
            loads: make("loads.csv", setup.loads.iter().flat_map(|load| load.columns()).collect())?,
            means: vec![LoadMean::default(); setup.loads.len()],
            next: 0.0,
            written: None,
        })
    }

    /// Takes part in every step; writes a row when one is due.
    pub fn observe(&mut self, setup: &Setup<D>, medium: &Medium<D>, view: &View<D>) -> io::Result<()> {
        for (load, mean) in setup.loads.iter().zip(&mut self.means) {
            mean.add(load.wrench(view.particles), view.limit.map_or(0.0, |limit| limit.dt));
        }
        if view.time >= self.next { self.write(setup, medium, view) } else { Ok(()) }
    }

    /// Writes the last state, if it is not there yet.
    pub fn finish(&mut self, setup: &Setup<D>, medium: &Medium<D>, view: &View<D>) -> io::Result<()> {
        if self.written == Some(view.step) { Ok(()) } else { self.write(setup, medium, view) }
    }

    /// Puts everything on disk.
    pub fn flush(&mut self) -> io::Result<()> {
        [&mut self.probes, &mut self.gauges, &mut self.loads].into_iter().flatten().try_for_each(Table::flush)
    }

    fn write(&mut self, setup: &Setup<D>, medium: &Medium<D>, view: &View<D>) -> io::Result<()> {
        let row = |values: Vec<f64>| std::iter::once(view.time).chain(values);
        if let Some(table) = &mut self.probes {
            table.numbers(row(setup.probes.iter().map(|probe| probe.pressure(view.particles, medium)).collect()))?;
        }
        if let Some(table) = &mut self.gauges {
            table.numbers(row(setup.gauges.iter().map(|gauge| gauge.value(view.particles, medium)).collect()))?;
        }
        if let Some(table) = &mut self.loads {
            table.numbers(row(self.means.iter_mut().flat_map(LoadMean::take).collect()))?;
        }
        let interval = setup.output.sensor_interval;
        if interval > 0.0 {
            self.next = interval * ((view.time / interval).floor() + 1.0);
        }
        self.written = Some(view.step);
        Ok(())
    }
}
