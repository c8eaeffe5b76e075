//! `greenwater bench`: measures this program on this machine.
//!
//! [`step`], [`lists`] and [`equations`] measure fixed workloads, each beside the plain loop of [`naive`] and the [`ceilings`] of the
//! machine; [`impact`] sets error against time. All of them give [`record`]s, which [`history`] keeps and [`docs`] shows. [`paper`]
//! rebuilds the measurements of the paper.

mod ceilings;
mod docs;
mod equations;
mod error;
mod history;
mod impact;
mod lists;
pub mod memory;
mod naive;
mod paper;
mod record;
mod session;
mod step;
mod watch;
mod workloads;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, Subcommand};

pub use error::BenchError;
use record::{Document, Record};
use session::Session;

use crate::console;
use crate::error::CliError;

/// Measures this program on this machine.
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Clone, Debug, Subcommand)]
enum What {
    /// Neighbour lists of disordered particles, 23 neighbours in 2D and 160 in 3D, beside the plain search
    Neighbors(MeasureArgs),
    /// Pressure equations of disordered particles, 1k to 1M unknowns: Jacobi-CG, IC(0)-CG and multigrid-CG, set-up included
    Poisson(MeasureArgs),
    /// Steps of delta-sph and isph in dam breaks, 1.4k to 1M particles, beside the plain pair loop
    Step(MeasureArgs),
    /// Error against wall time: a dam break on a wall by isph and delta-sph at several resolutions
    Impact(impact::ImpactArgs),
    /// Every figure and table of sections 11-13 of the paper, and a verdict on each of its claims
    Paper(paper::PaperArgs),
    /// Writes the page of the docs from a history, and measures nothing
    Page(PageArgs),
}

/// Where results go.
#[derive(Clone, Debug, Default, Args)]
struct Files {
    /// Writes the results to FILE as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes over what is already there
    #[arg(long)]
    force: bool,
}

impl Files {
    /// Whether the JSON file may be written.
    fn check(&self) -> Result<(), BenchError> {
        self.json.as_deref().map_or(Ok(()), |path| self.check_free(path))
    }

    fn check_free(&self, path: &Path) -> Result<(), BenchError> {
        let in_the_way = match fs::read_dir(path) {
            Ok(mut entries) => entries.next().is_some(),
            Err(_) => path.exists(),
        };
        if in_the_way && !self.force { Err(BenchError::Exists { path: path.to_owned() }) } else { Ok(()) }
    }

    fn write_json(&self, text: &str) -> Result<(), BenchError> {
        self.json.as_ref().map_or(Ok(()), |path| write(path, text))
    }
}

/// Where results are kept.
#[derive(Clone, Debug, Default, Args)]
struct Keep {
    /// Adds a line with the results, machine and commit to FILE
    #[arg(long, value_name = "FILE")]
    history: Option<PathBuf>,
    /// Writes the page of the docs to FILE, from the history if there is one
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
}

impl Keep {
    /// Whether the history can be read and the page be written.
    fn check(&self, files: &Files) -> Result<(), BenchError> {
        if let Some(path) = &self.history {
            history::read(path)?;
        }
        self.docs.as_deref().map_or(Ok(()), |path| files.check_free(path))
    }

    fn keep(&self, document: &Document) -> Result<(), BenchError> {
        let documents = match &self.history {
            Some(path) => {
                history::append(path, document)?;
                history::read(path)?
            }
            None => vec![document.clone()],
        };
        self.docs.as_ref().map_or(Ok(()), |path| docs::write(&documents, path))
    }
}

#[derive(Clone, Debug, Args)]
struct PageArgs {
    /// The history to show
    #[arg(long, value_name = "FILE")]
    history: PathBuf,
    /// The page
    #[arg(long, value_name = "FILE")]
    docs: PathBuf,
    /// Writes over what is already there
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Debug, Args)]
struct MeasureArgs {
    /// The smallest workloads only, with fewer repetitions
    #[arg(long)]
    quick: bool,
    /// Only the workloads whose names contain NAME; may be repeated
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// List the workloads, and measure nothing
    #[arg(long)]
    list: bool,
    /// Numbers of threads, with commas between; left out: one, and all cores
    #[arg(long, value_name = "N,...", value_delimiter = ',')]
    threads: Vec<usize>,
    /// Least number of timed repetitions, 1 to 1000; left out: 5, or 3 with --quick
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: Option<u32>,
    #[command(flatten)]
    keep: Keep,
    #[command(flatten)]
    files: Files,
}

/// How much is measured.
#[derive(Clone, Debug, PartialEq)]
struct Plan {
    quick: bool,
    /// Rising, without doubles.
    threads: Vec<usize>,
    /// Least number of timed repetitions.
    repeats: usize,
    /// Repetitions go on for so long, s.
    seconds: f64,
}

impl MeasureArgs {
    fn plan(&self) -> Result<Plan, CliError> {
        let quick = self.quick;
        let (repeats, seconds) = if quick { (3, 0.05) } else { (5, 0.5) };
        let threads = threads(&self.threads)?;
        Ok(Plan { quick, threads, repeats: self.repeats.map_or(repeats, |n| n as usize), seconds })
    }
}

