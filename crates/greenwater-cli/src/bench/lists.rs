//! `bench neighbors`: lists of neighbours of disordered particles, beside the plain search.

use greenwater::math::Vector;
use greenwater::neighbors::{Neighbors, Search};
use greenwater::particles::{Kind, Particle, Particles};
use serde_json::{Map, json};

use super::naive::List;
use super::record::Record;
use super::session::Session;
use super::watch::{least_wall, repeated, seconds};
use super::{BenchError, Clock, Plan, memory, with_threads};

/// A cloud of particles.
#[derive(Clone, Copy, Debug)]
pub struct Cloud {
    /// Its name.
    pub name: &'static str,
    /// Dimensions of space.
    pub dimension: u32,
    /// Particles along each side.
    pub side: usize,
    /// Whether it is measured with `--quick`.
    pub quick: bool,
}

/// All of them: 23 neighbours in 2D, 160 in 3D, as the flows of `bench step` have.
pub static WORKLOADS: [Cloud; 7] = [
    Cloud { name: "cloud-2d-10k", dimension: 2, side: 100, quick: true },
    Cloud { name: "cloud-2d-50k", dimension: 2, side: 224, quick: false },
    Cloud { name: "cloud-2d-200k", dimension: 2, side: 447, quick: false },
    Cloud { name: "cloud-2d-1m", dimension: 2, side: 1000, quick: false },
    Cloud { name: "cloud-3d-5k", dimension: 3, side: 17, quick: true },
    Cloud { name: "cloud-3d-35k", dimension: 3, side: 33, quick: false },
    Cloud { name: "cloud-3d-300k", dimension: 3, side: 67, quick: false },
];

/// Support of the kernel, in smoothing lengths.
const SUPPORT: f64 = 2.0;

/// Builds the list of every cloud with every number of threads.
pub fn measure<'a>(
    clouds: impl Iterator<Item = &'a Cloud>,
    plan: &Plan,
    session: &Session,
    clock: &Clock,
) -> Result<Vec<Record>, BenchError> {
    let mut records = Vec::new();
    for cloud in clouds {
        match cloud.dimension {
            2 => time(cloud, &particles::<2>(cloud.side, 1.414), plan, session, clock, &mut records)?,
            _ => time(cloud, &particles::<3>(cloud.side, 1.732), plan, session, clock, &mut records)?,
        }
    }
    Ok(records)
}

fn time<const D: usize>(
    cloud: &Cloud,
    p: &Particles<D>,
    plan: &Plan,
    session: &Session,
    clock: &Clock,
    records: &mut Vec<Record>,
) -> Result<(), BenchError> {
    let n = p.owned();
    let mut plain = List::default();
    let fewer = Plan { repeats: plan.repeats.min(3), ..plan.clone() };
    let (times, ()) = repeated(&fewer, || {
        plain.build(p, SUPPORT * p.h_max());
        Ok(())
    })?;
    let naive = seconds(&times, 1).min;
    let pairs = plain.pairs();
    drop(plain);
    let mut one_thread = None;
    for &threads in &plan.threads {
        let (times, listed, bytes) = with_threads(threads, || -> Result<_, BenchError> {
            let gauge = memory::Gauge::start();
            let mut near = Neighbors::new();
            // The first build allocates; a flow does that once.
            near.build(p, SUPPORT, Search::Grid)?;
            let (times, ()) = repeated(plan, || Ok(near.build(p, SUPPORT, Search::Grid)?))?;
            Ok((times, near.pairs(), gauge.peak()))
        })??;
        let seconds = seconds(&times, threads);
        let mut extra = Map::from_iter([
            ("pairs".to_owned(), json!(pairs)),
            ("listed_pairs".to_owned(), json!(listed)),
            ("neighbours".to_owned(), json!(pairs as f64 / n as f64)),
            ("naive_seconds".to_owned(), json!(naive)),
            ("wall_seconds".to_owned(), json!(least_wall(&times))),
            ("nanoseconds_a_pair".to_owned(), json!(1e9 * seconds.min / pairs as f64)),
        ]);
        match one_thread {
            Some(before) if threads > 1 => drop(extra.insert("speed_up".into(), json!(before / least_wall(&times)))),
            _ if threads == 1 => one_thread = Some(least_wall(&times)),
            _ => {}
        }
        if let Some(ceiling) = session.ceiling(threads) {
            // A build reads positions and writes the list, at the least.
            let least = n as f64 * 8.0 * D as f64 + 4.0 * listed as f64;
            extra.insert("bandwidth_share".into(), json!(least / seconds.min / ceiling.bytes_per_s));
        }
        let (name, ratio) = (cloud.name, naive / seconds.min);
        clock.say(&format!("{name}: {n} particles, {threads} threads: {:.3e} s, {ratio:.2} times the plain search", seconds.min));
        records.push(Record {
            bench: "neighbors".into(),
            workload: cloud.name.into(),
            method: "grid".into(),
            dimension: D as u32,
            particles: n,
            threads,
            seconds: Some(seconds),
            repetitions: times.len(),
            particle_steps_per_s: Some(n as f64 / seconds.min),
            pair_evaluations_per_s: Some(pairs as f64 / seconds.min),
            bytes_per_particle: Some(bytes as f64 / n as f64),
            ratio_to_naive: Some(ratio),
            extra,
            ..Record::default()
        });
    }
    Ok(())
}

/// A block of a lattice, every particle moved by up to 0.15 spacings along each axis.
fn particles<const D: usize>(side: usize, h: f64) -> Particles<D> {
    let mut state = 1u64;
    let mut shift = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        0.3 * ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5)
    };
    let mut particles = Particles::new();
    for a in 0..side.pow(D as u32) {
        let mut rest = a;
        let mut x = Vector::ZERO;
        for d in (0..D).rev() {
            x[d] = (rest % side) as f64 + shift();
            rest /= side;
        }
        let particle = Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h };
        particles.push(a as u32, particle);
    }
    particles
}

#[cfg(test)]
mod tests {
    use super::*;

    fn same<const D: usize>(side: usize, h: f64, neighbours: f64) {
        let p = particles::<D>(side, h);
        let (mut near, mut plain) = (Neighbors::new(), List::default());
        near.build(&p, SUPPORT, Search::Grid).expect("finite positions");
        plain.build(&p, SUPPORT * h);
        let mut inner = (0, 0);
        for a in 0..p.owned() {
            let (mut ours, mut theirs) = (near.of(a).to_vec(), plain.rows[plain.starts[a]..plain.starts[a + 1]].to_vec());
            ours.sort_unstable();
            theirs.sort_unstable();
            assert_eq!(ours, theirs, "{D}D, neighbours of {a}");
            if (0..D).all(|d| (4.0..side as f64 - 5.0).contains(&p.x[a][d])) {
                inner = (inner.0 + 1, inner.1 + theirs.len());
            }
        }
        // Near the volume of the support less the particle itself; in the plane four lattice points lie just outside.
        let found = inner.1 as f64 / f64::from(inner.0);
        assert!((found / neighbours - 1.0).abs() < 0.05, "{D}D: {found} neighbours");
    }

    #[test]
    fn both_lists_hold_the_same_pairs_and_as_many_as_the_support_has() {
        same::<2>(30, 1.414, 22.5);
        same::<3>(14, 1.732, 173.0);
    }
}
