//! Incompressible SPH that is smooth and robust at once: a compact pressure equation drives the flow, a truncated exact
//! projection cleans the velocity, and a projection of positions keeps the density.

mod closure;
mod exact;
mod numbering;
mod parts;
mod settings;
mod walls;

use self::closure::Closure;
use self::exact::Exact;
use self::numbering::Numbering;
use self::parts::Parts;
use self::walls::Guarded;
use super::before::Before;
use super::{Medium, Scheme, StepError, StepReport};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::lanes::{Lanes, Record, sweep_lanes};
use crate::math::{Matrix, Vector, transform};
use crate::neighbors::{BehindWalls, Neighbors, PairColumn, RowsOfPairs};
use crate::particles::{Kind, Particles};
use crate::physics::arrangement::{Arrangement, Place, across, known_along};
use crate::physics::damping::Damping;
use crate::physics::lattice::Lattice;
use crate::physics::pairs::{Pairs, Sense};
use crate::poisson::{Arms, CsrMatrix, LinearSolver, Sliced, SolveError, SolveReport};
use crate::reduce::norm;
use crate::sweep::{sweep, sweep2, update, update2};
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
    /// `f` of each pair, 1/m², as precise as the matrix that is made of it; once that is there, of pairs with walls at the least.
    f: PairColumn<f32>,
    /// Velocities of fluid and normals of walls.
    sense: Sense,
    at: Vec<Arrangement<D>>,
    places: Vec<Place>,
    numbering: Numbering,
    solver: LinearSolver,
    /// The pressure matrix, with arms `f x_ab`; its rows again for solvers that do not take it.
    sliced: Sliced,
    arms: Arms<D>,
    matrix: CsrMatrix,
    exact: Exact<D>,
    /// `s` of each unknown, 1/m².
    pull: Vec<f64>,
    parts: Parts<D>,
    closure: Closure,
    /// Pressure gradient of the step before, Pa/m.
    rise: Vec<Vector<D>>,
    /// See [`bending`](Self::bending); empty where a surface is tracked.
    bending: Vec<f64>,
    /// Right side of an equation and its solution, by unknown.
    source: Vec<f64>,
    unknowns: Vec<f64>,
    /// A vector field by unknown (behind a step the pushes on walls, by row), and `T` of the velocity; see [`look_at_velocity`](Self::look_at_velocity).
    by_unknown: Vec<[f64; D]>,
    strain: Vec<Matrix<D>>,
    /// Norm of the right side of the first pressure solve of a step.
    first_source: f64,
    /// Pressure; behind a step that before it.
    pressure: Vec<f64>,
    /// Potential of the clean-up, m²/s.
    cleaning: Vec<f32>,
    /// Velocity; before it is predicted what is to be damped of it, 1/(m s), see [`Damping`].
    v: Vec<Vector<D>>,
    /// The shift, m; behind a step the accelerations before it.
    shift: Vec<Vector<D>>,
    /// Where particles go; behind a step where they came from.
    moved: Vec<Guarded<D>>,
    before: Before<D>,
    /// Densities before the step, kg/m³.
    densities: Vec<f64>,
    /// Unit normal of each wall particle, towards the fluid, deeper lines that of the first one in front of them.
    normals: Vec<Vector<D>>,
    first_line: Vec<u32>,
    dt_before: Option<f64>,
    /// Share of the push of the last step that its start has seen.
    since_kick: f64,
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
            sense: Sense::default(),
            at: Vec::new(),
            places: Vec::new(),
            numbering: Numbering::default(),
            sliced: Sliced::default(),
            arms: Arms::default(),
            matrix: CsrMatrix::new(),
            exact: Exact::default(),
            pull: Vec::new(),
            parts: Parts::default(),
            closure: Closure::default(),
            rise: Vec::new(),
            bending: Vec::new(),
            source: Vec::new(),
            unknowns: Vec::new(),
            by_unknown: Vec::new(),
            strain: Vec::new(),
            first_source: 0.0,
            pressure: Vec::new(),
            cleaning: Vec::new(),
            v: Vec::new(),
            shift: Vec::new(),
            moved: Vec::new(),
            before: Before::default(),
            densities: Vec::new(),
            normals: Vec::new(),
            first_line: Vec::new(),
            dt_before: None,
            since_kick: 0.0,
            fastest: 0.0,
        };
        Ok(Self { kernel, flow })
    }

    /// Ghosts, pairs, `f` of each pair, and what they say about each particle.
    fn look_around(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        domain.refresh(p, self.kernel.radius() * p.h_max());
        // Records are made anew after the search.
        let Flow { near, sense, settings, .. } = &mut self.flow;
        near.list(p, self.kernel.radius(), settings.search, BehindWalls::Everyone, &mut sense.records)?;
        let (kernel, rest, owned) = (self.kernel, self.flow.medium.rest_density, p.owned());
        let flow = &mut self.flow;
        if flow.walls_turn(p) {
            flow.near.follow(p);
            let first = wall_normals(kernel, &flow.near, p);
            flow.look_at_walls(p, &first);
            flow.near.let_go();
        }
        flow.normals.resize(p.len(), Vector::ZERO);
        domain.refresh_column(&mut flow.normals);
        flow.at.resize(owned, Arrangement::alone());
        flow.places.resize(p.len(), Place::Inside);
        let normals = &flow.normals;
        flow.sense.fill(p, |a| if p.is_fluid(a) { p.v[a] } else { normals[a] }, |_| 0.0);
        let (near, lattice) = (&flow.near, &flow.lattice);
        let pairs = flow.sense.pairs(kernel, near);
        let set = pairs.set;
        let mut stretch = vec![[Vector::ZERO; D]; p.len() + 1];
        near.fill_rows(set, &mut flow.f, (&mut flow.at, &mut stretch[..owned]), &Looking { pairs, lattice, p });
        domain.refresh_column(&mut stretch[..p.len()]);
        flow.v.resize(p.len(), Vector::ZERO);
        if flow.lacking(p.h_max(), flow.medium.greatest_speed(p)) > 0.0 {
            // Of strength one: the viscosity is known later, with the speed.
            let damping = Damping { pairs, stretch: &stretch[..], scale: 1.0 / rest, strength: [0.0, -1.0], h: &p.h };
            sweep_lanes(set, &mut flow.v[..owned], &damping);
        } else {
            flow.v.fill(Vector::ZERO);
        }
        drop(stretch);
        flow.parts.find(p, domain, &flow.near);
        let f = &flow.f;
        if flow.settings.free_surface == FreeSurface::None {
            flow.at.iter_mut().for_each(|at| at.place = Place::Inside);
        } else {
            let (at, places, parts) = (&mut flow.at, &mut flow.places, &mut flow.parts);
            parts.find_full(|a| at[a].place == Place::Surface, |a| p.surface[a] != 0);
            update(at, |a, at| {
                if parts.is_full(a) {
                    at.place = Place::Inside;
                }
            });
            sweep(&mut places[..owned], |a| at[a].place);
            domain.refresh_column(places);
            update(at, |a, at| {
                if p.is_fluid(a) && !parts.is_full(a) {
                    at.look_for_surface(lattice, (near, &p.x), f, places, a);
                }
            });
        }
        let at = &flow.at;
        sweep2(&mut p.density[..owned], &mut p.surface[..owned], |a| (rest * at[a].filling, u8::from(at[a].place == Place::Surface)));
        Ok(())
    }
}

