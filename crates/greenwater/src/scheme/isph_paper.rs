//! Incompressible SPH as the paper states it: prediction without pressure, a pressure equation, correction.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::settings::{BrokenRule, Settings, changed, paper_departures};
use super::{Medium, Preset, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::{CubicSpline, Kernel, KernelName};
use crate::math::Vector;
use crate::neighbors::{Neighbors, Search};
use crate::particles::{Kind, Particles};
use crate::physics::lattice::Lattice;
use crate::physics::pressure::{laplacian_brookshaw, laplacian_shao_lo, symmetric};
use crate::physics::surface::{Detector, SurfaceTest};
use crate::physics::{summation_density, viscosity};
use crate::poisson::{CsrMatrix, LinearSolver, SolveError, SolveReport, SolverMethod, SolverSettings};
use crate::sweep::{largest, sweep, sweep2, update};
use crate::time::{Phases, StepLimit};
use crate::walls::{first_line_parents, wall_normals};

/// Form of the pressure operator `∇·(∇p/ρ)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Laplacian {
    /// Equation (16), Shao & Lo (2003).
    ShaoLo,
    /// Equation (17), Brookshaw (1985).
    Brookshaw,
}

/// What stands beyond the free surface in the pressure gradient of a surface particle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SurfaceGhosts {
    /// Every neighbour mirrored through the particle, with opposite pressure (the paper's section 10; Shao & Lo 2003).
    Mirrored,
    /// Nothing.
    None,
}

/// What keeps fluid out of walls besides the pressure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WallGuard {
    /// Nothing, as printed: a particle of the surface has no pressure, and neither has the wall under it.
    None,
    /// A particle that would cross the face of a wall, half a spacing before its first line, is set back on the face and loses
    /// its velocity into the wall. One more than a spacing behind the first line is on the far side and stays.
    SetBack,
}

/// Parameters of the method `isph-paper`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IsphPaperSettings {
    /// Where the defaults come from.
    pub preset: Preset,
    /// Form of the pressure operator.
    pub laplacian: Laplacian,
    /// `η` of (16) and (18), dimensionless, > 0.
    pub eta: f64,
    /// How surface particles are told.
    pub surface: SurfaceTest,
    /// Share of the rest density below which a particle belongs to the surface, dimensionless, in (0, 1); for `surface = "density"`.
    pub surface_threshold: f64,
    /// Radius of the discs in particle spacings, > 0.71; for `surface = "dilts"`.
    pub surface_radius: f64,
    /// What stands beyond the surface in the pressure gradient.
    pub surface_ghosts: SurfaceGhosts,
    /// What keeps fluid out of walls besides the pressure.
    pub wall_guard: WallGuard,
    /// Linear coefficient of an artificial viscosity (13) between fluid particles, added to the prediction, dimensionless, >= 0;
    /// 0 as printed. Its speed of sound is `10 sqrt(2 g H)`, as in the explicit method.
    pub alpha: f64,
    /// How pairs are found.
    pub search: Search,
    /// Solver of the pressure equation.
    pub solver: SolverSettings,
}

impl IsphPaperSettings {
    /// The defaults of `preset`.
    pub fn preset(preset: Preset) -> Self {
        let printed = Self {
            preset,
            laplacian: Laplacian::ShaoLo,
            eta: 0.1,
            surface: SurfaceTest::Density,
            surface_threshold: 0.97,
            surface_radius: 1.1,
            surface_ghosts: SurfaceGhosts::Mirrored,
            wall_guard: WallGuard::None,
            alpha: 0.0,
            search: Search::Grid,
            solver: SolverSettings::default(),
        };
        match preset {
            Preset::Paper => printed,
            Preset::Water => Self { wall_guard: WallGuard::SetBack, alpha: 0.05, ..printed },
        }
    }
}

impl Settings for IsphPaperSettings {
    type Own = CubicSpline;
    const SMOOTHING: f64 = 1.2;
    const STEP_COST: f64 = 1.6e-7;

    fn preset(preset: Preset) -> Self {
        Self::preset(preset)
    }

    fn preset_name(&self) -> Preset {
        self.preset
    }

