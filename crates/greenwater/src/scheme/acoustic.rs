//! What the weakly compressible methods of today share: walls, the free surface, shifting, and a step made of sound steps.
//!
//! A method brings its pair terms (`Flux`); this file moves the particles.

mod found;
pub(super) mod relative;
mod start;
mod sums;

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::found::{Bulk, Finding, Place, Shift};
use self::sums::{DensitySlope, Dilation, Kick, Looking, Shifting};
use super::before::{Before, follow};
use super::{Medium, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::lanes::{InstructionSet, Real, Record, sweep_lanes, sweep_lanes2, sweep_sums};
use crate::math::Vector;
use crate::neighbors::{BehindWalls, NOBODY, Neighbors, Search};
use crate::particles::{Kind, Order, Particles};
use crate::physics::consistency::{DensityReset, LinearKernel, MovingMoments, new_density};
use crate::physics::damping::Damping;
use crate::physics::diffusion::{Diffusion, gradient_at_rest};
use crate::physics::lattice::Lattice;
use crate::physics::pairs::{Pairs, record, take_lengths};
use crate::physics::state::{EquationOfState, PressureLaw};
use crate::reduce::sum;
use crate::sweep::{BLOCK, largest, sweep, update, update2};
use crate::time::{Phases, StepLimit};
use crate::walls::dummy::{DummyWalls, Liquid, WallPressure, WallSlip, WallSuction};
use crate::walls::guard::{Guarded, NO_WALL};

use super::delta_sph::DeltaFlux;
use super::edac::EdacFlux;
use super::linear::LinearFlux;
use super::riemann::RiemannFlux;

/// How sound is stepped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Stepping {
    /// A step follows the flow; pressure and density take as many shorter steps within it as sound asks for. Pairs, free surface
    /// and shifting once a step (Zhang, Rezavand & Hu 2020).
    Dual,
    /// Every step is as short as sound asks for.
    Single,
}

/// Pressure at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StartPressure {
    /// From the density that the particle file gives.
    Given,
    /// That of the case: `fluid.pressure`, or `fluid.initial_pressure`.
    Written,
    /// `p = ρ0 g d` under the weight of the fluid above, whatever is beside it.
    Hydrostatic,
    /// That of a flow about to begin: zero on the free surface, the weight of the liquid on walls, harmonic in between. Liquid at
    /// rest is hydrostatic by it, and a column without its gate starts without a burst of sound.
    Released,
}

/// What acts against clumping where the pressure is below zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TensileControl {
    /// Nothing: momentum is conserved to round-off.
    None,
    /// Inside the fluid a particle of negative pressure feels `p_b − p_a` in place of `p_b + p_a` (Sun et al. 2018).
    Switch,
}

/// One particle of a pair, as pair terms see it.
#[derive(Clone, Copy)]
pub(super) struct Side<L, const D: usize> {
    /// Velocity, m/s; for walls in forces the one that rubs.
    pub v: [L; D],
    /// Pressure, Pa.
    pub pressure: L,
    /// Pressure in the force on itself, Pa: [`Flux::own_pressure`].
    pub own: L,
}

/// Where the two particles of a pair are.
#[derive(Clone, Copy)]
pub(super) struct Between<L: Real, const D: usize> {
    /// `x_a − x_b`, m.
    pub x_ab: [L; D],
    /// Distance, m, and its square, m².
    pub r: L,
    pub square: L,
    /// Mean smoothing length, m.
    pub h: L,
    /// Whether one of the two belongs to a wall.
    pub wall: L::Mask,
}

/// The pair terms of a method, written once for one pair and for eight.
pub(super) trait Flux<const D: usize>: Copy + Send + Sync {
    /// Whether pressure and divergence are those of linear kernels, which [`force`](Self::force) then leaves out.
    const LINEAR: bool = false;

    /// With linear kernels: how much of their pressures `fluid` and `wall`, Pa, press each other with, dimensionless.
    fn share_at_wall(self, _fluid: f64, _wall: f64) -> f64 {
        1.0
    }

    /// The same terms for the speed of sound `sound`, m/s.
    fn with_sound(self, sound: f64) -> Self;

    /// The pressure of a particle in the force on itself, Pa; `inside`: away from the free surface.
    #[inline(always)]
    fn own_pressure<L: Real>(self, pressure: L, _inside: L::Mask) -> L {
        pressure
    }

    /// Force of `b` on the fluid particle `a` over both masses and `W'/(r ρ0²)`, with `∇_a W_ab = (W'/r) x_ab`; Pa m.
    fn force<L: Real>(self, a: Side<L, D>, b: Side<L, D>, pair: Between<L, D>) -> [L; D];

    /// Rate of the density of the fluid particle `a` beside compression, over the mass of `b` and `W'/r`, m²/s. `jump` is the part of `ρ_a − ρ_b` that
    /// diffuses, kg/m³.
    fn spread<L: Real>(self, pair: Between<L, D>, jump: L) -> L;
}