/// What the arrangement of its neighbours says about each particle, and `f` of each pair.
struct Looking<'a, K, const D: usize> {
    pairs: Pairs<'a, K, D>,
    lattice: &'a Lattice,
    p: &'a Particles<D>,
}

impl<K: Kernel<D>, const D: usize> RowsOfPairs<Arrangement<D>, Matrix<D>> for Looking<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, f: &mut Vec<f32>) -> (Arrangement<D>, Matrix<D>) {
        let Self { pairs, lattice, p } = self;
        if p.is_fluid(a) {
            return Arrangement::of::<_, L>(pairs, lattice, (a, p.h[a]), Some(f));
        }
        let half_over_rest = 0.5 / lattice.rest_density;
        f.extend(pairs.near.of(a).iter().map(|&b| {
            let b = b as usize;
            let (r, h) = ((p.x[a] - p.x[b]).norm(), 0.5 * (p.h[a] + p.h[b]));
            (-half_over_rest * (p.mass[a] + p.mass[b]) * pairs.kernel.dw_over_r(r, h)) as f32
        }));
        (Arrangement::alone(), [Vector::ZERO; D])
    }
}

impl<const D: usize> Flow<D> {
    /// The factor `ν` of sums `2ν Σ f (v_b − v_a)`, m²/s, for which they are exact for parabolic profiles on a lattice, whose `Σ f r²` is
    /// not quite `D`.
    fn diffusivity(&self) -> f64 {
        self.medium.viscosity / (self.medium.rest_density * self.lattice.slope_of_linear::<D>())
    }