    fn check(&self, reach: f64) -> Result<(), BrokenRule> {
        let s = self;
        BrokenRule::unless_positive("eta", s.eta)?;
        BrokenRule::unless_not_negative("alpha", s.alpha)?;
        let threshold = s.surface_threshold;
        BrokenRule::unless(threshold > 0.0 && threshold < 1.0, "surface_threshold", threshold, "> 0 and < 1")?;
        BrokenRule::unless(s.surface_radius > 0.71, "surface_radius", s.surface_radius, "> 0.71")?;
        // Discs that touch belong to particles two radii apart: neighbours only if the kernel reaches that far.
        let covers = s.surface != SurfaceTest::Dilts || 2.0 * s.surface_radius <= reach;
        let most = format!("at most {}, half the kernel's reach in spacings, with surface = \"dilts\"", 0.5 * reach);
        BrokenRule::unless(covers, "surface_radius", s.surface_radius, most)?;
        BrokenRule::unless_solvable(&s.solver)
    }

    fn distinctions(&self) -> Vec<(&'static str, String)> {
        let s = self;
        let operator = match s.laplacian {
            Laplacian::ShaoLo => "(16), Shao & Lo (2003)",
            Laplacian::Brookshaw => "(17), Brookshaw (1985)",
        };
        let guard = match s.wall_guard {
            WallGuard::None => "",
            WallGuard::SetBack => "; what would cross their face is set back",
        };
        let surface = match s.surface {
            SurfaceTest::Density => format!("density below {} of rest", s.surface_threshold),
            SurfaceTest::Divergence => "divergence of positions (Lee et al. 2008)".to_owned(),
            SurfaceTest::Dilts => format!("uncovered arcs of discs of {} spacings (Dilts 2000)", s.surface_radius),
            SurfaceTest::Umbrella => "nothing in a cone around the normal (Marrone et al. 2010)".to_owned(),
        };
        let beyond = match s.surface_ghosts {
            SurfaceGhosts::Mirrored => "neighbours mirrored with opposite pressure",
            SurfaceGhosts::None => "nothing beyond",
        };
        let added = if s.alpha == 0.0 { String::new() } else { format!(" and artificial (13), alpha = {}", s.alpha) };
        vec![
            ("compressibility", "incompressible".to_owned()),
            ("pressure from", format!("equation (31) with operator {operator}; a density error removed within a step")),
            ("density from", "sum over neighbours (11)".to_owned()),
            ("viscosity", format!("of the fluid (18){added}")),
            ("time step limited by", "speed (32)".to_owned()),
            ("time stepping", "prediction (29), pressure, correction (30)".to_owned()),
            ("walls", format!("three rows of fixed particles, one of them in the pressure equation{guard}")),
            ("free surface", format!("{surface}; {beyond}")),
            ("linear system", format!("{}, residual {:e}", s.solver.name(), s.solver.tolerance)),
            ("work of a step", "sums over neighbours and one linear system".to_owned()),
        ]
    }

    fn departures(&self, viscosity: f64, kernel: KernelName) -> Vec<String> {
        let s = self;
        let printed = IsphPaperSettings::preset(Preset::Paper);
        let mut found = Vec::new();
        if s.wall_guard != printed.wall_guard {
            found.push("particles that would cross the face of a wall are set back on it; the paper has no such guard".to_owned());
        }
        if s.alpha != printed.alpha {
            found.push(format!("artificial viscosity (13) with alpha = {} added to the prediction; the paper has none", s.alpha));
        }
        changed("eta of (16) and (18) =", s.eta, printed.eta, &mut found);
        match s.surface {
            SurfaceTest::Density => {
                changed("share of the rest density that marks the surface", s.surface_threshold, printed.surface_threshold, &mut found);
            }
            SurfaceTest::Divergence => {
                found.push("the surface is found by the divergence of positions (Lee et al. 2008) in place of the density".to_owned());
            }
            SurfaceTest::Dilts => found.push("the surface is found by uncovered arcs (Dilts 2000) in place of the density".to_owned()),
            SurfaceTest::Umbrella => {
                found.push("the surface is found by cones around normals (Marrone et al. 2010) in place of the density".to_owned());
            }
        }
        if s.surface_ghosts != printed.surface_ghosts {
            found.push("no mirrored neighbours beyond the free surface".to_owned());
        }
        paper_departures(viscosity, kernel, &mut found);
        found
    }

    fn time_step_rule(&self, courant: f64) -> String {
        format!("(32): {courant} h over the greatest speed, at least sqrt(g H)")
    }

