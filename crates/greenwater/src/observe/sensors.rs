//! Instruments inside the run: pressure sensors on walls, water levels, flow through lines, force and moment on walls.

use crate::domain::Periods;
use crate::kernel::{Kernel, WendlandC2};
use crate::math::Vector;
use crate::particles::{Kind, Particles};
use crate::scheme::Medium;

/// Smoothing length of every instrument, in spacings: that of the measured pressure noise and volume.
const SMOOTHING: f64 = 1.3;

/// Reach of an instrument, m: particles farther away do not count.
pub fn reach<const D: usize>(medium: &Medium<D>) -> f64 {
    Kernel::<D>::radius(WendlandC2) * SMOOTHING * medium.spacing
}

/// Volume that particle `a` stands for, seen from `away` (m): its share of the space there, `V W`. Fluid counts with `m/ρ0`: a density
/// summed over neighbours is too low at a surface, and water would stand too high. Walls count with the volume of a cell.
fn share<const D: usize>(p: &Particles<D>, medium: &Medium<D>, a: usize, away: Vector<D>) -> f64 {
    let volume = if p.is_fluid(a) { p.mass[a] / medium.rest_density } else { medium.spacing_volume() };
    volume * Kernel::<D>::w(WendlandC2, away.norm(), SMOOTHING * medium.spacing)
}

/// The wall that an instrument goes along with.
#[derive(Clone, Debug, PartialEq)]
pub struct Mount<const D: usize> {
    /// Name of the wall.
    pub wall: String,
    /// [`Particles::id`] of one of its particles: all of them go the same way.
    pub id: u32,
    /// Where that particle is at the start, m.
    pub start: Vector<D>,
}

impl<const D: usize> Mount<D> {
    /// How far the wall has gone since the start, m; in a box that repeats, to the nearest image.
    fn shift(mount: Option<&Self>, p: &Particles<D>, periods: Periods<D>) -> Vector<D> {
        let gone = |mount: &Self| (0..p.owned()).find(|&a| p.id[a] == mount.id).map(|a| periods.nearest(p.x[a] - mount.start));
        mount.and_then(gone).unwrap_or(Vector::ZERO)
    }
}

/// A sensor of finite size on a wall, that tells the pressure.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor<const D: usize> {
    /// Its name in tables and reports.
    pub name: String,
    /// Its middle at the start, m.
    pub position: Vector<D>,
    /// Width of the strip (2D) or diameter of the disc (3D), m; 0: a point.
    pub size: f64,
    /// The wall it goes along with, if any.
    pub mount: Option<Mount<D>>,
    /// Where the pressure is evaluated, at the start, m: every half spacing over the sensor, at least its middle.
    points: Vec<Vector<D>>,
    /// The least pressure that reaches it, Pa.
    least: f64,
    periods: Periods<D>,
}

impl<const D: usize> Sensor<D> {
    /// A sensor around `position`, facing along the unit vector `normal`, m. Without a size the normal does not matter.
    pub fn new(name: String, position: Vector<D>, size: f64, normal: Vector<D>, spacing: f64) -> Self {
        let points = disc(size, spacing).into_iter().map(|[s, t]| {
            let (first, second) = across(normal);
            position + s * first + t * second
        });
        let points = if size > 0.0 {
            if D == 2 { strip(size, spacing).into_iter().map(|s| position + s * across(normal).0).collect() } else { points.collect() }
        } else {
            vec![position]
        };
        Self { name, position, size, mount: None, points, least: f64::NEG_INFINITY, periods: Periods::NONE }
    }

    /// The same sensor in a box that repeats: it feels images as well.
    pub fn in_box(self, periods: Periods<D>) -> Self {
        Self { periods, ..self }
    }

    /// The same sensor on a wall that moves.
    pub fn on(self, mount: Option<Mount<D>>) -> Self {
        Self { mount, ..self }
    }

    /// The places of its rim, m, that lie farthest from each other: two in 2D, four in 3D.
    pub fn rim(position: Vector<D>, size: f64, normal: Vector<D>) -> Vec<Vector<D>> {
        let (first, second) = across(normal);
        let ways = [first, -first, second, -second];
        ways[..2 * (D - 1)].iter().map(|&way| position + 0.5 * size * way).collect()
    }

    /// How many places a sensor of so many metres is evaluated at, as a bound.
    pub fn places(size: f64, spacing: f64) -> f64 {
        (1..D).map(|_| pieces(size, spacing)).product()
    }

    /// The same sensor on a wall that cannot hold fluid back: it feels no pressure below zero, as the loads on that wall do not.
    pub fn without_suction(self) -> Self {
        Self { least: 0.0, ..self }
    }

