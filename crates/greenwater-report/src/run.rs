//! Reads a run folder. What is missing is noted in plain words, so that a failed run can still be shown.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;

use crate::error::ReportError;

/// What was run, by whom and on what: `provenance.json`. Absent keys read as empty.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// Format of the run folder; 1.
    pub format: u64,
    /// Name of the program that wrote the run.
    pub program: String,
    /// Its version.
    pub version: String,
    /// The command line, one entry a word.
    pub command: Vec<String>,
    /// Short name of the case.
    pub case: String,
    /// Title of the case.
    pub title: String,
    /// Name of the method, as in `--method`.
    pub method: String,
    /// Name of the method in words.
    pub method_title: String,
    /// Name of the parameter preset.
    pub preset: String,
    /// Dimension of space, 2 or 3.
    pub dimension: usize,
    /// Start of the run, RFC 3339.
    pub started: String,
    /// The machine.
    pub machine: Machine,
    /// Threads used.
    pub threads: Option<u64>,
    /// The smoothing kernel.
    pub kernel: KernelInfo,
    /// Particles at the start.
    pub particles: Counts,
    /// How the time step was chosen, in words.
    pub time_step_rule: String,
    /// Each documented departure from the method as printed.
    pub departures: Vec<String>,
    /// What distinguishes this method: one row an aspect.
    pub distinctions: Vec<Distinction>,
    /// Scales of the case.
    pub scales: Scales,
    /// Whether something does work on the fluid: walls that move, or gravity along an axis that repeats.
    pub driven: bool,
    /// What to compare, and with what.
    pub compare: Compare,
    /// The pressure probes.
    pub probes: Vec<Probe>,
}

/// The machine a run used.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Machine {
    /// Operating system.
    pub os: String,
    /// Architecture.
    pub arch: String,
    /// Model of the processor.
    pub cpu: String,
    /// Number of cores.
    pub cores: Option<u64>,
}

/// The smoothing kernel of a run.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct KernelInfo {
    /// Name.
    pub name: String,
    /// Smoothing length, m.
    pub smoothing_length_m: Option<f64>,
    /// Smoothing length over particle spacing, dimensionless.
    pub h_over_spacing: Option<f64>,
}

/// Particle counts.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Counts {
    /// Fluid particles.
    pub fluid: u64,
    /// Wall particles.
    pub wall: u64,
}

/// One row of the table of distinctions.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Distinction {
    /// What is compared, such as `pressure`.
    pub aspect: String,
    /// What this method does.
    pub value: String,
}

/// Scales of the case, SI.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Scales {
    /// Density at rest, kg/m³.
    pub rest_density: Option<f64>,
    /// Dynamic viscosity, Pa s.
    pub viscosity: Option<f64>,
    /// Magnitude of gravity, m/s².
    pub gravity: Option<f64>,
    /// Direction against gravity as an axis (0, 1, 2); absent: y in 2D, z in 3D.
    pub up_axis: Option<usize>,
    /// Height of the fluid at the start, m.
    pub height: Option<f64>,
    /// Width of the fluid at the start, m.
    pub width: Option<f64>,
    /// Particle spacing, m.
    pub spacing: Option<f64>,
    /// Volume of the fluid, m³ (m² in 2D).
    pub fluid_volume: Option<f64>,
    /// The tank.
    #[serde(rename = "box")]
    pub tank: Option<Tank>,
}

impl Scales {
    /// Hydrostatic pressure at the foot of the column, `ρ g H`, Pa.
    pub fn pressure(&self) -> Option<f64> {
        let p = self.rest_density? * self.gravity? * self.height?;
        (p.is_finite() && p > 0.0).then_some(p)
    }
}

/// A box, m.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Tank {
    /// Lowest corner.
    pub min: Vec<f64>,
    /// Highest corner.
    pub max: Vec<f64>,
}

/// What the case asks to compare.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Compare {
    /// Times of the pictures, s.
    pub times: Vec<f64>,
    /// Reference curves.
    pub references: Vec<Reference>,
}