    /// 16 bytes for a matrix entry, the dense matrix of Gauss, the vectors of GMRES.
    fn memory(&self, count: f64, neighbours: f64) -> f64 {
        let matrix = 16.0 * count * neighbours;
        match self.solver.method {
            SolverMethod::Gauss => matrix + 8.0 * count * count,
            SolverMethod::Gmres => matrix + 8.0 * count * (self.solver.restart as f64 + 1.0),
            SolverMethod::Cg | SolverMethod::Bicgstab | SolverMethod::DefectCorrection => matrix,
        }
    }

    fn scheme<K: Kernel<D>, const D: usize>(&self, kernel: K, medium: Medium<D>) -> Result<Box<dyn Scheme<D>>, SolveError> {
        Ok(Box::new(IsphPaper::new(kernel, medium, self.clone())?))
    }
}

/// The incompressible method of the paper: equations (11), (16)-(18), (20), (29)-(32).
///
/// Walls are three lines of fixed particles (Morris, Fox & Zhu 1997): all count in the density (11) and in the viscosity (18);
/// the first one carries an unknown pressure and enters the pressure equation and its gradient; the others take the pressure
/// of the first-line particle in front of them (no normal gradient). Surface particles have no pressure.
///
/// Sources: Afanasiev, Makarchuk & Popov, NNFM 101 (2008) 206; Shao & Lo, Adv. Water Resour. 26 (2003) 787;
/// Cummins & Rudman, J. Comput. Phys. 152 (1999) 584.
pub struct IsphPaper<K, const D: usize> {
    kernel: K,
    medium: Medium<D>,
    settings: IsphPaperSettings,
    detector: Detector,
    near: Neighbors<D>,
    solver: LinearSolver,
    matrix: CsrMatrix,
    source: Vec<f64>,
    solution: Vec<f64>,
    /// First-line particle in front of each wall particle.
    parents: Vec<u32>,
    /// Unit normal of each first-line wall particle, towards the fluid; zero for all others.
    normals: Vec<Vector<D>>,
    x_before: Vec<Vector<D>>,
    v_before: Vec<Vector<D>>,
    /// What the wall guard made of each particle.
    guarded: Vec<Guarded<D>>,
}

/// A particle behind the wall guard.
#[derive(Clone, Copy, Debug, Default)]
struct Guarded<const D: usize> {
    x: Vector<D>,
    v: Vector<D>,
    /// Velocity it lost into walls, m/s.
    lost: Vector<D>,
    /// Name of the wall particle that set it back last; `u32::MAX` for none.
    by: u32,
}

impl<K: Kernel<D>, const D: usize> IsphPaper<K, D> {
    /// The method for a fluid, with a kernel and checked parameters.
    ///
    /// # Errors
    /// Solver settings that contradict each other.
    pub fn new(kernel: K, medium: Medium<D>, settings: IsphPaperSettings) -> Result<Self, SolveError> {
        // Of the particles' own smoothing length from the start on.
        let lattice = Lattice::of(kernel, medium.spacing, medium.spacing, medium.rest_density);
        Ok(Self {
            kernel,
            medium,
            solver: LinearSolver::new(settings.solver.clone())?,
            detector: Detector::new(settings.surface, lattice),
            settings,
            near: Neighbors::new(),
            matrix: CsrMatrix::new(),
            source: Vec::new(),
            solution: Vec::new(),
            parents: Vec::new(),
            normals: Vec::new(),
            x_before: Vec::new(),
            v_before: Vec::new(),
            guarded: Vec::new(),
        })
    }

    /// Matrix and right-hand side of the last pressure equation (31), a row a particle; without rows before the first step.
    pub fn pressure_equation(&self) -> (&CsrMatrix, &[f64]) {
        (&self.matrix, &self.source)
    }

    /// Ghosts and pairs at the present positions.
    fn search(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, phases: &mut Phases) -> Result<(), StepError> {
        phases.measure("search", || {
            domain.refresh(p, self.kernel.radius() * p.h_max());
            // Images come and go.
            self.normals.resize(p.len(), Vector::ZERO);
            domain.refresh_column(&mut self.normals);
            self.near.build(p, self.kernel.radius(), self.settings.search)
        })?;
        Ok(())
    }

    /// `g + ν ∇²v`, m/s², by (18); walls drag at rest.
    fn predicted_acceleration(&self, p: &mut Particles<D>) {
        let (eta, alpha) = (self.settings.eta, self.settings.alpha);
        if alpha > 0.0 {
            self.sum_viscosity(p, |approach| viscosity::artificial(approach, alpha, 0.0, eta));
        } else {
            self.sum_viscosity(p, |_| 0.0);
        }
    }

