//! Several numbers at once: arithmetic with the vector units of the machine. Beside `gather` the only code that knows instruction sets,
//! and beside a call of the dense elimination the only one with `unsafe`.
//!
//! Formulas are written once, over [`Real`], and run on one number (`f64`) or on several of them. Sums over pairs take eight
//! neighbours at a time on every machine, part after part where registers are short, and add the lanes up in one order; where a
//! product is fused with a sum it is so on every machine: all instruction sets give the same bits.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::sweep::blocks2;

mod listed;
pub(crate) mod singles;

use self::portable::Portable;
use self::singles::Singles;

pub(crate) use self::listed::{Listed, Octets, Record};

/// Neighbours that lists keep together, and numbers in a record.
pub(crate) const LANES: usize = 8;

/// A number, or several that go through the same arithmetic.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// A yes or no for each number.
    type Mask: Copy;

    /// `x` everywhere.
    fn splat(x: f64) -> Self;

    /// Square root, rounded as IEEE 754 says.
    fn root(self) -> Self;

    /// `self * factor + term`, rounded once. For sums that run on vector units: without them it is a slow call on older machines.
    fn times_plus(self, factor: Self, term: Self) -> Self;

    /// The number without its sign.
    fn size(self) -> Self;

    /// The larger of two numbers; `other` where one is NaN.
    fn at_least(self, other: Self) -> Self;

    /// The smaller of two numbers; `other` where one is NaN.
    fn at_most(self, other: Self) -> Self;

    /// Whether `self < other`.
    fn below(self, other: Self) -> Self::Mask;

    /// `yes` where the mask says so, else `no`.
    fn choose(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// `f` of each number: for functions that vector units do not have.
    fn each(self, f: impl Fn(f64) -> f64) -> Self;
}

impl Real for f64 {
    type Mask = bool;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        x
    }

    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        self.mul_add(factor, term)
    }

    #[inline(always)]
    fn size(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    #[inline(always)]
    fn below(self, other: Self) -> bool {
        self < other
    }

    #[inline(always)]
    fn choose(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f64) -> f64) -> Self {
        f(self)
    }
}

/// A vector of [`COUNT`](Self::COUNT) numbers.
pub(crate) trait Lanes: Real {
    /// Numbers in it: [`LANES`], a half or a quarter of them.
    const COUNT: usize;

    /// What the same instructions make of single precision.
    type Singles: Singles;

    /// The numbers in order, as many as it holds.
    fn from_array(x: [f64; LANES]) -> Self;

    /// The numbers in order, and zeros where it holds no more.
    fn to_array(self) -> [f64; LANES];

    /// Field by field, what as many records hold.
    ///
    /// # Panics
    /// More rows or fewer.
    fn gather(listed: Listed<'_>) -> [Self; LANES];

    /// Number by number, what as many fours in single precision hold.
    fn turn(fours: [&[f32; 4]; LANES]) -> [Self; 4];

    /// The sum of all, by halves: of eight `((0+4) + (2+6)) + ((1+5) + (3+7))`.
    fn total(self) -> f64;

    /// The entries of a column at as many `rows`.
    ///
    /// # Panics
    /// A row beyond the column.
    #[inline(always)]
    fn pick(column: &[f64], rows: &[u32]) -> Self {
        let mut entries = [0.0; LANES];
        for lane in 0..Self::COUNT {
            entries[lane] = column[rows[lane] as usize];
        }
        Self::from_array(entries)
    }
}

/// What is added up lane by lane.
pub(crate) trait Totals: Copy {
    /// That of all neighbours, where those of the lower and of the upper lanes were added up apart.
    fn joined(self, high: Self) -> Self;
}

impl<L: Lanes> Totals for L {
    #[inline(always)]
    fn joined(self, high: Self) -> Self {
        self + high
    }
}

impl<T: Totals, const N: usize> Totals for [T; N] {
    #[inline(always)]
    fn joined(mut self, high: Self) -> Self {
        for i in 0..N {
            self[i] = self[i].joined(high[i]);
        }
        self
    }
}

impl<T: Totals, U: Totals> Totals for (T, U) {
    #[inline(always)]
    fn joined(self, high: Self) -> Self {
        (self.0.joined(high.0), self.1.joined(high.1))
    }
}

/// The operators of a type that has `plus`, `minus`, `times`, `over`.
macro_rules! operators {
    ($type:ty) => {
        operators!($type, Add, add, plus);
        operators!($type, Sub, sub, minus);
        operators!($type, Mul, mul, times);
        operators!($type, Div, div, over);

        impl Neg for $type {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                Self::splat(-0.0).minus(self)
            }
        }
    };
    ($type:ty, $trait:ident, $name:ident, $does:ident) => {
        impl $trait for $type {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.$does(other)
            }
        }

