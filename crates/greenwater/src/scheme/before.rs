//! What a method needs, beside its own columns, to take a step back.

use crate::domain::Domain;
use crate::math::Vector;
use crate::particles::{Kind, Particles};

/// What a step does to a particle beside moving it, as it was before the step.
#[derive(Clone, Debug, Default)]
pub(super) struct Before<const D: usize> {
    /// Whether the step went to its end: the method has positions and the like.
    pub(super) settled: bool,
    surface: Vec<u8>,
    /// Forces on walls, where there are any.
    force: Vec<(u32, Vector<D>)>,
    /// Fluid that will be lost: row, velocity, acceleration, rate of density.
    leaving: Vec<(u32, Vector<D>, Vector<D>, f64)>,
}

impl<const D: usize> Before<D> {
    /// Looks at the state before a step.
    pub(super) fn read(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let owned = p.owned();
        self.settled = false;
        self.surface.clear();
        self.surface.extend_from_slice(&p.surface[..owned]);
        self.force.clear();
        self.force.extend((0..owned).filter(|&a| p.force[a] != Vector::ZERO).map(|a| (a as u32, p.force[a])));
        let leaves = |a: &usize| p.is_fluid(*a) && domain.is_outside(p.x[*a]);
        self.leaving.clear();
        self.leaving.extend((0..owned).filter(leaves).map(|a| (a as u32, p.v[a], p.acceleration[a], p.density_rate[a])));
    }

    /// Makes it that of `p` again.
    pub(super) fn give_back(&self, p: &mut Particles<D>, domain: &Domain<D>) {
        let owned = p.owned();
        p.surface[..owned].copy_from_slice(&self.surface);
        p.force.fill(Vector::ZERO);
        self.force.iter().for_each(|&(a, force)| p.force[a as usize] = force);
        for &(a, v, acceleration, rate) in &self.leaving {
            let a = a as usize;
            (p.kind[a], p.v[a], p.acceleration[a], p.density_rate[a]) = (Kind::Fluid, v, acceleration, rate);
        }
        follow(p, domain);
    }
}

/// Makes ghosts what their parents have become.
pub(super) fn follow<const D: usize>(p: &mut Particles<D>, domain: &Domain<D>) {
    domain.follow(&mut p.x);
    domain.refresh_column(&mut p.v);
    domain.refresh_column(&mut p.pressure);
    domain.refresh_column(&mut p.density);
}
