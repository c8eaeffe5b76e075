//! A look at the geometry of a case before it runs.

use serde::Serialize;

use super::setup::Setup;
use super::shape::AXES;
use crate::domain::Domain;
use crate::kernel::KernelName;
use crate::motion::Motion;
use crate::neighbors::{Neighbors, Search};
use crate::observe::Sensor;
use crate::particles::{Kind, Particles};

/// What was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Audit {
    /// Smallest distance between two particles, m; none within four spacings: infinite.
    pub closest: f64,
    /// Smallest distance between a fluid and a wall particle, m; none within four spacings: infinite.
    pub fluid_to_wall: f64,
    /// Mass of the fluid, kg (kg/m in 2D).
    pub fluid_mass: f64,
    /// All that in one line.
    pub text: String,
    /// What may surprise, a sentence each; empty if nothing.
    pub warnings: Vec<String>,
}

/// Share of the kernel's sum over the lattice that a particle half a spacing from a flat wall misses behind `layers` lines.
fn missing_behind_walls<const D: usize>(kernel: KernelName, h: f64, dx: f64, layers: u8) -> f64 {
    let reach = (kernel.radius() * h / dx).ceil() as i64;
    let (mut all, mut missing) = (0.0, 0.0);
    // In 3D rows across are an integral of the same form: the plane is enough to tell how much is missing.
    for (x, y) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
        let w = kernel.w::<D>(((x * x + y * y) as f64).sqrt() * dx, h);
        all += w;
        missing += if y > i64::from(layers) { w } else { 0.0 };
    }
    missing / all
}

/// How far the audit looks, in spacings.
const REACH: f64 = 4.0;

impl<const D: usize> Setup<D> {
    /// Looks at distances, volumes and walls of the initial particles.
    pub fn audit(&self) -> Audit {
        let (dx, p) = (self.spacing, &self.particles);
        let Around { closest, fluid_to_wall, thin } = look_around(p, self.domain(), dx, self.kernel.radius() * self.smoothing_length);
        let fluid_mass: f64 = (0..p.owned()).filter(|&a| p.is_fluid(a)).map(|a| p.mass[a]).sum();
        let mut warnings = Vec::new();
        let layers = (0..p.owned()).map(|a| p.layer[a]).max().unwrap_or(0);
        let missing = missing_behind_walls::<D>(self.kernel, self.smoothing_length, dx, layers);
        let held = (0..D).all(|d| self.gravity[d] == 0.0 || self.bounds.periodic[d]);
        if layers == 0 && !held {
            warnings.push("there are no walls: the fluid falls freely, and what leaves `domain` is lost".to_owned());
        } else if layers == 0 && self.speed > 0.0 && self.bounds.periodic.contains(&false) {
            warnings.push("there are no walls: what leaves `domain` is lost".to_owned());
        } else if layers > 0 && missing > 0.01 {
            warnings.push(format!(
                "the kernel reaches beyond the {layers} line(s) of the walls, where fluid at a wall misses {:.1} % of its neighbours' weight; \
                 more `walls.layers` help",
                100.0 * missing
            ));
        }
        if let Some((at, thickness)) = thin {
            warnings.push(format!(
                "the wall at {at} m is {thickness} spacings thick and the kernel reaches {:.1}: fluid feels what is behind it; a thicker wall or a \
                 smaller `fluid.spacing` helps",
                self.kernel.radius() * self.smoothing_length / dx
            ));
        }
        for d in (0..D).filter(|&d| self.bounds.periodic[d]) {
            let spacings = (self.bounds.max[d] - self.bounds.min[d]) / dx;
            if (spacings - spacings.round()).abs() > 0.05 {
                let axis = AXES[d];
                warnings.push(format!(
                    "the domain repeats along {axis} every {spacings:.2} spacings: rows of a lattice meet their images too close or too far; a \
                     whole number of spacings helps"
                ));
            }
        }
        warnings.extend(self.left_behind());
        if closest < 0.5 * dx {
            warnings.push(format!("two particles are only {:.3} spacings apart: expect a violent start", closest / dx));
        }
        if layers > 0 && fluid_to_wall > 1.5 * dx {
            warnings.push("no fluid touches a wall at the start".to_owned());
        }
        let spacings = |distance: f64| if distance.is_finite() { format!("{:.3} spacings", distance / dx) } else { "far".to_owned() };
        let (unit, mass_unit) = if D == 2 { ("m2", "kg/m") } else { ("m3", "kg") };
        let text = format!(
            "fluid {:.4} m wide, {:.4} m high, {:.4} {unit}, {fluid_mass:.1} {mass_unit}; nearest particles {} apart, fluid and wall {}",
            self.width,
            self.depth,
            self.fluid_volume,
            spacings(closest),
            spacings(fluid_to_wall)
        );
        Audit { closest, fluid_to_wall, fluid_mass, text, warnings }
    }

