//! What the settings of a method tell the rest of the house.

use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Medium, Preset, Scheme};
use crate::kernel::{Kernel, KernelName, Named};
use crate::physics::pressure::Elasticity;
use crate::poisson::{SolveError, SolverSettings};

/// A row of the table that tells methods apart, after Table 1 of Afanasiev, Makarchuk & Popov (2008).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Distinction {
    /// What is compared.
    pub aspect: &'static str,
    /// What this method does, with its parameters.
    pub value: String,
}

/// A parameter out of its range.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BrokenRule {
    /// Its key under `[method]`.
    pub key: String,
    /// Its value, as words.
    pub value: String,
    /// What is allowed.
    pub rule: String,
}

impl BrokenRule {
    /// An error unless `holds`.
    pub(crate) fn unless(holds: bool, key: &str, value: impl ToString, rule: impl Into<String>) -> Result<(), Self> {
        if holds { Ok(()) } else { Err(Self { key: key.to_owned(), value: value.to_string(), rule: rule.into() }) }
    }

    /// An error unless `value > 0`.
    pub(crate) fn unless_positive(key: &str, value: f64) -> Result<(), Self> {
        Self::unless(value > 0.0, key, value, "> 0")
    }

    /// An error unless `value >= 0`.
    pub(crate) fn unless_not_negative(key: &str, value: f64) -> Result<(), Self> {
        Self::unless(value >= 0.0, key, value, ">= 0")
    }

    /// An error unless the settings of the pressure solver agree with each other.
    pub(crate) fn unless_solvable(solver: &SolverSettings) -> Result<(), Self> {
        solver.check().map_err(|error| match error {
            SolveError::Setting { key, value, rule } => {
                Self { key: format!("solver.{key}"), value: value.to_string(), rule: rule.to_string() }
            }
            other => Self { key: "solver".to_owned(), value: other.to_string(), rule: "settings of a solver".to_owned() },
        })
    }
}

/// The fluid at the start, as far as defaults depend on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Still {
    /// Magnitude of gravity, m/s².
    pub g: f64,
    /// Height of the fluid along gravity, m.
    pub depth: f64,
    /// Lowest point of the fluid along the direction against gravity, m.
    pub floor: f64,
    /// Largest speed expected, m/s: as [`Medium::speed`].
    pub speed: f64,
    /// Particle spacing, m.
    pub spacing: f64,
    /// Whether the particles come from a file.
    pub from_file: bool,
    /// Whether the case has a pressure of its own: a formula, or zero.
    pub pressure_written: bool,
}

/// The settings of one method, in its file.
pub(super) trait Settings: Serialize + DeserializeOwned + JsonSchema {
    /// The kernel where a case names none, compiled into the loops of the method.
    type Own: Named;
    /// Smoothing length over spacing where a case names none.
    const SMOOTHING: f64;
    /// Whether the method works with the kernel of the case. One that does not has weights of its own.
    const TAKES_KERNEL: bool = true;
    /// Wall-clock time of a step (of a [sound step](Self::sound_step), where there are some) for one particle and one of its neighbours, s, on one core: rounded from dam breaks of some
    /// thousand particles. Machines differ by a factor of two and more.
    const STEP_COST: f64;

    /// The defaults of `preset`.
    fn preset(preset: Preset) -> Self;

    /// The preset the defaults came from.
    fn preset_name(&self) -> Preset;

    /// An error for the first parameter out of its range. `reach` is the radius of the kernel's support in particle spacings.
    fn check(&self, reach: f64) -> Result<(), BrokenRule>;

    /// Fills parameters whose default follows from the state at the start.
    fn resolve(&mut self, _still: &Still) {}

