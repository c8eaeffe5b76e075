//! Smoothing kernels: the weight `W(r, h)` of a neighbour at distance `r`.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use crate::lanes::Real;
use crate::math::{cube, power};

/// A smoothing kernel in `D` dimensions: compact support, unit integral, a delta function for `h → 0`.
///
/// `W(r, h) = σ/hᴰ · f(q)` with `q = r/h`; `f` falls from its largest value at `q = 0` to exactly 0 at `q =` [`radius`](Kernel::radius).
/// An implementor gives the shape `f`, its slope over `q`, and `σ`; the trait does the rest.
/// Gradient with respect to `x_a`: `∇_a W_ab = (W'(r)/r) x_ab`, with `x_ab = x_a − x_b`.
pub trait Kernel<const D: usize>: Copy + Send + Sync + 'static {
    /// Support radius in units of `h`: `W = 0` for `r >= radius h`.
    fn radius(self) -> f64;

    /// Normalisation `σ` (dimensionless) that makes the integral over space one.
    fn sigma(self) -> f64;

    /// Shape `f(q)`, dimensionless.
    fn shape<L: Real>(self, q: L) -> L;

    /// `f'(q)/q`, dimensionless; finite at `q = 0` for every kernel here.
    fn slope_over_q<L: Real>(self, q: L) -> L;

    /// `W(r, h)`, in m⁻ᴰ, for `r` and `h` in m.
    #[inline(always)]
    fn w<L: Real>(self, r: L, h: L) -> L {
        let inverse = L::splat(1.0) / h;
        power(inverse, D as u32) * self.sigma() * self.shape(r * inverse)
    }

    /// `W'(r)/r`, in m⁻ᴰ⁻²: never positive, finite at `r = 0`, so that `∇W` needs no special case.
    #[inline(always)]
    fn dw_over_r<L: Real>(self, r: L, h: L) -> L {
        let inverse = L::splat(1.0) / h;
        power(inverse, D as u32 + 2) * self.sigma() * self.slope_over_q(r * inverse)
    }
}

/// `x` where it is positive, else 0.
#[inline(always)]
fn positive<L: Real>(x: L) -> L {
    x.at_least(L::splat(0.0))
}

/// Picks the constant of dimension `D` out of three.
const fn of_dimension<const D: usize>(one: f64, two: f64, three: f64) -> f64 {
    match D {
        1 => one,
        2 => two,
        3 => three,
        _ => panic!("kernels exist in 1, 2 and 3 dimensions"),
    }
}

/// The paper's cubic spline, equation (12): `f = 2/3 − q² + q³/2` for `q <= 1`, `(2 − q)³/6` for `q <= 2`.
///
/// `σ = 1`, `15/(7π)`, `3/(2π)` in 1D, 2D, 3D (the print has the 2D value). Source: Monaghan & Lattanzio (1985), written
/// there as `10/(7π) (1 − 3/2 q² + 3/4 q³)`, which is the same function.
#[derive(Clone, Copy, Debug, Default)]
pub struct CubicSpline;

impl<const D: usize> Kernel<D> for CubicSpline {
    #[inline(always)]
    fn radius(self) -> f64 {
        2.0
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(1.0, 15.0 / (7.0 * PI), 3.0 / (2.0 * PI)) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        let t = positive(-q + 2.0);
        let outer = t * t * t * (1.0 / 6.0);
        let inner = q * q * (q * 0.5 - 1.0) + 2.0 / 3.0;
        L::choose(L::splat(1.0).below(q), outer, inner)
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        let t = positive(-q + 2.0);
        L::choose(L::splat(1.0).below(q), t * t * -0.5 / q, q * 1.5 - 2.0)
    }
}

/// Gaussian, cut at `q = 3` and renormalised there: `f = exp(−q²)` for `q < 3`.
///
/// The cut loses 2.2e-5 (1D), 1.2e-4 (2D), 4.4e-4 (3D) of the integral of the whole curve; `σ` makes up for it, so that the
/// integral is one. The jump at the cut is `e⁻⁹` of the peak. Source: Gingold & Monaghan (1977).
#[derive(Clone, Copy, Debug, Default)]
pub struct Gaussian;

/// `e⁻⁹` to double precision.
const EXP_MINUS_9: f64 = 1.234_098_040_866_795_6e-4;
/// `erf(3)` to double precision.
const ERF_3: f64 = 0.999_977_909_503_001_4;
/// `√π`.
const SQRT_PI: f64 = 1.772_453_850_905_516;

