//! The sums over pairs of a step: what is done to each row of particles, and the terms, eight neighbours at a time.

use super::{Between, Bulk, Finding, Flux, Place, Plan, Shift, Side, dilated, relieved};
use crate::kernel::Kernel;
use crate::lanes::{LANES, Lanes, Real, Record, Rows, RowsOfSums, Totals};
use crate::math::Vector;
use crate::neighbors::{Group, Term};
use crate::particles::Kind;
use crate::physics::consistency::LinearKernel;
use crate::physics::correction::renormalisation;
use crate::physics::diffusion::{gradient_at_rest, jump};
use crate::physics::lattice::Lattice;
use crate::physics::pairs::{Pairs, Reach, Seen, add_scaled, difference, dot, record, scaled, splat, totals};
use crate::physics::shifting::{pair_weight, push_of_close_pairs, shift, shift_speed, volume_pull};
use crate::physics::state::EquationOfState;
use crate::physics::viscosity::{Tensor, contract};
use crate::walls::dummy::WallSuction;

/// Looks for the free surface. A particle belongs to it where `Σ_b V_b (x_b − x_a)·∇_a W_ab`, walls included, is below the value half-way
/// between the two outermost rows of a flat surface (Lee et al. 2008, with the threshold from the lattice), or where its neighbours are
/// as one-sided as beside a void: that is a surface, too, and shifting must not fill it.
///
/// Writes positions, normals out of the fluid (zero off the surface) and densities; and how the fluid stretches: the symmetric part of the
/// renormalised gradient of its velocity, over fluid alone, zero where neighbours are too few; and what its pressure counts for in forces, more than one
/// where the first sum is below that of the second row of a flat surface, or whether it is foam. Of walls of the first line: the unit normal towards
/// the fluid, `−Σ V ∇W` over walls; zero where walls surround the particle evenly.
pub(super) struct Looking<'a, K, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    /// `1/ρ0`, m³/kg.
    pub scale: f64,
    /// Least sum, and greatest `h |Σ V ∇W|`, off the surface.
    pub threshold: f64,
    pub gap: f64,
    /// What a surface makes missing, and what pressure counts for there.
    pub lattice: Lattice,
    /// Whether pressure counts for anything but itself.
    pub weighs: bool,
    /// The step of the flow that begins, s.
    pub dt: f64,
    pub kind: &'a [Kind],
    pub layer: &'a [u8],
    pub density: &'a [f64],
    pub mass: &'a [f64],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, const D: usize> Rows<Record, Finding<D>> for Looking<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, next: &mut Record, finding: &mut Finding<D>) {
        let own = self.pairs.records[a];
        let x = own.x();
        *finding = Finding::NOTHING;
        if self.kind[a] != Kind::Fluid {
            *next = record::<D>(x, Vector::ZERO, self.density[a], self.mass[a], true);
            if self.layer[a] == 1 {
                let term = Walls { reach: self.pairs.reach::<L>(self.h[a]) };
                let outward = -self.scale * term.reach.slope_scale() * totals(self.pairs.near.sum(a, self.pairs.records, &term));
                let length = outward.norm();
                // A hundredth of 1/h: far below the 0.5/h of a flat wall, far above what rounding leaves of an even surrounding.
                if length * self.h[a] > 1e-2 {
                    *finding = Finding::of_wall(outward / length);
                }
            }
            return;
        }
        let around = Around { reach: self.pairs.reach::<L>(self.h[a]), v: splat(own.v()) };
        let found = self.pairs.near.sum(a, self.pairs.records, &around);
        let scale = self.scale * around.reach.slope_scale();
        let (concentration, filled) = (scale * totals(found.concentration), -scale * found.filled.total());
        let gradient = match renormalisation(&symmetric(-scale, found.moments)) {
            Some(correction) => tensor(-scale, found.change).map(|row| contract(&correction, row)),
            None => [Vector::ZERO; D],
        };
        let of_itself = own.mass::<D>() / self.lattice.rest_density * self.pairs.kernel.w(0.0, self.h[a]);
        let filling = of_itself + around.reach.w_scale() / self.lattice.rest_density * found.filling.total();
        let slope = self.lattice.slope_of_linear::<D>() * concentration.norm();
        let weight = match () {
            () if self.lattice.is_foam(filling / self.lattice.sum_w, slope) => {
                let coming = Coming::<L, D> { v: splat(own.v()), dt: L::splat(self.dt) };
                let Least(closest) = self.pairs.near.sum(a, self.pairs.records, &coming);
                let closest = closest.to_array()[..L::COUNT].iter().copied().fold(f64::INFINITY, f64::min);
                if closest < self.lattice.spacing * self.lattice.spacing { -1.0 } else { 0.0 }
            }
            () if self.weighs => self.lattice.surface_weight(filled / D as f64),
            () => 1.0,
        };
        *finding = Finding::of_fluid(&gradient, weight);
        let length = concentration.norm();
        // A normal of zero marks a particle off the surface; a particle without neighbours has no direction, any will do.
        let normal = match () {
            () if filled >= self.threshold && length * self.h[a] <= self.gap => Vector::ZERO,
            () if length > 0.0 => -concentration / length,
            () => Vector::unit(D - 1),
        };
        *next = record(x, normal, self.density[a], self.mass[a], false);
    }
}

