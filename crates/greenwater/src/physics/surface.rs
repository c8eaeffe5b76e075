//! Where the free surface is.

use std::f64::consts::{PI, TAU};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lattice::Lattice;
use crate::kernel::Kernel;
use crate::math::{Vector, smallest_eigenvalue};
use crate::neighbors::{Neighbors, Pair};
use crate::particles::Particles;
use crate::sweep::{sweep, sweep_with};

/// How a particle of the free surface is told from one inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SurfaceTest {
    /// Density below a share of the rest density (Koshizuka & Oka 1996; Shao & Lo 2003).
    Density,
    /// Divergence of the positions less than half-way from that of the surface of a lattice to that inside (Lee et al. 2008).
    Divergence,
    /// The disc (sphere) round the particle is not wholly covered by those of its neighbours (Dilts 2000; Haque & Dilts 2007).
    Dilts,
    /// Uneven neighbours, and none of them in a cone of 45 degrees around the outward normal (Marrone et al. 2010).
    Umbrella,
}

/// A test of all particles with its limits, half-way between the two outermost rows of a lattice of the kernel in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detector {
    test: SurfaceTest,
    lattice: Lattice,
    /// Radius of the discs of [`SurfaceTest::Dilts`], m.
    radius: f64,
}

/// Smallest eigenvalue, over that inside, below which a particle is at a surface whatever its cone holds (Marrone et al. 2010):
/// less than where three faces of a lattice meet, 0.28.
const SPRAY: f64 = 0.2;

impl Detector {
    /// The test for particles on a lattice with these sums; the discs of Dilts get a radius of 1.1 spacings, which closes every gap of
    /// a lattice (0.71) with room for disorder.
    pub fn new(test: SurfaceTest, lattice: Lattice) -> Self {
        Self { test, lattice, radius: 1.1 * lattice.spacing }
    }

    /// The test with discs of `radius`, m.
    #[must_use]
    pub fn with_radius(self, radius: f64) -> Self {
        Self { radius, ..self }
    }

    /// Sets `surface` to 1 for each row at the surface, else 0. Every particle in reach counts, walls too.
    pub fn mark<K: Kernel<D>, const D: usize>(&self, kernel: K, near: &Neighbors<D>, p: &Particles<D>, surface: &mut [u8]) {
        let l = &self.lattice;
        let volume = |b: usize| p.mass[b] / l.rest_density;
        let f = |pair: &Pair<D>| -volume(pair.b) * kernel.dw_over_r(pair.r, pair.h);
        match self.test {
            SurfaceTest::Density => {
                let least = 0.5 * (l.sum_w_row[0] + l.sum_w_row[1]) * l.sum_w;
                sweep(surface, |a| {
                    let mut filling = volume(a) * kernel.w(0.0, near.h(a));
                    near.for_each(a, |pair| filling += volume(pair.b) * kernel.w(pair.r, pair.h));
                    u8::from(filling < least)
                });
            }
            SurfaceTest::Divergence => {
                let least = l.surface_threshold() * l.spread;
                sweep(surface, |a| {
                    let mut spread = 0.0;
                    near.for_each(a, |pair| spread += f(&pair) * pair.r * pair.r);
                    u8::from(spread < least)
                });
            }
            SurfaceTest::Dilts => {
                sweep_with(surface, Arcs::default, |arcs, a| u8::from(is_exposed(near, self.radius, a, arcs)));
            }
            SurfaceTest::Umbrella => {
                let whole = l.spread / D as f64;
                let most = 0.5 * (l.evenness_row[0] + l.evenness_row[1]);
                sweep(surface, |a| {
                    let (mut moment, mut outwards) = ([Vector::<D>::ZERO; D], Vector::ZERO);
                    near.for_each(a, |pair| {
                        let f = f(&pair);
                        outwards += f * pair.x_ab;
                        for (row, x) in moment.iter_mut().zip(pair.x_ab.0) {
                            *row += f * x * pair.x_ab;
                        }
                    });
                    let (evenness, length) = (smallest_eigenvalue(&moment) / whole, outwards.norm());
                    let shows = evenness < SPRAY || evenness < most && length > 0.0 && !under_cover(near, a, outwards / length);
                    u8::from(shows)
                });
            }
        }
    }
}

