//! Gaussian elimination with row pivoting on the dense matrix.

use matrixmultiply::dgemm;
use rayon::prelude::*;

use super::csr::add_scaled;
use super::{CsrMatrix, SolveError};

/// Largest dense matrix that is tried, bytes: 2 GiB, 16 384 unknowns.
pub const DENSE_LIMIT_BYTES: u128 = 1 << 31;

/// Columns that are eliminated one by one.
const NARROW: usize = 8;
/// Eliminated columns that are taken off others at a time.
const BLOCK: usize = 64;
/// Columns a thread takes at a time; the cut is the same for any number of threads, and with it the bits.
const STRIP: usize = 128;

/// `P A = L U` of a dense matrix, in storage that is reused.
///
/// By halves: the left columns are eliminated, what they leave of the right ones follows by products of matrices, and the right
/// ones are eliminated; narrow halves column by column. Source: Toledo, SIAM J. Matrix Anal. Appl. 18 (1997) 1065.
pub(super) struct DenseLu {
    /// Column behind column, `L` (ones on its diagonal) below the diagonal, `U` on and above it.
    lu: Vec<f64>,
    /// The row that row `k` was exchanged with before column `k` was eliminated.
    exchanged: Vec<usize>,
}

impl DenseLu {
    pub(super) fn new() -> Self {
        Self { lu: Vec::new(), exchanged: Vec::new() }
    }

    /// Factorises `a`, with the threads of the surrounding rayon pool.
    pub(super) fn factor(&mut self, a: &CsrMatrix) -> Result<(), SolveError> {
        let n = a.rows();
        let bytes = 8 * n as u128 * n as u128;
        if bytes > DENSE_LIMIT_BYTES {
            return Err(SolveError::TooLarge { rows: n, bytes, limit: DENSE_LIMIT_BYTES });
        }
        self.lu.clear();
        self.lu.resize(n * n, 0.0);
        for i in 0..n {
            let (columns, values) = a.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                self.lu[j as usize * n + i] = value;
            }
        }
        self.exchanged.clear();
        self.exchanged.resize(n, 0);
        eliminate(&mut self.lu, n, 0, &mut self.exchanged);
        let mut origin: Vec<usize> = (0..n).collect();
        self.exchanged.iter().enumerate().for_each(|(k, &row)| origin.swap(k, row));
        (0..n).try_for_each(|k| {
            let (row, pivot) = (origin[k], self.lu[k * n + k]);
            let largest = a.row(row).1.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
            // Rounding leaves pivots of about n ε times the row where exact arithmetic leaves none.
            if pivot.abs() > n as f64 * f64::EPSILON * largest {
                Ok(())
            } else {
                Err(SolveError::Singular { stage: "gauss elimination", row, pivot })
            }
        })
    }

    /// `x += z`, `z = A⁻¹ r` with the last factors.
    pub(super) fn refine(&mut self, r: &[f64], x: &mut [f64], z: &mut [f64]) {
        z.copy_from_slice(r);
        let n = z.len();
        self.exchanged.iter().enumerate().for_each(|(k, &row)| z.swap(k, row));
        // Without unknowns there are no columns of any length.
        let columns = self.lu.chunks(n.max(1)).enumerate();
        for (k, column) in columns.clone() {
            let known = z[k];
            subtract(&mut z[k + 1..], known, &column[k + 1..]);
        }
        for (k, column) in columns.rev() {
            z[k] /= column[k];
            let known = z[k];
            subtract(&mut z[..k], known, &column[..k]);
        }
        add_scaled(x, 1.0, z);
    }
}

/// `y −= factor x`.
fn subtract(y: &mut [f64], factor: f64, x: &[f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y -= factor * x);
}

