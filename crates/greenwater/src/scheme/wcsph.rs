//! Weakly compressible SPH as the paper states it: explicit, with an equation of state and forces from walls.

mod sums;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::sums::{Forces, Stress};
use super::before::follow;
use super::settings::{BrokenRule, Settings, Still, changed, paper_departures};
use super::{Medium, Preset, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::{CubicSpline, Kernel, KernelName};
use crate::lanes::{sweep_lanes, sweep_lanes2};
use crate::math::Vector;
use crate::neighbors::{BehindWalls, Neighbors, Search};
use crate::particles::{Kind, Particles};
use crate::physics::consistency::{DensityReset, new_density};
use crate::physics::pairs::{Pairs, Sense};
use crate::physics::pressure::{Elasticity, GAMMA, speed_of_sound, tait};
use crate::physics::viscosity::Tensor;
use crate::poisson::SolveError;
use crate::sweep::{largest, sweep, sweep2, update, update2};
use crate::time::{Phases, StepLimit};
use crate::walls::{LennardJones, NormalForce, WallForces, wall_normals};

/// How the coefficient `B` of the equation of state (25) is read, the paper's (26).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EquationOfState {
    /// `B = 200 ρ0 g H/γ` everywhere (Monaghan 1994); the initial density is hydrostatic.
    Constant,
    /// `B_a = 200 ρ0 g (H − y_a)/γ` with the height `y_a` each particle starts at; a uniform initial density is hydrostatic.
    InitialHeight,
    /// `B_a = 200 ρ0 g (H − y_a)/γ` with the height `y_a` each particle has now.
    CurrentHeight,
}

/// The force of wall particles on fluid particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallForce {
    /// Lennard-Jones (33)-(34), repulsion only (`r < r0`).
    LennardJones,
    /// Lennard-Jones (33)-(34) with the attraction beyond `r0`, out to the support of the kernel.
    LennardJonesAttractive,
    /// Normal force of Monaghan (2005).
    Monaghan2005,
}

/// Parameters of the method `wcsph`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WcsphSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Reading of (26).
    pub equation_of_state: EquationOfState,
    /// The number 200 of (26): `c0² = stiffness · g H`. Dimensionless, > 0.
    pub stiffness: f64,
    /// Smallest `B` as a share of its value at the floor, dimensionless, in (0, 1]; for the readings with `H − y`.
    pub stiffness_floor: f64,
    /// Depth `H` of (26), m; left out: the height of the fluid at the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<f64>,
    /// Height of the floor, where `y = 0` in (26), m along the direction against gravity; left out: the lowest point of the
    /// fluid at the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub floor: Option<f64>,
    /// Density at the start; left out: `given` for particles from a file, else `hydrostatic`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_density: Option<InitialDensity>,
    /// Linear coefficient `α` of the artificial viscosity (13), dimensionless, >= 0.
    pub alpha: f64,
    /// Quadratic coefficient `β` of the artificial viscosity (13), dimensionless, >= 0.
    pub beta: f64,
    /// `η` of (14), dimensionless, > 0.
    pub eta: f64,
    /// Force of walls.
    pub wall_force: WallForce,
    /// Exponents of (33), the larger one first.
    pub wall_exponents: [u32; 2],
    /// Strength `D` of (34), m²/s²; left out: `5 g H`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall_strength: Option<f64>,
    /// Range `r0` of (34), m; left out: the particle spacing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall_range: Option<f64>,
    /// Where new densities come from, now and then.
    pub density_reset: DensityReset,
    /// Steps from one new density to the next, >= 1.
    pub density_reset_every: u64,
    /// How pairs are found.
    pub search: Search,
}

/// Density at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum InitialDensity {
    /// As the case or the particle file says.
    Given,
    /// From the equation of state under the weight of the fluid above, `p = ρ0 g (H − y)`.
    Hydrostatic,
}

impl WcsphSettings {
    /// The defaults of `preset`.
    ///
    /// `paper`: `α = β = 1`, `B` with `H − y`. `water`: `α = 0.05`, `β = 0` (Monaghan 1994 used 0.01; codes of today 0.01 to 0.05), constant `B`.
    pub fn preset(preset: Preset) -> Self {
        let printed = Self {
            preset,
            equation_of_state: EquationOfState::InitialHeight,
            stiffness: 200.0,
            stiffness_floor: 0.1,
            depth: None,
            floor: None,
            initial_density: None,
            alpha: 1.0,
            beta: 1.0,
            eta: 0.1,
            wall_force: WallForce::LennardJones,
            wall_exponents: [12, 6],
            wall_strength: None,
            wall_range: None,
            density_reset: DensityReset::None,
            density_reset_every: 20,
            search: Search::Grid,
        };
        match preset {
            Preset::Paper => printed,
            Preset::Water => Self { equation_of_state: EquationOfState::Constant, alpha: 0.05, beta: 0.0, ..printed },
        }
    }
}

