//! The numbers of the paper that are known here, and nothing else of it.
//!
//! Source: Afanasiev, Makarchuk & Popov, "Comparative Analysis of the SPH and ISPH Methods", NNFM 101 (2008) 206, Tables 2 and 3.

/// What the paper is called on the page.
pub const PAPER: &str = "Afanasiev, Makarchuk & Popov, NNFM 101 (2008) 206";

/// Seconds the paper gives, by the number of particles.
type Cells = &'static [(usize, f64)];

/// Table 3: 2000 steps of SPH, s.
pub const SPH_2000_STEPS: Cells = &[(1409, 12.2), (4409, 38.4)];
/// Table 3: 2000 steps of ISPH, s.
pub const ISPH_2000_STEPS: Cells = &[(1409, 52.2), (3509, 436.0), (4409, 1476.0)];
/// Table 2: one pressure solve by serial PGMRES, s. The first two are 64 s and 406 s for 2000 solves.
pub const PGMRES: Cells = &[(1409, 0.032), (3509, 0.203), (4409, 0.719)];
/// Table 2: one pressure solve by serial Gauss, s.
pub const GAUSS: Cells = &[(4409, 43.1)];
/// Table 2: one pressure solve by Gauss on 32 processors, s.
pub const GAUSS_32: Cells = &[(4409, 1.36)];
/// Speed-up of Gauss on 32 processors, the same at every size.
pub const GAUSS_32_SPEED_UP: f64 = 31.7;

/// The paper's number for a size, if it is known.
pub fn at(cells: Cells, particles: usize) -> Option<f64> {
    cells.iter().find(|(n, _)| *n == particles).map(|(_, seconds)| *seconds)
}
