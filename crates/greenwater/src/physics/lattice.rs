//! What the sums of a method give on a perfect lattice: inside, and in the rows under a flat surface.

use crate::kernel::Kernel;
use crate::math::Vector;
use crate::physics::correction::solve;

/// Sums over a square (cubic) lattice of spacing `Δ`, with `V = Δᴰ` and `f = −V W'/r`: the measures that disorder, walls and
/// surfaces are told by. Rows are counted from a flat surface half a spacing above row 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// The spacing `Δ`, m.
    pub spacing: f64,
    /// Density at rest: a particle of mass `m` stands for the volume `m/ρ0`, kg/m³.
    pub rest_density: f64,
    /// `Σ V W` with the particle itself, dimensionless: about 1.
    pub sum_w: f64,
    /// `Σ 2f` without the particle itself, 1/m²: the diagonal of the pressure operator.
    pub diagonal: f64,
    /// `Σ f r²`, dimensionless: about `D`.
    pub spread: f64,
    /// `Σ f r²` in rows 0 and 1, over [`spread`](Self::spread).
    pub spread_row: [f64; 2],
    /// `Σ V W` in rows 0 and 1, over [`sum_w`](Self::sum_w).
    pub sum_w_row: [f64; 2],
    /// `|Σ f x|` in rows 0 and 1, 1/m.
    pub slope_row: [f64; 2],
    /// `|Σ f x|` along the surface's normal in row 0 where walls that stand out of the surface meet: one wall in 2D, two in 3D; 1/m.
    pub slope_corner: f64,
    /// Smallest eigenvalue of `Σ f x ⊗ x` in rows 0 and 1, over that inside: that along the surface's normal.
    pub evenness_row: [f64; 2],
    /// What the pressure of row 0 counts for in the forces of liquid at rest, over what it is; see [`surface_weight`](Self::surface_weight).
    pub weight_row: f64,
    /// `W` at one spacing, m⁻ᴰ.
    pub w_spacing: f64,
    /// `|Σ f x|` beside one missing neighbour, 1/m.
    pub slope_vacancy: f64,
    /// The most that `Σ V ∇W` changes with the displacements of a wave, over the displacement, 1/m²: the greatest `k² Σ V W cos(k x)`, which is
    /// `2.6/h²` for Wendland C2.
    pub stiffness: f64,
}

impl Lattice {
    /// The sums for a kernel of smoothing length `h` on a lattice of `spacing`, both m, of a fluid of density `rest_density`, kg/m³.
    pub fn of<K: Kernel<D>, const D: usize>(kernel: K, h: f64, spacing: f64, rest_density: f64) -> Self {
        let volume = (0..D).fold(1.0, |volume, _| volume * spacing);
        let n = (kernel.radius() * h / spacing).ceil() as i64;
        let side = 2 * n + 1;
        let mut l = Self {
            spacing,
            rest_density,
            sum_w: 0.0,
            diagonal: 0.0,
            spread: 0.0,
            spread_row: [0.0; 2],
            sum_w_row: [0.0; 2],
            slope_row: [0.0; 2],
            slope_corner: 0.0,
            evenness_row: [0.0; 2],
            weight_row: 1.0,
            w_spacing: kernel.w(spacing, h),
            slope_vacancy: -volume * kernel.dw_over_r(spacing, h) * spacing,
            stiffness: 0.0,
        };
        // `Σ V W` over the row so many above.
        let mut above = vec![0.0; n as usize + 1];
        // `Σ f x Δ` along the surface's normal over the row so many below.
        let mut below = vec![0.0; n as usize + 1];
        for i in 0..(0..D).fold(1, |points, _| points * side) {
            let mut rest = i;
            let cell: [i64; D] = std::array::from_fn(|_| {
                let along = rest % side - n;
                rest /= side;
                along
            });
            let x = Vector::<D>(cell.map(|along| along as f64 * spacing));
            let (r, up) = (x.norm(), cell[D - 1]);
            let w = volume * kernel.w(r, h);
            l.sum_w += w;
            if up >= 0 {
                above[up as usize] += w;
            }
            for row in 0..2 {
                if up <= row as i64 {
                    l.sum_w_row[row] += w;
                }
            }
            if r == 0.0 {
                continue;
            }
            let f = -volume * kernel.dw_over_r(r, h);
            l.diagonal += 2.0 * f;
            l.spread += f * r * r;
            for row in 0..2 {
                if up <= row as i64 {
                    l.spread_row[row] += f * r * r;
                    l.evenness_row[row] += f * x[D - 1] * x[D - 1];
                } else {
                    l.slope_row[row] += f * x[D - 1];
                }
            }
            if up > 0 {
                below[up as usize] += f * x[D - 1] * spacing;
            }
            if up > 0 && cell[..D - 1].iter().all(|&along| along >= 0) {
                l.slope_corner += f * x[D - 1];
            }
        }
        l.sum_w_row = l.sum_w_row.map(|row| row / l.sum_w);
        l.spread_row = l.spread_row.map(|row| row / l.spread);
        l.evenness_row = l.evenness_row.map(|row| row * D as f64 / l.spread);
        l.stiffness = stiffness(&above, spacing);
        l.weight_row = (2.0 * surface_pressure(&below, l.slope_of_linear::<D>())).max(1.0);
        l
    }

