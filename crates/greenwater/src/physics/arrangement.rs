//! What the arrangement of its neighbours says about a particle: where the surface is, how evenly it is surrounded, how full it is.

use std::cell::RefCell;

use super::lattice::Lattice;
use super::pairs::{Pairs, Reach, Seen, add_scaled, difference, dot, scaled, splat, totals};
use crate::kernel::Kernel;
use crate::lanes::{Lanes, Totals};
use crate::math::{Matrix, Vector, identity, inverse, smallest_eigenvalue, transform};
use crate::neighbors::{Group, Neighbors, PairColumn, Term};

/// Where a particle is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Place {
    /// No surface in reach.
    #[default]
    Inside,
    /// Within reach of a surface particle.
    Near,
    /// On the free surface.
    Surface,
}

/// Sums over the neighbours of a fluid particle, walls included, with `f_ab = −V W'/r`.
#[derive(Clone, Copy, Debug)]
pub struct Arrangement<const D: usize> {
    /// `Σ V W` over that of the lattice.
    pub filling: f64,
    /// `Σ f r²` over that of the lattice: 1 inside, less near a surface.
    pub spread: f64,
    /// `Σ 2f`, 1/m².
    pub links: f64,
    /// `Σ V ∇W = −Σ f x_ab`, 1/m: points inwards at a surface, zero where neighbours are even.
    pub slope: Vector<D>,
    /// The same with close pairs weighing more, for shifting (Monaghan 2000; Lind et al. 2012).
    pub crowding: Vector<D>,
    /// `Σ f x_ab` over walls, 1/m: points away from them.
    pub off_walls: Vector<D>,
    /// Makes the pressure gradient exact for linear fields: the inverse of `Σ f x_ab ⊗ x_ab` over fluid and `Σ f (n·x_ab)² n ⊗ n` over
    /// walls of normal `n`, whose pressure is known along the normal only; blended to the identity where neighbours are too few.
    pub correction: Matrix<D>,
    /// How far it is from being packed although no surface explains it, dimensionless: foam.
    pub deficit: f64,
    /// Share of a deficit that counts, in [0, 1].
    may_be_foam: f64,
    /// Whether a surface is near.
    pub place: Place,
    /// Unit vector inwards from the surface for particles near one, else zero.
    pub inwards: Vector<D>,
    /// Depth under the surface for particles near one, m.
    pub depth: f64,
}

/// `min(max(x, 0), 1)`.
fn ramp(x: f64) -> f64 {
    x.clamp(0.0, 1.0)
}

/// The part of `x_ab` along which the pressure of a wall particle is known: along its normal, `x_ab` itself if it has none.
#[inline(always)]
pub fn known_along<const D: usize>(x_ab: Vector<D>, normal: Vector<D>) -> Vector<D> {
    if normal == Vector::ZERO { x_ab } else { x_ab.dot(normal) * normal }
}

/// `v` without its part along `w`; `v` itself for `w = 0`.
pub fn across<const D: usize>(v: Vector<D>, w: Vector<D>) -> Vector<D> {
    let square = w.norm_squared();
    if square > 0.0 { v - (v.dot(w) / square) * w } else { v }
}

impl<const D: usize> Arrangement<D> {
    /// A particle without neighbours.
    pub fn alone() -> Self {
        Self {
            filling: 1.0,
            spread: 0.0,
            links: 0.0,
            slope: Vector::ZERO,
            crowding: Vector::ZERO,
            off_walls: Vector::ZERO,
            correction: identity(),
            deficit: 0.0,
            may_be_foam: 0.0,
            place: Place::Inside,
            inwards: Vector::ZERO,
            depth: 0.0,
        }
    }