impl<const D: usize> Kernel<D> for Gaussian {
    #[inline(always)]
    fn radius(self) -> f64 {
        3.0
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(1.0 / (SQRT_PI * ERF_3), 1.0 / (PI * (1.0 - EXP_MINUS_9)), 1.0 / (PI * (SQRT_PI * ERF_3 - 6.0 * EXP_MINUS_9))) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        L::choose(q.below(L::splat(3.0)), (-q * q).each(f64::exp), L::splat(0.0))
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        L::choose(q.below(L::splat(3.0)), (-q * q).each(f64::exp) * -2.0, L::splat(0.0))
    }
}

/// Quartic spline (B-spline `M₅`): `f = (2.5 − q)⁴₊ − 5 (1.5 − q)⁴₊ + 10 (0.5 − q)⁴₊`, support `2.5 h`.
///
/// `σ = 1/24`, `96/(1199π)`, `1/(20π)` in 1D, 2D, 3D. Source: Schoenberg (1946); Price (2012).
#[derive(Clone, Copy, Debug, Default)]
pub struct QuarticSpline;

impl<const D: usize> Kernel<D> for QuarticSpline {
    #[inline(always)]
    fn radius(self) -> f64 {
        2.5
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(1.0 / 24.0, 96.0 / (1199.0 * PI), 1.0 / (20.0 * PI)) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        let (a, b, c) = (positive(-q + 2.5), positive(-q + 1.5), positive(-q + 0.5));
        power(a, 4) - power(b, 4) * 5.0 + power(c, 4) * 10.0
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        // The three pieces added up, divided by q: no special case at q = 0.
        let (a, b) = (positive(-q + 2.5), positive(-q + 1.5));
        L::choose(q.below(L::splat(0.5)), q * q * 24.0 - 30.0, (cube(a) - cube(b) * 5.0) * -4.0 / q)
    }
}

/// Quintic spline (B-spline `M₆`): `f = (3 − q)⁵₊ − 6 (2 − q)⁵₊ + 15 (1 − q)⁵₊`, support `3h`.
///
/// `σ = 1/120`, `7/(478π)`, `1/(120π)` in 1D, 2D, 3D (a `3/(359π)` in circulation for 3D is 0.28 % off).
/// Source: Schoenberg (1946); Morris, Fox & Zhu (1997).
#[derive(Clone, Copy, Debug, Default)]
pub struct QuinticSpline;

impl<const D: usize> Kernel<D> for QuinticSpline {
    #[inline(always)]
    fn radius(self) -> f64 {
        3.0
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(1.0 / 120.0, 7.0 / (478.0 * PI), 1.0 / (120.0 * PI)) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        let (a, b, c) = (positive(-q + 3.0), positive(-q + 2.0), positive(-q + 1.0));
        power(a, 5) - power(b, 5) * 6.0 + power(c, 5) * 15.0
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        // As above: the three pieces added up, divided by q.
        let inner = q * q * (q * -50.0 + 120.0) - 120.0;
        let (a, b) = (positive(-q + 3.0), positive(-q + 2.0));
        L::choose(q.below(L::splat(1.0)), inner, (power(a, 4) - power(b, 4) * 6.0) * -5.0 / q)
    }
}

/// Wendland C2: smooth, never negative, no pairing of particles.
///
/// 2D, 3D: `f = (1 − q/2)⁴ (1 + 2q)`, `σ = 7/(4π)`, `21/(16π)`. 1D: `f = (1 − q/2)³ (1 + 3q/2)`, `σ = 5/8`.
/// Source: Wendland (1995); Dehnen & Aly (2012), table 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC2;

impl<const D: usize> Kernel<D> for WendlandC2 {
    #[inline(always)]
    fn radius(self) -> f64 {
        2.0
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(5.0 / 8.0, 7.0 / (4.0 * PI), 21.0 / (16.0 * PI)) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        let t = positive(q * -0.5 + 1.0);
        if D == 1 { cube(t) * (q * 1.5 + 1.0) } else { power(t, 4) * (q * 2.0 + 1.0) }
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        let t = positive(q * -0.5 + 1.0);
        if D == 1 { t * t * -3.0 } else { t * t * (t * -5.0) }
    }
}

/// Wendland C4: two more continuous derivatives than [`WendlandC2`].
///
/// 2D, 3D: `f = (1 − q/2)⁶ (1 + 3q + 35/12 q²)`, `σ = 9/(4π)`, `495/(256π)`.
/// 1D: `f = (1 − q/2)⁵ (1 + 5/2 q + 2q²)`, `σ = 3/4`. Source: Wendland (1995); Dehnen & Aly (2012), table 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC4;

