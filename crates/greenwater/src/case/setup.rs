//! From what was written to what runs: every check of a case is here, and nothing behind [`Setup`] repeats one.

use std::path::{Component, Path, PathBuf};

use serde::Serialize;
use toml::Value;

use super::error::{CaseError, Choices};
use super::instruments::{self, InitialFields};
use super::method;
use super::packing::pack;
use super::particle_file;
use super::sections::{Arrangement, InitialPressure, Kernel, Precision, Reference, Sections, Time};
use super::shape::{AXES, Lattice, Region, Shape, is_whole, too_close, vector};
use super::source::{Source, inside};
use crate::domain::{Domain, Periods};
use crate::kernel::KernelName;
use crate::machine::memory;
use crate::math::Vector;
use crate::motion::Motion;
use crate::observe::{Gauge, Load, Sensor};
use crate::particles::{Kind, Particle, Particles, field_table};
use crate::poisson::SolveError;
use crate::scheme::{Medium, MethodName, MethodSettings, Preset, Still};
use crate::simulation::{FEWEST_STEPS, Simulation};

/// A checked case in `D` dimensions: what runs. SI units; in 2D everything is per metre of depth.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup<const D: usize> {
    /// Short name: of the case's folder, or of its file.
    pub name: String,
    /// One line for reports.
    pub title: String,
    /// Distance between particles at the start, m.
    pub spacing: f64,
    /// Density at rest, kg/m³.
    pub rest_density: f64,
    /// Dynamic viscosity, Pa s.
    pub viscosity: f64,
    /// Acceleration of gravity, m/s².
    pub gravity: Vector<D>,
    /// Height of the fluid at the start, against gravity (along the last axis without gravity), m.
    pub depth: f64,
    /// Lowest point of the fluid at the start along the direction against gravity, m.
    pub floor: f64,
    /// Length of the fluid at the start along x, m.
    pub width: f64,
    /// Volume of the fluid at the start, m³ (m² in 2D).
    pub fluid_volume: f64,
    /// The initial state: fluid first, then walls, each sorted by position; a table's particles in its own order.
    pub particles: Particles<D>,
    /// The kernel.
    pub kernel: KernelName,
    /// Smoothing length over spacing.
    pub h_over_spacing: f64,
    /// Smoothing length, m; a table's particles may have their own.
    pub smoothing_length: f64,
    /// The method and all its parameters.
    pub method: MethodSettings,
    /// How long, and in what steps.
    pub time: Time,
    /// The region that counts.
    pub bounds: Bounds<D>,
    /// Walls that move.
    pub motions: Vec<Motion<D>>,
    /// Largest speed expected, m/s: of falling through the depth, of the initial state and of the walls.
    pub speed: f64,
    /// Sensors that record the pressure.
    pub probes: Vec<Sensor<D>>,
    /// Lines along which the water level or the flow is recorded.
    pub gauges: Vec<Gauge<D>>,
    /// Walls on which force and moment are recorded.
    pub loads: Vec<Load<D>>,
    /// What is written, and when.
    pub output: OutputPlan,
    /// What `compare` runs and plots.
    pub compare: ComparePlan,
    /// The table of particles that the case names, if any: the name as written, and where it lies.
    pub particle_file: Option<(String, PathBuf)>,
    /// What the run will take.
    pub estimate: Estimate,
    /// The case as written.
    pub written: String,
    /// The case with every default filled in: itself a case, which gives this same setup.
    pub resolved: String,
}

/// The region that counts. A particle outside a bound that is not periodic is lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds<const D: usize> {
    /// Lower corner, m.
    pub min: Vector<D>,
    /// Upper corner, m.
    pub max: Vector<D>,
    /// Axes along which the region repeats.
    pub periodic: [bool; D],
}

impl<const D: usize> Bounds<D> {
    /// Lengths after which the region repeats.
    pub fn periods(&self) -> Periods<D> {
        Periods::of(self.min, self.max, self.periodic)
    }
}

/// What is written, and when.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputPlan {
    /// Times of frames, s, rising; the first is 0, the last the end of the run.
    pub frame_times: Vec<f64>,
    /// Columns of a frame besides the position, as named in the field table.
    pub fields: Vec<&'static str>,
    /// Number format of frames.
    pub precision: Precision,
    /// Time between rows of tables, s; 0: every step.
    pub sample_interval: f64,
    /// Time between rows of the tables of probes, gauges and loads, s; 0: every step.
    pub sensor_interval: f64,
}

/// What `compare` runs and plots.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparePlan {
    /// The methods, each with the preset its defaults come from.
    pub methods: Vec<(MethodName, Preset)>,
    /// Times of the pictures side by side, s, rising.
    pub times: Vec<f64>,
    /// Curves to compare with.
    pub references: Vec<Reference>,
}

/// What a run will take: predictions, not promises.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Number of fluid particles.
    pub fluid: usize,
    /// Number of wall particles.
    pub walls: usize,
    /// Neighbours of a particle inside the fluid: particles within the kernel's support on a lattice.
    pub neighbours: f64,
    /// Memory, bytes: a particle takes 600 for its columns and workspaces, and 5 more a neighbour for the pair list; a pressure
    /// equation takes 16 more a neighbour, and the dense matrix of Gauss or the vectors of GMRES.
    pub memory_bytes: f64,
    /// Time step, s: `courant · h/(c + v)` with `v = 2 √(gH)`, or the largest initial speed if that is more, and the sound
    /// speed `c` of the method (0 for an incompressible one), or the fixed step. None for a fluid at rest without gravity.
    pub time_step: Option<f64>,
    /// Number of steps, where the time step is known.
    pub steps: Option<f64>,
    /// Wall-clock time on one core, s, where the number of steps is known: a guide, from dam breaks of some thousand particles.
    pub seconds: Option<f64>,
    /// Disk, bytes: all frames before compression, and 400 for a row of every table.
    pub disk_bytes: f64,
}

