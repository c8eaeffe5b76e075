//! `greenwater export`.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use greenwater_report::export::particle_table;
use greenwater_report::run::Run;
use serde_json::json;

use crate::console;
use crate::error::CliError;

#[derive(Clone, Debug, Args)]
pub struct ExportArgs {
    /// Run folder
    run: PathBuf,
    /// Format: csv is a table of particles that `fluid.from_file` reads, vtp a VTK file
    #[arg(long, value_enum)]
    to: Format,
    /// Frame to take, counted from 0, or last
    #[arg(long, value_name = "N", default_value = "last")]
    frame: String,
    /// File to write; left out: particles.csv or particles.vtp in the run folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Add every further field that the frame has to the table
    #[arg(long)]
    all_fields: bool,
    /// Replace a file that is already there
    #[arg(long)]
    force: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Csv,
    Vtp,
}

/// `greenwater export`.
pub fn export(args: &ExportArgs) -> Result<(), CliError> {
    let run = Run::read(&args.run)?;
    let last = run.frames.len().checked_sub(1).ok_or_else(|| CliError::NoFrames { run: args.run.clone() })?;
    let wanted = if args.frame == "last" { Some(last) } else { args.frame.parse().ok() };
    let index = wanted.filter(|&index| index <= last);
    let index = index.ok_or_else(|| CliError::NoFrame { given: args.frame.clone(), last, run: args.run.clone() })?;
    let frame = &run.frames[index];
    let (bytes, name, lost) = match args.to {
        Format::Csv => {
            let table = particle_table(&frame.path, run.provenance.dimension, args.all_fields)?;
            (table.text.into_bytes(), "particles.csv", table.lost)
        }
        Format::Vtp => {
            let read = std::fs::read(&frame.path);
            (read.map_err(|source| CliError::Io { action: "read", path: frame.path.clone(), source })?, "particles.vtp", 0)
        }
    };
    let out = args.out.clone().unwrap_or_else(|| args.run.join(name));
    write_new(&out, &bytes, args.force)?;
    if args.json {
        return console::print_json(&json!({"format": 1, "file": out, "frame": index, "time": frame.time, "lost_left_out": lost}));
    }
    if lost > 0 {
        console::note(&format!("{lost} particles had left the domain and are left out"));
    }
    console::print(&format!("frame {index}, t = {} s: {}", frame.time, out.display()))
}

/// Writes a file that is not there yet, or may be replaced: under a temporary name first.
pub fn write_new(path: &Path, bytes: &[u8], force: bool) -> Result<(), CliError> {
    if path.exists() && !force {
        return Err(CliError::FileExists { path: path.to_owned() });
    }
    let temporary = path.with_added_extension("part");
    let write = || {
        let mut file = std::fs::File::create(&temporary)?;
        file.write_all(bytes)?;
        drop(file);
        std::fs::rename(&temporary, path)
    };
    write().map_err(|source| match source.kind() {
        ErrorKind::NotFound => CliError::Io { action: "write", path: path.parent().unwrap_or(path).to_owned(), source },
        _ => CliError::Io { action: "write", path: path.to_owned(), source },
    })
}
