//! Symmetric matrices of pressure equations in slices of rows: what iterations on many rows are fastest with.

use std::ops::Range;

use rayon::prelude::*;

use crate::gather::{LANES, Lanes, Slices};
use crate::sweep::trim;

/// Rows built or multiplied as one piece of work: whole slices.
pub const ROWS: usize = 32 * LANES;

/// Rows of a turn.
const TURN: usize = 64 * ROWS;

/// Entries from which a product is shared among threads.
const SHARED_ENTRIES: usize = 30_000;

/// The matrix `(A x)_i = d_i x_i − Σ_j w_ij x_j`, with weights `w` in single precision and the diagonal `d` in double.
///
/// Rounded weights define the matrix; a row whose diagonal is summed from rounded weights keeps its sum to double precision. Each entry may
/// carry further weights, its *arms*, which belong to whoever [fills](Self::fill) the matrix and share its columns. Memory: 6 bytes an entry where
/// the columns of a block of rows lie near each other, else 8; 4 more for each arm.
#[derive(Clone, Debug, Default)]
pub struct Sliced {
    rows: usize,
    /// Beside the diagonal.
    entries: usize,
    blocks: Vec<Block>,
    /// `d`.
    diagonal: Vec<f64>,
    /// `1/Σ_j |a_ij|`.
    inverse: Vec<f32>,
}

/// [`ROWS`] rows.
#[derive(Clone, Debug, Default)]
struct Block {
    slices: Slices,
    weights: Vec<Lanes<f32>>,
    entries: usize,
    /// Length of `weights` before room was [given back](Sliced::let_go).
    likely: usize,
}

/// Further weights of the entries of a [`Sliced`] matrix, `S` each.
#[derive(Clone, Debug)]
pub struct Arms<const S: usize> {
    blocks: Vec<ArmBlock<S>>,
    /// Sum of the squares of the arms of each row.
    squares: Vec<f32>,
}

impl<const S: usize> Arms<S> {
    /// `Σ_j Σ_s arm_s,ij²`.
    pub fn square(&self, i: usize) -> f32 {
        self.squares[i]
    }
}

#[derive(Clone, Debug)]
struct ArmBlock<const S: usize> {
    arms: [Vec<Lanes<f32>>; S],
}

impl<const S: usize> Default for Arms<S> {
    fn default() -> Self {
        Self { blocks: Vec::new(), squares: Vec::new() }
    }
}

impl<const S: usize> Default for ArmBlock<S> {
    fn default() -> Self {
        Self { arms: std::array::from_fn(|_| Vec::new()) }
    }
}

/// The row being filled.
pub struct SlicedRow<'a, const S: usize> {
    slices: &'a mut Slices,
    weights: &'a mut Vec<Lanes<f32>>,
    arms: &'a mut [Vec<Lanes<f32>>; S],
    lane: usize,
    /// Where the next entry goes.
    next: usize,
    /// Sums of the sizes of the weights, and of the squares of the arms.
    size: f32,
    square: f32,
}

impl<const S: usize> SlicedRow<'_, S> {
    /// Adds an entry; a column may come more than once, and may be the row's own.
    #[inline(always)]
    pub fn push(&mut self, column: usize, weight: f32, arms: [f32; S]) {
        if self.next == self.weights.len() {
            self.slices.grow(column as u32);
            self.weights.push(Lanes::default());
            self.arms.iter_mut().for_each(|arm| arm.push(Lanes::default()));
        }
        self.slices.set(self.next, self.lane, column as u32);
        self.weights[self.next].0[self.lane] = weight;
        self.size += weight.abs();
        for (to, arm) in self.arms.iter_mut().zip(arms) {
            to[self.next].0[self.lane] = arm;
            self.square += arm * arm;
        }
        self.next += 1;
    }
}

