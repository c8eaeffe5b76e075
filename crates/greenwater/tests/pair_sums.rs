//! Sums over pairs, eight at a time: the same as pair by pair over all particles, and the same bits whatever the machine does them with.

mod common;

use common::{Flow, medium};
use greenwater::kernel::{Kernel, WendlandC2};
use greenwater::lanes::InstructionSet;
use greenwater::math::Vector;
use greenwater::particles::{Kind, Particles};
use greenwater::physics::diffusion::Diffusion;
use greenwater::physics::lattice::Lattice;
use greenwater::physics::state::PressureLaw;
use greenwater::scheme::acoustic::{StartPressure, TensileControl};
use greenwater::scheme::{DeltaSph, DeltaSphSettings, Medium, Preset};

const SOUND: f64 = 20.0;
const REST: f64 = 1000.0;

/// Nothing that acts on one particle alone, and no artificial viscosity: what it takes and keeps is tested beside its sum (`physics::damping`).
fn settings() -> DeltaSphSettings {
    DeltaSphSettings {
        tensile_control: TensileControl::None,
        start_pressure: Some(StartPressure::Given),
        reference_speed: Some(0.1 * SOUND),
        volume_control: 0.0,
        alpha: 0.0,
        ..DeltaSphSettings::preset(Preset::Water)
    }
}

/// A vessel of disordered fluid, each particle with its own mass, density above rest, velocity and smoothing length.
fn vessel<const D: usize>(cells: [i64; D]) -> Flow<D> {
    let mut flow = Flow::disordered(3, cells, true, REST);
    for body in &mut flow.bodies {
        body.density = REST + (body.density - REST).abs();
    }
    flow
}

/// Acceleration of fluid and rate of its density, `(m/s², kg/(m³ s))`, by the formulas of the method over all pairs. `surface`: where the free surface is.
fn by_all_pairs<const D: usize>(p: &Particles<D>, medium: &Medium<D>, surface: &[u8]) -> Vec<(Vector<D>, f64)> {
    let DeltaSphSettings { delta, .. } = settings();
    let lattice = Lattice::of::<_, D>(WendlandC2, p.h_max(), medium.spacing, REST);
    let slope = 1.0 / lattice.slope_of_linear::<D>();
    let near = |a: usize| {
        (0..p.owned()).filter(move |&b| b != a).map(move |b| {
            let x_ab = p.x[a] - p.x[b];
            (b, x_ab, x_ab.norm(), 0.5 * (p.h[a] + p.h[b]))
        })
    };
    let w = |r: f64, h: f64| Kernel::<D>::w(WendlandC2, r, h);
    let stiffness = SOUND * SOUND;
    let mut pressure: Vec<f64> = p.density[..p.owned()].iter().map(|density| stiffness * (density - REST)).collect();
    // What pressure counts for within reach of the surface.
    let counts = |a: usize| {
        let reaches = |(b, _, r, h): (usize, Vector<D>, f64, f64)| surface[b] == 1 && w(r, h) > 0.0;
        let filled: f64 = near(a).map(|(b, _, r, h)| -p.mass[b] / REST * slope * Kernel::<D>::dw_over_r(WendlandC2, r, h) * r * r).sum();
        let beside = p.is_fluid(a) && (surface[a] == 1 || near(a).any(reaches));
        // The library keeps it in single precision.
        if beside { f64::from(lattice.surface_weight(filled / D as f64) as f32) } else { 1.0 }
    };
    let weight: Vec<f64> = (0..p.owned()).map(counts).collect();
    assert!(weight.iter().any(|&weight| weight > 1.1) && weight.iter().zip(surface).any(|(&weight, &at)| weight > 1.0 && at == 0));
    (0..p.owned()).for_each(|a| pressure[a] *= weight[a]);
    let fluid = pressure.clone();
    let mut rubbing = p.v.clone();
    for a in (0..p.owned()).filter(|&a| !p.is_fluid(a)) {
        let (mut sum, mut flow, mut total) = (0.0, Vector::ZERO, 0.0);
        for (b, x_ab, r, h) in near(a).filter(|pair| p.is_fluid(pair.0)) {
            sum += w(r, h) * (fluid[b] + REST * medium.gravity.dot(x_ab));
            flow += w(r, h) * p.v[b];
            total += w(r, h);
        }
        pressure[a] = if total > 0.0 { (sum / total).max(0.0) } else { 0.0 };
        rubbing[a] = if total > 0.0 { -flow / total } else { Vector::ZERO };
    }
    let stays = REST / stiffness * medium.gravity;
    (0..p.owned())
        .map(|a| {
            let (mut push, mut rate) = (medium.gravity, 0.0);
            for (b, x_ab, r, h) in near(a) {
                let dw = slope * p.mass[b] * Kernel::<D>::dw_over_r(WendlandC2, r, h);
                let mut along = -(pressure[a] + pressure[b]);
                if p.is_fluid(b) {
                    rate += dw * 2.0 * delta * h * SOUND / REST * (p.density[a] - p.density[b] - stays.dot(x_ab));
                } else {
                    // A wall does not pull, and without pressure it pushes less by what a row of liquid weighs.
                    let row = REST * medium.g() * medium.spacing;
                    along = along.max((-8.0 * pressure[b]).min(along + row)).min(0.0);
                }
                push += dw / (REST * REST) * (along * x_ab + 2.0 * medium.viscosity * (rubbing[a] - rubbing[b]));
                rate += weight[a] * dw * (p.v[a] - p.v[b]).dot(x_ab);
            }
            (push, rate)
        })
        .collect()
}