/// Bytes of columns and workspaces of one particle.
const BYTES_PER_PARTICLE: f64 = 600.0;
/// Bytes of the pair list for one neighbour of one particle.
const BYTES_PER_NEIGHBOUR: f64 = 5.0;
/// Bytes of one row in each of the tables.
const BYTES_PER_SAMPLE: f64 = 400.0;
/// One GiB in bytes.
const GIB: f64 = 1_073_741_824.0;

impl<const D: usize> Setup<D> {
    /// Checks a case and makes its particles. Nothing is allocated for them before the limits have been checked.
    pub(super) fn checked(name: &str, mut sections: Sections, source: &Source) -> Result<Self, CaseError> {
        const { assert!(D == 2 || D == 3, "cases exist in 2 and 3 dimensions") };
        let check = |holds: bool, key: &str, value: f64, rule: &str| source.rule(holds, key, value, rule);
        let s = &sections;
        let (dx, density) = (s.fluid.spacing, s.fluid.density);
        check(dx > 0.0, "fluid.spacing", dx, "> 0")?;
        check(density > 0.0, "fluid.density", density, "> 0")?;
        check(s.fluid.viscosity >= 0.0, "fluid.viscosity", s.fluid.viscosity, ">= 0")?;
        source.rule((1..=32).contains(&s.walls.layers), "walls.layers", s.walls.layers, "1 to 32")?;
        let (own_kernel, own_ratio) = s.method.name.kernel();
        let (kernel, ratio) = (s.kernel.name.unwrap_or(own_kernel), s.kernel.h_over_spacing.unwrap_or(own_ratio));
        if !s.method.name.takes_kernel() {
            // What the resolved case of a run says is allowed, so that it can be run again.
            let rule = |own: &str| format!("left out, or {own}: method `{}` has weights of its own", s.method.name.name());
            source.rule(kernel == own_kernel, "kernel.name", kernel.name(), rule(own_kernel.name()))?;
            source.rule(ratio == own_ratio, "kernel.h_over_spacing", ratio, rule(&own_ratio.to_string()))?;
        }
        check((0.5..=5.0).contains(&ratio), "kernel.h_over_spacing", ratio, "0.5 to 5")?;
        let rule = format!(
            "at least {:.3} with the kernel `{}`: its support of {} smoothing lengths has to hold the neighbours across a cell, 1.5 spacings away",
            1.5 / kernel.radius(),
            kernel.name(),
            kernel.radius()
        );
        source.rule(!s.method.name.takes_kernel() || ratio * kernel.radius() >= 1.5, "kernel.h_over_spacing", ratio, rule)?;
        check(s.time.end > 0.0, "time.end", s.time.end, "> 0")?;
        check(s.time.courant > 0.0 && s.time.courant <= 1.0, "time.courant", s.time.courant, "> 0 and <= 1")?;
        if let Some(step) = s.time.step {
            check(step > 0.0, "time.step", step, "> 0")?;
            source.rule(step <= s.time.end, "time.step", step, format!("at most `time.end`, {} s", s.time.end))?;
        }
        let gravity = match &s.gravity.acceleration {
            Some(numbers) => vector(numbers, "gravity.acceleration", source)?,
            None => -9.81 * Vector::unit(D - 1),
        };
        let h = ratio * dx;

        let fluid = regions::<D>(&s.fluid.shapes, "fluid.shapes", source)?;
        let wall_shapes: Vec<Shape> = s.walls.shapes.iter().map(|wall| wall.shape.clone()).collect();
        let walls = regions::<D>(&wall_shapes, "walls.shapes", source)?;
        let motions = instruments::motions::<D>(s, source)?;
        for (arrangement, regions, key) in [(s.fluid.arrangement, &fluid, "fluid"), (s.walls.arrangement, &walls, "walls")] {
            let packs = arrangement == Arrangement::Lattice || regions.iter().any(|(_, region)| region.is_solid());
            source.rule(packs, &format!("{key}.arrangement"), "\"packed\"", "\"lattice\" where no solid shape is there to fill")?;
        }
        let initial = InitialFields::checked::<D>(&s.fluid, source)?;
        let (empty, from_file) = (fluid.is_empty(), s.fluid.from_file.is_some());
        source.rule(
            !empty || from_file,
            "fluid.shapes",
            "empty",
            "a list of one shape or more, such as `box`, unless `fluid.from_file` is given",
        )?;
        source.rule(
            empty || !from_file,
            "fluid.shapes",
            format!("a list of {}", fluid.len()),
            "left out where `fluid.from_file` is given",
        )?;

        let mut method = method::settings(&s.method, kernel.radius() * ratio, source)?;
        let limits = Limits::of(s, method.clone(), source, neighbours::<D>(kernel.radius() * ratio))?;
        let predicted = fluid.iter().chain(&walls).map(|(_, region)| region.predicted(dx, s.walls.layers)).sum();
        limits.check(predicted, source)?;
        check_sides(fluid.iter().chain(&walls), dx, source)?;

        let fill = Fill { dx, h, density, layers: s.walls.layers };
        let mut bodies = Bodies::default();
        let mut particle_file = None;
        if let Some(written) = &s.fluid.from_file {
            let path = path_in_folder(written, source)?;
            bodies.add_table(particle_file::read(&path, limits.particles_that_fit())?);
            particle_file = Some((written.clone(), path));
        }
        let common = fluid.first().map_or(Lattice { origin: Vector::ZERO, spacing: dx }, |(_, region)| Lattice::of(region, dx));
        bodies.fill(&fluid, Kind::Fluid, common, &fill, s.fluid.arrangement);
        bodies.fill(&walls, Kind::Wall, common, &fill, s.walls.arrangement);
        limits.check(bodies.rows.len() as f64, source)?;
        bodies.check_apart(dx, source)?;

        let is_fluid = |row: &&Row<D>| row.particle.kind == Kind::Fluid;
        let fluid_count = bodies.rows.iter().filter(is_fluid).count();
        source.rule(fluid_count > 0, "fluid", "without a particle", "at least one spacing wide somewhere, or a table with fluid in it")?;
        let fluid_box = if fluid.is_empty() {
            let (min, max) = around(bodies.rows.iter().filter(is_fluid).map(|row| row.particle.x));
            (min - Vector::splat(0.5 * dx), max + Vector::splat(0.5 * dx))
        } else {
            fluid.iter().map(|(_, region)| region.bounds()).reduce(join).unwrap_or_default()
        };
        let g = gravity.norm();
        let up = if g > 0.0 { -gravity / g } else { Vector::unit(D - 1) };
        let top = highest(fluid_box, up);
        let floor = -highest(fluid_box, -up);
        let depth = top - floor;
        if s.fluid.initial_pressure == InitialPressure::Hydrostatic {
            for row in bodies.rows.iter_mut().filter(|row| row.table_id.is_none() && row.particle.kind == Kind::Fluid) {
                row.particle.pressure = density * g * (top - row.particle.x.dot(up));
            }
        }
        for row in bodies.rows.iter_mut().filter(|row| row.table_id.is_none() && row.particle.kind == Kind::Fluid) {
            let particle = &mut row.particle;
            particle.v = initial.velocity(particle.x, source)?.unwrap_or(particle.v);
            particle.pressure = initial.pressure(particle.x, source)?.unwrap_or(particle.pressure);
        }
        for motion in &motions {
            let own = |row: &&mut Row<D>| row.wall == motion.body;
            bodies.rows.iter_mut().filter(own).for_each(|row| row.particle.v = motion.at(0.0));
        }
        let fastest = bodies.rows.iter().map(|row| row.particle.v.norm()).fold(0.0, f64::max);
        let fastest = motions.iter().map(|motion| motion.fastest(s.time.end)).fold(fastest, f64::max);
        let speed = fastest.max(2.0 * (g * depth).sqrt());
        let rule = "other than zero where nothing moves either: the speed of sound of `wcsph` follows from the speeds of the case";
        source.rule(speed > 0.0 || method.method() != MethodName::Wcsph, "gravity.acceleration", "zero", rule)?;
        let pressure_written = s.fluid.pressure.is_some() || s.fluid.initial_pressure == InitialPressure::Zero;
        method.resolve(&Still { g, depth, floor, speed, spacing: dx, from_file: s.fluid.from_file.is_some(), pressure_written });
        let fluid_volume = bodies.rows.iter().filter(is_fluid).map(|row| row.particle.mass / row.particle.density).sum();
        let particles = bodies.into_particles(source)?;
        let (widest, most) = (particles.h_max(), 5.0 * dx);
        let rule = format!("a table whose h is at most 5 spacings, {most} m: neighbours are counted from it");
        source.rule(
            s.fluid.from_file.is_none() || widest <= most * (1.0 + 1e-9),
            "fluid.from_file",
            format!("a table with h = {widest} m"),
            rule,
        )?;

        let bounds = bounds(s, kernel.radius(), &particles, fluid_box, (up, &motions), source)?;
        let medium = Medium {
            rest_density: density,
            viscosity: s.fluid.viscosity,
            gravity,
            spacing: dx,
            depth,
            floor,
            courant: s.time.courant,
            speed,
        };
        let mut probes = instruments::sensors(s, &bounds, &particles, &medium, source)?;
        if !method.walls_pull() {
            // Those in the midst of the fluid feel what there is.
            let on_wall = |sensor: &Sensor<D>| {
                let near = |a: usize| (particles.x[a] - sensor.position).norm() < 1.5 * dx;
                (0..particles.owned()).any(|a| particles.kind[a] == Kind::Wall && near(a))
            };
            probes = probes.into_iter().map(|sensor| if on_wall(&sensor) { sensor.without_suction() } else { sensor }).collect();
        }
        let gauges = instruments::gauges(s, &bounds, &particles, dx, source)?;
        let loads = instruments::loads(s, source)?;
        let compare = compare_plan::<D>(s, source)?;
        let output = output_plan(s, &compare, source)?;

        let flow = (2.0 * (g * depth).sqrt()).max(fastest);
        let sound = flow + method.sound_speed(g, depth, fastest);
        let viscous = 0.5 * s.time.courant * h * h * density / s.fluid.viscosity;
        let slowest = if method.sound_step().is_some() { flow } else { sound };
        let limit = (s.time.courant * h / slowest).min(viscous).min(s.time.end / FEWEST_STEPS);
        let time_step = s.time.step.or_else(|| limit.is_finite().then_some(limit));
        // Sound steps within one of the flow.
        let sound_steps = method.sound_step().zip(time_step).map_or(1.0, |(share, step)| (step * sound / (share * h)).ceil().max(1.0));
        let steps = time_step.map(|step| (s.time.end / step).ceil().min(s.time.max_steps.unwrap_or(u64::MAX) as f64));
        let samples = if output.sample_interval > 0.0 { s.time.end / output.sample_interval } else { steps.unwrap_or(0.0) };
        let count = particles.owned() as f64;
        let estimate = Estimate {
            fluid: fluid_count,
            walls: particles.owned() - fluid_count,
            neighbours: limits.neighbours,
            memory_bytes: limits.memory_of(count),
            time_step,
            steps,
            seconds: steps.map(|steps| steps * sound_steps * count * limits.neighbours * method.step_cost()),
            disk_bytes: output.frame_times.len() as f64 * count * bytes_of_frame_row::<D>(&output) + samples * BYTES_PER_SAMPLE,
        };

        // From here on the sections are the resolved ones.
        let s = &mut sections;
        s.gravity.acceleration = Some(gravity.0.to_vec());
        s.domain.min = Some(bounds.min.0.to_vec());
        s.domain.max = Some(bounds.max.0.to_vec());
        s.output.interval = frame_interval(s);
        s.output.sample_interval = Some(output.sample_interval);
        s.output.sensor_interval = Some(output.sensor_interval);
        s.compare.times = Some(compare.times.clone());
        s.limits.memory_gib = Some(limits.memory_gib);
        s.kernel = Kernel { name: Some(kernel), h_over_spacing: Some(ratio) };
        s.method.keys = method::table(&method);
        for name in ["name", "preset"] {
            s.method.keys.remove(name);
        }
        let resolved = toml::to_string(&s).map_err(|e| source.broken("format", "a case", format!("writable as TOML: {e}")))?;
        Ok(Self {
            name: name.to_owned(),
            title: sections.title,
            spacing: dx,
            rest_density: density,
            viscosity: sections.fluid.viscosity,
            gravity,
            depth,
            floor,
            width: fluid_box.1[0] - fluid_box.0[0],
            fluid_volume,
            particles,
            kernel,
            h_over_spacing: ratio,
            smoothing_length: h,
            method,
            time: sections.time,
            bounds,
            motions,
            speed,
            probes,
            gauges,
            loads,
            output,
            compare,
            particle_file,
            estimate,
            written: source.text.clone(),
            resolved,
        })
    }