/// `Σ m ∇W` over walls, on the scale of the particle.
struct Walls<'a, K, L> {
    reach: Reach<'a, K, L>,
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Walls<'_, K, L> {
    type Totals = [L; D];

    #[inline(always)]
    fn nothing(&self) -> [L; D] {
        [L::splat(0.0); D]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [L; D]) {
        let b = Seen::<L, D>::of(&group.fields);
        add_scaled(totals, L::choose(b.wall, b.mass * self.reach.slope(group), L::splat(0.0)), &group.x_ab);
    }
}

/// The least number, lane by lane.
#[derive(Clone, Copy)]
struct Least<L>(L);

impl<L: Lanes> Totals for Least<L> {
    #[inline(always)]
    fn joined(self, high: Self) -> Self {
        Self(self.0.at_most(high.0))
    }
}

/// Square of the least distance of any neighbour within the time `dt` from now, s, if none is turned aside, m².
struct Coming<L, const D: usize> {
    v: [L; D],
    dt: L,
}

impl<L: Lanes, const D: usize> Term<L, D> for Coming<L, D> {
    type Totals = Least<L>;

    #[inline(always)]
    fn nothing(&self) -> Least<L> {
        Least(L::splat(f64::INFINITY))
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, Least(closest): &mut Least<L>) {
        let b = Seen::<L, D>::of(&group.fields);
        let (x, v) = (&group.x_ab, difference(&self.v, &b.v));
        let nearing = L::splat(0.0) - dot(&v, x);
        let time = (nearing / dot(&v, &v).at_least(L::splat(f64::MIN_POSITIVE))).at_least(L::splat(0.0)).at_most(self.dt);
        let then: [L; D] = std::array::from_fn(|d| v[d].times_plus(time, x[d]));
        *closest = closest.at_most(dot(&then, &then));
    }
}

/// What surrounds a particle, on the scale of the particle.
#[derive(Clone, Copy)]
struct Surroundings<L, const D: usize> {
    /// `Σ m W` without the particle itself.
    filling: L,
    /// `Σ m ∇W`.
    concentration: [L; D],
    /// `Σ m x_ab·∇W`.
    filled: L,
    /// `Σ m v_ab ⊗ ∇W` over fluid.
    change: [[L; D]; D],
    /// `Σ m x_ab ⊗ ∇W` over fluid, on the diagonal and right of it.
    moments: [[L; D]; D],
}

impl<L: Lanes, const D: usize> Totals for Surroundings<L, D> {
    #[inline(always)]
    fn joined(self, high: Self) -> Self {
        Self {
            filling: self.filling.joined(high.filling),
            concentration: self.concentration.joined(high.concentration),
            filled: self.filled.joined(high.filled),
            change: self.change.joined(high.change),
            moments: self.moments.joined(high.moments),
        }
    }
}

struct Around<'a, K, L, const D: usize> {
    reach: Reach<'a, K, L>,
    v: [L; D],
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Around<'_, K, L, D> {
    type Totals = Surroundings<L, D>;

    #[inline(always)]
    fn nothing(&self) -> Surroundings<L, D> {
        let nothing = [L::splat(0.0); D];
        Surroundings { filling: L::splat(0.0), concentration: nothing, filled: L::splat(0.0), change: [nothing; D], moments: [nothing; D] }
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut Surroundings<L, D>) {
        let b = Seen::<L, D>::of(&group.fields);
        let dw = b.mass * self.reach.slope(group);
        totals.filling = b.mass.times_plus(self.reach.w(group), totals.filling);
        add_scaled(&mut totals.concentration, dw, &group.x_ab);
        totals.filled = dw.times_plus(group.square, totals.filled);
        let (fluid, v_ab) = (L::choose(b.wall, L::splat(0.0), dw), difference(&self.v, &b.v));
        for i in 0..D {
            add_scaled(&mut totals.change[i], fluid * v_ab[i], &group.x_ab);
            for j in i..D {
                totals.moments[i][j] = (fluid * group.x_ab[i]).times_plus(group.x_ab[j], totals.moments[i][j]);
            }
        }
    }
}