    /// What the fluid's own viscosity leaves to be damped at the smoothing length `h` (m), m²/s: `dissipation · h U/8` with the speed `U`
    /// (m/s), less `ν`.
    fn lacking(&self, h: f64, speed: f64) -> f64 {
        (self.settings.dissipation * h * speed / 8.0 - self.medium.viscosity / self.medium.rest_density).max(0.0)
    }

    /// Viscosity, m/s²: that of the fluid, `2ν Σ f (v_b − v_a)` (Morris, Fox & Zhu 1997) over `Σ f r²/D`, of the particle inside and off walls and of
    /// the lattice elsewhere, inside less what uneven neighbours make of a linear velocity, `2ν (∇v)·(Σ V∇W)`; and the dissipation between approaching
    /// particles, `2(D+2) ν` times `damping` with `ν` what the fluid [lacks](Self::lacking).
    fn viscosity(&self, p: &Particles<D>, a: usize, damping: Vector<D>, speed: f64) -> Vector<D> {
        let at = &self.at[a];
        let surrounded = at.place == Place::Inside && at.off_walls == Vector::ZERO;
        // `Σ f r²` of this particle, where there is no lattice any more.
        let nu = self.diffusivity() / if surrounded { at.spread } else { 1.0 };
        let numerical = 2.0 * (D as f64 + 2.0) * self.lacking(p.h[a], speed);
        let sticks = self.settings.wall_friction == WallFriction::NoSlip;
        let mut total = numerical * damping;
        if nu == 0.0 {
            return total;
        }
        let (mut linear, uneven) = (Vector::ZERO, transform(&at.correction, at.slope));
        self.near.for_each_at(&p.x, a, &self.f, |b, x_ab, f| {
            if p.is_fluid(b) {
                let v_ab = p.v[a] - p.v[b];
                total -= 2.0 * nu * f * v_ab;
                linear += f * uneven.dot(x_ab) * v_ab;
            } else if sticks {
                let drag = self.drag(p, a, b, x_ab, f);
                total += nu * drag;
                linear -= 0.5 * uneven.dot(known_along(x_ab, self.normals[b])) * drag;
            }
        });
        let known = surrounded || (sticks && at.place == Place::Inside);
        if known { total - 2.0 * nu * linear } else { total }
    }

    /// `T = Σ_fluid (v_b − v_a) ⊗ f x_ab` of each unknown, of which all derivatives of the velocity are made; in `self.strain`.
    fn look_at_velocity(&mut self, domain: &Domain<D>) {
        domain.refresh_column(&mut self.v);
        let (numbering, v) = (&self.numbering, &self.v);
        self.by_unknown.resize(numbering.len(), [0.0; D]);
        self.strain.resize(numbering.len(), [Vector::ZERO; D]);
        sweep(&mut self.by_unknown, |k| v[numbering.row(k)].0);
        self.sliced.strain(&self.arms, &self.by_unknown, &mut self.strain, |strain, of_velocity| *of_velocity = strain.map(Vector));
    }

    /// `D v` of unknown `k`, 1/s; [`strain`](Self::look_at_velocity) is that of `self.v`.
    fn divergence(&self, p: &Particles<D>, k: usize) -> f64 {
        let a = self.numbering.row(k);
        let mut total = -trace(&self.strain[k]);
        if self.at[a].off_walls != Vector::ZERO {
            let v_a = self.v[a];
            self.near.for_each_at(&p.x, a, &self.f, |b, x_ab, f| {
                if !p.is_fluid(b) {
                    total -= f * (self.v[b] - v_a).dot(x_ab);
                }
            });
        }
        total
    }

    /// `D v` of unknown `k` off walls with the corrected gradient, 1/s: zero for any linear field without divergence, however neighbours
    /// are strained.
    fn corrected_divergence(&self, k: usize) -> f64 {
        let (strain, correction) = (&self.strain[k], &self.at[self.numbering.row(k)].correction);
        let mut total = 0.0;
        for i in 0..D {
            for j in 0..D {
                total -= correction[i][j] * strain[i][j];
            }
        }
        total * self.lattice.slope_of_linear::<D>()
    }

    /// What the projections are to remove of `D v` of unknown `k`, 1/s. Where a free surface touches a wall, an expansion is held together with
    /// no more than [gravity](Self::hold): a wall has no suction on what the air can reach, and a jet that passes its end must not be drawn around it.
    fn divergence_to_remove(&self, p: &Particles<D>, k: usize, dt: f64) -> f64 {
        let at = &self.at[self.numbering.row(k)];
        let surrounded = at.place == Place::Inside && at.off_walls == Vector::ZERO;
        let divergence = if surrounded { self.corrected_divergence(k) } else { self.divergence(p, k).min(self.hold(k, dt)) };
        at.resisted(divergence, dt)
    }

