//! Conjugate gradients on an operator that is never assembled: a few iterations, or a solution with its residual.

use std::time::Instant;

use super::{SolveError, SolveReport};
use crate::reduce::{dot, norm, sum};

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

/// When [`solve`] is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Largest relative true residual `|b − A x|/|b|`, dimensionless.
    pub tolerance: f64,
    /// Residual, root mean square over the rows, in the unit of `b`, that means nothing to the caller.
    pub negligible: f64,
    /// Most iterations.
    pub max_iterations: usize,
}

/// Preconditioned conjugate gradients for `A x = b` from the start in `x`, or from zero where that is nearer, until the true
/// residual has reached the goal. The residual of the report is `|b − A x|/|b|`, computed from `x` once more at the end; where
/// the recurrence has drifted from it, the iteration starts again from there. `apply` and `level` as in [`iterate`]; `precondition(r, z)` sets
/// `z = M⁻¹ r` for a symmetric positive definite `M`.
///
/// # Errors
/// An input that is not finite, or a goal that was not reached within the iterations; `x` then is no solution.
///
/// Source: Hestenes & Stiefel, J. Res. NBS 49 (1952) 409.
pub fn solve(
    mut apply: impl FnMut(&[f64], &mut [f64]),
    mut level: impl FnMut(&mut [f64]),
    mut precondition: impl FnMut(&[f64], &mut [f64]),
    b: &[f64],
    x: &mut [f64],
    goal: Goal,
    work: &mut Workspace,
) -> Result<SolveReport, SolveError> {
    let started = Instant::now();
    let n = b.len();
    let size = norm(b);
    if !size.is_finite() {
        let row = b.iter().position(|b| !b.is_finite()).unwrap_or(0);
        return Err(SolveError::NotFinite { what: "right-hand side", row, value: b.get(row).copied().unwrap_or(size) });
    }
    let mut report = SolveReport::default();
    let target = (goal.tolerance * size).max(goal.negligible * (n as f64).sqrt());
    if size == 0.0 {
        x.fill(0.0);
        return Ok(report);
    }
    work.aq.resize(n, 0.0);
    work.r.resize(n, 0.0);
    work.z.resize(n, 0.0);
    work.q.resize(n, 0.0);
    loop {
        // The true residual.
        apply(x, &mut work.aq);
        for i in 0..n {
            work.r[i] = b[i] - work.aq[i];
        }
        level(&mut work.r);
        let residual = norm(&work.r);
        if residual.is_nan() || (report.iterations == 0 && residual > size) {
            x.fill(0.0);
            work.r.copy_from_slice(b);
            level(&mut work.r);
        } else {
            report.residual = residual / size;
            if residual <= target {
                break;
            }
        }
        if report.iterations >= goal.max_iterations {
            let (iterations, residual) = (report.iterations, report.residual);
            return Err(SolveError::NotConverged { iterations, residual, tolerance: goal.tolerance });
        }
        precondition(&work.r, &mut work.z);
        level(&mut work.z);
        work.q.copy_from_slice(&work.z);
        let mut rz = dot(&work.r, &work.z);
        let before = report.iterations;
        while report.iterations < goal.max_iterations {
            apply(&work.q, &mut work.aq);
            level(&mut work.aq);
            let curvature = dot(&work.q, &work.aq);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            report.iterations += 1;
            let step = rz / curvature;
            for i in 0..n {
                x[i] += step * work.q[i];
                work.r[i] -= step * work.aq[i];
            }
            // A tenth to spare: the recurrence drifts.
            if norm(&work.r) <= 0.9 * target {
                break;
            }
            precondition(&work.r, &mut work.z);
            level(&mut work.z);
            let next = sum(n, |i| work.r[i] * work.z[i]);
            let keep = next / rz;
            rz = next;
            for i in 0..n {
                work.q[i] = work.z[i] + keep * work.q[i];
            }
        }
        if report.iterations == before {
            return Err(SolveError::Breakdown {
                method: "conjugate gradients",
                iterations: report.iterations,
                residual: norm(&work.r) / size,
                reason: "the operator has no curvature along the residual",
                cure: "the flow asks for a change of density that no pressure can make; try a smaller `time.courant`",
            });
        }
    }
    report.seconds = started.elapsed().as_secs_f64();
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `−u''` on a row of points between zeros.
    fn row(q: &[f64], aq: &mut [f64]) {
        for i in 0..q.len() {
            let left = if i > 0 { q[i - 1] } else { 0.0 };
            let right = if i + 1 < q.len() { q[i + 1] } else { 0.0 };
            aq[i] = 2.0 * q[i] - left - right;
        }
    }

    fn halved(r: &[f64], z: &mut [f64]) {
        z.iter_mut().zip(r).for_each(|(z, r)| *z = r / 2.0);
    }

    #[test]
    fn the_residual_of_a_report_is_that_of_the_solution() {
        let (b, mut x) = ((0..40).map(|i| f64::from(i % 7) - 2.5).collect::<Vec<_>>(), vec![0.3; 40]);
        let goal = Goal { tolerance: 1e-6, negligible: 0.0, max_iterations: 100 };
        let report = solve(row, |_| (), halved, &b, &mut x, goal, &mut Workspace::default()).unwrap();
        let mut ax = vec![0.0; 40];
        row(&x, &mut ax);
        let residual = norm(&b.iter().zip(&ax).map(|(b, ax)| b - ax).collect::<Vec<_>>()) / norm(&b);
        assert_eq!(report.residual, residual);
        assert!(residual <= 1e-6 && report.iterations > 0, "{report:?}");
        // From the solution there is nothing to do.
        let again = solve(row, |_| (), halved, &b, &mut x, goal, &mut Workspace::default()).unwrap();
        assert_eq!(again.iterations, 0);
    }

    #[test]
    fn too_few_iterations_are_an_error_that_says_how_far_they_came() {
        let (b, mut x) = (vec![1.0; 40], vec![0.0; 40]);
        let goal = Goal { tolerance: 1e-6, negligible: 0.0, max_iterations: 5 };
        let error = solve(row, |_| (), halved, &b, &mut x, goal, &mut Workspace::default()).unwrap_err();
        let SolveError::NotConverged { iterations: 5, residual, .. } = error else { panic!("{error}") };
        assert!(residual > 1e-6, "{residual}");
        // Unless what is left means nothing.
        let goal = Goal { negligible: 100.0, ..goal };
        assert!(solve(row, |_| (), halved, &b, &mut x, goal, &mut Workspace::default()).is_ok());
    }

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
