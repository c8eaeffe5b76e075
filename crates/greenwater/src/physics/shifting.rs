//! Shifting: small moves that keep particles evenly spaced.

use crate::lanes::Real;
use crate::math::{Vector, power};

/// Extra push of pairs that are too close, `R`, dimensionless: that of Sun et al. (2017), after Monaghan (2000), where the `pressure` of a particle is
/// no more than the flow makes, `dynamic = ρ U²` of [`shift_speed`], none where it is more than twice that, both Pa.
///
/// Pressure holds the square lattice of a kernel of `h = 2` spacings and not the triangular one. With the push, shifts hold the triangular lattice and
/// break the square one. Under the weight of water shifts and pressure would move particles without end; where the flow rules, it is what keeps
/// particles even.
#[inline(always)]
pub fn push_of_close_pairs(pressure: f64, dynamic: f64) -> f64 {
    const PUSH: f64 = 0.2;
    PUSH * (2.0 * dynamic - pressure).clamp(0.0, dynamic) / dynamic.max(f64::MIN_POSITIVE)
}

/// Weight of a pair in the concentration gradient, dimensionless: `1 + R (W_ab/W(Δx))⁴` (Sun et al. 2017). `w_ratio` is `W_ab/W(Δx)`, `push` is `R`.
#[inline(always)]
pub fn pair_weight<L: Real>(w_ratio: L, push: L) -> L {
    power(w_ratio, 4) * push + 1.0
}

/// The shift of a particle over a step `dt` (s), m: `−2 h U dt Σ_b V_b [1 + R (W_ab/W(Δx))⁴] ∇_a W_ab`, no longer than `U dt/2` (Sun et al. 2017,
/// 2019), and of the sum no more than makes it even. `concentration` is the sum, 1/m; `speed` is `U`, m/s; `stiffness` is how the sum of the stiffest
/// wave of a lattice changes with its displacements, 1/m² ([`Lattice::stiffness`](super::lattice::Lattice::stiffness)): shifts of more than twice
/// its inverse overshoot and grow.
///
/// Near a free surface pass its unit `normal`: only the part along the surface is kept.
#[inline]
pub fn shift<const D: usize>(
    concentration: Vector<D>,
    h: f64,
    speed: f64,
    dt: f64,
    stiffness: f64,
    normal: Option<Vector<D>>,
) -> Vector<D> {
    let mut move_by = -(2.0 * h * speed * dt).min(1.0 / stiffness) * concentration;
    if let Some(n) = normal {
        move_by -= move_by.dot(n) * n;
    }
    let (length, most) = (move_by.norm(), 0.5 * speed * dt);
    if length > most { most / length * move_by } else { move_by }
}

/// What the difference of velocities over `h` is multiplied by: a kernel of two spacings barely sees an uneven lattice, and shifts have to
/// keep up with the strain that makes it so.
const STRAIN: f64 = 20.0;

/// Speed that shifts go by, m/s: `20 h √(D:D)`, at most `fastest`; `strain` is the rate of strain, 1/s.
///
/// Strain is what makes particles uneven. A speed measured by it is the same for every observer, and zero in liquid that is at rest,
/// falls or turns as a whole, however fast a drop flies elsewhere (after Michel, Vergnaud, Oger, Hermange & Le Touzé, J. Comput.
/// Phys. 459 (2022) 110999, who ask for the first two).
#[inline(always)]
pub fn shift_speed(strain: f64, h: f64, fastest: f64) -> f64 {
    (STRAIN * h * strain).min(fastest)
}

/// Sum `Σ V W` below which a neighbourhood counts as dilated: disordered particles of the right volume sum to 1 within half a
/// per cent, whatever the kernel.
const FULL: f64 = 0.995;