    /// The greatest expansion of unknown `k` that is resisted in a step, 1/s: on a free surface that touches a wall what gravity makes there, or what
    /// makes the same greatest speed where there is none.
    fn hold(&self, k: usize, dt: f64) -> f64 {
        let at = &self.at[self.numbering.row(k)];
        if at.place == Place::Surface && at.off_walls != Vector::ZERO {
            0.25 * self.medium.speed * self.medium.speed / self.medium.depth * dt * at.off_walls.norm()
        } else {
            f64::INFINITY
        }
    }

    /// The compact pressure equation, by unknown.
    fn assemble(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let fluid = p.count(Kind::Fluid);
        if self.numbering.len() != fluid || self.numbering.places.len() != p.owned() || self.solver.is_due(fluid) {
            self.numbering.renew(p, 2.0 * p.h_max());
            self.solver.forget();
        }
        if self.settings.free_surface == FreeSurface::None {
            let mut bending = std::mem::take(&mut self.bending);
            bending.resize(p.owned(), 0.0);
            sweep(&mut bending, |a| self.bending(p, a));
            self.bending = bending;
        }
        let (lattice, at, numbering) = (&self.lattice, &self.at, &self.numbering);
        self.pull.resize(fluid, 0.0);
        sweep(&mut self.pull, |k| at[numbering.row(k)].surface_pull(lattice));
        self.fill_matrix(p, domain);
    }

    /// The matrix takes the room of the pairs: it knows those of fluid, and from then on `near` and `f` are asked at walls alone.
    fn fill_matrix(&mut self, p: &Particles<D>, domain: &Domain<D>) {
        let (owned, unknowns) = (p.owned(), self.numbering.len());
        self.sliced.begin(unknowns, &mut self.arms);
        for rows in self.sliced.turns() {
            let (near, f, numbering) = (&self.near, &self.f, &self.numbering);
            let (at, pull, lattice) = (&self.at, &self.pull, &self.lattice);
            let (done, whole) = (rows.end, rows.end == unknowns);
            self.sliced.fill_rows(rows, &mut self.arms, |k, row| {
                let a = numbering.row(k);
                let mut to_fluid = 0.0;
                near.for_each_at(&p.x, a, f, |b, x_ab, f| {
                    if p.is_fluid(b) {
                        let weight = (2.0 * f) as f32;
                        to_fluid += f64::from(weight);
                        row.push(numbering.places[domain.parent(b, owned)] as usize, weight, x_ab.0.map(|x| (f * x) as f32));
                    }
                });
                diagonal(lattice, &at[a], to_fluid, pull[k])
            });
            let asked = |a: usize| !p.is_fluid(a) || at[a].off_walls != Vector::ZERO || numbering.places[a] as usize >= done;
            self.near.keep(&mut self.f, whole, asked);
        }
        self.fill_rows();
    }

    /// What the exact projection needs of the matrix, in the room of the records, which are made anew in the next step.
    fn prepare_exact(&mut self) {
        self.sense.records = Vec::new();
        let floor = 1e-6 / (self.medium.spacing * self.medium.spacing);
        let (at, numbering) = (&self.at, &self.numbering);
        self.exact.prepare(&self.arms, numbering.len(), floor, |k| at[numbering.row(k)].slope);
    }

    /// Lets go of how to take the step before back, and of what it knew of its flow: the search takes their room.
    fn let_go_of_step(&mut self) {
        (self.moved, self.shift) = (Vec::new(), Vec::new());
        (self.by_unknown, self.strain) = (Vec::new(), Vec::new());
    }

    /// Lets go of the matrix, once its work is done: the search of the next step takes its room.
    fn let_go_of_matrix(&mut self) {
        self.sliced.let_go(&mut self.arms);
        self.exact = Exact::default();
    }

    /// Signed pulls of the surface become positive ones, and with them the matrix.
    fn keep_positive(&mut self) {
        self.pull.iter_mut().for_each(|s| *s = s.max(0.0));
        let (at, pull, lattice, numbering) = (&self.at, &self.pull, &self.lattice, &self.numbering);
        self.sliced.replace_diagonal(|k, to_fluid| diagonal(lattice, &at[numbering.row(k)], to_fluid, pull[k]));
        self.fill_rows();
    }

