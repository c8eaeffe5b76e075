//! Smoothed-aggregation multigrid as a preconditioner for symmetric pressure equations.

mod rows;

use self::rows::Rows;
use super::dense::DenseLu;
use super::{CsrMatrix, SolveError};

/// Rows up to which a level is solved by elimination: its factors then take less work than a sweep over 10⁵ entries.
const COARSEST: usize = 200;

/// Levels at most; each has several times fewer rows than the one above it.
const LEVELS: usize = 20;

/// A level has at most this share of the rows above it; a matrix that falls apart into single rows does not coarsen.
const SLOWEST: f64 = 0.7;

/// Damping of the step that smooths the prolongation: 4/3 over the largest eigenvalue.
const DAMPING: f32 = 4.0 / 3.0;

/// Lowest eigenvalue that smoothing aims at, over the largest. An aggregate spans about four rows of particles, so the next level
/// sees what is slower than a sixteenth of the fastest.
const SMOOTH_FROM: f32 = 1.0 / 12.0;

/// Shift of the diagonal of the coarsest level: pressure of a closed part of the fluid is known up to a constant, and the factors
/// must exist. Single precision does not resolve less.
const COARSE_SHIFT: f64 = 1e-5;

/// One level: `A`, how it is smoothed, and how it hangs on the next.
#[derive(Debug, Default)]
struct Level {
    a: Rows,
    /// `1/Σ_j |a_ij|`.
    inverse: Vec<f32>,
    /// Prolongation from the next level, and its transpose.
    from_next: Rows,
    to_next: Rows,
    /// Aggregate of each row.
    aggregate: Vec<u32>,
    x: Vec<f32>,
    b: Vec<f32>,
    r: Vec<f32>,
    d: Vec<f32>,
}

impl Level {
    /// Diagonal, largest eigenvalue and room for vectors, for the `a` that is there.
    fn prepare(&mut self) {
        let n = self.a.rows();
        self.inverse.clear();
        self.inverse.extend((0..n).map(|i| 1.0 / self.a.sum_of_sizes(i)));
        for vector in [&mut self.x, &mut self.b, &mut self.r, &mut self.d] {
            vector.clear();
            vector.resize(n, 0.0);
        }
    }

    /// `x += q(D⁻¹A) D⁻¹ r` with the Chebyshev polynomial of degree 2 for the upper part of the spectrum; `residual`: `r` follows.
    fn smooth(&mut self, residual: bool) {
        let Self { a, inverse, x, r, d, .. } = self;
        let (middle, half) = (0.5 * (1.0 + SMOOTH_FROM), 0.5 * (1.0 - SMOOTH_FROM));
        let first = half / middle;
        let second = 1.0 / (2.0 * middle / half - first);
        for i in 0..d.len() {
            d[i] = inverse[i] * r[i] / middle;
            x[i] += d[i];
        }
        a.subtract(d, r);
        let (keep, add) = (second * first, 2.0 * second / half);
        for i in 0..d.len() {
            d[i] = keep * d[i] + add * inverse[i] * r[i];
            x[i] += d[i];
        }
        if residual {
            a.subtract(d, r);
        }
    }
}

/// A V-cycle with smoothing by Chebyshev polynomials of degree 2: symmetric and positive, so that conjugate gradients may use it.
///
/// Aggregates are the neighbourhoods of rows that no earlier aggregate touches. The prolongation is piecewise constant smoothed by
/// one step of damped Jacobi, `P = (I − 4/(3 λ) D⁻¹A) T`; coarse operators are `Pᵀ A P`. All in single precision: a preconditioner
/// need not be exact, and half the bytes are half the time. Every sum has one order, whatever the number of threads.
///
/// Sources: Vaněk, Mandel & Brezina, Computing 56 (1996) 179 (smoothed aggregation); Adams, Brezina, Hu & Tuminaro, J. Comput.
/// Phys. 188 (2003) 593 (polynomial smoothing).
pub(super) struct Multigrid {
    levels: Vec<Level>,
    /// Levels in use.
    depth: usize,
    /// `A P` of the level that is being built.
    product: Rows,
    coarse: DenseLu,
    coarse_matrix: CsrMatrix,
    coarse_b: Vec<f64>,
    coarse_x: Vec<f64>,
    coarse_z: Vec<f64>,
}

impl Multigrid {
    pub(super) fn new() -> Self {
        Self {
            levels: Vec::new(),
            depth: 0,
            product: Rows::default(),
            coarse: DenseLu::new(),
            coarse_matrix: CsrMatrix::new(),
            coarse_b: Vec::new(),
            coarse_x: Vec::new(),
            coarse_z: Vec::new(),
        }
    }

