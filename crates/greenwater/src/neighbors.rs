//! Who is near whom. The only code that knows how pairs are found.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::lanes::singles::{Singles, WIDE};
use crate::lanes::{InstructionSet, Job, LANES, Lanes, Listed, Octets, Record, Totals, dispatch};
use crate::math::Vector;
use crate::particles::{Kind, Particles};
use crate::sweep::{BLOCK, keep_ranges, replace, sweep, trim};

/// How pairs are found. Every way finds the same pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Search {
    /// Every particle looks at every other: `O(N²)`.
    Direct,
    /// Every particle looks into its own and the adjacent cells of a grid: `O(N)`.
    #[default]
    Grid,
}

/// A particle near another one.
#[derive(Clone, Copy, Debug)]
pub struct Pair<const D: usize> {
    /// Row of the neighbour.
    pub b: usize,
    /// `x_a − x_b`, m.
    pub x_ab: Vector<D>,
    /// `|x_a − x_b|`, m.
    pub r: f64,
    /// Mean smoothing length `(h_a + h_b)/2`, m.
    pub h: f64,
}

/// Why no pairs could be found.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum SearchError {
    /// A position is NaN or infinite.
    #[error("position of particle {particle} is not finite")]
    NotFinite {
        /// Row of the particle.
        particle: usize,
    },
}

/// The pairs of a set of particles: all `b != a` with `|x_a − x_b| <= κ (h_a + h_b)/2`, where `κ` is the support of the kernel
/// in smoothing lengths (the paper's `|r| <= h_a + h_b` for `κ = 2`).
///
/// Keeps the positions and smoothing lengths it was [built](Self::build) from: what it reports belongs together even when the particles have
/// moved on. Lists alone have none until they [follow](Self::follow) some. Storage is reused from build to build. The order of the neighbours
/// of a particle depends on the positions only, never on the number of threads.
#[derive(Clone, Debug, Default)]
pub struct Neighbors<const D: usize> {
    x: Vec<Vector<D>>,
    h: Vec<f64>,
    segments: Vec<Segment>,
    /// The row behind all particles.
    nobody: u32,
    /// Pairs found.
    pairs: usize,
    grid: Grid<D>,
    /// What the grid sorts into.
    room: Vec<Record>,
}

/// What wall particles behind the first line have in their lists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BehindWalls {
    /// All that is near.
    Everyone,
    /// Fluid alone: all that sums over the fluid in front of a wall need.
    Fluid,
}

/// The neighbours of `BLOCK` consecutive particles. Those of a particle start at a multiple of [`LANES`]; what is left of the last
/// eight is filled with the row behind all particles, where nobody is.
#[derive(Clone, Debug, Default)]
struct Segment {
    /// Where the neighbours of each particle end in `list`.
    ends: Vec<u32>,
    list: Octets,
}

impl Segment {
    /// Where the neighbours of particle `i` of the segment stand in `list`.
    #[inline(always)]
    fn range(&self, i: usize) -> std::ops::Range<usize> {
        let start = if i == 0 { 0 } else { (self.ends[i - 1] as usize).next_multiple_of(LANES) };
        start..self.ends[i] as usize
    }

    /// Keeps the neighbours of those particles of the segment that `keeps`, and their `values`.
    fn keep<T: Copy>(&mut self, values: &mut Vec<T>, keeps: impl Fn(usize) -> bool) {
        let whole = |i| self.range(i).start..(self.ends[i] as usize).next_multiple_of(LANES);
        let kept: Vec<_> = (0..self.ends.len()).filter(|&i| keeps(i)).map(whole).collect();
        self.list.keep(&kept);
        keep_ranges(values, &kept);
        let (mut start, mut length) = (0, 0);
        for (i, end) in self.ends.iter_mut().enumerate() {
            let more = *end as usize - start;
            start = (*end as usize).next_multiple_of(LANES);
            if keeps(i) {
                *end = (length + more) as u32;
                length = (*end as usize).next_multiple_of(LANES);
            } else {
                *end = length as u32;
            }
        }
    }
}

/// Neighbours of a particle, as many as a vector holds.
pub(crate) struct Group<'a, L, const D: usize> {
    /// Their rows; one behind all particles where there are no more.
    pub rows: &'a [u32],
    /// Their records.
    pub fields: [L; LANES],
    /// `x_a − x_b`, m.
    pub x_ab: [L; D],
    /// `|x_a − x_b|²`, m².
    pub square: L,
    /// `|x_a − x_b|`, m.
    pub r: L,
}

impl<'a, L: Lanes, const D: usize> Group<'a, L, D> {
    /// Those that are `listed` beside the particle of the record `own`.
    #[inline(always)]
    fn of(own: &Record, listed: Listed<'a>) -> Self {
        let fields = L::gather(listed);
        let mut x_ab = [L::splat(0.0); D];
        let mut square = L::splat(0.0);
        for d in 0..D {
            x_ab[d] = L::splat(own.0[d]) - fields[d];
            square = x_ab[d].times_plus(x_ab[d], square);
        }
        Self { rows: listed.rows(), fields, x_ab, square, r: square.root() }
    }
}

/// A term of a sum over neighbours, for several of them; every method must be `#[inline(always)]`. Nothing may come of a neighbour
/// farther away than the kernel reaches.
pub(crate) trait Term<L: Lanes, const D: usize> {
    /// What is added up.
    type Totals: Totals;

    /// A sum without terms.
    fn nothing(&self) -> Self::Totals;

