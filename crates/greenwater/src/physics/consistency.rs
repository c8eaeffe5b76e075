//! Kernels that reproduce linear fields, and what is made of them: interpolants by moving least squares and new densities.
//!
//! `W^R_ab = W_ab p(0)ᵀ M_a⁻¹ p(x_b − x_a)` with `p(y) = (1, y)` and `M_a = Σ_b V_b p(x_b − x_a) p(x_b − x_a)ᵀ W_ab`, `a` itself
//! included, so that `Σ_b V_b W^R_ab f_b = f(x_a)` for every linear `f`, whatever the arrangement. The reproducing kernel of Liu,
//! Jun & Zhang, Int. J. Numer. Meth. Fluids 20 (1995) 1081, and the interpolant `V_b W^R_ab` of Dilts, Int. J. Numer. Meth. Eng.
//! 44 (1999) 1115, are this one object.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kernel::Kernel;
use crate::math::{Matrix, Vector, inverse, transform};
use crate::neighbors::Neighbors;
use crate::particles::Particles;

/// Least share `S/M_0` of `S = M_0 − M_1·M_2⁻¹M_1` in `M_0 = Σ V W` for a linear fit: `M_0/S` is how much more a particle weighs in
/// the fit than in the mean, and how much its noise grows. On the lattices in use the share is 1 inside the fluid, 0.68 and more at a
/// flat surface, 0.52 in the corner of a square, 0.41 in that of a cube. Below 0.3 there is less fluid around than in any corner, and
/// the fit is an extrapolation.
const LEAST_SHARE: f64 = 0.3;

/// Least `det M_2` over that of a neighbourhood as wide in every direction: below, neighbours lie in a line (in 3D a sheet) but for
/// a fortieth of their spread, and there is no slope across it.
const LEAST_WIDTH: f64 = 0.1;

/// Share `S/M_0` above which a particle has neighbours all around. The first row under a flat surface of the lattices in use has
/// 0.68 to 0.74, the second 0.997 and more: half-way.
const ALL_AROUND: f64 = 0.85;

/// Moments of the neighbours of a particle and of itself, with `y = x_b − x_a`.
#[derive(Clone, Copy, Debug)]
pub struct Moments<const D: usize> {
    /// `M_0 = Σ V W`, dimensionless.
    zeroth: f64,
    /// `M_1 = Σ V W y`, m.
    first: Vector<D>,
    /// `M_2 = Σ V W y yᵀ`, m².
    second: Matrix<D>,
    /// Whether there is a neighbour.
    seen: bool,
}

/// What a linear fit is made of: `M_2⁻¹`, `B = −M_2⁻¹ M_1` and `S = M_0 + M_1·B`.
#[derive(Clone, Copy, Debug)]
struct Solved<const D: usize> {
    inverse: Matrix<D>,
    slope: Vector<D>,
    schur: f64,
}

impl<const D: usize> Moments<D> {
    /// A particle of which nothing is known but itself: `own = V_a W(0)`, dimensionless.
    pub fn alone(own: f64) -> Self {
        Self { zeroth: own, first: Vector::ZERO, second: [Vector::ZERO; D], seen: false }
    }

    /// Adds a neighbour at `y`, m, with `weight = V_b W_ab`, dimensionless.
    #[inline(always)]
    pub fn add(&mut self, y: Vector<D>, weight: f64) {
        self.zeroth += weight;
        self.first += weight * y;
        for (row, along) in self.second.iter_mut().zip(y.0) {
            *row += weight * along * y;
        }
        self.seen |= weight > 0.0;
    }

    /// The linear fit; `None` where `M` is ill-conditioned: see [`fit`](Self::fit).
    fn solve(&self) -> Option<Solved<D>> {
        let mean = (0..D).map(|d| self.second[d][d]).sum::<f64>() / D as f64;
        let inverse = inverse(&self.second)?;
        // The determinant of the inverse in units of the mean width: its greatest allowed value is 1/LEAST_WIDTH.
        let scaled = inverse.map(|row| mean * row);
        if determinant(&scaled) > 1.0 / LEAST_WIDTH {
            return None;
        }
        let slope = -transform(&inverse, self.first);
        let schur = self.zeroth + self.first.dot(slope);
        (schur >= LEAST_SHARE * self.zeroth).then_some(Solved { inverse, slope, schur })
    }

