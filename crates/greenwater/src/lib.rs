//! Violent free-surface flow by particle methods.

pub mod domain;
pub mod kernel;
pub mod math;
pub mod neighbors;
pub mod particles;
pub mod poisson;
pub mod reduce;
pub mod scheme;
mod sweep;
