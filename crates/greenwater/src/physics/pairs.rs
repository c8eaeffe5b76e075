//! What sums over pairs read of a particle: where it is, how it moves, what it carries, how much of it there is, and whether it is a
//! wall; and the arithmetic of vectors whose components are lanes.

use crate::kernel::Kernel;
use crate::lanes::{InstructionSet, LANES, Lanes, Real, Record};
use crate::math::{Vector, power};
use crate::neighbors::{Group, NOBODY, Neighbors};
use crate::particles::Particles;
use crate::sweep::sweep;

/// What sums over pairs are made of.
#[derive(Clone, Copy)]
pub(crate) struct Pairs<'a, K, const D: usize> {
    /// Instructions to use.
    pub set: InstructionSet,
    pub kernel: K,
    pub near: &'a Neighbors<D>,
    /// One for each particle and [nobody](crate::neighbors::NOBODY).
    pub records: &'a [Record],
    /// Smoothing lengths, as many as records, m; none where all are equal.
    pub lengths: Option<&'a [f64]>,
}

impl<'a, K: Copy, const D: usize> Pairs<'a, K, D> {
    /// The kernel for the pairs of a particle of smoothing length `h`, m.
    #[inline(always)]
    pub fn reach<L: Lanes>(&self, h: f64) -> Reach<'a, K, L> {
        Reach::of(self.kernel, h, self.lengths)
    }
}

/// What pairs are looked at through.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sense {
    /// One a particle, and nobody. Room for the search, too, which leaves anything in it.
    pub records: Vec<Record>,
    /// Smoothing lengths, m, where they differ.
    lengths: Vec<f64>,
}

impl Sense {
    /// Takes over positions, masses and smoothing lengths, and what else records show of each particle.
    pub fn fill<const D: usize>(&mut self, p: &Particles<D>, v: impl Fn(usize) -> Vector<D> + Sync, value: impl Fn(usize) -> f64 + Sync) {
        self.records.resize(p.len() + 1, NOBODY);
        sweep(&mut self.records[..p.len()], |a| record(p.x[a], v(a), value(a), p.mass[a], !p.is_fluid(a)));
        self.records[p.len()] = NOBODY;
        take_lengths(p, &mut self.lengths);
    }

    /// For sums with `kernel` over the neighbours `near`, by the best instructions of this machine.
    pub fn pairs<'a, K, const D: usize>(&'a self, kernel: K, near: &'a Neighbors<D>) -> Pairs<'a, K, D> {
        let lengths = (!self.lengths.is_empty()).then_some(self.lengths.as_slice());
        Pairs { set: InstructionSet::of_this_machine(), kernel, near, records: &self.records, lengths }
    }
}

/// Makes `lengths` the smoothing lengths of all particles and of nobody, m; none where all are equal.
pub(crate) fn take_lengths<const D: usize>(p: &Particles<D>, lengths: &mut Vec<f64>) {
    lengths.clear();
    if p.h_min() < p.h_max() {
        lengths.extend_from_slice(&p.h);
        lengths.push(p.h_max());
    }
}

/// The record of a particle at `x` (m) that moves with `v` (m/s), carries `value` (a pressure, a density) and has the mass `mass`, kg
/// (kg/m in 2D).
///
/// In 2D half a record holds all but the velocity: sums that do not ask for that read half as much.
#[inline(always)]
pub(crate) fn record<const D: usize>(x: Vector<D>, v: Vector<D>, value: f64, mass: f64, wall: bool) -> Record {
    let mut fields = [0.0; LANES];
    fields[..D].copy_from_slice(&x.0);
    fields[D] = value;
    // The sign tells walls.
    fields[D + 1] = if wall { -mass } else { mass };
    fields[D + 2..2 * D + 2].copy_from_slice(&v.0);
    Record(fields)
}

/// What records say, lane by lane.
#[derive(Clone, Copy)]
pub(crate) struct Seen<L: Real, const D: usize> {
    /// Velocities, m/s.
    pub v: [L; D],
    /// What they carry.
    pub value: L,
    /// Masses, kg (kg/m in 2D).
    pub mass: L,
    /// Which are walls.
    pub wall: L::Mask,
}

impl<L: Real, const D: usize> Seen<L, D> {
    /// Reads fields that were [gathered](Lanes::gather).
    #[inline(always)]
    pub fn of(fields: &[L; LANES]) -> Self {
        let mut v = [L::splat(0.0); D];
        v.copy_from_slice(&fields[D + 2..2 * D + 2]);
        let signed = fields[D + 1];
        Self { v, value: fields[D], mass: signed.size(), wall: signed.below(L::splat(0.0)) }
    }
}

impl Record {
    /// Position, m.
    #[inline(always)]
    pub fn x<const D: usize>(&self) -> Vector<D> {
        Vector(std::array::from_fn(|d| self.0[d]))
    }

    /// Velocity, m/s.
    #[inline(always)]
    pub fn v<const D: usize>(&self) -> Vector<D> {
        Vector(std::array::from_fn(|d| self.0[D + 2 + d]))
    }

    /// What the particle carries.
    #[inline(always)]
    pub fn value<const D: usize>(&self) -> f64 {
        self.0[D]
    }

