//! Sums of rows that gather, `Σ_k w_k x[c_k]`, for sixteen rows at once: the loop in which iterative solvers spend their time.
//!
//! Rows are stored in slices of sixteen, entry by entry, so that the lanes of a vector unit are rows: no sum runs across lanes, and a
//! row adds its terms in the order they were stored in. Multiplication and addition round separately; every instruction set gives
//! the same bits. Beside `lanes` and a call of the dense elimination the only `unsafe` code of the library: gathers do not check their
//! indices, and the columns of [`Slices`] are below a bound that every call compares with the length of what it gathers from.

use std::hint::black_box;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Rows of a slice.
pub const LANES: usize = 16;

/// A number for each row of a slice, on a cache line of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes<T>(pub [T; LANES]);

impl<T: Copy + Default> Default for Lanes<T> {
    fn default() -> Self {
        Self([T::default(); LANES])
    }
}

/// The columns of rows, sixteen rows a slice. Where a row is shorter than the longest of its slice, it is filled up with a column of another
/// one; weights there are to be zero.
#[derive(Clone, Debug, Default)]
pub struct Slices {
    /// Where each slice ends in `columns`.
    ends: Vec<u32>,
    columns: Columns,
    /// Above every column.
    bound: usize,
}

/// Columns that lie near each other, as those of rows in the order of space do, take half the memory, which sums wait for.
#[derive(Clone, Debug)]
enum Columns {
    /// From the number on, which lies before the first of them by half of what two bytes hold.
    Near(u32, Vec<Narrow>),
    Far(Vec<Lanes<u32>>),
}

impl Default for Columns {
    fn default() -> Self {
        Self::Near(0, Vec::new())
    }
}

/// A short number for each row of a slice, on half a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
struct Narrow([u16; LANES]);

/// An entry of each row of a slice: sixteen columns, aligned to their size.
trait Entry {
    /// Whether a column takes two bytes, not four.
    const NARROW: bool;

    fn column(&self, lane: usize) -> u32;
}

impl Entry for Narrow {
    const NARROW: bool = true;

    #[inline(always)]
    fn column(&self, lane: usize) -> u32 {
        u32::from(self.0[lane])
    }
}

impl Entry for Lanes<u32> {
    const NARROW: bool = false;

    #[inline(always)]
    fn column(&self, lane: usize) -> u32 {
        self.0[lane]
    }
}

/// `$sum` with the entries of `$slices` as they are stored, and with `$x` from the first of their columns on.
macro_rules! with_entries {
    ($slices:expr, $x:ident, |$columns:ident| $sum:expr) => {
        match &$slices.columns {
            Columns::Near(low, $columns) => {
                let $x = &$x[*low as usize..];
                $sum
            }
            Columns::Far($columns) => $sum,
        }
    };
}

