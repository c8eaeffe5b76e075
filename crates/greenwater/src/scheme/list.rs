//! The list of methods: the one place that names them all.

use schemars::{Schema, SchemaGenerator};
use serde::{Deserialize, Deserializer, Serialize};

use super::settings::{BrokenRule, Distinction, Settings, Still};
use super::{
    DeltaSphSettings, DfsphSettings, EdacSettings, IisphSettings, IsphPaperSettings, IsphSettings, IsphShiftSettings, Medium,
    MlsphSettings, MpsModernSettings, MpsSettings, Preset, RiemannSettings, RkpmSettings, Scheme, WcsphSettings,
};
use crate::kernel::{KernelName, Named};
use crate::physics::pressure::Elasticity;
use crate::poisson::SolveError;

/// Makes [`MethodName`] and [`MethodSettings`] from a line a method: variant, settings, name, title, text.
macro_rules! methods {
    ($($variant:ident($settings:ty), $name:literal, $title:literal, $text:literal;)*) => {
        /// The methods a case may name.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        pub enum MethodName {
            $(#[doc = $text] #[serde(rename = $name)] $variant,)*
        }

        impl MethodName {
            /// Every method, in the order they are listed to users.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// The name as written in a case.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// A title for reports.
            pub fn title(self) -> &'static str {
                match self { $(Self::$variant => $title),* }
            }

            /// What it is and where it comes from, in one line.
            pub fn text(self) -> &'static str {
                match self { $(Self::$variant => $text),* }
            }

            /// Kernel and smoothing length over spacing where a case names none.
            pub fn kernel(self) -> (KernelName, f64) {
                match self { $(Self::$variant => (<$settings as Settings>::Own::NAME, <$settings as Settings>::SMOOTHING)),* }
            }

            /// Whether the method works with the kernel of the case; `false` if its weights are its own.
            pub fn takes_kernel(self) -> bool {
                match self { $(Self::$variant => <$settings as Settings>::TAKES_KERNEL),* }
            }

            /// The JSON schema of the method's parameters.
            pub(crate) fn schema(self, generator: SchemaGenerator) -> Schema {
                match self { $(Self::$variant => generator.into_root_schema_for::<$settings>()),* }
            }
        }

        /// A method with all its parameters.
        #[derive(Clone, Debug, PartialEq, Serialize)]
        #[serde(tag = "name")]
        pub enum MethodSettings {
            $(#[doc = concat!("Parameters of `", $name, "`.")] #[serde(rename = $name)] $variant($settings),)*
        }

        impl MethodSettings {
            /// The defaults of `method` under `preset`.
            pub fn preset(method: MethodName, preset: Preset) -> Self {
                match method { $(MethodName::$variant => Self::$variant(<$settings as Settings>::preset(preset))),* }
            }

            /// Reads the parameters of `method`, all of them, from any format.
            pub(crate) fn read<'de, R: Deserializer<'de>>(method: MethodName, reader: R) -> Result<Self, R::Error> {
                match method { $(MethodName::$variant => <$settings>::deserialize(reader).map(Self::$variant)),* }
            }

            /// Which method this is.
            pub fn method(&self) -> MethodName {
                match self { $(Self::$variant(_) => MethodName::$variant),* }
            }

            /// Wall-clock time of a step for one particle and one of its neighbours, s, on one core: a guide.
            pub(crate) fn step_cost(&self) -> f64 {
                match self { $(Self::$variant(_) => <$settings as Settings>::STEP_COST),* }
            }
        }

        /// Evaluates `$body` with `$s` bound to the settings of whichever method it is.
        macro_rules! with_settings {
            ($method:expr, $s:ident => $body:expr) => {
                match $method { $(MethodSettings::$variant($s) => $body),* }
            };
        }
    };
}

