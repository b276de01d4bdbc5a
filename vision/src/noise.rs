//! How noisy an image is (deviation D16): Immerkaer's fast estimate (Computer Vision and Image Understanding 64(2), 1996, pp. 300–302).
//!
//! `σ = √(π/2) · mean |I * K| / 6` with `K = [1 -2 1; -2 4 -2; 1 -2 1]`, the difference of two Laplacians: it is blind to brightness that is
//! linear along a row or a column, and so to most of a picture, but not to fine texture, which it takes for noise.

use fearless_simd::{Select, Simd, SimdBase, dispatch};

use crate::image::Plane;
use crate::path::Path;
use crate::row::load;
use crate::sample::Sample;

/// Least initial pixel error once noise is taken off: an initial image that is all noise still has somewhere to come from.
pub(crate) const LEAST_INITIAL_MSE: f64 = 2e-3;

/// `σ²` of the noise, over the pixels whose nine neighbours all have weight; 0 if there is none.
pub(crate) fn noise_variance<T: Sample>(path: Path, image: &Plane<T>, weight: Option<&Plane<T>>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in 1..image.height() - 1 {
        let nine = around(image, v);
        let [row_sum, row_count] = match weight {
            None => [dispatch!(path.level(), simd => plain(simd, nine)), nine[0].len() as f64],
            Some(weight) => dispatch!(path.level(), simd => weighted(simd, nine, around(weight, v))),
        };
        sum += row_sum;
        count += row_count;
    }
    let mean = if count > 0.0 { sum / count } else { 0.0 };
    std::f64::consts::FRAC_PI_2 * (mean / 6.0) * (mean / 6.0)
}

/// The nine neighbours of the pixels of row `v` that have so many, each as a row; above, here, below.
fn around<T: Sample>(plane: &Plane<T>, v: usize) -> [&[T]; 9] {
    let inner = plane.width() - 2;
    std::array::from_fn(|i| &plane.row(v + i / 3 - 1)[i % 3..][..inner])
}

/// `Σ |I * K|` along one row.
#[inline(always)]
fn plain<S: Simd, T: Sample>(simd: S, nine: [&[T]; 9]) -> f64 {
    let mut strand = T::Vector::<S>::splat(simd, T::ZERO);
    for at in (0..nine[0].len()).step_by(T::Vector::<S>::LEN) {
        strand += response(simd, nine, at);
    }
    total::<S, T>(simd, strand)
}

/// `Σ |I * K|` of those with weight, and how many these are.
#[inline(always)]
fn weighted<S: Simd, T: Sample>(simd: S, nine: [&[T]; 9], weights: [&[T]; 9]) -> [f64; 2] {
    let (none, one) = (T::Vector::<S>::splat(simd, T::ZERO), T::Vector::<S>::splat(simd, T::from_f64(1.0)));
    let (mut sum, mut count) = (none, none);
    for at in (0..nine[0].len()).step_by(T::Vector::<S>::LEN) {
        let mut least = one;
        for weight in weights {
            least = least.min(load::<S, T>(simd, weight, at));
        }
        let has_weight = least.simd_gt(none);
        sum += has_weight.select(response(simd, nine, at), none);
        count += has_weight.select(one, none);
    }
    [total::<S, T>(simd, sum), total::<S, T>(simd, count)]
}

/// `|I * K|` in the middle of nine pixels; nought past the row's end.
#[inline(always)]
fn response<S: Simd, T: Sample>(simd: S, nine: [&[T]; 9], at: usize) -> T::Vector<S> {
    let mut across = [T::Vector::<S>::splat(simd, T::ZERO); 3];
    for i in 0..3 {
        let [left, middle, right] =
            [load::<S, T>(simd, nine[3 * i], at), load(simd, nine[3 * i + 1], at), load(simd, nine[3 * i + 2], at)];
        across[i] = left - (middle + middle) + right;
    }
    (across[0] - (across[1] + across[1]) + across[2]).abs()
}

#[inline(always)]
fn total<S: Simd, T: Sample>(simd: S, strand: T::Vector<S>) -> f64 {
    let parts = T::widened(simd, strand);
    let mut sum = parts[0];
    for k in 1..T::WIDE {
        sum += parts[k];
    }
    sum.reduce_sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nearly normal noise of variance 1: the sum of twelve numbers from a fixed sequence, even in `[0, 1]`, less 6.
    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            let mut even = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            };
            (0..12).map(|_| even()).sum::<f64>() - 6.0
        }
    }

    fn noisy(sigma: f64) -> Plane<f64> {
        let mut normal = noise(7);
        let mut image = Plane::from_fn(160, 120, |u, v| 0.5 + 0.3 * (0.05 * u as f64).sin() * (0.04 * v as f64).cos());
        image.samples_mut().iter_mut().for_each(|sample| *sample += sigma * normal());
        image
    }

    #[test]
    fn the_variance_of_added_noise_is_found_on_a_smooth_picture() {
        for sigma in [0.02, 0.1, 0.4] {
            let got = noise_variance(Path::best(), &noisy(sigma), None);
            // 1.9e4 responses, each 0.76 of its mean in deviation and correlated with its neighbours: 3 % of the variance is 3 deviations.
            assert!((got / (sigma * sigma) - 1.0).abs() < 0.03, "σ = {sigma}: {got}");
        }
    }

    #[test]
    fn a_linear_picture_has_no_noise() {
        let ramp = Plane::from_fn(33, 21, |u, v| 0.01 * u as f64 + 0.02 * v as f64);
        assert!(noise_variance(Path::best(), &ramp, None) < 1e-28, "rounding, squared");
    }

    #[test]
    fn pixels_without_weight_and_their_neighbours_are_not_looked_at() {
        let clean = Plane::from_fn(40, 30, |u, v| 0.01 * (u + v) as f64);
        let spoilt =
            Plane::from_fn(40, 30, |u, v| if u < 20 { f64::from((7 * u + 3 * v) as u8 % 5) } else { clean.at(u, v) });
        let weight = Plane::from_fn(40, 30, |u, _| if u < 20 { 0.0 } else { 1.0 });
        assert!(
            noise_variance(Path::best(), &spoilt, Some(&weight)) < 1e-28
                && noise_variance(Path::best(), &spoilt, None) > 0.01
        );
        assert_eq!(noise_variance(Path::best(), &spoilt, Some(&Plane::filled(40, 30, 0.0))), 0.0);
        let plain = noise_variance(Path::best(), &clean, None);
        assert!((noise_variance(Path::best(), &clean, Some(&Plane::filled(40, 30, 1.0))) - plain).abs() < 1e-28);
    }
}
