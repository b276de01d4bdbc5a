//! Is this image fit to servo on? What an image must have before it may move anything.
//!
//! Thresholds are stated here, and in `docs/safety.md`, as numbers. A black, white or flat image says nothing
//! about where the camera is, yet the mean interaction matrix stays regular, so the law alone would move.

use std::time::Duration;

use domvs_vision::{Plane, Twist};

use crate::Moment;

/// Standard deviation of the gray values (of [0, 1]) below which an image counts as flat: 2.5 of 255 levels.
pub const FLAT_BELOW: f64 = 0.01;
/// So many identical pixel planes in a row may be a frozen camera.
pub const FROZEN_FRAMES: u32 = 5;
/// The motion commanded meanwhile must have moved the image by more than this before they are called frozen.
pub const FROZEN_MOTION_PX: f64 = 2.0;

/// Standard deviation of the gray values.
pub fn contrast(image: &Plane<f32>) -> f64 {
    let (mut sum, mut squares) = (0.0, 0.0);
    for row in image.samples().chunks(image.width()) {
        // A row in f32 and the rows in f64: exact enough for a threshold, and vectorised.
        let (row_sum, row_squares) = row.iter().fold((0.0f32, 0.0f32), |(s, q), &gray| (s + gray, q + gray * gray));
        sum += f64::from(row_sum);
        squares += f64::from(row_squares);
    }
    let count = image.samples().len() as f64;
    let mean = sum / count;
    (squares / count - mean * mean).max(0.0).sqrt()
}

/// Watches pushed frames for a camera that delivers the same picture while it is being moved.
#[derive(Clone, Debug, Default)]
pub struct FreezeDetector {
    last_plane: Vec<f32>,
    identical: u32,
    motion_px: f64,
    last_twist: Twist,
    last_received: Moment,
}

impl FreezeDetector {
    /// Judges the next frame. `focal_px` and `depth_m` turn the commanded motion into pixels.
    pub fn is_frozen(&mut self, image: &Plane<f32>, received: Moment, focal_px: f64, depth_m: f64) -> bool {
        let interval = received.saturating_sub(self.last_received);
        self.last_received = received;
        if self.last_plane != image.samples() {
            self.last_plane.clear();
            self.last_plane.extend_from_slice(image.samples());
            (self.identical, self.motion_px) = (1, 0.0);
            return false;
        }
        self.identical = self.identical.saturating_add(1);
        self.motion_px += image_motion_px(self.last_twist, interval, focal_px, depth_m);
        self.identical >= FROZEN_FRAMES && self.motion_px > FROZEN_MOTION_PX
    }

    /// Notes what was commanded after the last frame.
    pub fn commanded(&mut self, twist: Twist) {
        self.last_twist = twist;
    }
}

/// How far a twist moves the image centre, roughly: `f·(|v|/Z + |ω|)·Δt`.
fn image_motion_px(twist: Twist, interval: Duration, focal_px: f64, depth_m: f64) -> f64 {
    focal_px * (twist.linear_norm() / depth_m + twist.angular_norm()) * interval.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stripes(shift: usize) -> Plane<f32> {
        Plane::from_fn(16, 16, |u, _| if (u + shift) % 4 < 2 { 0.2 } else { 0.8 })
    }

    fn frozen_after(detector: &mut FreezeDetector, twist: [f64; 6]) -> Vec<bool> {
        let image = stripes(0);
        (0u64..8)
            .map(|k| {
                let frozen = detector.is_frozen(&image, Duration::from_millis(66 * (k + 1)), 500.0, 1.0);
                detector.commanded(Twist::from_array(twist));
                frozen
            })
            .collect()
    }

    #[test]
    fn black_white_and_gray_images_are_flat_and_stripes_are_not() {
        for gray in [0.0, 0.5, 1.0] {
            assert!(contrast(&Plane::filled(64, 48, gray)) < FLAT_BELOW);
        }
        assert!((contrast(&stripes(0)) - 0.3).abs() < 1e-6, "half the pixels 0.3 above the mean, half below");
    }

    #[test]
    fn five_identical_frames_under_motion_are_frozen() {
        let verdicts = frozen_after(&mut FreezeDetector::default(), [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(verdicts, [false, false, false, false, true, true, true, true]);
    }

    #[test]
    fn identical_frames_of_a_camera_at_rest_are_not_frozen() {
        assert!(frozen_after(&mut FreezeDetector::default(), [0.0; 6]).iter().all(|frozen| !frozen));
    }

    #[test]
    fn a_moving_picture_is_never_frozen() {
        let mut detector = FreezeDetector::default();
        detector.commanded(Twist::from_array([1.0; 6]));
        for k in 0..20 {
            assert!(!detector.is_frozen(&stripes(k), Duration::from_secs(k as u64), 500.0, 1.0));
            detector.commanded(Twist::from_array([1.0; 6]));
        }
    }
}
