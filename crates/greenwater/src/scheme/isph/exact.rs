//! The exact projection `−D G q = source` among fluid particles: a few iterations, in single precision.

use rayon::prelude::*;

use super::closure::Closure;
use crate::math::Vector;
use crate::poisson::{Arms, Sliced};
use crate::reduce::dot_single;
use crate::sweep::{BLOCK, sweep};

/// `G q_a = q_a C_a − Σ_fluid q_b f x_ab` and `D u_a = −C_a·u_a − Σ_fluid u_b·f x_ab` for walls at rest, with `C = −Σ f x_ab`: the negative
/// adjoints of each other, over the pairs of the pressure matrix, whose arms are `f x_ab`.
///
/// What a truncated solve gives is a correction: six digits of it are plenty.
#[derive(Debug, Default)]
pub(super) struct Exact<const D: usize> {
    /// `C`, 1/m.
    slope: Vec<[f32; D]>,
    /// Inverse of the diagonal of `−D G`, `|C|² + Σ f² r²`.
    inverse: Vec<f32>,
    /// The same of those rows that have a potential, zero for the others.
    held: Vec<f32>,
    /// The potential, and its gradient.
    pub(super) q: Vec<f32>,
    pub(super) gradient: Vec<[f32; D]>,
    r: Vec<f32>,
    p: Vec<f32>,
    ap: Vec<f32>,
    /// For vectors without the mean of closed parts.
    wide: Vec<f64>,
}

impl<const D: usize> Exact<D> {
    /// Takes over `slope(i)`, 1/m, and the arms of a step; `floor`, 1/m², is the least diagonal.
    pub(super) fn prepare(&mut self, arms: &Arms<D>, n: usize, floor: f64, slope: impl Fn(usize) -> Vector<D> + Sync) {
        self.slope.resize(n, [0.0; D]);
        self.inverse.resize(n, 0.0);
        sweep(&mut self.slope, |i| slope(i).0.map(|c| c as f32));
        let slope = &self.slope;
        sweep(&mut self.inverse, |i| 1.0 / (slope[i].iter().map(|c| c * c).sum::<f32>() + arms.square(i)).max(floor as f32));
        self.gradient.resize(n, [0.0; D]);
        for vector in [&mut self.q, &mut self.r, &mut self.p, &mut self.ap] {
            vector.resize(n, 0.0);
        }
    }

    /// Says which rows have a potential in the projections that follow; that of the others is zero, and their divergence stays.
    pub(super) fn hold(&mut self, held: impl Fn(usize) -> bool + Sync) {
        let inverse = &self.inverse;
        self.held.resize(inverse.len(), 0.0);
        sweep(&mut self.held, |i| if held(i) { inverse[i] } else { 0.0 });
    }

    /// At most so many conjugate-gradient iterations from zero for `−D G q = source`, fewer once the residual has fallen to a twentieth:
    /// what the iterations reach that are worth their time. Leaves `q` and `gradient = G q`.
    pub(super) fn project(&mut self, a: &Sliced, arms: &Arms<D>, source: &[f64], closure: &mut Closure, iterations: usize) {
        let Self { slope, held, q, gradient, r, p, ap, wide, .. } = self;
        // Rows that are not held stay zero in every direction: these are the conjugate gradients of the rest.
        let (slope, inverse) = (&*slope, &*held);
        // A constant potential means nothing where there is no surface, but its gradient is that of the packing, and would take
        // the velocity that made it for divergence.
        let mut level = |column: &mut [f32]| {
            if closure.active {
                wide.clear();
                wide.extend(column.iter().map(|&value| f64::from(value)));
                closure.level(wide);
                column.iter_mut().zip(&*wide).for_each(|(to, &from)| *to = from as f32);
            }
        };
        let apply = |q: &[f32], gradient: &mut [[f32; D]]| {
            a.with_arms(arms, q, gradient, |i, sums, u| *u = std::array::from_fn(|d| q[i] * slope[i][d] - sums[d]));
        };
        q.fill(0.0);
        sweep(r, |i| source[i] as f32);
        level(r);
        sweep(p, |i| inverse[i] * r[i]);
        level(p);
        let mut rz = dot_single(r, p);
        let target = 0.05 * 0.05 * rz;
        for _ in 0..iterations {
            if rz.is_nan() || rz <= target.max(1e-30) {
                break;
            }
            apply(p, gradient);
            let u = &*gradient;
            a.join_arms(arms, u, ap, |i, sum, ap| *ap = sum + (0..D).map(|d| slope[i][d] * u[i][d]).sum::<f32>());
            level(ap);
            let curvature = dot_single(p, ap);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let step = (rz / curvature) as f32;
            // `ap` makes room for the preconditioned residual.
            let rows = q.par_chunks_mut(4 * BLOCK).zip(r.par_chunks_mut(4 * BLOCK)).zip(ap.par_chunks_mut(4 * BLOCK));
            rows.zip(p.par_chunks(4 * BLOCK)).zip(inverse.par_chunks(4 * BLOCK)).for_each(|((((q, r), ap), p), inverse)| {
                for i in 0..q.len() {
                    q[i] += step * p[i];
                    r[i] -= step * ap[i];
                    ap[i] = inverse[i] * r[i];
                }
            });
            level(ap);
            let next = dot_single(r, ap);
            let keep = (next / rz) as f32;
            rz = next;
            p.par_chunks_mut(4 * BLOCK).zip(ap.par_chunks(4 * BLOCK)).for_each(|(p, z)| {
                p.iter_mut().zip(z).for_each(|(p, z)| *p = z + keep * *p);
            });
        }
        apply(q, gradient);
    }

    /// `G q` of row `i`.
    pub(super) fn gradient(&self, i: usize) -> Vector<D> {
        Vector(self.gradient[i].map(f64::from))
    }
}
