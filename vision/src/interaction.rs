//! How the image moves under a camera twist: `L_x` of a point, and `L_I` of the brightness, Eq. (36)–(38).
//!
//! `L_I = -∇Iᵀ L_κ L_x`, with `∇I` in brightness per pixel, by central differences (one-sided at the border), and `L_κ` the focal
//! lengths in pixels. Its projection on `p_nm` is a row of the interaction matrix, Eq. (40) and (52). Written out, with
//! `g_u = f_u ∇I_u`, `g_v = f_v ∇I_v` and `ζ = 1/Z`:
//!
//! ```text
//! L_I = [ ζ g_u,  ζ g_v,  -ζ(x g_u + y g_v),  -(x y g_u + (1 + y²) g_v),  (1 + x²) g_u + x y g_v,  x g_v - y g_u ]
//! ```

use fearless_simd::{Simd, SimdBase};
use nalgebra::Matrix2x6;

use crate::image::Plane;
use crate::row::{each, load, load_left, load_right};
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
    pub(crate) fn at<S: Simd>(&self, simd: S, at: usize) -> [T::Vector<S>; 2] {
        let along_u = load_right(simd, self.here, at) - load_left(simd, self.here, at);
        let along_v = load(simd, self.below, at) - load(simd, self.above, at);
        [along_u * T::from_f64(0.5), along_v * self.along_v]
    }
}

/// Writes `∇I_u` along a whole row of at least two pixels, as [`Slopes::at`] has it. `out` has room for whole vectors.
#[inline(always)]
pub(crate) fn slopes_along_u<S: Simd, T: Sample>(simd: S, row: &[T], out: &mut [T]) {
    let (lanes, half) = (T::Vector::<S>::LEN, T::from_f64(0.5));
    // From the second vector on there is a pixel to the left, and to the right as long as `inner` lasts.
    let inner = row.len().saturating_sub(lanes + 1) / lanes * lanes;
    if inner > 0 {
        each(
            simd,
            &mut out[lanes..lanes + inner],
            [&row[lanes + 1..][..inner], &row[lanes - 1..][..inner]],
            #[inline(always)]
            |[right, left]| (right - left) * half,
        );
    }
    let mut at = 0;
    while at < row.len() {
        let slope = (load_right(simd, row, at) - load_left(simd, row, at)) * half;
        slope.store_slice(&mut out[at..at + lanes]);
        at += if at == 0 { lanes + inner } else { lanes };
    }
}

/// Writes `∇I_v` along the whole of row `v` of an image of at least two rows, as [`Slopes::at`] has it.
#[inline(always)]
pub(crate) fn slopes_along_v<S: Simd, T: Sample>(simd: S, image: &Plane<T>, v: usize, out: &mut [T]) {
    let (above, below) = (v.saturating_sub(1), (v + 1).min(image.height() - 1));
    let scale = T::from_f64(1.0 / (below - above) as f64);
    each(
        simd,
        out,
        [image.row(below), image.row(above)],
        #[inline(always)]
        |[below, above]| (below - above) * scale,
    );
}

#[cfg(test)]
mod tests {
    use fearless_simd::{SimdBase, dispatch};

    use super::*;
    use crate::path::Path;

    /// `∇I_u` and `∇I_v` along row `v`, of any path.
    fn gradient(path: Path, image: &Plane<f64>, v: usize) -> [Vec<f64>; 2] {
        let slopes = Slopes::of(image, v);
        let mut rows = dispatch!(path.level(), simd => all(simd, &slopes, image, v));
        rows.iter_mut().for_each(|row| row.truncate(image.width()));
        rows
    }

    #[inline(always)]
    fn all<S: Simd>(simd: S, slopes: &Slopes<'_, f64>, image: &Plane<f64>, v: usize) -> [Vec<f64>; 2] {
        let mut rows = [Vec::new(), Vec::new()];
        for at in (0..image.width()).step_by(S::f64s::LEN) {
            for (row, part) in rows.iter_mut().zip(slopes.at(simd, at)) {
                row.extend_from_slice(part.as_slice());
            }
        }
        let mut whole = [0; 2].map(|_| vec![0.0; rows[0].len()]);
        slopes_along_u(simd, slopes.here, &mut whole[0]);
        slopes_along_v(simd, image, v, &mut whole[1]);
        let inside = |rows: &[Vec<f64>; 2]| rows.each_ref().map(|row| row[..image.width()].to_vec());
        assert_eq!(inside(&whole), inside(&rows), "by rows as by vectors");
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
