//! Products of rows with rows: the innermost loop of every method.
//!
//! Several rows of one kind meet several of another at once, so that each vector that is loaded is used more than once, and every product has a
//! sum of its own that waits for no other ("strand"). How many fit is decided by the registers a path has.
//!
//! Loops here are plain: a closure handed to `array::map` would not be compiled for the path.

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::sample::Sample;

/// Whether the path has 32 vector registers rather than 16.
#[inline(always)]
pub(crate) fn has_many_registers<S: Simd>() -> bool {
    cfg!(target_arch = "aarch64") || S::f32s::LEN == 16
}

/// `products[a][b] = Σ a_row · b_row`, over padded rows of one length.
#[inline(always)]
pub(crate) fn products<S: Simd, T: Sample, const A: usize, const B: usize>(
    simd: S,
    a_rows: [&[T]; A],
    b_rows: [&[T]; B],
) -> [[f64; B]; A] {
    let (lanes, length) = (T::Vector::<S>::LEN, a_rows[0].len());
    let zero = T::Vector::<S>::splat(simd, T::ZERO);
    let (mut strands, mut b_parts) = ([[zero; B]; A], [zero; B]);
    let mut at = 0;
    while at + lanes <= length {
        for b in 0..B {
            b_parts[b] = T::Vector::<S>::from_slice(simd, &b_rows[b][at..at + lanes]);
        }
        for a in 0..A {
            let a_part = T::Vector::<S>::from_slice(simd, &a_rows[a][at..at + lanes]);
            for b in 0..B {
                strands[a][b] = a_part.mul_add(b_parts[b], strands[a][b]);
            }
        }
        at += lanes;
    }
    let mut products = [[0.0; B]; A];
    for a in 0..A {
        for b in 0..B {
            products[a][b] = strands[a][b].reduce_sum().to_f64();
        }
    }
    products
}
