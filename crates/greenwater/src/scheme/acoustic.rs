//! What the weakly compressible methods of today share: walls, the free surface, shifting, and a step made of sound steps.
//!
//! A method brings its pair terms (`Flux`); this file moves the particles.

pub(super) mod relative;
mod start;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Medium, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::math::Vector;
use crate::neighbors::{Neighbors, Pair, Search};
use crate::particles::{Kind, Particles};
use crate::physics::consistency::{DensityReset, LinearKernel, MovingMoments, new_density};
use crate::physics::correction::renormalisation;
use crate::physics::diffusion::{Diffusion, gradient_at_rest};
use crate::physics::lattice::Lattice;
use crate::physics::shifting::{pair_weight, shift, volume_pull};
use crate::physics::state::EquationOfState;
use crate::physics::viscosity::{Tensor, contract};
use crate::sweep::{largest, sweep, sweep2};
use crate::time::{Phases, StepLimit};
use crate::walls::dummy::{DummyWalls, Liquid, WallPressure, WallSlip, WallSuction};

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
#[derive(Clone, Copy, Debug)]
pub(super) struct Side<const D: usize> {
    /// Velocity, m/s.
    pub v: Vector<D>,
    /// Velocity in the viscous force, m/s.
    pub u: Vector<D>,
    /// Density, kg/m³.
    pub density: f64,
    /// Pressure, Pa.
    pub pressure: f64,
    /// Away from the free surface.
    pub inside: bool,
}

/// Where the two particles of a pair are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Between<const D: usize> {
    /// `x_a − x_b`, m.
    pub x_ab: Vector<D>,
    /// Distance, m.
    pub r: f64,
    /// Mean smoothing length, m.
    pub h: f64,
    /// `W'/r`, m⁻ᴰ⁻², on the scale where the lattice differentiates linear fields exactly.
    pub dw: f64,
    /// `∇_a W_ab` and `∇_b W_ba`, m⁻ᴰ⁻¹: `±dw x_ab`, or those of linear kernels where the pair terms ask for them.
    pub grad: [Vector<D>; 2],
    /// Whether `b` belongs to a wall.
    pub wall: bool,
}

/// The pair terms of a method.
pub(super) trait Flux<const D: usize>: Copy + Send + Sync {
    /// Whether gradients are those of linear kernels.
    const LINEAR: bool = false;

    /// The same terms for the speed of sound `sound`, m/s.
    fn with_sound(self, sound: f64) -> Self;

    /// Force of `b` on the fluid particle `a` over both masses, m/(kg s²).
    fn force(self, a: Side<D>, b: Side<D>, pair: Between<D>) -> Vector<D>;

    /// Rate of the density of the fluid particle `a` over the mass of `b`, m⁻ᴰ s⁻¹. `jump` is the part of `ρ_a − ρ_b` that
    /// diffuses, kg/m³.
    fn rate(self, a: Side<D>, b: Side<D>, pair: Between<D>, jump: f64) -> f64;
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

/// Where a particle is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Out of reach of the free surface.
    Inside,
    /// Within reach of a particle of the free surface.
    Near,
    /// On the free surface.
    Surface,
}

/// What shifting does to a particle.
#[derive(Clone, Copy, Debug)]
struct Shift<const D: usize> {
    /// The move, m.
    by: Vector<D>,
    /// Change of density that goes with it, kg/m³.
    change: f64,
    /// Rate of density that draws dilated fluid together, kg/(m³ s).
    pull: f64,
    place: Place,
}

impl<const D: usize> Shift<D> {
    const NONE: Self = Self { by: Vector::ZERO, change: 0.0, pull: 0.0, place: Place::Inside };
}

/// Pairs reach so much farther than the kernel, in smoothing lengths: a list lasts for one step. In a step of `0.25 h/U` the
/// fastest particles move a quarter of `h`; two that approach each other from farther away than that have a weight below 1 % of
/// the largest when they are missed, and are missed from both sides.
const SKIN: f64 = 0.25;