    /// [`predicted_acceleration`](Self::predicted_acceleration) with `artificial(approach)` as the artificial viscosity of fluid, and
    /// the drag on the walls.
    fn sum_viscosity(&self, p: &mut Particles<D>, artificial: impl Fn(viscosity::Approach<f64>) -> f64 + Sync) {
        let (near, kernel, medium, eta) = (&self.near, self.kernel, self.medium, self.settings.eta);
        let sound = 10.0 * (2.0 * medium.g() * medium.depth).sqrt();
        let still = medium.viscosity == 0.0 && self.settings.alpha == 0.0;
        // Coefficient of v_ab in the acceleration of the first particle by the second one.
        let laminar = |a: usize, b: usize, slope: f64, r: f64, h: f64| {
            viscosity::laplacian(p.mass[b], medium.viscosity, p.density[a], p.density[b], slope, r, eta * eta * h * h)
        };
        let owned = p.owned();
        let mut acceleration = std::mem::take(&mut p.acceleration);
        let mut force = std::mem::take(&mut p.force);
        sweep2(&mut acceleration[..owned], &mut force[..owned], |a| {
            let (mut total, mut on_wall) = (medium.gravity, Vector::ZERO);
            match p.kind[a] {
                Kind::Fluid if still => {}
                Kind::Fluid => near.for_each(a, |pair| {
                    let b = pair.b;
                    let slope = kernel.dw_over_r(pair.r, pair.h);
                    let v_ab = p.v[a] - p.v[b];
                    total += laminar(a, b, slope, pair.r, pair.h) * v_ab;
                    if p.is_fluid(b) {
                        let density = 0.5 * (p.density[a] + p.density[b]);
                        let approach =
                            viscosity::Approach { along: v_ab.dot(pair.x_ab), square: pair.r * pair.r, h: pair.h, sound, density };
                        total -= p.mass[b] * artificial(approach) * (slope * pair.x_ab);
                    }
                }),
                Kind::Wall => {
                    total = Vector::ZERO;
                    near.for_each(a, |pair| {
                        if p.is_fluid(pair.b) {
                            let slope = kernel.dw_over_r(pair.r, pair.h);
                            on_wall -= p.mass[pair.b] * laminar(pair.b, a, slope, pair.r, pair.h) * (p.v[pair.b] - p.v[a]);
                        }
                    });
                }
                Kind::Lost => total = Vector::ZERO,
            }
            (total, on_wall)
        });
        p.acceleration = acceleration;
        p.force = force;
    }

    /// (11) for all particles, and who belongs to the free surface.
    fn density_and_surface(&self, p: &mut Particles<D>, domain: &Domain<D>) {
        let (near, kernel) = (&self.near, self.kernel);
        let owned = p.owned();
        let mut density = std::mem::take(&mut p.density);
        sweep(&mut density[..owned], |a| summation_density(kernel, near, &p.mass, a));
        domain.refresh_column(&mut density);
        p.density = density;

        let mut surface = std::mem::take(&mut p.surface);
        match self.settings.surface {
            SurfaceTest::Density => {
                let threshold = self.settings.surface_threshold * self.medium.rest_density;
                sweep(&mut surface[..owned], |a| u8::from(p.density[a] < threshold));
            }
            SurfaceTest::Divergence | SurfaceTest::Dilts | SurfaceTest::Umbrella => {
                self.detector.mark(kernel, near, p, &mut surface[..owned]);
            }
        }
        domain.refresh_column(&mut surface);
        p.surface = surface;
    }

    /// The matrix of (31) at the predicted positions, with (16) or (17) as `operator(ρ_a, ρ_b, W'/r, r, h)` times both masses, so
    /// that it is symmetric. Rows of surface particles, of walls behind the first line and of lost particles are identities with
    /// pressure zero; their columns are left out, as the pressure there is zero.
    fn assemble_matrix(&mut self, p: &Particles<D>, domain: &Domain<D>, operator: impl Fn(f64, f64, f64, f64, f64) -> f64 + Sync) {
        let (near, kernel, owned) = (&self.near, self.kernel, p.owned());
        self.matrix.assemble(owned, |a, row| {
            let mut diagonal = 0.0;
            if carries_pressure(p, a) {
                near.for_each(a, |pair| {
                    if in_gradient(p, pair.b) {
                        let slope = kernel.dw_over_r(pair.r, pair.h);
                        let masses = p.mass[a] * p.mass[pair.b];
                        let k = masses * operator(p.density[a], p.density[pair.b], slope, pair.r, pair.h);
                        diagonal += k;
                        if carries_pressure(p, pair.b) {
                            row.push(domain.parent(pair.b, owned), -k);
                        }
                    }
                });
            }
            row.push(a, if diagonal > 0.0 { diagonal } else { 1.0 });
        });
    }