    /// The matrix as rows, for a solver that does not take it in slices.
    fn fill_rows(&mut self) {
        if !self.solver.takes_sliced() {
            let sliced = &self.sliced;
            self.matrix.assemble(sliced.rows(), |k, row| {
                sliced.row(k).for_each(|(j, weight)| row.push(j as usize, -f64::from(weight)));
                row.push(k, sliced.diagonal(k));
            });
        }
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
        self.near.for_each_at(&p.x, a, &self.f, |b, x_ab, f| {
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

    /// Solves the compact equation for the divergence of `self.v`; the result is in `self.unknowns`. `answered`: the wall rows of
    /// `self.v` hold what gravity and their acceleration made of them, and their pressure answers to it.
    fn solve(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64, answered: Answer) -> Result<SolveReport, StepError> {
        self.look_at_velocity(domain);
        let rest = self.medium.rest_density;
        let mut source = std::mem::take(&mut self.source);
        source.resize(self.numbering.len(), 0.0);
        sweep(&mut source, |k| {
            let a = self.numbering.row(k);
            // Nobody is in reach.
            if self.at[a].links == 0.0 {
                return 0.0;
            }
            let mut walls = 0.0;
            if answered == Answer::Full && self.at[a].off_walls != Vector::ZERO {
                self.near.for_each_at(&p.x, a, &self.f, |b, x_ab, f| {
                    if !p.is_fluid(b) {
                        walls -= 2.0 * f * rest * self.answer(p, b).dot(x_ab);
                    }
                });
            }
            let ahead = if self.bending.is_empty() { 0.0 } else { self.bending[a] };
            let uneven = if answered == Answer::Full { self.unevenness(a) } else { 0.0 };
            walls + uneven - rest / dt * (self.divergence_to_remove(p, k, dt) - 0.5 * dt * ahead)
        });
        self.source = source;
        let whole_is_closed = !self.pull.iter().any(|&s| s > 0.0);
        self.closure.active = whole_is_closed || self.closure.parts;
        if self.closure.active {
            self.closure.find(&self.parts, &self.numbering, &self.pull);
            self.closure.level(&mut self.source);
        }
        // A further pass corrects the first one: what it may leave is measured by what that one had to do.
        self.first_source = if answered == Answer::Full { norm(&self.source) } else { self.first_source };
        if self.solver.is_due(self.numbering.len()) {
            // A new multigrid is built in the room of what is known anew after the solve.
            (self.by_unknown, self.strain) = (Vec::new(), Vec::new());
        }
        let report = match self.solve_as_asked() {
            Ok(report) => report,
            // Rare: a part without surface beside one with a surface, which costs a search, or fluid so uneven that signed pulls
            // cost the matrix its sign. Without negative pulls it has one.
            Err(_) => {
                self.keep_positive();
                self.solver.forget();
                if !whole_is_closed && self.closure.find(&self.parts, &self.numbering, &self.pull) {
                    (self.closure.parts, self.closure.active) = (true, true);
                    self.closure.level(&mut self.source);
                }
                self.unknowns.fill(0.0);
                self.solve_as_asked()?
            }
        };
        if self.closure.active {
            self.closure.level(&mut self.unknowns);
        }
        Ok(report)
    }

    fn solve_as_asked(&mut self) -> Result<SolveReport, SolveError> {
        if self.solver.takes_sliced() {
            // Sums over records are made.
            let room = Record::flat_mut(&mut self.sense.records);
            self.solver.solve_sliced(&self.sliced, &self.source, &mut self.unknowns, self.first_source, room)
        } else {
            self.solver.solve(&self.matrix, &self.source, &mut self.unknowns)
        }
    }

    /// `∇p` of each unknown, Pa/m, in `self.by_unknown`: corrected differences, to walls along their normal only (a wall says nothing of the
    /// gradient along it: a drop that slides down feels its weight). Nothing pushes particles apart: positions are kept in order by moving
    /// them.
    fn pressure_gradient(&mut self, p: &Particles<D>, answered: Answer) {
        let mut gradient = std::mem::take(&mut self.by_unknown);
        gradient.resize(self.numbering.len(), [0.0; D]);
        let this = &*self;
        this.sliced.rise(&this.arms, &this.unknowns, &mut gradient, |k, rise, gradient| {
            let a = this.numbering.row(k);
            let mut differences = -Vector(rise);
            if answered == Answer::Full && this.at[a].off_walls != Vector::ZERO {
                this.near.for_each_at(&p.x, a, &this.f, |b, x_ab, f| {
                    if !p.is_fluid(b) {
                        let along = known_along(x_ab, this.normals[b]);
                        differences += f * this.medium.rest_density * this.answer(p, b).dot(along) * along;
                    }
                });
            }
            *gradient = transform(&this.at[a].correction, differences).0;
        });
        self.by_unknown = gradient;
    }

    /// (4): a few iterations of the exact projection on the velocity.
    fn clean(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        self.look_at_velocity(domain);
        self.cleaning.resize(p.len(), 0.0);
        if self.settings.velocity_iterations == 0 {
            return;
        }
        let mut source = std::mem::take(&mut self.source);
        sweep(&mut source, |k| -self.divergence_to_remove(p, k, dt));
        let mut exact = std::mem::take(&mut self.exact);
        // What parts from a wall has no potential at all: were it only let go in part, drops close together, which see the same of each other, would be
        // asked for different divergences, and no moderate velocity has them.
        let held = |k| {
            let hold = self.hold(k, dt);
            hold == f64::INFINITY || self.divergence(p, k) <= hold
        };
        exact.hold(held);
        exact.project(&self.sliced, &self.arms, &source, &mut self.closure, self.settings.velocity_iterations);
        self.exact = exact;
        self.source = source;
        let (numbering, exact) = (&self.numbering, &self.exact);
        update(&mut self.v[..p.owned()], |a, v| {
            if let Some(k) = numbering.place(a) {
                *v -= exact.gradient(k);
            }
        });
        sweep(&mut self.cleaning[..p.owned()], |a| numbering.place(a).map_or(0.0, |k| exact.q[k]));
        domain.refresh_column(&mut self.cleaning);
        self.look_at_velocity(domain);
    }

    /// (5): shifting, and the displacement that brings back the density the step will have lost; in `self.shift`.
    fn rearrange(&mut self, p: &Particles<D>, dt: f64) {
        let owned = p.owned();
        let mut shift = vec![Vector::ZERO; owned];
        sweep(&mut shift, |a| if p.is_fluid(a) { self.shifting(p, a, dt) } else { Vector::ZERO });
        self.shift = shift;
        if self.settings.density_iterations == 0 {
            return;
        }
        let (numbering, shift) = (&self.numbering, &self.shift);
        sweep(&mut self.by_unknown, |k| shift[numbering.row(k)].0);
        // The pressure of the step is known, and its unknowns are free.
        let mut swelling = std::mem::take(&mut self.unknowns);
        self.sliced.strain(&self.arms, &self.by_unknown, &mut swelling, |strain, swelling| *swelling = trace(&strain.map(Vector)));
        let mut source = std::mem::take(&mut self.source);
        sweep(&mut source, |k| {
            let a = self.numbering.row(k);
            let at = &self.at[a];
            // Walls are not shifted.
            let by_shift = at.off_walls.dot(self.shift[a]) - swelling[k];
            let crowded = at.density_error() >= 0.0 && at.place != Place::Inside;
            let error = if crowded { at.filling - 1.0 } else { at.density_error() };
            let source = 0.5 * error * self.lattice.sum_w - dt * self.divergence(p, k) - by_shift;
            if crowded { source.max(0.0) } else { source }
        });
        self.exact.hold(|_| true);
        self.exact.project(&self.sliced, &self.arms, &source, &mut self.closure, self.settings.density_iterations);
        (self.source, self.unknowns) = (source, swelling);
        let (numbering, exact, most) = (&self.numbering, &self.exact, 0.1 * self.medium.spacing);
        update(&mut self.shift[..owned], |a, shift| {
            if let Some(k) = numbering.place(a) {
                *shift -= capped(exact.gradient(k), most);
            }
        });
    }

    /// Shifting towards even spacing, m (Skillen et al. 2013), at most a tenth of a spacing: none on the surface, along it near it.
    fn shifting(&self, p: &Particles<D>, a: usize, dt: f64) -> Vector<D> {
        let at = &self.at[a];
        if at.place == Place::Surface {
            return Vector::ZERO;
        }
        let h = p.h[a];
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

    /// `δx·∇v` at fluid particle `a` with the corrected gradient, m/s.
    fn convected(&self, a: usize) -> Vector<D> {
        let Some(k) = self.numbering.place(a).filter(|_| self.at[a].place != Place::Surface) else {
            return Vector::ZERO;
        };
        let (correction, shift, strain) = (&self.at[a].correction, self.shift[a], &self.strain[k]);
        let along = Vector(std::array::from_fn(|j| (0..D).map(|i| correction[i][j] * shift[i]).sum()));
        Vector(std::array::from_fn(|i| -strain[i].dot(along)))
    }
}

/// Diagonal of the compact equation, 1/m², from its links to fluid and the pull of the surface. A particle held by next to nothing gets a row that is
/// not nothing: 2 % of the lattice's, all of it if it is alone.
fn diagonal<const D: usize>(lattice: &Lattice, at: &Arrangement<D>, to_fluid: f64, pull: f64) -> f64 {
    let least = if at.links < 1e-6 * lattice.diagonal { 1.0 } else { 0.02 };
    (to_fluid + pull).max(least * lattice.diagonal)
}

/// `Σ_i m_ii`.
fn trace<const D: usize>(m: &Matrix<D>) -> f64 {
    (0..D).map(|i| m[i][i]).sum()
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
        if domain.is_brimful(p, self.flow.medium.spacing, self.flow.medium.rest_density) {
            // As `isph-shift` does, and for its reasons.
            (self.flow.settings.free_surface, self.flow.settings.velocity_iterations) = (FreeSurface::None, 0);
        }
        // Until it was looked at, fluid may have a surface anywhere.
        p.surface.fill(1);
        self.look_around(p, domain)?;
        self.flow.start(p, domain)
    }

    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        self.flow.time_step(p)
    }

    fn looks_back(&self) -> bool {
        true
    }

    fn look_back(&mut self, p: &mut Particles<D>) {
        let Flow { moved, since_kick, .. } = &mut self.flow;
        let (kind, since) = (&p.kind, *since_kick);
        update2(&mut p.x[..moved.len()], moved, |_, x, moved| std::mem::swap(x, &mut moved.x));
        update2(&mut p.v[..moved.len()], moved, |a, v, moved| {
            let next = std::mem::replace(v, moved.v);
            if kind[a] == Kind::Fluid {
                *v += since * (next - moved.v);
            }
            moved.v = next;
        });
    }

    fn look_ahead(&mut self, p: &mut Particles<D>) {
        let moved = &mut self.flow.moved;
        update2(&mut p.x[..moved.len()], moved, |_, x, moved| std::mem::swap(x, &mut moved.x));
        sweep(&mut p.v[..moved.len()], |a| moved[a].v);
    }

    fn takes_back(&self) -> bool {
        true
    }

    fn take_back(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        self.flow.take_back(p, domain);
    }

    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        self.flow.before.read(p, domain);
        self.flow.let_go_of_step();
        self.flow.densities.clear();
        self.flow.densities.extend_from_slice(&p.density[..p.owned()]);
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
        self.let_go_of_matrix();
        Ok(())
    }

    /// `C h/max(|v|, sqrt(g H))`, and bounds from viscosity and moving walls; from step to step it grows by a fifth at most and at
    /// most halves: what is left of the divergence makes a pressure that goes as one over the step.
    fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let h = p.h_min();
        self.medium.flow_limit(p, h).min(self.medium.wall_limit(p, h)).after(self.dt_before, self.medium.courant * h)
    }

