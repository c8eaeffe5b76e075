//! Sums whose bits do not depend on the number of threads.
//!
//! A sum over `n` terms is cut into blocks of [`BLOCK`] terms; a block is summed in eight fixed lanes, and the blocks are
//! combined by a binary tree that depends on `n` only. Threads share out branches of that tree, so one thread and many
//! give the same bits. Short sums stay on one thread, along the same tree.

use std::ops::Range;

/// Terms in one block.
pub const BLOCK: usize = 4096;

/// Blocks below which a branch of the tree is not worth a second thread.
const BRANCH: usize = 4;

const LANES: usize = 8;

/// `Σ term(i)` for `i` in `0..n`, the same bits for any number of threads.
///
/// The unit is that of a term. A term that is not finite makes the sum not finite.
pub fn sum(n: usize, term: impl Fn(usize) -> f64 + Sync) -> f64 {
    over_blocks(n, &|block: Range<usize>| {
        let mut lanes = [0.0; LANES];
        for (k, i) in block.enumerate() {
            lanes[k % LANES] += term(i);
        }
        join_lanes(lanes)
    })
}

/// `Σ a_i b_i`, the same bits for any number of threads and the same bits as [`sum`] of the products.
///
/// Both slices must have the same length.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "dot product of vectors of different lengths");
    over_blocks(a.len(), &|block: Range<usize>| {
        let (a, a_rest) = a[block.clone()].as_chunks::<LANES>();
        let (b, b_rest) = b[block].as_chunks::<LANES>();
        let mut lanes = [0.0; LANES];
        for (a, b) in a.iter().zip(b) {
            for lane in 0..LANES {
                lanes[lane] += a[lane] * b[lane];
            }
        }
        for (lane, (a, b)) in lanes.iter_mut().zip(a_rest.iter().zip(b_rest)) {
            *lane += a * b;
        }
        join_lanes(lanes)
    })
}

/// `Σ a_i b_i` of numbers in single precision, each product in double; the same bits for any number of threads.
pub fn dot_single(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len(), "dot product of vectors of different lengths");
    over_blocks(a.len(), &|block: Range<usize>| {
        let (a, a_rest) = a[block.clone()].as_chunks::<LANES>();
        let (b, b_rest) = b[block].as_chunks::<LANES>();
        let mut lanes = [0.0; LANES];
        for (a, b) in a.iter().zip(b) {
            for lane in 0..LANES {
                lanes[lane] += f64::from(a[lane]) * f64::from(b[lane]);
            }
        }
        for (lane, (a, b)) in lanes.iter_mut().zip(a_rest.iter().zip(b_rest)) {
            *lane += f64::from(*a) * f64::from(*b);
        }
        join_lanes(lanes)
    })
}

/// Euclidean norm `√(Σ a_i²)`, the same bits for any number of threads.
pub fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

fn join_lanes(l: [f64; LANES]) -> f64 {
    ((l[0] + l[1]) + (l[2] + l[3])) + ((l[4] + l[5]) + (l[6] + l[7]))
}

/// Adds the sums of all blocks of `0..n` along the fixed tree.
fn over_blocks(n: usize, block_sum: &(dyn Fn(Range<usize>) -> f64 + Sync)) -> f64 {
    branch(0..n.div_ceil(BLOCK).max(1), n, block_sum)
}

fn branch(blocks: Range<usize>, n: usize, block_sum: &(dyn Fn(Range<usize>) -> f64 + Sync)) -> f64 {
    if blocks.len() == 1 {
        return block_sum(blocks.start * BLOCK..n.min(blocks.end * BLOCK));
    }
    let middle = blocks.start + blocks.len() / 2;
    let (left, right) = (blocks.start..middle, middle..blocks.end);
    let (left, right) = if blocks.len() > BRANCH {
        rayon::join(|| branch(left, n, block_sum), || branch(right, n, block_sum))
    } else {
        (branch(left, n, block_sum), branch(right, n, block_sum))
    };
    left + right
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Terms of both signs and very different sizes, so that another order of addition would show.
    fn term(i: usize) -> f64 {
        let x = ((i * 7919) % 10_007) as f64 - 5000.0;
        x * x * x / (1.0 + i as f64)
    }

    #[test]
    fn a_sum_has_the_same_bits_for_any_number_of_threads() {
        let n = 20 * BLOCK + 77;
        let sums: Vec<u64> = [1, 2, 3]
            .map(|threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| sum(n, term)).to_bits()
            })
            .to_vec();
        assert!(sums.iter().all(|&bits| bits == sums[0]), "{sums:x?}");
    }

    #[test]
    fn a_dot_product_is_the_sum_of_its_products_to_the_bit() {
        for n in [0, 1, 7, 8, 9, BLOCK - 1, BLOCK, BLOCK + 1, 9 * BLOCK + 13] {
            let a: Vec<f64> = (0..n).map(term).collect();
            let b: Vec<f64> = (0..n).map(|i| term(i + 3)).collect();
            assert_eq!(dot(&a, &b).to_bits(), sum(n, |i| a[i] * b[i]).to_bits(), "n = {n}");
        }
    }

    #[test]
    fn whole_numbers_add_up_exactly() {
        let n = 3 * BLOCK + 5;
        assert_eq!(sum(n, |i| i as f64), (n * (n - 1) / 2) as f64);
        assert_eq!(norm(&[3.0, 4.0]), 5.0);
        assert_eq!(sum(0, |_| f64::NAN), 0.0);
    }
}
