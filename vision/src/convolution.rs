//! The Gaussian blur in full: `G(x) = Σ_u J(u) exp(-|u - x|²/2λ²)` at every pixel `x`, the sum over the pixels of the image alone.
//!
//! Un-normalised, so that a pixel near the border gathers less; nothing stands outside. Separable: every row along `u` first, then strips of
//! columns along `v`, in bands as high as the blur reaches. Only taps below the samples' own rounding are left out. All sums are `f64`: a blur takes away most of what is rough,
//! and what it leaves of `f32` sums would be their rounding. The time grows with the extent: [`crate::low_rank`] is the way around.

use std::ops::Range;

use crate::chunks::LANES;
use crate::image::Plane;
use crate::sample::Sample;

/// Columns that are summed side by side.
pub(crate) const STRIP: usize = 4 * LANES;

/// One stretch of a blurred row.
pub(crate) type Stretch = [f64; STRIP];

/// Rows that are finished together, at least.
const BAND: usize = 64;

/// Buffers for blurring planes of one size by one extent, a band of rows at a time.
#[derive(Debug)]
pub(crate) struct Convolution {
    size: [usize; 2],
    /// `exp(-d²/2λ²)` for `d = -half … half`, along `u` and along `v`.
    taps: [Vec<f64>; 2],
    /// A row with `half` zeros before it, and `half` and a stretch behind.
    row: Vec<f64>,
    /// The rows that `along_u` has room for, and the first one it holds.
    capacity: usize,
    start: usize,
    /// By plane: rows blurred along `u`, `[strip][row - start]`.
    along_u: Vec<Vec<Stretch>>,
    /// The first row that is not finished.
    next: usize,
    /// By plane: one strip of a band, blurred along both.
    finished: Vec<Vec<Stretch>>,
}

/// How far a blur of this extent reaches over `length` pixels: farther, a tap is nothing beside the sum.
fn reach<T: Sample>(extent_px: f64, length: usize) -> usize {
    let widths = (-2.0 * T::EPSILON.to_f64().ln()).sqrt() + 1.0;
    ((widths * extent_px).ceil() as usize).min(length - 1)
}

/// How many taps a blur of this extent has over `length` pixels.
pub(crate) fn tap_count<T: Sample>(extent_px: f64, length: usize) -> usize {
    2 * reach::<T>(extent_px, length) + 1
}

fn taps<T: Sample>(extent_px: f64, length: usize) -> Vec<f64> {
    let half = reach::<T>(extent_px, length) as i64;
    (-half..=half).map(|d| (-0.5 * (d as f64 / extent_px).powi(2)).exp()).collect()
}

impl Convolution {
    /// Buffers for `planes` planes of `[width, height]` samples `T`.
    pub(crate) fn new<T: Sample>(extent_px: f64, [width, height]: [usize; 2], planes: usize) -> Convolution {
        let taps = [width, height].map(|length| taps::<T>(extent_px, length));
        let (strips, capacity) = (width.div_ceil(STRIP), (BAND + taps[1].len() - 1).min(height));
        Convolution {
            size: [width, height],
            row: vec![0.0; strips * STRIP + taps[0].len() - 1],
            taps,
            capacity,
            start: 0,
            along_u: vec![vec![[0.0; STRIP]; strips * capacity]; planes],
            next: 0,
            finished: vec![vec![[0.0; STRIP]; capacity]; planes],
        }
    }