/// The pair terms there are.
#[derive(Clone, Copy, Debug)]
pub(super) enum AnyFlux {
    Delta(DeltaFlux),
    Riemann(RiemannFlux),
    Edac(EdacFlux),
    Linear(LinearFlux),
}

/// Calls `$body` with `$flux` bound to the pair terms: the choice is made once, outside every loop.
macro_rules! with_flux {
    ($any:expr, $flux:ident => $body:expr) => {
        match $any {
            AnyFlux::Delta($flux) => $body,
            AnyFlux::Riemann($flux) => $body,
            AnyFlux::Edac($flux) => $body,
            AnyFlux::Linear($flux) => $body,
        }
    };
}

/// Everything a method chooses about the shared parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub flux: AnyFlux,
    pub state: EquationOfState,
    /// Speed of sound over the reference speed of the case; none where `state` has its own.
    pub sound_factor: Option<f64>,
    pub start: StartPressure,
    pub walls: WallPressure,
    pub slip: WallSlip,
    pub suction: WallSuction,
    pub stepping: Stepping,
    /// Share of `h/(c0 + v)` that a sound step takes.
    pub acoustic_courant: f64,
    /// Strength of artificial viscosity, dimensionless.
    pub alpha: f64,
    /// Strength of the acoustic damper; 0 for none.
    pub damping: f64,
    /// What diffusion leaves alone.
    pub diffusion: Diffusion,
    /// Strength of the shift over that of Sun et al.; 0 for none.
    pub shifting: f64,
    /// Share of a lack of volume that is closed while the fastest fluid moves by `h`; 0 for none.
    pub volume_control: f64,
    pub density_reset: DensityReset,
    /// Steps from one new density to the next.
    pub density_reset_every: u64,
    pub search: Search,
}

/// Pairs reach so much farther than the kernel, in smoothing lengths: a list lasts for one step. In a step of `0.25 h/U` the
/// fastest particles move a quarter of `h`; two that approach each other from farther away than that have a weight below 1 % of
/// the largest when they are missed, and are missed from both sides.
const SKIN: f64 = 0.1;

/// Where the guard of walls holds fluid, in spacings off the face.
const AT_FIRST_LINE: f64 = -0.5;

/// Steps after which particles are numbered anew. The fastest move by a quarter of a smoothing length in a step: by ten neighbourhoods or so
/// meanwhile, and most far less.
const ORDER_EVERY: u64 = 64;

/// A weakly compressible method in sound steps; the constructors are in the files of the methods.
///
/// Sources: Zhang, Rezavand & Hu, J. Comput. Phys. 404 (2020) 109135 (steps); Adami, Hu & Adams, J. Comput. Phys. 231 (2012)
/// 7057 and English et al., Comput. Part. Mech. 9 (2022) 911 (walls); Sun et al., Comput. Methods Appl. Mech. Eng. 315 (2017) 25
/// (shifting).
///
/// During a step the particles are records that sums over pairs read eight at a time. A sum reads one set of them and writes the
/// other, so that a sound step is two passes: velocities at the middle, densities at the end. Between steps they are room: for the search
/// of pairs, and behind a step for the state before it, which is there to be taken back.
pub struct Acoustic<K, const D: usize> {
    kernel: K,
    medium: Medium<D>,
    plan: Plan,
    set: InstructionSet,
    lattice: Lattice,
    near: Neighbors<D>,
    walls: DummyWalls<D>,
    /// Smoothing lengths of all rows and nobody, m; empty where they are all equal.
    lengths: Vec<f64>,
    /// Of all rows, and nobody.
    place: Vec<Place>,
    /// Positions, velocities and pressures in the middle of a sound step; of all rows, and nobody. Before the first sound step: shifts.
    /// Behind the last one: positions and velocities before the step.
    middle: Vec<Record>,
    /// Positions, velocities and densities at its end. Behind the last one: the other columns before the step, see [`settle`](Self::settle).
    end: Vec<Record>,
    bulk: Vec<Bulk>,
    /// Of all rows and nobody.
    found: Vec<Finding<D>>,
    before: Before<D>,
    /// Gradient of density that diffusion leaves alone, kg/m⁴, of all rows and nobody; empty where it is the same everywhere.
    gradient: Vec<Vector<D>>,
    /// The kernel of each row, for pair terms with linear kernels.
    linear: Vec<LinearKernel<D>>,
    /// Densities about to replace those of the particles, kg/m³.
    fresh: Vec<f64>,
    /// Mean density of a domain that fluid fills and cannot leave, kg/m³; none for others.
    closed: Option<f64>,
    /// Walls that go along with their velocity, by [`Particles::body`]; the others stay.
    going: Vec<u16>,
    /// Steps since densities were set anew.
    since_reset: u64,
    /// Steps since particles were numbered anew.
    since_order: u64,
}

