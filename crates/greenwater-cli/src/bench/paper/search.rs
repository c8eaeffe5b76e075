//! Figs. 3-5 of the paper: time of the direct and the grid search against the number of particles.

use std::time::Instant;

use greenwater::math::Vector;
use greenwater::neighbors::{Neighbors, Search};
use greenwater::particles::{Kind, Particle, Particles};
use serde_json::{Map, Value, json};

use super::plan::Plan;
use super::record::{Record, Seconds, exponent};
use super::{BenchError, Clock, with_threads};

/// Searches for which the paper gives times: a search a step.
pub const STEPS: f64 = 1000.0;
/// Support of the cubic spline in smoothing lengths.
const SUPPORT: f64 = 2.0;
/// Smoothing length in spacings, as in the dam breaks: 20 neighbours.
const SMOOTHING: f64 = 1.2;

/// One point of the figures.
#[derive(Clone, Debug)]
pub struct Point {
    /// How pairs were found.
    pub search: Search,
    /// Number of particles.
    pub particles: usize,
    /// Number of threads.
    pub threads: usize,
    /// Time of one search, s.
    pub seconds: Seconds,
    /// Searches timed.
    pub repetitions: usize,
    /// Pairs found, each from both sides.
    pub pairs: usize,
    /// Memory of the pairs and the grid, bytes.
    pub bytes: usize,
}

/// All points.
#[derive(Clone, Debug)]
pub struct Results {
    /// In the order they were measured: direct, grid, grid on all threads; rising numbers of particles.
    pub points: Vec<Point>,
}

/// Measures the search with one thread in both ways, and the grid with all threads.
pub fn measure(plan: &Plan, clock: &Clock) -> Result<Results, BenchError> {
    let mut runs = vec![(Search::Direct, 1, &plan.direct), (Search::Grid, 1, &plan.grid)];
    if plan.most_threads() > 1 {
        runs.push((Search::Grid, plan.most_threads(), &plan.grid));
    }
    let mut points = Vec::new();
    for (search, threads, sizes) in runs {
        // In rounds over all sizes, so that a busy while of the machine does not meet one size alone and bend the line.
        let mut times = vec![Vec::new(); sizes.len()];
        let mut found = vec![(0, 0); sizes.len()];
        for _ in 0..ROUNDS {
            for ((times, found), &count) in times.iter_mut().zip(&mut found).zip(sizes) {
                let particles = cloud(count);
                let budget = plan.seconds_a_point / f64::from(ROUNDS);
                *found = with_threads(threads, || time(&particles, search, budget, times))??;
            }
        }
        for ((times, (pairs, bytes)), &particles) in times.iter().zip(found).zip(sizes) {
            let point = Point { search, particles, threads, seconds: Seconds::of(times), repetitions: times.len(), pairs, bytes };
            clock.say(&format!("search: {}, {particles} particles, {threads} threads: {:.3e} s", name(search), point.seconds.min));
            points.push(point);
        }
    }
    Ok(Results { points })
}

/// How often all sizes are gone through; also the least number of repetitions.
const ROUNDS: u32 = 3;

/// Adds the times of at least one search, and of more until `budget`, s, is used up; answers the pairs and the memory.
fn time(particles: &Particles<2>, search: Search, budget: f64, times: &mut Vec<f64>) -> Result<(usize, usize), BenchError> {
    let mut near = Neighbors::new();
    // The first search allocates; a flow does that once.
    near.build(particles, SUPPORT, search)?;
    let started = Instant::now();
    loop {
        let clock = Instant::now();
        near.build(particles, SUPPORT, search)?;
        times.push(clock.elapsed().as_secs_f64());
        if started.elapsed().as_secs_f64() >= budget {
            return Ok((near.pairs(), near.bytes()));
        }
    }
}

/// `count` particles on a square lattice, each moved by up to a tenth of a spacing along each axis: the disorder of a flow, and
/// everywhere the 20 neighbours of the method.
fn cloud(count: usize) -> Particles<2> {
    let side = (count as f64).sqrt().ceil() as usize;
    let mut state = 1u64;
    let mut shift = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        0.2 * ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5)
    };
    let mut particles = Particles::new();
    for a in 0..count {
        let x = Vector([(a / side) as f64 + shift(), (a % side) as f64 + shift()]);
        let particle = Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h: SMOOTHING };
        particles.push(a as u32, particle);
    }
    particles
}

/// Name of a way to search.
pub fn name(search: Search) -> &'static str {
    match search {
        Search::Direct => "direct",
        Search::Grid => "grid",
    }
}

