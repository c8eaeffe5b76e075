//! Methods that differ from δ-SPH in a few settings and in their pair terms.

use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{AnyFlux, StartPressure};
use crate::kernel::{Kernel, KernelName};
use crate::physics::pressure::Elasticity;
use crate::poisson::SolveError;
use crate::scheme::delta_sph::{DeltaFlux, DeltaSph, DeltaSphSettings};
use crate::scheme::settings::{BrokenRule, Settings, Still};
use crate::scheme::{Medium, Preset, Scheme};

/// Default share of `h/(c0 + v)` that a sound step of a relative takes, dimensionless (Zhang et al. 2020): the analysis that lets δ-SPH take
/// longer ones is of its own pair terms.
pub(in crate::scheme) const SOUND_COURANT: f64 = 0.6;

/// What such a method says of itself; the rest of its [`Settings`] is that of δ-SPH.
pub(in crate::scheme) trait Relative: Serialize + DeserializeOwned + JsonSchema {
    /// As [`Settings::STEP_COST`].
    const COST: f64;
    /// Row of the table of methods that names the work of a step.
    const WORK: &'static str;

    /// The defaults of `preset`.
    fn defaults(preset: Preset) -> Self;

    /// The preset the defaults came from.
    fn origin(&self) -> Preset;

    /// Pressure at the start.
    fn start_pressure(&mut self) -> &mut Option<StartPressure>;

    /// The parts it shares, as parameters of δ-SPH of the same names.
    fn shared(&self) -> DeltaSphSettings;

    /// Its pair terms, from those of δ-SPH with the shared parameters.
    fn flux(&self, shared: DeltaFlux) -> AnyFlux;

    /// An error for the first parameter of its own that is out of its range.
    fn check_own(&self) -> Result<(), BrokenRule>;

    /// What spreads and damps density, and what damps velocity, in words.
    fn dissipation(&self) -> [String; 2];

    /// Each difference from its source but those of δ-SPH, as a phrase.
    fn own_departures(&self) -> Vec<String>;
}

impl<T: Relative> Settings for T {
    type Own = <DeltaSphSettings as Settings>::Own;
    const SMOOTHING: f64 = DeltaSphSettings::SMOOTHING;
    const STEP_COST: f64 = T::COST;

    fn preset(preset: Preset) -> Self {
        Self::defaults(preset)
    }

    fn preset_name(&self) -> Preset {
        self.origin()
    }

    fn check(&self, reach: f64) -> Result<(), BrokenRule> {
        self.check_own()?;
        self.shared().check(reach)
    }

    fn resolve(&mut self, still: &Still) {
        let mut shared = self.shared();
        shared.resolve(still);
        *self.start_pressure() = shared.start_pressure;
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        let shared = self.shared();
        let [density, velocity] = self.dissipation();
        let reset = shared.density_reset.words(shared.density_reset_every);
        let mut rows = shared.distinctions();
        for (aspect, value) in &mut rows {
            match *aspect {
                "density from" => *value = format!("continuity equation (22), {density}{reset}"),
                "viscosity" => *value = format!("of the fluid, and {velocity}"),
                "work of a step" => Self::WORK.clone_into(value),
                _ => {}
            }
        }
        rows
    }

    fn departures(&self, _viscosity: f64, _kernel: KernelName) -> Vec<String> {
        self.own_departures()
    }

    fn sound_step(&self) -> Option<f64> {
        self.shared().sound_step()
    }

    fn time_step_rule(&self, courant: f64) -> String {
        self.shared().time_step_rule(courant)
    }

    fn sound_speed(&self, g: f64, depth: f64, fastest: f64) -> f64 {
        self.shared().sound_speed(g, depth, fastest)
    }

    fn walls_pull(&self) -> bool {
        self.shared().walls_pull()
    }

    fn elasticity<const D: usize>(&self, medium: &Medium<D>) -> Elasticity {
        self.shared().elasticity(medium)
    }

    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        self.shared().memory(count, neighbours)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        let shared = self.shared();
        let flux = self.flux(DeltaFlux::of(&shared, &medium));
        Ok(Box::new(DeltaSph::delta_sph(kernel, medium, &shared).with_flux(flux)))
    }
}
