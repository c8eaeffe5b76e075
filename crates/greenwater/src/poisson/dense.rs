//! Gaussian elimination with row pivoting on the dense matrix.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::lu::partial_pivoting::{factor, solve};
use faer::perm::PermRef;
use faer::{Mat, MatMut, Par};

use super::csr::add_scaled;
use super::{CsrMatrix, SolveError};

/// Largest dense matrix that is tried, bytes: 2 GiB, 16 384 unknowns.
pub const DENSE_LIMIT_BYTES: u128 = 1 << 31;

/// Parts of the work, and so the most threads that can help.
const PARTS: usize = 32;

/// `P A = L U` of a dense matrix, in storage that is reused.
///
/// Work is always cut into [`PARTS`] parts, whatever threads there are to take them: how the library cuts it decides the
/// order of its sums, so a cut by the number of threads would change the bits.
pub(super) struct DenseLu {
    /// `L` below the diagonal, `U` on and above it.
    lu: Mat<f64>,
    permutation: Vec<usize>,
    inverse: Vec<usize>,
    scratch: MemBuffer,
}

impl DenseLu {
    pub(super) fn new() -> Self {
        Self { lu: Mat::new(), permutation: Vec::new(), inverse: Vec::new(), scratch: MemBuffer::new(StackReq::EMPTY) }
    }

    /// Factorises `a`, with the threads of the surrounding rayon pool.
    pub(super) fn factor(&mut self, a: &CsrMatrix) -> Result<(), SolveError> {
        let n = a.rows();
        let bytes = 8 * n as u128 * n as u128;
        if bytes > DENSE_LIMIT_BYTES {
            return Err(SolveError::TooLarge { rows: n, bytes, limit: DENSE_LIMIT_BYTES });
        }
        if self.lu.nrows() != n {
            self.lu = Mat::zeros(n, n);
            self.permutation = vec![0; n];
            self.inverse = vec![0; n];
            let factoring = factor::lu_in_place_scratch::<usize, f64>(n, n, parts(), Default::default());
            let solving = solve::solve_in_place_scratch::<usize, f64>(n, 1, parts());
            self.scratch = MemBuffer::new(factoring.or(solving));
        }
        self.lu.fill(0.0);
        for i in 0..n {
            let (columns, values) = a.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                self.lu[(i, j as usize)] = value;
            }
        }
        factor::lu_in_place(
            self.lu.as_mut(),
            &mut self.permutation,
            &mut self.inverse,
            parts(),
            MemStack::new(&mut self.scratch),
            Default::default(),
        );
        (0..n).try_for_each(|k| {
            let (row, pivot) = (self.permutation[k], self.lu[(k, k)]);
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
        let permutation = PermRef::new_checked(&self.permutation, &self.inverse, n);
        solve::solve_in_place(
            self.lu.as_ref(),
            self.lu.as_ref(),
            permutation,
            MatMut::from_column_major_slice_mut(z, n, 1),
            parts(),
            MemStack::new(&mut self.scratch),
        );
        add_scaled(x, 1.0, z);
    }
}

fn parts() -> Par {
    Par::rayon(PARTS)
}
