//! The last resort of walls: what comes too near is set back on their face.

use crate::domain::Domain;
use crate::math::Vector;
use crate::neighbors::Neighbors;
use crate::particles::Particles;
use crate::reduce::sum;
use crate::sweep::update;

/// What stands for the row of a wall particle where there is none.
pub const NO_WALL: u32 = u32::MAX;

/// A fluid particle after its move, and what walls did to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guarded<const D: usize> {
    /// Position, m.
    pub x: Vector<D>,
    /// Velocity, m/s.
    pub v: Vector<D>,
    /// Velocity that walls took, m/s.
    pub taken: Vector<D>,
    /// Row of the wall particle that took it last; [`NO_WALL`] for none.
    pub wall: u32,
}

impl<const D: usize> Default for Guarded<D> {
    fn default() -> Self {
        Self { x: Vector::ZERO, v: Vector::ZERO, taken: Vector::ZERO, wall: NO_WALL }
    }
}

/// How near a wall fluid may come, in spacings off its face, which lies half a spacing before its first line.
const GAP: f64 = 0.2;

impl<const D: usize> Guarded<D> {
    /// A particle moved to `x`, m, with the velocity `v`, m/s.
    pub fn moved(x: Vector<D>, v: Vector<D>) -> Self {
        Self { x, v, ..Self::default() }
    }

    /// Meets the first-line wall particle in row `wall`, which is at `x` and moves with `v` after the step: kept `gap` spacings off its face, of the unit
    /// normal `normal`, where it loses its velocity into the wall. One more than a spacing behind the first line is on the far side and stays.
    #[inline]
    pub fn meet(&mut self, wall: u32, (x, v): (Vector<D>, Vector<D>), normal: Vector<D>, spacing: f64, gap: f64) {
        let (off, least) = (self.x - x, (0.5 + gap) * spacing);
        let height = off.dot(normal);
        if height < least && height > -spacing && (off - height * normal).norm() <= spacing {
            self.x += (least - height) * normal;
            let taken = (self.v - v).dot(normal).min(0.0) * normal;
            self.v -= taken;
            self.taken += taken;
            self.wall = wall;
        }
    }
}

/// Fluid particle `a` moved to `x` with velocity `v`, but kept a fifth of a spacing off the face of walls, see [`meet`](Guarded::meet). `normals` are those
/// of first-line wall particles, zero for all others.
pub fn set_back<const D: usize>(
    near: &Neighbors<D>,
    p: &Particles<D>,
    normals: &[Vector<D>],
    (spacing, dt): (f64, f64),
    a: usize,
    (x, v): (Vector<D>, Vector<D>),
) -> Guarded<D> {
    let mut moved = Guarded::moved(x, v);
    near.for_each(a, |pair| {
        let b = pair.b;
        if p.layer[b] == 1 && normals[b] != Vector::ZERO {
            moved.meet(b as u32, (near.x(b) + dt * p.v[b], p.v[b]), normals[b], spacing, GAP);
        }
    });
    moved
}

/// Force on wall particle `a` from the fluid that it set back, N: `Σ m_b taken_b/Δt`.
pub fn force_of_set_back<const D: usize>(
    near: &Neighbors<D>,
    p: &Particles<D>,
    domain: &Domain<D>,
    moved: &[Guarded<D>],
    dt: f64,
    a: usize,
) -> Vector<D> {
    let (owned, mut total) = (p.owned(), Vector::ZERO);
    near.for_each(a, |pair| {
        if p.is_fluid(pair.b) {
            let moved = &moved[domain.parent(pair.b, owned)];
            if moved.wall != NO_WALL && domain.parent(moved.wall as usize, owned) == a {
                total += p.mass[pair.b] / dt * moved.taken;
            }
        }
    });
    total
}

