//! The page of the docs, and the tables of the terminal: both made from documents.

use std::fmt::Write as _;
use std::path::Path;

use greenwater_report::page::Table;
use greenwater_report::words::number;
use serde_json::Value;

use super::ceilings::vector::Instructions;
use super::paper::summary;
use super::record::{Document, Record};
use super::{BenchError, impact};

/// A row, and where it comes from.
struct Row<'a> {
    record: &'a Record,
    document: &'a Document,
}

/// What other codes do in the workloads that were made after theirs: workload, code, particle-steps a second on one thread.
const PEERS: [(&str, &str, f64); 5] = [
    ("dam-break-2d-50k", "DualSPHysics", 1.72e6),
    ("dam-break-3d-35k", "DualSPHysics", 0.31e6),
    ("dam-break-isph-5k", "PySPH SISPH", 0.140e6),
    ("dam-break-isph-20k", "PySPH SISPH", 0.127e6),
    ("dam-break-isph-101k", "PySPH SISPH", 0.112e6),
];

/// What other codes need for a second of flow, s: workload, code, threads.
const SECONDS_OF_PEERS: [(&str, &str, usize, f64); 2] =
    [("dam-break-2d-second", "DualSPHysics", 2, 131.0), ("dam-break-isph-second", "PySPH SISPH", 1, 33.6)];

/// Where the numbers of other codes come from.
const PEERS_ORIGIN: &str = "DualSPHysics 5.4 (single precision, -O3 -march=native -ffast-math) and PySPH 1.0b2 (double precision), measured once by this \
                            project on a busy 2-core AMD EPYC (Zen 4); its 3D example has the cubic spline in place of Wendland C2. Another day and \
                            another run: ratios to them are rough.";

/// Tables for a terminal.
pub fn text(document: &Document) -> String {
    let rows = latest(&[document]);
    // One document: its day and machine stand above, once.
    let unstamped =
        |table: Table| Table { caption: table.caption.rsplit_once("Measured ").map_or("", |(text, _)| text).to_owned(), ..table };
    let tables: Vec<Table> = tables(&rows).into_iter().map(|(_, table)| unstamped(table)).collect();
    let mut text = format!("{}\n\n{}", stamp(document), summary::text(&tables));
    let goals = table_of_goals(&[("measured", rows)]);
    if !goals.rows.is_empty() {
        let _ = write!(text, "{}", summary::text(&[goals]));
    }
    text.trim_end().to_owned()
}

/// Writes the page, and its figures beside it.
pub fn write(documents: &[Document], path: &Path) -> Result<(), BenchError> {
    let processors = by_instructions(documents);
    if let Some(impacts) = processors.iter().map(|(_, rows)| impacts(rows)).find(|impacts| !impacts.is_empty()) {
        impact::write_figures(&impacts, &path.parent().unwrap_or(Path::new(".")).join("figures"))?;
    }
    super::write(path, page(&processors))
}

fn impacts<'a>(rows: &[Row<'a>]) -> Vec<&'a Record> {
    rows.iter().map(|row| row.record).filter(|record| record.bench == "impact").collect()
}

/// The rows of processors with one set of instructions, and its name.
type Processors<'a> = (&'a str, Vec<Row<'a>>);

/// The newest rows of the kind of machine that the last document is of, by the instructions that it was measured with, the widest first: processors of
/// one name differ in them, and by more than by anything else.
fn by_instructions(documents: &[Document]) -> Vec<Processors<'_>> {
    let machine = documents.last().and_then(|document| document.extra.get("machine"));
    let alike: Vec<&Document> = documents.iter().filter(|document| document.extra.get("machine") == machine).collect();
    let name = |document: &'_ Document| {
        let ceilings = document.extra.get("ceilings").and_then(Value::as_array);
        let instructions = ceilings.and_then(|ceilings| ceilings.first()?.get("instructions")?.as_str());
        Instructions::ALL.iter().map(|set| set.name()).find(|&name| instructions == Some(name)).unwrap_or("unknown instructions")
    };
    let names = Instructions::ALL.iter().map(|set| set.name()).chain(["unknown instructions"]);
    let rows = names.map(|set| {
        let documents: Vec<&Document> = alike.iter().copied().filter(|document| name(document) == set).collect();
        (set, latest(&documents))
    });
    rows.filter(|(_, rows)| !rows.is_empty()).collect()
}