    /// The pressure equation (31): the matrix, and the density error as its source.
    fn assemble(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        let eta = self.settings.eta;
        match self.settings.laplacian {
            Laplacian::ShaoLo => self.assemble_matrix(p, domain, |rho_a, rho_b, slope, r, h| {
                let eta = eta * h;
                laplacian_shao_lo(rho_a, rho_b, slope, r, eta * eta)
            }),
            Laplacian::Brookshaw => self.assemble_matrix(p, domain, |rho_a, rho_b, slope, _, _| laplacian_brookshaw(rho_a, rho_b, slope)),
        }

        let rest = self.medium.rest_density;
        self.source.resize(owned, 0.0);
        sweep(&mut self.source, |a| if carries_pressure(p, a) { p.mass[a] * (p.density[a] - rest) / (rest * dt * dt) } else { 0.0 });
    }

    /// (31): pressure from the predicted density; warm start from the pressure of the step before.
    fn solve_pressure(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64, phases: &mut Phases) -> Result<SolveReport, StepError> {
        phases.measure("assembly", || self.assemble(p, domain, dt));
        let owned = p.owned();
        self.solution.resize(owned, 0.0);
        sweep(&mut self.solution, |a| if carries_pressure(p, a) { p.pressure[a] } else { 0.0 });
        if !(0..p.owned()).any(|a| p.is_fluid(a) && p.surface[a] != 0) {
            return Err(StepError::NoSurface);
        }
        let report = phases.measure("solver", || self.solver.solve(&self.matrix, &self.source, &mut self.solution))?;
        let (solution, parents) = (&self.solution, &self.parents);
        sweep(&mut p.pressure[..owned], |a| solution[parents[a] as usize]);
        domain.refresh_column(&mut p.pressure);
        Ok(report)
    }

    /// The reaction to [`pressure_acceleration`](Self::pressure_acceleration) on the first line of walls.
    fn add_pressure_on_walls(&self, p: &mut Particles<D>) {
        let (near, kernel) = (&self.near, self.kernel);
        let mirrored = self.settings.surface_ghosts == SurfaceGhosts::Mirrored;
        let mut force = std::mem::take(&mut p.force);
        update(&mut force[..p.owned()], |b, total| {
            if p.kind[b] == Kind::Wall && p.layer[b] == 1 {
                near.for_each(b, |pair| {
                    let a = pair.b;
                    if p.is_fluid(a) {
                        let factor = if mirrored && p.surface[a] == 1 {
                            2.0 * p.pressure[b] / (p.density[b] * p.density[b])
                        } else {
                            symmetric(p.pressure[a], p.density[a], p.pressure[b], p.density[b])
                        };
                        *total -= p.mass[a] * p.mass[b] * factor * kernel.dw_over_r(pair.r, pair.h) * pair.x_ab;
                    }
                });
            }
        });
        p.force = force;
    }

    /// Sets fluid that crossed the face of a wall back on it, and takes its velocity into the wall: a push on the wall that took it.
    fn guard_walls(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let face = 0.5 * self.medium.spacing;
        let (near, normals, spacing) = (&self.near, &self.normals, self.medium.spacing);
        let owned = p.owned();
        self.guarded.resize(p.len(), Guarded::default());
        sweep(&mut self.guarded[..owned], |a| {
            let mut now = Guarded { x: p.x[a], v: p.v[a], lost: Vector::ZERO, by: u32::MAX };
            if p.is_fluid(a) {
                near.for_each(a, |pair| {
                    let normal = normals[pair.b];
                    // Walls do not move: their place in the list is their place now.
                    let from_wall = now.x - near.x(pair.b);
                    let depth = face - from_wall.dot(normal);
                    let aside = (from_wall - from_wall.dot(normal) * normal).norm();
                    if normal != Vector::ZERO && depth > 0.0 && depth <= 3.0 * face && aside <= spacing {
                        now.x += depth * normal;
                        let into = now.v.dot(normal).min(0.0) * normal;
                        now.v -= into;
                        now.lost += into;
                        now.by = p.id[pair.b];
                    }
                });
            }
            now
        });
        domain.refresh_column(&mut self.guarded);
        let guarded = &self.guarded;
        let mut force = std::mem::take(&mut p.force);
        update(&mut force[..owned], |b, total| {
            if normals[b] != Vector::ZERO {
                near.for_each(b, |pair| {
                    let Guarded { lost, by, .. } = guarded[pair.b];
                    if by == p.id[b] {
                        *total += p.mass[pair.b] / dt * lost;
                    }
                });
            }
        });
        p.force = force;
        for (a, now) in guarded[..owned].iter().enumerate() {
            (p.x[a], p.v[a]) = (now.x, now.v);
        }
    }

