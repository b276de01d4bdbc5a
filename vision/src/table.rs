//! The second stage: moments along `u`, times multipliers along `v` ([`crate::along_v`]), added up over the rows of an image; and the table of
//! features that comes of it.
//!
//! A block of image rows is added at a time, so that each sum is fetched and put back once for several rows.

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::along_v::Multiplier;
use crate::moments::FeatureRow;

/// A feature's error, then its row of `L`.
pub(crate) const ERROR_AND_INTERACTION: usize = 7;

/// A feature's row of `C`.
pub(crate) const LIGHT: usize = 6;

/// Image rows that are added together.
pub(crate) const BLOCK: usize = 16;

/// `f64` numbers in the longest vector.
pub(crate) const CHUNK: usize = 8;

/// The moments along `u` of a block of image rows.
#[derive(Debug)]
pub(crate) struct RowMoments {
    /// `[plane][row of the block][chunk of carriers][carrier within the chunk]`.
    values: Vec<[f64; CHUNK]>,
    chunks: usize,
}

impl RowMoments {
    /// Room for so many planes and carriers.
    pub(crate) fn new(planes: usize, carriers: usize) -> RowMoments {
        let chunks = carriers.div_ceil(CHUNK);
        RowMoments { values: vec![[0.0; CHUNK]; planes * BLOCK * chunks], chunks }
    }

    /// The moments of one row of the block, by carrier.
    #[inline(always)]
    pub(crate) fn row_mut(&mut self, plane: usize, row: usize) -> &mut [f64] {
        self.values[(plane * BLOCK + row) * self.chunks..][..self.chunks].as_flattened_mut()
    }

    /// Makes the rows from `first` on zeros: the last block of an image may have fewer.
    pub(crate) fn clear_rows(&mut self, first: usize) {
        for plane in self.values.chunks_exact_mut(BLOCK * self.chunks) {
            plane[first * self.chunks..].as_flattened_mut().fill(0.0);
        }
    }

    /// One chunk of carriers, of every row of the block.
    #[inline(always)]
    fn chunk<S: Simd>(&self, simd: S, plane: usize, chunk: usize, at: usize) -> [S::f64s; BLOCK] {
        let (lanes, mut rows) = (S::f64s::LEN, [S::f64s::splat(simd, 0.0); BLOCK]);
        let values = &self.values[plane * BLOCK * self.chunks..][..BLOCK * self.chunks];
        for row in 0..BLOCK {
            rows[row] = S::f64s::from_slice(simd, &values[row * self.chunks + chunk][at..at + lanes]);
        }
        rows
    }
}

/// One sum over all rows for every `m` and carrier: of which plane, times what, and with which powers of `x`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Term {
    /// The plane.
    pub plane: usize,
    /// What it is multiplied by along `v`.
    pub times: Multiplier,
    /// The highest power of `x` that is wanted of it.
    pub degree: usize,
}

/// The sums of up to so many terms.
#[derive(Debug)]
pub(crate) struct Sums {
    /// `[term][m][chunk of carriers][carrier within the chunk]`.
    values: Vec<[f64; CHUNK]>,
    chunks: usize,
    highest_order: usize,
}

impl Sums {
    /// Room for so many terms and carriers.
    pub(crate) fn new(terms: usize, carriers: usize, highest_order: usize) -> Sums {
        let chunks = carriers.div_ceil(CHUNK);
        Sums { values: vec![[0.0; CHUNK]; terms * (highest_order + 1) * chunks], chunks, highest_order }
    }

    /// Starts anew.
    pub(crate) fn clear(&mut self) {
        self.values.as_flattened_mut().fill(0.0);
    }

    /// Adds one block of one term to one chunk of carriers, for every `m` that has its factors there: `sums[m][n] += Σ_row factors[m][row] source[row][n]`.
    #[inline(always)]
    pub(crate) fn add<S: Simd>(
        &mut self,
        simd: S,
        (slot, term): (usize, Term),
        chunk: usize,
        moments: &RowMoments,
        factors: &[[f64; BLOCK]],
    ) {
        let (lanes, first, mut at) = (S::f64s::LEN, self.start(slot, 0), 0);
        while at < CHUNK {
            let source = moments.chunk(simd, term.plane, chunk, at);
            let sums = self.values[first + chunk..].iter_mut().step_by(self.chunks);
            for (sum, factors) in sums.zip(factors) {
                let sum = &mut sum[at..at + lanes];
                // Two strands, so that not every product waits for the one before.
                let mut strands = [S::f64s::from_slice(simd, sum), source[1] * factors[1]];
                for row in 0..BLOCK {
                    if row != 1 {
                        strands[row % 2] = source[row].mul_add(factors[row], strands[row % 2]);
                    }
                }
                (strands[0] + strands[1]).store_slice(sum);
            }
            at += lanes;
        }
    }

    /// The sums of one term and `m`, by carrier.
    pub(crate) fn of(&self, slot: usize, m: usize) -> &[f64] {
        self.values[self.start(slot, m)..][..self.chunks].as_flattened()
    }

    fn start(&self, slot: usize, m: usize) -> usize {
        (slot * (self.highest_order + 1) + m) * self.chunks
    }
}

/// So many numbers for each feature `n + m <= order`.
#[derive(Debug)]
pub(crate) struct FeatureTable<const COLUMNS: usize> {
    order: usize,
    highest_order: usize,
    /// `[m][n]`; what stands at `n + m > order` means nothing.
    values: Vec<[f64; COLUMNS]>,
}

impl<const COLUMNS: usize> FeatureTable<COLUMNS> {
    pub(crate) fn new(highest_order: usize) -> FeatureTable<COLUMNS> {
        let side = highest_order + 1;
        FeatureTable { order: 0, highest_order, values: vec![[0.0; COLUMNS]; side * side] }
    }

    /// The highest order it was filled to.
    pub(crate) fn order(&self) -> usize {
        self.order
    }

    /// The numbers of one feature.
    pub(crate) fn at(&self, n: usize, m: usize) -> &[f64; COLUMNS] {
        &self.values[m * (self.highest_order + 1) + n]
    }

    /// Takes the numbers of every feature up to this order.
    pub(crate) fn fill(&mut self, order: usize, feature: impl Fn(usize, usize) -> [f64; COLUMNS]) {
        self.order = order;
        for (n, m) in indices(order) {
            self.values[m * (self.highest_order + 1) + n] = feature(n, m);
        }
    }
}

impl FeatureTable<ERROR_AND_INTERACTION> {
    /// What was swept of the current view becomes `½(L + L*)`, Eq. (40) and (52): half of it, and so much of the desired half's columns of
    /// translation and of rotation; `e` stays.
    pub(crate) fn take_mean_interaction(&mut self, desired: &Self, [translation, rotation]: [f64; 2]) {
        for (n, m) in indices(self.order) {
            let (own, desired) = (&mut self.values[m * (self.highest_order + 1) + n], desired.at(n, m));
            for column in 1..ERROR_AND_INTERACTION {
                let of_desired = if column < 4 { translation } else { rotation };
                own[column] = 0.5 * own[column] + of_desired * desired[column];
            }
        }
    }

    /// The features up to this order, `n` outside, `m` inside.
    pub(crate) fn rows(&self, order: usize) -> impl Iterator<Item = FeatureRow> {
        indices(order).map(|(n, m)| {
            let [error, interaction @ ..] = *self.at(n, m);
            FeatureRow { n, m, error, interaction }
        })
    }
}

/// All `(n, m)` with `n + m <= order`, `n` outside, `m` inside.
fn indices(order: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=order).flat_map(move |n| (0..=order - n).map(move |m| (n, m)))
}