    /// Aspect and value of each row of Table 1; the aspects are those of every other method.
    fn distinctions(&self) -> Vec<(&'static str, String)>;

    /// Each difference from the method as its source prints it, as a phrase.
    fn departures(&self, viscosity: f64, kernel: KernelName) -> Vec<String>;

    /// How the time step is chosen.
    fn time_step_rule(&self, courant: f64) -> String;

    /// Share of `h/(c + v)` that a sound step takes, where a step of the flow is made of them.
    fn sound_step(&self) -> Option<f64> {
        None
    }

    /// Speed of sound, m/s; 0 for an incompressible method.
    fn sound_speed(&self, _g: f64, _depth: f64, _fastest: f64) -> f64 {
        0.0
    }

    /// Whether walls can hold fluid back; if not, no pressure below zero reaches them.
    fn walls_pull(&self) -> bool {
        true
    }

    /// The elastic energy that the equation of state stores.
    fn elasticity<const D: usize>(&self, _medium: &Medium<D>) -> Elasticity {
        Elasticity::None
    }

    /// Memory beyond columns and pair list, bytes.
    fn memory(&self, _count: f64, _neighbours: f64) -> f64 {
        0.0
    }

    /// The method for a fluid, with the kernel of this name: one that is not its own is told apart at every pair.
    fn scheme_with<const D: usize>(&self, kernel: KernelName, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError>
    where
        Self::Own: Kernel<D>,
    {
        if kernel == Self::Own::NAME { self.scheme(Self::Own::default(), medium) } else { self.scheme(kernel, medium) }
    }

    /// The method for a fluid, with a kernel.
    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError>;
}

/// Viscosity that the paper prints, Pa s (its unit, kg/(m s²), is a misprint of kg/(m s)).
const PRINTED_VISCOSITY: f64 = 1.0;

/// Departures of the fluid and the kernel from what the paper prints.
pub(super) fn paper_departures(viscosity: f64, kernel: KernelName, found: &mut Vec<String>) {
    if viscosity != PRINTED_VISCOSITY {
        found.push(format!("dynamic viscosity {viscosity} Pa s in place of the printed {PRINTED_VISCOSITY}"));
    }
    if kernel != KernelName::CubicSpline {
        found.push(format!("kernel {} in place of the cubic spline (12)", kernel.name()));
    }
}

/// `"what now in place of the printed before"` if the two differ.
pub(super) fn changed<T: PartialEq + std::fmt::Display>(what: &str, now: T, printed: T, found: &mut Vec<String>) {
    if now != printed {
        found.push(format!("{what} {now} in place of the printed {printed}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scheme::{MethodName, MethodSettings};

    #[test]
    fn the_paper_preset_has_no_departure_at_the_printed_viscosity() {
        for method in [MethodName::Wcsph, MethodName::IsphPaper] {
            let settings = MethodSettings::preset(method, Preset::Paper);
            assert!(settings.departures(1.0, KernelName::CubicSpline).is_empty(), "{method:?}");
            let other = settings.departures(1e-3, KernelName::WendlandC2);
            assert_eq!(
                other,
                ["dynamic viscosity 0.001 Pa s in place of the printed 1", "kernel wendland-c2 in place of the cubic spline (12)"]
            );
        }
    }

    #[test]
    fn every_departure_of_the_water_presets_is_said() {
        let of = |method| MethodSettings::preset(method, Preset::Water).departures(1.0, KernelName::CubicSpline);
        let wcsph = of(MethodName::Wcsph);
        assert!(wcsph.contains(&"artificial viscosity alpha = 0.05 in place of the printed 1".to_owned()), "{wcsph:?}");
        assert_eq!(wcsph.len(), 3, "{wcsph:?}");
        assert_eq!(of(MethodName::IsphPaper).len(), 2);
    }

    #[test]
    fn all_methods_fill_the_same_rows() {
        let rows = |method| -> Vec<_> { MethodSettings::preset(method, Preset::Water).distinctions().iter().map(|d| d.aspect).collect() };
        for &method in MethodName::ALL {
            assert_eq!(rows(method), rows(MethodName::Wcsph));
        }
    }
}
