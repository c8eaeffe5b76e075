//! What is found about particles once a step, what shifting does to them, and what sound changes.

use crate::lanes::{LANES, Lanes, Record};
use crate::math::Vector;
use crate::physics::damping::Stretches;
use crate::physics::state::EquationOfState;
use crate::physics::viscosity::Tensor;

/// Where a particle is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Fluid out of reach of the free surface.
    Inside,
    /// Fluid within reach of a particle of the free surface.
    Near,
    /// Fluid on the free surface.
    Surface,
    /// Fluid that lacks more neighbours than a surface explains, in drops, threads and foam.
    Foam,
    /// The same, where a neighbour is or comes closer than a spacing within the step.
    Clash,
    /// A wall with fluid in reach.
    Wet,
    /// A wall without, or nobody.
    Dry,
}

/// What shifting does to a particle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shift<const D: usize> {
    /// The move, m.
    pub by: Vector<D>,
    /// Change of density that goes with it, kg/m³.
    pub change: f64,
    /// Rate of density that draws dilated fluid together, kg/(m³ s).
    pub pull: f64,
    /// Least pressure that the fluid bears, Pa.
    pub least: f64,
    /// What its pressure counts for in forces, dimensionless.
    pub weight: f64,
}

impl<const D: usize> Shift<D> {
    pub const NONE: Self = Self { by: Vector::ZERO, change: 0.0, pull: 0.0, least: f64::NEG_INFINITY, weight: 1.0 };

    /// As a record: between two steps those of `middle` hold nothing else.
    pub fn to_record(self) -> Record {
        let mut fields = [0.0; LANES];
        fields[..D].copy_from_slice(&self.by.0);
        [fields[D], fields[D + 1], fields[D + 2], fields[D + 3]] = [self.change, self.pull, self.least, self.weight];
        Record(fields)
    }

    pub fn from_record(record: &Record) -> Self {
        let [change, pull, least, weight] = [record.0[D], record.0[D + 1], record.0[D + 2], record.0[D + 3]];
        Self { by: record.x(), change, pull, least, weight }
    }
}

/// What is found about a particle once a step, in single precision, which is plenty. Of fluid: the symmetric part of the gradient of velocity, the entries
/// on the diagonal and right of it row by row, and behind them the surface weight, zero in foam and −1 where foam clashes. Of walls: the normal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finding<const D: usize>([[f32; D]; D]);

impl<const D: usize> Finding<D> {
    pub const NOTHING: Self = Self([[0.0; D]; D]);

    /// Where the surface weight stands, behind the entries of a symmetric tensor.
    pub const WEIGHT: usize = D * (D + 1) / 2;

    /// Of fluid around which velocities change as `gradient`, 1/s, and whose pressure counts for `weight` in forces, zero in foam and −1 where foam clashes.
    #[inline(always)]
    pub fn of_fluid(gradient: &Tensor<D>, weight: f64) -> Self {
        let mut found = Self::NOTHING;
        let numbers = found.0.as_flattened_mut();
        for i in 0..D {
            for j in i..D {
                numbers[Self::place(i, j)] = (0.5 * (gradient[i][j] + gradient[j][i])) as f32;
            }
        }
        numbers[Self::WEIGHT] = weight as f32;
        found
    }

    /// Of a wall that looks along `normal`.
    #[inline(always)]
    pub fn of_wall(normal: Vector<D>) -> Self {
        let mut found = Self::NOTHING;
        found.0[0] = normal.0.map(|n| n as f32);
        found
    }

    /// Where entry `i`, `j >= i` of a symmetric tensor stands.
    #[inline(always)]
    pub const fn place(i: usize, j: usize) -> usize {
        i * (2 * D - i - 1) / 2 + j
    }

    /// Entry `i`, `j >= i` of the symmetric part of the gradient of velocity, 1/s.
    #[inline(always)]
    pub fn stretch(&self, i: usize, j: usize) -> f64 {
        f64::from(self.0.as_flattened()[Self::place(i, j)])
    }

    /// `√(S:S)` of that part, 1/s.
    #[inline(always)]
    pub fn strain_rate(&self) -> f64 {
        let entries = (0..D).flat_map(|i| (i..D).map(move |j| (i, j)));
        entries.map(|(i, j)| if i == j { 1.0 } else { 2.0 } * self.stretch(i, j) * self.stretch(i, j)).sum::<f64>().sqrt()
    }

    #[inline(always)]
    pub fn weight(&self) -> f64 {
        f64::from(self.0.as_flattened()[Self::WEIGHT])
    }

    /// Where foam is, none for other fluid.
    #[inline(always)]
    pub fn foam(&self) -> Option<Place> {
        let weight = self.weight();
        (weight <= 0.0).then_some(if weight == 0.0 { Place::Foam } else { Place::Clash })
    }

    #[inline(always)]
    pub fn normal(&self) -> Vector<D> {
        Vector(self.0[0].map(f64::from))
    }
}

impl<const D: usize> Stretches<D> for [Finding<D>] {
    #[inline(always)]
    fn of(&self, a: usize) -> [[f64; D]; D] {
        let mut own = [[0.0; D]; D];
        for i in 0..D {
            for j in i..D {
                own[i][j] = self[a].stretch(i, j);
            }
        }
        own
    }

    /// Four numbers at a time; in space, two of them twice.
    #[inline(always)]
    fn of_lanes<L: Lanes>(&self, rows: &[u32]) -> [[L; D]; D] {
        let last = Finding::<D>::WEIGHT.saturating_sub(4);
        let (mut first_fours, mut last_fours) = ([&[0.0; 4]; LANES], [&[0.0; 4]; LANES]);
        for lane in 0..L::COUNT {
            let numbers = self[rows[lane] as usize].0.as_flattened();
            if let (Some(first), Some(last)) = (numbers.first_chunk(), numbers[last..].first_chunk()) {
                (first_fours[lane], last_fours[lane]) = (first, last);
            }
        }
        let (first_turned, last_turned) = (L::turn(first_fours), L::turn(last_fours));
        let mut lanes = [[L::splat(0.0); D]; D];
        for i in 0..D {
            for j in i..D {
                let place = Finding::<D>::place(i, j);
                lanes[i][j] = if place < 4 { first_turned[place] } else { last_turned[place - last] };
            }
        }
        lanes
    }
}

/// What sound changes in a particle of fluid, beside where it is and how it moves.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bulk {
    /// kg/m³.
    pub density: f64,
    /// Rate of density, kg/(m³ s).
    pub rate: f64,
    /// The part of it that is compression, `−ρ0 ∇·v`, kg/(m³ s).
    pub compression: f64,
    /// The part of it that draws dilated fluid together, kg/(m³ s).
    pub pull: f64,
    /// Least pressure, Pa: zero, or none.
    pub least: f32,
    /// What its pressure counts for in forces, and its compression in the rate of density, dimensionless: more than one in the row at the surface.
    pub weight: f32,
}

impl Bulk {
    /// The pressure of the density, Pa, as far as the fluid bears it.
    #[inline(always)]
    pub fn pressure(&self, state: &EquationOfState) -> f64 {
        state.pressure(self.density).max(f64::from(self.least))
    }

    /// What that pressure counts for in forces, Pa.
    #[inline(always)]
    pub fn pressing(&self, state: &EquationOfState) -> f64 {
        f64::from(self.weight) * self.pressure(state)
    }
}