    /// Sums over the neighbours of fluid particle `a`, whether it is on the surface, and how the fluid around it stretches, `(∇v + ∇vᵀ)/2`, 1/s; nobody is
    /// near a surface yet. Records carry velocities of fluid and normals of walls. `h` is the
    /// smoothing length of the particle, m. Appends `f_ab` of each neighbour to `weights`, if any are wanted.
    #[inline(always)]
    pub(crate) fn of<K: Kernel<D>, L: Lanes>(
        pairs: &Pairs<'_, K, D>,
        l: &Lattice,
        (a, h): (usize, f64),
        weights: Option<&mut Vec<f32>>,
    ) -> (Self, Matrix<D>) {
        let own = pairs.records[a];
        let reach = pairs.reach::<L>(h);
        let around = Around {
            kernel: pairs.kernel,
            reach,
            scales: [reach.w_scale(), reach.slope_scale()],
            mass: L::splat(own.mass::<D>()),
            v: splat(own.v()),
            half_over_rest: 0.5 / l.rest_density,
            over_spacing: 1.0 / l.w_spacing,
            lengths: pairs.lengths.is_some(),
            weights: weights.map(RefCell::new),
        };
        let sums = pairs.near.sum(a, pairs.records, &around);
        let mut at = Self::alone();
        at.filling = own.mass::<D>() / l.rest_density * pairs.kernel.w(0.0, h) + sums.filling.total();
        at.spread = sums.spread.total();
        at.links = 2.0 * sums.links.total();
        at.slope = -totals(sums.slope);
        at.crowding = -totals(sums.crowding);
        at.off_walls = totals(sums.off_walls);
        let (mut moment, mut known) = ([Vector::ZERO; D], [Vector::ZERO; D]);
        for i in 0..D {
            for j in i..D {
                moment[i][j] = sums.moment[i][j].total();
                moment[j][i] = moment[i][j];
                known[i][j] = sums.known[i][j].total();
                known[j][i] = known[i][j];
            }
        }
        at.filling /= l.sum_w;
        at.spread /= l.spread;
        let evenness = smallest_eigenvalue(&moment) / (l.spread / D as f64);
        let mut certainty = evenness;
        if at.off_walls != Vector::ZERO {
            for i in 0..D {
                moment[i] += known[i];
            }
            certainty = smallest_eigenvalue(&moment) / (l.spread / D as f64);
        }
        // A flat surface has 0.49, where it meets a wall 0.37, where it meets two 0.28: these must be exact. The ramp keeps what few
        // neighbours say from being magnified more than four times.
        let trust = ramp((certainty - 0.1) / 0.15);
        if let Some(inverse) = inverse(&moment).filter(|_| trust > 0.0) {
            at.correction = std::array::from_fn(|i| trust * inverse[i] + (1.0 - trust) * Vector::unit(i));
        }
        // On a flat surface what is missing of the filling goes with the slope; more missing than that is foam. Neither surfaces
        // (steeper than 0.4/h) nor sheets (uneven) count.
        let steepness = h * at.slope.norm();
        let deficit = 1.0 - l.missing(at.slope.norm()) - at.filling;
        at.may_be_foam = ramp((0.4 - steepness) / 0.12) * ramp((evenness - 0.5) / 0.1);
        at.deficit = deficit.max(0.0) * at.may_be_foam;
        let sparse = at.spread < 0.5 * (l.spread_row[0] + l.spread_row[1]);
        // Walls that stand out of the surface make up for missing neighbours: there the slope along them tells.
        let at_waterline = at.meets_walls() && across(at.slope, at.off_walls).norm() > 0.5 * (l.slope_corner + l.slope_row[1]);
        if sparse || at_waterline {
            at.place = Place::Surface;
        }
        // ∇v = (Σ f v_ab ⊗ x_ab) M⁻¹ with the inverse moments.
        let mut change = [Vector::ZERO; D];
        for i in 0..D {
            change[i] = transform(&at.correction, totals(sums.change[i]));
        }
        (at, std::array::from_fn(|i| Vector(std::array::from_fn(|j| 0.5 * (change[i][j] + change[j][i])))))
    }

    /// Whether walls stand beside the surface of this particle, not under or over it.
    fn meets_walls(&self) -> bool {
        self.off_walls != Vector::ZERO && self.slope.dot(self.off_walls).abs() < 0.9 * self.slope.norm() * self.off_walls.norm()
    }

