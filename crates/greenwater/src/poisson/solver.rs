//! One object that solves, again and again.

use std::time::Instant;

use super::dense::DenseLu;
use super::krylov::{self, Lent, Stuck, System, Vectors};
use super::preconditioner::Preconditioner;
use super::thrift::Thrift;
use super::{CsrMatrix, PreconditionerKind, Sliced, SolveError, SolveReport, SolverMethod, SolverSettings};
use crate::reduce::norm;
use crate::sweep::sweep;

/// Largest asymmetry (see [`CsrMatrix::asymmetry`]) of a matrix that CG accepts: rounding, with room to spare.
const CG_ASYMMETRY: f64 = 1e-6;

/// Largest asymmetry with which IC(0), which reads the lower triangle only, is of use to other methods.
const IC_ASYMMETRY: f64 = 0.1;

/// Steps of iterative refinement after which elimination has shown what it can.
const REFINEMENTS: usize = 10;

/// Solves after which a kept multigrid is built anew in any case: particles have moved by some spacings then.
pub(super) const OLDEST: usize = 20;

/// Iterations for a decade of the residual, over those of the solve after the build, from which a kept multigrid is too old.
const WORN: f64 = 1.5;

/// Share of what the start left that a solve of a sliced matrix may leave.
const LEFT: f64 = 0.1;

/// Relative residual that is rounding: weights have seven digits, and sums of them some more.
const SLICED_ROUNDING: f64 = 1e-10;

/// A multigrid that was built for an earlier matrix: it stays symmetric and positive, and slowly loses what it does. Or Jacobi in its place, which
/// has nothing to lose.
#[derive(Clone, Copy, Debug)]
struct Kept {
    jacobi: bool,
    rows: usize,
    solves: usize,
    /// Iterations for a decade of the residual in the solve after the build.
    fresh: Option<f64>,
    worn: bool,
}

/// Solver of `A x = b` with its settings and all its work vectors.
///
/// Repeated solves of one size allocate nothing. The matrix is factorised or preconditioned anew in every solve; multigrid is kept
/// while it serves.
pub struct LinearSolver {
    settings: SolverSettings,
    kept: Option<Kept>,
    thrift: Thrift,
    preconditioner: Preconditioner,
    dense: DenseLu,
    vectors: Vectors,
}

impl LinearSolver {
    /// Solver with these settings.
    ///
    /// # Errors
    /// [`SolveError::Setting`] if a value is out of its range.
    pub fn new(settings: SolverSettings) -> Result<Self, SolveError> {
        settings.check()?;
        Ok(Self {
            preconditioner: Preconditioner::new(settings.preconditioner),
            settings,
            kept: None,
            thrift: Thrift::default(),
            dense: DenseLu::new(),
            vectors: Vectors::default(),
        })
    }

    /// The settings of this solver.
    pub fn settings(&self) -> &SolverSettings {
        &self.settings
    }

    /// Solves `A x = b` from the start in `x`, until `|b − A x| ≤ tolerance · |b|`.
    ///
    /// The residual tested and reported is the true one: where the recurrence of a method has drifted from it, the method
    /// restarts from the true residual. A zero right-hand side gives `x = 0` in no iterations; a start that already is a
    /// solution is left as it is. The bits of `x` are the same for any number of threads.
    ///
    /// # Errors
    /// [`SolveError`] says what is wrong with the input, or why the method failed; `x` then is not a solution.
    pub fn solve(&mut self, a: &CsrMatrix, b: &[f64], x: &mut [f64]) -> Result<SolveReport, SolveError> {
        if a.rows() != b.len() || a.rows() != x.len() {
            return Err(SolveError::Shape { rows: a.rows(), rhs: b.len(), solution: x.len() });
        }
        // Entering the pool once is cheaper than at every product.
        rayon::scope(|_| self.solve_in_pool(a, b, x))
    }

    /// Whether these settings ask for what [`solve_sliced`](Self::solve_sliced) does: conjugate gradients with multigrid.
    pub fn takes_sliced(&self) -> bool {
        (self.settings.method, self.settings.preconditioner) == (SolverMethod::Cg, PreconditionerKind::Multigrid)
    }

    /// Whether the next solve for so many unknowns builds multigrid anew, or could: the time to number them anew.
    pub fn is_due(&self, rows: usize) -> bool {
        !self.serves(rows)
    }

    /// Forgets the multigrid that was kept: unknowns have other numbers now.
    pub fn forget(&mut self) {
        self.kept = None;
    }

