//! `greenwater new`.

use std::path::PathBuf;

use clap::Args;
use greenwater::case::shipped_cases;
use greenwater::output::OutputError;

use crate::console;
use crate::error::CliError;

#[derive(Clone, Debug, Args)]
pub struct NewArgs {
    /// Folder to make
    name: PathBuf,
    /// Shipped case to start from
    #[arg(long, value_name = "CASE", default_value = "dam-break")]
    case: String,
}

/// What the shipped cases say of the method: they repeat the paper. One that names its preset or keys stays as it is.
const OF_THE_PAPER: &str = "[method]\nname = \"wcsph\"\n\n";
/// What a case of one's own begins with: the default of the key, whose pressure can be used.
const TO_BEGIN_WITH: &str = "[method]\nname = \"delta-sph\"            # `greenwater methods` lists all\n\n";

/// `greenwater new`.
pub fn new(args: &NewArgs) -> Result<(), CliError> {
    let shipped = shipped_cases().iter().find(|case| case.name == args.case).ok_or_else(|| CliError::NoShippedCase {
        given: args.case.clone(),
        known: shipped_cases().iter().map(|case| case.name).collect(),
    })?;
    let io = |action, path: &PathBuf| {
        let path = path.clone();
        move |source| CliError::Io { action, path, source }
    };
    if let Some(parent) = args.name.parent() {
        std::fs::create_dir_all(parent).map_err(io("create", &args.name))?;
    }
    std::fs::create_dir(&args.name).map_err(|source| match source.kind() {
        std::io::ErrorKind::AlreadyExists => OutputError::InTheWay { path: args.name.clone() }.into(),
        _ => io("create", &args.name)(source),
    })?;
    let case = shipped.case.replacen(OF_THE_PAPER, TO_BEGIN_WITH, 1);
    for (file, text) in [("case.toml", case.as_str()), ("README.md", shipped.readme)] {
        let path = args.name.join(file);
        std::fs::write(&path, text).map_err(io("write", &path))?;
    }
    let name = args.name.display();
    console::print(&format!("{name}/case.toml is yours to edit; try\n  greenwater check {name}\n  greenwater compare {name}"))
}
