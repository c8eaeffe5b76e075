//! The first state: speed of sound, lattice, density and pressure.

use super::{Acoustic, Bulk, Place, StartPressure, closed_density};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::lanes::{Lanes, Record, Rows, sweep_lanes};
use crate::math::{Vector, cube_number};
use crate::neighbors::{Group, Term};
use crate::particles::{Kind, Particles};
use crate::physics::lattice::Lattice;
use crate::physics::pairs::{Pairs, Reach, Seen, record};
use crate::poisson::projection::{self, Goal, Workspace};
use crate::poisson::{Aggregates, SolveError};
use crate::scheme::{Medium, StepError};
use crate::sweep::update;

/// The speed that compressibility is measured by, m/s: `2 √(gH)`, the greatest a dam break reaches before it hits something, or
/// the greatest speed at the start, or of a wall at any time, if that is more.
pub(in crate::scheme) fn reference_speed<const D: usize>(medium: &Medium<D>, p: &Particles<D>) -> f64 {
    let fastest = p.v[..p.owned()].iter().map(|v| v.norm()).fold(0.0, f64::max);
    let speed = (2.0 * (medium.g() * medium.depth).sqrt()).max(fastest).max(medium.speed);
    // Nothing moves and nothing pushes: any speed will do, but not zero.
    if speed > 0.0 { speed } else { medium.spacing }
}

/// The pressure of a release is harmonic to this relative residual.
const RESIDUAL: f64 = 1e-8;

/// Some thirty iterations are usual; a fluid of thin threads takes more.
const MOST_ITERATIONS: usize = 10_000;

/// Width of the cubes whose fluid is one unknown of the coarse equation, in spacings.
const WIDTH: f64 = 4.0;

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
        self.bulk.clear();
        self.search(p, domain)?;
        self.surface(p, domain, 0.0);
        if self.plan.start == StartPressure::Released && self.medium.g() > 0.0 {
            self.release(p, domain)?;
            self.make_room(p);
            self.surface(p, domain, 0.0);
        }
        self.closed = closed_density(p, domain);
        self.damp(p);
        self.shift(p, domain, 0.0);
        // A step of no length: rates, accelerations and forces of this state.
        self.bulk.fill(Bulk::default());
        self.set_out(p, domain, 0.0, 0.0);
        self.press_walls(p, domain);
        self.kick(p, domain, [1.0, 0.0, 1.0, 0.0]);
        for a in (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.acceleration[a] = self.end[a].v() - p.v[a];
            self.end[a].set_v(p.v[a]);
        }
        domain.refresh_records(&mut self.end);
        self.dilate(p, domain, 0.0, true);
        self.press_walls(p, domain);
        self.settle(p, domain, 0.0);
        domain.refresh_column(&mut p.acceleration);
        Ok(())
    }

    /// Adds to the hydrostatic pressure the harmonic one that makes the free surface free: `Σ_b 2 V_b F_ab (q_a − q_b) = 0` over
    /// fluid (Brookshaw's Laplacian, natural at walls: the weight of the liquid is in the hydrostatic part), with
    /// `q_a = p_surface − p_hydrostatic` on the surface. The operator is symmetric for equal volumes; it is made so for others. It is a sum
    /// over pairs as those of a step: a matrix would take more memory than all the rest.
    ///
    /// A particle of the surface lies half a spacing below it where the surface faces up, and feels the weight of that much.
    fn release(&mut self, p: &mut Particles<D>, domain: &Domain<D>) -> Result<(), StepError> {
        let (owned, state) = (p.owned(), self.plan.state);
        let up = self.medium.gravity / -self.medium.g();
        let mut records = std::mem::take(&mut self.middle);
        for a in 0..owned {
            // The normals stand where velocities do.
            let normal = self.end[a].v::<D>();
            let mut known = 0.0;
            self.place[a] = match p.kind[a] {
                Kind::Fluid if normal == Vector::ZERO => Place::Inside,
                Kind::Fluid => {
                    let depth = 0.5 * self.medium.spacing * normal.dot(up).max(0.0);
                    known = state.rest * self.medium.g() * depth - p.pressure[a];
                    p.density[a] = state.density((p.pressure[a] + known).max(0.0));
                    Place::Surface
                }
                Kind::Wall | Kind::Lost => Place::Dry,
            };
            records[a] = record(p.x[a], Vector::ZERO, known, p.mass[a], p.kind[a] != Kind::Fluid);
        }
        domain.refresh_records(&mut records);
        // What the solver needs takes the place of what is made anew after it.
        (self.end, self.bulk) = (Vec::new(), Vec::new());

        let rise = |records: &[Record], q: &[f64], out: &mut [f64]| {
            let sums = Harmonic { pairs: self.pairs(records), rest: state.rest, place: &self.place, mass: &p.mass, h: &p.h, q };
            sweep_lanes(self.set, out, &sums);
        };
        let carry = |records: &mut [Record], q: &[f64]| {
            update(&mut records[..owned], |a, record| *record.value_mut::<D>() = q[a]);
            domain.refresh_records(records);
        };
        let mut q = vec![0.0; owned];
        let mut source = vec![0.0; owned];
        rise(&records, &q, &mut source);
        source.iter_mut().for_each(|source| *source = -*source);
        // Of one alone, the operator makes the diagonal.
        carry(&mut records, &q);
        let mut inverse = vec![0.0; owned];
        q.fill(1.0);
        rise(&records, &q, &mut inverse);
        inverse.iter_mut().for_each(|diagonal| *diagonal = if *diagonal > 0.0 { 1.0 / *diagonal } else { 1.0 });
        q.fill(0.0);
        let mut coarse = self.aggregates(p, domain)?;
        let goal = Goal { tolerance: RESIDUAL, negligible: 0.0, max_iterations: MOST_ITERATIONS };
        let solved = projection::solve(
            |q, aq| {
                carry(&mut records, q);
                rise(&records, q, aq);
            },
            |_| (),
            |r, z| coarse.apply(&inverse, r, z),
            &source,
            &mut q,
            goal,
            &mut Workspace::default(),
        );
        self.middle = records;
        solved?;
        for a in (0..owned).filter(|&a| self.place[a] == Place::Inside) {
            p.density[a] = state.density((p.pressure[a] + q[a]).max(0.0));
        }
        domain.refresh_column(&mut p.density);
        Ok(())
    }

    /// Fluid off the surface by cubes, with the links of the operator of [`release`](Self::release).
    fn aggregates(&self, p: &Particles<D>, domain: &Domain<D>) -> Result<Aggregates, SolveError> {
        let (owned, rest) = (p.owned(), self.plan.state.rest);
        let keys = (0..owned).filter(|&a| self.place[a] == Place::Inside);
        let keys = keys.map(|a| (cube_number(p.x[a], domain.min, WIDTH * self.medium.spacing), a as u32)).collect();
        Aggregates::new(owned, keys, |a, each| {
            for &b in self.near.of(a) {
                let b = b as usize;
                if p.is_fluid(b) {
                    let (r, h) = ((p.x[a] - p.x[b]).norm(), 0.5 * (p.h[a] + p.h[b]));
                    each(domain.parent(b, owned), -(p.mass[a] + p.mass[b]) / rest * self.kernel.dw_over_r(r, h));
                }
            }
        })
    }
}