/// Whether a neighbour of `a` lies in the umbrella over it, opened towards the unit vector `n`. With `h` the smoothing length and `T`
/// the point `h n` from the particle: nearer than `√2 h`, within 45 degrees of `n` (in 2D within the square of corner `a` and
/// middle `T`); farther off, nearer than `h` to `T` (Marrone et al. 2010).
fn under_cover<const D: usize>(near: &Neighbors<D>, a: usize, n: Vector<D>) -> bool {
    let (h, mut covered) = (near.h(a), false);
    near.for_each(a, |pair| {
        let from_t = -pair.x_ab - h * n;
        let along = from_t.dot(n);
        covered |= if pair.r * pair.r >= 2.0 * h * h {
            from_t.norm_squared() < h * h
        } else if D == 2 {
            along.abs() + (from_t - along * n).norm() < h
        } else {
            // cos 45° = 1/√2.
            -pair.x_ab.dot(n) * std::f64::consts::SQRT_2 > pair.r
        };
    });
    covered
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
    use crate::kernel::{CubicSpline, WendlandC2};
    use crate::neighbors::Search;
    use crate::particles::{Kind, Particle};

    const ALL: [SurfaceTest; 4] = [SurfaceTest::Density, SurfaceTest::Divergence, SurfaceTest::Dilts, SurfaceTest::Umbrella];

    /// What a test says of a shape cut out of a lattice: rim particles and how many it missed, inner ones and how many it took for rim.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct Confusion {
        rim: usize,
        missed: usize,
        inside: usize,
        wrong: usize,
    }

    /// The lattice sites within `half` of the origin that `shape` holds, each off its place by up to `jitter` spacings along each
    /// axis. Rim: a site next to it along an axis is empty. Inside: all sites around it, diagonals too, are full. What lies between
    /// may be either.
    fn confusion<K: Kernel<D>, const D: usize>(
        (kernel, h): (K, f64),
        test: SurfaceTest,
        half: i64,
        shape: impl Fn([i64; D]) -> bool,
        jitter: f64,
        seeds: u64,
    ) -> Confusion {
        let side = 2 * half + 1;
        let sites: Vec<[i64; D]> = (0..(0..D).fold(1, |count, _| count * side))
            .map(|i| {
                let mut rest = i;
                std::array::from_fn(|_| {
                    let along = rest % side - half;
                    rest /= side;
                    along
                })
            })
            .filter(|&site| shape(site))
            .collect();
        let lattice = Lattice::of::<K, D>(kernel, h, 1.0, 1.0);
        let mut found = Confusion::default();
        for seed in 0..seeds {
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
            };
            let mut p = Particles::new();
            for (id, site) in sites.iter().enumerate() {
                let x = Vector(site.map(|x| x as f64 + jitter * next()));
                p.push(id as u32, Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h });
            }
            let mut near = Neighbors::new();
            near.build(&p, kernel.radius(), Search::Grid).unwrap();
            let mut surface = vec![0; sites.len()];
            Detector::new(test, lattice).mark(kernel, &near, &p, &mut surface);
            for (&site, &shows) in sites.iter().zip(&surface) {
                let moved = |axis: usize, by: i64| {
                    let mut other = site;
                    other[axis] += by;
                    other
                };
                let rim = (0..D).any(|d| !shape(moved(d, 1)) || !shape(moved(d, -1)));
                let around = (0..(0..D).fold(1, |count, _| count * 3)).all(|i: i64| {
                    let mut rest = i;
                    let other = site.map(|x| {
                        let by = rest % 3 - 1;
                        rest /= 3;
                        x + by
                    });
                    shape(other)
                });
                found.rim += usize::from(rim);
                found.missed += usize::from(rim && shows == 0);
                found.inside += usize::from(around);
                found.wrong += usize::from(around && shows == 1);
            }
        }
        found
    }

    fn square<const D: usize>(half: i64) -> impl Fn([i64; D]) -> bool {
        move |site| site.iter().all(|x| x.abs() <= half)
    }

    /// Flat surfaces and corners: nothing is missed, and of the inside less than a thousandth is taken for surface, at a jitter of a
    /// tenth of a spacing. The density alone, the coarsest test, may miss one rim particle in two hundred at a tenth: a neighbour
    /// pushed close makes up for half of one that is missing.
    #[test]
    fn a_square_patch_shows_its_rim_and_nothing_else() {
        for test in ALL {
            for jitter in [0.0, 0.05, 0.1] {
                let found = confusion((WendlandC2, 1.3), test, 20, square::<2>(20), jitter, 4);
                let allowed = if test == SurfaceTest::Density && jitter == 0.1 { found.rim / 200 } else { 0 };
                assert!(found.missed <= allowed, "{test:?} at {jitter}: {found:?}");
                assert!((found.wrong as f64) < 1e-3 * found.inside as f64, "{test:?} at {jitter}: {found:?}");
            }
            let cubic = confusion((CubicSpline, 1.2), test, 20, square::<2>(20), 0.1, 4);
            let allowed = if test == SurfaceTest::Density { cubic.rim / 200 } else { 0 };
            assert!(cubic.missed <= allowed && (cubic.wrong as f64) < 1e-3 * cubic.inside as f64, "{test:?}, cubic spline: {cubic:?}");
        }
    }

    #[test]
    fn a_cube_shows_its_rim_and_nothing_else() {
        for test in ALL {
            for jitter in [0.0, 0.1] {
                let found = confusion((WendlandC2, 1.3), test, 6, square::<3>(6), jitter, 1);
                assert_eq!(found.missed, 0, "{test:?} at {jitter}: {found:?}");
                assert!((found.wrong as f64) < 1e-3 * found.inside as f64, "{test:?} at {jitter}: {found:?}");
            }
        }
    }

    /// Sheets of one, two and three particles are all rim, but for the middle of three; the density test as above.
    #[test]
    fn thin_sheets_are_all_surface() {
        for test in ALL {
            for rows in 1..=3i64 {
                let sheet = |[x, y]: [i64; 2]| x.abs() <= 20 && (0..rows).contains(&y);
                let found = confusion((WendlandC2, 1.3), test, 20, sheet, 0.1, 4);
                let allowed = if test == SurfaceTest::Density { found.rim / 200 } else { 0 };
                assert!(found.missed <= allowed, "{test:?}, {rows} rows: {found:?}");
            }
        }
    }

    /// All shapes at all jitters: rim missed, inner taken for rim, in percent.
    #[test]
    fn the_table_of_the_docs_is_what_the_tests_find() {
        let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/theory/surface.md")).unwrap();
        let disc = |radius: f64| move |[x, y]: [i64; 2]| (x * x + y * y) as f64 <= radius * radius;
        let void = |radius: f64| move |[x, y]: [i64; 2]| x.abs() <= 20 && y.abs() <= 20 && (x * x + y * y) as f64 > radius * radius;
        let drops = |[x, y]: [i64; 2]| (x.abs() - 9) * (x.abs() - 9) + y * y <= 81;
        let sheet = |rows: i64| move |[x, y]: [i64; 2]| x.abs() <= 20 && (0..rows).contains(&y);
        type Shape = Box<dyn Fn([i64; 2]) -> bool>;
        let shapes: Vec<(&str, Shape)> = vec![
            ("square", Box::new(square::<2>(20))),
            ("disc, R = 15", Box::new(disc(15.0))),
            ("sheet of 1", Box::new(sheet(1))),
            ("sheet of 2", Box::new(sheet(2))),
            ("sheet of 3", Box::new(sheet(3))),
            ("void, R = 1", Box::new(void(1.0))),
            ("void, R = 2", Box::new(void(2.0))),
            ("void, R = 3", Box::new(void(3.0))),
            ("two drops", Box::new(drops)),
        ];
        let mut missing = Vec::new();
        for (name, shape) in &shapes {
            for test in ALL {
                let rows = [0.0, 0.05, 0.1, 0.2].map(|jitter| {
                    let c = confusion((WendlandC2, 1.3), test, 21, shape, jitter, 5);
                    format!("{:.1} / {:.2}", 100.0 * c.missed as f64 / c.rim as f64, 100.0 * c.wrong as f64 / c.inside.max(1) as f64)
                });
                let line = format!("| {name} | `{}` | {} |", format!("{test:?}").to_lowercase(), rows.join(" | "));
                if !page.contains(&line) {
                    missing.push(line);
                }
            }
        }
        assert!(missing.is_empty(), "not in docs/src/theory/surface.md:\n{}", missing.join("\n"));
    }

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