impl<const D: usize> Kernel<D> for WendlandC4 {
    #[inline(always)]
    fn radius(self) -> f64 {
        2.0
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(3.0 / 4.0, 9.0 / (4.0 * PI), 495.0 / (256.0 * PI)) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        let t = positive(q * -0.5 + 1.0);
        if D == 1 { power(t, 5) * (q * (q * 2.0 + 2.5) + 1.0) } else { power(t, 6) * (q * (q * (35.0 / 12.0) + 3.0) + 1.0) }
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        let t = positive(q * -0.5 + 1.0);
        if D == 1 { power(t, 4) * (q * 2.0 + 1.0) * -3.5 } else { power(t, 5) * (q * 2.5 + 1.0) * (-14.0 / 3.0) }
    }
}

/// Wendland C6: two more continuous derivatives than [`WendlandC4`].
///
/// 2D, 3D: `f = (1 − q/2)⁸ (1 + 4q + 25/4 q² + 4q³)`, `σ = 39/(14π)`, `1365/(512π)`.
/// 1D: `f = (1 − q/2)⁷ (1 + 7/2 q + 19/4 q² + 21/8 q³)`, `σ = 55/64`. Source: Wendland (1995); Dehnen & Aly (2012), table 1.
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC6;

impl<const D: usize> Kernel<D> for WendlandC6 {
    #[inline(always)]
    fn radius(self) -> f64 {
        2.0
    }

    #[inline(always)]
    fn sigma(self) -> f64 {
        const { of_dimension::<D>(55.0 / 64.0, 39.0 / (14.0 * PI), 1365.0 / (512.0 * PI)) }
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        let t = positive(q * -0.5 + 1.0);
        if D == 1 {
            power(t, 7) * (q * (q * (q * 2.625 + 4.75) + 3.5) + 1.0)
        } else {
            power(t, 8) * (q * (q * (q * 4.0 + 6.25) + 4.0) + 1.0)
        }
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        let t = positive(q * -0.5 + 1.0);
        if D == 1 { -power(t, 6) * (q * (q * 13.125 + 13.5) + 4.5) } else { power(t, 7) * (q * (q * 4.0 + 3.5) + 1.0) * -5.5 }
    }
}

/// The kernels a case may name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelName {
    /// [`CubicSpline`], the paper's equation (12).
    #[default]
    CubicSpline,
    /// [`Gaussian`].
    Gaussian,
    /// [`QuarticSpline`].
    QuarticSpline,
    /// [`QuinticSpline`].
    QuinticSpline,
    /// [`WendlandC2`].
    WendlandC2,
    /// [`WendlandC4`].
    WendlandC4,
    /// [`WendlandC6`].
    WendlandC6,
}

/// A kernel that some method takes by itself.
pub(crate) trait Named: Default {
    /// What a case calls it.
    const NAME: KernelName;
}

impl Named for CubicSpline {
    const NAME: KernelName = KernelName::CubicSpline;
}

impl Named for WendlandC2 {
    const NAME: KernelName = KernelName::WendlandC2;
}

/// Calls `$body` with `$kernel` bound to the kernel that `$name` stands for: the choice is made once, outside every loop.
macro_rules! with_kernel {
    ($name:expr, $kernel:ident => $body:expr) => {
        match $name {
            KernelName::CubicSpline => {
                let $kernel = CubicSpline;
                $body
            }
            KernelName::Gaussian => {
                let $kernel = Gaussian;
                $body
            }
            KernelName::QuarticSpline => {
                let $kernel = QuarticSpline;
                $body
            }
            KernelName::QuinticSpline => {
                let $kernel = QuinticSpline;
                $body
            }
            KernelName::WendlandC2 => {
                let $kernel = WendlandC2;
                $body
            }
            KernelName::WendlandC4 => {
                let $kernel = WendlandC4;
                $body
            }
            KernelName::WendlandC6 => {
                let $kernel = WendlandC6;
                $body
            }
        }
    };
}

impl KernelName {
    /// Every kernel, in the order they are listed to users.
    pub const ALL: [Self; 7] =
        [Self::CubicSpline, Self::Gaussian, Self::QuarticSpline, Self::QuinticSpline, Self::WendlandC2, Self::WendlandC4, Self::WendlandC6];

