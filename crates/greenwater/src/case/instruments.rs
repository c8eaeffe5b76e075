//! What a case says of formulas, moving walls and instruments, checked.

use super::sections::{self, GaugeQuantity, Sections};
use super::setup::Bounds;
use super::shape::{AXES, vector};
use super::source::Source;
use super::wall_shape::Written;
use super::{CaseError, error::Choices};
use crate::formula::Formula;
use crate::math::Vector;
use crate::motion::Motion;
use crate::observe::{Gauge, GaugeKind, Load, Mount, Sensor, reach};
use crate::particles::{Kind, Particles};
use crate::scheme::Medium;

/// Reads the formula at `key`, of the variables `names`.
fn formula(written: &Written, names: &[&str], key: &str, source: &Source) -> Result<Formula, CaseError> {
    Formula::parse(&written.0, names).map_err(|e| source.broken(key, format!("{:?}", written.0), format!("a formula; {e}")))
}

/// Reads the formulas at `key`, one an axis.
fn formulas<const D: usize>(written: &[Written], names: &[&str], key: &str, source: &Source) -> Result<Vec<Formula>, CaseError> {
    let rule = format!("a list of {D} formulas, one an axis: `dimension` is {D}");
    source.rule(written.len() == D, key, format!("a list of {}", written.len()), rule)?;
    written.iter().enumerate().map(|(d, text)| formula(text, names, &format!("{key}[{d}]"), source)).collect()
}

/// Velocity and pressure of the fluid at the start, as formulas of the position.
pub(super) struct InitialFields {
    velocity: Option<Vec<Formula>>,
    pressure: Option<Formula>,
}

const POSITION: [&str; 3] = ["x", "y", "z"];

impl InitialFields {
    pub fn checked<const D: usize>(fluid: &sections::Fluid, source: &Source) -> Result<Self, CaseError> {
        for (key, given) in [("fluid.velocity", fluid.velocity.is_some()), ("fluid.pressure", fluid.pressure.is_some())] {
            let rule = "left out beside `fluid.from_file`, whose particles have their own";
            source.rule(!given || fluid.from_file.is_none(), key, "given", rule)?;
        }
        let velocity = fluid.velocity.as_ref().map(|v| formulas::<D>(v, &POSITION[..D], "fluid.velocity", source)).transpose()?;
        let pressure = fluid.pressure.as_ref().map(|p| formula(p, &POSITION[..D], "fluid.pressure", source)).transpose()?;
        Ok(Self { velocity, pressure })
    }

    /// Velocity at `x`, m/s, if there is a formula.
    pub fn velocity<const D: usize>(&self, x: Vector<D>, source: &Source) -> Result<Option<Vector<D>>, CaseError> {
        let Some(formulas) = &self.velocity else { return Ok(None) };
        let mut v = Vector::ZERO;
        for (d, formula) in formulas.iter().enumerate().take(D) {
            v[d] = finite(formula, x, &format!("fluid.velocity[{d}]"), source)?;
        }
        Ok(Some(v))
    }

    /// Pressure at `x`, Pa, if there is a formula.
    pub fn pressure<const D: usize>(&self, x: Vector<D>, source: &Source) -> Result<Option<f64>, CaseError> {
        self.pressure.as_ref().map(|formula| finite(formula, x, "fluid.pressure", source)).transpose()
    }
}

fn finite<const D: usize>(formula: &Formula, x: Vector<D>, key: &str, source: &Source) -> Result<f64, CaseError> {
    let value = formula.value(&x.0);
    let rule = "finite at every particle; guard divisions and roots, for example with max(x, 1e-9)";
    source.rule(value.is_finite(), key, format!("{value} at {:?} m", x.0), rule)?;
    Ok(value)
}

