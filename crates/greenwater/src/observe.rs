//! What is looked at while a run goes on: energies, fronts, wall pressures, and how good the solution is.

mod sensors;

use std::io;

use crate::kernel::{Kernel, WendlandC2};
use crate::math::Vector;
use crate::neighbors::{Neighbors, Search};
use crate::particles::{Kind, Particles};
use crate::physics::pressure::Elasticity;
use crate::reduce::sum;
use crate::scheme::{Medium, StepReport};
use crate::sweep::sweep;
use crate::time::{Phases, StepLimit};

pub use sensors::{Gauge, GaugeKind, Load, LoadMean, Mount, Sensor, Wrench, gauge_unit, reach};

/// A state of the run, as observers see it.
#[derive(Clone, Copy)]
pub struct View<'a, const D: usize> {
    /// All particles; columns belong to [`time`](Self::time).
    pub particles: &'a Particles<D>,
    /// Steps made so far; 0 at the start.
    pub step: u64,
    /// Time of the flow, s.
    pub time: f64,
    /// The step that led here and what bounded it; absent at the start.
    pub limit: Option<StepLimit>,
    /// What the step did.
    pub report: StepReport,
    /// Where the time went so far.
    pub phases: &'a Phases,
    /// Wall-clock time since the start, s.
    pub elapsed: f64,
}

/// Looks at a run without changing it: writes frames, samples probes, adds up energies.
pub trait Observer<const D: usize> {
    /// Called with every state once: at the start and after every step, where the method has all fields of a state only behind the step from
    /// it, one step later.
    ///
    /// # Errors
    /// A file could not be written. An error of kind [`io::ErrorKind::Interrupted`] ends the run in good order.
    fn observe(&mut self, view: &View<D>) -> io::Result<()>;

    /// Called once when the run has ended, well or badly, with the last good state.
    ///
    /// # Errors
    /// A file could not be written.
    fn finish(&mut self, view: &View<D>) -> io::Result<()>;
}

/// Mechanical energy of the fluid, J (J/m in 2D).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energy {
    /// `Σ m v²/2`.
    pub kinetic: f64,
    /// `−Σ m g·x`, from the floor under the fluid at the start.
    pub potential: f64,
    /// Work stored in compression, `Σ m e(ρ)`; 0 for an incompressible method.
    pub elastic: f64,
}

impl Energy {
    /// The sum of all parts.
    pub fn total(&self) -> f64 {
        self.kinetic + self.potential + self.elastic
    }
}

/// Energy of the fluid now; `elasticity` is that of the method's equation of state.
pub fn energy<const D: usize>(p: &Particles<D>, medium: &Medium<D>, elasticity: Elasticity) -> Energy {
    let of_fluid = |value: &(dyn Fn(usize) -> f64 + Sync)| sum(p.owned(), |a| if p.is_fluid(a) { p.mass[a] * value(a) } else { 0.0 });
    Energy {
        kinetic: of_fluid(&|a| 0.5 * p.v[a].norm_squared()),
        potential: of_fluid(&|a| medium.g() * medium.height(p.x[a])),
        elastic: of_fluid(&|a| elasticity.energy(p.density[a], medium.rest_density)),
    }
}

/// Where the water stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Front {
    /// Distance of the leading edge from the back wall, m: the largest `x` of the body of fluid.
    pub front: f64,
    /// Height of the water at the back wall above the floor, m.
    pub residual_height: f64,
}

/// Front and residual height of the body of fluid: particles with at least three fluid neighbours within two spacings, so that
/// drops thrown ahead do not count. `back` is the position of the back wall along `x`, m. Half a spacing is added where the
/// fluid ends: particles are the middles of what they stand for. The height is taken within two spacings of the back wall.
///
/// Costs a few passes over the particles, no search: the outermost ones are tried in turn.
pub fn front<const D: usize>(p: &Particles<D>, medium: &Medium<D>, back: f64) -> Front {
    let half = 0.5 * medium.spacing;
    let reach = 2.0 * medium.spacing;
    let fluid = || (0..p.owned()).filter(|&a| p.is_fluid(a));
    let ahead = fluid().map(|a| (p.x[a][0] + half - back, a)).collect();
    let at_back = fluid().filter(|&a| p.x[a][0] - back <= reach).map(|a| (medium.height(p.x[a]) + half, a)).collect();
    Front { front: outermost(p, ahead, reach), residual_height: outermost(p, at_back, reach) }
}