    /// A step, once the sums over neighbours are there.
    fn step(&mut self, p: &mut Particles<D>, domain: &mut Domain<D>, dt: f64, phases: &mut Phases) -> Result<StepReport, StepError> {
        let owned = p.owned();
        // Velocities stand half a step before positions.
        let since = 0.5 * self.dt_before.unwrap_or(0.0);
        let kick = since + 0.5 * dt;

        // (1) v* = v + Δt (g + viscosity), walls v + Δt (g − a)
        phases.measure("prediction", || self.predict(p, kick));

        // (2) compact pressure equation, (3) v = v* − (Δt/ρ) ∇p; further passes take up what is left of the divergence
        phases.measure("assembly", || self.assemble(p, domain));
        let report = phases.measure("pressure", || self.press(p, domain, kick))?;

        // (4) clean the velocity by a few iterations of the exact projection
        phases.measure("clean-up", || {
            self.prepare_exact();
            self.clean(p, domain, kick);
        });

        // (5) even spacing, and the density kept by moving particles
        phases.measure("positions", || self.rearrange(p, dt));

        // (6) x += Δt v + δx, v += δx·∇v; nothing passes a wall
        phases.measure("motion", || {
            self.let_go_of_matrix();
            let mut moved = vec![Guarded::default(); owned];
            sweep(&mut moved, |a| if p.is_fluid(a) { self.guarded(p, a, dt) } else { Guarded::at(p.x[a], p.v[a]) });
            let (medium, at) = ((self.medium.gravity, self.medium.spacing), &self.at);
            self.parts.keep_momentum(p, domain, |a| at[a].off_walls != Vector::ZERO, medium, (dt, kick), &mut moved);
            let (v, kind) = (&p.v, &p.kind);
            update2(&mut p.acceleration[..owned], &mut self.shift, |a, acceleration, before| {
                *before = *acceleration;
                if kind[a] == Kind::Fluid {
                    *acceleration = (moved[a].v - v[a]) / kick;
                }
            });
            update2(&mut p.v[..owned], &mut moved, |_, v, moved| std::mem::swap(v, &mut moved.v));
            self.moved = moved;
            std::mem::swap(&mut p.pressure, &mut self.pressure);
            self.wall_pressures(p);
            self.wall_forces(p, domain, kick);
            update2(&mut p.x[..owned], &mut self.moved, |_, x, moved| std::mem::swap(x, &mut moved.x));
            self.before.settled = true;
        });
        self.dt_before = Some(dt);
        self.since_kick = since / kick;
        Ok(report)
    }

