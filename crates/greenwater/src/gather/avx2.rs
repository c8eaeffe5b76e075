//! Eight lanes in a register, twice.

use std::arch::x86_64::*;

use super::{Entry, LANES, Lanes};

all_slices!(#[target_feature(enable = "avx2")] unsafe);

/// # Safety
/// Columns are below `x.len()`; `w` are as long as `columns`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn spread<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[f32]) -> [Lanes<f32>; S] {
    let x = x.as_chunks().0;
    let mut total = [[_mm256_setzero_ps(); 2]; S];
    for (k, columns) in columns.iter().enumerate() {
        for half in 0..2 {
            // SAFETY: as the caller promises.
            let [gathered] = unsafe { eight_of_each::<C, 1>(columns, half, x) };
            for (total, w) in total.iter_mut().zip(w) {
                // SAFETY: halves of 64 bytes on a boundary of 64.
                let w = unsafe { _mm256_load_ps(w[k].0.as_ptr().add(8 * half)) };
                total[half] = _mm256_add_ps(total[half], _mm256_mul_ps(w, gathered));
            }
        }
    }
    total.map(|total| store(total))
}

/// # Safety
/// Columns are below `x.len()`; `w` are as long as `columns`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn join<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[[f32; S]]) -> Lanes<f32> {
    let mut total = [_mm256_setzero_ps(); 2];
    for (k, columns) in columns.iter().enumerate() {
        for half in 0..2 {
            // SAFETY: as the caller promises.
            let eight = unsafe { eight_of_each(columns, half, x) };
            for (w, eight) in w.iter().zip(eight) {
                // SAFETY: halves of 64 bytes on a boundary of 64.
                let w = unsafe { _mm256_load_ps(w[k].0.as_ptr().add(8 * half)) };
                total[half] = _mm256_add_ps(total[half], _mm256_mul_ps(w, eight));
            }
        }
    }
    store(total)
}

/// The numbers of the columns of eight lanes of an entry, from lane `8 half` on, loaded one by one: on AMD Zen 3 gathers take longer.
///
/// # Safety
/// Columns are below `x.len()`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn eight_of_each<C: Entry, const S: usize>(entry: &C, half: usize, x: &[[f32; S]]) -> [__m256; S] {
    let mut of = [&x[0]; 8];
    for (lane, of) in of.iter_mut().enumerate() {
        // SAFETY: as the caller promises.
        *of = unsafe { x.get_unchecked(entry.column(8 * half + lane) as usize) };
    }
    let mut eight = [_mm256_setzero_ps(); S];
    if S == 2 {
        // SAFETY: a value is two numbers.
        let (low, high) = unsafe { (four_pairs([of[0], of[1], of[4], of[5]]), four_pairs([of[2], of[3], of[6], of[7]])) };
        (eight[0], eight[1]) = (_mm256_shuffle_ps::<0x88>(low, high), _mm256_shuffle_ps::<0xdd>(low, high));
        return eight;
    }
    for (s, eight) in eight.iter_mut().enumerate() {
        *eight = _mm256_setr_ps(of[0][s], of[1][s], of[2][s], of[3][s], of[4][s], of[5][s], of[6][s], of[7][s]);
    }
    eight
}

/// # Safety
/// `S` is 2.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn four_pairs<const S: usize>(of: [&[f32; S]; 4]) -> __m256 {
    let mut halves = [_mm_setzero_pd(); 2];
    for (half, of) in halves.iter_mut().zip(of.as_chunks::<2>().0) {
        // SAFETY: two numbers in single precision take the room of one in double.
        *half = unsafe { _mm_loadh_pd(_mm_load_sd(of[0].as_ptr().cast()), of[1].as_ptr().cast()) };
    }
    _mm256_castpd_ps(_mm256_insertf128_pd::<1>(_mm256_castpd128_pd256(halves[0]), halves[1]))
}

#[inline]
#[target_feature(enable = "avx2")]
fn store(total: [__m256; 2]) -> Lanes<f32> {
    let mut out = Lanes([0.0; LANES]);
    for half in 0..2 {
        // SAFETY: `out` is 64 bytes on a boundary of 64.
        unsafe { _mm256_store_ps(out.0.as_mut_ptr().add(8 * half), total[half]) };
    }
    out
}

/// As [`eight_of_each`], of four lanes from lane `4 quarter` on.
///
/// # Safety
/// Columns are below `x.len()`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn four_of_each<C: Entry, const S: usize>(entry: &C, quarter: usize, x: &[[f64; S]]) -> [__m256d; S] {
    let mut of = [&x[0]; 4];
    for (lane, of) in of.iter_mut().enumerate() {
        // SAFETY: as the caller promises.
        *of = unsafe { x.get_unchecked(entry.column(4 * quarter + lane) as usize) };
    }
    let mut four = [_mm256_setzero_pd(); S];
    if S == 2 {
        // SAFETY: a value is two numbers.
        let (even, odd) = unsafe { (two_pairs(of[0].as_ptr(), of[2].as_ptr()), two_pairs(of[1].as_ptr(), of[3].as_ptr())) };
        (four[0], four[1]) = (_mm256_unpacklo_pd(even, odd), _mm256_unpackhi_pd(even, odd));
        return four;
    }
    for (s, four) in four.iter_mut().enumerate() {
        *four = _mm256_setr_pd(of[0][s], of[1][s], of[2][s], of[3][s]);
    }
    four
}

