//! Pressure: equation of state, the two forms of its gradient term, the two forms of its Laplacian.

use crate::math::power;

/// Exponent of the equation of state of water, dimensionless (Cole 1948; the paper's (25)).
pub const GAMMA: u32 = 7;

/// The equation of state (25): `p = B ((ρ/ρ0)^γ − 1)`, Pa, for `B` in Pa.
#[inline(always)]
pub fn tait(stiffness: f64, density: f64, rest_density: f64) -> f64 {
    stiffness * (power(density / rest_density, GAMMA) - 1.0)
}

/// Speed of sound of (25), m/s: `c² = dp/dρ = (γ B/ρ0) (ρ/ρ0)^(γ−1)`.
#[inline(always)]
pub fn speed_of_sound(stiffness: f64, density: f64, rest_density: f64) -> f64 {
    (f64::from(GAMMA) * stiffness / rest_density * power(density / rest_density, GAMMA - 1)).sqrt()
}

/// How the equation of state of a method stores energy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Elasticity {
    /// Not at all: the fluid is incompressible.
    None,
    /// As (25) with the `B` given, Pa.
    Tait(f64),
    /// As `p = c² (ρ − ρ0)` with the speed of sound `c` given, m/s.
    Linear(f64),
    /// In a way that has no energy common to all particles.
    Unknown,
}

impl Elasticity {
    /// Elastic energy per mass of fluid of a density, J/kg: `∫ p/ρ² dρ` from rest; 0 where there is none to give.
    pub fn energy(self, density: f64, rest_density: f64) -> f64 {
        let ratio = density / rest_density;
        match self {
            Self::None | Self::Unknown => 0.0,
            Self::Tait(b) => {
                let gamma = f64::from(GAMMA);
                b / rest_density * ((power(ratio, GAMMA - 1) - 1.0) / (gamma - 1.0) + 1.0 / ratio - 1.0)
            }
            Self::Linear(c) => c * c * (ratio.ln() + 1.0 / ratio - 1.0),
        }
    }
}

/// The symmetric pressure factor of (20), `p_a/ρ_a² + p_b/ρ_b²`, m⁵/(kg s²) in 3D: equal for both particles of a pair, so that
/// their forces cancel exactly.
#[inline(always)]
pub fn symmetric(p_a: f64, rho_a: f64, p_b: f64, rho_b: f64) -> f64 {
    p_a / (rho_a * rho_a) + p_b / (rho_b * rho_b)
}

/// Coefficient of `(p_a − p_b)` in the Laplacian (16) of Shao & Lo (2003), without the mass: `−8/(ρ_a+ρ_b)² · x_ab·∇W/(r² + η²)`.
///
/// `dw_over_r` is `W'/r`; `eta_squared` in m². Never negative; equal for both particles of a pair. The sign is such that
/// `Σ_b m_b k_ab (p_a − p_b) = −∇·(∇p/ρ)`.
#[inline(always)]
pub fn laplacian_shao_lo(rho_a: f64, rho_b: f64, dw_over_r: f64, r: f64, eta_squared: f64) -> f64 {
    let sum = rho_a + rho_b;
    -8.0 / (sum * sum) * (dw_over_r * r * r) / (r * r + eta_squared)
}

/// Coefficient of `(p_a − p_b)` in the Laplacian (17) of Brookshaw (1985), without the mass: `−2/(ρ_a ρ_b) · x_ab·∇W/r²`.
///
/// Sign and symmetry as in [`laplacian_shao_lo`].
#[inline(always)]
pub fn laplacian_brookshaw(rho_a: f64, rho_b: f64, dw_over_r: f64) -> f64 {
    -2.0 / (rho_a * rho_b) * dw_over_r
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_of_sound_is_the_slope_of_the_equation_of_state() {
        let (b, rho, rho0, step) = (1.2e5, 1013.0, 1000.0, 1e-3);
        let slope = (tait(b, rho + step, rho0) - tait(b, rho - step, rho0)) / (2.0 * step);
        let c = speed_of_sound(b, rho, rho0);
        // 1e-7: cancellation in the difference quotient.
        assert!((c * c / slope - 1.0).abs() < 1e-7, "{} against {slope}", c * c);
        assert_eq!(tait(b, rho0, rho0), 0.0);
    }

    /// The paper's claim of "no essential difference": (16) is (17) for equal densities and `η = 0`.
    #[test]
    fn both_laplacians_agree_for_equal_densities() {
        let (rho, slope, r) = (998.0, -3.7e4, 0.03);
        let difference = laplacian_shao_lo(rho, rho, slope, r, 0.0) / laplacian_brookshaw(rho, rho, slope) - 1.0;
        assert!(difference.abs() < 1e-14);
    }
}
