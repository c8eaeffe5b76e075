//! The liquid that is missing beyond a free surface, as images of the liquid beneath it.
//!
//! Next to a free surface sums over pairs end where liquid does, and with them the pressure force of a linear pressure: of liquid at rest the
//! outermost row would sink until its pressure is that of a place half a spacing deeper. The pressure that is zero on the surface goes on
//! beyond it with the opposite sign, as the images of charges before a grounded plate do: the image of `b` at `x_b + 2 d_b n` has the pressure
//! `−p_b`, and presses on `a` with `p_a − p_b`. Along the normal the image of `b` pushes `a` as much as that of `a` pushes `b` back: momentum is
//! conserved, and with the images every row of liquid at rest is in equilibrium.

use super::{Place, Stretch};
use crate::kernel::Kernel;
use crate::lanes::{LANES, Lanes, Rows};
use crate::math::Vector;
use crate::neighbors::{Octet, Term};
use crate::physics::arrangement::across;
use crate::physics::pairs::{Pairs, Reach, Seen, add_scaled, dot, scaled, splat, totals};

/// What a particle near the surface knows of it: its unit normal, the depth under it, m, and how the pressure rises towards it over the density,
/// m/s². Zero elsewhere.
#[derive(Clone, Copy)]
struct Beneath<const D: usize> {
    normal: Vector<D>,
    depth: f64,
    rise: f64,
}

impl<const D: usize> Beneath<D> {
    const NOT: Self = Self { normal: Vector::ZERO, depth: 0.0, rise: 0.0 };

    /// In the place of what the sums of a step need no more: the normal in the first row, the others in the second.
    fn store(self) -> Stretch<D> {
        let mut stored = [[0.0; D]; D];
        for d in 0..D {
            stored[0][d] = self.normal[d] as f32;
        }
        [stored[1][0], stored[1][1]] = [self.depth as f32, self.rise as f32];
        stored
    }

    /// [Stored](Self::store) numbers.
    fn of(stored: &Stretch<D>) -> Self {
        let normal = Vector(std::array::from_fn(|d| f64::from(stored[0][d])));
        Self { normal, depth: f64::from(stored[1][0]), rise: f64::from(stored[1][1]) }
    }
}

/// Finds the surface from particles near it: its normal is the mean of those of surface particles around, half a spacing outside of which it is.
/// The pressure rises as the mean acceleration of the fluid around in the last step says, `(g − dv/dt)·n`: that of each particle alone would drive
/// the shortest waves, whose acceleration changes much from step to step.
pub(super) struct Finding<'a, K, const D: usize> {
    /// The records carry normals where velocities stand, zero off the surface.
    pub pairs: Pairs<'a, K, D>,
    pub place: &'a [Place],
    /// m.
    pub spacing: f64,
    pub gravity: Vector<D>,
    pub acceleration: &'a [Vector<D>],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, const D: usize> Rows<Stretch<D>> for Finding<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, stored: &mut Stretch<D>, _: &mut ()) {
        let mut found = Beneath::NOT;
        if matches!(self.place[a], Place::Near | Place::Surface) {
            let reach = self.pairs.reach::<L>(self.h[a]);
            let term = Around { reach, acceleration: self.acceleration };
            let sums: Neighbourhood<L, D> = self.pairs.near.sum(a, self.pairs.records, &term);
            let (record, own) = (&self.pairs.records[a], self.pairs.kernel.w(0.0, self.h[a]) / reach.w_scale());
            let outward = along_walls(totals(sums.outward) + own * record.v(), totals(sums.off_walls));
            let length = outward.norm();
            if length > 0.0 {
                let normal = outward / length;
                let seen = sums.of_surface.total();
                let under = if self.place[a] == Place::Near && seen > 0.0 { totals(sums.towards).dot(normal) / seen } else { 0.0 };
                let mass = own * record.mass::<D>();
                let mean = (totals(sums.momentum) + mass * self.acceleration[a]) / (sums.mass.total() + mass);
                let rise = (self.gravity - mean).dot(normal).min(0.0);
                found = Beneath { normal, depth: under.max(0.0) + 0.5 * self.spacing, rise };
            }
        }
        *stored = found.store();
    }
}

