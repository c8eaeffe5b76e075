//! Weakly compressible SPH whose pairs solve a Riemann problem.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Preset;
use super::acoustic::relative::{Relative, SOUND_COURANT};
use super::acoustic::{AnyFlux, Between, Flux, Side, StartPressure, Stepping, TensileControl};
use super::delta_sph::{DeltaFlux, DeltaSphSettings};
use super::settings::BrokenRule;
use crate::lanes::Real;
use crate::neighbors::Search;
use crate::physics::consistency::DensityReset;
use crate::physics::pairs::{add_scaled, difference, dot};
use crate::physics::state::PressureLaw;
use crate::walls::dummy::{WallPressure, WallSlip, WallSuction};

/// Parameters of the method `riemann`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RiemannSettings {
    /// Where the defaults come from; both presets are the same here.
    pub preset: Preset,
    /// Speed of sound over the reference speed, dimensionless, >= 1: 10 keeps the density within 1 % (Monaghan 1994).
    pub sound_factor: f64,
    /// Greatest speed to expect, m/s; left out: `2 sqrt(g H)`, or the greatest speed at the start or of a wall at any time
    /// if that is more.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_speed: Option<f64>,
    /// Strength `η` of the limiter, dimensionless, >= 0: 3 by Zhang, Hu & Adams (2017); the larger, the more two that approach
    /// rub.
    pub limiter: f64,
    /// What acts against clumping where the pressure is below zero.
    pub tensile_control: TensileControl,
    /// Strength of particle shifting, dimensionless, >= 0; 1 is that of Sun et al. (2017).
    pub shifting: f64,
    /// Share of a lack of volume inside the fluid that is closed while the fastest fluid moves by `h`, dimensionless, >= 0.
    pub volume_control: f64,
    /// Where new densities come from, now and then.
    pub density_reset: DensityReset,
    /// Steps from one new density to the next, >= 1.
    pub density_reset_every: u64,
    /// How wall particles get their pressure.
    pub wall_pressure: WallPressure,
    /// How fluid slides along walls.
    pub wall_slip: WallSlip,
    /// Whether walls can pull.
    pub wall_suction: WallSuction,
    /// Pressure at the start; left out: `given` for particles from a file, `written` where the case gives a
    /// pressure, else `released`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_pressure: Option<StartPressure>,
    /// How sound is stepped.
    pub stepping: Stepping,
    /// Share of `h/(c0 + v)` that a sound step takes, dimensionless, in (0, 1].
    pub acoustic_courant: f64,
    /// How pairs are found.
    pub search: Search,
}

impl RiemannSettings {
    /// The defaults of `preset`.
    pub fn preset(preset: Preset) -> Self {
        let parent = DeltaSphSettings::preset(preset);
        Self {
            preset,
            sound_factor: parent.sound_factor,
            reference_speed: None,
            limiter: 3.0,
            tensile_control: parent.tensile_control,
            shifting: parent.shifting,
            volume_control: parent.volume_control,
            density_reset: DensityReset::None,
            density_reset_every: parent.density_reset_every,
            wall_pressure: parent.wall_pressure,
            wall_slip: parent.wall_slip,
            wall_suction: parent.wall_suction,
            start_pressure: None,
            stepping: parent.stepping,
            acoustic_courant: SOUND_COURANT,
            search: parent.search,
        }
    }
}

impl Relative for RiemannSettings {
    const COST: f64 = 5e-9;
    const WORK: &'static str = "four sums over neighbours, and two for each sound step";

