//! The yardstick: what a good engineer writes first, one thread, plain `f64`, no tricks.
//!
//! A cell list, from it a list of neighbours in compressed rows, and one loop over it with every term of a sound step of δ-SPH: continuity,
//! diffusion of density after Fourtakas, pressure, with walls. Tests hold it to a sum over all pairs and to the library.

use greenwater::math::Vector;
use greenwater::particles::{Kind, Particles};

/// Neighbours of all particles in compressed rows.
#[derive(Clone, Debug, Default)]
pub struct List {
    /// Where the neighbours of each particle start; one more at the end.
    pub starts: Vec<usize>,
    /// Rows of the neighbours.
    pub rows: Vec<u32>,
}

impl List {
    /// Pairs, each from both sides.
    pub fn pairs(&self) -> usize {
        self.rows.len()
    }

    /// Pairs from the side of fluid particles: those that an evaluation of the method goes through.
    pub fn pairs_of_fluid<const D: usize>(&self, p: &Particles<D>) -> usize {
        (0..p.owned()).filter(|&a| p.is_fluid(a)).map(|a| self.starts[a + 1] - self.starts[a]).sum()
    }

    /// All pairs within `reach`, m, found with cells of that edge.
    pub fn build<const D: usize>(&mut self, p: &Particles<D>, reach: f64) {
        let (mut min, mut max) = ([f64::INFINITY; D], [f64::NEG_INFINITY; D]);
        for x in &p.x {
            for d in 0..D {
                min[d] = min[d].min(x[d]);
                max[d] = max[d].max(x[d]);
            }
        }
        let cells: [usize; D] = std::array::from_fn(|d| ((max[d] - min[d]) / reach) as usize + 1);
        let cell = |x: Vector<D>| -> [usize; D] { std::array::from_fn(|d| (((x[d] - min[d]) / reach) as usize).min(cells[d] - 1)) };
        let index = |cell: [usize; D]| (0..D).fold(0, |index, d| index * cells[d] + cell[d]);

        // Counting sort of the rows into cells.
        let count: usize = cells.iter().product();
        let mut first = vec![0usize; count + 1];
        for &x in &p.x {
            first[index(cell(x)) + 1] += 1;
        }
        for c in 0..count {
            first[c + 1] += first[c];
        }
        let mut next = first.clone();
        let mut sorted = vec![0u32; p.len()];
        for (a, &x) in p.x.iter().enumerate() {
            let c = index(cell(x));
            sorted[next[c]] = a as u32;
            next[c] += 1;
        }

        self.starts.clear();
        self.rows.clear();
        self.starts.push(0);
        for a in 0..p.owned() {
            if p.kind[a] != Kind::Lost {
                let home = cell(p.x[a]);
                let low = home.map(|c| c.saturating_sub(1));
                let high: [usize; D] = std::array::from_fn(|d| (home[d] + 1).min(cells[d] - 1));
                let mut at = low;
                loop {
                    let c = index(at);
                    for &b in &sorted[first[c]..first[c + 1]] {
                        let x_ab = p.x[a] - p.x[b as usize];
                        if b as usize != a && x_ab.dot(x_ab) <= reach * reach && p.kind[b as usize] != Kind::Lost {
                            self.rows.push(b);
                        }
                    }
                    let Some(d) = (0..D).rev().find(|&d| at[d] < high[d]) else { break };
                    at[d] += 1;
                    at[d + 1..].copy_from_slice(&low[d + 1..]);
                }
            }
            self.starts.push(self.rows.len());
        }
    }
}

/// The numbers of the method.
#[derive(Clone, Copy, Debug)]
pub struct Constants<const D: usize> {
    /// Smoothing length of all particles, m.
    pub h: f64,
    /// Speed of sound, m/s.
    pub sound: f64,
    /// Density at rest, kg/m³.
    pub rest: f64,
    /// Density diffusion `δ`.
    pub delta: f64,
    /// `ρ0 g Δx`, Pa: what a row of particles weighs.
    pub row: f64,
    /// Gravity, m/s².
    pub gravity: Vector<D>,
    /// Factor of the gradient of the kernel; 1 for the kernel as it is.
    pub slope: f64,
}

