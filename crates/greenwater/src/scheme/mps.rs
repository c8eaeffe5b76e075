//! Moving-particle semi-implicit: differences with weights of their own in place of a kernel.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::settings::{BrokenRule, Settings, changed};
use super::{Medium, Preset, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::{Kernel, KernelName, WendlandC2};
use crate::math::{Matrix, Vector, identity, inverse, smallest_eigenvalue, transform};
use crate::neighbors::{Neighbors, Search};
use crate::particles::{Kind, Particles};
use crate::physics::surface::{Arcs, SurfaceTest, is_exposed};
use crate::poisson::{CsrMatrix, LinearSolver, SolveError, SolveReport, SolverSettings};
use crate::sweep::{sweep, sweep_with, sweep2, update};
use crate::time::{Phases, StepLimit};
use crate::walls::guard::{Guarded, balance, force_of_set_back, set_back};
use crate::walls::{first_line_parents, wall_normals};

/// Parameters of the methods `mps` and `mps-modern`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MpsSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Share of the error of the number density in the source of the pressure equation, dimensionless, > 0 and <= 1.
    pub relaxation: f64,
    /// Distance below which approaching particles collide, in spacings, >= 0 and < 1; 0 switches collisions off.
    pub collision_distance: f64,
    /// Reach of the weight of gradient and number density, in spacings, > 1 and <= 4.
    pub reach: f64,
    /// Reach of the weight of the Laplacian, in spacings, > 1 and <= 4.
    pub laplacian_reach: f64,
    /// How the free surface is told: `density` or `dilts`.
    pub surface: SurfaceTest,
    /// Share of the lattice's number density below which a particle belongs to the surface, in (0, 1); for `surface = "density"`.
    pub surface_threshold: f64,
    /// How pairs are found.
    pub search: Search,
    /// Solver of the pressure equation.
    pub solver: SolverSettings,
}

impl MpsSettings {
    /// The defaults of `preset` for `mps`: as printed, or with the relaxation and the collisions of the textbook (Koshizuka, Shibata &
    /// Murotani 2018). As printed, the source removes 1.4 times the error on a lattice, more than the 4/3 that are stable.
    pub fn preset(preset: Preset) -> Self {
        let (relaxation, collision_distance) = match preset {
            Preset::Paper => (1.0, 0.0),
            Preset::Water => (0.2, 0.5),
        };
        Self {
            preset,
            relaxation,
            collision_distance,
            reach: 2.1,
            laplacian_reach: 4.0,
            surface: SurfaceTest::Density,
            surface_threshold: 0.97,
            search: Search::Grid,
            solver: SolverSettings::default(),
        }
    }

    fn rows(&self, from: &str, gradient: &str) -> Vec<(&'static str, String)> {
        let surface = match self.surface {
            SurfaceTest::Density => format!("number density below {} of the lattice's", self.surface_threshold),
            _ => "uncovered arcs of discs of 1.1 spacings (Dilts 2000)".to_owned(),
        };
        vec![
            ("compressibility", "incompressible".to_owned()),
            ("pressure from", from.to_owned()),
            ("density from", "particle number density; the weights are the method's own".to_owned()),
            ("viscosity", "of the fluid".to_owned()),
            ("time step limited by", "speed".to_owned()),
            ("time stepping", format!("prediction, pressure, correction with {gradient}")),
            (
                "walls",
                "rows of fixed particles, the first one in the pressure equation; what would cross their face is set back".to_owned(),
            ),
            ("free surface", format!("{surface}; pressure zero there")),
            ("linear system", format!("residual {:e}", self.solver.tolerance)),
            ("work of a step", "sums over neighbours and one linear system".to_owned()),
        ]
    }

    fn check_all(&self) -> Result<(), BrokenRule> {
        let (share, relaxation, near) = (self.surface_threshold, self.relaxation, self.collision_distance);
        BrokenRule::unless(relaxation > 0.0 && relaxation <= 1.0, "relaxation", relaxation, "> 0 and <= 1")?;
        BrokenRule::unless((0.0..1.0).contains(&near), "collision_distance", near, ">= 0 and < 1")?;
        // Beyond four spacings nothing is looked for.
        BrokenRule::unless(self.reach > 1.0 && self.reach <= 4.0, "reach", self.reach, "> 1 and <= 4")?;
        let far = self.laplacian_reach;
        BrokenRule::unless(far > 1.0 && far <= 4.0, "laplacian_reach", far, "> 1 and <= 4")?;
        BrokenRule::unless(share > 0.0 && share < 1.0, "surface_threshold", share, "> 0 and < 1")?;
        let own = matches!(self.surface, SurfaceTest::Density | SurfaceTest::Dilts);
        BrokenRule::unless(own, "surface", "a test that needs a kernel", "density or dilts")?;
        BrokenRule::unless_solvable(&self.solver)
    }
}

