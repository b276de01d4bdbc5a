//! Inner products of all planes with each other, in one pass over stretches of them: what the methods on pixels end with.
//!
//! A stretch of every plane is in the nearest cache. Planes are taken a few at a time, as many as there are registers for, so that every
//! product has a sum of its own. The sums of a stretch are in the samples' own precision, all others in `f64`.

use std::marker::PhantomData;

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::gram::Gram;
use crate::path::has_many_registers;
use crate::planes::gram_column;
use crate::row::load;
use crate::sample::Sample;

/// The sums of all products of `N` planes: 7 or, with light, 13.
pub(crate) struct PairSums<S: Simd, T: Sample, const N: usize> {
    /// `[i][j]` for `i <= j`.
    sums: [[S::f64s; N]; N],
    of: PhantomData<T>,
}

impl<S: Simd, T: Sample, const N: usize> PairSums<S, T, N> {
    /// Of nothing.
    #[inline(always)]
    pub(crate) fn new(simd: S) -> PairSums<S, T, N> {
        PairSums { sums: [[S::f64s::splat(simd, 0.0); N]; N], of: PhantomData }
    }

    /// Adds the products of these stretches, of one length.
    #[inline(always)]
    pub(crate) fn add(&mut self, simd: S, planes: [&[T]; N]) {
        // Which planes meet which, so that the sums and a vector of each fit into the registers.
        match (N, has_many_registers::<S>()) {
            (7, true) => {
                self.tile::<4, 3, true>(simd, &planes, 0, 4);
                self.tile::<3, 0, true>(simd, &planes, 4, 0);
            }
            (7, false) => {
                self.tile::<4, 0, true>(simd, &planes, 0, 0);
                self.tile::<4, 3, false>(simd, &planes, 0, 4);
                self.tile::<3, 0, true>(simd, &planes, 4, 0);
            }
            (13, true) => {
                self.tile::<4, 3, true>(simd, &planes, 0, 4);
                self.tile::<4, 6, false>(simd, &planes, 0, 7);
                self.tile::<4, 3, true>(simd, &planes, 4, 8);
                self.tile::<4, 2, false>(simd, &planes, 4, 11);
                self.tile::<5, 0, true>(simd, &planes, 8, 0);
            }
            (13, false) => {
                self.tile::<4, 0, true>(simd, &planes, 0, 0);
                for first in [4, 7, 10] {
                    self.tile::<4, 3, false>(simd, &planes, 0, first);
                    self.tile::<3, 0, true>(simd, &planes, first, 0);
                }
                for [a, b] in [[4, 7], [4, 10], [7, 10]] {
                    self.tile::<3, 3, false>(simd, &planes, a, b);
                }
            }
            _ => unreachable!("{N} planes"),
        }
    }

    /// The products of `A` planes from `first_a` on with `B` from `first_b` on and, if this is a `TRIANGLE`, with each other.
    #[inline(always)]
    fn tile<const A: usize, const B: usize, const TRIANGLE: bool>(
        &mut self,
        simd: S,
        planes: &[&[T]; N],
        first_a: usize,
        first_b: usize,
    ) {
        let (lanes, length) = (T::Vector::<S>::LEN, planes[0].len());
        let zero = T::Vector::<S>::splat(simd, T::ZERO);
        let (mut triangle, mut beside) = ([[zero; A]; A], [[zero; B]; A]);
        let (mut a_planes, mut b_planes): ([&[T]; A], [&[T]; B]) = ([&[]; A], [&[]; B]);
        for a in 0..A {
            a_planes[a] = &planes[first_a + a][..length];
        }
        for b in 0..B {
            b_planes[b] = &planes[first_b + b][..length];
        }
        let (mut a_parts, mut b_parts) = ([zero; A], [zero; B]);
        for at in (0..length).step_by(lanes) {
            for b in 0..B {
                b_parts[b] = load(simd, b_planes[b], at);
            }
            for a in 0..A {
                a_parts[a] = load(simd, a_planes[a], at);
                for b in 0..B {
                    beside[a][b] = a_parts[a].mul_add(b_parts[b], beside[a][b]);
                }
                if TRIANGLE {
                    for b in 0..=a {
                        triangle[b][a] = a_parts[a].mul_add(a_parts[b], triangle[b][a]);
                    }
                }
            }
        }
        for a in 0..A {
            for b in 0..B {
                widen_into::<S, T>(simd, beside[a][b], &mut self.sums[first_a + a][first_b + b]);
            }
            if TRIANGLE {
                for b in a..A {
                    widen_into::<S, T>(simd, triangle[a][b], &mut self.sums[first_a + a][first_a + b]);
                }
            }
        }
    }

    /// Adds `sign` times the sums to `gram`.
    #[inline(always)]
    pub(crate) fn add_to(&self, gram: &mut Gram, sign: f64) {
        for i in 0..N {
            for j in i..N {
                let (a, b) = (gram_column(i), gram_column(j));
                gram.products[(a.min(b), a.max(b))] += sign * self.sums[i][j].reduce_sum();
            }
        }
    }
}

#[inline(always)]
fn widen_into<S: Simd, T: Sample>(simd: S, strand: T::Vector<S>, sum: &mut S::f64s) {
    let parts = T::widened(simd, strand);
    for k in 0..T::WIDE {
        *sum += parts[k];
    }
}

/// How many products `planes` planes have with each other.
pub(crate) fn pair_count(planes: usize) -> usize {
    planes * (planes + 1) / 2
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;
    use crate::path::Path;
    use crate::row::PADDING;

    fn check<const N: usize>(path: Path) {
        let sample = |i: usize, u: usize| ((i * 7 + u * (4 + i)) % 11) as f32;
        let length = 3 * PADDING;
        let planes: [Vec<f32>; N] = std::array::from_fn(|i| (0..length).map(|u| sample(i, u)).collect());
        let mut gram = Gram::new();
        dispatch!(path.level(), simd => {
            let mut sums = PairSums::new(simd);
            sums.add(simd, planes.each_ref().map(|plane| &plane[..PADDING]));
            sums.add(simd, planes.each_ref().map(|plane| &plane[PADDING..]));
            sums.add_to(&mut gram, -1.0);
        });
        for (i, j) in (0..N).flat_map(|j| (0..=j).map(move |i| (i, j))) {
            let expected: f64 = (0..length).map(|u| f64::from(sample(i, u) * sample(j, u))).sum();
            let (a, b) = (gram_column(i), gram_column(j));
            assert_eq!(gram.products[(a.min(b), a.max(b))], -expected, "whole numbers: {i}, {j} of {N} on {path}");
        }
    }

    #[test]
    fn every_pair_of_planes_is_multiplied_once_on_every_path() {
        for path in Path::available() {
            check::<7>(path);
            check::<13>(path);
        }
    }
}