impl<K: Kernel<D>, const D: usize> Acoustic<K, D> {
    pub(super) fn of(kernel: K, medium: Medium<D>, plan: Plan) -> Self {
        Self {
            kernel,
            medium,
            plan,
            set: InstructionSet::of_this_machine(),
            lattice: Lattice::of(kernel, medium.spacing, medium.spacing, medium.rest_density),
            near: Neighbors::new(),
            walls: DummyWalls::new(plan.walls, plan.slip, plan.suction),
            lengths: Vec::new(),
            place: Vec::new(),
            middle: Vec::new(),
            end: Vec::new(),
            bulk: Vec::new(),
            found: Vec::new(),
            before: Before::default(),
            gradient: Vec::new(),
            linear: Vec::new(),
            fresh: Vec::new(),
            closed: None,
            going: Vec::new(),
            since_reset: 0,
            since_order: 0,
        }
    }

    /// The same method with other pair terms.
    pub(super) fn with_flux(mut self, flux: AnyFlux) -> Self {
        self.plan.flux = flux;
        self
    }

    /// The same method with other instructions than the best of this machine: the same bits, at another speed.
    pub fn on(mut self, set: InstructionSet) -> Self {
        self.set = set;
        self
    }

    /// What sums over one set of records are made of.
    fn pairs<'a>(&'a self, records: &'a [Record]) -> Pairs<'a, K, D> {
        let lengths = if self.lengths.is_empty() { None } else { Some(self.lengths.as_slice()) };
        Pairs { set: self.set, kernel: self.kernel, near: &self.near, records, lengths }
    }

    /// `1/ρ0` on the scale where the lattice differentiates linear fields exactly, m³/kg: a mass times this is a volume.
    fn volume_scale(&self) -> f64 {
        1.0 / (self.lattice.slope_of_linear::<D>() * self.plan.state.rest)
    }

    /// Pairs, for positions that may have moved far, and room for what belongs to each particle.
    fn search(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        let support = self.kernel.radius() + SKIN;
        domain.refresh(p, support * p.h_max());
        match self.plan.walls {
            WallPressure::Adami => self.near.list(p, support, self.plan.search, BehindWalls::Fluid, &mut self.end)?,
            WallPressure::GhostNodes => {
                self.near.list(p, support, self.plan.search, BehindWalls::Everyone, &mut self.end)?;
                self.near.follow(p);
            }
        }
        self.walls.search(self.kernel, &self.near, p, self.medium.spacing, self.kernel.radius());
        take_lengths(p, &mut self.lengths);
        self.make_room(p);
        Ok(())
    }

    /// Room for what belongs to each particle during a step.
    fn make_room(&mut self, p: &Particles<D>) {
        let rows = p.len() + 1;
        self.place.resize(rows, Place::Dry);
        self.place[p.len()] = Place::Dry;
        for records in [&mut self.middle, &mut self.end] {
            records.resize(rows, NOBODY);
            records[p.len()] = NOBODY;
        }
        self.bulk.resize(p.owned(), Bulk::default());
        self.found.resize(rows, Finding::NOTHING);
    }

    /// Which particles belong to the free surface or to foam in the step `dt` (s) that begins, the surface's normal, and how fluid stretches; leaves
    /// positions, normals and densities in `end`, velocities in `middle`.
    fn surface(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let (x, v, mass, kind, owned) = (&p.x, &p.v, &p.mass, &p.kind, p.owned());
        sweep(&mut self.middle[..p.x.len()], |a| record(x[a], v[a], 0.0, mass[a], kind[a] != Kind::Fluid));
        let (mut end, mut found) = (std::mem::take(&mut self.end), std::mem::take(&mut self.found));
        let looking = Looking {
            pairs: self.pairs(&self.middle),
            scale: self.volume_scale(),
            threshold: self.lattice.surface_threshold() * D as f64,
            lattice: self.lattice,
            weighs: matches!(self.plan.flux, AnyFlux::Delta(_)),
            dt,
            gap: p.h_max() * self.lattice.slope_of_gap() / self.lattice.slope_of_linear::<D>(),
            kind: &p.kind,
            layer: &p.layer,
            density: &p.density,
            mass: &p.mass,
            h: &p.h,
        };
        sweep_lanes2(self.set, &mut end[..owned], &mut found[..owned], &looking);
        sweep(&mut p.surface[..owned], |a| u8::from(kind[a] == Kind::Fluid && end[a].v::<D>() != Vector::ZERO));
        domain.refresh_records(&mut end);
        domain.refresh_column(&mut p.surface);
        domain.refresh_column(&mut found[..p.len()]);
        (self.end, self.found) = (end, found);
    }

