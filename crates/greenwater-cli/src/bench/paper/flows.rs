//! Dam breaks that the paper's claims about the flow are tested with: the numbers that are looked at, over time.

use std::time::Instant;

use greenwater::case::{Case, Reference, Setup};
use greenwater::math::Vector;
use greenwater::observe::{Quality, QualityMeter, Sensor, energy, front};
use greenwater::particles::{Kind, Particles};
use greenwater::physics::pressure::Elasticity;
use greenwater::scheme::{MethodName, Preset};
use greenwater_report::measure::{FRONT_LEVELS, lead};
use serde_json::{Map, json};

use super::plan::Plan;
use super::record::{Record, Seconds};
use super::{BenchError, Clock, dam_break, planar, with_threads};

/// Time between samples, s.
const INTERVAL: f64 = 0.02;
/// The front has not yet reached the wall, s (it does at about 0.65 s).
pub const IMPACT: f64 = 0.6;
/// Times at which the two forms of the pressure operator are compared, before impact, s.
pub const COMPARED: [f64; 3] = [0.1, 0.21, 0.5];
/// When the water lies against the right wall after impact, s.
pub const AFTER_IMPACT: [f64; 2] = [1.0, 1.3];
/// Height up to which the right wall is looked at, as a share of the depth of the column.
pub const WALL_SHARE: f64 = 0.2;

/// What is looked at, at one time.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Time, s.
    pub time: f64,
    /// Front from the back wall, m.
    pub front: f64,
    /// Height of the water at the back wall, m.
    pub residual_height: f64,
    /// Pressure noise and density of interior fluid.
    pub quality: Quality,
    /// Least and greatest density of all fluid, over rest.
    pub density: [f64; 2],
    /// Energy of the fluid, J/m; NaN where the equation of state has no single coefficient.
    pub energy: f64,
    /// Pressure on the right wall at a tenth of the depth, Pa.
    pub wall_pressure: f64,
    /// Mean distance of the nearest fluid particles from the first line of the right wall, in spacings.
    pub gap: f64,
    /// Fluid particles within two spacings of that line, as a share of those of a lattice at rest against it.
    pub contact: f64,
}

/// One flow.
#[derive(Clone, Debug)]
pub struct Flow {
    /// Name in legends.
    pub name: String,
    /// Particles, fluid and wall.
    pub particles: usize,
    /// Steps made.
    pub steps: u64,
    /// Wall-clock time of the steps, s.
    pub seconds: f64,
    /// Each step, s.
    pub step_seconds: Seconds,
    /// Time reached, s.
    pub end: f64,
    /// Why it ended before its time.
    pub stopped: Option<String>,
    /// The numbers, over time.
    pub samples: Vec<Sample>,
    /// Pressures of the fluid over `rho g H` at [`COMPARED`], in the order of the particles.
    pub pressures: Vec<Vec<f64>>,
    /// `rho g H`, Pa.
    pub pressure_scale: f64,
    /// Initial spacing, m.
    pub spacing: f64,
    /// Fronts of experiments.
    pub references: Vec<Reference>,
}

/// All flows.
#[derive(Clone, Debug)]
pub struct Results {
    /// SPH with little dissipation.
    pub sph: Flow,
    /// ISPH with little dissipation, pressure operator (16).
    pub isph: Flow,
    /// The same with (17).
    pub isph_17: Flow,
    /// SPH as printed.
    pub sph_printed: Flow,
    /// ISPH as printed.
    pub isph_printed: Flow,
}

/// Runs all flows with all threads.
pub fn measure(plan: &Plan, clock: &Clock) -> Result<Results, BenchError> {
    let flow = |name: &str, setup: Setup<2>| {
        let flow = with_threads(plan.most_threads(), || Flow::run(name, &setup, plan.flow_end))??;
        let outcome = flow.stopped.as_deref().unwrap_or("complete");
        clock.say(&format!("flow: {name}, {} particles, {} steps to {:.3} s: {outcome}", flow.particles, flow.steps, flow.end));
        Ok::<Flow, BenchError>(flow)
    };
    let water = |method, keys: &[(&str, &str)]| dam_break(plan.flow_columns, method, Some(Preset::Water), keys);
    let printed = |method| planar(&Case::load("dam-break-printed", &[])?.for_method(method, Some(Preset::Paper)));
    let brookshaw = [("method.name", "isph-paper"), ("method.laplacian", "brookshaw")];
    Ok(Results {
        sph: flow("SPH", water(MethodName::Wcsph, &[])?)?,
        isph: flow("ISPH, (16)", water(MethodName::IsphPaper, &[])?)?,
        isph_17: flow("ISPH, (17)", water(MethodName::IsphPaper, &brookshaw)?)?,
        sph_printed: flow("SPH as printed", printed(MethodName::Wcsph)?)?,
        isph_printed: flow("ISPH as printed", printed(MethodName::IsphPaper)?)?,
    })
}