/// A weakly compressible method in sound steps; the constructors are in the files of the methods.
///
/// Sources: Zhang, Rezavand & Hu, J. Comput. Phys. 404 (2020) 109135 (steps); Adami, Hu & Adams, J. Comput. Phys. 231 (2012)
/// 7057 and English et al., Comput. Part. Mech. 9 (2022) 911 (walls); Sun et al., Comput. Methods Appl. Mech. Eng. 315 (2017) 25
/// (shifting).
pub struct Acoustic<K, const D: usize> {
    kernel: K,
    medium: Medium<D>,
    plan: Plan,
    lattice: Lattice,
    near: Neighbors<D>,
    walls: DummyWalls<D>,
    place: Vec<Place>,
    /// Unit normal of surface particles, out of the fluid.
    normal: Vec<Vector<D>>,
    /// `L_a` of each row; zero where it does not exist.
    correction: Vec<Tensor<D>>,
    /// Gradient of density that diffusion leaves alone, kg/m⁴.
    gradient: Vec<Vector<D>>,
    shifts: Vec<Shift<D>>,
    /// Acceleration of fluid, m/s²; force on walls, N (N/m in 2D).
    push: Vec<Vector<D>>,
    /// Mean force on walls over the step, N (N/m in 2D).
    wall_force: Vec<Vector<D>>,
    /// Rate of density, kg/(m³ s).
    rate: Vec<f64>,
    /// The part of it that is compression, `−ρ0 ∇·v`, kg/(m³ s).
    compression: Vec<f64>,
    /// Velocity at the start of the step, m/s.
    v_before: Vec<Vector<D>>,
    /// The kernel of each row, for pair terms with linear kernels.
    linear: Vec<LinearKernel<D>>,
    /// Densities about to replace those of the particles, kg/m³.
    fresh: Vec<f64>,
    /// Steps since densities were set anew.
    since_reset: u64,
}

impl<K: Kernel<D>, const D: usize> Acoustic<K, D> {
    pub(super) fn of(kernel: K, medium: Medium<D>, plan: Plan) -> Self {
        Self {
            kernel,
            medium,
            plan,
            lattice: Lattice::of(kernel, medium.spacing, medium.spacing, medium.rest_density),
            near: Neighbors::new(),
            walls: DummyWalls::new(plan.walls, plan.slip, plan.suction),
            place: Vec::new(),
            normal: Vec::new(),
            correction: Vec::new(),
            gradient: Vec::new(),
            shifts: Vec::new(),
            push: Vec::new(),
            wall_force: Vec::new(),
            rate: Vec::new(),
            compression: Vec::new(),
            v_before: Vec::new(),
            linear: Vec::new(),
            fresh: Vec::new(),
            since_reset: 0,
        }
    }

    /// The same method with other pair terms.
    pub(super) fn with_flux(mut self, flux: AnyFlux) -> Self {
        self.plan.flux = flux;
        self
    }

    /// Pairs, for positions that may have moved far.
    fn search(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        let support = self.kernel.radius() + SKIN;
        domain.refresh(p, support * p.h_max());
        self.near.build(p, support, self.plan.search)?;
        self.walls.search(self.kernel, &self.near, p, self.medium.spacing, self.kernel.radius());
        Ok(())
    }

    /// Moves ghosts and pairs to the positions of now.
    fn follow(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        domain.follow(&mut p.x);
        self.near.follow(p);
    }

