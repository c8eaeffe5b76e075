//! The first state: speed of sound, lattice, density and pressure.

use super::{Acoustic, Bulk, StartPressure};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::math::Vector;
use crate::particles::{Kind, Particles};
use crate::physics::lattice::Lattice;
use crate::reduce::dot;
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
        self.since_reset = 0;
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
            self.release(p, domain);
            self.surface(p, domain);
        }
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
    /// `q_a = p_surface − p_hydrostatic` on the surface. Conjugate gradients; the matrix is symmetric for equal volumes.
    ///
    /// A particle of the surface lies half a spacing below it where the surface faces up, and feels the weight of that much.
    fn release(&self, p: &mut Particles<D>, domain: &Domain<D>) {
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
        let apply = |q: &[f64], out: &mut [f64]| {
            sweep(out, |a| {
                let mut sum = 0.0;
                if free(a) {
                    near.for_each(a, |pair| {
                        if p.is_fluid(pair.b) {
                            sum -= 2.0 * p.mass[pair.b] / state.rest * kernel.dw_over_r(pair.r, pair.h) * (q[a] - q[pair.b]);
                        }
                    });
                }
                sum
            });
        };
        let mut residual = vec![0.0; owned];
        let mut image = vec![0.0; owned];
        apply(&q, &mut residual);
        residual.iter_mut().for_each(|r| *r = -*r);
        let mut direction = vec![0.0; p.len()];
        direction[..owned].copy_from_slice(&residual);
        let (mut now, first) = (dot(&residual, &residual), dot(&residual, &residual));
        // Conjugate gradients need some four iterations for each particle along the longest side; ten is plenty.
        let most = 100 + 10 * owned.isqrt();
        for _ in 0..most {
            if now <= RESIDUAL * RESIDUAL * first || now == 0.0 {
                break;
            }
            domain.refresh_column(&mut direction);
            apply(&direction, &mut image);
            let curvature = dot(&direction[..owned], &image);
            if curvature <= 0.0 {
                break;
            }
            let length = now / curvature;
            for a in 0..owned {
                q[a] += length * direction[a];
                residual[a] -= length * image[a];
            }
            let next = dot(&residual, &residual);
            for a in 0..owned {
                direction[a] = residual[a] + next / now * direction[a];
            }
            now = next;
        }
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.density[a] = state.density((p.pressure[a] + q[a]).max(0.0));
        }
        domain.refresh_column(&mut p.density);
    }
}
