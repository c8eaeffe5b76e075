//! The state of the flow: one column a field, and the table that names every field a user may ask for.

use serde::{Deserialize, Serialize};

use crate::math::Vector;

/// What a particle stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum Kind {
    /// Moves with the flow.
    Fluid = 0,
    /// Fixed; one of the lines of particles that make a wall.
    Wall = 1,
    /// Was fluid and left the domain: rests where it left and takes no further part.
    Lost = 2,
}

/// Every particle of a run. Columns have equal length; the first [`Particles::owned`] rows are real, the rest are ghosts
/// (periodic images) that [`crate::domain::Domain::refresh`] makes anew.
///
/// Units: SI. In 2D a particle stands for a slice of unit depth: its mass is in kg/m.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Particles<const D: usize> {
    /// Name of the particle: unique, kept for the whole run.
    pub id: Vec<u32>,
    /// Fluid or wall.
    pub kind: Vec<Kind>,
    /// Line of a wall particle: 1 touches the fluid, 2, 3, ... lie behind it; 0 for fluid.
    pub layer: Vec<u8>,
    /// Position, m.
    pub x: Vec<Vector<D>>,
    /// Velocity, m/s.
    pub v: Vec<Vector<D>>,
    /// Mass, kg (kg/m in 2D).
    pub mass: Vec<f64>,
    /// Density, kg/m³.
    pub density: Vec<f64>,
    /// Pressure, Pa.
    pub pressure: Vec<f64>,
    /// Smoothing length, m.
    pub h: Vec<f64>,
    /// Acceleration of the last evaluation, m/s².
    pub acceleration: Vec<Vector<D>>,
    /// Rate of change of density of the last evaluation, kg/(m³ s).
    pub density_rate: Vec<f64>,
    /// 1 where the method sees a free surface, else 0.
    pub surface: Vec<u8>,
    /// Number of the wall shape a wall particle belongs to, in the order of the case from 1; 0 for fluid and for particles of a table.
    pub body: Vec<u16>,
    /// Force of the fluid on a wall particle, mean over the last step, N (N/m in 2D): every momentum exchanged. Zero for fluid.
    pub force: Vec<Vector<D>>,
    owned: usize,
}

/// One particle of an initial state: what a case or a particle file gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Particle<const D: usize> {
    /// Fluid or wall.
    pub kind: Kind,
    /// Line of a wall particle (1 touches the fluid); 0 for fluid.
    pub layer: u8,
    /// Position, m.
    pub x: Vector<D>,
    /// Velocity, m/s.
    pub v: Vector<D>,
    /// Mass, kg (kg/m in 2D).
    pub mass: f64,
    /// Density, kg/m³.
    pub density: f64,
    /// Pressure, Pa.
    pub pressure: f64,
    /// Smoothing length, m.
    pub h: f64,
}

/// Applies `$do!(column)` to every stored column.
macro_rules! each_column {
    ($columns:expr, $do:ident) => {{
        let p = $columns;
        $do!(p.id);
        $do!(p.kind);
        $do!(p.layer);
        $do!(p.x);
        $do!(p.v);
        $do!(p.mass);
        $do!(p.density);
        $do!(p.pressure);
        $do!(p.h);
        $do!(p.acceleration);
        $do!(p.density_rate);
        $do!(p.surface);
        $do!(p.body);
        $do!(p.force);
    }};
}

impl<const D: usize> Particles<D> {
    /// A set without particles.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a real particle under `id`. Only before any ghosts exist.
    pub fn push(&mut self, id: u32, particle: Particle<D>) {
        debug_assert_eq!(self.owned, self.x.len(), "ghosts come after all real particles");
        self.id.push(id);
        self.kind.push(particle.kind);
        self.layer.push(particle.layer);
        self.x.push(particle.x);
        self.v.push(particle.v);
        self.mass.push(particle.mass);
        self.density.push(particle.density);
        self.pressure.push(particle.pressure);
        self.h.push(particle.h);
        self.acceleration.push(Vector::ZERO);
        self.density_rate.push(0.0);
        self.surface.push(0);
        self.body.push(0);
        self.force.push(Vector::ZERO);
        self.owned += 1;
    }

    /// Number of real particles.
    pub fn owned(&self) -> usize {
        self.owned
    }

    /// Number of rows, ghosts included.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there is no particle at all.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Whether particle `a` moves with the flow.
    #[inline(always)]
    pub fn is_fluid(&self, a: usize) -> bool {
        self.kind[a] == Kind::Fluid
    }

    /// Number of real particles of `kind`.
    pub fn count(&self, kind: Kind) -> usize {
        self.kind[..self.owned].iter().filter(|&&k| k == kind).count()
    }

