//! How noisy an image is (deviation D16): Immerkaer's fast estimate (Computer Vision and Image Understanding 64(2), 1996, pp. 300–302).
//!
//! `σ = √(π/2) · mean |I * K| / 6` with `K = [1 -2 1; -2 4 -2; 1 -2 1]`, the difference of two Laplacians: it is blind to brightness that is
//! linear along a row or a column, and so to most of a picture, but not to fine texture, which it takes for noise.

use crate::image::Plane;
use crate::sample::Sample;

/// Least initial pixel error once noise is taken off: an initial image that is all noise still has somewhere to come from.
pub(crate) const LEAST_INITIAL_MSE: f64 = 2e-3;

/// `σ²` of the noise, over the pixels whose nine neighbours all have weight; 0 if there is none.
pub(crate) fn noise_variance<T: Sample>(image: &Plane<T>, weight: Option<&Plane<T>>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for v in 1..image.height() - 1 {
        let rows = [v - 1, v, v + 1].map(|v| image.row(v));
        match weight.map(|weight| [v - 1, v, v + 1].map(|v| weight.row(v))) {
            None => {
                sum += row_sum(rows);
                count += image.width() - 2;
            }
            Some(weights) => {
                let has_weight = |u: usize| weights.iter().all(|row| row[u - 1..=u + 1].iter().all(|w| *w > T::ZERO));
                for u in (1..image.width() - 1).filter(|u| has_weight(*u)) {
                    sum += response(rows.map(|row| [row[u - 1], row[u], row[u + 1]]));
                    count += 1;
                }
            }
        }
    }
    let mean = if count > 0 { sum / f64::from(u32::try_from(count).unwrap_or(u32::MAX)) } else { 0.0 };
    std::f64::consts::FRAC_PI_2 * (mean / 6.0) * (mean / 6.0)
}

/// `Σ |I * K|` along one row, in strands that need not wait for each other.
fn row_sum<T: Sample>([above, here, below]: [&[T]; 3]) -> f64 {
    const STRANDS: usize = 8;
    let mut strands = [0.0; STRANDS];
    let inner = here.len() - 2;
    let at = |u: usize| [above, here, below].map(|row| [row[u], row[u + 1], row[u + 2]]);
    for first in (0..inner / STRANDS).map(|chunk| chunk * STRANDS) {
        for (lane, strand) in strands.iter_mut().enumerate() {
            *strand += response(at(first + lane));
        }
    }
    let rest: f64 = (inner - inner % STRANDS..inner).map(|u| response(at(u))).sum();
    strands.iter().sum::<f64>() + rest
}

/// `|I * K|` at the middle of nine pixels.
fn response<T: Sample>(nine: [[T; 3]; 3]) -> f64 {
    let [above, here, below] = nine.map(|[left, middle, right]| left.to_f64() - 2.0 * middle.to_f64() + right.to_f64());
    (above - 2.0 * here + below).abs()
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
            let got = noise_variance(&noisy(sigma), None);
            // 1.9e4 responses, each 0.76 of its mean in deviation and correlated with its neighbours: 3 % of the variance is 3 deviations.
            assert!((got / (sigma * sigma) - 1.0).abs() < 0.03, "σ = {sigma}: {got}");
        }
    }

    #[test]
    fn a_linear_picture_has_no_noise() {
        let ramp = Plane::from_fn(33, 21, |u, v| 0.01 * u as f64 + 0.02 * v as f64);
        assert!(noise_variance(&ramp, None) < 1e-28, "rounding, squared");
    }

    #[test]
    fn pixels_without_weight_and_their_neighbours_are_not_looked_at() {
        let clean = Plane::from_fn(40, 30, |u, v| 0.01 * (u + v) as f64);
        let spoilt =
            Plane::from_fn(40, 30, |u, v| if u < 20 { f64::from((7 * u + 3 * v) as u8 % 5) } else { clean.at(u, v) });
        let weight = Plane::from_fn(40, 30, |u, _| if u < 20 { 0.0 } else { 1.0 });
        assert!(noise_variance(&spoilt, Some(&weight)) < 1e-28 && noise_variance(&spoilt, None) > 0.01);
        assert_eq!(noise_variance(&spoilt, Some(&Plane::filled(40, 30, 0.0))), 0.0);
        let plain = noise_variance(&clean, None);
        assert!((noise_variance(&clean, Some(&Plane::filled(40, 30, 1.0))) - plain).abs() < 1e-28);
    }
}
