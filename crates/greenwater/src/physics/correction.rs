//! Linear corrections of sums over neighbours: small matrices and their inverses.

use super::viscosity::Tensor;
use crate::math::Vector;

/// Solves `A x = b` for a few unknowns by elimination with the largest pivot of each column.
///
/// `None` where a pivot falls below `least` times the largest entry of `A`: the points that made the matrix lie on a line or
/// are too few.
pub fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N], least: f64) -> Option<[f64; N]> {
    let scale = a.iter().flatten().fold(0.0_f64, |most, entry| most.max(entry.abs()));
    for column in 0..N {
        let pivot = (column..N).max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs()))?;
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
            b[row] -= factor * b[column];
        }
    }
    let mut x = [0.0; N];
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N).map(|k| a[row][k] * x[k]).sum();
        x[row] = (b[row] - known) / a[row][row];
    }
    Some(x)
}

/// The inverse `L_a` of `Σ_b V_b (x_b − x_a) ⊗ ∇_a W_ab` (Randles & Libersky 1996; Bonet & Lok 1999): `L_a` times a sum with
/// `∇_a W_ab` differentiates a linear field exactly. `None` where neighbours lie on a line or are too few.
///
/// The matrix is dimensionless and the unit matrix inside the fluid; half a neighbourhood halves its smallest eigenvalue. A
/// pivot below 0.1 means less than a fifth of that.
pub fn renormalisation<const D: usize>(moments: &Tensor<D>) -> Option<Tensor<D>> {
    let a: [[f64; D]; D] = moments.map(|row| row.0);
    let mut inverse = [Vector::ZERO; D];
    for column in 0..D {
        let x = solve(a, Vector::<D>::unit(column).0, 0.1)?;
        for (row, value) in inverse.iter_mut().zip(x) {
            row[column] = value;
        }
    }
    Some(inverse)
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
