//! `bench impact`: error against time. The dam break on a wall of the validation suite at several resolutions, by `isph` and
//! `delta-sph`; errors as the suite measures them, against the converged inviscid solution.

use std::path::{Path, PathBuf};

use clap::Args;
use greenwater::case::{AnySetup, Case};
use greenwater::output::{Existing, record as record_run};
use greenwater::scheme::MethodName;
use greenwater::with_setup;
use greenwater_report::plot::{Axis, LinePlot, Series, png_from_svg};
use serde_json::{Map, Value, json};

use super::record::{Record, Seconds};
use super::session::Session;
use super::watch::Watch;
use super::{BenchError, Clock, Files, Keep, Plan, finish, threads, with_threads, write};
use crate::error::CliError;
use crate::progress::{Progress, Show, catch_ctrl_c};
use crate::run::method;
use crate::validate::measure::Reading;
use crate::validate::suite::{Bands, CASES, Shipped};

#[derive(Clone, Debug, Args)]
pub struct ImpactArgs {
    /// Particles over the height of the column, with commas between; left out: 20,40,80,160
    #[arg(long, value_name = "N,...", value_delimiter = ',')]
    sizes: Vec<u32>,
    /// Only H/dx = 20
    #[arg(long)]
    quick: bool,
    /// Methods, with commas between; left out: isph,delta-sph
    #[arg(long, value_name = "METHOD,...", value_parser = method, value_delimiter = ',')]
    methods: Vec<(MethodName, Option<greenwater::scheme::Preset>)>,
    /// Numbers of threads, with commas between; left out: 1, as the runs of interFoam had
    #[arg(long, value_name = "N,...", value_delimiter = ',')]
    threads: Vec<usize>,
    /// Folder for the figures, SVG and PNG
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    keep: Keep,
    #[command(flatten)]
    files: Files,
}

/// The case.
const CASE: &str = "dam-break-impact";
/// The sensors, by their height.
pub const SENSORS: [&str; 4] = ["0.01H", "0.05H", "0.1H", "0.267H"];
/// Height of the column, m.
const HEIGHT: f64 = 0.6;

/// A run of interFoam.
struct Foam {
    /// Cells over the height of the column.
    cells: u32,
    /// Wall time of a second of flow, s.
    seconds: f64,
    /// Errors of the impulse and of the plateau at the sensors, percent of the reference.
    errors: [[f64; 4]; 2],
}

/// Where the numbers of interFoam come from.
pub const FOAM_ORIGIN: &str = "OpenFOAM 1912 interFoam, volume of fluid, 2D, laminar, slip walls, Courant number 0.5, one core of a 2-core AMD EPYC \
                               (Zen 4): 10 s and 93 s of wall time for 1.6 s of flow, and 587 s for 1.04 s; measured by this project once, \
                               not in the run of the other rows";

/// interFoam on the same case.
const FOAM: [Foam; 3] = [
    Foam { cells: 20, seconds: 10.0 / 1.6, errors: [[-11.0, 8.0, 24.0, -9.0], [-3.0, 4.0, 9.0, -12.0]] },
    Foam { cells: 40, seconds: 93.0 / 1.6, errors: [[-2.0, 8.0, 15.0, 27.0], [-2.0, 2.0, 5.0, 3.0]] },
    Foam { cells: 80, seconds: 587.0 / 1.04, errors: [[2.0, 5.0, 9.0, 18.0], [1.0, 3.0, 5.0, -6.0]] },
];

/// The impulse from 2.3 to 3.4 and the mean pressure from 3.5 to 4.3 `sqrt(H/g)`: key and name of the quantity in the suite.
pub const MEASURES: [(&str, &str); 2] = [("impulse", "impulse at"), ("plateau", "plateau at")];