    /// The fluid and the forces on it, as methods take them.
    pub fn medium(&self) -> Medium<D> {
        Medium {
            rest_density: self.rest_density,
            viscosity: self.viscosity,
            gravity: self.gravity,
            spacing: self.spacing,
            depth: self.depth,
            floor: self.floor,
            courant: self.time.courant,
            speed: self.speed,
        }
    }

    /// The table of particles that the case names: as written there, relative to the case's folder, and where it lies.
    pub fn particle_table(&self) -> Option<(&str, &Path)> {
        self.particle_file.as_ref().map(|(name, path)| (name.as_str(), path.as_path()))
    }

    /// The region that counts, as the neighbour search takes it.
    pub fn domain(&self) -> Domain<D> {
        Domain::new(self.bounds.min, self.bounds.max, self.bounds.periodic)
    }
}

// In concrete dimensions, so that the methods with all kernels are compiled once, in this crate.
impl Setup<2> {
    /// The run, ready to start.
    ///
    /// # Errors
    /// Settings of the pressure solver that contradict each other; a checked case has none.
    pub fn simulation(&self) -> Result<Simulation<2>, SolveError> {
        put_together(self)
    }
}

impl Setup<3> {
    /// The run, ready to start.
    ///
    /// # Errors
    /// Settings of the pressure solver that contradict each other; a checked case has none.
    pub fn simulation(&self) -> Result<Simulation<3>, SolveError> {
        put_together(self)
    }
}

