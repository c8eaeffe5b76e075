//! A twin of the library, written from the printed equations: loops over all pairs, its own kernel, its own elimination. It
//! shares no code with the library, so a misreading on either side shows as a difference.
//!
//! Numbers in parentheses are the equations of Afanasiev, Makarchuk & Popov, NNFM 101 (2008) 206.
#![allow(dead_code)]

pub mod isph;
pub mod wcsph;

use std::f64::consts::PI;

use greenwater::domain::Domain;
use greenwater::math::Vector;
use greenwater::particles::{Kind, Particle, Particles};
use greenwater::scheme::{Medium, Scheme};
use greenwater::simulation::Simulation;

/// Numbers that look random and are the same on every machine (splitmix64, Steele et al. 2014).
pub struct Random(pub u64);

impl Random {
    /// Even in `[-1, 1)`.
    pub fn around_zero(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Even within the share `spread` of `value`.
    pub fn near(&mut self, value: f64, spread: f64) -> f64 {
        value * (1.0 + spread * self.around_zero())
    }
}

/// A particle of the twin; SI units.
#[derive(Clone, Debug)]
pub struct Body<const D: usize> {
    /// 0 for fluid, the line for walls.
    pub layer: u8,
    pub x: [f64; D],
    pub v: [f64; D],
    pub mass: f64,
    pub density: f64,
    pub pressure: f64,
    pub h: f64,
}

impl<const D: usize> Body<D> {
    pub fn fluid(&self) -> bool {
        self.layer == 0
    }
}

/// All particles, and the periodic box they may live in: `(lower corner, edge)` along the axes that repeat.
#[derive(Clone, Debug)]
pub struct Flow<const D: usize> {
    pub bodies: Vec<Body<D>>,
    pub period: [Option<f64>; D],
}

/// Spacing of all made-up flows, m.
pub const SPACING: f64 = 0.05;

impl<const D: usize> Flow<D> {
    /// A disordered block of fluid, `cells` spacings wide, in a vessel of three lines without lid (`walls`) or alone. Every
    /// particle has its own mass, density, pressure, velocity and smoothing length. `rest` is the density they scatter about.
    pub fn disordered(seed: u64, cells: [i64; D], walls: bool, rest: f64) -> Self {
        let mut random = Random(seed);
        let mut bodies = Vec::new();
        let volume = (0..D).fold(1.0, |product, _| product * SPACING);
        let layers = if walls { 3 } else { 0 };
        let span = cells.map(|n| n + 2 * layers);
        for index in 0..span.iter().product() {
            let mut left: i64 = index;
            let cell: [i64; D] = std::array::from_fn(|d| {
                let own = left % span[d];
                left /= span[d];
                own - layers
            });
            let line = (0..D).map(|d| (-cell[d]).max(cell[d] + 1 - cells[d])).max().unwrap_or(0).max(0);
            if cell[D - 1] >= cells[D - 1] {
                continue;
            }
            let jitter = if line == 0 { 0.2 } else { 0.03 };
            let x = std::array::from_fn(|d| (cell[d] as f64 + 0.5 + jitter * random.around_zero()) * SPACING);
            let speed = if line == 0 { 0.5 } else { 0.0 };
            bodies.push(Body {
                layer: line as u8,
                x,
                v: std::array::from_fn(|_| speed * random.around_zero()),
                mass: random.near(rest * volume, 0.1),
                density: random.near(rest, 0.02),
                pressure: random.near(2000.0, 0.5),
                h: random.near(1.2 * SPACING, 0.1),
            });
        }
        Self { bodies, period: [None; D] }
    }

    /// A disordered block, periodic along all axes but the last, on a regular floor of three lines whose face is at height 0.
    pub fn on_a_floor(seed: u64, cells: [i64; D], rest: f64) -> Self {
        let mut flow = Self::periodic(seed, cells, rest);
        flow.period[D - 1] = None;
        let columns: i64 = cells[..D - 1].iter().product();
        for index in 0..3 * columns {
            let mut left = index;
            let x = std::array::from_fn(|d| {
                let cell = left % cells[d];
                left /= cells[d];
                if d == D - 1 { -(index / columns) as f64 - 0.5 } else { cell as f64 + 0.5 }
            });
            let mass = (0..D).fold(rest, |product, _| product * SPACING);
            flow.bodies.push(Body {
                layer: (index / columns) as u8 + 1,
                x: x.map(|x: f64| x * SPACING),
                v: [0.0; D],
                mass,
                density: rest,
                pressure: 0.0,
                h: 1.2 * SPACING,
            });
        }
        flow
    }

    /// The same block repeated without end along every axis.
    pub fn periodic(seed: u64, cells: [i64; D], rest: f64) -> Self {
        Self { period: cells.map(|n| Some(n as f64 * SPACING)), ..Self::disordered(seed, cells, false, rest) }
    }

    /// `x_i - x_j` to the nearest image, and its length.
    pub fn apart(&self, i: usize, j: usize) -> ([f64; D], f64) {
        let x = std::array::from_fn(|d| {
            let x = self.bodies[i].x[d] - self.bodies[j].x[d];
            self.period[d].map_or(x, |edge| x - edge * (x / edge).round())
        });
        (x, dot(x, x).sqrt())
    }

    /// Half the sum of both smoothing lengths.
    pub fn h(&self, i: usize, j: usize) -> f64 {
        (self.bodies[i].h + self.bodies[j].h) / 2.0
    }

    /// Gradient of `W(r_ij, h_ij)` with respect to `x_i`.
    pub fn grad(&self, i: usize, j: usize) -> [f64; D] {
        let (x, r) = self.apart(i, j);
        if i == j || r == 0.0 { [0.0; D] } else { x.map(|x| kernel_slope::<D>(r, self.h(i, j)) * x / r) }
    }

