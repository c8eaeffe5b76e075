//! `greenwater validate`: the shipped validation cases against their references and bands.
//!
//! [`suite`] is what the cases say, [`measure`] takes the quantities from run folders, [`record`] is the table and the JSON, [`page`]
//! the page of the docs. A case is data; no method is treated on its own.

mod error;
pub mod measure;
mod page;
mod record;
pub mod suite;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use greenwater::case::Case;
use greenwater::output::{Existing, RunFolder, record as record_run};
use greenwater::scheme::{MethodName, Preset};
use greenwater::with_setup;

pub use error::ValidateError;
use measure::{Band, Reading};
use record::{Outcome, Results};
use suite::{Bands, CASES, Measure, Quantity, RunPlan, Shipped};

use crate::console;
use crate::error::CliError;
use crate::progress::{Progress, Show, catch_ctrl_c};
use crate::run::method;

#[derive(Clone, Debug, Args)]
pub struct ValidateArgs {
    /// Validation cases; left out: all (see --list)
    names: Vec<String>,
    /// Method, or method:preset; may be repeated; left out: the default methods
    #[arg(long = "method", value_name = "METHOD", value_parser = method)]
    methods: Vec<(MethodName, Option<Preset>)>,
    /// List the cases with their runs, and run nothing
    #[arg(long)]
    list: bool,
    /// Only the short runs
    #[arg(long)]
    quick: bool,
    /// Write the results to FILE as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the page of the docs to FILE
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
    /// Take results of earlier calls (--json) into the results, and run nothing but what is named; may be repeated
    #[arg(long, value_name = "FILE")]
    from: Vec<PathBuf>,
    /// Keep the run folders in DIR; left out: they are removed once measured
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Measure finished runs that are already in --out instead of making them again
    #[arg(long, requires = "out")]
    reuse: bool,
    /// Number of threads; left out: one for each core. Results do not depend on it
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Replace runs and files that are already there
    #[arg(long)]
    force: bool,
}

/// The methods that run where none is named: the default of each family.
const DEFAULT_METHODS: [MethodName; 2] = [MethodName::Isph, MethodName::DeltaSph];

/// `greenwater validate`.
pub fn validate(args: &ValidateArgs) -> Result<(), CliError> {
    let cases = chosen(&args.names)?;
    if args.list {
        return list(&cases, args.quick);
    }
    for file in args.json.iter().chain(&args.docs) {
        if file.exists() && !args.force {
            return Err(CliError::FileExists { path: file.clone() });
        }
    }
    crate::run::start_threads(args.threads)?;
    let mut results = Results::default();
    for path in &args.from {
        results.take_in(Results::read(path)?);
    }
    if args.from.is_empty() || !args.names.is_empty() {
        catch_ctrl_c();
        let methods = match &args.methods[..] {
            [] => DEFAULT_METHODS.map(|method| (method, None)).to_vec(),
            named => named.to_vec(),
        };
        for shipped in left_to_run(&cases, &methods, args)? {
            results.take_in(run_case(shipped, &methods, args)?);
        }
    }
    console::print(&results.table())?;
    if let Some(path) = &args.json {
        write(path, &format!("{:#}\n", results.json()))?;
    }
    if let Some(path) = &args.docs {
        write(path, &page::page(&results))?;
    }
    let missed = results.missed();
    if missed > 0 { Err(ValidateError::Missed { missed, all: results.banded() }.into()) } else { Ok(()) }
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    crate::export::write_new(path, text.as_bytes(), true)
}

/// The cases of which a run is left for these methods, with a word about each named one that is passed over.
fn left_to_run(
    cases: &[&'static Shipped],
    methods: &[(MethodName, Option<Preset>)],
    args: &ValidateArgs,
) -> Result<Vec<&'static Shipped>, CliError> {
    let (mut left, mut passed_over) = (Vec::new(), Vec::new());
    for &shipped in cases {
        let bands = shipped.read()?;
        if planned(&bands, args.quick).any(|run| methods.iter().any(|&(method, _)| run.makes(method))) {
            left.push(shipped);
        } else {
            passed_over.push(shipped.name);
        }
    }
    if left.is_empty() {
        return Err(ValidateError::NothingToRun { cases: passed_over }.into());
    }
    for name in passed_over.iter().filter(|_| !args.names.is_empty()) {
        console::note(&format!("{name}: passed over, no run of it is short enough for --quick; leave --quick out to run it"));
    }
    Ok(left)
}

