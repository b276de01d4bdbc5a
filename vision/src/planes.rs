//! What every pixel says: the six planes of `½(L_I(I, Z) + L_I(I*, Z*))`, `I - I*`, and the six of light, a vector of pixels at a time.
//!
//! The methods that compare brightness itself start here. A pixel's row of the interaction matrix is the mean of the two images' `L_I`
//! ([`crate::interaction`]), each with its own gradient and its own depth; its error is `I - I*`. A weight multiplies them all.
//! Planes stay in the nearest cache; only [`pair_planes`], which is for judges and pictures, makes them in full.

use std::ops::Range;

use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch};

use crate::camera::Intrinsics;
use crate::depth::Depth;
use crate::features::{Sight, Sights};
use crate::gram::{COLUMNS, ERROR};
use crate::image::Plane;
use crate::interaction::Slopes;
use crate::light::across;
use crate::path::Path;
use crate::row::{Place, Row, load};
use crate::sample::Sample;
use crate::servo::View;

/// Planes of a law without light: six of the interaction matrix, then the error.
pub(crate) const PLAIN: usize = 7;

/// Which column of a [`crate::gram::Gram`] plane `i` is: the planes of light come last here, so that they can stay away.
pub(crate) fn gram_column(plane: usize) -> usize {
    match plane {
        0..6 => plane,
        6 => ERROR,
        _ => plane - 1,
    }
}

/// Where the columns of an image are.
#[derive(Debug)]
pub(crate) struct Across<T> {
    camera: Intrinsics,
    width: usize,
    /// Normalized `x`.
    x: Row<T>,
    /// From -1 to 1, for the light.
    right: Row<T>,
}

impl<T: Sample> Across<T> {
    /// Of images of `width` pixels.
    pub(crate) fn new(camera: Intrinsics, width: usize) -> Across<T> {
        let (mut x, mut right) = (Row::zeros(width), Row::zeros(width));
        for u in 0..width {
            x.padded_mut()[u] = T::from_f64(camera.x(u as f64));
            right.padded_mut()[u] = T::from_f64(across(u, width));
        }
        Across { camera, width, x, right }
    }

    /// Columns.
    pub(crate) fn width(&self) -> usize {
        self.width
    }
}

/// One image row of a pair of views, from which its planes are made.
pub(crate) struct PairRow<'a, T> {
    slopes: [Slopes<'a, T>; 2],
    /// `1/Z` of each view: of every pixel, or one number.
    per_m: [Result<&'a [T], T>; 2],
    images: [&'a [T]; 2],
    weight: Option<&'a [T]>,
    x: &'a [T],
    right: &'a [T],
    y: T,
    down: T,
    half_f: [T; 2],
}

impl<'a, T: Sample> PairRow<'a, T> {
    /// Row `v`.
    #[inline(always)]
    pub(crate) fn of(sights: Sights<'a, T>, across: &'a Across<T>, v: usize) -> PairRow<'a, T> {
        let (current, desired) = (sights.current, sights.desired);
        let [f_u, f_v] = across.camera.focal_px();
        PairRow {
            slopes: [Slopes::of(current.0, v), Slopes::of(desired.0, v)],
            per_m: [inverse_depth(current, v), inverse_depth(desired, v)],
            images: [current.0.row(v), desired.0.row(v)],
            weight: sights.weight.map(|weight| weight.row(v)),
            x: across.x.padded(),
            right: across.right.padded(),
            y: T::from_f64(across.camera.y(v as f64)),
            down: T::from_f64(crate::light::across(v, current.0.height())),
            half_f: [T::from_f64(0.5 * f_u), T::from_f64(0.5 * f_v)],
        }
    }

    /// The pixels `columns` of the first `N` planes, each from the beginning of a stretch, which is filled up with zeros.
    #[inline(always)]
    pub(crate) fn fill<S: Simd, const N: usize>(&self, simd: S, columns: Range<usize>, mut stretches: [&mut [T]; N]) {
        let (lanes, count) = (T::Vector::<S>::LEN, columns.len());
        for to in (0..count).step_by(lanes) {
            let planes = self.planes(simd, columns.start + to);
            for i in 0..N {
                planes[i].store_slice(&mut stretches[i][to..to + lanes]);
            }
        }
        if count < stretches[0].len() {
            for stretch in &mut stretches {
                stretch[count..].fill(T::ZERO);
            }
        }
    }

    /// `[ ζ g_u,  ζ g_v,  -ζ(x g_u + y g_v),  -(x y g_u + (1 + y²) g_v),  (1 + x²) g_u + x y g_v,  x g_v - y g_u ]`, linear in `g` and `ζ g`:
    /// of their means over both views; then `I - I*`, then `{I*, 1, u I*, v I*, u, v}`. Past the row's end they mean nothing.
    #[inline(always)]
    fn planes<S: Simd>(&self, simd: S, at: usize) -> [T::Vector<S>; COLUMNS] {
        let one = T::Vector::<S>::splat(simd, T::from_f64(1.0));
        let place = Place::of::<S, T>(at, self.images[0].len());
        let ([own_u, own_v], [desired_u, desired_v]) =
            (self.slopes[0].at(simd, at, place), self.slopes[1].at(simd, at, place));
        let (own_zeta, desired_zeta) = (self.zeta::<S, 0>(simd, at), self.zeta::<S, 1>(simd, at));
        let (g_u, g_v) = ((own_u + desired_u) * self.half_f[0], (own_v + desired_v) * self.half_f[1]);
        let vx = own_zeta.mul_add(own_u, desired_zeta * desired_u) * self.half_f[0];
        let vy = own_zeta.mul_add(own_v, desired_zeta * desired_v) * self.half_f[1];

        let (x, y) = (load(simd, self.x, at), T::Vector::<S>::splat(simd, self.y));
        let vz = -x.mul_add(vx, y * vy);
        let outward = x.mul_add(g_u, y * g_v);
        let (wx, wy, wz) = (-y.mul_add(outward, g_v), x.mul_add(outward, g_u), x.mul_sub(g_v, y * g_u));

        let (own, desired) = (load(simd, self.images[0], at), load(simd, self.images[1], at));
        let (right, down) = (load(simd, self.right, at), T::Vector::<S>::splat(simd, self.down));
        let light = [desired, one, right * desired, down * desired, right, down];
        let mut planes =
            [vx, vy, vz, wx, wy, wz, own - desired, light[0], light[1], light[2], light[3], light[4], light[5]];
        if let Some(weight) = self.weight {
            let weight = load(simd, weight, at);
            for plane in &mut planes {
                *plane *= weight;
            }
        }
        planes
    }

    #[inline(always)]
    fn zeta<S: Simd, const VIEW: usize>(&self, simd: S, at: usize) -> T::Vector<S> {
        match self.per_m[VIEW] {
            Ok(row) => load(simd, row, at),
            Err(constant) => T::Vector::<S>::splat(simd, constant),
        }
    }
}

fn inverse_depth<'a, T: Sample>((_, depth): Sight<'a, T>, v: usize) -> Result<&'a [T], T> {
    match depth {
        Depth::Constant { depth_m } => Err(T::from_f64(1.0 / depth_m)),
        Depth::Map(map) => Ok(map.inverse_per_m().row(v)),
    }
}

