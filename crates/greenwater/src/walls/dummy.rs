//! Walls of particles that carry the pressure of the fluid in front of them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{first_line_parents, wall_normals};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::math::Vector;
use crate::neighbors::Neighbors;
use crate::particles::{Kind, Particles};
use crate::physics::correction::solve;
use crate::physics::state::EquationOfState;
use crate::sweep::{sweep, sweep2};

/// How a wall particle gets its pressure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallPressure {
    /// Mean over the fluid near the wall particle, each with the weight of the liquid in between (Adami, Hu & Adams 2012).
    Adami,
    /// Linear fit at the point that mirrors the wall particle in the face of the wall, carried on to the wall particle (mDBC:
    /// English et al. 2022).
    GhostNodes,
}

/// How fluid slides along a wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallSlip {
    /// The fluid has the velocity of the wall at its face: wall particles enter the viscous force with `2 v_wall − ṽ`, `ṽ` the
    /// mean velocity of the fluid near them.
    NoSlip,
    /// No friction.
    FreeSlip,
}

/// Whether a wall can pull.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallSuction {
    /// The pressure of a wall particle is never below zero, and no pair of wall and fluid attracts: fluid leaves a wall freely.
    None,
    /// The pressure of a wall particle is what it comes to.
    Full,
}

/// What the pressure in a wall depends on.
#[derive(Clone, Copy, Debug)]
pub struct Liquid<const D: usize> {
    /// Equation of state.
    pub state: EquationOfState,
    /// Gravity, m/s².
    pub gravity: Vector<D>,
}

/// Pressures and velocities of wall particles.
#[derive(Clone, Debug)]
pub struct DummyWalls<const D: usize> {
    model: WallPressure,
    slip: WallSlip,
    suction: WallSuction,
    /// Velocity of each row in the viscous force, m/s: that of the fluid, and `2 v_wall − ṽ` for walls.
    pub velocity: Vec<Vector<D>>,
    pressure: Vec<f64>,
    density: Vec<f64>,
    nodes: Nodes<D>,
}

/// Mirror points of wall particles, and the fluid near them.
#[derive(Clone, Debug, Default)]
struct Nodes<const D: usize> {
    /// Wall positions that the offsets were made for, m.
    made_for: Vec<Vector<D>>,
    /// From each wall particle to its mirror point, m; zero for other rows.
    offset: Vec<Vector<D>>,
    /// Rows near each mirror point.
    near: Vec<Vec<u32>>,
}

impl<const D: usize> DummyWalls<D> {
    /// Walls of one model; nothing is known of their particles yet.
    pub fn new(model: WallPressure, slip: WallSlip, suction: WallSuction) -> Self {
        Self { model, slip, suction, velocity: Vec::new(), pressure: Vec::new(), density: Vec::new(), nodes: Nodes::default() }
    }

    /// Whether walls rub.
    pub fn slip(&self) -> WallSlip {
        self.slip
    }

    /// Finds the fluid near mirror points, for pairs found anew with the support `support`, in smoothing lengths.
    pub fn search<K: Kernel<D>>(&mut self, kernel: K, near: &Neighbors<D>, p: &Particles<D>, spacing: f64, support: f64) {
        if self.model == WallPressure::GhostNodes {
            self.nodes.mirror(kernel, near, p, spacing);
            self.nodes.search(near, p, support);
        }
    }