/// Eliminates `columns` of `n` numbers each, whose rows from `top` on are what is left of them; writes which rows were exchanged.
fn eliminate(columns: &mut [f64], n: usize, top: usize, exchanged: &mut [usize]) {
    let width = exchanged.len();
    if width <= NARROW {
        for k in 0..width {
            let (before, row) = columns.split_at_mut((k + 1) * n);
            let (pivot_row, column) = (top + k, &mut before[k * n..]);
            let largest = |best: usize, i: usize| if column[i].abs() > column[best].abs() { i } else { best };
            let found = (pivot_row..n).fold(pivot_row, largest);
            exchanged[k] = found;
            before.chunks_mut(n).chain(row.chunks_mut(n)).for_each(|column| column.swap(pivot_row, found));
            let column = &mut before[k * n..];
            // A pivot of zero is told of at the end.
            if column[pivot_row] != 0.0 {
                let inverse = 1.0 / column[pivot_row];
                column[pivot_row + 1..].iter_mut().for_each(|entry| *entry *= inverse);
            }
            for other in row.chunks_mut(n) {
                let known = other[pivot_row];
                subtract(&mut other[pivot_row + 1..], known, &column[pivot_row + 1..n]);
            }
        }
        return;
    }
    // Whole blocks to the left, so that products are of blocks.
    let half = (width / 2).next_multiple_of(if width > 2 * BLOCK { BLOCK } else { NARROW });
    let (left, right) = columns.split_at_mut(half * n);
    let (first, second) = exchanged.split_at_mut(half);
    eliminate(left, n, top, first);
    right.par_chunks_mut(STRIP * n).for_each(|strip| {
        exchange(strip, n, top, first);
        (0..half).step_by(BLOCK).for_each(|start| {
            let block = &left[start * n..half.min(start + BLOCK) * n];
            take_off(strip, block, n, top + start);
        });
    });
    eliminate(right, n, top + half, second);
    left.par_chunks_mut(STRIP * n).for_each(|strip| exchange(strip, n, top + half, second));
}

/// Exchanges rows from `top` on of columns of `n` numbers.
fn exchange(columns: &mut [f64], n: usize, top: usize, exchanged: &[usize]) {
    for column in columns.chunks_mut(n) {
        exchanged.iter().enumerate().for_each(|(k, &row)| column.swap(top + k, row));
    }
}

/// Takes what a block of eliminated columns, the first with its pivot in row `top`, makes of other columns off them.
fn take_off(strip: &mut [f64], block: &[f64], n: usize, top: usize) {
    let (width, columns) = (block.len() / n, strip.len() / n);
    let bottom = top + width;
    let mut known = [0.0; BLOCK * STRIP];
    for (other, known) in strip.chunks_mut(n).zip(known.chunks_mut(width)) {
        for (k, column) in block.chunks(n).enumerate() {
            let pivot = other[top + k];
            subtract(&mut other[top + k + 1..bottom], pivot, &column[top + k + 1..bottom]);
        }
        known.copy_from_slice(&other[top..bottom]);
    }
    if bottom == n {
        return;
    }
    let (rows, factors, out) = (n - bottom, &block[bottom..], &mut strip[bottom..]);
    assert!(factors.len() == (width - 1) * n + rows && out.len() == (columns - 1) * n + rows && width * columns <= known.len());
    // SAFETY: the matrices of `rows` × `width` and `rows` × `columns` numbers, a column every `n`, and of `width` × `columns` numbers,
    // a column every `width`, lie within the slices; the one that is written to is borrowed alone.
    unsafe {
        let (factors, known, out) = (factors.as_ptr(), known.as_ptr(), out.as_mut_ptr());
        dgemm(rows, width, columns, -1.0, factors, 1, n as isize, known, 1, width as isize, 1.0, out, 1, n as isize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A matrix of size `n` without structure, entries in (-1, 1).
    fn disordered(n: usize) -> CsrMatrix {
        let mut a = CsrMatrix::default();
        a.assemble(n, |i, row| {
            for j in 0..n {
                let first = ((i * n + j + 1) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                let mixed = (first ^ (first >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                row.push(j, (mixed >> 32) as f64 / 2f64.powi(31) - 1.0);
            }
        });
        a
    }

    /// Sizes at, below and above the widths that columns are taken by. A residual of n ε times the pivots' growth; 1e-9 leaves room for ill conditions.
    #[test]
    fn products_with_the_solution_give_the_right_hand_side() {
        for n in [0, 1, 2, NARROW, NARROW + 1, 2 * BLOCK - 1, 2 * BLOCK, 2 * BLOCK + 1, 333] {
            let a = disordered(n);
            let exact: Vec<f64> = (0..n).map(|i| 1.0 - (i % 7) as f64).collect();
            let (mut b, mut x, mut z) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
            a.multiply(&exact, &mut b);
            let mut lu = DenseLu::new();
            lu.factor(&a).unwrap();
            lu.refine(&b, &mut x, &mut z);
            let worst = x.iter().zip(&exact).fold(0.0f64, |worst, (x, exact)| worst.max((x - exact).abs()));
            assert!(worst < 1e-9, "{n} unknowns: {worst}");
        }
    }
}
