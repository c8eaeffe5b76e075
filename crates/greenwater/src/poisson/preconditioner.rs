//! Preconditioners: approximate inverses that are cheap to build and to apply.

use std::ops::Range;

use rayon::prelude::*;

use super::csr::blockwise;
use super::multigrid::Multigrid;
use super::sliced::{Arms, Sliced};
use super::{CsrMatrix, PreconditionerKind, SolveError};

/// First shift tried when IC(0) loses a pivot; it doubles until all pivots are kept.
const FIRST_SHIFT: f64 = 1e-3;

/// Largest shift tried.
const LAST_SHIFT: f64 = 1e3;

/// Part of the diagonal below which a pivot of IC(0) counts as lost.
const LOST_PIVOT: f64 = 1e-8;

/// Mean entries in a level from which sharing a level among threads is worth it. On two cores levels of 16 000 entries broke
/// even with one thread; smaller ones, that is all in 2D and 3D up to some 10⁵ rows, lost.
const LEVEL_ENTRIES: usize = 32_768;

/// `z = M⁻¹ r` for the preconditioner of a kind, in storage that is reused.
pub(super) struct Preconditioner {
    kind: PreconditionerKind,
    /// Jacobi: inverse of the diagonal. ILU(0), IC(0): inverse of the pivots.
    inverse: Vec<f64>,
    lower: Strict,
    upper: Strict,
    forward: Sweep,
    backward: Sweep,
    /// One dense row; zero between uses by IC(0).
    row: Vec<f64>,
    /// Room for a sweep.
    swept: Vec<f64>,
    multigrid: Multigrid,
    /// What multigrid smooths: the matrix of the build.
    sliced: Sliced,
}

impl Preconditioner {
    pub(super) fn new(kind: PreconditionerKind) -> Self {
        Self {
            kind,
            inverse: Vec::new(),
            lower: Strict::default(),
            upper: Strict::default(),
            forward: Sweep::default(),
            backward: Sweep::default(),
            row: Vec::new(),
            swept: Vec::new(),
            multigrid: Multigrid::default(),
            sliced: Sliced::default(),
        }
    }

    /// Builds `M` for `a`; the answer is the relative shift of the diagonal that IC(0) needed.
    pub(super) fn build(&mut self, a: &CsrMatrix) -> Result<f64, SolveError> {
        let n = a.rows();
        match self.kind {
            PreconditionerKind::None => return Ok(0.0),
            PreconditionerKind::Jacobi => {
                self.inverse.clear();
                for i in 0..n {
                    let pivot = a.diagonal(i);
                    if pivot == 0.0 {
                        return Err(SolveError::Singular { stage: "jacobi", row: i, pivot });
                    }
                    self.inverse.push(1.0 / pivot);
                }
                return Ok(0.0);
            }
            PreconditionerKind::Multigrid => {
                self.sliced.fill(n, &mut Arms::<0>::default(), |i, row| {
                    let (columns, values) = a.row(i);
                    for (&j, &value) in columns.iter().zip(values).filter(|&(&j, _)| j as usize != i) {
                        row.push(j as usize, -value as f32, []);
                    }
                    a.diagonal(i)
                });
                return self.multigrid.build(&self.sliced).map(|()| 0.0);
            }
            PreconditionerKind::Ilu0 | PreconditionerKind::Ic0 => {}
        }
        self.row.clear();
        self.row.resize(n, 0.0);
        self.swept.resize(n, 0.0);
        let shift = if self.kind == PreconditionerKind::Ilu0 { self.factor_lu(a)? } else { self.factor_cholesky(a)? };
        let level_entries = (rayon::current_num_threads() > 1).then_some(LEVEL_ENTRIES);
        self.forward.arrange(&self.lower, 0..n, level_entries);
        self.backward.arrange(&self.upper, (0..n).rev(), level_entries);
        Ok(shift)
    }

    /// Builds multigrid for `a`, which stays the caller's.
    pub(super) fn build_below(&mut self, a: &Sliced) -> Result<(), SolveError> {
        self.multigrid.build(a)
    }

