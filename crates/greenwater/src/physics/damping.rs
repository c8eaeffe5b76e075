//! Dissipation between approaching particles, of what a velocity linear in space does not explain.

use super::pairs::{Pairs, Reach, Seen, add_scaled, difference, dot, splat, totals};
use crate::kernel::Kernel;
use crate::lanes::{LANES, Lanes, Rows};
use crate::math::{Matrix, Vector};
use crate::neighbors::{Group, Term};

/// `Σ ν V_b d_ab ∇_a W_ab/r²` over fluid, of the approach `d_ab = v_ab·x_ab < 0` of each pair less what the stretching of the
/// flow at both its ends explains: the harmonic mean of `x_ab·S_a·x_ab` and `x_ab·S_b·x_ab` where both are approaches, too, and `d_ab` at the most.
///
/// `ν` is `strength[0] h − strength[1]` of the mean smoothing length of the pair, m²/s, and not below zero; the sum is in m/s².
///
/// A flow that is linear around a pair is not damped; the tremor of particles and the clash of two streams are, as before. Equal and opposite in a
/// pair, along the line between its particles, and never against their parting: momentum is conserved, energy only lost. Source: the artificial viscosity
/// of Monaghan (1992) between velocities that are reconstructed linearly and limited after van Leer, as by Frontiere, Raskin & Owen, J. Comput. Phys. 332
/// (2017) 160.
pub(crate) struct Damping<'a, K, S: ?Sized, const D: usize> {
    /// Records carry velocities.
    pub pairs: Pairs<'a, K, D>,
    /// `S` of each particle; zero for nobody.
    pub stretch: &'a S,
    /// `1/ρ0`, m³/kg.
    pub scale: f64,
    /// m/s and m²/s.
    pub strength: [f64; 2],
    /// Smoothing lengths, m.
    pub h: &'a [f64],
}

/// The symmetric part `S` of `∇v` of every particle, 1/s: on the diagonal and right of it, what else is there is not asked for.
pub(crate) trait Stretches<const D: usize>: Sync {
    /// That of particle `a`.
    fn of(&self, a: usize) -> [[f64; D]; D];

    /// Those of eight particles; must be `#[inline(always)]`.
    fn of_lanes<L: Lanes>(&self, rows: &[u32]) -> [[L; D]; D];
}

impl<const D: usize> Stretches<D> for [Matrix<D>] {
    #[inline(always)]
    fn of(&self, a: usize) -> [[f64; D]; D] {
        self[a].map(|row| row.0)
    }

    #[inline(always)]
    fn of_lanes<L: Lanes>(&self, rows: &[u32]) -> [[L; D]; D] {
        let mut lanes = [[L::splat(0.0); D]; D];
        for i in 0..D {
            for j in i..D {
                let mut entries = [0.0; LANES];
                for lane in 0..L::COUNT {
                    entries[lane] = self[rows[lane] as usize][i][j];
                }
                lanes[i][j] = L::from_array(entries);
            }
        }
        lanes
    }
}

impl<K: Kernel<D>, S: Stretches<D> + ?Sized, const D: usize> Rows<Vector<D>> for Damping<'_, K, S, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, out: &mut Vector<D>, _: &mut ()) {
        let own = self.pairs.records[a];
        *out = Vector::ZERO;
        if !own.is_wall::<D>() {
            let reach = self.pairs.reach::<L>(self.h[a]);
            let term = Approach { reach, strength: self.strength, v: splat(own.v()), own: self.stretch.of(a), stretch: self.stretch };
            *out = self.scale * reach.slope_scale() * totals(self.pairs.near.sum(a, self.pairs.records, &term));
        }
    }
}

/// `ν m_b d_ab x_ab/r²`, times `W'/r` on the scale of the particle.
struct Approach<'a, K, S: ?Sized, L, const D: usize> {
    reach: Reach<'a, K, L>,
    strength: [f64; 2],
    v: [L; D],
    own: [[f64; D]; D],
    stretch: &'a S,
}

