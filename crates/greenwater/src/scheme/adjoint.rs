//! What the methods of exact projection share: the divergence of a set of particles, its adjoint gradient, and the pressure that
//! gives the velocity a divergence. `dfsph` and `iisph` are two ways to use it.

use super::{Medium, StepError};
use crate::domain::Domain;
use crate::kernel::Kernel;
use crate::lanes::{InstructionSet, Lanes, Record, Rows, sweep_lanes};
use crate::math::Vector;
use crate::neighbors::{NOBODY, Neighbors, PairColumn, Search};
use crate::particles::{Kind, Particles};
use crate::physics::arrangement::{Arrangement, Place};
use crate::physics::lattice::Lattice;
use crate::physics::pairs::{Pairs, record};
use crate::poisson::SolveReport;
use crate::poisson::projection::{self, Goal, Workspace};
use crate::reduce::sum;
use crate::sweep::{sweep, update};
use crate::time::StepLimit;
use crate::walls::guard::{Guarded, force_of_set_back, set_back};
use crate::walls::{first_line_parents, wall_normals};

/// What a pressure is to do to the divergence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Aim {
    /// `D v = 0` (Bender & Koschier 2017).
    DivergenceFree,
    /// The divergence that brings the filling back to one within the step (Ihmsen et al. 2014).
    ConstantDensity,
}

/// How hard fluids and walls rub, and what the solver is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choices {
    /// Share of `h U/8` that is the viscosity between approaching particles.
    pub dissipation: f64,
    /// Whether a viscous fluid sticks to walls.
    pub sticky: bool,
    /// What a pair of fluid and wall counts.
    pub wall_weight: f64,
    pub search: Search,
    pub tolerance: f64,
    pub max_iterations: usize,
}

/// All of an exact projection that needs no kernel, once its sums over neighbours are there.
///
/// With `f_ab = −(m_b/ρ0) W'/r`, scaled to give a linear field its slope on the lattice:
/// `D u = −Σ f (u_b − u_a)·x_ab` over fluid and walls, `G p = −Σ f (p_a + p_b) x_ab` with `p_b = 0` on walls, where `f` counts once or
/// twice (see [`WallPairs`](super::dfsph::WallPairs)). Then `Σ m (G p)·u = −Σ m p D u` for walls at rest, and `−D G`, its rows times the mass, is symmetric and positive. Forces of pairs
/// are opposite, those on walls too.
pub(super) struct Flow<const D: usize> {
    pub medium: Medium<D>,
    pub choices: Choices,
    /// Whether fluid and walls leave no place for a free surface.
    brimful: bool,
    lattice: Lattice,
    near: Neighbors<D>,
    f: PairColumn,
    /// One a particle, with the normals of walls in place of velocities, and nobody.
    records: Vec<Record>,
    at: Vec<Arrangement<D>>,
    places: Vec<Place>,
    normals: Vec<Vector<D>>,
    first_line: Vec<u32>,
    /// Diagonal of `−D G` and mass over that of a lattice particle.
    diagonal: Vec<f64>,
    weight: Vec<f64>,
    source: Vec<f64>,
    /// Rows without pressure in the present solve: see [`idle`](Self::idle).
    idle: Vec<bool>,
    with_ghosts: Vec<f64>,
    gradient: Vec<Vector<D>>,
    work: Workspace,
    /// Velocity on its way through the step, m/s.
    pub v: Vec<Vector<D>>,
    v_next: Vec<Vector<D>>,
    /// Force on walls in this step, N.
    force: Vec<Vector<D>>,
    /// Pressure of each row in this step, Pa.
    pub pressure: Vec<f64>,
    moved: Vec<Guarded<D>>,
    dt_before: Option<f64>,
}

/// What the arrangement of its neighbours says about each particle.
struct Looking<'a, K, const D: usize> {
    pairs: Pairs<'a, K, D>,
    lattice: &'a Lattice,
    p: &'a Particles<D>,
}

