//! Single steps of both methods on disordered particles against a twin written from the printed equations.

mod common;

use common::{Flow, column, flat, isph, medium, same, vectors, wcsph};
use greenwater::kernel::CubicSpline;
use greenwater::poisson::{SolverMethod, SolverSettings};
use greenwater::scheme::isph_paper::{IsphPaperSettings, Laplacian, SurfaceGhosts, WallGuard};
use greenwater::scheme::wcsph::{EquationOfState, InitialDensity, WallForce, WcsphSettings};
use greenwater::scheme::{IsphPaper, Medium, Preset, Wcsph};
use greenwater::simulation::Simulation;

// --- the explicit method ---

fn explicit() -> WcsphSettings {
    WcsphSettings { initial_density: Some(InitialDensity::Given), ..WcsphSettings::preset(Preset::Paper) }
}

fn explicit_run<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, settings: &WcsphSettings, dt: f64) -> Simulation<D> {
    let mut simulation = flow.simulation(Box::new(Wcsph::new(CubicSpline, *medium, settings.clone())), medium, dt);
    simulation.start().unwrap();
    simulation
}

#[track_caller]
fn same_rates<const D: usize>(what: &str, flow: &Flow<D>, medium: &Medium<D>, settings: &WcsphSettings) {
    let twin = wcsph::rates(flow, medium, settings, &wcsph::heights(flow, medium, settings));
    let simulation = explicit_run(flow, medium, settings, 1e-4);
    let p = simulation.particles();
    let fluid: Vec<usize> = (0..flow.bodies.len()).filter(|&i| flow.bodies[i].fluid()).collect();
    let of_fluid = |values: Vec<f64>| fluid.iter().map(|&i| values[i]).collect::<Vec<_>>();
    same(&format!("{what}: pressure"), &of_fluid(column(p, |a| p.pressure[a])), &of_fluid(twin.pressure));
    same(&format!("{what}: acceleration"), &vectors(p, &p.acceleration), &flat(&twin.acceleration));
    same(&format!("{what}: density rate"), &column(p, |a| p.density_rate[a]), &twin.density_rate);
}

fn every_choice_of_wcsph<const D: usize>(flow: &Flow<D>) {
    for viscosity in [1.0, 0.0] {
        let medium = medium(viscosity);
        for equation_of_state in [EquationOfState::Constant, EquationOfState::InitialHeight, EquationOfState::CurrentHeight] {
            for wall_force in [WallForce::LennardJones, WallForce::LennardJonesAttractive, WallForce::Monaghan2005] {
                for (alpha, beta) in [(1.0, 1.0), (0.02, 0.0)] {
                    let settings = WcsphSettings { equation_of_state, wall_force, alpha, beta, ..explicit() };
                    let what = format!("mu {viscosity}, {equation_of_state:?}, {wall_force:?}, alpha {alpha}");
                    same_rates(&what, flow, &medium, &settings);
                }
            }
        }
    }
}

#[test]
fn wcsph_rates_in_the_plane_are_those_of_the_equations() {
    every_choice_of_wcsph(&Flow::disordered(1, [15, 15], true, 1000.0));
}

#[test]
fn wcsph_rates_in_space_are_those_of_the_equations() {
    every_choice_of_wcsph(&Flow::disordered(2, [5, 4, 5], true, 1000.0));
}

#[test]
fn wcsph_rates_in_a_periodic_box_are_those_of_nearest_images() {
    same_rates("plane", &Flow::periodic(3, [16, 15], 1000.0), &medium(1.0), &explicit());
    same_rates("space", &Flow::periodic(4, [7, 7, 8], 1000.0), &medium(1.0), &explicit());
}

#[track_caller]
fn same_explicit_steps<const D: usize>(mut flow: Flow<D>, medium: &Medium<D>, settings: &WcsphSettings, dt: f64, steps: usize) {
    let mut simulation = explicit_run(&flow, medium, settings, dt);
    let first = flow.clone();
    wcsph::advance(&mut flow, medium, settings, dt, steps);
    for _ in 0..steps {
        simulation.advance().unwrap();
    }
    same_state(&format!("{settings:?}"), &simulation, &flow, &first);
}

/// Displacements (not positions: these are a thousand times as large), velocities, densities.
#[track_caller]
fn same_state<const D: usize>(what: &str, simulation: &Simulation<D>, flow: &Flow<D>, first: &Flow<D>) {
    let p = simulation.particles();
    let moved = |x: &[f64]| {
        let from_start = |(k, x): (usize, &f64)| {
            let moved = x - first.bodies[k / D].x[k % D];
            flow.period[k % D].map_or(moved, |edge| moved - edge * (moved / edge).round())
        };
        x.iter().enumerate().map(from_start).collect::<Vec<_>>()
    };
    let places = flat(&flow.bodies.iter().map(|b| b.x).collect::<Vec<_>>());
    same(&format!("{what}: displacement"), &moved(&vectors(p, &p.x)), &moved(&places));
    same(&format!("{what}: velocity"), &vectors(p, &p.v), &flat(&flow.bodies.iter().map(|b| b.v).collect::<Vec<_>>()));
    same(&format!("{what}: density"), &column(p, |a| p.density[a]), &flow.bodies.iter().map(|b| b.density).collect::<Vec<_>>());
}

