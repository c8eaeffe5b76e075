//! What a choice of parameters means, in words for reports: the rows of the paper's Table 1, and every departure from print.

use serde::Serialize;

use super::isph_paper::{DensitySource, Laplacian, SurfaceGhosts, WallGuard};
use super::wcsph::{EquationOfState, InitialDensity, WallForce};
use super::{IsphPaperSettings, MethodSettings, Preset, WcsphSettings};
use crate::kernel::KernelName;
use crate::physics::surface::SurfaceTest;
use crate::poisson::{PreconditionerKind, SolverMethod};

/// Viscosity that the paper prints, Pa s (its unit, kg/(m s²), is a misprint of kg/(m s)).
const PRINTED_VISCOSITY: f64 = 1.0;

/// A row of the table that tells methods apart, after Table 1 of Afanasiev, Makarchuk & Popov (2008).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Distinction {
    /// What is compared.
    pub aspect: &'static str,
    /// What this method does, with its parameters.
    pub value: String,
}

impl MethodSettings {
    /// What tells this method from others, in rows of the same names and order for every method.
    pub fn distinctions(&self) -> Vec<Distinction> {
        let rows = match self {
            Self::Wcsph(s) => wcsph_rows(s),
            Self::IsphPaper(s) => isph_rows(s),
        };
        rows.into_iter().map(|(aspect, value)| Distinction { aspect, value }).collect()
    }

    /// How the time step is chosen: `courant` is `C` of (32), `fixed` a step in s that replaces the limit.
    pub fn time_step_rule(&self, courant: f64, fixed: Option<f64>) -> String {
        if let Some(step) = fixed {
            return format!("fixed, {step} s");
        }
        match self {
            Self::Wcsph(_) => format!("(32): {courant} h over the greatest of sound speed plus speed"),
            Self::IsphPaper(_) => format!("(32): {courant} h over the greatest speed, at least sqrt(g H)"),
        }
    }

    /// Each difference from the method as the paper prints it, as a phrase; empty if there is none. `viscosity` is that of the
    /// fluid, Pa s.
    pub fn departures(&self, viscosity: f64, kernel: KernelName) -> Vec<String> {
        let mut found = match self {
            Self::Wcsph(s) => wcsph_departures(s),
            Self::IsphPaper(s) => isph_departures(s),
        };
        if viscosity != PRINTED_VISCOSITY {
            found.push(format!("dynamic viscosity {viscosity} Pa s in place of the printed {PRINTED_VISCOSITY}"));
        }
        if kernel != KernelName::CubicSpline {
            found.push(format!("kernel {} in place of the cubic spline (12)", kernel.name()));
        }
        found
    }
}

fn wcsph_rows(s: &WcsphSettings) -> Vec<(&'static str, String)> {
    let stiffness = s.stiffness;
    let pressure = match s.equation_of_state {
        EquationOfState::Constant => format!("equation of state (25) with B = {stiffness} \u{3c1}0 g H/7 everywhere"),
        EquationOfState::InitialHeight => format!("equation of state (25) with B = {stiffness} \u{3c1}0 g (H - y)/7, y at the start"),
        EquationOfState::CurrentHeight => format!("equation of state (25) with B = {stiffness} \u{3c1}0 g (H - y)/7, y now"),
    };
    let start = match s.initial_density {
        Some(InitialDensity::Given) => "as given",
        Some(InitialDensity::Hydrostatic) | None => "under the weight of the fluid above",
    };
    let [high, low] = s.wall_exponents;
    let walls = match s.wall_force {
        WallForce::LennardJones => format!("Lennard-Jones force (33)-(34), repulsion only, exponents {high} and {low}"),
        WallForce::LennardJonesAttractive => format!("Lennard-Jones force (33)-(34) with its attraction, exponents {high} and {low}"),
        WallForce::Monaghan2005 => "normal force of Monaghan (2005)".to_owned(),
    };
    vec![
        ("compressibility", format!("weakly compressible, sound speed sqrt({stiffness} g H)")),
        ("pressure from", pressure),
        ("density from", format!("continuity equation (22); at the start {start}")),
        ("viscosity", format!("artificial (13), alpha = {}, beta = {}, and the stress (23)-(24)", s.alpha, s.beta)),
        ("time step limited by", "sound speed plus speed (32)".to_owned()),
        ("time stepping", "explicit, predictor-corrector (27)-(28)".to_owned()),
        ("walls", walls),
        ("free surface", "nothing special: pressure vanishes where the density is that at rest".to_owned()),
        ("linear system", "none".to_owned()),
        ("work of a step", "two sums over neighbours".to_owned()),
    ]
}