methods! {
    Wcsph(WcsphSettings), "wcsph", "SPH (weakly compressible, the paper's)",
        "explicit, weakly compressible, Lennard-Jones walls; Afanasiev, Makarchuk & Popov (2008), after Monaghan (1994)";
    IsphPaper(IsphPaperSettings), "isph-paper", "ISPH (incompressible, the paper's)",
        "a pressure equation each step, Morris walls; Afanasiev, Makarchuk & Popov (2008), after Shao & Lo (2003)";
    DeltaSph(DeltaSphSettings), "delta-sph", "\u{3b4}-SPH (weakly compressible)",
        "explicit, weakly compressible, density diffusion, walls that carry pressure; Marrone et al. (2011), Adami, Hu & Adams (2012)";
    Riemann(RiemannSettings), "riemann", "Riemann SPH (weakly compressible)",
        "explicit, weakly compressible, a low-dissipation Riemann problem in each pair; Zhang, Hu & Adams (2017)";
    Edac(EdacSettings), "edac", "EDAC (weakly compressible)",
        "explicit, a diffusing pressure with an equation of its own; Clausen (2013), Ramachandran & Puri (2019)";
    Rkpm(RkpmSettings), "rkpm", "RKPM (weakly compressible, linear kernels)",
        "explicit, kernels that reproduce linear fields, Galerkin forces in pairs; Liu, Jun & Zhang (1995), Bonet & Lok (1999)";
    Mlsph(MlsphSettings), "mlsph", "MLSPH (weakly compressible, moving least squares)",
        "explicit, moving-least-squares interpolants, densities fitted anew; Dilts (1999), Colagrossi & Landrini (2003)";
    Isph(IsphSettings), "isph", "ISPH (incompressible, smooth and robust)",
        "compact pressure equation, exact projections for velocity and density; Cummins & Rudman (1999), Nair & Tomar (2014), Bender & Koschier (2017)";
    IsphShift(IsphShiftSettings), "isph-shift", "ISPH (incompressible, flows that fill their domain)",
        "divergence-free ISPH with shifting and no free surface; Xu, Stansby & Laurence (2009), Lind et al. (2012)";
    Dfsph(DfsphSettings), "dfsph", "DFSPH (incompressible, exact projections)",
        "exact projections of velocity and density, robust, pressure noisy; Bender & Koschier (2017)";
    Iisph(IisphSettings), "iisph", "IISPH (incompressible, exact projection)",
        "exact projection of the density, robust, pressure noisy; Ihmsen et al. (2014)";
    Mps(MpsSettings), "mps", "MPS (incompressible, moving particle semi-implicit)",
        "weights of its own in place of a kernel, pressure from the number density; Koshizuka & Oka (1996)";
    MpsModern(MpsModernSettings), "mps-modern", "MPS (incompressible, relaxed source, corrected gradient)",
        "moving particle semi-implicit; Tanaka & Masunaga (2010), Lee et al. (2011), Khayyer & Gotoh (2011)";
}

impl MethodSettings {
    /// The preset the defaults came from.
    pub fn preset_name(&self) -> Preset {
        with_settings!(self, s => s.preset_name())
    }

    /// Whether every parameter is in its range; `reach` is the radius of the kernel's support in particle spacings.
    ///
    /// # Errors
    /// The first one that is not.
    pub(crate) fn check(&self, reach: f64) -> Result<(), BrokenRule> {
        with_settings!(self, s => s.check(reach))
    }

    /// Fills parameters whose default follows from the state at the start.
    pub(crate) fn resolve(&mut self, still: &Still) {
        with_settings!(self, s => s.resolve(still));
    }

    /// What tells this method from others, in rows of the same names and order for every method.
    pub fn distinctions(&self) -> Vec<Distinction> {
        with_settings!(self, s => s.distinctions()).into_iter().map(|(aspect, value)| Distinction { aspect, value }).collect()
    }

    /// Each difference from the method as its source prints it, as a phrase; empty if there is none. `viscosity` is that of the
    /// fluid, Pa s.
    pub fn departures(&self, viscosity: f64, kernel: KernelName) -> Vec<String> {
        with_settings!(self, s => s.departures(viscosity, kernel))
    }

    /// How the time step is chosen: `courant` is the case's, `fixed` a step in s that replaces the limit.
    pub fn time_step_rule(&self, courant: f64, fixed: Option<f64>) -> String {
        match fixed {
            Some(step) => format!("fixed, {step} s"),
            None => with_settings!(self, s => s.time_step_rule(courant)),
        }
    }

    /// Share of `h/(c + v)` that a sound step takes, dimensionless, where a step of the flow is made of them.
    pub(crate) fn sound_step(&self) -> Option<f64> {
        with_settings!(self, s => s.sound_step())
    }

    /// Speed of sound, m/s, of fluid of depth `depth` (m) under gravity `g` (m/s²) whose fastest particle moves at `fastest`
    /// (m/s); 0 for an incompressible method.
    pub fn sound_speed(&self, g: f64, depth: f64, fastest: f64) -> f64 {
        with_settings!(self, s => s.sound_speed(g, depth, fastest))
    }

    /// Whether walls can hold fluid back; if not, no pressure below zero reaches them.
    pub fn walls_pull(&self) -> bool {
        with_settings!(self, s => s.walls_pull())
    }

    /// The elastic energy that the equation of state stores.
    pub fn elasticity<const D: usize>(&self, medium: &Medium<D>) -> Elasticity {
        with_settings!(self, s => s.elasticity(medium))
    }

    /// Memory beyond columns and pair list for `count` particles with `neighbours` each, bytes.
    pub(crate) fn memory(&self, count: f64, neighbours: f64) -> f64 {
        with_settings!(self, s => s.memory(count, neighbours))
    }

    /// The method, ready to start.
    ///
    /// # Errors
    /// Settings of the pressure solver that contradict each other.
    pub fn scheme<const D: usize>(&self, kernel: KernelName, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        with_settings!(self, s => s.scheme_with(kernel, medium))
    }
}
