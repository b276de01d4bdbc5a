//! The Gaussian blur in full: `G(x) = Σ_u J(u) exp(-|u - x|²/2λ²)` at every pixel `x`, the sum over the pixels of the image alone.
//!
//! Un-normalised, so that a pixel near the border gathers less; nothing stands outside. Separable: one matrix `K` for each axis, whose rows are
//! bells. Only entries below the samples' own rounding are left out. All sums are `f64`: a blur takes away most of what is rough, and what it
//! leaves of `f32` sums would be their rounding. The time grows with the extent: [`crate::low_rank`] is the way around.

use crate::banded::BandedRow;
use crate::image::Plane;
use crate::sample::Sample;

/// How far a blur of this extent reaches: farther, a tap is nothing beside the sum.
pub(crate) fn reach<T: Sample>(extent_px: f64) -> f64 {
    extent_px * ((-2.0 * T::EPSILON.to_f64().ln()).sqrt() + 1.0)
}

/// `scale exp(-(x - p)²/2λ²)` at the pixels `p` within reach of `x`, which need not be a pixel, of an axis of `length`.
pub(crate) fn bell<T: Sample>(extent_px: f64, length: usize, x: f64, scale: f64) -> BandedRow {
    let (reach, last) = (reach::<T>(extent_px), (length - 1) as f64);
    let first = (x - reach).ceil().clamp(0.0, last) as usize;
    let end = (x + reach).floor().clamp(0.0, last) as usize;
    let value = |p: usize| scale * (-0.5 * ((p as f64 - x) / extent_px).powi(2)).exp();
    BandedRow { first, values: (first..=end).map(value).collect(), sign: 1.0 }
}

/// `K` of an axis of `length` pixels: a row for each.
pub(crate) fn bells<T: Sample>(extent_px: f64, length: usize) -> Vec<BandedRow> {
    (0..length).map(|x| bell::<T>(extent_px, length, x as f64, 1.0)).collect()
}

/// The Gaussian mixture of a plane, `G(x) = Σ_u J(u) exp(-|u - x|²/2λ²)` at every pixel, with `λ = extent_px`: un-normalised, summed over the
/// plane's own pixels. `extent_px` must be positive.
pub fn blur<T: Sample>(plane: &Plane<T>, extent_px: f64) -> Plane<T> {
    let [width, height] = plane.size();
    let (along_u, along_v) = (bells::<T>(extent_px, width), bells::<T>(extent_px, height));
    let (mut blurred, mut column_sums) = (plane.clone(), vec![0.0; width]);
    for (row, bell) in blurred.samples_mut().chunks_exact_mut(width).zip(&along_v) {
        column_sums.fill(0.0);
        for (v, tap) in (bell.first..).zip(&bell.values) {
            for (sum, sample) in column_sums.iter_mut().zip(plane.row(v)) {
                *sum += tap * sample.to_f64();
            }
        }
        for (sample, bell) in row.iter_mut().zip(&along_u) {
            let seen = &column_sums[bell.first..][..bell.values.len()];
            *sample = T::from_f64(bell.values.iter().zip(seen).map(|(tap, sum)| tap * sum).sum());
        }
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