/// `greenwater bench impact`.
pub fn run(args: &ImpactArgs) -> Result<(), CliError> {
    let sizes = match args.sizes[..] {
        [] if args.quick => vec![20],
        [] => vec![20, 40, 80, 160],
        ref sizes => sizes.to_vec(),
    };
    if let Some(&given) = sizes.iter().find(|size| !(10..=400).contains(*size)) {
        return Err(BenchError::Size { given }.into());
    }
    let methods = match args.methods[..] {
        [] => vec![(MethodName::Isph, None), (MethodName::DeltaSph, None)],
        ref methods => methods.to_vec(),
    };
    let threads = if args.threads.is_empty() { vec![1] } else { threads(&args.threads)? };
    args.files.check()?;
    args.keep.check(&args.files)?;
    if let Some(out) = &args.out {
        args.files.check_free(out)?;
    }
    let shipped = shipped()?;
    let bands = shipped.read()?;
    let clock = Clock::start();
    let plan = Plan { quick: args.quick, threads: threads.clone(), repeats: 1, seconds: 0.0 };
    let session = Session::here(&plan, &clock)?;
    catch_ctrl_c();
    let mut records = Vec::new();
    for &size in &sizes {
        for &(method, preset) in &methods {
            for &threads in &threads {
                let case = Case::parse(CASE, case(shipped, size), None, &[]).map_err(BenchError::from)?.for_method(method, preset);
                records.push(measure(&case.checked().map_err(BenchError::from)?, method, size, threads, &bands, &clock)?);
            }
        }
    }
    let references = references(&bands)?;
    records.extend(FOAM.iter().map(|foam| foam_record(foam, &references)));
    if let Some(out) = &args.out {
        let rows: Vec<&Record> = records.iter().collect();
        write_figures(&rows, out)?;
    }
    finish(records, &session, &args.keep, &args.files)
}

fn shipped() -> Result<&'static Shipped, BenchError> {
    let found = CASES.iter().find(|case| case.name == CASE);
    found.ok_or_else(|| BenchError::Measure { quantity: "the case".into(), run: CASE.into(), problem: "it is not shipped".into() })
}

/// The text of the case with `size` particles over the height of the column. Where they do not fit into the tank of the case, its length
/// is the whole number of spacings nearest to the 5.366 H of the experiment.
fn case(shipped: &Shipped, size: u32) -> String {
    let dx = HEIGHT / f64::from(size);
    let spacing = |text: String| text.replace("spacing = 0.015 ", &format!("spacing = {dx:?} "));
    if size.is_multiple_of(40) {
        return spacing(shipped.case.to_owned());
    }
    let length = (5.366 * f64::from(size)).round() * dx;
    let thick = 3.0 * dx;
    let text = shipped.case.replace("3.225", &format!("{length:?}")).replace("3.27,", &format!("{:?},", length + thick));
    spacing(text.replace("-0.045", &format!("{:?}", -thick)))
}

/// One run, and its errors.
fn measure(setup: &AnySetup, method: MethodName, size: u32, threads: usize, bands: &Bands, clock: &Clock) -> Result<Record, CliError> {
    let label = format!("{CASE} H/dx = {size} {}", method.name());
    let folder = std::env::temp_dir().join(format!("greenwater-impact-{}-{}-{size}-{threads}", std::process::id(), method.name()));
    let command: Vec<String> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
    let (finished, lap) = with_threads(threads, || {
        let watch = Watch::start();
        let finished = with_setup!(setup, setup => {
            let mut progress = Progress::new(setup, &label, Show::Progress);
            record_run(setup, setup.simulation(), &folder, Existing::Replace, &command, &mut progress)
        });
        finished.map(|finished| (finished, watch.lap()))
    })??;
    if let Some(error) = finished.failure.filter(|error| error.exit_code() == 130) {
        return Err(CliError::Run { method: label, source: Box::new(error), folder });
    }
    let reading = Reading::of(&folder, bands);
    // What the system does not let go of now it will clear itself: a temporary folder.
    let _ = std::fs::remove_dir_all(&folder);
    let (seconds, end) = (lap.seconds(threads), finished.summary.end_time);
    let mut extra = Map::from_iter([
        ("h_over_dx".to_owned(), json!(size)),
        ("steps".to_owned(), json!(finished.summary.steps)),
        ("flow_time".to_owned(), json!(end)),
        ("wall_seconds".to_owned(), json!(lap.wall)),
        ("processor_share".to_owned(), json!(lap.share(threads))),
    ]);
    match reading.and_then(|reading| reading.failure().map_or(Ok(reading), Err)) {
        Ok(reading) => {
            for (key, quantity) in MEASURES {
                let mut values = [[0.0; 2]; 4];
                for (value, sensor) in values.iter_mut().zip(SENSORS) {
                    *value = read(&reading, bands, &format!("{quantity} {sensor}"), &label)?;
                }
                insert_errors(&mut extra, key, &values);
            }
        }
        Err(problem) => drop(extra.insert("problem".into(), json!(problem))),
    }
    let said = |key: &str| extra.get(key).and_then(Value::as_f64).map_or("none".to_owned(), |error| format!("{:.1} %", 100.0 * error));
    clock.say(&format!(
        "{label}, {threads} threads: {:.1} s for a second of flow, error of the impulse {}, of the plateau {}",
        seconds / end,
        said("impulse_error"),
        said("plateau_error")
    ));
    Ok(Record {
        bench: "impact".into(),
        workload: format!("{CASE}-{size}"),
        method: method.name().into(),
        dimension: 2,
        particles: setup.estimate().fluid + setup.estimate().walls,
        threads,
        seconds: Some(Seconds::of(&[seconds / end])),
        repetitions: 1,
        extra,
        ..Record::default()
    })
}

