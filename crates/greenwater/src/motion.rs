//! Walls that move: what the driver writes into the rows of wall particles before and after a step.

use crate::formula::Formula;
use crate::math::Vector;
use crate::particles::{Kind, Particles};

/// How the walls of one body move.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion<const D: usize> {
    /// Number of the wall shape in the case, from 1: [`Particles::body`] of its particles.
    pub body: u16,
    /// Velocity as formulas of the time `t` (s), m/s, one an axis.
    pub velocity: Vec<Formula>,
    /// Whether the particles go along. The belt of a lid slides and stays.
    pub moves: bool,
}

impl<const D: usize> Motion<D> {
    /// Velocity at time `t` (s), m/s.
    pub fn at(&self, t: f64) -> Vector<D> {
        Vector(std::array::from_fn(|d| self.velocity.get(d).map_or(0.0, |formula| formula.value(&[t]))))
    }

    /// Mean velocity (m/s) and acceleration (m/s²) from `t` to `t + dt`, s. The velocity by Simpson's rule, so that the path is
    /// that of the formula to fourth order in `dt`; the acceleration is the exact mean.
    pub fn over(&self, t: f64, dt: f64) -> (Vector<D>, Vector<D>) {
        let (start, middle, end) = (self.at(t), self.at(t + 0.5 * dt), self.at(t + dt));
        ((start + 4.0 * middle + end) / 6.0, (end - start) / dt)
    }

    /// How far the walls go up to `end` (s), m, along each axis at the least and at the most; zero where they stay.
    pub fn path(&self, end: f64) -> (Vector<D>, Vector<D>) {
        let (mut least, mut most, mut at) = (Vector::ZERO, Vector::ZERO, Vector::ZERO);
        let dt = end / 1000.0;
        for i in (0..1000).filter(|_| self.moves) {
            at += dt * self.over(dt * f64::from(i), dt).0;
            (least, most) = (least.zip(at, f64::min), most.zip(at, f64::max));
        }
        (least, most)
    }

    /// The largest speed at 1000 even times up to `end` (s), m/s; NaN if the velocity is not finite at one of them.
    pub fn fastest(&self, end: f64) -> f64 {
        let speeds = (0..=1000).map(|i| self.at(end * f64::from(i) / 1000.0).norm());
        speeds.fold(0.0, |most, speed| if speed.is_nan() || most.is_nan() { f64::NAN } else { most.max(speed) })
    }
}

/// The longest of `dt`, `dt/2`, `dt/4` and so on (s) in which no wall, going or sliding, covers more than half of `h` (m) from
/// time `t` (s) on. A limit of a method looks at what moves now; walls that start later, and fluid at rest till then, it cannot
/// see.
pub fn within_reach<const D: usize>(motions: &[Motion<D>], t: f64, dt: f64, h: f64) -> f64 {
    let fastest = |dt: f64| {
        let speeds = motions.iter().flat_map(|motion| (0..=16).map(move |i| motion.at(t + f64::from(i) / 16.0 * dt).norm()));
        speeds.fold(0.0, f64::max)
    };
    // A millionth at the least: walls that need less fail the checks of a state, not this one.
    (0..20).map(|i| dt / f64::from(1 << i)).find(|&dt| fastest(dt) * dt <= 0.5 * h).unwrap_or(dt / f64::from(1 << 20))
}

/// Gives the wall rows of moving bodies their mean velocity and acceleration over the step from `t` to `t + dt`, s.
pub fn set<const D: usize>(motions: &[Motion<D>], p: &mut Particles<D>, t: f64, dt: f64) {
    for motion in motions {
        give(motion, p, motion.over(t, dt));
    }
}

fn give<const D: usize>(motion: &Motion<D>, p: &mut Particles<D>, (v, acceleration): (Vector<D>, Vector<D>)) {
    for a in 0..p.owned() {
        if p.kind[a] == Kind::Wall && p.body[a] == motion.body {
            p.v[a] = v;
            p.acceleration[a] = acceleration;
        }
    }
}

