//! Walls: what they know of the pressure, how they hold the fluid back, and the force on them.

use super::Flow;
use crate::domain::Domain;
use crate::math::Vector;
use crate::particles::{Kind, Particles};
use crate::reduce::sum;
use crate::sweep::{fit, sweep, update};
use crate::walls::first_line_parents;

/// A fluid particle after its move, and what the guard of walls did to it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Guarded<const D: usize> {
    pub(super) x: Vector<D>,
    pub(super) v: Vector<D>,
    /// Velocity the wall took, m/s, and the row of its particle.
    pub(super) taken: Vector<D>,
    pub(super) wall: u32,
}

impl<const D: usize> Guarded<D> {
    /// Not touched by a wall.
    pub(super) fn at(x: Vector<D>, v: Vector<D>) -> Self {
        Self { x, v, taken: Vector::ZERO, wall: u32::MAX }
    }
}

impl<const D: usize> Flow<D> {
    /// Whether normals of walls are needed: at the start, and while walls move.
    pub(super) fn walls_turn(&self, p: &Particles<D>) -> bool {
        self.first_line.len() != p.owned() || (0..p.owned()).any(|a| p.kind[a] == Kind::Wall && p.v[a] != Vector::ZERO)
    }

    /// `g − a` of a wall row, m/s²: what its pressure answers to.
    #[inline(always)]
    pub(super) fn answer(&self, p: &Particles<D>, a: usize) -> Vector<D> {
        self.medium.gravity - p.acceleration[a]
    }

    /// Normals of walls from those of the first line.
    pub(super) fn look_at_walls(&mut self, p: &Particles<D>, first: &[Vector<D>]) {
        let owned = p.owned();
        if self.first_line.len() != owned {
            self.first_line = first_line_parents(&self.near, p);
        }
        self.normals.resize(p.len(), Vector::ZERO);
        let first_line = &self.first_line;
        sweep(&mut self.normals[..owned], |a| first[first_line[a] as usize]);
    }

    /// Drag of wall particle `w` on fluid particle `a`, m/s² over `ν`: `2 f β (v_w − v_a)`, `β = 1 + d_w/d_a` from the distances
    /// to the face of the wall: the velocity goes on linearly to that of the wall there (Morris, Fox & Zhu 1997).
    pub(super) fn drag(&self, p: &Particles<D>, a: usize, w: usize, x_aw: Vector<D>, f: f64) -> Vector<D> {
        let dx = self.medium.spacing;
        let behind = (f64::from(p.layer[w]) - 0.5) * dx;
        // Nearer than half a spacing a particle is taken to be there: it would be dragged without bound.
        let before = (x_aw.dot(self.normals[w]) - behind).max(0.5 * dx);
        let beta = if self.normals[w] == Vector::ZERO { 1.0 } else { 1.0 + behind / before };
        2.0 * f * beta * (p.v[w] - p.v[a])
    }

    /// Fluid particle `a` moved by the step, but kept at least a fifth of a spacing off the face of a wall; there it loses its
    /// velocity into the wall.
    pub(super) fn guarded(&self, p: &Particles<D>, a: usize, dt: f64) -> Guarded<D> {
        let dx = self.medium.spacing;
        let x = p.x[a] + dt * self.v[a] + self.shift[a];
        let v = self.v[a] + self.convected(a);
        let mut moved = Guarded::at(x, v);
        if self.at[a].off_walls == Vector::ZERO {
            return moved;
        }
        self.near.for_each_at(&p.x, a, &self.f, |b, _, _| {
            let normal = self.normals[b];
            if p.layer[b] == 1 && normal != Vector::ZERO {
                let off = moved.x - p.x[b] - dt * self.v[b];
                let height = off.dot(normal);
                if height < 0.7 * dx && height > -dx && (off - height * normal).norm() <= dx {
                    moved.x += (0.7 * dx - height) * normal;
                    let taken = (moved.v - self.v[b]).dot(normal).min(0.0) * normal;
                    moved.v -= taken;
                    moved.taken += taken;
                    moved.wall = b as u32;
                }
            }
        });
        moved
    }

    /// Pressure of first-line wall particle `a`, Pa: `Σ (p_b + ρ (g − a_w)·(x_w − x_b)) f/Σ f` over fluid (after Adami, Hu & Adams
    /// 2012), less where less than half the fluid of a flat wall is in reach.
    pub(super) fn wall_pressure(&self, p: &Particles<D>, a: usize) -> f64 {
        let (mut weight, mut total, mut spread) = (0.0, 0.0, 0.0);
        self.near.for_each_at(&p.x, a, &self.f, |b, x_ab, f| {
            if p.is_fluid(b) {
                weight += f;
                spread += f * x_ab.norm_squared();
                total += f * (p.pressure[b] + self.medium.rest_density * self.answer(p, a).dot(x_ab));
            }
        });
        let flat_wall = (1.0 - self.lattice.spread_row[0]) * self.lattice.spread;
        if weight > 0.0 { total / weight * (spread / (0.5 * flat_wall)).min(1.0) } else { 0.0 }
    }