    /// Slope of a linear field by `Σ V (f_b − f_a) ∇W` in `D` dimensions, over the true one; 1 in the continuum. The one-sided forms
    /// of SPH keep the error of this number at any resolution: 2.6 % for Wendland C2 at `h = 1.3` spacings, 0.3 % at 1.5.
    pub fn slope_of_linear<const D: usize>(&self) -> f64 {
        self.spread / D as f64
    }

    /// Share of the inner value of `∇·x` below which a particle belongs to the free surface: half-way between the outermost row
    /// of a flat surface and the one below.
    pub fn surface_threshold(&self) -> f64 {
        0.5 * (self.spread_row[0] + self.spread_row[1])
    }

    /// Whether more of the filling is missing, `1 − Σ V W` (dimensionless, of the whole), than a surface explains that makes a slope of `slope`, 1/m: more
    /// by half of what a film of one row lacks, which has air on both sides and no slope. That is what a flat surface lacks.
    pub fn is_foam(&self, filling: f64, slope: f64) -> bool {
        1.0 - filling - self.missing(slope) > 1.0 - self.sum_w_row[0]
    }

    /// What pressure counts for in forces, and compression in the rate of density, where `Σ f r²` is `share` of that inside: one from row 1 on inwards;
    /// in row 0, and where less is left, what keeps row 0 of liquid at rest in place under the pressure of its depth; in proportion between them.
    ///
    /// Pair forces `(p_a + p_b) ∇W` miss the neighbours beyond a surface, and the row at the surface has to carry more than the pressure of its depth to
    /// hold its own weight.
    pub fn surface_weight(&self, share: f64) -> f64 {
        let [outer, inner] = self.spread_row;
        1.0 + (self.weight_row - 1.0) * ((inner - share) / (inner - outer)).clamp(0.0, 1.0)
    }

    /// `|Σ f x|` that tells a void, 1/m: that beside one missing neighbour. A wide kernel sees the surface from the second row better
    /// than a single gap from beside it: then half-way between the two outermost rows of a flat surface.
    pub fn slope_of_gap(&self) -> f64 {
        if self.slope_vacancy > self.slope_row[1] { self.slope_vacancy } else { 0.5 * (self.slope_row[0] + self.slope_row[1]) }
    }

    /// What a surface makes missing of `Σ V W` where it makes a slope of `slope`, 1/m; over the whole, dimensionless. Exact in rows 0
    /// and 1, none inside; between them the ratio of both goes with the slope.
    pub fn missing(&self, slope: f64) -> f64 {
        let ratio = [0, 1].map(|row| (1.0 - self.sum_w_row[row]) / self.slope_row[row]);
        let share = ((slope - self.slope_row[1]) / (self.slope_row[0] - self.slope_row[1])).clamp(0.0, 1.0);
        slope * (ratio[1] + share * (ratio[0] - ratio[1]))
    }
}

