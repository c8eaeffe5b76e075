//! What a user may choose about `isph` and `isph-shift`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Isph;
use crate::kernel::{Kernel, KernelName, WendlandC2};
use crate::neighbors::Search;
use crate::poisson::{PreconditionerKind, SolveError, SolverSettings};
use crate::scheme::settings::{BrokenRule, Settings};
use crate::scheme::{Medium, Preset, Scheme};

/// Friction of walls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallFriction {
    /// Walls do not drag.
    FreeSlip,
    /// The fluid sticks to walls: its velocity goes on linearly to theirs, at the face of the wall.
    NoSlip,
}

/// Whether a surface with pressure zero is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FreeSurface {
    /// Fluid may end in air; not in a box that repeats along all axes and is full.
    Tracked,
    /// Fluid fills the domain: no particle is at a surface, whatever its neighbours look like.
    None,
}

/// Parameters of the method `isph`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IsphSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Whether a surface with pressure zero is looked for.
    pub free_surface: FreeSurface,
    /// Share of `h U/8` that is the viscosity, less that of the fluid, between particles that approach each other faster than the flow around them
    /// explains, dimensionless, >= 0; 0 is none.
    pub dissipation: f64,
    /// Pressure solves in a step, 1 to 4: each further one takes up what those before left of the divergence.
    pub pressure_passes: u32,
    /// Most iterations of the exact projection that cleans the velocity; 0 switches it off.
    pub velocity_iterations: usize,
    /// Most iterations of the exact projection that restores the density by moving particles; 0 switches it off.
    pub density_iterations: usize,
    /// Strength of the shifting towards even spacing, dimensionless, >= 0; 0 switches it off.
    pub shifting: f64,
    /// Friction of walls in a viscous fluid.
    pub wall_friction: WallFriction,
    /// How pairs are found.
    pub search: Search,
    /// Solver of the pressure equation.
    pub solver: SolverSettings,
}

impl IsphSettings {
    /// The defaults; the paper has no such method, and both presets are the same.
    pub fn preset(preset: Preset) -> Self {
        Self {
            preset,
            free_surface: FreeSurface::Tracked,
            dissipation: 0.3,
            pressure_passes: 2,
            velocity_iterations: 5,
            density_iterations: 10,
            shifting: 2.0,
            wall_friction: WallFriction::NoSlip,
            search: Search::Grid,
            solver: SolverSettings { preconditioner: PreconditionerKind::Multigrid, tolerance: 1e-4, ..SolverSettings::default() },
        }
    }
}

impl Settings for IsphSettings {
    type Own = WendlandC2;
    const SMOOTHING: f64 = 1.3;
    const STEP_COST: f64 = 5e-8;

    fn preset(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn preset_name(&self) -> Preset {
        self.preset
    }

    fn check(&self, _reach: f64) -> Result<(), BrokenRule> {
        let s = self;
        BrokenRule::unless_not_negative("dissipation", s.dissipation)?;
        BrokenRule::unless_not_negative("shifting", s.shifting)?;
        BrokenRule::unless((1..=4).contains(&s.pressure_passes), "pressure_passes", s.pressure_passes, "1 to 4")?;
        BrokenRule::unless_solvable(&s.solver)
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        let s = self;
        let friction = match s.wall_friction {
            WallFriction::FreeSlip => "without friction",
            WallFriction::NoSlip => "to which a viscous fluid sticks",
        };
        let surface = match s.free_surface {
            FreeSurface::Tracked => "pressure zero half a spacing above the particles that have too few neighbours",
            FreeSurface::None => "none",
        };
        vec![
            ("compressibility", "incompressible".to_owned()),
            ("pressure from", format!("div v = 0, {} pass(es) of a compact equation", s.pressure_passes)),
            ("density from", "sum over neighbours; kept by moving particles".to_owned()),
            (
                "viscosity",
                format!(
                    "of the fluid, and what it lacks of {} h U/8 between particles that approach each other faster than the flow around them explains",
                    s.dissipation
                ),
            ),
            ("time step limited by", "speed".to_owned()),
            ("time stepping", "prediction, pressure, clean-up of the velocity, move, shift".to_owned()),
            ("walls", format!("rows of particles that carry the pressure on, {friction}")),
            ("free surface", surface.to_owned()),
            ("linear system", format!("{}, residual {:e}", s.solver.name(), s.solver.tolerance)),
            ("work of a step", "some fifty sums over neighbours and one linear system a pass".to_owned()),
        ]
    }

    /// The method is ours: nothing is printed that it could depart from.
    fn departures(&self, _viscosity: f64, _kernel: KernelName) -> Vec<String> {
        Vec::new()
    }

    fn time_step_rule(&self, courant: f64) -> String {
        format!("{courant} h over the greatest speed, at least sqrt(g H); from step to step a fifth more or half at most")
    }

    /// 24 bytes for a pair: matrix entry and pair value; some 500 for the work space of a particle and its share of multigrid.
    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        count * (24.0 * neighbours + 500.0)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(Isph::new(kernel, medium, self.clone())?))
    }
}

/// Parameters of the method `isph-shift`: those of `isph`, set for flows that fill their domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct IsphShiftSettings(pub IsphSettings);

impl Settings for IsphShiftSettings {
    type Own = <IsphSettings as Settings>::Own;
    const SMOOTHING: f64 = IsphSettings::SMOOTHING;
    const STEP_COST: f64 = IsphSettings::STEP_COST;

    /// No free surface, no dissipation but that of the fluid, no clean-up: a smooth potential of the exact projection has a gradient
    /// `2 q C`, and without a surface to end at it takes flow that strains the packing for divergence.
    fn preset(preset: Preset) -> Self {
        let tracked = IsphSettings::preset(preset);
        Self(IsphSettings {
            free_surface: FreeSurface::None,
            dissipation: 0.0,
            velocity_iterations: 0,
            // Nothing splashes: what a residual of 1e-3 leaves does not grow.
            solver: SolverSettings { tolerance: 1e-3, ..tracked.solver.clone() },
            ..tracked
        })
    }

    fn preset_name(&self) -> Preset {
        self.0.preset
    }

    fn check(&self, reach: f64) -> Result<(), BrokenRule> {
        self.0.check(reach)
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        self.0.distinctions()
    }

    fn departures(&self, viscosity: f64, kernel: KernelName) -> Vec<String> {
        self.0.departures(viscosity, kernel)
    }

    fn time_step_rule(&self, courant: f64) -> String {
        self.0.time_step_rule(courant)
    }

    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        self.0.memory(count, neighbours)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        self.0.scheme(kernel, medium)
    }
}