    /// Pressure of wall rows for output: the first line from the fluid, the others from the first one with the weight between.
    pub(super) fn wall_pressures(&mut self, p: &mut Particles<D>) {
        let owned = p.owned();
        let mut walls = std::mem::take(&mut self.source);
        fit(&mut walls, owned, 0.0);
        sweep(&mut walls, |a| if p.kind[a] == Kind::Wall && p.layer[a] <= 1 { self.wall_pressure(p, a) } else { 0.0 });
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Wall) {
            let first = self.first_line[a] as usize;
            let below = self.medium.rest_density * self.answer(p, a).dot(p.x[a] - p.x[first]);
            p.pressure[a] = if walls[first] == 0.0 { 0.0 } else { walls[first] + below };
        }
        self.source = walls;
    }

    /// Force of the fluid on wall particle `a`, N, but for friction: pressure of each pair, `V f (p_b + p_w) x_wb`, the potential
    /// of the clean-up, and what the guard took.
    pub(super) fn wall_force(&self, p: &Particles<D>, domain: &Domain<D>, dt: f64, a: usize) -> Vector<D> {
        let rest = self.medium.rest_density;
        // Exact for constant pressure on a lattice.
        let scale = D as f64 / self.lattice.spread;
        let mut total = Vector::ZERO;
        self.near.for_each_at(&p.x, a, &self.f, |b, x_ab, f| {
            if p.is_fluid(b) {
                let pressure = scale * (2.0 * p.pressure[b] + rest * self.answer(p, a).dot(x_ab)) + rest * f64::from(self.cleaning[b]) / dt;
                total += p.mass[b] / rest * f * pressure * x_ab;
                let owner = domain.parent(b, p.owned());
                let moved = &self.moved[owner];
                if moved.wall != u32::MAX && domain.parent(moved.wall as usize, p.owned()) == a {
                    total += p.mass[b] / dt * moved.taken;
                }
            }
        });
        total
    }

    /// Forces on walls: friction is there already; adds the rest, and shares out what the momentum of the fluid says is missing.
    ///
    /// The gradient is exact rather than conservative, so that the balance of momentum differs a little from the sum over pairs. Where
    /// particles stand unevenly, all pressures of pairs push by the same share `ε` too much or too little (1 % beside packed water).
    /// Least squares tell it from the push `P` on all walls and what it has to be, `F`: `|P − (1 + ε) F|² + ε² Σ P_w²` is least, where
    /// the second term stands for errors of each push of its own. What remains is shared out in proportion to the forces, direction by
    /// direction.
    pub(super) fn wall_forces(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        let mut force = std::mem::take(&mut p.force);
        let mut push = std::mem::take(&mut self.by_unknown);
        fit(&mut push, owned, [0.0; D]);
        let this = &*self;
        sweep(&mut push, |a| if p.kind[a] == Kind::Wall { this.wall_force(p, domain, dt, a).0 } else { [0.0; D] });

        let balance = total(owned, |a| if p.is_fluid(a) { p.mass[a] * (this.medium.gravity - p.acceleration[a]) } else { Vector::ZERO });
        let pushed = total(owned, |a| Vector(push[a]));
        let due = balance - total(owned, |a| force[a]);
        let own = sum(owned, |a| Vector(push[a]).norm_squared());
        let (exact, found) = (due.norm_squared() + own, pushed.dot(due) + own);
        let factor = if found > 0.0 { (exact / found).clamp(0.5, 2.0) } else { 1.0 };
        update(&mut force[..owned], |a, force| *force += factor * Vector(push[a]));

        let missing = balance - total(owned, |a| force[a]);
        for d in 0..D {
            let exerted = sum(owned, |a| force[a][d].abs());
            if exerted > 0.0 {
                let share = (missing[d] / exerted).clamp(-1.0, 1.0);
                update(&mut force[..owned], |_, force| force[d] += share * force[d].abs());
            }
        }
        self.by_unknown = push;
        p.force = force;
    }
}

/// Sum of a vector over the first `n` rows.
fn total<const D: usize>(n: usize, of: impl Fn(usize) -> Vector<D> + Sync) -> Vector<D> {
    Vector(std::array::from_fn(|d| sum(n, |a| of(a)[d])))
}