    /// Adds the terms of neighbours, lane by lane.
    fn add(&self, group: &Group<'_, L, D>, totals: &mut Self::Totals);
}

/// What is found for each row and each of its pairs; `row` must be `#[inline(always)]`, see [`Job`].
pub(crate) trait RowsOfPairs<T, U>: Sync {
    /// Pushes a value for each neighbour of `a`, in the order of [`Neighbors::for_each`], whole eights or not; answers what belongs to `a`.
    fn row<L: Lanes>(&self, a: usize, values: &mut Vec<f32>) -> (T, U);
}

/// The record behind all others: nobody, out of everyone's reach. 1e30 m: its square is a number, too.
pub(crate) const NOBODY: Record = {
    let mut fields = [0.0; LANES];
    let mut d = 0;
    while d < 3 {
        fields[d] = 1e30;
        d += 1;
    }
    Record(fields)
};

/// A value for every listed pair, in the order of the lists: what many sums need and one sweep computes. In double precision, or in single where values go into
/// matrices that are stored so.
#[derive(Clone, Debug, Default)]
pub struct PairColumn<T = f64> {
    segments: Vec<Vec<T>>,
}

impl<T> PairColumn<T> {
    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.segments.iter().map(|segment| size_of::<T>() * segment.capacity()).sum()
    }
}

impl<const D: usize> Neighbors<D> {
    /// No pairs yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Finds all pairs of real particles with real ones and ghosts; `support` is `κ`, in smoothing lengths.
    ///
    /// # Errors
    /// A position that is not finite.
    pub fn build(&mut self, p: &Particles<D>, support: f64, search: Search) -> Result<(), SearchError> {
        let mut room = std::mem::take(&mut self.room);
        let listed = self.list(p, support, search, BehindWalls::Everyone, &mut room);
        self.room = room;
        listed.map(|()| self.follow(p))
    }

    /// Finds the same pairs and keeps the rows alone, for those who have the positions elsewhere: until [`follow`](Self::follow) only lists and
    /// sums over records know anything. Overwrites `room`, which grows to some records a particle at most.
    ///
    /// # Errors
    /// A position that is not finite.
    pub(crate) fn list(
        &mut self,
        p: &Particles<D>,
        support: f64,
        search: Search,
        behind: BehindWalls,
        room: &mut Vec<Record>,
    ) -> Result<(), SearchError> {
        if let Some(particle) = p.x.iter().position(|x| !x.is_finite()) {
            return Err(SearchError::NotFinite { particle });
        }
        self.x.clear();
        self.h.clear();
        self.nobody = p.len() as u32;
        self.segments.resize_with(p.owned().div_ceil(BLOCK), Segment::default);
        let mut grid = std::mem::take(&mut self.grid);
        match search {
            Search::Direct => grid.starts.clear(),
            Search::Grid => grid.sort(p, support * p.h_max(), room),
        }
        let (set, nobody) = (InstructionSet::of_this_machine(), self.nobody);
        let sorted =
            (search == Search::Grid).then(|| Sorted { grid: &grid, columns: Record::flat(room), length: p.len(), alike: is_alike(p) });
        self.segments.par_iter_mut().enumerate().with_max_len(4).for_each_init(Candidates::default, |candidates, (block, segment)| {
            dispatch(set, Listing { p, sorted, support, behind, nobody, first: block * BLOCK, candidates, segment });
        });
        self.grid = grid;
        self.pairs = self.segments.iter().flat_map(|segment| (0..segment.ends.len()).map(|i| segment.range(i).len())).sum();
        Ok(())
    }

    /// Calls `renumber` with the `owned` real rows in the order of the cells of the last search, cell by cell: near each other in memory, near
    /// each other in space. Lost rows come last. Not after a direct search, which has no cells.
    pub(crate) fn in_order(&mut self, owned: usize, renumber: impl FnOnce(&[u32])) {
        let Grid { starts, rows, cell_of, .. } = &mut self.grid;
        if !starts.is_empty() {
            // Cells of rows are of no use behind the search.
            cell_of.clear();
            cell_of.extend(rows[..self.nobody as usize].iter().filter(|&&row| (row as usize) < owned));
            renumber(cell_of);
        }
    }

    /// Takes the positions of now without a new search: pairs stay those of the last one, their distances are today's.
    ///
    /// A list built with a wider support than the kernel's holds every pair until two particles have moved towards each other by
    /// the difference.
    pub fn follow(&mut self, p: &Particles<D>) {
        self.x.clone_from(&p.x);
        self.h.clone_from(&p.h);
    }

    /// Lets go of the positions: those who look on have them elsewhere.
    pub(crate) fn let_go(&mut self) {
        (self.x, self.h) = (Vec::new(), Vec::new());
    }

    /// Gives back the room of all rows but those that `keeps`, here and in a `column`: until the next search others have no neighbours any more.
    /// Until this is `thorough`, blocks of rows in which one is kept are kept whole, which costs less.
    pub(crate) fn keep<T: Copy + Send>(&mut self, column: &mut PairColumn<T>, thorough: bool, keeps: impl Fn(usize) -> bool + Sync) {
        let blocks = self.segments.par_iter_mut().zip(&mut column.segments).enumerate();
        blocks.for_each(|(block, (segment, values))| {
            let rows = block * BLOCK..block * BLOCK + segment.ends.len();
            if !values.is_empty() && (thorough || !rows.clone().any(&keeps)) {
                segment.keep(values, |i| keeps(rows.start + i));
            }
        });
    }