    /// Largest smoothing length, m; 0 for an empty set.
    pub fn h_max(&self) -> f64 {
        extreme(&self.h[..self.owned], 0.0, |h, most| h > most)
    }

    /// Smallest smoothing length, m; infinite for an empty set.
    pub fn h_min(&self) -> f64 {
        extreme(&self.h[..self.owned], f64::INFINITY, |h, least| h < least)
    }

    /// The volume `m/ρ` of particle `a`, m³ (m² in 2D).
    #[inline(always)]
    pub fn volume(&self, a: usize) -> f64 {
        self.mass[a] / self.density[a]
    }

    /// Makes this a copy of `other`, column by column in parallel.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.owned = other.owned;
        rayon::scope(|scope| {
            macro_rules! copy {
                ($column:ident) => {{
                    let (to, from) = (&mut self.$column, &other.$column);
                    scope.spawn(move |_| to.clone_from(from));
                }};
            }
            copy!(id);
            copy!(kind);
            copy!(layer);
            copy!(x);
            copy!(v);
            copy!(mass);
            copy!(density);
            copy!(pressure);
            copy!(h);
            copy!(acceleration);
            copy!(density_rate);
            copy!(surface);
            copy!(body);
            copy!(force);
        });
    }

    /// Puts the real particles into another order. Drops all ghosts.
    pub(crate) fn reorder(&mut self, order: &Order) {
        self.drop_ghosts();
        let p = self;
        rayon::scope(move |scope| {
            macro_rules! reorder {
                ($column:expr) => {{
                    let column = &mut $column;
                    scope.spawn(move |_| order.apply(column));
                }};
            }
            each_column!(p, reorder);
        });
    }

    /// Drops all ghosts.
    pub(crate) fn drop_ghosts(&mut self) {
        let owned = self.owned;
        macro_rules! cut {
            ($column:expr) => {
                $column.truncate(owned)
            };
        }
        each_column!(self, cut);
    }

    /// Appends an image of row `parent`, moved by `shift`.
    pub(crate) fn push_ghost(&mut self, parent: usize, shift: Vector<D>) {
        macro_rules! copy {
            ($column:expr) => {{
                let value = $column[parent];
                $column.push(value);
            }};
        }
        each_column!(&mut *self, copy);
        let last = self.x.len() - 1;
        self.x[last] += shift;
    }
}

/// Another order of rows: the one in row `rows[a]` comes to row `a`.
pub(crate) struct Order<'a> {
    rows: &'a [u32],
    /// A row of each cycle that moves.
    cycles: Vec<u32>,
}

impl<'a> Order<'a> {
    /// `rows` names each row once.
    pub(crate) fn new(rows: &'a [u32]) -> Self {
        let (mut seen, mut cycles) = (vec![false; rows.len()], Vec::new());
        for first in 0..rows.len() as u32 {
            if seen[first as usize] || rows[first as usize] == first {
                continue;
            }
            cycles.push(first);
            let mut row = first;
            while !std::mem::replace(&mut seen[row as usize], true) {
                row = rows[row as usize];
            }
        }
        Self { rows, cycles }
    }

    /// Puts a column into this order, in its own place.
    pub(crate) fn apply<T: Copy>(&self, column: &mut [T]) {
        for &first in &self.cycles {
            let (kept, mut row) = (column[first as usize], first);
            while self.rows[row as usize] != first {
                let next = self.rows[row as usize];
                column[row as usize] = column[next as usize];
                row = next;
            }
            column[row as usize] = kept;
        }
    }
}

/// The value of a field for one particle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldValue<const D: usize> {
    /// A number.
    Scalar(f64),
    /// A vector.
    Vector(Vector<D>),
    /// A whole number: identities.
    Integer(u32),
    /// A small whole number: kinds and flags.
    Flag(u8),
}

/// A row of the field table: what a user may name in `output.fields`.
pub struct Field<const D: usize> {
    /// Name in cases, files and reports.
    pub name: &'static str,
    /// SI unit; `1` for pure numbers.
    pub unit: &'static str,
    /// What it is, in one line.
    pub text: &'static str,
    /// Reads it for one particle.
    pub value: fn(&Particles<D>, usize) -> FieldValue<D>,
}

