//! Sparse matrices in single precision, and the products that make one level from another.

use std::ops::Range;
use std::sync::Mutex;

use rayon::prelude::*;

use crate::poisson::sliced::Sliced;
use crate::sweep::trim;

/// Rows made as one piece of work.
const ROWS: usize = 512;

/// Rows of a level from which one band of the next is made: what two bands need both is computed twice, more of it the narrower they are, and
/// memory matters where rows are many.
const BAND: usize = 1 << 17;

/// Row without an aggregate.
pub(super) const NONE: u32 = u32::MAX;

/// Marks rows that joined an aggregate late.
const JOINED: u32 = 1 << 31;

/// Rows of numbers in single precision; each column once a row, in the order in which they came.
#[derive(Debug, Default)]
pub(super) struct Rows {
    rows: usize,
    blocks: Vec<Block>,
}

#[derive(Debug, Default)]
struct Block {
    ends: Vec<u32>,
    /// Column and value.
    entries: Vec<(u32, f32)>,
}

/// The row being gathered.
struct LastRow<'a> {
    entries: &'a mut Vec<(u32, f32)>,
    row: u32,
    sums: &'a mut [(u32, f32)],
}

impl LastRow<'_> {
    /// Adds to the entry in `column`.
    #[inline(always)]
    fn add(&mut self, column: u32, value: f32) {
        let (row, sum) = &mut self.sums[column as usize];
        if *row == self.row {
            *sum += value;
        } else {
            (*row, *sum) = (self.row, value);
            self.entries.push((column, 0.0));
        }
    }
}

/// What each thread gathers with, kept from use to use.
#[derive(Debug, Default)]
pub(super) struct Workspaces(Vec<Mutex<Workspace>>);

#[derive(Debug, Default)]
struct Workspace {
    /// How many rows were gathered.
    rows: u32,
    /// The last of them that had an entry in each column, and its sum there.
    sums: Vec<(u32, f32)>,
    /// Room for a row of another matrix.
    room: Vec<(u32, f32)>,
}

impl Workspaces {
    fn prepare(&mut self) {
        self.0.resize_with(rayon::current_num_threads() + 1, Mutex::default);
    }

    fn with<T>(&self, columns: usize, work: impl FnOnce(&mut Workspace) -> T) -> T {
        let thread = rayon::current_thread_index().map_or(0, |thread| thread + 1);
        // A thread that panicked has left nothing that matters here.
        let mut workspace = self.0[thread].lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if workspace.sums.len() < columns {
            workspace.sums.resize(columns, (0, 0.0));
        }
        work(&mut workspace)
    }
}

/// Fills the blocks of rows `rows`; `fill(i, row, room)` adds to row `i`.
fn gather(
    blocks: &mut [Block],
    rows: Range<usize>,
    columns: usize,
    work: &mut Workspaces,
    fill: impl Fn(usize, &mut LastRow, &mut Vec<(u32, f32)>) + Sync,
) {
    work.prepare();
    let work = &*work;
    blocks.par_iter_mut().enumerate().for_each(|(number, block)| {
        work.with(columns, |Workspace { rows: gathered, sums, room }| {
            block.ends.clear();
            block.entries.clear();
            let first = rows.start + number * ROWS;
            for i in first..rows.end.min(first + ROWS) {
                let start = block.entries.len();
                *gathered += 1;
                fill(i, &mut LastRow { entries: &mut block.entries, row: *gathered, sums }, room);
                block.entries[start..].iter_mut().for_each(|(column, value)| *value = sums[*column as usize].1);
                block.ends.push(block.entries.len() as u32);
            }
            trim(&mut block.entries);
        });
    });
}

impl Rows {
    #[inline]
    fn row(&self, i: usize) -> &[(u32, f32)] {
        let (block, at) = (&self.blocks[i / ROWS], i % ROWS);
        let start = if at == 0 { 0 } else { block.ends[at - 1] as usize };
        &block.entries[start..block.ends[at] as usize]
    }

    /// Replaces the rows by `n` new ones; `fill(i, row, room)` adds to row `i`.
    fn gather(&mut self, n: usize, columns: usize, work: &mut Workspaces, fill: impl Fn(usize, &mut LastRow, &mut Vec<(u32, f32)>) + Sync) {
        self.rows = n;
        self.blocks.resize_with(n.div_ceil(ROWS), Block::default);
        gather(&mut self.blocks, 0..n, columns, work, fill);
    }

    /// `(I − damping S⁻¹F) T` with `T` one where a row belongs to one of `count` aggregates, `F` the matrix `A` with its weak ties added to the diagonal, and `S` the
    /// sums of the sizes of its rows, above its eigenvalues.
    pub(super) fn smoothed(&mut self, a: &Sliced, strength: f64, damping: f32, aggregate: &[u32], count: usize, work: &mut Workspaces) {
        self.gather(a.rows(), count, work, |i, row, ties| {
            if aggregate[i] == NONE {
                return;
            }
            let least = strength * strength * a.diagonal(i);
            let (mut diagonal, mut size) = (a.diagonal(i) as f32, 0.0);
            a.unpack(i, ties);
            ties.retain(|&(j, weight)| {
                let strong = f64::from(weight) * f64::from(weight) > least * a.diagonal(j as usize);
                if strong {
                    size += weight.abs()
                } else {
                    diagonal -= weight
                }
                strong
            });
            let scale = damping / (diagonal.abs() + size);
            row.add(aggregate[i], 1.0 - scale * diagonal);
            for &(j, weight) in &*ties {
                if aggregate[j as usize] != NONE {
                    row.add(aggregate[j as usize], scale * weight);
                }
            }
        });
    }

