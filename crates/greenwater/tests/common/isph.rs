//! The incompressible method, from (11), (16)-(18), (20), (29)-(31).

use std::f64::consts::TAU;

use greenwater::scheme::Medium;
use greenwater::scheme::isph_paper::{IsphPaperSettings, Laplacian, SurfaceGhosts, WallGuard};

use super::{Flow, along, dot};

/// Density below a share of that at rest.
pub fn surface_by_density<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, settings: &IsphPaperSettings) -> Vec<bool> {
    flow.bodies.iter().map(|b| b.density < settings.surface_threshold * medium.rest_density).collect()
}

/// Whether a particle carries a pressure of its own: fluid, and the first line of walls.
fn carries(layer: u8) -> bool {
    layer <= 1
}

/// Acceleration without pressure: gravity, (18) with walls, and artificial viscosity among fluid with a sound of `10 sqrt(2 g H)`.
fn without_pressure<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, settings: &IsphPaperSettings, i: usize) -> [f64; D] {
    let g = dot(medium.gravity.0, medium.gravity.0).sqrt();
    let sound = 10.0 * (2.0 * g * medium.depth).sqrt();
    let mut a = medium.gravity.0;
    for j in (0..flow.bodies.len()).filter(|&j| j != i) {
        let (x, r) = flow.apart(i, j);
        let (grad, v, h, m) = (flow.grad(i, j), flow.v(i, j), flow.h(i, j), flow.bodies[j].mass);
        let soft = r * r + (settings.eta * h) * (settings.eta * h);
        let sum = flow.bodies[i].density + flow.bodies[j].density;
        a = along(a, m * 8.0 * medium.viscosity / (sum * sum) * dot(x, grad) / soft, v);
        let approach = dot(v, x);
        if approach < 0.0 && flow.bodies[j].fluid() {
            a = along(a, m * settings.alpha * sound * h * approach / soft / (sum / 2.0), grad);
        }
    }
    a
}

/// `-grad p/rho` of fluid particle `i` by (20), over fluid and the first line of walls. Round a surface particle every neighbour
/// `j` has a mirror image at `2 x_i - x_j` with the opposite pressure.
fn pressure_force<const D: usize>(flow: &Flow<D>, settings: &IsphPaperSettings, surface: &[bool], i: usize) -> [f64; D] {
    let at = |k: usize| flow.bodies[k].pressure / flow.bodies[k].density.powi(2);
    let mut a = [0.0; D];
    for j in (0..flow.bodies.len()).filter(|&j| j != i && carries(flow.bodies[j].layer)) {
        let (grad, m) = (flow.grad(i, j), flow.bodies[j].mass);
        a = along(a, -m * (at(i) + at(j)), grad);
        if surface[i] && settings.surface_ghosts == SurfaceGhosts::Mirrored {
            a = along(a, -m * (at(i) - at(j)), grad.map(|g| -g));
        }
    }
    a
}

/// What the library holds after `start`: the density (11), and gravity, viscosity and the pressure that was given.
pub fn start<const D: usize>(
    flow: &mut Flow<D>,
    medium: &Medium<D>,
    settings: &IsphPaperSettings,
    surface: impl Fn(&Flow<D>) -> Vec<bool>,
) -> (Vec<[f64; D]>, Vec<bool>) {
    sum_densities(flow);
    let surface = surface(flow);
    let acceleration = (0..flow.bodies.len())
        .map(|i| {
            let whole = |i| along(without_pressure(flow, medium, settings, i), 1.0, pressure_force(flow, settings, &surface, i));
            if flow.bodies[i].fluid() { whole(i) } else { [0.0; D] }
        })
        .collect();
    (acceleration, surface)
}

