//! The parameters of a method: those of its preset, with the keys of the case laid over them.

use toml::{Table, Value};

use super::error::CaseError;
use super::sections::Method;
use super::source::Source;
use crate::poisson::{SolveError, SolverMethod};
use crate::scheme::{MethodName, MethodSettings};

/// The parameters that `[method]` asks for, checked.
pub(super) fn settings(method: &Method, source: &Source) -> Result<MethodSettings, CaseError> {
    let mut keys = table(&MethodSettings::preset(method.name, method.preset));
    keys.remove("name");
    overlay(&mut keys, &method.keys);
    let keys = Value::Table(keys);
    let settings = match method.name {
        MethodName::Wcsph => MethodSettings::Wcsph(source.read("method", keys)?),
        MethodName::IsphPaper => MethodSettings::IsphPaper(source.read("method", keys)?),
    };
    check(&settings, source)?;
    Ok(settings)
}

/// All parameters of a method as the keys of a case, `name` and `preset` among them.
pub(super) fn table(settings: &MethodSettings) -> Table {
    Table::try_from(settings).unwrap_or_default()
}

/// Memory of the pressure equation for `count` particles, bytes: 16 for a matrix entry, the dense matrix of Gauss, the vectors of GMRES.
pub(super) fn solver_memory(settings: &MethodSettings, count: f64, neighbours: f64) -> f64 {
    match settings {
        MethodSettings::Wcsph(_) => 0.0,
        MethodSettings::IsphPaper(s) => {
            let matrix = 16.0 * count * neighbours;
            match s.solver.method {
                SolverMethod::Gauss => matrix + 8.0 * count * count,
                SolverMethod::Gmres => matrix + 8.0 * count * (s.solver.restart as f64 + 1.0),
                SolverMethod::Cg | SolverMethod::Bicgstab => matrix,
            }
        }
    }
}

/// Puts the values of `keys` into `base`, table by table.
fn overlay(base: &mut Table, keys: &Table) {
    for (key, value) in keys {
        match (base.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => overlay(below, above),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

fn check(settings: &MethodSettings, source: &Source) -> Result<(), CaseError> {
    let rule = |holds: bool, key: &str, value: f64, rule: &str| source.rule(holds, &format!("method.{key}"), value, rule);
    let positive = |key: &str, value: f64| rule(value > 0.0, key, value, "> 0");
    let not_negative = |key: &str, value: f64| rule(value >= 0.0, key, value, ">= 0");
    match settings {
        MethodSettings::Wcsph(s) => {
            positive("stiffness", s.stiffness)?;
            let share = s.stiffness_floor;
            rule(share > 0.0 && share <= 1.0, "stiffness_floor", share, "> 0 and <= 1")?;
            not_negative("alpha", s.alpha)?;
            not_negative("beta", s.beta)?;
            positive("eta", s.eta)?;
            let [high, low] = s.wall_exponents;
            source.rule(
                high > low && low >= 1,
                "method.wall_exponents",
                format!("[{high}, {low}]"),
                "two whole numbers >= 1, the larger first",
            )?;
            for (key, value) in [("depth", s.depth), ("wall_strength", s.wall_strength), ("wall_range", s.wall_range)] {
                value.map_or(Ok(()), |value| positive(key, value))?;
            }
            Ok(())
        }
        MethodSettings::IsphPaper(s) => {
            positive("eta", s.eta)?;
            not_negative("alpha", s.alpha)?;
            rule(s.surface_threshold > 0.0 && s.surface_threshold < 1.0, "surface_threshold", s.surface_threshold, "> 0 and < 1")?;
            rule(s.surface_radius > 0.71, "surface_radius", s.surface_radius, "> 0.71")?;
            s.solver.check().map_err(|error| match error {
                SolveError::Setting { key, value, rule } => source.broken(&format!("method.solver.{key}"), value, rule),
                other => source.broken("method.solver", other, "settings of a solver"),
            })
        }
    }
}