fn step_rule(courant: f64) -> String {
    format!("{courant} spacings over the greatest speed, at least sqrt(g H); from step to step a fifth more or half at most")
}

/// The guard of walls and the compressibility, which no source has.
fn added() -> Vec<String> {
    vec![
        "what would pass the face of a wall is set back".to_owned(),
        "compressibility of water, 4.5e-10 1/Pa, in the pressure equation".to_owned(),
    ]
}

/// 16 bytes for a matrix entry and some 500 for the work space of a particle.
fn bytes(count: f64, neighbours: f64) -> f64 {
    count * (16.0 * neighbours + 500.0)
}

impl Settings for MpsSettings {
    /// Not used by the method: its support, four spacings, is the reach of the weights.
    type Own = WendlandC2;
    const SMOOTHING: f64 = 2.0;
    const TAKES_KERNEL: bool = false;
    const STEP_COST: f64 = 1.6e-7;

    fn preset(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn preset_name(&self) -> Preset {
        self.preset
    }

    fn check(&self, _reach: f64) -> Result<(), BrokenRule> {
        self.check_all()
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        let from = format!("{} of the error of the number density after the prediction", self.relaxation);
        self.rows(&from, "pressure over the lowest around")
    }

    fn departures(&self, _viscosity: f64, _kernel: KernelName) -> Vec<String> {
        let (printed, mut found) = (Self::preset(Preset::Paper), added());
        changed("share of the density error in the source", self.relaxation, printed.relaxation, &mut found);
        changed("distance of collisions, in spacings,", self.collision_distance, printed.collision_distance, &mut found);
        changed("reach of the weight, in spacings,", self.reach, printed.reach, &mut found);
        changed("reach of the weight of the Laplacian, in spacings,", self.laplacian_reach, printed.laplacian_reach, &mut found);
        changed("share of the number density that marks the surface", self.surface_threshold, printed.surface_threshold, &mut found);
        if self.surface == SurfaceTest::Dilts {
            found.push("the surface is found by uncovered arcs (Dilts 2000) in place of the number density".to_owned());
        }
        found
    }

    fn time_step_rule(&self, courant: f64) -> String {
        step_rule(courant)
    }

    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        bytes(count, neighbours)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, _kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(Mps::new(medium, Recipe::Original, self)?))
    }
}

/// Parameters of the method `mps-modern`: those of `mps`, with defaults of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct MpsModernSettings(pub MpsSettings);

impl Settings for MpsModernSettings {
    type Own = <MpsSettings as Settings>::Own;
    const SMOOTHING: f64 = MpsSettings::SMOOTHING;
    const TAKES_KERNEL: bool = false;
    const STEP_COST: f64 = MpsSettings::STEP_COST;

    /// Both presets are the same.
    fn preset(preset: Preset) -> Self {
        Self(MpsSettings {
            preset,
            relaxation: 0.02,
            reach: 3.1,
            laplacian_reach: 3.1,
            surface: SurfaceTest::Dilts,
            solver: SolverSettings { tolerance: 1e-4, ..SolverSettings::default() },
            ..MpsSettings::preset(Preset::Water)
        })
    }

    fn preset_name(&self) -> Preset {
        self.0.preset
    }

    fn check(&self, _reach: f64) -> Result<(), BrokenRule> {
        self.0.check_all()
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        let from = format!("div v = 0 and {} of the error of the number density", self.0.relaxation);
        self.0.rows(&from, "a corrected gradient and repulsion")
    }

    fn departures(&self, _viscosity: f64, _kernel: KernelName) -> Vec<String> {
        added()
    }

    fn time_step_rule(&self, courant: f64) -> String {
        step_rule(courant)
    }

    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        bytes(count, neighbours)
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, _kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(Mps::new(medium, Recipe::Modern, &self.0)?))
    }
}

/// Which of the two methods.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Recipe {
    /// Koshizuka & Oka (1996).
    Original,
    /// Divergence in the source, corrected gradient.
    Modern,
}

/// `w(r) = r_e/r − 1` up to `r_e`, dimensionless, and its sums over the lattice (Koshizuka & Oka 1996).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Weight {
    /// `r_e`, m.
    reach: f64,
    /// Nearest distance told apart, m: nearer than that the weight, which has a pole, stays what it is. That of collisions, which
    /// take over there, or a thousandth of a spacing.
    nearest: f64,
    /// `n0 = Σ w`, dimensionless.
    sum: f64,
    /// `λ = Σ r² w/Σ w`, m².
    spread: f64,
}

