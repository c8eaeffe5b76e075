//! Cases from the outside: the shipped ones, what they resolve to, overrides, tables of particles, and every way to be wrong.

use std::fs;
use std::path::PathBuf;

use greenwater::case::{AnySetup, Case, CaseError, Precision, Setup, shipped_cases};
use greenwater::math::Vector;
use greenwater::particles::Kind;
use greenwater::scheme::{MethodName, MethodSettings, Preset};

/// A small case that is right; tests change one thing in it.
const GOOD: &str = r#"format = 1
title = "Small"
dimension = 2

[fluid]
spacing = 0.1
shapes = [{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }]

[walls]
layers = 2
shapes = [{ tank = { min = [0.0, 0.0], max = [2.0, 1.5], open = ["top"] } }]

[time]
end = 1.0

[[probe]]
name = "P1"
position = [2.0, 0.1]
"#;

fn parse(text: &str) -> Result<AnySetup, CaseError> {
    Case::parse("dam.toml", text.to_owned(), None, &[])?.checked()
}

fn two_d(any: AnySetup) -> Setup<2> {
    match any {
        AnySetup::D2(setup) => setup,
        AnySetup::D3(_) => panic!("a case of two dimensions"),
    }
}

fn good() -> Setup<2> {
    two_d(parse(GOOD).unwrap_or_else(|error| panic!("{error}")))
}

/// A plate of two spacings between two kernels that reach four, and one of four.
#[test]
fn a_wall_that_the_kernel_reaches_through_is_warned_of() {
    let warned = |to: &str| {
        let plate = format!(r#", {{ name = "plate", box = {{ min = [1.0, 0.0], max = [{to}, 0.7] }} }}]"#);
        let text = GOOD.replace("layers = 2", "layers = 4").replace(r#"open = ["top"] } }]"#, &format!(r#"open = ["top"] }} }}{plate}"#));
        two_d(parse(&text).unwrap_or_else(|error| panic!("{error}"))).audit().warnings
    };
    assert_eq!(
        warned("1.2"),
        ["the wall at (1.050, 0.350) m is 2 spacings thick and the kernel reaches 4.0: fluid feels what is behind it; \
          a thicker wall or a smaller `fluid.spacing` helps"]
    );
    assert_eq!(warned("1.4"), <[&str; 0]>::default());
}

/// The message and exit code of the good case with `from` replaced by `to`.
fn broken(from: &str, to: &str) -> (String, u8) {
    assert!(GOOD.contains(from), "{from}");
    match parse(&GOOD.replacen(from, to, 1)) {
        Ok(_) => panic!("{to} was accepted"),
        Err(error) => (error.to_string(), error.exit_code()),
    }
}

fn load(name: &str, overrides: &[(&str, &str)]) -> Result<Case, CaseError> {
    let overrides: Vec<_> = overrides.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect();
    Case::load(name, &overrides)
}

/// A folder of its own for one test, removed when dropped.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("greenwater-cases-{}-{name}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn write(&self, name: &str, text: &str) -> String {
        let path = self.0.join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn the_five_sizes_have_the_particle_counts_of_the_paper() {
    for (m, total) in [(20, 1409), (25, 2009), (30, 2709), (35, 3509), (40, 4409)] {
        let setup = two_d(load(&format!("dam-break-{m}"), &[]).unwrap().checked().unwrap());
        assert_eq!(setup.particles.owned(), total, "m = {m}");
        assert_eq!(setup.estimate.fluid, 2 * m * m);
        assert_eq!(setup.estimate.walls, 30 * m + 9);
        assert_eq!((setup.width, setup.depth), (0.75, 1.5));
        let area_error = (setup.fluid_volume - 0.75 * 1.5).abs();
        assert!(area_error < 1e-12, "round-off of a sum of {} cells: {area_error:e}", 2 * m * m);
    }
}

#[test]
fn all_shipped_cases_check_and_say_what_they_are() {
    for shipped in shipped_cases() {
        let setup = load(shipped.name, &[]).unwrap().checked().unwrap_or_else(|error| panic!("{}: {error}", shipped.name));
        assert_eq!(setup.name(), shipped.name);
        assert_eq!(setup.title(), shipped.title());
        assert!(shipped.text().len() > 20 && shipped.readme.starts_with(&format!("# {}\n", shipped.name)));
        let estimate = setup.estimate();
        assert!(estimate.memory_bytes < 20e6 && estimate.steps.is_some(), "{estimate:?}");
        for &(name, preset) in &setup.compare().methods {
            let case = load(shipped.name, &[]).unwrap().for_method(name, Some(preset));
            assert!(case.checked().is_ok(), "{} with {name:?}", shipped.name);
        }
    }
    assert_eq!(load("dam-break", &[]).unwrap().checked().unwrap().compare().references.len(), 3);
    let small = load("dam-break-3d", &[]).unwrap().checked().unwrap();
    assert_eq!((small.dimension(), small.estimate().fluid, small.estimate().walls), (3, 600, 3240));
}

#[test]
fn the_default_comparison_is_the_middle_size() {
    let strip = |setup: AnySetup| Setup {
        name: String::new(),
        title: String::new(),
        written: String::new(),
        resolved: String::new(),
        ..two_d(setup)
    };
    let setup = |name| strip(load(name, &[]).unwrap().checked().unwrap());
    assert_eq!(setup("dam-break"), setup("dam-break-30"));
}

#[test]
fn the_resolved_case_is_a_case_that_gives_the_same_setup() {
    for shipped in shipped_cases() {
        for method in [MethodName::Wcsph, MethodName::IsphPaper] {
            let first = load(shipped.name, &[]).unwrap().for_method(method, None).checked().unwrap();
            let again = Case::parse(shipped.name, first.resolved().to_owned(), None, &[]).unwrap().checked().unwrap();
            assert_eq!(first.resolved(), again.resolved());
            match (first, again) {
                (AnySetup::D2(first), AnySetup::D2(again)) => {
                    assert_eq!(Setup { written: String::new(), ..first }, Setup { written: String::new(), ..again })
                }
                (AnySetup::D3(first), AnySetup::D3(again)) => {
                    assert_eq!(Setup { written: String::new(), ..first }, Setup { written: String::new(), ..again })
                }
                _ => panic!("{} changed its dimension", shipped.name),
            }
        }
    }
}

#[test]
fn the_resolved_case_has_every_default() {
    let resolved = good().resolved;
    for key in [
        "density = 1000.0",
        "h_over_spacing = 2.0",
        "courant = 0.25",
        "acceleration = [",
        "memory_gib",
        "alpha",
        "preset = \"water\"",
        "interval",
    ] {
        assert!(resolved.contains(key), "`{key}` in\n{resolved}");
    }
}

#[test]
fn fluid_comes_first_in_order_of_position_then_walls() {
    let setup = good();
    let p = &setup.particles;
    assert_eq!(p.id, (0..p.owned() as u32).collect::<Vec<_>>());
    assert!(p.kind[..50].iter().all(|&kind| kind == Kind::Fluid) && p.kind[50..].iter().all(|&kind| kind == Kind::Wall));
    for range in [0..50, 50..p.owned()] {
        assert!(p.x[range].windows(2).all(|pair| pair[0].0 < pair[1].0), "x first, then y");
    }
    assert_eq!((p.x[0], p.layer[0], p.v[0]), (Vector([0.05, 0.05]), 0, Vector::ZERO));
    assert_eq!((p.mass[0], p.density[0], p.h[0]), (1000.0 * (0.1 * 0.1), 1000.0, 2.0 * 0.1));
    assert_eq!(p.count(Kind::Wall), 2 * (20 + 2 * 15) + 2 * 4);
}

#[test]
fn initial_pressure_is_that_of_the_depth_or_zero() {
    let setup = good();
    let error = |a: usize| (setup.particles.pressure[a] - 9810.0 * (1.0 - setup.particles.x[a][1])).abs();
    assert!((0..50).all(|a| error(a) < 1e-9), "round-off of 1e4 Pa");
    assert!(setup.particles.pressure[50..].iter().all(|&p| p == 0.0), "walls have none of their own");
    let zero = two_d(parse(&GOOD.replace("spacing = 0.1", "spacing = 0.1\ninitial_pressure = \"zero\"")).unwrap());
    assert!(zero.particles.pressure.iter().all(|&p| p == 0.0));
}

#[test]
fn frames_come_at_times_asked_for_and_at_even_steps_each_once() {
    let setup = two_d(load("dam-break", &[]).unwrap().checked().unwrap());
    let times = &setup.output.frame_times;
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] > 1e-3), "{times:?}");
    assert!([0.0, 0.21, 0.65, 1.31, 1.5, 1.64].iter().all(|time| times.contains(time)));
    // 83 even steps with both ends, and 0.21, 0.65, 1.31 between them.
    assert_eq!(times.len(), 86);
    let short = two_d(load("dam-break", &[("time.end", "0.5")]).unwrap().checked().unwrap());
    assert_eq!((short.output.frame_times.last(), short.compare.times.as_slice()), (Some(&0.5), [0.0, 0.21].as_slice()));
}