    /// Which particles belong to the free surface, its normal there, and `L_a`.
    ///
    /// A particle belongs to it where `Σ_b V_b (x_b − x_a)·∇_a W_ab`, walls included, is below the value half-way between the two
    /// outermost rows of a flat surface (Lee et al. 2008, with the threshold from the lattice), or where its neighbours are as
    /// one-sided as beside a void: that is a surface, too, and shifting must not fill it.
    fn surface(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        let (near, kernel, slope) = (&self.near, self.kernel, 1.0 / (self.lattice.slope_of_linear::<D>() * self.plan.state.rest));
        let (threshold, gap) =
            (self.lattice.surface_threshold(), p.h_max() * self.lattice.slope_of_gap() / self.lattice.slope_of_linear::<D>());
        let rows = p.len();
        self.place.resize(rows, Place::Inside);
        self.normal.resize(rows, Vector::ZERO);
        self.correction.resize(rows, [Vector::ZERO; D]);
        let owned = p.owned();
        let geometry = |a: usize| -> (Tensor<D>, Vector<D>) {
            let mut moments = [Vector::ZERO; D];
            let mut concentration = Vector::ZERO;
            near.for_each(a, |pair| {
                let grad_w = slope * p.mass[pair.b] * kernel.dw_over_r(pair.r, pair.h) * pair.x_ab;
                concentration += grad_w;
                for (row, along) in moments.iter_mut().zip(pair.x_ab.0) {
                    *row -= along * grad_w;
                }
            });
            (moments, concentration)
        };
        sweep2(&mut self.correction[..owned], &mut self.normal[..owned], |a| {
            if !p.is_fluid(a) {
                return ([Vector::ZERO; D], Vector::ZERO);
            }
            let (moments, concentration) = geometry(a);
            let trace: f64 = (0..D).map(|d| moments[d][d]).sum();
            let length = concentration.norm();
            // A normal of zero marks a particle off the surface; a particle without neighbours has no direction, any will do.
            let normal = match () {
                () if trace >= threshold * D as f64 && length * p.h[a] <= gap => Vector::ZERO,
                () if length > 0.0 => -concentration / length,
                () => Vector::unit(D - 1),
            };
            (renormalisation(&moments).unwrap_or([Vector::ZERO; D]), normal)
        });
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.surface[a] = u8::from(self.normal[a] != Vector::ZERO);
        }
        domain.refresh_column(&mut p.surface);
        domain.refresh_column(&mut self.normal);
        domain.refresh_column(&mut self.correction);
    }

    /// Finds who is near the free surface, and shifts particles over a step `dt`: not those of the surface, those near it along
    /// it only. The density goes with its gradient, `δρ = ∇ρ·δx`.
    fn shift(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let (near, kernel, spacing) = (&self.near, self.kernel, self.medium.spacing);
        let slope = 1.0 / (self.lattice.slope_of_linear::<D>() * self.plan.state.rest);
        let (normal, correction) = (&self.normal, &self.correction);
        let owned = p.owned();
        let (speed, Plan { shifting, volume_control, state, .. }) = (fastest(p), self.plan);
        self.shifts.resize(owned, Shift::NONE);
        sweep(&mut self.shifts, |a| {
            if !p.is_fluid(a) {
                return Shift::NONE;
            }
            if normal[a] != Vector::ZERO {
                return Shift { place: Place::Surface, ..Shift::NONE };
            }
            let (mut concentration, mut outward, mut gradient) = (Vector::ZERO, Vector::ZERO, Vector::ZERO);
            let whole = kernel.w(spacing, p.h[a]);
            let mut sum = p.mass[a] / state.rest * kernel.w(0.0, p.h[a]);
            near.for_each(a, |pair| {
                let b = pair.b;
                let w = kernel.w(pair.r, pair.h);
                let grad_w = slope * p.mass[b] * kernel.dw_over_r(pair.r, pair.h) * pair.x_ab;
                sum += p.mass[b] / state.rest * w;
                concentration += pair_weight(w / whole) * grad_w;
                gradient += (p.density[b] - p.density[a]) * grad_w;
                outward += w * normal[b];
            });
            let length = outward.norm();
            let (normal, place) = if length > 0.0 { (Some(outward / length), Place::Near) } else { (None, Place::Inside) };
            let by = shift(concentration, p.h[a], shifting * speed, dt, normal);
            let pull = match place {
                Place::Inside => state.rest * volume_pull(sum, p.h[a], speed, volume_control),
                Place::Near | Place::Surface => 0.0,
            };
            Shift { by, change: contract(&correction[a], gradient).dot(by), pull, place }
        });
        self.place.resize(p.len(), Place::Inside);
        for a in 0..owned {
            let Shift { by, change, place, .. } = self.shifts[a];
            self.place[a] = place;
            if p.kind[a] == Kind::Fluid {
                p.x[a] += by;
                p.density[a] += change;
            }
        }
        domain.refresh_column(&mut self.place);
        domain.refresh_column(&mut p.density);
        self.follow(p, domain);
    }

    /// Pressure of fluid by the equation of state and the acoustic damper, then of walls.
    ///
    /// The damper is the pressure of a bulk viscosity, `−α2 ρ0 c0 h ∇·v` (Sun, Pilloton, Antuono & Colagrossi 2023): it takes energy
    /// from sound and none from flow that keeps its volume. None within reach of the free surface, where `∇·v` misses neighbours.
    fn pressures(&mut self, p: &mut Particles<D>, domain: &Domain<D>, damping: f64) {
        let (state, damping) = (self.plan.state, damping * self.plan.state.sound);
        let owned = p.owned();
        self.compression.resize(owned, 0.0);
        let (kind, density, place, h, compression) = (&p.kind, &p.density, &self.place, &p.h, &self.compression);
        sweep(&mut p.pressure[..owned], |a| match kind[a] {
            Kind::Fluid if place[a] == Place::Inside => state.pressure(density[a]) + damping * h[a] * compression[a],
            Kind::Fluid => state.pressure(density[a]),
            Kind::Wall | Kind::Lost => 0.0,
        });
        domain.refresh_column(&mut p.pressure);
        self.walls.extrapolate(self.kernel, &self.near, p, domain, Liquid { state, gravity: self.medium.gravity });
    }

    /// Acceleration of fluid, and the force on walls, in `push`.
    fn forces<F: Flux<D>>(&mut self, flux: F, p: &Particles<D>) {
        let flux = flux.with_sound(self.plan.state.sound);
        let (near, kernel, slope, gravity) = (&self.near, self.kernel, 1.0 / self.lattice.slope_of_linear::<D>(), self.medium.gravity);
        let linear = &self.linear;
        let (place, viscous) = (&self.place, if self.medium.viscosity > 0.0 { &self.walls.velocity } else { &p.v });
        let side =
            |a: usize| Side { v: p.v[a], u: viscous[a], density: p.density[a], pressure: p.pressure[a], inside: place[a] == Place::Inside };
        self.push.resize(p.owned(), Vector::ZERO);
        sweep(&mut self.push, |a| {
            let mut sum = Vector::ZERO;
            match p.kind[a] {
                Kind::Fluid => {
                    let own = side(a);
                    near.for_each(a, |pair| {
                        if pair.r < self.kernel.radius() * pair.h {
                            let dw = slope * kernel.dw_over_r(pair.r, pair.h);
                            let wall = !p.is_fluid(pair.b);
                            let grad =
                                if F::LINEAR { linear_gradients(kernel, linear, a, &pair) } else { [dw * pair.x_ab, -dw * pair.x_ab] };
                            let between = Between { x_ab: pair.x_ab, r: pair.r, h: pair.h, dw, grad, wall };
                            sum += p.mass[pair.b] * flux.force(own, side(pair.b), between);
                        }
                    });
                    sum + gravity
                }
                Kind::Wall => {
                    let own = side(a);
                    near.for_each(a, |pair| {
                        if pair.r < self.kernel.radius() * pair.h && p.is_fluid(pair.b) {
                            let dw = slope * kernel.dw_over_r(pair.r, pair.h);
                            let [of_wall, of_fluid] =
                                if F::LINEAR { linear_gradients(kernel, linear, a, &pair) } else { [dw * pair.x_ab, -dw * pair.x_ab] };
                            let grad = [of_fluid, of_wall];
                            let between = Between { x_ab: -pair.x_ab, r: pair.r, h: pair.h, dw, grad, wall: true };
                            sum -= p.mass[pair.b] * flux.force(side(pair.b), own, between);
                        }
                    });
                    p.mass[a] * sum
                }
                Kind::Lost => sum,
            }
        });
    }

    /// Rate of the density of fluid, in `rate`, and its part by compression.
    fn rates<F: Flux<D>>(&mut self, flux: F, p: &Particles<D>) {
        let flux = flux.with_sound(self.plan.state.sound);
        let (near, kernel, slope, gradient) = (&self.near, self.kernel, 1.0 / self.lattice.slope_of_linear::<D>(), &self.gradient);
        let (shifts, linear) = (&self.shifts, &self.linear);
        let side = |a: usize| Side { v: p.v[a], u: p.v[a], density: p.density[a], pressure: p.pressure[a], inside: true };
        self.rate.resize(p.owned(), 0.0);
        self.compression.resize(p.owned(), 0.0);
        sweep2(&mut self.rate, &mut self.compression, |a| {
            let (mut sum, mut compression) = (0.0, 0.0);
            if p.is_fluid(a) {
                sum = shifts[a].pull;
                let own = side(a);
                near.for_each(a, |pair| {
                    if pair.r < self.kernel.radius() * pair.h {
                        let b = pair.b;
                        let dw = slope * kernel.dw_over_r(pair.r, pair.h);
                        let grad = if F::LINEAR { linear_gradients(kernel, linear, a, &pair) } else { [dw * pair.x_ab, -dw * pair.x_ab] };
                        let between = Between { x_ab: pair.x_ab, r: pair.r, h: pair.h, dw, grad, wall: !p.is_fluid(b) };
                        let jump = crate::physics::diffusion::jump(own.density, p.density[b], gradient[a], gradient[b], pair.x_ab);
                        sum += p.mass[b] * flux.rate(own, side(b), between, jump);
                        compression += p.mass[b] * dw * (own.v - p.v[b]).dot(pair.x_ab);
                    }
                });
            }
            (sum, compression)
        });
    }

    /// Linear kernels of the fluid at the positions of now, over fluid and walls. Walls go on where there are no more particles:
    /// theirs are not corrected.
    fn linear_kernels(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let (near, kernel, rest) = (&self.near, self.kernel, self.plan.state.rest);
        self.linear.resize(p.len(), LinearKernel::PLAIN);
        sweep(&mut self.linear[..p.owned()], |a| {
            if !p.is_fluid(a) {
                return LinearKernel::PLAIN;
            }
            let mut moments = MovingMoments::alone(p.mass[a] / rest * kernel.w(0.0, p.h[a]));
            near.for_each(a, |pair| {
                let volume = p.mass[pair.b] / rest;
                moments.add(-pair.x_ab, volume * kernel.w(pair.r, pair.h), volume * kernel.dw_over_r(pair.r, pair.h));
            });
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
        let (near, kernel, reset, owned) = (&self.near, self.kernel, self.plan.density_reset, p.owned());
        self.fresh.resize(owned, 0.0);
        sweep(&mut self.fresh, |a| if p.is_fluid(a) { new_density(kernel, near, p, reset, a) } else { p.density[a] });
        p.density[..owned].copy_from_slice(&self.fresh);
        domain.refresh_column(&mut p.density);
    }

    /// The gradient of density that diffusion leaves alone.
    fn gradients(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        self.gradient.resize(p.len(), Vector::ZERO);
        let (state, gravity) = (self.plan.state, self.medium.gravity);
        let at_rest = |a: usize| gradient_at_rest(&state, gravity, p.density[a]);
        let (near, kernel, correction) = (&self.near, self.kernel, &self.correction);
        let slope = 1.0 / (self.lattice.slope_of_linear::<D>() * state.rest);
        match self.plan.diffusion {
            Diffusion::Molteni => return,
            Diffusion::Fourtakas => sweep(&mut self.gradient[..p.owned()], at_rest),
            Diffusion::Antuono => sweep(&mut self.gradient[..p.owned()], |a| {
                if !p.is_fluid(a) || correction[a] == [Vector::ZERO; D] {
                    return at_rest(a);
                }
                let mut sum = Vector::ZERO;
                near.for_each(a, |pair| {
                    let b = pair.b;
                    let change = p.mass[b] * (p.density[b] - p.density[a]);
                    sum += slope * change * kernel.dw_over_r(pair.r, pair.h) * pair.x_ab;
                });
                contract(&correction[a], sum)
            }),
        }
        domain.refresh_column(&mut self.gradient);
    }

    /// One sound step of position-Verlet: half a step of positions and densities, a whole one of velocities at the middle, the
    /// other half with the new velocities (Zhang, Rezavand & Hu 2020). `share` is its part of the whole step.
    fn relax(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64, share: f64, phases: &mut Phases) {
        // x^{n+1/2} = x^n + Δt/2 v^n, ρ^{n+1/2} = ρ^n + Δt/2 (dρ/dt)^n, p^{n+1/2}
        phases.measure("motion", || {
            self.drift(p, 0.5 * dt);
            self.dilate(p, 0.5 * dt);
            domain.refresh_column(&mut p.density);
            self.follow(p, domain);
        });
        phases.measure("pressure", || self.pressures(p, domain, self.plan.damping));

        // v^{n+1} = v^n + Δt a(x^{n+1/2}, ρ^{n+1/2}, v^n)
        if self.medium.viscosity > 0.0 {
            phases.measure("walls", || self.walls.mirror_velocity(self.kernel, &self.near, p, domain));
        }
        let linear = matches!(self.plan.flux, AnyFlux::Linear(_));
        if linear {
            phases.measure("kernels", || self.linear_kernels(p, domain));
        }
        phases.measure("forces", || with_flux!(self.plan.flux, flux => self.forces(flux, p)));
        for (a, push) in self.push.iter().enumerate() {
            match p.kind[a] {
                Kind::Fluid => p.v[a] += dt * *push,
                Kind::Wall => self.wall_force[a] += share * *push,
                Kind::Lost => {}
            }
        }
        domain.refresh_column(&mut p.v);

        // x^{n+1} = x^{n+1/2} + Δt/2 v^{n+1}, ρ^{n+1} = ρ^{n+1/2} + Δt/2 (dρ/dt)^{n+1}
        phases.measure("motion", || {
            self.drift(p, 0.5 * dt);
            self.follow(p, domain);
        });
        if linear {
            phases.measure("kernels", || self.linear_kernels(p, domain));
        }
        phases.measure("density", || {
            self.gradients(p, domain);
            with_flux!(self.plan.flux, flux => self.rates(flux, p));
            self.dilate(p, 0.5 * dt);
            domain.refresh_column(&mut p.density);
        });
    }

    /// Densities over `dt` with the rates of now. A free surface bears no tension: liquid there parts instead of stretching, so
    /// its density is never below that at rest.
    fn dilate(&self, p: &mut Particles<D>, dt: f64) {
        let rest = self.plan.state.rest;
        for a in (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid) {
            let density = p.density[a] + dt * self.rate[a];
            p.density[a] = if p.surface[a] == 1 { density.max(rest) } else { density };
        }
    }

    /// Positions over `dt` with the velocities of now.
    fn drift(&self, p: &mut Particles<D>, dt: f64) {
        for a in (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.x[a] += dt * p.v[a];
        }
    }

    /// The longest sound step, s.
    fn sound_step(&self, p: &Particles<D>) -> f64 {
        self.plan.acoustic_courant * p.h_min() / (self.plan.state.sound + fastest(p))
    }
}

/// Gradients of the linear kernels of `a` and of its neighbour, each at its own particle.
#[inline(always)]
fn linear_gradients<K: Kernel<D>, const D: usize>(kernel: K, linear: &[LinearKernel<D>], a: usize, pair: &Pair<D>) -> [Vector<D>; 2] {
    let (w, dw) = (kernel.w(pair.r, pair.h), kernel.dw_over_r(pair.r, pair.h));
    [linear[a].gradient(-pair.x_ab, w, dw), linear[pair.b].gradient(pair.x_ab, w, dw)]
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

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        // (1) pairs, free surface, shift: once a step
        phases.measure("search", || self.search(p, domain))?;
        phases.measure("surface", || self.surface(p, domain));
        phases.measure("shifting", || self.shift(p, domain, dt));

        // (2) pressure and density in sound steps
        self.v_before.clone_from(&p.v);
        self.wall_force.clear();
        self.wall_force.resize(p.owned(), Vector::ZERO);
        let count = (dt / self.sound_step(p)).ceil().max(1.0);
        for _ in 0..count as u64 {
            self.relax(p, domain, dt / count, 1.0 / count, phases);
        }

        // (3) now and then, density from the neighbourhood
        phases.measure("density", || self.reset_density(p, domain));

        // (4) what others read: the pressure of the density
        phases.measure("pressure", || self.pressures(p, domain, 0.0));
        for a in 0..p.owned() {
            if p.kind[a] == Kind::Fluid {
                p.acceleration[a] = (p.v[a] - self.v_before[a]) / dt;
                p.density_rate[a] = self.rate[a];
            }
            p.force[a] = self.wall_force[a];
        }
        Ok(StepReport { evaluations: Some(count as usize), listed_pairs: Some(self.near.pairs()), ..StepReport::default() })
    }
}