/// The newest row of each kind; rows of `--quick` only where there is no other.
fn latest<'a>(documents: &[&'a Document]) -> Vec<Row<'a>> {
    let mut ordered: Vec<&Document> = documents.to_vec();
    // Stable: quick ones first, and each kind in the order of time.
    ordered.sort_by_key(|document| document.extra.get("quick") != Some(&Value::Bool(true)));
    let mut rows: Vec<Row> = Vec::new();
    for document in ordered {
        for record in &document.results {
            let key = |r: &Record| (r.bench.clone(), r.workload.clone(), r.method.clone(), r.threads);
            rows.retain(|row| key(row.record) != key(record));
            rows.push(Row { record, document });
        }
    }
    let order = |r: &Record| (r.bench.clone(), r.method.clone(), r.dimension, r.workload.contains("second"), r.particles, r.threads);
    rows.sort_by_key(|row| order(row.record));
    rows
}

/// Date, commit and machine of a document.
fn stamp(document: &Document) -> String {
    let word = |key: &str| document.extra.get(key).and_then(Value::as_str).unwrap_or("unknown").to_owned();
    let machine = document.extra.get("machine");
    let cpu = machine.and_then(|m| m.get("cpu")).and_then(Value::as_str).unwrap_or("an unknown machine").to_owned();
    let cores = machine.and_then(|m| m.get("cores")).and_then(Value::as_u64).unwrap_or(0);
    let quick = if document.extra.get("quick") == Some(&Value::Bool(true)) { ", quick" } else { "" };
    let load = document.extra.get("load_average").and_then(Value::as_f64);
    let load = load.map_or_else(String::new, |load| format!(", load {load:.1}"));
    let debug = if word("build") == "debug" { ", debug build" } else { "" };
    format!("{}, commit {}, {cpu}, {cores} cores{load}{quick}{debug}", word("date"), word("commit"))
}

fn page(processors: &[Processors]) -> String {
    let mut page = "# Speed\n\n\
        <!-- Made by `greenwater bench page --history docs/bench-history.jsonl --docs docs/src/speed.md`. Edit crates/greenwater-cli/src/bench/docs.rs, \
        not this page. -->\n\n\
        `greenwater bench step`, `neighbors`, `poisson` and `impact` measure fixed workloads (`--list` names them); with `--history FILE` each adds a line of \
        JSON to a file, and this page shows the newest numbers of `docs/bench-history.jsonl`. Under each table stand day, commit, machine, and how many processes wanted to run in the minute before (load).\n\n\
        Times are the least of several repetitions: on one thread those on the processor, which others on the machine do not touch, on several wall time, which \
        they do. Each number stands beside a yardstick of the same run: the \
        *plain loop*, which is what a good engineer writes first (cell list, list of neighbours, one scalar loop in double precision with every term of the \
        method, one thread; `bench/naive.rs`, held to the library to round-off by a test), and two ceilings of the machine.\n\n\
        A *particle-step* is one evaluation of pressure, forces and density rates of one particle, walls included. A step of `delta-sph` holds several such \
        sound steps; its search, surface and shifting are shared out over them. A *pair* is a neighbour within the support of the kernel, counted from the side \
        of each fluid particle; the list holds more, for its skin. `delta-sph` goes through the pairs twice in a sound step, for forces at its middle and for rates of \
        density at its end, and pairs/s counts both; the plain loop has all terms in one. *Over the plain loop* compares times for all terms.\n"
        .to_owned();
    ceilings(&mut page, processors.iter().flat_map(|(_, rows)| rows));
    let goals = table_of_goals(processors);
    if !goals.rows.is_empty() {
        page.push_str("\n## Goals\n\nPairs/s and particle-steps/s are goals for processors with AVX-512.\n\n");
        page.push_str(&markdown(&goals));
    }
    for (instructions, rows) in processors {
        for (title, table) in tables(rows) {
            let heading = match title.as_str() {
                "" => String::new(),
                title if processors.len() > 1 => format!("\n## {title}, {instructions}\n"),
                title => format!("\n## {title}\n"),
            };
            let _ = write!(page, "{heading}\n{}", markdown(&table));
        }
    }
    if processors.iter().any(|(_, rows)| !impacts(rows).is_empty()) {
        page.push('\n');
        for (name, title) in impact::FIGURES {
            let _ = writeln!(page, "![{title}: error against time](figures/{name}.svg)\n");
        }
        let _ = writeln!(
            page,
            "Case `dam-break-impact` of the validation suite. The error is the sum of the errors at the four sensors over the sum of the references \
             (the converged inviscid solution), so that a sensor counts as much as it feels; the errors at the sensors stand in the table. Points of interFoam: \
             {}.",
            impact::FOAM_ORIGIN
        );
    }
    page
}