    /// Mean pressure over the sensor, Pa. At each of its points `y`:
    ///
    /// the value there of the plane fitted to `p_j + ρ0 g·(y − x_j)` (the pressure of neighbour `j` moved to the height of the
    /// point) by least squares with the weights `V W` of a Wendland C2 kernel of 1.3 spacings, so that a linear pressure is told
    /// exactly; with fewer than `2 (D + 1)` neighbours, or where they do not span a plane, their weighted mean (Shepard).
    /// Both times `min(1, Σ V W / 0.25)`: half of what a point on a wet wall sees, so that a point that falls dry does so evenly.
    pub fn pressure(&self, p: &Particles<D>, medium: &Medium<D>) -> f64 {
        let reach = reach(medium);
        let around = reach + 0.5 * self.size;
        let shift = Mount::shift(self.mount.as_ref(), p, self.periods);
        let middle = self.position + shift;
        let near: Vec<usize> =
            (0..p.owned()).filter(|&a| p.is_fluid(a) && self.periods.nearest(p.x[a] - middle).norm_squared() < around * around).collect();
        let sum: f64 = self.points.iter().map(|&y| self.pressure_at(p, medium, &near, y + shift, reach)).sum();
        sum / self.points.len() as f64
    }

    fn pressure_at(&self, p: &Particles<D>, medium: &Medium<D>, near: &[usize], y: Vector<D>, reach: f64) -> f64 {
        let order = D + 1;
        let mut matrix = [[0.0; 5]; 4];
        let (mut count, mut weight, mut total) = (0, 0.0, 0.0);
        for &a in near {
            let away = self.periods.nearest(p.x[a] - y);
            if away.norm_squared() >= reach * reach {
                continue;
            }
            let w = share(p, medium, a, away);
            let value = p.pressure[a].max(self.least) - medium.rest_density * medium.gravity.dot(away);
            count += 1;
            weight += w;
            total += w * value;
            let mut row = [0.0; 5];
            row[0] = 1.0;
            for d in 0..D {
                row[1 + d] = away[d] / medium.spacing;
            }
            row[order] = value;
            for i in 0..order {
                for j in 0..=order {
                    matrix[i][j] += w * row[i] * row[j];
                }
            }
        }
        if weight == 0.0 {
            return 0.0;
        }
        let plane = if count >= 2 * order { super::solve_small(&mut matrix, order) } else { None };
        let wet = (weight / 0.25).min(1.0);
        (wet * plane.map_or(total / weight, |plane| plane[0])).max(self.least)
    }
}

/// Places along a strip, m from its middle: the middles of pieces of at most half a spacing.
fn strip(size: f64, spacing: f64) -> Vec<f64> {
    let pieces = pieces(size, spacing);
    (0..pieces as usize).map(|i| size * ((i as f64 + 0.5) / pieces - 0.5)).collect()
}

/// Number of pieces of at most half a spacing.
fn pieces(size: f64, spacing: f64) -> f64 {
    (size / (0.5 * spacing)).ceil().max(1.0)
}

/// Places on a disc, m from its middle: a square grid of pieces of at most half a spacing, cut round.
fn disc(size: f64, spacing: f64) -> Vec<[f64; 2]> {
    let line = strip(size, spacing);
    let all = line.iter().flat_map(|&s| line.iter().map(move |&t| [s, t]));
    let inside: Vec<[f64; 2]> = all.filter(|[s, t]| s * s + t * t <= 0.25 * size * size).collect();
    if inside.is_empty() { vec![[0.0, 0.0]] } else { inside }
}

/// Two unit vectors across `normal` and each other; in 2D the second is zero.
fn across<const D: usize>(normal: Vector<D>) -> (Vector<D>, Vector<D>) {
    if D == 2 {
        let mut first = Vector::ZERO;
        (first[0], first[1]) = (-normal[1], normal[0]);
        return (first, Vector::ZERO);
    }
    // The axis most across the normal, made perpendicular to it.
    let axis = (0..D).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
    let first = Vector::unit(axis) - normal[axis] * normal;
    let first = first / first.norm();
    let mut second = Vector::ZERO;
    for d in 0..D {
        let (i, j) = ((d + 1) % D, (d + 2) % D);
        second[d] = normal[i] * first[j] - normal[j] * first[i];
    }
    (first, second)
}

/// A line that tells how high the water stands on it, or how much passes through it.
#[derive(Clone, Debug, PartialEq)]
pub struct Gauge<const D: usize> {
    /// Its name in tables and reports.
    pub name: String,
    /// What it tells.
    pub kind: GaugeKind<D>,
    /// What repeats of the box it stands in: images of particles count.
    pub periods: Periods<D>,
    /// The wall that a gauge of elevation or depth goes along with, if any.
    pub mount: Option<Mount<D>>,
}

