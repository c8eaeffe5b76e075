//! Krylov methods and defect correction, one restart at a time.
//!
//! Each function starts from the true residual in `r`, improves `x`, and returns the number of iterations it made: at least
//! one, at most [`System::budget`]. It ends when its recurrence meets the target or cannot go on; the caller then computes
//! the true residual and decides. Preconditioning is from the right (symmetric for CG), so that the recurrence follows the
//! true residual. Nothing is allocated.

use super::CsrMatrix;
use super::csr::{add_scaled, scale_add};
use super::preconditioner::Preconditioner;
use super::sliced::Sliced;
use crate::reduce::{dot, norm};

/// `A x = b` as one restart sees it.
pub(super) struct System<'a> {
    pub(super) a: &'a CsrMatrix,
    pub(super) m: &'a mut Preconditioner,
    /// Norm of the residual to reach.
    pub(super) target: f64,
    /// Most iterations of this restart.
    pub(super) budget: usize,
}

/// Why the first iteration of a restart was impossible.
pub(super) struct Stuck {
    pub(super) reason: &'static str,
    pub(super) cure: &'static str,
}

/// Work vectors of a size, reused.
#[derive(Debug, Default)]
pub(super) struct Vectors {
    pub(super) r: Vec<f64>,
    p: Vec<f64>,
    q: Vec<f64>,
    pub(super) z: Vec<f64>,
    shadow: Vec<f64>,
    t: Vec<f64>,
    /// GMRES: orthonormal basis, vector after vector.
    basis: Vec<f64>,
    /// GMRES: triangular factor of the Hessenberg matrix, column after column.
    triangle: Vec<f64>,
    rotations: Vec<(f64, f64)>,
    rhs: Vec<f64>,
}

impl Vectors {
    pub(super) fn resize(&mut self, n: usize) {
        for vector in [&mut self.r, &mut self.p, &mut self.q, &mut self.z] {
            vector.resize(n, 0.0);
        }
    }
}

/// Work vectors of [`cg_sliced`], in room that somebody lends.
pub(super) struct Lent<'a> {
    pub(super) r: &'a mut [f64],
    p: &'a mut [f64],
    z: &'a mut [f64],
}

impl<'a> Lent<'a> {
    /// For `n` rows: `room` holds three times as many numbers or more.
    pub(super) fn of(room: &'a mut [f64], n: usize) -> Self {
        let (r, room) = room.split_at_mut(n);
        let (p, room) = room.split_at_mut(n);
        Self { r, p, z: &mut room[..n] }
    }
}

/// Conjugate gradients.
pub(super) fn cg(system: &mut System, x: &mut [f64], v: &mut Vectors) -> Result<usize, Stuck> {
    let Vectors { r, p, q, z, .. } = v;
    system.m.apply(r, z);
    p.copy_from_slice(z);
    let mut rz = dot(r, z);
    for iteration in 1..=system.budget {
        system.a.multiply(p, q);
        let pq = dot(p, q);
        // Also false for NaN.
        if !(pq > 0.0 && rz > 0.0) {
            let cure = "choose method `gmres` or `bicgstab`, and give each connected part of the fluid a row with known pressure";
            return done_or_stuck(iteration - 1, Stuck { reason: "matrix or preconditioner is not positive definite", cure });
        }
        let alpha = rz / pq;
        add_scaled(x, alpha, p);
        add_scaled(r, -alpha, q);
        if norm(r) <= system.target {
            return Ok(iteration);
        }
        system.m.apply(r, z);
        let rz_old = std::mem::replace(&mut rz, dot(r, z));
        scale_add(p, rz / rz_old, z);
    }
    Ok(system.budget)
}

/// Conjugate gradients on a matrix in slices, until the residual has fallen to `target` or for `budget` iterations; `precondition(r, z)` sets
/// `z = M⁻¹ r`.
pub(super) fn cg_sliced(
    a: &Sliced,
    mut precondition: impl FnMut(&[f64], &mut [f64]),
    (target, budget): (f64, usize),
    x: &mut [f64],
    v: &mut Lent,
) -> Result<usize, Stuck> {
    let Lent { r, p, z } = v;
    precondition(r, z);
    p.copy_from_slice(z);
    let mut rz = dot(r, z);
    for iteration in 1..=budget {
        // The preconditioned residual is in `p`, and makes room for `A p`.
        a.with_double(p, z, |ap, z| *z = ap);
        let pq = dot(p, z);
        // Also false for NaN.
        if !(pq > 0.0 && rz > 0.0) {
            let cure = "choose method `gmres` or `bicgstab`, and give each connected part of the fluid a row with known pressure";
            return done_or_stuck(iteration - 1, Stuck { reason: "matrix or preconditioner is not positive definite", cure });
        }
        let alpha = rz / pq;
        add_scaled(x, alpha, p);
        add_scaled(r, -alpha, z);
        if norm(r) <= target {
            return Ok(iteration);
        }
        precondition(r, z);
        let rz_old = std::mem::replace(&mut rz, dot(r, z));
        scale_add(p, rz / rz_old, z);
    }
    Ok(budget)
}