fn put_together<const D: usize>(setup: &Setup<D>) -> Result<Simulation<D>, SolveError> {
    let medium = setup.medium();
    let scheme = setup.method.scheme(setup.kernel, medium)?;
    let simulation = Simulation::new(setup.particles.clone(), setup.domain(), scheme, &medium, setup.time.step);
    Ok(simulation.with_motions(setup.motions.clone()))
}

/// A checked case in the dimension it was written for.
#[derive(Clone, Debug, PartialEq)]
pub enum AnySetup {
    /// In two dimensions.
    D2(Setup<2>),
    /// In three dimensions.
    D3(Setup<3>),
}

/// Evaluates `$body` with `$setup` bound to the setup of either dimension.
#[macro_export]
macro_rules! with_setup {
    ($any:expr, $setup:ident => $body:expr) => {
        match $any {
            $crate::case::AnySetup::D2($setup) => $body,
            $crate::case::AnySetup::D3($setup) => $body,
        }
    };
}

impl AnySetup {
    /// Short name: of the case's folder, or of its file.
    pub fn name(&self) -> &str {
        with_setup!(self, setup => &setup.name)
    }

    /// One line for reports.
    pub fn title(&self) -> &str {
        with_setup!(self, setup => &setup.title)
    }

    /// 2 or 3.
    pub fn dimension(&self) -> usize {
        match self {
            Self::D2(_) => 2,
            Self::D3(_) => 3,
        }
    }

