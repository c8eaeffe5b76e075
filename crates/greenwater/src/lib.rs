//! Violent free-surface flow by particle methods.

pub mod kernel;
pub mod math;
pub mod particles;
pub mod scheme;
