//! Fluid without a free surface: its pressure is known up to a constant.

use super::numbering::Numbering;
use super::parts::Parts;

/// Which parts of the fluid touch no free surface, so that their pressure has no level of its own.
#[derive(Clone, Debug, Default)]
pub(super) struct Closure {
    /// There was one beside open water: they are looked for in every step.
    pub(super) parts: bool,
    /// Some fluid touches no surface in this step.
    pub(super) active: bool,
    /// Part of each unknown; [`OPEN`] where it has a level.
    part: Vec<u32>,
    /// Sum and number of each part.
    sums: Vec<(f64, f64)>,
}

const OPEN: u32 = u32::MAX;

impl Closure {
    /// Finds the parts of the fluid that touch no surface; whether there are any. `pull` of an unknown is positive where one is.
    pub(super) fn find<const D: usize>(&mut self, parts: &Parts<D>, numbering: &Numbering, pull: &[f64]) -> bool {
        self.sums.clear();
        self.sums.resize(parts.count, (0.0, 0.0));
        self.part.clear();
        self.part.extend(numbering.rows.iter().map(|&row| parts.of[row as usize]));
        for (&part, pull) in self.part.iter().zip(pull) {
            if let Some((sum, _)) = self.sums.get_mut(part as usize) {
                *sum += pull.max(0.0);
            }
        }
        let sums = &self.sums;
        for part in &mut self.part {
            if sums.get(*part as usize).is_none_or(|&(sum, _)| sum != 0.0) {
                *part = OPEN;
            }
        }
        self.part.iter().any(|&part| part != OPEN)
    }

    /// Takes the mean of each closed part off `column`.
    pub(super) fn level(&mut self, column: &mut [f64]) {
        self.sums.fill((0.0, 0.0));
        for (&part, &value) in self.part.iter().zip(&*column) {
            if let Some((sum, count)) = self.sums.get_mut(part as usize) {
                (*sum, *count) = (*sum + value, *count + 1.0);
            }
        }
        for (&part, value) in self.part.iter().zip(column) {
            if let Some((sum, count)) = self.sums.get(part as usize) {
                *value -= sum / count;
            }
        }
    }
}
