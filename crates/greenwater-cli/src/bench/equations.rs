//! `bench poisson`: pressure equations of disordered particles by three preconditioners, set-up included.

use greenwater::kernel::{Kernel, WendlandC2};
use greenwater::math::Vector;
use greenwater::neighbors::{Neighbors, Search};
use greenwater::particles::{Kind, Particle, Particles};
use greenwater::poisson::{CsrMatrix, LinearSolver, PreconditionerKind, SolveError, SolveReport, SolverMethod, SolverSettings};
use serde_json::{Map, json};

use super::record::Record;
use super::session::Session;
use super::watch::{Lap, least_wall, repeated, seconds};
use super::{BenchError, Clock, Plan, memory, with_threads};

/// A column of liquid under air.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its name.
    pub name: &'static str,
    /// Dimensions of space.
    pub dimension: u32,
    /// Particles across; twice as many upwards.
    pub across: usize,
    /// Whether it is measured with `--quick`.
    pub quick: bool,
}

const fn column(name: &'static str, dimension: u32, across: usize, quick: bool) -> Column {
    Column { name, dimension, across, quick }
}

/// All of them.
pub static WORKLOADS: [Column; 10] = [
    column("column-2d-1k", 2, 22, true),
    column("column-2d-10k", 2, 71, true),
    column("column-2d-20k", 2, 100, false),
    column("column-2d-100k", 2, 224, false),
    column("column-2d-1m", 2, 707, false),
    column("column-3d-1k", 3, 8, true),
    column("column-3d-10k", 3, 17, false),
    column("column-3d-20k", 3, 22, false),
    column("column-3d-100k", 3, 37, false),
    column("column-3d-1m", 3, 79, false),
];

/// Conjugate gradients, by preconditioner; the first is the plain way.
const SOLVERS: [(&str, PreconditionerKind); 3] =
    [("jacobi-cg", PreconditionerKind::Jacobi), ("ic0-cg", PreconditionerKind::Ic0), ("multigrid-cg", PreconditionerKind::Multigrid)];

/// Relative residual of a solution.
const TOLERANCE: f64 = 1e-6;

/// Above so many unknowns the solvers that need thousands of iterations are timed once.
const ONCE_FROM: usize = 200_000;

/// Solves every equation with every solver and number of threads.
pub fn measure<'a>(
    columns: impl Iterator<Item = &'a Column>,
    plan: &Plan,
    session: &Session,
    clock: &Clock,
) -> Result<Vec<Record>, BenchError> {
    let mut records: Vec<Record> = Vec::new();
    for column in columns {
        let most = plan.threads.last().copied().unwrap_or(1);
        let (matrix, source) = with_threads(most, || -> Result<_, BenchError> {
            let matrix = match column.dimension {
                2 => matrix::<2>(column.across)?,
                _ => matrix::<3>(column.across)?,
            };
            let source = source(&matrix);
            Ok((matrix, source))
        })??;
        for &threads in &plan.threads {
            for (solver, preconditioner) in SOLVERS {
                let once = matrix.rows() >= ONCE_FROM && preconditioner != PreconditionerKind::Multigrid;
                let plan = if once { Plan { repeats: 1, seconds: 0.0, ..plan.clone() } } else { plan.clone() };
                let (times, report, bytes, product) = with_threads(threads, || -> Result<_, BenchError> {
                    if !once {
                        // The first solve of a program wakes threads and fills caches.
                        solve(&matrix, &source, preconditioner)?;
                    }
                    let gauge = memory::Gauge::start();
                    let (times, report) = repeated(&plan, || Ok(solve(&matrix, &source, preconditioner)?))?;
                    let bytes = gauge.peak();
                    let mut y = vec![0.0; matrix.rows()];
                    let (products, ()) = repeated(&plan, || {
                        matrix.multiply(&source, &mut y);
                        Ok(())
                    })?;
                    Ok((times, report, bytes, seconds(&products, threads).min))
                })??;
                let record = record(column, solver, threads, &matrix, (&times, report, bytes, product), session, &records);
                clock.say(&format!(
                    "{}: {} unknowns, {threads} threads, {solver}: {} iterations, {:.3e} s",
                    column.name,
                    matrix.rows(),
                    report.iterations,
                    seconds(&times, threads).min
                ));
                records.push(record);
            }
        }
    }
    Ok(records)
}

/// A solve from nothing: set-up, and iterations from zero.
fn solve(matrix: &CsrMatrix, source: &[f64], preconditioner: PreconditionerKind) -> Result<SolveReport, SolveError> {
    let settings = SolverSettings {
        method: SolverMethod::Cg,
        preconditioner,
        tolerance: TOLERANCE,
        max_iterations: 20_000,
        ..SolverSettings::default()
    };
    LinearSolver::new(settings)?.solve(matrix, source, &mut vec![0.0; matrix.rows()])
}