    /// Says whether fluid particle `a` is near the surface, how deep under it and in what direction, from the places of the
    /// particles around it.
    pub fn look_for_surface<T: Copy + Into<f64>>(
        &mut self,
        l: &Lattice,
        (near, x): (&Neighbors<D>, &[Vector<D>]),
        f: &PairColumn<T>,
        places: &[Place],
        a: usize,
    ) {
        if self.place == Place::Surface {
            return;
        }
        let (mut inwards, mut weight) = (Vector::ZERO, 0.0);
        near.for_each_at(x, a, f, |b, x_ab, f| {
            if places[b] == Place::Surface {
                inwards += f * x_ab;
                weight += f;
            }
        });
        if weight == 0.0 && self.spread >= 0.5 * (1.0 + l.spread_row[1]) {
            return;
        }
        self.place = Place::Near;
        if weight > 0.0 {
            // Beside a wall surface particles are seen on one side only.
            let inwards = across(inwards, self.off_walls_beside(inwards));
            let length = inwards.norm();
            if length > 0.0 {
                self.inwards = inwards / length;
                self.depth = (length / weight + 0.5 * l.spacing).clamp(0.5 * l.spacing, 2.5 * l.spacing);
                // Only the slope towards the surface is the surface's doing. At the waterline less slope goes with what is missing
                // than in the rows of a flat surface; there the ratio of row 0, the largest, keeps still water from being moved.
                let slope = self.slope.dot(self.inwards).max(0.0);
                let at_walls = slope * l.missing(l.slope_row[0]) / l.slope_row[0];
                let explained = if self.off_walls == Vector::ZERO { l.missing(slope) } else { at_walls };
                self.deficit = (1.0 - explained - self.filling).max(0.0) * self.may_be_foam;
            }
        }
    }

    /// [`off_walls`](Self::off_walls) if these walls stand beside a surface of normal `n`; zero if they lie under it.
    fn off_walls_beside(&self, n: Vector<D>) -> Vector<D> {
        let beside = n.dot(self.off_walls).abs() < 0.7 * n.norm() * self.off_walls.norm();
        if beside { self.off_walls } else { Vector::ZERO }
    }

    /// `s`, 1/m²: how strongly the free surface, where the pressure is zero, pulls at the pressure of this particle. Exact for a
    /// linear pressure under a flat surface half a spacing above row 0: `s = 2 (Σ V∇W)·n/depth`.
    pub fn surface_pull(&self, l: &Lattice) -> f64 {
        // Missing neighbours as partners of opposite pressure (Nair & Tomar 2014): for drops and sheets, without slope.
        let missing = |least: f64| 2.0 * ramp((0.95 - self.spread) / 0.2) * (l.diagonal - self.links).max(least * l.diagonal);
        match self.place {
            Place::Inside => 0.0,
            Place::Near if self.inwards == Vector::ZERO => missing(0.0),
            // Signed: the noise of packing averages out, as far as it is no more than what row 1 of a lattice has.
            Place::Near => {
                let pull = 2.0 * self.slope.dot(self.inwards).max(-l.slope_row[1]) / self.depth;
                if self.spread < 0.95 { pull.max(missing(0.0)) } else { pull }
            }
            Place::Surface => {
                let (slope, depth) = if self.meets_walls() {
                    (across(self.slope, self.off_walls).norm(), 0.5)
                } else {
                    let slope = self.slope.norm();
                    (slope, (1.5 - (slope - l.slope_row[1]) / (l.slope_row[0] - l.slope_row[1])).clamp(0.5, 1.5))
                };
                let pull = 2.0 * slope / (depth * l.spacing);
                // A tenth: a tight clump has more links than the lattice, and still is in the air.
                if slope > 0.5 * l.slope_row[0] { pull } else { pull.max(missing(0.1)) }
            }
        }
    }

    /// The density error to correct, dimensionless: expansion counts only where no surface explains it.
    pub fn density_error(&self) -> f64 {
        match self.place {
            Place::Inside => self.filling - 1.0,
            Place::Near | Place::Surface if self.deficit > 0.0 => -self.deficit,
            Place::Near | Place::Surface => (self.filling - 1.0).max(0.0),
        }
    }

    /// The divergence the projections may remove, 1/s: foam may collapse within a step without being resisted.
    pub fn resisted(&self, divergence: f64, dt: f64) -> f64 {
        if self.place == Place::Inside || divergence >= 0.0 { divergence } else { (divergence + 0.5 * self.deficit / dt).min(0.0) }
    }
}

/// The sums an [`Arrangement`] is made of.
struct Around<'a, K, L, const D: usize> {
    kernel: K,
    reach: Reach<'a, K, L>,
    /// Of `W` and of `W'/r`.
    scales: [f64; 2],
    /// Mass of the particle, kg (kg/m in 2D).
    mass: L,
    /// Its velocity, m/s.
    v: [L; D],
    /// `1/(2 ρ0)`, m³/kg.
    half_over_rest: f64,
    /// `1/W(Δ)`, mᴰ.
    over_spacing: f64,
    /// Whether smoothing lengths differ.
    lengths: bool,
    /// Where `f` goes.
    weights: Option<RefCell<&'a mut Vec<f32>>>,
}

