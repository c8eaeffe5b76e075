//! `greenwater report`.

use std::path::{Path, PathBuf};

use clap::Args;
use greenwater::output::{Existing, OutputError};
use serde_json::{Value, json};

use crate::console;
use crate::error::CliError;

#[derive(Clone, Debug, Args)]
pub struct ReportArgs {
    /// Run folders, or the folder of a comparison
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Folder for the report; left out: report/ beside several runs, or inside a single one
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace a report that is already there
    #[arg(long)]
    force: bool,
    /// Print the paths as one JSON object
    #[arg(long)]
    json: bool,
}

/// `greenwater report`.
pub fn report(args: &ReportArgs) -> Result<(), CliError> {
    let runs: Vec<PathBuf> = args.runs.iter().flat_map(|path| runs_in(path)).collect();
    let out = args.out.clone().unwrap_or_else(|| match runs.as_slice() {
        [only] => only.join("report"),
        several => several[0].parent().unwrap_or(Path::new(".")).join("report"),
    });
    check_free(&out, if args.force { Existing::Replace } else { Existing::Keep })?;
    let paths = greenwater_report::write_report(&runs, &out)?;
    if args.json {
        console::print_json(&json!({"format": 1, "html": paths.html, "json": paths.json, "figures": paths.figures}))
    } else {
        console::print(&format!("report: {}", paths.html.display()))
    }
}

/// The run folder itself, or those directly inside the folder of a comparison, in the order they were made.
fn runs_in(path: &Path) -> Vec<PathBuf> {
    let is_run = |path: &Path| path.join("provenance.json").is_file();
    if is_run(path) {
        return vec![path.to_owned()];
    }
    let inside = std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut runs: Vec<PathBuf> = inside.filter(|path| is_run(path)).collect();
    let started = |run: &PathBuf| {
        let text = std::fs::read(run.join("provenance.json")).unwrap_or_default();
        let value: Value = serde_json::from_slice(&text).unwrap_or_default();
        (value["started"].as_str().unwrap_or_default().to_owned(), run.clone())
    };
    runs.sort_by_cached_key(started);
    // A folder without runs goes on as it is: the report says what is wrong with it.
    if runs.is_empty() { vec![path.to_owned()] } else { runs }
}

/// Whether a report may be written to `path`: it is free, or holds a report that may be replaced.
pub fn check_free(path: &Path, existing: Existing) -> Result<(), CliError> {
    // What is left of a report that was interrupted as it began: the first of its files under its temporary name.
    let just_begun = |name: &str| name.starts_with(".report.json.") && name.ends_with(".tmp");
    let empty =
        std::fs::read_dir(path).is_ok_and(|entries| entries.flatten().all(|entry| just_begun(&entry.file_name().to_string_lossy())));
    let path = path.to_owned();
    match existing {
        _ if !path.exists() || empty => Ok(()),
        _ if !is_report(&path) => Err(CliError::NotAReport { path }),
        Existing::Keep => Err(OutputError::Exists { path }.into()),
        Existing::Replace => Ok(()),
    }
}

/// Whether `path` holds a report of this program, or the beginning of one: `report.json` is its first file.
fn is_report(path: &Path) -> bool {
    let text = std::fs::read(path.join("report.json")).unwrap_or_default();
    serde_json::from_slice::<Value>(&text).is_ok_and(|value| value["format"] == 1 && value["methods"].is_array())
}