fn ceilings<'a>(page: &mut String, rows: impl Iterator<Item = &'a Row<'a>>) {
    let mut lines: Vec<String> = Vec::new();
    for row in rows.filter(|row| row.record.method != "interFoam") {
        let Some(ceilings) = row.document.extra.get("ceilings").and_then(Value::as_array) else { continue };
        for ceiling in ceilings {
            let value = |key: &str| 1e-9 * ceiling.get(key).and_then(Value::as_f64).unwrap_or(f64::NAN);
            let line = format!(
                "| {} | {:.1} | {:.1} | {} | {} |",
                ceiling.get("threads").and_then(Value::as_u64).unwrap_or(0),
                value("bytes_per_s"),
                value("flops"),
                ceiling.get("instructions").and_then(Value::as_str).unwrap_or("unknown"),
                stamp(row.document)
            );
            if !lines.contains(&line) {
                lines.push(line);
            }
        }
    }
    if !lines.is_empty() {
        page.push_str("\n## Ceilings\n\n`a = b + s c` over arrays that no cache holds, and multiply-adds in independent chains.\n\n");
        page.push_str("| threads | GB/s | GFLOP/s | instructions | measured |\n|---|---|---|---|---|\n");
        for line in lines {
            let _ = writeln!(page, "{line}");
        }
    }
}

fn markdown(table: &Table) -> String {
    let mut text = String::new();
    let _ = writeln!(text, "| {} |\n|{}", table.head.join(" | "), "---|".repeat(table.head.len()));
    for row in &table.rows {
        let _ = writeln!(text, "| {} |", row.join(" | "));
    }
    if !table.caption.is_empty() {
        let _ = writeln!(text, "\n{}", table.caption);
    }
    text
}

// ---- numbers of rows ----------------------------------------------------------------------------------------------------

fn extra(record: &Record, key: &str) -> Option<f64> {
    record.extra.get(key).and_then(Value::as_f64)
}

/// Least time, s.
fn least(record: &Record) -> Option<f64> {
    record.seconds.map(|seconds| seconds.min)
}

fn cell(value: Option<f64>) -> String {
    value.map_or_else(|| "\u{2013}".into(), number)
}

fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| "\u{2013}".into(), |share| format!("{} %", number((1000.0 * share).round() / 10.0)))
}

fn million(value: Option<f64>) -> String {
    cell(value.map(|value| 1e-6 * value))
}

/// A table whose caption says when and where its rows were measured.
fn table(caption: &str, head: &[&str], rows: &[&Row], cells: impl Fn(&Record) -> Vec<String>) -> Table {
    let mut stamps: Vec<String> = Vec::new();
    for row in rows.iter().filter(|row| row.record.method != "interFoam") {
        let stamp = stamp(row.document);
        if !stamps.contains(&stamp) {
            stamps.push(stamp);
        }
    }
    Table {
        caption: format!("{caption} Measured {}.", stamps.join("; ")).trim_start().to_owned(),
        head: head.iter().map(|&cell| cell.to_owned()).collect(),
        rows: rows.iter().map(|row| cells(row.record)).collect(),
        ..Table::default()
    }
}

