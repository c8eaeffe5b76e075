//! The methods: one file a published method, and the list of them.

pub mod acoustic;
mod adjoint;
mod before;
pub mod delta_sph;
pub mod dfsph;
pub mod edac;
pub mod iisph;
pub mod isph;
pub mod isph_paper;
pub mod linear;
mod list;
pub mod mps;
pub mod riemann;
mod settings;
pub mod wcsph;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::domain::Domain;
use crate::math::Vector;
use crate::neighbors::SearchError;
use crate::particles::Particles;
use crate::poisson::SolveError;
use crate::sweep::largest;
use crate::time::{Phases, StepLimit};

pub use acoustic::Acoustic;
pub use delta_sph::{DeltaSph, DeltaSphSettings};
pub use dfsph::{Dfsph, DfsphSettings};
pub use edac::EdacSettings;
pub use iisph::{Iisph, IisphSettings};
pub use isph::{Isph, IsphSettings, IsphShiftSettings};
pub use isph_paper::{IsphPaper, IsphPaperSettings};
pub use linear::{MlsphSettings, RkpmSettings};
pub use list::{MethodName, MethodSettings};
pub use mps::{Mps, MpsModernSettings, MpsSettings};
pub use riemann::RiemannSettings;
pub use settings::{BrokenRule, Distinction, Still};
pub use wcsph::{Wcsph, WcsphSettings};

/// A numerical method: advances particles by one time step.
///
/// The driver calls [`start`](Scheme::start) once, then for each step [`renumber`](Scheme::renumber), [`time_step`](Scheme::time_step) and
/// [`step`](Scheme::step) with a `dt` no larger than the limit.
pub trait Scheme<const D: usize>: Send {
    /// Fills the columns the method derives from the initial state (density, pressure, acceleration, surface ...).
    ///
    /// # Errors
    /// As [`step`](Scheme::step).
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError>;

    /// Tells which walls ([`Particles::body`]) go along with their velocity, for a method whose step looks at walls more than once: the driver
    /// moves them in the particles behind the step.
    fn walls_that_go(&mut self, _bodies: Vec<u16>) {}

    /// The largest stable time step from the present state, s, and what bounds it.
    fn time_step(&self, p: &Particles<D>) -> StepLimit;

    /// Renumbers particles where that pays: rows that lie near each other are read together. Comes between two steps; particles are told
    /// apart by [`Particles::id`].
    fn renumber(&mut self, _p: &mut Particles<D>) {}

    /// Advances the state by `dt`, s. Adds the time of each phase to `phases`.
    ///
    /// # Errors
    /// The pressure equation was not solved, or a value is no longer finite. The state is then part-way through the step.
    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError>;

    /// Whether observers look at the state from which a step started, once it is made: for a method whose pressure and forces of a step
    /// belong to that state, which has all of its fields only then.
    fn looks_back(&self) -> bool {
        false
    }

    /// Gives `p`, behind a step, the state from which it started, all fields at one time, until [`look_ahead`](Self::look_ahead).
    fn look_back(&mut self, _p: &mut Particles<D>) {}

    /// Gives `p` the state at the end of the step again.
    fn look_ahead(&mut self, _p: &mut Particles<D>) {}

    /// Whether the method can [take back](Self::take_back) a step. For one that cannot, the driver keeps a copy of all particles.
    fn takes_back(&self) -> bool {
        false
    }

    /// Gives `p` the state before the last [`step`](Self::step), made or failed, but for what the driver does to walls. Periodic positions may
    /// have been wrapped. The method must be [started](Self::start) again before it steps again.
    fn take_back(&mut self, _p: &mut Particles<D>, _domain: &Domain<D>) {}
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Iterations of the pressure solve; absent for explicit methods.
    pub iterations: Option<usize>,
    /// True relative residual of the pressure solve, dimensionless; absent for explicit methods.
    pub residual: Option<f64>,
    /// Evaluations of pressure and forces that the step made: its sound steps; absent where it is one.
    pub evaluations: Option<usize>,
    /// Pairs in the lists of the step, each from both sides; absent where a method does not say.
    pub listed_pairs: Option<usize>,
}

