//! Is this image fit to servo on? What an image must have before it may move anything.
//!
//! Thresholds are stated here, and in `docs/safety.md`, as numbers. A black, white or flat image says nothing
//! about where the camera is, yet the mean interaction matrix stays regular, so the law alone would move. Each threshold has
//! two sides: what was refused must get better than what is refused before it moves again, so nothing flickers at the border.

use std::time::Duration;

use domvs_vision::control::SMALLEST_SINGULAR_RATIO;
use domvs_vision::{Plane, Twist};
use fearless_simd::{Level, dispatch};

use crate::Moment;

/// A quantity that must be large enough, with two sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Threshold {
    /// Refused below this …
    pub refuse_below: f64,
    /// … until it is this again.
    pub until: f64,
}

/// Standard deviation of the gray values (of [0, 1]): 2.5 of 255 levels. A target is judged by the first number.
pub const CONTRAST: Threshold = Threshold { refuse_below: 0.01, until: 0.012 };
/// Share of pixels that are not black (gray 0 or less), and of those that are not white (1 or more): each by itself, because a
/// picture of black and white alone shows as much as any other.
pub const UNCLIPPED: Threshold = Threshold { refuse_below: 0.02, until: 0.03 };
/// Share of pixels whose depth is known, if there is no fallback.
pub const KNOWN_DEPTH: Threshold = Threshold { refuse_below: 0.5, until: 0.55 };
/// Smallest over largest singular value of the column-scaled interaction matrix.
pub const SINGULAR_RATIO: Threshold =
    Threshold { refuse_below: SMALLEST_SINGULAR_RATIO, until: 2.0 * SMALLEST_SINGULAR_RATIO };
/// So many identical pixel planes in a row may be a frozen camera.
pub const FROZEN_FRAMES: u32 = 5;
/// The motion commanded meanwhile must have moved the image by more than this before they are called frozen.
pub const FROZEN_MOTION_PX: f64 = 2.0;

/// One threshold of one task: which side of it the task is on.
#[derive(Clone, Copy, Debug)]
pub struct Gate {
    threshold: Threshold,
    shut: bool,
}

impl Gate {
    /// An open gate.
    pub const fn new(threshold: Threshold) -> Gate {
        Gate { threshold, shut: false }
    }

    /// Judges the next value; what is not a number does not pass. Says what was asked for if it was too little.
    pub fn check(&mut self, value: f64) -> Result<(), f64> {
        let asked = if self.shut { self.threshold.until } else { self.threshold.refuse_below };
        self.shut = value < asked || value.is_nan();
        if self.shut { Err(asked) } else { Ok(()) }
    }
}

/// The thresholds of one task, in the order in which a frame meets them.
#[derive(Clone, Copy, Debug)]
pub struct Gates {
    /// [`CONTRAST`].
    pub contrast: Gate,
    /// [`UNCLIPPED`].
    pub unclipped: Gate,
    /// [`KNOWN_DEPTH`].
    pub known_depth: Gate,
    /// [`SINGULAR_RATIO`].
    pub singular_ratio: Gate,
}

impl Default for Gates {
    fn default() -> Gates {
        Gates {
            contrast: Gate::new(CONTRAST),
            unclipped: Gate::new(UNCLIPPED),
            known_depth: Gate::new(KNOWN_DEPTH),
            singular_ratio: Gate::new(SINGULAR_RATIO),
        }
    }
}

/// Sums over the rows of an image, of which its contrast is made, and how much of it is black or white.
#[derive(Clone, Copy, Debug, Default)]
pub struct GraySums {
    count: usize,
    sum: f64,
    squares: f64,
    black: usize,
    white: usize,
}

impl GraySums {
    /// Adds a row.
    #[inline(always)]
    pub fn add_row(&mut self, row: &[f32]) {
        // A row in f32, in sixteen strands that run side by side, and the rows in f64: exact enough for a threshold.
        let (strands, rest) = row.as_chunks::<16>();
        let (mut sums, mut squares) = ([0.0f32; 16], [0.0f32; 16]);
        let (mut black, mut white) = ([0u32; 16], [0u32; 16]);
        for strand in strands {
            for i in 0..16 {
                sums[i] += strand[i];
                squares[i] += strand[i] * strand[i];
                black[i] += u32::from(strand[i] <= 0.0);
                white[i] += u32::from(strand[i] >= 1.0);
            }
        }
        for (i, &gray) in rest.iter().enumerate() {
            sums[i] += gray;
            squares[i] += gray * gray;
            black[i] += u32::from(gray <= 0.0);
            white[i] += u32::from(gray >= 1.0);
        }
        self.count += row.len();
        self.black += black.iter().sum::<u32>() as usize;
        self.white += white.iter().sum::<u32>() as usize;
        self.sum += f64::from(sums.iter().sum::<f32>());
        self.squares += f64::from(squares.iter().sum::<f32>());
    }

    /// Standard deviation of the gray values.
    pub fn contrast(&self) -> f64 {
        let mean = self.sum / self.count as f64;
        (self.squares / self.count as f64 - mean * mean).max(0.0).sqrt()
    }