        impl $trait<f64> for $type {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f64) -> Self {
                self.$does(Self::splat(other))
            }
        }
    };
}

// Behind the macro that they use.
mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

/// The instructions that pair loops are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstructionSet {
    /// Eight numbers in a register.
    Avx512,
    /// Four numbers in a register.
    Avx2,
    /// What the compiler takes for granted on this machine: SSE2 on x86-64, NEON on ARM.
    Portable,
}

impl InstructionSet {
    /// The best one this machine has.
    pub fn of_this_machine() -> Self {
        Self::available().next().unwrap_or(Self::Portable)
    }

    /// Every one this machine has, the best first.
    pub fn available() -> impl Iterator<Item = Self> {
        [Self::Avx512, Self::Avx2, Self::Portable].into_iter().filter(|set| set.is_here())
    }

    /// Whether this machine has it.
    #[cfg(target_arch = "x86_64")]
    pub fn is_here(self) -> bool {
        match self {
            Self::Avx512 => {
                Self::Avx2.is_here()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
            }
            Self::Avx2 => {
                is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
                    && is_x86_feature_detected!("popcnt")
                    && is_x86_feature_detected!("bmi1")
                    && is_x86_feature_detected!("bmi2")
            }
            Self::Portable => true,
        }
    }

    /// Whether this machine has it.
    #[cfg(not(target_arch = "x86_64"))]
    pub fn is_here(self) -> bool {
        self == Self::Portable
    }

    /// Name, as people write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "AVX-512",
            Self::Avx2 => "AVX2",
            Self::Portable => "portable",
        }
    }
}

/// Something to do with vectors of any kind. `run` and all it calls in loops must be `#[inline(always)]`, and nothing there may be a
/// closure, which cannot be told to: only then are they compiled with the instructions they are dispatched to.
pub(crate) trait Job {
    /// Does it.
    fn run<L: Lanes>(self);
}