    /// Builds all levels for `a`, which has a positive diagonal.
    pub(super) fn build(&mut self, a: &CsrMatrix) -> Result<(), SolveError> {
        if let Some((row, pivot)) = (0..a.rows()).map(|i| (i, a.diagonal(i))).find(|&(_, diagonal)| diagonal <= 0.0) {
            return Err(SolveError::Singular { stage: "multigrid", row, pivot });
        }
        self.level(0).a.copy(a);
        self.depth = 1;
        loop {
            let here = self.depth - 1;
            let level = &mut self.levels[here];
            level.prepare();
            let rows = level.a.rows();
            if rows <= COARSEST || self.depth == LEVELS {
                break;
            }
            let next_rows = rows::aggregate(&level.a, &mut level.aggregate);
            if next_rows == 0 || next_rows as f64 > SLOWEST * rows as f64 {
                break;
            }
            let Level { a, inverse, aggregate, from_next, to_next, .. } = level;
            from_next.smoothed(a, inverse, DAMPING, aggregate);
            to_next.transpose_of(from_next, next_rows);
            self.level(here + 1);
            let (above, below) = self.levels.split_at_mut(here + 1);
            let Level { a, from_next, to_next, .. } = &above[here];
            self.product.product(a, from_next);
            below[0].a.product(to_next, &self.product);
            self.depth += 1;
        }
        self.eliminate()
    }

    /// Factorises the coarsest level where it is small; a large one that does not coarsen is left to its smoother.
    fn eliminate(&mut self) -> Result<(), SolveError> {
        let coarsest = &self.levels[self.depth - 1].a;
        let n = coarsest.rows();
        if n > COARSEST {
            return Ok(());
        }
        self.coarse_matrix.assemble(n, |i, row| {
            let (columns, values) = coarsest.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                let shift = if j as usize == i { 1.0 + COARSE_SHIFT } else { 1.0 };
                row.push(j as usize, shift * f64::from(value));
            }
        });
        for vector in [&mut self.coarse_b, &mut self.coarse_x, &mut self.coarse_z] {
            vector.resize(n, 0.0);
        }
        self.coarse.factor(&self.coarse_matrix)
    }

    /// The storage of level `i`.
    fn level(&mut self, i: usize) -> &mut Level {
        if self.levels.len() <= i {
            self.levels.resize_with(i + 1, Level::default);
        }
        &mut self.levels[i]
    }

    /// `z = M⁻¹ r`: one V-cycle from zero.
    pub(super) fn apply(&mut self, r: &[f64], z: &mut [f64]) {
        // Single precision has the range of residuals of 10³⁸: scaled, it has any.
        let scale = r.iter().fold(0.0f64, |largest, r| largest.max(r.abs()));
        if !(scale > 0.0 && scale.is_finite()) {
            z.copy_from_slice(r);
            return;
        }
        let inverse = 1.0 / scale;
        for (b, r) in self.levels[0].b.iter_mut().zip(r) {
            *b = (inverse * r) as f32;
        }
        self.cycle(0);
        for (z, x) in z.iter_mut().zip(&self.levels[0].x) {
            *z = scale * f64::from(*x);
        }
    }

    /// `x ≈ A⁻¹ b` on level `i`.
    fn cycle(&mut self, i: usize) {
        if i + 1 == self.depth {
            return self.solve_coarsest();
        }
        let (above, below) = self.levels.split_at_mut(i + 1);
        let (here, next) = (&mut above[i], &mut below[0]);
        here.x.fill(0.0);
        here.r.copy_from_slice(&here.b);
        here.smooth(true);
        here.to_next.set(&here.r, &mut next.b, |_, sum| sum);
        self.cycle(i + 1);
        let (above, below) = self.levels.split_at_mut(i + 1);
        let (here, next) = (&mut above[i], &below[0]);
        let Level { from_next, d, x, r, a, .. } = here;
        from_next.set(&next.x, d, |_, sum| sum);
        x.iter_mut().zip(&*d).for_each(|(x, d)| *x += d);
        a.subtract(d, r);
        here.smooth(false);
    }

    fn solve_coarsest(&mut self) {
        let level = &mut self.levels[self.depth - 1];
        if level.a.rows() > COARSEST {
            level.x.fill(0.0);
            level.r.copy_from_slice(&level.b);
            return level.smooth(false);
        }
        self.coarse_b.iter_mut().zip(&level.b).for_each(|(to, &from)| *to = f64::from(from));
        self.coarse_x.fill(0.0);
        self.coarse.refine(&self.coarse_b, &mut self.coarse_x, &mut self.coarse_z);
        level.x.iter_mut().zip(&self.coarse_x).for_each(|(to, &from)| *to = from as f32);
    }
}
