//! Vectors of AVX-512 and of AVX2.
//!
//! SAFETY of every block below: values of these types are made only inside [`super::dispatch`], behind a test that the machine
//! has the instructions; loads are from references to arrays of the right size, or from the records of a [`Listed`], whose rows are
//! below their number: only [`super::Octets::of`] makes one.

use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Neg, Sub};

use super::singles::x86::{Wide256, Wide512};
use super::{LANES, Lanes, Listed, Real, Record};

/// One register of AVX-512.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx512(__m512d);

impl Avx512 {
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self(unsafe { _mm512_add_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self(unsafe { _mm512_sub_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self(unsafe { _mm512_mul_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        Self(unsafe { _mm512_div_pd(self.0, other.0) })
    }
}

operators!(Avx512);

impl Real for Avx512 {
    type Mask = __mmask8;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self(unsafe { _mm512_set1_pd(x) })
    }

    #[inline(always)]
    fn root(self) -> Self {
        Self(unsafe { _mm512_sqrt_pd(self.0) })
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        Self(unsafe { _mm512_fmadd_pd(self.0, factor.0, term.0) })
    }

    #[inline(always)]
    fn size(self) -> Self {
        Self(unsafe { _mm512_abs_pd(self.0) })
    }

    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        Self(unsafe { _mm512_max_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        Self(unsafe { _mm512_min_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn below(self, other: Self) -> __mmask8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }

    #[inline(always)]
    fn choose(mask: __mmask8, yes: Self, no: Self) -> Self {
        Self(unsafe { _mm512_mask_blend_pd(mask, no.0, yes.0) })
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f64) -> f64) -> Self {
        Self::from_array(self.to_array().map(f))
    }
}

impl Lanes for Avx512 {
    type Singles = Wide512;
    const COUNT: usize = LANES;

    #[inline(always)]
    fn from_array(x: [f64; LANES]) -> Self {
        Self(unsafe { _mm512_loadu_pd(x.as_ptr()) })
    }

    #[inline(always)]
    fn to_array(self) -> [f64; LANES] {
        let mut x = [0.0; LANES];
        unsafe { _mm512_storeu_pd(x.as_mut_ptr(), self.0) };
        x
    }

    /// Halves of two records share a register, so that three rounds of shuffles put eight fields in order.
    #[inline(always)]
    fn gather(listed: Listed<'_>) -> [Self; LANES] {
        let rows = listed.exactly();
        unsafe {
            let [a, b, c, d] = four_fields::<0>(listed.records, rows);
            let [e, f, g, h] = four_fields::<4>(listed.records, rows);
            [a, b, c, d, e, f, g, h]
        }
    }

    #[inline(always)]
    fn turn(fours: [&[f32; 4]; LANES]) -> [Self; 4] {
        unsafe {
            let [a, b, c, d] = turned_fours(fours);
            [Self(_mm512_cvtps_pd(a)), Self(_mm512_cvtps_pd(b)), Self(_mm512_cvtps_pd(c)), Self(_mm512_cvtps_pd(d))]
        }
    }

    #[inline(always)]
    fn total(self) -> f64 {
        unsafe {
            let four = _mm256_add_pd(_mm512_castpd512_pd256(self.0), _mm512_extractf64x4_pd::<1>(self.0));
            total_of_four(four)
        }
    }
}

/// Number by number, what eight fours hold.
#[inline(always)]
unsafe fn turned_fours(fours: [&[f32; 4]; LANES]) -> [__m256; 4] {
    unsafe {
        let a = two_fours(fours[0], fours[4]);
        let b = two_fours(fours[1], fours[5]);
        let c = two_fours(fours[2], fours[6]);
        let d = two_fours(fours[3], fours[7]);
        let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
        let (ba, dc) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
        [
            _mm256_shuffle_ps::<0x44>(ab, cd),
            _mm256_shuffle_ps::<0xee>(ab, cd),
            _mm256_shuffle_ps::<0x44>(ba, dc),
            _mm256_shuffle_ps::<0xee>(ba, dc),
        ]
    }
}

#[inline(always)]
unsafe fn two_fours(low: &[f32; 4], high: &[f32; 4]) -> __m256 {
    unsafe { _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(_mm_loadu_ps(low.as_ptr())), _mm_loadu_ps(high.as_ptr())) }
}

/// Four fields from `FROM` on of the records `low` and `high`, one behind the other.
#[inline(always)]
unsafe fn two_halves<const FROM: usize>(records: &[Record], low: u32, high: u32) -> __m512d {
    unsafe {
        let low = _mm256_load_pd(records.get_unchecked(low as usize).0.as_ptr().add(FROM));
        let high = _mm256_load_pd(records.get_unchecked(high as usize).0.as_ptr().add(FROM));
        _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(low), high)
    }
}

/// Four fields from `FROM` on of eight records, turned.
#[inline(always)]
unsafe fn four_fields<const FROM: usize>(records: &[Record], rows: &[u32; LANES]) -> [Avx512; 4] {
    unsafe {
        let (a, b) = (two_halves::<FROM>(records, rows[0], rows[2]), two_halves::<FROM>(records, rows[1], rows[3]));
        let (c, d) = (two_halves::<FROM>(records, rows[4], rows[6]), two_halves::<FROM>(records, rows[5], rows[7]));
        let (even, odd) = (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
        let (even_high, odd_high) = (_mm512_unpacklo_pd(c, d), _mm512_unpackhi_pd(c, d));
        [
            Avx512(_mm512_shuffle_f64x2::<0x88>(even, even_high)),
            Avx512(_mm512_shuffle_f64x2::<0x88>(odd, odd_high)),
            Avx512(_mm512_shuffle_f64x2::<0xdd>(even, even_high)),
            Avx512(_mm512_shuffle_f64x2::<0xdd>(odd, odd_high)),
        ]
    }
}

/// `(0+2) + (1+3)`.
#[inline(always)]
unsafe fn total_of_four(four: __m256d) -> f64 {
    unsafe {
        let two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd::<1>(four));
        _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
    }
}

/// Two fields from `from` on of the records `low` and `high`, one behind the other.
#[inline(always)]
unsafe fn two_pairs(records: &[Record], low: u32, high: u32, from: usize) -> __m256d {
    unsafe {
        let low = _mm_load_pd(records.get_unchecked(low as usize).0.as_ptr().add(from));
        let high = _mm_load_pd(records.get_unchecked(high as usize).0.as_ptr().add(from));
        _mm256_insertf128_pd::<1>(_mm256_castpd128_pd256(low), high)
    }
}

/// Two fields from `from` on of four records, turned: halves come from memory in order, so that nothing has to cross the middle of a register.
#[inline(always)]
unsafe fn two_by_four(records: &[Record], rows: &[u32; 4], from: usize) -> [Avx2; 2] {
    unsafe {
        let (even, odd) = (two_pairs(records, rows[0], rows[2], from), two_pairs(records, rows[1], rows[3], from));
        [Avx2(_mm256_unpacklo_pd(even, odd)), Avx2(_mm256_unpackhi_pd(even, odd))]
    }
}

/// One register of AVX2.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx2(__m256d);

impl Avx2 {
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self(unsafe { _mm256_add_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self(unsafe { _mm256_sub_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self(unsafe { _mm256_mul_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        Self(unsafe { _mm256_div_pd(self.0, other.0) })
    }
}

operators!(Avx2);

impl Real for Avx2 {
    type Mask = __m256d;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self(unsafe { _mm256_set1_pd(x) })
    }

    #[inline(always)]
    fn root(self) -> Self {
        Self(unsafe { _mm256_sqrt_pd(self.0) })
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        Self(unsafe { _mm256_fmadd_pd(self.0, factor.0, term.0) })
    }

    #[inline(always)]
    fn size(self) -> Self {
        Self(unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), self.0) })
    }

    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        Self(unsafe { _mm256_max_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        Self(unsafe { _mm256_min_pd(self.0, other.0) })
    }

    #[inline(always)]
    fn below(self, other: Self) -> __m256d {
        unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, other.0) }
    }

    #[inline(always)]
    fn choose(mask: __m256d, yes: Self, no: Self) -> Self {
        Self(unsafe { _mm256_blendv_pd(no.0, yes.0, mask) })
    }

    #[inline(always)]
    fn each(self, f: impl Fn(f64) -> f64) -> Self {
        let mut x = self.to_array();
        for lane in 0..Self::COUNT {
            x[lane] = f(x[lane]);
        }
        Self::from_array(x)
    }
}

impl Lanes for Avx2 {
    type Singles = Wide256;
    const COUNT: usize = 4;

    #[inline(always)]
    fn from_array(x: [f64; LANES]) -> Self {
        Self(unsafe { _mm256_loadu_pd(x.as_ptr()) })
    }

    #[inline(always)]
    fn to_array(self) -> [f64; LANES] {
        let mut x = [0.0; LANES];
        unsafe { _mm256_storeu_pd(x.as_mut_ptr(), self.0) };
        x
    }

    #[inline(always)]
    fn gather(listed: Listed<'_>) -> [Self; LANES] {
        let rows = listed.exactly();
        unsafe {
            let ([a, b], [c, d]) = (two_by_four(listed.records, rows, 0), two_by_four(listed.records, rows, 2));
            let ([e, f], [g, h]) = (two_by_four(listed.records, rows, 4), two_by_four(listed.records, rows, 6));
            [a, b, c, d, e, f, g, h]
        }
    }

    #[inline(always)]
    fn turn([a, b, c, d, ..]: [&[f32; 4]; LANES]) -> [Self; 4] {
        unsafe {
            let (a, b) = (_mm_loadu_ps(a.as_ptr()), _mm_loadu_ps(b.as_ptr()));
            let (c, d) = (_mm_loadu_ps(c.as_ptr()), _mm_loadu_ps(d.as_ptr()));
            let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
            let (ba, dc) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
            [
                Self(_mm256_cvtps_pd(_mm_movelh_ps(ab, cd))),
                Self(_mm256_cvtps_pd(_mm_movehl_ps(cd, ab))),
                Self(_mm256_cvtps_pd(_mm_movelh_ps(ba, dc))),
                Self(_mm256_cvtps_pd(_mm_movehl_ps(dc, ba))),
            ]
        }
    }

    #[inline(always)]
    fn total(self) -> f64 {
        unsafe { total_of_four(self.0) }
    }
}
