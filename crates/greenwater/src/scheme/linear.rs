//! Weakly compressible methods whose kernels reproduce linear fields: RKPM and MLSPH, two names for one set of operators.

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

/// Parameters of the method `rkpm`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RkpmSettings {
    /// Where the defaults come from; both presets are the same here.
    pub preset: Preset,
    /// Speed of sound over the reference speed, dimensionless, >= 1: 10 keeps the density within 1 % (Monaghan 1994).
    pub sound_factor: f64,
    /// Greatest speed to expect, m/s; left out: `2 sqrt(g H)`, or the greatest speed at the start or of a wall at any time
    /// if that is more.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_speed: Option<f64>,
    /// What density diffusion leaves alone.
    pub diffusion: Diffusion,
    /// Strength `δ` of density diffusion, dimensionless, >= 0.
    pub delta: f64,
    /// Artificial viscosity `α`, dimensionless, >= 0: `α h c0/(2 (D + 2))` m²/s, less that of the fluid, on what of an approach of two particles the
    /// flow around them does not explain.
    pub alpha: f64,
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

impl RkpmSettings {
    /// The defaults of `preset`.
    pub fn preset(preset: Preset) -> Self {
        let parent = DeltaSphSettings::preset(preset);
        Self {
            preset,
            sound_factor: parent.sound_factor,
            reference_speed: None,
            diffusion: Diffusion::Fourtakas,
            delta: 0.1,
            alpha: parent.alpha,
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

impl Relative for RkpmSettings {
    const COST: f64 = 8e-8;
    const WORK: &'static str = "five sums over neighbours, and four for each sound step";

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
            delta: self.delta,
            alpha: self.alpha,
            tensile_control: TensileControl::None,
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
        AnyFlux::Linear(LinearFlux { shared })
    }

    fn check_own(&self) -> Result<(), BrokenRule> {
        Ok(())
    }

    fn dissipation(&self) -> [String; 2] {
        [format!("linear kernels, diffusion delta = {}", self.delta), format!("artificial, alpha = {}", self.alpha)]
    }

    fn own_departures(&self) -> Vec<String> {
        vec![
            "particles are the quadrature points of Galerkin's form, which makes forces equal and opposite in a pair".to_owned(),
            "particles are shifted, density diffuses".to_owned(),
        ]
    }
}

/// Parameters of the method `mlsph`: those of `rkpm`, with densities fitted anew at each step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct MlsphSettings(pub RkpmSettings);

impl MlsphSettings {
    /// The defaults of `preset`.
    pub fn preset(preset: Preset) -> Self {
        Self(RkpmSettings { density_reset: DensityReset::Mls, density_reset_every: 1, ..RkpmSettings::preset(preset) })
    }
}

impl Relative for MlsphSettings {
    const COST: f64 = RkpmSettings::COST;
    const WORK: &'static str = RkpmSettings::WORK;

    fn defaults(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn origin(&self) -> Preset {
        self.0.origin()
    }

    fn start_pressure(&mut self) -> &mut Option<StartPressure> {
        self.0.start_pressure()
    }

    fn shared(&self) -> DeltaSphSettings {
        self.0.shared()
    }

    fn flux(&self, shared: DeltaFlux) -> AnyFlux {
        self.0.flux(shared)
    }

    fn check_own(&self) -> Result<(), BrokenRule> {
        self.0.check_own()
    }

    fn dissipation(&self) -> [String; 2] {
        self.0.dissipation()
    }

    fn own_departures(&self) -> Vec<String> {
        self.0.own_departures()
    }
}

/// The pair terms with kernels that reproduce linear fields:
///
/// `dρ_a/dt = Σ_b m_b v_ab·∇_a W^R_ab + diffusion`, `dv_a/dt = −Σ_b m_b (p_a ∇_a W^R_ab − p_b ∇_b W^R_ba)/ρ0² + viscosity + g`,
/// diffusion and viscosity as in δ-SPH.
///
/// The divergence of a linear velocity is exact wherever a linear kernel exists. The force is the one whose work is that of the
/// pressure on this divergence, `Σ m v·dv/dt = −Σ (m p/ρ0²) dρ/dt`: it is Galerkin's, `Σ_b V_b p_b ∇φ_a(x_b)` with the particles as
/// quadrature points, since `Σ_b V_b ∇W^R_ab = 0`. Equal and opposite in a pair, not along the line between the two; what is linear
/// is differentiated exactly, so that torques of the fluid on itself cancel, too.
///
/// Sources: Liu, Jun & Zhang, Int. J. Numer. Meth. Fluids 20 (1995) 1081; Dilts, Int. J. Numer. Meth. Eng. 44 (1999) 1115; pairs of
/// corrected gradients after Bonet & Lok, Comput. Methods Appl. Mech. Eng. 180 (1999) 97.
#[derive(Clone, Copy, Debug)]
pub(super) struct LinearFlux {
    /// Diffusion, viscosity, walls.
    pub shared: DeltaFlux,
}

impl<const D: usize> Flux<D> for LinearFlux {
    const LINEAR: bool = true;

    fn with_sound(self, sound: f64) -> Self {
        Self { shared: Flux::<D>::with_sound(self.shared, sound) }
    }

    fn share_at_wall(self, fluid: f64, wall: f64) -> f64 {
        let pressed: f64 = self.shared.pressed(fluid, wall);
        if pressed == 0.0 { 0.0 } else { pressed / (fluid + wall) }
    }

    #[inline(always)]
    fn force<L: Real>(self, a: Side<L, D>, b: Side<L, D>, pair: Between<L, D>) -> [L; D] {
        let nothing = L::splat(0.0);
        self.shared.force(Side { own: nothing, ..a }, Side { pressure: nothing, ..b }, pair)
    }

    #[inline(always)]
    fn spread<L: Real>(self, pair: Between<L, D>, jump: L) -> L {
        Flux::<D>::spread(self.shared, pair, jump)
    }
}