    /// Artificial viscosity between the velocities in `middle`, once a step: `α h c0 Σ_b V_b d_ab ∇_a W_ab/r²` with what a linear flow explains of the
    /// approach `d_ab` left out (see [`Damping`]), and of `α h c0` the `2 (D + 2) ν` that the viscosity of the fluid does.
    ///
    /// The acceleration, m/s², stands where the force on walls does, which fluid has no use for, until [`settle`](Self::settle).
    fn damp(&self, p: &mut Particles<D>) {
        let own = 2.0 * (D as f64 + 2.0) * self.medium.viscosity / self.plan.state.rest;
        let strength = [self.plan.alpha * self.plan.state.sound, own];
        p.force.fill(Vector::ZERO);
        if strength[0] * p.h_max() > own {
            let (pairs, stretch, owned, h) = (self.pairs(&self.middle), &self.found[..], p.owned(), &p.h);
            sweep_lanes(self.set, &mut p.force[..owned], &Damping { pairs, stretch, scale: self.volume_scale(), strength, h });
        }
    }

    /// Finds who is near the free surface, and how particles are shifted over a step `dt`: not those of the surface, those near it
    /// along it only. The density goes with its gradient, `δρ = ∇ρ·δx`.
    fn shift(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        let (mut middle, mut place) = (std::mem::take(&mut self.middle), std::mem::take(&mut self.place));
        let shifting = Shifting {
            pairs: self.pairs(&self.end),
            scale: self.volume_scale(),
            plan: &self.plan,
            lattice: self.lattice,
            spacing: self.medium.spacing,
            looked: &self.found,
            fastest: fastest(p),
            dt,
            kind: &p.kind,
            h: &p.h,
        };
        sweep_lanes2(self.set, &mut middle[..owned], &mut place[..owned], &shifting);
        if let (Some(before), Some(now)) = (self.closed, closed_density(p, domain)) {
            update(&mut middle[..owned], |_, record| {
                let shift = Shift::<D>::from_record(record);
                *record = Shift { change: shift.change - (now - before), ..shift }.to_record();
            });
        }
        for &a in self.walls.wet() {
            place[a as usize] = Place::Wet;
        }
        domain.refresh_column(&mut place[..p.len()]);
        (self.middle, self.place) = (middle, place);
    }

    /// The first half of a sound step from the state of `p`, shifted: `x^{1/2}`, `ρ^{1/2}` and their pressure. Walls have their velocity of the time
    /// `late` behind the middle of the step, s.
    fn set_out(&mut self, p: &Particles<D>, domain: &Domain<D>, half: f64, late: f64) {
        let (state, damping, place) = (self.plan.state, self.plan.damping * self.plan.state.sound, &self.place);
        let owned = p.owned();
        update2(&mut self.middle[..owned], &mut self.bulk, |a, middle, bulk| {
            let Shift { by, change, pull, least, weight } = Shift::from_record(middle);
            *middle = match p.kind[a] {
                Kind::Fluid => {
                    (bulk.pull, bulk.least, bulk.weight) = (pull, least as f32, weight as f32);
                    let density = relieved(p.density[a] + change, p.density_rate[a], place[a], state.rest);
                    bulk.density = dilated(density, half * p.density_rate[a], place[a], state.rest);
                    let damper = if place[a] == Place::Inside { damping * p.h[a] * bulk.compression } else { 0.0 };
                    record(p.x[a] + by + half * p.v[a], p.v[a], bulk.pressing(&state) + damper, p.mass[a], false)
                }
                Kind::Wall if self.going.contains(&p.body[a]) => {
                    let v = p.v[a] + late * p.acceleration[a];
                    record(p.x[a] + half * v, p.v[a], 0.0, p.mass[a], true)
                }
                Kind::Wall | Kind::Lost => record(p.x[a], p.v[a], 0.0, p.mass[a], true),
            };
        });
        domain.refresh_records(&mut self.middle);
    }

    /// Gives walls their pressure, and in viscous flow the velocity that rubs.
    fn press_walls(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let mut walls = std::mem::replace(&mut self.walls, DummyWalls::new(self.plan.walls, self.plan.slip, self.plan.suction));
        let pairs = self.pairs(&self.middle);
        walls.extrapolate(pairs, p, Liquid { state: self.plan.state, gravity: self.medium.gravity });
        if self.medium.viscosity > 0.0 {
            walls.mirror_velocity(pairs, p);
        }
        self.walls = walls;
        for (a, pressure) in self.walls.pressures() {
            *self.middle[a].value_mut::<D>() = pressure;
        }
        if self.medium.viscosity > 0.0 {
            for (a, velocity) in self.walls.velocities() {
                self.middle[a].set_v(velocity);
            }
        }
        domain.refresh_records(&mut self.middle);
    }