impl<K: Kernel<D>, const D: usize> Rows<Arrangement<D>> for Looking<'_, K, D> {
    #[inline(always)]
    fn row<L: Lanes>(&self, a: usize, at: &mut Arrangement<D>, _: &mut ()) {
        *at = if self.p.is_fluid(a) {
            Arrangement::of::<_, L>(&self.pairs, self.lattice, (a, self.p.h[a]), None).0
        } else {
            Arrangement::alone()
        };
    }
}

impl<const D: usize> Flow<D> {
    pub fn new<K: Kernel<D>>(kernel: K, medium: Medium<D>, choices: Choices) -> Self {
        Self {
            lattice: Lattice::of(kernel, medium.spacing, medium.spacing, medium.rest_density),
            medium,
            choices,
            brimful: false,
            near: Neighbors::new(),
            f: PairColumn::default(),
            records: Vec::new(),
            at: Vec::new(),
            places: Vec::new(),
            normals: Vec::new(),
            first_line: Vec::new(),
            diagonal: Vec::new(),
            weight: Vec::new(),
            source: Vec::new(),
            idle: Vec::new(),
            with_ghosts: Vec::new(),
            gradient: Vec::new(),
            work: Workspace::default(),
            v: Vec::new(),
            v_next: Vec::new(),
            force: Vec::new(),
            pressure: Vec::new(),
            moved: Vec::new(),
            dt_before: None,
        }
    }

    /// Lattice constants of the particles' own smoothing length, and whether there may be a surface; forgets the steps before.
    pub fn begin<K: Kernel<D>>(&mut self, kernel: K, p: &Particles<D>, domain: &Domain<D>) {
        self.brimful = domain.is_brimful(p, self.medium.spacing, self.medium.rest_density);
        self.lattice = Lattice::of(kernel, p.h_max(), self.medium.spacing, self.medium.rest_density);
        self.dt_before = None;
        self.first_line.clear();
    }

    /// Ghosts, pairs, `f` of each pair, what they say about each particle, and the diagonal of `−D G`; the velocity of the state
    /// in `self.v`, no pressure and no force.
    pub fn look_around<K: Kernel<D>>(&mut self, kernel: K, p: &mut Particles<D>, domain: &mut Domain<D>) -> Result<(), StepError> {
        domain.refresh(p, kernel.radius() * p.h_max());
        self.near.build(p, kernel.radius(), self.choices.search)?;
        let (owned, rest) = (p.owned(), self.medium.rest_density);
        let scale = 1.0 / (rest * self.lattice.slope_of_linear::<D>());
        let at_walls = self.choices.wall_weight;
        self.near.fill(&mut self.f, |a, pair| {
            let weight = if p.is_fluid(a) == p.is_fluid(pair.b) { 1.0 } else { at_walls };
            -weight * scale * p.mass[pair.b] * kernel.dw_over_r(pair.r, pair.h)
        });
        let walls_turn = self.first_line.len() != owned || (0..owned).any(|a| p.kind[a] == Kind::Wall && p.v[a] != Vector::ZERO);
        if walls_turn {
            self.first_line = first_line_parents(&self.near, p);
            self.normals = wall_normals(kernel, &self.near, p);
        }
        self.normals.resize(p.len(), Vector::ZERO);
        domain.refresh_column(&mut self.normals);
        let (near, lattice, normals, f) = (&self.near, &self.lattice, &self.normals, &self.f);
        self.at.resize(owned, Arrangement::alone());
        self.places.resize(p.len(), Place::Inside);
        self.records.resize(p.len() + 1, NOBODY);
        sweep(&mut self.records[..p.len()], |a| record(p.x[a], normals[a], 0.0, p.mass[a], !p.is_fluid(a)));
        self.records[p.len()] = NOBODY;
        let lengths: Vec<f64> = if p.h_min() < p.h_max() { p.h.iter().copied().chain([p.h_max()]).collect() } else { Vec::new() };
        let set = InstructionSet::of_this_machine();
        let pairs = Pairs { set, kernel, near, records: &self.records, lengths: (!lengths.is_empty()).then_some(lengths.as_slice()) };
        sweep_lanes(set, &mut self.at, &Looking { pairs, lattice, p });
        let (at, places) = (&mut self.at, &mut self.places);
        if self.brimful {
            at.iter_mut().for_each(|at| at.place = Place::Inside);
        } else {
            sweep(&mut places[..owned], |a| at[a].place);
            domain.refresh_column(places);
            update(at, |a, at| {
                if p.is_fluid(a) {
                    at.look_for_surface(lattice, (near, near.positions()), f, places, a);
                }
            });
        }
        for a in 0..owned {
            p.density[a] = rest * self.at[a].filling;
            p.surface[a] = u8::from(self.at[a].place == Place::Surface);
        }
        self.weigh(p);
        self.v.clone_from(&p.v);
        self.pressure.clear();
        self.pressure.resize(p.len(), 0.0);
        self.force.clear();
        self.force.resize(owned, Vector::ZERO);
        Ok(())
    }