impl Flow {
    /// Runs a case to `end`, s, or as far as it goes.
    pub fn run(name: &str, setup: &Setup<2>, end: f64) -> Result<Self, BenchError> {
        let mut simulation = setup.simulation()?;
        let mut looker = Looker::of(setup);
        let mut flow = Self {
            name: name.to_owned(),
            particles: setup.particles.owned(),
            steps: 0,
            seconds: 0.0,
            step_seconds: Seconds::of(&[]),
            end: 0.0,
            stopped: None,
            samples: Vec::new(),
            pressures: Vec::new(),
            pressure_scale: looker.pressure_scale(),
            spacing: setup.spacing,
            references: setup.compare.references.clone(),
        };
        let mut times = Vec::new();
        let mut outcome = simulation.start();
        while outcome.is_ok() {
            let now = simulation.time();
            if now >= flow.samples.len() as f64 * INTERVAL {
                flow.samples.push(looker.look(now, simulation.particles()));
            }
            if COMPARED.get(flow.pressures.len()).is_some_and(|&time| now >= time) {
                let p = simulation.particles();
                let scale = looker.pressure_scale();
                flow.pressures.push((0..p.owned()).filter(|&a| setup.particles.is_fluid(a)).map(|a| p.pressure[a] / scale).collect());
            }
            if now >= end {
                break;
            }
            let clock = Instant::now();
            outcome = simulation.advance().map(|_| ());
            times.push(clock.elapsed().as_secs_f64());
        }
        flow.stopped = outcome.err().map(|error| error.to_string());
        flow.steps = simulation.steps();
        flow.end = simulation.time();
        flow.seconds = times.iter().sum();
        flow.step_seconds = Seconds::of(&times);
        Ok(flow)
    }

    /// Whether it reached the end.
    pub fn complete(&self) -> bool {
        self.stopped.is_none()
    }

    /// Samples between two times, s.
    pub fn between(&self, from: f64, to: f64) -> impl Iterator<Item = &Sample> {
        self.samples.iter().filter(move |sample| (from..=to).contains(&sample.time))
    }

    /// `[t, value]` of every sample.
    pub fn series(&self, value: impl Fn(&Sample) -> f64) -> Vec<[f64; 2]> {
        self.samples.iter().map(|sample| [sample.time, value(sample)]).collect()
    }

    /// Value at the first sample at or after `time`, s.
    pub fn at(&self, time: f64, value: impl Fn(&Sample) -> f64) -> Option<f64> {
        self.samples.iter().find(|sample| sample.time >= time).map(value)
    }

    /// Mean of a value over the samples between two times, s, where it is finite.
    pub fn mean(&self, [from, to]: [f64; 2], value: impl Fn(&Sample) -> f64) -> Option<f64> {
        let values: Vec<f64> = self.between(from, to).map(value).filter(|value| value.is_finite()).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// Leads over the experiments in percent of their times, at the front positions `1.5 <= Z <= 3.5`; positive: ahead.
    pub fn leads(&self) -> Vec<f64> {
        let of = |reference: &Reference| {
            let scaled: Vec<[f64; 2]> =
                self.samples.iter().map(|s| [s.time * reference.time_scale, s.front * reference.value_scale]).collect();
            FRONT_LEVELS.iter().filter_map(|&level| lead(&scaled, &reference.points, level)).collect::<Vec<f64>>()
        };
        self.references.iter().filter(|reference| reference.quantity == "front").flat_map(of).collect()
    }

    /// Largest departure of the energy from its start before impact, over the start.
    pub fn energy_error(&self) -> Option<f64> {
        let start = self.samples.first()?.energy;
        self.between(0.0, IMPACT).map(|sample| (sample.energy / start - 1.0).abs()).filter(|error| error.is_finite()).reduce(f64::max)
    }
}

impl Results {
    /// All flows, in the order of tables.
    pub fn all(&self) -> [&Flow; 5] {
        [&self.sph, &self.isph, &self.isph_17, &self.sph_printed, &self.isph_printed]
    }

    /// Rows of the JSON file.
    pub fn records(&self) -> Vec<Record> {
        let record = |flow: &&Flow| {
            let mut extra = Map::new();
            extra.insert("flow_time".into(), json!(flow.end));
            if let Some(stopped) = &flow.stopped {
                extra.insert("stopped".into(), json!(stopped));
            }
            Record {
                bench: "flow".into(),
                workload: "dam break".into(),
                method: flow.name.clone(),
                dimension: 2,
                particles: flow.particles,
                threads: rayon::current_num_threads(),
                seconds: Some(flow.step_seconds),
                repetitions: flow.steps as usize,
                particle_steps_per_s: Some(flow.particles as f64 * flow.steps as f64 / flow.seconds),
                extra,
                ..Record::default()
            }
        };
        self.all().iter().filter(|flow| flow.steps > 0).map(record).collect()
    }
}

/// Reads the numbers of a [`Sample`] off a state.
struct Looker<'a> {
    setup: &'a Setup<2>,
    meter: QualityMeter<2>,
    /// `B` of the equation of state, Pa, where it is one number; none for an incompressible method.
    elasticity: Elasticity,
    /// First line of the right wall, m.
    wall: f64,
}