/// What a [`Gauge`] tells.
#[derive(Clone, Debug, PartialEq)]
pub enum GaugeKind<const D: usize> {
    /// Height of the highest water on the line through this point (at the start, m) along gravity, above the lowest fluid at the start, m.
    Elevation(Vector<D>),
    /// Length of the line through this point (at the start, m) along gravity that is under water, m: what a wire probe tells. Drops in the air
    /// above count with their own size only.
    Depth(Vector<D>),
    /// Flow through a line or rectangle, m³/s (m²/s in 2D).
    Flow {
        /// Where the velocity is evaluated, m: the middles of pieces of at most half a spacing.
        points: Vec<Vector<D>>,
        /// Direction in which the flow counts.
        normal: Vector<D>,
        /// Length or area of one piece, m or m².
        piece: f64,
    },
}

impl<const D: usize> Gauge<D> {
    /// A gauge of the flow from the line `from`–`to` (2D: any line; 3D: a rectangle with corners there, flat along one axis).
    pub fn flow(name: String, (from, to): (Vector<D>, Vector<D>), spacing: f64, periods: Periods<D>) -> Self {
        let span = to - from;
        let flat = if D == 2 { D } else { (0..D).find(|&d| span[d] == 0.0).unwrap_or(D - 1) };
        let (mut points, mut piece) = (vec![0.5 * (from + to)], 1.0);
        let mut normal = Vector::ZERO;
        if D == 2 {
            let length = span.norm();
            (normal[0], normal[1]) = (span[1] / length, -span[0] / length);
            let places = strip(length, spacing);
            piece = length / places.len() as f64;
            points = places.into_iter().map(|s| 0.5 * (from + to) + s / length * span).collect();
        } else {
            normal[flat] = 1.0;
            for d in (0..D).filter(|&d| d != flat) {
                let places = strip(span[d].abs(), spacing);
                piece *= span[d].abs() / places.len() as f64;
                points = points.iter().flat_map(|&x| places.iter().map(move |&s| x + s * Vector::unit(d))).collect();
            }
        }
        Self { name, kind: GaugeKind::Flow { points, normal, piece }, periods, mount: None }
    }

    /// How many places a gauge of the flow from `from` to `to` (m) is evaluated at.
    pub fn places(from: Vector<D>, to: Vector<D>, spacing: f64) -> f64 {
        let span = to - from;
        if D == 2 { pieces(span.norm(), spacing) } else { (0..D).map(|d| pieces(span[d].abs(), spacing)).product() }
    }

    /// What it tells now, in the unit of its kind.
    pub fn value(&self, p: &Particles<D>, medium: &Medium<D>) -> f64 {
        let column = |start: Vector<D>| {
            let point = start + Mount::shift(self.mount.as_ref(), p, self.periods);
            Column::of(p, medium, point, self.periods)
        };
        match &self.kind {
            GaugeKind::Elevation(start) => column(*start).elevation(),
            GaugeKind::Depth(start) => column(*start).depth(),
            GaugeKind::Flow { points, normal, piece } => flow(p, medium, points, *normal, self.periods) * piece,
        }
    }
}

/// Unit of what a gauge tells.
pub fn gauge_unit<const D: usize>(kind: &GaugeKind<D>) -> &'static str {
    match kind {
        GaugeKind::Elevation(_) | GaugeKind::Depth(_) => "m",
        GaugeKind::Flow { .. } if D == 2 => "m2/s",
        GaugeKind::Flow { .. } => "m3/s",
    }
}

/// The particles around a line along gravity.
struct Column<'a, const D: usize> {
    p: &'a Particles<D>,
    medium: &'a Medium<D>,
    /// Those within reach of the line.
    near: Vec<usize>,
    /// The point of the line at the height zero: the floor, m.
    foot: Vector<D>,
    up: Vector<D>,
    /// Height of the highest fluid particle, m; minus infinity without one.
    top: f64,
    periods: Periods<D>,
}

impl<'a, const D: usize> Column<'a, D> {
    /// Around the line through `point`, m.
    fn of(p: &'a Particles<D>, medium: &'a Medium<D>, point: Vector<D>, periods: Periods<D>) -> Self {
        let up = if medium.g() > 0.0 { -medium.gravity / medium.g() } else { Vector::unit(D - 1) };
        let height = |x: Vector<D>| x.dot(up) - medium.floor;
        let reach = reach(medium);
        let across = |away: Vector<D>| away - away.dot(up) * up;
        let near: Vec<usize> = (0..p.owned())
            .filter(|&a| p.kind[a] != Kind::Lost && across(periods.nearest(p.x[a] - point)).norm_squared() < reach * reach)
            .collect();
        let top = near.iter().filter(|&&a| p.is_fluid(a)).map(|&a| height(p.x[a])).fold(f64::NEG_INFINITY, f64::max);
        Self { p, medium, near, foot: point - height(point) * up, up, top, periods }
    }

