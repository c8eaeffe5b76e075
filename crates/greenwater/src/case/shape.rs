//! Shapes of a case, and the particles that fill them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::error::CaseError;
use super::source::Source;
use crate::math::Vector;

/// Names of the axes.
pub(super) const AXES: [char; 3] = ['x', 'y', 'z'];

/// A region of space, as written in a case. Lengths and positions in m, positions with one number an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Shape {
    /// A box with sides along the axes, each a whole number of spacings long.
    Box {
        /// Lower corner.
        #[schemars(extend("unit" = "m"))]
        min: Vec<f64>,
        /// Upper corner.
        #[schemars(extend("unit" = "m", "rule" = "> min on every axis"))]
        max: Vec<f64>,
    },
    /// The inside of a closed polygon; 2D.
    Polygon {
        /// Corners in order, the last joined to the first.
        #[schemars(extend("unit" = "m", "rule" = "at least 3"))]
        points: Vec<[f64; 2]>,
    },
    /// A disc; 2D.
    Circle {
        /// Centre.
        #[schemars(extend("unit" = "m"))]
        center: Vec<f64>,
        /// Radius.
        #[schemars(extend("unit" = "m", "rule" = "> 0"))]
        radius: f64,
    },
    /// A ball; 3D.
    Sphere {
        /// Centre.
        #[schemars(extend("unit" = "m"))]
        center: Vec<f64>,
        /// Radius.
        #[schemars(extend("unit" = "m", "rule" = "> 0"))]
        radius: f64,
    },
    /// A cylinder around the line from one point to another; 3D.
    Cylinder {
        /// Centre of one end.
        #[schemars(extend("unit" = "m"))]
        from: Vec<f64>,
        /// Centre of the other end.
        #[schemars(extend("unit" = "m"))]
        to: Vec<f64>,
        /// Radius.
        #[schemars(extend("unit" = "m", "rule" = "> 0"))]
        radius: f64,
    },
    /// A region less others.
    Difference {
        /// The region.
        of: std::boxed::Box<Shape>,
        /// What is taken away.
        minus: Vec<Shape>,
    },
    /// A vessel around a box, `walls.layers` lines of particles thick; walls only. Its sides are whole numbers of spacings long.
    Tank {
        /// Lower corner of the inside.
        #[schemars(extend("unit" = "m"))]
        min: Vec<f64>,
        /// Upper corner of the inside.
        #[schemars(extend("unit" = "m", "rule" = "> min on every axis"))]
        max: Vec<f64>,
        /// Faces without wall.
        #[serde(default)]
        #[schemars(extend("rule" = "of \"left\", \"right\" (x), \"bottom\", \"top\" (last axis), \"front\", \"back\" (y in 3D)"))]
        open: Vec<String>,
    },
}

/// Names of the shapes, as written.
pub(super) const SHAPE_NAMES: [&str; 7] = ["box", "polygon", "circle", "sphere", "cylinder", "difference", "tank"];

/// A checked [`Shape`] in `D` dimensions.
#[derive(Clone, Debug)]
pub(super) enum Region<const D: usize> {
    Block { min: Vector<D>, max: Vector<D> },
    Ball { center: Vector<D>, radius: f64 },
    Cylinder { from: Vector<D>, direction: Vector<D>, length: f64, radius: f64 },
    Polygon { points: Vec<[f64; 2]> },
    Difference { of: Box<Region<D>>, minus: Vec<Region<D>> },
    Tank { min: Vector<D>, max: Vector<D>, open: [[bool; 2]; D] },
}

/// Cells of one spacing; particles stand at their centres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice<const D: usize> {
    /// A corner of a cell, m.
    pub origin: Vector<D>,
    /// Side of a cell, m.
    pub spacing: f64,
}

/// Lower and upper cell (exclusive) of a block of cells.
type Cells<const D: usize> = ([i64; D], [i64; D]);

