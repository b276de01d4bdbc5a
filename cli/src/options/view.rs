//! What an image was seen with: `--camera`, and the depth of a view.

use std::path::PathBuf;
use std::str::FromStr;

use super::numbers;

/// `--camera fx,fy,cx,cy`, all in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraOption {
    /// Focal lengths along u and v, positive.
    pub focal_px: [f64; 2],
    /// The principal point; pixel (0, 0) has its centre at (0, 0).
    pub center_px: [f64; 2],
}

impl FromStr for CameraOption {
    type Err = String;

    fn from_str(text: &str) -> Result<CameraOption, String> {
        let wanted = || format!("expected fx,fy,cx,cy in pixels, got '{text}'");
        let Some(&[fx, fy, cx, cy]) = numbers(text).as_deref() else {
            return Err(wanted());
        };
        if fx <= 0.0 || fy <= 0.0 {
            return Err(format!("focal lengths must be positive, got {fx},{fy} px"));
        }
        Ok(CameraOption { focal_px: [fx, fy], center_px: [cx, cy] })
    }
}

/// `--desired-depth`, `--current-depth`: one distance for all pixels, or a file with one for each.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthOption {
    /// The same depth everywhere, in metres, positive.
    Metres(f64),
    /// A 16-bit PNG, or a 32-bit float TIFF in metres.
    File(PathBuf),
}

impl FromStr for DepthOption {
    type Err = String;

    fn from_str(text: &str) -> Result<DepthOption, String> {
        match text.trim().parse::<f64>() {
            Ok(metres) if metres.is_finite() && metres > 0.0 => Ok(DepthOption::Metres(metres)),
            Ok(metres) => Err(format!("a depth must be a positive number of metres, got {metres}")),
            Err(_) => Ok(DepthOption::File(PathBuf::from(text))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_has_four_numbers_and_positive_focal_lengths() {
        let camera = "6e2,601.5,-3,239.5".parse();
        assert_eq!(camera, Ok(CameraOption { focal_px: [600.0, 601.5], center_px: [-3.0, 239.5] }));
        for bad in ["600,600,320", "0,600,320,240", "600,-1,320,240", "a,b,c,d", "600,600,320,inf"] {
            assert!(bad.parse::<CameraOption>().is_err(), "'{bad}'");
        }
    }

    #[test]
    fn a_depth_is_metres_or_a_file_and_never_zero() {
        assert_eq!("0.5".parse(), Ok(DepthOption::Metres(0.5)));
        assert_eq!("5e-1".parse(), Ok(DepthOption::Metres(0.5)));
        assert_eq!("depth.png".parse(), Ok(DepthOption::File(PathBuf::from("depth.png"))));
        for bad in ["0", "-1", "nan", "inf"] {
            assert!(bad.parse::<DepthOption>().is_err(), "'{bad}'");
        }
    }
}
