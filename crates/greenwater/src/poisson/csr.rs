//! Sparse square matrix in compressed rows.

use std::ops::Range;

use rayon::prelude::*;

use crate::reduce;

/// Rows built or multiplied as one piece of work.
const ROWS: usize = 512;

/// Stored entries from which a product is shared among threads.
const SHARED_ENTRIES: usize = 50_000;

/// Square sparse matrix in compressed rows: column numbers ascend within a row, every row stores its diagonal.
///
/// The storage is reused by the next [`assemble`](Self::assemble). Memory: 12 bytes an entry, twice that while rows of a
/// new matrix are gathered.
#[derive(Clone, Debug, Default)]
pub struct CsrMatrix {
    /// `offsets[i]..offsets[i + 1]` are the entries of row `i`.
    offsets: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
    /// Where the diagonal entry of a row is stored.
    diagonal: Vec<usize>,
    /// Rows as they are gathered, block by block.
    blocks: Vec<Block>,
}

#[derive(Clone, Debug, Default)]
struct Block {
    ends: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
}

/// One row being gathered.
#[derive(Debug)]
pub struct Row<'a> {
    block: &'a mut Block,
    start: usize,
    size: usize,
}

impl Row<'_> {
    /// Adds `value` to the entry in `column`, in any order of columns; ascending order is fastest.
    ///
    /// Repeated entries are summed in the order of the calls, so mirrored and periodic images may push to their owner.
    /// Panics if `column` is not a column of the matrix.
    #[inline]
    pub fn push(&mut self, column: usize, value: f64) {
        assert!(column < self.size, "column {column} of a matrix with {} columns", self.size);
        let column = column as u32;
        let Block { columns, values, .. } = &mut *self.block;
        let mut at = columns.len();
        while at > self.start && columns[at - 1] > column {
            at -= 1;
        }
        if at > self.start && columns[at - 1] == column {
            values[at - 1] += value;
        } else if at == columns.len() {
            columns.push(column);
            values.push(value);
        } else {
            columns.insert(at, column);
            values.insert(at, value);
        }
    }
}

impl CsrMatrix {
    /// Matrix without rows.
    pub fn new() -> Self {
        Self::default()
    }

    /// Replaces the matrix by one of `n` rows; `fill(i, row)` pushes the entries of row `i`.
    ///
    /// Rows are filled in parallel over fixed blocks; a row depends on its own pushes only, so the matrix has the same bits
    /// for any number of threads. A diagonal entry that is never pushed is stored as 0. Nothing is allocated once the
    /// storage has grown to the size of the problem. Panics if `n` does not fit in 32 bits.
    pub fn assemble(&mut self, n: usize, fill: impl Fn(usize, &mut Row) + Sync) {
        assert!(u32::try_from(n).is_ok(), "matrix of {n} rows: column numbers have 32 bits");
        let Self { offsets, columns, values, diagonal, blocks } = self;
        blocks.resize_with(n.div_ceil(ROWS), Block::default);
        blocks.par_iter_mut().enumerate().for_each(|(number, block)| {
            block.ends.clear();
            block.columns.clear();
            block.values.clear();
            for i in number * ROWS..n.min((number + 1) * ROWS) {
                let start = block.columns.len();
                let mut row = Row { block, start, size: n };
                fill(i, &mut row);
                row.push(i, 0.0);
                block.ends.push(block.columns.len());
            }
        });

        offsets.clear();
        columns.clear();
        values.clear();
        diagonal.clear();
        offsets.push(0);
        for block in blocks.iter() {
            let base = columns.len();
            offsets.extend(block.ends.iter().map(|end| base + end));
            columns.extend_from_slice(&block.columns);
            values.extend_from_slice(&block.values);
        }
        for i in 0..n {
            let row = offsets[i]..offsets[i + 1];
            diagonal.push(row.start + columns[row].partition_point(|&j| (j as usize) < i));
        }
    }

    /// Number of rows (and columns).
    pub fn rows(&self) -> usize {
        self.diagonal.len()
    }

    /// Number of stored entries.
    pub fn entries(&self) -> usize {
        self.values.len()
    }

    /// Columns, ascending, and values of row `i`.
    #[inline]
    pub fn row(&self, i: usize) -> (&[u32], &[f64]) {
        let row = self.offsets[i]..self.offsets[i + 1];
        (&self.columns[row.clone()], &self.values[row])
    }