impl Settings for WcsphSettings {
    type Own = CubicSpline;
    const SMOOTHING: f64 = 1.2;
    const STEP_COST: f64 = 1.5e-8;

    fn preset(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn preset_name(&self) -> Preset {
        self.preset
    }

    fn check(&self, _reach: f64) -> Result<(), BrokenRule> {
        let s = self;
        BrokenRule::unless_positive("stiffness", s.stiffness)?;
        let share = s.stiffness_floor;
        BrokenRule::unless(share > 0.0 && share <= 1.0, "stiffness_floor", share, "> 0 and <= 1")?;
        BrokenRule::unless_not_negative("alpha", s.alpha)?;
        BrokenRule::unless_not_negative("beta", s.beta)?;
        BrokenRule::unless_positive("eta", s.eta)?;
        BrokenRule::unless(s.density_reset_every >= 1, "density_reset_every", s.density_reset_every, ">= 1")?;
        let [high, low] = s.wall_exponents;
        let rule = "two whole numbers >= 1, the larger first";
        BrokenRule::unless(high > low && low >= 1, "wall_exponents", format!("[{high}, {low}]"), rule)?;
        for (key, value) in [("depth", s.depth), ("wall_strength", s.wall_strength), ("wall_range", s.wall_range)] {
            value.map_or(Ok(()), |value| BrokenRule::unless_positive(key, value))?;
        }
        Ok(())
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        let s = self;
        let stiffness = s.stiffness;
        let pressure = match s.equation_of_state {
            EquationOfState::Constant => format!("equation of state (25) with B = {stiffness} \u{3c1}0 g H/7 everywhere"),
            EquationOfState::InitialHeight => format!("equation of state (25) with B = {stiffness} \u{3c1}0 g (H - y)/7, y at the start"),
            EquationOfState::CurrentHeight => format!("equation of state (25) with B = {stiffness} \u{3c1}0 g (H - y)/7, y now"),
        };
        let start = match s.initial_density {
            Some(InitialDensity::Given) => "as given",
            Some(InitialDensity::Hydrostatic) | None => "under the weight of the fluid above",
        };
        let reset = s.density_reset.words(s.density_reset_every);
        let [high, low] = s.wall_exponents;
        let walls = match s.wall_force {
            WallForce::LennardJones => format!("Lennard-Jones force (33)-(34), repulsion only, exponents {high} and {low}"),
            WallForce::LennardJonesAttractive => format!("Lennard-Jones force (33)-(34) with its attraction, exponents {high} and {low}"),
            WallForce::Monaghan2005 => "normal force of Monaghan (2005)".to_owned(),
        };
        vec![
            ("compressibility", format!("weakly compressible, sound speed sqrt({stiffness} g H)")),
            ("pressure from", pressure),
            ("density from", format!("continuity equation (22); at the start {start}{reset}")),
            ("viscosity", format!("artificial (13), alpha = {}, beta = {}, and the stress (23)-(24)", s.alpha, s.beta)),
            ("time step limited by", "sound speed plus speed (32)".to_owned()),
            ("time stepping", "explicit, predictor-corrector (27)-(28)".to_owned()),
            ("walls", walls),
            ("free surface", "nothing special: pressure vanishes where the density is that at rest".to_owned()),
            ("linear system", "none".to_owned()),
            ("work of a step", "two sums over neighbours".to_owned()),
        ]
    }

    fn departures(&self, viscosity: f64, kernel: KernelName) -> Vec<String> {
        let s = self;
        let printed = WcsphSettings::preset(Preset::Paper);
        let mut found = Vec::new();
        match s.equation_of_state {
            EquationOfState::InitialHeight => {}
            EquationOfState::Constant => found.push("B of (26) with the full depth H for every particle in place of H - y".to_owned()),
            EquationOfState::CurrentHeight => found.push("B of (26) follows the height of a particle as it moves".to_owned()),
        }
        changed("factor of (26):", s.stiffness, printed.stiffness, &mut found);
        changed("artificial viscosity alpha =", s.alpha, printed.alpha, &mut found);
        changed("artificial viscosity beta =", s.beta, printed.beta, &mut found);
        changed("eta of (14) =", s.eta, printed.eta, &mut found);
        match s.wall_force {
            WallForce::LennardJones => {}
            WallForce::LennardJonesAttractive => found.push("wall force (34) with its attraction beyond r0".to_owned()),
            WallForce::Monaghan2005 => found.push("normal wall force of Monaghan (2005) in place of (33)-(34)".to_owned()),
        }
        if s.wall_exponents != printed.wall_exponents {
            let ([high, low], [printed_high, printed_low]) = (s.wall_exponents, printed.wall_exponents);
            found.push(format!("exponents of (33) {high} and {low} in place of the printed {printed_high} and {printed_low}"));
        }
        if s.density_reset != DensityReset::None {
            found.push(format!("density{}", s.density_reset.words(s.density_reset_every)));
        }
        paper_departures(viscosity, kernel, &mut found);
        found
    }

    fn time_step_rule(&self, courant: f64) -> String {
        format!("(32): {courant} h over the greatest of sound speed plus speed")
    }

    fn resolve(&mut self, still: &Still) {
        let given = if still.from_file { InitialDensity::Given } else { InitialDensity::Hydrostatic };
        self.initial_density.get_or_insert(given);
        let depth = *self.depth.get_or_insert(still.depth);
        self.floor.get_or_insert(still.floor);
        self.wall_strength.get_or_insert(5.0 * depth * scale(still.g, depth, still.speed));
        self.wall_range.get_or_insert(still.spacing);
    }

    fn sound_speed(&self, g: f64, depth: f64, fastest: f64) -> f64 {
        let depth = self.depth.unwrap_or(depth);
        (self.stiffness * scale(g, depth, fastest) * depth).sqrt()
    }

    fn elasticity<const D: usize>(&self, medium: &Medium<D>) -> Elasticity {
        if self.equation_of_state == EquationOfState::Constant {
            let depth = self.depth.unwrap_or(medium.depth);
            Elasticity::Tait(self.stiffness * medium.rest_density * scale(medium.g(), depth, medium.speed) * depth / f64::from(GAMMA))
        } else {
            Elasticity::Unknown
        }
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(Wcsph::new(kernel, medium, self.clone())))
    }
}

