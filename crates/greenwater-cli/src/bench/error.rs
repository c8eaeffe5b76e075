//! What can keep a benchmark from its result.

use std::path::PathBuf;

use greenwater::case::CaseError;
use greenwater::neighbors::SearchError;
use greenwater::poisson::SolveError;
use greenwater::scheme::StepError;
use greenwater::simulation::RunError;
use greenwater_report::plot::PngError;
use thiserror::Error;

/// Why a benchmark has no result.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BenchError {
    /// The output exists.
    #[error("`{}` exists and is not empty; choose another place with `--out` or `--json`, or give `--force` to write over it", path.display())]
    Exists {
        /// What is in the way.
        path: PathBuf,
    },
    /// A file could not be written.
    #[error("cannot {action} `{}`: {source}", path.display())]
    Io {
        /// `write`, or `create the folder of`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The answer of the operating system.
        source: std::io::Error,
    },
    /// A shipped case is not sound.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// The figures are of plane flows.
    #[error("the case `{case}` is not two-dimensional, as those of the paper are")]
    NotPlanar {
        /// Name of the case.
        case: String,
    },
    /// Pairs could not be found.
    #[error("neighbour search: {0}")]
    Search(#[from] SearchError),
    /// A pressure equation could not be solved.
    #[error("pressure equation: {0}")]
    Solve(#[from] SolveError),
    /// The flow that pressure equations are taken from ended early.
    #[error("the flow for the pressure equations: {0}")]
    Step(#[from] StepError),
    /// A timed run ended early.
    #[error("timed run of {method} with {particles} particles: {source}")]
    Run {
        /// Name of the method.
        method: &'static str,
        /// Number of particles.
        particles: usize,
        /// What ended it.
        source: RunError,
    },
    /// No pool of threads.
    #[error("cannot start threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// A figure could not be drawn.
    #[error("cannot draw the figure `{figure}`: {source}")]
    Figure {
        /// Name of the figure.
        figure: String,
        /// What the renderer said.
        source: PngError,
    },
}

impl BenchError {
    /// Exit code of the program: 2 bad usage, 4 instability, 5 input or output, 1 anything else.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Exists { .. } => 2,
            Self::Run { .. } | Self::Step(_) => 4,
            Self::Io { .. } => 5,
            _ => 1,
        }
    }
}
