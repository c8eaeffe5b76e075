//! `bench step`: what a step costs, by phase, beside the plain loop on the same particles.

use greenwater::case::{AnySetup, Setup};
use greenwater::kernel::Kernel;
use greenwater::kernel::WendlandC2;
use greenwater::particles::Particles;
use greenwater::scheme::{MethodName, MethodSettings};
use greenwater::simulation::Simulation;
use serde_json::{Map, json};

use super::naive::{Constants, List, Sums, operations_a_pair};
use super::record::{Record, Seconds};
use super::session::Session;
use super::watch::{Lap, Watch, repeated, seconds};
use super::workloads::Flow;
use super::{BenchError, Clock, Plan, memory, with_threads};

/// Phases of a weakly compressible step that go through the pairs of an evaluation, each once: forces, and rates of density.
const PAIR_LOOPS: [&str; 2] = ["forces", "density"];

/// What the plain list and loop gave, on one thread: once for a flow, whatever the threads.
struct Twin {
    /// Time of the list, s.
    list: f64,
    /// Time of the loop, s.
    sums: f64,
    /// Pairs from the side of the fluid.
    pairs: usize,
}

/// What one flow on some threads gave.
struct Timed {
    particles: usize,
    fluid: usize,
    /// Time of each step.
    steps: Vec<Lap>,
    /// Evaluations of each step.
    evaluations: Vec<f64>,
    iterations: Vec<f64>,
    listed: Option<usize>,
    phases: Vec<(&'static str, f64)>,
    /// Most bytes held.
    bytes: usize,
    flow_time: f64,
    /// Time of all steps.
    all: Lap,
}

impl Timed {
    /// Least wall time of an evaluation with its share of the step, s; of a whole second, all of it.
    fn least_wall(&self, flow: &Flow) -> f64 {
        if flow.second {
            return self.all.wall;
        }
        self.steps.iter().zip(&self.evaluations).map(|(step, evaluations)| step.wall / evaluations).fold(f64::INFINITY, f64::min)
    }
}

/// Times every flow with every number of threads.
pub fn measure<'a>(
    flows: impl Iterator<Item = &'a Flow>,
    plan: &Plan,
    session: &Session,
    clock: &Clock,
) -> Result<Vec<Record>, BenchError> {
    let mut records = Vec::new();
    for flow in flows {
        let mut twin = None;
        let mut one_thread = None;
        for &threads in &plan.threads {
            let (timed, of_twin) = with_threads(threads, || match flow.setup()? {
                AnySetup::D2(setup) => time(flow, &setup, Setup::<2>::simulation, plan, twin.is_none()),
                AnySetup::D3(setup) => time(flow, &setup, Setup::<3>::simulation, plan, twin.is_none()),
            })??;
            twin = twin.or(of_twin);
            let record = record(flow, threads, &timed, twin.as_ref(), session, one_thread);
            if threads == 1 {
                one_thread = Some(timed.least_wall(flow));
            }
            let (name, n, rate) = (flow.name, timed.particles, 1e-6 * record.particle_steps_per_s.unwrap_or(0.0));
            clock.say(&format!("{name}: {n} particles, {threads} threads: {rate:.3} M particle-steps/s"));
            records.push(record);
        }
    }
    Ok(records)
}

fn time<const D: usize>(
    flow: &Flow,
    setup: &Setup<D>,
    simulation: impl Fn(&Setup<D>) -> Result<Simulation<D>, greenwater::poisson::SolveError>,
    plan: &Plan,
    with_twin: bool,
) -> Result<(Timed, Option<Twin>), BenchError> {
    let particles = setup.particles.owned();
    let failed = |source| BenchError::Run { method: flow.method.name(), particles, source };
    let gauge = memory::Gauge::start();
    let mut simulation = simulation(setup)?;
    simulation.start().map_err(failed)?;
    for _ in 0..if plan.quick { flow.warm_up.min(2) } else { flow.warm_up } {
        simulation.advance().map_err(failed)?;
    }
    let mut timed = Timed {
        particles,
        fluid: setup.estimate.fluid,
        steps: Vec::new(),
        evaluations: Vec::new(),
        iterations: Vec::new(),
        listed: None,
        phases: Vec::new(),
        bytes: 0,
        flow_time: 0.0,
        all: Watch::start().lap(),
    };
    let phases_before: Vec<(&str, f64)> = simulation.phases().iter().collect();
    let watch = Watch::start();
    loop {
        let step = Watch::start();
        let (_, report) = simulation.advance().map_err(failed)?;
        timed.steps.push(step.lap());
        timed.evaluations.push(report.evaluations.unwrap_or(1) as f64);
        timed.iterations.extend(report.iterations.map(|n| n as f64));
        timed.listed = report.listed_pairs;
        let enough = timed.steps.len() >= plan.repeats && watch.lap().wall >= plan.seconds;
        let done = if flow.second { simulation.time() >= 1.0 } else { enough };
        if done {
            break;
        }
    }
    let since = |(name, seconds): (&'static str, f64)| {
        (name, seconds - phases_before.iter().find(|(known, _)| *known == name).map_or(0.0, |(_, before)| *before))
    };
    timed.all = watch.lap();
    timed.phases = simulation.phases().iter().map(since).collect();
    timed.bytes = gauge.peak();
    timed.flow_time = simulation.time();
    let twin = if with_twin && flow.method == MethodName::DeltaSph { Some(twin(setup, simulation.particles(), plan)?) } else { None };
    Ok((timed, twin))
}

