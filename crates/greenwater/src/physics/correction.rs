//! Linear corrections of sums over neighbours: small matrices and their inverses.

use super::viscosity::Tensor;
use crate::math::Vector;

/// Solves `A x = b` for a few unknowns by elimination with the largest pivot of each column.
///
/// `None` where a pivot falls below `least` times the largest entry of `A`: the points that made the matrix lie on a line or
/// are too few.
pub fn solve<const N: usize>(a: [[f64; N]; N], b: [f64; N], least: f64) -> Option<[f64; N]> {
    solve_all(a, b.map(|b| [b]), least).map(|x| x.map(|[x]| x))
}

/// The same for `M` right-hand sides, the columns of `b`, at once.
#[inline(always)]
fn solve_all<const N: usize, const M: usize>(mut a: [[f64; N]; N], mut b: [[f64; M]; N], least: f64) -> Option<[[f64; M]; N]> {
    let scale = a.iter().flatten().fold(0.0_f64, |most, entry| most.max(entry.abs()));
    for column in 0..N {
        let mut pivot = column;
        for row in column + 1..N {
            if a[row][column].abs().total_cmp(&a[pivot][column].abs()).is_ge() {
                pivot = row;
            }
        }
        let size = a[pivot][column].abs();
        if size.is_nan() || size <= least * scale {
            return None;
        }
        a.swap(column, pivot);
        b.swap(column, pivot);
        for row in column + 1..N {
            let factor = a[row][column] / a[column][column];
            for k in column..N {
                a[row][k] -= factor * a[column][k];
            }
            for k in 0..M {
                b[row][k] -= factor * b[column][k];
            }
        }
    }
    let mut x = [[0.0; M]; N];
    for row in (0..N).rev() {
        for k in 0..M {
            let known: f64 = (row + 1..N).map(|j| a[row][j] * x[j][k]).sum();
            x[row][k] = (b[row][k] - known) / a[row][row];
        }
    }
    Some(x)
}

/// The inverse `L_a` of `Σ_b V_b (x_b − x_a) ⊗ ∇_a W_ab` (Randles & Libersky 1996; Bonet & Lok 1999): `L_a` times a sum with
/// `∇_a W_ab` differentiates a linear field exactly. `None` where neighbours lie on a line or are too few.
///
/// The matrix is dimensionless and the unit matrix inside the fluid; half a neighbourhood halves its smallest eigenvalue. A
/// pivot below 0.1 means less than a fifth of that.
#[inline(always)]
pub fn renormalisation<const D: usize>(moments: &Tensor<D>) -> Option<Tensor<D>> {
    let unit = std::array::from_fn(|column| Vector::<D>::unit(column).0);
    solve_all(moments.map(|row| row.0), unit, 0.1).map(|inverse| inverse.map(Vector))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_is_solved_whatever_the_order_of_its_rows() {
        let a = [[0.0, 2.0, 1.0], [1.0, -1.0, 0.5], [3.0, 0.0, -1.0]];
        let x = [1.0, -2.0, 4.0];
        let b = a.map(|row| row[0] * x[0] + row[1] * x[1] + row[2] * x[2]);
        let found = solve(a, b, 1e-9).unwrap();
        // 1e-14: a handful of roundings.
        assert!(found.iter().zip(x).all(|(f, x)| (f - x).abs() < 1e-14), "{found:?}");
    }

    #[test]
    fn what_cannot_be_inverted_is_refused() {
        assert!(solve([[1.0, 2.0], [2.0, 4.0]], [1.0, 2.0], 1e-9).is_none());
        assert!(solve([[f64::NAN, 2.0], [2.0, 4.0]], [1.0, 2.0], 1e-9).is_none());
        assert!(renormalisation(&[Vector([1.0, 0.0]), Vector([0.0, 1e-3])]).is_none());
        let inverse = renormalisation(&[Vector([0.5, 0.0]), Vector([0.0, 1.0])]).unwrap();
        assert_eq!(inverse, [Vector([2.0, 0.0]), Vector([0.0, 1.0])]);
    }
}
