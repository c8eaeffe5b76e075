//! Equations of state of a weakly compressible liquid, evaluated by products.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::pressure::GAMMA;
use crate::math::power;

/// How pressure follows from density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PressureLaw {
    /// `p = c0² (ρ − ρ0)`.
    Linear,
    /// `p = (c0² ρ0/7) ((ρ/ρ0)⁷ − 1)` (Cole 1948).
    Tait,
}

/// An equation of state with its constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EquationOfState {
    /// Which one.
    pub law: PressureLaw,
    /// Speed of sound at rest `c0`, m/s.
    pub sound: f64,
    /// Density at rest `ρ0`, kg/m³.
    pub rest: f64,
}

impl EquationOfState {
    /// Pressure at the density `density`, Pa.
    #[inline(always)]
    pub fn pressure(&self, density: f64) -> f64 {
        match self.law {
            PressureLaw::Linear => self.sound * self.sound * (density - self.rest),
            PressureLaw::Tait => self.stiffness() * (power(density / self.rest, GAMMA) - 1.0),
        }
    }

    /// Density at the pressure `pressure`, kg/m³: the inverse of [`pressure`](Self::pressure).
    ///
    /// The seventh root is found by six steps of Newton's method from the linear law: for densities within 20 % of rest that
    /// is round-off, and it has the same bits on every machine.
    #[inline]
    pub fn density(&self, pressure: f64) -> f64 {
        match self.law {
            PressureLaw::Linear => self.rest + pressure / (self.sound * self.sound),
            PressureLaw::Tait => {
                let target = (pressure / self.stiffness() + 1.0).max(1e-3);
                let mut s: f64 = 1.0 + (target - 1.0) / f64::from(GAMMA);
                for _ in 0..6 {
                    let slope = f64::from(GAMMA) * power(s, GAMMA - 1);
                    s -= (power(s, GAMMA) - target) / slope;
                }
                self.rest * s
            }
        }
    }

    /// `c² = dp/dρ`, m²/s².
    #[inline(always)]
    pub fn sound_squared(&self, density: f64) -> f64 {
        match self.law {
            PressureLaw::Linear => self.sound * self.sound,
            PressureLaw::Tait => self.sound * self.sound * power(density / self.rest, GAMMA - 1),
        }
    }

    /// `B = c0² ρ0/γ`, Pa.
    fn stiffness(&self) -> f64 {
        self.sound * self.sound * self.rest / f64::from(GAMMA)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAWS: [PressureLaw; 2] = [PressureLaw::Linear, PressureLaw::Tait];

    #[test]
    fn density_is_the_inverse_of_pressure() {
        for law in LAWS {
            let state = EquationOfState { law, sound: 50.0, rest: 1000.0 };
            for density in [850.0, 990.0, 1000.0, 1007.0, 1150.0] {
                let back = state.density(state.pressure(density));
                // 1e-13: round-off of the products, times the slope.
                assert!((back / density - 1.0).abs() < 1e-13, "{law:?}: {back} for {density}");
            }
        }
    }

    #[test]
    fn the_speed_of_sound_is_the_slope() {
        for law in LAWS {
            let state = EquationOfState { law, sound: 50.0, rest: 1000.0 };
            let slope = (state.pressure(1010.001) - state.pressure(1009.999)) / 2e-3;
            // 1e-7: cancellation in the difference quotient.
            assert!((state.sound_squared(1010.0) / slope - 1.0).abs() < 1e-7, "{law:?}");
        }
    }
}
