//! The observer that writes a run folder, and the call that makes a whole run.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::Serialize;
use serde_json::{Value, json};

use super::folder::{Existing, OutputError, RunFolder};
use super::frames::{Frame, Frames};
use super::instruments::Instruments;
use super::provenance::provenance;
use super::tables::{Cell, Table};
use crate::case::Setup;
use crate::observe::{Energy, Front, Observer, Quality, QualityMeter, View, energy, front};
use crate::physics::pressure::Elasticity;
use crate::poisson::SolveError;
use crate::scheme::{Medium, StepError};
use crate::simulation::{RunError, Simulation, Stop};

/// About the number of rows in `steps.csv`; every k-th step is written, and k doubles each time as many rows again are full.
const STEP_ROWS: u64 = 16_000;

/// Least time between two writings of `status.json`.
const STATUS_EVERY: Duration = Duration::from_millis(500);

/// Least, median and greatest of a series.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Least value of all steps.
    pub min: f64,
    /// Median of the steps in `steps.csv`.
    pub median: f64,
    /// Greatest value of all steps.
    pub max: f64,
}

/// What a run came to: `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Version of the file.
    pub format: u32,
    /// Name of the method.
    pub method: &'static str,
    /// Name of the preset.
    pub preset: &'static str,
    /// Whether the end was reached.
    pub completed: bool,
    /// Steps made.
    pub steps: u64,
    /// Time reached, s.
    pub end_time: f64,
    /// Wall-clock time, s.
    pub wall_seconds: f64,
    /// Wall-clock time that writing the run folder took, s; part of `wall_seconds`.
    pub output_seconds: f64,
    /// Threads used.
    pub threads: usize,
    /// Time steps, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dt: Option<Spread>,
    /// Wall-clock time of each phase of the steps, s.
    pub phases: BTreeMap<&'static str, f64>,
    /// Iterations of the pressure solve; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<Spread>,
    /// Particles at the end: fluid and wall.
    pub particles: BTreeMap<&'static str, usize>,
    /// Fluid particles that left the domain.
    pub lost_particles: usize,
    /// Median of the pressure noise over the frames in `pressure_noise_window`, over `ρ g H`; null if there is none.
    pub pressure_noise: Option<f64>,
    /// From 25 % to 50 % of the end time asked for, s.
    pub pressure_noise_window: [f64; 2],
    /// Lowest 1st and highest 99th percentile over all frames of the density of interior fluid, over the rest density.
    pub density_percentiles: BTreeMap<&'static str, Option<f64>>,
    /// Volume error in the last frame, dimensionless.
    pub volume_error: Option<f64>,
    /// Total energy at the start and the end, J (J/m in 2D), and its greatest rise over the start, relative to that.
    pub energy: BTreeMap<&'static str, Option<f64>>,
    /// What the energies leave out, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub energy_note: Option<&'static str>,
}

/// A finished run.
#[derive(Debug)]
pub struct Finished {
    /// The run folder.
    pub folder: PathBuf,
    /// What the run came to.
    pub summary: Summary,
    /// Why it ended early, if it did.
    pub failure: Option<RunError>,
}

/// Makes a whole run, the `simulation` of `setup`, and writes its folder at `path`. `command` is the command line, for the record; `watch` looks on.
///
/// A run that fails is no error here: its folder says why, and so does [`Finished::failure`].
///
/// # Errors
/// The folder could not be made or written.
pub fn record<const D: usize>(
    setup: &Setup<D>,
    simulation: Result<Simulation<D>, SolveError>,
    path: &Path,
    existing: Existing,
    command: &[String],
    watch: &mut dyn Observer<D>,
) -> Result<Finished, OutputError> {
    let mut recorder = Recorder::create(setup, path, existing, command)?;
    let stop = Stop { end: setup.time.end, steps: setup.time.max_steps };
    let outcome = match simulation {
        Ok(mut simulation) => simulation.run(stop, &mut [&mut recorder, watch]),
        Err(source) => Err(RunError::Step { source: StepError::Pressure(source), time: 0.0, step: 0 }),
    };
    recorder.close(outcome)
}

