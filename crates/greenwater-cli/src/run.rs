//! `greenwater run` and `greenwater compare`.

use std::path::{Path, PathBuf};

use clap::Args;
use greenwater::case::{AnySetup, Case};
use greenwater::output::{Existing, Finished, RunFolder, record};
use greenwater::scheme::{MethodName, Preset};
use greenwater::with_setup;
use serde_json::{Value, json};

use crate::console;
use crate::error::CliError;
use crate::progress::{Progress, Show, catch_ctrl_c};
use crate::report;

/// A case and what is changed in it.
#[derive(Clone, Debug, Args)]
pub struct CaseArgs {
    /// Case file, folder with a case.toml, or name of a shipped case
    pub case: String,
    /// Set a key of the case, for example --set fluid.spacing=0.02; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = key_value)]
    pub set: Vec<(String, String)>,
    /// End of the run, s (time.end)
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub end: Option<f64>,
    /// Most steps to make; 0 writes the initial state only (time.max_steps)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub steps: Option<u64>,
}

impl CaseArgs {
    /// Reads the case.
    pub fn load(&self) -> Result<Case, CliError> {
        let mut overrides = self.set.clone();
        overrides.extend(self.end.map(|end| ("time.end".to_owned(), format!("{end:?}").to_lowercase())));
        overrides.extend(self.steps.map(|steps| ("time.max_steps".to_owned(), steps.to_string())));
        Ok(Case::load(&self.case, &overrides)?)
    }
}

/// How a run is made.
#[derive(Clone, Copy, Debug, Args)]
pub struct HowArgs {
    /// Number of threads; left out: one for each core. Results do not depend on it
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Replace a run or report that is already there
    #[arg(long)]
    force: bool,
    /// Print one JSON object at the end, and no progress
    #[arg(long)]
    json: bool,
}

impl HowArgs {
    fn existing(&self) -> Existing {
        if self.force { Existing::Replace } else { Existing::Keep }
    }

    fn show(&self) -> Show {
        if self.json { Show::Nothing } else { Show::Progress }
    }
}

/// Starts as many threads as asked for, or one for each core; this one is the first of them. A loop over particles then begins where it is called: handed to
/// threads apart, it would wait for one of them to wake, dozens of times a step. No other thread may start such a loop while this one waits for it.
pub fn start_threads(threads: Option<usize>) -> Result<(), CliError> {
    if let Some(given) = threads.filter(|given| !(1..=1024).contains(given)) {
        return Err(CliError::Threads { given });
    }
    let given = threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(given).use_current_thread().build_global();
    pool.map_err(|error| CliError::ThreadPool { given, reason: error.to_string() })
}

#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    #[command(flatten)]
    case: CaseArgs,
    /// Method, or method:preset; left out: that of the case
    #[arg(long, value_name = "METHOD", value_parser = method)]
    method: Option<(MethodName, Option<Preset>)>,
    /// Run folder to make; left out: runs/CASE-METHOD
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    how: HowArgs,
}

#[derive(Clone, Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    case: CaseArgs,
    /// Methods, each METHOD or METHOD:PRESET, with commas between; left out: those of the case
    #[arg(long, value_name = "METHODS", value_parser = method, value_delimiter = ',')]
    methods: Vec<(MethodName, Option<Preset>)>,
    /// Folder for the runs and the report; left out: runs/CASE
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    how: HowArgs,
}

/// `greenwater run`.
pub fn run(args: &RunArgs) -> Result<(), CliError> {
    start_threads(args.how.threads)?;
    let mut case = args.case.load()?;
    if let Some((method, preset)) = args.method {
        case = case.with_method(method, preset)?;
    }
    let method = case.sections.method.name.name();
    let out = args.out.clone().unwrap_or_else(|| Path::new("runs").join(format!("{}-{method}", case.name)));
    RunFolder::check(&out, args.how.existing())?;
    let setup = case.checked()?;
    catch_ctrl_c();
    let finished = record_one(&setup, method, &out, &args.how)?;
    if args.how.json {
        console::print_json(&run_json(method, &finished))?;
    } else {
        console::print(&sentence(method, &finished))?;
    }
    match finished.failure {
        None => Ok(()),
        Some(error) => Err(CliError::Run { method: method.to_owned(), source: Box::new(error), folder: finished.folder }),
    }
}

