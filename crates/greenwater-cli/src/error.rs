//! Everything a command can end with, and its exit code.

use std::io;
use std::path::PathBuf;

use greenwater::case::CaseError;
use greenwater::output::OutputError;
use greenwater::simulation::RunError;
use greenwater_report::ReportError;
use thiserror::Error;

/// Why a command ended early.
#[derive(Debug, Error)]
pub enum CliError {
    /// The case.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// The run folder.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The report, the preview or the export.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A measurement.
    #[error(transparent)]
    Bench(#[from] Box<crate::bench::BenchError>),
    /// A validation.
    #[error(transparent)]
    Validate(#[from] crate::validate::ValidateError),
    /// A run ended early; its folder has the details.
    #[error("{method}: {source}; the last good state is the last frame of `{}`", folder.display())]
    Run {
        /// Name of the run.
        method: String,
        /// What happened.
        source: Box<RunError>,
        /// Its folder.
        folder: PathBuf,
    },
    /// A number of threads that cannot be.
    #[error("--threads is {given}, but must be 1 to 1024")]
    Threads {
        /// What was asked for.
        given: usize,
    },
    /// The threads could not be started.
    #[error("cannot start {given} threads: {reason}")]
    ThreadPool {
        /// What was asked for.
        given: usize,
        /// What the system said.
        reason: String,
    },
    /// The same method twice.
    #[error("--methods names {name} twice; name each method once, or with different presets (wcsph:water,wcsph:paper)")]
    TwiceTheSame {
        /// The method.
        name: String,
    },
    /// No shipped case of this name.
    #[error("--case is {given}, but must be a shipped case: {}", known.join(", "))]
    NoShippedCase {
        /// What was asked for.
        given: String,
        /// What there is.
        known: Vec<&'static str>,
    },
    /// A frame that the run does not have.
    #[error("--frame is {given}, but `{}` has frames 0 to {last}; `last` is the newest", run.display())]
    NoFrame {
        /// What was asked for.
        given: String,
        /// Number of the last frame.
        last: usize,
        /// The run.
        run: PathBuf,
    },
    /// A run without any frame.
    #[error("`{}` has no frame to export; the run ended before its first one", run.display())]
    NoFrames {
        /// The run.
        run: PathBuf,
    },
    /// A file is there already.
    #[error("`{}` exists already; name another file, or replace it with --force", path.display())]
    FileExists {
        /// The file.
        path: PathBuf,
    },
    /// A folder is there already, and no report in it.
    #[error("`{}` is there and holds no report of greenwater, which is all that --force replaces; choose another folder with --out", path.display())]
    NotAReport {
        /// The folder.
        path: PathBuf,
    },
    /// A file or folder could not be read or written.
    #[error("cannot {action} `{}`: {source}", path.display())]
    Io {
        /// `read`, `write` or `create`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// No kind of picture that can be drawn.
    #[error("`--out {}` does not say what picture to draw: the name must end in .svg or .png", path.display())]
    NotAPicture {
        /// The file.
        path: PathBuf,
    },
    /// Standard output is closed or full.
    #[error("cannot print: {0}")]
    Print(#[from] io::Error),
}

impl From<crate::bench::BenchError> for CliError {
    fn from(error: crate::bench::BenchError) -> Self {
        Self::Bench(Box::new(error))
    }
}

impl CliError {
    /// Exit code of the program.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Case(error) => error.exit_code(),
            Self::Output(error) => error.exit_code(),
            Self::Bench(error) => error.exit_code(),
            Self::Validate(error) => error.exit_code(),
            Self::Run { source, .. } => source.exit_code(),
            Self::Report(ReportError::Io { .. } | ReportError::NotFound { .. }) | Self::Io { .. } | Self::Print(_) => 5,
            Self::Report(ReportError::Raster { .. }) | Self::ThreadPool { .. } => 1,
            Self::Report(_)
            | Self::Threads { .. }
            | Self::TwiceTheSame { .. }
            | Self::NoShippedCase { .. }
            | Self::NoFrame { .. }
            | Self::NoFrames { .. }
            | Self::FileExists { .. }
            | Self::NotAPicture { .. }
            | Self::NotAReport { .. } => 2,
        }
    }
}