/// Shifts particles, draws dilated fluid together, and lets fluid part from walls.
///
/// Beside a wall that cannot pull, fluid is never under tension. The continuity equation counts a wall from which fluid parts, and
/// the density falls; tension then would pull on the fluid behind while nothing holds the side of the wall, and tear the particle off
/// its wall ever faster. The density still counts: it remembers how far a gap has to close before anything pushes.
pub(super) struct Shifting<'a, K, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    /// `1/ρ0`, m³/kg.
    pub scale: f64,
    pub plan: &'a Plan,
    /// What a surface makes missing of `Σ V W`.
    pub lattice: Lattice,
    pub spacing: f64,
    pub looked: &'a [Finding<D>],
    /// Greatest speed, m/s.
    pub fastest: f64,
    pub dt: f64,
    pub kind: &'a [Kind],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, const D: usize> Rows<Record, Place> for Shifting<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, out: &mut Record, place: &mut Place) {
        let own = self.pairs.records[a];
        let (shift, found) = match self.kind[a] {
            Kind::Wall | Kind::Lost => (Shift::NONE, Place::Dry),
            Kind::Fluid if let Some(foam) = self.looked[a].foam() => (Shift::NONE, foam),
            Kind::Fluid if own.v::<D>() != Vector::ZERO => (Shift { weight: self.looked[a].weight(), ..Shift::<D>::NONE }, Place::Surface),
            Kind::Fluid => {
                let reach = self.pairs.reach::<L>(self.h[a]);
                let whole = self.pairs.kernel.w(self.spacing, self.h[a]);
                let speed = self.speed(a);
                let push = push_of_close_pairs(self.plan.state.pressure(own.value::<D>()), self.plan.state.rest * speed * speed);
                let term = Crowd { reach, per_whole: reach.w_scale() / whole, push: L::splat(push), density: L::splat(own.value::<D>()) };
                let found = self.pairs.near.sum(a, self.pairs.records, &term);
                self.shifted(a, &own, [reach.w_scale() / self.plan.state.rest, reach.slope_scale() * self.scale], found)
            }
        };
        (*out, *place) = (shift.to_record(), found);
    }
}

impl<K: Kernel<D>, const D: usize> Shifting<'_, K, D> {
    /// Speed that shifts go by, m/s.
    #[inline(always)]
    fn speed(&self, a: usize) -> f64 {
        shift_speed(self.looked[a].strain_rate(), self.h[a], self.fastest)
    }

    /// `scales`: of `V W` and of `V ∇W` over those of the sums.
    #[inline(always)]
    fn shifted<L: Lanes>(&self, a: usize, own: &Record, scales: [f64; 2], found: Crowding<L, D>) -> (Shift<D>, Place) {
        let Plan { shifting, volume_control, state, suction, .. } = *self.plan;
        let parts = suction == WallSuction::None && found.at_wall.total() > 0.0;
        let least = if parts { 0.0 } else { f64::NEG_INFINITY };
        let h = self.h[a];
        let outward = totals(found.outward);
        let length = outward.norm();
        let (normal, place) = if length > 0.0 { (Some(outward / length), Place::Near) } else { (None, Place::Inside) };
        let concentration = scales[1] * totals(found.concentration);
        let by = shift(concentration, h, shifting * self.speed(a), self.dt, self.lattice.stiffness, normal);
        let own = own.mass::<D>() / state.rest * self.pairs.kernel.w(0.0, h);
        let (missing, weight) = match place {
            Place::Near => {
                let slope = self.lattice.slope_of_linear::<D>() * scales[1] * totals(found.slope);
                (self.lattice.missing(slope.norm()), self.looked[a].weight())
            }
            _ => (0.0, 1.0),
        };
        let pull = state.rest * volume_pull(own + scales[0] * found.filling.total() + missing, h, self.fastest, volume_control);
        let correction = renormalisation(&tensor(-scales[1], found.moments)).unwrap_or([Vector::ZERO; D]);
        let change = contract(&correction, scales[1] * totals(found.gradient)).dot(by);
        (Shift { by, change, pull, least, weight }, place)
    }
}