/// A reference curve in its own dimensionless axes.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Reference {
    /// Name for legends.
    pub name: String,
    /// `front`, `residual_height`, `pressure_noise`, `probe:NAME`, `gauge:NAME` or `load:NAME.fx`.
    pub quantity: String,
    /// Where it was published.
    pub source: String,
    /// `T = t · time_scale`, 1/s.
    pub time_scale: Option<f64>,
    /// `Z = value · value_scale`, 1/m or 1/Pa.
    pub value_scale: Option<f64>,
    /// Label of the time axis.
    pub time_label: String,
    /// Label of the value axis.
    pub value_label: String,
    /// `[T, Z]` pairs.
    pub points: Vec<[f64; 2]>,
    /// How far repeated measurements lie to either side of each point, in units of Z; empty for not given.
    pub spread: Vec<f64>,
}

impl Reference {
    /// Both scales, if they are usable.
    pub fn scaling(&self) -> Option<(f64, f64)> {
        let (time, value) = (self.time_scale?, self.value_scale?);
        (time.is_finite() && time > 0.0 && value.is_finite() && value > 0.0).then_some((time, value))
    }
}

/// A pressure probe.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Probe {
    /// Name, as in the header of `probes.csv`.
    pub name: String,
    /// Position at the start, m.
    pub position: Vec<f64>,
    /// Name of the wall it goes along with, if any.
    pub on: Option<String>,
}

/// Totals of a run: `summary.json`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Summary {
    /// Whether the asked end was reached.
    pub completed: Option<bool>,
    /// Steps taken.
    pub steps: Option<u64>,
    /// Simulated time reached, s.
    pub end_time: Option<f64>,
    /// Wall-clock time, s.
    pub wall_seconds: Option<f64>,
    /// Threads used.
    pub threads: Option<u64>,
    /// Time steps, s.
    pub dt: Option<Spread>,
    /// Wall-clock seconds by phase.
    pub phases: BTreeMap<String, Option<f64>>,
    /// Solver iterations a step; absent without a solver.
    pub iterations: Option<Spread>,
    /// Particles at the end.
    pub particles: Option<Counts>,
    /// Particles that left the tank.
    pub lost_particles: Option<u64>,
    /// Pressure noise over `ρ g H`, dimensionless.
    pub pressure_noise: Option<f64>,
    /// Density over rest density, dimensionless.
    pub density_percentiles: Option<Percentiles>,
    /// Relative volume error at the end, dimensionless.
    pub volume_error: Option<f64>,
    /// Energies.
    pub energy: Option<EnergySummary>,
}

/// Least, median and greatest value.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Spread {
    /// Least.
    pub min: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// Greatest.
    pub max: Option<f64>,
}

impl Spread {
    /// Least, median and greatest of the finite numbers.
    pub fn of(values: &[f64]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        Self { min: finite().reduce(f64::min), median: crate::measure::median(finite()), max: finite().reduce(f64::max) }
    }
}

/// First and 99th percentile.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Percentiles {
    /// First percentile.
    pub p01: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
}

/// Energies as summed up by the run, J (J/m in 2D).
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub struct EnergySummary {
    /// Total at the start.
    pub initial: Option<f64>,
    /// Total at the end.
    #[serde(rename = "final")]
    pub last: Option<f64>,
    /// Highest rise over the start, relative to it.
    pub max_rise: Option<f64>,
}

/// Why a run ended early: `FAILED.json`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Failure {
    /// The error, in words.
    pub error: String,
    /// Exit code of the program.
    pub exit_code: Option<i64>,
    /// Field that went wrong.
    pub field: Option<String>,
    /// Particle at which it did.
    pub particle: Option<u64>,
    /// Time, s.
    pub time: Option<f64>,
    /// Step.
    pub step: Option<u64>,
}

/// How a run ended.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// `DONE` is there.
    Finished,
    /// `FAILED.json` is there.
    Failed(Failure),
    /// Neither is there: the run was stopped or is still going.
    Unfinished,
}