/// Acceleration and rate of density of every particle.
#[derive(Clone, Debug, Default)]
pub struct Sums<const D: usize> {
    /// m/s²; zero for walls.
    pub acceleration: Vec<Vector<D>>,
    /// kg/(m³ s); zero for walls.
    pub rate: Vec<f64>,
}

impl<const D: usize> Sums<D> {
    /// Every term of the method in one loop over the list, with Wendland's C2 kernel.
    pub fn evaluate(&mut self, list: &List, p: &Particles<D>, c: &Constants<D>) {
        let sigma = if D == 2 { 7.0 / (4.0 * std::f64::consts::PI) } else { 21.0 / (16.0 * std::f64::consts::PI) };
        // W'/r = −5 σ/h^{D+2} (1 − r/2h)³
        let scale = (0..D + 2).fold(-5.0 * c.slope * sigma, |scale, _| scale / c.h);
        let hydrostatic = c.rest / (c.sound * c.sound) * c.gravity;
        let diffusion = 2.0 * c.delta * c.h * c.sound / c.rest;
        self.acceleration.resize(p.owned(), Vector::ZERO);
        self.rate.resize(p.owned(), 0.0);
        for a in 0..p.owned() {
            if p.kind[a] != Kind::Fluid {
                (self.acceleration[a], self.rate[a]) = (Vector::ZERO, 0.0);
                continue;
            }
            let (mut acceleration, mut rate) = (Vector::ZERO, 0.0);
            let (x, v, density, pressure) = (p.x[a], p.v[a], p.density[a], p.pressure[a]);
            for &b in &list.rows[list.starts[a]..list.starts[a + 1]] {
                let b = b as usize;
                let x_ab = x - p.x[b];
                let v_ab = v - p.v[b];
                let r2 = x_ab.dot(x_ab);
                let t = (1.0 - 0.5 * r2.sqrt() / c.h).max(0.0);
                let weight = p.mass[b] * (scale * (t * t * t));
                let approach = v_ab.dot(x_ab);
                let sum = pressure + p.pressure[b];
                if p.kind[b] == Kind::Fluid {
                    let jump = density - p.density[b] - hydrostatic.dot(x_ab);
                    acceleration += weight * -sum * x_ab;
                    rate += weight * (approach + diffusion * jump);
                } else {
                    // Walls do not pull, push less where they are dry, and do not diffuse.
                    acceleration += weight * -sum.min((8.0 * p.pressure[b]).max(sum - c.row)).max(0.0) * x_ab;
                    rate += weight * approach;
                }
            }
            self.acceleration[a] = acceleration / (c.rest * c.rest) + c.gravity;
            self.rate[a] = rate;
        }
    }
}

