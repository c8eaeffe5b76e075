//! Incompressible SPH as the paper states it.

use serde::{Deserialize, Serialize};

use super::Preset;

/// Form of the pressure operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Laplacian {
    /// Equation (16), Shao & Lo (2003).
    ShaoLo,
    /// Equation (17), Brookshaw (1985).
    Brookshaw,
}

/// Parameters of the method `isph-paper`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IsphPaperSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Form of the pressure operator.
    pub laplacian: Laplacian,
    /// `η` of (16) and (18), dimensionless, > 0.
    pub eta: f64,
}