/// A column of a CSV file.
#[derive(Clone, Debug)]
struct Column {
    name: String,
    unit: String,
    text: Vec<String>,
    numbers: Vec<f64>,
}

/// A CSV file with a header `name [unit],...`. A cell that is no number reads as NaN.
#[derive(Clone, Debug, Default)]
pub struct Table {
    columns: Vec<Column>,
}

impl Table {
    /// Reads the text of a CSV file. Short rows are filled up with NaN. A name that an earlier column has gets the number of its
    /// column: the second `time` is `time (column 2)`.
    pub fn parse(text: &str) -> Self {
        let mut lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
        let Some(header) = lines.next() else { return Self::default() };
        let mut columns: Vec<Column> = Vec::new();
        for cell in header.split(',') {
            let (name, unit) = match cell.trim().split_once('[') {
                Some((name, unit)) => (name.trim(), unit.trim_end_matches(']').trim()),
                None => (cell.trim(), ""),
            };
            let taken = columns.iter().any(|column| column.name == name);
            let name = if taken { format!("{name} (column {})", columns.len() + 1) } else { name.to_owned() };
            columns.push(Column { name, unit: unit.into(), text: Vec::new(), numbers: Vec::new() });
        }
        for line in lines {
            let mut cells = line.split(',');
            for column in &mut columns {
                let cell = cells.next().unwrap_or("").trim();
                column.numbers.push(cell.parse().unwrap_or(f64::NAN));
                column.text.push(cell.to_owned());
            }
        }
        Self { columns }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.numbers.len())
    }

    /// Names of the columns, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|column| column.name.as_str())
    }

    /// Numbers of a column, in the unit of its header; empty if there is no such column.
    pub fn numbers(&self, name: &str) -> &[f64] {
        self.column(name).map_or(&[], |column| &column.numbers)
    }

    /// Cells of a column as written; empty if there is no such column.
    pub fn text(&self, name: &str) -> &[String] {
        self.column(name).map_or(&[], |column| &column.text)
    }

    /// Unit of a column; empty if there is no such column.
    pub fn unit(&self, name: &str) -> &str {
        self.column(name).map_or("", |column| &column.unit)
    }

    /// Pairs `[time, value]` of a column against the column `time`.
    pub fn against_time(&self, name: &str) -> Vec<[f64; 2]> {
        self.numbers("time").iter().zip(self.numbers(name)).map(|(&t, &v)| [t, v]).collect()
    }

    /// Numbers in data columns (all but `time`) that are infinite or written as NaN.
    pub fn not_finite(&self) -> usize {
        let bad = |cell: &String| cell.parse::<f64>().is_ok_and(|v| !v.is_finite());
        self.columns.iter().map(|column| column.text.iter().filter(|cell| bad(cell)).count()).sum()
    }

    fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name == name)
    }
}

/// One entry of `frames.pvd`.
#[derive(Clone, Debug)]
pub struct FrameEntry {
    /// Time, s.
    pub time: f64,
    /// The file.
    pub path: PathBuf,
}

/// Positions, pressures and kinds of one frame.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Positions, m; z = 0 in 2D.
    pub points: Vec<[f64; 3]>,
    /// Pressure, Pa; NaN where the frame has none.
    pub pressure: Vec<f64>,
    /// 0 fluid, 1 wall; all fluid where the frame does not say.
    pub kind: Vec<u8>,
}

/// Why a frame cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The file could not be read.
    #[error("cannot read `{}`: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The answer of the operating system.
        source: std::io::Error,
    },
    /// The file is no VTK XML PolyData file of the kind the run folder holds.
    #[error("`{}`: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// A run folder, read.