    /// The weights of the neighbours: linear where `S >= 0.3 M_0` and `det M_2 >= (tr M_2/D)ᴰ/10`, else Shepard's mean; nothing for
    /// a particle alone.
    pub fn fit(&self) -> Fit<D> {
        match self.solve() {
            Some(s) => Fit { constant: 1.0 / s.schur, slope: s.slope / s.schur },
            None => self.mean(),
        }
    }

    /// Shepard's mean: `W/Σ V W`; nothing for a particle alone.
    pub fn mean(&self) -> Fit<D> {
        if self.seen { Fit { constant: 1.0 / self.zeroth, slope: Vector::ZERO } } else { Fit::NONE }
    }

    /// Whether there are neighbours all around: `S/M_0 >= 0.85`.
    pub fn all_around(&self) -> bool {
        self.solve().is_some_and(|s| s.schur >= ALL_AROUND * self.zeroth)
    }
}

/// The determinant of a matrix in one to three dimensions.
fn determinant<const D: usize>(m: &Matrix<D>) -> f64 {
    match D {
        1 => m[0][0],
        2 => m[0][0] * m[1][1] - m[0][1] * m[1][0],
        _ => {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        }
    }
}

/// A corrected kernel at one particle: `W^R_ab = (constant + slope·y) W_ab`, `y = x_b − x_a`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit<const D: usize> {
    /// Dimensionless.
    pub constant: f64,
    /// 1/m.
    pub slope: Vector<D>,
}

impl<const D: usize> Fit<D> {
    /// No weight at all.
    pub const NONE: Self = Self { constant: 0.0, slope: Vector::ZERO };

    /// `W^R_ab` from `W_ab = w`, m⁻ᴰ.
    #[inline(always)]
    pub fn weight(&self, y: Vector<D>, w: f64) -> f64 {
        (self.constant + self.slope.dot(y)) * w
    }
}

/// [`Moments`] with their derivatives along the position of the particle.
#[derive(Clone, Copy, Debug)]
pub struct MovingMoments<const D: usize> {
    moments: Moments<D>,
    /// `Σ V ∇W`, 1/m.
    zeroth: Vector<D>,
    /// `[i][k]`: `Σ V y_i ∂_k W`, dimensionless.
    first: Matrix<D>,
    /// `[i][j][k]`: `Σ V y_i y_j ∂_k W`, m.
    second: [Matrix<D>; D],
}

impl<const D: usize> MovingMoments<D> {
    /// A particle of which nothing is known but itself: `own = V_a W(0)`, dimensionless.
    pub fn alone(own: f64) -> Self {
        Self { moments: Moments::alone(own), zeroth: Vector::ZERO, first: [Vector::ZERO; D], second: [[Vector::ZERO; D]; D] }
    }

    /// Adds a neighbour at `y`, m, with `weight = V_b W_ab`, dimensionless, and `slope = V_b W'/r`, 1/m².
    #[inline(always)]
    pub fn add(&mut self, y: Vector<D>, weight: f64, slope: f64) {
        self.moments.add(y, weight);
        let grad = -slope * y;
        self.zeroth += grad;
        for i in 0..D {
            self.first[i] += y[i] * grad;
            for j in 0..D {
                self.second[i][j] += y[i] * y[j] * grad;
            }
        }
    }

    /// The corrected kernel with its gradient, by the rule of [`Moments::fit`].
    pub fn kernel(&self) -> LinearKernel<D> {
        let m = &self.moments;
        let Some(Solved { inverse, slope, schur }) = m.solve() else {
            let fit = m.mean();
            let along = -fit.constant * fit.constant * self.zeroth;
            return LinearKernel { fit, constant_along: along, slope_along: [Vector::ZERO; D] };
        };
        // y moves against the particle: ∂_k y_i = −δ_ik.
        let mut first = self.first;
        for (i, row) in first.iter_mut().enumerate() {
            row[i] -= m.zeroth;
        }
        // (∂_k M_2) B, [i][k]
        let mut bent = [Vector::ZERO; D];
        for (i, row) in bent.iter_mut().enumerate() {
            for j in 0..D {
                *row += slope[j] * self.second[i][j];
            }
            row[i] -= m.first.dot(slope);
            *row -= m.first[i] * slope;
        }
        // ∂_k S = ∂_k M_0 + 2 B·∂_k M_1 + B·(∂_k M_2) B
        let mut schur_along = self.zeroth;
        for i in 0..D {
            schur_along += slope[i] * (2.0 * first[i] + bent[i]);
        }
        // ∂_k B = −M_2⁻¹ (∂_k M_1 + (∂_k M_2) B)
        let mut slope_along = [Vector::ZERO; D];
        for (i, row) in slope_along.iter_mut().enumerate() {
            for j in 0..D {
                *row -= inverse[i][j] * (first[j] + bent[j]);
            }
            *row = *row / schur - slope[i] / (schur * schur) * schur_along;
        }
        LinearKernel {
            fit: Fit { constant: 1.0 / schur, slope: slope / schur },
            constant_along: -schur_along / (schur * schur),
            slope_along,
        }
    }
}