/// The greatest `k² Σ V W cos(k x)` of waves up the rows, 1/m²; `above[i]` is `Σ V W` over the row `i` spacings above. A hundredth of the shortest
/// wave's number apart, waves miss the top of a smooth curve by less than a thousandth.
fn stiffness(above: &[f64], spacing: f64) -> f64 {
    const WAVES: usize = 100;
    let of =
        |k: f64| k * k * (0..above.len()).map(|i| if i == 0 { 1.0 } else { 2.0 } * above[i] * (k * spacing * i as f64).cos()).sum::<f64>();
    (1..=WAVES).map(|i| of(std::f64::consts::PI / spacing * i as f64 / WAVES as f64)).fold(0.0, f64::max)
}

/// Pressure of row 0 of liquid at rest under pair forces `Σ_b (p_a + p_b) ∇W`, over what a row weighs; half, if pairs went on beyond the surface.
///
/// `below[k]` is `Σ f x Δ` over the row `k` below, `slope` what a sum makes of a linear field. Rows from the sixteenth on are given the pressure of
/// their depth; a surface is not felt that far.
fn surface_pressure(below: &[f64], slope: f64) -> f64 {
    const ROWS: usize = 16;
    let (mut matrix, mut weight) = ([[0.0; ROWS]; ROWS], [slope; ROWS]);
    for row in 0..ROWS {
        for (k, &push) in below.iter().enumerate().skip(1) {
            matrix[row][row] += push;
            match row + k {
                other if other < ROWS => matrix[row][other] += push,
                deep => weight[row] -= push * (deep as f64 + 0.5),
            }
            if let Some(other) = row.checked_sub(k) {
                matrix[row][row] -= push;
                matrix[row][other] -= push;
            }
        }
    }
    // 1e-9: far below any pivot of rows that feel each other.
    solve(matrix, weight, 1e-9).map_or(0.5, |pressure| pressure[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{CubicSpline, WendlandC2, WendlandC4};

    /// Density, spread and `h` times slope of rows 0 and 1, published for these kernels to two or three figures.
    #[test]
    fn rows_under_a_flat_surface_have_their_known_sums() {
        let wendland = Lattice::of::<_, 2>(WendlandC2, 1.3, 1.0, 1e3);
        assert!((wendland.sum_w_row[0] - 0.786).abs() < 2e-3, "{wendland:?}");
        let spread = wendland.spread_row.map(|row| row * wendland.spread);
        assert!((spread[0] - 1.25).abs() < 5e-3 && (spread[1] - 1.87).abs() < 5e-3, "{wendland:?}");
        assert!((1.3 * wendland.slope_row[0] - 0.59).abs() < 5e-3 && (1.3 * wendland.slope_row[1] - 0.045).abs() < 5e-3, "{wendland:?}");
        for row in 0..2 {
            assert!((wendland.missing(wendland.slope_row[row]) - (1.0 - wendland.sum_w_row[row])).abs() < 1e-15, "row {row}");
        }
        // Published over D, where a whole lattice has 0.974.
        let evenness = wendland.evenness_row.map(|row| row * wendland.slope_of_linear::<2>());
        assert!((evenness[0] - 0.487).abs() < 2e-3 && (evenness[1] - 0.905).abs() < 1e-2, "{wendland:?}");
        let cubic = Lattice::of::<_, 2>(CubicSpline, 1.2, 1.0, 1e3);
        assert!((cubic.sum_w_row[0] - 0.785).abs() < 2e-3, "{cubic:?}");
    }

    /// The greatest `k² Ŵ(k) h²` of the kernels, by quadrature of their transforms: 2.545, 2.638 and 3.357. A lattice of so many neighbours is a
    /// continuum to a few per cent.
    #[test]
    fn the_stiffest_wave_is_that_of_the_kernel() {
        for (h, lattice, stiffness) in [
            (0.2, Lattice::of::<_, 2>(WendlandC2, 0.2, 0.1, 1e3), 2.545),
            (0.2, Lattice::of::<_, 3>(WendlandC2, 0.2, 0.1, 1e3), 2.638),
            (0.25, Lattice::of::<_, 2>(WendlandC4, 0.25, 0.1, 1e3), 3.357),
        ] {
            assert!((lattice.stiffness * h * h / stiffness - 1.0).abs() < 0.03, "{lattice:?}");
        }
    }

    /// Values summed independently.
    #[test]
    fn a_linear_field_keeps_its_known_error_at_any_resolution() {
        let plane = Lattice::of::<_, 2>(WendlandC2, 0.13, 0.1, 1e3);
        assert!((plane.slope_of_linear::<2>() - 0.97392).abs() < 1e-5, "{plane:?}");
        assert!((plane.sum_w - 1.01047).abs() < 1e-5, "{plane:?}");
        // 1e-3: digits of the table.
        assert!((0.15 * Lattice::of::<_, 2>(WendlandC2, 0.15, 0.1, 1e3).slope_vacancy - 0.244).abs() < 1e-3);
    }

    /// Rows of liquid at rest, solved independently with forty rows: 1.0387, 0.6969 and 1.0316 of what a row weighs.
    #[test]
    fn the_row_at_the_surface_counts_for_what_holds_its_weight() {
        for (lattice, weight) in [
            (Lattice::of::<_, 2>(WendlandC2, 2.0, 1.0, 1e3), 2.08),
            (Lattice::of::<_, 3>(WendlandC2, 0.15, 0.1, 1e3), 1.39),
            (Lattice::of::<_, 3>(WendlandC2, 2.0, 1.0, 1e3), 2.06),
        ] {
            // 0.01: digits of the values.
            assert!((lattice.weight_row - weight).abs() < 0.01, "{lattice:?}");
            let [outer, inner] = lattice.spread_row;
            assert_eq!([outer, inner, 1.0].map(|share| lattice.surface_weight(share)), [lattice.weight_row, 1.0, 1.0]);
            assert_eq!(lattice.surface_weight(0.0), lattice.weight_row);
        }
    }

    /// Rows of surfaces and films, corners and loose lattices, summed here.
    #[test]
    fn foam_is_told_from_surfaces() {
        let h = 2.0;
        let lattice = Lattice::of::<_, 2>(WendlandC2, h, 1.0, 1e3);
        // At a point with neighbours `apart` from each other where `inside` says so.
        let foam = |apart: f64, inside: fn(i32, i32) -> bool| {
            let (mut filling, mut slope) = (0.0, Vector::ZERO);
            for (i, j) in (-4..=4).flat_map(|i| (-4..=4).map(move |j| (i, j))).filter(|&(i, j)| inside(i, j)) {
                let x = apart * Vector([f64::from(i), f64::from(j)]);
                filling += Kernel::<2>::w(WendlandC2, x.norm(), h);
                if (i, j) != (0, 0) {
                    slope += Kernel::<2>::dw_over_r(WendlandC2, x.norm(), h) * x;
                }
            }
            lattice.is_foam(filling / lattice.sum_w, slope.norm())
        };
        let surfaces: [fn(i32, i32) -> bool; 5] =
            [|_, _| true, |_, j| j <= 0, |_, j| j <= 1, |i, j| i <= 0 && j <= 0, |_, j| (-1..=0).contains(&j)];
        assert_eq!(surfaces.map(|inside| foam(1.0, inside)), [false; 5]);
        let fragments: [fn(i32, i32) -> bool; 3] = [|i, j| (i, j) == (0, 0), |_, j| j == 0, |i, j| j == 0 && (0..=1).contains(&i)];
        assert_eq!(fragments.map(|inside| foam(1.0, inside)), [true; 3]);
        assert_eq!([1.1, 1.3].map(|apart| foam(apart, |_, _| true)), [false, true]);
    }

    #[test]
    fn sums_of_a_lattice_do_not_depend_on_the_unit_of_length() {
        let (one, other) = (Lattice::of::<_, 3>(WendlandC2, 1.3, 1.0, 1e3), Lattice::of::<_, 3>(WendlandC2, 0.013, 0.01, 1e3));
        assert!((one.sum_w / other.sum_w - 1.0).abs() < 1e-12);
        assert!((one.spread / other.spread - 1.0).abs() < 1e-12);
        assert!((one.diagonal / other.diagonal * 1e4 - 1.0).abs() < 1e-12);
        assert!((one.slope_corner / other.slope_corner * 1e2 - 1.0).abs() < 1e-12);
    }

    /// Least stiffness of a square lattice against waves across their own direction, in `p/(ρ Δ²)`: negative where the lattice gives
    /// way under its own pressure `p`. Pair forces `−2 p V² ∇W` about the lattice: `K(k) = 2 V Σ ∇∇W (1 − cos k·x)`, of which the
    /// part along the gradient that pressure works on, `Σ ∇W sin k·x`, is held by the speed of sound.
    fn least_stiffness(h: f64) -> f64 {
        let (reach, waves) = (5_i32, 24_i32);
        let mut least = f64::INFINITY;
        let scale = 2.0 / Lattice::of::<_, 2>(WendlandC2, h, 1.0, 1e3).slope_of_linear::<2>();
        for k in (0..=waves).flat_map(|i| (0..=waves).map(move |j| (i, j))).filter(|k| *k != (0, 0)) {
            let k = std::f64::consts::PI / f64::from(waves) * Vector([f64::from(k.0), f64::from(k.1)]);
            let (mut stiffness, mut along) = ([0.0; 3], Vector::ZERO);
            for cell in (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (i, j))).filter(|c| *c != (0, 0)) {
                let x = Vector([f64::from(cell.0), f64::from(cell.1)]);
                let r = x.norm();
                let first = Kernel::<2>::dw_over_r(WendlandC2, r, h);
                // Central difference of W'/r; 1e-4: its error is of the order of 1e-8.
                let second =
                    (Kernel::<2>::dw_over_r(WendlandC2, r + 1e-4, h) - Kernel::<2>::dw_over_r(WendlandC2, r - 1e-4, h)) / (2e-4 * r);
                let weight = scale * (1.0 - k.dot(x).cos());
                stiffness[0] += weight * (first + second * x[0] * x[0]);
                stiffness[1] += weight * second * x[0] * x[1];
                stiffness[2] += weight * (first + second * x[1] * x[1]);
                along += k.dot(x).sin() * first * x;
            }
            let [xx, xy, yy] = stiffness;
            let length = along.norm();
            // Waves that pressure does not feel at all, as at the corner of the zone, are free in both directions.
            let across = if length > 1e-6 {
                let t = Vector([-along[1], along[0]]) / length;
                t[0] * t[0] * xx + 2.0 * t[0] * t[1] * xy + t[1] * t[1] * yy
            } else {
                0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt()
            };
            least = least.min(across);
        }
        least
    }

    /// 1e-3: a tenth of what tears the lattice apart at 1.5 spacings.
    #[test]
    fn a_lattice_stays_under_its_own_pressure_at_two_spacings_and_not_at_one_and_a_half() {
        assert!(least_stiffness(2.0) > -1e-3, "{}", least_stiffness(2.0));
        assert!(least_stiffness(1.5) < -5e-3, "{}", least_stiffness(1.5));
    }

    /// A surface is told from a void by a wide kernel, and a void from the second row by a narrow one.
    #[test]
    fn the_second_row_is_not_beside_a_void() {
        for h in [1.3, 1.5, 2.0, 2.2] {
            let l = Lattice::of::<_, 2>(WendlandC2, h, 1.0, 1e3);
            assert!(l.slope_of_gap() > l.slope_row[1] && l.slope_of_gap() < l.slope_row[0], "{l:?}");
        }
    }
}
