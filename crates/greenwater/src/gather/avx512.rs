//! Sixteen lanes in a register.

use std::arch::x86_64::*;

use super::{Entry, LANES, Lanes};

all_slices!(#[target_feature(enable = "avx512f")] unsafe);

/// The columns of an entry.
#[inline]
#[target_feature(enable = "avx512f")]
fn all<C: Entry>(entry: &C) -> __m512i {
    let entry = std::ptr::from_ref(entry);
    // SAFETY: 32 or 64 bytes, aligned to that.
    unsafe { if C::NARROW { _mm512_cvtepu16_epi32(_mm256_load_si256(entry.cast())) } else { _mm512_load_si512(entry.cast()) } }
}

/// Half of the columns of an entry.
#[inline]
#[target_feature(enable = "avx512f")]
fn eight<C: Entry>(entry: &C, half: usize) -> __m256i {
    let entry = std::ptr::from_ref(entry);
    // SAFETY: halves of 32 or 64 bytes, aligned to that.
    unsafe {
        if C::NARROW {
            _mm256_cvtepu16_epi32(_mm_load_si128(entry.cast::<__m128i>().add(half)))
        } else {
            _mm256_load_si256(entry.cast::<__m256i>().add(half))
        }
    }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn store(lanes: __m512) -> Lanes<f32> {
    let mut out = Lanes([0.0; LANES]);
    // SAFETY: `out` is 64 bytes on a boundary of 64.
    unsafe { _mm512_store_ps(out.0.as_mut_ptr(), lanes) };
    out
}

/// # Safety
/// Columns are below `x.len()` and `i32::MAX`; `w` are as long as `columns`.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn spread<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[f32]) -> [Lanes<f32>; S] {
    let mut total = [_mm512_setzero_ps(); S];
    for (k, columns) in columns.iter().enumerate() {
        // SAFETY: `Lanes` are 64 bytes on a boundary of 64; indices are within `x` as the caller promises.
        let gathered = unsafe { _mm512_i32gather_ps::<4>(all(columns), x.as_ptr()) };
        for (total, w) in total.iter_mut().zip(w) {
            // SAFETY: as above.
            let w = unsafe { _mm512_load_ps(w[k].0.as_ptr()) };
            *total = _mm512_add_ps(*total, _mm512_mul_ps(w, gathered));
        }
    }
    total.map(|total| store(total))
}

/// # Safety
/// Columns are below `x.len()`, and `S` times that fits 31 bits; `w` are as long as `columns`.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn join<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[[f32; S]]) -> Lanes<f32> {
    let mut total = _mm512_setzero_ps();
    for (k, columns) in columns.iter().enumerate() {
        // SAFETY: indices are within `x` as the caller promises.
        let gathered = unsafe { both_or_each(all(columns), x) };
        for (w, gathered) in w.iter().zip(gathered) {
            // SAFETY: `Lanes` are 64 bytes on a boundary of 64.
            let w = unsafe { _mm512_load_ps(w[k].0.as_ptr()) };
            total = _mm512_add_ps(total, _mm512_mul_ps(w, gathered));
        }
    }
    store(total)
}

/// The numbers of sixteen values, one register each. Two numbers travel as one of twice the length: a gather costs by the element.
///
/// # Safety
/// Columns are below `x.len()`, and `S` times that fits 31 bits.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn both_or_each<const S: usize>(columns: __m512i, x: &[[f32; S]]) -> [__m512; S] {
    let mut gathered = [_mm512_setzero_ps(); S];
    if S == 2 {
        let (low, high) = (_mm512_castsi512_si256(columns), _mm512_extracti64x4_epi64::<1>(columns));
        // SAFETY: a value is 8 bytes, and indices are within `x` as the caller promises.
        let [low, high] = unsafe { [_mm512_i32gather_pd::<8>(low, x.as_ptr().cast()), _mm512_i32gather_pd::<8>(high, x.as_ptr().cast())] };
        let (low, high) = (_mm512_castpd_ps(low), _mm512_castpd_ps(high));
        for (s, gathered) in gathered.iter_mut().enumerate() {
            let first = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            *gathered = _mm512_permutex2var_ps(low, _mm512_add_epi32(first, _mm512_set1_epi32(s as i32)), high);
        }
        return gathered;
    }
    let first = _mm512_mullo_epi32(columns, _mm512_set1_epi32(S as i32));
    for (s, gathered) in gathered.iter_mut().enumerate() {
        // SAFETY: number `s < S` of a value within `x`, as the caller promises.
        *gathered = unsafe { _mm512_i32gather_ps::<4>(first, x.as_ptr().cast::<f32>().add(s)) };
    }
    gathered
}