    /// Gives `p` the state before the step.
    fn take_back(&mut self, p: &mut Particles<D>, domain: &Domain<D>) {
        let owned = p.owned();
        if self.before.settled {
            for (a, moved) in self.moved.iter().enumerate() {
                (p.x[a], p.v[a]) = (moved.x, moved.v);
            }
            p.acceleration[..owned].copy_from_slice(&self.shift);
            p.pressure.copy_from_slice(&self.pressure);
        }
        p.density[..owned].copy_from_slice(&self.densities);
        self.before.give_back(p, domain);
    }

    /// (1): the velocity without pressure, in `self.v`; friction of walls in `p.force`.
    fn predict(&mut self, p: &mut Particles<D>, dt: f64) {
        let (owned, speed) = (p.owned(), self.medium.greatest_speed(p));
        self.fastest = speed;
        let mut v = std::mem::take(&mut self.v);
        let this = &*self;
        update(&mut v[..owned], |a, v| {
            *v = match p.kind[a] {
                Kind::Fluid => p.v[a] + dt * (this.medium.gravity + this.viscosity(p, a, *v, speed)),
                Kind::Wall => p.v[a] + dt * this.answer(p, a),
                Kind::Lost => Vector::ZERO,
            }
        });
        let nu = self.diffusivity();
        let sticks = nu > 0.0 && self.settings.wall_friction == WallFriction::NoSlip;
        let mut force = std::mem::take(&mut p.force);
        sweep(&mut force[..owned], |a| {
            let mut total = Vector::ZERO;
            if sticks && p.kind[a] == Kind::Wall {
                this.near.for_each_at(&p.x, a, &this.f, |b, x_ab, f| {
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
        self.rise.resize(owned, Vector::ZERO);
        self.pressure.clear();
        self.pressure.resize(p.len(), 0.0);
        let (mut iterations, mut residual) = (0, 0.0f64);
        for pass in 0..self.settings.pressure_passes {
            let answered = if pass == 0 { Answer::Full } else { Answer::None };
            self.unknowns.resize(self.numbering.len(), 0.0);
            let numbering = &self.numbering;
            sweep(&mut self.unknowns, |k| if pass == 0 { p.pressure[numbering.row(k)] } else { 0.0 });
            let solved = self.solve(p, domain, dt, answered)?;
            iterations += solved.iterations;
            residual = residual.max(solved.residual);
            self.pressure_gradient(p, answered);
            let (numbering, gradient) = (&self.numbering, &self.by_unknown);
            update2(&mut self.v[..owned], &mut self.rise, |a, v, rise| match p.kind[a] {
                Kind::Fluid => {
                    let next = *v - (dt / rest) * numbering.place(a).map_or(Vector::ZERO, |k| Vector(gradient[k]));
                    let before = if pass == 0 { Vector::ZERO } else { *rise };
                    (*v, *rise) = (next, before + (rest / dt) * (*v - next));
                }
                Kind::Wall => *v = p.v[a],
                Kind::Lost => *v = Vector::ZERO,
            });
            let unknowns = &self.unknowns;
            update(&mut self.pressure[..owned], |a, total| *total += numbering.place(a).map_or(0.0, |k| unknowns[k]));
        }
        domain.refresh_column(&mut self.pressure);
        domain.refresh_column(&mut self.v);
        Ok(StepReport {
            iterations: Some(iterations),
            residual: Some(residual),
            listed_pairs: Some(self.near.pairs()),
            ..StepReport::default()
        })
    }
}