    /// Solves `A x = b` for a positive definite `A` by conjugate gradients with multigrid, from the start in `x`, until
    /// `|b − A x| ≤ tolerance · max(|b|, size)`; the residual of the report is over the same. `size` is that of an equation of which this one
    /// corrects the solution, or 0.
    ///
    /// What the start leaves is reduced to a tenth in any case, unless it is rounding: where most of `b` never changes, such as the weight of
    /// still water, a start may be good enough for its size and still hold all that has happened since the solve before, which
    /// must not be left to grow.
    ///
    /// Levels below the matrix are kept from solve to solve as in [`solve`](Self::solve). When they are due, and Jacobi is the cheaper preconditioner, it
    /// takes their place for as long as it is: fluid in fragments, or little of it. What is cheaper is told by products with the matrix, which are
    /// counted, so that a run repeats itself to the bit.
    ///
    /// Overwrites `room`, which lends its work vectors: three numbers a row or more; panics where there are fewer.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn solve_sliced(&mut self, a: &Sliced, b: &[f64], x: &mut [f64], size: f64, room: &mut [f64]) -> Result<SolveReport, SolveError> {
        if a.rows() != b.len() || a.rows() != x.len() {
            return Err(SolveError::Shape { rows: a.rows(), rhs: b.len(), solution: x.len() });
        }
        let started = Instant::now();
        let mut report = SolveReport::default();
        let size = norm(b).max(size);
        if size == 0.0 {
            x.fill(0.0);
            return Ok(report);
        }
        let mut vectors = Lent::of(room, a.rows());
        let SolverSettings { tolerance, max_iterations, .. } = self.settings;
        let (mut from, mut before, mut goal) = (f64::NAN, 0, tolerance);
        loop {
            vectors.r.copy_from_slice(b);
            a.with_double(x, &mut *vectors.r, |ax, r| *r -= ax);
            let last = report.residual;
            report.residual = norm(vectors.r) / size;
            if !(report.residual.is_finite() && size.is_normal()) {
                return Err(sliced_not_finite(a, b, x, size, &report, last));
            }
            if report.iterations == 0 {
                goal = tolerance.min((LEFT * report.residual).max(SLICED_ROUNDING));
            }
            if report.residual <= goal {
                if let Some(rate) = self.look_after(report.iterations - before, from / report.residual) {
                    self.thrift.measured(rate * self.preconditioner.products(a));
                }
                report.seconds = started.elapsed().as_secs_f64();
                return Ok(report);
            }
            if report.iterations >= max_iterations {
                let SolveReport { iterations, residual, .. } = report;
                return Err(SolveError::NotConverged { iterations, residual, tolerance: goal });
            }
            if from.is_nan() {
                (from, before) = (report.residual, report.iterations);
            }
            if report.iterations == 0 && !self.serves(a.rows()) {
                if self.thrift.chooses_jacobi() {
                    self.kept = Some(Kept { jacobi: true, rows: a.rows(), solves: 0, fresh: None, worn: false });
                } else {
                    let setup = Instant::now();
                    self.build_below(a)?;
                    report.setup_seconds = setup.elapsed().as_secs_f64();
                }
            }
            let jacobi = self.kept.is_some_and(|kept| kept.jacobi);
            let decades = (report.residual / goal).log10();
            let left = max_iterations - report.iterations;
            let budget = left.min(if jacobi { self.thrift.allowance(decades) } else { self.patience(decades) });
            let (target, m, v) = ((goal * size, budget), &mut self.preconditioner, &mut vectors);
            let improved = if jacobi {
                krylov::cg_sliced(a, |r, z| sweep(z, |i| r[i] / a.diagonal(i)), target, x, v)
            } else {
                krylov::cg_sliced(a, |r, z| m.apply_to(a, r, z), target, x, v)
            };
            match improved {
                Ok(iterations) => {
                    report.iterations += iterations;
                    if iterations == budget && budget < left {
                        self.build_below(a)?;
                        from = f64::NAN;
                    }
                }
                Err(_) if self.kept.is_some_and(|kept| kept.jacobi || kept.solves > 0) => {
                    self.build_below(a)?;
                    from = f64::NAN;
                }
                Err(Stuck { reason, cure }) => {
                    let SolveReport { iterations, residual, .. } = report;
                    return Err(SolveError::Breakdown { method: name(SolverMethod::Cg), iterations, residual, reason, cure });
                }
            }
        }
    }

    /// Builds multigrid, in place of what was there.
    fn build_below(&mut self, a: &Sliced) -> Result<(), SolveError> {
        if self.kept.take().is_some_and(|kept| kept.jacobi) {
            self.thrift.dismiss_jacobi();
        }
        self.preconditioner.build_below(a)?;
        self.kept = Some(Kept { jacobi: false, rows: a.rows(), solves: 0, fresh: None, worn: false });
        Ok(())
    }

    fn solve_in_pool(&mut self, a: &CsrMatrix, b: &[f64], x: &mut [f64]) -> Result<SolveReport, SolveError> {
        let started = Instant::now();
        let mut report = SolveReport::default();
        if b.iter().all(|&b| b == 0.0) {
            x.fill(0.0);
            return Ok(report);
        }
        let b_norm = norm(b);
        self.vectors.resize(a.rows());
        let SolverSettings { tolerance, max_iterations, method, .. } = self.settings;
        let max_iterations = if method == SolverMethod::Gauss { max_iterations.min(REFINEMENTS) } else { max_iterations };

        // Residual and iterations when the preconditioner in use took over.
        let (mut from, mut before) = (f64::NAN, 0);
        loop {
            a.residual(x, b, &mut self.vectors.r);
            let last = report.residual;
            report.residual = norm(&self.vectors.r) / b_norm;
            if !(report.residual.is_finite() && b_norm.is_normal()) {
                let method = name(method);
                return Err(not_finite(method, a, b, x, b_norm, &report, last));
            }
            if report.residual <= tolerance {
                self.look_after(report.iterations - before, from / report.residual);
                report.seconds = started.elapsed().as_secs_f64();
                return Ok(report);
            }
            if report.iterations >= max_iterations {
                let SolveReport { iterations, residual, .. } = report;
                return Err(SolveError::NotConverged { iterations, residual, tolerance });
            }
            if from.is_nan() {
                (from, before) = (report.residual, report.iterations);
            }
            if report.iterations == 0 {
                let setup = Instant::now();
                report.diagonal_shift = self.prepare(a)?;
                report.setup_seconds = setup.elapsed().as_secs_f64();
            }
            let (target, left) = (tolerance * b_norm, max_iterations - report.iterations);
            let budget = left.min(self.patience((report.residual / tolerance).log10()));
            match self.restart(a, x, target, budget) {
                Ok(iterations) => {
                    report.iterations += iterations;
                    if iterations == budget && budget < left {
                        self.rebuild(a)?;
                        from = f64::NAN;
                    }
                }
                Err(_) if self.kept.is_some_and(|kept| kept.solves > 0) => {
                    self.rebuild(a)?;
                    from = f64::NAN;
                }
                Err(Stuck { reason, cure }) => {
                    let SolveReport { iterations, residual, .. } = report;
                    return Err(SolveError::Breakdown { method: name(method), iterations, residual, reason, cure });
                }
            }
        }
    }

    /// Factorises or preconditions; answers the shift of the diagonal.
    fn prepare(&mut self, a: &CsrMatrix) -> Result<f64, SolveError> {
        if self.serves(a.rows()) {
            return Ok(0.0);
        }
        let limit = match (self.settings.method, self.settings.preconditioner) {
            (SolverMethod::Gauss, _) => return self.dense.factor(a).map(|()| 0.0),
            (SolverMethod::Cg, _) => Some(("cg", CG_ASYMMETRY)),
            (_, PreconditionerKind::Ic0) => Some(("ic0", IC_ASYMMETRY)),
            (_, PreconditionerKind::Multigrid) => Some(("multigrid", IC_ASYMMETRY)),
            _ => None,
        };
        if let Some((stage, limit)) = limit {
            let (row, asymmetry) = a.asymmetry();
            if asymmetry > limit {
                return Err(SolveError::NotSymmetric { stage, row, asymmetry, limit });
            }
        }
        self.kept = None;
        let shift = self.preconditioner.build(a)?;
        if self.settings.preconditioner == PreconditionerKind::Multigrid {
            self.kept = Some(Kept { jacobi: false, rows: a.rows(), solves: 0, fresh: None, worn: false });
        }
        Ok(shift)
    }

    /// Whether a kept multigrid is good for a matrix of so many rows.
    fn serves(&self, rows: usize) -> bool {
        self.kept.is_some_and(|kept| kept.rows == rows && !kept.worn && kept.solves < OLDEST)
    }

    /// Iterations after which a kept multigrid has failed to reduce the residual by so many decades: the matrix has changed at once.
    fn patience(&self, decades: f64) -> usize {
        let rate = self.kept.filter(|kept| kept.solves > 0).and_then(|kept| kept.fresh);
        rate.map_or(usize::MAX, |rate| (2.0 * WORN * rate * decades) as usize + 5)
    }

    fn rebuild(&mut self, a: &CsrMatrix) -> Result<(), SolveError> {
        self.kept = None;
        self.prepare(a).map(|_| ())
    }

    /// Judges a kept multigrid by a solve of so many iterations that reduced the residual by `factor`; answers the iterations of a decade where
    /// this was its first.
    fn look_after(&mut self, iterations: usize, factor: f64) -> Option<f64> {
        let kept = self.kept.as_mut().filter(|_| iterations > 0)?;
        kept.solves += 1;
        // A tenth is the least from which a rate can be told.
        if kept.jacobi || factor < 10.0 {
            return None;
        }
        let rate = iterations as f64 / factor.log10();
        let first = kept.fresh.is_none();
        kept.worn = rate > WORN * *kept.fresh.get_or_insert(rate);
        first.then_some(rate)
    }

    /// Improves `x` from the true residual; answers the iterations made.
    fn restart(&mut self, a: &CsrMatrix, x: &mut [f64], target: f64, budget: usize) -> Result<usize, Stuck> {
        let v = &mut self.vectors;
        let mut system = System { a, m: &mut self.preconditioner, target, budget };
        match self.settings.method {
            SolverMethod::Gauss => {
                self.dense.refine(&v.r, x, &mut v.z);
                Ok(1)
            }
            SolverMethod::Gmres => krylov::gmres(&mut system, self.settings.restart, x, v),
            SolverMethod::Cg => krylov::cg(&mut system, x, v),
            SolverMethod::Bicgstab => krylov::bicgstab(&mut system, x, v),
            SolverMethod::DefectCorrection => krylov::defect_correction(&mut system, x, v),
        }
    }
}