#[derive(Clone, Debug)]
pub struct Run {
    /// The folder.
    pub dir: PathBuf,
    /// Short name for legends: the method, with preset or folder where that alone is not unique.
    pub label: String,
    /// What was run.
    pub provenance: Provenance,
    /// Totals, if the run left them.
    pub summary: Summary,
    /// How it ended.
    pub outcome: Outcome,
    /// The frames, in order of time.
    pub frames: Vec<FrameEntry>,
    /// `energy.csv`
    pub energy: Table,
    /// `front.csv`
    pub front: Table,
    /// `probes.csv`; empty where the case has no probe.
    pub probes: Table,
    /// `gauges.csv`; empty where the case has no gauge.
    pub gauges: Table,
    /// `loads.csv`; empty where the case has no load.
    pub loads: Table,
    /// `quality.csv`
    pub quality: Table,
    /// `steps.csv`
    pub steps: Table,
    /// What is missing or cannot be understood, one sentence each.
    pub notes: Vec<String>,
}

impl Run {
    /// Reads a run folder.
    ///
    /// # Errors
    /// If the path is no run folder (no `provenance.json`), or that file cannot be understood. Every other
    /// missing or broken file becomes a sentence in [`Run::notes`].
    pub fn read(dir: &Path) -> Result<Self, ReportError> {
        let provenance = read_provenance(dir)?;
        let mut notes = Vec::new();
        let outcome = read_outcome(dir, &mut notes);
        let summary = read_json(&dir.join("summary.json"), &mut notes).unwrap_or_default();
        let frames = read_index(&dir.join("frames"), &mut notes);
        let mut table = |name: &str| read_table(&dir.join(name), &mut notes);
        let [energy, front, quality, steps] = ["energy.csv", "front.csv", "quality.csv", "steps.csv"].map(&mut table);
        let mut asked = |name: &str, expected: bool| {
            if expected || dir.join(name).exists() { read_table(&dir.join(name), &mut notes) } else { Table::default() }
        };
        let probes = asked("probes.csv", !provenance.probes.is_empty());
        let [gauges, loads] = ["gauges.csv", "loads.csv"].map(|name| asked(name, false));
        let label = if provenance.method.is_empty() { folder_name(dir) } else { provenance.method.clone() };
        Ok(Self {
            dir: dir.to_owned(),
            label,
            provenance,
            summary,
            outcome,
            frames,
            energy,
            front,
            probes,
            gauges,
            loads,
            quality,
            steps,
            notes,
        })
    }

    /// Reads several run folders and makes their labels unique.
    ///
    /// # Errors
    /// As [`Run::read`], and if the list is empty.
    pub fn read_all(dirs: &[PathBuf]) -> Result<Vec<Self>, ReportError> {
        if dirs.is_empty() {
            return Err(ReportError::NoRuns);
        }
        let mut runs = dirs.iter().map(|dir| Self::read(dir)).collect::<Result<Vec<_>, _>>()?;
        let refine: [fn(&Self) -> String; 3] = [
            |run| format!("{} ({})", run.provenance.method, run.provenance.preset),
            |run| folder_name(&run.dir),
            |run| run.dir.display().to_string(),
        ];
        for rename in refine {
            let labels: Vec<String> = runs.iter().map(|run| run.label.clone()).collect();
            for (i, run) in runs.iter_mut().enumerate() {
                if labels.iter().enumerate().any(|(j, label)| j != i && *label == labels[i]) {
                    run.label = rename(run);
                }
            }
        }
        Ok(runs)
    }

    /// Simulated time the run reached, s: from the summary, else from what was written.
    pub fn end_time(&self) -> Option<f64> {
        let last = |table: &Table| table.numbers("time").iter().copied().filter(|t| t.is_finite()).reduce(f64::max);
        self.summary
            .end_time
            .or_else(|| last(&self.steps))
            .or_else(|| last(&self.energy))
            .or_else(|| self.frames.last().map(|frame| frame.time))
    }

    /// Number of steps: from the summary, else the last step that was written.
    pub fn step_count(&self) -> Option<u64> {
        let logged = || self.steps.numbers("step").iter().copied().filter(|s| s.is_finite()).reduce(f64::max);
        self.summary.steps.or_else(|| logged().map(|s| s as u64))
    }