    /// What the run will take.
    pub fn estimate(&self) -> &Estimate {
        with_setup!(self, setup => &setup.estimate)
    }

    /// What `compare` runs and plots.
    pub fn compare(&self) -> &ComparePlan {
        with_setup!(self, setup => &setup.compare)
    }

    /// The method and all its parameters.
    pub fn method(&self) -> &MethodSettings {
        with_setup!(self, setup => &setup.method)
    }

    /// The case as written.
    pub fn written(&self) -> &str {
        with_setup!(self, setup => &setup.written)
    }

    /// The case with every default filled in.
    pub fn resolved(&self) -> &str {
        with_setup!(self, setup => &setup.resolved)
    }
}

type Named<const D: usize> = (String, Region<D>);

fn regions<const D: usize>(shapes: &[Shape], list: &str, source: &Source) -> Result<Vec<Named<D>>, CaseError> {
    let region = |(i, shape): (usize, &Shape)| {
        let key = format!("{list}[{i}]");
        let solid = list == "walls.shapes" || !matches!(shape, Shape::Tank { .. });
        source.rule(solid, &key, "a tank", "a shape that can be filled; a tank belongs to `walls.shapes`")?;
        Region::checked(shape, &key, source).map(|region| (key, region))
    };
    shapes.iter().enumerate().map(region).collect()
}

/// Every side of a box or tank is a whole number of spacings long, and positions still tell particles apart.
fn check_sides<'a, const D: usize>(shapes: impl Iterator<Item = &'a Named<D>> + Clone, dx: f64, source: &Source) -> Result<(), CaseError> {
    let sides = |region: &Region<D>| {
        let (min, max) = region.bounds();
        let whole = matches!(region, Region::Block { .. } | Region::Tank { .. });
        if whole { (max - min).0.to_vec() } else { Vec::new() }
    };
    let all: Vec<f64> = shapes.clone().flat_map(|(_, region)| sides(region)).collect();
    for (key, region) in shapes {
        let (min, max) = region.bounds();
        let far = (0..D).map(|d| min[d].abs().max(max[d].abs())).fold(0.0, f64::max);
        source.rule(far < 1e9 * dx, key, format!("up to {far} m from the origin"), format!("within 1e9 spacings of it, {} m", 1e9 * dx))?;
        for (d, &extent) in sides(region).iter().enumerate() {
            if !is_whole(extent, dx) {
                return Err(CaseError::NotWholeSpacings {
                    place: source.place(key),
                    key: key.clone(),
                    extent,
                    axis: AXES[d],
                    spacings: extent / dx,
                    spacing: dx,
                    nearest: nearest_spacing(&all, extent, dx),
                });
            }
        }
    }
    Ok(())
}

/// The spacing nearest to `dx` that divides all `sides`; if none within a factor of 10 does, the one that divides `extent`.
fn nearest_spacing(sides: &[f64], extent: f64, dx: f64) -> f64 {
    let shortest = sides.iter().copied().fold(f64::INFINITY, f64::min);
    let most = (10.0 * shortest / dx).min(100_000.0) as u64;
    let fits = (1..=most).map(|n| shortest / n as f64).filter(|&dx| sides.iter().all(|&side| is_whole(side, dx)));
    let own = extent / (extent / dx).round().max(1.0);
    fits.filter(|fit| *fit < 10.0 * dx).min_by(|a, b| (a - dx).abs().total_cmp(&(b - dx).abs())).unwrap_or(own)
}

/// Number of lattice points within `reach` spacings, from the volume of the ball.
fn neighbours<const D: usize>(reach: f64) -> f64 {
    let pi = std::f64::consts::PI;
    if D == 2 { pi * reach * reach } else { 4.0 / 3.0 * pi * reach * reach * reach }
}

/// What the case may use, and what a particle takes.
struct Limits {
    method: MethodSettings,
    particles: u64,
    memory_gib: f64,
    neighbours: f64,
}

impl Limits {
    fn of(s: &Sections, method: MethodSettings, source: &Source, neighbours: f64) -> Result<Self, CaseError> {
        let particles = s.limits.particles;
        source.rule((1..=4_000_000_000).contains(&particles), "limits.particles", particles, "1 to 4000000000")?;
        let memory_gib = s.limits.memory_gib.unwrap_or_else(|| (0.75 * memory() / GIB * 1e3).round() / 1e3);
        source.rule(memory_gib > 0.0, "limits.memory_gib", memory_gib, "> 0")?;
        Ok(Self { method, particles, memory_gib, neighbours })
    }

    /// Bytes for `count` particles.
    fn memory_of(&self, count: f64) -> f64 {
        let solver = self.method.memory(count, self.neighbours);
        count * (BYTES_PER_PARTICLE + BYTES_PER_NEIGHBOUR * self.neighbours) + solver
    }

    fn particles_that_fit(&self) -> u64 {
        ((self.memory_gib * GIB / self.memory_of(1.0)) as u64).min(self.particles)
    }

