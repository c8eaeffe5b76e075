//! The unknowns: fluid particles, numbered by cell.

use rayon::prelude::*;

use crate::math::{Vector, cube_number};
use crate::particles::Particles;

/// No unknown.
pub(super) const NONE: u32 = u32::MAX;

/// Fluid rows in the order of the cells of a grid, so that what lies together is stored together wherever the flow has taken it.
///
/// Depends on the positions of one moment only; kept until the solver takes new numbers.
#[derive(Clone, Debug, Default)]
pub(super) struct Numbering {
    /// Row of each unknown.
    pub(super) rows: Vec<u32>,
    /// Unknown of each row, or [`NONE`].
    pub(super) places: Vec<u32>,
}

impl Numbering {
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Row of unknown `k`.
    #[inline(always)]
    pub(super) fn row(&self, k: usize) -> usize {
        self.rows[k] as usize
    }

    /// Unknown of row `a`, if it is one.
    #[inline(always)]
    pub(super) fn place(&self, a: usize) -> Option<usize> {
        let place = self.places[a];
        (place != NONE).then_some(place as usize)
    }

    /// Numbers the fluid anew, by cells of edge `reach`, m.
    pub(super) fn renew<const D: usize>(&mut self, p: &Particles<D>, reach: f64) {
        let owned = p.owned();
        let low = Vector(std::array::from_fn(|d| p.x[..owned].iter().map(|x| x[d]).fold(f64::INFINITY, f64::min)));
        let mut keys: Vec<_> = (0..owned).filter(|&a| p.is_fluid(a)).map(|a| (cube_number(p.x[a], low, reach), a as u32)).collect();
        keys.par_sort_unstable();
        self.rows.clear();
        self.rows.extend(keys.into_iter().map(|(_, row)| row));
        self.places.clear();
        self.places.resize(owned, NONE);
        for (place, &row) in self.rows.iter().enumerate() {
            self.places[row as usize] = place as u32;
        }
    }
}
