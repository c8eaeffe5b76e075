//! Wall models: what wall particles do to the fluid.

pub mod dummy;
pub mod guard;

use crate::kernel::Kernel;
use crate::math::{Vector, power};
use crate::neighbors::Neighbors;
use crate::particles::{Kind, Particles};
use crate::sweep::sweep;

/// A force per unit mass, m/s², of a wall particle on a fluid particle.
#[derive(Clone, Debug, PartialEq)]
pub enum WallForces<const D: usize> {
    /// Monaghan (1994).
    LennardJones(LennardJones),
    /// Monaghan (2005).
    Normal(NormalForce<D>),
}

/// Equations (33)-(34), Monaghan (1994): `D ((r0/r)^p1 − (r0/r)^p2) x_ab/r²`.
#[derive(Clone, Debug, PartialEq)]
pub struct LennardJones {
    /// Strength `D`, m²/s².
    pub strength: f64,
    /// Range `r0`, m: the distance of no force.
    pub range: f64,
    /// `p1 > p2`, dimensionless.
    pub exponents: [u32; 2],
    /// Distance of the last force, m: `r0` for repulsion only.
    pub cutoff: f64,
}

impl LennardJones {
    /// Force per unit mass on the fluid particle at `x_ab` (length `r`, m) from a wall particle, m/s².
    #[inline(always)]
    pub fn on<const D: usize>(&self, x_ab: Vector<D>, r: f64) -> Vector<D> {
        if r < self.cutoff { lennard_jones(self.strength, self.range, self.exponents, r) * x_ab } else { Vector::ZERO }
    }
}

/// Monaghan (2005), section 5: along the normal of the wall, even along the wall.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalForce<const D: usize> {
    /// Speed of sound at rest, m/s.
    pub sound: f64,
    /// Spacing of the wall particles, m.
    pub spacing: f64,
    /// Unit normal of each wall particle of the first line, towards the fluid; zero for all other particles.
    pub normals: Vec<Vector<D>>,
}

impl<const D: usize> NormalForce<D> {
    /// Force per unit mass of `wall` on `fluid` in front of it, `x_ab` away, m/s²: the share `m_b/(m_a + m_b)` of the whole.
    #[inline(always)]
    pub fn on(&self, p: &Particles<D>, fluid: usize, wall: usize, x_ab: Vector<D>, h: f64) -> Vector<D> {
        let mass_share = p.mass[wall] / (p.mass[fluid] + p.mass[wall]);
        mass_share * normal_force(self.sound, self.spacing, x_ab, self.normals[wall], h)
    }
}

/// `D ((r0/r)^p1 − (r0/r)^p2)/r²`, 1/s²: times `x_ab` it is the force (34).
///
/// The print calls it a potential; it is a force per unit mass (Monaghan 1994).
#[inline(always)]
fn lennard_jones(strength: f64, range: f64, [p1, p2]: [u32; 2], r: f64) -> f64 {
    let q = range / r;
    strength * (power(q, p1) - power(q, p2)) / (r * r)
}

/// `Γ(y) χ(x) n`, m/s²: `y` is the distance to the wall particle along its normal `n`, `x` across it,
/// `χ = 1 − x/Δ` within one wall spacing `Δ`, so that a particle sliding along the wall feels an even force;
/// `Γ = 0.02 c²/y · g(y/h)` with `g = 2/3`, `2q − 3/2 q²`, `(2 − q)²/2` for `q < 2/3`, `< 1`, `< 2` (Monaghan 2005).
///
/// Nearer than a thousandth of `h` the force stays what it is there: the formula has a pole on the wall. Behind the wall
/// particle (`y < 0`) there is none: fluid on the far side of a thin obstacle does not feel this face.
fn normal_force<const D: usize>(sound: f64, spacing: f64, x_ab: Vector<D>, normal: Vector<D>, h: f64) -> Vector<D> {
    let along = x_ab.dot(normal);
    let across = (x_ab - along * normal).norm();
    if along < 0.0 || across >= spacing || normal == Vector::ZERO {
        return Vector::ZERO;
    }
    let y = along.max(1e-3 * h);
    let q = y / h;
    let shape = if q < 2.0 / 3.0 {
        2.0 / 3.0
    } else if q < 1.0 {
        2.0 * q - 1.5 * q * q
    } else if q < 2.0 {
        0.5 * (2.0 - q) * (2.0 - q)
    } else {
        0.0
    };
    0.02 * sound * sound / y * shape * (1.0 - across / spacing) * normal
}