/// A quantity of the suite and its reference.
fn read(reading: &Reading, bands: &Bands, name: &str, run: &str) -> Result<[f64; 2], BenchError> {
    let failed = |problem: String| BenchError::Measure { quantity: name.to_owned(), run: run.to_owned(), problem };
    let quantity = bands.quantity.iter().find(|quantity| quantity.name == name).ok_or_else(|| failed("the suite lacks it".into()))?;
    let value = reading.measure(&quantity.measure, &[]).map_err(failed)?.value;
    let reference = quantity.reference.as_ref().ok_or_else(|| failed("it has no reference".into()))?;
    Ok([value, reading.number(reference).map_err(failed)?])
}

/// References of the impulse and the plateau at the sensors.
fn references(bands: &Bands) -> Result<[[f64; 4]; 2], BenchError> {
    let mut references = [[0.0; 4]; 2];
    for (row, (_, quantity)) in references.iter_mut().zip(MEASURES) {
        for (reference, sensor) in row.iter_mut().zip(SENSORS) {
            let name = format!("{quantity} {sensor}");
            let found = bands.quantity.iter().find(|quantity| quantity.name == name).and_then(|quantity| quantity.reference.as_ref());
            *reference = match found {
                Some(crate::validate::suite::Number::Plain(value)) => *value,
                _ => return Err(BenchError::Measure { quantity: name, run: CASE.into(), problem: "it has no plain reference".into() }),
            };
        }
    }
    Ok(references)
}

/// Relative errors at each sensor, and over all of them: `Σ |value − reference| / Σ reference`, so that a sensor counts as much as it feels.
fn insert_errors(extra: &mut Map<String, Value>, key: &str, values: &[[f64; 2]; 4]) {
    let errors: Vec<f64> = values.iter().map(|[value, reference]| value / reference - 1.0).collect();
    let missed: f64 = values.iter().map(|[value, reference]| (value - reference).abs()).sum();
    let all: f64 = values.iter().map(|[_, reference]| reference).sum();
    extra.insert(key.to_owned(), json!(errors));
    extra.insert(format!("{key}_error"), json!(missed / all));
}

fn foam_record(foam: &Foam, references: &[[f64; 4]; 2]) -> Record {
    let mut extra = Map::from_iter([("h_over_dx".to_owned(), json!(foam.cells)), ("origin".to_owned(), json!(FOAM_ORIGIN))]);
    for (((key, _), errors), references) in MEASURES.iter().zip(&foam.errors).zip(references) {
        let values = std::array::from_fn(|i| [references[i] * (1.0 + 0.01 * errors[i]), references[i]]);
        insert_errors(&mut extra, key, &values);
    }
    Record {
        bench: "impact".into(),
        workload: format!("{CASE}-{}", foam.cells),
        method: "interFoam".into(),
        dimension: 2,
        threads: 1,
        seconds: Some(Seconds::of(&[foam.seconds])),
        extra,
        ..Record::default()
    }
}