    /// `z = M⁻¹ r` by multigrid for `a`.
    pub(super) fn apply_to(&mut self, a: &Sliced, r: &[f64], z: &mut [f64]) {
        self.multigrid.apply(a, r, z);
    }

    /// Work of an iteration of conjugate gradients with multigrid for `a`, in products with it.
    pub(super) fn products(&self, a: &Sliced) -> f64 {
        1.0 + self.multigrid.products(a)
    }

    /// `z = M⁻¹ r`.
    pub(super) fn apply(&mut self, r: &[f64], z: &mut [f64]) {
        match self.kind {
            PreconditionerKind::None => z.copy_from_slice(r),
            PreconditionerKind::Multigrid => self.multigrid.apply(&self.sliced, r, z),
            PreconditionerKind::Jacobi => {
                z.copy_from_slice(r);
                blockwise(z, &self.inverse, |z, inverse| *z *= inverse);
            }
            PreconditionerKind::Ilu0 | PreconditionerKind::Ic0 => {
                // Forward (I + L) y = r, scaling z = D⁻¹ y, backward (I + U) z = z.
                z.copy_from_slice(r);
                self.forward.solve_in_place(z, &mut self.swept);
                blockwise(z, &self.inverse, |z, inverse| *z *= inverse);
                self.backward.solve_in_place(z, &mut self.swept);
            }
        }
    }

    /// ILU(0): `A ≈ (I + L) D (I + U)`, fill outside the pattern of `A` dropped; no shift.
    fn factor_lu(&mut self, a: &CsrMatrix) -> Result<f64, SolveError> {
        let Self { inverse, lower, upper, row, .. } = self;
        inverse.clear();
        lower.clear();
        upper.clear();
        for i in 0..a.rows() {
            // Fill outside the pattern of this row also lands in `row`, but is never read: a later row sets its whole
            // pattern first.
            let (columns, values) = a.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                row[j as usize] = value;
            }
            let (left, _) = a.left(i);
            for &k in left {
                let k = k as usize;
                let (columns, values) = upper.row(k);
                let eliminated = row[k];
                for (&j, value) in columns.iter().zip(values) {
                    row[j as usize] -= eliminated * value;
                }
                row[k] = eliminated * inverse[k];
            }
            let pivot = row[i];
            let largest = values.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
            if pivot.is_nan() || pivot.abs() <= f64::EPSILON * largest {
                return Err(SolveError::Singular { stage: "ilu0", row: i, pivot });
            }
            inverse.push(1.0 / pivot);
            lower.push_row(left, |j| row[j]);
            upper.push_row(a.right_columns(i), |j| row[j] / pivot);
        }
        Ok(0.0)
    }

    /// IC(0): `A + s diag(A) ≈ (I + L) D (I + L)ᵀ` with all of `D` positive, from the lower triangle of `A`.
    fn factor_cholesky(&mut self, a: &CsrMatrix) -> Result<f64, SolveError> {
        if let Some((row, pivot)) = (0..a.rows()).map(|i| (i, a.diagonal(i))).find(|&(_, diagonal)| diagonal <= 0.0) {
            return Err(SolveError::Singular { stage: "ic0", row, pivot });
        }
        let mut shift = 0.0;
        while let Err((row, pivot)) = self.try_cholesky(a, shift) {
            if shift > LAST_SHIFT {
                return Err(SolveError::Singular { stage: "ic0", row, pivot });
            }
            shift = if shift == 0.0 { FIRST_SHIFT } else { 2.0 * shift };
        }
        self.upper.transpose_of(&self.lower);
        Ok(shift)
    }

    /// Fails with the row and value of a lost pivot.
    fn try_cholesky(&mut self, a: &CsrMatrix, shift: f64) -> Result<(), (usize, f64)> {
        let Self { inverse, lower, row, .. } = self;
        inverse.clear();
        lower.clear();
        for i in 0..a.rows() {
            // `row` holds l_ij d_j, and 0 outside the pattern.
            let (left, values) = a.left(i);
            for (&j, &value) in left.iter().zip(values) {
                row[j as usize] = value;
            }
            for &k in left {
                let (columns, values) = lower.row(k as usize);
                let known: f64 = columns.iter().zip(values).map(|(&j, l)| l * row[j as usize]).sum();
                row[k as usize] -= known;
            }
            let shifted = (1.0 + shift) * a.diagonal(i);
            let mut pivot = shifted;
            for &j in left {
                let j = j as usize;
                pivot -= row[j] * row[j] * inverse[j];
            }
            lower.push_row(left, |j| row[j] * inverse[j]);
            for &j in left {
                row[j as usize] = 0.0;
            }
            if pivot.is_nan() || pivot <= LOST_PIVOT * shifted {
                return Err((i, pivot));
            }
            inverse.push(1.0 / pivot);
        }
        Ok(())
    }
}

