//! Where the free surface is.

use std::f64::consts::{PI, TAU};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::Vector;
use crate::neighbors::Neighbors;

/// How a particle of the free surface is told from one inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SurfaceTest {
    /// Density below a share of the rest density (Koshizuka & Oka 1996; Shao & Lo 2003).
    Density,
    /// The disc (sphere) round the particle is not wholly covered by those of its neighbours (Dilts 2000; Haque & Dilts 2007).
    Dilts,
}

/// Whether the circle (sphere) of radius `radius`, m, round particle `a` shows a gap between the equal discs (balls) of its
/// neighbours: the particle lies on the boundary of the union of all discs. Exact in two and three dimensions.
///
/// `arcs` is scratch storage. Sees neighbours up to `2 radius`, so the support of the pairs must reach that far.
/// Sources: Dilts, Int. J. Numer. Meth. Eng. 48 (2000) 1503; in 3D Haque & Dilts, J. Comput. Phys. 226 (2007) 1710.
pub fn is_exposed<const D: usize>(near: &Neighbors<D>, radius: f64, a: usize, arcs: &mut Arcs<D>) -> bool {
    arcs.caps.clear();
    near.for_each(a, |pair| {
        if pair.r > 0.0 && pair.r < 2.0 * radius {
            arcs.caps.push(Cap { towards: -pair.x_ab / pair.r, cosine: pair.r / (2.0 * radius) });
        }
    });
    if D == 2 { arcs.circle_shows() } else { arcs.sphere_shows() }
}

/// Scratch storage of [`is_exposed`].
#[derive(Clone, Debug, Default)]
pub struct Arcs<const D: usize> {
    caps: Vec<Cap<D>>,
    covered: Vec<(f64, f64)>,
}

/// The part of a circle or sphere that a neighbour covers: directions `u` with `u · towards >= cosine`.
#[derive(Clone, Copy, Debug)]
struct Cap<const D: usize> {
    towards: Vector<D>,
    cosine: f64,
}

impl<const D: usize> Arcs<D> {
    fn circle_shows(&mut self) -> bool {
        self.covered.clear();
        for cap in &self.caps {
            cover(&mut self.covered, cap.towards[1].atan2(cap.towards[0]), cap.cosine.acos());
        }
        has_gap(&mut self.covered)
    }

    /// The rim of a bare patch is made of arcs of the rims of caps: look for a stretch of a rim that no other cap covers.
    fn sphere_shows(&mut self) -> bool {
        if self.caps.is_empty() {
            return true;
        }
        (0..self.caps.len()).any(|j| self.rim_shows(j))
    }

    fn rim_shows(&mut self, j: usize) -> bool {
        let Cap { towards: n, cosine } = self.caps[j];
        let sine = (1.0 - cosine * cosine).sqrt();
        let (e1, e2) = tangents(n);
        self.covered.clear();
        for (k, cap) in self.caps.iter().enumerate() {
            if k == j {
                continue;
            }
            let height = cosine * n.dot(cap.towards);
            let (along1, along2) = (cap.towards.dot(e1), cap.towards.dot(e2));
            let reach = sine * (along1 * along1 + along2 * along2).sqrt();
            if height - reach >= cap.cosine {
                return false;
            }
            if height + reach > cap.cosine {
                cover(&mut self.covered, along2.atan2(along1), ((cap.cosine - height) / reach).acos());
            }
        }
        has_gap(&mut self.covered)
    }
}

/// Two unit vectors at right angles to the unit vector `n` and to each other, in three dimensions.
fn tangents<const D: usize>(n: Vector<D>) -> (Vector<D>, Vector<D>) {
    let axis = (0..D).min_by(|&i, &j| n[i].abs().total_cmp(&n[j].abs())).unwrap_or(0);
    let mut e1 = Vector::unit(axis) - n[axis] * n;
    e1 = e1 / e1.norm();
    let mut e2 = Vector::ZERO;
    for d in 0..D {
        let (i, j) = ((d + 1) % D, (d + 2) % D);
        e2[d] = n[i] * e1[j] - n[j] * e1[i];
    }
    (e1, e2)
}