/// What crowds a particle, on the scale of the particle.
#[derive(Clone, Copy)]
struct Crowding<L, const D: usize> {
    /// `Σ m W` without the particle itself.
    filling: L,
    /// `Σ m ∇W`, close pairs with more weight.
    concentration: [L; D],
    /// `Σ m ∇W`.
    slope: [L; D],
    /// `Σ m (ρ_b − ρ_a) ∇W`.
    gradient: [L; D],
    /// `Σ W n`: out of the fluid.
    outward: [L; D],
    /// `Σ m x_ab ⊗ ∇W`.
    moments: [[L; D]; D],
    /// `Σ W` over walls.
    at_wall: L,
}

impl<L: Lanes, const D: usize> Totals for Crowding<L, D> {
    #[inline(always)]
    fn joined(self, high: Self) -> Self {
        Self {
            filling: self.filling.joined(high.filling),
            concentration: self.concentration.joined(high.concentration),
            slope: self.slope.joined(high.slope),
            gradient: self.gradient.joined(high.gradient),
            outward: self.outward.joined(high.outward),
            moments: self.moments.joined(high.moments),
            at_wall: self.at_wall.joined(high.at_wall),
        }
    }
}

struct Crowd<'a, K, L> {
    reach: Reach<'a, K, L>,
    /// `1/W(Δx)` on the scale of the particle.
    per_whole: f64,
    /// Extra push of pairs that are too close, dimensionless.
    push: L,
    density: L,
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Crowd<'_, K, L> {
    type Totals = Crowding<L, D>;

    #[inline(always)]
    fn nothing(&self) -> Crowding<L, D> {
        let nothing = [L::splat(0.0); D];
        Crowding {
            filling: L::splat(0.0),
            concentration: nothing,
            slope: nothing,
            gradient: nothing,
            outward: nothing,
            moments: [nothing; D],
            at_wall: L::splat(0.0),
        }
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut Crowding<L, D>) {
        let b = Seen::<L, D>::of(&group.fields);
        let w = self.reach.w(group);
        let dw = b.mass * self.reach.slope(group);
        totals.filling = b.mass.times_plus(w, totals.filling);
        add_scaled(&mut totals.concentration, pair_weight(w * self.per_whole, self.push) * dw, &group.x_ab);
        add_scaled(&mut totals.slope, dw, &group.x_ab);
        add_scaled(&mut totals.gradient, (b.value - self.density) * dw, &group.x_ab);
        add_scaled(&mut totals.outward, w, &b.v);
        add_moments(&mut totals.moments, dw, &group.x_ab);
        totals.at_wall = totals.at_wall + L::choose(b.wall, w, L::splat(0.0));
    }
}

/// The tensor that lanes add up to, times `scale`.
#[inline(always)]
fn tensor<L: Lanes, const D: usize>(scale: f64, rows: [[L; D]; D]) -> Tensor<D> {
    let mut tensor = [Vector::ZERO; D];
    for d in 0..D {
        tensor[d] = scale * totals(rows[d]);
    }
    tensor
}

/// As [`tensor`], from the diagonal and what is right of it.
#[inline(always)]
fn symmetric<L: Lanes, const D: usize>(scale: f64, rows: [[L; D]; D]) -> Tensor<D> {
    let mut tensor = [Vector::ZERO; D];
    for i in 0..D {
        for j in i..D {
            tensor[i][j] = scale * rows[i][j].total();
            tensor[j][i] = tensor[i][j];
        }
    }
    tensor
}

/// `moments += x_ab ⊗ dw x_ab`.
#[inline(always)]
fn add_moments<L: Real, const D: usize>(moments: &mut [[L; D]; D], dw: L, x_ab: &[L; D]) {
    for i in 0..D {
        add_scaled(&mut moments[i], dw * x_ab[i], x_ab);
    }
}

/// The renormalised gradient of the density; that of liquid at rest for walls and where neighbours are too few.
pub(super) struct DensitySlope<'a, K, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    /// `1/ρ0`, m³/kg.
    pub scale: f64,
    pub state: EquationOfState,
    pub gravity: Vector<D>,
    pub kind: &'a [Kind],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, const D: usize> Rows<Vector<D>> for DensitySlope<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, gradient: &mut Vector<D>, _: &mut ()) {
        let density = self.pairs.records[a].value::<D>();
        *gradient = gradient_at_rest(&self.state, self.gravity, density);
        if self.kind[a] == Kind::Fluid {
            let term = Rise { reach: self.pairs.reach::<L>(self.h[a]), density: L::splat(density) };
            let (sum, moments): ([L; D], [[L; D]; D]) = self.pairs.near.sum(a, self.pairs.records, &term);
            let scale = self.scale * term.reach.slope_scale();
            if let Some(correction) = renormalisation(&tensor(-scale, moments)) {
                *gradient = contract(&correction, scale * totals(sum));
            }
        }
    }
}