    fn check(&self, particles: f64, source: &Source) -> Result<(), CaseError> {
        let memory = self.memory_of(particles) / GIB;
        let over = |key: &'static str, needed: f64, limit: f64, unit: &'static str| {
            let place = source.place("fluid.spacing");
            // NaN (a side of infinite length) is over every limit.
            if needed <= limit { Ok(()) } else { Err(CaseError::OverLimit { place, key, needed, limit, unit, particles }) }
        };
        over("limits.memory_gib", memory, self.memory_gib, "GiB")?;
        over("limits.particles", particles, self.particles as f64, "particles")
    }
}

/// What the particles of shapes have in common.
struct Fill {
    dx: f64,
    h: f64,
    density: f64,
    layers: u32,
}

#[derive(Clone, Copy)]
struct Row<const D: usize> {
    particle: Particle<D>,
    body: u32,
    /// Number of the wall shape, from 1; 0 for fluid and for a table.
    wall: u16,
    table_id: Option<u32>,
}

/// Particles on their way into a setup, and the shapes they came from.
struct Bodies<const D: usize> {
    rows: Vec<Row<D>>,
    /// Keys of the shapes and the table.
    keys: Vec<String>,
}

impl<const D: usize> Default for Bodies<D> {
    fn default() -> Self {
        Self { rows: Vec::new(), keys: Vec::new() }
    }
}

impl<const D: usize> Bodies<D> {
    fn add_table(&mut self, table: Vec<particle_file::Row<D>>) {
        let body = self.keys.len() as u32;
        self.keys.push("fluid.from_file".to_owned());
        self.rows.extend(table.into_iter().map(|(id, particle, _)| Row { particle, body, wall: 0, table_id: Some(id) }));
    }

    /// Fills the shapes and sorts their particles by position, x first.
    fn fill(&mut self, shapes: &[Named<D>], kind: Kind, common: Lattice<D>, fill: &Fill, arrangement: Arrangement) {
        let first = self.rows.len();
        let cell: f64 = (0..D).map(|_| fill.dx).product();
        for ((key, region), number) in shapes.iter().zip(1..) {
            let wall = if kind == Kind::Wall { number } else { 0 };
            let body = self.keys.len() as u32;
            self.keys.push(key.clone());
            let (mut x, mut lines) = (Vec::new(), Vec::new());
            region.fill(region.lattice(common), fill.layers, |at, line| {
                x.push(at);
                lines.push(line);
            });
            let mut volume = cell;
            if arrangement == Arrangement::Packed && region.is_solid() {
                volume = pack(region, &mut x, fill.dx);
                lines = x.iter().map(|&x| region.line(x, fill.dx)).collect();
            }
            for (x, line) in x.into_iter().zip(lines) {
                let layer = if kind == Kind::Wall { line } else { 0 };
                let mass = fill.density * volume;
                let particle = Particle { kind, layer, x, v: Vector::ZERO, mass, density: fill.density, pressure: 0.0, h: fill.h };
                self.rows.push(Row { particle, body, wall, table_id: None });
            }
        }
        self.rows[first..].sort_by(|a, b| {
            let by_axis = (0..D).map(|d| a.particle.x[d].total_cmp(&b.particle.x[d]));
            by_axis.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
        });
    }

    /// No two shapes give particles nearer than half a spacing.
    fn check_apart(&self, dx: f64, source: &Source) -> Result<(), CaseError> {
        let positions: Vec<Vector<D>> = self.rows.iter().map(|row| row.particle.x).collect();
        let bodies: Vec<u32> = self.rows.iter().map(|row| row.body).collect();
        match too_close(&positions, &bodies, 0.5 * dx) {
            None => Ok(()),
            Some((a, b, distance)) => {
                let (first, second) = (bodies[a].min(bodies[b]) as usize, bodies[a].max(bodies[b]) as usize);
                Err(CaseError::Overlap {
                    place: source.place(&self.keys[second]),
                    first: self.keys[first].clone(),
                    second: self.keys[second].clone(),
                    position: positions[a].0.to_vec(),
                    distance,
                    least: 0.5 * dx,
                })
            }
        }
    }

    /// Identities count from 0, or on from the largest of a table.
    fn into_particles(self, source: &Source) -> Result<Particles<D>, CaseError> {
        let largest = self.rows.iter().filter_map(|row| row.table_id).max();
        let mut free = largest.map_or(0, |id| u64::from(id) + 1)..=u64::from(u32::MAX);
        let mut particles = Particles::new();
        for row in self.rows {
            let next = row.table_id.or_else(|| free.next().map(|id| id as u32));
            let id = next.ok_or_else(|| {
                let value = format!("a table with the id {}", largest.unwrap_or_default());
                source.broken("fluid.from_file", value, "a table whose largest id leaves room up to 4294967295 for the other particles")
            })?;
            particles.push(id, row.particle);
            if let Some(body) = particles.body.last_mut() {
                *body = row.wall;
            }
        }
        Ok(particles)
    }
}

/// The path of the table of particles, which must lie in the folder of the case.
fn path_in_folder(written: &str, source: &Source) -> Result<PathBuf, CaseError> {
    let key = "fluid.from_file";
    let outside = || CaseError::OutsideFolder { place: source.place(key), key: key.to_owned(), path: written.to_owned() };
    let leaves = Path::new(written).components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir));
    let folder = source.folder.as_ref().filter(|_| !leaves).ok_or_else(outside)?;
    match inside(folder, written) {
        Ok(path) => path.ok_or_else(outside),
        Err(error) => Err(CaseError::Unreadable { path: folder.join(written), source: error }),
    }
}

