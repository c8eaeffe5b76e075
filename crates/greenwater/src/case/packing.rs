//! Particles that follow the boundary of a shape, instead of a lattice with steps in it.

use super::shape::{Lattice, Region};
use crate::kernel::{Kernel, WendlandC2};
use crate::math::Vector;
use crate::neighbors::{Neighbors, Search};
use crate::particles::{Kind, Particle, Particles};
use crate::sweep::sweep;

/// Rounds of [`SWEEPS`] at most. Rows along the boundary are in place after some ten; the rest evens out the inside.
const ROUNDS: usize = 80;
/// Sweeps with the same lists, which reach [`SKIN`] smoothing lengths farther than the kernel: two particles come nearer by less.
const SWEEPS: usize = 5;
/// See [`SWEEPS`]: twice their number of longest moves is a spacing, and few are long.
const SKIN: f64 = 0.5;
/// A move that no longer counts, in spacings.
const STILL: f64 = 1e-3;
/// Moves at most a tenth of a spacing: no two particles change places.
const LONGEST: f64 = 0.1;
/// `δx = −κ h² ∇C`: from 0.5 on the particles of a lattice would overtake each other (Lind et al. 2012).
const RATE: f64 = 0.2;

/// Smoothing length of the packing, in spacings: every method starts from the same particles, whatever its kernel. Wendland's kernel
/// does not clump at any number of neighbours (Dehnen & Aly 2012).
const H: f64 = 1.3;

/// Moves the particles `x` of a region until they are evenly spread in it up to its boundary, and returns the volume of one,
/// m³ (m² in 2D): that of the region over their number.
///
/// What drives them is `∇C = Σ_b V ∇W_ab + ∫_outside ∇W dV`: the gradient of how full space is if all outside of the region were as
/// full as the inside. It vanishes inside where neighbours are even, and along a boundary for a row half a spacing deep. The
/// integral is a sum over points of half a spacing, each with the share of its cell that lies outside.
///
/// Source: Colagrossi, Bouscasse, Antuono & Marrone, Comput. Phys. Commun. 183 (2012) 1641; here the outside is an integral and
/// not a set of particles, so that corners and thin parts need nothing of their own.
pub(super) fn pack<const D: usize>(region: &Region<D>, x: &mut [Vector<D>], spacing: f64) -> f64 {
    if x.is_empty() {
        return 0.0;
    }
    let (h, support) = (H * spacing, Kernel::<D>::radius(WendlandC2));
    let (volume, outside) = around(region, support * h, 0.5 * spacing);
    let own = volume / x.len() as f64;
    let mut near = Neighbors::new();
    // Those that may move: all at first, then those that moved and who is near them.
    let mut active: Vec<u32> = (0..x.len() as u32).collect();
    for _ in 0..ROUNDS {
        let (mut p, names) = rows(x, &active, &outside, own, h);
        // Every position is finite: moves are bounded.
        if near.build(&p, support + SKIN, Search::Grid).is_err() {
            break;
        }
        let mut moves = vec![Vector::ZERO; active.len()];
        for _ in 0..SWEEPS {
            sweep(&mut moves, |a| {
                let mut slope = Vector::ZERO;
                near.for_each(a, |pair| slope += p.mass[pair.b] * Kernel::<D>::dw_over_r(WendlandC2, pair.r, h) * pair.x_ab);
                let by = -RATE * h * h * slope;
                let by = (LONGEST * spacing / by.norm().max(LONGEST * spacing)) * by;
                // Nothing leaves the region.
                if region.depth(p.x[a] + by) > 0.0 { by } else { Vector::ZERO }
            });
            p.x.iter_mut().zip(&moves).for_each(|(x, &by)| *x += by);
            near.follow(&p);
        }
        for (&name, &at) in active.iter().zip(&p.x) {
            x[name as usize] = at;
        }
        let moved = (0..active.len()).filter(|&a| moves[a].norm() > STILL * spacing);
        let mut next: Vec<u32> = moved.flat_map(|a| near.of(a).iter().copied().chain([a as u32]).map(|b| names[b as usize])).collect();
        next.retain(|&name| name != OUTSIDE);
        next.sort_unstable();
        next.dedup();
        active = next;
        if active.is_empty() {
            break;
        }
    }
    own
}

/// Row of a point outside.
const OUTSIDE: u32 = u32::MAX;