/// Rows of a strictly triangular matrix.
#[derive(Debug, Default)]
struct Strict {
    /// Ends of the rows.
    ends: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
}

impl Strict {
    fn clear(&mut self) {
        self.ends.clear();
        self.columns.clear();
        self.values.clear();
    }

    fn rows(&self) -> usize {
        self.ends.len()
    }

    fn range(&self, i: usize) -> Range<usize> {
        (if i == 0 { 0 } else { self.ends[i - 1] })..self.ends[i]
    }

    #[inline]
    fn row(&self, i: usize) -> (&[u32], &[f64]) {
        let range = self.range(i);
        (&self.columns[range.clone()], &self.values[range])
    }

    fn push_row(&mut self, columns: &[u32], value: impl Fn(usize) -> f64) {
        self.columns.extend_from_slice(columns);
        self.values.extend(columns.iter().map(|&j| value(j as usize)));
        self.ends.push(self.columns.len());
    }

    /// Replaces `self` by the transpose of `other`.
    fn transpose_of(&mut self, other: &Strict) {
        let (n, entries) = (other.rows(), other.columns.len());
        self.columns.resize(entries, 0);
        self.values.resize(entries, 0.0);
        // Starts of the rows; the filling below moves each to the end of its row.
        self.ends.clear();
        self.ends.resize(n + 1, 0);
        other.columns.iter().for_each(|&j| self.ends[j as usize + 1] += 1);
        (0..n).for_each(|i| self.ends[i + 1] += self.ends[i]);
        self.ends.pop();
        for i in 0..n {
            let (columns, values) = other.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                let at = &mut self.ends[j as usize];
                self.columns[*at] = i as u32;
                self.values[*at] = value;
                *at += 1;
            }
        }
    }
}

/// Solves `(I + T) y = r` for a strictly triangular `T`, with its rows stored in the order in which they are solved.
///
/// One thread goes through the rows of the matrix in their order, or backwards. For threads the rows are sorted by level:
/// a row depends on rows of lower levels only, so the rows of a level may run at once. The terms of a row keep their
/// order, so both ways give the same bits.
#[derive(Debug, Default)]
struct Sweep {
    /// Row of the matrix at a place in the order.
    order: Vec<u32>,
    /// Place of a row of the matrix.
    place: Vec<u32>,
    /// Rows in the order; their columns are places.
    rows: Strict,
    /// Ends of the levels in the order; empty for a sweep on one thread.
    levels: Vec<usize>,
}