/// Stabilised bi-conjugate gradients.
pub(super) fn bicgstab(system: &mut System, x: &mut [f64], v: &mut Vectors) -> Result<usize, Stuck> {
    let Vectors { r, p, q, z, shadow, t, .. } = v;
    t.resize(r.len(), 0.0);
    shadow.clone_from(r);
    p.copy_from_slice(r);
    let mut rho = dot(shadow, r);
    for iteration in 1..=system.budget {
        system.m.apply(p, z);
        system.a.multiply(z, q);
        let alpha = rho / dot(shadow, q);
        if !(alpha.is_finite() && alpha != 0.0) {
            let cure = "choose method `gmres`";
            return done_or_stuck(iteration - 1, Stuck { reason: "the shadow residual became orthogonal", cure });
        }
        add_scaled(x, alpha, z);
        add_scaled(r, -alpha, q);
        if norm(r) <= system.target {
            return Ok(iteration);
        }
        system.m.apply(r, z);
        system.a.multiply(z, t);
        let omega = dot(t, r) / dot(t, t);
        if !(omega.is_finite() && omega != 0.0) {
            return Ok(iteration);
        }
        add_scaled(x, omega, z);
        add_scaled(r, -omega, t);
        if norm(r) <= system.target {
            return Ok(iteration);
        }
        let rho_old = std::mem::replace(&mut rho, dot(shadow, r));
        // p = r + β (p − ω q)
        add_scaled(p, -omega, q);
        scale_add(p, (rho / rho_old) * (alpha / omega), r);
    }
    Ok(system.budget)
}

/// Defect correction by the preconditioner: `x += ω z`, `z = M⁻¹ r`, with the `ω` that leaves the least residual,
/// `ω = (A z·r)/(A z·A z)`, so that no step makes it larger.
pub(super) fn defect_correction(system: &mut System, x: &mut [f64], v: &mut Vectors) -> Result<usize, Stuck> {
    let Vectors { r, q, z, .. } = v;
    for iteration in 1..=system.budget {
        system.m.apply(r, z);
        system.a.multiply(z, q);
        let omega = dot(q, r) / dot(q, q);
        if !(omega.is_finite() && omega != 0.0) {
            let cure = "choose method `gmres`";
            return done_or_stuck(iteration - 1, Stuck { reason: "no correction makes the defect smaller", cure });
        }
        add_scaled(x, omega, z);
        add_scaled(r, -omega, q);
        if norm(r) <= system.target {
            return Ok(iteration);
        }
    }
    Ok(system.budget)
}

/// One cycle of GMRES of at most `restart` vectors: modified Gram-Schmidt, Givens rotations.
pub(super) fn gmres(system: &mut System, restart: usize, x: &mut [f64], v: &mut Vectors) -> Result<usize, Stuck> {
    let Vectors { r, q, z, basis, triangle, rotations, rhs, .. } = v;
    let n = r.len();
    let vectors = restart.min(system.budget).min(n);
    basis.resize((restart.min(n) + 1) * n, 0.0);
    triangle.clear();
    rotations.clear();
    rhs.clear();

    let beta = norm(r);
    rhs.push(beta);
    scale_into(&mut basis[..n], 1.0 / beta, r);
    for k in 0..vectors {
        let (known, next) = basis.split_at_mut((k + 1) * n);
        system.m.apply(&known[k * n..], z);
        system.a.multiply(z, q);
        let column = triangle.len();
        for u in known.chunks_exact(n) {
            let h = dot(q, u);
            add_scaled(q, -h, u);
            triangle.push(h);
        }
        let below = norm(q);
        for (i, &(c, s)) in rotations.iter().enumerate() {
            let (upper, lower) = (triangle[column + i], triangle[column + i + 1]);
            triangle[column + i] = c * upper + s * lower;
            triangle[column + i + 1] = c * lower - s * upper;
        }
        let corner = triangle[column + k];
        let length = (corner * corner + below * below).sqrt();
        if !(length > 0.0 && length.is_finite()) {
            triangle.truncate(column);
            break;
        }
        let (c, s) = (corner / length, below / length);
        rotations.push((c, s));
        triangle[column + k] = length;
        let error = rhs[k];
        rhs[k] = c * error;
        rhs.push(-s * error);
        if rhs[k + 1].abs() <= system.target || below == 0.0 {
            break;
        }
        scale_into(&mut next[..n], 1.0 / below, q);
    }

    // Back substitution, then x += M⁻¹ V y.
    let size = rotations.len();
    for i in (0..size).rev() {
        let column = |k: usize| k * (k + 1) / 2;
        let known: f64 = (i + 1..size).map(|k| triangle[column(k) + i] * rhs[k]).sum();
        rhs[i] = (rhs[i] - known) / triangle[column(i) + i];
    }
    q.fill(0.0);
    for (u, &y) in basis.chunks_exact(n).zip(&rhs[..size]) {
        add_scaled(q, y, u);
    }
    system.m.apply(q, z);
    add_scaled(x, 1.0, z);
    done_or_stuck(
        size,
        Stuck {
            reason: "the matrix maps the residual to nothing",
            cure: "the matrix is singular or its entries overflow: give each connected part of the fluid a row with known pressure",
        },
    )
}

fn scale_into(y: &mut [f64], s: f64, x: &[f64]) {
    super::csr::blockwise(y, x, |y, x| *y = s * x);
}

/// After some progress a method may go on from the true residual; without any it is stuck.
fn done_or_stuck(iterations: usize, stuck: Stuck) -> Result<usize, Stuck> {
    if iterations > 0 { Ok(iterations) } else { Err(stuck) }
}