    /// The name as written in a case.
    pub fn name(self) -> &'static str {
        match self {
            Self::CubicSpline => "cubic-spline",
            Self::Gaussian => "gaussian",
            Self::QuarticSpline => "quartic-spline",
            Self::QuinticSpline => "quintic-spline",
            Self::WendlandC2 => "wendland-c2",
            Self::WendlandC4 => "wendland-c4",
            Self::WendlandC6 => "wendland-c6",
        }
    }

    /// What it is good for and where it comes from, in one line.
    pub fn text(self) -> &'static str {
        match self {
            Self::CubicSpline => "the paper's kernel (12), support 2h; Monaghan & Lattanzio (1985)",
            Self::Gaussian => "smooth, cut at 3h and renormalised; Gingold & Monaghan (1977)",
            Self::QuarticSpline => "B-spline M5, support 2.5h; Schoenberg (1946)",
            Self::QuinticSpline => "B-spline M6, support 3h; Morris, Fox & Zhu (1997)",
            Self::WendlandC2 => "no pairing of particles, support 2h; Wendland (1995)",
            Self::WendlandC4 => "smoother, for h/dx of 1.5 and more, support 2h; Wendland (1995)",
            Self::WendlandC6 => "smoothest, for h/dx of 1.8 and more, support 2h; Wendland (1995)",
        }
    }

    /// Support radius in units of `h`.
    pub fn radius(self) -> f64 {
        with_kernel!(self, kernel => Kernel::<2>::radius(kernel))
    }

    /// `W(r, h)` in `D` dimensions, m⁻ᴰ. For tables and plots; loops use the kernel itself.
    pub fn w<const D: usize>(self, r: f64, h: f64) -> f64 {
        with_kernel!(self, kernel => Kernel::<D>::w(kernel, r, h))
    }

    /// `W'(r)/r` in `D` dimensions, m⁻ᴰ⁻². For tables and plots; loops use the kernel itself.
    pub fn dw_over_r<const D: usize>(self, r: f64, h: f64) -> f64 {
        with_kernel!(self, kernel => Kernel::<D>::dw_over_r(kernel, r, h))
    }
}

/// Any kernel, told apart at every call, number by number. Pair loops with it are slower than with the kernel itself but have the same
/// bits; they are what runs for kernels that a method does not take by itself, so that not every loop is compiled for every kernel.
impl<const D: usize> Kernel<D> for KernelName {
    #[inline(always)]
    fn radius(self) -> f64 {
        self.radius()
    }

    fn sigma(self) -> f64 {
        with_kernel!(self, kernel => Kernel::<D>::sigma(kernel))
    }

    #[inline(always)]
    fn shape<L: Real>(self, q: L) -> L {
        q.each(|q| self.shape_of_one::<D>(q))
    }

    #[inline(always)]
    fn slope_over_q<L: Real>(self, q: L) -> L {
        q.each(|q| self.slope_of_one::<D>(q))
    }
}

impl KernelName {
    #[inline(never)]
    fn shape_of_one<const D: usize>(self, q: f64) -> f64 {
        with_kernel!(self, kernel => Kernel::<D>::shape(kernel, q))
    }