/// Names, units and meanings of all fields, in the order they are listed to users.
pub fn field_table<const D: usize>() -> [Field<D>; 15] {
    use FieldValue::{Flag, Integer, Scalar, Vector as Components};
    let depth = if D == 2 { "kg/m" } else { "kg" };
    let newton = if D == 2 { "N/m" } else { "N" };
    macro_rules! field {
        ($name:literal, $unit:expr, $text:literal, $value:expr) => {
            Field { name: $name, unit: $unit, text: $text, value: $value }
        };
    }
    [
        field!("position", "m", "where the particle is", |p, a| Components(p.x[a])),
        field!("velocity", "m/s", "velocity", |p, a| Components(p.v[a])),
        field!("density", "kg/m3", "density", |p, a| Scalar(p.density[a])),
        field!("pressure", "Pa", "pressure", |p, a| Scalar(p.pressure[a])),
        field!("kind", "1", "0 fluid, 1 wall, 2 lost: left the domain", |p, a| Flag(p.kind[a] as u8)),
        field!("id", "1", "name of the particle, kept for the whole run", |p, a| Integer(p.id[a])),
        field!("mass", depth, "mass (per metre of depth in 2D)", |p, a| Scalar(p.mass[a])),
        field!("smoothing_length", "m", "smoothing length h", |p, a| Scalar(p.h[a])),
        field!("volume", if D == 2 { "m2" } else { "m3" }, "mass over density", |p, a| Scalar(p.volume(a))),
        field!("acceleration", "m/s2", "acceleration of the last evaluation", |p, a| Components(p.acceleration[a])),
        field!("density_rate", "kg/(m3 s)", "rate of change of density of the last evaluation", |p, a| Scalar(p.density_rate[a])),
        field!("surface", "1", "1 where the method sees a free surface", |p, a| Flag(p.surface[a])),
        field!("layer", "1", "line of a wall particle, 1 touches the fluid; 0 for fluid", |p, a| Flag(p.layer[a])),
        field!("body", "1", "number of the wall shape in the case, from 1; 0 for fluid", |p, a| Integer(u32::from(p.body[a]))),
        field!("force", newton, "force of the fluid on a wall particle, mean over the last step", |p, a| Components(p.force[a])),
    ]
}

/// The number that `beats` all others and `start`; eight at a time, since every step asks for it.
fn extreme(numbers: &[f64], start: f64, beats: impl Fn(f64, f64) -> bool) -> f64 {
    let better = |best: f64, number: f64| if beats(number, best) { number } else { best };
    let (eights, rest) = numbers.as_chunks::<8>();
    let mut best = [start; 8];
    for eight in eights {
        for (best, &number) in best.iter_mut().zip(eight) {
            *best = better(*best, number);
        }
    }
    best.iter().chain(rest).copied().fold(start, better)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extremes_of_smoothing_lengths_are_found_wherever_they_stand() {
        for n in [0, 1, 7, 8, 9, 27] {
            for place in 0..n {
                let numbers: Vec<f64> = (0..n).map(|i| if i == place { 1.0 } else { 2.0 + f64::from(i) }).collect();
                assert_eq!(extreme(&numbers, f64::INFINITY, |h, least| h < least), 1.0);
                let negative: Vec<f64> = numbers.iter().map(|h| 9.0 - h).collect();
                assert_eq!(extreme(&negative, 0.0, |h, most| h > most), 8.0);
            }
        }
        assert_eq!(Particles::<2>::new().h_max(), 0.0);
        assert_eq!(Particles::<2>::new().h_min(), f64::INFINITY);
    }

    fn particle(x: f64) -> Particle<2> {
        Particle { kind: Kind::Fluid, layer: 0, x: Vector([x, 0.0]), v: Vector::ZERO, mass: 2.0, density: 1000.0, pressure: 0.0, h: 0.1 }
    }

    #[test]
    fn ghosts_come_and_go_without_touching_real_particles() {
        let mut p = Particles::new();
        p.push(7, particle(0.0));
        p.push(8, particle(1.0));
        let before = p.clone();
        p.push_ghost(1, Vector([-2.0, 0.0]));
        assert_eq!((p.owned(), p.len()), (2, 3));
        assert_eq!((p.x[2], p.id[2]), (Vector([-1.0, 0.0]), 8));
        p.drop_ghosts();
        assert_eq!(p, before);
    }

    #[test]
    fn an_order_takes_every_column_along() {
        let mut p = Particles::new();
        for id in 0..3 {
            p.push(id, Particle { mass: f64::from(id), ..particle(f64::from(id)) });
        }
        p.push_ghost(0, Vector([9.0, 0.0]));
        p.reorder(&Order::new(&[2, 0, 1]));
        assert_eq!((p.owned(), p.len()), (3, 3));
        let mut copy = Particles::new();
        copy.copy_from(&p);
        assert_eq!(copy, p);
        assert_eq!((p.id, p.mass), (vec![2, 0, 1], vec![2.0, 0.0, 1.0]));
    }

    #[test]
    fn field_names_are_unique() {
        let table = field_table::<3>();
        for (i, field) in table.iter().enumerate() {
            assert!(table[..i].iter().all(|other| other.name != field.name), "{} twice", field.name);
        }
    }
}