    /// `−∇p/ρ`, m/s², by (20) over fluid and the first line of walls. At the surface every neighbour counts twice: with its image
    /// mirrored through the particle and of opposite pressure, pair and image add up to `2 m_b p_b/ρ_b² ∇W`.
    fn pressure_acceleration(&self, p: &Particles<D>, a: usize) -> Vector<D> {
        if !p.is_fluid(a) {
            return Vector::ZERO;
        }
        if p.surface[a] == 1 && self.settings.surface_ghosts == SurfaceGhosts::Mirrored {
            self.gradient(p, a, |b| 2.0 * p.pressure[b] / (p.density[b] * p.density[b]))
        } else {
            self.gradient(p, a, |b| symmetric(p.pressure[a], p.density[a], p.pressure[b], p.density[b]))
        }
    }

    /// `−Σ m_b factor(b) ∇W_ab` over fluid and the first line of walls.
    #[inline(always)]
    fn gradient(&self, p: &Particles<D>, a: usize, factor: impl Fn(usize) -> f64) -> Vector<D> {
        let mut total = Vector::ZERO;
        self.near.for_each(a, |pair| {
            if in_gradient(p, pair.b) {
                total -= p.mass[pair.b] * factor(pair.b) * self.kernel.dw_over_r(pair.r, pair.h) * pair.x_ab;
            }
        });
        total
    }
}

/// Whether `b` takes part in the pressure operator and the gradient: fluid and the first line of walls.
#[inline(always)]
fn in_gradient<const D: usize>(p: &Particles<D>, b: usize) -> bool {
    match p.kind[b] {
        Kind::Fluid => true,
        Kind::Wall => p.layer[b] == 1,
        Kind::Lost => false,
    }
}

/// Whether the pressure of `a` is an unknown: it takes part and is not at the surface.
#[inline(always)]
fn carries_pressure<const D: usize>(p: &Particles<D>, a: usize) -> bool {
    in_gradient(p, a) && p.surface[a] == 0
}