/// Every table, with the heading it stands under.
fn tables(rows: &[Row]) -> Vec<(String, Table)> {
    let mut tables = Vec::new();
    let of = |bench: &str, method: &str| -> Vec<&Row> {
        rows.iter().filter(|row| row.record.bench == bench && (method.is_empty() || row.record.method == method)).collect()
    };
    let delta = of("step", "delta-sph");
    if !delta.is_empty() {
        tables.push(("Steps of delta-sph".to_owned(), delta_table(&delta)));
        tables.push((String::new(), phases(&delta)));
    }
    let isph = of("step", "isph");
    if !isph.is_empty() {
        tables.push(("Steps of isph".to_owned(), isph_table(&isph, rows)));
        tables.push((String::new(), phases(&isph)));
    }
    let second = of("second", "");
    if !second.is_empty() {
        tables.push(("A second of flow".to_owned(), second_table(&second)));
    }
    let lists = of("neighbors", "");
    if !lists.is_empty() {
        tables.push(("Lists of neighbours".to_owned(), list_table(&lists)));
    }
    let poisson = of("poisson", "");
    if !poisson.is_empty() {
        tables.push(("Pressure equations".to_owned(), poisson_table(&poisson)));
    }
    let impact = of("impact", "");
    if !impact.is_empty() {
        tables.push(("Error against time".to_owned(), impact_table(&impact)));
    }
    tables
}

fn peer(record: &Record) -> String {
    let found = PEERS.iter().find(|(workload, ..)| *workload == record.workload).filter(|_| record.threads == 1);
    match (found, record.particle_steps_per_s) {
        (Some((_, code, rate)), Some(ours)) => format!("{} \u{d7} {code}", number(ours / rate)),
        _ => String::new(),
    }
}

fn delta_table(rows: &[&Row]) -> Table {
    let head = [
        "workload",
        "particles",
        "threads",
        "M particle-steps/s",
        "over the plain step",
        "pair loops, M pairs/s",
        "over the plain loop",
        "of the multiply-adds",
        "of the bandwidth",
        "over one thread",
        "B/particle (allowed)",
        "processor",
        "beside",
    ];
    let caption = format!(
        "Plain step: plain list and plain loop once an evaluation. Processor: how much of its threads' time the program got; what is missing went to others. Shares of the ceilings count the operations and bytes that the pair loops need at the least. {PEERS_ORIGIN}"
    );
    table(&caption, &head, rows, |r| {
        let allowed = extra(r, "bytes_per_particle_allowed").map_or(String::new(), |allowed| format!(" ({allowed:.0})"));
        vec![
            r.workload.clone(),
            r.particles.to_string(),
            r.threads.to_string(),
            million(r.particle_steps_per_s),
            cell(extra(r, "step_ratio_to_naive")),
            million(r.pair_evaluations_per_s),
            cell(r.ratio_to_naive),
            percent(extra(r, "multiply_add_share")),
            percent(extra(r, "bandwidth_share")),
            cell(extra(r, "speed_up")),
            format!("{:.0}{allowed}", r.bytes_per_particle.unwrap_or(f64::NAN)),
            percent(extra(r, "processor_share")),
            peer(r),
        ]
    })
}

fn isph_table(rows: &[&Row], all: &[Row]) -> Table {
    let head = [
        "workload",
        "particles",
        "threads",
        "M particle-steps/s",
        "us a particle and step",
        "iterations",
        "steps of delta-sph it costs",
        "over one thread",
        "B/particle (allowed)",
        "processor",
        "beside",
    ];
    let caption = "Steps of delta-sph: particle-steps of the plane workload of the nearest size, on as many threads.";
    table(caption, &head, rows, |r| {
        let allowed = extra(r, "bytes_per_particle_allowed").map_or(String::new(), |allowed| format!(" ({allowed:.0})"));
        vec![
            r.workload.clone(),
            r.particles.to_string(),
            r.threads.to_string(),
            million(r.particle_steps_per_s),
            cell(r.particle_steps_per_s.map(|rate| 1e6 / rate)),
            cell(r.iterations),
            cell(sweeps(r, all)),
            cell(extra(r, "speed_up")),
            format!("{:.0}{allowed}", r.bytes_per_particle.unwrap_or(f64::NAN)),
            percent(extra(r, "processor_share")),
            peer(r),
        ]
    })
}

