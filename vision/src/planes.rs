//! What every pixel says: the six planes of `½(L_I(I, Z) + L_I(I*, Z*))`, `I - I*`, and the six of light, image row by image row.
//!
//! The methods that compare brightness itself start here. A pixel's row of the interaction matrix is the mean of the two images' `L_I`
//! ([`crate::interaction`]), each with its own gradient and its own depth; its error is `I - I*`. A weight multiplies them all.
//! A row's planes stay in the nearest cache; only [`pair_planes`], which is for judges and pictures, makes them in full.

use crate::camera::Intrinsics;
use crate::chunks::{Chunks, LANES, padded_row};
use crate::depth::Depth;
use crate::features::Sights;
use crate::gram::{COLUMNS, ERROR};
use crate::image::Plane;
use crate::interaction::gradient_row;
use crate::light::light_row;
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

/// The buffers for one row of the planes.
#[derive(Debug)]
pub(crate) struct RowPlanes<T> {
    camera: Intrinsics,
    width: usize,
    /// Normalized `x` of the columns.
    x: Vec<T>,
    /// `∇I_u`, `∇I_v` of the current and of the desired image.
    gradients: [Vec<T>; 4],
    /// `1/Z` of each view where it is one number.
    constants: [Vec<T>; 2],
    /// Six of the interaction matrix, the error, and six of light; padded with zeros.
    planes: [Chunks<T>; COLUMNS],
    used: usize,
}

impl<T: Sample> RowPlanes<T> {
    /// Buffers for rows of `width` pixels, with the planes of light or without.
    pub(crate) fn new(camera: Intrinsics, width: usize, planes: usize) -> RowPlanes<T> {
        RowPlanes {
            camera,
            width,
            x: (0..width).map(|u| T::from_f64(camera.x(u as f64))).collect(),
            gradients: std::array::from_fn(|_| vec![T::ZERO; width]),
            constants: std::array::from_fn(|_| vec![T::ZERO; width]),
            planes: std::array::from_fn(|_| padded_row(width)),
            used: planes,
        }
    }

    /// Calls `each` with every `v` and that row of the planes.
    pub(crate) fn for_each(&mut self, sights: Sights<'_, T>, mut each: impl FnMut(usize, &[&[[T; LANES]]])) {
        for (constant, (_, depth)) in self.constants.iter_mut().zip([sights.current, sights.desired]) {
            if let Depth::Constant { depth_m } = depth {
                constant.fill(T::from_f64(1.0 / depth_m));
            }
        }
        for v in 0..sights.current.0.height() {
            self.fill(sights, v);
            each(v, &self.planes.each_ref().map(|plane| &plane[..])[..self.used]);
        }
    }

    fn fill(&mut self, sights: Sights<'_, T>, v: usize) {
        self.fill_interaction(sights, v);
        let (width, light) = (self.width, self.used == COLUMNS);
        let [_, _, _, _, _, _, error, rest @ ..] =
            self.planes.each_mut().map(|plane| &mut plane.as_flattened_mut()[..width]);
        let (own, desired) = (&sights.current.0.row(v)[..width], &sights.desired.0.row(v)[..width]);
        for u in 0..width {
            error[u] = own[u] - desired[u];
        }
        if light {
            light_row(sights.desired.0, v, rest);
        }
        if let Some(weight) = sights.weight {
            for plane in &mut self.planes[..self.used] {
                multiply(&mut plane.as_flattened_mut()[..width], &weight.row(v)[..width]);
            }
        }
    }

    /// `[ ζ g_u,  ζ g_v,  -ζ(x g_u + y g_v),  -(x y g_u + (1 + y²) g_v),  (1 + x²) g_u + x y g_v,  x g_v - y g_u ]`, linear in `g` and `ζ g`:
    /// of their means over both views.
    fn fill_interaction(&mut self, sights: Sights<'_, T>, v: usize) {
        let [own_u, own_v, desired_u, desired_v] = &mut self.gradients;
        gradient_row(sights.current.0, v, own_u, own_v);
        gradient_row(sights.desired.0, v, desired_u, desired_v);
        let zeta = [0, 1].map(|i| match [sights.current.1, sights.desired.1][i] {
            Depth::Constant { .. } => &self.constants[i][..],
            Depth::Map(map) => map.inverse_per_m().row(v),
        });
        let half_f = self.camera.focal_px().map(|f| T::from_f64(0.5 * f));
        let (x, y, width) = (&self.x[..], T::from_f64(self.camera.y(v as f64)), self.width);
        let [vx, vy, vz, wx, wy, wz, ..] = self.planes.each_mut().map(|plane| &mut plane.as_flattened_mut()[..width]);
        take_mean(half_f[0], own_u, desired_u, zeta, vx);
        take_mean(half_f[1], own_v, desired_v, zeta, vy);
        forward(x, y, [vx, vy], vz);
        turns(x, y, [own_u, own_v], [wx, wy, wz]);
    }
}

/// `g`, the mean over both views, in place of the current one's slope, and `ζ g`, which stays with each view's own depth.
fn take_mean<T: Sample>(
    half_f: T,
    own: &mut [T],
    desired: &[T],
    [own_zeta, desired_zeta]: [&[T]; 2],
    zeta_g: &mut [T],
) {
    let width = own.len();
    let (desired, own_zeta, desired_zeta) = (&desired[..width], &own_zeta[..width], &desired_zeta[..width]);
    for (u, zeta_g) in zeta_g[..width].iter_mut().enumerate() {
        let (a, b) = (half_f * own[u], half_f * desired[u]);
        *zeta_g = own_zeta[u] * a + desired_zeta[u] * b;
        own[u] = a + b;
    }
}

/// `-(x ζ g_u + y ζ g_v)`.
fn forward<T: Sample>(x: &[T], y: T, [vx, vy]: [&[T]; 2], vz: &mut [T]) {
    let width = vz.len();
    let (x, vx, vy) = (&x[..width], &vx[..width], &vy[..width]);
    for (u, vz) in vz.iter_mut().enumerate() {
        *vz = T::ZERO - (x[u] * vx[u] + y * vy[u]);
    }
}

/// The turns about the three axes: with `r = x g_u + y g_v` they are `-(y r + g_v)`, `x r + g_u` and `x g_v - y g_u`.
fn turns<T: Sample>(x: &[T], y: T, [g_u, g_v]: [&[T]; 2], [wx, wy, wz]: [&mut [T]; 3]) {
    let width = wx.len();
    let (x, g_u, g_v, wy, wz) = (&x[..width], &g_u[..width], &g_v[..width], &mut wy[..width], &mut wz[..width]);
    for (u, wx) in wx.iter_mut().enumerate() {
        let outward = x[u] * g_u[u] + y * g_v[u];
        *wx = T::ZERO - (y * outward + g_v[u]);
        wy[u] = x[u] * outward + g_u[u];
        wz[u] = x[u] * g_v[u] - y * g_u[u];
    }
}

fn multiply<T: Sample>(plane: &mut [T], weight: &[T]) {
    for (sample, weight) in plane.iter_mut().zip(weight) {
        *sample *= *weight;
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
    let [current, desired] = [current, desired].map(|view| (view.image, view.depth));
    RowPlanes::new(camera, width, PLAIN).for_each(Sights { current, desired, weight: None }, |v, planes| {
        for (full, row) in full.iter_mut().zip(planes) {
            full.samples_mut()[v * width..][..width].copy_from_slice(&row.as_flattened()[..width]);
        }
    });
    full
}