impl Weight {
    /// `reach` and `nearest` in spacings.
    fn new<const D: usize>(reach: f64, nearest: f64, spacing: f64) -> Self {
        let mut weight = Self { reach: reach * spacing, nearest: nearest.max(1e-3) * spacing, sum: 0.0, spread: 0.0 };
        let n = reach.ceil() as i64;
        let side = 2 * n + 1;
        for i in 0..(0..D).fold(1, |points, _| points * side) {
            let mut rest = i;
            let x = Vector::<D>(std::array::from_fn(|_| {
                let along = rest % side - n;
                rest /= side;
                along as f64 * spacing
            }));
            let r = x.norm();
            if r > 0.0 {
                weight.sum += weight.of(r);
                weight.spread += r * r * weight.of(r);
            }
        }
        weight.spread /= weight.sum;
        weight
    }

    #[inline(always)]
    fn of(&self, r: f64) -> f64 {
        (self.reach / r.max(self.nearest) - 1.0).max(0.0)
    }

    /// `2D/(λ n0)`, 1/m²: the factor of the Laplacian.
    fn laplacian<const D: usize>(&self) -> f64 {
        2.0 * D as f64 / (self.spread * self.sum)
    }
}

/// Compressibility of water, 1/Pa: keeps fluid without a surface from asking for any pressure.
const COMPRESSIBILITY: f64 = 4.5e-10;

/// Speed after over speed before a collision (Lee, Park, Kim & Hwang 2011).
const RESTITUTION: f64 = 0.2;

/// Both methods. All operators are differences weighted with `w(r) = r_e/r − 1`, normalised by sums over the lattice; particles
/// have equal mass.
///
/// `mps`: `v* = v + Δt (g + ν ∇²v)`, `r* = r + Δt v*`; `∇²p = −(ρ/Δt²)(n* − n0)/n0` at `r*`, `p = 0` on the surface and not below
/// zero; `v = v* − (Δt/ρ)(D/n0) Σ w (p_b − p_min) x_ba/r²`. Source: Koshizuka & Oka, Nucl. Sci. Eng. 123 (1996) 421.
///
/// With the preset `water` a fifth of the error, and collisions.
///
/// `mps-modern`: all at `r`: `∇²p = (ρ/Δt) ∇·v* − γ (ρ/Δt²)(n − n0)/n0`, `p` not below zero (Tanaka & Masunaga 2010; Lee et al. 2011) and the gradient
/// `M Σ w (p_b − p_a) x_ba/r² + (D/n0)(p_a − p_min) Σ w x_ba/r²` with `M = (Σ w x⊗x/r²)⁻¹` (Khayyer & Gotoh 2011).
pub struct Mps<const D: usize> {
    medium: Medium<D>,
    recipe: Recipe,
    settings: MpsSettings,
    near: Neighbors<D>,
    /// Of number density and gradient, and of the Laplacian.
    weight: Weight,
    far: Weight,
    solver: LinearSolver,
    matrix: CsrMatrix,
    source: Vec<f64>,
    solution: Vec<f64>,
    parents: Vec<u32>,
    normals: Vec<Vector<D>>,
    /// Number density of each row.
    number: Vec<f64>,
    /// What the gradient of each row is made with.
    slopes: Vec<Slope<D>>,
    v: Vec<Vector<D>>,
    v_next: Vec<Vector<D>>,
    x_before: Vec<Vector<D>>,
    moved: Vec<Guarded<D>>,
    dt_before: Option<f64>,
}

/// The gradient of a row: pairs give `correction (p_b − p_a) + identity (p_a − p_min) D/n0`, times `w x_ba/r²`.
#[derive(Clone, Copy, Debug)]
struct Slope<const D: usize> {
    correction: Matrix<D>,
    /// `p_a − p_min`, Pa.
    over: f64,
}

impl<const D: usize> Mps<D> {
    fn new(medium: Medium<D>, recipe: Recipe, settings: &MpsSettings) -> Result<Self, SolveError> {
        Ok(Self {
            weight: Weight::new::<D>(settings.reach, settings.collision_distance, medium.spacing),
            far: Weight::new::<D>(settings.laplacian_reach, settings.collision_distance, medium.spacing),
            solver: LinearSolver::new(settings.solver.clone())?,
            medium,
            recipe,
            settings: settings.clone(),
            near: Neighbors::new(),
            matrix: CsrMatrix::new(),
            source: Vec::new(),
            solution: Vec::new(),
            parents: Vec::new(),
            normals: Vec::new(),
            number: Vec::new(),
            slopes: Vec::new(),
            v: Vec::new(),
            v_next: Vec::new(),
            x_before: Vec::new(),
            moved: Vec::new(),
            dt_before: None,
        })
    }

