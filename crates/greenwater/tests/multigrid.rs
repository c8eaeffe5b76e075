//! Multigrid on pressure equations of particles: iterations that hardly grow, closed domains, splashes, threads.

use greenwater::kernel::{Kernel, WendlandC2};
use greenwater::math::Vector;
use greenwater::neighbors::{Neighbors, Search};
use greenwater::particles::{Kind, Particle, Particles};
use greenwater::poisson::{CsrMatrix, LinearSolver, PreconditionerKind, SolveReport, SolverMethod, SolverSettings};

/// Uniform number in [-1, 1) made of an index.
fn noise(i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for _ in 0..3 {
        z = (z ^ (z >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    (z >> 10) as f64 / (1u64 << 53) as f64 - 1.0
}

/// What of the fluid touches air.
#[derive(Clone, Copy, PartialEq)]
enum Air {
    /// Nothing.
    Nowhere,
    /// The top row: pressure zero half a spacing above.
    OnTop,
    /// The top row, and a tenth of the particles as drops of one to three far above.
    Splashes,
}

/// The compact pressure operator `Σ 2f (p_a − p_b)` of a column of `m` particles to a side, each moved by up to a tenth of a spacing.
fn column<const D: usize>(m: usize, air: Air) -> CsrMatrix {
    let mut p = Particles::<D>::new();
    let fluid = |x: Vector<D>| Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h: 1.3 };
    let sides: [usize; D] = std::array::from_fn(|d| if d == D - 1 { 2 * m } else { m });
    for i in 0..sides.iter().product() {
        let mut rest = i;
        let cell: [usize; D] = std::array::from_fn(|d| {
            let at = rest % sides[d];
            rest /= sides[d];
            at
        });
        let x = Vector(std::array::from_fn(|d| cell[d] as f64 + 0.1 * noise(D * i + d)));
        let drop = air == Air::Splashes && i % 10 == 0;
        // Strings of drops that touch nothing else.
        let up = if drop { (6.0 * m as f64) * Vector::<D>::unit(D - 1) + 0.9 * x } else { Vector::ZERO };
        p.push(i as u32, fluid(x + up));
    }
    let mut near = Neighbors::new();
    near.build(&p, Kernel::<D>::radius(WendlandC2), Search::Grid).unwrap();
    let top = 2.0 * m as f64 - 1.5;
    let mut a = CsrMatrix::new();
    a.assemble(p.owned(), |i, row| {
        let mut diagonal = 0.0;
        near.for_each(i, |pair| {
            let f = -2.0 * Kernel::<D>::dw_over_r(WendlandC2, pair.r, pair.h);
            diagonal += f;
            row.push(pair.b, -f);
        });
        // A row under a flat surface misses about a quarter of its neighbours; twice that where the pressure is odd about the surface.
        let open = air != Air::Nowhere && p.x[i][D - 1] > top;
        row.push(i, if open { diagonal + 1.0 } else if diagonal == 0.0 { 1.0 } else { diagonal });
    });
    a
}

fn source(a: &CsrMatrix) -> Vec<f64> {
    let p: Vec<f64> = (0..a.rows()).map(|i| 1.0 + noise(i)).collect();
    let mut b = vec![0.0; a.rows()];
    a.multiply(&p, &mut b);
    b
}

fn solve(a: &CsrMatrix, method: SolverMethod, preconditioner: PreconditionerKind) -> (SolveReport, Vec<f64>) {
    let b = source(a);
    let mut solver = LinearSolver::new(SolverSettings { method, preconditioner, tolerance: 1e-6, ..SolverSettings::default() }).unwrap();
    let mut x = vec![0.0; a.rows()];
    let report = solver.solve(a, &b, &mut x).unwrap_or_else(|error| panic!("{error}"));
    (report, x)
}

#[test]
fn timing() {
    let one = |name: &str, a: &CsrMatrix| {
        for kind in [PreconditionerKind::Jacobi, PreconditionerKind::Ic0, PreconditionerKind::Multigrid] {
            let (r, _) = solve(a, SolverMethod::Cg, kind);
            println!("{name} n {} nnz/row {:.0} {kind:?}: {} its, {:.1} ms, setup {:.1} ms", a.rows(), a.entries() as f64 / a.rows() as f64, r.iterations, 1e3 * r.seconds, 1e3 * r.setup_seconds);
        }
    };
    for m in [20, 40, 80, 160] { one("2D", &column::<2>(m, Air::OnTop)); }
    for m in [12, 20, 32] { one("3D", &column::<3>(m, Air::OnTop)); }
    one("2D splash", &column::<2>(80, Air::Splashes));
    one("2D closed", &column::<2>(80, Air::Nowhere));
}