#[test]
fn overrides_change_the_case_and_are_named_in_errors() {
    let setup = two_d(
        load("dam-break-20", &[("fluid.spacing", "0.01875"), ("output.precision", "float32"), ("probe[0].name", "edge")])
            .unwrap()
            .checked()
            .unwrap(),
    );
    assert_eq!((setup.spacing, setup.output.precision, setup.probes[0].name.as_str()), (0.01875, Precision::Float32, "edge"));
    assert_eq!(setup.estimate.fluid, 3200);
    let alpha = load("dam-break", &[("method.alpha", "0.07")]).unwrap().checked().unwrap();
    assert!(matches!(alpha.method(), MethodSettings::Wcsph(settings) if settings.alpha == 0.07));

    let message = |key, value| load("dam-break", &[(key, value)]).and_then(|case| case.checked()).unwrap_err().to_string();
    assert!(message("fluid.spacin", "0.02").starts_with("--set fluid.spacin=0.02: unknown key `fluid.spacin`, did you mean `spacing`?"));
    assert!(message("fluid.spacing", "-1").starts_with("--set fluid.spacing=-1: `fluid.spacing` is -1, but must be > 0"));
    assert!(message("fluid.spacing", "fine").starts_with("--set fluid.spacing=fine: `fluid.spacing` has a value of the wrong type"));
    assert!(message("fluid..spacing", "1").contains("a part of the key is empty"));
    assert!(message("probe[9].name", "x").contains("the case has no `probe[9]`"));
    assert!(message("title.x", "1").contains("cannot be set inside something that is not a table"));
    assert!(message("method.alhpa", "1").contains("unknown key `method.alhpa`, did you mean `alpha`?"));
}

#[test]
fn a_method_brings_its_own_keys() {
    let text = format!("{GOOD}\n[method]\nname = \"wcsph\"\npreset = \"paper\"\nalpha = 0.5\n");
    let case = Case::parse("dam.toml", text, None, &[]).unwrap();
    let settings = |case: Case| case.checked().unwrap().method().clone();
    assert!(
        matches!(settings(case.for_method(MethodName::Wcsph, None)), MethodSettings::Wcsph(s) if s.alpha == 0.5 && s.preset == Preset::Paper)
    );
    assert!(
        matches!(settings(case.for_method(MethodName::Wcsph, Some(Preset::Water))), MethodSettings::Wcsph(s) if s.alpha == 0.5 && s.preset == Preset::Water)
    );
    assert!(matches!(settings(case.for_method(MethodName::IsphPaper, None)), MethodSettings::IsphPaper(s) if s.preset == Preset::Water));
}

/// `--method isph-paper --set method.eta=0.2` is about `isph-paper`, whatever method the file names.
#[test]
fn overrides_are_for_the_method_that_was_asked_for() {
    let text = format!("{GOOD}\n[method]\nname = \"wcsph\"\npreset = \"paper\"\nalpha = 0.5\n");
    let with = |overrides: &[(&str, &str)]| {
        let overrides: Vec<(String, String)> = overrides.iter().map(|(key, value)| (key.to_string(), value.to_string())).collect();
        let case = Case::parse("dam.toml", text.clone(), None, &overrides).unwrap();
        case.with_method(MethodName::IsphPaper, None).and_then(|case| case.checked()).map(|setup| setup.method().clone())
    };
    assert!(matches!(with(&[("method.eta", "0.2")]), Ok(MethodSettings::IsphPaper(s)) if s.eta == 0.2 && s.preset == Preset::Water));
    assert!(matches!(with(&[("method.preset", "paper")]), Ok(MethodSettings::IsphPaper(s)) if s.preset == Preset::Paper));
    let message = with(&[("method.equation_of_state", "constant")]).unwrap_err().to_string();
    assert!(message.contains("unknown key `method.equation_of_state`"), "{message}");
}

