//! Walls of particles that carry the pressure of the fluid in front of them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{first_line_parents, wall_normals};
use crate::kernel::Kernel;
use crate::lanes::{Lanes, Rows, sweep_lanes};
use crate::math::Vector;
use crate::neighbors::{Group, Neighbors, Term};
use crate::particles::{Kind, Particles};
use crate::physics::correction::solve;
use crate::physics::pairs::{Pairs, Reach, Seen, add_scaled, dot, splat, totals};
use crate::physics::state::EquationOfState;
use crate::sweep::sweep;

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

/// Pressures and velocities of the wall particles that have fluid in reach.
#[derive(Clone, Debug)]
pub struct DummyWalls<const D: usize> {
    model: WallPressure,
    slip: WallSlip,
    suction: WallSuction,
    /// Whether a row is a wall with fluid in reach.
    sees_fluid: Vec<bool>,
    /// The rows of those that are.
    wet: Vec<u32>,
    /// Pressure of each of them, Pa.
    pressure: Vec<f64>,
    /// Velocity of each of them in the viscous force, m/s.
    velocity: Vec<Vector<D>>,
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
        Self {
            model,
            slip,
            suction,
            sees_fluid: Vec::new(),
            wet: Vec::new(),
            pressure: Vec::new(),
            velocity: Vec::new(),
            nodes: Nodes::default(),
        }
    }

    /// Whether walls rub.
    pub fn slip(&self) -> WallSlip {
        self.slip
    }

    /// Finds wall particles with fluid in reach, and the fluid near mirror points, for pairs found anew with the support `support`, in
    /// smoothing lengths.
    pub fn search<K: Kernel<D>>(&mut self, kernel: K, near: &Neighbors<D>, p: &Particles<D>, spacing: f64, support: f64) {
        self.sees_fluid.resize(p.owned(), false);
        sweep(&mut self.sees_fluid, |a| p.kind[a] == Kind::Wall && near.of(a).iter().any(|&b| p.is_fluid(b as usize)));
        self.wet.clear();
        self.wet.extend(self.sees_fluid.iter().enumerate().filter(|(_, sees)| **sees).map(|(a, _)| a as u32));
        if self.model == WallPressure::GhostNodes {
            self.nodes.mirror(kernel, near, p, spacing);
            self.nodes.search(near, p, support);
        }
    }

    /// Finds the pressure of every wet wall particle from that of the fluid in the records.
    ///
    /// Adami: `p_w = Σ_f [p_f + ρ0 (g − a_w)·(x_w − x_f)] W_wf / Σ_f W_wf`.
    pub(crate) fn extrapolate<K: Kernel<D>>(&mut self, pairs: Pairs<'_, K, D>, p: &Particles<D>, liquid: Liquid<D>) {
        let least = match self.suction {
            WallSuction::None => 0.0,
            WallSuction::Full => f64::NEG_INFINITY,
        };
        let (wet, nodes) = (&self.wet, &self.nodes);
        self.pressure.resize(wet.len(), 0.0);
        let weight = |a: usize| liquid.state.rest * (liquid.gravity - p.acceleration[a]);
        match self.model {
            WallPressure::Adami => sweep_lanes(pairs.set, &mut self.pressure, &MeanInFront { pairs, wet, p, liquid, least }),
            WallPressure::GhostNodes => sweep(&mut self.pressure, |i| {
                let a = wet[i] as usize;
                nodes.extrapolate(pairs, p, a, weight(a), liquid.state.rest).max(least)
            }),
        }
    }

    /// Finds the velocity of every wet wall particle in the viscous force: `2 v_w − Σ_f v_f W_wf/Σ_f W_wf`, where walls rub.
    pub(crate) fn mirror_velocity<K: Kernel<D>>(&mut self, pairs: Pairs<'_, K, D>, p: &Particles<D>) {
        self.velocity.resize(self.wet.len(), Vector::ZERO);
        sweep_lanes(pairs.set, &mut self.velocity, &MirroredVelocity { pairs, wet: &self.wet, p });
    }

    /// Wall rows with fluid in reach.
    pub(crate) fn wet(&self) -> &[u32] {
        &self.wet
    }

    /// Row and pressure of every wet wall particle, Pa.
    pub(crate) fn pressures(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.wet.iter().zip(&self.pressure).map(|(&a, &pressure)| (a as usize, pressure))
    }

    /// Row and viscous velocity of every wet wall particle, m/s.
    pub(crate) fn velocities(&self) -> impl Iterator<Item = (usize, Vector<D>)> + '_ {
        self.wet.iter().zip(&self.velocity).map(|(&a, &velocity)| (a as usize, velocity))
    }
}

/// Mean pressure of the fluid near wall particles, each with the weight of the liquid in between.
struct MeanInFront<'a, K, const D: usize> {
    pairs: Pairs<'a, K, D>,
    wet: &'a [u32],
    p: &'a Particles<D>,
    liquid: Liquid<D>,
    /// Least pressure, Pa.
    least: f64,
}

impl<K: Kernel<D>, const D: usize> Rows<f64> for MeanInFront<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, i: usize, pressure: &mut f64, _: &mut ()) {
        let a = self.wet[i] as usize;
        let weight = self.liquid.state.rest * (self.liquid.gravity - self.p.acceleration[a]);
        let term = WeightedPressure { reach: self.pairs.reach::<L>(self.p.h[a]), weight: splat(weight) };
        let [sum, total] = self.pairs.near.sum(a, self.pairs.records, &term);
        let (sum, total) = (sum.total(), total.total());
        *pressure = if total > 0.0 { sum / total } else { 0.0 }.max(self.least);
    }
}

