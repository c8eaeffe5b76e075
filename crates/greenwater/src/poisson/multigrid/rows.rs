//! Sparse matrices in single precision, and the products that make one level from another.

use rayon::prelude::*;

use crate::poisson::CsrMatrix;

/// Rows made or multiplied as one piece of work.
const ROWS: usize = 512;

/// Stored entries from which a product is shared among threads.
const SHARED_ENTRIES: usize = 50_000;

/// Row without an aggregate.
pub(super) const NONE: u32 = u32::MAX;

/// Marks rows that joined an aggregate late.
const JOINED: u32 = 1 << 31;

/// Rows of numbers in single precision, columns ascending.
#[derive(Debug, Default)]
pub(super) struct Rows {
    ends: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f32>,
    blocks: Vec<Block>,
}

/// Rows as they are gathered.
#[derive(Debug, Default)]
struct Block {
    ends: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f32>,
}

/// The row being gathered.
struct LastRow<'a> {
    block: &'a mut Block,
    start: usize,
}

impl LastRow<'_> {
    /// Adds to the entry in `column`.
    #[inline]
    fn add(&mut self, column: u32, value: f32) {
        let Block { columns, values, .. } = &mut *self.block;
        let mut at = columns.len();
        while at > self.start && columns[at - 1] > column {
            at -= 1;
        }
        if at > self.start && columns[at - 1] == column {
            values[at - 1] += value;
        } else {
            columns.insert(at, column);
            values.insert(at, value);
        }
    }
}

impl Rows {
    pub(super) fn rows(&self) -> usize {
        self.ends.len()
    }

    #[inline]
    pub(super) fn row(&self, i: usize) -> (&[u32], &[f32]) {
        let range = (if i == 0 { 0 } else { self.ends[i - 1] })..self.ends[i];
        (&self.columns[range.clone()], &self.values[range])
    }

    /// `Σ_j |a_ij|`.
    pub(super) fn sum_of_sizes(&self, i: usize) -> f32 {
        self.row(i).1.iter().map(|value| value.abs()).sum()
    }

    /// Takes over a matrix in double precision.
    pub(super) fn copy(&mut self, a: &CsrMatrix) {
        self.ends.clear();
        self.columns.clear();
        self.values.clear();
        for i in 0..a.rows() {
            let (columns, values) = a.row(i);
            self.columns.extend_from_slice(columns);
            self.values.extend(values.iter().map(|&value| value as f32));
            self.ends.push(self.columns.len());
        }
    }

    /// `out[i] = value(i, (A x)_i)`.
    pub(super) fn set(&self, x: &[f32], out: &mut [f32], value: impl Fn(usize, f32) -> f32 + Sync) {
        self.for_rows(x, out, |i, sum, out| *out = value(i, sum));
    }

    /// `r −= A x`.
    pub(super) fn subtract(&self, x: &[f32], r: &mut [f32]) {
        self.for_rows(x, r, |_, sum, r| *r -= sum);
    }

    fn for_rows(&self, x: &[f32], y: &mut [f32], set: impl Fn(usize, f32, &mut f32) + Sync) {
        let rows = |first: usize, y: &mut [f32]| {
            for (i, y) in y.iter_mut().enumerate() {
                let (columns, values) = self.row(first + i);
                let sum: f32 = columns.iter().zip(values).map(|(&j, a)| a * x[j as usize]).sum();
                set(first + i, sum, y);
            }
        };
        if self.columns.len() < SHARED_ENTRIES {
            rows(0, y);
        } else {
            y.par_chunks_mut(ROWS).enumerate().for_each(|(block, y)| rows(block * ROWS, y));
        }
    }

