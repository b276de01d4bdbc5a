//! The pinhole camera of the simulators: pixels to rays, no distortion.

use domvs_vision::{CameraError, Intrinsics};

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
}