    /// Highest point where fluid fills half of the space that walls leave, m above the floor; 0 if there is none. A lone particle fills
    /// a third and does not count.
    fn elevation(&self) -> f64 {
        // Down from where no fluid reaches, in quarters of a spacing; the surface lies between two of them.
        let step = 0.25 * self.medium.spacing;
        let (mut above, mut emptiness) = (self.top + reach(self.medium), -0.5);
        while above > 0.0 {
            let below = above - step;
            let fill = self.filled(below) - 0.5;
            if fill >= 0.0 {
                return (below + step * fill / (fill - emptiness)).max(0.0);
            }
            (above, emptiness) = (below, fill);
        }
        0.0
    }

    /// The share of the space that fluid fills, at most all of it, along the line from the floor upwards, m.
    fn depth(&self) -> f64 {
        let top = self.top + reach(self.medium);
        if top <= 0.0 {
            return 0.0;
        }
        let pieces = (top / (0.25 * self.medium.spacing)).ceil();
        let piece = top / pieces;
        (0..pieces as usize).map(|i| piece * self.filled((i as f64 + 0.5) * piece).min(1.0)).sum()
    }

    /// Share of the space at the height `at` (m) that fluid fills, of what walls leave; 0 inside walls.
    fn filled(&self, at: f64) -> f64 {
        let (x, reach) = (self.foot + at * self.up, reach(self.medium));
        let mut around = Around::default();
        for &a in &self.near {
            let away = self.periods.nearest(self.p.x[a] - x);
            if away.norm_squared() < reach * reach {
                let share = share(self.p, self.medium, a, away);
                around.add(self.p.is_fluid(a), share, share, away.norm_squared());
            }
        }
        around.of_what_walls_leave()
    }
}

/// What a point sees of fluid and walls.
struct Around {
    fluid: f64,
    wall: f64,
    /// Squares of the distances of the nearest of both, m².
    fluid_at: f64,
    wall_at: f64,
}

impl Default for Around {
    fn default() -> Self {
        Self { fluid: 0.0, wall: 0.0, fluid_at: f64::INFINITY, wall_at: f64::INFINITY }
    }
}

impl Around {
    /// Adds a neighbour that fills `share` of the space; one of the fluid counts with `weight`.
    fn add(&mut self, is_fluid: bool, share: f64, weight: f64, away: f64) {
        if is_fluid {
            self.fluid += weight;
            self.fluid_at = self.fluid_at.min(away);
        } else {
            self.wall += share;
            self.wall_at = self.wall_at.min(away);
        }
    }

    /// The sum over fluid, of the space that walls leave; 0 inside walls. Behind a flat wall walls fill more than half of the space; in a corner they
    /// fill three quarters (seven eighths in 3D), but there fluid is nearer.
    fn of_what_walls_leave(self) -> f64 {
        let inside_wall = self.wall > 0.5 && self.wall_at < self.fluid_at || self.wall > 0.9;
        if inside_wall { 0.0 } else { self.fluid / (1.0 - self.wall) }
    }
}

/// `Σ_points Σ_j V_j (v_j·n) W / (1 − Σ_wall V W)`, m/s: the velocity, zero where there is no fluid, summed over the points.
fn flow<const D: usize>(p: &Particles<D>, medium: &Medium<D>, points: &[Vector<D>], normal: Vector<D>, periods: Periods<D>) -> f64 {
    let reach = reach(medium);
    // First and last are opposite ends: no image farther from the first than the last counts anywhere.
    let around = (points[points.len() - 1] - points[0]).norm() + reach;
    let is_near = |x: Vector<D>| {
        let away = x - points[0];
        if periods == Periods::NONE { away.dot(normal).abs() < reach } else { periods.nearest(away).norm() < around }
    };
    let near: Vec<usize> = (0..p.owned()).filter(|&a| p.kind[a] != Kind::Lost && is_near(p.x[a])).collect();
    let through = |&x: &Vector<D>| {
        let mut around = Around::default();
        for &a in &near {
            let away = periods.nearest(p.x[a] - x);
            if away.norm_squared() >= reach * reach {
                continue;
            }
            let share = share(p, medium, a, away);
            around.add(p.is_fluid(a), share, share * p.v[a].dot(normal), away.norm_squared());
        }
        around.of_what_walls_leave()
    };
    points.iter().map(through).sum()
}

/// Walls whose loads count together.
#[derive(Clone, Debug, PartialEq)]
pub struct Load<const D: usize> {
    /// Its name in tables and reports.
    pub name: String,
    /// Numbers of the wall shapes, from 1 ([`Particles::body`]); empty: all walls.
    pub bodies: Vec<u16>,
    /// Point about which the moment is taken, m.
    pub about: Vector<D>,
}