    /// Columns and values of row `i` left of the diagonal.
    #[inline]
    pub(super) fn left(&self, i: usize) -> (&[u32], &[f64]) {
        let left = self.offsets[i]..self.diagonal[i];
        (&self.columns[left.clone()], &self.values[left])
    }

    /// Columns of row `i` right of the diagonal.
    #[inline]
    pub(super) fn right_columns(&self, i: usize) -> &[u32] {
        &self.columns[self.diagonal[i] + 1..self.offsets[i + 1]]
    }

    /// Entry `a_ii`.
    #[inline]
    pub fn diagonal(&self, i: usize) -> f64 {
        self.values[self.diagonal[i]]
    }

    /// Entry `a_ij`, 0 where none is stored.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        let (columns, values) = self.row(i);
        columns.iter().position(|&column| column as usize == j).map_or(0.0, |at| values[at])
    }

    /// `y = A x`. Panics unless both vectors have one entry a row.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
        self.for_rows(x, y, |ax, y| *y = ax);
    }

    /// `r = b − A x`. Panics unless all vectors have one entry a row.
    pub fn residual(&self, x: &[f64], b: &[f64], r: &mut [f64]) {
        r.copy_from_slice(b);
        self.for_rows(x, r, |ax, r| *r -= ax);
    }

    fn for_rows(&self, x: &[f64], y: &mut [f64], set: impl Fn(f64, &mut f64) + Sync) {
        assert!(x.len() == self.rows() && y.len() == self.rows(), "product of a matrix and vectors of another size");
        let rows = |start: usize, y: &mut [f64]| {
            for (i, y) in y.iter_mut().enumerate() {
                let (columns, values) = self.row(start + i);
                let ax: f64 = columns.iter().zip(values).map(|(&j, a)| a * x[j as usize]).sum();
                set(ax, y);
            }
        };
        if self.entries() < SHARED_ENTRIES {
            rows(0, y);
        } else {
            y.par_chunks_mut(ROWS).enumerate().for_each(|(block, y)| rows(block * ROWS, y));
        }
    }

    /// Worst row and value of `|a_ij − a_ji| / √|a_ii a_jj|`, dimensionless; `(0, 0)` for a symmetric matrix.
    pub fn asymmetry(&self) -> (usize, f64) {
        let right = |i: usize| self.diagonal[i] + 1..self.offsets[i + 1];
        let left = |i: usize| self.offsets[i]..self.diagonal[i];
        let (worst, partners) = self.compare(right, left);
        let to_compare: usize = (0..self.rows()).map(|i| left(i).len()).sum();
        if partners == to_compare {
            return worst;
        }
        // Some entries left of the diagonal have no partner.
        let (other, _) = self.compare(left, right);
        if other.1 > worst.1 { other } else { worst }
    }

    /// Compares the entries on one side of the diagonal with those across; answers the worst row with its value, and how many
    /// entries have a partner.
    fn compare(&self, side: impl Fn(usize) -> Range<usize> + Sync, across: impl Fn(usize) -> Range<usize> + Sync) -> ((usize, f64), usize) {
        let row = |i: usize| {
            let (mut worst, mut partners) = (0.0f64, 0);
            for at in side(i) {
                let j = self.columns[at] as usize;
                let opposite = across(j);
                let found = self.columns[opposite.clone()].binary_search(&(i as u32));
                partners += usize::from(found.is_ok());
                let gap = self.values[at] - found.map_or(0.0, |k| self.values[opposite.start + k]);
                if gap != 0.0 {
                    worst = worst.max(gap.abs() / (self.diagonal(i) * self.diagonal(j)).abs().sqrt());
                }
            }
            ((i, worst), partners)
        };
        type Found = ((usize, f64), usize);
        let worse = |x: Found, y: Found| {
            let y_is_worse = y.0.1 > x.0.1 || (y.0.1 == x.0.1 && y.0.0 < x.0.0);
            (if y_is_worse { y.0 } else { x.0 }, x.1 + y.1)
        };
        (0..self.rows()).into_par_iter().with_min_len(4 * ROWS).map(row).reduce(|| ((0, 0.0), 0), worse)
    }

    /// All `n × n` entries, row by row: for tests and small matrices.
    pub fn to_dense(&self) -> Vec<f64> {
        let n = self.rows();
        let mut dense = vec![0.0; n * n];
        for i in 0..n {
            let (columns, values) = self.row(i);
            for (&j, &a) in columns.iter().zip(values) {
                dense[i * n + j as usize] = a;
            }
        }
        dense
    }

    /// First row with an entry that is not finite, and that entry.
    pub(super) fn first_not_finite(&self) -> Option<(usize, f64)> {
        let at = self.values.iter().position(|a| !a.is_finite())?;
        Some((self.offsets.partition_point(|&offset| offset <= at) - 1, self.values[at]))
    }
}

