//! Incompressible SPH that is smooth and robust at once: a compact pressure equation drives the flow, a truncated exact
//! projection cleans the velocity, and a projection of positions keeps the density.

mod closure;
mod parts;
mod settings;
mod walls;

use self::closure::Closure;
use self::parts::Parts;
use self::walls::Guarded;
use super::{Medium, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::math::{Vector, transform};
use crate::neighbors::{Neighbors, PairColumn};
use crate::particles::{Kind, Particles};
use crate::physics::arrangement::{Arrangement, Place, across, known_along};
use crate::physics::lattice::Lattice;
use crate::poisson::projection::{self, Workspace};
use crate::poisson::{CsrMatrix, LinearSolver, SolveError, SolveReport};
use crate::sweep::{largest, sweep, sweep2, update};
use crate::time::{Phases, StepLimit};
use crate::walls::wall_normals;

pub use settings::{FreeSurface, IsphSettings, IsphShiftSettings, WallFriction};

/// The method: smooth wall pressure and robust through impacts.
///
/// With `f_ab = −V W'/r`, all sums at the positions of the start of the step, and `D u_a = −Σ f (u_b − u_a)·x_ab`:
/// 1. `v* = v + Δt (g + viscosity)`; walls `v* = v + Δt (g − a)`;
/// 2. compact pressure equation `Σ 2f (p_a − p_b) + s_a p_a = −(ρ/Δt) D v* + walls`, symmetric and positive, `s_a` the free
///    surface exact for linear `p`; walls carry `p_w = p_a + ρ (g − a_w)·(x_w − x_a)` pair by pair;
/// 3. `v = v* − (Δt/ρ) ∇p` with the corrected gradient; the same again for what divergence is left; the sum is the pressure;
/// 4. a few iterations of the exact projection `D G q = D v`, `G` the adjoint of `D`, clean the velocity; `q` is discarded;
/// 5. shifting to even spacing, and the same exact projection applied to positions restores the density;
/// 6. `x += Δt v + δx`, `v += δx·∇v`, and parts that touch no wall keep momentum and angular momentum.
///
/// Velocities stand half a step before positions: pushes last from the middle of one step to that of the next.
///
/// Sources: Cummins & Rudman (1999) (projection), Nair & Tomar (2014) (surface rows), Bender & Koschier (2017) (exact
/// projection), Skillen et al. (2013) (shifting), Bonet & Lok (1999) (corrected gradient).
pub struct Isph<K, const D: usize> {
    kernel: K,
    flow: Flow<D>,
}

/// All of the method that needs no kernel, once its sums over neighbours are there: compiled once for all kernels.
struct Flow<const D: usize> {
    medium: Medium<D>,
    settings: IsphSettings,
    lattice: Lattice,
    near: Neighbors<D>,
    /// `f` of each pair, 1/m².
    f: PairColumn,
    at: Vec<Arrangement<D>>,
    places: Vec<Place>,
    solver: LinearSolver,
    matrix: CsrMatrix,
    /// `s` of each row, 1/m².
    pull: Vec<f64>,
    parts: Parts<D>,
    closure: Closure,
    /// Pressure gradient of the step before, Pa/m.
    rise: Vec<Vector<D>>,
    /// See [`bending`](Self::bending); empty where a surface is tracked.
    bending: Vec<f64>,
    source: Vec<f64>,
    solution: Vec<f64>,
    pressure: Vec<f64>,
    /// Diagonal of the exact projection, and its potentials for the velocity (m²/s) and the positions (m²).
    exact_diagonal: Vec<f64>,
    cleaning: Vec<f64>,
    packing: Vec<f64>,
    with_ghosts: Vec<f64>,
    work: Workspace,
    v: Vec<Vector<D>>,
    v_next: Vec<Vector<D>>,
    /// `g − a` on wall rows, m/s²: what their pressure answers to.
    answer: Vec<Vector<D>>,
    gradient: Vec<Vector<D>>,
    shift: Vec<Vector<D>>,
    moved: Vec<Guarded<D>>,
    /// Unit normal of each wall particle, towards the fluid, deeper lines that of the first one in front of them.
    normals: Vec<Vector<D>>,
    first_line: Vec<u32>,
    dt_before: Option<f64>,
    /// Greatest speed of the step, m/s.
    fastest: f64,
}

impl<K: Kernel<D>, const D: usize> Isph<K, D> {
    /// The method for a fluid, with a kernel and checked parameters.
    ///
    /// # Errors
    /// Solver settings that contradict each other.
    pub fn new(kernel: K, medium: Medium<D>, settings: IsphSettings) -> Result<Self, SolveError> {
        let flow = Flow {
            medium,
            // Of the particles' own smoothing length from the start on.
            lattice: Lattice::of(kernel, medium.spacing, medium.spacing, medium.rest_density),
            solver: LinearSolver::new(settings.solver.clone())?,
            settings,
            near: Neighbors::new(),
            f: PairColumn::default(),
            at: Vec::new(),
            places: Vec::new(),
            matrix: CsrMatrix::new(),
            pull: Vec::new(),
            parts: Parts::default(),
            closure: Closure::default(),
            rise: Vec::new(),
            bending: Vec::new(),
            source: Vec::new(),
            solution: Vec::new(),
            pressure: Vec::new(),
            exact_diagonal: Vec::new(),
            cleaning: Vec::new(),
            packing: Vec::new(),
            with_ghosts: Vec::new(),
            work: Workspace::default(),
            v: Vec::new(),
            v_next: Vec::new(),
            answer: Vec::new(),
            gradient: Vec::new(),
            shift: Vec::new(),
            moved: Vec::new(),
            normals: Vec::new(),
            first_line: Vec::new(),
            dt_before: None,
            fastest: 0.0,
        };
        Ok(Self { kernel, flow })
    }

    /// Ghosts, pairs, `f` of each pair, and what they say about each particle.
    fn look_around(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        domain.refresh(p, self.kernel.radius() * p.h_max());
        self.flow.near.build(p, self.kernel.radius(), self.flow.settings.search)?;
        let (kernel, rest, owned) = (self.kernel, self.flow.medium.rest_density, p.owned());
        let flow = &mut self.flow;
        let half_over_rest = 0.5 / rest;
        let (near, f) = (&flow.near, &mut flow.f);
        near.fill(f, |a, pair| -half_over_rest * (p.mass[a] + p.mass[pair.b]) * kernel.dw_over_r(pair.r, pair.h));
        let first = flow.walls_turn(p).then(|| wall_normals(kernel, &flow.near, p));
        flow.look_at_walls(p, domain, first.as_deref());
        let (near, lattice, normals) = (&flow.near, &flow.lattice, &flow.normals);
        flow.at.resize(owned, Arrangement::alone());
        flow.places.resize(p.len(), Place::Inside);
        sweep(&mut flow.at, |a| if p.is_fluid(a) { Arrangement::of(kernel, lattice, near, p, normals, a) } else { Arrangement::alone() });
        if flow.settings.free_surface == FreeSurface::None {
            flow.at.iter_mut().for_each(|at| at.place = Place::Inside);
        } else {
            let (at, places, f) = (&mut flow.at, &mut flow.places, &flow.f);
            sweep(&mut places[..owned], |a| at[a].place);
            domain.refresh_column(places);
            update(at, |a, at| {
                if p.is_fluid(a) {
                    at.look_for_surface(lattice, near, f, places, a);
                }
            });
        }
        flow.parts.find(p, domain, &flow.near);
        let at = &flow.at;
        sweep2(&mut p.density[..owned], &mut p.surface[..owned], |a| (rest * at[a].filling, u8::from(at[a].place == Place::Surface)));
        Ok(())
    }
}

impl<const D: usize> Flow<D> {
    /// The greatest speed that counts for steps and viscosity, m/s: of fluid and walls, at least `sqrt(g H)`.
    fn speed(&self, p: &Particles<D>) -> f64 {
        let fastest = largest(p.owned(), |a| p.v[a].norm_squared()).max(0.0).sqrt();
        fastest.max((self.medium.g() * self.medium.depth).sqrt())
    }

    /// The factor `ν` of sums `2ν Σ f (v_b − v_a)`, m²/s, for which they are exact for parabolic profiles on a lattice, whose `Σ f r²` is
    /// not quite `D`.
    fn diffusivity(&self) -> f64 {
        self.medium.viscosity / (self.medium.rest_density * self.lattice.slope_of_linear::<D>())
    }

    /// Viscosity, m/s²: that of the fluid, `2ν Σ f (v_b − v_a)` (Morris, Fox & Zhu 1997), inside less what uneven neighbours make of a
    /// linear velocity, `2ν (∇v)·(Σ V∇W)`; and the dissipation between approaching
    /// particles, `2(D+2) ν f (v_ab·x_ab) x_ab/r²` with `ν = dissipation · h U/8` (Monaghan 1992).
    fn viscosity(&self, p: &Particles<D>, a: usize, speed: f64) -> Vector<D> {
        let mut total = Vector::ZERO;
        let nu = self.diffusivity();
        let numerical = 2.0 * (D as f64 + 2.0) * self.settings.dissipation * self.near.h(a) * speed / 8.0;
        let sticks = self.settings.wall_friction == WallFriction::NoSlip;
        if nu == 0.0 && numerical == 0.0 {
            return total;
        }
        let (mut linear, uneven) = (Vector::ZERO, transform(&self.at[a].correction, self.at[a].slope));
        self.near.for_each_with(a, &self.f, |b, x_ab, f| {
            if p.is_fluid(b) {
                let v_ab = p.v[a] - p.v[b];
                total -= 2.0 * nu * f * v_ab;
                linear += f * uneven.dot(x_ab) * v_ab;
                let approach = v_ab.dot(x_ab);
                if approach < 0.0 {
                    total -= (numerical * f * approach / x_ab.norm_squared()) * x_ab;
                }
            } else if sticks && nu > 0.0 {
                let drag = self.drag(p, a, b, x_ab, f);
                total += nu * drag;
                linear -= 0.5 * uneven.dot(known_along(x_ab, self.normals[b])) * drag;
            }
        });
        let known = self.at[a].place == Place::Inside && (sticks || self.at[a].off_walls == Vector::ZERO);
        if known { total - 2.0 * nu * linear } else { total }
    }

    /// `D u` at `a`, 1/s.
    fn divergence(&self, u: &[Vector<D>], a: usize) -> f64 {
        let mut total = 0.0;
        let u_a = u[a];
        self.near.for_each_with(a, &self.f, |b, x_ab, f| total -= f * (u[b] - u_a).dot(x_ab));
        total
    }

    /// `D u` at `a` with the corrected gradient, 1/s: zero for any linear field without divergence, however neighbours are strained.
    fn corrected_divergence(&self, u: &[Vector<D>], a: usize) -> f64 {
        let (mut total, u_a, correction) = (0.0, u[a], &self.at[a].correction);
        self.near.for_each_with(a, &self.f, |b, x_ab, f| total -= f * (u[b] - u_a).dot(transform(correction, x_ab)));
        total * self.lattice.slope_of_linear::<D>()
    }

    /// What the projections are to remove of `D v` at `a`, 1/s. Where a free surface touches a wall, an expansion is held together with
    /// no more than gravity: a wall has no suction on what the air can reach, and a jet that passes its end must not be drawn around it.
    fn divergence_to_remove(&self, a: usize, dt: f64) -> f64 {
        let at = &self.at[a];
        let surrounded = at.place == Place::Inside && at.off_walls == Vector::ZERO;
        let mut divergence = if surrounded { self.corrected_divergence(&self.v, a) } else { self.divergence(&self.v, a) };
        if at.place == Place::Surface && at.off_walls != Vector::ZERO {
            // Gravity, or what makes the same greatest speed where there is none.
            let pull = 0.25 * self.medium.speed * self.medium.speed / self.medium.depth;
            divergence = divergence.min(pull * dt * at.off_walls.norm());
        }
        at.resisted(divergence, dt)
    }

    /// `G q` at `a`, for `q` that is zero on walls: the negative adjoint of [`divergence`](Self::divergence) with resting walls.
    fn adjoint_gradient(&self, q: &[f64], a: usize) -> Vector<D> {
        let mut total = Vector::ZERO;
        let q_a = q[a];
        self.near.for_each_with(a, &self.f, |b, x_ab, f| total -= f * (q_a + q[b]) * x_ab);
        total
    }

    /// The compact pressure equation; rows of all but fluid are identities.
    fn assemble(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let owned = p.owned();
        let (lattice, at) = (&self.lattice, &self.at);
        self.pull.resize(owned, 0.0);
        sweep(&mut self.pull, |a| if p.is_fluid(a) { at[a].surface_pull(lattice) } else { 0.0 });
        self.fill_matrix(p, domain);
    }

    fn fill_matrix(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let owned = p.owned();
        let (near, f, lattice, at, pull) = (&self.near, &self.f, &self.lattice, &self.at, &self.pull);
        self.matrix.assemble(owned, |a, row| {
            if !p.is_fluid(a) {
                row.push(a, 1.0);
                return;
            }
            let mut to_fluid = 0.0;
            near.for_each_with(a, f, |b, _, f| {
                if p.is_fluid(b) {
                    to_fluid += 2.0 * f;
                    row.push(domain.parent(b, owned), -2.0 * f);
                }
            });
            // A particle held by next to nothing gets a row that is not nothing: 2 % of the lattice's, all of it if it is alone.
            let least = if at[a].links < 1e-6 * lattice.diagonal { 1.0 } else { 0.02 };
            row.push(a, (to_fluid + pull[a]).max(least * lattice.diagonal));
        });
    }

    /// What uneven neighbours make of a linear pressure in the compact equation although its Laplacian is zero, `−2 ∇p·(Σ V∇W)`, with the
    /// gradient of the step before, Pa/m²: on its right side it makes the equation exact for linear pressure. The part of the slope
    /// that is the surface's doing stands in the row's pull.
    fn unevenness(&self, a: usize) -> f64 {
        if self.settings.free_surface == FreeSurface::None {
            return 0.0;
        }
        let at = &self.at[a];
        // Drops and surface rows: the slope is the surface's.
        let slope = match at.place {
            Place::Inside => at.slope,
            Place::Near if at.inwards != Vector::ZERO => across(at.slope, at.inwards),
            Place::Near | Place::Surface => return 0.0,
        };
        -2.0 * self.rise[a].dot(slope)
    }

    /// `∂_i v_j ∂_j v_i` inside and off walls, 1/s²: minus the rate at which the divergence of a velocity falls that moves with the fluid.
    fn bending(&self, p: &Particles<D>, a: usize) -> f64 {
        let at = &self.at[a];
        if !p.is_fluid(a) || at.off_walls != Vector::ZERO {
            return 0.0;
        }
        let mut gradient = [Vector::<D>::ZERO; D];
        self.near.for_each_with(a, &self.f, |b, x_ab, f| {
            let along = f * transform(&at.correction, x_ab);
            for (row, v) in gradient.iter_mut().zip((p.v[a] - p.v[b]).0) {
                *row += v * along;
            }
        });
        let mut total = 0.0;
        for i in 0..D {
            for j in 0..D {
                total += gradient[i][j] * gradient[j][i];
            }
        }
        total * self.lattice.slope_of_linear::<D>()
    }

    /// Solves the compact equation for the divergence of `self.v`; the result is in `self.solution`. `answered`: the wall rows of
    /// `self.v` hold what gravity and their acceleration made of them, and their pressure answers to it.
    fn solve(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64, answered: Answer) -> Result<SolveReport, StepError> {
        domain.refresh_column(&mut self.v);
        let rest = self.medium.rest_density;
        let mut source = std::mem::take(&mut self.source);
        source.resize(p.owned(), 0.0);
        sweep(&mut source, |a| {
            if !p.is_fluid(a) || self.near.of(a).is_empty() {
                return 0.0;
            }
            let mut walls = 0.0;
            if answered == Answer::Full && self.at[a].off_walls != Vector::ZERO {
                self.near.for_each_with(a, &self.f, |b, x_ab, f| {
                    if !p.is_fluid(b) {
                        walls -= 2.0 * f * rest * self.answer[b].dot(x_ab);
                    }
                });
            }
            let ahead = if self.bending.is_empty() { 0.0 } else { self.bending[a] };
            let uneven = if answered == Answer::Full { self.unevenness(a) } else { 0.0 };
            walls + uneven - rest / dt * (self.divergence_to_remove(a, dt) - 0.5 * dt * ahead)
        });
        self.source = source;
        let owned = p.owned();
        let whole_is_closed = !self.pull.iter().any(|&s| s > 0.0);
        self.closure.active = whole_is_closed || self.closure.parts;
        if self.closure.active {
            self.closure.find(&self.parts, &self.pull);
            self.closure.level(&mut self.source);
        }
        let solved = self.solver.solve(&self.matrix, &self.source, &mut self.solution[..owned]);
        let report = match solved {
            Ok(report) => report,
            // Rare: a part without surface beside one with a surface, which costs a search, or fluid so uneven that signed pulls
            // cost the matrix its sign. Without negative pulls it has one.
            Err(_) => {
                self.pull.iter_mut().for_each(|s| *s = s.max(0.0));
                self.fill_matrix(p, domain);
                if !whole_is_closed && self.closure.find(&self.parts, &self.pull) {
                    (self.closure.parts, self.closure.active) = (true, true);
                    self.closure.level(&mut self.source);
                }
                self.solution[..owned].fill(0.0);
                self.solver.solve(&self.matrix, &self.source, &mut self.solution[..owned])?
            }
        };
        if self.closure.active {
            self.closure.level(&mut self.solution[..owned]);
        }
        domain.refresh_column(&mut self.solution);
        Ok(report)
    }

    /// `∇p` at `a`, Pa/m: corrected differences, to walls along their normal only (a wall says nothing of the gradient along it: a
    /// drop that slides down feels its weight). Nothing pushes particles apart: positions are kept in order by moving them.
    fn pressure_gradient(&self, p: &Particles<D>, answered: Answer, a: usize) -> Vector<D> {
        let (rest, pressure) = (self.medium.rest_density, &self.solution);
        let mut differences = Vector::ZERO;
        self.near.for_each_with(a, &self.f, |b, x_ab, f| {
            if p.is_fluid(b) {
                differences -= f * (pressure[b] - pressure[a]) * x_ab;
            } else if answered == Answer::Full {
                let along = known_along(x_ab, self.normals[b]);
                differences += f * rest * self.answer[b].dot(along) * along;
            }
        });
        transform(&self.at[a].correction, differences)
    }

    /// A few iterations of `−D G q = source` and then `G q`, in `q` and `self.gradient`.
    fn exact_projection(&mut self, p: &Particles<D>, domain: &Domain<D>, iterations: usize, q: &mut Vec<f64>) {
        let owned = p.owned();
        let mut work = std::mem::take(&mut self.work);
        let mut gradient = std::mem::take(&mut self.gradient);
        let mut with_ghosts = std::mem::take(&mut self.with_ghosts);
        let mut closure = std::mem::take(&mut self.closure);
        q.resize(owned, 0.0);
        with_ghosts.resize(p.len(), 0.0);
        gradient.resize(p.len(), Vector::ZERO);
        let this = &*self;
        let mut apply_gradient = |q: &[f64], gradient: &mut Vec<Vector<D>>| {
            with_ghosts[..owned].copy_from_slice(q);
            domain.refresh_column(&mut with_ghosts);
            let q = &with_ghosts;
            sweep(&mut gradient[..owned], |a| if p.is_fluid(a) { this.adjoint_gradient(q, a) } else { Vector::ZERO });
            domain.refresh_column(gradient);
        };
        projection::iterate(
            |q, aq| {
                apply_gradient(q, &mut gradient);
                sweep(aq, |a| if p.is_fluid(a) { -this.divergence(&gradient, a) } else { 0.0 });
            },
            // A constant potential means nothing where there is no surface, but its gradient is that of the packing, and would take
            // the velocity that made it for divergence.
            |column| {
                if closure.active {
                    closure.level(column);
                }
            },
            &this.exact_diagonal,
            &this.source,
            q,
            // Truncated on purpose: a twentieth is what the iterations reach that are worth their time.
            (0.05, iterations),
            &mut work,
        );
        apply_gradient(q, &mut gradient);
        (self.work, self.gradient, self.with_ghosts, self.closure) = (work, gradient, with_ghosts, closure);
    }

    /// `|Σ V ∇W|² + Σ f² r²` over fluid: the diagonal of `−D G`.
    fn exact_diagonal(&mut self, p: &Particles<D>) {
        let mut diagonal = std::mem::take(&mut self.exact_diagonal);
        diagonal.resize(p.owned(), 1.0);
        let floor = 1e-6 / (self.medium.spacing * self.medium.spacing);
        sweep(&mut diagonal, |a| {
            if !p.is_fluid(a) {
                return 1.0;
            }
            let mut total = self.at[a].slope.norm_squared();
            self.near.for_each_with(a, &self.f, |b, x_ab, f| {
                if p.is_fluid(b) {
                    total += f * f * x_ab.norm_squared();
                }
            });
            total.max(floor)
        });
        self.exact_diagonal = diagonal;
    }

    /// (4): a few iterations of the exact projection on the velocity.
    fn clean(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        self.exact_diagonal(p);
        domain.refresh_column(&mut self.v);
        if self.settings.velocity_iterations > 0 {
            let mut source = std::mem::take(&mut self.source);
            sweep(&mut source, |a| if p.is_fluid(a) { -self.divergence_to_remove(a, dt) } else { 0.0 });
            self.source = source;
            let mut q = std::mem::take(&mut self.cleaning);
            self.exact_projection(p, domain, self.settings.velocity_iterations, &mut q);
            self.cleaning = q;
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                self.v[a] -= self.gradient[a];
            }
            domain.refresh_column(&mut self.v);
        }
    }

    /// (5): shifting, and the displacement that brings back the density the step will have lost; in `self.shift`.
    fn rearrange(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        let mut shift = std::mem::take(&mut self.shift);
        shift.resize(p.len(), Vector::ZERO);
        sweep(&mut shift[..owned], |a| if p.is_fluid(a) { self.shifting(a, dt) } else { Vector::ZERO });
        domain.refresh_column(&mut shift);
        self.shift = shift;
        if self.settings.density_iterations == 0 {
            return;
        }
        let mut source = std::mem::take(&mut self.source);
        sweep(&mut source, |a| {
            if !p.is_fluid(a) {
                return 0.0;
            }
            let at = &self.at[a];
            let crowded = at.density_error() >= 0.0 && at.place != Place::Inside;
            let error = if crowded { at.filling - 1.0 } else { at.density_error() };
            let source = 0.5 * error * self.lattice.sum_w - dt * self.divergence(&self.v, a) - self.divergence(&self.shift, a);
            if crowded { source.max(0.0) } else { source }
        });
        self.source = source;
        let mut q = std::mem::take(&mut self.packing);
        self.exact_projection(p, domain, self.settings.density_iterations, &mut q);
        self.packing = q;
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            self.shift[a] -= capped(self.gradient[a], 0.1 * self.medium.spacing);
        }
    }

    /// Shifting towards even spacing, m (Skillen et al. 2013), at most a tenth of a spacing: none on the surface, along it near it.
    fn shifting(&self, a: usize, dt: f64) -> Vector<D> {
        let at = &self.at[a];
        if at.place == Place::Surface {
            return Vector::ZERO;
        }
        let h = self.near.h(a);
        // Without a surface the greatest speed of all: where flow stagnates, it strains the packing most.
        let speed = match self.settings.free_surface {
            FreeSurface::Tracked => self.v[a].norm(),
            FreeSurface::None => self.fastest,
        };
        let strength = (self.settings.shifting * h * speed * dt).min(0.5 * h * h);
        let mut shift = -strength * at.crowding;
        if at.place == Place::Near {
            shift = across(shift, at.slope);
        }
        capped(shift, 0.1 * self.medium.spacing)
    }

    /// `δx·∇v` at `a` with the corrected gradient, m/s.
    fn convected(&self, p: &Particles<D>, a: usize) -> Vector<D> {
        let mut total = Vector::ZERO;
        if self.at[a].place != Place::Surface {
            self.near.for_each_with(a, &self.f, |b, x_ab, f| {
                if p.is_fluid(b) {
                    let along = transform(&self.at[a].correction, x_ab).dot(self.shift[a]);
                    total -= f * along * (self.v[b] - self.v[a]);
                }
            });
        }
        total
    }
}

