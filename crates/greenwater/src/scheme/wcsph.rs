//! Weakly compressible SPH as the paper states it.

use serde::{Deserialize, Serialize};

use super::Preset;

/// How the coefficient `B` of the equation of state (25) is read, the paper's (26).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EquationOfState {
    /// `B = 200 ρ0 g H/γ` everywhere (Monaghan 1994); the initial density is hydrostatic.
    Constant,
    /// `B_a = 200 ρ0 g (H − y_a)/γ` with the height each particle starts at.
    InitialHeight,
    /// `B_a = 200 ρ0 g (H − y_a)/γ` with the height each particle has now.
    CurrentHeight,
}

/// The force of wall particles on fluid particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WallForce {
    /// Lennard-Jones (33)-(34), repulsion only (`r < r0`).
    LennardJones,
    /// Lennard-Jones (33)-(34) with the attraction beyond `r0`.
    LennardJonesAttractive,
    /// Normal force of Monaghan (2005).
    Monaghan2005,
}

/// Parameters of the method `wcsph`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WcsphSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Reading of (26).
    pub equation_of_state: EquationOfState,
    /// The number 200 of (26): `c0² = stiffness · g H`. Dimensionless, > 0.
    pub stiffness: f64,
    /// Smallest `B` as a share of its value at the floor, dimensionless, in (0, 1]; for the readings with `H − y`.
    pub stiffness_floor: f64,
    /// Depth `H` of (26), m; left out: the height of the fluid at the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<f64>,
    /// Linear coefficient of the artificial viscosity (13), dimensionless, >= 0.
    pub alpha: f64,
    /// Quadratic coefficient of the artificial viscosity (13), dimensionless, >= 0.
    pub beta: f64,
    /// `η` of (14), dimensionless, > 0.
    pub eta: f64,
    /// Force of walls.
    pub wall_force: WallForce,
    /// Exponents of (33), the larger one first.
    pub wall_exponents: [u32; 2],
    /// Strength `D` of (34), m²/s²; left out: `5 g H`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall_strength: Option<f64>,
    /// Range `r0` of (34), m; left out: the particle spacing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall_range: Option<f64>,
}
