//! Pair terms: pure functions of the values of two particles, and the sums over neighbours that are made of them.
//!
//! `x_ab = x_a − x_b`, `v_ab = v_a − v_b`; `∇_a W_ab = (W'/r) x_ab`, so `x_ab · ∇_a W_ab = (W'/r) r² <= 0`.

pub mod arrangement;
pub mod consistency;
pub mod correction;
pub(crate) mod damping;
pub mod density;
pub mod diffusion;
pub mod lattice;
pub(crate) mod pairs;
pub mod pressure;
pub mod shifting;
pub mod state;
pub mod surface;
pub mod viscosity;

pub use density::summation_density;