impl Sliced {
    /// Replaces the matrix by one of `n` rows. `fill(i, row)` pushes the entries of row `i` and answers its diagonal `d_i`, positive. Rows are
    /// filled in parallel over fixed blocks. Nothing is allocated once storage has grown. Panics if a column is not below `n`.
    pub fn fill<const S: usize>(&mut self, n: usize, arms: &mut Arms<S>, fill: impl Fn(usize, &mut SlicedRow<S>) -> f64 + Sync) {
        self.begin(n, arms);
        self.fill_rows(0..n, arms, fill);
    }

    /// Begins a matrix of `n` rows, whose [turns](Self::turns) are to be [filled](Self::fill_rows) in order: for those who have something to give
    /// back meanwhile.
    pub fn begin<const S: usize>(&mut self, n: usize, arms: &mut Arms<S>) {
        (self.rows, self.entries) = (n, 0);
        self.blocks.resize_with(n.div_ceil(ROWS), Block::default);
        arms.blocks.resize_with(n.div_ceil(ROWS), ArmBlock::default);
        self.diagonal.resize(n, 0.0);
        self.inverse.resize(n, 0.0);
        arms.squares.resize(n, 0.0);
    }

    /// The rows of each turn.
    pub fn turns(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let n = self.rows;
        (0..n).step_by(TURN).map(move |first| first..n.min(first + TURN))
    }

    /// Fills rows, as [`fill`](Self::fill) does all of them.
    pub fn fill_rows<const S: usize>(
        &mut self,
        rows: Range<usize>,
        arms: &mut Arms<S>,
        fill: impl Fn(usize, &mut SlicedRow<S>) -> f64 + Sync,
    ) {
        let of = rows.start / ROWS..rows.end.div_ceil(ROWS);
        let (diagonal, inverse, squares) =
            (&mut self.diagonal[rows.clone()], &mut self.inverse[rows.clone()], &mut arms.squares[rows.clone()]);
        let numbers = diagonal.par_chunks_mut(ROWS).zip(inverse.par_chunks_mut(ROWS)).zip(squares.par_chunks_mut(ROWS));
        let blocks = self.blocks[of.clone()].par_iter_mut().zip(&mut arms.blocks[of.clone()]).zip(numbers).enumerate();
        blocks.for_each(|(number, ((block, arms), ((diagonal, inverse), squares)))| {
            let number = of.start + number;
            let Block { slices, weights, entries, likely } = block;
            slices.clear();
            weights.clear();
            arms.arms.iter_mut().for_each(Vec::clear);
            *entries = 0;
            if *likely > 0 {
                let room = *likely + *likely / 32;
                slices.reserve(room);
                weights.reserve_exact(room);
                arms.arms.iter_mut().for_each(|arm| arm.reserve_exact(room));
                *likely = 0;
            }
            for first in (0..diagonal.len()).step_by(LANES) {
                let start = weights.len();
                for (lane, at) in (first..diagonal.len().min(first + LANES)).enumerate() {
                    let arms = &mut arms.arms;
                    let mut row = SlicedRow { slices, weights, arms, lane, next: start, size: 0.0, square: 0.0 };
                    let d = fill(number * ROWS + at, &mut row);
                    let SlicedRow { next, size, square, .. } = row;
                    *entries += next - start;
                    diagonal[at] = d;
                    inverse[at] = 1.0 / (d.abs() as f32 + size);
                    squares[at] = square;
                }
                slices.close();
            }
            trim(weights);
            slices.shrink_to(weights.capacity());
            arms.arms.iter_mut().for_each(trim);
        });
        self.entries += self.blocks[of].iter().map(|block| block.entries).sum::<usize>();
    }

    /// Gives back the room of all entries: the matrix is nothing until it is filled again.
    pub fn let_go<const S: usize>(&mut self, arms: &mut Arms<S>) {
        for (block, arms) in self.blocks.iter_mut().zip(&mut arms.blocks) {
            let likely = block.weights.len().max(block.likely);
            *block = Block { likely, ..Block::default() };
            *arms = ArmBlock::default();
        }
        (self.rows, self.entries) = (0, 0);
    }