/// How many particle-steps of delta-sph, plane and of the nearest size, a particle-step of this row costs.
fn sweeps(record: &Record, rows: &[Row]) -> Option<f64> {
    let away = |r: &Record| (r.particles as f64 / record.particles as f64).ln().abs();
    let plane = rows
        .iter()
        .map(|row| row.record)
        .filter(|r| r.bench == "step" && r.method == "delta-sph" && r.dimension == 2 && r.threads == record.threads);
    let nearest = plane.min_by(|a, b| away(a).total_cmp(&away(b)))?;
    Some(nearest.particle_steps_per_s? / record.particle_steps_per_s?)
}

/// Shares of the phases, of the rows with the fewest threads.
fn phases(rows: &[&Row]) -> Table {
    let fewest = rows.iter().map(|row| row.record.threads).min().unwrap_or(1);
    let rows: Vec<&Row> = rows.iter().copied().filter(|row| row.record.threads == fewest).collect();
    let mut names: Vec<&str> = Vec::new();
    for name in rows.iter().flat_map(|row| row.record.phases.keys()) {
        if !names.contains(&name.as_ref()) {
            names.push(name);
        }
    }
    let head: Vec<&str> = ["workload"].into_iter().chain(names.iter().copied()).collect();
    let plural = if fewest == 1 { "one thread".to_owned() } else { format!("{fewest} threads") };
    table(&format!("Share of the time by phase, {plural}."), &head, &rows, |r| {
        let total: f64 = r.phases.values().sum();
        let share = |name: &&str| percent(r.phases.get(*name).map(|seconds| seconds / total));
        [r.workload.clone()].into_iter().chain(names.iter().map(share)).collect()
    })
}

fn second_table(rows: &[&Row]) -> Table {
    let head = ["workload", "method", "particles", "threads", "steps", "evaluations", "time [s]", "beside"];
    table("", &head, rows, |r| {
        let found = SECONDS_OF_PEERS.iter().find(|(workload, _, threads, _)| *workload == r.workload && *threads == r.threads);
        let beside = match (found, least(r)) {
            (Some((_, code, _, seconds)), Some(ours)) => format!("{} \u{d7} faster than {code} ({seconds} s)", number(seconds / ours)),
            _ => String::new(),
        };
        vec![
            r.workload.clone(),
            r.method.clone(),
            r.particles.to_string(),
            r.threads.to_string(),
            cell(extra(r, "steps")),
            cell(extra(r, "evaluations")),
            cell(least(r)),
            beside,
        ]
    })
}

fn list_table(rows: &[&Row]) -> Table {
    let head = [
        "workload",
        "particles",
        "neighbours",
        "threads",
        "ns a particle",
        "ns a pair",
        "over the plain list",
        "of the bandwidth",
        "over one thread",
        "B/particle",
    ];
    table("Grid and list built anew, exact support.", &head, rows, |r| {
        vec![
            r.workload.clone(),
            r.particles.to_string(),
            cell(extra(r, "neighbours")),
            r.threads.to_string(),
            cell(least(r).map(|s| 1e9 * s / r.particles as f64)),
            cell(extra(r, "nanoseconds_a_pair")),
            cell(r.ratio_to_naive),
            percent(extra(r, "bandwidth_share")),
            cell(extra(r, "speed_up")),
            cell(r.bytes_per_particle),
        ]
    })
}