/// The active particles, and as rows without lists of their own the other ones and the points outside; and which particle a row is.
fn rows<const D: usize>(x: &[Vector<D>], active: &[u32], outside: &[(Vector<D>, f64)], own: f64, h: f64) -> (Particles<D>, Vec<u32>) {
    let mut p = Particles::new();
    let mut names = active.to_vec();
    let mut still = vec![true; x.len()];
    for (&name, id) in active.iter().zip(0..) {
        still[name as usize] = false;
        let x = x[name as usize];
        p.push(id, Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: own, density: 1.0, pressure: 0.0, h });
    }
    let first = p.x[0];
    for (name, &at) in x.iter().enumerate().filter(|&(name, _)| still[name]) {
        p.push_ghost(0, at - first);
        names.push(name as u32);
    }
    for &(at, volume) in outside {
        p.push_ghost(0, at - first);
        names.push(OUTSIDE);
        if let Some(mass) = p.mass.last_mut() {
            *mass = volume;
        }
    }
    (p, names)
}

/// Volume of a region, and points with volumes that stand for its outside within `reach` of its boundary. Cells of `side` that the
/// boundary cuts are shared out by the depth of their centre.
fn around<const D: usize>(region: &Region<D>, reach: f64, side: f64) -> (f64, Vec<(Vector<D>, f64)>) {
    let (min, max) = region.bounds();
    let all = Region::Block { min: min - Vector::splat(reach + side), max: max + Vector::splat(reach + side) };
    let cell: f64 = (0..D).map(|_| side).product();
    let (mut volume, mut outside) = (0.0, Vec::new());
    // Cells meet the lower corner of the region: boxes are cut by none.
    let origin = min - Vector::splat(((reach + side) / side).ceil() * side);
    all.fill(Lattice { origin, spacing: side }, 1, |x, _| {
        let depth = region.depth(x);
        let inside = (0.5 + depth / side).clamp(0.0, 1.0);
        volume += inside * cell;
        if inside < 1.0 && depth > -(reach + side) {
            outside.push((x, (1.0 - inside) * cell));
        }
    });
    (volume, outside)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packed(region: &Region<2>, spacing: f64) -> (Vec<Vector<2>>, f64) {
        let mut x = Vec::new();
        region.fill(region.lattice(Lattice::of(region, spacing)), 1, |at, _| x.push(at));
        let volume = pack(region, &mut x, spacing);
        (x, volume)
    }

    #[test]
    fn a_disc_gets_a_round_rim_and_its_own_area() {
        let (radius, spacing) = (1.0, 0.05);
        let disc = Region::Ball { center: Vector([0.2, 0.1]), radius };
        let (x, volume) = packed(&disc, spacing);
        // 1e-3: cells on the rim are shared out by the depth of their centre, to second order in their side over the radius.
        assert!((volume * x.len() as f64 / std::f64::consts::PI - 1.0).abs() < 1e-3);
        let rim: Vec<f64> = x.iter().map(|&x| disc.depth(x)).filter(|&depth| depth < 0.9 * spacing).collect();
        let (least, most) = rim.iter().fold((1.0f64, 0.0f64), |(a, b), &d| (a.min(d / spacing), b.max(d / spacing)));
        // One row, a little less than half a spacing deep; a lattice has depths from 0 to 0.9 spacings.
        assert!(least > 0.3 && most < 0.6, "depths from {least} to {most} spacings");
        let apart = |a: usize| (0..x.len()).filter(|&b| b != a).map(|b| (x[a] - x[b]).norm()).fold(f64::INFINITY, f64::min);
        // Where rows along the rim meet the lattice inside, particles are up to 7 % nearer than a spacing.
        let nearest = (0..x.len()).map(apart).fold(f64::INFINITY, f64::min);
        assert!(nearest > 0.9 * spacing, "two particles {nearest} m apart");
    }

    /// A box of whole spacings is its own packing.
    #[test]
    fn a_box_stays_a_lattice() {
        let block = Region::Block { min: Vector([0.0, 0.0]), max: Vector([1.0, 0.5]) };
        let mut x = Vec::new();
        block.fill(block.lattice(Lattice::of(&block, 0.1)), 1, |at, _| x.push(at));
        let before = x.clone();
        let volume = pack(&block, &mut x, 0.1);
        assert!((volume - 0.01).abs() < 1e-12);
        let moved = x.iter().zip(&before).map(|(a, b)| (*a - *b).norm()).fold(0.0, f64::max);
        assert!(moved < 0.02, "a particle moved by {moved} m");
    }
}