/// The smallest box around points.
fn around<const D: usize>(points: impl Iterator<Item = Vector<D>>) -> (Vector<D>, Vector<D>) {
    points.map(|x| (x, x)).reduce(join).unwrap_or_default()
}

fn join<const D: usize>(a: (Vector<D>, Vector<D>), b: (Vector<D>, Vector<D>)) -> (Vector<D>, Vector<D>) {
    (a.0.zip(b.0, f64::min), a.1.zip(b.1, f64::max))
}

/// Largest `x · up` in a box.
fn highest<const D: usize>((min, max): (Vector<D>, Vector<D>), up: Vector<D>) -> f64 {
    (0..D).map(|d| (min[d] * up[d]).max(max[d] * up[d])).sum()
}

fn bounds<const D: usize>(
    s: &Sections,
    kernel_radius: f64,
    particles: &Particles<D>,
    fluid_box: (Vector<D>, Vector<D>),
    (up, motions): (Vector<D>, &[Motion<D>]),
    source: &Source,
) -> Result<Bounds<D>, CaseError> {
    let mut periodic = [false; D];
    for name in &s.domain.periodic {
        let axis = AXES[..D].iter().position(|axis| name.len() == 1 && name.starts_with(*axis));
        let axis =
            axis.ok_or_else(|| source.broken("domain.periodic", format!("{name:?}"), format!("of {}", &["x, y", "x, y, z"][D - 2])))?;
        periodic[axis] = true;
    }
    let (low, high) = join(around(particles.x.iter().copied()), fluid_box);
    // Fluid thrown over a wall is not lost: it counts until it is as far away as everything is large. What is thrown up comes
    // back: ten times as far against gravity.
    let size = (high - low).0.into_iter().fold(0.0, f64::max);
    let margin = |along_up: f64| size * (1.0 + 9.0 * along_up.max(0.0));
    // Walls take the fluid along: those that go far, and may leave the margin.
    let paths = motions.iter().map(|motion| motion.path(s.time.end));
    let (back, forth) = paths.reduce(join).unwrap_or_default();
    let far = |path: f64| if path.abs() > 0.5 * size { path } else { 0.0 };
    let (mut min, mut max) = (low - (-up).map(margin) + back.map(far), high + up.map(margin) + forth.map(far));
    for (key, given, slot) in [("domain.min", &s.domain.min, &mut min), ("domain.max", &s.domain.max, &mut max)] {
        match given {
            Some(numbers) => *slot = vector(numbers, key, source)?,
            None => source.rule(!periodic.contains(&true), key, "left out", "given where an axis is periodic")?,
        }
    }
    let reach = 2.0 * kernel_radius * particles.h_max();
    for d in 0..D {
        source.rule(max[d] > min[d], "domain.max", format!("{:?}", max.0), format!("greater than `domain.min` along {}", AXES[d]))?;
        let wide = !periodic[d] || max[d] - min[d] >= reach;
        let period = max[d] - min[d];
        source.rule(
            wide,
            "domain.max",
            format!("{period} m above `domain.min` along {}", AXES[d]),
            format!(">= {reach} m, two kernel supports"),
        )?;
    }
    if let Some(a) = (0..particles.len()).find(|&a| (0..D).any(|d| particles.x[a][d] < min[d] || particles.x[a][d] > max[d])) {
        let (value, rule) =
            (format!("{:?} to {:?}", min.0, max.0), format!("around every particle; one starts at {:?} m", particles.x[a].0));
        return Err(source.broken("domain", value, rule));
    }
    Ok(Bounds { min, max, periodic })
}