    /// Positions of all particles, m, as they were at the build.
    pub(crate) fn positions(&self) -> &[Vector<D>] {
        &self.x
    }

    /// Appends the rows near a point to `list`: those within `support` mean smoothing lengths of `x`, m, for a point of smoothing
    /// length `h`, m. Sees the positions of the build.
    pub fn near_point(&self, x: Vector<D>, h: f64, support: f64, list: &mut Vec<u32>) {
        if !self.grid.starts.is_empty() {
            self.grid.near_point(&self.x, &self.h, (x, h), support, list);
        } else {
            let within = |b: &usize| {
                let reach = support * (0.5 * (h + self.h[*b]));
                (x - self.x[*b]).norm_squared() <= reach * reach
            };
            list.extend((0..self.x.len()).filter(within).map(|b| b as u32));
        }
    }

    /// Rows of the neighbours of `a`.
    #[inline(always)]
    pub fn of(&self, a: usize) -> &[u32] {
        let segment = &self.segments[a / BLOCK];
        &segment.list.rows()[segment.range(a % BLOCK)]
    }

    /// The neighbours of `a` by eights, the last ones filled up, in `records`.
    #[inline(always)]
    fn octets<'a>(&'a self, a: usize, records: &'a [Record]) -> impl Iterator<Item = Listed<'a>> {
        let segment = &self.segments[a / BLOCK];
        let range = segment.range(a % BLOCK);
        segment.list.of(range.start..range.end.next_multiple_of(LANES), records)
    }

    /// The sum of `term` over the neighbours of `a`, eight at a time; its lanes are not yet added up. `records` hold one a particle and
    /// [`NOBODY`] at the end, positions in the first fields.
    #[inline(always)]
    pub(crate) fn sum<L: Lanes, T: Term<L, D>>(&self, a: usize, records: &[Record], term: &T) -> T::Totals {
        let own = &records[a];
        let eights = self.octets(a, records);
        match LANES / L::COUNT {
            1 => {
                let mut totals = term.nothing();
                for eight in eights {
                    term.add(&Group::of(own, eight), &mut totals);
                }
                totals
            }
            // Written out, since what is added up stays in registers.
            2 => {
                let (mut low, mut high) = (term.nothing(), term.nothing());
                for eight in eights {
                    term.add(&Group::of(own, eight.part::<L>(0)), &mut low);
                    term.add(&Group::of(own, eight.part::<L>(1)), &mut high);
                }
                low.joined(high)
            }
            _ => {
                let mut quarters = [term.nothing(); 4];
                for eight in eights {
                    for (part, totals) in quarters.iter_mut().enumerate() {
                        term.add(&Group::of(own, eight.part::<L>(part)), totals);
                    }
                }
                let [a, b, c, d] = quarters;
                a.joined(c).joined(b.joined(d))
            }
        }
    }

    /// Calls `each` with every neighbour of `a`, always in the same order.
    #[inline(always)]
    pub fn for_each(&self, a: usize, mut each: impl FnMut(Pair<D>)) {
        let (x_a, h_a) = (self.x[a], self.h[a]);
        for &b in self.of(a) {
            let b = b as usize;
            let x_ab = x_a - self.x[b];
            each(Pair { b, x_ab, r: x_ab.norm(), h: 0.5 * (h_a + self.h[b]) });
        }
    }

    /// Position of particle `a`, m, as it was at the build.
    #[inline(always)]
    pub fn x(&self, a: usize) -> Vector<D> {
        self.x[a]
    }

    /// Sets `column` to `value(a, pair)` for every pair of these lists. Nothing is allocated once it has grown to their size.
    pub fn fill(&self, column: &mut PairColumn, value: impl Fn(usize, &Pair<D>) -> f64 + Sync) {
        column.segments.resize_with(self.segments.len(), Vec::new);
        let blocks = column.segments.par_iter_mut().zip(&self.segments).enumerate();
        blocks.for_each(|(block, (values, segment))| {
            values.clear();
            for i in 0..segment.ends.len() {
                let a = block * BLOCK + i;
                self.for_each(a, |pair| values.push(value(a, &pair)));
                values.resize(values.len().next_multiple_of(LANES), 0.0);
            }
            trim(values);
        });
    }

    /// Fills a column row by row and finds two things more for each row, with vectors of any kind; see [`RowsOfPairs`].
    pub(crate) fn fill_rows<T: Send, U: Send, R: RowsOfPairs<T, U>>(
        &self,
        set: InstructionSet,
        column: &mut PairColumn<f32>,
        (first, second): (&mut [T], &mut [U]),
        rows: &R,
    ) {
        struct Block<'a, T, U, R> {
            start: usize,
            values: &'a mut Vec<f32>,
            first: &'a mut [T],
            second: &'a mut [U],
            rows: &'a R,
        }