    /// `v^{n+1} = vⁿ + Δt a(x^{n+1/2}, ρ^{n+1/2}, vⁿ)`, then `x^{n+1} = x^{n+1/2} + drift v^{n+1}`; adds the force on walls, times `share`.
    /// The steps: `Δt`, `drift`, `share`, and how late walls are behind the middle of the step, s.
    fn kick(&mut self, p: &mut Particles<D>, domain: &Domain<D>, step: [f64; 4]) {
        if matches!(self.plan.flux, AnyFlux::Linear(_)) {
            self.linear_kernels(p, domain, false);
        }
        let owned = p.owned();
        let mut end = std::mem::take(&mut self.end);
        with_flux!(self.plan.flux, flux => {
            let kick = Kick {
                pairs: self.pairs(&self.middle),
                flux: Flux::<D>::with_sound(flux, self.plan.state.sound),
                slope: 1.0 / self.lattice.slope_of_linear::<D>(),
                linear: &self.linear,
                place: &self.place,
                bulk: &self.bulk,
                state: self.plan.state,
                gravity: self.medium.gravity,
                step,
                kind: &p.kind,
                body: &p.body,
                going: &self.going,
                v: &p.v,
                acceleration: &p.acceleration,
                mass: &p.mass,
                h: &p.h,
            };
            sweep_sums(self.set, &mut end[..owned], &mut p.force[..owned], &kick);
        });
        domain.refresh_records(&mut end);
        self.end = end;
    }

    /// `ρ^{n+1} = ρ^{n+1/2} + Δt/2 (dρ/dt)^{n+1}`, and the first half of the next step, `lead` long: positions, densities and pressures
    /// of its middle. Behind the `last` one the pressure is that of the density alone.
    fn dilate(&mut self, p: &Particles<D>, domain: &Domain<D>, half: f64, last: bool) {
        if matches!(self.plan.flux, AnyFlux::Linear(_)) {
            self.linear_kernels(p, domain, true);
        }
        self.gradients(p, domain);
        let owned = p.owned();
        let (mut middle, mut bulk) = (std::mem::take(&mut self.middle), std::mem::take(&mut self.bulk));
        let state = self.plan.state;
        let same = if self.plan.diffusion == Diffusion::Molteni {
            Vector::ZERO
        } else {
            gradient_at_rest(&state, self.medium.gravity, state.rest)
        };
        with_flux!(self.plan.flux, flux => {
            let dilation = Dilation {
                pairs: self.pairs(&self.end),
                flux: Flux::<D>::with_sound(flux, state.sound),
                slope: 1.0 / self.lattice.slope_of_linear::<D>(),
                linear: &self.linear,
                gradients: if self.gradient.is_empty() { None } else { Some(&self.gradient) },
                gradient: same,
                place: &self.place,
                state,
                step: [half, if last { 0.0 } else { half }, self.plan.damping * state.sound],
                last,
                kind: &p.kind,
                body: &p.body,
                going: &self.going,
                mass: &p.mass,
                h: &p.h,
            };
            sweep_sums(self.set, &mut middle[..owned], &mut bulk, &dilation);
        });
        domain.refresh_records(&mut middle);
        (self.middle, self.bulk) = (middle, bulk);
    }

    /// Sets fluid that came as far as the first line of a wall back on it, and takes its velocity into the wall, which the wall feels. Pressure alone does
    /// not stop a film whose density has fallen below that at rest: it has a gap to remember. On the face, half a spacing before the line, fluid that rests
    /// on an oblique wall would be disturbed: its line is a staircase.
    fn guard(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let (owned, spacing) = (p.owned(), self.medium.spacing);
        // Of fluid of the surface, and where walls pull, nobody has looked whether a wall is near.
        let beside_walls = |a: usize| {
            let may_be = self.plan.suction == WallSuction::Full
                || matches!(self.place[a], Place::Surface | Place::Foam | Place::Clash)
                || self.bulk[a].least == 0.0;
            may_be && p.kind[a] == Kind::Fluid
        };
        let guarded = |a: usize| {
            let mut moved = Guarded::moved(self.middle[a].x(), self.middle[a].v());
            for &b in self.near.of(a) {
                let b = b as usize;
                let normal = self.found[b].normal();
                if p.kind[b] == Kind::Wall && p.layer[b] == 1 && normal != Vector::ZERO {
                    moved.meet(b as u32, (self.middle[b].x(), p.v[b]), normal, spacing, AT_FIRST_LINE);
                }
            }
            (moved.wall != NO_WALL).then_some((a, moved))
        };
        let came_through: Vec<_> = (0..owned).into_par_iter().filter(|&a| beside_walls(a)).filter_map(guarded).collect();
        for (a, moved) in came_through {
            self.middle[a].0[..D].copy_from_slice(&moved.x.0);
            self.middle[a].set_v(moved.v);
            if dt > 0.0 {
                p.force[domain.parent(moved.wall as usize, owned)] += p.mass[a] / dt * moved.taken;
            }
        }
        domain.refresh_records(&mut self.middle);
    }