/// Force (N) and moment (N m) of the fluid on walls; per metre of depth in 2D, where the moment has one component, the last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench<const D: usize> {
    /// Force.
    pub force: Vector<D>,
    /// Moment about the x, y and z axis; counter-clockwise in 2D.
    pub moment: [f64; 3],
}

impl<const D: usize> Load<D> {
    /// Names and units of the columns that a load has in its table: the force, then the moment.
    pub fn columns(&self) -> Vec<String> {
        let (force, moment) = if D == 2 { ("N/m", "N") } else { ("N", "N m") };
        let mut columns: Vec<String> = ["x", "y", "z"][..D].iter().map(|axis| format!("{}.f{axis} [{force}]", self.name)).collect();
        let axes: &[&str] = if D == 2 { &["z"] } else { &["x", "y", "z"] };
        columns.extend(axes.iter().map(|axis| format!("{}.m{axis} [{moment}]", self.name)));
        columns
    }

    /// What the fluid gives the walls, mean over the last step: the sum of the column `force`, `M = Σ (x − about) × f`.
    pub fn wrench(&self, p: &Particles<D>) -> Wrench<D> {
        let mut sum = Wrench::default();
        for a in 0..p.owned() {
            if p.kind[a] != Kind::Wall || !(self.bodies.is_empty() || self.bodies.contains(&p.body[a])) {
                continue;
            }
            let (f, arm) = (p.force[a], p.x[a] - self.about);
            sum.force += f;
            let (f, arm) = (three(f), three(arm));
            for d in 0..3 {
                let (i, j) = ((d + 1) % 3, (d + 2) % 3);
                sum.moment[d] += arm[i] * f[j] - arm[j] * f[i];
            }
        }
        sum
    }
}

fn three<const D: usize>(v: Vector<D>) -> [f64; 3] {
    std::array::from_fn(|d| if d < D { v[d] } else { 0.0 })
}

/// The mean of a load over the steps since it was last asked for.
#[derive(Clone, Debug)]
pub struct LoadMean<const D: usize> {
    impulse: Wrench<D>,
    time: f64,
    last: Wrench<D>,
}

impl<const D: usize> Default for LoadMean<D> {
    fn default() -> Self {
        Self { impulse: Wrench::default(), time: 0.0, last: Wrench::default() }
    }
}

impl<const D: usize> LoadMean<D> {
    /// Adds a step of `dt` seconds.
    pub fn add(&mut self, wrench: Wrench<D>, dt: f64) {
        self.impulse.force += dt * wrench.force;
        for d in 0..3 {
            self.impulse.moment[d] += dt * wrench.moment[d];
        }
        self.time += dt;
        self.last = wrench;
    }