        impl<T, U, R: RowsOfPairs<T, U>> Job for Block<'_, T, U, R> {
            #[inline(always)]
            fn run<L: Lanes>(self) {
                for (i, (first, second)) in self.first.iter_mut().zip(self.second).enumerate() {
                    (*first, *second) = self.rows.row::<L>(self.start + i, self.values);
                    self.values.resize(self.values.len().next_multiple_of(LANES), 0.0);
                }
            }
        }

        column.segments.resize_with(self.segments.len(), Vec::new);
        let blocks = column.segments.par_iter_mut().zip(first.par_chunks_mut(BLOCK)).zip(second.par_chunks_mut(BLOCK));
        // Values grow in a place of the thread's own, so that what is kept has little more room than it needs.
        blocks.enumerate().with_max_len(4).for_each_init(Vec::new, |found, (block, ((values, first), second))| {
            found.clear();
            dispatch(set, Block { start: block * BLOCK, values: &mut *found, first, second, rows });
            replace(values, found.iter().copied());
        });
    }

    /// Calls `each(b, x_ab, value)` with every neighbour of `a` in the order of [`for_each`](Self::for_each), `value` from a
    /// column that was [filled](Self::fill) from these lists.
    #[inline(always)]
    pub fn for_each_with<T: Copy + Into<f64>>(&self, a: usize, column: &PairColumn<T>, each: impl FnMut(usize, Vector<D>, f64)) {
        self.for_each_at(&self.x, a, column, each);
    }

    /// The same for particles at `x`, m, whether or not these lists have positions of their own.
    #[inline(always)]
    pub(crate) fn for_each_at<T: Copy + Into<f64>>(
        &self,
        x: &[Vector<D>],
        a: usize,
        column: &PairColumn<T>,
        mut each: impl FnMut(usize, Vector<D>, f64),
    ) {
        let (block, i) = (a / BLOCK, a % BLOCK);
        let segment = &self.segments[block];
        let range = segment.range(i);
        let x_a = x[a];
        for (&b, &value) in segment.list.rows()[range.clone()].iter().zip(&column.segments[block][range]) {
            let b = b as usize;
            each(b, x_a - x[b], value.into());
        }
    }

    /// Smoothing length of particle `a`, m, as it was at the build.
    #[inline(always)]
    pub fn h(&self, a: usize) -> f64 {
        self.h[a]
    }

    /// Number of pairs that the search found, each counted from both sides (ghosts have no neighbours of their own).
    pub fn pairs(&self) -> usize {
        self.pairs
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let lists: usize = self.segments.iter().map(|s| 4 * s.ends.capacity() + s.list.bytes()).sum();
        let room = self.room.capacity() * size_of::<Record>();
        lists + self.x.capacity() * size_of::<Vector<D>>() + 8 * self.h.capacity() + self.grid.bytes() + room
    }
}

/// Lists the neighbours of a block of particles.
struct Listing<'a, const D: usize> {
    p: &'a Particles<D>,
    /// None for a direct search.
    sorted: Option<Sorted<'a, D>>,
    support: f64,
    behind: BehindWalls,
    nobody: u32,
    first: usize,
    candidates: &'a mut Candidates<D>,
    segment: &'a mut Segment,
}

impl<const D: usize> Job for Listing<'_, D> {
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { p, sorted, support, behind, nobody, first, candidates, segment } = self;
        let Segment { ends, list } = segment;
        ends.clear();
        // Blocks of rows have about as many neighbours as those before them.
        list.begin(candidates.likely);
        for a in first..p.owned().min(first + BLOCK) {
            list.fill_up(nobody);
            let fluid_alone = behind == BehindWalls::Fluid && p.kind[a] == Kind::Wall && p.layer[a] > 1;
            match sorted {
                _ if p.kind[a] == Kind::Lost => {}
                None => all_near(p, support, a, fluid_alone, list),
                Some(sorted) => {
                    candidates.gather(&sorted, p, a, fluid_alone);
                    candidates.near::<L::Singles>(p, a, support, list);
                }
            }
            ends.push(list.len() as u32);
        }
        list.fill_up(nobody);
        list.end();
        candidates.likely = list.asked();
    }
}

/// Whether two particles see each other, to the last digit.
fn sees<const D: usize>(p: &Particles<D>, a: usize, b: usize, support: f64) -> bool {
    let reach = support * (0.5 * (p.h[a] + p.h[b]));
    (p.x[a] - p.x[b]).norm_squared() <= reach * reach
}

/// Appends the neighbours of `a`, found by looking at every particle.
fn all_near<const D: usize>(p: &Particles<D>, support: f64, a: usize, fluid_alone: bool, list: &mut Octets) {
    for b in 0..p.len() {
        if sees(p, a, b, support) && b != a && p.kind[b] != Kind::Lost && (p.is_fluid(b) || !fluid_alone) {
            list.push(b as u32);
        }
    }
}

/// Whether all smoothing lengths are equal.
fn is_alike<const D: usize>(p: &Particles<D>) -> bool {
    p.h.iter().all(|&h| h == p.h[0])
}

/// Particles sorted into cubes, the last axis fastest, so that the cells of a row are one run of memory. Cases number particles
/// in the same order: those of a cell lie near each other in the columns, too.
#[derive(Clone, Debug)]
struct Grid<const D: usize> {
    min: Vector<D>,
    edge: f64,
    cells: [usize; D],
    /// First entry of each cell in `entries`; one more at the end.
    starts: Vec<u32>,
    cell_of: Vec<u32>,
    /// Particles in the order of their cells.
    rows: Vec<u32>,
}

/// Particles in the order of the cells of a grid.
#[derive(Clone, Copy, Debug)]
struct Sorted<'a, const D: usize> {
    grid: &'a Grid<D>,
    /// A column for each axis, and where they differ one of smoothing lengths, m.
    columns: &'a [f64],
    /// Of a column.
    length: usize,
    /// Whether all smoothing lengths are equal.
    alike: bool,
}