/// Writes the folder of one run while it goes on.
pub struct Recorder<'a, const D: usize> {
    setup: &'a Setup<D>,
    medium: Medium<D>,
    /// `B` of the elastic energy, Pa.
    elasticity: Elasticity,
    folder: RunFolder,
    frames: Frames<D>,
    energy: Table,
    front: Table,
    instruments: Instruments<D>,
    quality: Table,
    steps: Table,
    log: Table,
    events: Table,
    meter: QualityMeter<D>,
    /// Position of the back wall along x, m.
    back: f64,
    next_sample: f64,
    every: u64,
    last: Last,
    energies: Option<[f64; 3]>,
    dt: Series,
    iterations: Series,
    qualities: Vec<(f64, Quality)>,
    clock: Instant,
    spent: Duration,
    status_written: Option<Instant>,
}

/// What is known of the last state seen.
#[derive(Clone, Default)]
struct Last {
    step: u64,
    time: f64,
    elapsed: f64,
    sampled: Option<u64>,
    framed: Option<u64>,
    phases: BTreeMap<&'static str, f64>,
    fluid: usize,
    wall: usize,
    lost: usize,
}

/// Extremes of all values, and those that were written.
#[derive(Default)]
struct Series {
    range: Option<[f64; 2]>,
    kept: Vec<f64>,
}

impl Series {
    fn add(&mut self, value: f64, keep: bool) {
        let [low, high] = self.range.unwrap_or([value, value]);
        self.range = Some([low.min(value), high.max(value)]);
        if keep {
            self.kept.push(value);
        }
    }

    fn spread(&self) -> Option<Spread> {
        let [min, max] = self.range?;
        Some(Spread { min, median: median(self.kept.iter().copied()).unwrap_or(min), max })
    }
}

/// Median of the finite values; the mean of the middle two of an even number.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| 0.5 * (values[(n - 1) / 2] + values[n / 2]))
}

impl<'a, const D: usize> Recorder<'a, D> {
    /// Makes the run folder at `path` and writes what is known before the first step.
    ///
    /// # Errors
    /// The folder is in the way, or the system refuses.
    pub fn create(setup: &'a Setup<D>, path: &Path, existing: Existing, command: &[String]) -> Result<Self, OutputError> {
        let folder = RunFolder::create(path, existing)?;
        let started = humantime::format_rfc3339_micros(SystemTime::now()).to_string();
        let provenance = provenance(setup, command, &started);
        put(&folder, "provenance.json", pretty(&provenance).as_bytes())?;
        put(&folder, "case.toml", setup.written.as_bytes())?;
        put(&folder, "case.resolved.toml", setup.resolved.as_bytes())?;
        if let Some((name, source)) = setup.particle_table() {
            let error = |e| folder.error(name, e);
            let copy = folder.path().join(name);
            std::fs::create_dir_all(copy.parent().unwrap_or(folder.path())).map_err(error)?;
            std::fs::copy(source, &copy).map_err(error)?;
        }
        let table = |name: &str, header: &str| Table::create(&folder, name, header).map_err(|e| folder.error(name, e));
        let joule = if D == 2 { "J/m" } else { "J" };
        let energy = ["kinetic", "potential", "elastic", "total"].map(|part| format!("{part} [{joule}]")).join(",");
        let p = &setup.particles;
        let back = (0..p.owned()).filter(|&a| p.is_fluid(a)).map(|a| p.x[a][0]).fold(f64::INFINITY, f64::min) - 0.5 * setup.spacing;
        let mut recorder = Self {
            medium: setup.medium(),
            elasticity: setup.method.elasticity(&setup.medium()),
            frames: Frames::new(&setup.output.fields, setup.output.precision, setup.output.frame_times.clone()),
            energy: table("energy.csv", &format!("time [s],{energy}"))?,
            front: table("front.csv", "time [s],front [m],residual_height [m]")?,
            instruments: Instruments::create(setup, table)?,
            quality: table(
                "quality.csv",
                "time [s],pressure_noise [1],density_p01 [1],density_p99 [1],density_mean [1],volume_error [1],lost_particles [1]",
            )?,
            steps: table("steps.csv", "step,time [s],dt [s],limit,iterations,residual [1],maximum_speed [m/s],wall_clock [s]")?,
            log: table("log.txt", &format!("{started} greenwater {} runs {}", env!("CARGO_PKG_VERSION"), setup.title))?,
            events: table("events.jsonl", &json!({"event": "started", "at": started, "end": setup.time.end}).to_string())?,
            meter: QualityMeter::new(setup.spacing),
            back,
            next_sample: 0.0,
            every: ((setup.estimate.steps.unwrap_or(0.0) / STEP_ROWS as f64).ceil() as u64).max(1),
            last: Last::default(),
            energies: None,
            dt: Series::default(),
            iterations: Series::default(),
            qualities: Vec::new(),
            clock: Instant::now(),
            spent: Duration::ZERO,
            status_written: None,
            setup,
            folder,
        };
        recorder.introduce(command).map_err(|e| recorder.folder.error("log.txt", e))?;
        Ok(recorder)
    }

