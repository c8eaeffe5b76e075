//! Parts of the fluid that touch each other, and what each of them owes to mechanics while it touches no wall.

use super::walls::Guarded;
use rayon::prelude::*;

use crate::domain::Domain;
use crate::math::{Matrix, Vector, inverse};
use crate::neighbors::Neighbors;
use crate::particles::{Kind, Particles};

/// Part of rows that are no fluid.
pub(super) const NONE: u32 = u32::MAX;

/// The parts of the fluid: two particles in reach of each other belong to the same one.
#[derive(Clone, Debug, Default)]
pub(super) struct Parts<const D: usize> {
    /// Number of the part of each row, in the order of their first rows; [`NONE`] for all but fluid.
    pub(super) of: Vec<u32>,
    pub(super) count: usize,
    extents: Vec<Extent>,
    bodies: Vec<Body<D>>,
}

/// Counts of a part.
#[derive(Clone, Copy, Debug, Default)]
struct Extent {
    particles: usize,
    /// Particles on a surface, and those that were in the step before.
    surface: usize,
    before: usize,
    /// Whether it is taken to have none.
    full: bool,
}

/// Share of the `N^((D−1)/D)` particles on a side of a part that may come to a surface before a part that had none is taken to have one.
const HOLES: f64 = 0.05;

/// Sums over a part.
#[derive(Clone, Copy, Debug, Default)]
struct Body<const D: usize> {
    /// Whether walls are in reach.
    held: bool,
    /// Mass, kg, and centre, m, at the start of the step.
    mass: f64,
    centre: Vector<D>,
    /// Momentum as it must be and as it is, kg m/s.
    owed: Vector<D>,
    found: Vector<D>,
    /// `Σ m (x − x_before)`, kg m.
    moved: Vector<D>,
    /// Angular momentum that is missing, kg m²/s, a plane of axes each, and the inertia of turning in these planes, kg m².
    missing: Vector<3>,
    inertia: Matrix<3>,
}

/// Rows that look for each other at once.
const BLOCK: usize = 4096;

/// The first row of the part of `a`, as far as it is known.
fn first(of: &mut [u32], mut a: u32) -> u32 {
    while of[a as usize] != a {
        of[a as usize] = of[of[a as usize] as usize];
        a = of[a as usize];
    }
    a
}

/// Makes the parts of two rows one.
fn join(of: &mut [u32], a: u32, b: u32) {
    let (a, b) = (first(of, a), first(of, b));
    of[a.max(b) as usize] = a.min(b);
}

/// Planes of axes in which something turns: the first one in two dimensions, three in three.
const PLANES: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// Velocity at `x` of turning once a second and radian in plane `k`; nothing for planes that the dimension has not.
fn turning<const D: usize>(k: usize, x: Vector<D>) -> Vector<D> {
    let (i, j) = PLANES[k];
    if j < D { x[i] * Vector::unit(j) - x[j] * Vector::unit(i) } else { Vector::ZERO }
}

impl<const D: usize> Parts<D> {
    /// Finds the parts.
    pub(super) fn find(&mut self, p: &Particles<D>, domain: &Domain<D>, near: &Neighbors<D>) {
        let owned = p.owned();
        self.of.resize(owned, 0);
        // Pairs of fluid whose second row belongs to an earlier block.
        let mut pairs_across: Vec<Vec<(u32, u32)>> = vec![Vec::new(); owned.div_ceil(BLOCK)];
        // A row leads to one before it, and in the end to the first of its part, whichever pairs are looked at first: blocks on their own,
        // then the pairs across them.
        let blocks = self.of.par_chunks_mut(BLOCK).zip(&mut pairs_across).enumerate();
        blocks.for_each(|(block, (of, across))| {
            let start = block * BLOCK;
            of.iter_mut().enumerate().for_each(|(i, of)| *of = i as u32);
            for i in 0..of.len() {
                let a = start + i;
                if !p.is_fluid(a) {
                    continue;
                }
                for &b in near.of(a) {
                    let b = domain.parent(b as usize, owned);
                    if b < start && p.is_fluid(b) {
                        across.push((a as u32, b as u32));
                    } else if b < a && of[b - start] != of[i] && p.is_fluid(b) {
                        join(of, i as u32, (b - start) as u32);
                    }
                }
            }
            of.iter_mut().for_each(|of| *of += start as u32);
        });
        for &(a, b) in pairs_across.iter().flatten() {
            if self.of[a as usize] != self.of[b as usize] {
                join(&mut self.of, a, b);
            }
        }
        for a in 0..owned as u32 {
            self.of[a as usize] = first(&mut self.of, a);
        }
        self.count = 0;
        for a in 0..owned {
            let first = self.of[a] as usize;
            self.of[a] = match p.kind[a] {
                Kind::Fluid if first == a => {
                    self.count += 1;
                    self.count as u32 - 1
                }
                Kind::Fluid => self.of[first],
                Kind::Wall | Kind::Lost => NONE,
            };
        }
    }

