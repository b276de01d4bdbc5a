//! How the image moves under a camera twist: `L_x` of a point, and `L_I` of the brightness, Eq. (36)–(38).
//!
//! `L_I = -∇Iᵀ L_κ L_x`, with `∇I` in brightness per pixel, by central differences (one-sided at the border), and `L_κ` the focal
//! lengths in pixels. Its projection on `p_nm` is a row of the interaction matrix, Eq. (40) and (52). Written out, with
//! `g_u = f_u ∇I_u`, `g_v = f_v ∇I_v` and `ζ = 1/Z`:
//!
//! ```text
//! L_I = [ ζ g_u,  ζ g_v,  -ζ(x g_u + y g_v),  -(x y g_u + (1 + y²) g_v),  (1 + x²) g_u + x y g_v,  x g_v - y g_u ]
//! ```

use fearless_simd::Simd;
use nalgebra::Matrix2x6;

use crate::image::Plane;
use crate::row::{Place, load, load_around};
use crate::sample::Sample;

/// `L_x`: how a point at normalized `(x, y)` and depth `Z` moves under a camera twist, Eq. (37).
pub fn point_interaction(x: f64, y: f64, depth_m: f64) -> Matrix2x6<f64> {
    let inv_z = 1.0 / depth_m;
    #[rustfmt::skip]
    let l_x = Matrix2x6::new(
        -inv_z,    0.0, x * inv_z,       x * y, -(1.0 + x * x),  y,
           0.0, -inv_z, y * inv_z, 1.0 + y * y,         -x * y, -x,
    );
    l_x
}

/// The brightness around one image row, from which its slopes come: central differences, one-sided at the border. At least 2x2 pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slopes<'a, T> {
    above: &'a [T],
    here: &'a [T],
    below: &'a [T],
    along_v: T,
}

impl<'a, T: Sample> Slopes<'a, T> {
    /// Around row `v`.
    #[inline(always)]
    pub(crate) fn of(image: &'a Plane<T>, v: usize) -> Slopes<'a, T> {
        let (above, below) = (v.saturating_sub(1), (v + 1).min(image.height() - 1));
        let along_v = T::from_f64(1.0 / (below - above) as f64);
        Slopes { above: image.row(above), here: image.row(v), below: image.row(below), along_v }
    }

    /// `∇I_u` and `∇I_v` of the pixels from `at` on, in brightness per pixel; past the row's end they are finite and mean nothing.
    #[inline(always)]
    pub(crate) fn at<S: Simd>(&self, simd: S, at: usize, place: Place) -> [T::Vector<S>; 2] {
        let [left, _, right] = load_around(simd, self.here, at, place);
        let along_v = load(simd, self.below, at) - load(simd, self.above, at);
        [(right - left) * T::from_f64(0.5), along_v * self.along_v]
    }

    /// `∇(I - I')_u` and `I - I'` of the pixels from `at` on; the difference is taken first, so that it keeps its digits.
    #[inline(always)]
    pub(crate) fn difference<S: Simd>(
        &self,
        other: &Slopes<'_, T>,
        simd: S,
        at: usize,
        place: Place,
    ) -> [T::Vector<S>; 2] {
        let (own, other) = (load_around(simd, self.here, at, place), load_around(simd, other.here, at, place));
        [((own[2] - other[2]) - (own[0] - other[0])) * T::from_f64(0.5), own[1] - other[1]]
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{SimdBase, dispatch};

    use super::*;
    use crate::path::Path;

    /// `∇I_u` and `∇I_v` along row `v`, of any path.
    fn gradient(path: Path, image: &Plane<f64>, v: usize) -> [Vec<f64>; 2] {
        let slopes = Slopes::of(image, v);
        let mut rows = dispatch!(path.level(), simd => all(simd, &slopes, image));
        rows.iter_mut().for_each(|row| row.truncate(image.width()));
        rows
    }

    #[inline(always)]
    fn all<S: Simd>(simd: S, slopes: &Slopes<'_, f64>, image: &Plane<f64>) -> [Vec<f64>; 2] {
        let mut rows = [Vec::new(), Vec::new()];
        let lanes = S::f64s::LEN;
        for at in (0..image.width()).step_by(lanes) {
            let slopes_at = slopes.at(simd, at, Place::Border);
            if at > 0 && at + lanes < image.width() {
                let inside = slopes.at(simd, at, Place::Inside);
                assert_eq!(inside.map(|s| s.as_slice().to_vec()), slopes_at.map(|s| s.as_slice().to_vec()));
            }
            for (row, part) in rows.iter_mut().zip(slopes_at) {
                row.extend_from_slice(part.as_slice());
            }
        }
        rows
    }

    #[test]
    fn the_gradient_of_a_ramp_is_its_slope_up_to_the_border() {
        let ramp = Plane::from_fn(9, 7, |u, v| 3.0 * u as f64 - 2.0 * v as f64);
        for (path, v) in Path::available().into_iter().flat_map(|path| (0..7).map(move |v| (path, v))) {
            assert_eq!(gradient(path, &ramp, v), [[3.0; 9], [-2.0; 9]], "{path}");
        }
    }

    #[test]
    fn the_gradient_of_a_parabola_is_one_sided_at_the_border() {
        let parabola = Plane::from_fn(8, 8, |_, v| (v * v) as f64);
        for (v, slope) in [(0, 1.0), (1, 2.0), (6, 12.0), (7, 13.0)] {
            assert_eq!(gradient(Path::best(), &parabola, v)[1], [slope; 8]);
        }
    }
}