    /// A sentence for each probe that stays where it is while the wall beside it moves away, by more than a tenth of a spacing: little beside the 2.6
    /// that a sensor looks at.
    fn left_behind(&self) -> Vec<String> {
        let (dx, p) = (self.spacing, &self.particles);
        let path = |motion: &Motion<D>| {
            let (least, most) = motion.path(self.time.end);
            (motion.body, (most - least).norm())
        };
        let paths: Vec<(u16, f64)> = self.motions.iter().map(path).collect();
        let gone = |sensor: &Sensor<D>| {
            let is_beside = |a: usize| self.bounds.periods().nearest(p.x[a] - sensor.position).norm() < dx;
            let of =
                |&(body, path): &(u16, f64)| (path > 0.1 * dx && (0..p.owned()).any(|a| p.body[a] == body && is_beside(a))).then_some(path);
            paths.iter().find_map(of).map(|path| {
                format!(
                    "the probe `{}` stays where it is, while the wall beside it moves by up to {path:.4} m: with `on` and the name of that wall it goes along",
                    sensor.name
                )
            })
        };
        self.probes.iter().filter(|sensor| sensor.mount.is_none()).filter_map(gone).collect()
    }
}

/// What neighbours tell.
struct Around {
    /// Smallest distance of any two particles, m.
    closest: f64,
    /// Smallest distance of fluid and wall, m.
    fluid_to_wall: f64,
    /// Where a wall is that a kernel reaches through, and how many spacings thick it is at the most.
    thin: Option<(String, u8)>,
}

/// Looks at the neighbours of each particle. Lines of a wall are counted from its faces, so that one with lines up to `n` is up to `2n` spacings thick;
/// what is thinner than `reach`, m, and than the thickest wall of all is thin.
fn look_around<const D: usize>(p: &Particles<D>, mut domain: Domain<D>, dx: f64, reach: f64) -> Around {
    let mut wide = p.clone();
    wide.h.fill(0.5 * REACH * dx);
    // Images across seams are neighbours, too.
    domain.refresh(&mut wide, REACH * dx);
    let p = &wide;
    let mut near = Neighbors::new();
    let mut around = Around { closest: f64::INFINITY, fluid_to_wall: f64::INFINITY, thin: None };
    // Positions of a setup are finite, which is all that a search asks for.
    if near.build(&wide, 2.0, Search::Grid).is_err() {
        return around;
    }
    let lines = p.layer.iter().max().copied().unwrap_or(0);
    for a in 0..p.owned() {
        let mut deepest = p.layer[a];
        near.for_each(a, |pair| {
            around.closest = around.closest.min(pair.r);
            if p.kind[a] == Kind::Fluid && p.kind[pair.b] == Kind::Wall {
                around.fluid_to_wall = around.fluid_to_wall.min(pair.r);
            }
            deepest = deepest.max(p.layer[pair.b]);
        });
        let thickness = deepest.saturating_mul(2);
        if around.thin.is_none() && p.kind[a] == Kind::Wall && deepest < lines && f64::from(thickness) * dx < reach {
            let at: Vec<String> = p.x[a].0.iter().map(|x| format!("{x:.3}")).collect();
            around.thin = Some((format!("({})", at.join(", ")), thickness));
        }
    }
    around
}