    /// Mass, kg (kg/m in 2D).
    #[inline(always)]
    pub fn mass<const D: usize>(&self) -> f64 {
        self.0[D + 1].abs()
    }

    /// Whether it is a wall.
    #[inline(always)]
    pub fn is_wall<const D: usize>(&self) -> bool {
        self.0[D + 1] < 0.0
    }

    /// Gives it the velocity `v`, m/s.
    #[inline(always)]
    pub fn set_v<const D: usize>(&mut self, v: Vector<D>) {
        self.0[D + 2..2 * D + 2].copy_from_slice(&v.0);
    }

    /// Where what the particle carries stands.
    #[inline(always)]
    pub fn value_mut<const D: usize>(&mut self) -> &mut f64 {
        &mut self.0[D]
    }
}

/// `v` in every lane.
#[inline(always)]
pub(crate) fn splat<L: Real, const D: usize>(v: Vector<D>) -> [L; D] {
    let mut lanes = [L::splat(0.0); D];
    for d in 0..D {
        lanes[d] = L::splat(v[d]);
    }
    lanes
}

/// `factor v`, lane by lane.
#[inline(always)]
pub(crate) fn scaled<L: Real, const D: usize>(factor: L, v: &[L; D]) -> [L; D] {
    let mut scaled = *v;
    for d in 0..D {
        scaled[d] = factor * v[d];
    }
    scaled
}

/// `a · b`, lane by lane.
#[inline(always)]
pub(crate) fn dot<L: Real, const D: usize>(a: &[L; D], b: &[L; D]) -> L {
    let mut sum = a[0] * b[0];
    for d in 1..D {
        sum = a[d].times_plus(b[d], sum);
    }
    sum
}

/// `a − b`, lane by lane.
#[inline(always)]
pub(crate) fn difference<L: Real, const D: usize>(a: &[L; D], b: &[L; D]) -> [L; D] {
    let mut difference = *a;
    for d in 0..D {
        difference[d] = difference[d] - b[d];
    }
    difference
}

/// `total += factor v`, lane by lane.
#[inline(always)]
pub(crate) fn add_scaled<L: Real, const D: usize>(total: &mut [L; D], factor: L, v: &[L; D]) {
    for d in 0..D {
        total[d] = factor.times_plus(v[d], total[d]);
    }
}

/// The vector that lanes add up to.
#[inline(always)]
pub(crate) fn totals<L: Lanes, const D: usize>(v: [L; D]) -> Vector<D> {
    let mut totals = Vector::ZERO;
    for d in 0..D {
        totals[d] = v[d].total();
    }
    totals
}

/// The kernel for the pairs of a particle, on a scale of its own: sums over the pairs are multiplied with [`w_scale`](Self::w_scale) or
/// [`slope_scale`](Self::slope_scale) once.
#[derive(Clone, Copy)]
pub(crate) struct Reach<'a, K, L> {
    kernel: K,
    /// The particle's own smoothing length, m.
    length: f64,
    h: L,
    inverse: L,
    /// Those of all particles, m, with one more for nobody; none where all are equal.
    others: Option<&'a [f64]>,
}

impl<'a, K, L: Lanes> Reach<'a, K, L> {
    /// For a particle of smoothing length `length`, m.
    #[inline(always)]
    pub fn of(kernel: K, length: f64, others: Option<&'a [f64]>) -> Self {
        Self { kernel, length, h: L::splat(length), inverse: L::splat(1.0 / length), others }
    }

    /// The mean smoothing length of each pair, m.
    #[inline(always)]
    pub fn lengths(&self, rows: &[u32]) -> L {
        match self.others {
            None => self.h,
            Some(others) => (self.h + L::pick(others, rows)) * 0.5,
        }
    }

    /// `W`, on the scale of the particle.
    #[inline(always)]
    pub fn w<const D: usize>(&self, group: &Group<'_, L, D>) -> L
    where
        K: Kernel<D>,
    {
        match self.others {
            None => self.kernel.shape(group.r * self.inverse),
            Some(_) => {
                let h = self.lengths(group.rows);
                self.kernel.shape(group.r / h) * power(self.h / h, D as u32)
            }
        }
    }

    /// `W'/r`, on the scale of the particle.
    #[inline(always)]
    pub fn slope<const D: usize>(&self, group: &Group<'_, L, D>) -> L
    where
        K: Kernel<D>,
    {
        match self.others {
            None => self.kernel.slope_over_q(group.r * self.inverse),
            Some(_) => {
                let h = self.lengths(group.rows);
                self.kernel.slope_over_q(group.r / h) * power(self.h / h, D as u32 + 2)
            }
        }
    }

    /// `W` over what [`w`](Self::w) says, m⁻ᴰ.
    #[inline(always)]
    pub fn w_scale<const D: usize>(&self) -> f64
    where
        K: Kernel<D>,
    {
        self.kernel.sigma() * power(1.0 / self.length, D as u32)
    }

    /// `W'/r` over what [`slope`](Self::slope) says, m⁻ᴰ⁻².
    #[inline(always)]
    pub fn slope_scale<const D: usize>(&self) -> f64
    where
        K: Kernel<D>,
    {
        self.kernel.sigma() * power(1.0 / self.length, D as u32 + 2)
    }
}