    /// Finds the parts that fill what holds them, from who is on a surface and who was in the step before. A part has a surface where a kernel can tell
    /// it from a hole of the packing: on more than `2^D` of its particles, or a larger share than one in 16, as drops and puddles have. One that had
    /// none before, and whose volume therefore still is that of what holds it, gets one only from much larger holes than bodies tear in their
    /// wakes. With zero pressure in such a hole, all that the fluid lacks or has too much of would pass through it within a step.
    pub(super) fn find_full(&mut self, on_surface: impl Fn(usize) -> bool, was_on_surface: impl Fn(usize) -> bool) {
        self.extents.clear();
        self.extents.resize(self.count, Extent::default());
        for (a, &part) in self.of.iter().enumerate() {
            if let Some(extent) = self.extents.get_mut(part as usize) {
                extent.particles += 1;
                extent.surface += usize::from(on_surface(a));
                extent.before += usize::from(was_on_surface(a));
            }
        }
        for extent in &mut self.extents {
            let side = (extent.particles as f64).powf((D as f64 - 1.0) / D as f64);
            let holes = if extent.before == 0 { (HOLES * side) as usize } else { 0 };
            extent.full = extent.surface <= holes.max(1 << D) && 16 * extent.surface < extent.particles;
        }
    }

    /// Whether row `a` is of fluid that fills what holds it, at the last [`find_full`](Self::find_full).
    pub(super) fn is_full(&self, a: usize) -> bool {
        self.extents.get(self.of[a] as usize).is_some_and(|extent| extent.full)
    }

    /// Gives each part without walls in reach (`held` tells who has one) the momentum, the path of its centre and, without periodic axes,
    /// the angular momentum that it has by mechanics: a rigid motion of the part is added, which changes no distance and no divergence.
    /// `moved` is the state after a step of `dt` with velocities pushed over `kick`, `p` that before it.
    pub(super) fn keep_momentum(
        &mut self,
        p: &Particles<D>,
        domain: &Domain<D>,
        held: impl Fn(usize) -> bool,
        (gravity, spacing): (Vector<D>, f64),
        (dt, kick): (f64, f64),
        moved: &mut [Guarded<D>],
    ) {
        self.bodies.clear();
        self.bodies.resize(self.count, Body::default());
        let (bodies, of) = (&mut self.bodies, &self.of);
        for (a, &part) in of.iter().enumerate() {
            if let Some(body) = bodies.get_mut(part as usize).filter(|body| !body.held) {
                body.held = held(a);
            }
        }
        if bodies.iter().all(|body| body.held) {
            return;
        }
        for (a, moved) in moved.iter().enumerate() {
            if let Some(body) = bodies.get_mut(of[a] as usize).filter(|body| !body.held) {
                body.mass += p.mass[a];
                body.centre += p.mass[a] * p.x[a];
                body.owed += p.mass[a] * (p.v[a] + kick * gravity);
                body.found += p.mass[a] * moved.v;
                body.moved += p.mass[a] * (moved.x - p.x[a]);
            }
        }
        for body in &mut *bodies {
            body.centre = body.centre / body.mass;
        }
        for (a, moved) in moved.iter_mut().enumerate() {
            if let Some(body) = bodies.get_mut(of[a] as usize).filter(|body| !body.held) {
                moved.v += (body.owed - body.found) / body.mass;
                moved.x += (dt * body.owed - body.moved) / body.mass;
                let (before, after) = (p.x[a] - body.centre, moved.x - body.centre);
                let arm = after - (dt / body.mass) * body.owed;
                for k in 0..3 {
                    let (owed, found) = (turning(k, before).dot(p.v[a] + kick * gravity), turning(k, after).dot(moved.v));
                    body.missing[k] += p.mass[a] * (owed - found);
                    for l in 0..3 {
                        body.inertia[k][l] += p.mass[a] * turning(k, arm).dot(turning(l, arm));
                    }
                }
            }
        }
        if domain.periodic.contains(&true) {
            return;
        }
        for body in &mut *bodies {
            // Planes that are not there turn nothing.
            let size = body.inertia[0][0];
            for k in (D * D - D) / 2..3 {
                body.inertia[k][k] = size;
            }
            // A line of particles does not resist turning about itself, and one alone not at all: what it has is rounding.
            let turns = size > 1e-6 * body.mass * spacing * spacing;
            body.missing =
                inverse(&body.inertia).filter(|_| turns).map_or(Vector::ZERO, |inverse| crate::math::transform(&inverse, body.missing));
        }
        for (a, moved) in moved.iter_mut().enumerate() {
            if let Some(body) = bodies.get(of[a] as usize).filter(|body| !body.held) {
                let arm = moved.x - body.centre - (dt / body.mass) * body.owed;
                for k in 0..3 {
                    moved.v += body.missing[k] * turning(k, arm);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a part of `n` particles of which `surface` are on a surface, and `before` were, has none.
    fn is_full<const D: usize>(n: usize, surface: usize, before: usize) -> bool {
        let mut parts = Parts::<D> { of: vec![0; n], count: 1, ..Parts::default() };
        parts.find_full(|a| a < surface, |a| a < before);
        parts.is_full(0)
    }

    #[test]
    fn a_hole_of_the_packing_is_no_surface() {
        assert!(is_full::<2>(10_000, 0, 100) && is_full::<2>(10_000, 4, 100) && is_full::<3>(10_000, 8, 100));
        assert!(!is_full::<2>(10_000, 5, 100) && !is_full::<3>(10_000, 9, 100));
        // A twentieth of a side.
        assert!(is_full::<2>(40_000, 10, 0) && !is_full::<2>(40_000, 11, 0));
        // Drops and puddles.
        assert!(!is_full::<2>(1, 1, 0) && !is_full::<2>(3, 2, 0) && !is_full::<2>(40, 4, 0));
    }
}
