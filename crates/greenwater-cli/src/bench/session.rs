//! Where and when something was measured.

use std::process::Command;
use std::time::SystemTime;

use greenwater::machine::Machine;
use serde_json::{Map, Value, json};

use super::ceilings::{self, Ceiling};
use super::{BenchError, Clock, Plan};

/// One call of `greenwater bench`.
pub struct Session {
    /// What the machine can do at most, by number of threads.
    pub ceilings: Vec<Ceiling>,
    quick: bool,
    /// Processes that wanted to run in the minute before; none where the system does not say.
    load: Option<f64>,
}

impl Session {
    /// This machine, with its ceilings measured.
    pub fn here(plan: &Plan, clock: &Clock) -> Result<Self, BenchError> {
        let load = load_average();
        Ok(Self { ceilings: ceilings::measure(plan, clock)?, quick: plan.quick, load })
    }

    /// The ceilings for a number of threads.
    pub fn ceiling(&self, threads: usize) -> Option<&Ceiling> {
        self.ceilings.iter().find(|ceiling| ceiling.threads == threads)
    }

    /// What stands in the file beside the results.
    pub fn extra(&self) -> Map<String, Value> {
        let build = if cfg!(debug_assertions) { "debug" } else { "release" };
        Map::from_iter([
            ("date".to_owned(), json!(humantime::format_rfc3339_seconds(SystemTime::now()).to_string())),
            ("commit".to_owned(), json!(commit())),
            ("machine".to_owned(), json!(Machine::here())),
            ("build".to_owned(), json!(build)),
            ("quick".to_owned(), json!(self.quick)),
            ("load_average".to_owned(), json!(self.load)),
            ("ceilings".to_owned(), json!(self.ceilings)),
        ])
    }
}

fn load_average() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}

/// The commit of the sources, `-dirty` where the crates were changed since; `unknown` for a program away from its sources.
fn commit() -> String {
    let git = |words: &[&str]| {
        let asked = Command::new("git").args(["-C", concat!(env!("CARGO_MANIFEST_DIR"), "/..")]).args(words).output();
        asked.ok().filter(|output| output.status.success()).and_then(|output| String::from_utf8(output.stdout).ok())
    };
    match git(&["rev-parse", "--short=10", "HEAD"]) {
        Some(commit) => {
            let changed = git(&["status", "--porcelain", "--untracked-files=no", "."]).is_some_and(|files| !files.trim().is_empty());
            format!("{}{}", commit.trim(), if changed { "-dirty" } else { "" })
        }
        None => "unknown".to_owned(),
    }
}
