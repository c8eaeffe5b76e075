//! Linear solvers against dense elimination, analytic solutions and each other.

use PreconditionerKind::{Ic0, Ilu0, Jacobi, None as Plain};
use SolverMethod::{Bicgstab, Cg, DefectCorrection, Gauss, Gmres};
use greenwater::poisson::{CsrMatrix, LinearSolver, PreconditionerKind, SolveError, SolveReport, SolverMethod, SolverSettings};

const SYMMETRIC: [(SolverMethod, PreconditionerKind); 13] = [
    (Gauss, Plain),
    (Cg, Plain),
    (Cg, Jacobi),
    (Cg, Ilu0),
    (Cg, Ic0),
    (Gmres, Plain),
    (Gmres, Jacobi),
    (Gmres, Ilu0),
    (Gmres, Ic0),
    (Bicgstab, Plain),
    (Bicgstab, Jacobi),
    (Bicgstab, Ilu0),
    (Bicgstab, Ic0),
];

fn solver(method: SolverMethod, preconditioner: PreconditionerKind, tolerance: f64) -> LinearSolver {
    LinearSolver::new(SolverSettings { method, preconditioner, tolerance, ..SolverSettings::default() }).unwrap()
}

fn solve(
    method: SolverMethod,
    preconditioner: PreconditionerKind,
    tolerance: f64,
    a: &CsrMatrix,
    b: &[f64],
) -> Result<(Vec<f64>, SolveReport), SolveError> {
    let mut x = vec![0.0; b.len()];
    let report = solver(method, preconditioner, tolerance).solve(a, b, &mut x)?;
    Ok((x, report))
}