/// Runs `job` with the vectors of `set`, or portable ones if the machine does not have them.
pub(crate) fn dispatch<J: Job>(set: InstructionSet, job: J) {
    match set {
        // SAFETY: the machine was asked for exactly these instructions.
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx512 if set.is_here() => unsafe { on_avx512(job) },
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx2 if set.is_here() => unsafe { on_avx2(job) },
        _ => job.run::<Portable>(),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512vl,avx2,fma,popcnt,bmi1,bmi2")]
fn on_avx512<J: Job>(job: J) {
    job.run::<x86::Avx512>();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,popcnt,bmi1,bmi2")]
fn on_avx2<J: Job>(job: J) {
    job.run::<x86::Avx2>();
}

/// What is done to each row, written once for every kind of vector; `row` must be `#[inline(always)]`, see [`Job`].
pub(crate) trait Rows<T, U = ()>: Sync {
    /// Fills or changes row `a` of two columns.
    fn row<L: Lanes>(&self, a: usize, first: &mut T, second: &mut U);
}

/// Lets `rows` fill or change every row of two columns of equal length, in parallel, with the same bits for any number of threads and
/// on any machine.
pub(crate) fn sweep_lanes2<T: Send, U: Send, R: Rows<T, U>>(set: InstructionSet, first: &mut [T], second: &mut [U], rows: &R) {
    struct Block<'a, T, U, R> {
        start: usize,
        first: &'a mut [T],
        second: &'a mut [U],
        rows: &'a R,
    }

    impl<T, U, R: Rows<T, U>> Job for Block<'_, T, U, R> {
        #[inline(always)]
        fn run<L: Lanes>(self) {
            for (i, (first, second)) in self.first.iter_mut().zip(self.second).enumerate() {
                self.rows.row::<L>(self.start + i, first, second);
            }
        }
    }

    blocks2(first, second, &|start, first, second| dispatch(set, Block { start, first, second, rows }));
}

/// What is done to each row in two goes: a sum over its pairs, and what comes of it. The next row's sum does not wait for that. Both must be
/// `#[inline(always)]`, see [`Job`].
pub(crate) trait RowsOfSums<T, U>: Sync {
    /// What a sum adds up to.
    type Sum: Copy;

    /// That of rows without a sum.
    const NOTHING: Self::Sum;

    /// The sum of row `a`.
    fn sum<L: Lanes>(&self, a: usize, first: &T, second: &U) -> Self::Sum;

    /// Fills or changes row `a` of two columns.
    fn row(&self, a: usize, sum: Self::Sum, first: &mut T, second: &mut U);
}

/// As [`sweep_lanes2`], for sums and what comes of them.
pub(crate) fn sweep_sums<T: Send, U: Send, R: RowsOfSums<T, U>>(set: InstructionSet, first: &mut [T], second: &mut [U], rows: &R) {
    /// Rows that are summed up before anything comes of the first of them: some more than are on their way through the processor at once.
    const AHEAD: usize = 16;

    struct Block<'a, T, U, R> {
        start: usize,
        first: &'a mut [T],
        second: &'a mut [U],
        rows: &'a R,
    }

    impl<T, U, R: RowsOfSums<T, U>> Job for Block<'_, T, U, R> {
        #[inline(always)]
        fn run<L: Lanes>(self) {
            let mut start = self.start;
            for (first, second) in self.first.chunks_mut(AHEAD).zip(self.second.chunks_mut(AHEAD)) {
                let mut sums = [R::NOTHING; AHEAD];
                for (i, (sum, (first, second))) in sums.iter_mut().zip(first.iter().zip(second.iter())).enumerate() {
                    *sum = self.rows.sum::<L>(start + i, first, second);
                }
                for (i, (sum, (first, second))) in sums.iter().zip(first.iter_mut().zip(second)).enumerate() {
                    self.rows.row(start + i, *sum, first, second);
                }
                start += AHEAD;
            }
        }
    }

    blocks2(first, second, &|start, first, second| dispatch(set, Block { start, first, second, rows }));
}

