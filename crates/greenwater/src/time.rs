//! Time: what limits the step, and where the seconds of a run go.

use std::time::Instant;

/// A time step and what bounds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepLimit {
    /// Time step, s.
    pub dt: f64,
    /// What bounds it, in a word or two.
    pub name: &'static str,
}

impl StepLimit {
    /// A limit of `dt` seconds called `name`.
    pub fn new(dt: f64, name: &'static str) -> Self {
        Self { dt, name }
    }

    /// The limit behind a step of `before` seconds: from step to step a fifth more or half at most, since pressure of an incompressible
    /// fluid goes as one over the step. Where nothing bounds it, the step before again, or `first` seconds.
    pub fn after(self, before: Option<f64>, first: f64) -> Self {
        match before {
            before if self.dt == f64::INFINITY => Self::new(before.unwrap_or(first), "rest"),
            Some(before) if self.dt > 1.2 * before => Self::new(1.2 * before, "growth"),
            Some(before) if self.dt < 0.5 * before => Self::new(0.5 * before, "shrinkage"),
            _ => self,
        }
    }

    /// The stricter of two limits.
    pub fn min(self, other: Self) -> Self {
        if other.dt < self.dt { other } else { self }
    }
}

/// Seconds spent in each named phase of the steps, in the order the phases first ran.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Phases {
    seconds: Vec<(&'static str, f64)>,
}

impl Phases {
    /// Runs `work` and adds its wall-clock time to phase `name`.
    pub fn measure<T>(&mut self, name: &'static str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.add(name, start.elapsed().as_secs_f64());
        result
    }

    /// Adds `seconds` to phase `name`.
    pub fn add(&mut self, name: &'static str, seconds: f64) {
        match self.seconds.iter_mut().find(|(known, _)| *known == name) {
            Some((_, total)) => *total += seconds,
            None => self.seconds.push((name, seconds)),
        }
    }

    /// Name and seconds of each phase.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        self.seconds.iter().copied()
    }
}