/// The runs of a case; with `quick` the short ones.
fn planned(bands: &Bands, quick: bool) -> impl Iterator<Item = &RunPlan> {
    bands.run.iter().filter(move |run| run.quick || !quick)
}

/// The cases with these names, in the order of the list; all without names.
fn chosen(names: &[String]) -> Result<Vec<&'static Shipped>, CliError> {
    if let Some(given) = names.iter().find(|name| CASES.iter().all(|case| case.name != **name)) {
        let known = CASES.iter().map(|case| case.name).collect();
        return Err(ValidateError::NoCase { given: given.clone(), known }.into());
    }
    Ok(CASES.iter().filter(|case| names.is_empty() || names.iter().any(|name| name == case.name)).collect())
}

fn list(cases: &[&'static Shipped], quick: bool) -> Result<(), CliError> {
    let width = cases.iter().map(|case| case.name.len()).max().unwrap_or(0);
    let mut lines = Vec::new();
    for case in cases {
        let bands = case.read()?;
        let runs: Vec<String> =
            planned(&bands, quick).map(|run| format!("{}{}", run.name, if run.quick { " (quick)" } else { "" })).collect();
        if runs.is_empty() {
            continue;
        }
        lines.push(format!("{:width$}  {}; runs: {}", case.name, bands.title, runs.join(", ")));
    }
    console::print(&lines.join("\n"))
}

/// One method on one run of a case.
struct Made<'a> {
    run: &'a str,
    method: MethodName,
    /// The method and its preset, as tables name it.
    label: String,
    reading: Result<Reading, String>,
}

fn run_case(shipped: &'static Shipped, methods: &[(MethodName, Option<Preset>)], args: &ValidateArgs) -> Result<Results, CliError> {
    let bands = shipped.read()?;
    let kept = args.out.clone();
    let base = kept.clone().unwrap_or_else(|| std::env::temp_dir().join(format!("greenwater-validate-{}", std::process::id())));
    let mut made = Vec::new();
    for run in planned(&bands, args.quick) {
        let set: Vec<(String, String)> = run.set.iter().map(|(key, value)| (key.clone(), value.to_string())).collect();
        let mut case = Case::parse(&format!("validation/{}/case.toml", shipped.name), shipped.case.to_owned(), None, &set)?;
        shipped.name.clone_into(&mut case.name);
        for &(method, preset) in methods.iter().filter(|(method, _)| run.makes(*method)) {
            let label = match preset {
                Some(preset) => format!("{}-{}", method.name(), preset.name()),
                None => method.name().to_owned(),
            };
            let folder = base.join(shipped.name).join(&run.name).join(&label);
            let finished = folder.join("DONE").exists() || folder.join("FAILED.json").exists();
            if !(args.reuse && finished) {
                make(&case.for_method(method, preset), &format!("{} {} {label}", shipped.name, run.name), &folder, args)?;
            }
            made.push(Made { run: &run.name, method, label, reading: Reading::of(&folder, &bands) });
        }
    }
    let results = measure_all(shipped, &bands, &made);
    if kept.is_none() {
        // What the system does not let go of now it will clear itself: a temporary folder.
        let _ = fs::remove_dir_all(&base);
    }
    Ok(results)
}

/// Makes one run. A run that fails is no error: its folder says so.
fn make(case: &Case, label: &str, folder: &Path, args: &ValidateArgs) -> Result<(), CliError> {
    let existing = if args.force || args.out.is_none() || args.reuse { Existing::Replace } else { Existing::Keep };
    RunFolder::check(folder, existing)?;
    let setup = case.checked()?;
    let command: Vec<String> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
    let finished = with_setup!(&setup, setup => {
        let mut progress = Progress::new(setup, label, Show::Progress);
        record_run(setup, setup.simulation(), folder, existing, &command, &mut progress)?
    });
    match finished.failure {
        // Ctrl-C ends the whole validation.
        Some(error) if error.exit_code() == 130 => {
            Err(CliError::Run { method: label.to_owned(), source: Box::new(error), folder: finished.folder })
        }
        _ => Ok(()),
    }
}