/// `y += s x`.
pub(super) fn add_scaled(y: &mut [f64], s: f64, x: &[f64]) {
    blockwise(y, x, |y, x| *y += s * x);
}

/// `y = x + s y`.
pub(super) fn scale_add(y: &mut [f64], s: f64, x: &[f64]) {
    blockwise(y, x, |y, x| *y = x + s * *y);
}

/// Sets each entry of `y` from the same entry of `x`, shared among threads where vectors are long.
pub(super) fn blockwise(y: &mut [f64], x: &[f64], set: impl Fn(&mut f64, f64) + Sync) {
    const SHARED: usize = 8 * reduce::BLOCK;
    let block = |y: &mut [f64], x: &[f64]| y.iter_mut().zip(x).for_each(|(y, &x)| set(y, x));
    if y.len() < SHARED {
        block(y, x);
    } else {
        y.par_chunks_mut(reduce::BLOCK).zip(x.par_chunks(reduce::BLOCK)).for_each(|(y, x)| block(y, x));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> CsrMatrix {
        let mut a = CsrMatrix::new();
        a.assemble(3, |i, row| match i {
            0 => [(2, 1.0), (0, 4.0), (1, -1.0), (2, 0.5)].iter().for_each(|&(j, v)| row.push(j, v)),
            1 => row.push(0, -1.0),
            _ => [(2, 3.0), (0, 1.5)].iter().for_each(|&(j, v)| row.push(j, v)),
        });
        a
    }

    #[test]
    fn rows_are_sorted_repeated_entries_are_summed_and_the_diagonal_is_always_there() {
        let a = small();
        assert_eq!(a.row(0), (&[0, 1, 2][..], &[4.0, -1.0, 1.5][..]));
        assert_eq!(a.row(1), (&[0, 1][..], &[-1.0, 0.0][..]));
        assert_eq!((a.rows(), a.entries(), a.diagonal(1), a.diagonal(2)), (3, 7, 0.0, 3.0));
        assert_eq!(a.to_dense(), [4.0, -1.0, 1.5, -1.0, 0.0, 0.0, 1.5, 0.0, 3.0]);
        assert_eq!(a.asymmetry(), (0, 0.0));
    }

    #[test]
    fn a_product_is_the_dense_product_and_a_residual_its_complement() {
        let a = small();
        let (x, b) = ([1.0, 2.0, 4.0], [1.0, 1.0, 1.0]);
        let (mut y, mut r) = ([0.0; 3], [0.0; 3]);
        a.multiply(&x, &mut y);
        a.residual(&x, &b, &mut r);
        assert_eq!(y, [8.0, -1.0, 13.5]);
        assert_eq!(r, [-7.0, 2.0, -12.5]);
    }

    #[test]
    fn a_matrix_is_replaced_in_its_own_storage() {
        let mut a = CsrMatrix::new();
        let fill = |i: usize, row: &mut Row| (i.saturating_sub(2)..=i).for_each(|j| row.push(j, 1.0));
        a.assemble(2000, fill);
        let (columns, values) = (a.columns.as_ptr(), a.values.as_ptr());
        a.assemble(1900, fill);
        assert_eq!((a.columns.as_ptr(), a.values.as_ptr()), (columns, values));
        assert_eq!((a.rows(), a.entries()), (1900, 3 * 1900 - 3));
        assert!(a.asymmetry().1 > 0.5, "a lower triangle is not symmetric");
    }

    #[test]
    fn an_entry_that_is_not_finite_is_found_with_its_row() {
        let mut a = CsrMatrix::new();
        a.assemble(4, |i, row| row.push(i, if i == 2 { f64::NAN } else { 1.0 }));
        assert_eq!(a.first_not_finite().map(|(row, _)| row), Some(2));
        assert_eq!(small().first_not_finite(), None);
    }
}