/// The part along walls beside the surface of a normal `outward`: they stand out of the liquid and turn normals away from them. `off_walls` points
/// away from walls; those under the surface do not turn it.
#[inline(always)]
fn along_walls<const D: usize>(outward: Vector<D>, off_walls: Vector<D>) -> Vector<D> {
    let beside = outward.dot(off_walls).abs() < 0.9 * outward.norm() * off_walls.norm();
    if beside { across(outward, off_walls) } else { outward }
}

/// What is around a particle near the surface, with kernels on the scale of the particle.
struct Neighbourhood<L, const D: usize> {
    /// `Σ W n`.
    outward: [L; D],
    /// `Σ W (x_b − x_a)` and `Σ W` over particles of the surface.
    towards: [L; D],
    of_surface: L,
    /// `Σ m W dv/dt` and `Σ m W` over fluid.
    momentum: [L; D],
    mass: L,
    /// `Σ W (x_a − x_b)` over walls.
    off_walls: [L; D],
}

struct Around<'a, K, L, const D: usize> {
    reach: Reach<'a, K, L>,
    acceleration: &'a [Vector<D>],
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Around<'_, K, L, D> {
    type Totals = Neighbourhood<L, D>;

    #[inline(always)]
    fn nothing(&self) -> Neighbourhood<L, D> {
        let nothing = L::splat(0.0);
        Neighbourhood { outward: [nothing; D], towards: [nothing; D], of_surface: nothing, momentum: [nothing; D], mass: nothing, off_walls: [nothing; D] }
    }

    #[inline(always)]
    fn add(&self, octet: &Octet<'_, L, D>, totals: &mut Neighbourhood<L, D>) {
        let b = Seen::<L, D>::of(&octet.fields);
        let w = self.reach.w(octet);
        // Normals are of length one or zero.
        let of_surface = w * dot(&b.v, &b.v);
        add_scaled(&mut totals.outward, w, &b.v);
        add_scaled(&mut totals.towards, -of_surface, &octet.x_ab);
        totals.of_surface = totals.of_surface + of_surface;
        let mut acceleration = [[0.0; LANES]; D];
        for lane in 0..LANES {
            // Behind all particles there is nobody.
            let theirs = self.acceleration.get(octet.rows[lane] as usize).copied().unwrap_or(Vector::ZERO);
            for d in 0..D {
                acceleration[d][lane] = theirs[d];
            }
        }
        let mass = L::choose(b.wall, L::splat(0.0), b.mass * w);
        for d in 0..D {
            totals.momentum[d] = mass.times_plus(L::from_array(acceleration[d]), totals.momentum[d]);
        }
        totals.mass = totals.mass + mass;
        add_scaled(&mut totals.off_walls, L::choose(b.wall, w, L::splat(0.0)), &octet.x_ab);
    }
}

/// Adds to accelerations, m/s², what images do: `Σ_b V_b (p_a − p_b)/ρ0 (W'/r)(r') (d_a + d_b) n`, `r'` from the image, with the mean normal and
/// rise of pressure of both; none between surfaces that face different ways. Walls have no surface of their own: they go on like the fluid beside
/// them, and bear what they do to it.
pub(super) struct Images<'a, K, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    /// `1/ρ0` for masses, m³/kg.
    pub scale: f64,
    /// What [`Finding`] found.
    pub beneath: &'a [Stretch<D>],
    pub place: &'a [Place],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, const D: usize> Rows<Vector<D>> for Images<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, acceleration: &mut Vector<D>, _: &mut ()) {
        let (own, reach) = (Beneath::of(&self.beneath[a]), self.pairs.reach::<L>(self.h[a]));
        let sum = if own.depth > 0.0 {
            let own = Under { normal: splat(own.normal), depth: L::splat(own.depth), rise: L::splat(own.rise) };
            totals(self.pairs.near.sum(a, self.pairs.records, &Image { reach, own, beneath: self.beneath }))
        } else if self.place[a] == Place::Wet {
            totals(self.pairs.near.sum(a, self.pairs.records, &ImageAtWall { reach, beneath: self.beneath }))
        } else {
            return;
        };
        *acceleration += self.scale * reach.slope_scale() * sum;
    }
}

/// [`Beneath`] of eight particles.
#[derive(Clone, Copy)]
struct Under<L, const D: usize> {
    normal: [L; D],
    depth: L,
    rise: L,
}