    /// Gives `p` the state that the last sound step left in `middle`, and keeps the one before it: `x` and `v` in their places there; in `end`
    /// density as what a record carries, acceleration as its velocity, rate of density and pressure as the first two numbers. Walls have gone along in
    /// `middle`; in `p` the driver moves them behind the step, but within it (`dt` zero) they are where the fluid finds them.
    fn settle(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let (rest, bulk) = (self.plan.state.rest, &self.bulk);
        let kind = &p.kind;
        update(&mut p.force, |a, force| *force = if kind[a] == Kind::Fluid { Vector::ZERO } else { *force });
        columns(p, &mut self.middle, &mut self.end).for_each(
            |(block, (kind, x, v, density, pressure, acceleration, rate, middle, end))| {
                for i in 0..x.len() {
                    end[i].set_v(acceleration[i]);
                    [end[i].0[0], end[i].0[1]] = [rate[i], pressure[i]];
                    *end[i].value_mut::<D>() = density[i];
                    let (before, now) = ((x[i], v[i]), (middle[i].x(), middle[i].v()));
                    match kind[i] {
                        Kind::Fluid => {
                            if dt > 0.0 {
                                acceleration[i] = (now.1 - v[i]) / dt;
                            }
                            (x[i], v[i]) = now;
                            let bulk = &bulk[block * BLOCK + i];
                            (pressure[i], density[i], rate[i]) = (middle[i].value::<D>(), bulk.density, bulk.rate);
                        }
                        Kind::Wall => {
                            (pressure[i], density[i]) = (0.0, rest);
                            if dt == 0.0 {
                                x[i] = now.0;
                            }
                        }
                        Kind::Lost => {}
                    }
                    middle[i].0[..D].copy_from_slice(&before.0.0);
                    middle[i].set_v(before.1);
                }
            },
        );
        for (a, pressure) in self.walls.pressures() {
            (p.pressure[a], p.density[a]) = (pressure, self.plan.state.density(pressure));
        }
        self.before.settled = true;
        follow(p, domain);
    }

    /// Gives `p` the state back that it had before [`settle`](Self::settle), and `middle` the one that it got there.
    fn unsettle(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        columns(p, &mut self.middle, &mut self.end).for_each(|(_, (_, x, v, density, pressure, acceleration, rate, middle, end))| {
            for i in 0..x.len() {
                let now = (x[i], v[i]);
                (x[i], v[i], acceleration[i]) = (middle[i].x(), middle[i].v(), end[i].v());
                ([rate[i], pressure[i]], density[i]) = ([end[i].0[0], end[i].0[1]], end[i].value::<D>());
                middle[i].0[..D].copy_from_slice(&now.0.0);
                middle[i].set_v(now.1);
            }
        });
        self.before.settled = false;
        follow(p, domain);
    }

    /// Linear kernels of the fluid at the positions of `end`, else of `middle`, over fluid and walls. Walls go on where there are no
    /// more particles: theirs are not corrected.
    fn linear_kernels(&mut self, p: &Particles<D>, domain: &Domain<D>, at_end: bool) {
        let records = if at_end { &self.end } else { &self.middle };
        let (near, kernel, rest) = (&self.near, self.kernel, self.plan.state.rest);
        self.linear.resize(p.len(), LinearKernel::PLAIN);
        sweep(&mut self.linear[..p.owned()], |a| {
            if !p.is_fluid(a) {
                return LinearKernel::PLAIN;
            }
            let mut moments = MovingMoments::alone(p.mass[a] / rest * kernel.w(0.0, p.h[a]));
            for &b in near.of(a) {
                let b = b as usize;
                let (y, volume) = (records[b].x::<D>() - records[a].x(), p.mass[b] / rest);
                let (r, h) = (y.norm(), 0.5 * (p.h[a] + p.h[b]));
                moments.add(y, volume * kernel.w(r, h), volume * kernel.dw_over_r(r, h));
            }
            moments.kernel()
        });
        domain.refresh_column(&mut self.linear);
    }

    /// New densities, where the plan wants them after this step.
    fn reset_density(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        self.since_reset += 1;
        if self.plan.density_reset == DensityReset::None || self.since_reset < self.plan.density_reset_every {
            return;
        }
        self.since_reset = 0;
        self.settle(p, domain, 0.0);
        self.near.follow(p);
        let (near, kernel, reset, owned) = (&self.near, self.kernel, self.plan.density_reset, p.owned());
        self.fresh.resize(owned, 0.0);
        sweep(&mut self.fresh, |a| if p.is_fluid(a) { new_density(kernel, near, p, reset, a) } else { p.density[a] });
        self.unsettle(p, domain);
        for (a, &density) in self.fresh.iter().enumerate().filter(|(a, _)| p.kind[*a] == Kind::Fluid) {
            self.bulk[a].density = density;
            *self.middle[a].value_mut::<D>() = self.bulk[a].pressure(&self.plan.state);
        }
        domain.refresh_records(&mut self.middle);
    }

