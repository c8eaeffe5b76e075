//! Diffusion of density in weakly compressible methods: it damps the sound that a particle spacing can carry and no longer.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::state::EquationOfState;
use crate::lanes::Real;
use crate::math::Vector;

/// The gradient that diffusion leaves alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Diffusion {
    /// That of liquid at rest, `ρ0 g/c²` (Fourtakas et al. 2019): right where gravity is the only steady force.
    Fourtakas,
    /// The renormalised gradient of the density (Antuono et al. 2010): right everywhere, and one more sum over neighbours.
    Antuono,
    /// None (Molteni & Colagrossi 2009): also levels the pressure of liquid at rest; for comparison.
    Molteni,
}

/// `∇ρ = ρ0 g/c²` of liquid at rest, kg/m⁴: its pressure is `ρ0 g d` at the depth `d`.
#[inline]
pub fn gradient_at_rest<const D: usize>(state: &EquationOfState, gravity: Vector<D>, density: f64) -> Vector<D> {
    state.rest / state.sound_squared(density) * gravity
}

/// The part of `ρ_a − ρ_b` that diffuses, kg/m³: `ρ_a − ρ_b − ½ (G_a + G_b)·x_ab` with the gradients that stay; antisymmetric in
/// the pair. `rise` is `½ (G_a + G_b)·x_ab`, kg/m³.
///
/// The rate is `dρ_a/dt = 2 δ h c0 Σ_b (m_b/ρ0) jump x_ab·∇_a W_ab/r²`: `Σ m dρ/dt` vanishes pair by pair.
#[inline(always)]
pub fn jump<L: Real>(rho_a: L, rho_b: L, rise: L) -> L {
    rho_a - rho_b - rise
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::state::PressureLaw;

    #[test]
    fn liquid_at_rest_does_not_diffuse() {
        let gravity = Vector([0.5, -9.0]);
        let x_ab = Vector([0.02, -0.03]);
        for law in [PressureLaw::Linear, PressureLaw::Tait] {
            let state = EquationOfState { law, sound: 60.0, rest: 1000.0 };
            // a lies deeper than b by g·x_ab.
            let (b, a) = (state.density(1e4), state.density(1e4 + 1000.0 * gravity.dot(x_ab)));
            let (of_a, of_b) = (gradient_at_rest(&state, gravity, a), gradient_at_rest(&state, gravity, b));
            // 1e-6: third order in g·x_ab/c².
            let rise = 0.5 * (of_a + of_b).dot(x_ab);
            assert!(jump(a, b, rise).abs() < 1e-6 * (a - b).abs(), "{law:?}");
            assert_eq!(jump(a, 999.0, rise), -jump(999.0, a, 0.5 * (of_b + of_a).dot(-x_ab)));
        }
    }
}
