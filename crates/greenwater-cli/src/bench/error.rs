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
    /// No workload of this name.
    #[error("--only is {given}, but must be part of the name of a workload: {}", known.join(", "))]
    NoWorkload {
        /// What was asked for.
        given: String,
        /// What there is.
        known: Vec<&'static str>,
    },
    /// A resolution that the case cannot have.
    #[error("--sizes has {given}, but must hold whole numbers from 10 to 400: spacings that fit into the height of the column")]
    Size {
        /// What was asked for.
        given: u32,
    },
    /// A line of a history that is none.
    #[error("`{}` line {line} is not a result of `greenwater bench`: {problem}; mend or remove the line", path.display())]
    History {
        /// The history.
        path: PathBuf,
        /// Number of the line.
        line: usize,
        /// What is wrong.
        problem: String,
    },
    /// A history without a line.
    #[error("`{}` has no results; let `greenwater bench step --history FILE` add some", path.display())]
    NoHistory {
        /// The history.
        path: PathBuf,
    },
    /// An error that could not be taken from a run.
    #[error("`{quantity}` of {run} could not be measured: {problem}")]
    Measure {
        /// What was to be measured.
        quantity: String,
        /// The run.
        run: String,
        /// Why not.
        problem: String,
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
            Self::Exists { .. } | Self::NoWorkload { .. } | Self::Size { .. } | Self::NoHistory { .. } => 2,
            Self::Run { .. } | Self::Step(_) => 4,
            Self::Io { .. } | Self::History { .. } => 5,
            _ => 1,
        }
    }
}
