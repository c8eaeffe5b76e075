//! Clocks: wall time, and the time that the processors gave to this program.

use std::time::Instant;

use super::{BenchError, Plan};
use crate::bench::record::Seconds;

/// A stop watch.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    wall: Instant,
    given: Option<f64>,
}

/// What a watch shows.
#[derive(Clone, Copy, Debug)]
pub struct Lap {
    /// Wall time, s.
    pub wall: f64,
    /// Time on processors, all threads together, s; none where the system does not say.
    pub given: Option<f64>,
}

impl Watch {
    /// Starts now.
    pub fn start() -> Self {
        Self { wall: Instant::now(), given: processor_seconds() }
    }

    /// Time since the start.
    pub fn lap(&self) -> Lap {
        let given = self.given.zip(processor_seconds()).map(|(before, now)| now - before);
        Lap { wall: self.wall.elapsed().as_secs_f64(), given }
    }
}

impl Lap {
    /// The time to report, s: on one thread that on the processor, which others on the machine do not touch; on several wall time.
    pub fn seconds(&self, threads: usize) -> f64 {
        self.given.filter(|&given| threads == 1 && given > 0.0).unwrap_or(self.wall)
    }

    /// How much of the time of `threads` threads the program got.
    pub fn share(&self, threads: usize) -> Option<f64> {
        self.given.map(|given| given / (self.wall * threads as f64))
    }
}

/// Times to report of several laps, s.
pub fn seconds(laps: &[Lap], threads: usize) -> Seconds {
    Seconds::of(&laps.iter().map(|lap| lap.seconds(threads)).collect::<Vec<_>>())
}

/// Least wall time of several laps, s.
pub fn least_wall(laps: &[Lap]) -> f64 {
    laps.iter().map(|lap| lap.wall).fold(f64::INFINITY, f64::min)
}

/// Times `work` again and again: `plan.repeats` times at least, and until `plan.seconds` are used up.
pub fn repeated<T>(plan: &Plan, mut work: impl FnMut() -> Result<T, BenchError>) -> Result<(Vec<Lap>, T), BenchError> {
    let started = Instant::now();
    let mut laps = Vec::new();
    loop {
        let watch = Watch::start();
        let result = work()?;
        laps.push(watch.lap());
        if laps.len() >= plan.repeats && started.elapsed().as_secs_f64() >= plan.seconds {
            return Ok((laps, result));
        }
    }
}

/// Seconds that the processors have given to all threads of this program.
fn processor_seconds() -> Option<f64> {
    #[cfg(unix)]
    {
        let time = nix::time::clock_gettime(nix::time::ClockId::CLOCK_PROCESS_CPUTIME_ID).ok()?;
        Some(time.tv_sec() as f64 + 1e-9 * time.tv_nsec() as f64)
    }
    #[cfg(not(unix))]
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_sleeps_takes_wall_time_only() {
        let watch = Watch::start();
        std::thread::sleep(std::time::Duration::from_millis(20));
        assert!(watch.lap().wall >= 0.02);
        let lap = Lap { wall: 2.0, given: Some(1.0) };
        assert_eq!((lap.seconds(1), lap.seconds(2), lap.share(2)), (1.0, 2.0, Some(0.25)));
        assert_eq!(Lap { given: None, ..lap }.seconds(1), 2.0);
    }
}