/// The `g` of (26) and (34), m/s². Without gravity, where the paper gives none: what makes `2 sqrt(g H)`, the greatest speed of a dam
/// break, the greatest speed `speed` at the start, m/s.
fn scale(g: f64, depth: f64, speed: f64) -> f64 {
    if g > 0.0 { g } else { 0.25 * speed * speed / depth }
}

/// The explicit method of the paper: equations (13)-(15), (20)-(28) and (32), walls by (33)-(34).
///
/// Sources: Afanasiev, Makarchuk & Popov, NNFM 101 (2008) 206; Monaghan, J. Comput. Phys. 110 (1994) 399 (equation of state,
/// walls); Liu & Liu, Smoothed Particle Hydrodynamics (2003) (stress, time stepping).
pub struct Wcsph<K, const D: usize> {
    kernel: K,
    medium: Medium<D>,
    settings: WcsphSettings,
    near: Neighbors<D>,
    sense: Sense,
    walls: WallForces<D>,
    /// `B` of each particle, Pa.
    stiffness: Vec<f64>,
    /// Speed of sound of each particle, m/s.
    sound: Vec<f64>,
    /// `p/ρ²` of each particle, m⁵/(kg s²) in 3D.
    pressed: Vec<f64>,
    /// `μ T/ρ²` of each particle, the viscous part of (21).
    stress: Vec<Tensor<D>>,
    /// The state before the step, to be taken back; before a step, room for the one after it.
    before: State<D>,
    /// Velocity at the half step before, m/s.
    v_half: Vec<Vector<D>>,
    /// Density at the half step before, kg/m³.
    density_half: Vec<f64>,
    /// The step before, s; none yet at the start.
    dt_before: Option<f64>,
    /// Densities about to replace those of the particles, kg/m³.
    fresh: Vec<f64>,
    /// Steps since densities were set anew.
    since_reset: u64,
}

/// What a step changes: columns of all rows.
#[derive(Default)]
struct State<const D: usize> {
    kind: Vec<Kind>,
    x: Vec<Vector<D>>,
    v: Vec<Vector<D>>,
    density: Vec<f64>,
    pressure: Vec<f64>,
    acceleration: Vec<Vector<D>>,
    density_rate: Vec<f64>,
    force: Vec<Vector<D>>,
}