/// `m (ρ_b − ρ_a) ∇W` and `m x_ab ⊗ ∇W`, on the scale of the particle.
struct Rise<'a, K, L> {
    reach: Reach<'a, K, L>,
    density: L,
}

impl<K: Kernel<D>, L: Lanes, const D: usize> Term<L, D> for Rise<'_, K, L> {
    type Totals = ([L; D], [[L; D]; D]);

    #[inline(always)]
    fn nothing(&self) -> Self::Totals {
        ([L::splat(0.0); D], [[L::splat(0.0); D]; D])
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, (sum, moments): &mut Self::Totals) {
        let b = Seen::<L, D>::of(&group.fields);
        let dw = b.mass * self.reach.slope(group);
        add_scaled(sum, (b.value - self.density) * dw, &group.x_ab);
        add_moments(moments, dw, &group.x_ab);
    }
}

impl<L: Real, const D: usize> Between<L, D> {
    /// The same pair from the other side.
    #[inline(always)]
    fn turned(self) -> Self {
        Self { x_ab: scaled(L::splat(-1.0), &self.x_ab), ..self }
    }
}

/// Forces: on fluid, which they set in motion, and on walls, where they are added up. Of fluid the second column is the acceleration by artificial
/// viscosity, m/s².
pub(super) struct Kick<'a, K, F, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    pub flux: F,
    /// What a gradient of a linear field is multiplied with to be exact on the lattice, dimensionless.
    pub slope: f64,
    pub linear: &'a [LinearKernel<D>],
    pub place: &'a [Place],
    pub bulk: &'a [Bulk],
    pub state: EquationOfState,
    pub gravity: Vector<D>,
    /// `Δt` of velocities and of positions, s; share of the step in the mean force on walls; how late it is behind the middle of the step, s.
    pub step: [f64; 4],
    pub kind: &'a [Kind],
    pub body: &'a [u16],
    /// Walls that go along with their velocity.
    pub going: &'a [u16],
    pub v: &'a [Vector<D>],
    /// Of walls: mean over the step.
    pub acceleration: &'a [Vector<D>],
    pub mass: &'a [f64],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, F: Flux<D>, const D: usize> RowsOfSums<Record, Vector<D>> for Kick<'_, K, F, D> {
    /// Acceleration by neighbours; of walls that are wet, too. m/s².
    type Sum = Vector<D>;
    const NOTHING: Vector<D> = Vector::ZERO;

    #[inline(always)]
    fn sum<L: Lanes>(&self, a: usize, _: &Record, _: &Vector<D>) -> Vector<D> {
        let now = &self.pairs.records[a];
        match self.kind[a] {
            Kind::Fluid if F::LINEAR => self.linear_push(a),
            Kind::Fluid => self.push::<L>(a, now),
            Kind::Wall if self.place[a] == Place::Wet && F::LINEAR => self.linear_push(a),
            Kind::Wall if self.place[a] == Place::Wet => self.push_back::<L>(a, now),
            Kind::Wall | Kind::Lost => Self::NOTHING,
        }
    }

    #[inline(always)]
    fn row(&self, a: usize, push: Vector<D>, next: &mut Record, force: &mut Vector<D>) {
        let now = self.pairs.records[a];
        let [dt, drift, share, late] = self.step;
        match self.kind[a] {
            Kind::Fluid => {
                let v = now.v() + dt * (push + *force + self.gravity);
                *next = record(now.x() + drift * v, v, self.bulk[a].density, self.mass[a], false);
            }
            Kind::Wall => {
                let density = self.state.density(now.value::<D>());
                let v = self.v[a] + late * self.acceleration[a];
                let x = if self.going.contains(&self.body[a]) { now.x() + drift * v } else { now.x() };
                *next = record(x, v, density, self.mass[a], true);
                if self.place[a] == Place::Wet {
                    *force += share * self.mass[a] * push;
                }
            }
            Kind::Lost => {}
        }
    }
}

