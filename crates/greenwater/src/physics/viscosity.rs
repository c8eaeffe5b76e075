//! Viscosity: the artificial one of the explicit method, the stress tensor, and the Laplacian of the velocity.

use crate::lanes::Real;
use crate::math::Vector;

/// A tensor of rank two; row `i` is `t[i]`.
pub type Tensor<const D: usize> = [Vector<D>; D];

/// `T · n`.
#[inline(always)]
pub fn contract<const D: usize>(t: &Tensor<D>, n: Vector<D>) -> Vector<D> {
    Vector(std::array::from_fn(|i| t[i].dot(n)))
}

/// Values the artificial viscosity of a pair depends on.
#[derive(Clone, Copy, Debug)]
pub struct Approach<L> {
    /// `v_ab·x_ab`, m²/s.
    pub along: L,
    /// Square of the distance, m².
    pub square: L,
    /// Mean smoothing length, m.
    pub h: L,
    /// Mean speed of sound, m/s.
    pub sound: L,
    /// Mean density, kg/m³.
    pub density: L,
}

/// The artificial viscosity `Π_ab` (13)-(15), m⁵/(kg s²) in 3D: `(β φ² − α c φ)/ρ̄` where the two approach, else 0, with
/// `φ = h v_ab·x_ab/(r² + η² h²)`.
///
/// The print lacks a square in `φ` and sums the fraction by coordinates; this is the form of Monaghan (1992).
/// `alpha`, `beta` and `eta` are dimensionless. Symmetric in the pair.
#[inline(always)]
pub fn artificial<L: Real>(pair: Approach<L>, alpha: f64, beta: f64, eta: f64) -> L {
    let phi = pair.h * pair.along.at_most(L::splat(0.0)) / (pair.square + pair.h * pair.h * (eta * eta));
    (phi * phi * beta - pair.sound * phi * alpha) / pair.density
}

/// Viscous stress over `μ` from the velocity gradient `g[i][j] = ∂v_i/∂x_j`, 1/s, equation (3):
/// `T_ij = ∂v_i/∂x_j + ∂v_j/∂x_i − (2/3) (∇·v) δ_ij`.
///
/// The diagonal is (23) with the leading 2/3 that its print lost. The factor is that of three dimensions in 2D too (plane strain).
#[inline(always)]
pub fn stress<const D: usize>(g: &Tensor<D>) -> Tensor<D> {
    let divergence: f64 = (0..D).map(|i| g[i][i]).sum();
    std::array::from_fn(|i| {
        let mut row = Vector(std::array::from_fn(|j| g[i][j] + g[j][i]));
        row[i] -= 2.0 / 3.0 * divergence;
        row
    })
}

/// Coefficient of `v_ab` in the viscous acceleration (18) of Shao & Lo (2003), 1/s, for the mass `mass_b` (kg):
/// `m_b 4 (μ_a + μ_b)/(ρ_a + ρ_b)² · x_ab·∇W/(r² + η²)`. Never positive: neighbours are dragged along.
///
/// One viscosity `mu` (Pa s) for all particles; `eta_squared` in m².
#[inline(always)]
pub fn laplacian(mass_b: f64, mu: f64, rho_a: f64, rho_b: f64, dw_over_r: f64, r: f64, eta_squared: f64) -> f64 {
    let sum = rho_a + rho_b;
    mass_b * 8.0 * mu / (sum * sum) * (dw_over_r * r * r) / (r * r + eta_squared)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Plane strain with `∂u/∂x = 3`, `∂v/∂y = −1`, `∂u/∂y = 2`: the paper's (23) and (24) by hand.
    #[test]
    fn stress_has_the_two_thirds_that_the_print_lost() {
        let t = stress(&[Vector([3.0, 2.0]), Vector([0.0, -1.0])]);
        let xx = 2.0 / 3.0 * (2.0 * 3.0 - (-1.0));
        let yy = 2.0 / 3.0 * (-2.0 - 3.0);
        assert!((t[0][0] - xx).abs() < 1e-15 && (t[1][1] - yy).abs() < 1e-15);
        assert_eq!((t[0][1], t[1][0]), (2.0, 2.0));
    }

    #[test]
    fn artificial_viscosity_acts_on_approach_only() {
        let pair = |v: f64| Approach { along: 0.1 * v, square: 0.1 * 0.1, h: 0.12, sound: 50.0, density: 1000.0 };
        assert_eq!(artificial(pair(1.0), 1.0, 1.0, 0.1), 0.0);
        let phi = 0.12 * -0.1 / (0.01 + 0.01 * 0.12 * 0.12);
        let expected = (phi * phi - 50.0 * phi) / 1000.0;
        // 1e-15: the products are the same up to their order.
        assert!((artificial(pair(-1.0), 1.0, 1.0, 0.1) / expected - 1.0).abs() < 1e-14);
    }
}