impl<const D: usize> State<D> {
    /// Makes it `rows` long.
    fn resize(&mut self, rows: usize) {
        self.kind.resize(rows, Kind::Lost);
        for column in [&mut self.x, &mut self.v, &mut self.acceleration, &mut self.force] {
            column.resize(rows, Vector::ZERO);
        }
        for column in [&mut self.density, &mut self.pressure, &mut self.density_rate] {
            column.resize(rows, 0.0);
        }
    }

    /// Changes places with the columns of `p`.
    fn swap(&mut self, p: &mut Particles<D>) {
        std::mem::swap(&mut self.kind, &mut p.kind);
        std::mem::swap(&mut self.x, &mut p.x);
        std::mem::swap(&mut self.v, &mut p.v);
        std::mem::swap(&mut self.density, &mut p.density);
        std::mem::swap(&mut self.pressure, &mut p.pressure);
        std::mem::swap(&mut self.acceleration, &mut p.acceleration);
        std::mem::swap(&mut self.density_rate, &mut p.density_rate);
        std::mem::swap(&mut self.force, &mut p.force);
    }
}

impl<K: Kernel<D>, const D: usize> Wcsph<K, D> {
    /// The method for a fluid, with a kernel and checked parameters.
    pub fn new(kernel: K, medium: Medium<D>, settings: WcsphSettings) -> Self {
        let depth = settings.depth.unwrap_or(medium.depth);
        let strength = settings.wall_strength.unwrap_or(5.0 * depth * scale(medium.g(), depth, medium.speed));
        let range = settings.wall_range.unwrap_or(medium.spacing);
        let exponents = settings.wall_exponents;
        let lennard_jones = |cutoff| WallForces::LennardJones(LennardJones { strength, range, exponents, cutoff });
        let walls = match settings.wall_force {
            WallForce::LennardJones => lennard_jones(range),
            WallForce::LennardJonesAttractive => lennard_jones(f64::INFINITY),
            WallForce::Monaghan2005 => {
                let sound = (settings.stiffness * scale(medium.g(), depth, medium.speed) * depth).sqrt();
                WallForces::Normal(NormalForce { sound, spacing: medium.spacing, normals: Vec::new() })
            }
        };
        let floor = settings.floor.unwrap_or(medium.floor);
        Self {
            kernel,
            medium: Medium { depth, floor, ..medium },
            settings,
            near: Neighbors::new(),
            sense: Sense::default(),
            walls,
            stiffness: Vec::new(),
            sound: Vec::new(),
            pressed: Vec::new(),
            stress: Vec::new(),
            before: State::default(),
            v_half: Vec::new(),
            density_half: Vec::new(),
            dt_before: None,
            fresh: Vec::new(),
            since_reset: 0,
        }
    }

    /// `B` of a particle at `x`, Pa, equation (26) in the chosen reading.
    fn stiffness_at(&self, x: Vector<D>) -> f64 {
        let scale = scale(self.medium.g(), self.medium.depth, self.medium.speed);
        let whole = self.settings.stiffness * self.medium.rest_density * scale / f64::from(GAMMA);
        match self.settings.equation_of_state {
            EquationOfState::Constant => whole * self.medium.depth,
            EquationOfState::InitialHeight | EquationOfState::CurrentHeight => {
                let share = 1.0 - self.medium.height(x) / self.medium.depth;
                whole * self.medium.depth * share.max(self.settings.stiffness_floor)
            }
        }
    }

    /// Density under the weight of the fluid above, kg/m³: (25) solved for `p = ρ0 g (H − y)`.
    fn hydrostatic_density(&self, x: Vector<D>, stiffness: f64) -> f64 {
        let weight = self.medium.rest_density * self.medium.g() * (self.medium.depth - self.medium.height(x)).max(0.0);
        self.medium.rest_density * (1.0 + weight / stiffness).powf(1.0 / f64::from(GAMMA))
    }