    /// Components of force and moment, in the order of [`Load::columns`]: means since the last call, so that no impulse falls
    /// between two rows; the last values where there was no step.
    pub fn take(&mut self) -> Vec<f64> {
        let (Wrench { force, moment }, time) = if self.time > 0.0 { (self.impulse, self.time) } else { (self.last, 1.0) };
        (self.impulse, self.time) = (Wrench::default(), 0.0);
        let moments = if D == 2 { &moment[2..] } else { &moment[..] };
        force.0.iter().chain(moments).map(|sum| sum / time).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Particle;

    const DX: f64 = 0.05;

    fn medium<const D: usize>() -> Medium<D> {
        Medium {
            rest_density: 1000.0,
            viscosity: 0.0,
            gravity: -10.0 * Vector::unit(D - 1),
            spacing: DX,
            depth: 1.0,
            floor: 0.0,
            courant: 0.25,
            speed: 1.0,
        }
    }

    /// Still water 1 m wide (and deep) and 1 m high between walls on all sides, three particles thick, disordered by up to a
    /// fifth of a spacing.
    fn tank<const D: usize>() -> Particles<D> {
        let mut p = Particles::new();
        let cells = 26_i64;
        let all = (0..D).map(|_| cells as usize).product::<usize>();
        for i in 0..all {
            let mut rest = i as i64;
            let cell: [i64; D] = std::array::from_fn(|_| {
                let c = rest % cells;
                rest /= cells;
                c - 3
            });
            let wall = (0..D).any(|d| cell[d] < 0 || d < D - 1 && cell[d] >= 20);
            if !wall && cell[D - 1] >= 20 {
                continue;
            }
            let jitter = |d: usize| if wall { 0.0 } else { 0.2 * ((37 * i + 101 * d + 13) as f64).sin() };
            let x = Vector(std::array::from_fn(|d| DX * (cell[d] as f64 + 0.5 + jitter(d))));
            let kind = if wall { Kind::Wall } else { Kind::Fluid };
            let mass = 1000.0 * (0..D).map(|_| DX).product::<f64>();
            let pressure = if wall { 0.0 } else { 1e4 * (1.0 - x[D - 1]) };
            let particle =
                Particle { kind, layer: u8::from(wall), x, v: 2.0 * Vector::unit(0), mass, density: 1000.0, pressure, h: 1.3 * DX };
            p.push(i as u32, particle);
        }
        p
    }

    /// 1e-9: round-off of sums of some ten thousand pascals.
    #[test]
    fn a_sensor_tells_hydrostatic_pressure_exactly() {
        let p = tank::<2>();
        for (position, size, normal) in [
            (Vector([1.0, 0.3]), 0.0, Vector([-1.0, 0.0])),
            (Vector([1.0, 0.3]), 0.21, Vector([-1.0, 0.0])),
            (Vector([0.5, 0.0]), 0.3, Vector([0.0, 1.0])),
            (Vector([0.0, 0.01]), 0.0, Vector([1.0, 0.0])),
        ] {
            let sensor = Sensor::new("p".into(), position, size, normal, DX);
            let (told, exact) = (sensor.pressure(&p, &medium()), 1e4 * (1.0 - position[1]));
            assert!((told - exact).abs() < 1e-9 * 1e4, "{position:?}: {told} instead of {exact}");
        }
        let p = tank::<3>();
        let sensor = Sensor::new("p".into(), Vector([1.0, 0.4, 0.6]), 0.2, Vector([-1.0, 0.0, 0.0]), DX);
        assert!((sensor.pressure(&p, &medium()) - 4e3).abs() < 1e-9 * 1e4);
    }

    /// A pressure that also changes along the floor: the plane is exact where a mean of one-sided neighbours is not.
    #[test]
    fn a_sensor_tells_any_linear_pressure_exactly() {
        let mut p = tank::<2>();
        for a in 0..p.owned() {
            p.pressure[a] = 500.0 - 300.0 * p.x[a][0] + 70.0 * p.x[a][1];
        }
        let medium = Medium { gravity: Vector::ZERO, ..medium() };
        let told = Sensor::new("p".into(), Vector([1.0, 0.3]), 0.0, Vector::ZERO, DX).pressure(&p, &medium);
        assert!((told - 221.0).abs() < 1e-9 * 500.0, "{told}");
    }

    /// The whole tank goes 0.83 m along x: what goes along with it tells what it told before, what stays is left behind. 1e-9 of the
    /// pressure, and of a metre: round-off of other positions.
    #[test]
    fn instruments_go_along_with_their_wall() {
        let mut p = tank::<2>();
        let wall = (0..p.owned()).find(|&a| p.kind[a] == Kind::Wall).unwrap();
        let mount = Some(Mount { wall: "tank".into(), id: p.id[wall], start: p.x[wall] });
        let sensor = Sensor::new("p".into(), Vector([0.0, 0.3]), 0.1, Vector([1.0, 0.0]), DX);
        let depth = gauge(GaugeKind::Depth(Vector([0.1, 0.2])));
        let before = (sensor.pressure(&p, &medium()), depth.value(&p, &medium()));
        p.x.iter_mut().for_each(|x| x[0] += 0.83);
        assert_eq!((sensor.pressure(&p, &medium()), depth.value(&p, &medium())), (0.0, 0.0));
        let (sensor, depth) = (sensor.on(mount.clone()), Gauge { mount, ..depth });
        let after = (sensor.pressure(&p, &medium()), depth.value(&p, &medium()));
        assert!((after.0 - before.0).abs() < 1e-9 * 1e4 && (after.1 - before.1).abs() < 1e-9, "{before:?}, then {after:?}");
    }

    #[test]
    fn a_dry_sensor_tells_nothing_and_a_sheet_its_mean() {
        let p = tank::<2>();
        let at = |y: f64| Sensor::new("p".into(), Vector([1.0, y]), 0.0, Vector::ZERO, DX).pressure(&p, &medium());
        assert_eq!(at(1.3), 0.0);
        assert!(at(1.05).abs() < 300.0, "above the surface by a spacing: {}", at(1.05));
    }

    #[test]
    fn a_sensor_on_a_wall_that_cannot_pull_feels_no_tension() {
        let mut p = tank::<2>();
        p.pressure.iter_mut().for_each(|pressure| *pressure = -2e3);
        let medium = Medium { gravity: Vector::ZERO, ..medium() };
        let sensor = Sensor::new("p".into(), Vector([1.0, 0.3]), 0.0, Vector::ZERO, DX);
        assert!((sensor.pressure(&p, &medium) + 2e3).abs() < 1e-9 * 2e3);
        assert_eq!(sensor.without_suction().pressure(&p, &medium), 0.0);
    }

    #[test]
    fn strips_and_discs_are_covered_evenly() {
        let points = strip(0.3, 0.1);
        assert_eq!(points.len(), 6);
        assert!((points[0] + 0.125).abs() < 1e-15 && points.iter().sum::<f64>().abs() < 1e-15);
        // 4 pi: points on a disc of diameter four spacings at half a spacing; a square grid misses it by its rim, here 10 %.
        let count = disc(0.4, 0.1).len() as f64;
        assert!((count / (16.0 * std::f64::consts::PI) - 1.0).abs() < 0.1, "{count} points");
        let (a, b) = across(Vector([0.0, 0.6, 0.8]));
        assert!(a.dot(b).abs() < 1e-15 && (a.norm() - 1.0).abs() < 1e-15 && b.dot(Vector([0.0, 0.6, 0.8])).abs() < 1e-15);
    }

    fn gauge<const D: usize>(kind: GaugeKind<D>) -> Gauge<D> {
        Gauge { name: "h".into(), kind, periods: Periods::NONE, mount: None }
    }

    /// Water without side walls that repeats along x: what stands on the seam tells what the same instrument tells in the middle, but
    /// for the disorder of the particles, which leaves gaps of up to a spacing in all along a wire. Without images half would be missing.
    #[test]
    fn instruments_on_a_seam_feel_the_images() {
        let tank = tank::<2>();
        let mut p = Particles::new();
        for a in (0..tank.owned()).filter(|&a| (0.0..1.0).contains(&tank.x[a][0])) {
            let (kind, layer, x, v, mass) = (tank.kind[a], tank.layer[a], tank.x[a], tank.v[a], tank.mass[a]);
            p.push(a as u32, Particle { kind, layer, x, v, mass, density: 1000.0, pressure: tank.pressure[a], h: tank.h[a] });
        }
        let periods = Periods::of(Vector([0.0, -1.0]), Vector([1.0, 3.0]), [true, false]);
        let on = |kind: GaugeKind<2>| Gauge { name: "h".into(), kind, periods, mount: None }.value(&p, &medium());
        for x in [0.0, 0.5, 1.0] {
            let level = on(GaugeKind::Elevation(Vector([x, 0.2])));
            let depth = on(GaugeKind::Depth(Vector([x, 0.2])));
            assert!((level - 1.0).abs() < 0.3 * DX && (depth - 1.0).abs() < DX, "x = {x}: {level}, {depth}");
            let line = (Vector([x, 0.0]), Vector([x, 1.4]));
            let flow = Gauge::flow("q".into(), line, DX, periods).value(&p, &medium());
            assert!((flow - 2.0).abs() < 0.04, "x = {x}: {flow}");
            let sensor = Sensor::new("p".into(), Vector([x, 0.0]), 0.3, Vector([0.0, 1.0]), DX).in_box(periods);
            let told = sensor.pressure(&p, &medium());
            assert!((told - 1e4).abs() < 1e-9 * 1e4, "x = {x}: {told}");
        }
    }

    /// Water over a block that stands in it to 0.3 m, as over a floor: 0.7 m deep, and what flows across is what the water above carries.
    /// A tenth of a spacing for the pieces of the line and the disorder, a quarter for the points of a line of flow, half a spacing apart; were what is
    /// behind the face counted as water, it would add 0.7.
    #[test]
    fn gauges_end_at_the_face_of_a_submerged_wall() {
        let mut p = tank::<2>();
        for a in 0..p.owned() {
            let x = p.x[a];
            if p.kind[a] == Kind::Fluid && (0.3..0.7).contains(&x[0]) && x[1] < 0.3 {
                let cell = x.0.map(|x| (x / DX).floor());
                (p.kind[a], p.layer[a], p.v[a]) = (Kind::Wall, 1, Vector::ZERO);
                p.x[a] = Vector(cell.map(|c| (c + 0.5) * DX));
            }
        }
        let depth = gauge(GaugeKind::Depth(Vector([0.5, 0.5]))).value(&p, &medium());
        assert!((depth - 0.7).abs() < 0.1 * DX, "{depth}");
        let flow = Gauge::flow("q".into(), (Vector([0.5, 0.1]), Vector([0.5, 1.4])), DX, Periods::NONE).value(&p, &medium());
        assert!((flow - 2.0 * 0.7).abs() < 2.0 * 0.25 * DX, "{flow}");
    }

    /// The surface of the disordered block within a fifth of a spacing, also beside a wall; where it is dry, nothing.
    #[test]
    fn an_elevation_gauge_finds_the_surface() {
        let p = tank::<2>();
        for x in [0.01, 0.1, 0.5] {
            let told = gauge(GaugeKind::Elevation(Vector([x, 0.2]))).value(&p, &medium());
            assert!((told - 1.0).abs() < 0.2 * DX, "x = {x}: {told}");
        }
        let mut dry = p.clone();
        dry.kind.iter_mut().filter(|kind| **kind == Kind::Fluid).for_each(|kind| *kind = Kind::Lost);
        assert_eq!(gauge(GaugeKind::Elevation(Vector([0.5, 0.2]))).value(&dry, &medium()), 0.0);
    }

    /// A drop of four particles high above the water is the highest water, and wets its own two spacings of a wire. 0.2 spacings: the
    /// disorder of the particles.
    #[test]
    fn spray_counts_in_an_elevation_and_hardly_in_a_depth() {
        let mut p = tank::<2>();
        let gauge = |kind: fn(Vector<2>) -> GaugeKind<2>| gauge(kind(Vector([0.5, 0.2])));
        let before = gauge(GaugeKind::Depth).value(&p, &medium());
        assert!((before - 1.0).abs() < 0.2 * DX, "{before}");
        for (i, (across, up)) in [(-0.5, 0.0), (0.5, 0.0), (-0.5, 1.0), (0.5, 1.0)].into_iter().enumerate() {
            let x = Vector([0.5 + across * DX, 1.6 + up * DX]);
            let (mass, v) = (1000.0 * DX * DX, Vector::ZERO);
            let drop = Particle { kind: Kind::Fluid, layer: 0, x, v, mass, density: 400.0, pressure: 0.0, h: 1.3 * DX };
            p.push(10_000 + i as u32, drop);
        }
        assert!(gauge(GaugeKind::Elevation).value(&p, &medium()) > 1.6);
        let wetted = gauge(GaugeKind::Depth).value(&p, &medium()) - before;
        assert!(wetted > DX && wetted < 2.0 * DX, "{wetted}");
    }

    /// The block moves at 2 m/s: 2 m2/s pass a line across it, whichever way it leans. 2 %: sums over disordered particles.
    #[test]
    fn a_flow_gauge_counts_what_passes() {
        let p = tank::<2>();
        for (from, to, expected) in [
            (Vector([0.5, 0.0]), Vector([0.5, 1.4]), 2.0),
            (Vector([0.5, 1.4]), Vector([0.5, 0.0]), -2.0),
            (Vector([0.3, 0.0]), Vector([0.7, 1.2]), 2.0),
            (Vector([0.2, 0.5]), Vector([0.8, 0.5]), 0.0),
        ] {
            let told = Gauge::flow("q".into(), (from, to), DX, Periods::NONE).value(&p, &medium());
            assert!((told - expected).abs() < 0.04, "{from:?} to {to:?}: {told}");
        }
        let p = tank::<3>();
        let told = Gauge::flow("q".into(), (Vector([0.5, 0.0, 0.0]), Vector([0.5, 1.0, 1.2])), DX, Periods::NONE).value(&p, &medium());
        assert!((told - 2.0).abs() < 0.04, "{told}");
    }

    #[test]
    fn loads_add_up_and_have_moments() {
        let mut p = tank::<2>();
        for a in 0..p.owned() {
            p.body[a] = 1 + u16::from(p.x[a][0] > 1.0);
            p.force[a] = Vector([1.0, -2.0]);
        }
        let count = (0..p.owned()).filter(|&a| p.kind[a] == Kind::Wall && p.body[a] == 2).count() as f64;
        let load = Load { name: "gate".into(), bodies: vec![2], about: Vector([1.0, 0.0]) };
        let wrench = load.wrench(&p);
        assert_eq!(wrench.force, Vector([count, -2.0 * count]));
        let moment: f64 =
            (0..p.owned()).filter(|&a| p.kind[a] == Kind::Wall && p.body[a] == 2).map(|a| -2.0 * (p.x[a][0] - 1.0) - p.x[a][1]).sum();
        assert!((wrench.moment[2] - moment).abs() < 1e-12 * moment.abs());
        assert_eq!(load.columns(), ["gate.fx [N/m]", "gate.fy [N/m]", "gate.mz [N]"]);
        // Means weigh steps by their length.
        let mut mean = LoadMean::default();
        mean.add(Wrench { force: Vector([1.0, 0.0]), moment: [0.0, 0.0, 4.0] }, 0.3);
        mean.add(Wrench { force: Vector([5.0, 0.0]), moment: [0.0; 3] }, 0.1);
        assert!(mean.take().iter().zip([2.0, 0.0, 3.0]).all(|(mean, exact)| (mean - exact).abs() < 1e-12));
        assert_eq!(mean.take(), [5.0, 0.0, 0.0], "without a step the last value stands");
    }
}
