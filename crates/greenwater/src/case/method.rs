//! The parameters of a method: those of its preset, with the keys of the case laid over them.

use toml::{Table, Value};

use super::error::CaseError;
use super::sections::Method;
use super::source::Source;
use crate::scheme::MethodSettings;

/// The parameters that `[method]` asks for, checked; `reach` is the radius of the kernel's support in particle spacings.
pub(super) fn settings(method: &Method, reach: f64, source: &Source) -> Result<MethodSettings, CaseError> {
    let mut keys = table(&MethodSettings::preset(method.name, method.preset));
    keys.remove("name");
    overlay(&mut keys, &method.keys);
    let settings = source.read_method(method.name, Value::Table(keys))?;
    settings.check(reach).map_err(|broken| source.broken(&format!("method.{}", broken.key), broken.value, broken.rule))?;
    Ok(settings)
}

/// All parameters of a method as the keys of a case, `name` and `preset` among them.
pub(super) fn table(settings: &MethodSettings) -> Table {
    Table::try_from(settings).unwrap_or_default()
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