/// A corrected kernel at one particle that can be differentiated there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearKernel<const D: usize> {
    /// The kernel itself.
    pub fit: Fit<D>,
    /// `∂_k constant`, 1/m.
    constant_along: Vector<D>,
    /// `[i][k]`: `∂_k slope_i`, 1/m².
    slope_along: Matrix<D>,
}

impl<const D: usize> LinearKernel<D> {
    /// The kernel as it is, not corrected: what a particle has whose neighbourhood goes on where there are no particles.
    pub const PLAIN: Self =
        Self { fit: Fit { constant: 1.0, slope: Vector::ZERO }, constant_along: Vector::ZERO, slope_along: [Vector::ZERO; D] };

    /// `∇_a W^R_ab`, m⁻ᴰ⁻¹, from `W_ab = w`, m⁻ᴰ, and `W'/r = dw`, m⁻ᴰ⁻²; `y = x_b − x_a`, m.
    #[inline(always)]
    pub fn gradient(&self, y: Vector<D>, w: f64, dw: f64) -> Vector<D> {
        let mut change = self.constant_along - self.fit.slope;
        for i in 0..D {
            change += y[i] * self.slope_along[i];
        }
        w * change - dw * (self.fit.constant + self.fit.slope.dot(y)) * y
    }
}

/// Where new densities come from, every so many steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DensityReset {
    /// Densities stay as the continuity equation makes them.
    None,
    /// The mean `Σ m W/Σ (m/ρ) W` of the neighbourhood (Shepard): levels the pressure of liquid at rest, too.
    Shepard,
    /// `Σ m W^R`, moving least squares (Colagrossi & Landrini 2003): keeps linear densities. Particles that do not have fluid all
    /// around keep their density, since a fit at the rim makes mass.
    Mls,
}

impl DensityReset {
    /// In words, for reports.
    pub(crate) fn words(self, every: u64) -> String {
        match self {
            Self::None => String::new(),
            Self::Shepard => format!(", the mean of the neighbourhood every {every} steps"),
            Self::Mls => format!(", fitted by moving least squares every {every} steps"),
        }
    }
}