impl Sweep {
    /// Stores `triangle`; `natural` is an order in which each row comes after those it depends on.
    ///
    /// Rows are sorted by level where a level then has `level_entries` entries in the mean, else kept in the natural order.
    fn arrange(&mut self, triangle: &Strict, natural: impl Iterator<Item = usize> + Clone, level_entries: Option<usize>) {
        let (n, entries) = (triangle.rows(), triangle.columns.len());
        let Self { order, place, rows, levels } = self;
        order.clear();
        order.extend(natural.clone().map(|i| i as u32));
        levels.clear();
        place.resize(n, 0);
        if let Some(least) = level_entries
            && entries >= 2 * least
        {
            // Level of a row, kept in `place` for the moment, and ends of the levels by counting.
            for i in natural.clone() {
                let level = triangle.row(i).0.iter().map(|&j| place[j as usize] + 1).max().unwrap_or(0);
                place[i] = level;
                if levels.len() <= level as usize {
                    levels.resize(level as usize + 1, 0);
                }
                levels[level as usize] += 1;
            }
            if entries >= least * levels.len() {
                let mut start = 0;
                for end in levels.iter_mut() {
                    (*end, start) = (start, start + *end);
                }
                for i in natural {
                    let end = &mut levels[place[i] as usize];
                    order[*end] = i as u32;
                    *end += 1;
                }
            } else {
                levels.clear();
            }
        }
        for (at, &i) in order.iter().enumerate() {
            place[i as usize] = at as u32;
        }
        rows.clear();
        for &i in order.iter() {
            let (columns, values) = triangle.row(i as usize);
            rows.columns.extend(columns.iter().map(|&j| place[j as usize]));
            rows.values.extend_from_slice(values);
            rows.ends.push(rows.columns.len());
        }
    }

    /// Replaces `r`, passed in `y`, by the solution; `solved` is room for as many numbers.
    fn solve_in_place(&self, y: &mut [f64], solved: &mut [f64]) {
        let unknown = |at: usize, y: &[f64], done: &[f64]| {
            let (columns, values) = self.rows.row(at);
            let known: f64 = columns.iter().zip(values).map(|(&j, t)| t * done[j as usize]).sum();
            y[self.order[at] as usize] - known
        };
        if self.levels.is_empty() {
            for at in 0..solved.len() {
                solved[at] = unknown(at, y, &solved[..at]);
            }
        } else {
            let mut start = 0;
            for &end in &self.levels {
                let (done, level) = solved[..end].split_at_mut(start);
                let y = &*y;
                level.par_iter_mut().enumerate().with_min_len(128).for_each(|(k, solved)| {
                    *solved = unknown(start + k, y, done);
                });
                start = end;
            }
        }
        for (&i, &value) in self.order.iter().zip(solved.iter()) {
            y[i as usize] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Wide bands with holes: many levels of different width, columns of both neighbours and far rows.
    fn lower(n: usize) -> Strict {
        let mut lower = Strict::default();
        for i in 0..n {
            let columns: Vec<u32> = (0..i).filter(|j| (i - j) % 37 == 11 || (i - j) == 200).map(|j| j as u32).collect();
            lower.push_row(&columns, |j| 0.3 / (1.0 + ((i * 31 + j) % 7) as f64));
        }
        lower
    }

    #[test]
    fn a_sweep_by_levels_has_the_bits_of_a_sweep_by_rows() {
        let n = 3000;
        let lower = lower(n);
        let mut upper = Strict::default();
        upper.transpose_of(&lower);
        let r: Vec<f64> = (0..n).map(|i| (i as f64 * 0.37).sin()).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let solve = |sweep: &Sweep| {
            let (mut y, mut room) = (r.clone(), vec![0.0; n]);
            pool.install(|| sweep.solve_in_place(&mut y, &mut room));
            y
        };
        let (mut by_rows, mut by_levels) = (Sweep::default(), Sweep::default());
        by_rows.arrange(&lower, 0..n, None);
        by_levels.arrange(&lower, 0..n, Some(1));
        assert!(by_levels.levels.len() > 10 && by_rows.levels.is_empty());
        assert_eq!(solve(&by_rows), solve(&by_levels));
        by_rows.arrange(&upper, (0..n).rev(), None);
        by_levels.arrange(&upper, (0..n).rev(), Some(1));
        assert!(!by_levels.levels.is_empty());
        assert_eq!(solve(&by_rows), solve(&by_levels));
    }

    #[test]
    fn a_transpose_swaps_rows_and_columns() {
        let n = 300;
        let lower = lower(n);
        let (mut upper, mut back) = (Strict::default(), Strict::default());
        upper.transpose_of(&lower);
        back.transpose_of(&upper);
        assert_eq!((&back.ends, &back.columns, &back.values), (&lower.ends, &lower.columns, &lower.values));
        assert!((0..n).all(|i| upper.row(i).0.iter().all(|&j| j as usize > i)));
    }
}