/// `$run` of the module of a way.
macro_rules! by {
    ($way:expr, $run:ident($($argument:expr),*)) => {
        match $way {
            // SAFETY: ways are of this processor; columns are below `bound`, which callers compare with the length of `x`, and fit indices.
            #[cfg(target_arch = "x86_64")]
            Way::Avx512 => unsafe { avx512::$run($($argument),*) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Way::Avx2 => unsafe { avx2::$run($($argument),*) },
            Way::Portable => portable::$run($($argument),*),
        }
    };
}

impl Slices {
    /// Forgets all rows; storage stays.
    pub fn clear(&mut self) {
        self.ends.clear();
        match &mut self.columns {
            Columns::Near(low, columns) => {
                // Rows without an entry may follow, and read nothing of any `x`.
                *low = 0;
                columns.clear();
            }
            Columns::Far(columns) => columns.clear(),
        }
        self.bound = 0;
    }

    /// Appends an entry to each row of the slice that is open: this column, until [set](Self::set) to another one.
    #[inline]
    pub fn grow(&mut self, column: u32) {
        if self.entries() == 0 {
            let near = if let Columns::Near(_, near) = std::mem::take(&mut self.columns) { near } else { Vec::new() };
            self.columns = Columns::Near(column.saturating_sub(1 << 15), near);
        }
        match &mut self.columns {
            Columns::Near(low, columns) => {
                let near = u16::try_from(column.wrapping_sub(*low));
                columns.push(Narrow([near.unwrap_or(0); LANES]));
                if near.is_err() {
                    let last = columns.len() - 1;
                    (0..LANES).for_each(|lane| self.set(last, lane, column));
                }
            }
            Columns::Far(columns) => columns.push(Lanes([column; LANES])),
        }
    }

    /// Sets the column of a lane in an entry.
    #[inline(always)]
    pub fn set(&mut self, entry: usize, lane: usize, column: u32) {
        self.bound = self.bound.max(column as usize + 1);
        if let Columns::Near(low, columns) = &mut self.columns {
            if let Ok(near) = u16::try_from(column.wrapping_sub(*low)) {
                columns[entry].0[lane] = near;
                return;
            }
            self.columns = Columns::Far(columns.iter().map(|near| Lanes(near.0.map(|column| *low + u32::from(column)))).collect());
        }
        if let Columns::Far(columns) = &mut self.columns {
            columns[entry].0[lane] = column;
        }
    }

    /// Ends the slice that is open.
    pub fn close(&mut self) {
        // Gathers take 32-bit indices with a sign.
        assert!(self.bound < i32::MAX as usize, "column {} does not fit an index", self.bound - 1);
        self.ends.push(self.entries() as u32);
    }

    /// Room for so many entries.
    pub fn reserve(&mut self, entries: usize) {
        match &mut self.columns {
            Columns::Near(_, columns) => columns.reserve_exact(entries),
            Columns::Far(columns) => columns.reserve_exact(entries),
        }
    }

    /// Gives back room for more than so many entries.
    pub fn shrink_to(&mut self, entries: usize) {
        match &mut self.columns {
            Columns::Near(_, columns) => columns.shrink_to(entries),
            Columns::Far(columns) => columns.shrink_to(entries),
        }
    }

    /// Entries of a row and of those beside it, of all slices.
    fn entries(&self) -> usize {
        match &self.columns {
            Columns::Near(_, columns) => columns.len(),
            Columns::Far(columns) => columns.len(),
        }
    }

    /// The columns of row `lane` of slice `s`.
    #[inline]
    pub fn row(&self, s: usize, lane: usize) -> impl Iterator<Item = u32> + '_ {
        // One of the two is empty.
        let (low, near, far): (u32, &[Narrow], &[Lanes<u32>]) = match &self.columns {
            Columns::Near(low, columns) => (*low, &columns[self.range(s)], &[]),
            Columns::Far(columns) => (0, &[], &columns[self.range(s)]),
        };
        near.iter().map(move |columns| low + columns.column(lane)).chain(far.iter().map(move |columns| columns.column(lane)))
    }

    /// Columns and weights `w` of row `lane` of slice `s`, but for weights of zero, as a list: for loops to which an iterator would be dear.
    #[inline]
    pub fn unpack(&self, s: usize, lane: usize, w: &[Lanes<f32>], entries: &mut Vec<(u32, f32)>) {
        let range = self.range(s);
        match &self.columns {
            Columns::Near(low, columns) => unpack(&columns[range.clone()], *low, &w[range], lane, entries),
            Columns::Far(columns) => unpack(&columns[range.clone()], 0, &w[range], lane, entries),
        }
    }

    /// The entries of slice `s`.
    pub fn range(&self, s: usize) -> std::ops::Range<usize> {
        (if s == 0 { 0 } else { self.ends[s - 1] as usize })..self.ends[s] as usize
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let columns = match &self.columns {
            Columns::Near(_, columns) => size_of::<Narrow>() * columns.capacity(),
            Columns::Far(columns) => size_of::<Lanes<u32>>() * columns.capacity(),
        };
        4 * self.ends.capacity() + columns
    }

    /// `Σ_k w_k x[c_k]` of every row, for each of several weights; `out` have an entry for each lane of each slice.
    #[inline]
    pub fn spread<const S: usize>(&self, w: [&[Lanes<f32>]; S], x: &[f32], out: [&mut [f32]; S]) {
        assert!(x.len() >= self.bound, "columns up to {} of {} values", self.bound, x.len());
        with_entries!(self, x, |columns| by!(Way::fastest(), spread_all(self, columns, w, x, out)));
    }

    /// `Σ_k Σ_s w_sk x[c_k]_s` of every row.
    #[inline]
    pub fn join<const S: usize>(&self, w: [&[Lanes<f32>]; S], x: &[[f32; S]], out: &mut [f32]) {
        assert!(x.len() >= self.bound, "columns up to {} of {} values", self.bound, x.len());
        assert!(x.len() * S < i32::MAX as usize, "{} values of {S} numbers do not fit an index", x.len());
        with_entries!(self, x, |columns| by!(Way::fastest(), join_all(self, columns, w, x, out)));
    }

    /// `Σ_k w_k (x[c_k] − own)` of the rows of slice `s` for each of several weights, in double precision.
    #[inline]
    pub fn rise<const S: usize>(&self, s: usize, w: [&[Lanes<f32>]; S], x: &[f64], own: &Lanes<f64>) -> [Lanes<f64>; S] {
        let range = self.range(s);
        let w = w.map(|w| &w[range.clone()]);
        assert!(x.len() >= self.bound, "columns up to {} of {} values", self.bound, x.len());
        with_entries!(self, x, |columns| by!(Way::fastest(), rise(&columns[range], w, x, own)))
    }

    /// `Σ_k (x[c_k]_i − own_i) w_jk` of the rows of slice `s` for all `i` and `j`, in double precision.
    #[inline]
    pub fn strain<const S: usize>(&self, s: usize, w: [&[Lanes<f32>]; S], x: &[[f64; S]], own: &[Lanes<f64>; S]) -> [[Lanes<f64>; S]; S] {
        let range = self.range(s);
        let w = w.map(|w| &w[range.clone()]);
        assert!(x.len() >= self.bound, "columns up to {} of {} values", self.bound, x.len());
        assert!(x.len() * S < i32::MAX as usize, "{} values of {S} numbers do not fit an index", x.len());
        with_entries!(self, x, |columns| by!(Way::fastest(), strain(&columns[range], w, x, own)))
    }

    /// `Σ_k w_k x[c_k]` of every row, summed in double precision.
    #[inline]
    pub fn sum(&self, w: &[Lanes<f32>], x: &[f64], out: &mut [f64]) {
        assert!(x.len() >= self.bound, "columns up to {} of {} values", self.bound, x.len());
        with_entries!(self, x, |columns| by!(Way::fastest(), sum_all(self, columns, w, x, out)));
    }
}