    /// `Pᵀ A P`, with `P` in `right` and its transpose in `left`. Bands of rows one after the other: of `A P`, the largest matrix of all, only what a
    /// band needs is there at a time.
    pub(super) fn product_of_level(&mut self, left: &Rows, a: &Sliced, right: &Rows, work: &mut Workspaces) {
        let n = left.rows;
        self.rows = n;
        self.blocks.resize_with(n.div_ceil(ROWS), Block::default);
        let (mut needed, mut product) = (Vec::new(), Rows::default());
        let blocks_of_band = self.blocks.len().div_ceil(a.rows().div_ceil(BAND).max(1)).max(1);
        for (band, blocks) in self.blocks.chunks_mut(blocks_of_band).enumerate() {
            let first = band * blocks_of_band * ROWS;
            let rows = first..n.min(first + blocks.len() * ROWS);
            needed.clear();
            needed.resize(a.rows(), false);
            rows.clone().for_each(|i| left.row(i).iter().for_each(|&(k, _)| needed[k as usize] = true));
            product.gather(a.rows(), n, work, |i, row, entries| {
                if needed[i] {
                    let diagonal = a.diagonal(i) as f32;
                    right.row(i).iter().for_each(|&(j, other)| row.add(j, diagonal * other));
                    a.unpack(i, entries);
                    for &(k, weight) in &*entries {
                        right.row(k as usize).iter().for_each(|&(j, other)| row.add(j, -weight * other));
                    }
                }
            });
            gather(blocks, rows, n, work, |i, row, _| {
                for &(k, value) in left.row(i) {
                    product.row(k as usize).iter().for_each(|&(j, other)| row.add(j, value * other));
                }
            });
        }
    }

    /// The transpose of `other`, which has `columns` columns.
    pub(super) fn transpose_of(&mut self, other: &Rows, columns: usize) {
        self.rows = columns;
        self.blocks.resize_with(columns.div_ceil(ROWS), Block::default);
        for (number, block) in self.blocks.iter_mut().enumerate() {
            block.ends.clear();
            block.ends.resize(ROWS.min(columns - number * ROWS), 0);
        }
        // Lengths, then starts of the rows; filling moves each to its end.
        for block in &other.blocks {
            block.entries.iter().for_each(|&(j, _)| self.blocks[j as usize / ROWS].ends[j as usize % ROWS] += 1);
        }
        for block in &mut self.blocks {
            let mut start = 0;
            for end in &mut block.ends {
                (*end, start) = (start, start + *end);
            }
            block.entries.resize(start as usize, (0, 0.0));
        }
        for i in 0..other.rows {
            for &(j, value) in other.row(i) {
                let block = &mut self.blocks[j as usize / ROWS];
                let at = &mut block.ends[j as usize % ROWS];
                block.entries[*at as usize] = (i as u32, value);
                *at += 1;
            }
        }
    }

    /// The same in slices.
    pub(super) fn slice(&self, sliced: &mut Sliced) {
        sliced.fill_wide(self.rows, |i, row| self.row(i).iter().for_each(|&(j, value)| row.push(j as usize, value, [])));
    }

    /// The same as a square matrix in slices.
    pub(super) fn slice_square(&self, sliced: &mut Sliced) {
        sliced.fill(self.rows, &mut super::super::sliced::Arms::<0>::default(), |i, row| {
            let mut diagonal = 0.0;
            self.row(i).iter().for_each(|&(j, value)| if j as usize == i { diagonal = value } else { row.push(j as usize, -value, []) });
            f64::from(diagonal)
        });
    }
}

/// Numbers the aggregate of each row, and answers how many there are. Rows are tied where `|a_ij|` is above `strength · √(a_ii a_jj)`. Rows
/// connected to no other belong to none.
pub(super) fn aggregate(a: &Sliced, strength: f64, aggregate: &mut Vec<u32>) -> usize {
    let n = a.rows();
    aggregate.clear();
    aggregate.resize(n, NONE);
    let mut count = 0u32;
    let tied = |i: usize| {
        let least = strength * strength * a.diagonal(i);
        let others = a.row(i).map(|(j, weight)| (j as usize, f64::from(weight)));
        others.filter(move |&(j, weight)| j != i && weight * weight > least * a.diagonal(j)).map(|(j, _)| j)
    };
    // Whole neighbourhoods that nothing has touched yet.
    for i in 0..n {
        if aggregate[i] == NONE && tied(i).next().is_some() && tied(i).all(|j| aggregate[j] == NONE) {
            aggregate[i] = count;
            tied(i).for_each(|j| aggregate[j] = count);
            count += 1;
        }
    }
    // What is left joins the aggregate it is tied to most, of those that are there now: none grows by chains.
    let (whole, mut ties) = (count, Vec::new());
    for i in 0..n {
        if aggregate[i] == NONE {
            let mut most = (0.0, NONE);
            a.unpack(i, &mut ties);
            for &(j, weight) in &ties {
                let of = aggregate[j as usize];
                if of < whole && weight.abs() > most.0 {
                    most = (weight.abs(), of);
                }
            }
            if most.1 != NONE {
                aggregate[i] = JOINED | most.1;
            }
        }
    }
    aggregate.iter_mut().filter(|of| **of != NONE).for_each(|of| *of &= !JOINED);
    // Remnants beside none.
    let others = |i: usize| a.row(i).map(|(j, _)| j as usize).filter(move |&j| j != i);
    for i in 0..n {
        if aggregate[i] == NONE && others(i).next().is_some() {
            aggregate[i] = count;
            others(i).for_each(|j| {
                if aggregate[j] == NONE {
                    aggregate[j] = count;
                }
            });
            count += 1;
        }
    }
    count as usize
}