    /// Time steps, s: from the summary, else from `steps.csv`.
    pub fn dt(&self) -> Spread {
        self.summary.dt.unwrap_or_else(|| Spread::of(self.steps.numbers("dt")))
    }

    /// Wall-clock time, s: from the summary, else from `steps.csv`.
    pub fn wall_seconds(&self) -> Option<f64> {
        let logged = || self.steps.numbers("wall_clock").iter().copied().filter(|s| s.is_finite()).reduce(f64::max);
        self.summary.wall_seconds.or_else(logged)
    }

    /// Particles, fluid and wall together.
    pub fn particle_count(&self) -> u64 {
        let counts = self.summary.particles.unwrap_or(self.provenance.particles);
        counts.fluid + counts.wall
    }

    /// Whether the run reached its end.
    pub fn completed(&self) -> bool {
        matches!(self.outcome, Outcome::Finished) && self.summary.completed != Some(false)
    }

    /// Reads a frame.
    ///
    /// # Errors
    /// If the file is missing or no VTK XML PolyData file.
    pub fn frame(&self, index: usize) -> Result<Frame, FrameError> {
        let path = &self.frames[index].path;
        let text = fs::read_to_string(path).map_err(|source| FrameError::Io { path: path.clone(), source })?;
        parse_vtp(&text).map_err(|reason| FrameError::Malformed { path: path.clone(), reason })
    }
}

fn folder_name(dir: &Path) -> String {
    dir.file_name().map_or_else(|| dir.display().to_string(), |name| name.to_string_lossy().into_owned())
}

fn read_provenance(dir: &Path) -> Result<Provenance, ReportError> {
    let path = dir.join("provenance.json");
    if !dir.exists() {
        return Err(ReportError::NotFound { path: dir.to_owned() });
    }
    if !path.is_file() {
        let mut runs: Vec<PathBuf> = fs::read_dir(dir)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .filter(|inside| inside.join("provenance.json").is_file())
            .collect();
        runs.sort();
        return Err(ReportError::NotARun { path: dir.to_owned(), runs });
    }
    let text = fs::read_to_string(&path).map_err(|source| ReportError::Io { action: "read", path: path.clone(), source })?;
    let provenance: Provenance =
        serde_json::from_str(&text).map_err(|error| ReportError::Malformed { path: path.clone(), reason: error.to_string() })?;
    if provenance.format != 1 {
        return Err(ReportError::Format { path, format: provenance.format });
    }
    Ok(provenance)
}

fn read_outcome(dir: &Path, notes: &mut Vec<String>) -> Outcome {
    let failed = dir.join("FAILED.json");
    if failed.exists() {
        Outcome::Failed(read_json(&failed, notes).unwrap_or_default())
    } else if dir.join("DONE").exists() {
        Outcome::Finished
    } else {
        Outcome::Unfinished
    }
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path, notes: &mut Vec<String>) -> Option<T> {
    let text = read_text(path, notes)?;
    match serde_json::from_str(&text) {
        Ok(value) => Some(value),
        Err(error) => {
            notes.push(format!("{} cannot be understood: {error}", folder_name(path)));
            None
        }
    }
}

fn read_text(path: &Path, notes: &mut Vec<String>) -> Option<String> {
    match fs::read_to_string(path) {
        Ok(text) => Some(text),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            notes.push(format!("{} is missing", folder_name(path)));
            None
        }
        Err(error) => {
            notes.push(format!("{} cannot be read: {error}", folder_name(path)));
            None
        }
    }
}

fn read_table(path: &Path, notes: &mut Vec<String>) -> Table {
    let Some(text) = read_text(path, notes) else { return Table::default() };
    let table = Table::parse(&text);
    if table.rows() == 0 {
        notes.push(format!("{} has no rows", folder_name(path)));
    }
    let bad = table.not_finite();
    if bad > 0 {
        notes.push(format!("{} has {bad} cells that are not finite; they are left out", folder_name(path)));
    }
    table
}

