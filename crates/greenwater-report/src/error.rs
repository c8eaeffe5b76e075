//! What can go wrong while a report is made.

use std::path::PathBuf;

use thiserror::Error;

/// Why no report could be written. Files that a failed run left out are no error: the page names them.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The list of runs was empty.
    #[error("no run folder was given; name at least one, such as `runs/dam-break/wcsph`")]
    NoRuns,
    /// The path does not exist.
    #[error("`{}` does not exist; give a folder written by `greenwater run` or `greenwater compare`", path.display())]
    NotFound {
        /// The path as given.
        path: PathBuf,
    },
    /// The path has no `provenance.json`.
    #[error(
        "`{}` is no run folder: `provenance.json` is missing; \
         give a folder written by `greenwater run`, or one method's folder of `greenwater compare`{}",
        path.display(), hint(runs)
    )]
    NotARun {
        /// The path as given.
        path: PathBuf,
        /// Run folders that lie directly inside it.
        runs: Vec<PathBuf>,
    },
    /// A file that every run has cannot be understood.
    #[error("`{}`: {reason}; run the case again, or restore the file from a copy", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it and where.
        reason: String,
    },
    /// The run folder has a format that this program does not know.
    #[error("`{}` has format {format}, but this program reads format 1; use the program that wrote it", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The number found.
        format: u64,
    },
    /// A file could not be read or written.
    #[error("cannot {action} `{}`: {source}", path.display())]
    Io {
        /// `read`, `write` or `create`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The answer of the operating system.
        source: std::io::Error,
    },
    /// A figure could not be turned into pixels.
    #[error("cannot draw `{figure}` as PNG: {reason}")]
    Raster {
        /// Name of the figure.
        figure: String,
        /// What the renderer answered.
        reason: String,
    },
}

fn hint(runs: &[PathBuf]) -> String {
    if runs.is_empty() {
        return String::new();
    }
    let names: Vec<String> = runs.iter().map(|run| format!("`{}`", run.display())).collect();
    format!(" (found inside it: {})", names.join(", "))
}