impl<const D: usize> Default for Grid<D> {
    fn default() -> Self {
        Self { min: Vector::ZERO, edge: 0.0, cells: [0; D], starts: Vec::new(), cell_of: Vec::new(), rows: Vec::new() }
    }
}

/// Cells allowed for each particle; a sparse cloud gets larger cells instead of more memory.
const CELLS_PER_PARTICLE: usize = 4;

impl<const D: usize> Grid<D> {
    /// Counting sort of all particles into cells of edge `reach`, m, or larger; the columns of [`Sorted`] stand in `room`.
    fn sort(&mut self, p: &Particles<D>, reach: f64, room: &mut Vec<Record>) {
        let (min, max) = bounds(&p.x);
        self.min = min;
        // A hair wider than the reach: two particles exactly that far apart stay in adjacent cells whatever the rounding.
        self.edge = (reach * (1.0 + 1e-9)).max(f64::MIN_POSITIVE);
        let budget = CELLS_PER_PARTICLE * p.len() + 64;
        loop {
            let along = |d: usize| ((max[d] - min[d]) / self.edge).floor() + 1.0;
            if (0..D).map(along).product::<f64>() <= budget as f64 {
                self.cells = std::array::from_fn(|d| along(d) as usize);
                break;
            }
            self.edge *= 1.25;
        }
        let count: usize = self.cells.iter().product();
        let no_cell = count as u32;

        let mut cell_of = std::mem::take(&mut self.cell_of);
        cell_of.resize(p.len(), 0);
        sweep(&mut cell_of, |b| if p.kind[b] == Kind::Lost { no_cell } else { self.index(self.cell(p.x[b])) });
        self.cell_of = cell_of;

        // Counted two places on: after the sums, place `cell + 1` holds where a cell starts; the fill moves it to where the cell
        // ends, which is where the next one starts.
        self.starts.clear();
        self.starts.resize(count + 3, 0);
        for &cell in &self.cell_of {
            self.starts[cell as usize + 2] += 1;
        }
        for i in 1..self.starts.len() {
            self.starts[i] += self.starts[i - 1];
        }
        self.rows.resize(p.len(), 0);
        for (row, &cell) in self.cell_of.iter().enumerate() {
            let slot = &mut self.starts[cell as usize + 1];
            self.rows[*slot as usize] = row as u32;
            *slot += 1;
        }
        let (rows, columns) = (&self.rows, if is_alike(p) { D } else { D + 1 });
        let needed = (columns * p.len()).div_ceil(LANES);
        if room.len() < needed {
            room.resize(needed, NOBODY);
        }
        for (d, column) in Record::flat_mut(room).chunks_exact_mut(p.len().max(1)).take(columns).enumerate() {
            if d < D {
                sweep(column, |i| p.x[rows[i] as usize][d]);
            } else {
                sweep(column, |i| p.h[rows[i] as usize]);
            }
        }
    }

    fn cell(&self, x: Vector<D>) -> [usize; D] {
        std::array::from_fn(|d| (((x[d] - self.min[d]) / self.edge) as usize).min(self.cells[d] - 1))
    }

    fn index(&self, cell: [usize; D]) -> u32 {
        (0..D).fold(0, |index, d| index * self.cells[d] + cell[d]) as u32
    }

    /// Appends the rows near a point that need not lie within the grid, `(position, smoothing length)`, of particles at `xs` with smoothing
    /// lengths `hs`, m.
    fn near_point(&self, xs: &[Vector<D>], hs: &[f64], (x, h): (Vector<D>, f64), support: f64, list: &mut Vec<u32>) {
        let cell = |d: usize| ((x[d] - self.min[d]) / self.edge).floor();
        if (0..D).any(|d| !(-1.0..=self.cells[d] as f64).contains(&cell(d))) {
            return;
        }
        let first: [usize; D] = std::array::from_fn(|d| (cell(d) - 1.0).max(0.0) as usize);
        let last = std::array::from_fn(|d| ((cell(d) + 1.0) as usize).min(self.cells[d] - 1));
        let mut row = first;
        loop {
            let near = |row: &u32| {
                let reach = support * (0.5 * (h + hs[*row as usize]));
                (x - xs[*row as usize]).norm_squared() <= reach * reach
            };
            list.extend(self.rows[self.run(row, last)].iter().copied().filter(near));
            if !next_run(&mut row, first, last) {
                break;
            }
        }
    }

    /// Where the particles of a row of cells along the last axis stand, from the cell `row` to that of `last`: one run.
    #[inline(always)]
    fn run(&self, row: [usize; D], last: [usize; D]) -> std::ops::Range<usize> {
        let mut end = row;
        end[D - 1] = last[D - 1];
        self.starts[self.index(row) as usize] as usize..self.starts[self.index(end) as usize + 1] as usize
    }

    fn bytes(&self) -> usize {
        4 * (self.starts.capacity() + self.cell_of.capacity() + self.rows.capacity())
    }
}

/// All who may be near the particles of a cell, around its middle and in single precision; columns of whole sixteens.
#[derive(Debug)]
struct Candidates<const D: usize> {
    /// The cell, and whether they are fluid alone.
    of: Option<(u32, bool)>,
    /// The middle of the cell, m.
    middle: Vector<D>,
    /// Positions from there, m.
    x: [Vec<f32>; D],
    /// Smoothing lengths where they differ, m.
    h: Vec<f32>,
    rows: Vec<u32>,
    /// How many they are; what stands behind them in the columns is anything.
    count: usize,
    /// Square distances are uncertain by so much, m².
    slack: f32,
    /// Room that the last list asked for.
    likely: usize,
}

