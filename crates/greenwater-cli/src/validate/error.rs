//! Why a validation could not be made.

use thiserror::Error;

/// Why a validation could not be made.
#[derive(Debug, Error)]
pub enum ValidateError {
    /// No such case.
    #[error("no validation case `{given}`; there are {}", known.join(", "))]
    NoCase {
        /// What was asked for.
        given: String,
        /// What there is.
        known: Vec<&'static str>,
    },
    /// Every case was left out.
    #[error("--quick leaves nothing to run, for there is no short run of {}; leave --quick out", cases.join(", "))]
    NothingToRun {
        /// The cases.
        cases: Vec<&'static str>,
    },
    /// The bands of a case do not hold what they should.
    #[error("validation/{case}/bands.toml: {problem}")]
    Bands {
        /// The case.
        case: String,
        /// What is wrong.
        problem: String,
    },
    /// A results file that cannot be used.
    #[error("`{}` holds no results of `greenwater validate --json`: {problem}", path.display())]
    Results {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// Values outside their bands.
    #[error("{missed} of {all} quantities are outside their bands")]
    Missed {
        /// Outside.
        missed: usize,
        /// Measured, of those with a band.
        all: usize,
    },
}

impl ValidateError {
    /// Exit code of the program: 3 outside a band, 2 bad usage.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Missed { .. } => 3,
            Self::NoCase { .. } | Self::NothingToRun { .. } | Self::Results { .. } => 2,
            Self::Bands { .. } => 1,
        }
    }
}