impl<K: Kernel<D>, const D: usize> Scheme<D> for IsphPaper<K, D> {
    /// Density and surface at the start, and the acceleration that gravity, viscosity and the given pressure make.
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        let lattice = Lattice::of(self.kernel, p.h_max(), self.medium.spacing, self.medium.rest_density);
        self.detector = Detector::new(self.settings.surface, lattice).with_radius(self.settings.surface_radius * self.medium.spacing);
        self.search(p, domain, &mut Phases::default())?;
        self.parents = first_line_parents(&self.near, p);
        self.normals = wall_normals(self.kernel, &self.near, p);
        domain.refresh_column(&mut self.normals);
        self.density_and_surface(p, domain);
        self.predicted_acceleration(p);
        let mut acceleration = p.acceleration.clone();
        sweep(&mut acceleration[..p.owned()], |a| p.acceleration[a] + self.pressure_acceleration(p, a));
        p.acceleration = acceleration;
        Ok(())
    }

    /// (32): `C min(h)/max|v|`. The print gives no step for a fluid at rest; `sqrt(g H)`, the speed its pressure can cause, is
    /// the least speed here.
    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let h = p.h_min();
        let speed = largest(p.owned(), |a| p.v[a].norm_squared()).sqrt();
        let least = (self.medium.g() * self.medium.depth).sqrt();
        let c = self.medium.courant;
        StepLimit::new(c * h / speed, "flow").min(StepLimit::new(c * h / least, "depth"))
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        let owned = p.owned();

        // (29) predict without pressure: v* = vⁿ + Δt (g + ν ∇²v), r* = rⁿ + Δt v*
        self.search(p, domain, phases)?;
        self.x_before.clone_from(&p.x);
        self.v_before.clone_from(&p.v);
        phases.measure("prediction", || {
            self.predicted_acceleration(p);
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.v[a] += dt * p.acceleration[a];
                p.x[a] += dt * p.v[a];
            }
        });

        // (11) density at the predicted positions
        self.search(p, domain, phases)?;
        phases.measure("density", || self.density_and_surface(p, domain));

        // (31) pressure that brings the density back to rest
        let report = self.solve_pressure(p, domain, dt, phases)?;

        // (30) correct: v = v* − Δt ∇p/ρ, r = rⁿ + Δt (vⁿ + v)/2
        phases.measure("correction", || {
            let mut correction = std::mem::take(&mut p.acceleration);
            sweep(&mut correction[..owned], |a| self.pressure_acceleration(p, a));
            p.acceleration = correction;
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.v[a] += dt * p.acceleration[a];
                p.x[a] = self.x_before[a] + 0.5 * dt * (self.v_before[a] + p.v[a]);
            }
            self.add_pressure_on_walls(p);
            if self.settings.wall_guard == WallGuard::SetBack {
                self.guard_walls(p, domain, dt);
            }
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.acceleration[a] = (p.v[a] - self.v_before[a]) / dt;
            }
        });
        Ok(StepReport { iterations: Some(report.iterations), residual: Some(report.residual), ..StepReport::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::CubicSpline;
    use crate::particles::Particle;

    /// Three lines of wall under `y = 0` with the face at 0, and one fluid particle at `x`, moving at `v`.
    fn over_a_floor(x: Vector<2>, v: Vector<2>) -> (Particles<2>, Vector<2>) {
        let (dx, mut p) = (0.1, Particles::new());
        let mut push = |kind, layer, x, v| {
            let id = p.owned() as u32;
            p.push(id, Particle { kind, layer, x, v, mass: 10.0, density: 1000.0, pressure: 0.0, h: 1.2 * dx });
        };
        push(Kind::Fluid, 0, x, v);
        for line in 1..=3 {
            for column in -6..=6 {
                push(Kind::Wall, line, Vector([dx * f64::from(column), -dx * (f64::from(line) - 0.5)]), Vector::ZERO);
            }
        }
        let medium = Medium {
            rest_density: 1000.0,
            viscosity: 0.0,
            gravity: Vector([0.0, -9.81]),
            spacing: dx,
            depth: 1.0,
            floor: 0.0,
            courant: 0.25,
            speed: 6.3,
        };
        let mut domain = Domain::new(Vector([-5.0, -5.0]), Vector([5.0, 5.0]), [false; 2]);
        let mut method = IsphPaper::new(CubicSpline, medium, IsphPaperSettings::preset(Preset::Water)).unwrap();
        method.start(&mut p, &mut domain).unwrap();
        let before: Vector<2> = p.force[1..].iter().fold(Vector::ZERO, |sum, &f| sum + f);
        method.guard_walls(&mut p, &domain, 0.01);
        let after = p.force[1..].iter().fold(Vector::ZERO, |sum, &f| sum + f);
        (p, after - before)
    }

    #[test]
    fn what_crosses_the_face_of_a_wall_is_set_back_and_pushes_the_wall() {
        let (p, push) = over_a_floor(Vector([0.02, -0.03]), Vector([1.5, -2.0]));
        // 1e-12: round-off. The face is half a spacing before the first line, at y = 0.
        assert!((p.x[0] - Vector([0.02, 0.0])).norm() < 1e-12 && (p.v[0] - Vector([1.5, 0.0])).norm() < 1e-12, "{:?} {:?}", p.x[0], p.v[0]);
        // 10 kg/m lose 2 m/s in 0.01 s.
        assert!((push - Vector([0.0, -2000.0])).norm() < 1e-9, "{push:?}");
    }

    #[test]
    fn what_is_in_front_of_the_face_or_on_the_far_side_of_a_thin_wall_is_left_alone() {
        for y in [0.01, -0.17] {
            let (x, v) = (Vector([0.02, y]), Vector([1.5, -2.0]));
            let (p, push) = over_a_floor(x, v);
            assert_eq!((p.x[0], p.v[0], push), (x, v, Vector::ZERO), "at y = {y}");
        }
    }
}