/// The greatest value of a particle that has company: three fluid neighbours within `reach`, m. 0 if there is none above.
fn outermost<const D: usize>(p: &Particles<D>, mut rest: Vec<(f64, usize)>, reach: f64) -> f64 {
    // As many are sorted at a time.
    const AT_ONCE: usize = 32;
    let descending = |a: &(f64, usize), b: &(f64, usize)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
    let has_company = |a: usize| {
        let near = |&b: &usize| b != a && p.is_fluid(b) && (p.x[a] - p.x[b]).norm_squared() <= reach * reach;
        (0..p.owned()).filter(near).take(3).count() == 3
    };
    while !rest.is_empty() {
        let count = AT_ONCE.min(rest.len());
        rest.select_nth_unstable_by(count - 1, descending);
        rest[..count].sort_unstable_by(descending);
        if let Some(&(value, _)) = rest[..count].iter().find(|(_, a)| has_company(*a)) {
            return value.max(0.0);
        }
        rest.drain(..count);
    }
    0.0
}

/// How good a state is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// RMS residual of a local linear fit of the pressure over fluid within three spacings, over `ρ g H`; interior fluid.
    /// NaN when there is no interior.
    pub pressure_noise: f64,
    /// First percentile of the density of interior fluid, over the rest density.
    pub density_p01: f64,
    /// 99th percentile.
    pub density_p99: f64,
    /// Mean density of interior fluid, over the rest density.
    pub density_mean: f64,
    /// Volume `Σ m/ρ` of the interior fluid over `Σ m/ρ0`, minus one, with `ρ` by summation normalised by the initial lattice.
    pub volume_error: f64,
    /// Fluid particles that left the domain.
    pub lost_particles: usize,
}

/// Measures [`Quality`]; keeps its work space and the density that the kernel sums to inside a full lattice.
pub struct QualityMeter<const D: usize> {
    near: Neighbors<D>,
    wide: Particles<D>,
    lattice_sum: f64,
    full: usize,
    residuals: Vec<(f64, f64, f64)>,
}

/// Reach of the fit, in spacings.
const FIT_REACH: f64 = 3.0;

impl<const D: usize> QualityMeter<D> {
    /// A meter for particles of this spacing, m.
    pub fn new(spacing: f64) -> Self {
        let (lattice_sum, full) = lattice::<D>(spacing);
        Self { near: Neighbors::new(), wide: Particles::new(), lattice_sum, full, residuals: Vec::new() }
    }

    /// Measures the state. A particle is interior when the space within three spacings is full (walls count), so that no free
    /// surface is near.
    pub fn measure(&mut self, p: &Particles<D>, medium: &Medium<D>) -> Quality {
        self.wide.clone_from(p);
        // A search radius of three spacings: "h" of one and a half and a support of two.
        self.wide.h.fill(0.5 * FIT_REACH * medium.spacing);
        if self.near.build(&self.wide, 2.0, Search::Grid).is_err() {
            return Quality::unknown(p);
        }
        let (near, full) = (&self.near, self.full);
        let h = 1.3 * medium.spacing;
        self.residuals.resize(p.owned(), (f64::NAN, f64::NAN, f64::NAN));
        sweep(&mut self.residuals, |a| {
            // 0.9 of a full neighbourhood: half way to the 0.8 a particle two rows under a flat surface has left.
            if !p.is_fluid(a) || (near.of(a).len() as f64) < 0.9 * full as f64 {
                return (f64::NAN, f64::NAN, f64::NAN);
            }
            let volume = medium.spacing_volume();
            let mut sum = volume * Kernel::<D>::w(WendlandC2, 0.0, h);
            near.for_each(a, |pair| sum += volume * Kernel::<D>::w(WendlandC2, pair.r, h));
            (fit_residual(p, near, a, medium.spacing), p.density[a] / medium.rest_density, sum)
        });
        let interior = || self.residuals.iter().filter(|(residual, _, _)| residual.is_finite());
        let count = interior().count();
        if count == 0 {
            return Quality::unknown(p);
        }
        let square: f64 = interior().map(|(residual, _, _)| residual * residual).sum();
        let mut density: Vec<f64> = interior().map(|&(_, density, _)| density).collect();
        density.sort_unstable_by(f64::total_cmp);
        let volume: f64 = interior().map(|&(_, _, sum)| self.lattice_sum / sum).sum();
        Quality {
            pressure_noise: (square / count as f64).sqrt() / (medium.rest_density * medium.g() * medium.depth),
            density_p01: density[count / 100],
            density_p99: density[count - 1 - count / 100],
            density_mean: density.iter().sum::<f64>() / count as f64,
            volume_error: volume / count as f64 - 1.0,
            lost_particles: p.count(Kind::Lost),
        }
    }
}