fn compare_plan<const D: usize>(s: &Sections, source: &Source) -> Result<ComparePlan, CaseError> {
    let mut methods = Vec::new();
    source.rule(!s.compare.methods.is_empty(), "compare.methods", "an empty list", "at least one method")?;
    for (i, text) in s.compare.methods.iter().enumerate() {
        let key = format!("compare.methods[{i}]");
        let (name, preset) = match text.split_once(':') {
            Some((name, preset)) => (name, source.read(&key, Value::String(preset.to_owned()))?),
            None => (text.as_str(), Preset::default()),
        };
        let entry = (source.read(&key, Value::String(name.to_owned()))?, preset);
        source.rule(!methods.contains(&entry), &key, format!("{text:?}"), "unique; it stands there twice")?;
        methods.push(entry);
    }
    let times = match (&s.compare.times, s.output.times.is_empty()) {
        (Some(times), _) => sorted_times(times, "compare.times", s.time.end, source)?,
        (None, false) => sorted_times(&s.output.times, "output.times", s.time.end, source)?,
        (None, true) => (0..=5).map(|i| s.time.end * f64::from(i) / 5.0).collect(),
    };
    for (i, curve) in s.compare.reference.iter().enumerate() {
        let key = |name: &str| format!("compare.reference[{i}].{name}");
        let known = match curve.quantity.strip_prefix("probe:") {
            Some(name) => s.probe.iter().any(|probe| probe.name == name),
            None => match (curve.quantity.strip_prefix("gauge:"), curve.quantity.strip_prefix("load:")) {
                (Some(name), _) => s.gauge.iter().any(|gauge| gauge.name == name),
                (_, Some(column)) => {
                    let components: &[&str] = if D == 2 { &["fx", "fy", "mz"] } else { &["fx", "fy", "fz", "mx", "my", "mz"] };
                    let named = column.rsplit_once('.').filter(|(_, component)| components.contains(component));
                    named.is_some_and(|(name, _)| s.load.iter().any(|load| load.name == name))
                }
                _ => ["front", "residual_height"].contains(&curve.quantity.as_str()),
            },
        };
        let rule = "\"front\", \"residual_height\", \"probe:NAME\", \"gauge:NAME\" or \"load:NAME.fx\" with the name of an instrument; a load has fx, fy and mz, in 3D also fz, mx and my";
        source.rule(known, &key("quantity"), format!("{:?}", curve.quantity), rule)?;
        source.rule(curve.time_scale > 0.0, &key("time_scale"), curve.time_scale, "> 0")?;
        source.rule(curve.value_scale > 0.0, &key("value_scale"), curve.value_scale, "> 0")?;
        source.rule(!curve.points.is_empty(), &key("points"), "an empty list", "at least one pair [T, Z]")?;
        let bands = curve.spread.is_empty() || curve.spread.len() == curve.points.len();
        source.rule(
            bands,
            &key("spread"),
            format!("a list of {}", curve.spread.len()),
            format!("as many as points, {}", curve.points.len()),
        )?;
        for (n, &spread) in curve.spread.iter().enumerate() {
            source.rule(spread >= 0.0, &format!("{}[{n}]", key("spread")), spread, ">= 0")?;
        }
        if let Some(n) = curve.points.windows(2).position(|pair| pair[1][0] <= pair[0][0]) {
            let at = format!("{}[{}]", key("points"), n + 1);
            return Err(source.broken(&at, format!("{:?}", curve.points[n + 1]), "later than the point before it"));
        }
    }
    Ok(ComparePlan { methods, times, references: s.compare.reference.clone() })
}

/// Times from 0 to `end`, rising, each once.
fn sorted_times(times: &[f64], key: &str, end: f64, source: &Source) -> Result<Vec<f64>, CaseError> {
    for (i, &time) in times.iter().enumerate() {
        source.rule(time >= 0.0, &format!("{key}[{i}]"), time, ">= 0")?;
    }
    let mut times: Vec<f64> = times.iter().copied().filter(|&time| time <= end).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    Ok(times)
}

/// The interval between frames as written, or by default.
fn frame_interval(s: &Sections) -> Option<f64> {
    s.output.interval.or_else(|| s.output.times.is_empty().then_some(s.time.end / 50.0))
}

/// Columns of every frame besides the position: with the default ones a frame is a whole initial state. They hardly change, so
/// they take next to no room when compressed.
const ALWAYS_WRITTEN: [&str; 5] = ["id", "kind", "layer", "mass", "smoothing_length"];

fn output_plan(s: &Sections, compare: &ComparePlan, source: &Source) -> Result<OutputPlan, CaseError> {
    let end = s.time.end;
    let mut asked = sorted_times(&s.output.times, "output.times", end, source)?;
    asked.extend(compare.times.iter().copied().chain([0.0, end]));
    asked.sort_by(f64::total_cmp);
    asked.dedup();
    let mut frame_times = asked.clone();
    if let Some(interval) = frame_interval(s) {
        source.rule(interval >= 1e-5 * end, "output.interval", interval, format!(">= time.end / 100000, {} s", 1e-5 * end))?;
        // A multiple of the interval that rounding puts beside a time asked for is that time.
        let free = |time: f64| asked.iter().all(|other| (time - other).abs() > 1e-9 * end);
        frame_times.extend((1..).map(|k| f64::from(k) * interval).take_while(|&time| time < end).filter(|&time| free(time)));
        frame_times.sort_by(f64::total_cmp);
    }
    let table = field_table::<2>();
    let mut fields = Vec::new();
    for (i, name) in s.output.fields.iter().enumerate() {
        let key = format!("output.fields[{i}]");
        let Some(field) = table.iter().find(|field| field.name == name) else {
            let choices = Choices::new(name, table.iter().map(|field| field.name));
            return Err(CaseError::UnknownChoice { place: source.place(&key), key, value: name.clone(), choices });
        };
        source.rule(!fields.contains(&field.name), &key, format!("{name:?}"), "named once")?;
        fields.push(field.name);
    }
    for name in ALWAYS_WRITTEN {
        if !fields.contains(&name) {
            fields.push(name);
        }
    }
    let sample_interval = s.output.sample_interval.unwrap_or(1e-3 * end);
    source.rule(sample_interval >= 0.0, "output.sample_interval", sample_interval, ">= 0")?;
    let sensor_interval = s.output.sensor_interval.unwrap_or(sample_interval);
    source.rule(sensor_interval >= 0.0, "output.sensor_interval", sensor_interval, ">= 0")?;
    Ok(OutputPlan { frame_times, fields, precision: s.output.precision, sample_interval, sensor_interval })
}

/// Bytes of one particle in one frame before compression: three numbers for positions and vectors, one for the rest.
fn bytes_of_frame_row<const D: usize>(output: &OutputPlan) -> f64 {
    let numbers =
        3 + output.fields.iter().map(|field| if ["velocity", "acceleration", "position"].contains(field) { 3 } else { 1 }).sum::<usize>();
    numbers as f64 * if output.precision == Precision::Float64 { 8.0 } else { 4.0 }
}