#[test]
fn three_steps_of_wcsph_are_the_leapfrog_of_the_paper() {
    let flow = Flow::disordered(5, [14, 14], true, 1000.0);
    for equation_of_state in [EquationOfState::Constant, EquationOfState::InitialHeight, EquationOfState::CurrentHeight] {
        let settings = WcsphSettings { equation_of_state, ..explicit() };
        same_explicit_steps(flow.clone(), &medium(1.0), &settings, 1e-4, 3);
    }
    same_explicit_steps(Flow::disordered(6, [5, 4, 4], true, 1000.0), &medium(0.5), &explicit(), 1e-4, 3);
}

// --- the incompressible method ---

/// The paper's settings with a solver that leaves nothing to the tolerance.
fn incompressible(preset: Preset) -> IsphPaperSettings {
    let solver = SolverSettings { method: SolverMethod::Gauss, tolerance: 1e-13, ..SolverSettings::default() };
    IsphPaperSettings { solver, ..IsphPaperSettings::preset(preset) }
}

fn incompressible_run<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, settings: &IsphPaperSettings, dt: f64) -> Simulation<D> {
    let scheme = IsphPaper::new(CubicSpline, *medium, settings.clone()).unwrap();
    let mut simulation = flow.simulation(Box::new(scheme), medium, dt);
    simulation.start().unwrap();
    simulation
}

#[track_caller]
fn same_surface<const D: usize>(what: &str, simulation: &Simulation<D>, flow: &Flow<D>, surface: &[bool]) {
    let p = simulation.particles();
    let found: Vec<bool> = column(p, |a| p.surface[a] == 1);
    for (i, b) in flow.bodies.iter().enumerate().filter(|(_, b)| b.layer <= 1) {
        assert_eq!(found[i], surface[i], "{what}: surface flag of particle {i}, layer {}, density {}", b.layer, b.density);
    }
}

#[track_caller]
fn same_start<const D: usize>(mut flow: Flow<D>, medium: &Medium<D>, settings: &IsphPaperSettings) {
    let simulation = incompressible_run(&flow, medium, settings, 1e-3);
    let (acceleration, surface) = isph::start(&mut flow, medium, settings, |flow| isph::surface_by_density(flow, medium, settings));
    let p = simulation.particles();
    same("start: density", &column(p, |a| p.density[a]), &flow.bodies.iter().map(|b| b.density).collect::<Vec<_>>());
    same_surface("start", &simulation, &flow, &surface);
    same("start: acceleration", &vectors(p, &p.acceleration), &flat(&acceleration));
}

#[test]
fn isph_starts_from_summed_density_flags_and_the_given_pressure() {
    for settings in [incompressible(Preset::Paper), incompressible(Preset::Water)] {
        for surface_ghosts in [SurfaceGhosts::Mirrored, SurfaceGhosts::None] {
            for viscosity in [1.0, 0.0] {
                let settings = IsphPaperSettings { surface_ghosts, ..settings.clone() };
                same_start(Flow::disordered(11, [14, 13], true, 1000.0), &medium(viscosity), &settings);
                same_start(Flow::disordered(12, [5, 5, 4], true, 1000.0), &medium(viscosity), &settings);
            }
        }
    }
}

#[track_caller]
fn same_steps<const D: usize>(what: &str, mut flow: Flow<D>, medium: &Medium<D>, settings: &IsphPaperSettings, steps: usize) {
    let dt = 1e-3;
    let mut simulation = incompressible_run(&flow, medium, settings, dt);
    let first = flow.clone();
    // What the library holds after its start: densities by (11).
    isph::start(&mut flow, medium, settings, |flow| isph::surface_by_density(flow, medium, settings));
    for step in 1..=steps {
        let surface = isph::advance(&mut flow, medium, settings, dt, |flow| isph::surface_by_density(flow, medium, settings));
        simulation.advance().unwrap();
        let p = simulation.particles();
        let what = format!("{what}, step {step}");
        same_surface(&what, &simulation, &flow, &surface);
        let carrying =
            |values: Vec<f64>| values.into_iter().zip(&flow.bodies).filter(|(_, b)| b.layer <= 1).map(|(p, _)| p).collect::<Vec<_>>();
        let pressure = flow.bodies.iter().map(|b| b.pressure).collect();
        same(&format!("{what}: pressure"), &carrying(column(p, |a| p.pressure[a])), &carrying(pressure));
        same_state(&what, &simulation, &flow, &first);
    }
}

