//! Entropically damped artificial compressibility: the pressure has an equation of its own.

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
use crate::physics::diffusion::Diffusion;
use crate::physics::state::PressureLaw;
use crate::walls::dummy::{WallPressure, WallSlip, WallSuction};

/// Parameters of the method `edac`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EdacSettings {
    /// Where the defaults come from; both presets are the same here.
    pub preset: Preset,
    /// Speed of sound over the reference speed, dimensionless, >= 1: 10 keeps the density within 1 % (Monaghan 1994).
    pub sound_factor: f64,
    /// Greatest speed to expect, m/s; left out: `2 sqrt(g H)`, or the greatest speed at the start or of a wall at any time
    /// if that is more.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_speed: Option<f64>,
    /// Strength `α_e` of the diffusion of pressure, dimensionless, >= 0: `ν_e = α_e h c0/8`; 0.5 by Ramachandran & Puri (2019).
    pub pressure_diffusion: f64,
    /// The gradient that the diffusion of pressure leaves alone; `molteni` for none, as printed.
    pub diffusion: Diffusion,
    /// Artificial viscosity `α`, dimensionless, >= 0: `α h c0/(2 (D + 2))` m²/s, less that of the fluid, on what of an approach of two particles the
    /// flow around them does not explain.
    pub alpha: f64,
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

impl EdacSettings {
    /// The defaults of `preset`.
    pub fn preset(preset: Preset) -> Self {
        let parent = DeltaSphSettings::preset(preset);
        Self {
            preset,
            sound_factor: parent.sound_factor,
            reference_speed: None,
            pressure_diffusion: 0.5,
            diffusion: Diffusion::Fourtakas,
            alpha: parent.alpha,
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

impl Relative for EdacSettings {
    const COST: f64 = 5e-9;
    const WORK: &'static str = "five sums over neighbours, and two for each sound step";

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
            diffusion: self.diffusion,
            delta: 0.0,
            alpha: self.alpha,
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
        AnyFlux::Edac(EdacFlux { shared, strength: self.pressure_diffusion })
    }

    fn check_own(&self) -> Result<(), BrokenRule> {
        BrokenRule::unless_not_negative("pressure_diffusion", self.pressure_diffusion)
    }

    fn dissipation(&self) -> [String; 2] {
        let left = match self.diffusion {
            Diffusion::Fourtakas => "beyond its gradient at rest",
            Diffusion::Antuono => "beyond its linear part",
            Diffusion::Molteni => "all of it",
        };
        [
            format!("which carries the pressure; the pressure diffuses, {left}, \u{3b1}_e = {}", self.pressure_diffusion),
            format!("artificial, alpha = {}", self.alpha),
        ]
    }

    fn own_departures(&self) -> Vec<String> {
        let mut found = vec![
            "particles are shifted by Sun et al. (2017) in place of a transport velocity; sums over neighbours are scaled by one number, so \
             that the lattice of the start differentiates linear fields exactly"
                .to_owned(),
        ];
        if self.diffusion != Diffusion::Molteni {
            found.push("the diffusion of pressure leaves a gradient alone".to_owned());
        }
        found
    }
}

/// The pair terms of EDAC: `dp_a/dt = ρ0 c0² Σ_b V_b v_ab·∇W + 2 ν_e Σ_b V_b (p_a − p_b) x_ab·∇W/(r² + 0.01 h²)`,
/// `ν_e = α_e h c0/8`, over fluid and walls; forces as in δ-SPH.
///
/// With the linear equation of state the density carries the pressure, `p = c0² (ρ − ρ0)`: both equations are those of the density,
/// times `c0²`. No mass and no volume depends on it: a particle stands for `m/ρ0` throughout.
///
/// Sources: Clausen, Phys. Rev. E 87 (2013) 013309; Ramachandran & Puri, Comput. Fluids 179 (2019) 579.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdacFlux {
    /// Everything but the diffusion.
    pub shared: DeltaFlux,
    /// `α_e`, dimensionless.
    pub strength: f64,
}

impl<const D: usize> Flux<D> for EdacFlux {
    fn with_sound(self, sound: f64) -> Self {
        Self { shared: Flux::<D>::with_sound(self.shared, sound), ..self }
    }

    #[inline(always)]
    fn own_pressure<L: Real>(self, pressure: L, inside: L::Mask) -> L {
        Flux::<D>::own_pressure(self.shared, pressure, inside)
    }

    #[inline(always)]
    fn force<L: Real>(self, a: Side<L, D>, b: Side<L, D>, pair: Between<L, D>) -> [L; D] {
        self.shared.force(a, b, pair)
    }

    #[inline(always)]
    fn spread<L: Real>(self, pair: Between<L, D>, jump: L) -> L {
        // 2 ν_e V_b jump (x_ab·∇W)/(r² + 0.01 h²), x_ab·∇W = r² W'/r.
        let twice_nu = pair.h * (0.25 * self.strength * self.shared.sound / self.shared.rest);
        Flux::<D>::spread(self.shared, pair, jump) + twice_nu * jump * pair.square / (pair.square + pair.h * pair.h * 0.01)
    }
}
