//! Chains of multiply-adds that the compiler turns into vector instructions, for the widest set that the processor has.
//!
//! The only `unsafe` here are the calls of functions compiled for features that were just detected.

/// Doubles in flight: enough independent chains to hide the latency of a multiply-add at any width up to 512 bits.
const CHAINS: usize = 96;

/// What the processor offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instructions {
    /// 512 bits with fused multiply-add.
    Avx512,
    /// 256 bits with fused multiply-add.
    Avx2,
    /// What every processor of the target has; on ARM that is 128 bits with fused multiply-add.
    Portable,
}

impl Instructions {
    /// All of them, the widest first.
    pub const ALL: [Self; 3] = [Self::Avx512, Self::Avx2, Self::Portable];

    /// The widest that this processor has.
    pub fn here() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "AVX-512",
            Self::Avx2 => "AVX2 with FMA",
            Self::Portable => "portable",
        }
    }
}

/// Runs `rounds` multiply-adds in every chain; answers how many floating-point operations that were, two each.
pub fn run(instructions: Instructions, rounds: usize) -> f64 {
    let mut x = std::hint::black_box([1.0; CHAINS]);
    // Any start tends to 2: no value grows or vanishes.
    let (a, b) = std::hint::black_box((0.5, 1.0));
    match instructions {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `here` gives these only where the features were detected, and no one else makes them but tests that ask `here`.
        Instructions::Avx512 => unsafe { avx512(&mut x, a, b, rounds) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Instructions::Avx2 => unsafe { avx2(&mut x, a, b, rounds) },
        _ if cfg!(target_arch = "aarch64") => fused(&mut x, a, b, rounds),
        _ => separate(&mut x, a, b, rounds),
    }
    std::hint::black_box(x);
    (2 * CHAINS * rounds) as f64
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn avx512(x: &mut [f64; CHAINS], a: f64, b: f64, rounds: usize) {
    fused(x, a, b, rounds);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2(x: &mut [f64; CHAINS], a: f64, b: f64, rounds: usize) {
    // 96 doubles do not fit into 16 registers of four: half of them, twice.
    let (low, high) = x.split_at_mut(CHAINS / 2);
    for half in [low, high] {
        if let Ok(half) = <&mut [f64; CHAINS / 2]>::try_from(half) {
            fused(half, a, b, rounds);
        }
    }
}

#[inline(always)]
fn fused<const N: usize>(x: &mut [f64; N], a: f64, b: f64, rounds: usize) {
    let mut chains = *x;
    for _ in 0..rounds {
        for chain in &mut chains {
            *chain = chain.mul_add(a, b);
        }
    }
    *x = chains;
}

#[inline(always)]
fn separate<const N: usize>(x: &mut [f64; N], a: f64, b: f64, rounds: usize) {
    let mut chains = *x;
    for _ in 0..rounds {
        for chain in &mut chains {
            *chain = *chain * a + b;
        }
    }
    *x = chains;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `x = x/2 + 1` is exact here, fused or not: from 1 it is `2 − 2⁻ⁿ` after `n` rounds.
    #[test]
    fn every_set_of_instructions_computes_the_chains() {
        let exact = 2.0 - 0.5f64.powi(20);
        let mut x = [1.0; CHAINS];
        separate(&mut x, 0.5, 1.0, 20);
        assert_eq!(x, [exact; CHAINS]);
        let mut x = [1.0; CHAINS];
        fused(&mut x, 0.5, 1.0, 20);
        assert_eq!(x, [exact; CHAINS]);
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") {
                let mut x = [1.0; CHAINS];
                // SAFETY: detected.
                unsafe { avx512(&mut x, 0.5, 1.0, 20) };
                assert_eq!(x, [exact; CHAINS]);
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                let mut x = [1.0; CHAINS];
                // SAFETY: detected.
                unsafe { avx2(&mut x, 0.5, 1.0, 20) };
                assert_eq!(x, [exact; CHAINS]);
            }
        }
        assert_eq!(run(Instructions::here(), 3), 2.0 * 3.0 * CHAINS as f64);
    }
}