impl Quality {
    /// Nothing could be measured but the lost particles.
    fn unknown<const D: usize>(p: &Particles<D>) -> Self {
        let nan = f64::NAN;
        Self {
            pressure_noise: nan,
            density_p01: nan,
            density_p99: nan,
            density_mean: nan,
            volume_error: nan,
            lost_particles: p.count(Kind::Lost),
        }
    }
}

/// Sum `Σ V W` of the Wendland C2 kernel at `h = 1.3` spacings, and number of neighbours within the fit's reach, inside a lattice.
fn lattice<const D: usize>(spacing: f64) -> (f64, usize) {
    let n = FIT_REACH.ceil() as i64;
    let side = 2 * n + 1;
    let points = (0..D).fold(1, |product, _| product * side);
    let h = 1.3 * spacing;
    let volume = (0..D).fold(1.0, |product, _| product * spacing);
    let (mut sum, mut count) = (0.0, 0);
    for i in 0..points {
        let mut rest = i;
        let x = Vector::<D>(std::array::from_fn(|_| {
            let along = rest % side - n;
            rest /= side;
            along as f64
        }));
        let r = x.norm();
        sum += volume * Kernel::<D>::w(WendlandC2, r * spacing, h);
        count += usize::from(r > 0.0 && r <= FIT_REACH);
    }
    (sum, count)
}

/// Pressure of particle `a` minus the value there of the plane fitted by least squares to it and its fluid neighbours, Pa.
fn fit_residual<const D: usize>(p: &Particles<D>, near: &Neighbors<D>, a: usize, spacing: f64) -> f64 {
    // Normal equations of p ≈ c0 + c·(x_b − x_a)/spacing, of order D + 1 <= 4.
    let order = D + 1;
    let mut matrix = [[0.0; 5]; 4];
    let mut add = |away: Vector<D>, pressure: f64| {
        let mut row = [0.0; 5];
        row[0] = 1.0;
        row[1..order].copy_from_slice(&away.0);
        row[order] = pressure;
        for i in 0..order {
            for j in 0..=order {
                matrix[i][j] += row[i] * row[j];
            }
        }
    };
    add(Vector::ZERO, p.pressure[a]);
    near.for_each(a, |pair| {
        if p.is_fluid(pair.b) {
            add(-pair.x_ab / spacing, p.pressure[pair.b]);
        }
    });
    match solve_small(&mut matrix, order) {
        Some(plane) => p.pressure[a] - plane[0],
        None => f64::NAN,
    }
}

