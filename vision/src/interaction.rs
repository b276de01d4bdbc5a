//! How the image moves under a camera twist: `L_x` of a point, and `L_I` of the brightness, Eq. (36)–(38).
//!
//! `L_I = -∇Iᵀ L_κ L_x`, with `∇I` in brightness per pixel, by central differences (one-sided at the border), and `L_κ` the focal
//! lengths in pixels. Its projection on `p_nm` is a row of the interaction matrix, Eq. (40) and (52). Written out, with
//! `g_u = f_u ∇I_u`, `g_v = f_v ∇I_v` and `ζ = 1/Z`:
//!
//! ```text
//! L_I = [ ζ g_u,  ζ g_v,  -ζ(x g_u + y g_v),  -(x y g_u + (1 + y²) g_v),  (1 + x²) g_u + x y g_v,  x g_v - y g_u ]
//! ```

use std::ops::{Add, Mul, Neg, Sub};

use fearless_simd::Simd;
use nalgebra::Matrix2x6;

use crate::image::Plane;
use crate::row::{load, load_beside};
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
        let along_u = load_beside::<S, T, 1>(simd, self.here, at) - load_beside::<S, T, -1>(simd, self.here, at);
        let along_v = load(simd, self.below, at) - load(simd, self.above, at);
        [along_u * T::from_f64(0.5), along_v * self.along_v]
    }
}

/// The moments, along one image row and for one `p_n`, of what `L_I` is made of. `g_u` and `g_v` are `f_u ∇I_u` and `f_v ∇I_v`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GradientMoments<N> {
    /// Of `g_u`, `x g_u` and `x² g_u`.
    pub g_u: [N; 3],
    /// Of `g_v` and `x g_v`.
    pub g_v: [N; 2],
    /// Of `ζ g_u` and `x ζ g_u`.
    pub zeta_g_u: [N; 2],
    /// Of `ζ g_v`.
    pub zeta_g_v: N,
}

impl<N: Copy + Add<Output = N> + Sub<Output = N> + Mul<Output = N> + Neg<Output = N>> GradientMoments<N> {
    /// The six columns of `L_I`, projected on `p_n` along the row at normalized `y`; of one `n`, or of as many as a vector holds.
    #[inline(always)]
    pub(crate) fn interaction(&self, y: N, one_and_yy: N) -> [N; 6] {
        let GradientMoments { g_u, g_v, zeta_g_u, zeta_g_v } = *self;
        [
            zeta_g_u[0],
            zeta_g_v,
            -(zeta_g_u[1] + y * zeta_g_v),
            -(y * g_u[1] + one_and_yy * g_v[0]),
            g_u[0] + g_u[2] + y * g_v[1],
            g_v[1] - y * g_u[0],
        ]
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
        let mut rows = dispatch!(path.level(), simd => all(simd, &slopes, image.width()));
        rows.iter_mut().for_each(|row| row.truncate(image.width()));
        rows
    }

    #[inline(always)]
    fn all<S: Simd>(simd: S, slopes: &Slopes<'_, f64>, width: usize) -> [Vec<f64>; 2] {
        let mut rows = [Vec::new(), Vec::new()];
        for at in (0..width).step_by(S::f64s::LEN) {
            for (row, part) in rows.iter_mut().zip(slopes.at(simd, at)) {
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

    #[test]
    fn the_written_out_row_is_minus_gradient_times_l_x() {
        let (x, y, depth_m, g) = (0.3, -0.2, 0.8, [1.7, -0.6]);
        let zeta = 1.0 / depth_m;
        let at_one_pixel = GradientMoments {
            g_u: [g[0], x * g[0], x * x * g[0]],
            g_v: [g[1], x * g[1]],
            zeta_g_u: [zeta * g[0], x * zeta * g[0]],
            zeta_g_v: zeta * g[1],
        };
        let expected = -nalgebra::RowVector2::from(g) * point_interaction(x, y, depth_m);
        let worst =
            at_one_pixel.interaction(y, 1.0 + y * y).into_iter().zip(expected.iter()).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f64::max) < 1e-15, "numbers near 1: a rounding error or two");
    }
}