/// The walls that move. Bodies count from 1 in the order of `walls.shapes`.
pub(super) fn motions<const D: usize>(s: &Sections, source: &Source) -> Result<Vec<Motion<D>>, CaseError> {
    let mut motions = Vec::new();
    let count = s.walls.shapes.len();
    source.rule(count <= usize::from(u16::MAX), "walls.shapes", format!("a list of {count}"), format!("at most {} shapes", u16::MAX))?;
    for (i, wall) in s.walls.shapes.iter().enumerate() {
        let key = format!("walls.shapes[{i}]");
        if let Some(name) = &wall.name {
            let name_key = format!("{key}.name");
            plain_name(name, &name_key, source)?;
            let unique = s.walls.shapes[..i].iter().all(|other| other.name.as_ref() != Some(name));
            source.rule(unique, &name_key, format!("{name:?}"), "unique; another wall has this name")?;
        }
        let Some(written) = &wall.velocity else {
            source.rule(wall.moves.is_none(), &format!("{key}.moves"), "given", "left out without a `velocity`")?;
            continue;
        };
        let key = format!("{key}.velocity");
        let velocity = formulas::<D>(written, &["t"], &key, source)?;
        let motion = Motion { body: 1 + i as u16, velocity, moves: wall.moves.unwrap_or(true) };
        let rule = "finite from t = 0 to `time.end`; guard divisions and roots";
        source.rule(motion.fastest(s.time.end).is_finite(), &key, "not finite at some time", rule)?;
        motions.push(motion);
    }
    Ok(motions)
}

fn plain_name(name: &str, key: &str, source: &Source) -> Result<(), CaseError> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let named = !name.is_empty() && name.chars().all(plain);
    source.rule(named, key, format!("{name:?}"), "letters, digits, `.`, `_` and `-`")
}

/// Names of a list of instruments: plain, and each once.
fn check_names<'a>(list: &str, names: impl Iterator<Item = &'a String>, source: &Source) -> Result<(), CaseError> {
    let mut known: Vec<&String> = Vec::new();
    for (i, name) in names.enumerate() {
        let key = format!("{list}[{i}].name");
        plain_name(name, &key, source)?;
        source.rule(!known.contains(&name), &key, format!("{name:?}"), format!("unique; another {list} has this name"))?;
        source.rule(name != "time", &key, format!("{name:?}"), "another name; its table has a column `time` already")?;
        known.push(name);
    }
    Ok(())
}

/// A position at `key`, inside the domain.
fn position<const D: usize>(numbers: &[f64], key: &str, bounds: &Bounds<D>, source: &Source) -> Result<Vector<D>, CaseError> {
    let position: Vector<D> = vector(numbers, key, source)?;
    let within = (0..D).all(|d| (bounds.min[d]..=bounds.max[d]).contains(&position[d]));
    let rule = format!("inside the domain, {:?} to {:?} m", bounds.min.0, bounds.max.0);
    source.rule(within, key, format!("{:?}", position.0), rule)?;
    Ok(position)
}

/// The number, from 1, of the wall shape that the name at `key` means.
fn body(name: &str, key: &str, s: &Sections, source: &Source) -> Result<u16, CaseError> {
    let known = || s.walls.shapes.iter().zip(1..).filter_map(|(wall, body)| Some((wall.name.as_deref()?, body)));
    if let Some((_, body)) = known().find(|(known, _)| *known == name) {
        return Ok(body);
    }
    if known().next().is_none() {
        let rule = "the `name` of a wall shape; give the walls names: { name = \"gate\", box = { ... } }";
        return Err(source.broken(key, format!("{name:?}"), rule));
    }
    let choices = Choices::new(name, known().map(|(name, _)| name));
    Err(CaseError::UnknownChoice { place: source.place(key), key: key.to_owned(), value: name.to_owned(), choices })
}

/// What the wall named at `key`, if any, takes along.
fn mount<const D: usize>(
    name: Option<&str>,
    key: &str,
    s: &Sections,
    particles: &Particles<D>,
    source: &Source,
) -> Result<Option<Mount<D>>, CaseError> {
    let Some(wall) = name else { return Ok(None) };
    let body = body(wall, key, s, source)?;
    match (0..particles.owned()).find(|&a| particles.body[a] == body) {
        Some(a) => Ok(Some(Mount { wall: wall.to_owned(), id: particles.id[a], start: particles.x[a] })),
        None => Err(source.broken(key, format!("{wall:?}"), "the name of a wall at least a spacing thick; this one has no particle")),
    }
}