/// Without walls: in a box that repeats all ways nothing leaves; under gravity fluid falls; a flow leaves the box. A lattice across a seam of 0.6
/// spacings.
#[test]
fn what_leaves_and_what_does_not_fit_is_warned_of() {
    let warned = |gravity: &str, velocity: &str, domain: &str| {
        let text = format!(
            "format = 1\ntitle = \"t\"\ndimension = 2\n[fluid]\nspacing = 0.1\nvelocity = {velocity}\nshapes = [{{ box = {{ min = [0.0, 0.0], max = [1.0, 1.0] }} }}]\n\
             [gravity]\nacceleration = {gravity}\n[domain]\n{domain}\n[time]\nend = 1.0\n"
        );
        two_d(parse(&text).unwrap_or_else(|error| panic!("{error}"))).audit().warnings
    };
    let still = "[\"0\", \"0\"]";
    let box_of = |x: &str| format!("periodic = [\"x\", \"y\"]\nmin = [0.0, 0.0]\nmax = [{x}, 1.0]");
    assert_eq!(warned("[0.0, 0.0]", "[\"1\", \"0\"]", &box_of("1.0")), <[&str; 0]>::default());
    assert!(warned("[0.0, 0.0]", still, &box_of("1.06"))[0].contains("repeats along x every 10.60 spacings"));
    assert!(warned("[0.0, -9.81]", still, "")[0].contains("falls freely"));
    assert!(warned("[0.0, 0.0]", "[\"1\", \"0\"]", "")[0].contains("what leaves `domain` is lost"));
}

#[test]
fn a_speed_of_sound_of_nothing_is_refused() {
    let text = GOOD.replace("[time]", "[gravity]\nacceleration = [0.0, 0.0]\n\n[method]\nname = \"wcsph\"\n\n[time]");
    let message = parse(&text).unwrap_err().to_string();
    assert!(message.contains("`gravity.acceleration` is zero, but must be other than zero where nothing moves"), "{message}");
}