/// `greenwater compare`.
pub fn compare(args: &CompareArgs) -> Result<(), CliError> {
    start_threads(args.how.threads)?;
    let case = args.case.load()?;
    let chosen = if args.methods.is_empty() {
        case.checked()?.compare().methods.iter().map(|&(method, preset)| (method, Some(preset))).collect()
    } else {
        args.methods.clone()
    };
    let cases: Vec<Case> = chosen.iter().map(|&(method, preset)| case.for_method(method, preset)).collect();
    let names = run_names(&cases)?;
    let out = args.out.clone().unwrap_or_else(|| Path::new("runs").join(&case.name));
    let report_folder = out.join("report");
    for name in &names {
        RunFolder::check(&out.join(name), args.how.existing())?;
    }
    report::check_free(&report_folder, args.how.existing())?;
    // Every method is checked before the first one runs.
    let setups = cases.iter().map(Case::checked).collect::<Result<Vec<AnySetup>, _>>()?;
    catch_ctrl_c();

    let mut finished: Vec<Finished> = Vec::new();
    for (setup, name) in setups.iter().zip(&names) {
        let run = record_one(setup, name, &out.join(name), &args.how)?;
        if !args.how.json {
            console::print(&sentence(name, &run))?;
        }
        let stopped = run.failure.as_ref().is_some_and(|error| error.exit_code() == 130);
        finished.push(run);
        if stopped {
            break;
        }
    }
    let folders: Vec<PathBuf> = finished.iter().map(|run| run.folder.clone()).collect();
    let paths = greenwater_report::write_report(&folders, &report_folder)?;
    if args.how.json {
        let runs: Vec<Value> = names.iter().zip(&finished).map(|(name, run)| run_json(name, run)).collect();
        console::print_json(&json!({"format": 1, "runs": runs, "report": {"html": paths.html, "json": paths.json}}))?;
    } else {
        console::print(&format!("report: {}", paths.html.display()))?;
    }
    let failed = names.into_iter().zip(finished).find_map(|(method, run)| run.failure.map(|error| (method, error, run.folder)));
    match failed {
        None => Ok(()),
        Some((method, error, folder)) => Err(CliError::Run { method, source: Box::new(error), folder }),
    }
}

/// Folder names: the method, with its preset where the method stands there twice.
fn run_names(cases: &[Case]) -> Result<Vec<String>, CliError> {
    let entry = |case: &Case| (case.sections.method.name, case.sections.method.preset);
    let name = |(i, case): (usize, &Case)| {
        let (method, preset) = entry(case);
        if cases[..i].iter().any(|other| entry(other) == (method, preset)) {
            return Err(CliError::TwiceTheSame { name: format!("{}:{}", method.name(), preset.name()) });
        }
        let alone = cases.iter().filter(|other| entry(other).0 == method).count() == 1;
        Ok(if alone { method.name().to_owned() } else { format!("{}-{}", method.name(), preset.name()) })
    };
    cases.iter().enumerate().map(name).collect()
}

/// Makes one run, with progress.
fn record_one(setup: &AnySetup, name: &str, out: &Path, how: &HowArgs) -> Result<Finished, CliError> {
    let command: Vec<String> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
    with_setup!(setup, setup => {
        let mut progress = Progress::new(setup, name, how.show());
        Ok(record(setup, setup.simulation(), out, how.existing(), &command, &mut progress)?)
    })
}

/// One line about a run that ended.
fn sentence(name: &str, run: &Finished) -> String {
    let s = &run.summary;
    let state = if s.completed { "done" } else { "ended early" };
    let noise = s.pressure_noise.map(|noise| format!(", pressure noise {noise:.3}")).unwrap_or_default();
    format!(
        "{name}: {state} at t = {:.4} s after {} steps in {}, {} lost{noise}: {}",
        s.end_time,
        s.steps,
        console::duration(s.wall_seconds),
        s.lost_particles,
        run.folder.display()
    )
}

fn run_json(name: &str, run: &Finished) -> Value {
    let failure = run.failure.as_ref();
    json!({
        "format": 1, "name": name, "folder": run.folder, "completed": run.summary.completed,
        "exit_code": failure.map_or(0, |error| error.exit_code()), "error": failure.map(|error| error.to_string()), "summary": run.summary,
    })
}

/// Reads `KEY=VALUE`.
fn key_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) if !key.trim().is_empty() => Ok((key.trim().to_owned(), value.trim().to_owned())),
        _ => Err("write section.key=value, for example fluid.spacing=0.02".to_owned()),
    }
}

/// Reads `METHOD` or `METHOD:PRESET`.
pub fn method(text: &str) -> Result<(MethodName, Option<Preset>), String> {
    let (name, preset) = text.split_once(':').map_or((text, None), |(name, preset)| (name, Some(preset)));
    let known = || MethodName::ALL.iter().map(|method| method.name()).collect::<Vec<_>>().join(", ");
    let method = MethodName::ALL.iter().copied().find(|method| method.name() == name);
    let method = method.ok_or_else(|| format!("no method `{name}`; the methods are {}", known()))?;
    let preset = match preset {
        None => None,
        Some(text) => {
            let found = [Preset::Water, Preset::Paper].into_iter().find(|preset| preset.name() == text);
            Some(found.ok_or_else(|| format!("no preset `{text}`; the presets are water, paper"))?)
        }
    };
    Ok((method, preset))
}