    /// `|Σ f x|² + Σ f_ab f_ba r²` (the second sum over fluid) times the weight of the row.
    fn weigh(&mut self, p: &Particles<D>) {
        let rest_mass = self.medium.rest_density * self.medium.spacing_volume();
        // A millionth of the lattice's: only for particles without neighbours, whose right-hand side is zero.
        let floor = 1e-6 / (self.medium.spacing * self.medium.spacing);
        let (near, f) = (&self.near, &self.f);
        self.weight.resize(p.owned(), 1.0);
        self.diagonal.resize(p.owned(), 1.0);
        sweep(&mut self.weight, |a| p.mass[a] / rest_mass);
        let weight = &self.weight;
        sweep(&mut self.diagonal, |a| {
            if !p.is_fluid(a) {
                return 1.0;
            }
            let (mut slope, mut pairs) = (Vector::ZERO, 0.0);
            near.for_each_with(a, f, |b, x_ab, f| {
                slope += f * x_ab;
                if p.is_fluid(b) {
                    pairs += f * f * p.mass[a] / p.mass[b] * x_ab.norm_squared();
                }
            });
            weight[a] * (slope.norm_squared() + pairs).max(floor)
        });
    }

    /// `C h/max(|v|, sqrt(g H))`, and bounds from viscosity and moving walls; from step to step a fifth more or half at most:
    /// pressure goes as one over the step, that of a density error as one over its square.
    pub fn time_step(&self, p: &Particles<D>) -> StepLimit {
        let h = p.h_min();
        self.medium.flow_limit(p, h).min(self.medium.wall_limit(p, h)).after(self.dt_before, self.medium.courant * h)
    }

    /// `v += Δt (g + viscosity)`: `2ν Σ f (v_b − v_a)` of the fluid (Morris, Fox & Zhu 1997) with walls that stick at their own
    /// velocity, and `2(D+2) ν' f (v_ab·x_ab) x_ab/r²`, `ν' = dissipation · h U/8`, between approaching particles (Monaghan 1992).
    pub fn predict(&mut self, p: &Particles<D>, domain: &Domain<D>, dt: f64) {
        domain.refresh_column(&mut self.v);
        let nu = self.medium.viscosity / self.medium.rest_density;
        let numerical = 2.0 * (D as f64 + 2.0) * self.choices.dissipation * self.medium.greatest_speed(p) / 8.0;
        let sticky = nu > 0.0 && self.choices.sticky;
        let (near, f, v, gravity) = (&self.near, &self.f, &self.v, self.medium.gravity);
        self.v_next.resize(p.len(), Vector::ZERO);
        sweep(&mut self.v_next[..p.owned()], |a| {
            if !p.is_fluid(a) {
                return v[a];
            }
            let mut total = gravity;
            near.for_each_with(a, f, |b, x_ab, f| {
                let v_ab = v[a] - v[b];
                if p.is_fluid(b) {
                    total -= 2.0 * nu * f * v_ab;
                    let approach = v_ab.dot(x_ab);
                    if approach < 0.0 {
                        let h = 0.5 * (near.h(a) + near.h(b));
                        total -= (numerical * h * f * approach / x_ab.norm_squared()) * x_ab;
                    }
                } else if sticky {
                    total -= 2.0 * nu * f * v_ab;
                }
            });
            v[a] + dt * total
        });
        if sticky {
            update(&mut self.force, |a, force| {
                if p.kind[a] == Kind::Wall {
                    near.for_each_with(a, f, |b, _, f| {
                        if p.is_fluid(b) {
                            *force += 2.0 * nu * p.mass[a] * f * (v[b] - v[a]);
                        }
                    });
                }
            });
        }
        std::mem::swap(&mut self.v, &mut self.v_next);
    }