    /// Takes row `v` of all planes, from `v = 0` down. Whenever a band of rows has all it needs, `each` gets it strip by strip: the strip's
    /// number, the rows, and a stretch for each of them by plane. The last strip is filled up with zeros.
    pub(crate) fn take_row<'a, T: Sample>(
        &mut self,
        v: usize,
        planes: impl Iterator<Item = &'a [T]>,
        mut each: impl FnMut(usize, Range<usize>, &[Vec<Stretch>]),
    ) {
        if v == 0 {
            (self.start, self.next) = (0, 0);
        }
        for (plane, samples) in planes.enumerate() {
            self.blur_row(plane, v, samples);
        }
        let ([width, height], half) = (self.size, self.taps[1].len() / 2);
        let rows = match v + 1 {
            last if last == height => self.next..height,
            full if full == self.start + self.capacity => self.next..full - half,
            _ => return,
        };
        for strip in 0..width.div_ceil(STRIP) {
            for plane in 0..self.finished.len() {
                self.finish(plane, strip, rows.clone());
            }
            each(strip, rows.clone(), &self.finished);
        }
        self.drop_rows_before(rows.end - half.min(rows.end));
        self.next = rows.end;
    }

    /// Blurs a row along `u`.
    fn blur_row<T: Sample>(&mut self, plane: usize, v: usize, samples: &[T]) {
        let (width, half) = (self.size[0], self.taps[0].len() / 2);
        for (slot, sample) in self.row[half..half + width].iter_mut().zip(samples) {
            *slot = sample.to_f64();
        }
        for strip in 0..width.div_ceil(STRIP) {
            let first = strip * STRIP;
            // Taps that see nothing but the zeros before or behind the row are passed over.
            let from = half.saturating_sub(first + STRIP - 1);
            let to = (half + width - first).min(self.taps[0].len());
            let windows = self.row[first + from..first + to + STRIP - 1].windows(STRIP);
            let mut sums = weighted(self.taps[0][from..to].iter().zip(windows));
            sums[(width - first).min(STRIP)..].fill(0.0);
            self.along_u[plane][strip * self.capacity + v - self.start] = sums;
        }
    }

    /// Blurs a strip of some rows along `v`.
    fn finish(&mut self, plane: usize, strip: usize, rows: Range<usize>) {
        let (height, half) = (self.size[1], self.taps[1].len() / 2);
        let column = &self.along_u[plane][strip * self.capacity..][..self.capacity];
        for (v, finished) in rows.clone().zip(&mut self.finished[plane]) {
            let (from, to) = (v.saturating_sub(half), (v + half + 1).min(height));
            let stretches = &column[from - self.start..to - self.start];
            let taps = &self.taps[1][half + from - v..];
            *finished = weighted(taps.iter().zip(stretches.iter().map(|stretch| &stretch[..])));
        }
    }

    fn drop_rows_before(&mut self, start: usize) {
        let dropped = start - self.start;
        for column in self.along_u.iter_mut().flat_map(|plane| plane.chunks_exact_mut(self.capacity)) {
            column.copy_within(dropped.., 0);
        }
        self.start = start;
    }
}

/// `Σ tap · stretch`.
#[inline(always)]
fn weighted<'a>(terms: impl Iterator<Item = (&'a f64, &'a [f64])>) -> Stretch {
    let mut sums = [0.0; STRIP];
    for (tap, stretch) in terms {
        for lane in 0..STRIP {
            sums[lane] += tap * stretch[lane];
        }
    }
    sums
}

/// The Gaussian mixture of a plane, `G(x) = Σ_u J(u) exp(-|u - x|²/2λ²)` at every pixel, with `λ = extent_px`: un-normalised, summed over the
/// plane's own pixels. `extent_px` must be positive.
pub fn blur<T: Sample>(plane: &Plane<T>, extent_px: f64) -> Plane<T> {
    let [width, height] = plane.size();
    let mut convolution = Convolution::new::<T>(extent_px, [width, height], 1);
    let mut blurred = plane.clone();
    for v in 0..height {
        convolution.take_row(v, std::iter::once(plane.row(v)), |strip, rows, finished| {
            let (first, count) = (strip * STRIP, STRIP.min(width - strip * STRIP));
            for (v, stretch) in rows.zip(&finished[0]) {
                for (sample, sum) in blurred.samples_mut()[v * width + first..][..count].iter_mut().zip(stretch) {
                    *sample = T::from_f64(*sum);
                }
            }
        });
    }
    blurred
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_is_the_double_sum_whatever_the_extent_and_shape() {
        for (width, height, extent_px) in
            [(9, 7, 0.5), (37, 20, 3.0), (16, 33, 512.0), (5, 2, 1.0), (40, 8, 9.0), (19, 301, 4.0)]
        {
            let plane = Plane::from_fn(width, height, |u, v| ((u * 7 + v * 13 + u * v) % 17) as f64 - 6.0);
            let blurred = blur(&plane, extent_px);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let squared = |u: usize, v: usize| (u as f64 - x as f64).powi(2) + (v as f64 - y as f64).powi(2);
                let pixels = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
                let (mut sum, mut size) = (0.0, 0.0);
                for (u, v) in pixels {
                    let weight = (-squared(u, v) / (2.0 * extent_px * extent_px)).exp();
                    sum += plane.at(u, v) * weight;
                    size += plane.at(u, v).abs() * weight;
                }
                let difference = (blurred.at(x, y) - sum).abs();
                assert!(difference < 1e-14 * size, "{difference:e} at {x}, {y}: a few roundings of at most {size}");
            }
        }
    }
}
