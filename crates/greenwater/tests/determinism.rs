//! The same bits for any number of threads. That they are the same for any optimisation level too is for the example
//! `fingerprint`, run from two builds.

#[path = "../examples/fingerprint.rs"]
mod example;

use example::fingerprint;
use greenwater::scheme::MethodName;

/// 4409 particles: more than one block of every kind of sum and sweep.
fn hash_on(threads: usize, method: MethodName, steps: usize) -> u64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| fingerprint("dam-break-40", method, steps).unwrap())
}

#[test]
fn every_method_gives_the_same_bits_on_any_number_of_threads() {
    for &method in MethodName::ALL {
        // A step of the flow has some ten steps of sound in the weakly compressible methods of today, and some hundred sweeps in
        // an exact projection.
        let steps = match method {
            MethodName::Wcsph | MethodName::IsphPaper => 20,
            MethodName::Dfsph | MethodName::Iisph => 2,
            _ => 3,
        };
        let one = hash_on(1, method, steps);
        for threads in [2, 3] {
            assert_eq!(hash_on(threads, method, steps), one, "{}, {threads} threads", method.name());
        }
    }
}

#[test]
fn delta_sph_gives_the_same_bits_on_any_number_of_threads() {
    let one = hash_on(1, MethodName::DeltaSph, 10);
    for threads in [2, 3] {
        assert_eq!(hash_on(threads, MethodName::DeltaSph, 10), one, "{threads} threads");
    }
}

/// A hash that never changed would hold of anything.
#[test]
fn another_step_gives_other_bits() {
    let after = |steps| fingerprint("dam-break-20", MethodName::Wcsph, steps).unwrap();
    assert_ne!(after(2), after(3));
}
