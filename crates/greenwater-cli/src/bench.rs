//! `greenwater bench`: measures this program on this machine.
//!
//! [`search`], [`solvers`], [`methods`] and [`flows`] measure and know nothing of each other; [`claims`] turns their numbers into
//! verdicts, [`page`] shows them beside those of the paper ([`printed`]), [`record`] is their JSON.

mod claims;
mod error;
mod flows;
mod methods;
mod page;
mod plan;
mod printed;
mod record;
mod search;
mod solvers;
mod summary;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, Subcommand};
use greenwater::case::{AnySetup, Case, Setup, shipped_cases};
use greenwater::scheme::{MethodName, Preset};

pub use error::BenchError;
use plan::Plan;
use record::{Document, Record};

/// Measures this program on this machine.
#[derive(Clone, Debug, Args)]
pub struct BenchArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Clone, Debug, Subcommand)]
enum What {
    /// Neighbour search: direct and grid, time against the number of particles
    Neighbors(Common),
    /// Pressure equations of the dam break: Gauss, preconditioned GMRES and the default solver, over sizes and threads
    Poisson(Common),
    /// A step of each method at the five sizes of the paper
    Step(Common),
    /// Every figure and table of sections 11-13 of the paper, and a verdict on each of its claims
    Paper(PaperArgs),
}

#[derive(Clone, Debug, Args)]
struct Common {
    /// Smaller sizes and fewer repetitions
    #[arg(long)]
    quick: bool,
    /// Writes the results to FILE as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes over what is already there
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Debug, Args)]
struct PaperArgs {
    #[command(flatten)]
    common: Common,
    /// Folder for the page, its figures and bench.json
    #[arg(long, value_name = "DIR", default_value = "runs/bench-paper")]
    out: PathBuf,
}

/// Runs `greenwater bench`: progress on standard error, the summary on standard output.
///
/// # Errors
/// Something is in the way and `--force` was not given, a file could not be written, or something could not be measured.
/// A flow that ends early is a result, not an error.
pub fn run(args: &BenchArgs) -> Result<(), BenchError> {
    let (What::Neighbors(common) | What::Poisson(common) | What::Step(common) | What::Paper(PaperArgs { common, .. })) = &args.what;
    let plan = if common.quick { Plan::quick() } else { Plan::full() };
    if let Some(path) = &common.json {
        check_free(path, common)?;
    }
    let clock = Clock(Instant::now());
    let mut records = Vec::new();
    match &args.what {
        What::Neighbors(_) => {
            let results = search::measure(&plan, &clock)?;
            print!("{}", summary::text(&page::search_tables(&results)));
            records.extend(results.records());
        }
        What::Poisson(_) => {
            let results = solvers::measure(&plan, &clock)?;
            print!("{}", summary::text(&page::solver_tables(&results)));
            records.extend(results.records());
        }
        What::Step(_) => {
            let results = methods::measure(&plan, &clock)?;
            print!("{}", summary::text(&page::method_tables(&results)));
            records.extend(results.records());
        }
        What::Paper(paper) => {
            check_free(&paper.out, common)?;
            let measured = Measured::of(&plan, &clock)?;
            let document = measured.document();
            page::write(&measured, &paper.out)?;
            write(&paper.out.join("bench.json"), &document)?;
            print!("{}", summary::paper(&measured, &paper.out));
            return common.json.as_ref().map_or(Ok(()), |path| write(path, &document));
        }
    }
    let document = Document::new(records, serde_json::Map::new()).text();
    common.json.as_ref().map_or(Ok(()), |path| write(path, &document))
}

/// Everything that `bench paper` measures.
struct Measured {
    search: search::Results,
    solvers: solvers::Results,
    methods: methods::Results,
    flows: flows::Results,
    claims: Vec<claims::Claim>,
    /// How long it all took, s.
    seconds: f64,
    threads: usize,
}

impl Measured {
    fn of(plan: &Plan, clock: &Clock) -> Result<Self, BenchError> {
        let search = search::measure(plan, clock)?;
        let solvers = solvers::measure(plan, clock)?;
        let methods = methods::measure(plan, clock)?;
        let flows = flows::measure(plan, clock)?;
        let claims = claims::all(&search, &solvers, &methods, &flows);
        Ok(Self { search, solvers, methods, flows, claims, seconds: clock.seconds(), threads: plan.most_threads() })
    }

    fn document(&self) -> String {
        let mut records: Vec<Record> = self.search.records();
        records.extend(self.solvers.records());
        records.extend(self.methods.records());
        records.extend(self.flows.records());
        let mut extra = serde_json::Map::new();
        extra.insert("fits".into(), self.search.fits_json());
        extra.insert("claims".into(), serde_json::json!(self.claims));
        extra.insert("seconds".into(), self.seconds.into());
        Document::new(records, extra).text()
    }
}

/// Tells on standard error how far things are.
struct Clock(Instant);

impl Clock {
    fn seconds(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }

    fn say(&self, what: &str) {
        eprintln!("[{:6.1} s] {what}", self.seconds());
    }
}

/// Runs `work` in a pool of `threads` threads.
fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T, BenchError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    Ok(pool.install(work))
}