    /// Ghosts and pairs, as far as any weight reaches.
    fn search(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        let reach = self.weight.reach.max(self.far.reach).max(2.2 * self.medium.spacing);
        domain.refresh(p, reach);
        self.near.build(p, reach / p.h_min(), self.settings.search)?;
        for column in [&mut self.v, &mut self.normals] {
            column.resize(p.len(), Vector::ZERO);
            domain.refresh_column(column);
        }
        Ok(())
    }

    /// Number density of all rows, density as that over the lattice's, and the surface.
    fn count(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        let (near, weight, owned, rest) = (&self.near, self.weight, p.owned(), self.medium.rest_density);
        self.number.resize(owned, 0.0);
        sweep(&mut self.number, |a| {
            let mut number = 0.0;
            near.for_each(a, |pair| number += weight.of(pair.r));
            number
        });
        let number = &self.number;
        sweep(&mut p.density[..owned], |a| rest * number[a] / weight.sum);
        domain.refresh_column(&mut p.density);
        match self.settings.surface {
            SurfaceTest::Density => {
                let least = self.settings.surface_threshold * weight.sum;
                sweep(&mut p.surface[..owned], |a| u8::from(number[a] < least));
            }
            // The other tests need a kernel: no checked setting has them.
            SurfaceTest::Dilts | SurfaceTest::Divergence | SurfaceTest::Umbrella => {
                let radius = 1.1 * self.medium.spacing;
                sweep_with(&mut p.surface[..owned], Arcs::default, |arcs, a| u8::from(is_exposed(near, radius, a, arcs)));
            }
        }
        domain.refresh_column(&mut p.surface);
    }

    /// `v* = v + Δt (g + ν ∇²v)` of fluid, in `self.v`, and the drag on walls.
    fn predict(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let (near, far, gravity, owned) = (&self.near, self.far, self.medium.gravity, p.owned());
        let factor = self.medium.viscosity / self.medium.rest_density * far.laplacian::<D>();
        let mut force = std::mem::take(&mut p.force);
        self.v.resize(p.len(), Vector::ZERO);
        sweep2(&mut self.v[..owned], &mut force[..owned], |a| {
            let mut drag = Vector::ZERO;
            if factor > 0.0 && p.kind[a] != Kind::Lost {
                near.for_each(a, |pair| {
                    if p.is_fluid(a) || p.is_fluid(pair.b) {
                        drag += factor * far.of(pair.r) * (p.v[pair.b] - p.v[a]);
                    }
                });
            }
            match p.kind[a] {
                Kind::Fluid => (p.v[a] + dt * (gravity + drag), Vector::ZERO),
                Kind::Wall => (p.v[a], p.mass[a] * drag),
                Kind::Lost => (Vector::ZERO, Vector::ZERO),
            }
        });
        p.force = force;
        domain.refresh_column(&mut self.v);
    }

    /// `−∇²` over fluid and the first line of walls; rows of all that has no pressure are identities.
    fn assemble(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        let (near, far, owned, factor) = (&self.near, self.far, p.owned(), self.far.laplacian::<D>());
        let soft = self.medium.rest_density * COMPRESSIBILITY / (dt * dt);
        self.matrix.assemble(owned, |a, row| {
            if !has_pressure(p, a) {
                row.push(a, 1.0);
                return;
            }
            let mut diagonal = soft;
            near.for_each(a, |pair| {
                let k = factor * far.of(pair.r);
                if k > 0.0 && takes_part(p, pair.b) {
                    diagonal += k;
                    if has_pressure(p, pair.b) {
                        row.push(domain.parent(pair.b, owned), -k);
                    }
                }
            });
            row.push(a, diagonal);
        });
    }

    /// `(D/n0) Σ w (v_b − v_a)·x_ba/r²` at `a`, 1/s, over fluid and walls.
    fn divergence(&self, v: &[Vector<D>], a: usize) -> f64 {
        let mut total = 0.0;
        let (weight, nearest) = (self.weight, self.weight.nearest);
        self.near.for_each(a, |pair| {
            let square = (pair.r * pair.r).max(nearest * nearest);
            total -= weight.of(pair.r) * (v[pair.b] - v[a]).dot(pair.x_ab) / square;
        });
        D as f64 / weight.sum * total
    }

