//! Sixteen numbers at once in single precision: for the search, which decides by them what is clear and looks again where it is not. What is
//! found is therefore the same on every machine although the arithmetic is not.

/// Numbers in a vector.
pub(crate) const WIDE: usize = 16;

/// A vector of [`WIDE`] numbers.
pub(crate) trait Singles: Copy {
    /// `x` everywhere.
    fn splat(x: f32) -> Self;

    /// The numbers in order.
    fn from_array(x: &[f32; WIDE]) -> Self;

    /// `self + other`.
    fn plus(self, other: Self) -> Self;

    /// `self − other`.
    fn minus(self, other: Self) -> Self;

    /// `self * other`.
    fn times(self, other: Self) -> Self;

    /// `self * factor + term`, rounded once or twice.
    fn times_plus(self, factor: Self, term: Self) -> Self;

    /// A bit for each number that is below that of `other`; none where one is NaN.
    fn below(self, other: Self) -> u16;

    /// Writes the rows whose bits are set, but not `but`, to the start of `to`, in order, and answers how many they are; what is behind them is
    /// anything.
    #[inline(always)]
    fn keep(bits: u16, but: u32, rows: &[u32; WIDE], to: &mut [u32; WIDE]) -> usize {
        let (mut bits, mut kept) = (bits, 0);
        while bits != 0 {
            let row = rows[bits.trailing_zeros() as usize];
            to[kept] = row;
            kept += usize::from(row != but);
            bits &= bits - 1;
        }
        kept
    }
}

