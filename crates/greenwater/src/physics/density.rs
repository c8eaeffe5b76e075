//! Density: by summation over neighbours, and its rate of change.

use crate::kernel::Kernel;
use crate::math::Vector;
use crate::neighbors::Neighbors;

/// The paper's summation (11): `ρ_a = Σ_b m_b W_ab` over all particles near `a`, `a` itself included, kg/m³.
///
/// `mass` is the whole column, kg. `W` is taken at the mean smoothing length of each pair.
#[inline]
pub fn summation_density<K: Kernel<D>, const D: usize>(kernel: K, near: &Neighbors<D>, mass: &[f64], a: usize) -> f64 {
    let mut density = mass[a] * kernel.w(0.0, near.h(a));
    near.for_each(a, |pair| density += mass[pair.b] * kernel.w(pair.r, pair.h));
    density
}

/// One term of the continuity equation (22): `m_b v_ab · ∇_a W_ab`, kg/(m³ s).
///
/// `mass_b` in kg, `v_ab` in m/s, `grad_w` in m⁻ᴰ⁻¹. Positive where the two approach.
#[inline(always)]
pub fn continuity<const D: usize>(mass_b: f64, v_ab: Vector<D>, grad_w: Vector<D>) -> f64 {
    mass_b * v_ab.dot(grad_w)
}
