//! A preconditioner for operators that are never assembled: rows that lie together are one unknown of a coarse equation.

use std::ops::Range;

use rayon::prelude::*;

use super::SolveError;
use super::multigrid::Multigrid;
use super::sliced::{Arms, Sliced};
use crate::sweep::{sweep, update};

/// Row that belongs to no aggregate.
const NONE: u32 = u32::MAX;

/// What a coarse correction is multiplied with. Steps from aggregate to aggregate cost more energy than the slopes they stand for, so that
/// the correction comes out too small.
const OVER: f64 = 1.8;

/// `z = D⁻¹ r + s T M⁻¹ Tᵀ r` for an `A` with diagonal `D`, where `T` is one where a row belongs to an aggregate and `M⁻¹` is a cycle of
/// multigrid for `Tᵀ A T`. Aggregates a few rows wide take a tenth of the memory of multigrid on the rows themselves, and some more iterations.
///
/// Source: Nicolaides, SIAM J. Numer. Anal. 24 (1987) 355.
#[derive(Debug)]
pub struct Aggregates {
    /// Aggregate of each row, or [`NONE`].
    of: Vec<u32>,
    /// The rows by aggregate, and where each aggregate ends among them.
    rows: Vec<u32>,
    ends: Vec<u32>,
    coarse: Sliced,
    multigrid: Multigrid,
    /// `Tᵀ r`, and what becomes of it.
    residual: Vec<f64>,
    correction: Vec<f64>,
}

impl Aggregates {
    /// Of `n` rows, those of `keys`, `(key, row)`, that have the same key. `links(i, each)` calls `each(j, w)` with all `w = −a_ij` of a row that
    /// has a key; its diagonal is their sum. Rows without a key are known: their columns count in diagonals only.
    ///
    /// # Errors
    /// The coarse matrix is singular.
    pub fn new(n: usize, mut keys: Vec<(u64, u32)>, links: impl Fn(usize, &mut dyn FnMut(usize, f64)) + Sync) -> Result<Self, SolveError> {
        keys.par_sort_unstable();
        let (mut of, mut ends) = (vec![NONE; n], Vec::new());
        for (at, same) in keys.chunk_by(|one, next| one.0 == next.0).enumerate() {
            same.iter().for_each(|&(_, row)| of[row as usize] = at as u32);
            ends.push(ends.last().unwrap_or(&0) + same.len() as u32);
        }
        let rows: Vec<u32> = keys.into_iter().map(|(_, row)| row).collect();
        let count = ends.len();
        let mut coarse = Sliced::default();
        coarse.fill(count, &mut Arms::<0>::default(), |i, row| {
            let (mut entries, mut diagonal) = (Vec::<(u32, f64)>::new(), 0.0);
            for &a in &rows[range(&ends, i)] {
                links(a as usize, &mut |b, weight| match of[b] {
                    own if own == i as u32 => {}
                    NONE => diagonal += weight,
                    other => match entries.iter_mut().find(|(column, _)| *column == other) {
                        Some((_, sum)) => *sum += weight,
                        None => entries.push((other, weight)),
                    },
                });
            }
            for (column, weight) in entries {
                // The matrix is what its rounded weights say.
                row.push(column as usize, weight as f32, []);
                diagonal += f64::from(weight as f32);
            }
            if diagonal > 0.0 { diagonal } else { 1.0 }
        });
        let mut multigrid = Multigrid::default();
        multigrid.build(&coarse)?;
        Ok(Self { of, rows, ends, coarse, multigrid, residual: vec![0.0; count], correction: vec![0.0; count] })
    }

    /// `z = D⁻¹ r + s T M⁻¹ Tᵀ r`, with the inverse of the diagonal in `inverse`; `r` is zero on rows without a key.
    pub fn apply(&mut self, inverse: &[f64], r: &[f64], z: &mut [f64]) {
        let Self { of, rows, ends, coarse, multigrid, residual, correction } = self;
        sweep(residual, |i| rows[range(ends, i)].iter().map(|&row| r[row as usize]).sum());
        multigrid.apply(coarse, residual, correction);
        sweep(z, |i| inverse[i] * r[i]);
        update(z, |i, z| {
            if of[i] != NONE {
                *z += OVER * correction[of[i] as usize];
            }
        });
    }
}

/// Where the rows of aggregate `i` stand.
fn range(ends: &[u32], i: usize) -> Range<usize> {
    (if i == 0 { 0 } else { ends[i - 1] as usize })..ends[i] as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::poisson::projection::{Goal, Workspace, solve};

    /// `−Δu = 1` on a square of points between zeros: halving the spacing doubles the iterations of Jacobi, and leaves these as they are.
    #[test]
    fn iterations_do_not_grow_with_the_number_of_rows() {
        let iterations = |n: usize| {
            let links = |i: usize, each: &mut dyn FnMut(usize, f64)| {
                let (x, y) = (i % n, i / n);
                // Points on the edge have no key: they are known.
                [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].iter().for_each(|&(x, y)| each(y * n + x, 1.0));
            };
            let inside = |i: &usize| (1..n - 1).contains(&(i % n)) && (1..n - 1).contains(&(i / n));
            let keys = (0..n * n).filter(inside).map(|i| ((i % n / 4 + n * (i / n / 4)) as u64, i as u32)).collect();
            let mut coarse = Aggregates::new(n * n, keys, links).unwrap();
            let apply = |q: &[f64], aq: &mut [f64]| {
                aq.fill(0.0);
                (0..n * n).filter(inside).for_each(|i| links(i, &mut |j, weight| aq[i] += weight * (q[i] - q[j])));
            };
            let b: Vec<f64> = (0..n * n).map(|i| f64::from(u8::from(inside(&i)))).collect();
            let (inverse, mut x) = (vec![0.25; n * n], vec![0.0; n * n]);
            let goal = Goal { tolerance: 1e-8, negligible: 0.0, max_iterations: 1000 };
            let report = solve(apply, |_| (), |r, z| coarse.apply(&inverse, r, z), &b, &mut x, goal, &mut Workspace::default());
            report.unwrap().iterations
        };
        let (few, many) = (iterations(64), iterations(256));
        assert!(many <= few + few / 4, "{few} iterations for 64 x 64 points, {many} for 256 x 256");
    }
}
