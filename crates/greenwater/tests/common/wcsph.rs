//! The explicit method, from (13)-(15), (20)-(28), (33)-(34).

use greenwater::scheme::Medium;
use greenwater::scheme::wcsph::{EquationOfState, WallForce, WcsphSettings};

use super::{Flow, along, dot};

/// What the twin computes from a state.
pub struct Rates<const D: usize> {
    pub pressure: Vec<f64>,
    pub acceleration: Vec<[f64; D]>,
    pub density_rate: Vec<f64>,
}

const GAMMA: i32 = 7;

/// (20)-(25) and the forces of walls. `start` holds the heights at the start, for the reading of (26) with the initial height.
pub fn rates<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, settings: &WcsphSettings, start: &[f64]) -> Rates<D> {
    let n = flow.bodies.len();
    let g = dot(medium.gravity.0, medium.gravity.0).sqrt();
    let rest = medium.rest_density;
    let depth = settings.depth.unwrap_or(medium.depth);
    let now = heights(flow, medium, settings);
    let at_floor = settings.stiffness * rest * g * depth / f64::from(GAMMA);
    let share = |y: f64| (settings.stiffness * rest * g * (depth - y) / f64::from(GAMMA)).max(settings.stiffness_floor * at_floor);
    let b: Vec<f64> = (0..n)
        .map(|i| match settings.equation_of_state {
            EquationOfState::Constant => at_floor,
            EquationOfState::InitialHeight => share(start[i]),
            EquationOfState::CurrentHeight => share(now[i]),
        })
        .collect();
    let ratio = |i: usize| flow.bodies[i].density / rest;
    let pressure: Vec<f64> = (0..n).map(|i| b[i] * (ratio(i).powi(GAMMA) - 1.0)).collect();
    let sound: Vec<f64> = (0..n).map(|i| (f64::from(GAMMA) * b[i] / rest * ratio(i).powi(GAMMA - 1)).sqrt()).collect();
    let fluid: Vec<usize> = (0..n).filter(|&i| flow.bodies[i].fluid()).collect();

    // (23), (24): twice the diagonal less two thirds of the divergence, component by component.
    let mut stress = vec![[[0.0; D]; D]; n];
    for &i in &fluid {
        for &j in &fluid {
            let (grad, v) = (flow.grad(i, j), flow.v(j, i));
            let volume = flow.bodies[j].mass / flow.bodies[j].density;
            for a in 0..D {
                for c in 0..D {
                    stress[i][a][c] += volume
                        * if a == c {
                            let others: f64 = (0..D).filter(|&e| e != a).map(|e| v[e] * grad[e]).sum();
                            2.0 / 3.0 * (2.0 * v[a] * grad[a] - others)
                        } else {
                            v[a] * grad[c] + v[c] * grad[a]
                        };
                }
            }
        }
    }

    let normals = normals(flow);
    let mut acceleration = vec![[0.0; D]; n];
    let mut density_rate = vec![0.0; n];
    for &i in &fluid {
        let (rho_i, mut a) = (flow.bodies[i].density, medium.gravity.0);
        for &j in &fluid {
            let (grad, v) = (flow.grad(i, j), flow.v(i, j));
            let (x, r) = flow.apart(i, j);
            let (m, rho_j, h) = (flow.bodies[j].mass, flow.bodies[j].density, flow.h(i, j));
            let approach = dot(v, x);
            let phi = h * approach / (r * r + settings.eta * settings.eta * h * h);
            let viscous = settings.beta * phi * phi - settings.alpha * (sound[i] + sound[j]) / 2.0 * phi;
            let artificial = if approach < 0.0 { viscous / ((rho_i + rho_j) / 2.0) } else { 0.0 };
            a = along(a, -m * (pressure[i] / (rho_i * rho_i) + pressure[j] / (rho_j * rho_j) + artificial), grad);
            for c in 0..D {
                for e in 0..D {
                    let pair = stress[i][e][c] / (rho_i * rho_i) + stress[j][e][c] / (rho_j * rho_j);
                    a[c] += m * medium.viscosity * pair * grad[e];
                }
            }
            density_rate[i] += m * dot(v, grad);
        }
        for j in (0..n).filter(|&j| !flow.bodies[j].fluid()) {
            a = along(a, 1.0, wall_force(flow, medium, settings, g * depth, i, j, normals[j]));
        }
        acceleration[i] = a;
    }
    Rates { pressure, acceleration, density_rate }
}

