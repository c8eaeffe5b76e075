//! Divergence-free SPH: the exact projection of the particles' own divergence, once for the velocity and once for the density.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::adjoint::{Aim, Choices, Flow};
use super::isph::WallFriction;
use super::settings::{BrokenRule, Settings};
use super::{Medium, Preset, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::{Kernel, KernelName, WendlandC2};
use crate::neighbors::Search;
use crate::particles::Particles;
use crate::poisson::{SolveError, SolveReport};
use crate::time::{Phases, StepLimit};

/// What a pair of fluid and wall counts in divergence and gradient: the same in both, so that they stay adjoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallPairs {
    /// Once: a wall particle has its own velocity and no pressure. The row at a wall then needs twice the pressure to be carried.
    Single,
    /// Twice: velocity goes on beyond the face of a wall as `2 v_w − v_a`, pressure as `p_a`.
    Mirrored,
}

/// Parameters of the methods `dfsph` and `iisph`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DfsphSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Share of `h U/8` that is the viscosity between approaching particles, dimensionless, >= 0; 0 is inviscid.
    pub dissipation: f64,
    /// What a pair of fluid and wall counts.
    pub wall_pairs: WallPairs,
    /// Friction of walls in a viscous fluid.
    pub wall_friction: WallFriction,
    /// Largest relative true residual of a pressure solve, dimensionless, in (0, 1).
    pub tolerance: f64,
    /// Most iterations of one pressure solve, at least 1; the run stops if they are not enough.
    pub max_iterations: usize,
    /// How pairs are found.
    pub search: Search,
}

impl DfsphSettings {
    /// The defaults; both presets are the same.
    pub fn preset(preset: Preset) -> Self {
        Self {
            preset,
            dissipation: 0.1,
            wall_pairs: WallPairs::Mirrored,
            wall_friction: WallFriction::NoSlip,
            tolerance: 1e-3,
            max_iterations: 2000,
            search: Search::Grid,
        }
    }

    pub(super) fn choices(&self) -> Choices {
        Choices {
            dissipation: self.dissipation,
            sticky: self.wall_friction == WallFriction::NoSlip,
            wall_weight: match self.wall_pairs {
                WallPairs::Single => 1.0,
                WallPairs::Mirrored => 2.0,
            },
            search: self.search,
            tolerance: self.tolerance,
            max_iterations: self.max_iterations,
        }
    }

    pub(super) fn check_all(&self) -> Result<(), BrokenRule> {
        BrokenRule::unless_not_negative("dissipation", self.dissipation)?;
        BrokenRule::unless(self.tolerance > 0.0 && self.tolerance < 1.0, "tolerance", self.tolerance, "> 0 and < 1")?;
        BrokenRule::unless(self.max_iterations > 0, "max_iterations", self.max_iterations, "at least 1")
    }

    /// The rows of Table 1; `aim` says what the pressure does, `solves` how often a step asks for it.
    pub(super) fn rows(&self, aim: &str, stepping: &str, solves: &str) -> Vec<(&'static str, String)> {
        let friction = match self.wall_friction {
            WallFriction::FreeSlip => "without friction",
            WallFriction::NoSlip => "to which a viscous fluid sticks",
        };
        let pairs = match self.wall_pairs {
            WallPairs::Single => "without pressure",
            WallPairs::Mirrored => "that mirror velocity and pressure",
        };
        vec![
            ("compressibility", "incompressible".to_owned()),
            ("pressure from", aim.to_owned()),
            ("density from", "sum over neighbours".to_owned()),
            ("viscosity", format!("of the fluid, and {} h U/8 between approaching particles", self.dissipation)),
            ("time step limited by", "speed".to_owned()),
            ("time stepping", stepping.to_owned()),
            ("walls", format!("rows of particles {pairs}, {friction}")),
            ("free surface", "expansion is not resisted where neighbours are missing".to_owned()),
            ("linear system", format!("never assembled; conjugate gradients with Jacobi preconditioner, residual {:e}", self.tolerance)),
            ("work of a step", format!("{solves}, two sums over neighbours an iteration")),
        ]
    }

    pub(super) fn step_rule(courant: f64) -> String {
        format!("{courant} h over the greatest speed, at least sqrt(g H); from step to step a fifth more or half at most")
    }

    /// 8 bytes for the value of a pair; some 700 for the work space of a particle.
    pub(super) fn bytes(count: f64, neighbours: f64) -> f64 {
        count * (8.0 * neighbours + 700.0)
    }