    /// Gives each row `i` the diagonal `diagonal(i, Σ_j w_ij)`, positive.
    pub fn replace_diagonal(&mut self, diagonal: impl Fn(usize, f64) -> f64) {
        for i in 0..self.rows {
            let (sum, size) = self.row(i).fold((0.0, 0.0), |(sum, size), (_, weight)| (sum + f64::from(weight), size + weight.abs()));
            self.diagonal[i] = diagonal(i, sum);
            self.inverse[i] = 1.0 / (self.diagonal[i].abs() as f32 + size);
        }
    }

    /// Replaces the matrix by one of `n` rows and any number of columns without a diagonal, for [`weigh`](Self::weigh).
    pub(super) fn fill_wide(&mut self, n: usize, fill: impl Fn(usize, &mut SlicedRow<0>) + Sync) {
        self.fill(n, &mut Arms::default(), |i, row| {
            fill(i, row);
            0.0
        });
        (self.diagonal, self.inverse) = (Vec::new(), Vec::new());
    }

    /// Number of rows (and columns).
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of entries beside the diagonal.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// `d_i`.
    pub fn diagonal(&self, i: usize) -> f64 {
        self.diagonal[i]
    }

    /// `1/Σ_j |a_ij|` of each row.
    pub(super) fn inverse(&self) -> &[f32] {
        &self.inverse
    }

    /// Whether a product is worth more than one thread.
    pub fn is_shared(&self) -> bool {
        self.rows > ROWS && self.entries >= SHARED_ENTRIES
    }