    /// Solves for the pressure of all rows.
    fn press(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) -> Result<SolveReport, StepError> {
        self.assemble(p, domain, dt);
        let (owned, rest) = (p.owned(), self.medium.rest_density);
        let mut source = std::mem::take(&mut self.source);
        source.resize(owned, 0.0);
        let (this, relaxation) = (&*self, self.settings.relaxation);
        match self.recipe {
            Recipe::Original => sweep(&mut source, |a| {
                if has_pressure(p, a) { rest / (dt * dt) * relaxation * (this.number[a] / this.weight.sum - 1.0) } else { 0.0 }
            }),
            Recipe::Modern => sweep(&mut source, |a| {
                if !has_pressure(p, a) {
                    return 0.0;
                }
                let mut excess = this.number[a] / this.weight.sum - 1.0;
                if excess < 0.0 {
                    // Beside the surface neighbours are missing, not fluid.
                    this.near.for_each(a, |pair| {
                        if p.surface[pair.b] == 1 && pair.r < this.weight.reach {
                            excess = 0.0;
                        }
                    });
                }
                rest / dt * (relaxation * excess / dt - this.divergence(&this.v, a))
            }),
        }
        self.source = source;
        self.solution.resize(owned, 0.0);
        sweep(&mut self.solution, |a| if has_pressure(p, a) { p.pressure[a] } else { 0.0 });
        let report = self.solver.solve(&self.matrix, &self.source, &mut self.solution)?;
        self.solution.iter_mut().for_each(|pressure| *pressure = pressure.max(0.0));
        let (solution, parents) = (&self.solution, &self.parents);
        sweep(&mut p.pressure[..owned], |a| solution[parents[a] as usize]);
        domain.refresh_column(&mut p.pressure);
        Ok(report)
    }

    /// How the gradient of fluid particle `a` is made.
    fn slope(&self, p: &Particles<D>, a: usize) -> Slope<D> {
        let (weight, uniform) = (self.weight, D as f64 / self.weight.sum);
        let (mut moment, mut lowest) = ([Vector::ZERO; D], p.pressure[a]);
        self.near.for_each(a, |pair| {
            let w = weight.of(pair.r);
            if w > 0.0 && takes_part(p, pair.b) {
                lowest = lowest.min(p.pressure[pair.b]);
                let square = (pair.r * pair.r).max(weight.nearest * weight.nearest);
                for (row, x) in moment.iter_mut().zip(pair.x_ab.0) {
                    *row += w * x / square * pair.x_ab;
                }
            }
        });
        let mut correction = identity().map(|row: Vector<D>| uniform * row);
        if self.recipe != Recipe::Original {
            // A flat surface has one half of the lattice's. There the correction would double the push outwards of a pressure that
            // is zero at the particle itself: only where neighbours are all around does it count.
            let trust = ((smallest_eigenvalue(&moment) * uniform - 0.5) / 0.4).clamp(0.0, 1.0);
            if let Some(inverse) = inverse(&moment).filter(|_| trust > 0.0) {
                correction = std::array::from_fn(|i| trust * inverse[i] + (1.0 - trust) * correction[i]);
            }
        }
        Slope { correction, over: p.pressure[a] - lowest }
    }

    /// What the pair of fluid particle `a` and `b`, `x_ab` apart, gives to the gradient at `a`, Pa/m.
    #[inline(always)]
    fn share_of_pair(&self, p: &Particles<D>, slope: &Slope<D>, (a, b): (usize, usize), x_ab: Vector<D>, r: f64) -> Vector<D> {
        let w = self.weight.of(r);
        if w == 0.0 {
            return Vector::ZERO;
        }
        let along = -w / (r * r).max(self.weight.nearest * self.weight.nearest) * x_ab;
        let difference = p.pressure[b] - p.pressure[a];
        difference * transform(&slope.correction, along) + D as f64 / self.weight.sum * slope.over * along
    }

    /// `∇p` at fluid particle `a`, Pa/m.
    fn gradient(&self, p: &Particles<D>, slope: &Slope<D>, a: usize) -> Vector<D> {
        let mut total = Vector::ZERO;
        self.near.for_each(a, |pair| {
            if takes_part(p, pair.b) {
                total += self.share_of_pair(p, slope, (a, pair.b), pair.x_ab, pair.r);
            }
        });
        total
    }

    fn slopes(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let mut slopes = std::mem::take(&mut self.slopes);
        slopes.resize(p.len(), Slope { correction: identity(), over: 0.0 });
        sweep(&mut slopes[..p.owned()], |a| if p.is_fluid(a) { self.slope(p, a) } else { Slope { correction: identity(), over: 0.0 } });
        domain.refresh_column(&mut slopes);
        self.slopes = slopes;
    }

