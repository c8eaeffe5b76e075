//! What the machine can do at most: memory bandwidth, and multiply-adds.

pub mod vector;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::watch::Watch;
use super::{BenchError, Clock, Plan, with_threads};
use vector::Instructions;

/// The ceilings for a number of threads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ceiling {
    /// Threads.
    pub threads: usize,
    /// Bytes read and written in a second by `a = b + s c` over arrays that no cache holds.
    pub bytes_per_s: f64,
    /// Floating-point operations in a second by multiply-adds in independent chains, two each.
    pub flops: f64,
    /// The instructions that reached it.
    pub instructions: String,
}

/// Doubles in each of the three arrays: 96 MB, and 24 MB for a quick look.
const LONG: [usize; 2] = [12_000_000, 3_000_000];

/// Measures both for every number of threads; the best of several goes, since what else the machine does can only slow it down.
pub fn measure(plan: &Plan, clock: &Clock) -> Result<Vec<Ceiling>, BenchError> {
    let instructions = Instructions::here();
    let (length, goes) = if plan.quick { (LONG[1], 3) } else { (LONG[0], 7) };
    let mut ceilings = Vec::new();
    for &threads in &plan.threads {
        let (bytes_per_s, flops) = with_threads(threads, || (bandwidth(length, goes), rate(instructions, goes)))?;
        let (gigabytes, gigaflops) = (1e-9 * bytes_per_s, 1e-9 * flops);
        clock.say(&format!("ceilings, {threads} threads: {gigabytes:.1} GB/s, {gigaflops:.1} GFLOP/s ({})", instructions.name()));
        ceilings.push(Ceiling { threads, bytes_per_s, flops, instructions: instructions.name().to_owned() });
    }
    Ok(ceilings)
}

/// Bytes in a second of the triad.
fn bandwidth(length: usize, goes: usize) -> f64 {
    // Every thread first touches what it works on.
    let filled = |value: f64| (0..length).into_par_iter().with_min_len(65_536).map(|_| value).collect::<Vec<f64>>();
    let (mut a, b, c) = (filled(0.0), filled(1.0), filled(2.0));
    let chunk = length.div_ceil(rayon::current_num_threads());
    let s = std::hint::black_box(3.0);
    let best = best(goes, || {
        a.par_chunks_mut(chunk).zip(b.par_chunks(chunk).zip(c.par_chunks(chunk))).for_each(|(a, (b, c))| {
            for (a, (b, c)) in a.iter_mut().zip(b.iter().zip(c)) {
                *a = b + s * c;
            }
        });
    });
    std::hint::black_box(&a);
    24.0 * length as f64 / best
}

/// Floating-point operations in a second.
fn rate(instructions: Instructions, goes: usize) -> f64 {
    const ROUNDS: usize = 200_000;
    let mut operations = 0.0;
    let best = best(goes, || {
        operations = rayon::broadcast(|_| vector::run(instructions, ROUNDS)).into_iter().sum();
    });
    operations / best
}

fn best(goes: usize, mut work: impl FnMut()) -> f64 {
    // The first go wakes threads and pages.
    work();
    let times = (0..goes).map(|_| {
        let watch = Watch::start();
        work();
        watch.lap().seconds(rayon::current_num_threads())
    });
    times.fold(f64::INFINITY, f64::min)
}