/// The paper's dam break with a column `columns` particles wide, run by `method`.
fn dam_break(columns: u32, method: MethodName, preset: Option<Preset>, overrides: &[(&str, &str)]) -> Result<Setup<2>, BenchError> {
    let shipped = format!("dam-break-{columns}");
    let mut keys: Vec<(String, String)> = overrides.iter().map(|&(key, value)| (key.to_owned(), value.to_owned())).collect();
    let case = if shipped_cases().iter().any(|case| case.name == shipped) {
        Case::load(&shipped, &keys)?
    } else {
        // The geometry of the shipped cases at another spacing: a tank 4 L - dx wide and 3 L - dx high.
        let dx = COLUMN_WIDTH / f64::from(columns);
        let (width, height) = (4.0 * COLUMN_WIDTH - dx, 3.0 * COLUMN_WIDTH - dx);
        keys.push(("fluid.spacing".into(), format!("{dx:?}")));
        keys.push((
            "walls.shapes".into(),
            format!("[{{ tank = {{ min = [0.0, 0.0], max = [{width:?}, {height:?}], open = [\"top\"] }} }}]"),
        ));
        Case::load("dam-break", &keys)?
    };
    planar(&case.for_method(method, preset))
}

/// Width `L` of the paper's column, m.
const COLUMN_WIDTH: f64 = 0.75;

fn planar(case: &Case) -> Result<Setup<2>, BenchError> {
    match case.checked()? {
        AnySetup::D2(setup) => Ok(setup),
        AnySetup::D3(_) => Err(BenchError::NotPlanar { case: case.name.clone() }),
    }
}

fn check_free(path: &Path, common: &Common) -> Result<(), BenchError> {
    let in_the_way = match fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => path.exists(),
    };
    if in_the_way && !common.force { Err(BenchError::Exists { path: path.to_owned() }) } else { Ok(()) }
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

    fn common(force: bool) -> Common {
        Common { quick: true, json: None, force }
    }

    /// Handbook counts of the paper: 2 m^2 + 30 m + 9, for its five sizes and for those in between.
    #[test]
    fn the_dam_break_has_the_particle_counts_of_the_paper_at_any_size() {
        for m in [5, 7, 20, 41] {
            let setup = dam_break(m, MethodName::IsphPaper, None, &[]).expect("the case is sound");
            assert_eq!(setup.particles.owned() as u32, 2 * m * m + 30 * m + 9, "m = {m}");
        }
    }

    #[test]
    fn nothing_is_written_over_without_force() {
        let folder = tempfile::tempdir().expect("a folder");
        check_free(folder.path(), &common(false)).expect("an empty folder is free");
        let file = folder.path().join("bench.json");
        write(&file, "{}").expect("writable");
        for path in [folder.path(), &file] {
            assert!(matches!(check_free(path, &common(false)), Err(BenchError::Exists { .. })));
            check_free(path, &common(true)).expect("force");
        }
    }

    /// The smallest sizes that leave every number defined, from measuring to the files on disk.
    #[test]
    fn a_small_run_measures_everything_and_leaves_page_figures_and_json() {
        let clock = Clock(Instant::now());
        let measured = Measured::of(&Plan::tiny(), &clock).expect("measured");
        let folder = tempfile::tempdir().expect("a folder");
        page::write(&measured, folder.path()).expect("written");
        let html = fs::read_to_string(folder.path().join("index.html")).expect("page");
        for section in ["Claims", "Fig. 2", "Figs. 3", "Figs. 6", "Table 2", "Table 3"] {
            assert!(html.contains(section), "{section} is missing");
        }
        for figure in ["fig-2-kernel", "fig-3-search-direct", "fig-6-gauss", "fig-8-speed-up", "table-3-cost", "fronts"] {
            for extension in ["svg", "png"] {
                assert!(folder.path().join(format!("figures/{figure}.{extension}")).is_file(), "{figure}.{extension}");
            }
        }
        let json: serde_json::Value = serde_json::from_str(&measured.document()).expect("JSON");
        assert_eq!(json["format"], 1);
        let results = json["results"].as_array().expect("results");
        for bench in ["neighbors", "poisson", "step", "flow"] {
            assert!(results.iter().any(|row| row["bench"] == bench), "no row of {bench}");
        }
        for row in results {
            for key in ["workload", "method"] {
                assert!(row[key].is_string(), "{key} in {row}");
            }
            for key in ["dimension", "particles", "threads"] {
                assert!(row[key].as_u64().is_some_and(|n| n > 0), "{key} in {row}");
            }
            let seconds = ["min", "median", "max"].map(|key| row["seconds"][key].as_f64().expect("a number"));
            assert!(seconds[0] > 0.0 && seconds.is_sorted(), "{row}");
            assert!(row.as_object().expect("object").values().all(|value| !value.is_null()), "null in {row}");
        }
        assert_eq!(json["claims"].as_array().map(Vec::len), Some(measured.claims.len()));
        let text = summary::paper(&measured, folder.path());
        assert!(measured.claims.iter().all(|claim| text.contains(claim.claim)), "{text}");
    }
}