fn agrees_with_all_pairs<const D: usize>(cells: [i64; D]) {
    let (flow, medium) = (vessel(cells), Medium { depth: 1.0, ..medium(0.5) });
    let mut simulation = flow.simulation(Box::new(DeltaSph::delta_sph(WendlandC2, medium, &settings())), &medium, 1e-4);
    let before = simulation.particles().clone();
    simulation.start().unwrap();
    let p = simulation.particles();
    let twin = by_all_pairs(&before, &medium, &p.surface);
    let fluid = || (0..p.owned()).filter(|&a| p.kind[a] == Kind::Fluid);
    let size = fluid().map(|a| twin[a].0.norm()).fold(0.0, f64::max);
    let fastest = fluid().map(|a| twin[a].1.abs()).fold(0.0, f64::max);
    for a in fluid() {
        // 1e-12: round-off of some ten or a hundred terms that nearly cancel.
        assert!((p.acceleration[a] - twin[a].0).norm() < 1e-12 * size, "{a}: {:?} for {:?}", p.acceleration[a], twin[a].0);
        assert!((p.density_rate[a] - twin[a].1).abs() < 1e-12 * fastest, "{a}: {} for {}", p.density_rate[a], twin[a].1);
    }
}

#[test]
fn forces_and_rates_are_those_of_all_pairs() {
    agrees_with_all_pairs([9, 7]);
    agrees_with_all_pairs([5, 4, 5]);
}

/// The state after some steps, as bits.
fn after<const D: usize>(set: InstructionSet, cells: [i64; D], settings: &DeltaSphSettings) -> Vec<u64> {
    let medium = Medium { depth: 1.0, ..medium(0.5) };
    let scheme = DeltaSph::delta_sph(WendlandC2, medium, settings).on(set);
    let mut simulation = vessel(cells).simulation(Box::new(scheme), &medium, 1e-3);
    simulation.start().unwrap();
    for _ in 0..3 {
        simulation.advance().unwrap();
    }
    let p = simulation.particles();
    let numbers = |a: usize| {
        let vectors = [p.x[a], p.v[a], p.acceleration[a], p.force[a]];
        vectors.into_iter().flat_map(|v| v.0).chain([p.density[a], p.pressure[a]]).collect::<Vec<_>>()
    };
    (0..p.owned()).flat_map(numbers).map(f64::to_bits).collect()
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let variants = [
        DeltaSphSettings { tensile_control: TensileControl::Switch, alpha: 0.5, ..settings() },
        DeltaSphSettings { diffusion: Diffusion::Antuono, ..settings() },
        DeltaSphSettings { pressure_law: PressureLaw::Tait, ..settings() },
    ];
    for settings in &variants {
        let (plane, space) = (after(InstructionSet::Portable, [9, 7], settings), after(InstructionSet::Portable, [5, 4, 5], settings));
        for set in InstructionSet::available() {
            assert_eq!(after(set, [9, 7], settings), plane, "{}", set.name());
            assert_eq!(after(set, [5, 4, 5], settings), space, "{}", set.name());
        }
    }
}
