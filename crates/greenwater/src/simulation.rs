//! Step, observe, stop: the driver of a run.

use std::io;
use std::time::Instant;

use thiserror::Error;

use crate::domain::Domain;
use crate::math::Vector;
use crate::motion::{self, Motion};
use crate::observe::{Observer, View};
use crate::particles::{Kind, Particles};
use crate::scheme::{Medium, Scheme, StepError, StepReport};
use crate::sweep::largest;
use crate::time::{Phases, StepLimit};

/// Steps in which a run reaches its end at the least.
pub(crate) const FEWEST_STEPS: f64 = 20.0;

/// Why a run ended early.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// A step failed: the method is unstable here, or its pressure equation could not be solved.
    #[error("t = {time:.6} s, step {step}: {source}")]
    Step {
        /// What failed.
        source: StepError,
        /// Time at the start of the step, s.
        time: f64,
        /// Number of the step, counted from 1.
        step: u64,
    },
    /// An observer asked for the end: its error was [`io::ErrorKind::Interrupted`].
    #[error("stopped at t = {time:.6} s (step {step})")]
    Interrupted {
        /// Time reached, s.
        time: f64,
        /// Steps made.
        step: u64,
    },
    /// A file of the run could not be written.
    #[error("cannot write the run: {0}")]
    Output(#[from] io::Error),
}

impl RunError {
    /// Exit code of a program that ends with this error: 4 for an instability, 5 for output, 130 when stopped.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Step { .. } => 4,
            Self::Interrupted { .. } => 130,
            Self::Output(_) => 5,
        }
    }
}

/// When a run stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// Time to reach, s; the last step may pass it, steps are never cut short.
    pub end: f64,
    /// Largest number of steps; `None`: as many as it takes.
    pub steps: Option<u64>,
}

/// A flow under way: particles, the box they live in, the method that moves them, and the clock.
pub struct Simulation<const D: usize> {
    particles: Particles<D>,
    domain: Domain<D>,
    scheme: Box<dyn Scheme<D>>,
    fixed_step: Option<f64>,
    speed_limit: f64,
    motions: Vec<Motion<D>>,
    /// No step is longer, s.
    longest_step: f64,
    step: u64,
    time: f64,
    /// Time at the start of the last step, s.
    time_before: f64,
    phases: Phases,
    /// Copy of the last good state, given back when a step fails; empty where the method takes steps back by itself.
    last_good: Particles<D>,
    /// Velocity and acceleration of the moving walls in the last good state.
    walls: Vec<(Vector<D>, Vector<D>)>,
}

/// The state that observers see, but for its particles.
#[derive(Clone, Copy)]
struct Shown {
    step: u64,
    time: f64,
    limit: Option<StepLimit>,
    report: StepReport,
    /// When the run began.
    clock: Instant,
}

impl<const D: usize> Simulation<D> {
    /// Puts a run together. `fixed_step` (s) replaces the stability limit of the method.
    pub fn new(
        particles: Particles<D>,
        domain: Domain<D>,
        scheme: Box<dyn Scheme<D>>,
        medium: &Medium<D>,
        fixed_step: Option<f64>,
    ) -> Self {
        let initial_speed = particles.v.iter().map(|v| v.norm()).fold(medium.speed, f64::max);
        let fall = (2.0 * medium.g() * (domain.max - domain.min).norm().max(medium.depth)).sqrt();
        Self {
            last_good: Particles::new(),
            walls: Vec::new(),
            particles,
            domain,
            scheme,
            fixed_step,
            // Ten times what falling through the whole domain gives: jets reach two or three times that, no more.
            speed_limit: if fall + initial_speed > 0.0 { 10.0 * (fall + initial_speed) } else { f64::INFINITY },
            motions: Vec::new(),
            longest_step: f64::INFINITY,
            step: 0,
            time: 0.0,
            time_before: 0.0,
            phases: Phases::default(),
        }
    }

    /// The same run with walls that move.
    pub fn with_motions(mut self, motions: Vec<Motion<D>>) -> Self {
        self.scheme.walls_that_go(motions.iter().filter(|motion| motion.moves).map(|motion| motion.body).collect());
        self.motions = motions;
        self
    }

    /// The particles now.
    pub fn particles(&self) -> &Particles<D> {
        &self.particles
    }

    /// Time of the flow, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Steps made so far.
    pub fn steps(&self) -> u64 {
        self.step
    }

    /// Where the seconds went.
    pub fn phases(&self) -> &Phases {
        &self.phases
    }

    /// Fills what the method derives from the initial state. Call once, before the first step.
    ///
    /// # Errors
    /// The initial state cannot be evaluated.
    pub fn start(&mut self) -> Result<(), RunError> {
        let Self { scheme, particles, domain, .. } = &mut *self;
        rayon::scope(|_| scheme.start(particles, domain)).map_err(|source| RunError::Step { source, time: 0.0, step: 0 })?;
        self.check().map_err(|source| RunError::Step { source, time: 0.0, step: 0 })
    }

