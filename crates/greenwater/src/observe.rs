//! What is looked at while a run goes on.

use std::io;

use crate::particles::Particles;
use crate::scheme::StepReport;
use crate::time::{Phases, StepLimit};

/// A state of the run, as observers see it.
#[derive(Clone, Copy)]
pub struct View<'a, const D: usize> {
    /// All particles; columns belong to [`time`](Self::time).
    pub particles: &'a Particles<D>,
    /// Steps made so far; 0 at the start.
    pub step: u64,
    /// Time of the flow, s.
    pub time: f64,
    /// The step that led here and what bounded it; absent at the start.
    pub limit: Option<StepLimit>,
    /// What the step did.
    pub report: StepReport,
    /// Where the time went so far.
    pub phases: &'a Phases,
    /// Wall-clock time since the start, s.
    pub elapsed: f64,
}

/// Looks at a run without changing it: writes frames, samples probes, adds up energies.
pub trait Observer<const D: usize> {
    /// Called at the start and after every step.
    ///
    /// # Errors
    /// A file could not be written.
    fn observe(&mut self, view: &View<D>) -> io::Result<()>;

    /// Called once when the run has ended, well or badly, with the last good state.
    ///
    /// # Errors
    /// A file could not be written.
    fn finish(&mut self, view: &View<D>) -> io::Result<()>;
}