/// Velocity (m/s) and acceleration (m/s²) that the wall rows of each moving body have now: all those of a body the same.
pub fn read<const D: usize>(motions: &[Motion<D>], p: &Particles<D>, found: &mut Vec<(Vector<D>, Vector<D>)>) {
    let row = |motion: &Motion<D>| (0..p.owned()).find(|&a| p.kind[a] == Kind::Wall && p.body[a] == motion.body);
    found.clear();
    found.extend(motions.iter().map(|motion| row(motion).map_or((Vector::ZERO, Vector::ZERO), |a| (p.v[a], p.acceleration[a]))));
}

/// Gives the wall rows what they had when [`read`] looked.
pub fn give_back<const D: usize>(motions: &[Motion<D>], p: &mut Particles<D>, found: &[(Vector<D>, Vector<D>)]) {
    motions.iter().zip(found).for_each(|(motion, &had)| give(motion, p, had));
}

/// Moves the wall rows that go along, by the velocity that [`set`] gave them over `dt`, s.
pub fn carry<const D: usize>(motions: &[Motion<D>], p: &mut Particles<D>, dt: f64) {
    for motion in motions.iter().filter(|motion| motion.moves) {
        for a in 0..p.owned() {
            if p.kind[a] == Kind::Wall && p.body[a] == motion.body {
                let step = dt * p.v[a];
                p.x[a] += step;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Particle;

    /// A lid that starts at 1 s, and a step of 0.5 s from 0.9 s: 0.0625 s is the longest of its halves in which 1 m/s covers no
    /// more than 0.08 m; where nothing has begun to move the step stays.
    #[test]
    fn a_step_ends_before_walls_have_gone_far() {
        let lid = [Motion::<2> { body: 1, velocity: vec![Formula::parse("min(1, max(0, 1e6*(t - 1)))", &["t"]).unwrap()], moves: false }];
        assert_eq!(within_reach(&lid, 0.9, 0.5, 0.16), 0.0625);
        assert_eq!(within_reach(&lid, 0.4, 0.5, 0.16), 0.5);
        assert_eq!(within_reach::<2>(&[], 0.9, 0.5, 0.16), 0.5);
    }

    /// A wall that swings follows the integral of its formula: Simpson's error of a step is `dt^5 |v''''|/2880`, here 200 steps.
    #[test]
    fn a_swinging_wall_follows_its_formula() {
        let velocity = ["0.3*2*pi*cos(2*pi*t)", "0"].map(|text| Formula::parse(text, &["t"]).unwrap()).to_vec();
        let mut p = Particles::<2>::new();
        let (x, v) = (Vector([1.0, 0.5]), Vector::ZERO);
        let wall = Particle { kind: Kind::Wall, layer: 1, x, v, mass: 1.0, density: 1000.0, pressure: 0.0, h: 0.1 };
        p.push(0, wall);
        p.push(1, wall);
        p.body = vec![2, 1];
        let mut motions = [Motion { body: 2, velocity, moves: true }];
        let mut t = 0.0;
        for step in 0..200 {
            // Steps of uneven length.
            let dt = if step % 2 == 0 { 0.004 } else { 0.006 };
            set(&motions, &mut p, t, dt);
            carry(&motions, &mut p, dt);
            t += dt;
            let exact = 1.0 + 0.3 * (2.0 * std::f64::consts::PI * t).sin();
            assert!((p.x[0][0] - exact).abs() < 1e-9, "t = {t}: {} instead of {exact}", p.x[0][0]);
        }
        assert_eq!(p.x[1], Vector([1.0, 0.5]), "another body stays");
        motions[0].moves = false;
        let before = p.x[0];
        set(&motions, &mut p, 0.0, 0.1);
        carry(&motions, &mut p, 0.1);
        assert_eq!(p.x[0], before, "a belt slides and stays");
        assert!(p.v[0][0] > 1.0 && p.acceleration[0][0] < 0.0);
    }
}