/// The new density of the fluid particle `a`, kg/m³, from the fluid near it: `Σ_b m_b W^R_ab` with the volumes `m_b/ρ_b` (Colagrossi
/// & Landrini, J. Comput. Phys. 191 (2003) 448). Walls have no density of their own: the row along a wall is a rim,
/// too. A fit there would extrapolate, and an impact would find densities that nothing made.
pub fn new_density<K: Kernel<D>, const D: usize>(kernel: K, near: &Neighbors<D>, p: &Particles<D>, reset: DensityReset, a: usize) -> f64 {
    if reset == DensityReset::None {
        return p.density[a];
    }
    let own = kernel.w(0.0, near.h(a));
    let mut fluid = Moments::alone(p.volume(a) * own);
    near.for_each(a, |pair| {
        if p.is_fluid(pair.b) {
            fluid.add(-pair.x_ab, p.volume(pair.b) * kernel.w(pair.r, pair.h));
        }
    });
    let fit = match reset {
        DensityReset::Mls if fluid.all_around() => fluid.fit(),
        DensityReset::Shepard => fluid.mean(),
        DensityReset::None | DensityReset::Mls => return p.density[a],
    };
    if fit == Fit::NONE {
        return p.density[a];
    }
    let mut density = p.mass[a] * fit.weight(Vector::ZERO, own);
    near.for_each(a, |pair| {
        if p.is_fluid(pair.b) {
            density += p.mass[pair.b] * fit.weight(-pair.x_ab, kernel.w(pair.r, pair.h));
        }
    });
    density
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{CubicSpline, WendlandC2};
    use crate::neighbors::Search;
    use crate::particles::{Kind, Particle};

    /// A block of `n` cells of edge 1 a side, jittered by a fifth of them, with volumes that differ by as much.
    fn block<const D: usize>(n: i64) -> Vec<(Vector<D>, f64)> {
        let mut state = 12345_u64;
        let mut random = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        (0..(0..D).fold(1, |points, _| points * n))
            .map(|mut i| {
                let x = Vector(std::array::from_fn(|_| {
                    let along = (i % n) as f64 + 0.2 * random();
                    i /= n;
                    along
                }));
                (x, 1.0 + 0.2 * random())
            })
            .collect()
    }

    const H: f64 = 1.5;

    /// `W` and `W'/r` at the distance `r`.
    fn values<const D: usize>(r: f64) -> (f64, f64) {
        (Kernel::<D>::w(WendlandC2, r, H), Kernel::<D>::dw_over_r(WendlandC2, r, H))
    }

    fn kernel_at<const D: usize>(points: &[(Vector<D>, f64)], x: Vector<D>) -> LinearKernel<D> {
        let mut moments = MovingMoments::alone(0.0);
        for &(x_b, volume) in points {
            let (w, dw) = values::<D>((x - x_b).norm());
            moments.add(x_b - x, volume * w, volume * dw);
        }
        moments.kernel()
    }

    /// Corners and faces of the block included. 1e-12: sums of up to 250 terms with factors of some units.
    fn patch<const D: usize>(n: i64) {
        let points = block::<D>(n);
        let slope = Vector::<D>(std::array::from_fn(|d| 0.7 - d as f64));
        let field = |x: Vector<D>| 3.0 + slope.dot(x);
        for &(x, _) in &points {
            let kernel = kernel_at(&points, x);
            let (mut one, mut value, mut zero, mut gradient) = (0.0, 0.0, Vector::ZERO, [Vector::ZERO; D]);
            for &(x_b, volume) in &points {
                let y = x_b - x;
                let (w, dw) = values::<D>(y.norm());
                let grad = kernel.gradient(y, volume * w, volume * dw);
                one += volume * kernel.fit.weight(y, w);
                value += volume * kernel.fit.weight(y, w) * field(x_b);
                zero += grad;
                for d in 0..D {
                    gradient[d] += x_b[d] * grad;
                }
            }
            assert!((one - 1.0).abs() < 1e-12, "sum of weights {one} at {x:?}");
            assert!((value - field(x)).abs() < 1e-12 * (1.0 + x.norm()), "{value} for {} at {x:?}", field(x));
            assert!(zero.norm() < 1e-12, "gradient of a constant {zero:?} at {x:?}");
            for (d, row) in gradient.iter().enumerate() {
                let error = (*row - Vector::unit(d)).norm();
                assert!(error < 1e-12 * (1.0 + x.norm()), "gradient of x[{d}] {row:?} at {x:?}");
            }
        }
    }

    #[test]
    fn linear_fields_are_reproduced_and_differentiated_exactly() {
        patch::<2>(9);
        patch::<3>(6);
    }

    /// The gradient is that of the corrected kernel, not a fit of its own: central differences over 1e-5, whose error is 1e-10 of
    /// the third derivative and 1e-11 of rounding.
    #[test]
    fn the_gradient_is_the_derivative_of_the_corrected_kernel() {
        let points = block::<3>(5);
        for (x, x_b) in [(Vector([2.1, 1.9, 2.2]), points[62].0), (Vector([0.1, 0.3, -0.2]), points[31].0)] {
            let weight = |x: Vector<3>| kernel_at(&points, x).fit.weight(x_b - x, values::<3>((x_b - x).norm()).0);
            let (w, dw) = values::<3>((x_b - x).norm());
            let found = kernel_at(&points, x).gradient(x_b - x, w, dw);
            for d in 0..3 {
                let step = 1e-5 * Vector::unit(d);
                let slope = (weight(x + step) - weight(x - step)) / 2e-5;
                assert!((found[d] - slope).abs() < 1e-8, "{} for {slope}", found[d]);
            }
            assert!(found.norm() > 1e-3, "far from it: {found:?}");
        }
    }

    #[test]
    fn a_kernel_that_is_not_corrected_is_the_kernel() {
        let y = Vector([0.3, -0.7]);
        let (w, dw) = values::<2>(y.norm());
        assert_eq!(LinearKernel::PLAIN.gradient(y, w, dw), -dw * y);
        assert_eq!(LinearKernel::PLAIN.fit.weight(y, w), w);
    }

    #[test]
    fn few_neighbours_get_a_mean_and_one_particle_nothing() {
        let mut alone = Moments::<2>::alone(0.3);
        assert_eq!(alone.fit(), Fit::NONE);
        // In a line: no slope across it.
        for along in [-1.0, 1.0, 2.0] {
            alone.add(along * Vector([0.6, 0.8]), 0.1);
        }
        assert_eq!(alone.fit(), Fit { constant: 1.0 / alone.zeroth, slope: Vector::ZERO });
        // A clump far to one side: the fit would extrapolate.
        let mut beside = Moments::<2>::alone(0.005);
        for (x, y) in [(1.0, 0.3), (1.3, 0.0), (1.0, -0.3)] {
            beside.add(Vector([x, y]), 0.2);
        }
        assert_eq!(beside.fit().slope, Vector::ZERO);
    }

    /// The share that tells the rim of the fluid, for the lattices and kernels methods take by themselves.
    #[test]
    fn the_first_row_under_a_surface_lacks_neighbours_and_the_second_does_not() {
        fn share<K: Kernel<D>, const D: usize>(kernel: K, h: f64, row: i64) -> f64 {
            let mut moments = Moments::<D>::alone(kernel.w(0.0, h));
            for mut i in 0..(0..D).fold(1, |points, _| points * 9) {
                let y = Vector::<D>(std::array::from_fn(|_| {
                    let along = (i % 9 - 4) as f64;
                    i /= 9;
                    along
                }));
                if y[D - 1] <= row as f64 && y.norm() > 0.0 {
                    moments.add(y, kernel.w(y.norm(), h));
                }
            }
            moments.solve().unwrap().schur / moments.zeroth
        }
        for row in 0..2 {
            let all = [
                share::<_, 2>(WendlandC2, 1.5, row),
                share::<_, 3>(WendlandC2, 1.5, row),
                share::<_, 2>(CubicSpline, 1.2, row),
                share::<_, 3>(CubicSpline, 1.2, row),
            ];
            assert!(all.iter().all(|&share| (share >= ALL_AROUND) == (row == 1)), "row {row}: {all:?}");
            // Room for disorder on both sides.
            assert!(all.iter().all(|share| (share - ALL_AROUND).abs() > 0.05), "row {row}: {all:?}");
        }
    }

    /// A jittered pool with a linear density, the fluid alone.
    fn pool(density: impl Fn(Vector<2>) -> f64) -> (Particles<2>, Neighbors<2>) {
        let mut p = Particles::new();
        for (i, (x, volume)) in block::<2>(12).into_iter().enumerate() {
            let density = density(x);
            let particle =
                Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: density * volume, density, pressure: 0.0, h: H };
            p.push(i as u32, particle);
        }
        let mut near = Neighbors::new();
        near.build(&p, 2.0, Search::Grid).unwrap();
        (p, near)
    }

    #[test]
    fn moving_least_squares_keep_a_linear_density_and_a_mean_does_not() {
        let (p, near) = pool(|x| 1000.0 + x.dot(Vector([2.0, -5.0])));
        let change = |reset| (0..p.len()).map(|a| (new_density(WendlandC2, &near, &p, reset, a) - p.density[a]).abs()).fold(0.0, f64::max);
        // 1e-12 of 1000: the round-off of the sums.
        assert!(change(DensityReset::Mls) < 1e-9, "{}", change(DensityReset::Mls));
        assert!(change(DensityReset::Shepard) > 1.0);
        assert_eq!(change(DensityReset::None), 0.0);
    }

    #[test]
    fn moving_least_squares_leave_the_rim_alone_and_smooth_the_inside() {
        let noise = |x: Vector<2>| 1000.0 + 10.0 * (37.0 * x[0] + 91.0 * x[1]).sin();
        let (p, near) = pool(noise);
        let (mut before, mut after) = (0.0_f64, 0.0_f64);
        for a in 0..p.len() {
            let new = new_density(WendlandC2, &near, &p, DensityReset::Mls, a);
            let rim = p.x[a].0.iter().any(|x| !(0.5..10.5).contains(x));
            assert!(!rim || new == p.density[a], "{:?}", p.x[a]);
            if !rim {
                before = before.max((p.density[a] - 1000.0).abs());
                after = after.max((new - 1000.0).abs());
            }
        }
        assert!(after < 0.7 * before, "{after} of {before}");
    }
}