    /// Makes one step.
    ///
    /// # Errors
    /// The step failed; particles are then those before it.
    pub fn advance(&mut self) -> Result<(StepLimit, StepReport), RunError> {
        self.scheme.renumber(&mut self.particles);
        motion::read(&self.motions, &self.particles, &mut self.walls);
        if !self.scheme.takes_back() {
            self.last_good.copy_from(&self.particles);
        }
        let limit = match self.fixed_step {
            Some(dt) => StepLimit::new(dt, "fixed"),
            None => self.stable_step(),
        };
        motion::set(&self.motions, &mut self.particles, self.time, limit.dt);
        let Self { scheme, particles, domain, phases, .. } = &mut *self;
        // Entering the pool once is cheaper than at every sweep of a step.
        let outcome = rayon::scope(|_| scheme.step(particles, domain, limit.dt, phases));
        motion::carry(&self.motions, &mut self.particles, limit.dt);
        match outcome.and_then(|report| self.check().map(|()| report)) {
            Ok(report) => {
                self.step += 1;
                self.time_before = self.time;
                self.time += limit.dt;
                Ok((limit, report))
            }
            Err(source) => {
                if self.scheme.takes_back() {
                    self.scheme.take_back(&mut self.particles, &self.domain);
                    motion::give_back(&self.motions, &mut self.particles, &self.walls);
                } else {
                    std::mem::swap(&mut self.particles, &mut self.last_good);
                }
                Err(RunError::Step { source, time: self.time, step: self.step + 1 })
            }
        }
    }

    /// The step that the method allows, and the walls that move.
    fn stable_step(&self) -> StepLimit {
        let limit = self.scheme.time_step(&self.particles).min(StepLimit::new(self.longest_step, "end"));
        if self.motions.is_empty() {
            return limit;
        }
        let dt = motion::within_reach(&self.motions, self.time, limit.dt, self.particles.h_min());
        limit.min(StepLimit::new(dt, "moving walls"))
    }

    /// Starts, steps until `stop` says so, and shows every state to the observers: as a step leaves it, or, where the method
    /// [looks back](Scheme::looks_back), once the step from it is made.
    ///
    /// # Errors
    /// A step failed, an observer asked for the end, or one could not write. But for the last, the observers have then finished
    /// with the last good state.
    pub fn run(&mut self, stop: Stop, observers: &mut [&mut dyn Observer<D>]) -> Result<(), RunError> {
        let looks_back = self.scheme.looks_back();
        let mut shown = Shown { step: 0, time: 0.0, limit: None, report: StepReport::default(), clock: Instant::now() };
        // Where nothing moves and nothing pushes, a method sees no reason to look at the fluid again.
        self.longest_step = stop.end / FEWEST_STEPS;
        // The step that led to the state at its end.
        let mut led = (None, StepReport::default());
        self.start()?;
        if !looks_back {
            self.show(observers, shown)?;
        }
        let outcome = loop {
            // A method that looks back has the first state to show behind the first step.
            let unseen = looks_back && self.step == 0;
            if !unseen && (shown.time >= stop.end || stop.steps.is_some_and(|most| shown.step >= most)) {
                break Ok(());
            }
            if looks_back && !unseen {
                self.scheme.look_ahead(&mut self.particles);
            }
            let made = match self.advance() {
                Ok((limit, report)) => (Some(limit), report),
                Err(error) => {
                    if unseen {
                        self.show(observers, shown)?;
                    }
                    (shown.step, shown.time, shown.limit, shown.report) = (self.step, self.time, led.0, led.1);
                    break Err(error);
                }
            };
            if looks_back {
                self.scheme.look_back(&mut self.particles);
                (shown.step, shown.time, shown.limit, shown.report) = (self.step - 1, self.time_before, led.0, led.1);
            } else {
                (shown.step, shown.time, shown.limit, shown.report) = (self.step, self.time, made.0, made.1);
            }
            led = made;
            match self.show(observers, shown) {
                Err(RunError::Output(error)) if error.kind() == io::ErrorKind::Interrupted => {
                    break Err(RunError::Interrupted { time: shown.time, step: shown.step });
                }
                seen => seen?,
            }
        };
        let view = self.view(shown);
        for observer in observers {
            observer.finish(&view)?;
        }
        if looks_back && shown.step < self.step {
            self.scheme.look_ahead(&mut self.particles);
        }
        outcome
    }

    fn show(&self, observers: &mut [&mut dyn Observer<D>], shown: Shown) -> Result<(), RunError> {
        let view = self.view(shown);
        for observer in observers {
            observer.observe(&view)?;
        }
        Ok(())
    }

    fn view(&self, shown: Shown) -> View<'_, D> {
        View {
            particles: &self.particles,
            step: shown.step,
            time: shown.time,
            limit: shown.limit,
            report: shown.report,
            phases: &self.phases,
            elapsed: shown.clock.elapsed().as_secs_f64(),
        }
    }

    /// Every field finite, no particle faster than the case can make it, and some fluid left.
    fn check(&self) -> Result<(), StepError> {
        let p = &self.particles;
        let worst = largest(p.owned(), |a| {
            let sum = p.x[a].norm_squared() + p.v[a].norm_squared() + p.density[a].abs() + p.pressure[a].abs();
            if sum.is_finite() { p.v[a].norm_squared() } else { f64::NAN }
        });
        if worst <= self.speed_limit * self.speed_limit || p.owned() == 0 {
            let empty = p.owned() > 0 && p.count(Kind::Fluid) == 0;
            return if empty { Err(StepError::Empty) } else { Ok(()) };
        }
        for a in (0..p.owned()).filter(|&a| p.kind[a] != Kind::Lost) {
            let particle = p.id[a];
            let fields: [(&'static str, bool); 4] = [
                ("position", p.x[a].is_finite()),
                ("velocity", p.v[a].is_finite()),
                ("density", p.density[a].is_finite()),
                ("pressure", p.pressure[a].is_finite()),
            ];
            if let Some((field, _)) = fields.into_iter().find(|(_, finite)| !finite) {
                return Err(StepError::NotFinite { field, particle });
            }
            let speed = p.v[a].norm();
            if speed > self.speed_limit {
                return Err(StepError::Runaway { particle, speed, limit: self.speed_limit });
            }
        }
        Ok(())
    }
}