impl<'a> Looker<'a> {
    fn of(setup: &'a Setup<2>) -> Self {
        let medium = setup.medium();
        let p = &setup.particles;
        let first_line = (0..p.owned()).filter(|&a| p.kind[a] == Kind::Wall && p.layer[a] == 1).map(|a| p.x[a][0]);
        let elasticity = setup.method.elasticity(&medium);
        Self { setup, meter: QualityMeter::new(setup.spacing), elasticity, wall: first_line.fold(f64::NEG_INFINITY, f64::max) }
    }

    fn pressure_scale(&self) -> f64 {
        let medium = self.setup.medium();
        medium.rest_density * medium.g() * medium.depth
    }

    fn look(&mut self, time: f64, p: &Particles<2>) -> Sample {
        let medium = self.setup.medium();
        let quality = self.meter.measure(p, &medium);
        let water = front(p, &medium, 0.0);
        let fluid = || (0..p.owned()).filter(|&a| p.is_fluid(a));
        let density = fluid()
            .map(|a| p.density[a] / medium.rest_density)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], s| [low.min(s), high.max(s)]);
        let probe = Vector([self.wall, medium.floor + 0.1 * medium.depth]);
        let sensor = Sensor::new("wall".to_owned(), probe, 0.0, Vector::ZERO, medium.spacing);
        let (gap, contact) = at_wall(p, self.wall, medium.floor, WALL_SHARE * medium.depth, medium.spacing);
        Sample {
            time,
            front: water.front,
            residual_height: water.residual_height,
            quality,
            density,
            energy: if self.elasticity != Elasticity::Unknown { energy(p, &medium, self.elasticity).total() } else { f64::NAN },
            wall_pressure: sensor.pressure(p, &medium),
            gap,
            contact,
        }
    }
}

/// How far fluid is from the wall whose first line is at `x = wall`, m, between `floor` and `floor + height`, m: in each band of
/// two spacings the distance of the nearest fluid particle to the line, at most a tenth of the tank; their mean, in spacings. And the
/// particles within two spacings of the line over the two that a lattice at rest has in each spacing of height.
fn at_wall(p: &Particles<2>, wall: f64, floor: f64, height: f64, spacing: f64) -> (f64, f64) {
    let farthest = 0.1 * wall;
    let bands = ((height / (2.0 * spacing)).floor() as usize).max(1);
    let mut nearest = vec![farthest; bands];
    let mut close = 0;
    for a in (0..p.owned()).filter(|&a| p.is_fluid(a)) {
        let band = (p.x[a][1] - floor) / (2.0 * spacing);
        if band >= 0.0 && band < bands as f64 {
            let distance = wall - p.x[a][0];
            let least = &mut nearest[band as usize];
            *least = least.min(distance);
            close += usize::from(distance <= 2.0 * spacing);
        }
    }
    let mean = nearest.iter().sum::<f64>() / bands as f64;
    (mean / spacing, close as f64 / (4.0 * bands as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use greenwater::math::Vector;
    use greenwater::particles::Particle;

    #[test]
    fn a_lattice_against_the_wall_has_half_a_spacing_of_gap_and_full_contact() {
        for (away, gap, contact) in [(0, 0.5, 1.0), (1, 1.5, 0.5), (3, 3.5, 0.0)] {
            let mut p = Particles::new();
            for (i, j) in (away..10).flat_map(|i| (0..12).map(move |j| (i, j))) {
                let x = Vector([10.0 - 0.1 * (f64::from(i) + 0.5), 0.1 * (f64::from(j) + 0.5)]);
                let fluid = Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h: 0.1 };
                p.push((100 * i + j) as u32, fluid);
            }
            let (found_gap, found_contact) = at_wall(&p, 10.0, 0.0, 0.8, 0.1);
            assert!((found_gap - gap).abs() < 1e-9 && (found_contact - contact).abs() < 1e-9, "{found_gap}, {found_contact}");
        }
    }

    #[test]
    fn a_flow_leaves_samples_from_its_start_to_its_end() {
        let setup = dam_break(6, MethodName::IsphPaper, Some(Preset::Water), &[]).expect("the case is sound");
        let flow = Flow::run("ISPH", &setup, 0.12).expect("settings are sound");
        assert!(flow.complete() && flow.end >= 0.12, "{:?}", flow.stopped);
        assert_eq!((flow.samples.len(), flow.pressures.len()), (7, 1));
        let (first, last) = (flow.samples[0], flow.samples[6]);
        assert_eq!(first.time, 0.0);
        assert!((first.front - 0.75).abs() < 1e-9 && last.front > first.front);
        assert_eq!(flow.pressures[0].len(), 72);
        // Dry walls: the gap is the greatest that is looked for.
        assert!((first.gap * setup.spacing / 0.3 - 1.0).abs() < 0.05 && first.contact == 0.0);
    }
}