fn record(
    column: &Column,
    solver: &str,
    threads: usize,
    matrix: &CsrMatrix,
    (times, report, bytes, product): (&[Lap], SolveReport, usize, f64),
    session: &Session,
    before: &[Record],
) -> Record {
    let (n, seconds) = (matrix.rows(), seconds(times, threads));
    let find =
        |threads: usize, method: &str| before.iter().find(|r| r.workload == column.name && r.threads == threads && r.method == method);
    let mut extra = Map::from_iter([
        ("entries".to_owned(), json!(matrix.entries())),
        ("nanoseconds_an_unknown".to_owned(), json!(1e9 * seconds.min / n as f64)),
        ("wall_seconds".to_owned(), json!(least_wall(times))),
        ("products".to_owned(), json!(seconds.min / product)),
    ]);
    if let Some(one) = find(1, solver).and_then(|r| r.extra.get("wall_seconds")?.as_f64()).filter(|_| threads > 1) {
        extra.insert("speed_up".into(), json!(one / least_wall(times)));
    }
    if let Some(ceiling) = session.ceiling(threads) {
        // A product reads the matrix, 12 bytes an entry, and two columns, at the least.
        let least = 12.0 * matrix.entries() as f64 + 16.0 * n as f64;
        extra.insert("product_bandwidth_share".into(), json!(least / product / ceiling.bytes_per_s));
    }
    Record {
        bench: "poisson".into(),
        workload: column.name.into(),
        method: solver.to_owned(),
        dimension: column.dimension,
        particles: n,
        threads,
        seconds: Some(seconds),
        repetitions: times.len(),
        bytes_per_particle: Some(bytes as f64 / n as f64),
        iterations: Some(report.iterations as f64),
        ratio_to_naive: Some(find(threads, SOLVERS[0].0).and_then(|r| r.seconds).map_or(1.0, |jacobi| jacobi.min / seconds.min)),
        phases: [("setup".into(), report.setup_seconds), ("iterations".into(), report.seconds - report.setup_seconds)].into(),
        extra,
        ..Record::default()
    }
}

/// A number in [-1, 1) made of an index.
fn noise(i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for _ in 0..3 {
        z = (z ^ (z >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    (z >> 10) as f64 / (1u64 << 53) as f64 - 1.0
}

/// The compact pressure operator `Σ 2f (p_a − p_b)` of a column, each particle moved by up to a tenth of a spacing; the pressure is zero
/// half a spacing above the top row, and walls are where there are no neighbours.
fn matrix<const D: usize>(across: usize) -> Result<CsrMatrix, BenchError> {
    let mut p = Particles::<D>::new();
    let sides: [usize; D] = std::array::from_fn(|d| if d == D - 1 { 2 * across } else { across });
    for i in 0..sides.iter().product() {
        let mut rest = i;
        // The upward axis fastest, as cases number particles.
        let mut x = Vector::ZERO;
        for d in (0..D).rev() {
            x[d] = (rest % sides[d]) as f64 + 0.1 * noise(D * i + d);
            rest /= sides[d];
        }
        p.push(i as u32, Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h: 1.3 });
    }
    let mut near = Neighbors::new();
    near.build(&p, Kernel::<D>::radius(WendlandC2), Search::Grid)?;
    let top = 2.0 * across as f64 - 1.5;
    let mut matrix = CsrMatrix::new();
    matrix.assemble(p.owned(), |i, row| {
        let mut diagonal = 0.0;
        near.for_each(i, |pair| {
            let f = -2.0 * Kernel::<D>::dw_over_r(WendlandC2, pair.r, pair.h);
            diagonal += f;
            row.push(pair.b, -f);
        });
        // A row under a flat surface misses about a quarter of its neighbours; twice that where the pressure is odd about the surface.
        row.push(i, if p.x[i][D - 1] > top { diagonal + 1.0 } else { diagonal });
    });
    Ok(matrix)
}

/// The right-hand side whose solution is one plus noise: every wave length is in it.
fn source(matrix: &CsrMatrix) -> Vec<f64> {
    let p: Vec<f64> = (0..matrix.rows()).map(|i| 1.0 + noise(i)).collect();
    let mut b = vec![0.0; matrix.rows()];
    matrix.multiply(&p, &mut b);
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1e-3: a residual of 1e-6 times a condition of some thousand.
    #[test]
    fn the_three_solvers_agree_and_multigrid_takes_the_fewest_iterations() {
        let matrix = matrix::<2>(20).expect("finite positions");
        let b = source(&matrix);
        let mut iterations = Vec::new();
        for (name, preconditioner) in SOLVERS {
            let settings = SolverSettings { preconditioner, tolerance: TOLERANCE, ..SolverSettings::default() };
            let mut x = vec![0.0; matrix.rows()];
            let report = LinearSolver::new(settings).expect("sound").solve(&matrix, &b, &mut x).expect("solved");
            let worst = x.iter().enumerate().map(|(i, x)| (x - 1.0 - noise(i)).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-3, "{name}: {worst}");
            iterations.push(report.iterations);
        }
        assert!(iterations[2] < iterations[1] && iterations[1] < iterations[0], "{iterations:?}");
    }
}