/// See [`Slices::unpack`]; columns are stored from `low` on.
fn unpack<C: Entry>(columns: &[C], low: u32, w: &[Lanes<f32>], lane: usize, entries: &mut Vec<(u32, f32)>) {
    entries.resize(columns.len(), (0, 0.0));
    let mut count = 0;
    for (column, w) in columns.iter().zip(w) {
        let weight = w.0[lane];
        entries[count] = (low + column.column(lane), weight);
        count += usize::from(weight != 0.0);
    }
    entries.truncate(count);
}

/// What sums are made with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// Gathers and sums of AVX-512.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// Numbers loaded one by one, sums of AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
}

impl Way {
    /// Those of this machine.
    fn available() -> Vec<Self> {
        let mut ways = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx2") {
                ways.push(Self::Avx512);
            }
            if is_x86_feature_detected!("avx2") {
                ways.push(Self::Avx2);
            }
        }
        ways.push(Self::Portable);
        ways
    }

    /// The one that is fastest here. What gathers cost differs several times between processors that have them, so that a clock chooses,
    /// once; it may, because all ways give the same bits.
    #[inline(always)]
    fn fastest() -> Self {
        static FASTEST: OnceLock<Way> = OnceLock::new();
        *FASTEST.get_or_init(|| Trial::new().choose(&Self::available()))
    }
}

/// Sums as `isph` has them in a plane, to tell the ways apart by.
struct Trial {
    slices: Slices,
    weights: [Vec<Lanes<f32>>; 2],
}

impl Trial {
    const SLICES: usize = 64;
    const ENTRIES: usize = 20;

    /// Rows whose columns lie around them.
    fn new() -> Self {
        let (mut slices, rows) = (Slices::default(), Self::SLICES * LANES);
        for first in (0..rows).step_by(LANES) {
            for k in 0..Self::ENTRIES {
                slices.grow(first as u32);
                let entry = slices.entries() - 1;
                (0..LANES).for_each(|lane| slices.set(entry, lane, ((first + lane + 37 * k) % rows) as u32));
            }
            slices.close();
        }
        let weight = vec![Lanes([0.5; LANES]); Self::SLICES * Self::ENTRIES];
        Self { slices, weights: [weight.clone(), weight] }
    }

    fn run(&self, way: Way) {
        let Self { slices, weights } = self;
        let rows = Self::SLICES * LANES;
        let (one, two, wide) = (vec![1.0; rows], vec![[1.0; 2]; rows], vec![[1.0; 2]; rows]);
        let (mut out, w) = (vec![0.0; rows], [weights[0].as_slice(), weights[1].as_slice()]);
        // Rows are fewer than two bytes tell apart.
        if let Columns::Near(_, columns) = &slices.columns {
            by!(way, spread_all(slices, columns, [w[0]], &one, [&mut out]));
            by!(way, join_all(slices, columns, w, &two, &mut out));
            for s in 0..Self::SLICES {
                let (range, own) = (slices.range(s), [Lanes([0.0; LANES]); 2]);
                let w = w.map(|w| &w[range.clone()]);
                black_box(by!(way, strain(&columns[range], w, &wide, &own)));
            }
        }
        black_box(out);
    }