    /// Writes how the run ended: `summary.json`, `DONE` or `FAILED.json`, and the last lines of the log.
    ///
    /// # Errors
    /// The system refuses.
    pub fn close(mut self, outcome: Result<(), RunError>) -> Result<Finished, OutputError> {
        let failure = outcome.err();
        let summary = self.summary(failure.is_none());
        let closing = match &failure {
            None => self.conclude("DONE", &[], "finished", json!({})),
            Some(error) => {
                let text = failure_json(error);
                self.conclude("FAILED.json", pretty(&text).as_bytes(), "failed", text)
            }
        };
        closing.map_err(|e| self.folder.error("log.txt", e))?;
        put(&self.folder, "summary.json", pretty(&json!(summary)).as_bytes())?;
        Ok(Finished { folder: self.folder.path().to_owned(), summary, failure })
    }

    fn introduce(&mut self, command: &[String]) -> io::Result<()> {
        let (setup, e) = (self.setup, &self.setup.estimate);
        let method = setup.method.method();
        self.say(&format!("command: {}", command.join(" ")))?;
        self.say(&format!(
            "method {} with preset {}, {} threads",
            method.name(),
            setup.method.preset_name().name(),
            rayon::current_num_threads()
        ))?;
        self.say(&format!("{} fluid and {} wall particles, spacing {} m, {} to {} s", e.fluid, e.walls, setup.spacing, 0, setup.time.end))?;
        for departure in setup.method.departures(setup.viscosity, setup.kernel) {
            self.say(&format!("departs from print: {departure}"))?;
        }
        if let Some(note) = self.energy_note() {
            self.say(note)?;
        }
        self.say(&format!("steps.csv has every {} step(s), rarer after each {STEP_ROWS} rows", self.every))?;
        self.log.flush()?;
        self.events.flush()?;
        self.write_status("running", true)
    }

    fn conclude(&mut self, name: &str, bytes: &[u8], state: &str, mut event: Value) -> io::Result<()> {
        let last = self.frames.settle(&self.folder)?;
        self.tell_of(last)?;
        if self.frames.count() > 0 {
            self.frames.write_index(&self.folder)?;
        }
        self.say(&format!("{state} at t = {} s, step {}, after {:.2} s", self.last.time, self.last.step, self.last.elapsed))?;
        event["event"] = json!(state);
        event["time"] = json!(self.last.time);
        event["step"] = json!(self.last.step);
        self.events.row(&[Cell::Text(&event.to_string())])?;
        for table in [&mut self.energy, &mut self.front, &mut self.quality, &mut self.steps, &mut self.log, &mut self.events] {
            table.flush()?;
        }
        self.instruments.flush()?;
        self.write_status(state, true)?;
        self.folder.write(name, bytes)
    }

    fn say(&mut self, text: &str) -> io::Result<()> {
        self.log.row(&[Cell::Text(&format!("[{:9.3} s] {text}", self.clock.elapsed().as_secs_f64()))])
    }

