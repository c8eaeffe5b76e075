//! The first state: speed of sound, lattice, density and pressure.

use super::{Acoustic, Bulk, StartPressure, closed_density};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::math::Vector;
use crate::neighbors::Pair;
use crate::particles::{Kind, Particles};
use crate::physics::lattice::Lattice;
use crate::poisson::{Arms, LinearSolver, PreconditionerKind, Sliced, SolverSettings};
use crate::scheme::{Medium, StepError};
use crate::sweep::sweep;

/// The speed that compressibility is measured by, m/s: `2 √(gH)`, the greatest a dam break reaches before it hits something, or
/// the greatest speed at the start if that is more.
pub(in crate::scheme) fn reference_speed<const D: usize>(medium: &Medium<D>, p: &Particles<D>) -> f64 {
    let fastest = p.v[..p.owned()].iter().map(|v| v.norm()).fold(0.0, f64::max);
    let speed = (2.0 * (medium.g() * medium.depth).sqrt()).max(fastest);
    // Nothing moves and nothing pushes: any speed will do, but not zero.
    if speed > 0.0 { speed } else { medium.spacing }
}

/// The pressure of a release is harmonic to this relative residual.
const RESIDUAL: f64 = 1e-8;

impl<K: Kernel<D>, const D: usize> Acoustic<K, D> {
    /// Fills what follows from positions, velocities and the wanted start.
    pub(super) fn first_state(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        (self.since_reset, self.since_order) = (0, 0);
        if let Some(factor) = self.plan.sound_factor {
            self.plan.state.sound = factor * reference_speed(&self.medium, p);
        }
        self.lattice = Lattice::of(self.kernel, p.h_max(), self.medium.spacing, self.medium.rest_density);
        let state = self.plan.state;
        for a in (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid) {
            let depth = (self.medium.depth - self.medium.height(p.x[a])).max(0.0);
            p.density[a] = match self.plan.start {
                StartPressure::Given => p.density[a],
                StartPressure::Written => state.density(p.pressure[a]),
                StartPressure::Hydrostatic | StartPressure::Released => state.density(state.rest * self.medium.g() * depth),
            };
            p.pressure[a] = state.pressure(p.density[a]);
        }
        self.search(p, domain)?;
        self.surface(p, domain);
        if self.plan.start == StartPressure::Released && self.medium.g() > 0.0 {
            self.release(p, domain)?;
            self.surface(p, domain);
        }
        self.closed = closed_density(p, domain);
        self.shift(p, domain, 0.0);
        // A step of no length: rates, accelerations and forces of this state.
        self.bulk.fill(Bulk::default());
        self.set_out(p, domain, 0.0);
        self.press_walls(p, domain);
        p.force.fill(Vector::ZERO);
        self.kick(p, domain, 1.0, 0.0, 1.0);
        for a in (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.acceleration[a] = self.end[a].v() - p.v[a];
            self.end[a].set_v(p.v[a]);
        }
        domain.refresh_records(&mut self.end);
        self.dilate(p, domain, 0.0, 0.0, 0.0);
        self.press_walls(p, domain);
        self.settle(p, domain, 0.0);
        domain.refresh_column(&mut p.acceleration);
        Ok(())
    }

    /// Adds to the hydrostatic pressure the harmonic one that makes the free surface free: `Σ_b 2 V_b F_ab (q_a − q_b) = 0` over
    /// fluid (Brookshaw's Laplacian, natural at walls: the weight of the liquid is in the hydrostatic part), with
    /// `q_a = p_surface − p_hydrostatic` on the surface. The matrix is symmetric for equal volumes; it is made so for others.
    ///
    /// A particle of the surface lies half a spacing below it where the surface faces up, and feels the weight of that much.
    fn release(&self, p: &mut Particles<D>, domain: &Domain<D>) -> Result<(), StepError> {
        let (near, kernel, state, owned) = (&self.near, self.kernel, self.plan.state, p.owned());
        let up = self.medium.gravity / -self.medium.g();
        // The normals stand where velocities do.
        let normal = |a: usize| self.end[a].v::<D>();
        let free = |a: usize| p.kind[a] == Kind::Fluid && normal(a) == Vector::ZERO;
        let mut q = vec![0.0; p.len()];
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid && !free(a)) {
            let depth = 0.5 * self.medium.spacing * normal(a).dot(up).max(0.0);
            q[a] = state.rest * self.medium.g() * depth - p.pressure[a];
        }
        domain.refresh_column(&mut q);
        let link = |a: usize, pair: &Pair<D>| -(p.mass[a] + p.mass[pair.b]) / state.rest * kernel.dw_over_r(pair.r, pair.h);
        let mut source = vec![0.0; owned];
        sweep(&mut source, |a| {
            let mut sum = 0.0;
            if free(a) {
                near.for_each(a, |pair| {
                    if p.is_fluid(pair.b) && !free(domain.parent(pair.b, owned)) {
                        sum += link(a, &pair) * q[pair.b];
                    }
                });
            }
            sum
        });
        let mut matrix = Sliced::default();
        matrix.fill(owned, &mut Arms::<0>::default(), |a, row| {
            let mut diagonal = 0.0;
            if free(a) {
                near.for_each(a, |pair| {
                    if p.is_fluid(pair.b) {
                        let (b, link) = (domain.parent(pair.b, owned), link(a, &pair) as f32);
                        diagonal += f64::from(link);
                        if free(b) {
                            row.push(b, link, []);
                        }
                    }
                });
            }
            if diagonal > 0.0 { diagonal } else { 1.0 }
        });
        let mut harmonic = vec![0.0; owned];
        LinearSolver::new(SolverSettings {
            preconditioner: PreconditionerKind::Multigrid,
            tolerance: RESIDUAL,
            ..SolverSettings::default()
        })?
        .solve_sliced(&matrix, &source, &mut harmonic, 0.0)?;
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            let q = if free(a) { harmonic[a] } else { q[a] };
            p.density[a] = state.density((p.pressure[a] + q).max(0.0));
        }
        domain.refresh_column(&mut p.density);
        Ok(())
    }
}