/// Reads `frames.pvd`. Entries that point outside the folder are refused.
fn read_index(folder: &Path, notes: &mut Vec<String>) -> Vec<FrameEntry> {
    let Some(text) = read_text(&folder.join("frames.pvd"), notes) else { return Vec::new() };
    let document = match roxmltree::Document::parse(&text) {
        Ok(document) => document,
        Err(error) => {
            notes.push(format!("frames.pvd cannot be understood: {error}"));
            return Vec::new();
        }
    };
    let mut frames = Vec::new();
    for node in document.descendants().filter(|node| node.has_tag_name("DataSet")) {
        let time = node.attribute("timestep").and_then(|t| t.trim().parse::<f64>().ok()).filter(|t| t.is_finite());
        let (Some(time), Some(file)) = (time, node.attribute("file")) else {
            notes.push("frames.pvd has an entry without time or file; it is left out".into());
            continue;
        };
        if Path::new(file).components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir)) {
            notes.push(format!("frames.pvd names `{file}`, which is outside the run folder; it is left out"));
            continue;
        }
        frames.push(FrameEntry { time, path: folder.join(file) });
    }
    frames.sort_by(|a, b| a.time.total_cmp(&b.time));
    frames
}

/// A column of a frame.
#[derive(Clone, Debug)]
pub struct FrameColumn {
    /// Its name.
    pub name: String,
    /// Numbers of one particle: 1, or 3 for a vector.
    pub components: usize,
    /// Whether it holds whole numbers.
    pub whole: bool,
    /// The numbers, particle by particle.
    pub values: Vec<f64>,
}

/// A frame with everything in it.
#[derive(Clone, Debug)]
pub struct FrameColumns {
    /// Positions, m; z = 0 in 2D.
    pub points: Vec<[f64; 3]>,
    /// All columns, as the file has them.
    pub columns: Vec<FrameColumn>,
}

/// Reads everything in a frame.
///
/// # Errors
/// If the file is missing or no VTK XML PolyData file.
pub fn read_columns(path: &Path) -> Result<FrameColumns, FrameError> {
    let text = fs::read_to_string(path).map_err(|source| FrameError::Io { path: path.to_owned(), source })?;
    let malformed = |reason| FrameError::Malformed { path: path.to_owned(), reason };
    let document = roxmltree::Document::parse(&text).map_err(|error| malformed(error.to_string()))?;
    let read = || {
        let piece = Piece::of(&document)?;
        let nodes = piece.node.children().filter(|node| node.has_tag_name("PointData")).flat_map(|node| node.children());
        let column = |node: roxmltree::Node<'_, '_>| {
            let components = node.attribute("NumberOfComponents").and_then(|n| n.parse().ok()).unwrap_or(1);
            Ok(FrameColumn {
                name: node.attribute("Name").unwrap_or_default().to_owned(),
                components,
                whole: !node.attribute("type").unwrap_or_default().starts_with("Float"),
                values: piece.encoding.numbers(node, piece.count, components)?,
            })
        };
        let columns = nodes.filter(|node| node.has_tag_name("DataArray")).map(column).collect::<Result<_, String>>()?;
        Ok(FrameColumns { points: piece.points()?, columns })
    };
    read().map_err(malformed)
}

/// Reads positions, pressure and kind from the text of a VTK XML PolyData file with inline arrays.
fn parse_vtp(text: &str) -> Result<Frame, String> {
    let document = roxmltree::Document::parse(text).map_err(|error| error.to_string())?;
    let piece = Piece::of(&document)?;
    let column = |name: &str| piece.array("PointData", Some(name)).map(|node| piece.encoding.numbers(node, piece.count, 1)).transpose();
    Ok(Frame {
        points: piece.points()?,
        pressure: column("pressure")?.unwrap_or_else(|| vec![f64::NAN; piece.count]),
        kind: column("kind")?.map_or_else(|| vec![0; piece.count], |kinds| kinds.into_iter().map(|k| k as u8).collect()),
    })
}