/// Unit normals of the wall particles of the first line, towards the fluid: `−Σ_b V_b ∇W_ab` over wall particles, made a unit.
/// Zero for fluid, for the lines behind, and where wall particles surround the particle evenly.
pub fn wall_normals<K: Kernel<D>, const D: usize>(kernel: K, near: &Neighbors<D>, p: &Particles<D>) -> Vec<Vector<D>> {
    let mut normals = vec![Vector::ZERO; p.len()];
    sweep(&mut normals[..p.owned()], |a| {
        if p.kind[a] != Kind::Wall || p.layer[a] != 1 {
            return Vector::ZERO;
        }
        let mut outward = Vector::ZERO;
        near.for_each(a, |pair| {
            if p.kind[pair.b] == Kind::Wall {
                outward -= p.volume(pair.b) * kernel.dw_over_r(pair.r, pair.h) * pair.x_ab;
            }
        });
        let length = outward.norm();
        // A hundredth of 1/h: far below the 0.5/h of a flat wall, far above what rounding leaves of an even surrounding.
        if length * p.h[a] < 1e-2 { Vector::ZERO } else { outward / length }
    });
    normals
}

/// Row of the first-line wall particle in front of each wall particle, along the normal: the nearest neighbour of a line nearer
/// to the fluid, then the nearest of that one, until the first line. All other particles point to themselves.
pub fn first_line_parents<const D: usize>(near: &Neighbors<D>, p: &Particles<D>) -> Vec<u32> {
    let in_front = |a: usize| -> usize {
        let mut nearest = (a, f64::INFINITY);
        near.for_each(a, |pair| {
            if p.kind[pair.b] == Kind::Wall && p.layer[pair.b] < p.layer[a] && pair.r < nearest.1 {
                nearest = (pair.b, pair.r);
            }
        });
        nearest.0
    };
    let mut parents: Vec<u32> = (0..p.owned() as u32).collect();
    sweep(&mut parents, |a| {
        let mut parent = a;
        while p.kind[parent] == Kind::Wall && p.layer[parent] > 1 {
            let next = in_front(parent);
            if next == parent || next >= p.owned() {
                break;
            }
            parent = next;
        }
        parent as u32
    });
    parents
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lennard_jones_repels_inside_its_range_and_attracts_outside() {
        assert!(lennard_jones(73.0, 0.03, [12, 6], 0.029) > 0.0);
        assert!(lennard_jones(73.0, 0.03, [12, 6], 0.031) < 0.0);
        // (r0/r) = 2: D (4096 − 64)/r².
        assert_eq!(lennard_jones(1.0, 2.0, [12, 6], 1.0), 4032.0);
    }

    /// Monaghan's point: the force on a particle sliding along a row of wall particles does not change.
    #[test]
    fn normal_force_is_even_along_a_row() {
        let (spacing, h, y) = (0.1, 0.12, 0.07);
        let total = |x: f64| -> f64 {
            (-5..=5).map(|k| normal_force(50.0, spacing, Vector([x - spacing * f64::from(k), y]), Vector([0.0, 1.0]), h)[1]).sum()
        };
        for x in [0.0, 0.013, 0.05, 0.099] {
            // 1e-12: round-off of two summands.
            assert!((total(x) / total(0.0) - 1.0).abs() < 1e-12, "at x = {x}");
        }
        assert!(total(0.0) > 0.0);
    }

    /// A thin obstacle has fluid on both sides: the far side must not be drawn through it.
    #[test]
    fn normal_force_is_felt_in_front_of_the_wall_only() {
        let force = |y: f64| normal_force(50.0, 0.1, Vector([0.0, y]), Vector([0.0, 1.0]), 0.12);
        assert!(force(0.05)[1] > 0.0);
        assert_eq!(force(-0.05), Vector::ZERO);
    }
}