fn name(method: SolverMethod) -> &'static str {
    match method {
        SolverMethod::Gauss => "gauss",
        SolverMethod::Gmres => "gmres",
        SolverMethod::Cg => "cg",
        SolverMethod::Bicgstab => "bicgstab",
        SolverMethod::DefectCorrection => "defect-correction",
    }
}

/// The error behind a residual of a sliced matrix that is not finite.
fn sliced_not_finite(a: &Sliced, b: &[f64], x: &[f64], size: f64, report: &SolveReport, last: f64) -> SolveError {
    let not_finite = |(_, value): &(usize, f64)| !value.is_finite();
    let vectors = [
        ("matrix", (0..a.rows()).map(|i| (i, a.diagonal(i))).find(not_finite)),
        ("right-hand side", b.iter().copied().enumerate().find(not_finite)),
        ("start vector", x.iter().copied().enumerate().find(not_finite).filter(|_| report.iterations == 0)),
    ];
    if let Some((what, (row, value))) = vectors.into_iter().find_map(|(what, found)| Some((what, found?))) {
        return SolveError::NotFinite { what, row, value };
    }
    if size.is_normal() {
        let (reason, cure) = ("the iterates overflowed", "choose another `method` or `preconditioner`");
        return SolveError::Breakdown { method: name(SolverMethod::Cg), iterations: report.iterations, residual: last, reason, cure };
    }
    SolveError::OutOfRange { what: "the right-hand side", value: size }
}

/// The error behind a residual that is not finite.
fn not_finite(method: &'static str, a: &CsrMatrix, b: &[f64], x: &[f64], b_norm: f64, report: &SolveReport, last: f64) -> SolveError {
    let first = |v: &[f64]| v.iter().position(|v| !v.is_finite()).map(|i| (i, v[i]));
    if let Some((row, value)) = a.first_not_finite() {
        return SolveError::NotFinite { what: "matrix", row, value };
    }
    if let Some((row, value)) = first(b) {
        return SolveError::NotFinite { what: "right-hand side", row, value };
    }
    if report.iterations > 0 {
        return SolveError::Breakdown {
            method,
            iterations: report.iterations,
            residual: last,
            reason: "the iterates overflowed",
            cure: "choose another `method` or `preconditioner`",
        };
    }
    if let Some((row, value)) = first(x) {
        return SolveError::NotFinite { what: "start vector", row, value };
    }
    if b_norm.is_normal() {
        SolveError::OutOfRange { what: "the first residual, relative to the right-hand side,", value: report.residual }
    } else {
        SolveError::OutOfRange { what: "the right-hand side", value: b_norm }
    }
}