    fn defaults(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn origin(&self) -> Preset {
        self.preset
    }

    fn start_pressure(&mut self) -> &mut Option<StartPressure> {
        &mut self.start_pressure
    }

    fn shared(&self) -> DeltaSphSettings {
        DeltaSphSettings {
            pressure_law: PressureLaw::Linear,
            sound_factor: self.sound_factor,
            reference_speed: self.reference_speed,
            delta: 0.0,
            alpha: 0.0,
            tensile_control: self.tensile_control,
            shifting: self.shifting,
            volume_control: self.volume_control,
            density_reset: self.density_reset,
            density_reset_every: self.density_reset_every,
            wall_pressure: self.wall_pressure,
            wall_slip: self.wall_slip,
            wall_suction: self.wall_suction,
            start_pressure: self.start_pressure,
            stepping: self.stepping,
            acoustic_courant: self.acoustic_courant,
            search: self.search,
            acoustic_damping: 0.0,
            ..DeltaSphSettings::preset(self.preset)
        }
    }

    fn flux(&self, shared: DeltaFlux) -> AnyFlux {
        AnyFlux::Riemann(RiemannFlux { shared, limiter: self.limiter })
    }

    fn check_own(&self) -> Result<(), BrokenRule> {
        BrokenRule::unless_not_negative("limiter", self.limiter)
    }

    fn dissipation(&self) -> [String; 2] {
        [
            "jumps of pressure spread by a Riemann solver".to_owned(),
            format!("that of a Riemann solver on approach, limiter {}", self.limiter),
        ]
    }

    fn own_departures(&self) -> Vec<String> {
        vec![
            "the jump of pressure of a pair is that beyond the weight of the liquid in between".to_owned(),
            "walls are particles with the pressure of the fluid in front, without a Riemann problem".to_owned(),
            "particles are shifted; sums over neighbours are scaled by one number, so that the lattice of the start differentiates \
             linear fields exactly"
                .to_owned(),
        ]
    }
}

/// The pair terms of low-dissipation Riemann SPH: a pair of fluid is a Riemann problem along `e = (x_b − x_a)/r`, with
/// `U* = ½ (u_a + u_b) + ½ Δp/(ρ0 c0)`, `p* = ½ (p_a + p_b) + ½ β ρ0 c0 (u_a − u_b)`, `u = v·e` and
/// `β = min(η max(u_a − u_b, 0)/c0, 1)`:
///
/// `dρ_a/dt = 2 Σ_b m_b [½ v_ab − (U* − ½ (u_a + u_b)) e]·∇W`, `dv_a/dt = −2 Σ_b m_b p*/ρ0² ∇W`.
///
/// The jump `Δp` is reconstructed: `c0²` times that of the density beyond its gradient at rest, so that still water has none.
///
/// Source: Zhang, Hu & Adams, J. Comput. Phys. 335 (2017) 605.
#[derive(Clone, Copy, Debug)]
pub(super) struct RiemannFlux {
    /// Pressure, walls and the viscosity of the fluid.
    pub shared: DeltaFlux,
    /// `η`, dimensionless.
    pub limiter: f64,
}

impl<const D: usize> Flux<D> for RiemannFlux {
    fn with_sound(self, sound: f64) -> Self {
        Self { shared: Flux::<D>::with_sound(self.shared, sound), ..self }
    }

    #[inline(always)]
    fn own_pressure<L: Real>(self, pressure: L, inside: L::Mask) -> L {
        Flux::<D>::own_pressure(self.shared, pressure, inside)
    }

    #[inline(always)]
    fn force<L: Real>(self, a: Side<L, D>, b: Side<L, D>, pair: Between<L, D>) -> [L; D] {
        let nothing = L::splat(0.0);
        let DeltaFlux { sound, rest, .. } = self.shared;
        // Particles at one place approach in no direction.
        let r = pair.r.at_least(L::splat(f64::MIN_POSITIVE));
        let approach = (-dot(&difference(&a.v, &b.v), &pair.x_ab) / r).at_least(nothing);
        let beta = (approach * (self.limiter / sound)).at_most(L::splat(1.0));
        let push = -beta * approach * (sound * rest);
        let mut force = self.shared.force(a, b, pair);
        add_scaled(&mut force, L::choose(pair.wall, nothing, push), &pair.x_ab);
        force
    }

    #[inline(always)]
    fn spread<L: Real>(self, pair: Between<L, D>, jump: L) -> L {
        let spread = jump * pair.r * (self.shared.sound / self.shared.rest);
        Flux::<D>::spread(self.shared, pair, jump) + L::choose(pair.wall, L::splat(0.0), spread)
    }
}