    /// (27), (28): positions, velocities and densities after a step `dt`.
    fn advance(&mut self, p: &mut Particles<D>, dt: f64) {
        let owned = p.owned();
        // (28) kick: half-step values forward by the mean of this step and the one before; half a step at the start
        let kick = match self.dt_before {
            Some(before) => 0.5 * (dt + before),
            None => {
                self.v_half.clone_from(&p.v);
                self.density_half.clone_from(&p.density);
                0.5 * dt
            }
        };
        let (kind, acceleration, rate) = (&p.kind, &p.acceleration, &p.density_rate);
        update2(&mut self.v_half[..owned], &mut self.density_half[..owned], |a, v, density| {
            if kind[a] == Kind::Fluid {
                (*v, *density) = (*v + kick * acceleration[a], *density + kick * rate[a]);
            }
        });
        let (v_half, density_half, next) = (&self.v_half, &self.density_half, &mut self.before);
        next.resize(p.len());
        next.kind.copy_from_slice(&p.kind);
        // (28) drift: x^{n+1} = x^n + Δt v^{n+1/2}
        sweep(&mut next.x[..owned], |a| if kind[a] == Kind::Fluid { p.x[a] + dt * v_half[a] } else { p.x[a] });
        // (27) predict the whole step from the half step, with the rates of the old positions
        sweep2(&mut next.v[..owned], &mut next.density[..owned], |a| match kind[a] {
            Kind::Fluid => (v_half[a] + 0.5 * dt * acceleration[a], density_half[a] + 0.5 * dt * rate[a]),
            Kind::Wall | Kind::Lost => (p.v[a], p.density[a]),
        });
        next.swap(p);
        self.dt_before = Some(dt);
    }

    /// Pairs, pressures, stresses, forces: everything that follows from positions, velocities and densities.
    fn evaluate(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, phases: &mut Phases) -> Result<(), StepError> {
        phases.measure("search", || {
            domain.refresh(p, self.kernel.radius() * p.h_max());
            if let WallForces::Normal(NormalForce { normals, .. }) = &mut self.walls {
                // Images come and go.
                normals.resize(p.len(), Vector::ZERO);
                domain.refresh_column(normals);
            }
            // Records are made anew after the search.
            self.near.list(p, self.kernel.radius(), self.settings.search, BehindWalls::Everyone, &mut self.sense.records)?;
            self.near.follow(p);
            self.sense.fill(p, |a| p.v[a], |a| p.density[a]);
            Ok::<_, StepError>(())
        })?;
        phases.measure("pressure", || self.equation_of_state(p, domain));
        phases.measure("stress", || self.viscous_stress(p, domain));
        phases.measure("forces", || {
            self.forces(p);
            match &self.walls {
                WallForces::LennardJones(wall) => self.wall_forces(p, |_, _, _, x_ab, r, _| wall.on(x_ab, r)),
                WallForces::Normal(wall) => self.wall_forces(p, |p, fluid, b, x_ab, _, h| wall.on(p, fluid, b, x_ab, h)),
            }
        });
        Ok(())
    }

    /// (25), (26): pressure and speed of sound of the fluid, ghosts included.
    fn equation_of_state(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        if self.settings.equation_of_state == EquationOfState::CurrentHeight {
            for a in 0..p.owned() {
                self.stiffness[a] = self.stiffness_at(p.x[a]);
            }
        }
        let (rest, stiffness) = (self.medium.rest_density, &self.stiffness);
        self.sound.resize(p.len() + 1, 0.0);
        self.pressed.resize(p.len() + 1, 0.0);
        let owned = p.owned();
        let (kind, density) = (&p.kind, &p.density);
        sweep2(&mut p.pressure[..owned], &mut self.sound[..owned], |a| match kind[a] {
            Kind::Fluid => (tait(stiffness[a], density[a], rest), speed_of_sound(stiffness[a], density[a], rest)),
            Kind::Wall | Kind::Lost => (0.0, 0.0),
        });
        domain.refresh_column(&mut p.pressure);
        domain.refresh_column(&mut self.sound[..p.len()]);
        sweep(&mut self.pressed[..p.len()], |a| if p.is_fluid(a) { p.pressure[a] / (p.density[a] * p.density[a]) } else { 0.0 });
    }

