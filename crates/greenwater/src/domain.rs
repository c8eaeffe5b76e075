//! The box the flow lives in: its bounds, and the periodic images of particles near its faces.

use crate::lanes::Record;
use crate::math::Vector;
use crate::particles::{Kind, Particles};
use crate::reduce::sum;

/// Lengths after which a box repeats, m; infinite along its open axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Periods<const D: usize>(Vector<D>);

impl<const D: usize> Periods<D> {
    /// Nothing repeats.
    pub const NONE: Self = Self(Vector([f64::INFINITY; D]));

    /// Those of a box from `min` to `max`, m, periodic along the axes where `periodic` says so.
    pub fn of(min: Vector<D>, max: Vector<D>, periodic: [bool; D]) -> Self {
        Self(Vector(std::array::from_fn(|d| if periodic[d] { max[d] - min[d] } else { f64::INFINITY })))
    }

    /// The difference of two positions (m) to the nearest image.
    pub fn nearest(self, away: Vector<D>) -> Vector<D> {
        let along = |d: usize| if self.0[d].is_finite() { away[d] - self.0[d] * (away[d] / self.0[d]).round() } else { away[d] };
        Vector(std::array::from_fn(along))
    }
}

/// A box, periodic along some axes. Along the others it is open: a fluid particle that leaves is lost.
#[derive(Clone, Debug, PartialEq)]
pub struct Domain<const D: usize> {
    /// Lower corner, m.
    pub min: Vector<D>,
    /// Upper corner, m.
    pub max: Vector<D>,
    /// Axes along which what leaves at one face enters at the other.
    pub periodic: [bool; D],
    /// Row of the real particle behind each ghost, in ghost order.
    parents: Vec<u32>,
    /// How far each ghost stands from its parent, m.
    shifts: Vec<Vector<D>>,
}

impl<const D: usize> Domain<D> {
    /// A box from `min` to `max`, m, periodic along the axes where `periodic` says so.
    pub fn new(min: Vector<D>, max: Vector<D>, periodic: [bool; D]) -> Self {
        Self { min, max, periodic, parents: Vec::new(), shifts: Vec::new() }
    }

    /// Makes the particles ready for a search of pairs up to `reach` (m): wraps them into periodic axes, marks fluid that left
    /// through an open face as [`Kind::Lost`], and makes the ghosts anew.
    ///
    /// The same call will fetch the particles of neighbouring ranks.
    pub fn refresh(&mut self, p: &mut Particles<D>, reach: f64) {
        p.drop_ghosts();
        self.parents.clear();
        self.shifts.clear();
        for a in 0..p.owned() {
            if p.kind[a] == Kind::Lost {
                continue;
            }
            for d in 0..D {
                let (low, high) = (self.min[d], self.max[d]);
                if self.periodic[d] {
                    let x = p.x[a][d];
                    if !(low..high).contains(&x) && x.is_finite() {
                        p.x[a][d] = low + (x - low).rem_euclid(high - low);
                    }
                } else if p.is_fluid(a) && self.leaves(p.x[a], d) {
                    p.kind[a] = Kind::Lost;
                    p.v[a] = Vector::ZERO;
                    p.acceleration[a] = Vector::ZERO;
                    p.density_rate[a] = 0.0;
                }
            }
        }
        if self.periodic.contains(&true) {
            self.add_images(p, reach);
        }
    }

    /// Whether fluid at `x` has left the box through an open face across axis `d`.
    fn leaves(&self, x: Vector<D>, d: usize) -> bool {
        !self.periodic[d] && x[d].is_finite() && !(self.min[d]..=self.max[d]).contains(&x[d])
    }

    /// Whether fluid of `rest_density` (kg/m³) and walls at a `spacing` (m) fill a box that repeats along all axes, but for a hundredth: there
    /// is no place for a free surface then, whatever the flow does to the packing.
    pub fn is_brimful(&self, p: &Particles<D>, spacing: f64, rest_density: f64) -> bool {
        let cell: f64 = (0..D).map(|_| spacing).product();
        let volume = |a: usize| match p.kind[a] {
            Kind::Fluid => p.mass[a] / rest_density,
            Kind::Wall => cell,
            Kind::Lost => 0.0,
        };
        let whole: f64 = (0..D).map(|d| self.max[d] - self.min[d]).product();
        !self.periodic.contains(&false) && sum(p.owned(), volume) >= 0.99 * whole
    }

    /// Whether fluid at `x` (m) has left the box: the next [`refresh`](Self::refresh) makes it [`Kind::Lost`].
    pub fn is_outside(&self, x: Vector<D>) -> bool {
        (0..D).any(|d| self.leaves(x, d))
    }

    /// Copies the column of real particles into the rows of their ghosts: for a field that changed since [`refresh`](Self::refresh).
    pub fn refresh_column<T: Copy>(&self, column: &mut [T]) {
        let owned = column.len() - self.parents.len();
        let (real, ghosts) = column.split_at_mut(owned);
        for (ghost, &parent) in ghosts.iter_mut().zip(&self.parents) {
            *ghost = real[parent as usize];
        }
    }

