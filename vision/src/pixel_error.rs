//! The pixel mean square error `ē_I` of Eq. (26): what the order rule and an adaptive gain follow.
//!
//! Over pixels with weight it is a weighted mean; with a light that is known, the mean of what that light leaves unexplained.

use crate::image::Plane;
use crate::light::across;
use crate::sample::Sample;

/// Samples that are added up side by side.
const STRANDS: usize = 8;

/// Mean of `(I - I*)²`; of `(I - I* - C h)²` with light `h`; weighted, if there are weights. Not finite if a pixel is not.
pub(crate) fn pixel_mse<T: Sample>(
    image: &Plane<T>,
    desired: &Plane<T>,
    weight: Option<&Plane<T>>,
    light: Option<[f64; 6]>,
) -> f64 {
    if weight.is_none() && light.is_none() {
        return mean_square_difference(image, desired);
    }
    let [gain, offset, gain_u, gain_v, offset_u, offset_v] = light.unwrap_or_default();
    let (mut squares, mut weights) = (0.0, 0.0);
    for v in 0..image.height() {
        let down = across(v, image.height());
        let row = Lit { gain: [1.0 + gain + gain_v * down, gain_u], offset: [offset + offset_v * down, offset_u] };
        let (own, desired) = (image.row(v), desired.row(v));
        let [row_squares, row_weights] = match weight.map(|weight| weight.row(v)) {
            None => [row.squares(own, desired, |_| 1.0), own.len() as f64],
            Some(weight) => {
                [row.squares(own, desired, |u| weight[u].to_f64()), weight.iter().map(|weight| weight.to_f64()).sum()]
            }
        };
        squares += row_squares;
        weights += row_weights;
    }
    squares / weights
}

/// The light along one row: `I* → (gain_0 + gain_1 u) I* + offset_0 + offset_1 u`, with `u` from -1 to 1.
struct Lit {
    gain: [f64; 2],
    offset: [f64; 2],
}

impl Lit {
    /// `Σ w (I - lit I*)²`.
    fn squares<T: Sample>(&self, own: &[T], desired: &[T], weight: impl Fn(usize) -> f64) -> f64 {
        let per_pixel = across(1, own.len()) - across(0, own.len());
        let square = |u: usize| {
            let right = u as f64 * per_pixel - 1.0;
            let [gain, offset] = [self.gain, self.offset].map(|[at_centre, slope]| at_centre + slope * right);
            let difference = own[u].to_f64() - gain * desired[u].to_f64() - offset;
            weight(u) * difference * difference
        };
        let (mut strands, whole) = ([0.0; STRANDS], own.len() - own.len() % STRANDS);
        for first in (0..whole).step_by(STRANDS) {
            for (lane, strand) in strands.iter_mut().enumerate() {
                *strand += square(first + lane);
            }
        }
        strands.iter().sum::<f64>() + (whole..own.len()).map(square).sum::<f64>()
    }
}

fn mean_square_difference<T: Sample>(image: &Plane<T>, desired: &Plane<T>) -> f64 {
    let mut strands = [0.0; STRANDS];
    let [(image, image_rest), (desired, desired_rest)] =
        [image, desired].map(|plane| plane.samples().as_chunks::<STRANDS>());
    let square = |a: T, b: T| (a - b).to_f64() * (a - b).to_f64();
    for (a, b) in image.iter().zip(desired) {
        for i in 0..STRANDS {
            strands[i] += square(a[i], b[i]);
        }
    }
    let rest: f64 = image_rest.iter().zip(desired_rest).map(|(a, b)| square(*a, *b)).sum();
    let count = (STRANDS * image.len() + image_rest.len()) as f64;
    (strands.iter().sum::<f64>() + rest) / count
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
        assert!(pixel_mse(&lit, &desired, None, Some(light)) < 1e-30, "rounding, squared");
        assert!(pixel_mse(&lit, &desired, None, None) > 1e-2);
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
            (pixel_mse(&image, &desired, Some(&weight), None) - sums[0] / sums[1]).abs() < 1e-15,
            "357 terms near 0.1"
        );
        let even = pixel_mse(&image, &desired, Some(&Plane::filled(21, 17, 0.25)), None);
        assert!((even - pixel_mse(&image, &desired, None, None)).abs() < 1e-15);
    }
}
