//! Smoothed-aggregation multigrid as a preconditioner for symmetric pressure equations.

mod rows;

use std::ops::Range;

use rayon::prelude::*;

use self::rows::{Rows, Workspaces};
use super::SolveError;
use super::sliced::{ROWS, Sliced};
use crate::reduce::norm;

/// Rows up to which a level is solved with its inverse.
const COARSEST: usize = 128;

/// Levels at most; each has several times fewer rows than the one above it.
const LEVELS: usize = 20;

/// A level has at most this share of the rows above it; a matrix that falls apart into single rows does not coarsen.
const SLOWEST: f64 = 0.7;

/// Damping of the step that smooths the prolongation: 4/3 over the largest eigenvalue.
const DAMPING: f32 = 4.0 / 3.0;

/// Entry of a row, over the diagonals of both rows, from which they are gathered together on the finest level; half of it below. The farther half of
/// the neighbours of a particle is weaker than that: aggregates are three particles wide rather than five, and a cycle
/// takes two thirds of the iterations.
const STRENGTH: f64 = 0.025;

/// Lowest eigenvalue that smoothing aims at, over the largest: the next level sees what is slower.
const SMOOTH_FROM: f32 = 0.25;

/// Step of the damped Jacobi sweeps on the finest level, over that which takes the fastest error to zero. One sweep before and one after the
/// levels below cost half of two each, and a fifth more iterations.
const FINEST: f32 = 1.8;

/// Shift of the diagonal of the coarsest level: pressure of a closed part of the fluid is known up to a constant, and the inverse
/// must exist. Single precision does not resolve less. An unknown there gathers the rounding of thousands: where that is more, shifts up to the
/// last one are tried.
const COARSE_SHIFT: f64 = 1e-5;
const LAST_COARSE_SHIFT: f64 = 1e-3;

/// Chebyshev polynomial of degree 2 for eigenvalues from [`SMOOTH_FROM`] to 1: `d₁ = START D⁻¹r`, `d₂ = KEEP d₁ + ADD D⁻¹r'`.
const MIDDLE: f32 = 0.5 * (1.0 + SMOOTH_FROM);
const HALF: f32 = 0.5 * (1.0 - SMOOTH_FROM);
const FIRST: f32 = HALF / MIDDLE;
const SECOND: f32 = 1.0 / (2.0 * MIDDLE / HALF - FIRST);
const START: f32 = 1.0 / MIDDLE;
const KEEP: f32 = SECOND * FIRST;
const ADD: f32 = 2.0 * SECOND / HALF;

/// One level: how it hangs on the next, and the vectors of a cycle.
#[derive(Debug, Default)]
struct Level {
    /// Prolongation from the next level, and its transpose.
    from_next: Sliced,
    to_next: Sliced,
    b: Vec<f32>,
    /// Two corrections of a smoothing (one on the finest level), the residual, what the next level adds, and the solution.
    d: Vec<f32>,
    e: Vec<f32>,
    r: Vec<f32>,
    c: Vec<f32>,
    x: Vec<f32>,
}

impl Level {
    fn resize(&mut self, n: usize) {
        for vector in [&mut self.b, &mut self.d, &mut self.r, &mut self.c] {
            vector.resize(n, 0.0);
        }
    }

    /// `b` is there and `d = START D⁻¹ b`: smooths from zero, to `d + e` with residual `r`.
    fn descend(&mut self, a: &Sliced) {
        let Self { b, d, e, r, .. } = self;
        let inverse = a.inverse();
        let (b, d) = (&*b, &*d);
        a.with_single2(d, r, e, |at, ad, r, e| {
            let known = b[at.clone()].iter().zip(&d[at.clone()]).zip(&inverse[at]);
            for (((r, e), ad), ((b, d), inverse)) in r.iter_mut().zip(e).zip(ad).zip(known) {
                *r = b - ad;
                *e = KEEP * d + ADD * inverse * *r;
            }
        });
        a.with_single(e, r, |_, ae, r| r.iter_mut().zip(ae).for_each(|(r, ae)| *r -= ae));
    }

