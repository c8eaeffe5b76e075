//! Small vectors of the space the flow lives in.

use std::ops::{Add, AddAssign, Div, Index, IndexMut, Mul, Neg, Sub, SubAssign};

use serde::{Deserialize, Serialize};

/// A vector in `D` dimensions; component `d` is `v[d]`.
///
/// Its unit is that of the quantity it holds. Serialised as a plain list of `D` numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub struct Vector<const D: usize>(pub [f64; D]);

impl<const D: usize> Vector<D> {
    /// The zero vector.
    pub const ZERO: Self = Self([0.0; D]);

    /// The vector whose every component is `value`.
    pub const fn splat(value: f64) -> Self {
        Self([value; D])
    }

    /// The unit vector along `axis` (`0..D`).
    pub fn unit(axis: usize) -> Self {
        let mut e = Self::ZERO;
        e[axis] = 1.0;
        e
    }

    /// The scalar product `a · b`.
    #[inline(always)]
    pub fn dot(self, other: Self) -> f64 {
        let mut sum = self.0[0] * other.0[0];
        for d in 1..D {
            sum += self.0[d] * other.0[d];
        }
        sum
    }

    /// `a · a`.
    #[inline(always)]
    pub fn norm_squared(self) -> f64 {
        self.dot(self)
    }

    /// The length `|a|`.
    #[inline(always)]
    pub fn norm(self) -> f64 {
        self.norm_squared().sqrt()
    }

    /// Component by component `f(a, b)`.
    #[inline(always)]
    pub fn zip(self, other: Self, mut f: impl FnMut(f64, f64) -> f64) -> Self {
        Self(std::array::from_fn(|d| f(self.0[d], other.0[d])))
    }

    /// Component by component `f(a)`.
    #[inline(always)]
    pub fn map(self, f: impl FnMut(f64) -> f64) -> Self {
        Self(self.0.map(f))
    }

    /// Whether no component is NaN or infinite.
    #[inline]
    pub fn is_finite(self) -> bool {
        self.0.iter().all(|c| c.is_finite())
    }
}

impl<const D: usize> Default for Vector<D> {
    fn default() -> Self {
        Self::ZERO
    }
}

impl<const D: usize> From<[f64; D]> for Vector<D> {
    fn from(components: [f64; D]) -> Self {
        Self(components)
    }
}

impl<const D: usize> Index<usize> for Vector<D> {
    type Output = f64;
    #[inline(always)]
    fn index(&self, axis: usize) -> &f64 {
        &self.0[axis]
    }
}

impl<const D: usize> IndexMut<usize> for Vector<D> {
    #[inline(always)]
    fn index_mut(&mut self, axis: usize) -> &mut f64 {
        &mut self.0[axis]
    }
}

impl<const D: usize> Add for Vector<D> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl<const D: usize> Sub for Vector<D> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl<const D: usize> AddAssign for Vector<D> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const D: usize> SubAssign for Vector<D> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl<const D: usize> Neg for Vector<D> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

impl<const D: usize> Mul<Vector<D>> for f64 {
    type Output = Vector<D>;
    #[inline(always)]
    fn mul(self, v: Vector<D>) -> Vector<D> {
        v.map(|a| self * a)
    }
}

impl<const D: usize> Div<f64> for Vector<D> {
    type Output = Self;
    #[inline(always)]
    fn div(self, divisor: f64) -> Self {
        self.map(|a| a / divisor)
    }
}

impl<const D: usize> Serialize for Vector<D> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.as_slice().serialize(serializer)
    }
}

impl<'de, const D: usize> Deserialize<'de> for Vector<D> {
    fn deserialize<T: serde::Deserializer<'de>>(deserializer: T) -> Result<Self, T::Error> {
        let components = Vec::<f64>::deserialize(deserializer)?;
        let found = components.len();
        <[f64; D]>::try_from(components)
            .map(Self)
            .map_err(|_| serde::de::Error::custom(format!("{found} numbers given, but this case has {D} dimensions")))
    }
}

/// The cube of `x`, as products (`powi` may round differently from build to build).
#[inline(always)]
pub(crate) fn cube(x: f64) -> f64 {
    x * x * x
}

/// `x` to the whole power `n >= 0`, as products in a fixed order.
#[inline]
pub(crate) fn power(x: f64, n: u32) -> f64 {
    let (mut result, mut base, mut left) = (1.0, x, n);
    while left > 0 {
        if left & 1 == 1 {
            result *= base;
        }
        base *= base;
        left >>= 1;
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_follow_the_rules_of_algebra() {
        let (a, b) = (Vector([1.0, 2.0, 3.0]), Vector([4.0, -5.0, 6.0]));
        assert_eq!(a + b, Vector([5.0, -3.0, 9.0]));
        assert_eq!(a - b, -(b - a));
        assert_eq!(a.dot(b), 12.0);
        assert_eq!((2.0 * a) / 2.0, a);
        assert_eq!(Vector([3.0, 4.0]).norm(), 5.0);
    }

    #[test]
    fn whole_powers_are_products() {
        assert_eq!(power(1.5, 0), 1.0);
        assert_eq!(power(2.0, 12), 4096.0);
        assert_eq!(power(3.0, 7), 2187.0);
        assert_eq!(cube(3.0), 27.0);
    }
}
