//! The sums over pairs of the paper's explicit method, eight neighbours at a time.

use crate::kernel::Kernel;
use crate::lanes::{LANES, Lanes, Rows};
use crate::math::Vector;
use crate::neighbors::{Group, Term};
use crate::physics::pairs::{Pairs, Reach, Seen, add_scaled, difference, dot, scaled, splat, totals};
use crate::physics::viscosity::{Approach, Tensor, artificial, stress};

/// (23), (24): `μ T_a/ρ_a²` with the velocity gradient `Σ_b (m_b/ρ_b) (v_b − v_a) ⊗ ∇_a W_ab` over fluid. Records carry densities.
pub(super) struct Stress<'a, K, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    /// `μ`, Pa s.
    pub viscosity: f64,
}

impl<K: Kernel<D>, const D: usize> Rows<Tensor<D>> for Stress<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, out: &mut Tensor<D>, _: &mut ()) {
        let own = self.pairs.records[a];
        *out = [Vector::ZERO; D];
        if own.is_wall::<D>() {
            return;
        }
        let reach = self.pairs.reach::<L>(self.pairs.near.h(a));
        let change = self.pairs.near.sum(a, self.pairs.records, &Change { reach, v: splat(own.v()) });
        let mut gradient = [Vector::ZERO; D];
        for d in 0..D {
            gradient[d] = -reach.slope_scale() * totals(change[d]);
        }
        let (density, stress) = (own.value::<D>(), stress(&gradient));
        for d in 0..D {
            out[d] = self.viscosity / (density * density) * stress[d];
        }
    }
}

/// `Σ (m_b/ρ_b) v_ab ⊗ ∇W` over fluid, on the scale of the particle.
struct Change<'a, K, L, const D: usize> {
    reach: Reach<'a, K, L>,
    v: [L; D],
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Change<'_, K, L, D> {
    type Totals = [[L; D]; D];

    #[inline(always)]
    fn nothing(&self) -> [[L; D]; D] {
        [[L::splat(0.0); D]; D]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [[L; D]; D]) {
        let b = Seen::<L, D>::of(&group.fields);
        // Nobody has no density either.
        let volume = L::choose(b.wall, L::splat(0.0), b.mass / b.value.at_least(L::splat(f64::MIN_POSITIVE)));
        let dw = volume * self.reach.slope(group);
        let v_ab = difference(&self.v, &b.v);
        for i in 0..D {
            add_scaled(&mut totals[i], dw * v_ab[i], &group.x_ab);
        }
    }
}

/// (21) and (22) of fluid among itself: acceleration, gravity included, and rate of density. Records carry densities.
pub(super) struct Forces<'a, K, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    pub gravity: Vector<D>,
    /// `α`, `β`, `η` of (13) and (14).
    pub artificial: [f64; 3],
    /// Of each particle and of nobody: `p/ρ²`, the speed of sound, m/s, and `μ T/ρ²`, if there is viscosity.
    pub pressed: &'a [f64],
    pub sound: &'a [f64],
    pub stress: Option<&'a [Tensor<D>]>,
}

impl<K: Kernel<D>, const D: usize> Rows<Vector<D>, f64> for Forces<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, acceleration: &mut Vector<D>, rate: &mut f64) {
        let own = self.pairs.records[a];
        (*acceleration, *rate) = (Vector::ZERO, 0.0);
        if own.is_wall::<D>() {
            return;
        }
        let reach = self.pairs.reach::<L>(self.pairs.near.h(a));
        let term = Push {
            all: self,
            a,
            reach,
            v: splat(own.v()),
            density: L::splat(own.value::<D>()),
            pressed: L::splat(self.pressed[a]),
            sound: L::splat(self.sound[a]),
        };
        let (push, approach) = self.pairs.near.sum(a, self.pairs.records, &term);
        *acceleration = self.gravity + reach.slope_scale() * totals(push);
        *rate = reach.slope_scale() * approach.total();
    }
}

/// `m_b (T_a/ρ_a² + T_b/ρ_b² − p_a/ρ_a² − p_b/ρ_b² − Π_ab) ∇W` and `m_b v_ab·∇W`, on the scale of the particle.
struct Push<'a, K, L, const D: usize> {
    all: &'a Forces<'a, K, D>,
    a: usize,
    reach: Reach<'a, K, L>,
    v: [L; D],
    density: L,
    pressed: L,
    sound: L,
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Push<'_, K, L, D> {
    type Totals = ([L; D], L);

    #[inline(always)]
    fn nothing(&self) -> ([L; D], L) {
        ([L::splat(0.0); D], L::splat(0.0))
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, (push, rate): &mut ([L; D], L)) {
        let Forces { pressed, sound, stress, artificial: [alpha, beta, eta], .. } = *self.all;
        let b = Seen::<L, D>::of(&group.fields);
        // Walls act by forces of their own.
        let dw = L::choose(b.wall, L::splat(0.0), b.mass) * self.reach.slope(group);
        let along = dot(&difference(&self.v, &b.v), &group.x_ab);
        let pair = Approach {
            along,
            square: group.square,
            h: self.reach.lengths(group.rows),
            sound: (self.sound + L::pick(sound, group.rows)) * 0.5,
            density: (self.density + b.value) * 0.5,
        };
        let pressure = self.pressed + L::pick(pressed, group.rows);
        add_scaled(push, -dw * (pressure + artificial(pair, alpha, beta, eta)), &group.x_ab);
        if let Some(stress) = stress {
            let slope = scaled(dw, &group.x_ab);
            for i in 0..D {
                for j in i..D {
                    let mut others = [0.0; LANES];
                    for lane in 0..L::COUNT {
                        others[lane] = stress[group.rows[lane] as usize][i][j];
                    }
                    let both = L::splat(stress[self.a][i][j]) + L::from_array(others);
                    push[i] = both.times_plus(slope[j], push[i]);
                    if j > i {
                        push[j] = both.times_plus(slope[i], push[j]);
                    }
                }
            }
        }
        *rate = dw.times_plus(along, *rate);
    }
}
