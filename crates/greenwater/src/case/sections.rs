//! What a case may say. These doc comments, units and rules are the reference of the format: [`super::reference`] reads them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::shape::Shape;
use super::wall_shape::{WallShape, Written};
use crate::kernel::KernelName;
use crate::scheme::{MethodName, Preset};

/// A case as written: every section and key of `case.toml`. All numbers are in SI units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sections {
    /// Version of the case format.
    #[schemars(extend("rule" = "1"))]
    pub format: u32,
    /// One line that names the case in reports.
    pub title: String,
    /// Number of dimensions. In 2D everything is per metre of depth.
    #[schemars(extend("rule" = "2 or 3"))]
    pub dimension: u32,
    /// The liquid and where it is at the start.
    pub fluid: Fluid,
    /// Walls, at rest or moved as told.
    #[serde(default)]
    pub walls: Walls,
    /// The method that moves the particles.
    #[serde(default)]
    pub method: Method,
    /// The smoothing kernel.
    #[serde(default)]
    pub kernel: Kernel,
    /// How long, and in what steps.
    pub time: Time,
    /// Gravity.
    #[serde(default)]
    pub gravity: Gravity,
    /// The region that counts.
    #[serde(default)]
    pub domain: Domain,
    /// Sensors that record the pressure.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub probe: Vec<Probe>,
    /// Lines along which the water level or the flow is recorded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gauge: Vec<Gauge>,
    /// Walls on which force and moment are recorded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub load: Vec<Load>,
    /// What is written, and when.
    #[serde(default)]
    pub output: Output,
    /// What the run may use at most.
    #[serde(default)]
    pub limits: Limits,
    /// What `greenwater compare` runs and plots.
    #[serde(default)]
    pub compare: Compare,
}

/// The liquid and where it is at the start: `shapes` or `from_file`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fluid {
    /// Distance between particles at the start. The sides of every box and tank must be whole multiples of it.
    #[schemars(extend("unit" = "m", "rule" = "> 0"))]
    pub spacing: f64,
    /// Density at rest.
    #[serde(default = "water_density")]
    #[schemars(extend("unit" = "kg/m3", "rule" = "> 0"))]
    pub density: f64,
    /// Dynamic viscosity.
    #[serde(default = "water_viscosity")]
    #[schemars(extend("unit" = "Pa s", "rule" = ">= 0"))]
    pub viscosity: f64,
    /// Pressure of the fluid at t = 0; a method may compute its own instead.
    #[serde(default)]
    pub initial_pressure: InitialPressure,
    /// Pressure of the fluid at t = 0 as a formula of the position, instead of `initial_pressure`: `"1000*9.81*(1 - y)"`. Formulas
    /// know `+ - * / ^`, `pi` and the functions sqrt, exp, ln, sin, cos, tan, asin, acos, atan, sinh, cosh, tanh, sech, abs, floor,
    /// round, sign, step (1 above 0, else 0), min, max, atan2 and hypot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>", extend("kind" = "formula", "unit" = "Pa", "rule" = "of x, y (and z) in m"))]
    pub pressure: Option<Written>,
    /// Velocity of the fluid at t = 0 as formulas of the position, one an axis: `["-y", "x"]`; left out: at rest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Vec<String>>", extend("kind" = "list of formulas", "unit" = "m/s", "rule" = "of x, y (and z) in m"))]
    pub velocity: Option<Vec<Written>>,
    /// Regions filled with fluid.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shapes: Vec<Shape>,
    /// How particles fill the shapes.
    #[serde(default)]
    pub arrangement: Arrangement,
    /// A table of particles, in the folder of the case, instead of `shapes`: CSV with the columns
    /// `id,kind,x,y[,z],vx,vy[,vz],density,pressure,mass,h` and, if wanted, `layer`; kind is fluid or wall.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_file: Option<String>,
}

/// How particles fill a shape.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Arrangement {
    /// At the centres of cells of one spacing: curved and oblique boundaries have steps.
    #[default]
    Lattice,
    /// Evenly spread in each shape, in rows along its boundary (Colagrossi et al. 2012); together they have the volume of the shape.
    Packed,
}

/// Pressure of the fluid at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum InitialPressure {
    /// `p = ρ0 g d` at the depth `d` below the highest point of the fluid.
    #[default]
    Hydrostatic,
    /// `p = 0` everywhere.
    Zero,
}

/// Walls, made of particles, at rest or moved as told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Walls {
    /// Lines of particles that make a tank.
    #[schemars(extend("rule" = "1 to 32"))]
    pub layers: u32,
    /// How particles fill solid obstacles; tanks are lines along their sides anyway.
    pub arrangement: Arrangement,
    /// Tanks and solid obstacles. Beside its shape each may have a `name` for loads, and `velocity` and `moves` if it moves:
    /// `{ name = "lid", velocity = ["1", "0"], moves = false, box = { ... } }`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shapes: Vec<WallShape>,
}