    /// `D u` at `a`, 1/s.
    fn divergence(&self, u: &[Vector<D>], a: usize) -> f64 {
        let (mut total, u_a) = (0.0, u[a]);
        self.near.for_each_with(a, &self.f, |b, x_ab, f| total -= f * (u[b] - u_a).dot(x_ab));
        total
    }

    /// `G q` at `a` for `q` that is zero on walls.
    fn adjoint_gradient(&self, q: &[f64], a: usize) -> Vector<D> {
        let (mut total, q_a) = (Vector::ZERO, q[a]);
        self.near.for_each_with(a, &self.f, |b, x_ab, f| total -= f * (q_a + q[b]) * x_ab);
        total
    }

    /// What the pressure is to add to `D v`, 1/s, for `aim`: near a free surface fluid may expand as it likes.
    fn wanted(&self, aim: Aim, dt: f64, a: usize) -> f64 {
        let at = &self.at[a];
        let change = match aim {
            Aim::DivergenceFree => 0.0,
            // The filling falls by D v times this.
            Aim::ConstantDensity => (at.filling - 1.0) * self.lattice.sum_w / (self.lattice.slope_of_linear::<D>() * dt),
        };
        let wanted = change - self.divergence(&self.v, a);
        if at.place == Place::Inside { wanted } else { wanted.max(0.0) }
    }

    /// Whether `a` has no pressure, if `wanted` is what it asks for: on the surface where nothing compresses it, and in spray, with
    /// less than half the neighbours of the outermost row of a flat surface. Chains of such particles have pressures that push
    /// nobody, alternating from one to the next.
    fn idle(&self, p: &Particles<D>, wanted: f64, a: usize) -> bool {
        let at = &self.at[a];
        !p.is_fluid(a) || at.place == Place::Surface && (wanted <= 0.0 || at.spread < 0.5 * self.lattice.spread_row[0])
    }