/// The numbers of threads asked for, rising; without any: one, and all cores.
fn threads(asked: &[usize]) -> Result<Vec<usize>, CliError> {
    if let Some(&given) = asked.iter().find(|n| !(1..=1024).contains(*n)) {
        return Err(CliError::Threads { given });
    }
    let mut threads = match asked {
        [] => vec![1, std::thread::available_parallelism().map_or(1, usize::from)],
        asked => asked.to_vec(),
    };
    threads.sort_unstable();
    threads.dedup();
    Ok(threads)
}

/// Runs `greenwater bench`: progress on standard error, the summary on standard output.
///
/// # Errors
/// Something is in the way and `--force` was not given, a file could not be written, or something could not be measured.
pub fn run(args: &BenchArgs) -> Result<(), CliError> {
    match &args.what {
        What::Neighbors(args) => {
            let names = lists::WORKLOADS.iter().map(|w| (w.name, w.quick));
            measure(args, names, |chosen, plan, session, clock| {
                lists::measure(lists::WORKLOADS.iter().filter(|w| chosen(w.name)), plan, session, clock)
            })
        }
        What::Poisson(args) => {
            let names = equations::WORKLOADS.iter().map(|w| (w.name, w.quick));
            measure(args, names, |chosen, plan, session, clock| {
                equations::measure(equations::WORKLOADS.iter().filter(|w| chosen(w.name)), plan, session, clock)
            })
        }
        What::Step(args) => {
            let names = workloads::FLOWS.iter().map(|w| (w.name, w.quick));
            measure(args, names, |chosen, plan, session, clock| {
                step::measure(workloads::FLOWS.iter().filter(|w| chosen(w.name)), plan, session, clock)
            })
        }
        What::Impact(args) => impact::run(args),
        What::Paper(args) => paper::run(args),
        What::Page(args) => {
            let documents = history::read(&args.history)?;
            if documents.is_empty() {
                return Err(BenchError::NoHistory { path: args.history.clone() }.into());
            }
            Files { json: None, force: args.force }.check_free(&args.docs)?;
            Ok(docs::write(&documents, &args.docs)?)
        }
    }
}

/// What all fixed workloads share: which are chosen, the machine, the table, the files.
fn measure(
    args: &MeasureArgs,
    names: impl Iterator<Item = (&'static str, bool)>,
    work: impl FnOnce(&dyn Fn(&str) -> bool, &Plan, &Session, &Clock) -> Result<Vec<Record>, BenchError>,
) -> Result<(), CliError> {
    let names: Vec<(&str, bool)> = names.collect();
    if let Some(given) = args.only.iter().find(|only| !names.iter().any(|(name, _)| name.contains(only.as_str()))) {
        let known = names.iter().map(|(name, _)| *name).collect();
        return Err(BenchError::NoWorkload { given: given.clone(), known }.into());
    }
    let chosen = |name: &str| {
        let quick = names.iter().any(|(known, quick)| *known == name && *quick);
        if args.only.is_empty() { quick || !args.quick } else { args.only.iter().any(|only| name.contains(only.as_str())) }
    };
    if args.list {
        let line = |(name, quick): &(&str, bool)| if *quick { format!("{name} (quick)") } else { (*name).to_owned() };
        let lines: Vec<String> = names.iter().filter(|(name, _)| chosen(name)).map(line).collect();
        return console::print(&lines.join("\n"));
    }
    let plan = args.plan()?;
    args.files.check()?;
    args.keep.check(&args.files)?;
    let clock = Clock::start();
    let session = Session::here(&plan, &clock)?;
    let records = work(&chosen, &plan, &session, &clock)?;
    finish(records, &session, &args.keep, &args.files)
}

/// Prints, writes and keeps the records of a session.
fn finish(records: Vec<Record>, session: &Session, keep: &Keep, files: &Files) -> Result<(), CliError> {
    let document = Document::new(records, session.extra());
    console::print(&docs::text(&document))?;
    files.write_json(&document.text())?;
    Ok(keep.keep(&document)?)
}

/// Tells on standard error how far things are.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    fn seconds(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }

    fn say(&self, what: &str) {
        console::note(&format!("[{:6.1} s] {what}", self.seconds()));
    }
}

/// Runs `work` in a pool of `threads` threads.
fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T, BenchError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    Ok(pool.install(work))
}

/// Writes a file under a temporary name and renames it; makes its folder.
fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), BenchError> {
    let failed = |action| move |source| BenchError::Io { action, path: path.to_owned(), source };
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed("create the folder of"))?;
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
    fs::write(&temporary, contents).and_then(|()| fs::rename(&temporary, path)).map_err(failed("write"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_written_over_without_force() {
        let folder = tempfile::tempdir().expect("a folder");
        let files = |force| Files { json: None, force };
        files(false).check_free(folder.path()).expect("an empty folder is free");
        let file = folder.path().join("bench.json");
        write(&file, "{}").expect("writable");
        for path in [folder.path(), &file] {
            assert!(matches!(files(false).check_free(path), Err(BenchError::Exists { .. })));
            files(true).check_free(path).expect("force");
        }
    }

    #[test]
    fn threads_rise_and_stand_once() {
        assert_eq!(threads(&[4, 1, 4]).expect("sound"), [1, 4]);
        assert_eq!(threads(&[]).expect("sound")[0], 1);
        assert!(threads(&[0]).is_err() && threads(&[5000]).is_err());
    }
}