impl<K: Kernel<D>, F: Flux<D>, const D: usize> Kick<'_, K, F, D> {
    /// A particle as its record tells it.
    #[inline(always)]
    fn side<L: Real>(&self, a: usize, now: &Record) -> Side<L, D> {
        let pressure = now.value::<D>();
        let inside = self.place[a] == Place::Inside;
        Side { v: splat(now.v()), pressure: L::splat(pressure), own: L::splat(self.flux.own_pressure(pressure, inside)) }
    }

    /// What sums of forces are multiplied with.
    #[inline(always)]
    fn scale(&self, slope_scale: f64) -> f64 {
        self.slope * slope_scale / (self.state.rest * self.state.rest)
    }

    /// Acceleration of fluid by its neighbours, m/s².
    #[inline(always)]
    fn push<L: Lanes>(&self, a: usize, now: &Record) -> Vector<D> {
        let term = Push { reach: self.pairs.reach(self.h[a]), flux: self.flux, own: self.side::<L>(a, now) };
        self.scale(term.reach.slope_scale()) * totals(self.pairs.near.sum(a, self.pairs.records, &term))
    }

    /// Force of fluid on a wall particle over its mass, m/s²: what the fluid feels of it, turned round.
    #[inline(always)]
    fn push_back<L: Lanes>(&self, a: usize, now: &Record) -> Vector<D> {
        let term = PushBack { reach: self.pairs.reach(self.h[a]), flux: self.flux, own: self.side::<L>(a, now), place: self.place };
        -self.scale(term.reach.slope_scale()) * totals(self.pairs.near.sum(a, self.pairs.records, &term))
    }

    /// Either, with linear kernels, pair by pair.
    #[inline(always)]
    fn linear_push(&self, a: usize) -> Vector<D> {
        let records = self.pairs.records;
        let (own, fluid) = (self.side(a, &records[a]), self.kind[a] == Kind::Fluid);
        let mut sum = Vector::ZERO;
        for &b in self.pairs.near.of(a) {
            let b = b as usize;
            let pair = LinearPair::of(self.pairs, self.linear, self.h, a, b);
            let (mass, other, wall) = (records[b].mass::<D>(), self.side(b, &records[b]), !fluid || records[b].is_wall::<D>());
            if !fluid && records[b].is_wall::<D>() {
                continue;
            }
            let between = Between { wall, ..pair.between };
            let rubbing = if fluid { self.flux.force(own, other, between) } else { self.flux.force(other, own, between.turned()) };
            let mut force = self.scale(pair.dw) * if fluid { Vector(rubbing) } else { -Vector(rubbing) };
            let share = match (wall, fluid) {
                (false, _) => 1.0,
                (true, true) => self.flux.share_at_wall(own.pressure, other.pressure),
                (true, false) => self.flux.share_at_wall(other.pressure, own.pressure),
            };
            force -= share * (own.pressure * pair.grad[0] - other.pressure * pair.grad[1]) / (self.state.rest * self.state.rest);
            sum += mass * force;
        }
        sum
    }
}

/// A pair with the gradients of linear kernels.
struct LinearPair<const D: usize> {
    between: Between<f64, D>,
    /// `W'/r` of the kernel itself, m⁻ᴰ⁻².
    dw: f64,
    /// `∇_a W_ab` and `∇_b W_ba`, each at its own particle, m⁻ᴰ⁻¹.
    grad: [Vector<D>; 2],
}

impl<const D: usize> LinearPair<D> {
    #[inline(always)]
    fn of<K: Kernel<D>>(pairs: Pairs<'_, K, D>, linear: &[LinearKernel<D>], lengths: &[f64], a: usize, b: usize) -> Self {
        let records = pairs.records;
        let x_ab = records[a].x::<D>() - records[b].x();
        let (r, h) = (x_ab.norm(), 0.5 * (lengths[a] + lengths[b]));
        let (w, dw) = (pairs.kernel.w(r, h), pairs.kernel.dw_over_r(r, h));
        let grad = [linear[a].gradient(-x_ab, w, dw), linear[b].gradient(x_ab, w, dw)];
        Self { between: Between { x_ab: x_ab.0, r, square: r * r, h, wall: records[b].is_wall::<D>() }, dw, grad }
    }
}

/// `m_b` times the force of `b` on `a`, on the scale of the particle.
struct Push<'a, K, F, L, const D: usize> {
    reach: Reach<'a, K, L>,
    flux: F,
    own: Side<L, D>,
}

