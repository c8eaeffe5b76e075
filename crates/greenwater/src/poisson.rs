//! The pressure equation as linear algebra: solve `A p = b`.
//!
//! [`CsrMatrix`] holds the rows, [`LinearSolver`] solves by the method and preconditioner of its [`SolverSettings`] and
//! answers with a [`SolveReport`] or a [`SolveError`]. Nothing here knows about particles; units are the caller's.
//!
//! Every result has the same bits for any number of threads: matrix rows are gathered, sums run over fixed blocks
//! ([`crate::reduce`]), and triangular solves keep the order of terms in a row whichever rows run at once. Threads are
//! those of the surrounding rayon pool; a pool of one thread gives the serial solver.

mod aggregates;
mod csr;
mod dense;
mod krylov;
mod multigrid;
mod preconditioner;
pub mod projection;
mod report;
mod settings;
mod sliced;
mod solver;
mod thrift;

pub use aggregates::Aggregates;
pub use csr::{CsrMatrix, Row};
pub use dense::DENSE_LIMIT_BYTES;
pub use report::{SolveError, SolveReport};
pub use settings::{PreconditionerKind, SolverMethod, SolverSettings};
pub use sliced::{Arms, Sliced, SlicedRow};
pub use solver::LinearSolver;