    /// Gives every wall particle its pressure (Pa), the density that belongs to it (kg/m³), and its velocity in the viscous force.
    ///
    /// Adami: `p_w = Σ_f [p_f + ρ0 (g − a_w)·(x_w − x_f)] W_wf / Σ_f W_wf`. No fluid in reach: 0.
    pub fn extrapolate<K: Kernel<D>>(
        &mut self,
        kernel: K,
        near: &Neighbors<D>,
        p: &mut Particles<D>,
        domain: &Domain<D>,
        liquid: Liquid<D>,
    ) {
        let owned = p.owned();
        self.pressure.resize(owned, 0.0);
        self.density.resize(owned, 0.0);
        let Liquid { state, gravity } = liquid;
        let (nodes, model) = (&self.nodes, self.model);
        let least = match self.suction {
            WallSuction::None => 0.0,
            WallSuction::Full => f64::NEG_INFINITY,
        };
        sweep2(&mut self.pressure, &mut self.density, |a| {
            if p.kind[a] != Kind::Wall {
                return (p.pressure[a], p.density[a]);
            }
            let weight = state.rest * (gravity - p.acceleration[a]);
            let pressure = match model {
                WallPressure::Adami => mean_in_front(kernel, near, p, a, weight),
                WallPressure::GhostNodes => nodes.extrapolate(kernel, near, p, a, weight, state.rest),
            };
            let pressure = pressure.max(least);
            (pressure, state.density(pressure))
        });
        p.pressure[..owned].copy_from_slice(&self.pressure);
        p.density[..owned].copy_from_slice(&self.density);
        domain.refresh_column(&mut p.pressure);
        domain.refresh_column(&mut p.density);
    }

    /// Velocities of the viscous force: `2 v_wall − Σ_f v_f W_wf/Σ_f W_wf` for walls without slip, else those of the particles.
    pub fn mirror_velocity<K: Kernel<D>>(&mut self, kernel: K, near: &Neighbors<D>, p: &Particles<D>, domain: &Domain<D>) {
        self.velocity.resize(p.len(), Vector::ZERO);
        sweep(&mut self.velocity[..p.owned()], |a| {
            if p.kind[a] != Kind::Wall {
                return p.v[a];
            }
            let (mut sum, mut weight) = (Vector::ZERO, 0.0);
            near.for_each(a, |pair| {
                if p.is_fluid(pair.b) {
                    let w = kernel.w(pair.r, pair.h);
                    sum += w * p.v[pair.b];
                    weight += w;
                }
            });
            if weight > 0.0 { 2.0 * p.v[a] - sum / weight } else { p.v[a] }
        });
        domain.refresh_column(&mut self.velocity);
    }
}

/// Mean pressure of the fluid near wall particle `a`, Pa, each with the weight of the liquid in between; `weight` is `ρ0 (g − a_w)`,
/// N/m³.
fn mean_in_front<K: Kernel<D>, const D: usize>(kernel: K, near: &Neighbors<D>, p: &Particles<D>, a: usize, weight: Vector<D>) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    near.for_each(a, |pair| {
        let b = pair.b;
        if p.is_fluid(b) {
            let w = kernel.w(pair.r, pair.h);
            sum += w * (p.pressure[b] + weight.dot(pair.x_ab));
            total += w;
        }
    });
    if total > 0.0 { sum / total } else { 0.0 }
}

/// Pivot of the fit below which it is not trusted, over its largest entry: the entries are `ΣVW`, up to 1, and moments in units
/// of the smoothing length; a row of particles in a line leaves some hundredths of the smallest moment of a full neighbourhood, 0.2.
const LEAST_PIVOT: f64 = 1e-2;

impl<const D: usize> Nodes<D> {
    /// Mirrors wall particles in the face of their wall, half a spacing in front of the first line; only if one has moved.
    fn mirror<K: Kernel<D>>(&mut self, kernel: K, near: &Neighbors<D>, p: &Particles<D>, spacing: f64) {
        let owned = p.owned();
        if self.made_for.len() == owned && (0..owned).all(|a| p.kind[a] != Kind::Wall || self.made_for[a] == p.x[a]) {
            return;
        }
        self.made_for.clear();
        self.made_for.extend_from_slice(&p.x[..owned]);
        let normals = wall_normals(kernel, near, p);
        let parents = first_line_parents(near, p);
        self.offset.clear();
        self.offset.extend((0..owned).map(|a| {
            let parent = parents[a] as usize;
            let normal = normals[parent];
            if p.kind[a] != Kind::Wall || normal == Vector::ZERO {
                return Vector::ZERO;
            }
            // Out of the cell of the first-line particle: half a spacing through a face, more through an edge.
            let steepest = normal.0.iter().fold(0.0_f64, |most, n| most.max(n.abs()));
            let face = p.x[parent] + 0.5 * spacing / steepest * normal;
            2.0 * (face - p.x[a])
        }));
    }

