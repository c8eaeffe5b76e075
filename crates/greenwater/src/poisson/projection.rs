//! A few conjugate-gradient iterations on an operator that is never assembled.

use crate::reduce::{dot, sum};

/// Work vectors of [`iterate`].
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    r: Vec<f64>,
    z: Vec<f64>,
    q: Vec<f64>,
    aq: Vec<f64>,
}

/// Jacobi-preconditioned conjugate gradients for `A x = b` from `x = 0`: at most `iterations`, fewer once the residual in the
/// norm of the preconditioner has fallen to `tolerance` of that of `b`. Returns the number of iterations done.
///
/// `level` takes off a vector what `x` may not have, such as the mean where only differences count: an orthogonal projection.
///
/// For corrections where a truncated solve is what is wanted: no error if the tolerance is not reached. `apply(q, aq)` sets
/// `aq = A q` for a symmetric positive semidefinite `A`; `diagonal` is positive.
pub fn iterate(
    mut apply: impl FnMut(&[f64], &mut [f64]),
    mut level: impl FnMut(&mut [f64]),
    diagonal: &[f64],
    b: &[f64],
    x: &mut [f64],
    (tolerance, iterations): (f64, usize),
    work: &mut Workspace,
) -> usize {
    let n = b.len();
    x.fill(0.0);
    work.r.clear();
    work.r.extend_from_slice(b);
    work.z.clear();
    level(&mut work.r);
    work.z.extend(work.r.iter().zip(diagonal).map(|(r, d)| r / d));
    level(&mut work.z);
    work.q.clone_from(&work.z);
    work.aq.resize(n, 0.0);
    let mut rz = dot(&work.r, &work.z);
    let target = tolerance * tolerance * rz;
    for done in 0..iterations {
        if rz.is_nan() || rz <= target.max(1e-30) {
            return done;
        }
        apply(&work.q, &mut work.aq);
        level(&mut work.aq);
        let curvature = dot(&work.q, &work.aq);
        if curvature.is_nan() || curvature <= 0.0 {
            return done;
        }
        let step = rz / curvature;
        for i in 0..n {
            x[i] += step * work.q[i];
            work.r[i] -= step * work.aq[i];
            work.z[i] = work.r[i] / diagonal[i];
        }
        level(&mut work.z);
        let next = sum(n, |i| work.r[i] * work.z[i]);
        let keep = next / rz;
        rz = next;
        for i in 0..n {
            work.q[i] = work.z[i] + keep * work.q[i];
        }
    }
    iterations
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn enough_iterations_solve_a_small_system() {
        let apply = |q: &[f64], aq: &mut [f64]| {
            for i in 0..q.len() {
                let left = if i > 0 { q[i - 1] } else { 0.0 };
                let right = if i + 1 < q.len() { q[i + 1] } else { 0.0 };
                aq[i] = 2.0 * q[i] - left - right;
            }
        };
        let (b, mut x) = (vec![1.0; 9], vec![0.0; 9]);
        iterate(apply, |_| (), &[2.0; 9], &b, &mut x, (1e-14, 50), &mut Workspace::default());
        for (i, x) in x.iter().enumerate() {
            let s = (i + 1) as f64;
            // The exact solution of -u'' = 1 on the lattice: s (10 - s)/2.
            assert!((x - s * (10.0 - s) / 2.0).abs() < 1e-12, "{x}");
        }
    }
}