    /// `v = v* − (Δt/ρ) ∇p`; the first line of walls takes its pressure on a spacing of wall.
    fn correct(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let (owned, rest) = (p.owned(), self.medium.rest_density);
        self.slopes(p, domain);
        let mut next = std::mem::take(&mut self.v_next);
        next.resize(p.len(), Vector::ZERO);
        let mut force = std::mem::take(&mut p.force);
        let this = &*self;
        sweep(
            &mut next[..owned],
            |a| {
                if p.is_fluid(a) { this.v[a] - (dt / rest) * this.gradient(p, &this.slopes[a], a) } else { this.v[a] }
            },
        );
        // Pairs say little: differences of pressure carry a column by forces within it.
        let area = this.medium.spacing_volume() / this.medium.spacing;
        update(&mut force[..owned], |a, force| *force -= area * p.pressure[a] * this.normals[a]);
        p.force = force;
        domain.refresh_column(&mut next);
        self.v_next = std::mem::replace(&mut self.v, next);
        if self.settings.collision_distance > 0.0 {
            self.collide(p, self.settings.collision_distance * self.medium.spacing);
        }
    }

    /// Approaching fluid particles nearer than `distance`, m, lose most of their approach: half of `1 + e` each (Lee et al. 2011).
    fn collide(&mut self, p: &Particles<D>, distance: f64) {
        let (v, near) = (&self.v, &self.near);
        sweep(&mut self.v_next[..p.owned()], |a| {
            let mut now = v[a];
            if p.is_fluid(a) {
                near.for_each(a, |pair| {
                    if pair.r < distance && pair.r > 0.0 && p.is_fluid(pair.b) {
                        let approach = (v[a] - v[pair.b]).dot(pair.x_ab) / pair.r;
                        if approach < 0.0 {
                            now -= (0.5 * (1.0 + RESTITUTION) * approach / pair.r) * pair.x_ab;
                        }
                    }
                });
            }
            now
        });
        std::mem::swap(&mut self.v, &mut self.v_next);
    }

    /// `x = xⁿ + Δt v`; nothing passes a wall.
    fn finish(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        let mut moved = std::mem::take(&mut self.moved);
        moved.resize(owned, Guarded::default());
        let this = &*self;
        sweep(&mut moved, |a| {
            if p.is_fluid(a) {
                let to = (this.x_before[a] + dt * this.v[a], this.v[a]);
                set_back(&this.near, p, &this.normals, (this.medium.spacing, dt), a, to)
            } else {
                Guarded::default()
            }
        });
        let mut force = std::mem::take(&mut p.force);
        update(&mut force[..owned], |a, force| {
            if p.kind[a] == Kind::Wall {
                *force += force_of_set_back(&this.near, p, domain, &moved, dt, a);
            }
        });
        p.force = force;
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.acceleration[a] = (moved[a].v - p.v[a]) / dt;
            (p.x[a], p.v[a]) = (moved[a].x, moved[a].v);
        }
        self.moved = moved;
        balance(p, self.medium.gravity);
        self.dt_before = Some(dt);
    }
}

/// Whether `b` takes part in the pressure operator and the gradient: fluid and the first line of walls.
#[inline(always)]
fn takes_part<const D: usize>(p: &Particles<D>, b: usize) -> bool {
    match p.kind[b] {
        Kind::Fluid => true,
        Kind::Wall => p.layer[b] == 1,
        Kind::Lost => false,
    }
}

/// Whether the pressure of `a` is an unknown.
#[inline(always)]
fn has_pressure<const D: usize>(p: &Particles<D>, a: usize) -> bool {
    takes_part(p, a) && p.surface[a] == 0
}

