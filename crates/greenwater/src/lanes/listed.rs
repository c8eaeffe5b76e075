//! Records of particles, and lists of their rows by eights.

use super::{LANES, Lanes};
use crate::sweep::keep_ranges;

/// What a sum over pairs reads of a particle: one line of the cache.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Record(pub [f64; LANES]);

impl Record {
    /// The numbers of records, one behind the other: room for columns of them while records are not in use.
    pub fn flat(records: &[Self]) -> &[f64] {
        // SAFETY: a record is `LANES` numbers without a gap.
        unsafe { std::slice::from_raw_parts(records.as_ptr().cast(), LANES * records.len()) }
    }

    /// The same, to be written to.
    pub fn flat_mut(records: &mut [Self]) -> &mut [f64] {
        // SAFETY: a record is `LANES` numbers without a gap, and any numbers make one.
        unsafe { std::slice::from_raw_parts_mut(records.as_mut_ptr().cast(), LANES * records.len()) }
    }
}

/// Lists of rows, eights behind eights. They are written in place, and what is behind the last one is anything.
#[derive(Clone, Debug, Default)]
pub(crate) struct Octets {
    room: Vec<u32>,
    /// Rows written.
    length: usize,
    /// The most room that was asked for since the beginning.
    asked: usize,
    /// Above every row; none while rows are written.
    bound: Option<usize>,
}

/// Rows of records that are there: eight, or as many as a vector holds.
#[derive(Clone, Copy)]
pub(crate) struct Listed<'a> {
    rows: &'a [u32],
    /// More than any of the rows.
    pub(super) records: &'a [Record],
}

impl Octets {
    /// Begins anew, with room for `likely` rows, or for as many as were asked for the last time.
    pub fn begin(&mut self, likely: usize) {
        let likely = likely.max(self.asked);
        (self.length, self.asked, self.bound) = (0, 0, None);
        self.grow(likely);
    }

    /// Keeps the rows of `ranges`, whole eights in order, one behind the other, and gives back the room of all others.
    pub fn keep(&mut self, ranges: &[std::ops::Range<usize>]) {
        self.room.truncate(self.length);
        keep_ranges(&mut self.room, ranges);
        self.length = self.room.len();
    }

    fn grow(&mut self, least: usize) {
        if self.room.len() < least {
            self.room.reserve_exact(least - self.room.len());
            self.room.resize(least, 0);
        }
    }

    /// Room behind the last row, for `more` at least.
    #[inline(always)]
    pub fn behind(&mut self, more: usize) -> &mut [u32] {
        self.asked = self.asked.max(self.length + more);
        if self.room.len() < self.asked {
            self.grow(self.asked + self.asked / 16);
        }
        &mut self.room[self.length..]
    }

    /// Takes `more` rows over that were written behind the last one.
    #[inline(always)]
    pub fn take(&mut self, more: usize) {
        self.length += more;
    }

    /// Appends a row.
    pub fn push(&mut self, row: u32) {
        self.behind(1)[0] = row;
        self.take(1);
    }

    /// Fills the last eight up with `row`.
    #[inline(always)]
    pub fn fill_up(&mut self, row: u32) {
        let missing = self.length.next_multiple_of(LANES) - self.length;
        self.behind(LANES)[..missing].fill(row);
        self.take(missing);
    }

    /// All rows are written. Gives back most of the room that was not asked for.
    #[inline(always)]
    pub fn end(&mut self) {
        if self.room.len() > self.asked + self.asked / 16 {
            self.room.truncate(self.asked + self.asked / 64);
            self.room.shrink_to_fit();
        }
        self.bound = Some(self.rows().iter().fold(0, |last, &row| last.max(row)) as usize + 1);
    }

    /// The most room that was asked for since the beginning, in rows.
    pub fn asked(&self) -> usize {
        self.asked
    }

    /// How many rows are written.
    #[inline(always)]
    pub fn len(&self) -> usize {
        self.length
    }

    /// All rows.
    #[inline(always)]
    pub fn rows(&self) -> &[u32] {
        &self.room[..self.length]
    }

    /// The eights of a range of rows, whole ones only, of `records`.
    ///
    /// # Panics
    /// A row, of this range or not, is beyond the records.
    #[inline(always)]
    pub fn of<'a>(&'a self, range: std::ops::Range<usize>, records: &'a [Record]) -> impl Iterator<Item = Listed<'a>> {
        let bound = self.bound.expect("lists are written to their end");
        assert!(bound <= records.len(), "rows up to {bound} of {} records", records.len());
        self.rows()[range].as_chunks::<LANES>().0.iter().map(move |rows| Listed { rows, records })
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        4 * self.room.capacity()
    }
}

impl<'a> Listed<'a> {
    /// The rows.
    #[inline(always)]
    pub fn rows(self) -> &'a [u32] {
        self.rows
    }

    /// Those of the vector `part` of them.
    ///
    /// # Panics
    /// There are not so many.
    #[inline(always)]
    pub fn part<L: Lanes>(self, part: usize) -> Self {
        Self { rows: &self.rows[part * L::COUNT..][..L::COUNT], ..self }
    }

    /// The rows as an array.
    #[inline(always)]
    pub(super) fn exactly<const N: usize>(self) -> &'a [u32; N] {
        self.rows.try_into().expect("as many rows as the vector holds")
    }
}