/// Uncertainty of square distances, over the square of the edge of a cell. Positions within 1.5 edges of the middle are rounded by 2⁻²⁴ of that at the
/// most, and so are differences and squares: for two particles about an edge apart all of it together stays below 1.2e-6, smoothing lengths included.
const SLACK: f64 = 4e-6;

impl<const D: usize> Default for Candidates<D> {
    fn default() -> Self {
        let x = std::array::from_fn(|_| Vec::new());
        Self { of: None, middle: Vector::ZERO, x, h: Vec::new(), rows: Vec::new(), count: 0, slack: 0.0, likely: 0 }
    }
}

impl<const D: usize> Candidates<D> {
    /// Those around particle `a`; they stay while the cell does.
    #[inline(always)]
    fn gather(&mut self, sorted: &Sorted<'_, D>, p: &Particles<D>, a: usize, fluid_alone: bool) {
        let of = (sorted.grid.cell_of[a], fluid_alone);
        if self.of != Some(of) {
            self.of = Some(of);
            self.gather_around(sorted, p, sorted.grid.cell(p.x[a]), fluid_alone);
        }
    }

    #[inline(always)]
    fn gather_around(&mut self, sorted: &Sorted<'_, D>, p: &Particles<D>, home: [usize; D], fluid_alone: bool) {
        let Sorted { grid, columns, length, alike } = *sorted;
        let column = |d: usize| &columns[d * length..(d + 1) * length];
        self.slack = (SLACK * grid.edge * grid.edge) as f32;
        let (mut first, mut last) = (home, home);
        for d in 0..D {
            self.middle[d] = grid.min[d] + (home[d] as f64 + 0.5) * grid.edge;
            first[d] = home[d].saturating_sub(1);
            last[d] = (home[d] + 1).min(grid.cells[d] - 1);
        }
        self.count = 0;
        let mut row = first;
        loop {
            let run = grid.run(row, last);
            let start = self.count;
            self.make_room(start + run.len(), alike);
            if fluid_alone {
                for i in run.filter(|&i| p.is_fluid(grid.rows[i] as usize)) {
                    self.rows[self.count] = grid.rows[i];
                    for d in 0..D {
                        self.x[d][self.count] = (column(d)[i] - self.middle[d]) as f32;
                    }
                    if !alike {
                        self.h[self.count] = column(D)[i] as f32;
                    }
                    self.count += 1;
                }
            } else {
                self.count += run.len();
                self.rows[start..self.count].copy_from_slice(&grid.rows[run.clone()]);
                for d in 0..D {
                    narrowed(&column(d)[run.clone()], self.middle[d], &mut self.x[d][start..self.count]);
                }
                if !alike {
                    narrowed(&column(D)[run], 0.0, &mut self.h[start..self.count]);
                }
            }
            if !next_run(&mut row, first, last) {
                break;
            }
        }
    }

    /// Room for so many, and what fills up the last sixteen.
    #[inline(always)]
    fn make_room(&mut self, count: usize, alike: bool) {
        if self.rows.len() < count {
            let room = count.next_multiple_of(4 * WIDE);
            self.rows.resize(room, 0);
            self.x.iter_mut().for_each(|x| x.resize(room, 0.0));
            if !alike {
                self.h.resize(room, 0.0);
            }
        }
    }

    /// Appends those near `a`, a particle of the cell, sixteen at a time. Where single precision cannot tell, double precision decides.
    #[inline(always)]
    fn near<S: Singles>(&self, p: &Particles<D>, a: usize, support: f64, list: &mut Octets) {
        let x_a: [S; D] = std::array::from_fn(|d| S::splat((p.x[a][d] - self.middle[d]) as f32));
        let (h_a, half, slack) = (S::splat(p.h[a] as f32), S::splat((0.5 * support) as f32), S::splat(self.slack));
        let square_reach = |h: S| {
            let reach = h_a.plus(h).times(half);
            reach.times(reach)
        };
        let alike = square_reach(h_a);
        let xs: [&[[f32; WIDE]]; D] = std::array::from_fn(|d| self.x[d].as_chunks().0);
        let hs = self.h.as_chunks().0;
        let room = list.behind(self.count + 2 * WIDE);
        let mut found = 0;
        for (i, rows) in self.rows.as_chunks().0[..self.count.div_ceil(WIDE)].iter().enumerate() {
            let mut square = S::splat(0.0);
            for d in 0..D {
                let away = x_a[d].minus(S::from_array(&xs[d][i]));
                square = away.times_plus(away, square);
            }
            let reach = if hs.is_empty() { alike } else { square_reach(S::from_array(&hs[i])) };
            let mut near = !reach.plus(slack).below(square) & u16::MAX >> ((i + 1) * WIDE).saturating_sub(self.count);
            let clear = square.below(reach.minus(slack));
            if near & !clear != 0 {
                near = looked_at_again(p, a, support, (near, clear), rows);
            }
            let to = room[found..].first_chunk_mut().expect("room for sixteen more than there are candidates");
            // Nobody is its own neighbour.
            found += S::keep(near, a as u32, rows, to);
        }
        list.take(found);
    }
}

/// `to = from − middle`, in single precision.
#[inline(always)]
fn narrowed(from: &[f64], middle: f64, to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = (from - middle) as f32;
    }
}