    /// Adds the correction `c` of the next level and smooths, into `x`.
    fn ascend(&mut self, a: &Sliced, x: &mut [f32]) {
        let Self { d, e, r, c, .. } = self;
        let inverse = a.inverse();
        // What is known so far is d + e + c; `e` makes room for the next correction.
        for_all(d, |at, d| d.iter_mut().zip(&e[at]).for_each(|(d, e)| *d += e));
        a.with_single2(c, r, e, |at, ac, r, e| {
            for (((r, e), ac), inverse) in r.iter_mut().zip(e).zip(ac).zip(&inverse[at]) {
                *r -= ac;
                *e = START * inverse * *r;
            }
        });
        let (d, e, r, c) = (&*d, &*e, &*r, &*c);
        a.with_single(e, x, |at, ae, x| {
            let known = d[at.clone()].iter().zip(&c[at.clone()]).zip(&e[at.clone()]).zip(&r[at.clone()]).zip(&inverse[at]);
            for ((x, ae), ((((d, c), e), r), inverse)) in x.iter_mut().zip(ae).zip(known) {
                *x = d + c + e + (KEEP * e + ADD * inverse * (r - ae));
            }
        });
    }
}

/// `change(i, v_i)` for runs `i` of entries, shared among threads where there are many.
fn for_all(v: &mut [f32], change: impl Fn(Range<usize>, &mut [f32]) + Sync) {
    if v.len() < 16 * ROWS {
        change(0..v.len(), v);
    } else {
        v.par_chunks_mut(ROWS).enumerate().for_each(|(number, v)| change(number * ROWS..number * ROWS + v.len(), v));
    }
}

/// A V-cycle with one damped Jacobi sweep each way on the finest level and Chebyshev polynomials of degree 2 below: symmetric and positive, so
/// that conjugate gradients may use it.
///
/// Aggregates are the neighbourhoods of rows, by strong ties, that no earlier aggregate touches. The prolongation is piecewise constant smoothed by
/// one step of damped Jacobi, `P = (I − 4/3 S⁻¹F) T`, for the filtered matrix `F`: `A` with its weak ties added to the diagonal; `S` are the sums of its
/// rows' sizes. With all ties a row would hang on twice as many aggregates in 3D, and a build cost 1.5 times as much, for no fewer iterations. Coarse operators
/// are `Pᵀ A P`. All in single precision: a preconditioner need not be exact, and half the bytes are half the time. Every sum has one order, whatever
/// the number of threads.
///
/// The finest level is smoothed with the matrix of today even where the levels below were built from an earlier one. With `S` for
/// the smoothing, a cycle leaves `Sᵀ (I − P A_c⁻¹ Pᵀ A) S` of an error, whose eigenvalues lie below 1 for any positive `A_c`: what it
/// does stays symmetric and positive.
///
/// Sources: Vaněk, Mandel & Brezina, Computing 56 (1996) 179 (smoothed aggregation); Adams, Brezina, Hu & Tuminaro, J. Comput.
/// Phys. 188 (2003) 593 (polynomial smoothing).
#[derive(Debug, Default)]
pub(super) struct Multigrid {
    levels: Vec<Level>,
    /// `A` of all levels but the finest, whose matrix is the caller's.
    below: Vec<Sliced>,
    /// Levels in use.
    depth: usize,
    /// Inverse of the coarsest level, where it is small.
    inverse: Vec<f32>,
}

/// What is needed while a level is built: more memory than what is kept of it, and needed once in many solves.
#[derive(Debug, Default)]
struct Scratch {
    aggregate: Vec<u32>,
    from_next: Rows,
    to_next: Rows,
    work: Workspaces,
}

impl Multigrid {
    /// Builds all levels below `a`, which has a positive diagonal.
    pub(super) fn build(&mut self, a: &Sliced) -> Result<(), SolveError> {
        if let Some((row, pivot)) = (0..a.rows()).map(|i| (i, a.diagonal(i))).find(|&(_, diagonal)| diagonal.is_nan() || diagonal <= 0.0) {
            return Err(SolveError::Singular { stage: "multigrid", row, pivot });
        }
        self.depth = 1;
        let mut scratch = Scratch::default();
        loop {
            let here = self.depth - 1;
            if self.levels.len() < self.depth {
                self.levels.push(Level::default());
                self.below.push(Sliced::default());
            }
            let (above, next) = self.below.split_at_mut(here);
            let a = if here == 0 { a } else { &above[here - 1] };
            let level = &mut self.levels[here];
            level.resize(a.rows());
            if self.depth == LEVELS || !level.coarsen(a, here == 0, &mut next[0], &mut scratch) {
                let rows = a.rows();
                return self.invert(here, rows);
            }
            self.depth += 1;
        }
    }