impl<const D: usize> Region<D> {
    /// Checks the numbers of `shape`, which stands at `key`.
    pub fn checked(shape: &Shape, key: &str, source: &Source) -> Result<Self, CaseError> {
        let dimension_is = |needed: usize, name: &str| {
            source.rule(D == needed, key, format!("a {name}"), format!("a shape of {D} dimensions; a {name} has {needed}"))
        };
        let corners = |name: &str, min: &[f64], max: &[f64]| -> Result<(Vector<D>, Vector<D>), CaseError> {
            let (min_key, max_key) = (format!("{key}.{name}.min"), format!("{key}.{name}.max"));
            let (min, max) = (vector(min, &min_key, source)?, vector(max, &max_key, source)?);
            for d in 0..D {
                source.rule(max[d] > min[d], &max_key, format!("{:?}", max.0), format!("greater than `min` along {}", AXES[d]))?;
            }
            Ok((min, max))
        };
        let positive = |name: &str, radius: f64| source.rule(radius > 0.0, &format!("{key}.{name}.radius"), radius, "> 0");
        Ok(match shape {
            Shape::Box { min, max } => {
                let (min, max) = corners("box", min, max)?;
                Self::Block { min, max }
            }
            Shape::Polygon { points } => {
                dimension_is(2, "polygon")?;
                let points_key = format!("{key}.polygon.points");
                source.rule(points.len() >= 3, &points_key, format!("a list of {}", points.len()), "at least 3 points")?;
                Self::Polygon { points: points.clone() }
            }
            Shape::Circle { center, radius } => {
                dimension_is(2, "circle")?;
                positive("circle", *radius)?;
                Self::Ball { center: vector(center, &format!("{key}.circle.center"), source)?, radius: *radius }
            }
            Shape::Sphere { center, radius } => {
                dimension_is(3, "sphere")?;
                positive("sphere", *radius)?;
                Self::Ball { center: vector(center, &format!("{key}.sphere.center"), source)?, radius: *radius }
            }
            Shape::Cylinder { from, to, radius } => {
                dimension_is(3, "cylinder")?;
                positive("cylinder", *radius)?;
                let to_key = format!("{key}.cylinder.to");
                let from: Vector<D> = vector(from, &format!("{key}.cylinder.from"), source)?;
                let axis = vector(to, &to_key, source)? - from;
                let length = axis.norm();
                source.rule(length > 0.0, &to_key, format!("{to:?}"), "another point than `from`")?;
                Self::Cylinder { from, direction: axis / length, length, radius: *radius }
            }
            Shape::Difference { of, minus } => {
                let solid = |shape: &Shape, key: String| {
                    source.rule(!matches!(shape, Shape::Tank { .. }), &key, "a tank", "a solid shape inside a difference")?;
                    Self::checked(shape, &key, source)
                };
                let of = solid(of, format!("{key}.difference.of"))?;
                let minus = minus.iter().enumerate().map(|(i, shape)| solid(shape, format!("{key}.difference.minus[{i}]")));
                Self::Difference { of: Box::new(of), minus: minus.collect::<Result<_, _>>()? }
            }
            Shape::Tank { min, max, open } => {
                let (min, max) = corners("tank", min, max)?;
                let mut faces = [[false; 2]; D];
                for name in open {
                    let (axis, side) = match name.as_str() {
                        "left" => (0, 0),
                        "right" => (0, 1),
                        "bottom" => (D - 1, 0),
                        "top" => (D - 1, 1),
                        "front" if D == 3 => (1, 0),
                        "back" if D == 3 => (1, 1),
                        _ => {
                            let names = if D == 3 { "left, right, front, back, bottom, top" } else { "left, right, bottom, top" };
                            return Err(source.broken(&format!("{key}.tank.open"), format!("{name:?}"), format!("of {names}")));
                        }
                    };
                    faces[axis][side] = true;
                }
                Self::Tank { min, max, open: faces }
            }
        })
    }

    /// The smallest box around the region; of a tank, its inside.
    pub fn bounds(&self) -> (Vector<D>, Vector<D>) {
        match self {
            Self::Block { min, max } | Self::Tank { min, max, .. } => (*min, *max),
            Self::Ball { center, radius } => (*center - Vector::splat(*radius), *center + Vector::splat(*radius)),
            Self::Cylinder { from, direction, length, radius } => {
                let to = *from + *length * *direction;
                let reach = direction.map(|n| radius * (1.0 - n * n).max(0.0).sqrt());
                (from.zip(to, f64::min) - reach, from.zip(to, f64::max) + reach)
            }
            Self::Polygon { points } => {
                points.iter().fold((Vector::splat(f64::INFINITY), Vector::splat(f64::NEG_INFINITY)), |(min, max), p| {
                    let p = Vector(std::array::from_fn(|d| p[d]));
                    (min.zip(p, f64::min), max.zip(p, f64::max))
                })
            }
            Self::Difference { of, .. } => of.bounds(),
        }
    }

