//! The parameters of a method: those of its preset, with the keys of the case laid over them.

use toml::{Table, Value};

use super::error::CaseError;
use super::sections::Method;
use super::source::Source;
use crate::scheme::isph_paper::{IsphPaperSettings, Laplacian};
use crate::scheme::wcsph::{EquationOfState, WallForce, WcsphSettings};
use crate::scheme::{MethodName, MethodSettings, Preset};

/// The parameters that `[method]` asks for.
pub(super) fn settings(method: &Method, source: &Source) -> Result<MethodSettings, CaseError> {
    let mut keys = table(&preset(method.name, method.preset));
    keys.remove("name");
    overlay(&mut keys, &method.keys);
    let keys = Value::Table(keys);
    Ok(match method.name {
        MethodName::Wcsph => MethodSettings::Wcsph(source.read("method", keys)?),
        MethodName::IsphPaper => MethodSettings::IsphPaper(source.read("method", keys)?),
    })
}

/// All parameters of a method as the keys of a case, `name` and `preset` among them.
pub(super) fn table(settings: &MethodSettings) -> Table {
    Table::try_from(settings).unwrap_or_default()
}

/// Puts the values of `keys` into `base`, table by table. A table that names another choice replaces the one below it.
fn overlay(base: &mut Table, keys: &Table) {
    for (key, value) in keys {
        match (base.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above)) if above.get("name").is_none_or(|name| below.get("name") == Some(name)) => {
                overlay(below, above);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}

/// The parameters a method starts from.
fn preset(name: MethodName, preset: Preset) -> MethodSettings {
    match name {
        MethodName::Wcsph => MethodSettings::Wcsph(WcsphSettings {
            preset,
            equation_of_state: if preset == Preset::Paper { EquationOfState::InitialHeight } else { EquationOfState::Constant },
            stiffness: 200.0,
            stiffness_floor: 0.1,
            depth: None,
            alpha: if preset == Preset::Paper { 1.0 } else { 0.02 },
            beta: if preset == Preset::Paper { 1.0 } else { 0.0 },
            eta: 0.1,
            wall_force: WallForce::LennardJones,
            wall_exponents: [12, 6],
            wall_strength: None,
            wall_range: None,
        }),
        MethodName::IsphPaper => MethodSettings::IsphPaper(IsphPaperSettings { preset, laplacian: Laplacian::ShaoLo, eta: 0.1 }),
    }
}