#[test]
fn two_steps_of_isph_solve_the_printed_pressure_equation() {
    for laplacian in [Laplacian::ShaoLo, Laplacian::Brookshaw] {
        let settings = IsphPaperSettings { laplacian, ..incompressible(Preset::Paper) };
        same_steps(&format!("plane, {laplacian:?}"), Flow::disordered(13, [14, 13], true, 1000.0), &medium(1.0), &settings, 2);
        same_steps(&format!("space, {laplacian:?}"), Flow::disordered(14, [5, 4, 4], true, 1000.0), &medium(1.0), &settings, 2);
    }
}

#[test]
fn the_departures_of_the_water_preset_do_what_they_say() {
    let water = incompressible(Preset::Water);
    let paper = incompressible(Preset::Paper);
    let settings = [
        ("alpha", IsphPaperSettings { alpha: 0.05, ..paper.clone() }),
        ("no ghosts", IsphPaperSettings { surface_ghosts: SurfaceGhosts::None, ..paper }),
        ("no guard", IsphPaperSettings { wall_guard: WallGuard::None, ..water.clone() }),
    ];
    for (what, settings) in settings {
        same_steps(what, Flow::disordered(15, [12, 12], true, 1000.0), &medium(1.0), &settings, 2);
    }

    // With the guard: fluid thrown at a flat floor, of which some gets through the face.
    let mut flow = Flow::on_a_floor(18, [12, 10], 1000.0);
    for b in flow.bodies.iter_mut().filter(|b| b.fluid()) {
        b.v[1] -= 20.0;
    }
    let (medium, free) = (medium(1.0), IsphPaperSettings { wall_guard: WallGuard::None, ..water.clone() });
    let mut unguarded = flow.clone();
    isph::advance(&mut unguarded, &medium, &free, 1e-3, |flow| isph::surface_by_density(flow, &medium, &free));
    let crossed = unguarded.bodies.iter().filter(|b| b.fluid() && b.x[1] < 0.0).count();
    assert!(crossed >= 3, "{crossed} particles cross the face without the guard: the test needs some");
    same_steps("guard", flow, &medium, &water, 2);
}

#[test]
fn isph_in_a_periodic_box_sees_nearest_images() {
    same_steps("plane", Flow::periodic(16, [16, 15], 1000.0), &medium(1.0), &incompressible(Preset::Paper), 2);
    same_steps("space", Flow::periodic(17, [7, 7, 7], 1000.0), &medium(1.0), &incompressible(Preset::Paper), 1);
}

// --- the discs of Dilts ---

/// The circle (sphere) round each particle is looked at in many directions. Where one is bare, the particle is exposed; where
/// none is, it may still be, through a gap narrower than the directions are apart: of 360°/20000 in the plane, which no particle
/// of this cloud has, and of some 3° in space, which few have.
fn discs_show_the_surface<const D: usize>(mut flow: Flow<D>, directions: usize, most_narrow: usize) {
    use greenwater::physics::surface::SurfaceTest;
    // A hole inside: surface that no density would tell from noise.
    let middle = flow.bodies.iter().fold([0.0; D], |sum, b| common::along(sum, 1.0 / flow.bodies.len() as f64, b.x));
    flow.bodies.retain(|b| {
        let apart = common::along(b.x, -1.0, middle);
        common::dot(apart, apart).sqrt() > 1.3 * common::SPACING
    });
    // 2 radii are 0.1 m, less than the support of every pair, 0.108 m or more.
    let settings = IsphPaperSettings { surface: SurfaceTest::Dilts, surface_radius: 1.0, ..incompressible(Preset::Paper) };
    let simulation = incompressible_run(&flow, &medium(0.0), &settings, 1e-3);
    let found = column(simulation.particles(), |a| simulation.particles().surface[a] == 1);
    let open: Vec<bool> = (0..flow.bodies.len())
        .map(|i| isph::open_directions(&flow, settings.surface_radius * common::SPACING, i, directions) > 0.0)
        .collect();
    let missed = (0..open.len()).filter(|&i| open[i] && !found[i]).count();
    let narrow = (0..open.len()).filter(|&i| !open[i] && found[i]).count();
    assert_eq!(missed, 0, "exposed particles that were not found");
    assert!(narrow <= most_narrow, "{narrow} particles are called exposed, but show no gap");
    let inside = found.iter().filter(|&&exposed| !exposed).count();
    assert!(inside > found.len() / 10, "only {inside} of {} particles inside: the test needs both kinds", found.len());
}