    /// Depth of `x` under the surface of a solid region, m: positive inside, negative outside. Exact in size inside convex
    /// shapes; where shapes are cut out of each other, a lower bound.
    pub fn depth(&self, x: Vector<D>) -> f64 {
        match self {
            Self::Block { min, max } | Self::Tank { min, max, .. } => {
                let inward = (0..D).map(|d| (x[d] - min[d]).min(max[d] - x[d]));
                let nearest = inward.clone().fold(f64::INFINITY, f64::min);
                let outside = inward.fold(0.0, |sum, d| sum + d.min(0.0) * d.min(0.0));
                if nearest < 0.0 { -outside.sqrt() } else { nearest }
            }
            Self::Ball { center, radius } => radius - (x - *center).norm(),
            Self::Cylinder { from, direction, length, radius } => {
                let along = (x - *from).dot(*direction);
                let radial = (x - *from - along * *direction).norm();
                (radius - radial).min(along).min(length - along)
            }
            Self::Polygon { points } => polygon_depth(points, x[0], x[1]),
            Self::Difference { of, minus } => minus.iter().fold(of.depth(x), |depth, hole| depth.min(-hole.depth(x))),
        }
    }

    /// Whether the region is filled all through, not lined.
    pub fn is_solid(&self) -> bool {
        !matches!(self, Self::Tank { .. })
    }

    /// Line of a place inside a solid region, of lines one `spacing` thick: 1 at the surface that wets.
    pub fn line(&self, x: Vector<D>, spacing: f64) -> u8 {
        (self.depth(x) / spacing).ceil().clamp(1.0, 255.0) as u8
    }

    /// The cells that fill the region: of its own if it is a box or a tank, else of `common`.
    pub fn lattice(&self, common: Lattice<D>) -> Lattice<D> {
        match self {
            Self::Block { min, .. } | Self::Tank { min, .. } => Lattice { origin: *min, spacing: common.spacing },
            _ => common,
        }
    }

    /// Cells of `lattice` that may hold particles of the region.
    fn cells(&self, lattice: Lattice<D>, layers: i64) -> Cells<D> {
        let (min, max) = self.bounds();
        let (mut low, mut high) = lattice.cells_around(min, max);
        if let Self::Tank { open, .. } = self {
            for d in 0..D {
                low[d] -= if open[d][0] { 0 } else { layers };
                high[d] += if open[d][1] { 0 } else { layers };
            }
        }
        (low, high)
    }

    /// Predicted number of particles, without making any: exact for boxes and tanks, at most one a cell for the others.
    pub fn predicted(&self, spacing: f64, layers: u32) -> f64 {
        let (min, max) = self.bounds();
        let inside = |d: usize| ((max[d] - min[d]) / spacing).round().max(1.0);
        let all: f64 = (0..D).map(inside).product();
        match self {
            Self::Tank { open, .. } => {
                let thick = |d: usize| open[d].iter().filter(|&&open| !open).count() as f64 * f64::from(layers);
                (0..D).map(|d| inside(d) + thick(d)).product::<f64>() - all
            }
            _ => all,
        }
    }

    /// Calls `make` with position and line (1 at the surface that wets) of every particle of the region.
    pub fn fill(&self, lattice: Lattice<D>, layers: u32, mut make: impl FnMut(Vector<D>, u8)) {
        let (low, high) = self.cells(lattice, i64::from(layers));
        let dx = lattice.spacing;
        match self {
            Self::Tank { min, max, .. } => {
                let (inner_low, inner_high) = lattice.cells_around(*min, *max);
                for_each_cell((low, high), |cell| {
                    let rows_out = |d: usize| (inner_low[d] - cell[d]).max(cell[d] - inner_high[d] + 1);
                    let row = (0..D).map(rows_out).max().unwrap_or(0);
                    if row >= 1 {
                        make(lattice.center(cell), row.min(255) as u8);
                    }
                });
            }
            Self::Block { .. } => for_each_cell((low, high), |cell| {
                let row = (0..D).map(|d| (cell[d] - low[d] + 1).min(high[d] - cell[d])).min().unwrap_or(1);
                make(lattice.center(cell), row.min(255) as u8);
            }),
            _ => for_each_cell((low, high), |cell| {
                let x = lattice.center(cell);
                let depth = self.depth(x);
                // A centre on the surface is outside, whichever way it was rounded.
                if depth > 1e-9 * dx {
                    make(x, self.line(x, dx));
                }
            }),
        }
    }
}

