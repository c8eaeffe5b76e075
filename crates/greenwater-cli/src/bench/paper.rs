//! `greenwater bench paper`: what the paper's sections 11-13 report, on this machine.
//!
//! [`search`], [`solvers`], [`methods`] and [`flows`] measure and know nothing of each other; [`claims`] turns their numbers into
//! verdicts, [`page`] shows them beside those of the paper ([`printed`]).

mod claims;
mod flows;
mod methods;
mod page;
mod plan;
mod printed;
mod search;
mod solvers;
pub mod summary;

use std::path::PathBuf;

use clap::Args;
use greenwater::case::{AnySetup, Case, Setup, shipped_cases};
use greenwater::scheme::{MethodName, Preset};

use super::record::{self, Document, Record};
use super::{BenchError, Clock, Files, with_threads, write};
use crate::console;
use crate::error::CliError;
use plan::Plan;

#[derive(Clone, Debug, Args)]
pub struct PaperArgs {
    /// Smaller sizes and fewer repetitions
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    files: Files,
    /// Folder for the page, its figures and bench.json
    #[arg(long, value_name = "DIR", default_value = "runs/bench-paper")]
    out: PathBuf,
}

/// `greenwater bench paper`.
pub fn run(args: &PaperArgs) -> Result<(), CliError> {
    args.files.check()?;
    args.files.check_free(&args.out)?;
    let plan = if args.quick { Plan::quick() } else { Plan::full() };
    let measured = Measured::of(&plan, &Clock::start())?;
    let document = measured.document();
    page::write(&measured, &args.out)?;
    write(&args.out.join("bench.json"), &document)?;
    console::print(summary::paper(&measured, &args.out).trim_end())?;
    Ok(args.files.write_json(&document)?)
}

/// Everything that `bench paper` measures.
pub struct Measured {
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

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// Handbook counts of the paper: 2 m^2 + 30 m + 9, for its five sizes and for those in between.
    #[test]
    fn the_dam_break_has_the_particle_counts_of_the_paper_at_any_size() {
        for m in [5, 7, 20, 41] {
            let setup = dam_break(m, MethodName::IsphPaper, None, &[]).expect("the case is sound");
            assert_eq!(setup.particles.owned() as u32, 2 * m * m + 30 * m + 9, "m = {m}");
        }
    }

    /// The smallest sizes that leave every number defined, from measuring to the files on disk.
    #[test]
    fn a_small_run_measures_everything_and_leaves_page_figures_and_json() {
        let clock = Clock::start();
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