/// `Σ_b 2 V_b F_ab (q_a − q_b)` over fluid inside; zero elsewhere.
struct Harmonic<'a, K, const D: usize> {
    /// The records carry `q`.
    pairs: Pairs<'a, K, D>,
    rest: f64,
    place: &'a [Place],
    mass: &'a [f64],
    h: &'a [f64],
    /// Of the particles themselves.
    q: &'a [f64],
}

impl<K: Kernel<D>, const D: usize> Rows<f64> for Harmonic<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, sum: &mut f64, _: &mut ()) {
        *sum = 0.0;
        if self.place[a] == Place::Inside {
            let term = Rise { reach: self.pairs.reach::<L>(self.h[a]), mass: L::splat(self.mass[a]), q: L::splat(self.q[a]) };
            let total: L = self.pairs.near.sum(a, self.pairs.records, &term);
            *sum = term.reach.slope_scale() / self.rest * total.total();
        }
    }
}

/// `(m_a + m_b) (q_b − q_a) W'/r` over fluid, on the scale of the particle.
struct Rise<'a, K, L> {
    reach: Reach<'a, K, L>,
    mass: L,
    q: L,
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Rise<'_, K, L> {
    type Totals = L;

    #[inline(always)]
    fn nothing(&self) -> L {
        L::splat(0.0)
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, total: &mut L) {
        let b = Seen::<L, D>::of(&group.fields);
        let mass = L::choose(b.wall, L::splat(0.0), self.mass + b.mass);
        *total = (mass * self.reach.slope(group)).times_plus(b.value - self.q, *total);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall that starts from rest stirs liquid at rest without gravity: sound answers to what it will do.
    #[test]
    fn a_wall_that_has_yet_to_move_counts() {
        let medium = Medium::<2> {
            rest_density: 1000.0,
            viscosity: 1.0,
            gravity: Vector::ZERO,
            spacing: 0.05,
            depth: 1.0,
            floor: 0.0,
            courant: 0.25,
            speed: 1.5,
        };
        assert_eq!(reference_speed(&medium, &Particles::new()), 1.5);
        assert_eq!(reference_speed(&Medium { gravity: Vector([0.0, -9.0]), ..medium }, &Particles::new()), 6.0);
    }
}