    #[inline(never)]
    fn slope_of_one<const D: usize>(self, q: f64) -> f64 {
        with_kernel!(self, kernel => Kernel::<D>::slope_over_q(kernel, q))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `∫ W dV` in `D` dimensions by the midpoint rule in shells; exact to 1e-9 at this resolution for these smooth shapes.
    fn integral<const D: usize>(name: KernelName, h: f64) -> f64 {
        let shells = 200_000;
        let reach = name.radius() * h;
        let dr = reach / shells as f64;
        (0..shells)
            .map(|i| {
                let r = (i as f64 + 0.5) * dr;
                let area = of_dimension::<D>(2.0, 2.0 * PI * r, 4.0 * PI * r * r);
                name.w::<D>(r, h) * area * dr
            })
            .sum()
    }

    /// The first of the paper's three requirements; a slope of zero there too, but for the cut Gaussian.
    #[test]
    fn support_is_compact() {
        for name in KernelName::ALL {
            let edge = name.radius();
            for q in [edge, 1.0001 * edge, 5.0] {
                assert_eq!(name.w::<1>(q, 1.0), 0.0, "{name:?} at q = {q}");
                assert_eq!(name.w::<2>(q, 1.0), 0.0, "{name:?} at q = {q}");
                assert_eq!(name.dw_over_r::<3>(q, 1.0), 0.0, "{name:?} at q = {q}");
            }
            assert!(name.w::<2>(0.99 * edge, 1.0) > 0.0, "{name:?} reaches its support");
        }
    }

    /// The second requirement. 1e-9: error of the quadrature.
    #[test]
    fn integral_is_one_in_every_dimension() {
        for name in KernelName::ALL {
            for (dimension, value) in [(1, integral::<1>(name, 0.7)), (2, integral::<2>(name, 0.7)), (3, integral::<3>(name, 0.7))] {
                assert!((value - 1.0).abs() < 1e-9, "{name:?} in {dimension}D: {value}");
            }
        }
    }

    /// The third requirement: the smoothed value of `cos x` tends to the value at the point as `h²` (second moment).
    #[test]
    fn small_h_gives_a_delta_function() {
        let smoothed_cosine = |name: KernelName, h: f64| -> f64 {
            let n = 20_000;
            let reach = name.radius() * h;
            let dx = 2.0 * reach / n as f64;
            (0..n).map(|i| -reach + (i as f64 + 0.5) * dx).map(|x| name.w::<1>(x.abs(), h) * x.cos() * dx).sum()
        };
        for name in KernelName::ALL {
            let (coarse, fine) = (1.0 - smoothed_cosine(name, 0.1), 1.0 - smoothed_cosine(name, 0.05));
            let order = (coarse / fine).log2();
            assert!(fine > 0.0 && fine < 2e-3, "{name:?}: error {fine:.1e}");
            assert!((order - 2.0).abs() < 0.02, "{name:?}: order {order:.3}");
        }
    }

    #[test]
    fn slope_is_the_derivative_of_the_shape() {
        for name in KernelName::ALL {
            for i in 1..60 {
                let (r, h, step) = (0.05 * i as f64 + 0.013, 1.1, 1e-6);
                let across_the_cut = (r - name.radius() * h).abs() < 2.0 * step;
                if across_the_cut {
                    continue;
                }
                for (numeric, exact) in [
                    ((name.w::<1>(r + step, h) - name.w::<1>(r - step, h)) / (2.0 * step * r), name.dw_over_r::<1>(r, h)),
                    ((name.w::<3>(r + step, h) - name.w::<3>(r - step, h)) / (2.0 * step * r), name.dw_over_r::<3>(r, h)),
                ] {
                    // 1e-8: cancellation in the difference quotient.
                    assert!((numeric - exact).abs() < 1e-8 * (1.0 + exact.abs()) / r, "{name:?} at r = {r}: {numeric} against {exact}");
                }
            }
            assert!(name.dw_over_r::<2>(0.0, 1.0).is_finite(), "{name:?} at r = 0");
        }
    }

    /// The printed constant `15/(7πh²)` and the printed values of equation (12), also in Monaghan & Lattanzio's notation.
    #[test]
    fn cubic_spline_is_the_one_printed() {
        let h = 0.045;
        let constant = 15.0 / (7.0 * PI * h * h);
        for (q, bracket) in [(0.0, 2.0 / 3.0), (0.5, 2.0 / 3.0 - 0.25 + 0.0625), (1.0, 1.0 / 6.0), (1.5, 0.125 / 6.0), (2.0, 0.0)] {
            let value = KernelName::CubicSpline.w::<2>(q * h, h);
            // 1e-13: round-off; q h / h differs from q in the last place.
            assert!((value - constant * bracket).abs() <= 1e-13 * constant, "q = {q}");
            let monaghan = 10.0 / (7.0 * PI * h * h) * if q <= 1.0 { 1.0 - 1.5 * q * q + 0.75 * q * q * q } else { 0.25 * cube(2.0 - q) };
            assert!((value - monaghan).abs() <= 1e-13 * constant, "q = {q}");
        }
    }

    /// Peak values from the literature pin every `σ f(0)`.
    #[test]
    fn peaks_are_those_of_the_literature() {
        let peaks = [
            (KernelName::CubicSpline, [2.0 / 3.0, 10.0 / (7.0 * PI), 1.0 / PI]),
            (KernelName::QuarticSpline, [115.0 / 192.0, 96.0 / (1199.0 * PI) * 115.0 / 8.0, 115.0 / 8.0 / (20.0 * PI)]),
            (KernelName::QuinticSpline, [66.0 / 120.0, 66.0 * 7.0 / (478.0 * PI), 66.0 / (120.0 * PI)]),
            (KernelName::WendlandC2, [5.0 / 8.0, 7.0 / (4.0 * PI), 21.0 / (16.0 * PI)]),
            (KernelName::WendlandC4, [3.0 / 4.0, 9.0 / (4.0 * PI), 495.0 / (256.0 * PI)]),
            (KernelName::WendlandC6, [55.0 / 64.0, 78.0 / (28.0 * PI), 1365.0 / (512.0 * PI)]),
        ];
        for (name, [one, two, three]) in peaks {
            for (value, expected) in [(name.w::<1>(0.0, 1.0), one), (name.w::<2>(0.0, 1.0), two), (name.w::<3>(0.0, 1.0), three)] {
                assert!((value - expected).abs() < 1e-14, "{name:?}: {value} against {expected}");
            }
        }
    }
}
