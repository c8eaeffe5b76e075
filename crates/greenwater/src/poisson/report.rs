//! What a solve answers: a report or an error.

use serde::Serialize;
use thiserror::Error;

/// A solution within its tolerance, and what it cost.
#[derive(Serialize, Clone, Copy, Debug, Default, PartialEq)]
pub struct SolveReport {
    /// Iterations of the method; 0 when the start already was a solution.
    pub iterations: usize,
    /// Relative true residual `|b − A p| / |b|`, computed from `A`, `b` and `p`, dimensionless.
    pub residual: f64,
    /// Relative shift `s` of the diagonal, `(1 + s) a_ii`, with which IC(0) kept its pivots positive; 0 where it had no need.
    pub diagonal_shift: f64,
    /// Wall time of the factorisation or preconditioner, s.
    pub setup_seconds: f64,
    /// Wall time of the whole solve with set-up, s.
    pub seconds: f64,
}

/// Why there is no solution. The start vector may have been overwritten by the last iterate.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum SolveError {
    /// A setting is out of its range.
    #[error("`{key}` of the linear solver is {value}, but must be {rule}")]
    Setting {
        /// Key of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
        /// Its rule.
        rule: &'static str,
    },
    /// The vectors do not fit the matrix.
    #[error("matrix has {rows} rows, but right-hand side has {rhs} entries and the solution {solution}; all must be equal")]
    Shape {
        /// Rows of the matrix.
        rows: usize,
        /// Entries of the right-hand side.
        rhs: usize,
        /// Entries of the solution vector.
        solution: usize,
    },
    /// An input is NaN or infinite.
    #[error("{what} is {value} at row {row}, but must be finite; look for the instability that made it")]
    NotFinite {
        /// Which input: matrix, right-hand side or start vector.
        what: &'static str,
        /// First row where it happens.
        row: usize,
        /// The value.
        value: f64,
    },
    /// Squares of the input leave the range of double precision.
    #[error("the norm of {what} is {value:e}, but its square must be a normal number; scale the equation")]
    OutOfRange {
        /// Which vector.
        what: &'static str,
        /// Its norm as computed.
        value: f64,
    },
    /// A pivot or diagonal entry cannot be divided by.
    #[error(
        "{stage} met pivot {pivot:.1e} in row {row}, too small beside the row to divide by: the matrix is singular or nearly so; \
         give each connected part of the fluid a row with known pressure"
    )]
    Singular {
        /// What was being done.
        stage: &'static str,
        /// Row of the matrix.
        row: usize,
        /// The pivot.
        pivot: f64,
    },
    /// The matrix is less symmetric than the method needs.
    #[error(
        "{stage} needs a symmetric matrix, but entries across the diagonal in row {row} differ by {asymmetry:.1e} of the diagonal \
         (limit {limit:.0e}); choose method `gmres` or `bicgstab` with preconditioner `ilu0` or `jacobi`"
    )]
    NotSymmetric {
        /// CG or IC(0).
        stage: &'static str,
        /// Row of the worst entry.
        row: usize,
        /// Worst `|a_ij − a_ji| / √|a_ii a_jj|`.
        asymmetry: f64,
        /// Largest value allowed.
        limit: f64,
    },
    /// The recurrences of the method cannot continue.
    #[error("{method} broke down after {iterations} iterations at relative residual {residual:.1e}: {reason}; {cure}")]
    Breakdown {
        /// Method.
        method: &'static str,
        /// Iterations done.
        iterations: usize,
        /// Relative true residual before the breakdown.
        residual: f64,
        /// The quantity that failed.
        reason: &'static str,
        /// What to try.
        cure: &'static str,
    },
    /// The iteration limit came first.
    #[error(
        "linear solve stopped at relative residual {residual:.1e} after {iterations} iterations (needed {tolerance:.1e}); \
         try a stronger `preconditioner`, more `max_iterations` or a larger `tolerance`"
    )]
    NotConverged {
        /// Iterations done.
        iterations: usize,
        /// Relative true residual reached.
        residual: f64,
        /// Relative true residual wanted.
        tolerance: f64,
    },
    /// The dense matrix would not fit.
    #[error(
        "Gauss elimination of {rows} unknowns needs {bytes} bytes for its dense matrix (limit {limit}); \
         choose method `gmres`, `cg` or `bicgstab`"
    )]
    TooLarge {
        /// Unknowns.
        rows: usize,
        /// Bytes needed.
        bytes: u128,
        /// Bytes allowed.
        limit: u128,
    },
}
