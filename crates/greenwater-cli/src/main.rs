//! The `greenwater` command: parses what is asked, calls the library or the report, prints.

mod bench;
mod check;
mod console;
mod doctor;
mod error;
mod export;
mod lists;
mod new;
mod progress;
mod report;
mod run;
mod validate;

use clap::{Parser, Subcommand};

use error::CliError;

/// Violent free-surface flow by particle methods: run a case, compare methods on it, report.
///
/// CASE is a case file, a folder with a case.toml, or the name of a shipped case (see `greenwater cases`).
#[derive(Debug, Parser)]
#[command(name = "greenwater", version, propagate_version = true, max_term_width = 110, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done; 1 other failure; 2 bad usage or case; 3 outside a band; 4 instability; 5 input/output; \
                          7 over a resource limit; 130 stopped by Ctrl-C";

#[derive(Debug, Subcommand)]
enum Command {
    /// Write a commented case folder that runs unedited
    New(new::NewArgs),
    /// Check a case without running it: geometry, particles, memory, disk, steps, time, and a preview picture
    Check(check::CheckArgs),
    /// Run one method and write a new run folder
    Run(run::RunArgs),
    /// Run several methods from the same initial particles, then write the report that compares them
    Compare(run::CompareArgs),
    /// Run the shipped validation cases against their references and bands
    Validate(validate::ValidateArgs),
    /// Measure this program on this machine: neighbour search, pressure solvers, steps, error against time, and the whole paper
    Bench(bench::BenchArgs),
    /// Rebuild the report of run folders from what they hold
    Report(report::ReportArgs),
    /// Convert a frame of a run: a table of particles that a case can start from, or a single VTK file
    Export(export::ExportArgs),
    /// List the shipped cases, or every key a case may have
    Cases(lists::CasesArgs),
    /// List the methods
    Methods(lists::ListArgs),
    /// List the kernels
    Kernels(lists::ListArgs),
    /// Describe this program and machine: text to paste into an issue
    Doctor(doctor::DoctorArgs),
}

fn main() -> std::process::ExitCode {
    let cli = Cli::parse();
    let outcome = match &cli.command {
        Command::New(args) => new::new(args),
        Command::Check(args) => check::check(args),
        Command::Run(args) => run::run(args),
        Command::Compare(args) => run::compare(args),
        Command::Validate(args) => validate::validate(args),
        Command::Bench(args) => bench::run(args),
        Command::Report(args) => report::report(args),
        Command::Export(args) => export::export(args),
        Command::Cases(args) => lists::cases(args),
        Command::Methods(args) => lists::methods(args),
        Command::Kernels(args) => lists::kernels(args),
        Command::Doctor(args) => doctor::doctor(args),
    };
    match outcome {
        Ok(()) => std::process::ExitCode::SUCCESS,
        // Whoever read the output has seen enough.
        Err(CliError::Print(error)) if error.kind() == std::io::ErrorKind::BrokenPipe => std::process::ExitCode::SUCCESS,
        Err(error) => {
            console::note(&format!("error: {error}"));
            error.exit_code().into()
        }
    }
}