impl<const D: usize> Lattice<D> {
    /// Cells that fill the box around `region` evenly: from its lower corner if the spacing divides it, else centred on it.
    pub fn of(region: &Region<D>, spacing: f64) -> Self {
        let (min, max) = region.bounds();
        let origin = min.zip(max, |low, high| {
            let cells = ((high - low) / spacing - WHOLE).ceil();
            if (cells * spacing - (high - low)).abs() <= WHOLE * (high - low) { low } else { 0.5 * (low + high - cells * spacing) }
        });
        Self { origin, spacing }
    }

    /// Centre of a cell, m.
    fn center(&self, cell: [i64; D]) -> Vector<D> {
        Vector(std::array::from_fn(|d| self.origin[d] + (cell[d] as f64 + 0.5) * self.spacing))
    }

    fn cells_around(&self, min: Vector<D>, max: Vector<D>) -> Cells<D> {
        let low = std::array::from_fn(|d| ((min[d] - self.origin[d]) / self.spacing + WHOLE).floor() as i64);
        let high = std::array::from_fn(|d| ((max[d] - self.origin[d]) / self.spacing - WHOLE).ceil() as i64);
        (low, high)
    }
}

/// How far from a whole number of spacings a side may be, relative to the side or in spacings: room for decimal numbers
/// such as 0.1, far below what a particle would notice.
pub(super) const WHOLE: f64 = 1e-6;

/// Whether `extent` is a whole number (at least one) of spacings.
pub(super) fn is_whole(extent: f64, spacing: f64) -> bool {
    let cells = (extent / spacing).round();
    cells >= 1.0 && (cells * spacing - extent).abs() <= WHOLE * extent
}

/// The numbers of a position or vector that stands at `key`.
pub(super) fn vector<const D: usize>(numbers: &[f64], key: &str, source: &Source) -> Result<Vector<D>, CaseError> {
    match <[f64; D]>::try_from(numbers) {
        Ok(components) => Ok(Vector(components)),
        Err(_) => Err(source.broken(
            key,
            format!("a list of {}", numbers.len()),
            format!("a list of {D} numbers, one an axis: `dimension` is {D}"),
        )),
    }
}

/// Visits a block of cells, the last axis fastest.
fn for_each_cell<const D: usize>((low, high): Cells<D>, mut visit: impl FnMut([i64; D])) {
    if (0..D).any(|d| low[d] >= high[d]) {
        return;
    }
    let mut cell = low;
    loop {
        visit(cell);
        let mut axis = D;
        loop {
            if axis == 0 {
                return;
            }
            axis -= 1;
            cell[axis] += 1;
            if cell[axis] < high[axis] {
                break;
            }
            cell[axis] = low[axis];
        }
    }
}

/// Signed distance to the boundary of a polygon, positive inside (even-odd rule).
fn polygon_depth(points: &[[f64; 2]], x: f64, y: f64) -> f64 {
    let mut inside = false;
    let mut nearest = f64::INFINITY;
    for (i, &[bx, by]) in points.iter().enumerate() {
        let [ax, ay] = points[(i + points.len() - 1) % points.len()];
        if (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax) {
            inside = !inside;
        }
        let (ex, ey, px, py) = (bx - ax, by - ay, x - ax, y - ay);
        let length = ex * ex + ey * ey;
        let t = if length > 0.0 { ((px * ex + py * ey) / length).clamp(0.0, 1.0) } else { 0.0 };
        let (dx, dy) = (px - t * ex, py - t * ey);
        nearest = nearest.min(dx * dx + dy * dy);
    }
    if inside { nearest.sqrt() } else { -nearest.sqrt() }
}

