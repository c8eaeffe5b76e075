//! Figs. 6-8 and Table 2 of the paper: Gauss and preconditioned GMRES on pressure equations of the dam break.

use std::time::Instant;

use greenwater::kernel::CubicSpline;
use greenwater::poisson::{CsrMatrix, LinearSolver, PreconditionerKind, SolverMethod, SolverSettings};
use greenwater::scheme::{IsphPaper, MethodName, MethodSettings, Scheme};
use greenwater::time::Phases;
use serde_json::{Map, json};

use super::plan::Plan;
use super::record::{Record, Seconds};
use super::{BenchError, Clock, dam_break, with_threads};

/// A pressure equation of the dam break.
pub struct Equation {
    /// Particles across the column.
    pub columns: u32,
    /// Time of the flow, s.
    pub time: f64,
    matrix: CsrMatrix,
    source: Vec<f64>,
}

/// A solver of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// Elimination on the dense matrix, as in the paper.
    Gauss,
    /// Restarted GMRES with ILU(0), as in the paper.
    Pgmres,
    /// What `isph-paper` uses unless told otherwise.
    Default,
}

impl Solver {
    /// In the order of tables.
    pub const ALL: [Self; 3] = [Self::Gauss, Self::Pgmres, Self::Default];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gauss => "Gauss",
            Self::Pgmres => "PGMRES",
            Self::Default => "CG, IC(0)",
        }
    }

    fn settings(self) -> SolverSettings {
        let settings = SolverSettings::default();
        match self {
            Self::Gauss => SolverSettings { method: SolverMethod::Gauss, ..settings },
            Self::Pgmres => SolverSettings { method: SolverMethod::Gmres, preconditioner: PreconditionerKind::Ilu0, ..settings },
            Self::Default => settings,
        }
    }
}

/// Time of one solver on one equation.
#[derive(Clone, Debug)]
pub struct Solve {
    /// The solver.
    pub solver: Solver,
    /// Particles across the column.
    pub columns: u32,
    /// Time of the flow at which the equation was met, s.
    pub time: f64,
    /// Rows of the matrix: all particles, fluid and wall.
    pub rows: usize,
    /// Stored entries of the matrix.
    pub entries: usize,
    /// Number of threads.
    pub threads: usize,
    /// Time of a solve from zero to a residual of 1e-6, s.
    pub seconds: Seconds,
    /// Solves timed.
    pub repetitions: usize,
    /// Iterations.
    pub iterations: usize,
    /// Part of the last solve that went into factors or the preconditioner, s.
    pub setup_seconds: f64,
}

/// All solves.
#[derive(Clone, Debug)]
pub struct Results {
    /// By size, then solver, then threads.
    pub solves: Vec<Solve>,
    /// Numbers of threads, rising from 1.
    pub threads: Vec<usize>,
    /// Columns of the sizes of Table 2.
    pub sizes: Vec<u32>,
}

/// Solves the pressure equations of all sizes with one thread, and those of the sizes of Table 2 with every number of threads.
pub fn measure(plan: &Plan, clock: &Clock) -> Result<Results, BenchError> {
    let mut solves = Vec::new();
    let mut columns: Vec<u32> = plan.equations.iter().chain(&plan.sizes).copied().collect();
    columns.sort_unstable();
    columns.dedup();
    for m in columns {
        let equation = with_threads(plan.most_threads(), || Equation::of(m, plan.equation_time))??;
        let threads = if plan.sizes.contains(&m) { plan.threads.as_slice() } else { &[1] };
        for solver in Solver::ALL {
            for &threads in threads {
                let solve = with_threads(threads, || time(&equation, solver, threads, plan.seconds_a_point))??;
                let (rows, seconds) = (solve.rows, solve.seconds.min);
                clock.say(&format!("pressure equation: {}, {rows} rows, {threads} threads: {seconds:.3e} s", solver.name()));
                solves.push(solve);
            }
        }
    }
    Ok(Results { solves, threads: plan.threads.clone(), sizes: plan.sizes.clone() })
}

impl Equation {
    /// The equation that ISPH solves in the first step at or after `time`, s.
    pub fn of(columns: u32, time: f64) -> Result<Self, BenchError> {
        let setup = dam_break(columns, MethodName::IsphPaper, None, &[])?;
        let MethodSettings::IsphPaper(settings) = setup.method.clone() else {
            unreachable!("the case was asked for with isph-paper");
        };
        let mut scheme = IsphPaper::new(CubicSpline, setup.medium(), settings)?;
        let (mut particles, mut domain) = (setup.particles.clone(), setup.domain());
        scheme.start(&mut particles, &mut domain)?;
        let mut now = 0.0;
        loop {
            let dt = scheme.time_step(&particles).dt;
            scheme.step(&mut particles, &mut domain, dt, &mut Phases::default())?;
            if now >= time {
                let (matrix, source) = scheme.pressure_equation();
                return Ok(Self { columns, time: now, matrix: matrix.clone(), source: source.to_vec() });
            }
            now += dt;
        }
    }
}