/// Height of every particle above the floor, against gravity.
pub fn heights<const D: usize>(flow: &Flow<D>, medium: &Medium<D>, settings: &WcsphSettings) -> Vec<f64> {
    let g = dot(medium.gravity.0, medium.gravity.0).sqrt();
    let floor = settings.floor.unwrap_or(medium.floor);
    flow.bodies.iter().map(|b| if g > 0.0 { -dot(b.x, medium.gravity.0) / g - floor } else { 0.0 }).collect()
}

/// (34), or Monaghan (2005): `0.02 c^2/y` times a spline of the distance `y` from the wall, falling to zero one spacing aside.
fn wall_force<const D: usize>(
    flow: &Flow<D>,
    medium: &Medium<D>,
    settings: &WcsphSettings,
    gh: f64,
    i: usize,
    j: usize,
    normal: [f64; D],
) -> [f64; D] {
    let (x, r) = flow.apart(i, j);
    let h = flow.h(i, j);
    if r >= 2.0 * h {
        return [0.0; D];
    }
    let (strength, range) = (settings.wall_strength.unwrap_or(5.0 * gh), settings.wall_range.unwrap_or(medium.spacing));
    let [high, low] = settings.wall_exponents.map(|e| e as i32);
    match settings.wall_force {
        WallForce::LennardJones if r >= range => [0.0; D],
        WallForce::LennardJones | WallForce::LennardJonesAttractive => {
            let f = strength * ((range / r).powi(high) - (range / r).powi(low)) / (r * r);
            x.map(|x| f * x)
        }
        WallForce::Monaghan2005 => {
            let y = dot(x, normal);
            let aside = (r * r - y * y).max(0.0).sqrt();
            if y <= 0.0 || aside >= medium.spacing {
                return [0.0; D];
            }
            let q = y / h;
            let spline = if q < 2.0 / 3.0 {
                2.0 / 3.0
            } else if q < 1.0 {
                2.0 * q - 1.5 * q * q
            } else if q < 2.0 {
                (2.0 - q).powi(2) / 2.0
            } else {
                0.0
            };
            let share = flow.bodies[j].mass / (flow.bodies[i].mass + flow.bodies[j].mass);
            let f = share * 0.02 * settings.stiffness * gh / y * spline * (1.0 - aside / medium.spacing);
            normal.map(|n| f * n)
        }
    }
}

/// Unit normals of first-line wall particles, away from the other wall particles; zero for all others.
pub fn normals<const D: usize>(flow: &Flow<D>) -> Vec<[f64; D]> {
    let wall = |j: &usize| !flow.bodies[*j].fluid();
    (0..flow.bodies.len())
        .map(|i| {
            if flow.bodies[i].layer != 1 {
                return [0.0; D];
            }
            let sum = (0..flow.bodies.len())
                .filter(wall)
                .fold([0.0; D], |sum, j| along(sum, -flow.bodies[j].mass / flow.bodies[j].density, flow.grad(i, j)));
            let length = dot(sum, sum).sqrt();
            if length > 0.0 { sum.map(|n| n / length) } else { sum }
        })
        .collect()
}

/// `steps` steps of the leapfrog (27)-(28) with one force evaluation each: velocities and densities at full steps are those of
/// the half step before, carried on with the old rates.
pub fn advance<const D: usize>(flow: &mut Flow<D>, medium: &Medium<D>, settings: &WcsphSettings, dt: f64, steps: usize) {
    let start = heights(flow, medium, settings);
    let mut half: Vec<([f64; D], f64)> = flow.bodies.iter().map(|b| (b.v, b.density)).collect();
    for step in 0..steps {
        let now = rates(flow, medium, settings, &start);
        let kick = if step == 0 { dt / 2.0 } else { dt };
        for (i, b) in flow.bodies.iter_mut().enumerate().filter(|(_, b)| b.fluid()) {
            let (a, rate) = (now.acceleration[i], now.density_rate[i]);
            half[i] = (along(half[i].0, kick, a), half[i].1 + kick * rate);
            b.x = along(b.x, dt, half[i].0);
            b.v = along(half[i].0, dt / 2.0, a);
            b.density = half[i].1 + dt / 2.0 * rate;
        }
    }
}