    /// What the elastic energy leaves out.
    fn energy_note(&self) -> Option<&'static str> {
        (self.elasticity == Elasticity::Unknown)
            .then_some("elastic energy is written as 0: with B by height the equation of state has no energy common to all particles")
    }

    fn sample(&mut self, view: &View<D>) -> io::Result<()> {
        let Energy { kinetic, potential, elastic } = energy(view.particles, &self.medium, self.elasticity);
        let total = kinetic + potential + elastic;
        self.energy.numbers([view.time, kinetic, potential, elastic, total])?;
        let [first, _, highest] = self.energies.unwrap_or([total, total, total]);
        self.energies = Some([first, total, highest.max(total)]);
        let Front { front, residual_height } = front(view.particles, &self.medium, self.back);
        self.front.numbers([view.time, front, residual_height])?;
        let interval = self.setup.output.sample_interval;
        if interval > 0.0 {
            self.next_sample = interval * ((view.time / interval).floor() + 1.0);
        }
        self.last.sampled = Some(view.step);
        Ok(())
    }

    /// Tells of a frame once it is on the disk.
    fn tell_of(&mut self, frame: Option<Frame>) -> io::Result<()> {
        let Some(Frame { index, time, step }) = frame else { return Ok(()) };
        let event = json!({"event": "frame", "frame": index, "time": time, "step": step});
        self.events.row(&[Cell::Text(&event.to_string())])
    }

    fn frame(&mut self, view: &View<D>) -> io::Result<()> {
        let before = self.frames.write(&self.folder, view.particles, view.time, view.step)?;
        self.tell_of(before)?;
        let q = self.meter.measure(view.particles, &self.medium);
        let lost = q.lost_particles;
        self.quality.numbers([view.time, q.pressure_noise, q.density_p01, q.density_p99, q.density_mean, q.volume_error, lost as f64])?;
        self.qualities.push((view.time, q));
        if lost > self.last.lost {
            self.say(&format!("{lost} particles have left the domain by t = {} s", view.time))?;
        }
        self.last.lost = lost;
        self.last.framed = Some(view.step);
        for table in [&mut self.energy, &mut self.front, &mut self.quality, &mut self.steps, &mut self.log, &mut self.events] {
            table.flush()?;
        }
        self.instruments.flush()?;
        self.write_status("running", false)
    }

    fn step_row(&mut self, view: &View<D>) -> io::Result<()> {
        let Some(limit) = view.limit else { return Ok(()) };
        let keep = view.step.is_multiple_of(self.every) || view.step == 1;
        self.dt.add(limit.dt, keep);
        if let Some(iterations) = view.report.iterations {
            self.iterations.add(iterations as f64, keep);
        }
        if !keep {
            return Ok(());
        }
        if (self.dt.kept.len() as u64).is_multiple_of(STEP_ROWS) {
            self.every *= 2;
        }
        let p = view.particles;
        let fastest = crate::sweep::largest(p.owned(), |a| p.v[a].norm_squared()).sqrt();
        self.steps.row(&[
            Cell::Count(view.step),
            Cell::Number(view.time),
            Cell::Number(limit.dt),
            Cell::Text(limit.name),
            view.report.iterations.map_or(Cell::Empty, |n| Cell::Count(n as u64)),
            view.report.residual.map_or(Cell::Empty, Cell::Number),
            Cell::Number(fastest),
            Cell::Number((1e6 * view.elapsed).round() / 1e6),
        ])
    }

    fn write_status(&mut self, state: &str, now: bool) -> io::Result<()> {
        if !now && self.status_written.is_some_and(|last| last.elapsed() < STATUS_EVERY) {
            return Ok(());
        }
        self.status_written = Some(Instant::now());
        let status = json!({
            "format": 1, "state": state, "time": self.last.time, "end": self.setup.time.end, "step": self.last.step,
            "wall_seconds": self.last.elapsed, "frames": self.frames.count(), "lost_particles": self.last.lost,
            "updated": humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
        });
        self.folder.write("status.json", pretty(&status).as_bytes())
    }

    fn summary(&self, completed: bool) -> Summary {
        let end = self.setup.time.end;
        let window = [0.25 * end, 0.5 * end];
        let inside = |time: f64| time >= window[0] && time <= window[1];
        let of_frames = |value: fn(&Quality) -> f64| self.qualities.iter().map(move |(_, q)| value(q)).filter(|value| value.is_finite());
        let noise = self.qualities.iter().filter(|(time, _)| inside(*time)).map(|(_, q)| q.pressure_noise);
        let last_quality = self.qualities.last().map(|(_, q)| q);
        let rise = self.energies.map(|[first, _, highest]| (highest - first) / first.abs());
        Summary {
            format: 1,
            method: self.setup.method.method().name(),
            preset: self.setup.method.preset_name().name(),
            completed,
            steps: self.last.step,
            end_time: self.last.time,
            wall_seconds: self.last.elapsed,
            output_seconds: self.spent.as_secs_f64(),
            threads: rayon::current_num_threads(),
            dt: self.dt.spread(),
            phases: self.last.phases.clone(),
            iterations: self.iterations.spread(),
            particles: BTreeMap::from([("fluid", self.last.fluid), ("wall", self.last.wall)]),
            lost_particles: self.last.lost,
            pressure_noise: median(noise),
            pressure_noise_window: window,
            density_percentiles: BTreeMap::from([
                ("p01", of_frames(|q| q.density_p01).reduce(f64::min)),
                ("p99", of_frames(|q| q.density_p99).reduce(f64::max)),
            ]),
            volume_error: last_quality.map(|q| q.volume_error).filter(|error| error.is_finite()),
            energy: BTreeMap::from([
                ("initial", self.energies.map(|e| e[0])),
                ("final", self.energies.map(|e| e[1])),
                ("max_rise", rise.filter(|rise| rise.is_finite())),
            ]),
            energy_note: self.energy_note(),
        }
    }
}