/// As [`sweep_lanes2`], for one column.
pub(crate) fn sweep_lanes<T: Send, R: Rows<T>>(set: InstructionSet, out: &mut [T], rows: &R) {
    // Nothing is stored for rows of no size.
    let mut nothing = vec![(); out.len()];
    sweep_lanes2(set, out, &mut nothing, rows);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_their_numbers_one_behind_the_other() {
        let mut records = [Record([1.0; LANES]), Record(std::array::from_fn(|i| i as f64))];
        assert_eq!(Record::flat(&records)[LANES - 1..LANES + 2], [1.0, 0.0, 1.0]);
        Record::flat_mut(&mut records)[LANES + 1] = 7.0;
        assert_eq!(records[1].0[1], 7.0);
    }

    fn listed(rows: &[u32]) -> Octets {
        let mut octets = Octets::default();
        octets.begin(0);
        rows.iter().for_each(|&row| octets.push(row));
        octets.end();
        octets
    }

    #[test]
    fn lists_are_begun_anew_in_the_room_they_had() {
        let mut octets = listed(&[5; 400]);
        let bytes = octets.bytes();
        assert!((1600..=1700).contains(&bytes), "{bytes} bytes for 400 rows");
        octets.begin(0);
        octets.push(2);
        octets.fill_up(3);
        octets.behind(16)[..2].copy_from_slice(&[1, 7]);
        octets.take(1);
        octets.end();
        assert_eq!(octets.rows(), [2, 3, 3, 3, 3, 3, 3, 3, 1]);
        assert!(octets.bytes() < 200, "{} bytes for 9 rows", octets.bytes());
        // Of what was behind the last row nothing is known: 7 is beyond the records.
        assert_eq!(octets.of(0..LANES, &[Record::default(); 4]).count(), 1);
    }

    /// Every operation on lanes that hold values of all kinds, against the same on plain numbers.
    struct Everything<'a> {
        records: &'a [Record],
        out: &'a mut Vec<f64>,
    }

    impl Job for Everything<'_> {
        fn run<L: Lanes>(self) {
            let rows = [3, 0, 2, 1, 3, 3, 0, 2];
            let octets = listed(&rows);
            let eight = octets.of(0..LANES, self.records).next().unwrap();
            let parts: Vec<Vec<L>> = (0..LANES / L::COUNT).map(|part| everything(eight.part::<L>(part), part * L::COUNT)).collect();
            for i in 0..parts[0].len() {
                let mut sums: Vec<L> = parts.iter().map(|part| part[i]).collect();
                sums.iter().for_each(|part| self.out.extend(&part.to_array()[..L::COUNT]));
                while let half @ 1.. = sums.len() / 2 {
                    sums = (0..half).map(|part| sums[part].joined(sums[part + half])).collect();
                }
                self.out.push(sums[0].total());
            }
        }
    }

    /// The same, for as many records as a vector holds; their place among the eight is `first`.
    fn everything<L: Lanes>(listed: Listed<'_>, first: usize) -> Vec<L> {
        let fields = L::gather(listed);
        let fours: [[f32; 4]; LANES] = std::array::from_fn(|lane| std::array::from_fn(|i| (10 * (first + lane) + i) as f32));
        let turned = L::turn(fours.each_ref());
        let [a, b, ..] = fields;
        let results = [
            a + b,
            a - b,
            a * b,
            a / b,
            -a,
            a + 1.5,
            a - 1.5,
            a * 1.5,
            (a * a).root(),
            a.at_least(b),
            a.at_most(b),
            a.size(),
            a.times_plus(b, -a),
            L::choose(a.below(b), a, b),
            a.each(|x| x.abs() + 1.0),
            L::pick(&[1.0, 2.0, 3.0, 4.0], listed.rows()),
            L::splat(0.1),
        ];
        fields.into_iter().chain(turned).chain(results).collect()
    }

    fn all_of(set: InstructionSet) -> Vec<u64> {
        let records: Vec<Record> = (0..4)
            .map(|row| Record(std::array::from_fn(|field| f64::from(row * 8 + field as i32 - 9) * 0.37 * f64::from(1 - 2 * (row % 2)))))
            .collect();
        let mut out = Vec::new();
        dispatch(set, Everything { records: &records, out: &mut out });
        out.into_iter().map(f64::to_bits).collect()
    }

    #[test]
    fn all_instruction_sets_give_the_same_bits() {
        let portable = all_of(InstructionSet::Portable);
        for set in InstructionSet::available() {
            assert_eq!(all_of(set), portable, "{}", set.name());
        }
    }

    #[test]
    fn lanes_hold_the_records_in_order_and_add_up_by_halves() {
        let records: Vec<Record> = (0..9).map(|row| Record(std::array::from_fn(|field| f64::from(10 * row) + field as f64))).collect();
        let octets = listed(&[8, 1, 2, 3, 4, 5, 6, 7]);
        let eight = octets.of(0..LANES, &records).next().unwrap();
        let parts: [Portable; 4] = std::array::from_fn(|part| Portable::gather(eight.part::<Portable>(part))[2]);
        assert_eq!(parts.map(|part| part.0), [[82.0, 12.0], [22.0, 32.0], [42.0, 52.0], [62.0, 72.0]]);
        let [a, b, c, d] = [[1e16, 1.0], [1.0, 1.0], [-1e16, 0.0], [0.0, 0.0]].map(Portable);
        assert_eq!((a.joined(c)).joined(b.joined(d)).total(), 3.0);
    }

    #[test]
    fn fours_are_turned_number_by_number() {
        let fours: [[f32; 4]; LANES] = std::array::from_fn(|lane| std::array::from_fn(|i| (10 * lane + i) as f32));
        assert_eq!(Portable::turn(fours.each_ref()).map(|number| number.0), [[0.0, 10.0], [1.0, 11.0], [2.0, 12.0], [3.0, 13.0]]);
    }

    #[test]
    #[should_panic(expected = "rows up to 5 of 4 records")]
    fn rows_beyond_the_records_are_refused() {
        let octets = listed(&[0, 0, 0, 0, 0, 0, 4, 0]);
        let _ = octets.of(0..LANES, &[Record::default(); 4]);
    }
}