/// The one piece of a VTK XML PolyData file.
struct Piece<'a> {
    node: roxmltree::Node<'a, 'a>,
    encoding: Encoding,
    /// Number of points.
    count: usize,
}

impl<'a> Piece<'a> {
    fn of(document: &'a roxmltree::Document<'a>) -> Result<Self, String> {
        let root = document.root_element();
        if root.attribute("type") != Some("PolyData") {
            return Err("not a VTK XML file of type PolyData".into());
        }
        if root.attribute("byte_order").is_some_and(|order| order != "LittleEndian") {
            return Err("byte order is not LittleEndian".into());
        }
        let encoding = Encoding {
            wide_header: root.attribute("header_type") == Some("UInt64"),
            compressed: match root.attribute("compressor") {
                None => false,
                Some("vtkZLibDataCompressor") => true,
                Some(other) => return Err(format!("compressor `{other}` is not vtkZLibDataCompressor")),
            },
        };
        let pieces = || document.descendants().filter(|node| node.has_tag_name("Piece"));
        if pieces().count() != 1 {
            return Err(format!("{} pieces, expected 1", pieces().count()));
        }
        let piece = pieces().next().ok_or("no piece")?;
        let count: usize =
            piece.attribute("NumberOfPoints").and_then(|n| n.parse().ok()).ok_or("NumberOfPoints is missing or no number")?;
        Ok(Self { node: piece, encoding, count })
    }

    /// The array `name` of a section, or its first one.
    fn array(&self, section: &str, name: Option<&str>) -> Option<roxmltree::Node<'a, 'a>> {
        let sections = self.node.children().filter(|node| node.has_tag_name(section));
        let mut arrays = sections.flat_map(|node| node.children()).filter(|node| node.has_tag_name("DataArray"));
        arrays.find(|node| name.is_none_or(|name| node.attribute("Name") == Some(name)))
    }

    fn points(&self) -> Result<Vec<[f64; 3]>, String> {
        let node = self.array("Points", None).ok_or("no Points array")?;
        let values = self.encoding.numbers(node, self.count, 3)?;
        Ok(values.chunks_exact(3).map(|x| [x[0], x[1], x[2]]).collect())
    }
}

/// How the arrays of a VTK XML file are stored.
#[derive(Clone, Copy, Debug)]
struct Encoding {
    wide_header: bool,
    compressed: bool,
}

impl Encoding {
    /// The numbers of an array of `count` tuples of `components`.
    fn numbers(self, node: roxmltree::Node<'_, '_>, count: usize, components: usize) -> Result<Vec<f64>, String> {
        let name = node.attribute("Name").unwrap_or("Points").to_owned();
        let fail = |reason: &str| format!("array `{name}`: {reason}");
        let declared = node.attribute("NumberOfComponents").and_then(|n| n.parse().ok()).unwrap_or(1);
        if declared != components {
            return Err(fail(&format!("{declared} components, expected {components}")));
        }
        let wanted = count.checked_mul(components).ok_or_else(|| fail("too many points"))?;
        let text = node.text().unwrap_or("");
        let values = match node.attribute("format") {
            Some("ascii") => text.split_whitespace().map(|v| v.parse().unwrap_or(f64::NAN)).collect(),
            Some("binary") => {
                let kind = node.attribute("type").unwrap_or("");
                let (size, convert) = scalar(kind).ok_or_else(|| fail(&format!("unknown type `{kind}`")))?;
                let expected = wanted.checked_mul(size).ok_or_else(|| fail("too many points"))?;
                let bytes = self.bytes(text, expected).map_err(|reason| fail(&reason))?;
                bytes.chunks_exact(size).map(convert).collect::<Vec<f64>>()
            }
            other => return Err(fail(&format!("format `{}` is not `binary` or `ascii`", other.unwrap_or("")))),
        };
        if values.len() != wanted {
            return Err(fail(&format!("{} numbers, expected {wanted}", values.len())));
        }
        Ok(values)
    }