#[test]
fn bad_values_are_named_with_line_value_and_rule() {
    for (from, to, expected) in [
        ("format = 1", "format = 2", "dam.toml:1: `format` is 2, but must be 1"),
        ("format = 1\n", "", "dam.toml: `format` is missing"),
        (
            "dimension = 2",
            "dimension = 2\ngravity = [0.0, 0.0]",
            "dam.toml:4: `gravity` has a value of the wrong type: list, expected a table, with keys such as `gravity.acceleration`",
        ),
        (
            "{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }",
            "{ box = [0.0, 0.0, 0.5, 1.0] }",
            "dam.toml:7: `fluid.shapes[0].box` has a value of the wrong type: list, expected a table, with keys such as `box.min`",
        ),
        (
            "{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }",
            "{ difference = { of = { box = [0, 0, 1, 1] }, minus = [] } }",
            "dam.toml:7: `fluid.shapes[0].difference.of.box` has a value of the wrong type: list, expected a table, with keys such as `box.min`",
        ),
        (
            "{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }",
            "\"box\"",
            "dam.toml:7: `fluid.shapes[0].box` has a value of the wrong type: a name alone, expected a table",
        ),
        ("[time]", "[time]\n[time]", "not valid TOML: duplicate key; a section stands once, lists of tables are written `[[probe]]`"),
        ("dimension = 2", "dimension = 4", "dam.toml:3: `dimension` is 4, but must be 2 or 3"),
        ("spacing = 0.1", "spacing = -0.01", "dam.toml:6: `fluid.spacing` is -0.01, but must be > 0"),
        ("spacing = 0.1", "spacing = 0.0", "dam.toml:6: `fluid.spacing` is 0, but must be > 0"),
        ("spacing = 0.1", "spacing = nan", "dam.toml:6: `fluid.spacing` is NaN, but must be a finite number"),
        ("spacing = 0.1", "spacing = 0.1\ndensity = inf", "dam.toml:7: `fluid.density` is inf, but must be a finite number"),
        ("spacing = 0.1", "spacing = 0.1\ndensity = 0", "dam.toml:7: `fluid.density` is 0, but must be > 0"),
        ("spacing = 0.1", "spacing = 0.1\nviscosity = -1.0", "dam.toml:7: `fluid.viscosity` is -1, but must be >= 0"),
        ("spacing = 0.1\n", "", "`fluid.spacing` is missing: Distance between particles at the start."),
        (
            "spacing = 0.1",
            "spacing = \"10 cm\"",
            "dam.toml:6: `fluid.spacing` has a value of the wrong type: string \"10 cm\", expected a number in SI units",
        ),
        ("spacing = 0.1", "spacing = true", "dam.toml:6: `fluid.spacing` has a value of the wrong type: boolean `true`, expected a number"),
        (
            "spacing = 0.1",
            "spacin = 0.1",
            "dam.toml:6: unknown key `fluid.spacin`, did you mean `spacing`?; known here: spacing, density, viscosity",
        ),
        ("[walls]", "[wals]", "dam.toml:9: unknown key `wals`, did you mean `walls`?; known here: format, title"),
        (
            "{ box =",
            "{ boks =",
            "dam.toml:7: `fluid.shapes[0]` is \"boks\", which is unknown, did you mean `box`?; choose one of: box, polygon",
        ),
        ("max = [0.5, 1.0]", "max = [0.5, 1.0], radius = 1.0", "dam.toml:7: unknown key `fluid.shapes[0].box.radius`"),
        (
            "max = [0.5, 1.0]",
            "max = [0.5, 1.0, 1.0]",
            "`fluid.shapes[0].box.max` is a list of 3, but must be a list of 2 numbers, one an axis: `dimension` is 2",
        ),
        ("max = [0.5, 1.0]", "max = [0.5, -1.0]", "`fluid.shapes[0].box.max` is [0.5, -1.0], but must be greater than `min` along y"),
        (
            "max = [0.5, 1.0]",
            "max = [0.55, 1.0]",
            "`fluid.shapes[0]` is 0.55 m long along x, which is 5.500000 spacings of 0.1 m, but must be a whole number of them; the nearest `fluid.spacing` that fits is 0.05 m",
        ),
        ("{ box =", "{ tank =", "`fluid.shapes[0]` is a tank, but must be a shape that can be filled"),
        ("{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }", "", "`fluid.shapes` is empty, but must be a list of one shape or more"),
        (
            "{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }",
            "{ difference = { of = { box = { min = [0, 0], max = [1, 1] } }, minus = [{ box = { min = [0, 0], max = [1, 1] } }] } }",
            "`fluid` is without a particle, but must be at least one spacing wide",
        ),
        (
            "{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }",
            "{ circle = { center = [0.5, 0.5], radius = -1 } }",
            "`fluid.shapes[0].circle.radius` is -1, but must be > 0",
        ),
        ("{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }", "{ sphere = { center = [0.5, 0.5], radius = 1 } }", "a sphere has 3"),
        ("open = [\"top\"]", "open = [\"topp\"]", "`walls.shapes[0].tank.open` is \"topp\", but must be of left, right, bottom, top"),
        ("layers = 2", "layers = 0", "dam.toml:10: `walls.layers` is 0, but must be 1 to 32"),
        (
            "layers = 2",
            "layers = -1",
            "dam.toml:10: `walls.layers` has a value of the wrong type: integer `-1`, expected a whole number >= 0",
        ),
        (
            "layers = 2",
            "layers = 2.5",
            "dam.toml:10: `walls.layers` has a value of the wrong type: number `2.5`, expected a whole number >= 0",
        ),
        ("end = 1.0", "end = 0.0", "dam.toml:14: `time.end` is 0, but must be > 0"),
        ("end = 1.0", "end = 1.0\ncourant = 1.5", "dam.toml:15: `time.courant` is 1.5, but must be > 0 and <= 1"),
        ("end = 1.0", "end = 1.0\nstep = -1e-3", "`time.step` is -0.001, but must be > 0"),
        ("end = 1.0", "end = 1.0\nstep = 1.5", "`time.step` is 1.5, but must be at most `time.end`, 1 s"),
        ("end = 1.0", "end = 1.0\nmax_steps = -5", "`time.max_steps` has a value of the wrong type"),
        ("[time]", "[kernel]\nh_over_spacing = 0\n[time]", "dam.toml:14: `kernel.h_over_spacing` is 0, but must be 0.5 to 5"),
        (
            "[time]",
            "[kernel]\nname = \"wendland-c2\"\nh_over_spacing = 0.5\n[time]",
            "`kernel.h_over_spacing` is 0.5, but must be at least 0.750 with the kernel `wendland-c2`",
        ),
        ("[time]", "[kernel]\nname = \"wendland\"\n[time]", "`kernel.name` is \"wendland\", which is unknown, did you mean `wendland-c2`?"),
        ("[time]", "[method]\nname = \"sph\"\n[time]", "`method.name` is \"sph\", which is unknown"),
        ("[time]", "[method]\nalfa = 1.0\n[time]", "dam.toml:14: unknown key `method.alfa`, did you mean `alpha`?"),
        ("[time]", "[method]\nalpha = \"much\"\n[time]", "dam.toml:14: `method.alpha` has a value of the wrong type"),
        (
            "[time]",
            "[method]\nname = \"isph-paper\"\nsurface = \"dilts\"\nsurface_radius = 1.3\n[time]",
            "dam.toml:16: `method.surface_radius` is 1.3, but must be at most 1.2, half the kernel's reach",
        ),
        ("[time]", "[gravity]\nacceleration = [0.0, 0.0, -9.81]\n[time]", "`gravity.acceleration` is a list of 3, but must be a list of 2"),
        ("[time]", "[domain]\nperiodic = [\"x\"]\n[time]", "`domain.min` is left out, but must be given where an axis is periodic"),
        ("[time]", "[domain]\nperiodic = [\"z\"]\n[time]", "`domain.periodic` is \"z\", but must be of x, y"),
        ("[time]", "[domain]\nmin = [0.2, 0.0]\n[time]", "but must be around every particle"),
        ("[time]", "[domain]\nperiodic = [\"x\"]\nmin = [-0.2, -1]\nmax = [0.2, 9]\n[time]", "two kernel supports"),
        (
            "position = [2.0, 0.1]",
            "position = [200.0, 0.1]",
            "dam.toml:18: `probe[0].position` is [200.0, 0.1], but must be inside the domain",
        ),
        ("position = [2.0, 0.1]", "position = [2.0]", "`probe[0].position` is a list of 1, but must be a list of 2"),
        (
            "position = [2.0, 0.1]",
            "position = [2.5, 0.1]",
            "`probe[0].position` is [2.5000, 0.1000], 0.3536 m from the nearest wall particle, but must be within 0.2600 m of the face of a \
             wall or of the fluid, or the probe will never feel anything; move it to the face of the wall, half a spacing before the particle \
             at [2.0500, 0.0500] m",
        ),
        ("position = [2.0, 0.1]", "position = [2.15, 0.15]", "`probe[0].position` is [2.1500, 0.1500], inside a wall, but must be within"),
        (
            "position = [2.0, 0.1]",
            "position = [2.0, 0.1]\nsize = 3.0\nnormal = [-1, 0]",
            "`probe[0].size` is 3 m, with its rim at [2.0000, -1.4000], 1.",
        ),
        ("position = [2.0, 0.1]", "position = [2.0, 0.1]\nsize = 1e9\nnormal = [-1, 0]", "covered by at most 1000000 places"),
        (
            "[time]",
            "[domain]\nmin = [-1e9, -1e9]\nmax = [1e9, 1e9]\n[[gauge]]\nname = \"q\"\nquantity = \"flow\"\nfrom = [1, -1e8]\nto = [1, 1e8]\n[time]",
            "at most 1000000 places",
        ),
        ("name = \"P1\"", "name = \"time\"", "`probe[0].name` is \"time\", but must be another name"),
        ("name = \"P1\"", "name = \"P,1\"", "dam.toml:17: `probe[0].name` is \"P,1\", but must be letters, digits"),
        ("[time]", "[[probe]]\nname = \"P1\"\nposition = [0.1, 0.1]\n[time]", "`probe[1].name` is \"P1\", but must be unique"),
        (
            "[time]",
            "[output]\nfields = [\"presure\"]\n[time]",
            "`output.fields[0]` is \"presure\", which is unknown, did you mean `pressure`?",
        ),
        ("[time]", "[output]\ninterval = 0\n[time]", "`output.interval` is 0, but must be >= time.end / 100000"),
        ("[time]", "[output]\ntimes = [-1]\n[time]", "`output.times[0]` is -1, but must be >= 0"),
        ("[time]", "[output]\nprecision = \"float16\"\n[time]", "`output.precision` is \"float16\", which is unknown"),
        ("[time]", "[compare]\nmethods = [\"dsph\"]\n[time]", "`compare.methods[0]` is \"dsph\", which is unknown"),
        ("[time]", "[compare]\nmethods = [\"wcsph:thick\"]\n[time]", "`compare.methods[0]` is \"thick\", which is unknown"),
        ("[time]", "[compare]\nmethods = []\n[time]", "`compare.methods` is an empty list"),
        ("[time]", "[limits]\nmemory_gib = 0\n[time]", "`limits.memory_gib` is 0, but must be > 0"),
        ("end = 1.0", "end = ", "dam.toml:14: not valid TOML"),
        ("end = 1.0", "end = 1.0\nend = 2.0", "dam.toml:15: not valid TOML"),
    ] {
        let (message, code) = broken(from, to);
        assert!(message.contains(expected), "{to}\n  gave: {message}\n  not:  {expected}");
        assert_eq!(code, 2, "{message}");
    }
    let empty = parse("").unwrap_err();
    assert_eq!((empty.to_string(), empty.exit_code()), ("dam.toml: `format` is missing: Version of the case format.".to_owned(), 2));
}