#[test]
fn discs_show_the_surface_and_nothing_else() {
    discs_show_the_surface(Flow::disordered(21, [18, 18], false, 1000.0), 20_000, 0);
    discs_show_the_surface(Flow::disordered(22, [8, 8, 8], false, 1000.0), 4000, 5);
}

// --- the way from outside ---

/// Writes `flow` as a table of particles and a case with `method`, and loads them.
fn from_file(name: &str, flow: &Flow<2>, method: &str, dt: f64) -> greenwater::case::Setup<2> {
    use greenwater::case::{AnySetup, Case};
    let folder = std::env::temp_dir().join(format!("greenwater-single-step-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut table = "id,kind,layer,x,y,vx,vy,density,pressure,mass,h\n".to_owned();
    for (id, b) in flow.bodies.iter().enumerate() {
        let kind = if b.fluid() { "fluid" } else { "wall" };
        let ([x, y], [vx, vy]) = (b.x, b.v);
        table += &format!("{id},{kind},{},{x:?},{y:?},{vx:?},{vy:?},{:?},{:?},{:?},{:?}\n", b.layer, b.density, b.pressure, b.mass, b.h);
    }
    std::fs::write(folder.join("particles.csv"), table).unwrap();
    let case = format!(
        "format = 1\ntitle = \"Disorder\"\ndimension = 2\n[fluid]\nspacing = 0.05\nviscosity = 1.0\nfrom_file = \"particles.csv\"\n\
         [method]\n{method}\n[time]\nend = 1.0\nstep = {dt:?}\n"
    );
    std::fs::write(folder.join("case.toml"), case).unwrap();
    let setup = Case::load(&folder.display().to_string(), &[]).unwrap().checked().unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    match setup {
        AnySetup::D2(setup) => setup,
        AnySetup::D3(_) => panic!("a case of two dimensions"),
    }
}

/// Depth and floor of a table: from half a spacing under its lowest to half a spacing over its highest fluid.
fn medium_of(flow: &Flow<2>) -> Medium<2> {
    let heights = || flow.bodies.iter().filter(|b| b.fluid()).map(|b| b.x[1]);
    let (low, high) = (heights().fold(f64::INFINITY, f64::min), heights().fold(f64::NEG_INFINITY, f64::max));
    Medium { depth: high - low + common::SPACING, floor: low - common::SPACING / 2.0, ..medium(1.0) }
}

#[test]
fn a_table_of_particles_runs_as_written() {
    let mut flow = Flow::disordered(19, [14, 13], true, 1000.0);
    let (medium, first) = (medium_of(&flow), flow.clone());

    let setup = from_file("wcsph", &flow, "name = \"wcsph\"\npreset = \"paper\"", 1e-4);
    let mut simulation = setup.simulation().unwrap();
    simulation.start().unwrap();
    wcsph::advance(&mut flow, &medium, &explicit(), 1e-4, 2);
    for _ in 0..2 {
        simulation.advance().unwrap();
    }
    same_state("wcsph", &simulation, &flow, &first);

    let mut flow = first.clone();
    let solver = "solver = { method = \"gauss\", tolerance = 1e-13 }";
    let setup = from_file("isph", &flow, &format!("name = \"isph-paper\"\npreset = \"paper\"\n{solver}"), 1e-3);
    let mut simulation = setup.simulation().unwrap();
    simulation.start().unwrap();
    let settings = incompressible(Preset::Paper);
    let surface = |flow: &Flow<2>| isph::surface_by_density(flow, &medium, &settings);
    isph::start(&mut flow, &medium, &settings, surface);
    for _ in 0..2 {
        isph::advance(&mut flow, &medium, &settings, 1e-3, surface);
        simulation.advance().unwrap();
    }
    same_state("isph-paper", &simulation, &flow, &first);
}

/// The default solver is of Krylov's kind and works on the symmetric form, each row times its mass: for particles of unequal mass
/// too it must find the solution of (31). `1e-6`: its tolerance times the condition of the matrix, some hundreds.
#[test]
fn krylov_finds_the_pressure_that_elimination_finds() {
    let flow = Flow::disordered(20, [14, 13], true, 1000.0);
    let exact = incompressible(Preset::Paper);
    let solver = SolverSettings { tolerance: 1e-10, ..SolverSettings::default() };
    let pressure = |settings: &IsphPaperSettings| {
        let mut simulation = incompressible_run(&flow, &medium(1.0), settings, 1e-3);
        simulation.advance().unwrap();
        column(simulation.particles(), |a| simulation.particles().pressure[a])
    };
    let error = common::difference(&pressure(&IsphPaperSettings { solver, ..exact.clone() }), &pressure(&exact));
    assert!(error < 1e-6, "{error:.1e}");
}