/// Two particles of different bodies nearer than allowed: indices of both, and their distance in m.
///
/// `bodies[i]` is the body of particle `i`; particles of one body are not compared.
pub(super) fn too_close<const D: usize>(x: &[Vector<D>], bodies: &[u32], least: f64) -> Option<(usize, usize, f64)> {
    let cell = |x: Vector<D>| -> [i64; D] { std::array::from_fn(|d| (x[d] / least).floor() as i64) };
    let mut sorted: Vec<([i64; D], u32)> = x.iter().enumerate().map(|(a, &x)| (cell(x), a as u32)).collect();
    sorted.sort_unstable();
    for (row, &(home, a)) in sorted.iter().enumerate() {
        let a = a as usize;
        // Runs of three cells along the last axis, over the neighbouring rows that come later or are the same.
        let mut found = None;
        let (mut low, mut high) = (home.map(|c| c - 1), home.map(|c| c + 2));
        (low[D - 1], high[D - 1]) = (0, 1);
        for_each_cell((low, high), |mut start| {
            start[D - 1] = home[D - 1] - 1;
            let mut end = start;
            end[D - 1] = home[D - 1] + 1;
            if end < home || found.is_some() {
                return;
            }
            let first = row + 1 + sorted[row + 1..].partition_point(|(cell, _)| *cell < start);
            found = sorted[first..].iter().take_while(|(cell, _)| *cell <= end).map(|&(_, b)| b as usize).find_map(|b| {
                let distance = (x[a] - x[b]).norm();
                (bodies[a] != bodies[b] && distance < least * (1.0 - WHOLE)).then_some((a.min(b), a.max(b), distance))
            });
        });
        if found.is_some() {
            return found;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(region: &Region<2>, dx: f64, layers: u32) -> Vec<(Vector<2>, u8)> {
        let mut points = Vec::new();
        region.fill(region.lattice(Lattice::of(region, dx)), layers, |x, row| points.push((x, row)));
        points
    }

    /// 4/π of a disc's area is its box; a lattice disc of 40 cells has its area within the cells on its rim (1 %).
    #[test]
    fn a_disc_holds_its_area_and_is_symmetric() {
        let disc = Region::<2>::Ball { center: Vector([0.3, -0.2]), radius: 0.5 };
        let dx = 0.025;
        let cells = points(&disc, dx, 3);
        let area = cells.len() as f64 * dx * dx / (std::f64::consts::PI * 0.25);
        assert!((area - 1.0).abs() < 0.01, "area ratio {area}");
        let mean = cells.iter().fold(Vector::ZERO, |sum, (x, _)| sum + *x) / cells.len() as f64;
        assert!((mean - Vector([0.3, -0.2])).norm() < 1e-12, "centre of mass {mean:?}");
    }

    #[test]
    fn lines_of_a_solid_count_from_its_surface() {
        let block = Region::<2>::Block { min: Vector([0.0, 0.0]), max: Vector([0.5, 0.5]) };
        let rows: Vec<u8> = points(&block, 0.1, 3).iter().filter(|(x, _)| (x[0] - 0.25).abs() < 0.01).map(|(_, row)| *row).collect();
        assert_eq!(rows, [1, 2, 3, 2, 1]);
        let hole =
            Region::Difference { of: Box::new(block), minus: vec![Region::Block { min: Vector([0.2, 0.2]), max: Vector([0.3, 0.3]) }] };
        let cells = points(&hole, 0.1, 3);
        assert_eq!(cells.len(), 24);
        assert!(cells.iter().all(|(_, row)| *row == 1), "every cell of the ring touches its inner or outer side");
    }

    #[test]
    fn a_tank_has_whole_corners_and_open_faces() {
        let open = [[false, false], [false, true]];
        let tank = Region::<2>::Tank { min: Vector([0.0, 0.0]), max: Vector([0.4, 0.2]), open };
        let cells = points(&tank, 0.1, 2);
        assert_eq!(cells.len(), 2 * 4 + 2 * 2 * 2 + 2 * 2 * 2, "floor, sides, corners");
        assert_eq!(cells.len() as f64, tank.predicted(0.1, 2));
        assert!(cells.iter().all(|(x, _)| x[1] < 0.2));
        let row_of = |x: f64, y: f64| cells.iter().find(|(c, _)| (*c - Vector([x, y])).norm() < 1e-9).map(|(_, row)| *row);
        assert_eq!((row_of(-0.05, 0.05), row_of(-0.15, 0.05), row_of(-0.15, -0.05)), (Some(1), Some(2), Some(2)));
    }

    #[test]
    fn polygons_know_inside_from_outside() {
        let corner = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
        assert!((polygon_depth(&corner, 0.5, 1.5) - 0.5).abs() < 1e-15);
        assert!((polygon_depth(&corner, 1.5, 1.5) + 0.5).abs() < 1e-15);
        assert!((polygon_depth(&corner, 3.0, 0.5) + 1.0).abs() < 1e-15);
    }

    #[test]
    fn close_particles_are_found_in_any_direction() {
        for angle in 0..16 {
            let t = f64::from(angle) * std::f64::consts::PI / 8.0;
            for (distance, found) in [(0.99, true), (1.01, false)] {
                let x = [
                    Vector([5.0, 5.0, 0.95]),
                    Vector([5.0 + distance * t.cos(), 5.0 + 0.6 * distance * t.sin(), 0.95 + 0.8 * distance * t.sin()]),
                ];
                assert_eq!(too_close(&x, &[0, 1], 1.0).is_some(), found, "direction {angle}");
                assert_eq!(too_close(&x, &[0, 0], 1.0), None, "one body is not compared with itself");
            }
        }
    }
}
