//! Reports from run folders: one self-contained HTML page, SVG and PNG figures, and `report.json`.
//!
//! This crate knows only the files of a run folder; it never sees the solver. [`write_report`] is all that a
//! program needs:
//!
//! ```no_run
//! # fn main() -> Result<(), greenwater_report::ReportError> {
//! use std::path::{Path, PathBuf};
//! let runs = [PathBuf::from("runs/dam-break/wcsph"), PathBuf::from("runs/dam-break/isph-paper")];
//! let paths = greenwater_report::write_report(&runs, Path::new("runs/dam-break/report"))?;
//! println!("{}", paths.html.display());
//! # Ok(())
//! # }
//! ```
//!
//! [`run`] reads, [`measure`] reduces series to numbers, [`words`] says what the numbers mean, [`flow`] and
//! [`plot`] draw, [`page`] lays out, [`report`] puts the parts together. The last three are open to other
//! programs that want tables and plots in the same hand.

mod error;
pub mod export;
pub mod flow;
mod lettering;
pub mod measure;
pub mod page;
pub mod plot;
pub mod report;
pub mod run;
pub mod words;

pub use error::ReportError;
pub use plot::png;
pub use report::{ReportPaths, write_report};