    /// The way whose quickest run of several is the quickest.
    fn choose(&self, ways: &[Way]) -> Way {
        let mut least = vec![Duration::MAX; ways.len()];
        for _ in 0..5 {
            for (&way, least) in ways.iter().zip(&mut least) {
                let start = Instant::now();
                self.run(way);
                *least = start.elapsed().min(*least);
            }
        }
        let quickest = (0..ways.len()).min_by_key(|&i| least[i]);
        quickest.map_or(Way::Portable, |i| ways[i])
    }
}

/// Loops over all slices, compiled for the instructions of the functions they call.
macro_rules! all_slices {
    ($(#[$feature:meta])* $($unsafe:ident)?) => {
        /// # Safety
        /// Columns are below `x.len()` and `i32::MAX`, and the processor has the instructions.
        $(#[$feature])*
        pub(super) $($unsafe)? fn spread_all<C: Entry, const S: usize>(
            slices: &super::Slices,
            columns: &[C],
            w: [&[Lanes<f32>]; S],
            x: &[f32],
            mut out: [&mut [f32]; S],
        ) {
            for s in 0..slices.ends.len() {
                let range = slices.range(s);
                let mut part = w;
                part.iter_mut().for_each(|w| *w = &w[range.clone()]);
                // SAFETY: as the caller promises.
                #[allow(unused_unsafe)]
                let sums = unsafe { spread(&columns[range], part, x) };
                for (out, sums) in out.iter_mut().zip(&sums) {
                    out[s * LANES..][..LANES].copy_from_slice(&sums.0);
                }
            }
        }

        /// # Safety
        /// Columns are below `x.len()`, and `S` times that fits 31 bits, and the processor has the instructions.
        $(#[$feature])*
        pub(super) $($unsafe)? fn join_all<C: Entry, const S: usize>(
            slices: &super::Slices,
            columns: &[C],
            w: [&[Lanes<f32>]; S],
            x: &[[f32; S]],
            out: &mut [f32],
        ) {
            for s in 0..slices.ends.len() {
                let range = slices.range(s);
                let mut part = w;
                part.iter_mut().for_each(|w| *w = &w[range.clone()]);
                // SAFETY: as the caller promises.
                #[allow(unused_unsafe)]
                let sums = unsafe { join(&columns[range], part, x) };
                out[s * LANES..][..LANES].copy_from_slice(&sums.0);
            }
        }

        /// # Safety
        /// Columns are below `x.len()` and `i32::MAX`, and the processor has the instructions.
        $(#[$feature])*
        pub(super) $($unsafe)? fn sum_all<C: Entry>(slices: &super::Slices, columns: &[C], w: &[Lanes<f32>], x: &[f64], out: &mut [f64]) {
            for s in 0..slices.ends.len() {
                let range = slices.range(s);
                // SAFETY: as the caller promises.
                #[allow(unused_unsafe)]
                let sums = unsafe { sum(&columns[range.clone()], &w[range], x) };
                out[s * LANES..][..LANES].copy_from_slice(&sums.0);
            }
        }
    };
}

mod portable;

#[cfg(target_arch = "x86_64")]
mod avx512;

#[cfg(target_arch = "x86_64")]
mod avx2;

#[cfg(test)]
mod tests {
    use super::*;

    /// As a block of rows whose particles have parted from all others, in a matrix that has become smaller.
    #[test]
    fn rows_without_an_entry_read_nothing_wherever_those_before_them_did() {
        let (mut slices, _) = slice(100_000, 0);
        slices.clear();
        slices.close();
        let mut out = [1.0; LANES];
        slices.sum(&[], &[0.0; LANES], &mut out);
        assert_eq!(out, [0.0; LANES]);
    }

    /// Sixteen rows of different lengths over 100 columns from `first` on, but for one that is `far` behind it, and two weights of each entry.
    fn slice(first: u32, far: u32) -> (Slices, [Vec<Lanes<f32>>; 2]) {
        let rows: Vec<Vec<u32>> = (0..LANES as u32).map(|i| (0..5 + i % 4).map(|k| first + (i * 37 + k * 11) % 100).collect()).collect();
        let mut slices = Slices::default();
        let longest = rows.iter().map(Vec::len).max().unwrap();
        (0..longest).for_each(|_| slices.grow(first));
        for (lane, row) in rows.iter().enumerate() {
            row.iter().enumerate().for_each(|(k, &column)| slices.set(k, lane, column));
        }
        if far > 0 {
            slices.set(1, 2, first + far);
        }
        slices.close();
        let weights = [0.1f32, -0.7].map(|scale| {
            let weight = |k: usize, lane: usize| if k < rows[lane].len() { scale * (1.0 + k as f32) / (2.0 + lane as f32) } else { 0.0 };
            (0..longest).map(|k| Lanes(std::array::from_fn(|lane| weight(k, lane)))).collect()
        });
        (slices, weights)
    }

    #[test]
    fn every_instruction_set_gives_the_bits_of_the_portable_loop() {
        for far in [0, 1 << 17] {
            let (slices, w) = slice(40_000, far);
            match &slices.columns {
                Columns::Near(low, columns) if far == 0 => compare(&slices, columns, *low as usize, &w),
                Columns::Far(columns) if far > 0 => compare(&slices, columns, 0, &w),
                columns => panic!("{columns:?}"),
            }
        }
    }

    /// `columns` are those of `slices`, stored from `low` on.
    fn compare<C: Entry>(slices: &Slices, columns: &[C], low: usize, w: &[Vec<Lanes<f32>>; 2]) {
        let (n, w) = (slices.bound, [w[0].as_slice(), w[1].as_slice()]);
        let x: Vec<f32> = (0..n).map(|i| (i as f32 * 0.37).sin()).collect();
        let pairs: Vec<[f32; 2]> = (0..n).map(|i| [(i as f32 * 0.61).cos(), 0.1 * i as f32]).collect();
        let wide: Vec<f64> = x.iter().map(|&x| f64::from(x) / 3.0).collect();
        type Run<'a> = &'a dyn Fn(&mut [f32; LANES], &mut [f32; LANES], &mut [f32; LANES], &mut [f64; LANES]);
        let results = |run: Run| {
            let (mut a, mut b, mut c, mut d) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
            run(&mut a, &mut b, &mut c, &mut d);
            (a, b, c, d)
        };
        let by_way = |way: Way| {
            results(&|a, b, c, d| {
                by!(way, spread_all(slices, columns, w, &x[low..], [a, b]));
                by!(way, join_all(slices, columns, w, &pairs[low..], c));
                by!(way, sum_all(slices, columns, w[0], &wide[low..], d));
            })
        };
        let own = [Lanes([0.25; LANES]), Lanes(std::array::from_fn(|lane| lane as f64))];
        let wide_pairs: Vec<[f64; 2]> = pairs.iter().map(|pair| pair.map(f64::from)).collect();
        let expected = by_way(Way::Portable);
        for way in Way::available() {
            assert_eq!(by_way(way), expected, "{way:?}");
            let rise = by!(way, rise(columns, w, &wide[low..], &own[1]));
            assert_eq!(rise, portable::rise(columns, w, &wide[low..], &own[1]), "{way:?}");
            let strain = by!(way, strain(columns, w, &wide_pairs[low..], &own));
            assert_eq!(strain, portable::strain(columns, w, &wide_pairs[low..], &own), "{way:?}");
        }
        let fastest = results(&|a, b, c, d| {
            slices.spread(w, &x, [a, b]);
            slices.join(w, &pairs, c);
            slices.sum(w[0], &wide, d);
        });
        assert_eq!(fastest, expected);
        assert_eq!(slices.rise(0, w, &wide, &own[1]), portable::rise(columns, w, &wide[low..], &own[1]));
        assert_eq!(slices.strain(0, w, &wide_pairs, &own), portable::strain(columns, w, &wide_pairs[low..], &own));
        let sum: f32 = slices.row(0, 3).zip(w[0]).map(|(column, w)| w.0[3] * x[column as usize]).sum();
        assert_eq!(expected.0[3], sum);
        let mut unpacked = vec![(7, 7.0)];
        slices.unpack(0, 3, w[0], &mut unpacked);
        let entries = slices.row(0, 3).zip(w[0]).map(|(column, w)| (column, w.0[3]));
        assert!(unpacked.iter().copied().eq(entries.filter(|&(_, w)| w != 0.0)), "{unpacked:?}");
    }

    #[test]
    fn the_way_is_one_of_this_machine() {
        let trial = Trial::new();
        assert!(
            matches!(&trial.slices.columns, Columns::Near(0, columns) if columns.len() == Trial::SLICES * Trial::ENTRIES),
            "nothing is timed"
        );
        assert_eq!(trial.choose(&[Way::Portable]), Way::Portable);
        assert!(Way::available().contains(&trial.choose(&Way::available())));
    }

    #[test]
    #[should_panic(expected = "columns up to")]
    fn columns_beyond_the_values_are_refused() {
        let (slices, w) = slice(0, 0);
        slices.spread([&w[0]], &[0.0; 50], [&mut [0.0; LANES]]);
    }
}