    /// Finds `p` with `D (v − (Δt/ρ0) G p)` as `aim` says, and sets `v −= (Δt/ρ0) G p`; `p` is added to the pressure and its
    /// forces on walls to theirs. `guess` is where the search starts, and is left at what was found.
    pub fn press(
        &mut self,
        p: &Particles<D>,
        domain: &Domain<D>,
        aim: Aim,
        dt: f64,
        guess: &mut Vec<f64>,
    ) -> Result<SolveReport, StepError> {
        let (owned, rest) = (p.owned(), self.medium.rest_density);
        domain.refresh_column(&mut self.v);
        guess.resize(owned, 0.0);
        let mut source = std::mem::take(&mut self.source);
        source.resize(owned, 0.0);
        sweep(&mut source, |a| if p.is_fluid(a) { self.weight[a] * rest / dt * self.wanted(aim, dt, a) } else { 0.0 });
        let mut idle = std::mem::take(&mut self.idle);
        idle.resize(owned, true);
        sweep(&mut idle, |a| self.idle(p, source[a], a));
        for a in (0..owned).filter(|&a| idle[a]) {
            (source[a], guess[a]) = (0.0, 0.0);
        }
        self.idle = idle;
        // Without a surface a constant pressure means nothing.
        let closed = !self.places[..owned].contains(&Place::Surface) && !p.kind[..owned].contains(&Kind::Wall);
        let level = |column: &mut [f64]| {
            if closed {
                let mean = sum(owned, |a| column[a]) / owned as f64;
                column.iter_mut().for_each(|value| *value -= mean);
            }
        };
        level(&mut source);
        self.source = source;

        let mut work = std::mem::take(&mut self.work);
        let mut gradient = std::mem::take(&mut self.gradient);
        let mut with_ghosts = std::mem::take(&mut self.with_ghosts);
        with_ghosts.resize(p.len(), 0.0);
        gradient.resize(p.len(), Vector::ZERO);
        let this = &*self;
        let mut apply_gradient = |q: &[f64], gradient: &mut Vec<Vector<D>>| {
            with_ghosts.clear();
            with_ghosts.extend_from_slice(q);
            with_ghosts.resize(p.len(), 0.0);
            domain.refresh_column(&mut with_ghosts);
            let q = &with_ghosts;
            sweep(&mut gradient[..owned], |a| if p.is_fluid(a) { this.adjoint_gradient(q, a) } else { Vector::ZERO });
            domain.refresh_column(gradient);
        };
        // A relative change of volume of 1e-8 in a step means nothing: a run of a million steps would show a hundredth of it.
        let negligible = 1e-8 * rest / (dt * dt);
        let goal = Goal { tolerance: this.choices.tolerance, negligible, max_iterations: this.choices.max_iterations };
        let solved = projection::solve(
            |q, aq| {
                apply_gradient(q, &mut gradient);
                sweep(aq, |a| if this.idle[a] { 0.0 } else { -this.weight[a] * this.divergence(&gradient, a) });
            },
            level,
            |r, z| sweep(z, |a| r[a] / this.diagonal[a]),
            &this.source,
            guess,
            goal,
            &mut work,
        );
        apply_gradient(guess, &mut gradient);
        (self.work, self.gradient, self.with_ghosts) = (work, gradient, with_ghosts);
        let report = solved?;
        let (gradient, with_ghosts, near, f) = (&self.gradient, &self.with_ghosts, &self.near, &self.f);
        update(&mut self.v[..owned], |a, v| {
            if p.is_fluid(a) {
                *v -= (dt / rest) * gradient[a];
            }
        });
        update(&mut self.force, |a, force| {
            if p.kind[a] == Kind::Wall {
                near.for_each_with(a, f, |b, x_ab, f| *force += p.mass[a] / rest * f * with_ghosts[b] * x_ab);
            }
        });
        for (total, part) in self.pressure.iter_mut().zip(with_ghosts) {
            *total += part;
        }
        Ok(report)
    }

