//! Rows folded about their middle: `x(u) ± x(W - 1 - u)`, the even and the odd half.
//!
//! Tchebichef, cosines, Hahn with `a = b` and Krawtchouk with `p = ½` are even and odd about the middle in turn. An even one meets only the
//! even half of a row, an odd one only the odd half, so each product is taken over half as many samples.

use std::array::from_fn;

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::projection::MOST_PLANES;
use crate::row::{PADDING, Place, Row};
use crate::sample::Sample;

/// Shortest row that is folded: both halves hold the longest vector, and more.
pub(crate) const FOLDABLE: usize = 4 * PADDING;

/// One row of each plane, as it is or folded.
#[derive(Debug)]
pub(crate) struct Folds<T> {
    whole: [Row<T>; MOST_PLANES],
    even: [Row<T>; MOST_PLANES],
    odd: [Row<T>; MOST_PLANES],
}

impl<T: Sample> Folds<T> {
    /// For rows of so many samples.
    pub(crate) fn new(width: usize) -> Folds<T> {
        let halves = || from_fn(|_| Row::zeros(width.div_ceil(2)));
        Folds { whole: from_fn(|_| Row::zeros(width)), even: halves(), odd: halves() }
    }

    /// The rows as they are, the padding included.
    pub(crate) fn whole(&self) -> [&[T]; MOST_PLANES] {
        self.whole.each_ref().map(Row::padded)
    }

    /// `x(u) + x(W - 1 - u)` up to the middle; finite beyond it.
    pub(crate) fn even(&self) -> [&[T]; MOST_PLANES] {
        self.even.each_ref().map(Row::padded)
    }

    /// `x(u) - x(W - 1 - u)` up to the middle; finite beyond it.
    pub(crate) fn odd(&self) -> [&[T]; MOST_PLANES] {
        self.odd.each_ref().map(Row::padded)
    }

    /// Fills the rows of `width` samples with what `planes` makes of the samples from a place on: folded, or as they are. Rows to be folded have
    /// [`FOLDABLE`] samples at least.
    ///
    /// `planes` must be `#[inline(always)]`, or it is not compiled for the path.
    #[inline(always)]
    pub(crate) fn fill<S: Simd, const P: usize>(
        &mut self,
        _: S,
        (width, folded): (usize, bool),
        planes: impl Fn(usize, Place) -> [T::Vector<S>; P],
    ) {
        let lanes = T::Vector::<S>::LEN;
        if folded {
            let (mut even, mut odd) = (first::<P, T>(&mut self.even), first::<P, T>(&mut self.odd));
            put_halves(&mut even, &mut odd, 0, planes(0, Place::Border), planes(width - lanes, Place::Border));
            let mut at = lanes;
            while at < width.div_ceil(2) {
                let mirrored = planes(width - at - lanes, Place::Inside);
                put_halves(&mut even, &mut odd, at, planes(at, Place::Inside), mirrored);
                at += lanes;
            }
            return;
        }
        let mut whole = first::<P, T>(&mut self.whole);
        put(&mut whole, 0, planes(0, Place::Border));
        let mut at = lanes;
        while at + lanes < width {
            put(&mut whole, at, planes(at, Place::Inside));
            at += lanes;
        }
        while at < width {
            put(&mut whole, at, planes(at, Place::Border));
            at += lanes;
        }
    }
}

/// The samples of the first `P` rows.
#[inline(always)]
fn first<const P: usize, T: Sample>(rows: &mut [Row<T>; MOST_PLANES]) -> [&mut [T]; P] {
    let (length, mut rows) = (rows[0].padded().len(), rows.iter_mut());
    from_fn(|_| &mut rows.next().expect("a sweep has at most so many planes").padded_mut()[..length])
}

#[inline(always)]
fn put<S: Simd, V: SimdBase<S>, const P: usize>(rows: &mut [&mut [V::Element]; P], at: usize, planes: [V; P]) {
    for p in 0..P {
        planes[p].store_slice(&mut rows[p][at..at + V::LEN]);
    }
}

#[inline(always)]
fn put_halves<S: Simd, V: SimdFloat<S>, const P: usize>(
    even: &mut [&mut [V::Element]; P],
    odd: &mut [&mut [V::Element]; P],
    at: usize,
    left: [V; P],
    right: [V; P],
) {
    for p in 0..P {
        let mirrored = right[p].reverse();
        (left[p] + mirrored).store_slice(&mut even[p][at..at + V::LEN]);
        (left[p] - mirrored).store_slice(&mut odd[p][at..at + V::LEN]);
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;
    use crate::path::Path;
    use crate::row::load_around;

    #[test]
    fn the_halves_of_a_row_add_up_to_it() {
        for width in [64, 65, 79, 640] {
            let row: Vec<f64> = (0..width).map(|u| (7 * u * u % 31) as f64).collect();
            for path in Path::available() {
                let (mut folds, mut plain) = (Folds::<f64>::new(width), Folds::<f64>::new(width));
                dispatch!(path.level(), simd => {
                    fill(simd, &mut folds, &row, true);
                    fill(simd, &mut plain, &row, false);
                });
                assert_eq!(plain.whole()[1][..width], row, "{width} samples, {path}");
                for u in 0..width.div_ceil(2) {
                    let (even, odd) = (folds.even()[1][u], folds.odd()[1][u]);
                    let expected = (2.0 * row[u], 2.0 * row[width - 1 - u]);
                    assert_eq!((even + odd, even - odd), expected, "{width} samples, {path}");
                }
            }
        }
    }

    #[inline(always)]
    fn fill<S: Simd>(simd: S, folds: &mut Folds<f64>, row: &[f64], folded: bool) {
        folds.fill(
            simd,
            (row.len(), folded),
            #[inline(always)]
            |at, place| {
                let [_, here, _] = load_around(simd, row, at, place);
                [S::f64s::splat(simd, 0.0), here]
            },
        );
    }
}
