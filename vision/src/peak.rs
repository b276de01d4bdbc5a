//! Arithmetic and nothing else: what a core can do at most, for whoever holds a clock.

use std::hint::black_box;

use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch};

use crate::path::Path;

/// Sums that do not wait for each other: enough to hide a multiply-add's latency, few enough for 16 registers.
const STRANDS: usize = 12;

/// Does `rounds` rounds of `f32` multiply-adds in registers, and returns how many floating-point operations that were: two for each.
///
/// Timed, that is the peak of one core on this path, against which a step's own multiply-adds ([`crate::Work`]) can be held.
pub fn spin(path: Path, rounds: u64) -> u64 {
    dispatch!(path.level(), simd => spin_on(simd, rounds))
}

#[inline(always)]
fn spin_on<S: Simd>(simd: S, rounds: u64) -> u64 {
    let (factor, term) = (S::f32s::splat(simd, black_box(0.999)), S::f32s::splat(simd, black_box(0.001)));
    let mut strands = [term; STRANDS];
    for _ in 0..rounds {
        for strand in &mut strands {
            *strand = strand.mul_add(factor, term);
        }
    }
    for strand in strands {
        black_box(strand.reduce_sum());
    }
    rounds * (2 * STRANDS * S::f32s::LEN) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_counts_every_lane_of_every_strand_twice() {
        for path in Path::available() {
            let per_round = spin(path, 1);
            assert_eq!(spin(path, 1000), 1000 * per_round);
            assert!(per_round >= 2 * STRANDS as u64 * 4, "{path} has four lanes at least");
        }
    }
}