/// Additions, multiplications, divisions and roots of one pair, each counted once: what a share of the ceiling is taken of.
pub fn operations_a_pair(dimension: usize) -> f64 {
    // x_ab, v_ab, three dot products, the sum into the acceleration.
    let d = dimension as f64;
    let along_axes = d + d + 3.0 * (2.0 * d - 1.0) + 2.0 * d;
    // Root, kernel (5), weight (2), pressure, jump (2), rate (4).
    along_axes + 15.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use greenwater::domain::Domain;
    use greenwater::kernel::{Kernel, WendlandC2};
    use greenwater::particles::Particle;
    use greenwater::physics::lattice::Lattice;
    use greenwater::scheme::acoustic::{StartPressure, Stepping, TensileControl};
    use greenwater::scheme::{DeltaSph, DeltaSphSettings, Medium, Preset, Scheme};
    use greenwater::time::Phases;

    /// Numbers in [-1, 1) from a fixed sequence.
    fn noise() -> impl FnMut() -> f64 {
        let mut state = 3u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }
    }

    const SPACING: f64 = 0.1;

    /// A block of `side` particles along each axis, every position (by up to `disorder` spacings), velocity, density and pressure a little
    /// off.
    fn block<const D: usize>(side: usize, h: f64, disorder: f64, kind: impl Fn(usize) -> Kind) -> Particles<D> {
        let mut next = noise();
        let mut p = Particles::new();
        for i in 0..side.pow(D as u32) {
            let mut rest = i;
            let x = Vector(std::array::from_fn(|_| {
                let at = rest % side;
                rest /= side;
                SPACING * (at as f64 + 0.5 + disorder * next())
            }));
            let v = Vector(std::array::from_fn(|_| next()));
            let mass = 1000.0 * (0..D).fold(1.0, |volume, _| volume * SPACING);
            let (density, pressure) = (1000.0 + 2.0 * next(), 500.0 * next());
            p.push(i as u32, Particle { kind: kind(i), layer: 0, x, v, mass, density, pressure, h });
        }
        p
    }

    fn constants<const D: usize>(h: f64, slope: f64) -> Constants<D> {
        Constants { h, sound: 10.0, rest: 1000.0, row: 1000.0 * 9.81 * SPACING, delta: 0.1, gravity: -9.81 * Vector::unit(D - 1), slope }
    }

    /// The formulas once more, over all pairs, with the library's kernel.
    fn over_all_pairs<const D: usize>(p: &Particles<D>, c: &Constants<D>, a: usize) -> (Vector<D>, f64) {
        let (mut acceleration, mut rate) = (c.gravity, 0.0);
        for b in (0..p.len()).filter(|&b| b != a) {
            let x_ab = p.x[a] - p.x[b];
            let r = x_ab.norm();
            if r > 2.0 * c.h {
                continue;
            }
            let grad = c.slope * Kernel::<D>::dw_over_r(WendlandC2, r, c.h) * x_ab;
            let v_ab = p.v[a] - p.v[b];
            rate += p.mass[b] * v_ab.dot(grad);
            let sum = p.pressure[a] + p.pressure[b];
            if p.is_fluid(b) {
                let at_rest = c.rest / (c.sound * c.sound) * c.gravity.dot(x_ab);
                let jump = p.density[a] - p.density[b] - at_rest;
                rate += 2.0 * c.delta * c.h * c.sound * p.mass[b] / c.rest * jump * x_ab.dot(grad) / (r * r);
                acceleration -= p.mass[b] * sum / (c.rest * c.rest) * grad;
            } else {
                acceleration -= p.mass[b] * sum.min((8.0 * p.pressure[b]).max(sum - c.row)).max(0.0) / (c.rest * c.rest) * grad;
            }
        }
        (acceleration, rate)
    }

    fn agrees_with_all_pairs<const D: usize>(side: usize) {
        let h = 1.4 * SPACING;
        let p = block::<D>(side, h, 0.15, |i| if i.is_multiple_of(7) { Kind::Wall } else { Kind::Fluid });
        let c = constants(h, 1.0);
        let (mut list, mut sums) = (List::default(), Sums::default());
        list.build(&p, 2.0 * h);
        sums.evaluate(&list, &p, &c);
        let exact: Vec<(Vector<D>, f64)> = (0..p.owned()).map(|a| over_all_pairs(&p, &c, a)).collect();
        let largest = exact.iter().fold((0.0, 0.0), |most: (f64, f64), e| (most.0.max(e.0.norm()), most.1.max(e.1.abs())));
        for a in (0..p.owned()).filter(|&a| p.is_fluid(a)) {
            // 1e-12: round-off of some hundred terms.
            assert!((sums.acceleration[a] - exact[a].0).norm() < 1e-12 * largest.0, "{D}D, acceleration of {a}");
            assert!((sums.rate[a] - exact[a].1).abs() < 1e-12 * largest.1, "{D}D, rate of {a}");
        }
        assert!(list.pairs_of_fluid(&p) < list.pairs());
    }

    #[test]
    fn the_twin_is_the_sum_over_all_pairs() {
        agrees_with_all_pairs::<2>(14);
        agrees_with_all_pairs::<3>(7);
    }

    /// One short step of the library without shifting, artificial viscosity and damper in a periodic box: its velocities change by the twin's acceleration,
    /// its rate is the twin's.
    fn agrees_with_the_library<const D: usize>(side: usize) {
        let h = 1.4 * SPACING;
        // Even enough that the library sees no free surface, where it would hold the density up.
        let mut p = block::<D>(side, h, 0.05, |_| Kind::Fluid);
        let edge = SPACING * side as f64;
        let mut domain = Domain::new(Vector::ZERO, edge * Vector([1.0; D]), [true; D]);
        let gravity = -9.81 * Vector::<D>::unit(D - 1);
        let medium =
            Medium { rest_density: 1000.0, viscosity: 0.0, gravity, spacing: SPACING, depth: edge, floor: 0.0, courant: 0.25, speed: 1.0 };
        let settings = DeltaSphSettings {
            reference_speed: Some(1.0),
            sound_factor: 10.0,
            alpha: 0.0,
            acoustic_damping: 0.0,
            tensile_control: TensileControl::None,
            shifting: 0.0,
            volume_control: 0.0,
            start_pressure: Some(StartPressure::Given),
            stepping: Stepping::Single,
            ..DeltaSphSettings::preset(Preset::Water)
        };
        let mut scheme = DeltaSph::delta_sph(WendlandC2, medium, &settings);
        scheme.start(&mut p, &mut domain).expect("sound");
        let before = p.clone();
        let dt = 1e-5;
        scheme.step(&mut p, &mut domain, dt, &mut Phases::default()).expect("sound");
        assert!(p.surface.iter().all(|&surface| surface == 0), "{D}D: a surface in a full box");

        // A step may number rows anew: identities tell who was who.
        let mut rows = vec![0; before.owned()];
        for a in 0..before.owned() {
            rows[before.id[a] as usize] = a;
        }
        let was = |a: usize| rows[p.id[a] as usize];
        // The state at the middle of the step, images included: pressure is linear in density.
        let mut middle = p.clone();
        let shift = |p: &Particles<D>, row: usize| p.x[row] - p.x[domain.parent(row, p.owned())];
        for row in 0..p.len() {
            let a = was(domain.parent(row, p.owned()));
            middle.v[row] = before.v[a];
            middle.density[row] = before.density[a] + 0.5 * dt * before.density_rate[a];
            middle.pressure[row] = 100.0 * (middle.density[row] - 1000.0);
            middle.x[row] = before.x[a] + 0.5 * dt * before.v[a] + shift(&p, row);
        }
        let lattice = Lattice::of::<_, D>(WendlandC2, h, SPACING, 1000.0);
        let c = constants::<D>(h, 1.0 / lattice.slope_of_linear::<D>());
        let (mut list, mut sums) = (List::default(), Sums::default());
        list.build(&middle, 2.0 * h);
        sums.evaluate(&list, &middle, &c);
        let largest = sums.acceleration.iter().map(|a| a.norm()).fold(0.0, f64::max);
        for a in 0..p.owned() {
            let of_library = (p.v[a] - before.v[was(a)]) / dt;
            // 1e-9: velocities near 1 change by 1e-3 of that, so their difference has lost three digits of sixteen, and the step two more.
            assert!((sums.acceleration[a] - of_library).norm() < 1e-9 * largest, "{D}D: {:?}, {of_library:?}", sums.acceleration[a]);
        }

        // The rate is that of the end: new positions and velocities, densities of the middle.
        let mut end = middle.clone();
        for row in 0..p.len() {
            let a = domain.parent(row, p.owned());
            (end.x[row], end.v[row]) = (p.x[a] + shift(&p, row), p.v[a]);
        }
        list.build(&end, 2.0 * h);
        sums.evaluate(&list, &end, &c);
        let largest = sums.rate.iter().fold(0.0f64, |most, rate| most.max(rate.abs()));
        for a in 0..p.owned() {
            // 1e-10: round-off of densities near 1000 whose differences are near 1.
            assert!((sums.rate[a] - p.density_rate[a]).abs() < 1e-10 * largest, "{D}D: {} and {}", sums.rate[a], p.density_rate[a]);
        }
    }

    #[test]
    fn the_twin_is_the_library_to_round_off() {
        agrees_with_the_library::<2>(16);
        agrees_with_the_library::<3>(8);
    }
}