/// A tank that is driven off takes its fluid along: the region that counts is as much longer as the tank goes, 3 m.
#[test]
fn the_region_goes_as_far_as_walls_do() {
    let bounds = |walls: &str| {
        let text = GOOD.replace("shapes = [{ tank", &format!("shapes = [{{ {walls} tank"));
        two_d(parse(&text).unwrap_or_else(|error| panic!("{error}"))).bounds
    };
    let (still, driven) = (bounds(""), bounds("velocity = [\"6*t\", \"0\"],"));
    // 1e-9: a sum of a thousand pieces.
    assert!((driven.max[0] - still.max[0] - 3.0).abs() < 1e-9 && driven.min == still.min, "{driven:?}");
    assert_eq!(bounds("velocity = [\"6*t\", \"0\"], moves = false,"), still);
}

#[test]
fn parameters_of_methods_are_checked() {
    let isph = |keys: &str| parse(&format!("{GOOD}\n[method]\nname = \"isph-paper\"\n{keys}\n"));
    for (keys, expected) in [
        ("eta = 0", "dam.toml:22: `method.eta` is 0, but must be > 0"),
        ("surface_threshold = 1.0", "`method.surface_threshold` is 1, but must be > 0 and < 1"),
        ("solver = { tolerance = 2.0 }", "dam.toml:22: `method.solver.tolerance` is 2, but must be"),
        ("solver = { tol = 2.0 }", "dam.toml:22: unknown key `method.solver.tol`, did you mean `tolerance`?"),
        ("solver = { method = \"lu\" }", "`method.solver.method` is \"lu\", which is unknown"),
    ] {
        let message = isph(keys).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let gauss = isph("solver = { method = \"gauss\" }").unwrap();
    assert!(matches!(gauss.method(), MethodSettings::IsphPaper(s) if s.solver.tolerance == 1e-6), "the other keys of the table stay");
    // The dense matrix of Gauss counts: 4409 particles take 8 * 4409^2 bytes.
    let dense = load("dam-break-40", &[("method.name", "isph-paper"), ("method.solver.method", "gauss")]).unwrap().checked().unwrap();
    assert!(dense.estimate().memory_bytes > 8.0 * 4409.0 * 4409.0);
    let (message, _) = broken("[time]", "[method]\nname = \"wcsph\"\nwall_exponents = [6, 12]\n[time]");
    assert!(message.contains("`method.wall_exponents` is [6, 12], but must be two whole numbers >= 1, the larger first"), "{message}");
}

#[test]
fn references_are_checked_with_their_curve() {
    let curve = "[[compare.reference]]\nname = \"a\"\nquantity = \"front\"\nsource = \"s\"\ntime_scale = 1.0\nvalue_scale = 1.0\ntime_label = \"t\"\nvalue_label = \"x\"\npoints = [[0.0, 1.0], [1.0, 2.0]]\n";
    assert!(parse(&format!("{GOOD}{curve}")).is_ok());
    for (from, to, expected) in [
        ("\"front\"", "\"frnt\"", "`compare.reference[0].quantity` is \"frnt\""),
        ("\"front\"", "\"probe:P9\"", "with the name of an instrument"),
        ("\"front\"", "\"load:all.fq\"", "a load has fx, fy and mz"),
        ("\"front\"", "\"load:all.fz\"", "a load has fx, fy and mz"),
        ("[1.0, 2.0]", "[0.0, 2.0]", "`compare.reference[0].points[1]` is [0.0, 2.0], but must be later than the point before it"),
        ("time_scale = 1.0", "time_scale = 0", "`compare.reference[0].time_scale` is 0, but must be > 0"),
        ("source = \"s\"\n", "", "`compare.reference[0].source` is missing: Where the values come from."),
        ("[1.0, 2.0]]", "[1.0, 2.0]]\nspread = [0.1]", "`compare.reference[0].spread` is a list of 1, but must be as many as points, 2"),
        ("[1.0, 2.0]]", "[1.0, 2.0]]\nspread = [0.1, -0.1]", "`compare.reference[0].spread[1]` is -0.1, but must be >= 0"),
    ] {
        let message = parse(&format!("{GOOD}{}", curve.replacen(from, to, 1))).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn overlapping_shapes_are_named_with_a_place() {
    let (message, code) = broken("max = [0.5, 1.0] } }", "max = [0.5, 1.0] } }, { box = { min = [0.4, 0.0], max = [1.0, 0.2] } }");
    assert!(message.starts_with("dam.toml:7: `fluid.shapes[0]` and `fluid.shapes[1]` overlap near [0.45, 0.05"), "{message}");
    assert!(message.contains("at least half a spacing, 5.000e-2 m; move or shrink one of the two"), "{message}");
    assert_eq!(code, 2);
    let (message, _) = broken("min = [0.0, 0.0], max = [0.5, 1.0]", "min = [-0.1, 0.0], max = [0.5, 1.0]");
    assert!(message.contains("`fluid.shapes[0]` and `walls.shapes[0]` overlap near [-0.05"), "{message}");
    // Side by side is no overlap.
    let beside = GOOD.replace("max = [0.5, 1.0] } }", "max = [0.5, 1.0] } }, { box = { min = [0.5, 0.0], max = [1.0, 0.2] } }");
    assert_eq!(two_d(parse(&beside).unwrap()).estimate.fluid, 60);
}

#[test]
fn a_case_of_a_terabyte_is_refused_before_anything_is_allocated() {
    for spacing in ["1e-6", "1e-9", "1e-30"] {
        let error = load("dam-break-20", &[("fluid.spacing", spacing)]).unwrap().checked().unwrap_err();
        assert!(matches!(error, CaseError::OverLimit { key: "limits.memory_gib", .. }), "{error}");
        assert_eq!(error.exit_code(), 7);
        assert!(error.to_string().contains("choose a larger `fluid.spacing` or raise `limits.memory_gib`"), "{error}");
    }
    let error = load("dam-break", &[("limits.particles", "2708")]).unwrap().checked().unwrap_err();
    assert!(matches!(error, CaseError::OverLimit { key: "limits.particles", needed: 2709.0, .. }), "{error}");
}

#[test]
fn missing_files_name_the_nearest_shipped_case() {
    let error = load("dam-brake", &[]).unwrap_err();
    assert!(
        error.to_string().starts_with("dam-brake: no such file, and no shipped case of this name, did you mean `dam-break`?"),
        "{error}"
    );
    assert_eq!(error.exit_code(), 2);
    let folder = Folder::new("missing");
    let error = load(&folder.0.display().to_string(), &[]).unwrap_err();
    assert!(error.to_string().contains("the folder has no case.toml"), "{error}");
    assert_eq!(error.exit_code(), 2);
}

#[test]
fn a_case_is_read_from_a_file_or_its_folder() {
    let folder = Folder::new("read");
    let file = folder.write("case.toml", GOOD);
    let by_file = load(&file, &[]).unwrap();
    let by_folder = load(&folder.0.display().to_string(), &[]).unwrap();
    assert_eq!(by_file.name, folder.0.file_name().unwrap().to_string_lossy());
    assert_eq!(by_file.sections, by_folder.sections);
    fs::write(folder.0.join("bytes.toml"), [0xff, 0xfe]).unwrap();
    let error = load(&folder.0.join("bytes.toml").display().to_string(), &[]).unwrap_err();
    assert!(error.to_string().contains("not UTF-8 text"), "{error}");
}

const TABLE: &str = "id,kind,x,y,vx,vy,density,pressure,mass,h\n\
                     7,fluid,0.05,0.05,0.1,0.2,1001,50,10,0.12\n\
                     3,fluid,0.16,0.05,0,0,999,40,10.5,0.13\n\
                     9,wall,0.05,-0.05,0,0,1000,0,10,0.12\n";

/// The good case with its fluid from `particles.csv`.
fn from_file(name: &str, path: &str) -> (Folder, String) {
    let folder = Folder::new(name);
    let text = GOOD
        .replace("shapes = [{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }]", &format!("from_file = {path:?}"))
        .replace("shapes = [{ tank = { min = [0.0, 0.0], max = [2.0, 1.5], open = [\"top\"] } }]", "")
        .replace("position = [2.0, 0.1]", "position = [0.1, 0.1]");
    let case = folder.write("case.toml", &text);
    (folder, case)
}

#[test]
fn a_table_of_particles_arrives_as_it_is() {
    let (folder, case) = from_file("table", "particles.csv");
    folder.write("particles.csv", TABLE);
    let setup = two_d(load(&case, &[]).unwrap().checked().unwrap());
    let p = &setup.particles;
    assert_eq!(p.id, [7, 3, 9]);
    assert_eq!((p.kind[2], p.layer[2]), (Kind::Wall, 1));
    assert_eq!((p.v[0], p.density[1], p.pressure[0], p.mass[1], p.h[1]), (Vector([0.1, 0.2]), 999.0, 50.0, 10.5, 0.13));
    assert_eq!((setup.estimate.fluid, setup.estimate.walls), (2, 1));
    assert_eq!(setup.particle_file, Some(("particles.csv".to_owned(), folder.0.join("particles.csv"))));
    let again = Case::parse("case.toml", setup.resolved.clone(), Some(&folder.0), &[]).unwrap().checked().unwrap();
    assert_eq!(two_d(again).particles, setup.particles);

    // Walls from shapes count on from the largest identity, and must keep clear of the table.
    let tank = "[{ tank = { min = [-0.2, -0.2], max = [0.5, 0.5], open = [\"top\"] } }]";
    let both = two_d(load(&case, &[("walls.shapes", tank)]).unwrap().checked().unwrap());
    assert_eq!(both.particles.id[3], 10);
    let close = load(&case, &[("walls.shapes", &tank.replace("-0.2", "0.1"))]).unwrap().checked().unwrap_err().to_string();
    assert!(close.contains("`fluid.from_file` and `walls.shapes[0]` overlap"), "{close}");

    let fluid = [("fluid.shapes", "[{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }]")];
    let twice = load(&case, &fluid).unwrap().checked().unwrap_err().to_string();
    assert!(twice.contains("`fluid.shapes` is a list of 1, but must be left out where `fluid.from_file` is given"), "{twice}");
}

#[test]
fn bad_tables_are_errors_of_the_case() {
    let (folder, case) = from_file("bad-table", "particles.csv");
    let message = || {
        let error = load(&case, &[]).unwrap().checked().unwrap_err();
        (error.to_string(), error.exit_code())
    };
    assert!(message().0.contains("particles.csv: cannot be read") && message().1 == 2);
    folder.write("particles.csv", &TABLE.replace("0.16", "nan"));
    assert!(
        message().0.ends_with("particles.csv:3: column `x` is nan, but must be a finite number") && message().1 == 2,
        "{}",
        message().0
    );
    folder.write("particles.csv", &TABLE.replace("7,fluid", "3,fluid"));
    assert!(message().0.contains("must be unique; row 2 has the same"), "{}", message().0);
    folder.write("particles.csv", &TABLE.replace("fluid", "wall"));
    assert!(message().0.contains("`fluid` is without a particle"), "{}", message().0);
    folder.write("particles.csv", TABLE);
    let few = load(&case, &[("limits.particles", "2")]).unwrap().checked().unwrap_err().to_string();
    assert!(few.contains("more than 2 particles"), "{few}");
}

#[test]
fn a_case_cannot_read_outside_its_folder() {
    let outside = Folder::new("outside");
    let secret = outside.write("particles.csv", TABLE);
    for path in [secret.as_str(), "../particles.csv", "sub/../../particles.csv"] {
        let (_folder, case) = from_file("escape", path);
        let error = load(&case, &[]).unwrap().checked().unwrap_err();
        assert!(matches!(error, CaseError::OutsideFolder { .. }), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
    #[cfg(unix)]
    {
        let (folder, case) = from_file("link", "particles.csv");
        std::os::unix::fs::symlink(&secret, folder.0.join("particles.csv")).unwrap();
        let error = load(&case, &[]).unwrap().checked().unwrap_err();
        assert!(matches!(error, CaseError::OutsideFolder { .. }), "{error}");
    }
}

#[test]
fn formulas_give_velocity_and_pressure_at_the_start() {
    let with = |keys: &str| parse(&GOOD.replacen("spacing = 0.1\n", &format!("spacing = 0.1\n{keys}\n"), 1));
    let setup = two_d(with("velocity = [\"-y\", \"2*x\"]\npressure = \"100*x^2\"").unwrap());
    for a in (0..setup.particles.owned()).filter(|&a| setup.particles.is_fluid(a)) {
        let (x, v) = (setup.particles.x[a], setup.particles.v[a]);
        assert_eq!((v, setup.particles.pressure[a]), (Vector([-x[1], 2.0 * x[0]]), 100.0 * x[0].powf(2.0)));
    }
    for (keys, expected) in [
        (
            "velocity = [\"q\", \"x\"]",
            "`fluid.velocity[0]` is \"q\", but must be a formula; character 1: unknown name `q`; known: x, y, pi",
        ),
        ("velocity = [\"x\"]", "`fluid.velocity` is a list of 1, but must be a list of 2 formulas"),
        ("velocity = [\"z\", 0]", "unknown name `z`"),
        ("pressure = \"1/(x - 0.05)*0\"", "`fluid.pressure` is NaN at [0.05, 0.05] m, but must be finite at every particle"),
        ("pressure = \"1 +\"", "character 4: the formula ends"),
        ("pressure = true", "`fluid.pressure` has a value of the wrong type"),
    ] {
        let message = with(keys).unwrap_err().to_string();
        assert!(message.contains(expected), "{keys}: {message}");
    }
}

/// The tank of the good case with a paddle that swings beside it.
const PADDLE: &str =
    "shapes = [{ name = \"paddle\", velocity = [\"0.5*cos(20*t)\", \"0\"], box = { min = [1.0, 0.0], max = [1.2, 0.5] } }, { tank";

#[test]
fn walls_move_as_their_formula_says() {
    let text = GOOD.replace("shapes = [{ tank", PADDLE).replace("end = 1.0", "end = 1.0\nstep = 0.0005");
    let setup = two_d(parse(&text).unwrap());
    let paddle: Vec<usize> = (0..setup.particles.owned()).filter(|&a| setup.particles.body[a] == 1).collect();
    assert_eq!(paddle.len(), 10);
    assert!(setup.speed >= 0.5 && setup.particles.v[paddle[0]] == Vector([0.5, 0.0]));
    let mut simulation = setup.simulation().unwrap();
    simulation.start().unwrap();
    for _ in 0..100 {
        simulation.advance().unwrap();
        let shift = 0.5 / 20.0 * (20.0 * simulation.time()).sin();
        let p = simulation.particles();
        for &a in &paddle {
            let row = p.id.iter().position(|&id| id == setup.particles.id[a]).unwrap();
            // 1e-9 m: Simpson's rule over steps of a hundredth of a radian.
            let away = p.x[row][0] - setup.particles.x[a][0] - shift;
            assert!(away.abs() < 1e-9, "t = {}: {away}", simulation.time());
        }
    }
    let resolved = two_d(parse(&setup.resolved).unwrap());
    assert_eq!(resolved.motions, setup.motions);
    for (from, to, expected) in [
        ("0.5*cos(20*t)", "x", "`walls.shapes[0].velocity[0]` is \"x\", but must be a formula; character 1: unknown name `x`; known: t"),
        ("0.5*cos(20*t)", "1/t", "`walls.shapes[0].velocity` is not finite at some time"),
        (
            "velocity = [\"0.5*cos(20*t)\", \"0\"]",
            "moves = false",
            "`walls.shapes[0].moves` is given, but must be left out without a `velocity`",
        ),
        ("\"paddle\"", "\"a paddle\"", "`walls.shapes[0].name` is \"a paddle\""),
        ("velocity", "velocty", "`walls.shapes[0]` is \"velocty\", which is unknown, did you mean `velocity`?"),
    ] {
        let message = parse(&text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

/// Still water in a tank that goes evenly, and water with it, has the pressure of still water, whatever moves when within a step. Shifts go by speed and
/// are left out. 1e-11 of `ρ g H`: round-off of positions that differ by some centimetres, in ten steps of some ten sound steps each; later on, limits
/// by which places are told apart are crossed by round-off. Mirror points 1e-4: which particles a fit stands on is decided by such limits from the start, in
/// the corners. With walls that stay behind within a step it is some 1e-2.
#[test]
fn a_tank_that_goes_evenly_is_a_tank_at_rest() {
    let pressures = |method: &str, speed: f64| {
        let text = format!(
            "format = 1\ntitle = \"t\"\ndimension = 2\n[fluid]\nspacing = 0.05\nvelocity = [{speed}, 0]\nshapes = [{{ box = {{ min = [0.0, 0.0], max = [1.0, 0.5] }} }}]\n\
             [walls]\nlayers = 4\nshapes = [{{ velocity = [{speed}, 0], tank = {{ min = [0.0, 0.0], max = [1.0, 0.8], open = [\"top\"] }} }}]\n\
             [method]\n{method}\nshifting = 0.0\n[time]\nend = 1.0\nstep = 0.005\n"
        );
        let mut simulation = two_d(parse(&text).unwrap()).simulation().unwrap();
        simulation.start().unwrap();
        (0..10).for_each(|_| assert!(simulation.advance().is_ok()));
        let p = simulation.particles();
        let mut pressures: Vec<(u32, f64)> = (0..p.owned()).map(|a| (p.id[a], p.pressure[a])).collect();
        pressures.sort_unstable_by_key(|&(id, _)| id);
        pressures
    };
    for (method, most) in [
        ("name = \"delta-sph\"", 1e-11),
        ("name = \"delta-sph\"\nstepping = \"single\"", 1e-11),
        ("name = \"delta-sph\"\nwall_pressure = \"ghost-nodes\"", 1e-4),
        ("name = \"riemann\"", 1e-11),
        ("name = \"edac\"", 1e-11),
        ("name = \"rkpm\"", 1e-11),
        ("name = \"mlsph\"", 1e-11),
    ] {
        let (still, going) = (pressures(method, 0.0), pressures(method, 0.5));
        let apart = still.iter().zip(&going).map(|(still, going)| (still.1 - going.1).abs()).fold(0.0, f64::max);
        assert!(apart < most * 1000.0 * 9.81 * 0.5, "{method}: {apart} Pa");
    }
}

#[test]
fn instruments_are_checked() {
    let text = format!(
        "{}size = 0.2\nnormal = [-2.0, 0.0]\n\n[[gauge]]\nname = \"h\"\nquantity = \"elevation\"\nposition = [0.2, 0.1]\n\n\
         [[gauge]]\nname = \"q\"\nquantity = \"flow\"\nfrom = [0.4, 0.0]\nto = [0.4, 1.0]\n\n[[load]]\nname = \"paddle\"\nwalls = [\"paddle\"]\n",
        GOOD.replace("shapes = [{ tank", PADDLE)
    );
    let setup = two_d(parse(&text).unwrap());
    assert_eq!((setup.probes[0].size, setup.gauges.len(), setup.loads[0].bodies.as_slice()), (0.2, 2, [1].as_slice()));
    for (from, to, expected) in [
        ("normal = [-2.0, 0.0]", "", "`probe[0].normal` is left out, but must be given for a probe with a `size`"),
        (
            "position = [2.0, 0.1]",
            "position = [1.6, 1.0]",
            "m from the nearest wall particle, but must be within 0.2600 m of the face of a wall or of the fluid",
        ),
        ("[\"paddle\"]", "[\"padle\"]", "`load[0].walls[0]` is \"padle\", which is unknown, did you mean `paddle`?"),
        ("size = 0.2", "size = 0.2\non = \"padle\"", "`probe[0].on` is \"padle\", which is unknown, did you mean `paddle`?"),
        ("name = \"paddle\", ", "", "`load[0].walls[0]` is \"paddle\", but must be the `name` of a wall shape"),
        ("from = [0.4, 0.0]", "on = \"paddle\"\nfrom = [0.4, 0.0]", "`gauge[1].on` is given, but must be left out for a gauge of flow"),
        ("to = [0.4, 1.0]", "to = [0.4, 0.0]", "`gauge[1].to` is [0.4, 0.0], but must be another point than `from`"),
        ("position = [0.2, 0.1]\n", "", "`gauge[0].position` is left out, but must be given for a gauge of elevation"),
        ("name = \"q\"", "name = \"h\"", "`gauge[1].name` is \"h\", but must be unique"),
        ("quantity = \"flow\"", "quantity = \"flw\"", "`gauge[1].quantity` is \"flw\", which is unknown, did you mean `flow`?"),
    ] {
        assert!(text.contains(from), "{from}");
        let message = parse(&text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

/// A probe on the face of a paddle that swings by 25 mm, two fifths of a spacing and more: told of in `check`, unless it goes along.
#[test]
fn a_probe_that_its_wall_leaves_behind_is_told_of() {
    let text = GOOD.replace("shapes = [{ tank", PADDLE).replace("position = [2.0, 0.1]", "position = [1.0, 0.1]");
    let warnings = |text: &str| two_d(parse(text).unwrap()).audit().warnings.join("\n");
    let told = "the probe `P1` stays where it is, while the wall beside it moves by up to 0.0500 m";
    assert!(warnings(&text).contains(told), "{}", warnings(&text));
    let along = text.replace("position = [1.0, 0.1]", "position = [1.0, 0.1]\non = \"paddle\"");
    assert!(!warnings(&along).contains("stays where it is"), "{}", warnings(&along));
    let setup = two_d(parse(&along).unwrap());
    let mount = setup.probes[0].mount.as_ref().unwrap();
    assert_eq!((mount.wall.as_str(), setup.particles.body[mount.id as usize]), ("paddle", 1));
    assert_eq!(two_d(parse(&setup.resolved).unwrap()).probes, setup.probes);
}

#[test]
fn solid_obstacles_and_other_shapes_fill_with_particles() {
    let walls = "shapes = [{ polygon = { points = [[1.0, 0.0], [1.4, 0.0], [1.0, 0.4]] } }, { difference = { of = { box = { min = [2.0, 0.0], max = [2.5, 0.5] } }, minus = [{ circle = { center = [2.25, 0.25], radius = 0.06 } }] } },";
    let setup = two_d(parse(&GOOD.replace("shapes = [{ tank", &format!("{walls} {{ tank")).replace("[2.0, 1.5]", "[3.0, 1.5]")).unwrap());
    let inside = |low: f64, high: f64| setup.particles.x.iter().filter(|x| x[0] > low && x[0] < high && x[1] > 0.0 && x[1] < 1.0).count();
    assert_eq!(inside(0.9, 1.5), 6, "lattice centres strictly below the slope: 3 + 2 + 1");
    assert_eq!(inside(1.9, 2.6), 24, "25 cells less the one in the hole");
}

#[test]
fn packed_shapes_have_their_own_volume_and_tanks_stay_lines() {
    let disc = "arrangement = \"packed\"\nshapes = [{ circle = { center = [0.65, 0.65], radius = 0.5 } }]";
    let setup = two_d(parse(&GOOD.replace("shapes = [{ box = { min = [0.0, 0.0], max = [0.5, 1.0] } }]", disc)).unwrap());
    let mass: f64 = (0..setup.particles.owned()).filter(|&a| setup.particles.is_fluid(a)).map(|a| setup.particles.mass[a]).sum();
    // 2e-3: cells of half a spacing cut by the rim count by the depth of their centre, to second order in a tenth of the radius.
    assert!((mass / (1000.0 * std::f64::consts::PI * 0.25) - 1.0).abs() < 2e-3, "{mass} kg/m");
    let again = two_d(parse(&setup.resolved).unwrap());
    assert_eq!(again.particles, setup.particles, "the resolved case packs the same way");
    let (message, code) = broken("layers = 2", "layers = 2\narrangement = \"packed\"");
    assert!(
        message.contains("`walls.arrangement` is \"packed\", but must be \"lattice\" where no solid shape is there to fill"),
        "{message}"
    );
    assert_eq!(code, 2);
}
