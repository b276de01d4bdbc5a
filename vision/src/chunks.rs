//! Rows in chunks of four samples: what the methods on pixels still multiply with.

use crate::sample::Sample;

/// Samples that are worked on side by side; rows are padded with zeros to whole chunks.
pub(crate) const LANES: usize = 4;

/// A row of samples in whole chunks.
pub(crate) type Chunks<T> = Vec<[T; LANES]>;

/// A zeroed row for `length` samples.
pub(crate) fn padded_row<T: Sample>(length: usize) -> Chunks<T> {
    vec![[T::ZERO; LANES]; length.div_ceil(LANES)]
}

/// The products of `P` plane rows with `C` carriers. Every pair has its own strands, one per lane: no strand waits for another,
/// and the compiler may keep each in one register (so `P * C` stays at 10 or below, of 16).
#[inline(always)]
pub(crate) fn tile<T: Sample, const P: usize, const C: usize>(
    planes: [&[[T; LANES]]; P],
    carriers: [&[[T; LANES]]; C],
) -> [[f64; P]; C] {
    let length = carriers[0].len();
    let planes = planes.map(|plane| &plane[..length]);
    let carriers = carriers.map(|carrier| &carrier[..length]);
    let mut strands = [[[T::ZERO; LANES]; P]; C];
    for i in 0..length {
        for c in 0..C {
            for p in 0..P {
                for lane in 0..LANES {
                    strands[c][p][lane] += carriers[c][i][lane] * planes[p][i][lane];
                }
            }
        }
    }
    strands.map(|of_carrier| of_carrier.map(|lanes| add_lanes(&lanes)))
}

/// The lanes of a strand, added in `f64`. Not inlined: seeing these sums, the compiler would lay the strands' lanes out across strands.
#[inline(never)]
pub(crate) fn add_lanes<T: Sample>(lanes: &[T; LANES]) -> f64 {
    lanes.iter().map(|lane| lane.to_f64()).sum()
}