impl<L: Lanes, const D: usize> Under<L, D> {
    #[inline(always)]
    fn of(beneath: &[Stretch<D>], rows: &[u32; LANES]) -> Self {
        let (mut normals, mut depths, mut rises) = ([[0.0; LANES]; D], [0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            let it = Beneath::of(&beneath[rows[lane] as usize]);
            (depths[lane], rises[lane]) = (it.depth, it.rise);
            for d in 0..D {
                normals[d][lane] = it.normal[d];
            }
        }
        let mut normal = [L::splat(0.0); D];
        for d in 0..D {
            normal[d] = L::from_array(normals[d]);
        }
        Self { normal, depth: L::from_array(depths), rise: L::from_array(rises) }
    }

    /// That of a wall beside these particles, `x` from it to them, m.
    #[inline(always)]
    fn of_wall(self, x: &[L; D]) -> Self {
        Self { depth: (dot(x, &self.normal) + self.depth).at_least(L::splat(0.0)), ..self }
    }
}

/// `(p_a − p_b)/ρ0 (d_a + d_b) n`, times `W'/r` of the image on the scale of the particle; `x_ab` from `b`.
#[inline(always)]
fn push<K: Kernel<D>, L: Lanes, const D: usize>(
    reach: &Reach<'_, K, L>,
    octet: &Octet<'_, L, D>,
    x_ab: &[L; D],
    a: Under<L, D>,
    b: Under<L, D>,
) -> [L; D] {
    let nothing = L::splat(0.0);
    let mut twice = a.normal;
    for d in 0..D {
        twice[d] = twice[d] + b.normal[d];
    }
    let facing = dot(&a.normal, &b.normal);
    // |n_a + n_b|² = 2 (1 + n_a·n_b).
    let length = (facing * 2.0 + 2.0).at_least(L::splat(1.0)).root();
    let (between, up) = (a.depth + b.depth, dot(x_ab, &twice) / length);
    let from_image = (octet.square - up * up + between * between).at_least(nothing).root();
    let push = (a.rise + b.rise) * 0.5 * up * between / length * reach.slope_at(from_image, octet.rows);
    // Off the surface depths are zero.
    let near = L::choose(nothing.below(a.depth), L::choose(nothing.below(b.depth), push, nothing), nothing);
    scaled(L::choose(L::splat(FACING).below(facing), near, nothing), &twice)
}

/// Least cosine between normals of one surface.
const FACING: f64 = 0.5;

/// What images do to fluid, over its mass.
struct Image<'a, K, L, const D: usize> {
    reach: Reach<'a, K, L>,
    own: Under<L, D>,
    beneath: &'a [Stretch<D>],
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Image<'_, K, L, D> {
    type Totals = [L; D];

    #[inline(always)]
    fn nothing(&self) -> [L; D] {
        [L::splat(0.0); D]
    }

    #[inline(always)]
    fn add(&self, octet: &Octet<'_, L, D>, totals: &mut [L; D]) {
        let b = Seen::<L, D>::of(&octet.fields);
        let (fluid, wall) = (Under::<L, D>::of(self.beneath, octet.rows), self.own.of_wall(&octet.x_ab));
        let mut other = Under {
            normal: fluid.normal,
            depth: L::choose(b.wall, wall.depth, fluid.depth),
            rise: L::choose(b.wall, wall.rise, fluid.rise),
        };
        for d in 0..D {
            other.normal[d] = L::choose(b.wall, wall.normal[d], fluid.normal[d]);
        }
        add_scaled(totals, b.mass, &push(&self.reach, octet, &octet.x_ab, self.own, other));
    }
}

/// What the images of a wall do to fluid, turned round, over the mass of the wall.
struct ImageAtWall<'a, K, L, const D: usize> {
    reach: Reach<'a, K, L>,
    beneath: &'a [Stretch<D>],
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for ImageAtWall<'_, K, L, D> {
    type Totals = [L; D];

    #[inline(always)]
    fn nothing(&self) -> [L; D] {
        [L::splat(0.0); D]
    }

    #[inline(always)]
    fn add(&self, octet: &Octet<'_, L, D>, totals: &mut [L; D]) {
        let b = Seen::<L, D>::of(&octet.fields);
        let fluid = Under::<L, D>::of(self.beneath, octet.rows);
        let x = scaled(L::splat(-1.0), &octet.x_ab);
        let mass = L::choose(b.wall, L::splat(0.0), b.mass);
        add_scaled(totals, -mass, &push(&self.reach, octet, &x, fluid, fluid.of_wall(&x)));
    }
}