fn isph_rows(s: &IsphPaperSettings) -> Vec<(&'static str, String)> {
    let operator = match s.laplacian {
        Laplacian::ShaoLo => "(16), Shao & Lo (2003)",
        Laplacian::Brookshaw => "(17), Brookshaw (1985)",
    };
    let source = match s.density_source {
        DensitySource::Step => "a density error removed within a step",
        DensitySource::Front => "a density error removed within the step of the fastest front",
    };
    let guard = match s.wall_guard {
        WallGuard::None => "",
        WallGuard::SetBack => "; what would cross their face is set back",
    };
    let surface = match s.surface {
        SurfaceTest::Density => format!("density below {} of rest", s.surface_threshold),
        SurfaceTest::Dilts => format!("uncovered arcs of discs of {} spacings (Dilts 2000)", s.surface_radius),
    };
    let beyond = match s.surface_ghosts {
        SurfaceGhosts::Mirrored => "neighbours mirrored with opposite pressure",
        SurfaceGhosts::None => "nothing beyond",
    };
    let method = match s.solver.method {
        SolverMethod::Gauss => "Gauss elimination",
        SolverMethod::Gmres => "GMRES",
        SolverMethod::Cg => "conjugate gradients",
        SolverMethod::Bicgstab => "BiCGStab",
    };
    let preconditioner = match (s.solver.method, s.solver.preconditioner) {
        (SolverMethod::Gauss, _) | (_, PreconditionerKind::None) => "",
        (_, PreconditionerKind::Jacobi) => " with Jacobi preconditioner",
        (_, PreconditionerKind::Ilu0) => " with ILU(0) preconditioner",
        (_, PreconditionerKind::Ic0) => " with IC(0) preconditioner",
    };
    let added = if s.alpha == 0.0 { String::new() } else { format!(" and artificial (13), alpha = {}", s.alpha) };
    vec![
        ("compressibility", "incompressible".to_owned()),
        ("pressure from", format!("equation (31) with operator {operator}; {source}")),
        ("density from", "sum over neighbours (11)".to_owned()),
        ("viscosity", format!("of the fluid (18){added}")),
        ("time step limited by", "speed (32)".to_owned()),
        ("time stepping", "prediction (29), pressure, correction (30)".to_owned()),
        ("walls", format!("three rows of fixed particles, one of them in the pressure equation{guard}")),
        ("free surface", format!("{surface}; {beyond}")),
        ("linear system", format!("{method}{preconditioner}, residual {:e}", s.solver.tolerance)),
        ("work of a step", "sums over neighbours and one linear system".to_owned()),
    ]
}

/// `"what now in place of the printed before"` if the two differ.
fn changed<T: PartialEq + std::fmt::Display>(what: &str, now: T, printed: T, found: &mut Vec<String>) {
    if now != printed {
        found.push(format!("{what} {now} in place of the printed {printed}"));
    }
}

fn wcsph_departures(s: &WcsphSettings) -> Vec<String> {
    let printed = WcsphSettings::preset(Preset::Paper);
    let mut found = Vec::new();
    match s.equation_of_state {
        EquationOfState::InitialHeight => {}
        EquationOfState::Constant => found.push("B of (26) with the full depth H for every particle in place of H - y".to_owned()),
        EquationOfState::CurrentHeight => found.push("B of (26) follows the height of a particle as it moves".to_owned()),
    }
    changed("factor of (26):", s.stiffness, printed.stiffness, &mut found);
    changed("artificial viscosity alpha =", s.alpha, printed.alpha, &mut found);
    changed("artificial viscosity beta =", s.beta, printed.beta, &mut found);
    changed("eta of (14) =", s.eta, printed.eta, &mut found);
    match s.wall_force {
        WallForce::LennardJones => {}
        WallForce::LennardJonesAttractive => found.push("wall force (34) with its attraction beyond r0".to_owned()),
        WallForce::Monaghan2005 => found.push("normal wall force of Monaghan (2005) in place of (33)-(34)".to_owned()),
    }
    if s.wall_exponents != printed.wall_exponents {
        let ([high, low], [printed_high, printed_low]) = (s.wall_exponents, printed.wall_exponents);
        found.push(format!("exponents of (33) {high} and {low} in place of the printed {printed_high} and {printed_low}"));
    }
    found
}

fn isph_departures(s: &IsphPaperSettings) -> Vec<String> {
    let printed = IsphPaperSettings::preset(Preset::Paper);
    let mut found = Vec::new();
    if s.density_source != printed.density_source {
        found.push("a density error in (31) is removed within the step of the fastest front, not within one time step".to_owned());
    }
    if s.wall_guard != printed.wall_guard {
        found.push("particles that would cross the face of a wall are set back on it; the paper has no such guard".to_owned());
    }
    if s.alpha != printed.alpha {
        found.push(format!("artificial viscosity (13) with alpha = {} added to the prediction; the paper has none", s.alpha));
    }
    changed("eta of (16) and (18) =", s.eta, printed.eta, &mut found);
    match s.surface {
        SurfaceTest::Density => {
            changed("share of the rest density that marks the surface", s.surface_threshold, printed.surface_threshold, &mut found);
        }
        SurfaceTest::Dilts => found.push("the surface is found by uncovered arcs (Dilts 2000) in place of the density".to_owned()),
    }
    if s.surface_ghosts != printed.surface_ghosts {
        found.push("no mirrored neighbours beyond the free surface".to_owned());
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scheme::MethodName;

    #[test]
    fn the_paper_preset_has_no_departure_at_the_printed_viscosity() {
        for method in MethodName::ALL {
            let settings = MethodSettings::preset(method, Preset::Paper);
            assert!(settings.departures(1.0, KernelName::CubicSpline).is_empty(), "{method:?}");
            let other = settings.departures(1e-3, KernelName::WendlandC2);
            assert_eq!(
                other,
                ["dynamic viscosity 0.001 Pa s in place of the printed 1", "kernel wendland-c2 in place of the cubic spline (12)"]
            );
        }
    }

    #[test]
    fn every_departure_of_the_water_presets_is_said() {
        let of = |method| MethodSettings::preset(method, Preset::Water).departures(1.0, KernelName::CubicSpline);
        let wcsph = of(MethodName::Wcsph);
        assert!(wcsph.contains(&"artificial viscosity alpha = 0.05 in place of the printed 1".to_owned()), "{wcsph:?}");
        assert_eq!(wcsph.len(), 3, "{wcsph:?}");
        assert_eq!(of(MethodName::IsphPaper).len(), 3);
    }

    #[test]
    fn all_methods_fill_the_same_rows() {
        let rows = |method| -> Vec<_> { MethodSettings::preset(method, Preset::Water).distinctions().iter().map(|d| d.aspect).collect() };
        for method in MethodName::ALL {
            assert_eq!(rows(method), rows(MethodName::Wcsph));
        }
    }
}
