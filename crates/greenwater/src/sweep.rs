//! Loops over all particles, in parallel, with the same bits for any number of threads: each row is written by one closure
//! call that only reads shared data, and rows are dealt out in fixed blocks. Where rows may differ in work, as walls do from fluid, blocks go
//! one or a few at a time.

use rayon::prelude::*;

/// Rows a thread takes at a time.
pub(crate) const BLOCK: usize = 256;

/// `change(start, rows)` for every block of rows. Loops over particles are many, and what threads need is more than they are: it is compiled once for
/// each type of row, not for each loop.
#[inline(never)]
fn blocks<T: Send>(rows: &mut [T], change: &(dyn Fn(usize, &mut [T]) + Sync)) {
    rows.par_chunks_mut(BLOCK).enumerate().with_max_len(1).for_each(|(block, rows)| change(block * BLOCK, rows));
}

/// What is done to a block of rows of two columns: `change(start, first, second)`.
type Change2<'a, T, U> = dyn Fn(usize, &mut [T], &mut [U]) + Sync + 'a;

/// `change(start, first, second)` for every block of rows of two columns of equal length.
#[inline(never)]
pub(crate) fn blocks2<T: Send, U: Send>(first: &mut [T], second: &mut [U], change: &Change2<'_, T, U>) {
    debug_assert_eq!(first.len(), second.len());
    let blocks = first.par_chunks_mut(BLOCK).zip(second.par_chunks_mut(BLOCK)).enumerate().with_max_len(1);
    blocks.for_each(|(block, (first, second))| change(block * BLOCK, first, second));
}

/// `out[a] = value(a)` for every row.
pub(crate) fn sweep<T: Send>(out: &mut [T], value: impl Fn(usize) -> T + Sync) {
    blocks(out, &|start, rows| {
        for (i, row) in rows.iter_mut().enumerate() {
            *row = value(start + i);
        }
    });
}

/// `out[a] = value(workspace, a)` for every row; a thread makes a workspace for each share of the rows it takes.
pub(crate) fn sweep_with<T: Send, W>(out: &mut [T], workspace: impl Fn() -> W + Sync + Send, value: impl Fn(&mut W, usize) -> T + Sync) {
    out.par_chunks_mut(BLOCK).enumerate().with_max_len(4).for_each_init(workspace, |workspace, (block, rows)| {
        for (i, row) in rows.iter_mut().enumerate() {
            *row = value(workspace, block * BLOCK + i);
        }
    });
}

/// `change(a, &mut column[a])` for every row.
pub(crate) fn update<T: Send>(column: &mut [T], change: impl Fn(usize, &mut T) + Sync) {
    blocks(column, &|start, rows| {
        for (i, row) in rows.iter_mut().enumerate() {
            change(start + i, row);
        }
    });
}

/// `change(a, &mut first[a], &mut second[a])` for every row.
pub(crate) fn update2<T: Send, U: Send>(first: &mut [T], second: &mut [U], change: impl Fn(usize, &mut T, &mut U) + Sync) {
    blocks2(first, second, &|start, ones, twos| {
        for (i, (one, two)) in ones.iter_mut().zip(twos).enumerate() {
            change(start + i, one, two);
        }
    });
}

/// `(first[a], second[a]) = values(a)` for every row.
pub(crate) fn sweep2<T: Send, U: Send>(first: &mut [T], second: &mut [U], values: impl Fn(usize) -> (T, U) + Sync) {
    blocks2(first, second, &|start, ones, twos| {
        for (i, (one, two)) in ones.iter_mut().zip(twos).enumerate() {
            (*one, *two) = values(start + i);
        }
    });
}

/// Makes a column these values, with little more room than they need.
pub(crate) fn replace<T>(column: &mut Vec<T>, values: impl ExactSizeIterator<Item = T>) {
    column.clear();
    let needed = values.len();
    if column.capacity() < needed || column.capacity() > needed + needed / 8 {
        *column = Vec::new();
        column.reserve_exact(needed + needed / 32);
    }
    column.extend(values);
}

/// Makes a column `n` rows long, new ones of `value`, with room for no more: columns grow little, and seldom, and doubling would keep twice the memory.
pub(crate) fn fit<T: Clone>(column: &mut Vec<T>, n: usize, value: T) {
    column.reserve_exact(n.saturating_sub(column.len()));
    column.resize(n, value);
}

/// Keeps the entries of `ranges`, which are in order, one behind the other, and gives back the room of all others.
pub(crate) fn keep_ranges<T: Copy>(column: &mut Vec<T>, ranges: &[std::ops::Range<usize>]) {
    let mut length = 0;
    for range in ranges {
        column.copy_within(range.clone(), length);
        length += range.len();
    }
    column.truncate(length);
    column.shrink_to_fit();
}

/// Gives back most of the room that a column which grew by doubling does not use.
pub(crate) fn trim<T>(column: &mut Vec<T>) {
    if column.capacity() > column.len() + column.len() / 8 {
        column.shrink_to(column.len() + column.len() / 32);
    }
}

/// The largest `value(a)` over `0..n`; `-∞` for none, NaN if any value is NaN.
pub(crate) fn largest(n: usize, value: impl Fn(usize) -> f64 + Sync + Send) -> f64 {
    largest_of(n.div_ceil(4 * BLOCK), &|block| {
        (4 * BLOCK * block..n.min(4 * BLOCK * (block + 1))).map(&value).fold(f64::NEG_INFINITY, larger)
    })
}

#[inline(never)]
fn largest_of(n: usize, value: &(dyn Fn(usize) -> f64 + Sync)) -> f64 {
    (0..n).into_par_iter().map(value).reduce(|| f64::NEG_INFINITY, larger)
}

/// The larger of two, NaN if one is.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}