impl<K: Kernel<D>, S: Stretches<D> + ?Sized, L: Lanes, const D: usize> Term<L, D> for Approach<'_, K, S, L, D> {
    type Totals = [L; D];

    #[inline(always)]
    fn nothing(&self) -> [L; D] {
        [L::splat(0.0); D]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [L; D]) {
        let b = Seen::<L, D>::of(&group.fields);
        let (nothing, x) = (L::splat(0.0), &group.x_ab);
        let others = self.stretch.of_lanes::<L>(group.rows);
        let (mut here, mut there) = (nothing, nothing);
        for i in 0..D {
            for j in i..D {
                let twice = if i == j { x[i] * x[j] } else { x[i] * x[j] * 2.0 };
                here = twice.times_plus(L::splat(self.own[i][j]), here);
                there = twice.times_plus(others[i][j], there);
            }
        }
        let approach = dot(&difference(&self.v, &b.v), x).at_most(nothing);
        let (here, there) = (here.at_most(nothing), there.at_most(nothing));
        let explained = (here * there * 2.0 / (here + there).at_most(L::splat(-f64::MIN_POSITIVE))).at_least(approach);
        // Between fluid only; nothing comes of particles at one place.
        let square = group.square.at_least(L::splat(f64::MIN_POSITIVE));
        let strength = (self.reach.lengths(group.rows) * self.strength[0] - self.strength[1]).at_least(nothing);
        let mass = L::choose(b.wall, nothing, b.mass * strength);
        add_scaled(totals, mass * self.reach.slope(group) * (approach - explained) / square, x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::WendlandC2;
    use crate::lanes::{InstructionSet, Record, sweep_lanes};
    use crate::neighbors::{NOBODY, Neighbors, Search};
    use crate::particles::{Kind, Particle, Particles};
    use crate::physics::pairs::record;

    /// What is to be damped in a block of 14 by 14 disordered particles of unit spacing that move with `v(x)`, and the positions. `stretch`: what the
    /// particles know of `S`.
    fn damped(v: impl Fn(Vector<2>) -> Vector<2>, stretch: Matrix<2>) -> (Vec<Vector<2>>, Vec<Vector<2>>) {
        let mut p = Particles::new();
        for i in 0..196u32 {
            let noise = |k: u32| (f64::from(i * 7919 + k * 104_729) * 0.618_033_988_75).fract() - 0.5;
            let x = Vector([f64::from(i % 14) + 0.3 * noise(0), f64::from(i / 14) + 0.3 * noise(1)]);
            p.push(i, Particle { kind: Kind::Fluid, layer: 0, x, v: v(x), mass: 1.0, density: 1.0, pressure: 0.0, h: 1.3 });
        }
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        let mut records: Vec<Record> = (0..p.len()).map(|a| record(p.x[a], p.v[a], 0.0, 1.0, false)).collect();
        records.push(NOBODY);
        let set = InstructionSet::of_this_machine();
        let pairs = Pairs { set, kernel: WendlandC2, near: &near, records: &records, lengths: None };
        let mut out = vec![Vector::ZERO; p.len()];
        let stretch = vec![stretch; p.len() + 1];
        sweep_lanes(set, &mut out, &Damping { pairs, stretch: &stretch[..], scale: 1.0, strength: [0.0, -1.0], h: &p.h });
        (out, p.x.clone())
    }

    fn greatest(v: &[Vector<2>]) -> f64 {
        v.iter().map(|v| v.norm()).fold(0.0, f64::max)
    }

    /// 1e-13: rounding of some twenty approaches of strains of one.
    #[test]
    fn a_linear_flow_is_not_damped() {
        // A strain and a turn.
        let flow = |x: Vector<2>| Vector([0.5 * x[0] + 2.0 * x[1], -0.4 * x[0] - 0.7 * x[1]]);
        let known = [Vector([0.5, 0.8]), Vector([0.8, -0.7])];
        assert!(greatest(&damped(flow, known).0) < 1e-13);
        assert!(greatest(&damped(flow, [Vector::ZERO; 2]).0) > 0.1, "not known, it is");
    }

    /// What is damped of a clash pushes the streams apart, conserves momentum, and takes energy.
    #[test]
    fn a_clash_is_damped_and_keeps_momentum() {
        let flow = |x: Vector<2>| Vector([if x[0] < 6.5 { 1.0 } else { -1.0 }, 0.0]);
        // As steep as a kernel sees it.
        let (damping, x) = damped(flow, [Vector([-0.3, 0.0]), Vector::ZERO]);
        let sum = damping.iter().fold(Vector::ZERO, |sum, &d| sum + d);
        assert!(sum.norm() < 1e-12, "{sum:?}");
        let power: f64 = damping.iter().zip(&x).map(|(d, &x)| d.dot(flow(x))).sum();
        assert!(power < -1.0, "{power}");
    }
}