/// The plain loop on these particles.
fn twin<const D: usize>(setup: &Setup<D>, p: &Particles<D>, plan: &Plan) -> Result<Twin, BenchError> {
    let h = setup.smoothing_length;
    let (delta, factor) = match &setup.method {
        MethodSettings::DeltaSph(s) => (s.delta, s.sound_factor),
        _ => (0.0, 10.0),
    };
    let sound = factor * 2.0 * (setup.gravity.norm() * setup.depth).sqrt();
    let row = setup.rest_density * setup.gravity.norm() * setup.spacing;
    let constants = Constants { h, sound, rest: setup.rest_density, row, delta, gravity: setup.gravity, slope: 1.0 };
    let reach = Kernel::<D>::radius(WendlandC2) * h;
    let plan = Plan { repeats: plan.repeats.min(3), ..plan.clone() };
    let mut list = List::default();
    let (lists, ()) = repeated(&plan, || {
        list.build(p, reach);
        Ok(())
    })?;
    let mut sums = Sums::default();
    let (times, ()) = repeated(&plan, || {
        sums.evaluate(&list, p, &constants);
        Ok(())
    })?;
    std::hint::black_box(&sums);
    Ok(Twin { list: seconds(&lists, 1).min, sums: seconds(&times, 1).min, pairs: list.pairs_of_fluid(p) })
}

fn record(flow: &Flow, threads: usize, timed: &Timed, twin: Option<&Twin>, session: &Session, one_thread: Option<f64>) -> Record {
    let n = timed.particles as f64;
    let evaluations: f64 = timed.evaluations.iter().sum();
    let total = if flow.second { timed.all.seconds(threads) } else { timed.steps.iter().map(|step| step.seconds(threads)).sum() };
    // A whole second is one measurement; else each step is one, shared out over its evaluations.
    let seconds = if flow.second {
        Seconds::of(&[total])
    } else {
        Seconds::of(&timed.steps.iter().zip(&timed.evaluations).map(|(s, e)| s.seconds(threads) / e).collect::<Vec<_>>())
    };
    let evaluation = if flow.second { total / evaluations } else { seconds.min };
    let mut extra = Map::from_iter([
        ("fluid".to_owned(), json!(timed.fluid)),
        ("steps".to_owned(), json!(timed.steps.len())),
        ("evaluations".to_owned(), json!(evaluations)),
        ("seconds_a_step".to_owned(), json!(total / timed.steps.len() as f64)),
        ("flow_time".to_owned(), json!(timed.flow_time)),
    ]);
    extra.insert("wall_seconds".into(), json!(timed.least_wall(flow)));
    if let Some(share) = timed.all.share(threads) {
        extra.insert("processor_share".into(), json!(share));
    }
    if let Some(listed) = timed.listed {
        extra.insert("listed_pairs".into(), json!(listed));
        // What the project allows itself: a base for each particle, and some bytes for each listed neighbour.
        let (base, each) = if flow.method == MethodName::DeltaSph { (300.0, 5.0) } else { (600.0, 16.0) };
        extra.insert("bytes_per_particle_allowed".into(), json!(base + each * listed as f64 / n));
    }
    if let Some(before) = one_thread.filter(|_| threads > 1) {
        extra.insert("speed_up".into(), json!(before / timed.least_wall(flow)));
    }
    // Phases are wall time: their share of it is taken of the least time of an evaluation.
    let in_loops: f64 = timed.phases.iter().filter(|(name, _)| PAIR_LOOPS.contains(name)).map(|(_, seconds)| seconds).sum();
    let loops = evaluation * in_loops / timed.steps.iter().map(|step| step.wall).sum::<f64>();
    let (mut pair_rate, mut ratio) = (None, None);
    if let Some(twin) = twin.filter(|_| loops > 0.0) {
        let rate = twin.pairs as f64 / loops;
        pair_rate = Some(PAIR_LOOPS.len() as f64 * rate);
        ratio = Some(twin.sums / loops);
        extra.insert("pairs".into(), json!(twin.pairs));
        extra.insert("neighbours".into(), json!(twin.pairs as f64 / timed.fluid.max(1) as f64));
        extra.insert("naive_pair_evaluations_per_s".into(), json!(twin.pairs as f64 / twin.sums));
        extra.insert("naive_list_seconds".into(), json!(twin.list));
        extra.insert("step_ratio_to_naive".into(), json!((twin.list + twin.sums) / evaluation));
        if let Some(ceiling) = session.ceiling(threads) {
            extra.insert("multiply_add_share".into(), json!(rate * operations_a_pair(flow.dimension() as usize) / ceiling.flops));
            // An evaluation reads a record of 64 bytes and the list, and writes acceleration and rate, at the least.
            let listed = timed.listed.unwrap_or(twin.pairs) as f64;
            let bytes = n * (64.0 + 8.0 * (f64::from(flow.dimension()) + 1.0)) + 4.0 * listed;
            extra.insert("bandwidth_share".into(), json!(bytes / loops / ceiling.bytes_per_s));
        }
    }
    Record {
        bench: if flow.second { "second".into() } else { "step".into() },
        workload: flow.name.into(),
        method: flow.method.name().into(),
        dimension: flow.dimension(),
        particles: timed.particles,
        threads,
        seconds: Some(seconds),
        repetitions: if flow.second { 1 } else { timed.steps.len() },
        particle_steps_per_s: Some(n / evaluation),
        pair_evaluations_per_s: pair_rate,
        bytes_per_particle: Some(timed.bytes as f64 / n),
        iterations: (!timed.iterations.is_empty()).then(|| timed.iterations.iter().sum::<f64>() / timed.iterations.len() as f64),
        ratio_to_naive: ratio,
        phases: timed.phases.iter().map(|&(name, seconds)| (name.into(), seconds)).collect(),
        extra,
    }
}