/// Which of the rows that may be near `a` are; of those that clearly are nobody asks.
#[cold]
fn looked_at_again<const D: usize>(p: &Particles<D>, a: usize, support: f64, (near, clear): (u16, u16), rows: &[u32; WIDE]) -> u16 {
    let unclear = (0..WIDE).filter(|lane| (near & !clear) >> lane & 1 == 1);
    unclear.filter(|&lane| !sees(p, a, rows[lane] as usize, support)).fold(near, |near, lane| near & !(1 << lane))
}

/// The next row of cells between `first` and `last`; none after the last one.
#[inline(always)]
fn next_run<const D: usize>(row: &mut [usize; D], first: [usize; D], last: [usize; D]) -> bool {
    for axis in (0..D - 1).rev() {
        if row[axis] < last[axis] {
            row[axis] += 1;
            return true;
        }
        row[axis] = first[axis];
    }
    false
}

/// Smallest box around finite points, m; the origin for none.
fn bounds<const D: usize>(x: &[Vector<D>]) -> (Vector<D>, Vector<D>) {
    let Some(&first) = x.first() else { return (Vector::ZERO, Vector::ZERO) };
    x.iter().fold((first, first), |(min, max), &x| (min.zip(x, f64::min), max.zip(x, f64::max)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Domain;
    use crate::particles::Particle;

    fn particle<const D: usize>(x: Vector<D>, h: f64) -> Particle<D> {
        Particle { kind: Kind::Fluid, layer: 0, x, v: Vector::ZERO, mass: 1.0, density: 1.0, pressure: 0.0, h }
    }

    fn set<const D: usize>(points: impl IntoIterator<Item = (Vector<D>, f64)>) -> Particles<D> {
        let mut p = Particles::new();
        for (id, (x, h)) in points.into_iter().enumerate() {
            p.push(id as u32, particle(x, h));
        }
        p
    }

    /// Numbers in [0, 1) from a fixed sequence.
    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    fn sorted<const D: usize>(near: &Neighbors<D>, n: usize) -> Vec<Vec<u32>> {
        (0..n)
            .map(|a| {
                let mut list = near.of(a).to_vec();
                list.sort_unstable();
                list
            })
            .collect()
    }

    fn same_pairs<const D: usize>(p: &Particles<D>, support: f64) {
        let (mut direct, mut grid) = (Neighbors::new(), Neighbors::new());
        direct.build(p, support, Search::Direct).unwrap();
        grid.build(p, support, Search::Grid).unwrap();
        assert_eq!(sorted(&direct, p.owned()), sorted(&grid, p.owned()));
        for a in 0..p.owned() {
            for &b in grid.of(a) {
                let b = b as usize;
                assert!(b >= p.owned() || grid.of(b).contains(&(a as u32)), "pair {a}, {b} is seen from one side only");
            }
        }
    }

    #[test]
    fn grid_and_direct_search_find_the_same_pairs_when_h_differs() {
        let mut next = random(3);
        let plane = set((0..900).map(|_| (Vector([next(), next()]), 0.02 + 0.03 * next())));
        same_pairs(&plane, 2.0);
        let space = set((0..900).map(|_| (Vector([next(), next(), next()]), 0.05 + 0.05 * next())));
        same_pairs(&space, 3.0);
    }

    #[test]
    fn walls_behind_the_first_line_can_do_with_fluid_and_others_lose_nobody() {
        let mut next = random(7);
        let mut p = set((0..600).map(|_| (Vector([next(), next()]), 0.03 + 0.02 * next())));
        for a in 0..600 {
            (p.kind[a], p.layer[a]) = if a % 3 == 0 { (Kind::Fluid, 0) } else { (Kind::Wall, 1 + (a % 2) as u8) };
        }
        let mut all = Neighbors::new();
        all.build(&p, 2.0, Search::Direct).unwrap();
        for search in [Search::Direct, Search::Grid] {
            let (mut near, mut room) = (Neighbors::new(), Vec::new());
            near.list(&p, 2.0, search, BehindWalls::Fluid, &mut room).unwrap();
            let mut expected = sorted(&all, 600);
            for (a, list) in expected.iter_mut().enumerate() {
                list.retain(|&b| p.layer[a] < 2 || p.is_fluid(b as usize));
            }
            assert_eq!(sorted(&near, 600), expected, "{search:?}");
            assert!(near.pairs() < all.pairs());
        }
    }

    #[test]
    fn rows_that_are_kept_have_their_neighbours_and_values_and_others_give_back_their_room() {
        let mut next = random(13);
        let p = set((0..900).map(|_| (Vector([next(), next()]), 0.03)));
        let (mut near, mut column) = (Neighbors::new(), PairColumn::default());
        near.build(&p, 2.0, Search::Grid).unwrap();
        near.fill(&mut column, |a, pair| 1e3 * a as f64 + pair.b as f64);
        let (before, full, bytes, pairs) = (near.clone(), column.clone(), near.bytes() + column.bytes(), near.pairs());
        // One row in five, and none at all of the second block.
        let kept = |a: usize| a % 5 == 2 && !(BLOCK..2 * BLOCK).contains(&a);
        near.keep(&mut column, false, kept);
        let all_of = |near: &Neighbors<2>, column: &PairColumn, a| {
            let mut found = Vec::new();
            near.for_each_with(a, column, |b, _, value| found.push((b, value)));
            found
        };
        for a in 0..900 {
            let expected = if (BLOCK..2 * BLOCK).contains(&a) { Vec::new() } else { all_of(&before, &full, a) };
            assert_eq!(all_of(&near, &column, a), expected, "row {a}, whole blocks");
        }
        near.keep(&mut column, true, kept);
        for a in 0..900 {
            let expected = if kept(a) { all_of(&before, &full, a) } else { Vec::new() };
            assert_eq!(all_of(&near, &column, a), expected, "row {a}");
        }
        assert!(near.bytes() + column.bytes() < bytes / 2, "{} of {bytes} bytes", near.bytes() + column.bytes());
        assert_eq!(near.pairs(), pairs);
        near.build(&p, 2.0, Search::Grid).unwrap();
        assert_eq!(sorted(&near, 900), sorted(&before, 900));
    }

    /// Lattice points lie exactly on cell faces and exactly at the reach.
    #[test]
    fn lattices_on_cell_faces_lose_no_pair_near_the_origin_and_far_from_it() {
        for origin in [0.0, 1e6] {
            let lattice = set((0..20).flat_map(|i| (0..20).map(move |j| (Vector([origin + f64::from(i), f64::from(j)]), 1.0))));
            same_pairs(&lattice, 2.0);
            let mut near = Neighbors::new();
            near.build(&lattice, 2.0, Search::Grid).unwrap();
            // 12 lattice points lie within a distance of 2, those at exactly 2 included.
            assert_eq!(near.of(10 * 20 + 10).len(), 12);
        }
    }

    /// Pairs a rounding of double precision nearer and farther than the reach, in units in which single precision is exact to a millionth, holds
    /// zeros alone, or overflows.
    #[test]
    fn what_single_precision_cannot_tell_is_decided_in_double() {
        let mut next = random(11);
        for unit in [1.0, 1e-30, 1e30] {
            for alike in [true, false] {
                let pairs = (0..200).flat_map(|i| {
                    // Ten reaches apart, and turned: the distance of a pair is made of roots.
                    let (corner, turn) = (Vector([f64::from(i % 20), f64::from(i / 20)]), 0.1 * next());
                    let distance = 2.0 * (1.0 + f64::from(i % 3 - 1) * 1e-15);
                    let x = 20.0 * corner;
                    [x, x + Vector([distance * turn.cos(), distance * turn.sin()])]
                });
                let p = set(pairs.enumerate().map(|(i, x)| (unit * x, if alike || i % 4 < 2 { unit } else { 0.5 * unit })));
                same_pairs(&p, 2.0);
                let mut near = Neighbors::new();
                near.build(&p, 2.0, Search::Grid).unwrap();
                // Each from both sides; those of half the smoothing length are too far apart, and a third of the others by a rounding.
                let (seen, close) = (near.pairs() / 2, if alike { 200 } else { 100 });
                assert!((close / 3..close).contains(&seen), "{seen} of {close} pairs are seen");
            }
        }
    }

    #[test]
    fn a_periodic_box_sees_across_its_faces_even_when_it_is_two_cells_wide() {
        let mut next = random(5);
        for edge in [1.0, 0.45] {
            let mut p = set((0..300).map(|_| (Vector([edge * next(), next()]), 0.1)));
            let mut domain = Domain::new(Vector::ZERO, Vector([edge, 1.0]), [true, true]);
            domain.refresh(&mut p, 0.2);
            same_pairs(&p, 2.0);
            let mut near = Neighbors::new();
            near.build(&p, 2.0, Search::Grid).unwrap();
            let expected: usize = (0..300).map(|a| images_within(&p, a, edge, 0.2)).sum();
            assert_eq!(near.pairs(), expected);
        }
    }

    /// Images of all particles within `reach` of particle `a`, counted over enough copies of the box.
    fn images_within(p: &Particles<2>, a: usize, edge: f64, reach: f64) -> usize {
        let mut count = 0;
        for b in 0..p.owned() {
            for (i, j) in (-2..=2).flat_map(|i| (-2..=2).map(move |j| (i, j))) {
                let image = p.x[b] + Vector([f64::from(i) * edge, f64::from(j)]);
                count += usize::from((a, 0, 0) != (b, i, j) && (p.x[a] - image).norm_squared() <= reach * reach);
            }
        }
        count
    }

    #[test]
    fn empty_sets_and_outliers_are_no_trouble() {
        same_pairs(&set::<2>([]), 2.0);
        let mut next = random(7);
        let outlier = (Vector([1e9, -1e9]), 0.1);
        same_pairs(&set((0..200).map(|_| (Vector([next(), next()]), 0.1)).chain([outlier])), 2.0);
    }

    #[test]
    fn positions_that_are_not_finite_are_named() {
        let p = set([(Vector([0.0, 0.0]), 0.1), (Vector([f64::NAN, 0.0]), 0.1)]);
        assert_eq!(Neighbors::new().build(&p, 2.0, Search::Grid), Err(SearchError::NotFinite { particle: 1 }));
    }

    #[test]
    fn lists_are_the_same_for_any_number_of_threads() {
        let mut next = random(11);
        let p = set((0..3000).map(|_| (Vector([next(), next()]), 0.03)));
        let lists: Vec<Vec<Vec<u32>>> = [1, 2, 3]
            .map(|threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let mut near = Neighbors::new();
                pool.install(|| near.build(&p, 2.0, Search::Grid)).unwrap();
                (0..p.owned()).map(|a| near.of(a).to_vec()).collect()
            })
            .to_vec();
        assert_eq!(lists[0], lists[1]);
        assert_eq!(lists[0], lists[2]);
    }
}