fn poisson_table(rows: &[&Row]) -> Table {
    let mut sorted: Vec<&Row> = rows.to_vec();
    sorted.sort_by_key(|row| (row.record.dimension, row.record.particles, row.record.threads, row.record.method != "jacobi-cg"));
    let head = [
        "workload",
        "unknowns",
        "threads",
        "solver",
        "iterations",
        "time [s]",
        "of it set-up",
        "ns an unknown",
        "in matrix products",
        "over Jacobi-CG",
        "over one thread",
        "B/unknown",
    ];
    let caption =
        "From zero to a relative residual of 1e-6, set-up included, beside the matrix. In matrix products: time over that of one product.";
    table(caption, &head, &sorted, |r| {
        let setup = r.phases.get("setup").zip(r.phases.get("iterations")).map(|(setup, rest)| setup / (setup + rest));
        vec![
            r.workload.clone(),
            r.particles.to_string(),
            r.threads.to_string(),
            r.method.clone(),
            cell(r.iterations),
            cell(least(r)),
            percent(setup),
            cell(extra(r, "nanoseconds_an_unknown")),
            cell(extra(r, "products")),
            cell(r.ratio_to_naive),
            cell(extra(r, "speed_up")),
            cell(r.bytes_per_particle),
        ]
    })
}

fn impact_table(rows: &[&Row]) -> Table {
    let mut head = vec!["method".to_owned(), "H/dx".to_owned(), "threads".to_owned(), "particles".to_owned()];
    head.push("time of a second of flow [s]".to_owned());
    for (key, _) in impact::MEASURES {
        head.push(format!("error of the {key}"));
        head.push(format!("at {}", impact::SENSORS.join(", ")));
    }
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    table("", &head, rows, |r| {
        let mut cells = vec![r.method.clone(), cell(extra(r, "h_over_dx")), r.threads.to_string()];
        cells.push(if r.particles == 0 { String::new() } else { r.particles.to_string() });
        cells.push(cell(least(r)));
        for (key, _) in impact::MEASURES {
            let problem = r.extra.get("problem").and_then(Value::as_str);
            cells.push(problem.map_or_else(|| percent(extra(r, &format!("{key}_error"))), str::to_owned));
            let each = r.extra.get(key).and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
            let signed: Vec<String> = each.iter().filter_map(Value::as_f64).map(|e| format!("{:+.0}", 100.0 * e)).collect();
            cells.push(if signed.is_empty() { String::new() } else { format!("{} %", signed.join(" / ")) });
        }
        cells
    })
}

// ---- goals --------------------------------------------------------------------------------------------------------------

/// What the project wants, and whether processors meet it, by their instructions.
fn table_of_goals(processors: &[Processors]) -> Table {
    let found: Vec<Vec<Goal>> = processors.iter().map(|(_, rows)| goals(rows)).collect();
    let mut head: Vec<String> = ["goal", "rule"].map(str::to_owned).to_vec();
    head.extend(processors.iter().flat_map(|(name, _)| [(*name).to_owned(), "met".to_owned()]));
    let mut rows: Vec<Vec<String>> = Vec::new();
    for goal in found.iter().flatten() {
        if !rows.iter().any(|row| row[0] == goal.what) {
            let verdicts = found.iter().flat_map(|goals| match goals.iter().find(|other| other.what == goal.what) {
                Some(Goal { measured, met, .. }) => [measured.clone(), if *met { "yes".to_owned() } else { "**no**".to_owned() }],
                None => ["\u{2013}".to_owned(), String::new()],
            });
            rows.push([goal.what.clone(), goal.rule.clone()].into_iter().chain(verdicts).collect());
        }
    }
    Table { head, rows, ..Table::default() }
}

/// Something the project wants, and what was measured.
struct Goal {
    what: String,
    rule: String,
    measured: String,
    met: bool,
}