impl<const D: usize> Observer<D> for Recorder<'_, D> {
    fn observe(&mut self, view: &View<D>) -> io::Result<()> {
        let start = Instant::now();
        self.last.step = view.step;
        self.last.time = view.time;
        self.last.elapsed = view.elapsed;
        self.step_row(view)?;
        if view.time >= self.next_sample {
            self.sample(view)?;
        }
        self.instruments.observe(self.setup, &self.medium, view)?;
        if self.frames.due(view.time) {
            self.frame(view)?;
        }
        self.spent += start.elapsed();
        Ok(())
    }

    fn finish(&mut self, view: &View<D>) -> io::Result<()> {
        let start = Instant::now();
        if self.last.sampled != Some(view.step) {
            self.sample(view)?;
        }
        self.instruments.finish(self.setup, &self.medium, view)?;
        if self.last.framed != Some(view.step) {
            self.frame(view)?;
        }
        let last = self.frames.settle(&self.folder)?;
        self.tell_of(last)?;
        let p = view.particles;
        self.last.fluid = p.count(crate::particles::Kind::Fluid);
        self.last.wall = p.count(crate::particles::Kind::Wall);
        self.last.lost = p.count(crate::particles::Kind::Lost);
        self.last.phases = view.phases.iter().collect();
        self.spent += start.elapsed();
        self.last.elapsed = view.elapsed + start.elapsed().as_secs_f64();
        Ok(())
    }
}

/// What `FAILED.json` says.
fn failure_json(error: &RunError) -> Value {
    let mut value = json!({"format": 1, "error": error.to_string(), "exit_code": error.exit_code()});
    if let RunError::Step { time, step, .. } | RunError::Interrupted { time, step } = error {
        value["time"] = json!(time);
        value["step"] = json!(step);
    }
    if let RunError::Step { source, .. } = error {
        value["field"] = json!(source.field());
        if let Some(particle) = source.particle() {
            value["particle"] = json!(particle);
        }
    }
    value
}

fn pretty(value: &Value) -> String {
    format!("{value:#}\n")
}

fn put(folder: &RunFolder, name: &str, bytes: &[u8]) -> Result<(), OutputError> {
    folder.write(name, bytes).map_err(|source| folder.error(name, source))
}