/// # Safety
/// Columns are below `x.len()` and `i32::MAX`; `w` are as long as `columns`.
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn rise<C: Entry, const S: usize>(columns: &[C], w: [&[Lanes<f32>]; S], x: &[f64], own: &Lanes<f64>) -> [Lanes<f64>; S] {
    let mut out = [Lanes([0.0; LANES]); S];
    for half in 0..2 {
        let mut total = [_mm512_setzero_pd(); S];
        // SAFETY: half of 128 bytes on a boundary of 64.
        let own = unsafe { _mm512_load_pd(own.0.as_ptr().add(8 * half)) };
        for (k, columns) in columns.iter().enumerate() {
            // SAFETY: halves of 64 bytes on a boundary of 64; indices are within `x` as the caller promises.
            let gathered = unsafe { _mm512_i32gather_pd::<8>(eight(columns, half), x.as_ptr()) };
            let rise = _mm512_sub_pd(gathered, own);
            for (total, w) in total.iter_mut().zip(w) {
                // SAFETY: as above.
                let w = unsafe { _mm256_load_ps(w[k].0.as_ptr().add(8 * half)) };
                *total = _mm512_add_pd(*total, _mm512_mul_pd(_mm512_cvtps_pd(w), rise));
            }
        }
        for (out, total) in out.iter_mut().zip(total) {
            // SAFETY: half of 128 bytes on a boundary of 64.
            unsafe { _mm512_store_pd(out.0.as_mut_ptr().add(8 * half), total) };
        }
    }
    out
}

/// # Safety
/// Columns are below `x.len()`, and `S` times that fits 31 bits; `w` are as long as `columns`.
#[target_feature(enable = "avx512f,avx2")]
pub(super) unsafe fn strain<C: Entry, const S: usize>(
    columns: &[C],
    w: [&[Lanes<f32>]; S],
    x: &[[f64; S]],
    own: &[Lanes<f64>; S],
) -> [[Lanes<f64>; S]; S] {
    let mut out = [[Lanes([0.0; LANES]); S]; S];
    for half in 0..2 {
        let mut total = [[_mm512_setzero_pd(); S]; S];
        let mut mine = [_mm512_setzero_pd(); S];
        for (mine, own) in mine.iter_mut().zip(own) {
            // SAFETY: half of 128 bytes on a boundary of 64.
            *mine = unsafe { _mm512_load_pd(own.0.as_ptr().add(8 * half)) };
        }
        for (k, columns) in columns.iter().enumerate() {
            let first = _mm256_mullo_epi32(eight(columns, half), _mm256_set1_epi32(S as i32));
            let mut weights = [_mm512_setzero_pd(); S];
            for (weight, w) in weights.iter_mut().zip(w) {
                // SAFETY: as above.
                *weight = _mm512_cvtps_pd(unsafe { _mm256_load_ps(w[k].0.as_ptr().add(8 * half)) });
            }
            for i in 0..S {
                // SAFETY: number `i < S` of a value within `x`, as the caller promises.
                let gathered = unsafe { _mm512_i32gather_pd::<8>(first, x.as_ptr().cast::<f64>().add(i)) };
                let rise = _mm512_sub_pd(gathered, mine[i]);
                for j in 0..S {
                    total[i][j] = _mm512_add_pd(total[i][j], _mm512_mul_pd(weights[j], rise));
                }
            }
        }
        for i in 0..S {
            for j in 0..S {
                // SAFETY: half of 128 bytes on a boundary of 64.
                unsafe { _mm512_store_pd(out[i][j].0.as_mut_ptr().add(8 * half), total[i][j]) };
            }
        }
    }
    out
}

/// # Safety
/// Columns are below `x.len()` and `i32::MAX`.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn sum<C: Entry>(columns: &[C], w: &[Lanes<f32>], x: &[f64]) -> Lanes<f64> {
    let mut total = [_mm512_setzero_pd(); 2];
    for (columns, w) in columns.iter().zip(w) {
        for half in 0..2 {
            // SAFETY: halves of 64 bytes on a boundary of 64; indices are within `x` as the caller promises.
            let (w, gathered) =
                unsafe { (_mm256_load_ps(w.0.as_ptr().add(8 * half)), _mm512_i32gather_pd::<8>(eight(columns, half), x.as_ptr())) };
            total[half] = _mm512_add_pd(total[half], _mm512_mul_pd(_mm512_cvtps_pd(w), gathered));
        }
    }
    let mut out = Lanes([0.0; LANES]);
    for half in 0..2 {
        // SAFETY: `out` is 128 bytes on a boundary of 64.
        unsafe { _mm512_store_pd(out.0.as_mut_ptr().add(8 * half), total[half]) };
    }
    out
}