impl<K: Kernel<D>, F: Flux<D>, L: Lanes, const D: usize> Term<L, D> for Push<'_, K, F, L, D> {
    type Totals = [L; D];

    #[inline(always)]
    fn nothing(&self) -> [L; D] {
        [L::splat(0.0); D]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [L; D]) {
        let b = Seen::<L, D>::of(&group.fields);
        let pair = Between { x_ab: group.x_ab, r: group.r, square: group.square, h: self.reach.lengths(group.rows), wall: b.wall };
        let other = Side { v: b.v, pressure: b.value, own: b.value };
        add_scaled(totals, b.mass * self.reach.slope(group), &self.flux.force(self.own, other, pair));
    }
}

/// `m_b` times the force of the wall particle on the fluid `b`, on the scale of the particle.
struct PushBack<'a, K, F, L, const D: usize> {
    reach: Reach<'a, K, L>,
    flux: F,
    own: Side<L, D>,
    place: &'a [Place],
}

impl<K: Kernel<D>, F: Flux<D>, L: Lanes, const D: usize> Term<L, D> for PushBack<'_, K, F, L, D> {
    type Totals = [L; D];

    #[inline(always)]
    fn nothing(&self) -> [L; D] {
        [L::splat(0.0); D]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [L; D]) {
        let b = Seen::<L, D>::of(&group.fields);
        let mut inside = [0.0; LANES];
        for lane in 0..L::COUNT {
            inside[lane] = if self.place[group.rows[lane] as usize] == Place::Inside { -1.0 } else { 1.0 };
        }
        let inside = L::from_array(inside).below(L::splat(0.0));
        let fluid = Side { v: b.v, pressure: b.value, own: self.flux.own_pressure(b.value, inside) };
        let everywhere = L::splat(0.0).below(L::splat(1.0));
        let pair =
            Between { x_ab: group.x_ab, r: group.r, square: group.square, h: self.reach.lengths(group.rows), wall: everywhere }.turned();
        let mass = L::choose(b.wall, L::splat(0.0), b.mass);
        add_scaled(totals, mass * self.reach.slope(group), &self.flux.force(fluid, self.own, pair));
    }
}

/// Rates of density, what they make of it by the end of the sound step, and the first half of the next one.
pub(super) struct Dilation<'a, K, F, const D: usize> {
    pub pairs: Pairs<'a, K, D>,
    pub flux: F,
    /// What a gradient of a linear field is multiplied with to be exact on the lattice, dimensionless.
    pub slope: f64,
    pub linear: &'a [LinearKernel<D>],
    /// Gradients of density that diffusion leaves alone, kg/m⁴; none where it is `gradient` everywhere.
    pub gradients: Option<&'a [Vector<D>]>,
    pub gradient: Vector<D>,
    pub place: &'a [Place],
    pub state: EquationOfState,
    /// `Δt` of densities to the end of this step, and of all to the middle of the next, s; `α2 c0`, m/s.
    pub step: [f64; 3],
    /// Whether there is no next sound step: pressure is then that of the density, for others to read.
    pub last: bool,
    pub kind: &'a [Kind],
    pub body: &'a [u16],
    /// Walls that go along with their velocity.
    pub going: &'a [u16],
    pub mass: &'a [f64],
    pub h: &'a [f64],
}

impl<K: Kernel<D>, F: Flux<D>, const D: usize> RowsOfSums<Record, Bulk> for Dilation<'_, K, F, D> {
    /// Rate of density by compression, and what spreads, kg/(m³ s).
    type Sum = [f64; 2];
    const NOTHING: [f64; 2] = [0.0; 2];

    #[inline(always)]
    fn sum<L: Lanes>(&self, a: usize, _: &Record, bulk: &Bulk) -> [f64; 2] {
        match self.kind[a] {
            Kind::Fluid if F::LINEAR => self.linear_rate(a, bulk.density),
            Kind::Fluid => self.rate::<L>(a, &self.pairs.records[a], bulk.density),
            Kind::Wall | Kind::Lost => Self::NOTHING,
        }
    }

    #[inline(always)]
    fn row(&self, a: usize, [compression, spread]: [f64; 2], next: &mut Record, bulk: &mut Bulk) {
        let now = self.pairs.records[a];
        let [half, lead, damping] = self.step;
        match self.kind[a] {
            Kind::Fluid => {}
            Kind::Wall if self.going.contains(&self.body[a]) => {
                next.0[..D].copy_from_slice(&(now.x::<D>() + lead * now.v::<D>()).0);
                return;
            }
            Kind::Wall | Kind::Lost => return,
        }
        bulk.compression = f64::from(bulk.weight) * compression;
        bulk.rate = bulk.pull + bulk.compression + spread;
        let density = dilated(bulk.density, half * bulk.rate, self.place[a], self.state.rest);
        bulk.density = relieved(density, bulk.rate, self.place[a], self.state.rest);
        bulk.density = dilated(bulk.density, lead * bulk.rate, self.place[a], self.state.rest);
        let pressure = match self.place[a] {
            _ if self.last => bulk.pressure(&self.state),
            Place::Inside => bulk.pressing(&self.state) + damping * self.h[a] * bulk.compression,
            _ => bulk.pressing(&self.state),
        };
        let v = now.v::<D>();
        *next = record(now.x() + lead * v, v, pressure, self.mass[a], false);
    }
}