impl Default for Walls {
    fn default() -> Self {
        Self { layers: 3, arrangement: Arrangement::Lattice, shapes: Vec::new() }
    }
}

/// The method that moves the particles, and its own keys (see `greenwater methods`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Method {
    /// Name of the method.
    #[serde(default = "default_method")]
    #[schemars(with = "String", extend("rule" = "a name that `greenwater methods` lists"))]
    pub name: MethodName,
    /// Where the defaults of the method's keys come from: `water` runs a whole dam break, `paper` is as printed.
    #[serde(default)]
    #[schemars(with = "String", extend("rule" = "\"water\" or \"paper\""))]
    pub preset: Preset,
    /// The method's own keys, as written.
    #[serde(flatten)]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub keys: toml::Table,
}

impl Default for Method {
    fn default() -> Self {
        Self { name: default_method(), preset: Preset::default(), keys: toml::Table::new() }
    }
}

/// The smoothing kernel. What is left out is the method's own choice (see `greenwater methods`).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Kernel {
    /// Name of the kernel.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>", extend("rule" = "a name that `greenwater kernels` lists"))]
    pub name: Option<KernelName>,
    /// Smoothing length over spacing; where only the kernel is named: the method's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("rule" = "0.5 to 5"))]
    pub h_over_spacing: Option<f64>,
}

/// How long, and in what steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// End of the run.
    #[schemars(extend("unit" = "s", "rule" = "> 0"))]
    pub end: f64,
    /// Share of the stability limit that a step takes.
    #[serde(default = "default_courant")]
    #[schemars(extend("rule" = "> 0 and <= 1"))]
    pub courant: f64,
    /// A fixed time step instead of the one that `courant` gives.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "s", "rule" = "> 0"))]
    pub step: Option<f64>,
    /// Stop after this many steps even if `end` is not reached; 0 writes the initial state only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_steps: Option<u64>,
}

/// Gravity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Gravity {
    /// Acceleration of gravity, one number an axis; left out: 9.81 against the last axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m/s2"))]
    pub acceleration: Option<Vec<f64>>,
}

/// The region that counts. A particle outside a bound that is not periodic is lost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Domain {
    /// Axes (`"x"`, `"y"`, `"z"`) along which the region repeats; these need `min` and `max`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub periodic: Vec<String>,
    /// Lower corner; left out: as far beyond fluid and walls as they are large together, ten times as far along gravity's opposite, and as much farther as walls go if that is more than half of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m"))]
    pub min: Option<Vec<f64>>,
    /// Upper corner; left out: as `min`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m"))]
    pub max: Option<Vec<f64>>,
}

/// A sensor that records the pressure on a wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Probe {
    /// Its name in tables and reports.
    #[schemars(extend("rule" = "letters, digits, `.`, `_`, `-`; unique"))]
    pub name: String,
    /// Where its middle is, one number an axis.
    #[schemars(extend("unit" = "m", "rule" = "inside the domain, in reach of a wall or of the fluid"))]
    pub position: Vec<f64>,
    /// Width of the sensor: a strip in 2D, the diameter of a disc in 3D. The pressure is averaged over it; 0: a point.
    #[serde(default)]
    #[schemars(extend("unit" = "m", "rule" = ">= 0"))]
    pub size: f64,
    /// Direction in which the sensor faces; needed if it has a `size`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("rule" = "not zero"))]
    pub normal: Option<Vec<f64>>,
    /// Name of a wall that it goes along with; left out: it stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("rule" = "a name of `walls.shapes`"))]
    pub on: Option<String>,
}

/// A line along which the water level or the flow is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Gauge {
    /// Its name in tables and reports.
    #[schemars(extend("rule" = "letters, digits, `.`, `_`, `-`; unique"))]
    pub name: String,
    /// What it records: how high or how deep the water is on the line through `position` along gravity, or the flow through the line (in 3D the
    /// rectangle) from `from` to `to`.
    pub quantity: GaugeQuantity,
    /// A point of the line of a gauge of elevation or depth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m", "rule" = "inside the domain"))]
    pub position: Option<Vec<f64>>,
    /// One end of the line of a flow gauge; in 3D a corner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m"))]
    pub from: Option<Vec<f64>>,
    /// The other end; in 3D the opposite corner, equal to `from` along the one axis across which the flow is counted. Flow is
    /// positive along that axis; in 2D to the right of someone who walks from `from` to `to`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m", "rule" = "another point than `from`"))]
    pub to: Option<Vec<f64>>,
    /// Name of a wall that a gauge of elevation or depth goes along with; left out: it stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("rule" = "a name of `walls.shapes`"))]
    pub on: Option<String>,
}