/// Vectors as arrays.
impl Singles for [f32; WIDE] {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        [x; WIDE]
    }

    #[inline(always)]
    fn from_array(x: &[f32; WIDE]) -> Self {
        *x
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        std::array::from_fn(|i| self[i] + other[i])
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        std::array::from_fn(|i| self[i] - other[i])
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        std::array::from_fn(|i| self[i] * other[i])
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        self.times(factor).plus(term)
    }

    #[inline(always)]
    fn below(self, other: Self) -> u16 {
        (0..WIDE).fold(0, |bits, i| bits | u16::from(self[i] < other[i]) << i)
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) mod x86 {
    //! SAFETY of every block below: as in [`lanes`](crate::lanes), values of these types are made only behind a test that the machine has the
    //! instructions, and loads and stores are of arrays of the right size.

    use std::arch::x86_64::*;

    use super::{Singles, WIDE};

    /// One register of AVX-512.
    #[derive(Clone, Copy)]
    pub(crate) struct Wide512(__m512);

    impl Singles for Wide512 {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self(unsafe { _mm512_set1_ps(x) })
        }

        #[inline(always)]
        fn from_array(x: &[f32; WIDE]) -> Self {
            Self(unsafe { _mm512_loadu_ps(x.as_ptr()) })
        }

        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            Self(unsafe { _mm512_add_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn minus(self, other: Self) -> Self {
            Self(unsafe { _mm512_sub_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn times(self, other: Self) -> Self {
            Self(unsafe { _mm512_mul_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn times_plus(self, factor: Self, term: Self) -> Self {
            Self(unsafe { _mm512_fmadd_ps(self.0, factor.0, term.0) })
        }

        #[inline(always)]
        fn below(self, other: Self) -> u16 {
            unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) }
        }

        #[inline(always)]
        fn keep(bits: u16, but: u32, rows: &[u32; WIDE], to: &mut [u32; WIDE]) -> usize {
            unsafe {
                let rows = _mm512_loadu_si512(rows.as_ptr().cast());
                let kept = _mm512_mask_cmpneq_epi32_mask(bits, rows, _mm512_set1_epi32(but as i32));
                _mm512_storeu_si512(to.as_mut_ptr().cast(), _mm512_maskz_compress_epi32(kept, rows));
                kept.count_ones() as usize
            }
        }
    }

    /// Two registers of AVX2.
    #[derive(Clone, Copy)]
    pub(crate) struct Wide256(__m256, __m256);

    impl Singles for Wide256 {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            unsafe { Self(_mm256_set1_ps(x), _mm256_set1_ps(x)) }
        }

        #[inline(always)]
        fn from_array(x: &[f32; WIDE]) -> Self {
            unsafe { Self(_mm256_loadu_ps(x.as_ptr()), _mm256_loadu_ps(x.as_ptr().add(8))) }
        }

        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            unsafe { Self(_mm256_add_ps(self.0, other.0), _mm256_add_ps(self.1, other.1)) }
        }

        #[inline(always)]
        fn minus(self, other: Self) -> Self {
            unsafe { Self(_mm256_sub_ps(self.0, other.0), _mm256_sub_ps(self.1, other.1)) }
        }

        #[inline(always)]
        fn times(self, other: Self) -> Self {
            unsafe { Self(_mm256_mul_ps(self.0, other.0), _mm256_mul_ps(self.1, other.1)) }
        }

        #[inline(always)]
        fn times_plus(self, factor: Self, term: Self) -> Self {
            unsafe { Self(_mm256_fmadd_ps(self.0, factor.0, term.0), _mm256_fmadd_ps(self.1, factor.1, term.1)) }
        }

        #[inline(always)]
        fn below(self, other: Self) -> u16 {
            unsafe {
                let low = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0));
                let high = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.1, other.1));
                (low | high << 8) as u16
            }
        }

        /// Each half is brought together by a permutation, of which there are 256.
        #[inline(always)]
        fn keep(bits: u16, but: u32, rows: &[u32; WIDE], to: &mut [u32; WIDE]) -> usize {
            let mut kept = 0;
            for (half, rows) in rows.as_chunks::<8>().0.iter().enumerate() {
                let bits = usize::from(bits >> (8 * half) & 0xff);
                unsafe {
                    let rows = _mm256_loadu_si256(rows.as_ptr().cast());
                    let is_but = _mm256_cmpeq_epi32(rows, _mm256_set1_epi32(but as i32));
                    let bits = bits & !(_mm256_movemask_ps(_mm256_castsi256_ps(is_but)) as usize);
                    let order = _mm256_cvtepu8_epi32(_mm_loadl_epi64(TOGETHER[bits].as_ptr().cast()));
                    // At most eight are kept of the first half: eight more have room behind them.
                    _mm256_storeu_si256(to.as_mut_ptr().add(kept).cast(), _mm256_permutevar8x32_epi32(rows, order));
                    kept += bits.count_ones() as usize;
                }
            }
            kept
        }
    }

    /// For each choice of eight numbers the places of those that are chosen, in order.
    static TOGETHER: [[u8; 8]; 256] = {
        let mut all = [[0; 8]; 256];
        let mut bits = 0;
        while bits < 256 {
            let (mut place, mut kept) = (0, 0);
            while place < 8 {
                if bits >> place & 1 == 1 {
                    all[bits][kept] = place as u8;
                    kept += 1;
                }
                place += 1;
            }
            bits += 1;
        }
        all
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{InstructionSet, Job, Lanes, dispatch};

    /// What vectors make of numbers that single precision holds exactly, NaN and infinity among them.
    struct Everything<'a>(&'a mut Vec<u32>);

    impl Job for Everything<'_> {
        fn run<L: Lanes>(self) {
            let x: [f32; WIDE] = std::array::from_fn(|i| [0.5, -3.0, 7.0, f32::NAN, f32::INFINITY, 2.0, 0.0][i % 7] * (1.0 + i as f32));
            let y: [f32; WIDE] = std::array::from_fn(|i| i as f32);
            let (x, y) = (L::Singles::from_array(&x), L::Singles::from_array(&y));
            let limit = L::Singles::splat(5.0);
            let rows = std::array::from_fn(|i| 100 + i as u32);
            for bits in (0..=u16::MAX).step_by(37).chain([u16::MAX]) {
                let mut to = [0; WIDE];
                let kept = L::Singles::keep(bits, 109, &rows, &mut to);
                let chosen = rows.iter().enumerate().filter(|&(i, &row)| bits >> i & 1 == 1 && row != 109).map(|(_, row)| row);
                assert!(to[..kept].iter().eq(chosen), "{bits:#b}: {:?}", &to[..kept]);
            }
            for value in [x, y, x.plus(y), x.minus(y), x.times(y), x.times_plus(y, limit)] {
                let bits = value.below(limit);
                self.0.push(u32::from(bits));
                let mut to = [0; WIDE];
                let kept = L::Singles::keep(bits, 101, &rows, &mut to);
                self.0.extend(&to[..kept]);
            }
        }
    }

    #[test]
    fn all_instruction_sets_tell_the_same_numbers_apart() {
        let of = |set| {
            let mut found = Vec::new();
            dispatch(set, Everything(&mut found));
            found
        };
        let portable = of(InstructionSet::Portable);
        // x is 0.5, -6, 21, NaN, infinity, 12, 0, 4, -27, 70, NaN, infinity, 26, 0, 7.5, -48.
        assert_eq!(portable[..7], [0b1010_0001_1100_0011, 100, 106, 107, 108, 113, 115], "below 5, without row 101");
        for set in InstructionSet::available() {
            assert_eq!(of(set), portable, "{}", set.name());
        }
    }
}