    fn search(&mut self, near: &Neighbors<D>, p: &Particles<D>, support: f64) {
        self.near.resize_with(p.owned(), Vec::new);
        for (a, list) in self.near.iter_mut().enumerate() {
            list.clear();
            if p.kind[a] == Kind::Wall {
                near.near_point(p.x[a] + self.offset[a], p.h[a], support, list);
                list.retain(|&b| p.is_fluid(b as usize));
            }
        }
    }

    /// Pressure of wall particle `a`, Pa: the linear fit `Σ_f V W (1, y) (1, y)ᵀ c = Σ_f V W (1, y) p_f` about the mirror point,
    /// `y = (x_f − x_node)/h`, taken at the wall particle; with too few fluid particles the mean with the weight in between.
    fn extrapolate<K: Kernel<D>>(&self, kernel: K, near: &Neighbors<D>, p: &Particles<D>, a: usize, weight: Vector<D>, rest: f64) -> f64 {
        let (node, h) = (p.x[a] + self.offset[a], p.h[a]);
        // Room for one constant and up to three slopes; unused rows are those of the unit matrix.
        let mut matrix = [[0.0; 4]; 4];
        let mut right = [0.0; 4];
        let (mut sum, mut total) = (0.0, 0.0);
        for &b in &self.near[a] {
            let b = b as usize;
            let away = near.x(b) - node;
            let w = kernel.w(away.norm(), 0.5 * (h + p.h[b])) * p.mass[b] / rest;
            let y = away / h;
            let basis: [f64; 4] = std::array::from_fn(|k| {
                if k == 0 {
                    1.0
                } else if k <= D {
                    y[k - 1]
                } else {
                    0.0
                }
            });
            for (row, first) in matrix.iter_mut().zip(basis) {
                for (entry, second) in row.iter_mut().zip(basis) {
                    *entry += w * first * second;
                }
            }
            for (entry, first) in right.iter_mut().zip(basis) {
                *entry += w * first * p.pressure[b];
            }
            sum += w * (p.pressure[b] + weight.dot(p.x[a] - near.x(b)));
            total += w;
        }
        if total == 0.0 {
            return 0.0;
        }
        for (k, row) in matrix.iter_mut().enumerate().skip(D + 1) {
            row[k] = total;
        }
        match solve(matrix, right, LEAST_PIVOT) {
            // A node that half its neighbourhood sees: the fit stands on fluid round it, not on a rim far to one side.
            Some(c) if total > 0.3 => {
                let y = (p.x[a] - node) / h;
                (0..D).fold(c[0], |value, d| value + c[d + 1] * y[d])
            }
            _ => sum / total,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::WendlandC2;
    use crate::neighbors::Search;
    use crate::particles::Particle;
    use crate::physics::state::PressureLaw;

    /// A pool 12 spacings wide and 8 deep in a vessel of three lines, with a pressure of `p0 + slope·x`.
    fn pool(slope: Vector<2>, density: f64) -> Particles<2> {
        let mut p = Particles::new();
        for i in -3..15_i32 {
            for j in -3..8_i32 {
                let line = (-i).max(i - 11).max(-j).max(0);
                let kind = if line == 0 { Kind::Fluid } else { Kind::Wall };
                let x = 0.1 * Vector([f64::from(i) + 0.5, f64::from(j) + 0.5]);
                let pressure = if line == 0 { 5e4 + slope.dot(x) } else { 0.0 };
                p.push(p.len() as u32, Particle { kind, layer: line as u8, x, v: Vector::ZERO, mass: 10.0, density, pressure, h: 0.15 });
            }
        }
        p
    }

    fn worst(model: WallPressure, slope: Vector<2>, gravity: Vector<2>) -> f64 {
        let mut p = pool(slope, 1000.0);
        let domain = Domain::new(Vector::splat(-9.0), Vector::splat(9.0), [false; 2]);
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let mut walls = DummyWalls::new(model, WallSlip::FreeSlip, WallSuction::Full);
        walls.search(WendlandC2, &near, &p, 0.1, 2.0);
        let state = EquationOfState { law: PressureLaw::Linear, sound: 100.0, rest: 1000.0 };
        walls.extrapolate(WendlandC2, &near, &mut p, &domain, Liquid { state, gravity });
        let error = |a: usize| (p.pressure[a] - 5e4 - slope.dot(p.x[a])).abs();
        // Below the surface row; third-line corners of this kernel see no fluid by Adami's sum.
        let seen = |a: &usize| p.x[*a][1] < 0.6 && (0..p.len()).any(|b| p.is_fluid(b) && (p.x[*a] - p.x[b]).norm() < 0.299);
        (0..p.len()).filter(|a| p.kind[*a] == Kind::Wall).filter(seen).map(error).fold(0.0, f64::max)
    }

    /// The weight of the liquid is a linear pressure, and the mean with the weight in between carries it exactly.
    /// 1e-7 Pa of 5e4: round-off of sums of some twenty terms.
    #[test]
    fn the_weight_of_the_liquid_is_carried_into_the_wall_exactly() {
        let gravity = Vector([1.5, -9.81]);
        let error = worst(WallPressure::Adami, 1000.0 * gravity, gravity);
        assert!(error < 1e-7, "{error} Pa");
    }

    /// Ghost nodes carry any linear pressure exactly, whatever gravity is.
    #[test]
    fn ghost_nodes_carry_any_linear_pressure_exactly() {
        let error = worst(WallPressure::GhostNodes, Vector([-3e3, 7e3]), Vector([0.0, -9.81]));
        assert!(error < 1e-7, "{error} Pa");
        let mean = worst(WallPressure::Adami, Vector([-3e3, 7e3]), Vector([0.0, -9.81]));
        assert!(mean > 100.0, "the mean is not meant to: {mean} Pa");
    }

    #[test]
    fn a_wall_that_accelerates_feels_less_weight() {
        let gravity = Vector([0.0, -9.81]);
        let mut p = pool(Vector([0.0, -9810.0]), 1000.0);
        for a in 0..p.len() {
            if p.kind[a] == Kind::Wall {
                p.acceleration[a] = gravity;
            }
        }
        let domain = Domain::new(Vector::splat(-9.0), Vector::splat(9.0), [false; 2]);
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let mut walls = DummyWalls::new(WallPressure::Adami, WallSlip::NoSlip, WallSuction::None);
        let state = EquationOfState { law: PressureLaw::Linear, sound: 100.0, rest: 1000.0 };
        walls.extrapolate(WendlandC2, &near, &mut p, &domain, Liquid { state, gravity });
        // A falling vessel: the wall has the mean pressure of what it sees, which lies above it and has less.
        let floor = (0..p.len()).find(|&a| (p.x[a] - Vector([0.55, -0.05])).norm() < 1e-9).unwrap();
        assert!(p.pressure[floor] < 5e4 - 0.05 * 9810.0, "{}", p.pressure[floor]);
    }

    #[test]
    fn a_wall_without_slip_mirrors_the_velocity() {
        let mut p = pool(Vector::ZERO, 1000.0);
        for a in 0..p.len() {
            p.v[a] = if p.is_fluid(a) { Vector([2.0, 0.0]) } else { Vector([0.5, 0.0]) };
        }
        let domain = Domain::new(Vector::splat(-9.0), Vector::splat(9.0), [false; 2]);
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let mut walls = DummyWalls::new(WallPressure::Adami, WallSlip::NoSlip, WallSuction::None);
        walls.mirror_velocity(WendlandC2, &near, &p, &domain);
        let floor = (0..p.len()).find(|&a| (p.x[a] - Vector([0.55, -0.05])).norm() < 1e-9).unwrap();
        // 2 · 0.5 − 2; 1e-14: round-off of the mean.
        assert!((walls.velocity[floor] - Vector([-1.0, 0.0])).norm() < 1e-14);
    }
}