    /// The inverse of the coarsest level where it is small; a large one that does not coarsen is left to its smoother. The finest level
    /// is smoothed in any case.
    fn invert(&mut self, level: usize, n: usize) -> Result<(), SolveError> {
        self.inverse.clear();
        if n > COARSEST || level == 0 {
            return Ok(());
        }
        let (a, mut dense, mut shift) = (&self.below[level - 1], vec![0.0; n * n], COARSE_SHIFT);
        loop {
            dense.fill(0.0);
            for i in 0..n {
                dense[i * n + i] = (1.0 + shift) * a.diagonal(i);
                a.row(i).for_each(|(j, weight)| dense[i * n + j as usize] -= f64::from(weight));
            }
            // Without rounding no pivot of a matrix that is not negative is less than its shift.
            match invert(n, &mut dense, |i| 0.5 * shift * a.diagonal(i)) {
                Ok(()) => break,
                Err(_) if shift < LAST_COARSE_SHIFT => shift *= 10.0,
                Err((row, pivot)) => return Err(SolveError::Singular { stage: "multigrid", row, pivot }),
            }
        }
        // Rounding must not cost the inverse its symmetry.
        self.inverse.extend((0..n * n).map(|k| (0.5 * (dense[k] + dense[k % n * n + k / n])) as f32));
        Ok(())
    }

    /// `z = M⁻¹ r` for the matrix `a`: one V-cycle from zero.
    pub(super) fn apply(&mut self, a: &Sliced, r: &[f64], z: &mut [f64]) {
        // Single precision has the range of residuals of 10³⁸: scaled, it has any.
        let size = norm(r);
        if !(size > 0.0 && size.is_finite()) {
            z.copy_from_slice(r);
            return;
        }
        let scale = size / (r.len() as f64).sqrt();
        let (down, inverse) = (1.0 / scale, a.inverse());
        let Level { b, d, r: left, .. } = &mut self.levels[0];
        for_all(b, |at, b| b.iter_mut().zip(&r[at]).for_each(|(b, r)| *b = (down * r) as f32));
        start(d, FINEST, b, inverse);
        let b = &*b;
        a.with_single(d, left, |at, ad, left| {
            for ((left, ad), b) in left.iter_mut().zip(ad).zip(&b[at]) {
                *left = b - ad;
            }
        });
        self.correct(0);
        let Level { d, r, c, .. } = &self.levels[0];
        a.with_single(c, z, |at, ac, z| {
            let known = d[at.clone()].iter().zip(&c[at.clone()]).zip(&r[at.clone()]).zip(&inverse[at]);
            for ((z, ac), (((d, c), r), inverse)) in z.iter_mut().zip(ac).zip(known) {
                *z = scale * f64::from(d + c + FINEST * inverse * (r - ac));
            }
        });
    }

    /// Work of a cycle, in products with the matrix `a`: two on the finest level, four on those below, and the ways between them.
    pub(super) fn products(&self, a: &Sliced) -> f64 {
        let ways: usize = self.levels[..self.depth - 1].iter().map(|level| level.from_next.entries() + level.to_next.entries()).sum();
        let smoothed = self.depth - 1 - usize::from(!self.inverse.is_empty());
        let below: usize = self.below[..smoothed].iter().map(|a| 4 * a.entries()).sum();
        2.0 + (ways + below + self.inverse.len()) as f64 / a.entries().max(1) as f64
    }

    /// `c`: what the levels below level `i` make of its residual `r`.
    fn correct(&mut self, i: usize) {
        if i + 1 == self.depth {
            self.levels[i].c.fill(0.0);
            return;
        }
        let (above, below) = self.levels.split_at_mut(i + 1);
        let (here, next) = (&mut above[i], &mut below[0]);
        here.to_next.weigh(&here.r, &mut next.b, |_, sums, b| b.copy_from_slice(sums));
        if i + 2 == self.depth && !self.inverse.is_empty() {
            multiply(&self.inverse, &next.b, &mut next.x);
        } else {
            self.cycle(i + 1);
        }
        let (above, below) = self.levels.split_at_mut(i + 1);
        let (here, next) = (&mut above[i], &below[0]);
        let Level { from_next, c, .. } = here;
        from_next.weigh(&next.x, c, |_, sums, c| c.copy_from_slice(sums));
    }