    /// The bytes behind an inline base64 array. Header and data are encoded each for itself when compressed,
    /// together when not.
    fn bytes(self, text: &str, expected: usize) -> Result<Vec<u8>, String> {
        let text: String = text.split_whitespace().collect();
        let decode = |part: &str| STANDARD.decode(part).map_err(|error| format!("base64: {error}"));
        let word = if self.wide_header { 8 } else { 4 };
        let number = |bytes: &[u8], i: usize| -> usize {
            bytes[i * word..(i + 1) * word].iter().rev().fold(0, |n, &byte| (n << 8) | usize::from(byte))
        };
        if !self.compressed {
            let mut bytes = decode(&text)?;
            if bytes.len() < word || number(&bytes, 0) != bytes.len() - word || bytes.len() - word != expected {
                return Err(format!("length {} bytes, expected {expected}", bytes.len().saturating_sub(word)));
            }
            return Ok(bytes.split_off(word));
        }
        let part = |from: usize, to: usize| text.get(from..to).ok_or_else(|| "data end too early".to_owned());
        // The number of blocks tells how long the header is; the header has three words at least, so its first
        // word never meets padding.
        let first = decode(part(0, base64_length(word))?)?;
        let blocks = number(&first, 0);
        let header_bytes = blocks.checked_add(3).and_then(|n| n.checked_mul(word)).ok_or("too many blocks")?;
        if header_bytes > text.len() {
            return Err("data end too early".into());
        }
        let header = decode(part(0, base64_length(header_bytes))?)?;
        let data = decode(part(base64_length(header_bytes), text.len())?)?;
        let mut bytes = Vec::with_capacity(expected.min(1 << 26));
        let mut start = 0usize;
        for block in 0..blocks {
            let end = start.checked_add(number(&header, 3 + block)).filter(|&end| end <= data.len());
            let end = end.ok_or("data end too early")?;
            // One byte over the expected length is enough to see that a file lies about its size.
            let room = (expected + 1).saturating_sub(bytes.len()) as u64;
            flate2::read::ZlibDecoder::new(&data[start..end])
                .take(room)
                .read_to_end(&mut bytes)
                .map_err(|error| format!("block {block}: {error}"))?;
            start = end;
        }
        if bytes.len() != expected {
            return Err(format!("length {} bytes, expected {expected}", bytes.len()));
        }
        Ok(bytes)
    }
}

/// Length of the base64 text of `bytes` bytes, with padding.
fn base64_length(bytes: usize) -> usize {
    bytes.div_ceil(3) * 4
}

/// Makes a number of the first bytes.
type Reader = fn(&[u8]) -> f64;

/// The type's size in bytes and how to read it, little-endian.
fn scalar(kind: &str) -> Option<(usize, Reader)> {
    /// The first `N` bytes.
    fn le<const N: usize>(bytes: &[u8]) -> [u8; N] {
        std::array::from_fn(|i| bytes[i])
    }
    Some(match kind {
        "Float64" => (8, |b| f64::from_le_bytes(le(b))),
        "Float32" => (4, |b| f64::from(f32::from_le_bytes(le(b)))),
        "UInt8" => (1, |b| f64::from(b[0])),
        "Int8" => (1, |b| f64::from(i8::from_le_bytes(le(b)))),
        "UInt16" => (2, |b| f64::from(u16::from_le_bytes(le(b)))),
        "Int16" => (2, |b| f64::from(i16::from_le_bytes(le(b)))),
        "UInt32" => (4, |b| f64::from(u32::from_le_bytes(le(b)))),
        "Int32" => (4, |b| f64::from(i32::from_le_bytes(le(b)))),
        "UInt64" => (8, |b| u64::from_le_bytes(le(b)) as f64),
        "Int64" => (8, |b| i64::from_le_bytes(le(b)) as f64),
        _ => return None,
    })
}