/// Uniform number in [0, 1) made of an index: three rounds of multiply and shift.
fn noise(seed: u64, i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed.wrapping_mul(0xd1b5_4a32_d192_ed03);
    for _ in 0..3 {
        z = (z ^ (z >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    (z >> 11) as f64 / (1u64 << 53) as f64
}

fn vector(seed: u64, n: usize) -> Vec<f64> {
    (0..n).map(|i| 2.0 * noise(seed, i) - 1.0).collect()
}

/// M-matrix of `n` rows coupled at random to a few rows up to 40 away; `skew` tilts each coupling to one side, 0 keeps the
/// matrix symmetric. Diagonally dominant, as pressure rows beside a free surface are.
fn random_m_matrix(n: usize, skew: f64) -> CsrMatrix {
    let weight = |i: usize, j: usize| {
        let pair = i.min(j) * n + i.max(j);
        if noise(1, pair) < 0.15 { noise(2, pair) } else { 0.0 }
    };
    let mut a = CsrMatrix::new();
    a.assemble(n, |i, row| {
        let mut sum = 0.02;
        for j in i.saturating_sub(40)..n.min(i + 41) {
            let w = if j == i { 0.0 } else { weight(i, j) * if j > i { 1.0 + skew } else { 1.0 - skew } };
            if w > 0.0 {
                row.push(j, -w);
                sum += w;
            }
        }
        row.push(i, sum);
    });
    a
}

/// Five-point `−∇²` on the `m × m` interior points of the unit square, `p = 0` on its border, times `Δx²`.
fn lattice(m: usize) -> CsrMatrix {
    let mut a = CsrMatrix::new();
    a.assemble(m * m, |i, row| {
        let (x, y) = (i % m, i / m);
        row.push(i, 4.0);
        if y > 0 {
            row.push(i - m, -1.0);
        }
        if x > 0 {
            row.push(i - 1, -1.0);
        }
        if x + 1 < m {
            row.push(i + 1, -1.0);
        }
        if y + 1 < m {
            row.push(i + m, -1.0);
        }
    });
    a
}

/// `−p'' = b` with `p' = 0` at both ends: singular, constants are its null space.
fn closed_channel(n: usize) -> CsrMatrix {
    let mut a = CsrMatrix::new();
    a.assemble(n, |i, row| {
        for j in [i.wrapping_sub(1), i + 1].into_iter().filter(|&j| j < n) {
            row.push(j, -1.0);
            row.push(i, 1.0);
        }
    });
    a
}

fn largest_gap(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

fn relative_residual(a: &CsrMatrix, b: &[f64], x: &[f64]) -> f64 {
    let mut r = vec![0.0; b.len()];
    a.residual(x, b, &mut r);
    let norm = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    norm(&r) / norm(b)
}

#[test]
fn every_method_agrees_with_elimination_on_a_random_symmetric_m_matrix() {
    let a = random_m_matrix(600, 0.0);
    assert_eq!(a.asymmetry().1, 0.0);
    let b = vector(3, 600);
    let (exact, _) = solve(Gauss, Plain, 1e-10, &a, &b).unwrap();
    // A diagonal this heavy is close enough to correct defects with.
    for (method, preconditioner) in SYMMETRIC.into_iter().chain([(DefectCorrection, Jacobi), (DefectCorrection, Ic0)]) {
        let (x, report) = solve(method, preconditioner, 1e-10, &a, &b).unwrap();
        let true_residual = relative_residual(&a, &b, &x);
        // The smallest eigenvalue is 0.02, |b| about 14: an error of 14 · 1e-10 / 0.02 is the most a residual of 1e-10 allows.
        assert!(largest_gap(&x, &exact) < 1e-7, "{method:?} {preconditioner:?}: {:.1e}", largest_gap(&x, &exact));
        assert!((report.residual - true_residual).abs() < 1e-13, "reported {:.3e}, true {true_residual:.3e}", report.residual);
        assert_eq!(report.diagonal_shift, 0.0, "incomplete factors of a symmetric M-matrix exist");
    }
}

#[test]
fn every_general_method_agrees_with_elimination_on_a_nonsymmetric_matrix() {
    let a = random_m_matrix(500, 0.4);
    let b = vector(4, 500);
    let (exact, report) = solve(Gauss, Plain, 1e-10, &a, &b).unwrap();
    assert_eq!(report.iterations, 1);
    for method in [Gmres, Bicgstab] {
        for preconditioner in [Plain, Jacobi, Ilu0] {
            let (x, _) = solve(method, preconditioner, 1e-10, &a, &b).unwrap();
            assert!(largest_gap(&x, &exact) < 1e-7, "{method:?} {preconditioner:?}: {:.1e}", largest_gap(&x, &exact));
        }
    }
}

#[test]
fn methods_for_symmetric_matrices_refuse_others() {
    let a = random_m_matrix(100, 0.4);
    let b = vector(5, 100);
    for (method, preconditioner) in [(Cg, Plain), (Cg, Jacobi), (Cg, Ilu0), (Cg, Ic0), (Gmres, Ic0), (Bicgstab, Ic0)] {
        let error = solve(method, preconditioner, 1e-6, &a, &b).unwrap_err();
        assert!(matches!(error, SolveError::NotSymmetric { .. }), "{method:?} {preconditioner:?}: {error}");
        assert!(error.to_string().contains("gmres"), "no cure in: {error}");
    }
}

/// `sin(kπx) sin(lπy)` is an eigenvector of the five-point matrix with eigenvalue `4 − 2 cos(kπΔx) − 2 cos(lπΔx)`.
#[test]
fn the_poisson_equation_on_a_lattice_has_its_analytic_solution() {
    let (m, k, l) = (40, 2.0, 3.0);
    let step = std::f64::consts::PI / (m + 1) as f64;
    let eigenvalue = 4.0 - 2.0 * (k * step).cos() - 2.0 * (l * step).cos();
    let exact: Vec<f64> = (0..m * m).map(|i| (k * step * (i % m + 1) as f64).sin() * (l * step * (i / m + 1) as f64).sin()).collect();
    // A second mode, so that the right-hand side is no eigenvector and the methods have work to do.
    let other: Vec<f64> = (0..m * m).map(|i| (step * (i % m + 1) as f64).sin() * (step * (i / m + 1) as f64).sin()).collect();
    let lowest = 4.0 - 4.0 * step.cos();
    let solution: Vec<f64> = exact.iter().zip(&other).map(|(e, o)| e + 0.5 * o).collect();
    let b: Vec<f64> = exact.iter().zip(&other).map(|(e, o)| eigenvalue * e + 0.5 * lowest * o).collect();
    for (method, preconditioner) in SYMMETRIC {
        let (x, _) = solve(method, preconditioner, 1e-10, &lattice(m), &b).unwrap();
        // |b| / λ_min · 1e-10 is 4e-8 at most in the 2-norm.
        let gap = largest_gap(&x, &solution);
        assert!(gap < 1e-8, "{method:?} {preconditioner:?}: {gap:.1e}");
    }
}

/// IC(0) lowers the condition number of the lattice by a factor of about ten, so iterations by about three.
#[test]
fn incomplete_factors_need_fewer_iterations_than_the_diagonal() {
    let a = lattice(60);
    let b = vector(6, 3600);
    let iterations = |method, preconditioner| solve(method, preconditioner, 1e-8, &a, &b).unwrap().1.iterations;
    let (jacobi, ic, ilu) = (iterations(Cg, Jacobi), iterations(Cg, Ic0), iterations(Cg, Ilu0));
    assert!(2 * ic < jacobi, "ic0 {ic}, jacobi {jacobi}");
    // On a symmetric matrix ILU(0) is IC(0) but for rounding.
    assert!(ic.abs_diff(ilu) <= 1, "ic0 {ic}, ilu0 {ilu}");
    assert!(2 * iterations(Gmres, Ilu0) < iterations(Gmres, Jacobi));
    assert!(2 * iterations(Bicgstab, Ilu0) < iterations(Bicgstab, Jacobi));
}

/// A tridiagonal matrix has no fill, so its incomplete factors are complete.
#[test]
fn incomplete_factors_of_a_tridiagonal_matrix_are_exact() {
    let n = 300;
    let tridiagonal = |left: f64, right: f64| {
        let mut a = CsrMatrix::new();
        a.assemble(n, |i, row| {
            row.push(i, 2.1);
            if i > 0 {
                row.push(i - 1, left);
            }
            if i + 1 < n {
                row.push(i + 1, right);
            }
        });
        a
    };
    let b = vector(7, n);
    for (method, preconditioner, right) in
        [(Gmres, Ilu0, -0.7), (Bicgstab, Ilu0, -0.7), (Cg, Ilu0, -1.0), (Cg, Ic0, -1.0), (Gmres, Ic0, -1.0)]
    {
        let (_, report) = solve(method, preconditioner, 1e-10, &tridiagonal(-1.0, right), &b).unwrap();
        assert_eq!(report.iterations, 1, "{method:?} {preconditioner:?}");
    }
}

#[test]
fn incomplete_cholesky_shifts_the_diagonal_where_a_pivot_is_lost_and_says_so() {
    // Kershaw's matrix (J. Comput. Phys. 26 (1978) 43), repeated: positive definite, but IC(0) meets a pivot of -5.
    let kershaw = [[3.0, -2.0, 0.0, 2.0], [-2.0, 3.0, -2.0, 0.0], [0.0, -2.0, 3.0, -2.0], [2.0, 0.0, -2.0, 3.0]];
    let mut a = CsrMatrix::new();
    a.assemble(200, |i, row| {
        for (j, &value) in kershaw[i % 4].iter().enumerate().filter(|(_, value)| **value != 0.0) {
            row.push(i - i % 4 + j, value);
        }
    });
    let b = vector(8, 200);
    let (exact, _) = solve(Gauss, Plain, 1e-10, &a, &b).unwrap();
    for method in [Cg, Gmres, Bicgstab] {
        let (x, report) = solve(method, Ic0, 1e-10, &a, &b).unwrap();
        assert!(report.diagonal_shift > 0.0 && report.diagonal_shift < 1.0, "shift {}", report.diagonal_shift);
        assert!(largest_gap(&x, &exact) < 1e-7, "{method:?}: {:.1e}", largest_gap(&x, &exact));
    }
}

#[test]
fn a_nearly_symmetric_matrix_is_solved_with_incomplete_cholesky() {
    // Entries across the diagonal differ by 4 %.
    let a = random_m_matrix(400, 0.02);
    let b = vector(9, 400);
    let (_, report) = solve(Gmres, Ic0, 1e-8, &a, &b).unwrap();
    assert!(report.residual <= 1e-8);
}

#[test]
fn a_singular_matrix_is_an_error() {
    let a = closed_channel(50);
    // The mean of b is not 0, so there is no solution.
    let b = vec![1.0; 50];
    for (method, preconditioner) in SYMMETRIC {
        let mut x = vec![0.0; 50];
        let error = solver(method, preconditioner, 1e-8).solve(&a, &b, &mut x).unwrap_err();
        assert!(
            matches!(error, SolveError::Singular { .. } | SolveError::Breakdown { .. } | SolveError::NotConverged { .. }),
            "{method:?} {preconditioner:?}: {error}"
        );
    }
    let error = solve(Gauss, Plain, 1e-8, &a, &b).unwrap_err();
    assert!(matches!(error, SolveError::Singular { row: 48..=49, .. }), "{error}");
}

#[test]
fn an_empty_row_is_an_error_that_names_it() {
    let mut a = CsrMatrix::new();
    a.assemble(10, |i, row| row.push(i, if i == 6 { 0.0 } else { 2.0 }));
    for (method, preconditioner) in [(Gauss, Plain), (Cg, Jacobi), (Cg, Ic0), (Gmres, Ilu0), (Bicgstab, Jacobi)] {
        let error = solve(method, preconditioner, 1e-8, &a, &vector(1, 10)).unwrap_err();
        assert!(matches!(error, SolveError::Singular { row: 6, pivot: 0.0, .. }), "{method:?}: {error}");
    }
}

#[test]
fn input_that_is_not_finite_is_an_error_that_names_it() {
    let good = lattice(10);
    let mut bad = CsrMatrix::new();
    bad.assemble(100, |i, row| row.push(i, if i == 17 { f64::INFINITY } else { 1.0 }));
    for (method, preconditioner) in SYMMETRIC {
        let mut solver = solver(method, preconditioner, 1e-6);
        let mut b = vector(1, 100);
        let mut x = vec![0.0; 100];
        let error = solver.solve(&bad, &b, &mut x).unwrap_err();
        assert!(matches!(error, SolveError::NotFinite { what: "matrix", row: 17, .. }), "{error}");
        x[9] = f64::NAN;
        let error = solver.solve(&good, &b, &mut x).unwrap_err();
        assert!(matches!(error, SolveError::NotFinite { what: "start vector", row: 9, .. }), "{error}");
        x[9] = 0.0;
        b[42] = f64::NAN;
        let error = solver.solve(&good, &b, &mut x).unwrap_err();
        assert!(matches!(error, SolveError::NotFinite { what: "right-hand side", row: 42, .. }), "{error}");
    }
    let error = solve(Cg, Plain, 1e-6, &good, &[1e-200; 100]).unwrap_err();
    assert!(matches!(error, SolveError::OutOfRange { .. }), "{error}");
    let error = solver(Cg, Plain, 1e-6).solve(&good, &[1.0; 99], &mut [0.0; 100]).unwrap_err();
    assert_eq!(error, SolveError::Shape { rows: 100, rhs: 99, solution: 100 });
}

#[test]
fn a_matrix_too_large_for_elimination_is_refused_before_memory_is_taken() {
    let n = 20_000;
    let mut a = CsrMatrix::new();
    a.assemble(n, |i, row| row.push(i, 1.0));
    let error = solve(Gauss, Plain, 1e-6, &a, &vec![1.0; n]).unwrap_err();
    assert!(matches!(error, SolveError::TooLarge { bytes: 3_200_000_000, .. }), "{error}");
}

#[test]
fn a_zero_right_hand_side_gives_zero_and_an_exact_start_no_iterations() {
    let a = lattice(20);
    let exact = vector(2, 400);
    let mut b = vec![0.0; 400];
    a.multiply(&exact, &mut b);
    for (method, preconditioner) in SYMMETRIC {
        let mut solver = solver(method, preconditioner, 1e-12);
        let mut x = exact.clone();
        let report = solver.solve(&a, &b, &mut x).unwrap();
        assert_eq!((report.iterations, &x), (0, &exact), "{method:?} {preconditioner:?}");
        let report = solver.solve(&a, &[0.0; 400], &mut x).unwrap();
        assert_eq!((report.iterations, report.residual), (0, 0.0));
        assert!(x.iter().all(|&x| x == 0.0));
    }
}

#[test]
fn a_solve_that_cannot_reach_its_tolerance_ends_with_an_error() {
    let a = lattice(30);
    let b = vector(3, 900);
    for (method, preconditioner) in SYMMETRIC {
        // Below the rounding of b − A x no method can tell a better x.
        let settings = SolverSettings { method, preconditioner, tolerance: 1e-18, max_iterations: 500, restart: 20 };
        let error = LinearSolver::new(settings).unwrap().solve(&a, &b, &mut [0.0; 900]).unwrap_err();
        match error {
            SolveError::NotConverged { residual, iterations, .. } => {
                assert!(residual < 1e-14 && iterations <= 500, "{method:?} {preconditioner:?}: {residual:.1e}");
            }
            other => assert!(matches!(other, SolveError::Breakdown { .. }), "{other}"),
        }
    }
    let settings = SolverSettings { max_iterations: 3, ..SolverSettings::default() };
    let error = LinearSolver::new(settings).unwrap().solve(&a, &b, &mut [0.0; 900]).unwrap_err();
    assert!(matches!(error, SolveError::NotConverged { iterations: 3, .. }), "{error}");
}

#[test]
fn conjugate_gradients_refuse_an_indefinite_matrix() {
    let mut a = CsrMatrix::new();
    a.assemble(40, |i, row| row.push(i, if i % 2 == 0 { 1.0 } else { -1.0 }));
    let error = solve(Cg, Plain, 1e-6, &a, &vec![1.0; 40]).unwrap_err();
    assert!(matches!(error, SolveError::Breakdown { method: "cg", .. }), "{error}");
    let error = solve(Cg, Ic0, 1e-6, &a, &vec![1.0; 40]).unwrap_err();
    assert!(matches!(error, SolveError::Singular { row: 1, pivot: -1.0, .. }), "{error}");
}

/// 200 × 200 rows of five entries: above the sizes from which products, sums and vectors are shared among threads.
#[test]
fn solutions_have_the_same_bits_for_any_number_of_threads() {
    let (large, small) = (lattice(200), random_m_matrix(700, 0.0));
    let runs = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut bits = Vec::new();
            for (method, preconditioner) in SYMMETRIC {
                let a = if method == Gauss { &small } else { &large };
                let (x, report) = solve(method, preconditioner, 1e-2, a, &vector(5, a.rows())).unwrap();
                bits.push((method, report.iterations, x.iter().map(|x| x.to_bits()).collect::<Vec<_>>()));
            }
            bits
        })
    });
    for k in 0..SYMMETRIC.len() {
        assert!(runs[0][k] == runs[1][k] && runs[0][k] == runs[2][k], "{:?}", SYMMETRIC[k]);
    }
}

#[test]
fn a_solver_serves_matrices_of_changing_size() {
    for (method, preconditioner) in SYMMETRIC {
        let mut solver = solver(method, preconditioner, 1e-8);
        for m in [12, 5, 20] {
            let b = vector(m as u64, m * m);
            let mut x = vec![0.0; m * m];
            solver.solve(&lattice(m), &b, &mut x).unwrap();
            assert!(relative_residual(&lattice(m), &b, &x) <= 1.001e-8, "{method:?} {preconditioner:?}, m = {m}");
        }
    }
}
