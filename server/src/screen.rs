//! Is this image fit to servo on? What an image must have before it may move anything.
//!
//! Thresholds are stated here, and in `docs/safety.md`, as numbers. A black, white or flat image says nothing
//! about where the camera is, yet the mean interaction matrix stays regular, so the law alone would move.

use std::time::Duration;

use domvs_vision::{Plane, Twist};
use fearless_simd::{Level, dispatch};

use crate::Moment;

/// Standard deviation of the gray values (of [0, 1]) below which an image counts as flat: 2.5 of 255 levels.
pub const FLAT_BELOW: f64 = 0.01;
/// So many identical pixel planes in a row may be a frozen camera.
pub const FROZEN_FRAMES: u32 = 5;
/// The motion commanded meanwhile must have moved the image by more than this before they are called frozen.
pub const FROZEN_MOTION_PX: f64 = 2.0;

/// Sums over the rows of an image, of which its contrast is made.
#[derive(Clone, Copy, Debug, Default)]
pub struct GraySums {
    count: usize,
    sum: f64,
    squares: f64,
}

impl GraySums {
    /// Adds a row.
    #[inline(always)]
    pub fn add_row(&mut self, row: &[f32]) {
        // A row in f32, in sixteen strands that run side by side, and the rows in f64: exact enough for a threshold.
        let (strands, rest) = row.as_chunks::<16>();
        let (mut sums, mut squares) = ([0.0f32; 16], [0.0f32; 16]);
        for strand in strands {
            for i in 0..16 {
                sums[i] += strand[i];
                squares[i] += strand[i] * strand[i];
            }
        }
        for (i, gray) in rest.iter().enumerate() {
            sums[i] += gray;
            squares[i] += gray * gray;
        }
        self.count += row.len();
        self.sum += f64::from(sums.iter().sum::<f32>());
        self.squares += f64::from(squares.iter().sum::<f32>());
    }

    /// Standard deviation of the gray values.
    pub fn contrast(&self) -> f64 {
        let mean = self.sum / self.count as f64;
        (self.squares / self.count as f64 - mean * mean).max(0.0).sqrt()
    }
}

/// Standard deviation of the gray values.
pub fn contrast(image: &Plane<f32>) -> f64 {
    let mut sums = GraySums::default();
    image.samples().chunks(image.width()).for_each(|row| sums.add_row(row));
    sums.contrast()
}

/// Watches pushed frames for a camera that delivers the same picture while it is being moved.
#[derive(Clone, Debug, Default)]
pub struct FreezeDetector {
    newest: Option<Plane<f32>>,
    identical: u32,
    motion_px: f64,
    last_twist: Twist,
    last_received: Moment,
}

impl FreezeDetector {
    /// Judges the next frame, which [`FreezeDetector::newest`] is from then on: nothing is copied, `image` gets the plane
    /// of the frame before in exchange. `focal_px` and `depth_m` turn the commanded motion into pixels.
    pub fn is_frozen(&mut self, image: &mut Plane<f32>, received: Moment, focal_px: f64, depth_m: f64) -> bool {
        let interval = received.saturating_sub(self.last_received);
        self.last_received = received;
        match &mut self.newest {
            Some(newest) if is_same(newest, image) => {
                self.identical = self.identical.saturating_add(1);
                self.motion_px += image_motion_px(self.last_twist, interval, focal_px, depth_m);
                self.identical >= FROZEN_FRAMES && self.motion_px > FROZEN_MOTION_PX
            }
            newest => {
                match newest {
                    Some(newest) => std::mem::swap(newest, image),
                    None => *newest = Some(image.clone()),
                }
                (self.identical, self.motion_px) = (1, 0.0);
                false
            }
        }
    }

    /// The plane of the frame judged last.
    pub fn newest(&self) -> Option<&Plane<f32>> {
        self.newest.as_ref()
    }

    /// Notes what was commanded after the last frame.
    pub fn commanded(&mut self, twist: Twist) {
        self.last_twist = twist;
    }
}

/// Whether both planes are the same picture; looks no further than the first part that differs.
fn is_same(one: &Plane<f32>, other: &Plane<f32>) -> bool {
    /// Samples that are compared before anything is asked.
    const PART: usize = 4096;
    let level = Level::new();
    let parts = one.samples().chunks(PART).zip(other.samples().chunks(PART));
    [one.width(), one.height()] == [other.width(), other.height()]
        && parts.map(|(one, other)| dispatch!(level, _ => differences(one, other))).all(|differences| differences == 0)
}

#[inline(always)]
fn differences(one: &[f32], other: &[f32]) -> u32 {
    one.iter().zip(other).map(|(one, other)| u32::from(one != other)).sum()
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
        (0u64..8)
            .map(|k| {
                let frozen = detector.is_frozen(&mut stripes(0), Duration::from_millis(66 * (k + 1)), 500.0, 1.0);
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
            assert!(!detector.is_frozen(&mut stripes(k), Duration::from_secs(k as u64), 500.0, 1.0));
            detector.commanded(Twist::from_array([1.0; 6]));
        }
    }
}