/// The seven planes of a pair in full: the six columns of `½(L_I(I, Z) + L_I(I*, Z*))`, per m/s and rad/s, then `I - I*`.
///
/// These are what photometric servoing compares and, each blurred by [`crate::convolution::blur`], what the Gaussian mixture does. A servo never
/// makes them; they are here to be looked at, and checked. Panics unless both views have one size, of at least 2x2 pixels.
pub fn pair_planes<T: Sample>(camera: Intrinsics, current: View<'_, T>, desired: View<'_, T>) -> [Plane<T>; PLAIN] {
    let [width, height] = current.image.size();
    assert_eq!(desired.image.size(), [width, height], "one size for both images");
    let mut full = std::array::from_fn(|_| Plane::filled(width, height, T::ZERO));
    let mut rows: [Row<T>; PLAIN] = std::array::from_fn(|_| Row::zeros(width));
    let across = Across::new(camera, width);
    let [current, desired] = [current, desired].map(|view| (view.image, view.depth));
    let sights = Sights { current, desired, weight: None };
    for v in 0..height {
        let row = PairRow::of(sights, &across, v);
        let stretches = rows.each_mut().map(Row::padded_mut);
        dispatch!(Path::best().level(), simd => row.fill(simd, 0..width, stretches));
        for (full, row) in full.iter_mut().zip(&rows) {
            full.samples_mut()[v * width..][..width].copy_from_slice(&row.padded()[..width]);
        }
    }
    full
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_planes_of_light_are_the_desired_image_and_one_each_also_sloped_from_border_to_border() {
        let desired = Plane::from_fn(5, 3, |u, v| (1 + u + 10 * v) as f64);
        let depth = Depth::Constant { depth_m: 1.0 };
        let camera = Intrinsics::new([1.0; 2], [0.0; 2]).expect("a camera");
        let across = Across::new(camera, 5);
        let sights = Sights { current: (&desired, &depth), desired: (&desired, &depth), weight: None };
        let mut rows: [[f64; 16]; COLUMNS] = [[7.0; 16]; COLUMNS];
        let (row, stretches) = (PairRow::of(sights, &across, 2), rows.each_mut().map(|row| &mut row[..]));
        dispatch!(Path::best().level(), simd => row.fill(simd, 0..5, stretches));
        assert!(rows.iter().all(|row| row[5..] == [0.0; 11]), "filled up with zeros");
        let light = rows.map(|row| <[f64; 5]>::try_from(&row[..5]).expect("five"));
        assert_eq!((light[6], light[7]), ([0.0; 5], [21.0, 22.0, 23.0, 24.0, 25.0]));
        assert_eq!((light[8], light[9]), ([1.0; 5], [-21.0, -11.0, 0.0, 12.0, 25.0]));
        assert_eq!((light[10], light[11], light[12]), (light[7], [-1.0, -0.5, 0.0, 0.5, 1.0], [1.0; 5]));
    }
}