impl<const D: usize> Scheme<D> for Mps<D> {
    /// Number density, surface, and the acceleration that gravity and the given pressure make.
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        self.dt_before = None;
        self.search(p, domain)?;
        self.parents = first_line_parents(&self.near, p);
        self.normals = wall_normals(WendlandC2, &self.near, p);
        domain.refresh_column(&mut self.normals);
        self.count(p, domain);
        self.slopes(p, domain);
        let mut acceleration = std::mem::take(&mut p.acceleration);
        let this = &*self;
        update(&mut acceleration[..p.owned()], |a, acceleration| {
            if p.is_fluid(a) {
                *acceleration = this.medium.gravity - this.gradient(p, &this.slopes[a], a) / this.medium.rest_density;
            }
        });
        p.acceleration = acceleration;
        domain.refresh_column(&mut p.acceleration);
        Ok(())
    }

    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let dx = self.medium.spacing;
        self.medium.flow_limit(p, dx).after(self.dt_before, self.medium.courant * dx)
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        let owned = p.owned();

        // v* = v + Δt (g + ν ∇²v)
        phases.measure("search", || self.search(p, domain))?;
        if (0..owned).any(|a| p.kind[a] == Kind::Wall && p.v[a] != Vector::ZERO) {
            self.normals = wall_normals(WendlandC2, &self.near, p);
            domain.refresh_column(&mut self.normals);
        }
        phases.measure("prediction", || self.predict(p, domain, dt));

        // r* = r + Δt v*, where the number density is told and the pressure acts; the modern method stays at r
        self.x_before.clone_from(&p.x);
        if self.recipe == Recipe::Original {
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.x[a] += dt * self.v[a];
            }
            phases.measure("search", || self.search(p, domain))?;
        }
        phases.measure("density", || self.count(p, domain));

        // pressure from the density error, or from divergence and a share of that error
        let report = phases.measure("pressure", || self.press(p, domain, dt))?;

        // v = v* − (Δt/ρ) ∇p, r = r + Δt v
        phases.measure("correction", || {
            self.correct(p, domain, dt);
            self.finish(p, domain, dt);
        });
        Ok(StepReport { iterations: Some(report.iterations), residual: Some(report.residual), ..StepReport::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Particle;

    /// Fluid on a lattice of unit spacing, `n` a side.
    fn lattice<const D: usize>(n: i64, recipe: Recipe) -> (Mps<D>, Particles<D>, Domain<D>) {
        let mut p = Particles::new();
        for i in 0..(0..D).fold(1, |product, _| product * n) {
            let mut rest = i;
            let x = Vector(std::array::from_fn(|_| {
                let along = rest % n;
                rest /= n;
                along as f64
            }));
            let id = p.owned() as u32;
            p.push(id, Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1e3, density: 1e3, pressure: 0.0, h: 2.0 });
        }
        let medium = Medium {
            rest_density: 1e3,
            viscosity: 0.0,
            gravity: Vector::ZERO,
            spacing: 1.0,
            depth: n as f64,
            floor: 0.0,
            courant: 0.25,
            speed: 1.0,
        };
        let mut method = Mps::new(medium, recipe, &MpsSettings::preset(Preset::Water)).unwrap();
        let mut domain = Domain::new(Vector::splat(-5.0), Vector::splat(50.0), [false; D]);
        method.search(&mut p, &mut domain).unwrap();
        (method, p, domain)
    }

    /// Inside, the gradient of a linear pressure is exact but for the repulsion, which the lattice cancels; the Laplacian of
    /// `Σ x²` is `2D`; the divergence of `v = x` is `D`. 1e-12: round-off of some hundred terms of order one.
    fn operators_are_exact<const D: usize>(n: i64) {
        let slope = Vector(std::array::from_fn(|d| [3.0, -2.0, 0.5][d]));
        for recipe in [Recipe::Original, Recipe::Modern] {
            let (method, mut p, domain) = lattice::<D>(n, recipe);
            for a in 0..p.owned() {
                p.pressure[a] = 100.0 + slope.dot(p.x[a]);
            }
            let inside: Vec<usize> = (0..p.owned()).filter(|&a| (0..D).all(|d| p.x[a][d] >= 4.0 && p.x[a][d] <= (n - 5) as f64)).collect();
            assert!(!inside.is_empty());
            for &a in &inside {
                let gradient = method.gradient(&p, &method.slope(&p, a), a);
                assert!((gradient - slope).norm() < 1e-12, "{recipe:?}: {gradient:?}");
                assert!((method.divergence(&p.x, a) - D as f64).abs() < 1e-12);
            }
            let squares: Vec<f64> = (0..p.owned()).map(|a| p.x[a].norm_squared()).collect();
            let mut method = method;
            method.assemble(&p, &domain, 1e6);
            let mut product = vec![0.0; p.owned()];
            method.matrix.multiply(&squares, &mut product);
            for &a in &inside {
                // 1e-10: sums of squares of positions up to twelve spacings.
                assert!((product[a] + 2.0 * D as f64).abs() < 1e-10, "{}", product[a]);
            }
        }
    }

    #[test]
    fn operators_are_exact_for_linear_pressure_on_the_lattice_in_2d() {
        operators_are_exact::<2>(12);
    }

    #[test]
    fn operators_are_exact_for_linear_pressure_on_the_lattice_in_3d() {
        operators_are_exact::<3>(10);
    }

    /// The corrected gradient is exact for a linear pressure on disorder too, repulsion aside; the original one is not.
    #[test]
    fn the_corrected_gradient_is_exact_on_disorder() {
        for (recipe, exact) in [(Recipe::Modern, true), (Recipe::Original, false)] {
            let (mut method, mut p, mut domain) = lattice::<2>(12, recipe);
            let slope = Vector([3.0, -2.0]);
            for a in 0..p.owned() {
                p.x[a] += 0.2 * Vector([f64::from((a * 7 % 11) as u32) / 11.0 - 0.5, f64::from((a * 5 % 13) as u32) / 13.0 - 0.5]);
                p.pressure[a] = slope.dot(p.x[a]);
            }
            method.search(&mut p, &mut domain).unwrap();
            let a = 6 * 12 + 6;
            let mut with = method.slope(&p, a);
            with.over = 0.0;
            let error = (method.gradient(&p, &with, a) - slope).norm();
            // Round-off, or some percent.
            assert_eq!(error < 1e-12, exact, "{recipe:?}: {error:.1e}");
        }
    }

    /// `w = r_e/r − 1`: four neighbours at one spacing give 1.1 each at a reach of 2.1, four at √2, four at 2.
    #[test]
    fn the_lattice_has_its_known_number_density() {
        let weight = Weight::new::<2>(2.1, 0.0, 1.0);
        let root = 2f64.sqrt();
        // 1e-14: a dozen terms.
        assert!((weight.sum - (4.0 * 1.1 + 4.0 * (2.1 / root - 1.0) + 4.0 * 0.05)).abs() < 1e-14, "{weight:?}");
        let (method, mut p, domain) = lattice::<2>(12, Recipe::Original);
        let mut method = method;
        method.count(&mut p, &domain);
        assert!((p.density[6 * 12 + 6] / 1e3 - 1.0).abs() < 1e-14);
        let surface = (0..p.owned()).filter(|&a| p.surface[a] == 1).count();
        // Row 1 misses the four neighbours at two spacings in part: 0.05 of 6.5 each.
        assert_eq!(surface, 12 * 12 - 10 * 10, "the rim, and nothing but the rim");
    }

    /// Still water in a trough: the walls carry what the momentum of the fluid says. 1e-12: rounding of some hundred forces of the size
    /// of the weight.
    #[test]
    fn walls_carry_the_weight() {
        for recipe in [Recipe::Original, Recipe::Modern] {
            let mut p = Particles::<2>::new();
            for i in -3..13i32 {
                for j in -3..9i32 {
                    let line = (-j).max(-i).max(i - 9).max(0);
                    if line == 0 && j >= 6 {
                        continue;
                    }
                    let kind = if line == 0 { Kind::Fluid } else { Kind::Wall };
                    let x = Vector([f64::from(i) + 0.5, f64::from(j) + 0.5]);
                    let id = p.owned() as u32;
                    p.push(id, Particle { kind, layer: line as u8, x, v: Vector::ZERO, mass: 1e3, density: 1e3, pressure: 0.0, h: 2.0 });
                }
            }
            let medium = Medium {
                rest_density: 1e3,
                viscosity: 0.0,
                gravity: Vector([0.0, -10.0]),
                spacing: 1.0,
                depth: 6.0,
                floor: 0.0,
                courant: 0.25,
                speed: 15.0,
            };
            let mut method = Mps::new(medium, recipe, &MpsSettings::preset(Preset::Water)).unwrap();
            let mut domain = Domain::new(Vector::splat(-5.0), Vector::splat(50.0), [false; 2]);
            method.start(&mut p, &mut domain).unwrap();
            let weight = 60.0 * 1e4;
            for _ in 0..10 {
                let dt = method.time_step(&p).dt;
                method.step(&mut p, &mut domain, dt, &mut Phases::default()).unwrap();
            }
            let on_walls: f64 = p.force.iter().map(|force| force[1]).sum();
            let of_fluid: f64 = (0..p.owned()).filter(|&a| p.is_fluid(a)).map(|a| 1e3 * p.acceleration[a][1]).sum();
            assert!((on_walls + weight + of_fluid).abs() < 1e-12 * weight, "{recipe:?}: {on_walls} N, {of_fluid} N");
            assert!(on_walls < 0.0, "{recipe:?}: {on_walls} N");
        }
    }

    /// Two particles that meet part with a fifth of their speed and all of their momentum.
    #[test]
    fn a_collision_keeps_momentum() {
        let (mut method, mut p, mut domain) = lattice::<2>(2, Recipe::Modern);
        p.x[0] = Vector([0.7, 0.0]);
        method.search(&mut p, &mut domain).unwrap();
        method.v[..4].copy_from_slice(&[Vector([2.0, 1.0]), Vector([0.0, 0.0]), Vector::ZERO, Vector::ZERO]);
        method.v_next.resize(p.len(), Vector::ZERO);
        method.collide(&p, 0.5);
        let (one, other) = (method.v[0], method.v[1]);
        // 1e-15: round-off.
        assert!((one + other - Vector([2.0, 1.0])).norm() < 1e-15, "{one:?} {other:?}");
        assert!((other - one)[0] - 0.4 < 1e-15, "{one:?} {other:?}");
    }
}