fn time(equation: &Equation, solver: Solver, threads: usize, budget: f64) -> Result<Solve, BenchError> {
    let mut linear = LinearSolver::new(solver.settings())?;
    let mut pressure = vec![0.0; equation.matrix.rows()];
    let started = Instant::now();
    let mut times = Vec::new();
    let mut report = linear.solve(&equation.matrix, &equation.source, &mut pressure)?;
    // The first solve allocates and is not counted; a dense elimination that takes longer than the budget is made twice more.
    while times.len() < 2 || (started.elapsed().as_secs_f64() < budget && times.len() < 1000) {
        pressure.fill(0.0);
        let clock = Instant::now();
        report = linear.solve(&equation.matrix, &equation.source, &mut pressure)?;
        times.push(clock.elapsed().as_secs_f64());
    }
    Ok(Solve {
        solver,
        columns: equation.columns,
        time: equation.time,
        rows: equation.matrix.rows(),
        entries: equation.matrix.entries(),
        threads,
        seconds: Seconds::of(&times),
        repetitions: times.len(),
        iterations: report.iterations,
        setup_seconds: report.setup_seconds,
    })
}

impl Results {
    /// The solve of one solver, size and number of threads.
    pub fn find(&self, solver: Solver, columns: u32, threads: usize) -> Option<&Solve> {
        self.solves.iter().find(|s| s.solver == solver && s.columns == columns && s.threads == threads)
    }

    /// Serial solves of one solver, by size.
    pub fn serial(&self, solver: Solver) -> impl Iterator<Item = &Solve> {
        self.solves.iter().filter(move |s| s.solver == solver && s.threads == 1)
    }

    /// Largest number of threads.
    pub fn most_threads(&self) -> usize {
        self.threads.last().copied().unwrap_or(1)
    }

    /// Speed-up `S_m = T_1/T_m`.
    pub fn speed_up(&self, solver: Solver, columns: u32, threads: usize) -> Option<f64> {
        Some(self.find(solver, columns, 1)?.seconds.min / self.find(solver, columns, threads)?.seconds.min)
    }

    /// Rows of the JSON file.
    pub fn records(&self) -> Vec<Record> {
        let record = |s: &Solve| {
            let mut extra = Map::new();
            extra.insert("entries".into(), json!(s.entries));
            if let Some(speed_up) = self.speed_up(s.solver, s.columns, s.threads) {
                extra.insert("speed_up".into(), json!(speed_up));
                extra.insert("efficiency".into(), json!(speed_up / s.threads as f64));
            }
            Record {
                bench: "poisson".into(),
                workload: format!("pressure equation of the dam break, m = {}, t = {:.3} s", s.columns, s.time),
                method: s.solver.name().into(),
                dimension: 2,
                particles: s.rows,
                threads: s.threads,
                seconds: Some(s.seconds),
                repetitions: s.repetitions,
                iterations: Some(s.iterations as f64),
                ratio_to_naive: self.find(Solver::Gauss, s.columns, 1).map(|gauss| gauss.seconds.min / s.seconds.min),
                phases: [("setup".into(), s.setup_seconds)].into(),
                extra,
                ..Record::default()
            }
        };
        self.solves.iter().map(record).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1e-4: each solution is within 1e-6 in the residual, and the matrix is conditioned like the square of the size, some hundred.
    #[test]
    fn all_solvers_find_the_same_pressure() {
        let equation = Equation::of(6, 0.05).expect("a short flow");
        assert_eq!(equation.matrix.rows(), 2 * 36 + 180 + 9);
        assert!(equation.time >= 0.05 && equation.source.iter().any(|b| *b != 0.0));
        let solutions = Solver::ALL.map(|solver| {
            let mut x = vec![0.0; equation.matrix.rows()];
            LinearSolver::new(solver.settings()).expect("sound").solve(&equation.matrix, &equation.source, &mut x).expect("solved");
            x
        });
        let largest = solutions[0].iter().fold(0.0f64, |most, p| most.max(p.abs()));
        for other in &solutions[1..] {
            let worst = other.iter().zip(&solutions[0]).fold(0.0f64, |most, (p, q)| most.max((p - q).abs()));
            assert!(worst < 1e-4 * largest, "{worst} of {largest}");
        }
    }
}