/// For methods whose forces of pairs do not cancel: adds to the forces on walls what the momentum of the fluid says is missing,
/// along each axis by their size, at most as much as is there. `p.acceleration` of fluid is that of the whole step.
pub fn balance<const D: usize>(p: &mut Particles<D>, gravity: Vector<D>) {
    let owned = p.owned();
    let mut force = std::mem::take(&mut p.force);
    for d in 0..D {
        let on_walls = sum(owned, |a| force[a][d]);
        let exerted = sum(owned, |a| force[a][d].abs());
        let of_fluid = sum(owned, |a| if p.is_fluid(a) { p.mass[a] * (p.acceleration[a][d] - gravity[d]) } else { 0.0 });
        let missing = -of_fluid - on_walls;
        if exerted > 0.0 {
            let share = (missing / exerted).clamp(-1.0, 1.0);
            update(&mut force[..owned], |_, force| force[d] += share * force[d].abs());
        }
    }
    p.force = force;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::neighbors::Search;
    use crate::particles::{Kind, Particle};

    /// A floor with its face at `y = 0`, spacing 0.1, and one fluid particle at `x`.
    fn over_a_floor(x: Vector<2>, v: Vector<2>) -> (Guarded<2>, Vector<2>) {
        let (dx, dt, mut p) = (0.1, 0.01, Particles::new());
        let mut push = |kind, layer, x| {
            let id = p.owned() as u32;
            p.push(id, Particle { kind, layer, x, v: Vector::ZERO, mass: 10.0, density: 1000.0, pressure: 0.0, h: 1.3 * dx });
        };
        push(Kind::Fluid, 0, Vector([x[0], 0.05]));
        for line in 1..=3u8 {
            for column in -6..=6 {
                push(Kind::Wall, line, Vector([dx * f64::from(column), -dx * (f64::from(line) - 0.5)]));
            }
        }
        let normals: Vec<_> = (0..p.owned()).map(|a| if p.layer[a] == 1 { Vector::unit(1) } else { Vector::ZERO }).collect();
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let mut moved = vec![Guarded::default(); p.owned()];
        moved[0] = set_back(&near, &p, &normals, (dx, dt), 0, (x, v));
        let domain = Domain::new(Vector([-5.0, -5.0]), Vector([5.0, 5.0]), [false; 2]);
        let force = (1..p.owned()).fold(Vector::ZERO, |sum, a| sum + force_of_set_back(&near, &p, &domain, &moved, dt, a));
        (moved[0], force)
    }

    #[test]
    fn what_comes_too_near_is_set_back_and_pushes_the_wall() {
        let (moved, force) = over_a_floor(Vector([0.02, -0.03]), Vector([1.5, -2.0]));
        // 1e-12: round-off. A fifth of a spacing off the face; 10 kg/m lose 2 m/s in 0.01 s.
        assert!((moved.x - Vector([0.02, 0.02])).norm() < 1e-12 && (moved.v - Vector([1.5, 0.0])).norm() < 1e-12, "{moved:?}");
        assert!((force - Vector([0.0, -2000.0])).norm() < 1e-9, "{force:?}");
    }

    /// Held at the first line, half a spacing behind the face: 0.1 before it a particle goes on, 0.1 behind it does not.
    #[test]
    fn walls_may_hold_fluid_at_their_first_line_only() {
        let (face, spacing, v) = (Vector([0.0, -0.05]), 0.1, Vector([1.5, -2.0]));
        let meets = |height: f64| {
            let mut moved = Guarded::moved(face + Vector([0.0, height]), v);
            moved.meet(3, (face, Vector::ZERO), Vector::unit(1), spacing, -0.5);
            moved
        };
        assert_eq!(meets(0.01), Guarded::moved(face + Vector([0.0, 0.01]), v));
        let held = meets(-0.01);
        assert!((held.x - face).norm() < 1e-15, "{held:?}");
        assert_eq!((held.v, held.taken, held.wall), (Vector([1.5, 0.0]), Vector([0.0, -2.0]), 3));
    }

    #[test]
    fn what_stays_off_or_is_on_the_far_side_is_left_alone() {
        for y in [0.03, -0.17] {
            let (x, v) = (Vector([0.02, y]), Vector([1.5, -2.0]));
            let (moved, force) = over_a_floor(x, v);
            assert_eq!((moved.x, moved.v, force), (x, v, Vector::ZERO), "at y = {y}");
        }
    }
}
