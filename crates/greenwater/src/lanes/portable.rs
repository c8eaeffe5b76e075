//! Vectors without instructions of one machine.

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::singles::WIDE;
use super::{LANES, Lanes, Listed, Real};

/// Vectors as arrays: what the compiler makes of them on any machine. Two numbers are a register of SSE2 and of NEON.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Portable(pub(super) [f64; 2]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

operators!(Portable);

impl Real for Portable {
    type Mask = [bool; 2];

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x; 2])
    }

    #[inline(always)]
    fn root(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].mul_add(factor.0[i], term.0[i])))
    }

    #[inline(always)]
    fn size(self) -> Self {
        Self(self.0.map(f64::abs))
    }

    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        self.zip(other, Real::at_least)
    }

    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        self.zip(other, Real::at_most)
    }

    #[inline(always)]
    fn below(self, other: Self) -> [bool; 2] {
        std::array::from_fn(|i| self.0[i] < other.0[i])
    }

    #[inline(always)]
    fn choose(mask: [bool; 2], yes: Self, no: Self) -> Self {
        Self(std::array::from_fn(|i| if mask[i] { yes.0[i] } else { no.0[i] }))
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f64) -> f64) -> Self {
        Self(self.0.map(f))
    }
}

impl Lanes for Portable {
    type Singles = [f32; WIDE];
    const COUNT: usize = 2;

    #[inline(always)]
    fn from_array([a, b, ..]: [f64; LANES]) -> Self {
        Self([a, b])
    }

    #[inline(always)]
    fn to_array(self) -> [f64; LANES] {
        let [a, b] = self.0;
        [a, b, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    }

    #[inline(always)]
    fn gather(listed: Listed<'_>) -> [Self; LANES] {
        let of = listed.exactly().map(|row| &listed.records[row as usize].0);
        std::array::from_fn(|field| Self(of.map(|record| record[field])))
    }

    #[inline(always)]
    fn turn([a, b, ..]: [&[f32; 4]; LANES]) -> [Self; 4] {
        std::array::from_fn(|i| Self([f64::from(a[i]), f64::from(b[i])]))
    }

    #[inline(always)]
    fn total(self) -> f64 {
        let [a, b] = self.0;
        a + b
    }
}