    /// The entries of row `i` beside the diagonal, `(j, w_ij)`.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let (block, s, lane) = (&self.blocks[i / ROWS], i % ROWS / LANES, i % LANES);
        let entries = block.slices.row(s, lane).zip(&block.weights[block.slices.range(s)]);
        // What fills a row up has no weight.
        entries.map(move |(column, weights)| (column, weights.0[lane])).filter(|&(_, weight)| weight != 0.0)
    }

    /// The same as a list.
    #[inline]
    pub(super) fn unpack(&self, i: usize, entries: &mut Vec<(u32, f32)>) {
        let block = &self.blocks[i / ROWS];
        block.slices.unpack(i % ROWS / LANES, i % LANES, &block.weights, entries);
    }

    /// `set(i, (Σ_j w_ij x_j)_i, y_i)` for runs `i` of rows, in single precision.
    pub(super) fn weigh<T: Send>(&self, x: &[f32], y: &mut [T], set: impl Fn(Range<usize>, &[f32], &mut [T]) + Sync) {
        self.by_block(y, |number, y| {
            let block = &self.blocks[number];
            let mut sums = [0.0; ROWS];
            block.slices.spread([&block.weights], x, [&mut sums]);
            let first = number * ROWS;
            set(first..first + y.len(), &sums[..y.len()], y);
        });
    }

    /// `A x` of the rows of a block, in single precision.
    fn product<'a>(&self, number: usize, rows: usize, x: &[f32], sums: &'a mut [f32; ROWS]) -> (Range<usize>, &'a [f32]) {
        let (block, first) = (&self.blocks[number], number * ROWS);
        block.slices.spread([&block.weights], x, [&mut *sums]);
        let at = first..first + rows;
        let sums = &mut sums[..rows];
        for ((sum, diagonal), x) in sums.iter_mut().zip(&self.diagonal[at.clone()]).zip(&x[at.clone()]) {
            *sum = *diagonal as f32 * x - *sum;
        }
        (at, sums)
    }

    /// `set(i, (A x)_i, y_i, z_i)` for runs `i` of rows, in single precision.
    pub(super) fn with_single2<T: Send, U: Send>(
        &self,
        x: &[f32],
        y: &mut [T],
        z: &mut [U],
        set: impl Fn(Range<usize>, &[f32], &mut [T], &mut [U]) + Sync,
    ) {
        assert!(y.len() == self.rows && z.len() == self.rows, "product of a matrix and vectors of another size");
        let rows = |number: usize, y: &mut [T], z: &mut [U]| {
            let mut sums = [0.0; ROWS];
            let (at, ax) = self.product(number, y.len(), x, &mut sums);
            set(at, ax, y, z);
        };
        if self.is_shared() {
            y.par_chunks_mut(ROWS).zip(z.par_chunks_mut(ROWS)).enumerate().for_each(|(number, (y, z))| rows(number, y, z));
        } else {
            y.chunks_mut(ROWS).zip(z.chunks_mut(ROWS)).enumerate().for_each(|(number, (y, z))| rows(number, y, z));
        }
    }

    /// `set(i, (A x)_i, y_i)` for runs `i` of rows, in single precision.
    pub(super) fn with_single<T: Send>(&self, x: &[f32], y: &mut [T], set: impl Fn(Range<usize>, &[f32], &mut [T]) + Sync) {
        self.by_block(y, |number, y| {
            let mut sums = [0.0; ROWS];
            let (at, ax) = self.product(number, y.len(), x, &mut sums);
            set(at, ax, y);
        });
    }

    /// `set((A x)_i, &mut y_i)` for every row.
    pub(super) fn with_double(&self, x: &[f64], y: &mut [f64], set: impl Fn(f64, &mut f64) + Sync) {
        self.by_block(y, |number, y| {
            let block = &self.blocks[number];
            let mut sums = [0.0; ROWS];
            block.slices.sum(&block.weights, x, &mut sums);
            let at = number * ROWS..number * ROWS + y.len();
            for (((y, sum), diagonal), x) in y.iter_mut().zip(&sums).zip(&self.diagonal[at.clone()]).zip(&x[at]) {
                set(diagonal * x - sum, y);
            }
        });
    }

    /// `set(i, (Σ_j arm_s,ij x_j)_s, &mut y_i)` for every row.
    pub fn with_arms<const S: usize, T: Send>(&self, arms: &Arms<S>, x: &[f32], y: &mut [T], set: impl Fn(usize, [f32; S], &mut T) + Sync) {
        self.by_block(y, |number, y| {
            let (block, arms) = (&self.blocks[number], &arms.blocks[number]);
            let mut sums = [[0.0; ROWS]; S];
            block.slices.spread(std::array::from_fn(|s| arms.arms[s].as_slice()), x, sums.each_mut().map(|sums| sums.as_mut_slice()));
            for (k, y) in y.iter_mut().enumerate() {
                set(number * ROWS + k, std::array::from_fn(|s| sums[s][k]), y);
            }
        });
    }

    /// `set(i, Σ_j Σ_s arm_s,ij x_j,s, &mut y_i)` for every row.
    pub fn join_arms<const S: usize, T: Send>(&self, arms: &Arms<S>, x: &[[f32; S]], y: &mut [T], set: impl Fn(usize, f32, &mut T) + Sync) {
        self.by_block(y, |number, y| {
            let (block, arms) = (&self.blocks[number], &arms.blocks[number]);
            let mut sums = [0.0; ROWS];
            block.slices.join(std::array::from_fn(|s| arms.arms[s].as_slice()), x, &mut sums);
            for (k, (y, sum)) in y.iter_mut().zip(sums).enumerate() {
                set(number * ROWS + k, sum, y);
            }
        });
    }

    /// `set(i, (Σ_j arm_s,ij (x_j − x_i))_s, &mut y_i)` for every row, in double precision.
    #[inline]
    pub fn rise<const S: usize, T: Send>(&self, arms: &Arms<S>, x: &[f64], y: &mut [T], set: impl Fn(usize, [f64; S], &mut T) + Sync) {
        self.by_block(y, |number, y| {
            let (block, arms) = (&self.blocks[number], &arms.blocks[number]);
            let arms: [&[Lanes<f32>]; S] = std::array::from_fn(|s| arms.arms[s].as_slice());
            for (s, y) in y.chunks_mut(LANES).enumerate() {
                let first = number * ROWS + s * LANES;
                let own = Lanes(std::array::from_fn(|lane| x[(first + lane).min(self.rows - 1)]));
                let sums = block.slices.rise(s, arms, x, &own);
                for (lane, y) in y.iter_mut().enumerate() {
                    set(first + lane, std::array::from_fn(|s| sums[s].0[lane]), y);
                }
            }
        });
    }

    /// `set((Σ_j (x_j,k − x_i,k) arm_l,ij)_kl, &mut y_i)` for every row, in double precision.
    pub fn strain<const S: usize, T: Send>(&self, arms: &Arms<S>, x: &[[f64; S]], y: &mut [T], set: impl Fn([[f64; S]; S], &mut T) + Sync) {
        self.by_block(y, |number, y| {
            let (block, arms) = (&self.blocks[number], &arms.blocks[number]);
            let arms: [&[Lanes<f32>]; S] = std::array::from_fn(|s| arms.arms[s].as_slice());
            for (s, y) in y.chunks_mut(LANES).enumerate() {
                let first = number * ROWS + s * LANES;
                let own = std::array::from_fn(|k| Lanes(std::array::from_fn(|lane| x[(first + lane).min(self.rows - 1)][k])));
                let sums = block.slices.strain(s, arms, x, &own);
                for (lane, y) in y.iter_mut().enumerate() {
                    set(std::array::from_fn(|k| std::array::from_fn(|l| sums[k][l].0[lane])), y);
                }
            }
        });
    }

    fn by_block<T: Send>(&self, y: &mut [T], block: impl Fn(usize, &mut [T]) + Sync) {
        assert_eq!(y.len(), self.rows, "product of a matrix and a vector of another size");
        if self.is_shared() {
            y.par_chunks_mut(ROWS).enumerate().for_each(|(number, y)| block(number, y));
        } else {
            y.chunks_mut(ROWS).enumerate().for_each(|(number, y)| block(number, y));
        }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let blocks: usize = self.blocks.iter().map(|b| b.slices.bytes() + size_of::<Lanes<f32>>() * b.weights.capacity()).sum();
        blocks + 8 * self.diagonal.capacity() + 4 * self.inverse.capacity()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_that_was_let_go_is_filled_turn_by_turn_as_at_once() {
        // Two turns and a bit; rows of one to four entries.
        let n = 2 * TURN + 100;
        let fill = |i: usize, row: &mut SlicedRow<2>| {
            (0..1 + i % 4).for_each(|k| row.push((i + 7 * k) % n, 0.5 + k as f32, [i as f32, k as f32]));
            10.0 + i as f64
        };
        let (mut at_once, mut arms_at_once) = (Sliced::default(), Arms::default());
        at_once.fill(n, &mut arms_at_once, fill);
        let (mut a, mut arms) = (at_once.clone(), arms_at_once.clone());
        a.let_go(&mut arms);
        assert!(a.bytes() < at_once.bytes() / 2, "{} of {} bytes", a.bytes(), at_once.bytes());
        a.begin(n, &mut arms);
        let mut ends = Vec::new();
        for rows in a.turns() {
            ends.push(rows.end);
            a.fill_rows(rows, &mut arms, fill);
        }
        assert_eq!(ends, [TURN, 2 * TURN, n]);
        assert_eq!(a.entries(), at_once.entries());
        let x: Vec<f64> = (0..n).map(|i| (0.1 * i as f64).sin()).collect();
        let rises = |a: &Sliced, arms: &Arms<2>| {
            let mut rises = vec![[0.0; 2]; n];
            a.rise(arms, &x, &mut rises, |_, rise, out| *out = rise);
            rises
        };
        assert_eq!(rises(&a, &arms), rises(&at_once, &arms_at_once));
        for i in (0..n).step_by(997) {
            assert!(
                a.row(i).eq(at_once.row(i)) && a.diagonal(i) == at_once.diagonal(i) && arms.square(i) == arms_at_once.square(i),
                "row {i}"
            );
        }
    }
}
