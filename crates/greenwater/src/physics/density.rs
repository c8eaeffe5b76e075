//! Density: by summation over neighbours, and its rate of change.

use crate::kernel::Kernel;
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