pub(super) fn sensors<const D: usize>(
    s: &Sections,
    bounds: &Bounds<D>,
    particles: &Particles<D>,
    medium: &Medium<D>,
    source: &Source,
) -> Result<Vec<Sensor<D>>, CaseError> {
    check_names("probe", s.probe.iter().map(|probe| &probe.name), source)?;
    let mut sensors = Vec::new();
    for (i, probe) in s.probe.iter().enumerate() {
        let key = |name: &str| format!("probe[{i}].{name}");
        let place = position(&probe.position, &key("position"), bounds, source)?;
        source.rule(probe.size >= 0.0, &key("size"), probe.size, ">= 0")?;
        let normal = match &probe.normal {
            Some(numbers) => {
                let normal: Vector<D> = vector(numbers, &key("normal"), source)?;
                let length = normal.norm();
                source.rule(length > 0.0, &key("normal"), format!("{numbers:?}"), "not zero")?;
                normal / length
            }
            None => {
                let rule = "given for a probe with a `size`: the direction in which the sensor faces, from the wall into the fluid";
                source.rule(probe.size == 0.0, &key("normal"), "left out", rule)?;
                Vector::ZERO
            }
        };
        let near = Near { bounds, particles, medium, source };
        near.check(place, "", &key("position"))?;
        if probe.size > 0.0 {
            let places = Sensor::<D>::places(probe.size, medium.spacing);
            let rule = format!("covered by at most {MOST_PLACES} places at half a spacing; here it takes {places:e}");
            source.rule(places <= MOST_PLACES, &key("size"), format!("{} m", probe.size), rule)?;
            for end in Sensor::rim(place, probe.size, normal) {
                near.check(end, &format!("{} m, with its rim at ", probe.size), &key("size"))?;
            }
        }
        let mount = mount(probe.on.as_deref(), &key("on"), s, particles, source)?;
        sensors.push(Sensor::new(probe.name.clone(), place, probe.size, normal, medium.spacing).in_box(bounds.periods()).on(mount));
    }
    Ok(sensors)
}

/// Places at which one instrument is evaluated, at the most: 24 MB of them.
const MOST_PLACES: f64 = 1e6;

/// What a probe has around it.
struct Near<'a, const D: usize> {
    bounds: &'a Bounds<D>,
    particles: &'a Particles<D>,
    medium: &'a Medium<D>,
    source: &'a Source,
}

impl<const D: usize> Near<'_, D> {
    /// The particle nearest to `x` of those that `count`, and how far it is, m.
    fn nearest(&self, x: Vector<D>, count: impl Fn(usize) -> bool) -> Option<(f64, usize)> {
        let distance = |a: usize| self.bounds.periods().nearest(self.particles.x[a] - x).norm();
        (0..self.particles.owned()).filter(|&a| count(a)).map(|a| (distance(a), a)).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// A probe at `x` sees something: the face of a wall, or fluid. What is said of it begins with `lead`.
    fn check(&self, x: Vector<D>, lead: &str, key: &str) -> Result<(), CaseError> {
        let (p, reach) = (self.particles, reach(self.medium));
        let is_face = |a: usize| p.kind[a] == Kind::Wall && p.layer[a] <= 1;
        let Some((away, a)) = self.nearest(x, |_| true) else { return Ok(()) };
        let inside = p.kind[a] == Kind::Wall && !is_face(a);
        if away <= reach && !inside {
            return Ok(());
        }
        let (place, kind) = (self.written(x), if p.kind[a] == Kind::Wall { "wall" } else { "fluid" });
        let value = if inside && away <= reach {
            format!("{place}, inside a wall")
        } else {
            format!("{place}, {away:.4} m from the nearest {kind} particle")
        };
        let cure = match self.nearest(x, is_face).or_else(|| self.nearest(x, |a| p.is_fluid(a))) {
            Some((_, a)) if p.is_fluid(a) => format!("; move it to the fluid, which is nearest at {} m", self.written(p.x[a])),
            Some((_, a)) => format!("; move it to the face of the wall, half a spacing before the particle at {} m", self.written(p.x[a])),
            None => String::new(),
        };
        let rule = format!("within {reach:.4} m of the face of a wall or of the fluid, or the probe will never feel anything{cure}");
        Err(self.source.broken(key, format!("{lead}{value}"), rule))
    }

    /// A position in metres, to a thousandth of a spacing.
    fn written(&self, x: Vector<D>) -> String {
        let digits = (3.0 - self.medium.spacing.log10().floor()).clamp(0.0, 17.0) as usize;
        format!("[{}]", x.0.map(|x| format!("{x:.digits$}")).join(", "))
    }
}

