//! Fluid without a free surface: its pressure is known up to a constant.

use crate::domain::Domain;
use crate::neighbors::Neighbors;
use crate::particles::{Kind, Particles};

/// Which parts of the fluid touch no free surface, so that their pressure has no level of its own.
#[derive(Clone, Debug, Default)]
pub(super) struct Closure {
    /// Parts were found once: they are looked for in every step.
    pub(super) parts: bool,
    /// Some fluid touches no surface in this step.
    pub(super) active: bool,
    /// Part of each row.
    part: Vec<u32>,
    /// Sum and number of each part.
    sums: Vec<(f64, f64)>,
}

impl Closure {
    /// Finds the parts of the fluid that touch no surface; whether there are any. `whole`: all fluid is one of them.
    pub(super) fn find<const D: usize>(
        &mut self,
        p: &Particles<D>,
        domain: &Domain<D>,
        near: &Neighbors<D>,
        pull: &[f64],
        whole: bool,
    ) -> bool {
        const OPEN: u32 = u32::MAX;
        let owned = p.owned();
        self.part.clear();
        if whole {
            self.part.extend((0..owned).map(|a| if p.is_fluid(a) { 0 } else { OPEN }));
            return true;
        }
        self.part.extend(0..owned as u32);
        fn root(part: &mut [u32], mut a: u32) -> u32 {
            while part[a as usize] != a {
                part[a as usize] = part[part[a as usize] as usize];
                a = part[a as usize];
            }
            a
        }
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            for &b in near.of(a) {
                if p.is_fluid(b as usize) {
                    let b = domain.parent(b as usize, owned) as u32;
                    let (one, other) = (root(&mut self.part, a as u32), root(&mut self.part, b));
                    self.part[one.max(other) as usize] = one.min(other);
                }
            }
        }
        for a in 0..owned as u32 {
            self.part[a as usize] = root(&mut self.part, a);
        }
        self.sums.clear();
        self.sums.resize(owned, (0.0, 0.0));
        for a in 0..owned {
            self.sums[self.part[a] as usize].0 += pull[a].max(0.0);
        }
        let mut any = false;
        for a in 0..owned {
            if !p.is_fluid(a) || self.sums[self.part[a] as usize].0 > 0.0 {
                self.part[a] = OPEN;
            } else {
                any = true;
            }
        }
        any
    }

    /// Takes the mean of each closed part off `column`.
    pub(super) fn level(&mut self, column: &mut [f64]) {
        self.sums.clear();
        self.sums.resize(column.len(), (0.0, 0.0));
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
