//! The pinhole camera: pixels to normalized coordinates, `x = (u - c_u) / f_u`, `y = (v - c_v) / f_v`.
//!
//! The focal lengths in pixels are the paper's scale factors `κ_u`, `κ_v`. Lens distortion is not modelled here: undistort first.

/// Focal lengths and principal point of a camera, in pixels; `u` from 0 at the centre of the leftmost pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    focal_px: [f64; 2],
    center_px: [f64; 2],
}

/// Why numbers do not make a camera.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum CameraError {
    /// A focal length is zero, negative or not a number.
    #[error("focal lengths must be positive, got {focal_px:?} px")]
    FocalNotPositive {
        /// As given.
        focal_px: [f64; 2],
    },
    /// The principal point is not a finite number.
    #[error("the principal point must be finite, got {center_px:?} px")]
    CenterNotFinite {
        /// As given.
        center_px: [f64; 2],
    },
}

impl Intrinsics {
    /// A camera from focal lengths and principal point, `[u, v]` in pixels.
    ///
    /// # Errors
    /// A focal length that is not positive and finite, or a principal point that is not finite.
    pub fn new(focal_px: [f64; 2], center_px: [f64; 2]) -> Result<Intrinsics, CameraError> {
        if !focal_px.iter().all(|f| f.is_finite() && *f > 0.0) {
            return Err(CameraError::FocalNotPositive { focal_px });
        }
        if !center_px.iter().all(|c| c.is_finite()) {
            return Err(CameraError::CenterNotFinite { center_px });
        }
        Ok(Intrinsics { focal_px, center_px })
    }

    /// Focal lengths `[f_u, f_v]` in pixels.
    pub fn focal_px(&self) -> [f64; 2] {
        self.focal_px
    }

    /// Principal point `[c_u, c_v]` in pixels.
    pub fn center_px(&self) -> [f64; 2] {
        self.center_px
    }

    /// Normalized `x` of column `u`.
    pub fn x(&self, u: f64) -> f64 {
        (u - self.center_px[0]) / self.focal_px[0]
    }

    /// Normalized `y` of row `v`.
    pub fn y(&self, v: f64) -> f64 {
        (v - self.center_px[1]) / self.focal_px[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_principal_point_is_the_origin() {
        let camera = Intrinsics::new([100.0, 50.0], [31.5, 23.5]).expect("valid");
        assert_eq!((camera.x(31.5), camera.y(23.5)), (0.0, 0.0));
        assert_eq!((camera.x(131.5), camera.y(73.5)), (1.0, 1.0));
    }

    #[test]
    fn a_focal_length_that_is_not_positive_is_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(Intrinsics::new([bad, 1.0], [0.0, 0.0]), Err(CameraError::FocalNotPositive { .. })));
        }
        assert!(matches!(Intrinsics::new([1.0, 1.0], [f64::NAN, 0.0]), Err(CameraError::CenterNotFinite { .. })));
    }
}