    /// Moves the ghosts along with their parents, without wrapping or making any: for positions that changed a little since
    /// [`refresh`](Self::refresh).
    pub fn follow(&self, x: &mut [Vector<D>]) {
        let owned = x.len() - self.parents.len();
        let (real, ghosts) = x.split_at_mut(owned);
        for (ghost, (&parent, &shift)) in ghosts.iter_mut().zip(self.parents.iter().zip(&self.shifts)) {
            *ghost = real[parent as usize] + shift;
        }
    }

    /// Makes the records of ghosts those of their parents, each in its own place.
    pub(crate) fn refresh_records(&self, records: &mut [Record]) {
        // Nobody stands behind the ghosts.
        let owned = records.len() - self.parents.len() - 1;
        for (i, (&parent, shift)) in self.parents.iter().zip(&self.shifts).enumerate() {
            let mut image = records[parent as usize];
            for d in 0..D {
                image.0[d] += shift[d];
            }
            records[owned + i] = image;
        }
    }

    /// The real particle that row `row` stands for: itself, or the parent of a ghost. `owned` is the number of real rows.
    #[inline(always)]
    pub fn parent(&self, row: usize, owned: usize) -> usize {
        if row < owned { row } else { self.parents[row - owned] as usize }
    }

    /// Every image of every particle within `reach` of the box. An axis shorter than `reach` gets several layers of images.
    fn add_images(&mut self, p: &mut Particles<D>, reach: f64) {
        let edge = self.max - self.min;
        let layers: [i32; D] = std::array::from_fn(|d| if self.periodic[d] { (reach / edge[d]).ceil() as i32 } else { 0 });
        for a in 0..p.owned() {
            if p.kind[a] == Kind::Lost {
                continue;
            }
            let mut cell: [i32; D] = layers.map(|n| -n);
            loop {
                let shift = Vector(std::array::from_fn(|d| f64::from(cell[d]) * edge[d]));
                let image = p.x[a] + shift;
                let near = (0..D).all(|d| !self.periodic[d] || (self.min[d] - reach..=self.max[d] + reach).contains(&image[d]));
                if near && cell.iter().any(|&c| c != 0) {
                    p.push_ghost(a, shift);
                    self.parents.push(a as u32);
                    self.shifts.push(shift);
                }
                let Some(axis) = (0..D).find(|&d| cell[d] < layers[d]) else { break };
                cell[axis] += 1;
                for d in 0..axis {
                    cell[d] = -layers[d];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Particle;

    fn fluid(x: [f64; 2]) -> Particle<2> {
        Particle { kind: Kind::Fluid, layer: 0, x: Vector(x), v: Vector([1.0, 0.0]), mass: 1.0, density: 1.0, pressure: 0.0, h: 0.1 }
    }

    fn cloud(points: &[[f64; 2]]) -> Particles<2> {
        let mut p = Particles::new();
        for (id, &x) in points.iter().enumerate() {
            p.push(id as u32, fluid(x));
        }
        p
    }

    #[test]
    fn a_corner_particle_has_three_images_in_a_doubly_periodic_box() {
        let mut domain = Domain::new(Vector::ZERO, Vector([1.0, 1.0]), [true, true]);
        let mut p = cloud(&[[0.05, 0.05], [0.5, 0.5]]);
        domain.refresh(&mut p, 0.2);
        assert_eq!(p.len() - p.owned(), 3);
        assert!(p.x[2..].contains(&Vector([1.05, 1.05])));
        assert!((2..5).all(|row| domain.parent(row, p.owned()) == 0));
    }

    #[test]
    fn a_box_shorter_than_the_reach_gets_several_layers() {
        let mut domain = Domain::new(Vector::ZERO, Vector([0.3, 1.0]), [true, false]);
        let mut p = cloud(&[[0.15, 0.5]]);
        domain.refresh(&mut p, 0.7);
        // Images at 0.15 + 0.3 k within [-0.7, 1.0]: k = -2, -1, 1, 2.
        assert_eq!(p.len() - p.owned(), 4);
    }

    #[test]
    fn particles_wrap_along_periodic_axes_and_are_lost_at_open_ones() {
        let mut domain = Domain::new(Vector::ZERO, Vector([1.0, 1.0]), [true, false]);
        let mut p = cloud(&[[1.25, 0.5], [0.5, 1.5]]);
        domain.refresh(&mut p, 0.1);
        assert_eq!((p.x[0], p.kind[0]), (Vector([0.25, 0.5]), Kind::Fluid));
        assert_eq!((p.kind[1], p.v[1]), (Kind::Lost, Vector::ZERO));
    }

    #[test]
    fn ghost_columns_follow_their_parents() {
        let mut domain = Domain::new(Vector::ZERO, Vector([1.0, 1.0]), [true, false]);
        let mut p = cloud(&[[0.05, 0.5], [0.95, 0.5]]);
        domain.refresh(&mut p, 0.1);
        p.pressure[0] = 3.0;
        p.pressure[1] = 4.0;
        domain.refresh_column(&mut p.pressure);
        assert_eq!(p.pressure, [3.0, 4.0, 3.0, 4.0]);
    }
}