/// Gauss elimination with pivoting of `order` equations, the right-hand side in column `order`; `None` if singular.
pub fn solve_small(m: &mut [[f64; 5]; 4], order: usize) -> Option<[f64; 4]> {
    let scale = (0..order).map(|i| m[i][i].abs()).fold(0.0, f64::max);
    for k in 0..order {
        let pivot = (k..order).max_by(|&i, &j| m[i][k].abs().total_cmp(&m[j][k].abs()))?;
        m.swap(k, pivot);
        if m[k][k].abs() <= 1e-12 * scale {
            return None;
        }
        for i in k + 1..order {
            let factor = m[i][k] / m[k][k];
            for j in k..=order {
                m[i][j] -= factor * m[k][j];
            }
        }
    }
    let mut x = [0.0; 4];
    for i in (0..order).rev() {
        let known: f64 = (i + 1..order).map(|j| m[i][j] * x[j]).sum();
        x[i] = (m[i][order] - known) / m[i][i];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Particle;

    fn medium() -> Medium<2> {
        Medium {
            rest_density: 1000.0,
            viscosity: 0.0,
            gravity: Vector([0.0, -10.0]),
            spacing: 0.1,
            depth: 1.0,
            floor: 0.0,
            courant: 0.25,
            speed: 0.0,
        }
    }

    /// A block of fluid 2 m wide and 1 m high on a lattice, pressures given by `pressure`.
    fn block(pressure: impl Fn(Vector<2>) -> f64) -> Particles<2> {
        let mut p = Particles::new();
        for i in 0..20 {
            for j in 0..10 {
                let x = Vector([0.05 + 0.1 * f64::from(i), 0.05 + 0.1 * f64::from(j)]);
                let particle = Particle {
                    kind: Kind::Fluid,
                    layer: 0,
                    x,
                    v: Vector([2.0, 0.0]),
                    mass: 10.0,
                    density: 1000.0,
                    pressure: pressure(x),
                    h: 0.12,
                };
                p.push(10 * i as u32 + j as u32, particle);
            }
        }
        p
    }

    #[test]
    fn energies_of_a_moving_block_are_those_of_mechanics() {
        let energy = energy(&block(|_| 0.0), &medium(), Elasticity::None);
        // 2000 kg/m at 2 m/s, its middle 0.5 m up; 1e-9: round-off of 200 terms.
        assert!((energy.kinetic - 4000.0).abs() < 1e-9 * 4000.0);
        assert!((energy.potential - 10_000.0).abs() < 1e-9 * 10_000.0);
        assert_eq!(energy.elastic, 0.0);
    }

    /// `de/dρ = p/ρ²`, by a difference quotient.
    #[test]
    fn elastic_energy_is_the_work_of_the_equation_of_state() {
        let (b, c, rho, step) = (1e5, 26.0, 1020.0, 0.01);
        for (elasticity, pressure) in
            [(Elasticity::Tait(b), crate::physics::pressure::tait(b, rho, 1000.0)), (Elasticity::Linear(c), c * c * (rho - 1000.0))]
        {
            let at = |density: f64| {
                let mut p = block(|_| 0.0);
                p.density.fill(density);
                energy(&p, &medium(), elasticity).elastic / 2000.0
            };
            let slope = (at(rho + step) - at(rho - step)) / (2.0 * step);
            let expected = pressure / (rho * rho);
            // 1e-6: cancellation in the difference quotient.
            assert!((slope / expected - 1.0).abs() < 1e-6, "{slope} against {expected}");
            assert!(at(1000.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_linear_pressure_has_no_noise_and_a_checkerboard_has_its_amplitude() {
        let mut meter = QualityMeter::new(0.1);
        let linear = meter.measure(&block(|x| 1e4 * (1.0 - x[1]) + 300.0 * x[0]), &medium());
        assert!(linear.pressure_noise < 1e-12, "{}", linear.pressure_noise);
        let sign = |x: Vector<2>| if ((x[0] + x[1]) / 0.1).round() as i64 % 2 == 0 { 1.0 } else { -1.0 };
        let noisy = meter.measure(&block(|x| 100.0 * sign(x)), &medium());
        // 100 Pa over ρ g H = 1e4 Pa; the fit takes away the mean of 29 values of ±100 Pa, at most 5 of them unbalanced.
        assert!((0.008..0.012).contains(&noisy.pressure_noise), "{}", noisy.pressure_noise);
        assert!(linear.volume_error.abs() < 1e-12, "{}", linear.volume_error);
    }

    #[test]
    fn the_front_is_the_edge_of_the_body_not_of_a_drop_ahead() {
        let mut p = block(|_| 0.0);
        p.push(
            999,
            Particle {
                kind: Kind::Fluid,
                layer: 0,
                x: Vector([3.0, 0.0]),
                v: Vector::ZERO,
                mass: 10.0,
                density: 1e3,
                pressure: 0.0,
                h: 0.12,
            },
        );
        let front = front(&p, &medium(), 0.0);
        assert!((front.front - 2.0).abs() < 1e-12 && (front.residual_height - 1.0).abs() < 1e-12, "{front:?}");
    }
}