/// Every quantity of every run and method.
fn measure_all(shipped: &'static Shipped, bands: &Bands, made: &[Made]) -> Results {
    // Values by quantity, run and method, for those that are made of others.
    let mut known: BTreeMap<(String, String, String), f64> = BTreeMap::new();
    let mut results = Results::default();
    for quantity in &bands.quantity {
        let several = quantity.runs.len() != 1 && bands.run.len() > 1;
        let owes = |method: MethodName| quantity.methods.is_empty() || quantity.methods.contains(&method);
        for made in made.iter().filter(|made| owes(made.method) && belongs(quantity, bands, made.run)) {
            let name = if several && !across(quantity) { format!("{} ({})", quantity.name, made.run) } else { quantity.name.clone() };
            let outcome = one(shipped, quantity, made, &known);
            if let Outcome { value: Some(value), .. } = outcome {
                known.insert((quantity.name.clone(), made.run.to_owned(), made.label.clone()), value);
            }
            results.add(shipped.name, &made.label, made.run, &name, quantity, outcome);
        }
    }
    // Agreement of methods needs the values of all of them.
    results.between_methods(shipped.name, bands, &known);
    results
}

/// Whether the quantity compares runs: it is measured once a method, with the run it leads to.
fn across(quantity: &Quantity) -> bool {
    matches!(quantity.measure, Measure::Order { .. } | Measure::Change { .. })
}

fn belongs(quantity: &Quantity, bands: &Bands, run: &str) -> bool {
    match &quantity.measure {
        Measure::Order { fine, .. } => fine == run,
        Measure::Change { to, .. } => to == run,
        Measure::Methods { .. } => false,
        _ if quantity.runs.is_empty() => bands.run.iter().any(|plan| plan.name == run),
        _ => quantity.runs.iter().any(|name| name == run),
    }
}

fn one(shipped: &Shipped, quantity: &Quantity, made: &Made, known: &BTreeMap<(String, String, String), f64>) -> Outcome {
    let nothing = |problem: String| Outcome { problem: Some(problem), ..Outcome::default() };
    let reading = match &made.reading {
        Ok(reading) => reading,
        Err(problem) => return nothing(problem.clone()),
    };
    let other = |name: &str, run: &str| {
        let key = (name.to_owned(), run.to_owned(), made.label.clone());
        known.get(&key).copied().ok_or_else(|| format!("`{name}` was not measured in run `{run}`"))
    };
    let measured = match (&quantity.measure, reading.failure()) {
        (_, Some(problem)) => Err(problem),
        (Measure::Order { of, coarse, fine, ratio }, None) => other(of, coarse)
            .and_then(|coarse| Ok((coarse, other(of, fine)?)))
            .map(|(coarse, fine)| measure::Measured { value: (coarse.abs() / fine.abs()).ln() / ratio.ln(), reference: None }),
        (Measure::Change { of, from, to }, None) => other(of, from)
            .and_then(|from| Ok((from, other(of, to)?)))
            .map(|(from, to)| measure::Measured { value: ((from - to) / to).abs(), reference: None }),
        (Measure::Ratio { of, over }, None) => other(of, made.run)
            .and_then(|of| Ok((of, other(over, made.run)?)))
            .map(|(of, over)| measure::Measured { value: of / over, reference: None }),
        (measure, None) => reading.measure(measure, shipped.tables),
    };
    let own = measured.as_ref().ok().and_then(|measured| measured.reference);
    let band = match Band::of(quantity, reading, own) {
        Ok(band) => band,
        Err(problem) => return nothing(problem),
    };
    let (value, problem) = match measured {
        Ok(measured) => (Some(measured.value), None),
        Err(problem) => (None, Some(problem)),
    };
    Outcome { value, band, problem, seconds: reading.seconds(), pass: band.holds(value) }
}