/// Lanes of [`Around`].
#[derive(Clone, Copy)]
struct Sums<L, const D: usize> {
    filling: L,
    spread: L,
    links: L,
    slope: [L; D],
    crowding: [L; D],
    off_walls: [L; D],
    /// `Σ f v_ab ⊗ x_ab` over fluid.
    change: [[L; D]; D],
    moment: [[L; D]; D],
    known: [[L; D]; D],
}

impl<L: Lanes, const D: usize> Totals for Sums<L, D> {
    #[inline(always)]
    fn joined(self, high: Self) -> Self {
        Self {
            filling: self.filling.joined(high.filling),
            spread: self.spread.joined(high.spread),
            links: self.links.joined(high.links),
            slope: self.slope.joined(high.slope),
            crowding: self.crowding.joined(high.crowding),
            off_walls: self.off_walls.joined(high.off_walls),
            change: self.change.joined(high.change),
            moment: self.moment.joined(high.moment),
            known: self.known.joined(high.known),
        }
    }
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Around<'_, K, L, D> {
    type Totals = Sums<L, D>;

    #[inline(always)]
    fn nothing(&self) -> Sums<L, D> {
        let zero = L::splat(0.0);
        Sums {
            filling: zero,
            spread: zero,
            links: zero,
            slope: [zero; D],
            crowding: [zero; D],
            off_walls: [zero; D],
            change: [[zero; D]; D],
            moment: [[zero; D]; D],
            known: [[zero; D]; D],
        }
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, sums: &mut Sums<L, D>) {
        let b = Seen::<L, D>::of(&group.fields);
        let volume = (self.mass + b.mass) * self.half_over_rest;
        // Of the pair, not of the particle: both have the same bits for it.
        let (w, dw) = if self.lengths {
            let h = self.reach.lengths(group.rows);
            (self.kernel.w(group.r, h), self.kernel.dw_over_r(group.r, h))
        } else {
            (self.reach.w(group) * self.scales[0], self.reach.slope(group) * self.scales[1])
        };
        let f = -(volume * dw);
        if let Some(weights) = &self.weights {
            weights.borrow_mut().extend_from_slice(&f.to_array().map(|f| f as f32)[..L::COUNT]);
        }
        let x = &group.x_ab;
        sums.filling = volume.times_plus(w, sums.filling);
        sums.spread = (f * group.r).times_plus(group.r, sums.spread);
        sums.links = sums.links + f;
        add_scaled(&mut sums.slope, f, x);
        let close = w * self.over_spacing;
        let square = close * close;
        add_scaled(&mut sums.crowding, f * (square * square * 0.2 + 1.0), x);
        // Walls count along their normals; those without one count in full.
        let wall = L::choose(b.wall, f, L::splat(0.0));
        add_scaled(&mut sums.off_walls, wall, x);
        let (v_ab, fluid) = (difference(&self.v, &b.v), f - wall);
        for i in 0..D {
            add_scaled(&mut sums.change[i], fluid * v_ab[i], x);
        }
        let normal_length = dot(&b.v, &b.v);
        let along = scaled(dot(&b.v, x), &b.v);
        for i in 0..D {
            for j in i..D {
                sums.moment[i][j] = (f * x[i]).times_plus(x[j], sums.moment[i][j]);
                let less = along[i] * along[j] - x[i] * x[j];
                let known = L::choose(L::splat(0.0).below(normal_length), less, L::splat(0.0));
                sums.known[i][j] = wall.times_plus(known, sums.known[i][j]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::WendlandC2;
    use crate::lanes::{InstructionSet, Job, Record, dispatch};
    use crate::neighbors::{NOBODY, Search};
    use crate::particles::{Kind, Particle, Particles};
    use crate::physics::pairs::record;

    /// A disordered block of 12 by 12 on a floor of three lines, all of unit spacing; its normals.
    fn block(jitter: f64) -> (Particles<2>, Vec<Vector<2>>) {
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let (mut p, mut normals) = (Particles::new(), Vec::new());
        for i in 0..12 {
            for j in -3..12 {
                let (kind, layer) = if j < 0 { (Kind::Wall, -j as u8) } else { (Kind::Fluid, 0) };
                let noise = if j < 0 { Vector::ZERO } else { 2.0 * jitter * Vector([next(), next()]) };
                let x = Vector([f64::from(i) + 0.5, f64::from(j) + 0.5]) + noise;
                p.push(p.len() as u32, Particle { kind, layer, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h: 1.3 });
                normals.push(if j < 0 { Vector([0.0, 1.0]) } else { Vector::ZERO });
            }
        }
        (p, normals)
    }

    fn lattice() -> Lattice {
        Lattice::of::<_, 2>(WendlandC2, 1.3, 1.0, 1.0)
    }

    /// That of particle `a`, on this machine.
    fn arrangement(near: &Neighbors<2>, p: &Particles<2>, normals: &[Vector<2>], a: usize) -> Arrangement<2> {
        struct One<'a>(Pairs<'a, WendlandC2, 2>, usize, &'a mut Arrangement<2>);
        impl Job for One<'_> {
            fn run<L: Lanes>(self) {
                *self.2 = Arrangement::of::<_, L>(&self.0, &lattice(), (self.1, 1.3), None).0;
            }
        }
        let set = InstructionSet::of_this_machine();
        let mut records: Vec<Record> = (0..p.len()).map(|a| record(p.x[a], normals[a], 0.0, p.mass[a], !p.is_fluid(a))).collect();
        records.push(NOBODY);
        let mut at = Arrangement::alone();
        dispatch(set, One(Pairs { set, kernel: WendlandC2, near, records: &records, lengths: None }, a, &mut at));
        at
    }

    /// Corrected differences of `p = c·x` are `c` for any arrangement with enough neighbours, although the wall gives the part of
    /// `c` along its normal only. 1e-12: rounding of some twenty terms.
    #[test]
    fn corrected_differences_are_exact_for_linear_pressure() {
        let (p, normals) = block(0.2);
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let slope = Vector([3.0, -2.0]);
        let mut tried = 0;
        for a in (0..p.len()).filter(|&a| p.is_fluid(a) && (2.0..10.0).contains(&p.x[a][0])) {
            let at = arrangement(&near, &p, &normals, a);
            let mut differences = Vector::ZERO;
            near.for_each(a, |pair| {
                let f = -WendlandC2.slope(pair.r);
                let along = known_along(pair.x_ab, normals[pair.b]);
                differences += f * slope.dot(along) * along;
            });
            let found = crate::math::transform(&at.correction, differences);
            assert!((found - slope).norm() < 1e-12, "{found:?} at {:?}", p.x[a]);
            tried += 1;
        }
        assert!(tried > 80, "{tried}");
    }

    impl WendlandC2 {
        fn slope(self, r: f64) -> f64 {
            Kernel::<2>::dw_over_r(self, r, 1.3)
        }
    }

    /// Rows of an even block are where they are: the top one on the surface, two below it near, the rest inside; the depth is
    /// the true one, and the pull that of a linear pressure.
    #[test]
    fn rows_under_a_flat_surface_know_their_depth() {
        let (p, normals) = block(0.0);
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let mut f = PairColumn::<f64>::default();
        near.fill(&mut f, |_, pair| -WendlandC2.slope(pair.r));
        let l = lattice();
        let mut at: Vec<_> =
            (0..p.len()).map(|a| if p.is_fluid(a) { arrangement(&near, &p, &normals, a) } else { Arrangement::alone() }).collect();
        let places: Vec<_> = at.iter().map(|at| at.place).collect();
        for a in (0..p.len()).filter(|&a| p.is_fluid(a)) {
            at[a].look_for_surface(&l, (&near, &p.x), &f, &places, a);
        }
        for a in (0..p.len()).filter(|&a| p.is_fluid(a) && (3.0..9.0).contains(&p.x[a][0])) {
            let row = (11.5 - p.x[a][1]).round() as usize;
            let expected = [Place::Surface, Place::Near, Place::Near].get(row).copied().unwrap_or_default();
            assert_eq!(at[a].place, expected, "row {row}");
            let depth = row as f64 + 0.5;
            // Σ 2f (p_a − p_b) of p = depth is −2 (Σ V∇W)·n: what the pull at this depth has to balance.
            let mut sum = 0.0;
            near.for_each(a, |pair| sum += 2.0 * WendlandC2.slope(pair.r) * pair.x_ab[1]);
            assert!((at[a].surface_pull(&l) * depth - sum.abs()).abs() < 1e-12, "row {row}: {} {sum}", at[a].surface_pull(&l));
            assert!(at[a].deficit < 1e-14, "row {row}");
        }
    }
}