impl Results {
    /// The points of one line of the figures.
    pub fn line(&self, search: Search, threads: usize) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(move |point| point.search == search && point.threads == threads)
    }

    /// Largest number of threads measured.
    pub fn most_threads(&self) -> usize {
        self.points.iter().map(|point| point.threads).max().unwrap_or(1)
    }

    /// `(N, direct/grid)`, serial, where both were measured.
    pub fn acceleration(&self) -> Vec<(usize, f64)> {
        let grid = |n| self.line(Search::Grid, 1).find(|point| point.particles == n);
        self.line(Search::Direct, 1).filter_map(|d| Some((d.particles, d.seconds.min / grid(d.particles)?.seconds.min))).collect()
    }

    /// Exponent of the serial direct search, fitted where it takes longer than what any search does once: from 1000 particles.
    pub fn direct_exponent(&self) -> Option<f64> {
        self.fit(Search::Direct, 1000)
    }

    /// Exponent of the serial grid search from 10 000 particles on.
    pub fn grid_exponent(&self) -> Option<f64> {
        self.fit(Search::Grid, 10_000)
    }

    fn fit(&self, search: Search, from: usize) -> Option<f64> {
        exponent(self.line(search, 1).filter(|point| point.particles >= from).map(|point| (point.particles as f64, point.seconds.min)))
    }

    /// The exponents for the JSON file.
    pub fn fits_json(&self) -> Value {
        json!({ "direct_exponent": self.direct_exponent(), "grid_exponent": self.grid_exponent() })
    }

    /// Rows of the JSON file.
    pub fn records(&self) -> Vec<Record> {
        let accelerations = self.acceleration();
        let record = |point: &Point| {
            let ratio = accelerations.iter().find(|(n, _)| *n == point.particles).map(|(_, ratio)| *ratio);
            Record {
                bench: "neighbors".into(),
                workload: "lattice with disorder, 20 neighbours".into(),
                method: name(point.search).into(),
                dimension: 2,
                particles: point.particles,
                threads: point.threads,
                seconds: Some(point.seconds),
                repetitions: point.repetitions,
                particle_steps_per_s: Some(point.particles as f64 / point.seconds.median),
                pair_evaluations_per_s: Some(point.pairs as f64 / point.seconds.median),
                bytes_per_particle: Some(point.bytes as f64 / point.particles as f64),
                ratio_to_naive: ratio.filter(|_| point.search == Search::Grid && point.threads == 1),
                extra: Map::from_iter([("seconds_of_1000_steps".to_owned(), json!(STEPS * point.seconds.min))]),
                ..Record::default()
            }
        };
        self.points.iter().map(record).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_searches_find_the_same_pairs_and_inner_particles_have_twenty() {
        let particles = cloud(900);
        let mut pairs = Vec::new();
        for search in [Search::Direct, Search::Grid] {
            pairs.push(time(&particles, search, 0.0, &mut Vec::new()).expect("finite positions").0);
        }
        assert_eq!(pairs[0], pairs[1]);
        let mut near = Neighbors::new();
        near.build(&particles, SUPPORT, Search::Grid).expect("finite positions");
        let inner = (0..900).filter(|a| [a / 30, a % 30].iter().all(|i| (4..26).contains(i)));
        let (count, total) = inner.fold((0, 0), |(count, total), a| (count + 1, total + near.of(a).len()));
        // The lattice has 20 within 2.4 spacings and 4 more at 2.83: disorder moves few of them across.
        assert!((total as f64 / f64::from(count) - 20.0).abs() < 0.5);
    }

    #[test]
    fn exponents_come_from_the_sizes_they_are_meant_for() {
        let point = |search, particles: usize, seconds: f64| Point {
            search,
            particles,
            threads: 1,
            seconds: Seconds::of(&[seconds]),
            repetitions: 1,
            pairs: 0,
            bytes: 0,
        };
        let n = |k: f64| [100usize, 1000, 10_000, 100_000].map(|n| (n, if n < 1000 { 1.0 } else { 1e-9 * (n as f64).powf(k) }));
        let results = Results {
            points: n(2.0)
                .map(|(n, s)| point(Search::Direct, n, s))
                .into_iter()
                .chain(n(1.0).map(|(n, s)| point(Search::Grid, n, s)))
                .collect(),
        };
        assert!((results.direct_exponent().expect("three points") - 2.0).abs() < 1e-12);
        assert!((results.grid_exponent().expect("two points") - 1.0).abs() < 1e-12);
        // N² over N is N.
        assert!(results.acceleration().iter().all(|&(n, ratio)| n < 1000 || (ratio / n as f64 - 1.0).abs() < 1e-9));
    }
}