    /// `x ≈ A⁻¹ b` on level `i`, one of those that are kept here.
    fn cycle(&mut self, i: usize) {
        let a = std::mem::take(&mut self.below[i - 1]);
        let mut x = std::mem::take(&mut self.levels[i].x);
        x.resize(a.rows(), 0.0);
        let Level { b, d, e, .. } = &mut self.levels[i];
        e.resize(a.rows(), 0.0);
        start(d, START, b, a.inverse());
        self.levels[i].descend(&a);
        self.correct(i);
        self.levels[i].ascend(&a, &mut x);
        self.levels[i].x = x;
        self.below[i - 1] = a;
    }
}

impl Level {
    /// Makes the matrix of the next level and the ways to it; whether there is one.
    fn coarsen(&mut self, a: &Sliced, finest: bool, next: &mut Sliced, scratch: &mut Scratch) -> bool {
        let rows = a.rows();
        let Scratch { aggregate, from_next, to_next, work } = scratch;
        if rows <= COARSEST {
            return false;
        }
        let strength = if finest { STRENGTH } else { 0.5 * STRENGTH };
        let count = rows::aggregate(a, strength, aggregate);
        if count == 0 || count as f64 > SLOWEST * rows as f64 {
            return false;
        }
        // Old ways make room for new ones.
        (self.from_next, self.to_next) = (Sliced::default(), Sliced::default());
        from_next.smoothed(a, strength, DAMPING, aggregate, count, work);
        to_next.transpose_of(from_next, count);
        let mut square = Rows::default();
        square.product_of_level(to_next, a, from_next, work);
        square.slice_square(next);
        // The ways take its room.
        drop(square);
        std::mem::take(from_next).slice(&mut self.from_next);
        std::mem::take(to_next).slice(&mut self.to_next);
        true
    }
}

/// `d = step D⁻¹ b`.
fn start(d: &mut [f32], step: f32, b: &[f32], inverse: &[f32]) {
    for_all(d, |at, d| {
        for ((d, b), inverse) in d.iter_mut().zip(&b[at.clone()]).zip(&inverse[at]) {
            *d = step * inverse * b;
        }
    });
}

/// `y = A x` for a dense matrix, row by row.
fn multiply(a: &[f32], x: &[f32], y: &mut Vec<f32>) {
    let n = x.len();
    y.clear();
    y.extend(a.chunks_exact(n).map(|row| {
        let (row, rest) = row.as_chunks::<8>();
        let (x, x_rest) = x.as_chunks::<8>();
        let mut lanes = [0.0f32; 8];
        for (a, x) in row.iter().zip(x) {
            for lane in 0..8 {
                lanes[lane] += a[lane] * x[lane];
            }
        }
        let rest: f32 = rest.iter().zip(x_rest).map(|(a, x)| a * x).sum();
        lanes.iter().sum::<f32>() + rest
    }));
}

/// Replaces a positive definite `n × n` matrix by its inverse, by elimination without exchanges; fails with row and value of a pivot that is
/// not above `least` of its row.
fn invert(n: usize, a: &mut [f64], least: impl Fn(usize) -> f64) -> Result<(), (usize, f64)> {
    let mut pivot_row = vec![0.0; n];
    for k in 0..n {
        let pivot = a[k * n + k];
        if pivot.is_nan() || pivot <= least(k) {
            return Err((k, pivot));
        }
        a[k * n + k] = 1.0;
        for entry in &mut a[k * n..(k + 1) * n] {
            *entry /= pivot;
        }
        pivot_row.copy_from_slice(&a[k * n..(k + 1) * n]);
        for i in (0..n).filter(|&i| i != k) {
            let row = &mut a[i * n..(i + 1) * n];
            let factor = std::mem::replace(&mut row[k], 0.0);
            if factor != 0.0 {
                row.iter_mut().zip(&pivot_row).for_each(|(entry, pivot)| *entry -= factor * pivot);
            }
        }
    }
    Ok(())
}
