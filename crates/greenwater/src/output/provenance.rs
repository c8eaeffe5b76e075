//! Where a run comes from: `provenance.json`.

use serde_json::{Value, json};

use crate::case::Setup;
use crate::machine::Machine;
use crate::math::Vector;
use crate::observe::{Sensor, gauge_unit};
use crate::particles::Particles;

/// What `provenance.json` says. `command` is the command line, word by word.
pub(super) fn provenance<const D: usize>(setup: &Setup<D>, command: &[String], started: &str) -> Value {
    let (min, max) = extent(&setup.particles);
    let references: Vec<Value> = setup.compare.references.iter().map(|reference| json!(reference)).collect();
    let probe = |probe: &Sensor<D>| {
        let on = probe.mount.as_ref().map(|mount| &mount.wall);
        json!({"name": probe.name, "position": probe.position.0.to_vec(), "size": probe.size, "on": on})
    };
    let probes: Vec<Value> = setup.probes.iter().map(probe).collect();
    let gauges: Vec<Value> = setup.gauges.iter().map(|gauge| json!({"name": gauge.name, "unit": gauge_unit(&gauge.kind)})).collect();
    let loads: Vec<Value> = setup.loads.iter().map(|load| json!({"name": load.name, "about": load.about.0.to_vec()})).collect();
    let mut value = json!({
        "format": 1,
        "program": "greenwater",
        "version": env!("CARGO_PKG_VERSION"),
        "command": command,
        "case": setup.name,
        "title": setup.title,
        "method": setup.method.method().name(),
        "method_title": setup.method.method().title(),
        "preset": setup.method.preset_name().name(),
        "dimension": D,
        "started": started,
        "machine": Machine::here(),
        "threads": rayon::current_num_threads(),
        "kernel": {
            "name": setup.kernel.name(),
            "smoothing_length_m": setup.smoothing_length,
            "h_over_spacing": setup.h_over_spacing,
        },
        "particles": {"fluid": setup.estimate.fluid, "wall": setup.estimate.walls},
        "time_step_rule": time_step_rule(setup),
        "departures": setup.method.departures(setup.viscosity, setup.kernel),
        "distinctions": setup.method.distinctions(),
        "driven": driven(setup),
        "scales": {
            "rest_density": setup.rest_density,
            "viscosity": setup.viscosity,
            "gravity": setup.gravity.norm(),
            "height": setup.depth,
            "width": setup.width,
            "spacing": setup.spacing,
            "fluid_volume": setup.fluid_volume,
            "box": {"min": min.0.to_vec(), "max": max.0.to_vec()},
        },
        "compare": {"times": setup.compare.times, "references": references},
        "probes": probes,
        "gauges": gauges,
        "loads": loads,
    });
    if let Some(axis) = up_axis(setup.gravity) {
        value["scales"]["up_axis"] = json!(axis);
    }
    value
}

/// How the time step is chosen: by the method, and by walls that move.
fn time_step_rule<const D: usize>(setup: &Setup<D>) -> String {
    let rule = setup.method.time_step_rule(setup.time.courant, setup.time.step);
    if setup.motions.is_empty() || setup.time.step.is_some() {
        return rule;
    }
    format!("{rule}; walls that move go half of h in a step at most")
}

/// Whether something does work on the fluid: walls that move, or gravity along an axis that repeats.
fn driven<const D: usize>(setup: &Setup<D>) -> bool {
    !setup.motions.is_empty() || (0..D).any(|d| setup.bounds.periodic[d] && setup.gravity[d] != 0.0)
}

/// Corners of the smallest box around all particles, m.
fn extent<const D: usize>(p: &Particles<D>) -> (Vector<D>, Vector<D>) {
    let corners = p.x[..p.owned()].iter().map(|&x| (x, x));
    corners.reduce(|a, b| (a.0.zip(b.0, f64::min), a.1.zip(b.1, f64::max))).unwrap_or_default()
}

/// The axis that gravity points against most; none without gravity.
fn up_axis<const D: usize>(gravity: Vector<D>) -> Option<usize> {
    let strongest = (0..D).reduce(|a, b| if gravity[b].abs() > gravity[a].abs() { b } else { a })?;
    (gravity[strongest] != 0.0).then_some(strongest)
}
