//! What pairs of particles exchange is lost nowhere: momentum, and angular momentum where forces are central.

mod common;

use common::{Flow, SPACING, medium};
use greenwater::kernel::CubicSpline;
use greenwater::particles::{Kind, Particles};
use greenwater::scheme::isph_paper::{IsphPaperSettings, SurfaceGhosts};
use greenwater::scheme::wcsph::{InitialDensity, WcsphSettings};
use greenwater::scheme::{Dfsph, DfsphSettings, Iisph, IsphPaper, Medium, Preset, Scheme, Wcsph};
use greenwater::simulation::Simulation;

fn explicit<const D: usize>(medium: &Medium<D>) -> Box<dyn Scheme<D>> {
    let settings = WcsphSettings { initial_density: Some(InitialDensity::Given), ..WcsphSettings::preset(Preset::Paper) };
    Box::new(Wcsph::new(CubicSpline, *medium, settings))
}

/// Without mirrored ghosts, which push on a particle and on nothing else.
fn incompressible<const D: usize>(medium: &Medium<D>) -> Box<dyn Scheme<D>> {
    let settings = IsphPaperSettings { surface_ghosts: SurfaceGhosts::None, ..IsphPaperSettings::preset(Preset::Water) };
    Box::new(IsphPaper::new(CubicSpline, *medium, settings).unwrap())
}

fn divergence_free<const D: usize>(medium: &Medium<D>) -> Box<dyn Scheme<D>> {
    Box::new(Dfsph::new(CubicSpline, *medium, &DfsphSettings::preset(Preset::Water)))
}

fn constant_density<const D: usize>(medium: &Medium<D>) -> Box<dyn Scheme<D>> {
    Box::new(Iisph::new(CubicSpline, *medium, &DfsphSettings::preset(Preset::Water)))
}

fn started<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, scheme: Box<dyn Scheme<D>>, dt: f64) -> Simulation<D> {
    let mut simulation = flow.simulation(scheme, medium, dt);
    simulation.start().unwrap();
    simulation
}

/// Largest component of the sum of all forces but gravity, over the sum of their sizes.
fn lost_force<const D: usize>(p: &Particles<D>, medium: &Medium<D>) -> f64 {
    let (mut sum, mut size) = ([0.0; D], 0.0);
    for a in 0..p.owned() {
        let force = p.mass[a] * (p.acceleration[a] - medium.gravity);
        (0..D).for_each(|d| sum[d] += force[d]);
        size += force.norm();
    }
    sum.iter().fold(0.0, |most: f64, x| most.max(x.abs())) / size
}

/// The same of torques about the origin, with the size of the block as arm.
fn lost_torque<const D: usize>(p: &Particles<D>, medium: &Medium<D>) -> f64 {
    let (mut sum, mut size) = ([[0.0; D]; D], 0.0);
    for a in 0..p.owned() {
        let force = p.mass[a] * (p.acceleration[a] - medium.gravity);
        for d in 0..D {
            for e in 0..D {
                sum[d][e] += p.x[a][d] * force[e] - p.x[a][e] * force[d];
            }
        }
        size += p.x[a].norm() * force.norm();
    }
    sum.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs())) / size
}

/// `1e-13` of the sum of all sizes: a force is the sum of some 100 pair forces up to a hundred times as large as it, each rounded
/// by 1e-16, and the errors of hundreds of particles cancel in part.
const ROUND_OFF: f64 = 1e-13;

fn forces_cancel<const D: usize>(flow: &Flow<D>, scheme: fn(&Medium<D>) -> Box<dyn Scheme<D>>) {
    let viscous = medium(1.0);
    let simulation = started(flow, &viscous, scheme(&viscous), 1e-4);
    let lost = lost_force(simulation.particles(), &viscous);
    assert!(lost < ROUND_OFF, "lost force {lost:.1e}");

    // Pressure and artificial viscosity act along the line between two particles; (18) and (24) do not.
    let inviscid = medium(0.0);
    let simulation = started(flow, &inviscid, scheme(&inviscid), 1e-4);
    let lost = lost_torque(simulation.particles(), &inviscid);
    assert!(lost < ROUND_OFF, "lost torque {lost:.1e}");
}

#[test]
fn forces_of_wcsph_pairs_cancel() {
    forces_cancel(&Flow::disordered(31, [18, 18], false, 1000.0), explicit);
    forces_cancel(&Flow::disordered(32, [7, 7, 7], false, 1000.0), explicit);
}

#[test]
fn forces_of_isph_pairs_cancel_without_surface_ghosts() {
    forces_cancel(&Flow::disordered(33, [18, 18], false, 1000.0), incompressible);
    forces_cancel(&Flow::disordered(34, [7, 7, 7], false, 1000.0), incompressible);
}

/// However loose the solve: the gradient is the adjoint of the divergence, pair by pair.
#[test]
fn forces_of_exact_projections_cancel() {
    for scheme in [divergence_free, constant_density] {
        forces_cancel(&Flow::disordered(36, [14, 14], false, 1000.0), scheme);
    }
    forces_cancel(&Flow::disordered(37, [6, 6, 6], false, 1000.0), constant_density);
}

/// Momentum of a falling drop after `steps` steps less that of the start and of gravity, over the sum of `m |v|`.
fn momentum_error(scheme: fn(&Medium<2>) -> Box<dyn Scheme<2>>, dt: f64, steps: usize) -> f64 {
    let mut flow = Flow::<2>::disordered(35, [16, 16], false, 1000.0);
    let radius = 8.0 * SPACING;
    flow.bodies.retain(|b| (b.x[0] - radius).hypot(b.x[1] - radius) < radius);
    let medium = medium(1.0);
    let mut simulation = started(&flow, &medium, scheme(&medium), dt);
    let momentum = |p: &Particles<2>| {
        let mut sum = [0.0; 2];
        (0..p.owned()).for_each(|a| (0..2).for_each(|d| sum[d] += p.mass[a] * p.v[a][d]));
        sum
    };
    let before = momentum(simulation.particles());
    for _ in 0..steps {
        simulation.advance().unwrap();
    }
    let p = simulation.particles();
    assert_eq!(p.count(Kind::Fluid), p.owned(), "some left the domain");
    let (after, mass): (_, f64) = (momentum(p), p.mass[..p.owned()].iter().sum());
    let size: f64 = (0..p.owned()).map(|a| p.mass[a] * p.v[a].norm()).sum();
    let lost = |d: usize| (after[d] - before[d] - mass * medium.gravity[d] * simulation.time()).abs();
    lost(0).max(lost(1)) / size
}

/// `1e-12`: as many steps of the round-off above. Each method at a step of its own size: (31) answers the disorder of the start with
/// speeds of `δ/Δt`, and the exact projections with so much that the drop has left the domain after some fifty steps.
#[test]
fn a_falling_drop_keeps_its_momentum() {
    let methods = [
        ("wcsph", explicit as fn(&Medium<2>) -> _, 1e-4, 100),
        ("isph-paper", incompressible, 2e-3, 100),
        ("dfsph", divergence_free, 2e-3, 20),
        ("iisph", constant_density, 2e-3, 20),
    ];
    for (name, scheme, dt, steps) in methods {
        let error = momentum_error(scheme, dt, steps);
        assert!(error < 1e-12, "{name}: momentum off by {error:.1e}");
    }
}