/// Names of the figures.
pub const FIGURES: [(&str, &str); 2] = [
    ("error-time-impulse", "Impulse on the wall from 2.3 to 3.4 sqrt(H/g)"),
    ("error-time-plateau", "Pressure on the wall from 3.5 to 4.3 sqrt(H/g)"),
];

/// Draws error against time for the impulse and the plateau into `folder`, from the rows of one number of threads.
pub fn write_figures(rows: &[&Record], folder: &Path) -> Result<(), BenchError> {
    let least = rows.iter().map(|row| row.threads).min().unwrap_or(1);
    for ((name, title), (key, _)) in FIGURES.iter().zip(MEASURES) {
        let mut plot = LinePlot::new(*title, "time of a second of flow [s]", "error over all sensors [%]");
        (plot.x, plot.y) = (Axis::log(plot.x.label), Axis::log(plot.y.label));
        let mut methods: Vec<&str> = Vec::new();
        for row in rows.iter().filter(|row| row.threads == least) {
            if !methods.contains(&row.method.as_str()) {
                methods.push(&row.method);
            }
        }
        for (n, method) in methods.into_iter().enumerate() {
            let mut points: Vec<(u64, [f64; 2])> = rows
                .iter()
                .filter(|row| row.method == method && row.threads == least)
                .filter_map(|row| {
                    let error = row.extra.get(&format!("{key}_error"))?.as_f64()?;
                    Some((row.extra.get("h_over_dx")?.as_u64()?, [row.seconds?.min, 100.0 * error]))
                })
                .collect();
            points.sort_by_key(|(size, _)| *size);
            let sizes: Vec<String> = points.iter().map(|(size, _)| size.to_string()).collect();
            let points = points.into_iter().map(|(_, point)| point).collect();
            let series = format!("{method} (H/dx = {})", sizes.join(", "));
            plot.series.push(Series::both(series, n, points));
        }
        if plot.is_empty() {
            continue;
        }
        let svg = plot.svg();
        let png = png_from_svg(&svg, 2.0).map_err(|source| BenchError::Figure { figure: (*name).to_owned(), source })?;
        write(&folder.join(format!("{name}.svg")), &svg)?;
        write(&folder.join(format!("{name}.png")), png)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_case_is_sound_at_every_size_and_the_shipped_one_where_it_fits() {
        let shipped = shipped().expect("shipped");
        for size in [10, 20, 40, 80] {
            let text = case(shipped, size);
            let case = Case::parse(CASE, text, None, &[]).unwrap_or_else(|error| panic!("{size}: {error}"));
            let setup = case.checked().unwrap_or_else(|error| panic!("{size}: {error}"));
            assert_eq!(setup.estimate().fluid as u32, 2 * size * size, "{size}");
        }
        assert_eq!(case(shipped, 40), shipped.case);
    }

    /// By hand: the errors at 0.01, 0.05, 0.1 and 0.267 H weigh as their references.
    #[test]
    fn errors_weigh_as_much_as_the_sensor_feels() {
        let mut extra = Map::new();
        insert_errors(&mut extra, "impulse", &[[1.1, 1.0], [3.0, 3.0], [1.0, 2.0], [2.0, 2.0]]);
        // (0.1 + 0 + 1 + 0)/8
        assert!((extra["impulse_error"].as_f64().expect("a number") - 0.1375).abs() < 1e-12);
        assert!((extra["impulse"][2].as_f64().expect("a number") + 0.5).abs() < 1e-12);
    }

    #[test]
    fn the_suite_has_every_reference_that_is_needed() {
        let bands = shipped().and_then(|case| case.read().map_err(|e| panic!("{e}"))).expect("sound");
        assert_eq!(references(&bands).expect("plain numbers")[0][0], 1.624);
    }
}