    /// Share of pixels that are not black, or of those that are not white, whichever is smaller.
    pub fn unclipped(&self) -> f64 {
        1.0 - self.black.max(self.white) as f64 / self.count as f64
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
    /// of the frame before in exchange. `optics` turn the commanded motion into pixels; it lasts for `watchdog` at most.
    pub fn is_frozen(&mut self, image: &mut Plane<f32>, received: Moment, watchdog: Duration, optics: Optics) -> bool {
        let interval = received.saturating_sub(self.last_received).min(watchdog);
        self.last_received = received;
        match &mut self.newest {
            Some(newest) if is_same(newest, image) => {
                self.identical = self.identical.saturating_add(1);
                self.motion_px += optics.motion_px(self.last_twist, interval);
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

/// What turns the camera's motion into the image's.
#[derive(Clone, Copy, Debug)]
pub struct Optics {
    /// The longer focal length.
    pub focal_px: f64,
    /// Of the desired view, typically.
    pub depth_m: f64,
}

impl Optics {
    /// How far a twist moves the image centre, roughly: `f·(|v|/Z + |ω|)·Δt`.
    fn motion_px(self, twist: Twist, interval: Duration) -> f64 {
        self.focal_px * (twist.linear_norm() / self.depth_m + twist.angular_norm()) * interval.as_secs_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stripes(shift: usize) -> Plane<f32> {
        Plane::from_fn(16, 16, |u, _| if (u + shift) % 4 < 2 { 0.2 } else { 0.8 })
    }

    const WATCHDOG: Duration = Duration::from_millis(200);
    const OPTICS: Optics = Optics { focal_px: 500.0, depth_m: 1.0 };

    fn frozen_after(detector: &mut FreezeDetector, period_ms: u64, twist: [f64; 6]) -> Vec<bool> {
        (0u64..8)
            .map(|k| {
                let received = Duration::from_millis(period_ms * (k + 1));
                let frozen = detector.is_frozen(&mut stripes(0), received, WATCHDOG, OPTICS);
                detector.commanded(Twist::from_array(twist));
                frozen
            })
            .collect()
    }

    #[test]
    fn black_white_and_gray_images_are_flat_and_stripes_are_not() {
        for gray in [0.0, 0.5, 1.0] {
            assert!(contrast(&Plane::filled(64, 48, gray)) < CONTRAST.refuse_below);
        }
        assert!((contrast(&stripes(0)) - 0.3).abs() < 1e-6, "half the pixels 0.3 above the mean, half below");
    }

    #[test]
    fn five_identical_frames_under_motion_are_frozen() {
        let verdicts = frozen_after(&mut FreezeDetector::default(), 66, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(verdicts, [false, false, false, false, true, true, true, true]);
    }

    #[test]
    fn identical_frames_of_a_camera_at_rest_are_not_frozen() {
        assert!(frozen_after(&mut FreezeDetector::default(), 66, [0.0; 6]).iter().all(|frozen| !frozen));
    }

    #[test]
    fn a_twist_counts_as_motion_no_longer_than_the_watchdog_lets_it_last() {
        // 1 mm/s for 0.2 s at most between two frames: 0.1 px each, whatever the camera's pauses.
        let verdicts = frozen_after(&mut FreezeDetector::default(), 60_000, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(verdicts.iter().all(|frozen| !frozen));
    }

    #[test]
    fn what_was_refused_must_get_better_than_what_is_refused() {
        let mut gate = Gate::new(CONTRAST);
        let values = [0.02, 0.0101, 0.0099, 0.0101, 0.0119, 0.0121, 0.0101, f64::NAN, 0.0101, 0.5];
        let passes = values.map(|value| gate.check(value).is_ok());
        assert_eq!(passes, [true, true, false, false, false, true, true, false, false, true]);
        assert_eq!((gate.check(0.009), gate.check(0.011)), (Err(0.01), Err(0.012)), "it says what it asks for");
    }

    #[test]
    fn black_and_white_are_counted_apart_and_a_picture_of_both_is_no_lack_of_either() {
        let share = |image: &Plane<f32>| {
            let mut sums = GraySums::default();
            image.samples().chunks(image.width()).for_each(|row| sums.add_row(row));
            sums.unclipped()
        };
        assert_eq!(share(&Plane::from_fn(20, 10, |u, _| if u % 2 == 0 { 0.0 } else { 1.0 })), 0.5);
        assert_eq!(share(&Plane::from_fn(20, 10, |u, _| if u == 0 { 0.5 } else { 1.5 })), 1.0 - 190.0 / 200.0);
        assert_eq!(share(&Plane::from_fn(20, 10, |u, _| if u < 5 { 0.5 } else { -0.0 })), 0.25);
        assert_eq!(share(&stripes(0)), 1.0);
    }

    #[test]
    fn a_moving_picture_is_never_frozen() {
        let mut detector = FreezeDetector::default();
        detector.commanded(Twist::from_array([1.0; 6]));
        for k in 0..20 {
            assert!(!detector.is_frozen(&mut stripes(k), Duration::from_secs(k as u64), WATCHDOG, OPTICS));
            detector.commanded(Twist::from_array([1.0; 6]));
        }
    }
}