pub(super) fn gauges<const D: usize>(
    s: &Sections,
    bounds: &Bounds<D>,
    particles: &Particles<D>,
    dx: f64,
    source: &Source,
) -> Result<Vec<Gauge<D>>, CaseError> {
    check_names("gauge", s.gauge.iter().map(|gauge| &gauge.name), source)?;
    let mut gauges = Vec::new();
    for (i, gauge) in s.gauge.iter().enumerate() {
        let key = |name: &str| format!("gauge[{i}].{name}");
        let needed = |given: &Option<Vec<f64>>, name: &str, kind: &str| {
            let given = given.clone().ok_or_else(|| source.broken(&key(name), "left out", format!("given for a gauge of {kind}")))?;
            position(&given, &key(name), bounds, source)
        };
        let unused = |given: &Option<Vec<f64>>, name: &str, kind: &str| {
            source.rule(given.is_none(), &key(name), "given", format!("left out for a gauge of {kind}"))
        };
        // The point of a line along gravity.
        let upright = |kind: &str| {
            unused(&gauge.from, "from", kind)?;
            unused(&gauge.to, "to", kind)?;
            needed(&gauge.position, "position", kind)
        };
        let (name, periods) = (gauge.name.clone(), bounds.periods());
        let mount = mount(gauge.on.as_deref(), &key("on"), s, particles, source)?;
        gauges.push(match gauge.quantity {
            GaugeQuantity::Elevation => Gauge { name, kind: GaugeKind::Elevation(upright("elevation")?), periods, mount },
            GaugeQuantity::Depth => Gauge { name, kind: GaugeKind::Depth(upright("depth")?), periods, mount },
            GaugeQuantity::Flow => {
                unused(&gauge.position, "position", "flow")?;
                source.rule(mount.is_none(), &key("on"), "given", "left out for a gauge of flow")?;
                let (from, to) = (needed(&gauge.from, "from", "flow")?, needed(&gauge.to, "to", "flow")?);
                let span = to - from;
                let flat = (0..D).filter(|&d| span[d] == 0.0).count();
                let text = format!("{:?}", to.0);
                if D == 2 {
                    source.rule(span.norm() > 0.0, &key("to"), text, "another point than `from`")?;
                } else {
                    let rule = format!(
                        "equal to `from` along exactly one of {}, the axis across which flow is counted",
                        AXES.iter().collect::<String>()
                    );
                    source.rule(flat == 1, &key("to"), text, rule)?;
                }
                let places = Gauge::places(from, to, dx);
                let rule = format!(
                    "so near to `from` that at most {MOST_PLACES} places at half a spacing lie between them; here there are {places:e}"
                );
                source.rule(places <= MOST_PLACES, &key("to"), format!("{:?}", to.0), rule)?;
                Gauge::flow(name, (from, to), dx, periods)
            }
        });
    }
    Ok(gauges)
}

pub(super) fn loads<const D: usize>(s: &Sections, source: &Source) -> Result<Vec<Load<D>>, CaseError> {
    check_names("load", s.load.iter().map(|load| &load.name), source)?;
    let mut loads = Vec::new();
    for (i, load) in s.load.iter().enumerate() {
        let walls = load.walls.iter().enumerate();
        let bodies = walls.map(|(k, name)| body(name, &format!("load[{i}].walls[{k}]"), s, source)).collect::<Result<_, _>>()?;
        source.rule(!s.walls.shapes.is_empty(), &format!("load[{i}].walls"), "without walls", "in a case with `walls.shapes`")?;
        let about = load.about.as_ref().map_or(Ok(Vector::ZERO), |x| vector(x, &format!("load[{i}].about"), source))?;
        loads.push(Load { name: load.name.clone(), bodies, about });
    }
    Ok(loads)
}
