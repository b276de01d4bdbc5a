//! The pixel mean square error `ē_I` of Eq. (26): what the order rule and an adaptive gain follow.
//!
//! Over pixels with weight it is a weighted mean; with a light that is known, the mean of what that light leaves unexplained.

use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch};

use crate::image::Plane;
use crate::light::across;
use crate::path::Path;
use crate::row::load;
use crate::sample::Sample;

/// Mean of `(I - I*)²`; of `(I - I* - C h)²` with light `h`; weighted, if there are weights. Not finite if a pixel is not.
pub(crate) fn pixel_mse<T: Sample>(
    path: Path,
    image: &Plane<T>,
    desired: &Plane<T>,
    weight: Option<&Plane<T>>,
    light: Option<[f64; 6]>,
) -> f64 {
    let [gain, offset, gain_u, gain_v, offset_u, offset_v] = light.unwrap_or_default();
    let (mut squares, mut weights) = (0.0, 0.0);
    for v in 0..image.height() {
        let down = across(v, image.height());
        let row = Row {
            own: image.row(v),
            desired: desired.row(v),
            weight: weight.map(|weight| weight.row(v)),
            light: light.map(|_| [1.0 + gain + gain_v * down, gain_u, offset + offset_v * down, offset_u]),
        };
        let [row_squares, row_weights] = dispatch!(path.level(), simd => row.sums(simd));
        squares += row_squares;
        weights += row_weights;
    }
    squares / weights
}

/// One row of both images.
#[derive(Clone, Copy)]
struct Row<'a, T> {
    own: &'a [T],
    desired: &'a [T],
    weight: Option<&'a [T]>,
    /// `I* → (light[0] + light[1] u) I* + light[2] + light[3] u`, with `u` from -1 to 1; `None` leaves `I*` as it is.
    light: Option<[f64; 4]>,
}

impl<T: Sample> Row<'_, T> {
    /// `[Σ w (I - lit I*)², Σ w]`.
    #[inline(always)]
    fn sums<S: Simd>(&self, simd: S) -> [f64; 2] {
        let (lanes, wide) = (T::Vector::<S>::LEN, S::f64s::LEN);
        let whole = self.own.len() - self.own.len() % lanes;
        let zero = S::f64s::splat(simd, 0.0);
        let (mut squares, mut weights) = ([zero; 2], [zero; 2]);
        let ramp = S::f64s::from_fn(simd, |lane| lane as f64);
        let per_pixel = across(1, self.own.len()) - across(0, self.own.len());
        for at in (0..whole).step_by(lanes) {
            let (own, desired) = (load(simd, self.own, at), load(simd, self.desired, at));
            let mut differences = T::widened(simd, own - desired);
            if let Some([gain, gain_u, offset, offset_u]) = self.light {
                let (own, desired) = (T::widened(simd, own), T::widened(simd, desired));
                for k in 0..T::WIDE {
                    let right = (ramp + (at + k * wide) as f64) * per_pixel - 1.0;
                    differences[k] = own[k] - (right * gain_u + gain) * desired[k] - (right * offset_u + offset);
                }
            }
            let mut weighted = differences;
            if let Some(weight) = self.weight {
                let weight = T::widened(simd, load(simd, weight, at));
                for k in 0..T::WIDE {
                    weighted[k] = weight[k] * differences[k];
                    weights[k] += weight[k];
                }
            }
            for k in 0..T::WIDE {
                squares[k] = weighted[k].mul_add(differences[k], squares[k]);
            }
        }
        let mut sums = [(squares[0] + squares[1]).reduce_sum(), (weights[0] + weights[1]).reduce_sum()];
        if self.weight.is_none() {
            sums[1] = whole as f64;
        }
        for u in whole..self.own.len() {
            let difference = match self.light {
                None => (self.own[u] - self.desired[u]).to_f64(),
                Some([gain, gain_u, offset, offset_u]) => {
                    let right = u as f64 * per_pixel - 1.0;
                    self.own[u].to_f64()
                        - (gain + gain_u * right) * self.desired[u].to_f64()
                        - offset
                        - offset_u * right
                }
            };
            let weight = self.weight.map_or(1.0, |weight| weight[u].to_f64());
            sums[0] += weight * difference * difference;
            sums[1] += weight;
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(phase: f64) -> Plane<f64> {
        Plane::from_fn(21, 17, |u, v| 0.5 + 0.4 * (0.3 * u as f64 + 0.2 * v as f64 + phase).sin())
    }

    #[test]
    fn a_light_that_is_known_leaves_no_error() {
        let (desired, light) = (picture(0.0), [-0.3, 0.1, 0.2, -0.1, 0.05, 0.02]);
        let lit = Plane::from_fn(21, 17, |u, v| {
            let (x, y) = (across(u, 21), across(v, 17));
            let [g, o, gu, gv, ou, ov] = light;
            (1.0 + g + gu * x + gv * y) * desired.at(u, v) + o + ou * x + ov * y
        });
        assert!(pixel_mse(Path::best(), &lit, &desired, None, Some(light)) < 1e-30, "rounding, squared");
        assert!(pixel_mse(Path::best(), &lit, &desired, None, None) > 1e-2);
    }

    #[test]
    fn weights_make_a_weighted_mean() {
        let (image, desired) = (picture(0.4), picture(0.0));
        let weight = Plane::from_fn(21, 17, |u, v| ((u + 2 * v) % 3) as f64 / 2.0);
        let sums = (0..21 * 17).fold([0.0; 2], |[squares, weights], i| {
            let [w, a, b] = [&weight, &image, &desired].map(|plane| plane.samples()[i]);
            [squares + w * (a - b) * (a - b), weights + w]
        });
        assert!(
            (pixel_mse(Path::best(), &image, &desired, Some(&weight), None) - sums[0] / sums[1]).abs() < 1e-15,
            "357 terms near 0.1"
        );
        let even = pixel_mse(Path::best(), &image, &desired, Some(&Plane::filled(21, 17, 0.25)), None);
        assert!((even - pixel_mse(Path::best(), &image, &desired, None, None)).abs() < 1e-15);
    }
}