    /// `v_i - v_j`.
    pub fn v(&self, i: usize, j: usize) -> [f64; D] {
        std::array::from_fn(|d| self.bodies[i].v[d] - self.bodies[j].v[d])
    }

    /// Density by summation (11), the particle itself included.
    pub fn summation(&self, i: usize) -> f64 {
        let terms = (0..self.bodies.len()).map(|j| self.bodies[j].mass * kernel::<D>(self.apart(i, j).1, self.h(i, j)));
        terms.sum()
    }

    /// The particles for the library; the row is the id.
    pub fn particles(&self) -> Particles<D> {
        let mut particles = Particles::new();
        for (id, b) in self.bodies.iter().enumerate() {
            let kind = if b.fluid() { Kind::Fluid } else { Kind::Wall };
            let (x, v) = (Vector(b.x), Vector(b.v));
            let Body { layer, mass, density, pressure, h, .. } = *b;
            particles.push(id as u32, Particle { kind, layer, x, v, mass, density, pressure, h });
        }
        particles
    }

    /// The box for the library: its own period, or wide bounds.
    pub fn domain(&self) -> Domain<D> {
        let min = self.period.map(|edge| if edge.is_some() { 0.0 } else { -1.0 });
        let max = self.period.map(|edge| edge.unwrap_or(3.0));
        Domain::new(Vector(min), Vector(max), self.period.map(|edge| edge.is_some()))
    }

    /// A run of the library from this state with a fixed step.
    pub fn simulation(&self, scheme: Box<dyn Scheme<D>>, medium: &Medium<D>, dt: f64) -> Simulation<D> {
        Simulation::new(self.particles(), self.domain(), scheme, medium, Some(dt))
    }
}

/// Water with a viscosity, in gravity that leans, so that no component is zero.
pub fn medium<const D: usize>(viscosity: f64) -> Medium<D> {
    let mut gravity = [0.0; D];
    gravity[D - 1] = -9.81;
    Medium {
        rest_density: 1000.0,
        viscosity,
        gravity: Vector(gravity),
        spacing: SPACING,
        depth: 0.8,
        floor: -0.05,
        courant: 0.25,
        speed: 0.0,
    }
}

pub fn dot<const D: usize>(a: [f64; D], b: [f64; D]) -> f64 {
    (0..D).map(|d| a[d] * b[d]).sum()
}

/// `a + s b`.
pub fn along<const D: usize>(a: [f64; D], s: f64, b: [f64; D]) -> [f64; D] {
    std::array::from_fn(|d| a[d] + s * b[d])
}

/// Constant before the bracket of (12): it makes the integral one in 2D (the paper's) and in 3D (Monaghan & Lattanzio 1985).
fn kernel_constant<const D: usize>(h: f64) -> f64 {
    if D == 2 { 15.0 / (7.0 * PI * h.powi(2)) } else { 3.0 / (2.0 * PI * h.powi(3)) }
}

/// (12).
pub fn kernel<const D: usize>(r: f64, h: f64) -> f64 {
    let q = r / h;
    let bracket = if q <= 1.0 {
        2.0 / 3.0 - q.powi(2) + q.powi(3) / 2.0
    } else if q < 2.0 {
        (2.0 - q).powi(3) / 6.0
    } else {
        0.0
    };
    kernel_constant::<D>(h) * bracket
}

/// Derivative of (12) over r.
pub fn kernel_slope<const D: usize>(r: f64, h: f64) -> f64 {
    let q = r / h;
    let bracket = if q <= 1.0 {
        -2.0 * q + 1.5 * q.powi(2)
    } else if q < 2.0 {
        -(2.0 - q).powi(2) / 2.0
    } else {
        0.0
    };
    kernel_constant::<D>(h) / h * bracket
}

/// Root mean square of all components.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Largest difference of two columns, over the rms of the second.
pub fn difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let scale = rms(expected);
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    if worst == 0.0 { 0.0 } else { worst / scale.max(f64::MIN_POSITIVE) }
}

/// Fails unless the columns agree to `1e-9` of their rms. Both sides sum the same hundred terms of like size in another
/// order, which costs some 1e-14; a pressure solved at a residual of 1e-13 costs that times the condition of its matrix, here
/// some hundreds. What remains above 1e-9 is another formula.
#[track_caller]
pub fn same(what: &str, found: &[f64], expected: &[f64]) {
    let worst = difference(found, expected);
    let at = (0..found.len()).max_by(|&a, &b| (found[a] - expected[a]).abs().total_cmp(&(found[b] - expected[b]).abs())).unwrap_or(0);
    assert!(
        worst <= 1e-9,
        "{what}: the library and its twin differ by {worst:.1e} of the rms; worst at component {at}: {:.12e} and {:.12e}",
        found[at],
        expected[at]
    );
}

/// The components of vectors, one after another.
pub fn flat<const D: usize>(vectors: &[[f64; D]]) -> Vec<f64> {
    vectors.iter().flatten().copied().collect()
}

/// A column of the library in the order of the ids.
pub fn column<const D: usize, T>(p: &Particles<D>, value: impl Fn(usize) -> T) -> Vec<T> {
    let mut rows: Vec<usize> = (0..p.owned()).collect();
    rows.sort_by_key(|&a| p.id[a]);
    rows.into_iter().map(value).collect()
}

/// All components of a vector column of the library in the order of the ids.
pub fn vectors<const D: usize>(p: &Particles<D>, values: &[Vector<D>]) -> Vec<f64> {
    flat(&column(p, |a| values[a].0))
}