/// Whether the pressure of walls answers to gravity and their acceleration: in the first pressure solve of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Answer {
    Full,
    None,
}

/// `v`, shortened to length `most`.
fn capped<const D: usize>(v: Vector<D>, most: f64) -> Vector<D> {
    let length = v.norm();
    if length > most { (most / length) * v } else { v }
}

impl<K: Kernel<D>, const D: usize> Scheme<D> for Isph<K, D> {
    /// Density, surface and pressure of the initial state: the pressure that the first step will find.
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        self.flow.dt_before = None;
        self.flow.lattice = Lattice::of(self.kernel, p.h_max(), self.flow.medium.spacing, self.flow.medium.rest_density);
        self.look_around(p, domain)?;
        self.flow.start(p, domain)
    }

    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        self.flow.time_step(p)
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        phases.measure("search", || self.look_around(p, domain))?;
        self.flow.step(p, domain, dt, phases)
    }
}

impl<const D: usize> Flow<D> {
    /// Pressure, walls and accelerations of the initial state.
    fn start(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        let dt = self.time_step(p).dt;
        self.predict(p, dt);
        self.assemble(p, domain);
        self.press(p, domain, dt)?;
        let owned = p.owned();
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.acceleration[a] = (self.v[a] - p.v[a]) / dt;
        }
        domain.refresh_column(&mut p.acceleration);
        p.pressure.clone_from(&self.pressure);
        self.wall_pressures(p);
        Ok(())
    }

    /// `C h/max(|v|, sqrt(g H))`, and bounds from viscosity and moving walls; from step to step it grows by a fifth at most and at
    /// most halves: what is left of the divergence makes a pressure that goes as one over the step.
    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let (h, c) = (p.h_min(), self.medium.courant);
        let nu = self.medium.viscosity / self.medium.rest_density;
        let pushed = largest(p.owned(), |a| if p.is_fluid(a) { 0.0 } else { p.acceleration[a].norm_squared() }).max(0.0).sqrt();
        let limit = StepLimit::new(c * h / self.speed(p), "flow")
            .min(StepLimit::new(0.5 * c * h * h / nu, "viscosity"))
            .min(StepLimit::new(c * (h / pushed).sqrt(), "walls"));
        match self.dt_before {
            // Nothing moves and nothing pushes: any step will do, and the one before most of all.
            before if limit.dt == f64::INFINITY => StepLimit::new(before.unwrap_or(c * h), "rest"),
            Some(before) if limit.dt > 1.2 * before => StepLimit::new(1.2 * before, "growth"),
            Some(before) if limit.dt < 0.5 * before => StepLimit::new(0.5 * before, "shrinkage"),
            _ => limit,
        }
    }

    /// A step, once the sums over neighbours are there.
    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        let owned = p.owned();
        // Velocities stand half a step before positions.
        let kick = 0.5 * (self.dt_before.unwrap_or(0.0) + dt);

        // (1) v* = v + Δt (g + viscosity), walls v + Δt (g − a)
        phases.measure("prediction", || self.predict(p, kick));

        // (2) compact pressure equation, (3) v = v* − (Δt/ρ) ∇p; further passes take up what is left of the divergence
        phases.measure("assembly", || self.assemble(p, domain));
        let report = phases.measure("pressure", || self.press(p, domain, kick))?;

        // (4) clean the velocity by a few iterations of the exact projection
        phases.measure("clean-up", || self.clean(p, domain, kick));

        // (5) even spacing, and the density kept by moving particles
        phases.measure("positions", || self.rearrange(p, domain, dt));

        // (6) x += Δt v + δx, v += δx·∇v; nothing passes a wall
        phases.measure("motion", || {
            let mut moved = std::mem::take(&mut self.moved);
            moved.resize(owned, Guarded::default());
            sweep(&mut moved, |a| if p.is_fluid(a) { self.guarded(p, a, dt) } else { Guarded::default() });
            let (medium, at) = ((self.medium.gravity, self.medium.spacing), &self.at);
            self.parts.keep_momentum(p, domain, |a| at[a].off_walls != Vector::ZERO, medium, (dt, kick), &mut moved);
            self.moved = moved;
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.acceleration[a] = (self.moved[a].v - p.v[a]) / kick;
                p.v[a] = self.moved[a].v;
            }
            p.pressure.clone_from(&self.pressure);
            self.wall_pressures(p);
            self.wall_forces(p, domain, kick);
            for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
                p.x[a] = self.moved[a].x;
            }
        });
        self.dt_before = Some(dt);
        Ok(report)
    }

    /// (1): the velocity without pressure, in `self.v`; friction of walls in `p.force`.
    fn predict(&mut self, p: &mut Particles<D>, dt: f64) {
        let (owned, speed) = (p.owned(), self.speed(p));
        self.fastest = speed;
        let mut v = std::mem::take(&mut self.v);
        v.resize(p.len(), Vector::ZERO);
        let this = &*self;
        sweep(&mut v[..owned], |a| match p.kind[a] {
            Kind::Fluid => p.v[a] + dt * (this.medium.gravity + this.viscosity(p, a, speed)),
            Kind::Wall => p.v[a] + dt * this.answer[a],
            Kind::Lost => Vector::ZERO,
        });
        let nu = self.diffusivity();
        let sticks = nu > 0.0 && self.settings.wall_friction == WallFriction::NoSlip;
        let mut force = std::mem::take(&mut p.force);
        sweep(&mut force[..owned], |a| {
            let mut total = Vector::ZERO;
            if sticks && p.kind[a] == Kind::Wall {
                this.near.for_each_with(a, &this.f, |b, x_ab, f| {
                    if p.is_fluid(b) {
                        total -= nu * p.mass[b] * this.drag(p, b, a, -x_ab, f);
                    }
                });
            }
            total
        });
        p.force = force;
        self.v = v;
    }

    /// (2) and (3): pressure and velocity, in `self.pressure` and `self.v`.
    fn press(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) -> Result<StepReport, StepError> {
        let (owned, rest) = (p.owned(), self.medium.rest_density);
        self.solution.resize(p.len(), 0.0);
        self.rise.resize(owned, Vector::ZERO);
        self.pressure.clear();
        self.pressure.resize(p.len(), 0.0);
        if self.settings.free_surface == FreeSurface::None {
            let mut bending = std::mem::take(&mut self.bending);
            bending.resize(owned, 0.0);
            sweep(&mut bending, |a| self.bending(p, a));
            self.bending = bending;
        }
        let (mut iterations, mut residual) = (0, 0.0f64);
        for pass in 0..self.settings.pressure_passes {
            let answered = if pass == 0 { Answer::Full } else { Answer::None };
            sweep(&mut self.solution[..owned], |a| if pass == 0 && p.is_fluid(a) { p.pressure[a] } else { 0.0 });
            let solved = self.solve(p, domain, dt, answered)?;
            iterations += solved.iterations;
            residual = residual.max(solved.residual);
            let mut next = std::mem::take(&mut self.v_next);
            next.resize(p.len(), Vector::ZERO);
            sweep(&mut next[..owned], |a| match p.kind[a] {
                Kind::Fluid => self.v[a] - (dt / rest) * self.pressure_gradient(p, answered, a),
                Kind::Wall => p.v[a],
                Kind::Lost => Vector::ZERO,
            });
            let mut rise = std::mem::take(&mut self.rise);
            update(&mut rise, |a, rise| {
                let before = if pass == 0 { Vector::ZERO } else { *rise };
                if p.is_fluid(a) {
                    *rise = before + (rest / dt) * (self.v[a] - next[a]);
                }
            });
            self.rise = rise;
            self.v_next = std::mem::replace(&mut self.v, next);
            for (total, part) in self.pressure.iter_mut().zip(&self.solution) {
                *total += part;
            }
        }
        domain.refresh_column(&mut self.v);
        Ok(StepReport {
            iterations: Some(iterations),
            residual: Some(residual),
            listed_pairs: Some(self.near.pairs()),
            ..StepReport::default()
        })
    }
}
