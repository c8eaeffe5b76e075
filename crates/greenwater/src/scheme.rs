//! The methods: one file a published method, and the list of them.

pub mod isph_paper;
pub mod wcsph;

use serde::{Deserialize, Serialize};

use isph_paper::IsphPaperSettings;
use wcsph::WcsphSettings;

/// The methods a case may name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MethodName {
    /// Weakly compressible SPH as the paper states it.
    Wcsph,
    /// Incompressible SPH as the paper states it.
    IsphPaper,
}

/// Which defaults a method starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Little dissipation, and the documented departures that let the method run a whole dam break.
    #[default]
    Water,
    /// Every number and formula as the paper prints it.
    Paper,
}

/// A method with all its parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "name", rename_all = "kebab-case")]
pub enum MethodSettings {
    /// Parameters of [`MethodName::Wcsph`].
    Wcsph(WcsphSettings),
    /// Parameters of [`MethodName::IsphPaper`].
    IsphPaper(IsphPaperSettings),
}