/// What the project wants, and what these rows say; goals without a row are left out.
fn goals(rows: &[Row]) -> Vec<Goal> {
    let find = |bench: &str, workload: &str, method: &str, threads: usize| {
        let same =
            |r: &&Record| r.bench == bench && r.workload == workload && (method.is_empty() || r.method == method) && r.threads == threads;
        rows.iter().map(|row| row.record).find(same)
    };
    let mut found: Vec<Goal> = Vec::new();
    let mut goal = |what: &str, rule: &str, measured: Option<f64>, unit: &str, met: &dyn Fn(f64) -> bool| {
        if let Some(value) = measured {
            let measured = format!("{} {unit}", number(value)).trim().to_owned();
            found.push(Goal { what: what.to_owned(), rule: rule.to_owned(), measured, met: met(value) });
        }
    };
    for (workload, step) in [("dam-break-2d-50k", 12e6), ("dam-break-3d-35k", 2.5e6)] {
        let row = find("step", workload, "delta-sph", 1);
        let pairs = row.and_then(|r| r.pair_evaluations_per_s);
        goal(&format!("pairs of both loops, {workload}, one thread"), ">= 450 M pairs/s", pairs.map(|p| 1e-6 * p), "M pairs/s", &|v| {
            v >= 450.0
        });
        goal(&format!("pair loops over the plain loop, {workload}"), ">= 3", row.and_then(|r| r.ratio_to_naive), "", &|v| v >= 3.0);
        let rate = row.and_then(|r| r.particle_steps_per_s);
        goal(
            &format!("whole step, {workload}, one thread"),
            &format!(">= {} M particle-steps/s", number(1e-6 * step)),
            rate.map(|r| 1e-6 * r),
            "M particle-steps/s",
            &|v| v >= 1e-6 * step,
        );
        // Where others had the processors the clock on the wall says nothing about threads.
        let undisturbed = |r: &&Record| extra(r, "processor_share").is_none_or(|share| share > 0.8);
        let both = find("step", workload, "delta-sph", 2).filter(undisturbed).and_then(|r| extra(r, "speed_up"));
        goal(&format!("two threads over one, {workload}"), ">= 1.85", both, "", &|v| v >= 1.85);
    }
    let uneven = |method: &str| {
        let costs: Vec<f64> = rows
            .iter()
            .map(|row| row.record)
            .filter(|r| r.bench == "step" && r.method == method && r.dimension == 2 && r.threads == 1)
            .filter_map(|r| Some(1.0 / r.particle_steps_per_s?))
            .collect();
        let (most, least) = (costs.iter().copied().fold(0.0, f64::max), costs.iter().copied().fold(f64::INFINITY, f64::min));
        (costs.len() > 1).then(|| 100.0 * (most / least - 1.0))
    };
    goal("cost of a particle-step of delta-sph over the sizes in 2D", "flat within 15 %", uneven("delta-sph"), "%", &|v| v <= 15.0);
    goal("cost of a particle-step of isph over the sizes", "flat within 20 %", uneven("isph"), "%", &|v| v <= 20.0);
    let dearest = rows.iter().filter(|row| row.record.bench == "step" && row.record.method == "isph" && row.record.threads == 1);
    let dearest = dearest.filter_map(|row| sweeps(row.record, rows)).reduce(f64::max);
    goal("a step of isph, in particle-steps of delta-sph, at any size", "<= 10", dearest, "", &|v| v <= 10.0);
    for method in ["delta-sph", "isph"] {
        let largest = rows.iter().map(|row| row.record).filter(|r| r.bench == "step" && r.method == method).max_by_key(|r| r.particles);
        let share = largest.and_then(|r| Some(r.bytes_per_particle? / extra(r, "bytes_per_particle_allowed")?));
        goal(&format!("memory of {method} at the largest size over what is allowed"), "<= 1", share, "", &|v| v <= 1.0);
    }
    for (workload, _, threads, seconds) in SECONDS_OF_PEERS {
        let ours = find("second", workload, "", threads).and_then(least);
        goal(
            &format!("a second of flow, {workload}, against {seconds} s"),
            ">= 20 times faster",
            ours.map(|s| seconds / s),
            "times",
            &|v| v >= 20.0,
        );
    }
    let multigrid = || rows.iter().map(|row| row.record).filter(|r| r.bench == "poisson" && r.method == "multigrid-cg");
    goal("iterations of multigrid-CG at any size", "<= 16", multigrid().filter_map(|r| r.iterations).reduce(f64::max), "", &|v| v <= 16.0);
    let slowest = multigrid().filter(|r| r.particles >= 20_000).filter_map(|r| r.ratio_to_naive).reduce(f64::min);
    goal("multigrid-CG over Jacobi-CG from 20k unknowns up, set-up included", "> 1", slowest, "", &|v| v > 1.0);
    for dimension in ["2d", "3d"] {
        let cost = |size: &str| {
            find("poisson", &format!("column-{dimension}-{size}"), "multigrid-cg", 1).and_then(|r| extra(r, "nanoseconds_an_unknown"))
        };
        let ratio = cost("1m").zip(cost("20k")).map(|(large, small)| large / small);
        goal(&format!("multigrid-CG, time an unknown at 1M over 20k, {dimension}"), "<= 1.3", ratio, "", &|v| v <= 1.3);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::record::Seconds;
    use serde_json::{Map, json};

    fn document(quick: bool, date: &str, seconds: f64) -> Document {
        let record = |bench: &'static str, method: &str, workload: &str| Record {
            bench: bench.into(),
            workload: workload.into(),
            method: method.into(),
            dimension: 2,
            particles: 50_000,
            threads: 1,
            seconds: Some(Seconds::of(&[seconds])),
            particle_steps_per_s: Some(5e4 / seconds),
            extra: Map::new(),
            ..Record::default()
        };
        let extra = Map::from_iter([
            ("date".to_owned(), json!(date)),
            ("commit".to_owned(), json!("abc1234")),
            ("machine".to_owned(), json!({"cpu": "a processor", "cores": 2})),
            ("quick".to_owned(), json!(quick)),
        ]);
        Document::new(vec![record("step", "delta-sph", "dam-break-2d-50k"), record("step", "isph", "dam-break-isph-101k")], extra)
    }

    #[test]
    fn the_page_shows_the_newest_full_numbers_with_commit_and_machine() {
        let documents = [document(false, "day one", 0.01), document(false, "day two", 0.02), document(true, "day three", 9.0)];
        let page = page(&by_instructions(&documents));
        assert!(page.contains("day two, commit abc1234, a processor, 2 cores") && !page.contains("day three"), "{page}");
        // 50 000 / 0.02 s = 2.5 M, below 12 M; the other method costs as much.
        assert!(
            page.contains("| whole step, dam-break-2d-50k, one thread | >= 12 M particle-steps/s | 2.5 M particle-steps/s | **no** |"),
            "{page}"
        );
        assert!(page.contains("in particle-steps of delta-sph, at any size | <= 10 | 1 | yes |"), "{page}");
    }

    #[test]
    fn rows_of_another_machine_stay_out() {
        let mut other = document(false, "day zero", 0.5);
        other.extra.insert("machine".into(), json!({"cpu": "another", "cores": 64}));
        let documents = [other, document(true, "day one", 0.01)];
        let processors = by_instructions(&documents);
        assert!(processors.iter().flat_map(|(_, rows)| rows).all(|row| stamp(row.document).contains("a processor")));
    }

    #[test]
    fn processors_with_other_instructions_stand_beside_each_other() {
        let with = |instructions: &str, date: &str, seconds: f64| {
            let mut document = document(false, date, seconds);
            document
                .extra
                .insert("ceilings".into(), json!([{"threads": 1, "bytes_per_s": 1e10, "flops": 5e10, "instructions": instructions}]));
            document
        };
        let page = page(&by_instructions(&[with("AVX-512", "day one", 0.004), with("AVX2 with FMA", "day two", 0.01)]));
        assert!(page.contains("| goal | rule | AVX-512 | met | AVX2 with FMA | met |"), "{page}");
        // 50 000 particle-steps in 0.004 s and in 0.01 s.
        let whole = "| whole step, dam-break-2d-50k, one thread | >= 12 M particle-steps/s | 12.5 M particle-steps/s | yes | 5 M particle-steps/s | **no** |";
        assert!(page.contains(whole), "{page}");
        assert!(page.contains("## Steps of isph, AVX-512\n") && page.contains("## Steps of isph, AVX2 with FMA\n"), "{page}");
    }
}
