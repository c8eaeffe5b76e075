//! Small vectors of the space the flow lives in.

use std::ops::{Add, AddAssign, Div, Index, IndexMut, Mul, Neg, Sub, SubAssign};

use serde::{Deserialize, Serialize};

use crate::lanes::Real;

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

/// A square matrix; row `i` is `m[i]`.
pub type Matrix<const D: usize> = [Vector<D>; D];

/// Number of the cube of edge `edge` that holds `x`, counted from `low`; one number for each cube. Axes share 64 bits: clouds wider than
/// that end in the last cube of an axis.
pub fn cube_number<const D: usize>(x: Vector<D>, low: Vector<D>, edge: f64) -> u64 {
    let most = f64::from((1u32 << (63 / D as u32).min(31)) - 1);
    (0..D).fold(0, |number, d| (number << (63 / D)) | ((x[d] - low[d]) / edge).min(most) as u64)
}

/// `M v`.
#[inline(always)]
pub fn transform<const D: usize>(m: &Matrix<D>, v: Vector<D>) -> Vector<D> {
    Vector(std::array::from_fn(|i| m[i].dot(v)))
}

/// The identity matrix.
pub fn identity<const D: usize>() -> Matrix<D> {
    std::array::from_fn(Vector::unit)
}

/// The inverse of `m` by cofactors, in one to three dimensions; `None` where the determinant is below 1e-9 of what entries of that
/// size can make, beyond which nothing but rounding is left of the gradients that are corrected with it.
pub fn inverse<const D: usize>(m: &Matrix<D>) -> Option<Matrix<D>> {
    let size = m.iter().flat_map(|row| row.0).fold(0.0, |most: f64, entry| most.max(entry.abs()));
    // Cofactor of entry (i, j), signs included.
    let cofactor = |i: usize, j: usize| match D {
        1 => 1.0,
        2 => {
            let sign = if i == j { 1.0 } else { -1.0 };
            sign * m[1 - i][1 - j]
        }
        _ => {
            let (i1, i2, j1, j2) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
            m[i1][j1] * m[i2][j2] - m[i1][j2] * m[i2][j1]
        }
    };
    let determinant: f64 = (0..D).map(|j| m[0][j] * cofactor(0, j)).sum();
    let scale = (0..D).fold(1.0, |product, _| product * size);
    if determinant.is_nan() || determinant.abs() <= 1e-9 * scale {
        return None;
    }
    Some(std::array::from_fn(|i| Vector(std::array::from_fn(|j| cofactor(j, i) / determinant))))
}

/// The smallest eigenvalue of the symmetric matrix `m` in one to three dimensions, in closed form (Smith 1961 for three).
pub fn smallest_eigenvalue<const D: usize>(m: &Matrix<D>) -> f64 {
    let trace: f64 = (0..D).map(|i| m[i][i]).sum();
    let mean = trace / D as f64;
    let mut deviation = *m;
    for i in 0..D {
        deviation[i][i] -= mean;
    }
    // Half the square of the deviation's norm is (l1 - mean)² in 2D; a sixth of it is the square of the radius in 3D.
    let square: f64 = deviation.iter().map(|row| row.norm_squared()).sum();
    match D {
        1 => mean,
        2 => mean - (0.5 * square).sqrt(),
        _ => {
            let radius = (square / 6.0).sqrt();
            if radius <= 1e-12 * mean.abs() {
                return mean;
            }
            let b = deviation.map(|row| row / radius);
            let half_determinant = 0.5
                * (b[0][0] * (b[1][1] * b[2][2] - b[1][2] * b[2][1]) - b[0][1] * (b[1][0] * b[2][2] - b[1][2] * b[2][0])
                    + b[0][2] * (b[1][0] * b[2][1] - b[1][1] * b[2][0]));
            let angle = half_determinant.clamp(-1.0, 1.0).acos() / 3.0;
            mean + 2.0 * radius * (angle + 2.0 * std::f64::consts::PI / 3.0).cos()
        }
    }
}

/// The cube of `x`, as products (`powi` may round differently from build to build).
#[inline(always)]
pub(crate) fn cube<L: Real>(x: L) -> L {
    x * x * x
}

/// `x` to the whole power `n >= 0`, as products in a fixed order.
#[inline(always)]
pub(crate) fn power<L: Real>(x: L, n: u32) -> L {
    let (mut result, mut base, mut left) = (L::splat(1.0), x, n);
    while left > 0 {
        if left & 1 == 1 {
            result = result * base;
        }
        base = base * base;
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

    /// Each matrix is `R diag R^T` with a known rotation, so its eigenvalues are the entries of the diagonal.
    #[test]
    fn the_smallest_eigenvalue_of_a_turned_diagonal_is_its_smallest_entry() {
        let (c, s) = (0.6, 0.8);
        let flat = [Vector([2.0 * c * c + 5.0 * s * s, -3.0 * c * s]), Vector([-3.0 * c * s, 2.0 * s * s + 5.0 * c * c])];
        assert!((smallest_eigenvalue(&flat) - 2.0).abs() < 1e-14);
        for (third, smallest) in [(7.0, 2.0), (0.25, 0.25), (2.0, 2.0), (-1.0, -1.0)] {
            let solid = [Vector([flat[0][0], flat[0][1], 0.0]), Vector([flat[1][0], flat[1][1], 0.0]), Vector([0.0, 0.0, third])];
            // 1e-7: the root of a double eigenvalue loses half the digits.
            assert!((smallest_eigenvalue(&solid) - smallest).abs() < 1e-7, "{third}");
        }
        assert_eq!(smallest_eigenvalue(&identity::<3>()), 1.0);
    }

    #[test]
    fn a_matrix_times_its_inverse_is_the_identity() {
        fn check<const D: usize>(m: Matrix<D>) {
            let inverse = inverse(&m).unwrap();
            for i in 0..D {
                let column = transform(&m, transform(&inverse, Vector::unit(i)));
                // 1e-14: a handful of products of numbers of order one.
                assert!((column - Vector::unit(i)).norm() < 1e-14, "{column:?}");
            }
        }
        check([Vector([3.0])]);
        check([Vector([2.0, 1.0]), Vector([-1.0, 3.0])]);
        check([Vector([2.0, 1.0, 0.5]), Vector([-1.0, 3.0, 0.25]), Vector([0.0, 1.0, 4.0])]);
        assert_eq!(inverse(&[Vector([1.0, 2.0]), Vector([2.0, 4.0])]), None);
        assert_eq!(inverse(&[Vector::<3>::ZERO; 3]), None);
    }

    #[test]
    fn whole_powers_are_products() {
        assert_eq!(power(1.5, 0), 1.0);
        assert_eq!(power(2.0, 12), 4096.0);
        assert_eq!(power(3.0, 7), 2187.0);
        assert_eq!(cube(3.0), 27.0);
    }
}
