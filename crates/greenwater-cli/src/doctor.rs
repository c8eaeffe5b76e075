//! `greenwater doctor`.

use clap::Args;
use greenwater::lanes::InstructionSet;
use greenwater::machine::{Machine, memory};
use serde_json::json;

use crate::console;
use crate::error::CliError;

#[derive(Clone, Copy, Debug, Args)]
pub struct DoctorArgs {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// `greenwater doctor`.
pub fn doctor(args: &DoctorArgs) -> Result<(), CliError> {
    let machine = Machine::here();
    let build = if cfg!(debug_assertions) { "debug (slow: build with --release)" } else { "release" };
    let folders = [("temporary folder", std::env::temp_dir()), ("working folder", std::env::current_dir().unwrap_or_else(|_| ".".into()))];
    let writable = folders.map(|(name, path)| {
        let probe = path.join(format!(".greenwater-doctor-{}", std::process::id()));
        let outcome = std::fs::write(&probe, b"").and_then(|()| std::fs::remove_file(&probe));
        (name, path, outcome)
    });
    let threads = rayon::current_num_threads();
    let instructions = InstructionSet::of_this_machine().name();
    if args.json {
        let folders: Vec<_> = writable.iter().map(|(name, path, o)| json!({"name": name, "path": path, "writable": o.is_ok()})).collect();
        return console::print_json(&json!({
            "format": 1, "version": env!("CARGO_PKG_VERSION"), "build": build, "machine": machine, "memory_bytes": memory(),
            "threads": threads, "instructions": instructions, "folders": folders,
        }));
    }
    let mut lines = vec![
        format!("greenwater {}, {build} build", env!("CARGO_PKG_VERSION")),
        format!("system:  {} on {}", machine.os, machine.arch),
        format!("cpu:     {}, {} cores for this process", machine.cpu, machine.cores),
        format!("memory:  {} (a case may use three quarters unless it says limits.memory_gib)", console::bytes(memory())),
        format!("threads: {threads} unless --threads says otherwise"),
        format!("pair loops with {instructions} instructions"),
    ];
    for (name, path, outcome) in &writable {
        let state = outcome.as_ref().map_or_else(|error| format!("cannot be written: {error}"), |()| "writable".to_owned());
        lines.push(format!("{name}: {} ({state})", path.display()));
    }
    console::print(&lines.join("\n"))
}