    fn pairs(&self) -> Pairs<'_, K, D> {
        self.sense.pairs(self.kernel, &self.near)
    }

    /// (23), (24): the viscous stress of the fluid, ghosts included.
    fn viscous_stress(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        if self.medium.viscosity == 0.0 {
            return;
        }
        let mut stress = std::mem::take(&mut self.stress);
        stress.resize(p.len() + 1, [Vector::ZERO; D]);
        let pairs = self.pairs();
        sweep_lanes(pairs.set, &mut stress[..p.owned()], &Stress { pairs, viscosity: self.medium.viscosity });
        domain.refresh_column(&mut stress[..p.len()]);
        self.stress = stress;
    }

    /// New densities, where the settings want them after this step, at the whole step and at the half step before; then what
    /// follows from them.
    fn reset_density(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, phases: &mut Phases) -> Result<(), StepError> {
        self.since_reset += 1;
        let reset = self.settings.density_reset;
        if reset == DensityReset::None || self.since_reset < self.settings.density_reset_every {
            return Ok(());
        }
        self.since_reset = 0;
        let (near, kernel, owned) = (&self.near, self.kernel, p.owned());
        self.fresh.resize(owned, 0.0);
        sweep(&mut self.fresh, |a| if p.is_fluid(a) { new_density(kernel, near, p, reset, a) } else { p.density[a] });
        for a in 0..owned {
            self.density_half[a] += self.fresh[a] - p.density[a];
            p.density[a] = self.fresh[a];
        }
        self.evaluate(p, domain, phases)
    }

    /// (21) and (22) of the fluid among itself.
    fn forces(&self, p: &mut Particles<D>) {
        let WcsphSettings { alpha, beta, eta, .. } = self.settings;
        let (owned, pairs) = (p.owned(), self.pairs());
        let stress = (self.medium.viscosity > 0.0).then_some(self.stress.as_slice());
        let forces = Forces {
            pairs,
            gravity: self.medium.gravity,
            artificial: [alpha, beta, eta],
            pressed: &self.pressed,
            sound: &self.sound,
            stress,
        };
        sweep_lanes2(pairs.set, &mut p.acceleration[..owned], &mut p.density_rate[..owned], &forces);
    }

    /// What walls add to accelerations, and the forces on them. Walls act by their force alone: `wall(p, fluid, wall, x_ab, r, h)`, m/s², on the
    /// fluid particle.
    fn wall_forces(&self, p: &mut Particles<D>, wall: impl Fn(&Particles<D>, usize, usize, Vector<D>, f64, f64) -> Vector<D> + Sync) {
        let (near, owned) = (&self.near, p.owned());
        let mut acceleration = std::mem::take(&mut p.acceleration);
        update(&mut acceleration[..owned], |a, total| {
            if p.is_fluid(a) && near.of(a).iter().any(|&b| !p.is_fluid(b as usize)) {
                near.for_each(a, |pair| {
                    if !p.is_fluid(pair.b) {
                        *total += wall(p, a, pair.b, pair.x_ab, pair.r, pair.h);
                    }
                });
            }
        });
        p.acceleration = acceleration;

        let mut on_walls = std::mem::take(&mut p.force);
        sweep(&mut on_walls[..owned], |b| {
            let mut total = Vector::ZERO;
            if p.kind[b] == Kind::Wall {
                near.for_each(b, |pair| {
                    if p.is_fluid(pair.b) {
                        total -= p.mass[pair.b] * wall(p, pair.b, b, -pair.x_ab, pair.r, pair.h);
                    }
                });
            }
            total
        });
        p.force = on_walls;
    }
}

impl<K: Kernel<D>, const D: usize> Scheme<D> for Wcsph<K, D> {
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        self.stiffness = p.x[..p.owned()].iter().map(|&x| self.stiffness_at(x)).collect();
        if self.settings.initial_density != Some(InitialDensity::Given) {
            for a in (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.density[a] = self.hydrostatic_density(p.x[a], self.stiffness[a]);
            }
        }
        if let WallForces::Normal(NormalForce { normals, .. }) = &mut self.walls {
            domain.refresh(p, self.kernel.radius() * p.h_max());
            self.near.build(p, self.kernel.radius(), self.settings.search)?;
            *normals = wall_normals(self.kernel, &self.near, p);
            domain.refresh_column(normals);
        }
        self.dt_before = None;
        self.since_reset = 0;
        self.evaluate(p, domain, &mut Phases::default())
    }

    /// (32): `C min(h)/max(c + |v|)`.
    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let fastest = largest(p.owned(), |a| self.sound[a] + p.v[a].norm());
        StepLimit::new(self.medium.courant * p.h_min() / fastest, "sound")
    }

    fn takes_back(&self) -> bool {
        true
    }

    fn take_back(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        // There may be more ghosts than before, or fewer: they follow their parents.
        self.before.resize(p.len());
        self.before.swap(p);
        domain.refresh_column(&mut p.kind);
        follow(p, domain);
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        phases.measure("motion", || self.advance(p, dt));
        // (21)-(26) at the new positions
        self.evaluate(p, domain, phases)?;
        self.reset_density(p, domain, phases)?;
        Ok(StepReport::default())
    }
}
