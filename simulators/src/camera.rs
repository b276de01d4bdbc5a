//! The pinhole camera of the simulators: pixels to rays, no distortion.

use domvs_vision::{CameraError, Intrinsics};
use nalgebra::{Isometry3, Matrix3, Vector3};

/// A pinhole camera and the size of its image; optical frame x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeCamera {
    /// Focal lengths and principal point, px; pixel centres have whole coordinates, from 0.
    pub intrinsics: Intrinsics,
    /// Pixels to the right.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
}

impl PinholeCamera {
    /// Square pixels, `horizontal_fov_rad` over `width` pixels, centre `((W-1)/2, (H-1)/2)`; fails when the
    /// field of view is not between 0 and pi, or the width is 0.
    pub fn with_field_of_view(
        width: usize,
        height: usize,
        horizontal_fov_rad: f64,
    ) -> Result<PinholeCamera, CameraError> {
        let focal_px = width as f64 / 2.0 / (horizontal_fov_rad / 2.0).tan();
        let center_px = [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
        Ok(PinholeCamera { intrinsics: Intrinsics::new([focal_px, focal_px], center_px)?, width, height })
    }

    /// The rays of all pixels from `pose` (`world_from_camera`).
    pub(crate) fn rays(&self, pose: &Isometry3<f64>) -> Rays {
        let rotation: Matrix3<f64> = pose.rotation.to_rotation_matrix().into_inner();
        let [focal_u, focal_v] = self.intrinsics.focal_px();
        let [center_u, center_v] = self.intrinsics.center_px();
        Rays {
            origin: pose.translation.vector,
            at_zero: rotation * Vector3::new(-center_u / focal_u, -center_v / focal_v, 1.0),
            per_u: rotation.column(0) / focal_u,
            per_v: rotation.column(1) / focal_v,
        }
    }
}

/// The rays of one pose: directions in the world `r(u, v) = R (x, y, 1)` are linear in the pixel, and a point at the
/// depth `z` along the optical axis is `origin + z r(u, v)`.
pub(crate) struct Rays {
    pub(crate) origin: Vector3<f64>,
    pub(crate) at_zero: Vector3<f64>,
    pub(crate) per_u: Vector3<f64>,
    pub(crate) per_v: Vector3<f64>,
}

impl Rays {
    pub(crate) fn direction(&self, u: f64, v: f64) -> Vector3<f64> {
        self.at_zero + u * self.per_u + v * self.per_v
    }

    /// `vector · r(u, v)` as the coefficients of u, of v and of 1.
    pub(crate) fn project(&self, vector: &Vector3<f64>) -> [f64; 3] {
        [vector.dot(&self.per_u), vector.dot(&self.per_v), vector.dot(&self.at_zero)]
    }
}