/// # Safety
/// Two numbers are behind each pointer.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn two_pairs(low: *const f64, high: *const f64) -> __m256d {
    // SAFETY: as the caller promises.
    unsafe { _mm256_insertf128_pd::<1>(_mm256_castpd128_pd256(_mm_loadu_pd(low)), _mm_loadu_pd(high)) }
}

/// Four weights in double precision, from lane `4 quarter` on.
#[inline]
#[target_feature(enable = "avx2")]
fn four_weights(w: &Lanes<f32>, quarter: usize) -> __m256d {
    // SAFETY: quarters of 64 bytes on a boundary of 64.
    _mm256_cvtps_pd(unsafe { _mm_load_ps(w.0.as_ptr().add(4 * quarter)) })
}

/// # Safety
/// Columns are below `x.len()`; `w` are as long as `columns`.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn rise<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[f64], own: &Lanes<f64>) -> [Lanes<f64>; S] {
    let x = x.as_chunks().0;
    let mut out = [Lanes([0.0; LANES]); S];
    for quarter in 0..4 {
        let mut total = [_mm256_setzero_pd(); S];
        // SAFETY: quarter of 128 bytes on a boundary of 64.
        let own = unsafe { _mm256_load_pd(own.0.as_ptr().add(4 * quarter)) };
        for (k, columns) in columns.iter().enumerate() {
            // SAFETY: as the caller promises.
            let [four] = unsafe { four_of_each::<C, 1>(columns, quarter, x) };
            let rise = _mm256_sub_pd(four, own);
            for (total, w) in total.iter_mut().zip(w) {
                *total = _mm256_add_pd(*total, _mm256_mul_pd(four_weights(&w[k], quarter), rise));
            }
        }
        for (out, total) in out.iter_mut().zip(total) {
            // SAFETY: quarter of 128 bytes on a boundary of 64.
            unsafe { _mm256_store_pd(out.0.as_mut_ptr().add(4 * quarter), total) };
        }
    }
    out
}

/// # Safety
/// Columns are below `x.len()`; `w` are as long as `columns`.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn strain<C: Entry, const S: usize>(
    columns: &[C],
    w: [&[Lanes<f32>]; S],
    x: &[[f64; S]],
    own: &[Lanes<f64>; S],
) -> [[Lanes<f64>; S]; S] {
    let mut out = [[Lanes([0.0; LANES]); S]; S];
    for quarter in 0..4 {
        let mut total = [[_mm256_setzero_pd(); S]; S];
        let mut mine = [_mm256_setzero_pd(); S];
        for (mine, own) in mine.iter_mut().zip(own) {
            // SAFETY: quarter of 128 bytes on a boundary of 64.
            *mine = unsafe { _mm256_load_pd(own.0.as_ptr().add(4 * quarter)) };
        }
        for (k, columns) in columns.iter().enumerate() {
            // SAFETY: as the caller promises.
            let four = unsafe { four_of_each(columns, quarter, x) };
            for i in 0..S {
                let rise = _mm256_sub_pd(four[i], mine[i]);
                for j in 0..S {
                    total[i][j] = _mm256_add_pd(total[i][j], _mm256_mul_pd(four_weights(&w[j][k], quarter), rise));
                }
            }
        }
        for i in 0..S {
            for j in 0..S {
                // SAFETY: quarter of 128 bytes on a boundary of 64.
                unsafe { _mm256_store_pd(out[i][j].0.as_mut_ptr().add(4 * quarter), total[i][j]) };
            }
        }
    }
    out
}

/// # Safety
/// Columns are below `x.len()`; `w` are as long as `columns`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn sum<C: Entry>(columns: &[C], w: &[Lanes<f32>], x: &[f64]) -> Lanes<f64> {
    let x = x.as_chunks().0;
    let mut total = [_mm256_setzero_pd(); 4];
    for (columns, w) in columns.iter().zip(w) {
        for quarter in 0..4 {
            // SAFETY: as the caller promises.
            let [four] = unsafe { four_of_each::<C, 1>(columns, quarter, x) };
            total[quarter] = _mm256_add_pd(total[quarter], _mm256_mul_pd(four_weights(w, quarter), four));
        }
    }
    let mut out = Lanes([0.0; LANES]);
    for quarter in 0..4 {
        // SAFETY: `out` is 128 bytes on a boundary of 64.
        unsafe { _mm256_store_pd(out.0.as_mut_ptr().add(4 * quarter), total[quarter]) };
    }
    out
}