/// One step (29)-(31). The densities in (18) are those the step before summed at its predicted positions. A guard of walls
/// knows flat floors at height 0 only. Returns the surface flags at the predicted positions.
pub fn advance<const D: usize>(
    flow: &mut Flow<D>,
    medium: &Medium<D>,
    settings: &IsphPaperSettings,
    dt: f64,
    surface: impl Fn(&Flow<D>) -> Vec<bool>,
) -> Vec<bool> {
    let n = flow.bodies.len();
    let before = flow.clone();
    for i in (0..n).filter(|&i| before.bodies[i].fluid()) {
        let b = &mut flow.bodies[i];
        b.v = along(b.v, dt, without_pressure(&before, medium, settings, i));
        b.x = along(b.x, dt, b.v);
    }
    sum_densities(flow);
    let surface = surface(flow);

    // (31): one row a particle that carries a pressure; zero pressure on the surface.
    let unknown: Vec<usize> = (0..n).filter(|&i| carries(flow.bodies[i].layer) && !surface[i]).collect();
    let mut matrix = vec![vec![0.0; unknown.len()]; unknown.len()];
    let mut source = vec![0.0; unknown.len()];
    for (row, &i) in unknown.iter().enumerate() {
        for j in (0..n).filter(|&j| j != i && carries(flow.bodies[j].layer)) {
            let coefficient = laplacian(flow, settings, i, j);
            matrix[row][row] += coefficient;
            if let Ok(column) = unknown.binary_search(&j) {
                matrix[row][column] -= coefficient;
            }
        }
        let rest = medium.rest_density;
        source[row] = (rest - flow.bodies[i].density) / (rest * dt * dt);
    }
    let solution = eliminate(matrix, source);
    for b in &mut flow.bodies {
        b.pressure = 0.0;
    }
    for (&i, p) in unknown.iter().zip(solution) {
        flow.bodies[i].pressure = p;
    }

    // (30): from the predicted velocity, and from the position before the step.
    let predicted = flow.clone();
    for i in (0..n).filter(|&i| before.bodies[i].fluid()) {
        let b = &mut flow.bodies[i];
        b.v = along(b.v, dt, pressure_force(&predicted, settings, &surface, i));
        b.x = along(along(before.bodies[i].x, dt / 2.0, before.bodies[i].v), dt / 2.0, b.v);
    }
    if settings.wall_guard == WallGuard::SetBack {
        for b in flow.bodies.iter_mut().filter(|b| b.fluid() && b.x[D - 1] < 0.0) {
            (b.x[D - 1], b.v[D - 1]) = (0.0, b.v[D - 1].max(0.0));
        }
    }
    surface
}

fn sum_densities<const D: usize>(flow: &mut Flow<D>) {
    let sums: Vec<f64> = (0..flow.bodies.len()).map(|i| flow.summation(i)).collect();
    for (b, sum) in flow.bodies.iter_mut().zip(sums) {
        b.density = sum;
    }
}

/// Factor of `p_i - p_j` in (16) or (17).
fn laplacian<const D: usize>(flow: &Flow<D>, settings: &IsphPaperSettings, i: usize, j: usize) -> f64 {
    let (x, r) = flow.apart(i, j);
    let (h, m) = (flow.h(i, j), flow.bodies[j].mass);
    let (rho_i, rho_j) = (flow.bodies[i].density, flow.bodies[j].density);
    let along_x = dot(x, flow.grad(i, j));
    match settings.laplacian {
        Laplacian::ShaoLo => m * 8.0 / (rho_i + rho_j).powi(2) * along_x / (r * r + (settings.eta * h).powi(2)),
        Laplacian::Brookshaw => m * 2.0 / (rho_i * rho_j) * along_x / (r * r),
    }
}

/// Gauss elimination with row pivoting.
fn eliminate(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap_or(k);
        a.swap(k, pivot);
        b.swap(k, pivot);
        let (above, below) = a.split_at_mut(k + 1);
        for (offset, row) in below.iter_mut().enumerate() {
            let factor = row[k] / above[k][k];
            if factor != 0.0 {
                for (x, y) in row[k..].iter_mut().zip(&above[k][k..]) {
                    *x -= factor * y;
                }
                b[k + 1 + offset] -= factor * b[k];
            }
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    b
}

/// Share of a fine set of directions in which the circle (sphere) of `radius` round particle `i` is outside all discs (balls)
/// of the same radius round its neighbours, and the largest angle between directions that were looked at.
pub fn open_directions<const D: usize>(flow: &Flow<D>, radius: f64, i: usize, count: usize) -> f64 {
    let near: Vec<[f64; D]> =
        (0..flow.bodies.len()).filter(|&j| j != i).map(|j| flow.apart(j, i)).filter(|(_, r)| *r < 2.0 * radius).map(|(x, _)| x).collect();
    let golden = TAU * (5.0_f64.sqrt() - 1.0) / 2.0;
    let open = (0..count).filter(|&k| {
        let direction: [f64; D] = if D == 2 {
            let angle = TAU * (k as f64 + 0.5) / count as f64;
            std::array::from_fn(|d| if d == 0 { angle.cos() } else { angle.sin() })
        } else {
            // Even on the sphere: heights in even steps, turned by the golden angle.
            let height = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
            let (ring, angle) = ((1.0 - height * height).sqrt(), golden * k as f64);
            std::array::from_fn(|d| [ring * angle.cos(), ring * angle.sin(), height][d])
        };
        let point = direction.map(|e| radius * e);
        near.iter().all(|x| {
            let apart = along(point, -1.0, *x);
            dot(apart, apart) > radius * radius
        })
    });
    open.count() as f64 / count as f64
}