    /// The gradient of density that diffusion leaves alone, where it differs from place to place.
    fn gradients(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let (state, gravity) = (self.plan.state, self.medium.gravity);
        let (mut gradient, owned) = (std::mem::take(&mut self.gradient), p.owned());
        match (self.plan.diffusion, state.law) {
            (Diffusion::Molteni, _) | (Diffusion::Fourtakas, PressureLaw::Linear) => gradient.clear(),
            (Diffusion::Fourtakas, PressureLaw::Tait) => {
                gradient.resize(p.len() + 1, Vector::ZERO);
                sweep(&mut gradient[..owned], |a| gradient_at_rest(&state, gravity, self.end[a].value::<D>()));
            }
            (Diffusion::Antuono, _) => {
                gradient.resize(p.len() + 1, Vector::ZERO);
                let slopes =
                    DensitySlope { pairs: self.pairs(&self.end), scale: self.volume_scale(), state, gravity, kind: &p.kind, h: &p.h };
                sweep_lanes(self.set, &mut gradient[..owned], &slopes);
            }
        }
        if !gradient.is_empty() {
            domain.refresh_column(&mut gradient[..p.len()]);
        }
        self.gradient = gradient;
    }

    /// The longest sound step, s: `C h/((c0 + U) max(1, α2))`; a damper stronger than one is stiffer than sound.
    fn sound_step(&self, p: &Particles<D>) -> f64 {
        let stiffness = self.plan.damping.max(1.0);
        self.plan.acoustic_courant * p.h_min() / ((self.plan.state.sound + fastest(p)) * stiffness)
    }
}

/// Kinds, positions, velocities, densities, pressures, accelerations and rates of density of a block, with the records of the middle and the
/// end.
type Columns<'a, const D: usize> = (
    &'a [Kind],
    &'a mut [Vector<D>],
    &'a mut [Vector<D>],
    &'a mut [f64],
    &'a mut [f64],
    &'a mut [Vector<D>],
    &'a mut [f64],
    &'a mut [Record],
    &'a mut [Record],
);

/// The real rows of the columns that a step changes, block by block.
fn columns<'a, const D: usize>(
    p: &'a mut Particles<D>,
    middle: &'a mut [Record],
    end: &'a mut [Record],
) -> impl IndexedParallelIterator<Item = (usize, Columns<'a, D>)> {
    let owned = p.owned();
    let kind = p.kind[..owned].par_chunks(BLOCK);
    let x = p.x[..owned].par_chunks_mut(BLOCK);
    let v = p.v[..owned].par_chunks_mut(BLOCK);
    let density = p.density[..owned].par_chunks_mut(BLOCK);
    let pressure = p.pressure[..owned].par_chunks_mut(BLOCK);
    let acceleration = p.acceleration[..owned].par_chunks_mut(BLOCK);
    let rate = p.density_rate[..owned].par_chunks_mut(BLOCK);
    let (middle, end) = (middle[..owned].par_chunks_mut(BLOCK), end[..owned].par_chunks_mut(BLOCK));
    (kind, x, v, density, pressure, acceleration, rate, middle, end).into_par_iter().enumerate()
}

/// What is left, at the end of a sound step, of a density that changes at `rate`: in foam that at rest, kg/m³ and kg/(m³ s). The air is everywhere within a
/// spacing of a drop, and relieves it of pressure within `Δx/c0`, which is less than a sound step. Sums over pairs know nothing of that: drops that meet
/// would store the energy of their approach in density, part as fast as they met, and be a gas; and foam that comes together would resist as if it
/// were full. Closer than a spacing they stop each other, and are relieved once they have.
#[inline(always)]
fn relieved(density: f64, rate: f64, place: Place, rest: f64) -> f64 {
    if place == Place::Foam || (place == Place::Clash && rate <= 0.0) { rest } else { density }
}

/// A density after a change. A free surface bears no tension: liquid there parts instead of stretching, so its density is never below
/// that at rest.
#[inline(always)]
fn dilated(density: f64, change: f64, place: Place, rest: f64) -> f64 {
    let density = density + change;
    if matches!(place, Place::Surface | Place::Foam | Place::Clash) { density.max(rest) } else { density }
}

/// Mean density of a domain that is periodic along every axis and full of fluid, kg/m³. Neither its mass nor its volume changes, so that
/// its mean density does not; the sum of `dρ/dt`, which follows the arrangement, makes it climb while particles leave a lattice.
fn closed_density<const D: usize>(p: &Particles<D>, domain: &Domain<D>) -> Option<f64> {
    let full = domain.periodic == [true; D] && (0..p.owned()).all(|a| p.is_fluid(a) && p.surface[a] == 0);
    full.then(|| sum(p.owned(), |a| p.mass[a] * p.density[a]) / sum(p.owned(), |a| p.mass[a]))
}

/// Greatest speed of fluid, m/s.
fn fastest<const D: usize>(p: &Particles<D>) -> f64 {
    largest(p.owned(), |a| if p.is_fluid(a) { p.v[a].norm_squared() } else { 0.0 }).max(0.0).sqrt()
}