/// Relative rate of density, 1/s, that closes what shifting and splashes have opened inside the fluid: the missing part of `Σ V W`
/// over the time `h/(strength U)`. Zero where the neighbourhood is full. `sum` is `Σ V W`, `speed` is `U`, m/s.
///
/// Density that follows the continuity equation forgets where particles are: fluid that has come to fill more space than its
/// volume would stay so. This is the drift term of incompressible methods (Tanaka & Masunaga 2010), one-sided.
#[inline]
pub fn volume_pull(sum: f64, h: f64, speed: f64, strength: f64) -> f64 {
    -strength * speed / h * (FULL - sum).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{Kernel, WendlandC2};

    /// Where the shift of a particle goes over the displacement of every second row along itself, on a square lattice at `h = 2` spacings: back into line if
    /// above zero.
    fn back_into_line(push: f64) -> f64 {
        let (h, by) = (2.0, 1e-4);
        let kernel = |r: f64| Kernel::<2>::w(WendlandC2, r, h);
        let mut total = 0.0;
        for i in -5..=5 {
            for j in (-5..=5).filter(|&j| (i, j) != (0, 0)) {
                let x = Vector([f64::from(i) + if j % 2 == 0 { 0.0 } else { by }, f64::from(j)]);
                let close = kernel(x.norm()) / kernel(1.0);
                total += pair_weight(close, push) * Kernel::<2>::dw_over_r(WendlandC2, x.norm(), h) * x[0];
            }
        }
        total / by
    }

    #[test]
    fn a_push_of_close_pairs_breaks_the_lattice_that_pressure_holds() {
        assert!(back_into_line(0.0) > 0.0);
        // -0.0062: without the push it is nothing to speak of, 0.0000 in the digits of the theory page.
        assert!(back_into_line(0.2) < -0.005, "{}", back_into_line(0.2));
    }

    #[test]
    fn close_pairs_are_pushed_where_the_flow_makes_the_pressure() {
        assert_eq!([-1e4, 0.0, 50.0, 75.0, 100.0, 1e4].map(|pressure| push_of_close_pairs(pressure, 50.0)), [0.2, 0.2, 0.2, 0.1, 0.0, 0.0]);
        assert_eq!([-1.0, 0.0, 1.0].map(|pressure| push_of_close_pairs(pressure, 0.0)), [0.0; 3]);
    }

    #[test]
    fn only_dilated_fluid_is_pulled_together() {
        assert_eq!(volume_pull(1.003, 0.1, 2.0, 0.1), 0.0);
        // 1e-15: a few products.
        assert!((volume_pull(0.945, 0.1, 2.0, 0.1) + 0.1).abs() < 1e-15);
    }

    #[test]
    fn liquid_without_strain_is_not_shifted_and_strained_liquid_no_faster_than_it_flows() {
        assert_eq!(shift_speed(0.0, 0.1, 2.0), 0.0);
        assert_eq!(shift_speed(0.7, 0.1, 2.0), 1.4);
        assert_eq!(shift_speed(0.7, 0.1, 0.2), 0.2);
    }

    #[test]
    fn shifts_go_down_the_concentration_along_the_surface_and_not_too_far() {
        let free = shift(Vector([0.1, 0.2]), 0.05, 2.0, 1e-3, 1.0, None);
        assert!(free[0] < 0.0 && free[1] < 0.0);
        let along = shift(Vector([0.1, 0.2]), 0.05, 2.0, 1e-3, 1.0, Some(Vector([0.0, 1.0])));
        assert_eq!(along, Vector([free[0], 0.0]));
        // A stiff lattice takes no more than the inverse of its stiffness.
        let stiff = shift(Vector([0.1, 0.0]), 0.05, 2.0, 1e-3, 1e5, None);
        assert!((stiff[0] + 1e-6).abs() < 1e-18, "{stiff:?}");
        // 1e-15: round-off of the scaling.
        assert!((shift(Vector([1e3, 0.0]), 0.05, 2.0, 1e-3, 1.0, None).norm() - 1e-3).abs() < 1e-15);
    }
}