impl<K: Kernel<D>, F: Flux<D>, const D: usize> Dilation<'_, K, F, D> {
    /// Rate of the density of fluid by compression, unweighted, and what spreads, kg/(m³ s).
    #[inline(always)]
    fn rate<L: Lanes>(&self, a: usize, now: &Record, density: f64) -> [f64; 2] {
        let term = Rate {
            reach: self.pairs.reach::<L>(self.h[a]),
            flux: self.flux,
            v: splat(now.v()),
            density: L::splat(density),
            gradient: splat(self.gradients.map_or(self.gradient, |gradients| gradients[a])),
            gradients: self.gradients,
        };
        let [compression, spread] = self.pairs.near.sum(a, self.pairs.records, &term);
        let scale = self.slope * term.reach.slope_scale();
        [scale * compression.total(), scale * spread.total()]
    }

    /// The same with linear kernels, pair by pair.
    #[inline(always)]
    fn linear_rate(&self, a: usize, density: f64) -> [f64; 2] {
        let records = self.pairs.records;
        let (mut compression, mut spread) = (0.0, 0.0);
        for &b in self.pairs.near.of(a) {
            let b = b as usize;
            let pair = LinearPair::of(self.pairs, self.linear, self.h, a, b);
            let x_ab = Vector(pair.between.x_ab);
            let rise = self.gradients.map_or(self.gradient, |gradients| 0.5 * (gradients[a] + gradients[b])).dot(x_ab);
            let v_ab = records[a].v::<D>() - records[b].v();
            let jump = jump(density, records[b].value::<D>(), rise);
            compression += records[b].mass::<D>() * v_ab.dot(pair.grad[0]);
            spread += records[b].mass::<D>() * self.slope * pair.dw * self.flux.spread(pair.between, jump);
        }
        [compression, spread]
    }
}

/// `m_b` times the rate of density by `b` that is compression, and what spreads, on the scale of the particle.
struct Rate<'a, K, F, L, const D: usize> {
    reach: Reach<'a, K, L>,
    flux: F,
    v: [L; D],
    density: L,
    /// The gradient of density that stays, kg/m⁴.
    gradient: [L; D],
    /// Those of others, where they differ.
    gradients: Option<&'a [Vector<D>]>,
}

impl<K: Kernel<D>, F: Flux<D>, L: Lanes, const D: usize> Term<L, D> for Rate<'_, K, F, L, D> {
    type Totals = [L; 2];

    #[inline(always)]
    fn nothing(&self) -> [L; 2] {
        [L::splat(0.0); 2]
    }

    #[inline(always)]
    fn add(&self, group: &Group<'_, L, D>, totals: &mut [L; 2]) {
        let b = Seen::<L, D>::of(&group.fields);
        let mut rise = dot(&self.gradient, &group.x_ab);
        if let Some(gradients) = self.gradients {
            let mut others = [[0.0; LANES]; D];
            for lane in 0..L::COUNT {
                for d in 0..D {
                    others[d][lane] = gradients[group.rows[lane] as usize][d];
                }
            }
            for d in 0..D {
                rise = L::from_array(others[d]).times_plus(group.x_ab[d], rise);
            }
            rise = rise * 0.5;
        }
        let pair = Between { x_ab: group.x_ab, r: group.r, square: group.square, h: self.reach.lengths(group.rows), wall: b.wall };
        let dw = b.mass * self.reach.slope(group);
        totals[0] = dw.times_plus(dot(&difference(&self.v, &b.v), &group.x_ab), totals[0]);
        totals[1] = dw.times_plus(self.flux.spread(pair, jump(self.density, b.value, rise)), totals[1]);
    }
}