/// Why a step stopped.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum StepError {
    /// No pairs could be found.
    #[error(transparent)]
    Search(#[from] SearchError),
    /// The pressure equation was not solved.
    #[error("pressure equation: {0}")]
    Pressure(#[from] SolveError),
    /// A field holds NaN or infinity.
    #[error("{field} of particle {particle} is not finite")]
    NotFinite {
        /// Name of the field.
        field: &'static str,
        /// Name (`id`) of the particle.
        particle: u32,
    },
    /// A particle is faster than anything the case can cause.
    #[error(
        "velocity of particle {particle} is {speed:.3e} m/s, but this case cannot cause more than {limit:.3e} m/s; \
         the method is unstable here: try a smaller `time.courant` or `time.step`, or another method (`isph-shift` knows no free surface)"
    )]
    Runaway {
        /// Name (`id`) of the particle.
        particle: u32,
        /// Its speed, m/s.
        speed: f64,
        /// The bound, m/s.
        limit: f64,
    },
    /// All fluid has left the domain.
    #[error(
        "position of every fluid particle is outside the domain: where the fluid falls or flies away, a larger `domain` or walls keep it; where \
         the method is unstable, a smaller `time.courant`"
    )]
    Empty,
    /// No fluid particle is at a free surface, and the method needs one.
    #[error(
        "pressure equation: no fluid particle is at a free surface, and without one the equation of this method has no solution; `isph`, and \
         `isph-shift` for a full domain, solve it up to a constant"
    )]
    NoSurface,
}

impl StepError {
    /// Name of the field that went wrong.
    pub fn field(&self) -> &'static str {
        match self {
            Self::Search(_) | Self::Empty => "position",
            Self::Pressure(_) | Self::NoSurface => "pressure",
            Self::NotFinite { field, .. } => field,
            Self::Runaway { .. } => "velocity",
        }
    }

    /// Name (`id`) of the particle that went wrong, where it is one.
    pub fn particle(&self) -> Option<u32> {
        match self {
            Self::NotFinite { particle, .. } | Self::Runaway { particle, .. } => Some(*particle),
            Self::Search(_) | Self::Pressure(_) | Self::Empty | Self::NoSurface => None,
        }
    }
}

/// The fluid and the forces on it: what every method needs to know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium<const D: usize> {
    /// Density at rest `ρ0`, kg/m³.
    pub rest_density: f64,
    /// Dynamic viscosity `μ`, Pa s.
    pub viscosity: f64,
    /// Acceleration of gravity, m/s².
    pub gravity: Vector<D>,
    /// Particle spacing at the start, m.
    pub spacing: f64,
    /// Height `H` of the fluid at the start, along gravity, m.
    pub depth: f64,
    /// Position of the floor along the upward axis, m: heights `y` are counted from here.
    pub floor: f64,
    /// Courant number `C` of (32), dimensionless.
    pub courant: f64,
    /// Largest speed expected, m/s: of falling through the depth, `2 √(gH)`, of the initial state and of the walls.
    pub speed: f64,
}

impl<const D: usize> Medium<D> {
    /// Height of `x` above the floor, against gravity, m; 0 without gravity.
    pub fn height(&self, x: Vector<D>) -> f64 {
        let g = self.gravity.norm();
        if g == 0.0 { 0.0 } else { -x.dot(self.gravity) / g - self.floor }
    }

    /// Volume a particle stands for at the start, m³ (m² in 2D).
    pub fn spacing_volume(&self) -> f64 {
        (0..D).fold(1.0, |volume, _| volume * self.spacing)
    }

    /// Magnitude of gravity, m/s².
    pub fn g(&self) -> f64 {
        self.gravity.norm()
    }

    /// The greatest speed that counts for steps and viscosity, m/s: of fluid and walls, at least `sqrt(g H)`.
    pub fn greatest_speed(&self, p: &Particles<D>) -> f64 {
        let fastest = largest(p.owned(), |a| p.v[a].norm_squared()).max(0.0).sqrt();
        fastest.max((self.g() * self.depth).sqrt())
    }

    /// `C h/max(|v|, sqrt(g H))` and `C h²/(2ν)`: how far flow and friction may get in a step of an incompressible fluid, for a length `h`, m.
    pub fn flow_limit(&self, p: &Particles<D>, h: f64) -> StepLimit {
        let nu = self.viscosity / self.rest_density;
        StepLimit::new(self.courant * h / self.greatest_speed(p), "flow").min(StepLimit::new(0.5 * self.courant * h * h / nu, "viscosity"))
    }

    /// `C sqrt(h/|a|)` for the walls of greatest acceleration.
    pub fn wall_limit(&self, p: &Particles<D>, h: f64) -> StepLimit {
        let pushed = largest(p.owned(), |a| if p.is_fluid(a) { 0.0 } else { p.acceleration[a].norm_squared() }).max(0.0).sqrt();
        StepLimit::new(self.courant * (h / pushed).sqrt(), "walls")
    }
}

/// Which defaults a method starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Little dissipation, and the documented departures that let the method run a whole dam break.
    #[default]
    Water,
    /// Every number and formula as the paper prints it.
    Paper,
}

impl Preset {
    /// The name as written in a case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Water => "water",
            Self::Paper => "paper",
        }
    }
}
