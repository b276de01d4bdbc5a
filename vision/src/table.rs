//! The table of features: moments along `u`, times `q_m(v)`, added up over the rows of an image.
//!
//! A block of image rows is added at a time, so that each number of the table is fetched and put back once for several rows.

use std::ops::Range;

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::basis::Basis;
use crate::moments::FeatureRow;

/// A feature's error, then its row of `L`.
pub(crate) const ERROR_AND_INTERACTION: usize = 7;

/// A feature's row of `C`.
pub(crate) const LIGHT: usize = 6;

/// Image rows that are added together.
pub(crate) const BLOCK: usize = 8;

/// `f64` numbers in the longest vector.
const LONGEST: usize = 8;

/// Room for so many numbers in whole vectors.
pub(crate) fn padded(count: usize) -> usize {
    count.next_multiple_of(LONGEST)
}

/// So many numbers for each feature `n + m <= order`.
#[derive(Debug)]
pub(crate) struct FeatureTable<const COLUMNS: usize> {
    order: usize,
    stride: usize,
    /// `[m][column][n]`, the last padded to whole vectors; what stands at `n + m > order` means nothing.
    values: Vec<f64>,
}

impl<const COLUMNS: usize> FeatureTable<COLUMNS> {
    pub(crate) fn new(highest_order: usize) -> FeatureTable<COLUMNS> {
        let stride = padded(highest_order + 1);
        FeatureTable { order: 0, stride, values: vec![0.0; (highest_order + 1) * COLUMNS * stride] }
    }

    /// The highest order it was filled to.
    pub(crate) fn order(&self) -> usize {
        self.order
    }

    /// Numbers between two columns, here and in what [`FeatureTable::add_rows`] takes.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// The numbers of one feature.
    pub(crate) fn at(&self, n: usize, m: usize) -> [f64; COLUMNS] {
        std::array::from_fn(|column| self.values[(m * COLUMNS + column) * self.stride + n])
    }

    /// Starts anew, for features up to this order.
    pub(crate) fn clear(&mut self, order: usize) {
        self.order = order;
        self.values.fill(0.0);
    }

    /// Multiply-adds of use for one image row.
    pub(crate) fn multiply_adds_of_a_row(&self) -> usize {
        COLUMNS * (self.order + 1) * (self.order + 2) / 2
    }

    /// Adds `q_m(v)` times the columns of every `v` in `rows`, at most [`BLOCK`] of them, to every feature with `n + m <= order`;
    /// `columns` is `[v - rows.start][column][n]`.
    #[inline(always)]
    pub(crate) fn add_rows<S: Simd>(&mut self, simd: S, columns: &[f64], rows: Range<usize>, basis_v: &Basis) {
        let (lanes, stride) = (S::f64s::LEN, self.stride);
        for m in 0..=self.order {
            let q = &basis_v.row(m)[rows.clone()];
            for column in 0..COLUMNS {
                let sums = &mut self.values[(m * COLUMNS + column) * stride..][..stride];
                for at in (0..=self.order - m).step_by(lanes) {
                    let mut sum = S::f64s::from_slice(simd, &sums[at..at + lanes]);
                    for (row, q) in columns.chunks_exact(COLUMNS * stride).zip(q) {
                        let part = &row[column * stride + at..][..lanes];
                        sum = S::f64s::from_slice(simd, part).mul_add(*q, sum);
                    }
                    sum.store_slice(&mut sums[at..at + lanes]);
                }
            }
        }
    }
}

impl FeatureTable<ERROR_AND_INTERACTION> {
    /// `L` of this view becomes `½(L + L*)`, Eq. (40) and (52); `e` stays.
    pub(crate) fn take_mean_interaction(&mut self, desired: &Self) {
        let length = ERROR_AND_INTERACTION * self.stride;
        for (own, desired) in self.values.chunks_exact_mut(length).zip(desired.values.chunks_exact(length)) {
            for (own, desired) in own[self.stride..].iter_mut().zip(&desired[self.stride..]) {
                *own = 0.5 * (*own + desired);
            }
        }
    }

    /// The features up to this order, `n` outside, `m` inside.
    pub(crate) fn rows(&self, order: usize) -> impl Iterator<Item = FeatureRow> {
        indices(order).map(|(n, m)| {
            let [error, interaction @ ..] = self.at(n, m);
            FeatureRow { n, m, error, interaction }
        })
    }
}

/// All `(n, m)` with `n + m <= order`, `n` outside, `m` inside.
fn indices(order: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=order).flat_map(move |n| (0..=order - n).map(move |m| (n, m)))
}
