//! Prints a hash of the whole state of a dam break after some steps of every method: equal for any number of threads and any
//! optimisation level of the build.
//!
//! `cargo run --example fingerprint -- [CASE] [STEPS]`; default `dam-break-20` and 20 steps. A line a method: name, steps, hash.

use std::error::Error;

use greenwater::case::{AnySetup, Case};
use greenwater::particles::Particles;
use greenwater::scheme::MethodName;
use greenwater::simulation::Simulation;

/// Hash of positions, velocities, densities and pressures after `steps` steps of `method` on `case`.
///
/// # Errors
/// Cases that are wrong, steps that fail.
pub fn fingerprint(case: &str, method: MethodName, steps: usize) -> Result<u64, Box<dyn Error>> {
    fn run<const D: usize>(mut simulation: Simulation<D>, steps: usize) -> Result<u64, Box<dyn Error>> {
        simulation.start()?;
        for _ in 0..steps {
            simulation.advance()?;
        }
        Ok(hash(simulation.particles()))
    }
    match Case::load(case, &[])?.for_method(method, None).checked()? {
        AnySetup::D2(setup) => run(setup.simulation()?, steps),
        AnySetup::D3(setup) => run(setup.simulation()?, steps),
    }
}

/// FNV-1a (Fowler, Noll & Vo) over the bits of every real particle, by rows.
fn hash<const D: usize>(p: &Particles<D>) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |value: f64| {
        for byte in value.to_bits().to_le_bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    };
    for a in 0..p.owned() {
        p.x[a].0.iter().chain(&p.v[a].0).for_each(|&value| add(value));
        add(p.density[a]);
        add(p.pressure[a]);
    }
    hash
}

#[allow(dead_code)] // The test of determinism takes this file as a module.
fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let case = arguments.next().unwrap_or_else(|| "dam-break-20".to_owned());
    let steps = arguments.next().map_or(Ok(20), |text| text.parse())?;
    for method in MethodName::ALL.iter().copied() {
        println!("{} {steps} {:016x}", method.name(), fingerprint(&case, method, steps)?);
    }
    Ok(())
}