    /// Replaces the rows by `n` new ones; `fill(i, row)` adds to row `i`, columns in any order.
    fn gather(&mut self, n: usize, fill: impl Fn(usize, &mut LastRow) + Sync) {
        self.blocks.resize_with(n.div_ceil(ROWS), Block::default);
        self.blocks.par_iter_mut().enumerate().for_each(|(number, block)| {
            block.ends.clear();
            block.columns.clear();
            block.values.clear();
            for i in number * ROWS..n.min((number + 1) * ROWS) {
                let start = block.columns.len();
                fill(i, &mut LastRow { block, start });
                block.ends.push(block.columns.len());
            }
        });
        self.ends.clear();
        self.columns.clear();
        self.values.clear();
        for block in &self.blocks {
            let base = self.columns.len();
            self.ends.extend(block.ends.iter().map(|end| base + end));
            self.columns.extend_from_slice(&block.columns);
            self.values.extend_from_slice(&block.values);
        }
    }

    /// `(I − damping D⁻¹A) T` with `T` one where a row belongs to an aggregate.
    pub(super) fn smoothed(&mut self, a: &Rows, inverse: &[f32], damping: f32, aggregate: &[u32]) {
        self.gather(a.rows(), |i, row| {
            if aggregate[i] == NONE {
                return;
            }
            row.add(aggregate[i], 1.0);
            let (columns, values) = a.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                if aggregate[j as usize] != NONE {
                    row.add(aggregate[j as usize], -damping * inverse[i] * value);
                }
            }
        });
    }

    /// `left · right`.
    pub(super) fn product(&mut self, left: &Rows, right: &Rows) {
        self.gather(left.rows(), |i, row| {
            let (columns, values) = left.row(i);
            for (&k, &value) in columns.iter().zip(values) {
                let (columns, others) = right.row(k as usize);
                for (&j, &other) in columns.iter().zip(others) {
                    row.add(j, value * other);
                }
            }
        });
    }

    /// The transpose of `other`, which has `columns` columns.
    pub(super) fn transpose_of(&mut self, other: &Rows, columns: usize) {
        // Starts of the rows; filling moves each to its end.
        self.ends.clear();
        self.ends.resize(columns + 1, 0);
        other.columns.iter().for_each(|&j| self.ends[j as usize + 1] += 1);
        (0..columns).for_each(|j| self.ends[j + 1] += self.ends[j]);
        self.ends.pop();
        self.columns.clear();
        self.columns.resize(other.columns.len(), 0);
        self.values.clear();
        self.values.resize(other.columns.len(), 0.0);
        for i in 0..other.rows() {
            let (columns, values) = other.row(i);
            for (&j, &value) in columns.iter().zip(values) {
                let at = &mut self.ends[j as usize];
                self.columns[*at] = i as u32;
                self.values[*at] = value;
                *at += 1;
            }
        }
    }
}

/// Numbers the aggregate of each row, and answers how many there are. Rows connected to no other belong to none.
pub(super) fn aggregate(a: &Rows, aggregate: &mut Vec<u32>) -> usize {
    let n = a.rows();
    aggregate.clear();
    aggregate.resize(n, NONE);
    let mut count = 0u32;
    let others = |i: usize| a.row(i).0.iter().map(|&j| j as usize).filter(move |&j| j != i);
    // Whole neighbourhoods that nothing has touched yet.
    for i in 0..n {
        if aggregate[i] == NONE && others(i).next().is_some() && others(i).all(|j| aggregate[j] == NONE) {
            aggregate[i] = count;
            others(i).for_each(|j| aggregate[j] = count);
            count += 1;
        }
    }
    // What is left joins the aggregate it is tied to most, of those that are there now: none grows by chains.
    let whole = count;
    for i in 0..n {
        if aggregate[i] == NONE {
            let (columns, values) = a.row(i);
            let mut most = (0.0, NONE);
            for (&j, &value) in columns.iter().zip(values) {
                let of = aggregate[j as usize];
                if of < whole && value.abs() > most.0 {
                    most = (value.abs(), of);
                }
            }
            if most.1 != NONE {
                aggregate[i] = JOINED | most.1;
            }
        }
    }
    aggregate.iter_mut().filter(|of| **of != NONE).for_each(|of| *of &= !JOINED);
    // Remnants beside none.
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
