//! Implicit incompressible SPH: the exact projection of the particles' own divergence, for the density alone.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::adjoint::{Aim, Flow};
use super::dfsph::DfsphSettings;
use super::settings::{BrokenRule, Settings};
use super::{Medium, Preset, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::{Kernel, KernelName, WendlandC2};
use crate::particles::Particles;
use crate::poisson::SolveError;
use crate::time::{Phases, StepLimit};

/// Parameters of the method `iisph`: those of `dfsph`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct IisphSettings(pub DfsphSettings);

impl Settings for IisphSettings {
    type Own = WendlandC2;
    const SMOOTHING: f64 = 1.3;
    const STEP_COST: f64 = 5e-7;

    fn preset(preset: Preset) -> Self {
        Self(DfsphSettings::preset(preset))
    }

    fn preset_name(&self) -> Preset {
        self.0.preset
    }

    fn check(&self, _reach: f64) -> Result<(), BrokenRule> {
        self.0.check_all()
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        self.0.rows("an exact projection: the density at rest", "prediction, pressure, move", "one pressure solve")
    }

    fn departures(&self, _viscosity: f64, _kernel: KernelName) -> Vec<String> {
        self.0.common_departures()
    }

    fn time_step_rule(&self, courant: f64) -> String {
        DfsphSettings::step_rule(courant)
    }

    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        DfsphSettings::bytes(count, neighbours)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(Iisph::new(kernel, medium, &self.0)))
    }
}

/// The method: steps 2 to 4 of [`Dfsph`](super::Dfsph), without the divergence solve.
///
/// Source: Ihmsen, Cornelis, Solenthaler, Horvath & Teschner, IEEE Trans. Vis. Comput. Graph. 20 (2014) 426.
pub struct Iisph<K, const D: usize> {
    kernel: K,
    flow: Flow<D>,
    /// The last pressure, Pa: where the next solve starts.
    packing: Vec<f64>,
}

impl<K: Kernel<D>, const D: usize> Iisph<K, D> {
    /// The method for a fluid, with a kernel and checked parameters.
    pub fn new(kernel: K, medium: Medium<D>, settings: &DfsphSettings) -> Self {
        Self { kernel, flow: Flow::new(kernel, medium, settings.choices()), packing: Vec::new() }
    }
}

impl<K: Kernel<D>, const D: usize> Scheme<D> for Iisph<K, D> {
    /// Density, surface, and the pressure that the first step will find.
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        self.flow.begin(self.kernel, p, domain);
        self.flow.look_around(self.kernel, p, domain)?;
        let dt = self.flow.time_step(p).dt;
        self.packing.clone_from(&p.pressure);
        self.packing.truncate(p.owned());
        self.flow.predict(p, domain, dt);
        self.flow.press(p, domain, Aim::ConstantDensity, dt, &mut self.packing)?;
        self.flow.show(p, dt);
        Ok(())
    }

    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        self.flow.time_step(p)
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        let flow = &mut self.flow;
        phases.measure("search", || flow.look_around(self.kernel, p, domain))?;

        // (1) v* = v + Δt (g + viscosity)
        phases.measure("prediction", || flow.predict(p, domain, dt));

        // (2) the density at rest after the step
        let solved = phases.measure("density", || flow.press(p, domain, Aim::ConstantDensity, dt, &mut self.packing))?;

        // (3) x += Δt v
        phases.measure("motion", || flow.finish(p, domain, dt));
        Ok(StepReport { iterations: Some(solved.iterations), residual: Some(solved.residual), ..StepReport::default() })
    }
}