    /// `x += Δt v`; nothing passes a wall. Acceleration, pressure and forces on walls go with it.
    pub fn finish(&mut self, p: &mut Particles<D>, domain: &Domain<D>, dt: f64) {
        let owned = p.owned();
        let mut moved = std::mem::take(&mut self.moved);
        moved.resize(owned, Guarded::default());
        sweep(&mut moved, |a| {
            if p.is_fluid(a) {
                set_back(&self.near, p, &self.normals, (self.medium.spacing, dt), a, (p.x[a] + dt * self.v[a], self.v[a]))
            } else {
                Guarded::default()
            }
        });
        let (near, force) = (&self.near, &self.force);
        let mut on_walls = std::mem::take(&mut p.force);
        sweep(&mut on_walls[..owned], |a| match p.kind[a] {
            Kind::Wall => force[a] + force_of_set_back(near, p, domain, &moved, dt, a),
            Kind::Fluid | Kind::Lost => Vector::ZERO,
        });
        p.force = on_walls;
        self.show(p, dt);
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.acceleration[a] = (moved[a].v - p.v[a]) / dt;
            (p.x[a], p.v[a]) = (moved[a].x, moved[a].v);
        }
        self.moved = moved;
        self.dt_before = Some(dt);
    }

    /// Pressure of fluid, and of walls for output: `Σ f (p_b + ρ (g − a_w)·x_wb)/Σ f` over fluid (Adami, Hu & Adams 2012) in the
    /// first line, less where less than half the fluid of a flat wall is in reach; behind it the same with the weight between.
    /// The acceleration of fluid is the one that `self.v` makes.
    pub fn show(&self, p: &mut Particles<D>, dt: f64) {
        let (owned, rest, near, f) = (p.owned(), self.medium.rest_density, &self.near, &self.f);
        let answer = |a: usize| self.medium.gravity - p.acceleration[a];
        let flat_wall = self.choices.wall_weight * (1.0 - self.lattice.spread_row[0]) * D as f64;
        let mut pressure = std::mem::take(&mut p.pressure);
        sweep(&mut pressure[..owned], |a| {
            if p.kind[a] != Kind::Wall {
                return self.pressure[a];
            }
            if p.layer[a] > 1 {
                return 0.0;
            }
            let (mut weight, mut total, mut spread) = (0.0, 0.0, 0.0);
            near.for_each_with(a, f, |b, x_ab, f| {
                if p.is_fluid(b) {
                    weight += f;
                    spread += f * x_ab.norm_squared();
                    total += f * (self.pressure[b] + rest * answer(a).dot(x_ab));
                }
            });
            if weight > 0.0 { total / weight * (spread / (0.5 * flat_wall)).min(1.0) } else { 0.0 }
        });
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Wall && p.layer[a] > 1) {
            let first = self.first_line[a] as usize;
            let line = pressure[first];
            pressure[a] = if line == 0.0 { 0.0 } else { line + rest * answer(a).dot(p.x[a] - p.x[first]) };
        }
        p.pressure = pressure;
        for a in (0..owned).filter(|&a| p.kind[a] == Kind::Fluid) {
            p.acceleration[a] = (self.v[a] - p.v[a]) / dt;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::WendlandC2;
    use crate::particles::Particle;

    /// A disordered block of particles of uneven mass on a floor; spacing 0.1.
    fn block() -> (Flow<2>, Particles<2>, Domain<2>) {
        let (dx, mut p) = (0.1, Particles::new());
        for i in 0..16 {
            for j in -3..14 {
                let noise = |k: i32| f64::from((i * 7 + j * 13 + k * 5).rem_euclid(11)) / 11.0 - 0.5;
                let (kind, layer) = if j < 0 { (Kind::Wall, -j as u8) } else { (Kind::Fluid, 0) };
                let away = if j < 0 { Vector::ZERO } else { 0.3 * Vector([noise(1), noise(2)]) };
                let x = dx * (Vector([f64::from(i) + 0.5, f64::from(j) + 0.5]) + away);
                let v = if j < 0 { Vector::ZERO } else { Vector([noise(3), noise(4)]) };
                let id = p.owned() as u32;
                p.push(id, Particle { kind, layer, x, v, mass: 10.0 * (1.0 + 0.2 * noise(5)), density: 1e3, pressure: 0.0, h: 1.3 * dx });
            }
        }
        let medium = Medium {
            rest_density: 1e3,
            viscosity: 0.5,
            gravity: Vector([0.0, -9.81]),
            spacing: dx,
            depth: 1.4,
            floor: 0.0,
            courant: 0.25,
            speed: 7.4,
        };
        let choices =
            Choices { dissipation: 0.1, sticky: true, wall_weight: 2.0, search: Search::Grid, tolerance: 1e-6, max_iterations: 2000 };
        let mut domain = Domain::new(Vector([-5.0; 2]), Vector([5.0; 2]), [false; 2]);
        let mut flow = Flow::new(WendlandC2, medium, choices);
        flow.begin(WendlandC2, &p, &domain);
        flow.look_around(WendlandC2, &mut p, &mut domain).unwrap();
        (flow, p, domain)
    }

    /// `Σ m (G q)·u = −Σ m q D u` for velocities that vanish on walls, and the diagonal is that of the operator. 1e-13: round-off
    /// of some thousand terms against the sum of their sizes.
    #[test]
    fn the_gradient_is_the_negative_adjoint_of_the_divergence() {
        let (flow, p, _) = block();
        let q: Vec<f64> = (0..p.owned()).map(|a| if p.is_fluid(a) { f64::from((a * 37 % 101) as u32) - 50.0 } else { 0.0 }).collect();
        let (mut one, mut other, mut size) = (0.0, 0.0, 0.0);
        for a in (0..p.owned()).filter(|&a| p.is_fluid(a)) {
            let (force, flux) = (p.mass[a] * flow.adjoint_gradient(&q, a).dot(p.v[a]), p.mass[a] * q[a] * flow.divergence(&p.v, a));
            (one, other, size) = (one + force, other + flux, size + force.abs() + flux.abs());
        }
        assert!((one + other).abs() < 1e-13 * size, "{one} and {other}");
        let a = 100;
        let alone: Vec<f64> = (0..p.owned()).map(|b| f64::from(u8::from(a == b))).collect();
        let gradient: Vec<_> =
            (0..p.owned()).map(|b| if p.is_fluid(b) { flow.adjoint_gradient(&alone, b) } else { Vector::ZERO }).collect();
        let diagonal = -flow.weight[a] * flow.divergence(&gradient, a);
        assert!((diagonal / flow.diagonal[a] - 1.0).abs() < 1e-12, "{diagonal}, not {}", flow.diagonal[a]);
    }

    /// After the solve the divergence is what was wanted in every row with a pressure, to the residual of 1e-6. At a step of 0.01 s what
    /// the solver lets be is less than that.
    #[test]
    fn the_pressure_leaves_the_divergence_that_was_wanted() {
        for aim in [Aim::DivergenceFree, Aim::ConstantDensity] {
            let (mut flow, p, domain) = block();
            let dt = 1e-2;
            let before: Vec<f64> = (0..p.owned()).map(|a| if p.is_fluid(a) { flow.wanted(aim, dt, a) } else { 0.0 }).collect();
            let was: Vec<f64> = (0..p.owned()).map(|a| flow.divergence(&flow.v, a)).collect();
            let report = flow.press(&p, &domain, aim, dt, &mut Vec::new()).unwrap();
            assert!(report.residual <= 1e-6 && report.iterations > 3, "{report:?}");
            let size = before.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            for a in (0..p.owned()).filter(|&a| !flow.idle[a]) {
                let gained = flow.divergence(&flow.v, a) - was[a];
                // 1e-4: the residual is a mean over some hundred rows of which the worst may have all.
                assert!((gained - before[a]).abs() < 1e-4 * size, "{aim:?}: {gained}, not {} at row {a}", before[a]);
            }
        }
    }

    /// Momentum of fluid after a step less that of before and the weight is minus what walls got. 1e-12: round-off.
    #[test]
    fn walls_get_what_the_fluid_loses() {
        let (mut flow, mut p, domain) = block();
        let dt = 1e-3;
        let fluid: Vec<usize> = (0..p.owned()).filter(|&a| p.is_fluid(a)).collect();
        let momentum = |p: &Particles<2>| fluid.iter().fold(Vector::ZERO, |sum, &a| sum + p.mass[a] * p.v[a]);
        let (before, weight) = (momentum(&p), fluid.iter().map(|&a| 9.81 * p.mass[a]).sum::<f64>());
        flow.press(&p, &domain, Aim::DivergenceFree, dt, &mut Vec::new()).unwrap();
        flow.predict(&p, &domain, dt);
        flow.press(&p, &domain, Aim::ConstantDensity, dt, &mut Vec::new()).unwrap();
        flow.finish(&mut p, &domain, dt);
        let gained = (momentum(&p) - before) / dt + weight * Vector::unit(1);
        let on_walls = p.force.iter().fold(Vector::ZERO, |sum, &force| sum + force);
        let size: f64 = p.force.iter().map(|force| force.norm()).sum();
        assert!(size > 0.0 && (gained + on_walls).norm() < 1e-12 * (size + weight / dt), "{gained:?} and {on_walls:?}");
    }
}
