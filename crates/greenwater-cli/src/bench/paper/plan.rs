//! How much is measured.

use std::thread::available_parallelism;

/// Sizes and repetitions.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Particle numbers of the direct search.
    pub direct: Vec<usize>,
    /// Particle numbers of the grid search.
    pub grid: Vec<usize>,
    /// Time given to one point of a figure, s: at least three repetitions are made, then more until it is used up.
    pub seconds_a_point: f64,
    /// Columns `m` of the dam breaks whose pressure equations are solved; `2 m² + 30 m + 9` rows.
    pub equations: Vec<u32>,
    /// Time of the flow at which the pressure equations are taken, s.
    pub equation_time: f64,
    /// Columns `m` of the dam breaks of Tables 2 and 3.
    pub sizes: Vec<u32>,
    /// Steps timed for Table 3.
    pub steps: u64,
    /// Runs timed for each cell of Table 3; the fastest counts.
    pub runs: usize,
    /// Columns of the dam breaks that the claims about the flow are tested with.
    pub flow_columns: u32,
    /// End of those flows, s.
    pub flow_end: f64,
    /// Numbers of threads, rising from 1.
    pub threads: Vec<usize>,
}

/// Columns of the paper's five sizes: 1409, 2009, 2709, 3509 and 4409 particles.
const PAPER_SIZES: [u32; 5] = [20, 25, 30, 35, 40];

impl Plan {
    /// Everything the paper shows, at its sizes.
    pub fn full() -> Self {
        Self {
            direct: vec![500, 1000, 2000, 4000, 8000, 16_000, 32_000],
            grid: vec![500, 1000, 2000, 4000, 8000, 16_000, 32_000, 64_000, 125_000, 250_000, 500_000, 1_000_000],
            seconds_a_point: 1.0,
            equations: vec![5, 10, 15, 20, 25, 30, 35, 40, 41],
            equation_time: 0.5,
            sizes: PAPER_SIZES.to_vec(),
            steps: 2000,
            runs: 3,
            flow_columns: 30,
            flow_end: 1.64,
            threads: threads(),
        }
    }

    /// The same in a minute or two.
    pub fn quick() -> Self {
        Self {
            direct: vec![500, 1000, 2000, 4000, 8000],
            grid: vec![500, 1000, 2000, 4000, 8000, 16_000, 64_000, 250_000],
            seconds_a_point: 0.2,
            equations: vec![5, 10, 15, 20, 25, 30],
            equation_time: 0.2,
            steps: 200,
            runs: 1,
            flow_columns: 20,
            ..Self::full()
        }
    }

    /// The least that leaves every number defined, for tests.
    #[cfg(test)]
    pub fn tiny() -> Self {
        Self {
            direct: vec![100, 200],
            grid: vec![100, 200],
            seconds_a_point: 0.0,
            equations: vec![4, 5],
            equation_time: 0.02,
            sizes: vec![4, 5],
            steps: 3,
            runs: 1,
            flow_columns: 5,
            flow_end: 0.25,
            threads: vec![1, 2],
        }
    }

    /// The largest number of threads.
    pub fn most_threads(&self) -> usize {
        self.threads.last().copied().unwrap_or(1)
    }
}

/// All numbers of threads up to four, then powers of two, then all the machine has.
fn threads() -> Vec<usize> {
    let most = available_parallelism().map_or(1, usize::from);
    let mut list: Vec<usize> = [1, 2, 3, 4, 8, 16, 32, 64, 128].into_iter().filter(|&n| n < most).collect();
    list.push(most);
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_rise_from_one_to_all() {
        let list = threads();
        assert_eq!(list[0], 1);
        assert!(list.windows(2).all(|pair| pair[0] < pair[1]), "{list:?}");
    }
}
