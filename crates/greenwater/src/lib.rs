//! Violent free-surface flow by particle methods.

pub mod case;
pub mod domain;
pub mod formula;
mod gather;
pub mod kernel;
pub mod lanes;
pub mod machine;
pub mod math;
pub mod motion;
pub mod neighbors;
pub mod observe;
pub mod output;
pub mod particles;
pub mod physics;
pub mod poisson;
pub mod reduce;
pub mod scheme;
pub mod simulation;
mod sweep;
pub mod time;
pub mod walls;