/// Adds the arc `middle ± half`, rad, as intervals within `[−π, π]`.
fn cover(covered: &mut Vec<(f64, f64)>, middle: f64, half: f64) {
    let (from, to) = (middle - half, middle + half);
    covered.push((from.max(-PI), to.min(PI)));
    if from < -PI {
        covered.push((from + TAU, PI));
    }
    if to > PI {
        covered.push((-PI, to - TAU));
    }
}

/// Whether intervals leave a part of `[−π, π]` bare. Gaps below 1e-12 rad are round-off of arcs that touch.
fn has_gap(covered: &mut [(f64, f64)]) -> bool {
    covered.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut reached = -PI;
    for &(from, to) in covered.iter() {
        if from > reached + 1e-12 {
            return true;
        }
        reached = reached.max(to);
    }
    reached < PI - 1e-12
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::neighbors::Search;
    use crate::particles::{Kind, Particle, Particles};

    fn exposed<const D: usize>(points: &[Vector<D>], radius: f64) -> Vec<bool> {
        let mut p = Particles::new();
        for (id, &x) in points.iter().enumerate() {
            p.push(id as u32, Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h: 1.2 });
        }
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        (0..points.len()).map(|a| is_exposed(&near, radius, a, &mut Arcs::default())).collect()
    }

    fn block<const D: usize>(n: usize) -> Vec<Vector<D>> {
        let count = (0..D).fold(1, |product, _| product * n);
        (0..count)
            .map(|i| {
                let mut rest = i;
                Vector(std::array::from_fn(|_| {
                    let along = rest % n;
                    rest /= n;
                    along as f64
                }))
            })
            .collect()
    }

    fn on_the_rim<const D: usize>(x: &Vector<D>, n: usize) -> bool {
        (0..D).any(|d| x[d] == 0.0 || x[d] == (n - 1) as f64)
    }

    #[test]
    fn exactly_the_rim_of_a_block_is_exposed_in_2d_and_3d() {
        let square = block::<2>(8);
        for (x, shows) in square.iter().zip(exposed(&square, 1.1)) {
            assert_eq!(shows, on_the_rim(x, 8), "at {x:?}");
        }
        let cube = block::<3>(6);
        for (x, shows) in cube.iter().zip(exposed(&cube, 1.1)) {
            assert_eq!(shows, on_the_rim(x, 6), "at {x:?}");
        }
    }

    /// A disc of 1.1 spacings closes the place of one missing particle, 1 spacing away, but not the middle of a hole of two by
    /// two, 1.58 away; there the eight particles beside the hole show, its four corners do not.
    #[test]
    fn holes_show_from_two_by_two_missing_particles_on() {
        let whole = block::<2>(10);
        let missing = |hole: &[[f64; 2]]| -> Vec<Vector<2>> { whole.iter().copied().filter(|x| !hole.contains(&x.0)).collect() };
        let inside = |points: &[Vector<2>]| -> Vec<Vector<2>> {
            let shows = exposed(points, 1.1);
            points.iter().zip(shows).filter(|(x, shows)| *shows && !on_the_rim(x, 10)).map(|(x, _)| *x).collect()
        };
        assert!(inside(&missing(&[[4.0, 4.0]])).is_empty());
        let beside = inside(&missing(&[[4.0, 4.0], [5.0, 4.0], [4.0, 5.0], [5.0, 5.0]]));
        assert_eq!(beside.len(), 8, "{beside:?}");
    }

    #[test]
    fn lone_particles_and_thin_sheets_are_exposed() {
        assert_eq!(exposed(&[Vector([0.0, 0.0])], 1.1), [true]);
        let sheet: Vec<Vector<3>> = (0..36).map(|i| Vector([f64::from(i % 6), f64::from(i / 6), 0.0])).collect();
        assert!(exposed(&sheet, 1.1).iter().all(|&shows| shows));
    }
}
