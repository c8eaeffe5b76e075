//! Table 3 of the paper: what 2000 steps of both methods cost at five sizes.

use std::time::Instant;

use greenwater::scheme::MethodName;
use serde_json::{Map, json};

use super::plan::Plan;
use super::record::{Record, Seconds};
use super::{BenchError, Clock, dam_break, with_threads};

/// Steps that the paper gives times for.
pub const STEPS: f64 = 2000.0;

/// The cost of one method at one size.
#[derive(Clone, Debug)]
pub struct Cost {
    /// The method.
    pub method: MethodName,
    /// Fluid particles.
    pub fluid: usize,
    /// Particles, fluid and wall.
    pub particles: usize,
    /// Number of threads.
    pub threads: usize,
    /// Steps made.
    pub steps: u64,
    /// Time of the flow after them, s.
    pub end: f64,
    /// Time of a step, over the steps of the fastest run, s.
    pub step_seconds: Seconds,
    /// Time of all steps in the fastest run, s.
    pub total_seconds: f64,
    /// Mean iterations of a pressure solve.
    pub iterations: Option<f64>,
    /// Seconds by phase, in the fastest run.
    pub phases: Vec<(&'static str, f64)>,
}

impl Cost {
    /// Seconds of 2000 steps, scaled from those made.
    pub fn of_2000_steps(&self) -> f64 {
        self.total_seconds * STEPS / self.steps as f64
    }

    /// Microseconds for a particle and a step.
    pub fn per_particle_step(&self) -> f64 {
        1e6 * self.total_seconds / (self.steps as f64 * self.particles as f64)
    }
}

/// All costs.
#[derive(Clone, Debug)]
pub struct Results {
    /// By size, then threads, then method.
    pub costs: Vec<Cost>,
    /// Runs made for each cell.
    pub runs: usize,
}

/// Times both methods from the start of the dam break, at every size, with one thread and with all.
pub fn measure(plan: &Plan, clock: &Clock) -> Result<Results, BenchError> {
    let mut costs = Vec::new();
    let mut threads = vec![1, plan.most_threads()];
    threads.dedup();
    for &columns in &plan.sizes {
        for &threads in &threads {
            // Methods by turns, so that a busy while of the machine does not meet one of them alone.
            let mut best: [Option<Cost>; 2] = [None, None];
            for _ in 0..plan.runs {
                for (best, method) in best.iter_mut().zip([MethodName::Wcsph, MethodName::IsphPaper]) {
                    let cost = with_threads(threads, || time(columns, method, threads, plan.steps))??;
                    if best.as_ref().is_none_or(|best| cost.total_seconds < best.total_seconds) {
                        *best = Some(cost);
                    }
                }
            }
            for cost in best.into_iter().flatten() {
                let (name, n, us) = (cost.method.name(), cost.particles, cost.per_particle_step());
                clock.say(&format!("{} steps: {name}, {n} particles, {threads} threads: {us:.3} us a particle and step", cost.steps));
                costs.push(cost);
            }
        }
    }
    Ok(Results { costs, runs: plan.runs })
}

fn time(columns: u32, method: MethodName, threads: usize, steps: u64) -> Result<Cost, BenchError> {
    let setup = dam_break(columns, method, None, &[])?;
    let particles = setup.particles.owned();
    let failed = |source| BenchError::Run { method: method.name(), particles, source };
    let mut simulation = setup.simulation()?;
    simulation.start().map_err(failed)?;
    let mut times = Vec::with_capacity(steps as usize);
    let mut iterations = Vec::new();
    for _ in 0..steps {
        let clock = Instant::now();
        let (_, report) = simulation.advance().map_err(failed)?;
        times.push(clock.elapsed().as_secs_f64());
        iterations.extend(report.iterations);
    }
    let mean = iterations.iter().sum::<usize>() as f64 / iterations.len() as f64;
    Ok(Cost {
        method,
        fluid: setup.estimate.fluid,
        particles,
        threads,
        steps,
        end: simulation.time(),
        step_seconds: Seconds::of(&times),
        total_seconds: times.iter().sum(),
        iterations: (!iterations.is_empty()).then_some(mean),
        phases: simulation.phases().iter().collect(),
    })
}

impl Results {
    /// The cost of a method at a size.
    pub fn find(&self, method: MethodName, particles: usize, threads: usize) -> Option<&Cost> {
        self.costs.iter().find(|c| c.method == method && c.particles == particles && c.threads == threads)
    }

    /// Costs of a method with one thread, by size.
    pub fn serial(&self, method: MethodName) -> impl Iterator<Item = &Cost> {
        self.costs.iter().filter(move |c| c.method == method && c.threads == 1)
    }

    /// Largest number of threads.
    pub fn most_threads(&self) -> usize {
        self.costs.iter().map(|c| c.threads).max().unwrap_or(1)
    }

    /// `(particles, ISPH/SPH)`: how many steps of SPH a step of ISPH costs, with one thread.
    pub fn ratios(&self) -> Vec<(usize, f64)> {
        let sph = |n| self.find(MethodName::Wcsph, n, 1);
        let ratio = |isph: &Cost| Some((isph.particles, isph.per_particle_step() / sph(isph.particles)?.per_particle_step()));
        self.serial(MethodName::IsphPaper).filter_map(ratio).collect()
    }

    /// Greatest over least cost of SPH over the sizes, minus one: for a particle, and for a fluid particle. Of the median step, which
    /// a busy moment of the machine does not touch.
    pub fn sph_unevenness(&self) -> Option<[f64; 2]> {
        let uneven = |particles: fn(&Cost) -> usize| {
            let costs = || self.serial(MethodName::Wcsph).map(|cost| cost.step_seconds.median / particles(cost) as f64);
            Some(costs().reduce(f64::max)? / costs().reduce(f64::min)? - 1.0)
        };
        Some([uneven(|cost| cost.particles)?, uneven(|cost| cost.fluid)?])
    }

    /// Rows of the JSON file.
    pub fn records(&self) -> Vec<Record> {
        let record = |c: &Cost| Record {
            bench: "step".into(),
            workload: "dam break".into(),
            method: c.method.name().into(),
            dimension: 2,
            particles: c.particles,
            threads: c.threads,
            seconds: Some(c.step_seconds),
            repetitions: c.steps as usize,
            particle_steps_per_s: Some(1e6 / c.per_particle_step()),
            iterations: c.iterations,
            phases: c.phases.iter().map(|&(name, seconds)| (name.into(), seconds)).collect(),
            extra: Map::from_iter([
                ("seconds_of_2000_steps".to_owned(), json!(c.of_2000_steps())),
                ("flow_time".to_owned(), json!(c.end)),
                ("runs".to_owned(), json!(self.runs)),
            ]),
            ..Record::default()
        };
        self.costs.iter().map(record).collect()
    }
}