/// What a gauge records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GaugeQuantity {
    /// Height of the highest water above the lowest fluid at the start, m; 0 where dry. Spray counts.
    Elevation,
    /// Length of the line that is under water, m, as a wire probe tells it: drops count with their own size only.
    Depth,
    /// Volume that passes in a second, m³/s (m²/s in 2D).
    Flow,
}

/// Walls on which force and moment are recorded: all that the fluid gives them, averaged from row to row of the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// Its name in tables and reports.
    #[schemars(extend("rule" = "letters, digits, `.`, `_`, `-`; unique"))]
    pub name: String,
    /// Names of the walls that count together; left out: all walls.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(extend("rule" = "names of `walls.shapes`"))]
    pub walls: Vec<String>,
    /// Point about which the moment is taken; left out: the origin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "m"))]
    pub about: Option<Vec<f64>>,
}

/// What is written, and when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Time between frames; left out: a fiftieth of the run, or only `times` if those are given. The start and the end
    /// are always written.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "s", "rule" = ">= time.end / 100000"))]
    pub interval: Option<f64>,
    /// Times of further frames. Those after `time.end` are left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(extend("unit" = "s", "rule" = ">= 0"))]
    pub times: Vec<f64>,
    /// Columns of a frame besides the position and `id`, `kind`, `layer`, `mass`, `smoothing_length`, which every frame has.
    #[schemars(extend("rule" = "names of the field table"))]
    pub fields: Vec<String>,
    /// Number format of frames.
    pub precision: Precision,
    /// Time between rows of the tables of energies and fronts; 0: every step; left out: a thousandth of the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "s", "rule" = ">= 0"))]
    pub sample_interval: Option<f64>,
    /// Time between rows of the tables of probes, gauges and loads; 0: every step; left out: `sample_interval`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "s", "rule" = ">= 0"))]
    pub sensor_interval: Option<f64>,
}

impl Default for Output {
    fn default() -> Self {
        Self {
            interval: None,
            times: Vec::new(),
            fields: ["velocity", "density", "pressure", "kind", "id"].map(String::from).to_vec(),
            precision: Precision::default(),
            sample_interval: None,
            sensor_interval: None,
        }
    }
}

/// Number format of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// 8 bytes a number: what the solver has.
    #[default]
    Float64,
    /// 4 bytes a number: half the disk, for pictures.
    Float32,
}

/// What the run may use at most. A case that needs more is refused before anything is allocated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Memory; left out: three quarters of what this machine has.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "GiB", "rule" = "> 0"))]
    pub memory_gib: Option<f64>,
    /// Number of particles, walls included.
    #[schemars(extend("rule" = "1 to 4000000000"))]
    pub particles: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { memory_gib: None, particles: 200_000_000 }
    }
}

/// What `greenwater compare` runs and plots.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Compare {
    /// Methods, each `name` or `name:preset`. The keys of `[method]` hold for the method named there.
    #[schemars(extend("rule" = "not empty, no method twice"))]
    pub methods: Vec<String>,
    /// Times of the pictures side by side; left out: `output.times`, or else five even steps. Those after `time.end` are
    /// left out. A frame is written at each of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("unit" = "s", "rule" = ">= 0"))]
    pub times: Option<Vec<f64>>,
    /// Measured or computed curves to plot beside the results.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub reference: Vec<Reference>,
}

impl Default for Compare {
    fn default() -> Self {
        Self { methods: ["wcsph", "isph-paper", "delta-sph", "isph"].map(String::from).to_vec(), times: None, reference: Vec::new() }
    }
}

/// A curve to compare with, in its own scaled variables `T = t * time_scale`, `Z = value * value_scale`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Its name in the legend.
    pub name: String,
    /// What was measured.
    #[schemars(extend("rule" = "\"front\", \"residual_height\", \"probe:NAME\", \"gauge:NAME\" or \"load:NAME.fx\""))]
    pub quantity: String,
    /// Where the values come from.
    pub source: String,
    /// Scaled time over time.
    #[schemars(extend("unit" = "1/s", "rule" = "> 0"))]
    pub time_scale: f64,
    /// Scaled value over value: 1/m for lengths, 1/Pa for pressures.
    #[schemars(extend("unit" = "1/m or 1/Pa", "rule" = "> 0"))]
    pub value_scale: f64,
    /// Label of the time axis.
    pub time_label: String,
    /// Label of the value axis.
    pub value_label: String,
    /// The curve: pairs `[T, Z]`, T rising.
    #[schemars(extend("rule" = "at least one, T rising"))]
    pub points: Vec<[f64; 2]>,
    /// How far repeated measurements lie to either side of each point, in units of Z: drawn as a band.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(extend("rule" = "as many as points, each >= 0"))]
    pub spread: Vec<f64>,
}

fn water_density() -> f64 {
    1000.0
}

fn water_viscosity() -> f64 {
    1e-3
}

fn default_courant() -> f64 {
    0.25
}

fn default_method() -> MethodName {
    MethodName::DeltaSph
}