    /// What differs from the papers, in both methods.
    pub(super) fn common_departures(&self) -> Vec<String> {
        let mut found = vec![
            "conjugate gradients in place of relaxed Jacobi iterations; pressure may be negative away from the surface".to_owned(),
            "what would pass the face of a wall is set back".to_owned(),
        ];
        if self.dissipation > 0.0 {
            found.push(format!("viscosity of {} h U/8 between approaching particles", self.dissipation));
        }
        found
    }
}

impl Settings for DfsphSettings {
    type Own = WendlandC2;
    const SMOOTHING: f64 = 1.3;
    const STEP_COST: f64 = 8e-7;

    fn preset(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn preset_name(&self) -> Preset {
        self.preset
    }

    fn check(&self, _reach: f64) -> Result<(), BrokenRule> {
        self.check_all()
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        self.rows(
            "exact projections: div v = 0, then the density at rest",
            "clean velocity, prediction, pressure, move",
            "two pressure solves",
        )
    }

    fn departures(&self, _viscosity: f64, _kernel: KernelName) -> Vec<String> {
        self.common_departures()
    }

    fn time_step_rule(&self, courant: f64) -> String {
        Self::step_rule(courant)
    }

    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        Self::bytes(count, neighbours)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(Dfsph::new(kernel, medium, self)))
    }
}

/// The method: the velocity is made free of divergence, then a pressure keeps the density.
///
/// With `D` the divergence of the particles and `G` its negative adjoint, all at the positions of the start of the step:
/// 1. `D G κ = (ρ/Δt) D v`, `v −= (Δt/ρ) G κ`;
/// 2. `v* = v + Δt (g + viscosity)`;
/// 3. `(Δt/ρ) D G p = D v* − (S − 1)/(k Δt)`, `v = v* − (Δt/ρ) G p`, with `S` the filling and `k` its fall with `D v`;
/// 4. `x += Δt v`.
///
/// The pressure reported is `p + κ`, every push of the step: noisy, as it answers each density error within one step.
///
/// Source: Bender & Koschier, IEEE Trans. Vis. Comput. Graph. 23 (2017) 1193, whose divergence solve at the end of a step is that
/// at the start of the next one.
pub struct Dfsph<K, const D: usize> {
    kernel: K,
    flow: Flow<D>,
    /// The last `κ` and `p`, Pa: where the next solves start.
    cleaning: Vec<f64>,
    packing: Vec<f64>,
}

impl<K: Kernel<D>, const D: usize> Dfsph<K, D> {
    /// The method for a fluid, with a kernel and checked parameters.
    pub fn new(kernel: K, medium: Medium<D>, settings: &DfsphSettings) -> Self {
        Self { kernel, flow: Flow::new(kernel, medium, settings.choices()), cleaning: Vec::new(), packing: Vec::new() }
    }
}

/// Iterations of both solves, and the larger residual.
fn joined(one: SolveReport, other: SolveReport) -> StepReport {
    StepReport {
        iterations: Some(one.iterations + other.iterations),
        residual: Some(one.residual.max(other.residual)),
        ..StepReport::default()
    }
}

impl<K: Kernel<D>, const D: usize> Scheme<D> for Dfsph<K, D> {
    /// Density, surface, and the pressure that the first step will find.
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        self.flow.begin(self.kernel, p, domain);
        self.flow.look_around(self.kernel, p, domain)?;
        let dt = self.flow.time_step(p).dt;
        self.packing.clone_from(&p.pressure);
        self.packing.truncate(p.owned());
        self.flow.press(p, domain, Aim::DivergenceFree, dt, &mut self.cleaning)?;
        self.flow.predict(p, domain, dt);
        self.flow.press(p, domain, Aim::ConstantDensity, dt, &mut self.packing)?;
        self.flow.show(p, dt);
        Ok(())
    }

    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        self.flow.time_step(p)
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        let flow = &mut self.flow;
        phases.measure("search", || flow.look_around(self.kernel, p, domain))?;

        // (1) D v = 0
        let cleaned = phases.measure("divergence", || flow.press(p, domain, Aim::DivergenceFree, dt, &mut self.cleaning))?;

        // (2) v* = v + Δt (g + viscosity)
        phases.measure("prediction", || flow.predict(p, domain, dt));

        // (3) the density at rest after the step
        let packed = phases.measure("density", || flow.press(p, domain, Aim::ConstantDensity, dt, &mut self.packing))?;

        // (4) x += Δt v
        phases.measure("motion", || flow.finish(p, domain, dt));
        Ok(joined(cleaned, packed))
    }
}