/// `W (p + weight·x_ab)` and `W` over fluid.
struct WeightedPressure<'a, K, L, const D: usize> {
    reach: Reach<'a, K, L>,
    weight: [L; D],
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for WeightedPressure<'_, K, L, D> {
    type Totals = [L; 2];

    #[inline(always)]
    fn nothing(&self) -> [L; 2] {
        [L::splat(0.0); 2]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [L; 2]) {
        let b = Seen::<L, D>::of(&group.fields);
        let w = L::choose(b.wall, L::splat(0.0), self.reach.w(group));
        totals[0] = w.times_plus(b.value + dot(&self.weight, &group.x_ab), totals[0]);
        totals[1] = totals[1] + w;
    }
}

/// Velocities of wall particles in the viscous force.
struct MirroredVelocity<'a, K, const D: usize> {
    pairs: Pairs<'a, K, D>,
    wet: &'a [u32],
    p: &'a Particles<D>,
}

impl<K: Kernel<D>, const D: usize> Rows<Vector<D>> for MirroredVelocity<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, i: usize, velocity: &mut Vector<D>, _: &mut ()) {
        let a = self.wet[i] as usize;
        let term = WeightedVelocity { reach: self.pairs.reach::<L>(self.p.h[a]) };
        let (sum, total) = self.pairs.near.sum(a, self.pairs.records, &term);
        let (sum, total) = (totals(sum), total.total());
        *velocity = if total > 0.0 { 2.0 * self.p.v[a] - sum / total } else { self.p.v[a] };
    }
}

/// `W v` and `W` over fluid.
struct WeightedVelocity<'a, K, L> {
    reach: Reach<'a, K, L>,
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for WeightedVelocity<'_, K, L> {
    type Totals = ([L; D], L);

    #[inline(always)]
    fn nothing(&self) -> Self::Totals {
        ([L::splat(0.0); D], L::splat(0.0))
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut Self::Totals) {
        let b = Seen::<L, D>::of(&group.fields);
        let w = L::choose(b.wall, L::splat(0.0), self.reach.w(group));
        add_scaled(&mut totals.0, w, &b.v);
        totals.1 = totals.1 + w;
    }
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
    fn extrapolate<K: Kernel<D>>(&self, pairs: Pairs<'_, K, D>, p: &Particles<D>, a: usize, weight: Vector<D>, rest: f64) -> f64 {
        let (x_a, h) = (pairs.records[a].x::<D>(), p.h[a]);
        let node = x_a + self.offset[a];
        // Room for one constant and up to three slopes; unused rows are those of the unit matrix.
        let mut matrix = [[0.0; 4]; 4];
        let mut right = [0.0; 4];
        let (mut sum, mut total) = (0.0, 0.0);
        for &b in &self.near[a] {
            let b = b as usize;
            let (x_b, pressure) = (pairs.records[b].x::<D>(), pairs.records[b].value::<D>());
            let away = x_b - node;
            let w = pairs.kernel.w(away.norm(), 0.5 * (h + p.h[b])) * p.mass[b] / rest;
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
                *entry += w * first * pressure;
            }
            sum += w * (pressure + weight.dot(x_a - x_b));
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
                let y = (x_a - node) / h;
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
    use crate::lanes::InstructionSet;
    use crate::neighbors::{NOBODY, Search};
    use crate::particles::Particle;
    use crate::physics::pairs::record;
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

    /// Pressures and viscous velocities of the walls of `p`.
    fn found(p: &Particles<2>, model: WallPressure, suction: WallSuction, gravity: Vector<2>) -> DummyWalls<2> {
        let mut near = Neighbors::new();
        near.build(p, 2.0, Search::Grid).unwrap();
        let mut walls = DummyWalls::new(model, WallSlip::NoSlip, suction);
        walls.search(WendlandC2, &near, p, 0.1, 2.0);
        let state = EquationOfState { law: PressureLaw::Linear, sound: 100.0, rest: 1000.0 };
        let of = |a: usize| record(p.x[a], p.v[a], p.pressure[a], p.mass[a], !p.is_fluid(a));
        let records: Vec<_> = (0..p.len()).map(of).chain([NOBODY]).collect();
        let pairs = Pairs { set: InstructionSet::of_this_machine(), kernel: WendlandC2, near: &near, records: &records, lengths: None };
        walls.extrapolate(pairs, p, Liquid { state, gravity });
        walls.mirror_velocity(pairs, p);
        walls
    }

    fn worst(model: WallPressure, slope: Vector<2>, gravity: Vector<2>) -> f64 {
        let mut p = pool(slope, 1000.0);
        for (a, pressure) in found(&p, model, WallSuction::Full, gravity).pressures() {
            p.pressure[a] = pressure;
        }
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
        for (a, pressure) in found(&p, WallPressure::Adami, WallSuction::None, gravity).pressures() {
            p.pressure[a] = pressure;
        }
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
        let walls = found(&p, WallPressure::Adami, WallSuction::None, Vector::ZERO);
        let floor = (0..p.len()).find(|&a| (p.x[a] - Vector([0.55, -0.05])).norm() < 1e-9).unwrap();
        let (_, velocity) = walls.velocities().find(|(a, _)| *a == floor).unwrap();
        // 2 · 0.5 − 2; 1e-14: round-off of the mean.
        assert!((velocity - Vector([-1.0, 0.0])).norm() < 1e-14);
    }
}