impl<K: Kernel<D>, const D: usize> Scheme<D> for Acoustic<K, D> {
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        self.first_state(p, domain)
    }

    /// The shortest of `C h/U`, `C √(h/a)` and `h²/(8ν)`: pairs, shift and viscosity. `U` is the greatest speed, at least a
    /// fortieth of the speed of sound, so that a step has a score of sound steps at most. Single stepping: one sound step.
    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let (h, courant) = (p.h_min(), self.medium.courant);
        let speed = fastest(p).max(self.plan.state.sound / 40.0);
        let push = largest(p.owned(), |a| if p.is_fluid(a) { p.acceleration[a].norm_squared() } else { 0.0 }).max(0.0).sqrt();
        let viscosity = self.medium.viscosity / self.medium.rest_density;
        let flow = StepLimit::new(courant * h / speed, "speed")
            .min(StepLimit::new(courant * (h / push).sqrt(), "acceleration"))
            .min(StepLimit::new(0.125 * h * h / viscosity, "viscosity"));
        match self.plan.stepping {
            Stepping::Dual => flow,
            Stepping::Single => flow.min(StepLimit::new(self.sound_step(p), "sound")),
        }
    }

    /// In the order of cells, now and then: what a sum reads of neighbours then lies near each other, however the flow has mixed them.
    fn renumber(&mut self, p: &mut Particles<D>) {
        self.since_order += 1;
        if self.since_order < ORDER_EVERY {
            return;
        }
        self.since_order = 0;
        let bulk = &mut self.bulk;
        self.near.in_order(p.owned(), |rows| {
            let order = Order::new(rows);
            p.reorder(&order);
            order.apply(bulk);
        });
    }

    fn walls_that_go(&mut self, bodies: Vec<u16>) {
        self.going = bodies;
    }

    fn takes_back(&self) -> bool {
        true
    }

    fn take_back(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        if self.before.settled {
            self.unsettle(p, domain);
        }
        self.before.give_back(p, domain);
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        // (1) pairs, free surface, shift: once a step
        self.before.read(p, domain);
        phases.measure("search", || self.search(p, domain))?;
        phases.measure("surface", || self.surface(p, domain, dt));
        phases.measure("damping", || self.damp(p));
        phases.measure("shifting", || self.shift(p, domain, dt));

        // (2) pressure and density in sound steps of position-Verlet (Zhang, Rezavand & Hu 2020):
        //     x^{n+1/2} = x^n + Δt/2 v^n, ρ^{n+1/2} = ρ^n + Δt/2 (dρ/dt)^n, p^{n+1/2}, the first one here, the others in `dilate`
        let count = (dt / self.sound_step(p)).ceil().max(1.0) as u64;
        let share = 1.0 / count as f64;
        let half = 0.5 * dt * share;
        // A wall has its mean velocity in the middle of the step, and none that jumps from step to step: fluid would hear it.
        phases.measure("motion", || self.set_out(p, domain, half, -0.5 * dt));
        for sound_step in 1..=count {
            phases.measure("walls", || self.press_walls(p, domain));
            // v^{n+1} = v^n + Δt a^{n+1/2}, x^{n+1} = x^{n+1/2} + Δt/2 v^{n+1}
            let late = (sound_step as f64 * share - 0.5) * dt;
            phases.measure("forces", || self.kick(p, domain, [2.0 * half, half, share, late]));
            // ρ^{n+1} = ρ^{n+1/2} + Δt/2 (dρ/dt)^{n+1}
            phases.measure("density", || self.dilate(p, domain, half, sound_step == count));
        }

        // (3) nothing goes through walls; now and then, density from the neighbourhood
        phases.measure("walls", || self.guard(p, domain, dt));
        phases.measure("density", || self.reset_density(p, domain));

        // (4) what others read: the pressure of the density
        phases.measure("walls", || self.press_walls(p, domain));
        phases.measure("motion", || self.settle(p, domain, dt));
        Ok(StepReport { evaluations: Some(count as usize), listed_pairs: Some(self.near.pairs()), ..StepReport::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_found_about_a_particle_is_told_again() {
        let fluid = Finding::of_fluid(&[Vector([0.5, 1.0]), Vector([-1.0, -0.5])], 1.5);
        assert_eq!([fluid.stretch(0, 0), fluid.stretch(0, 1), fluid.stretch(1, 1), fluid.weight()], [0.5, 0.0, -0.5, 1.5]);
        // A pull of 0.5 along one axis and a push along the other; 1e-15: a root. What turns as a whole is not strained.
        assert!((fluid.strain_rate() - 0.5_f64.sqrt()).abs() < 1e-15);
        let sheared = Finding::of_fluid(&[Vector([0.0, 2.0]), Vector([0.0, 0.0])], 1.0);
        assert!((sheared.strain_rate() - 2.0_f64.sqrt()).abs() < 1e-15);
        assert_eq!(Finding::<3>::NOTHING.strain_rate(), 0.0);
        let foam = [1.5, 0.0, -1.0].map(|weight| Finding::of_fluid(&[Vector::<2>::ZERO; 2], weight).foam());
        assert_eq!(foam, [None, Some(Place::Foam), Some(Place::Clash)]);
        assert_eq!(Finding::of_wall(Vector::<3>::unit(2)).normal(), Vector::unit(2));
    }
}
