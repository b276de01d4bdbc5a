//! How old a pushed frame is, from two clocks that need not agree.
//!
//! The difference `receive time − capture time` of a source is its clock offset plus the way's delay. The
//! smallest difference of the last ten seconds stands for "no delay", so a frame's age is its own difference
//! minus that one. Seconds in which no frame comes do not count: silence proves nothing, and what ends it may be old. A jump of a sender's clock and a backlog that bursts out of a healed link look alike at
//! first: both shift the difference by seconds. They part soon: a jumped clock keeps its new difference, a
//! backlog's shrinks back. So after a jump towards "older" nothing counts as fresh until the new difference
//! has held for [`SETTLING`]; a jump towards "younger" cannot hide an old frame and costs one frame.

use std::collections::VecDeque;
use std::time::Duration;

use crate::Moment;

/// How long the smallest difference is remembered, in time during which frames came.
const WINDOW: Duration = Duration::from_secs(10);
/// A longer time between two frames counts as this.
const LONGEST_GAP: Duration = Duration::from_millis(500);
/// A change of the difference by more than this is a jump.
const JUMP_NS: i128 = 1_000_000_000;
/// How long a difference must hold after a jump before frames count as fresh again.
pub const SETTLING: Duration = Duration::from_millis(500);

/// The verdict on one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Age {
    /// Young enough, or without a capture time.
    Fresh,
    /// Too old, out of order, a duplicate, or from a clock that has just jumped.
    Stale,
}

/// One source's clock, as far as its frames tell.
#[derive(Clone, Debug, Default)]
pub struct AgeEstimator {
    /// `(time heard, difference in ns)`, differences rising from front to back: the front is the smallest.
    window: VecDeque<(Duration, i128)>,
    /// For how long frames have come, without the gaps.
    heard: Duration,
    last_received: Moment,
    /// After a jump: since when, and the smallest and largest difference seen since.
    jump: Option<(Moment, i128, i128)>,
    last_capture_ns: u64,
    known_since: Option<Moment>,
}

impl AgeEstimator {
    /// Since when ages have been judged against the same clock: its first frame, or the last jump.
    pub fn known_since(&self) -> Option<Moment> {
        self.known_since
    }

    /// Judges a frame captured at `capture_time_ns` (sender's clock, 0 = unknown) and received at `received`.
    pub fn judge(&mut self, capture_time_ns: u64, received: Moment, max_age: Duration) -> Age {
        if capture_time_ns == 0 {
            return Age::Fresh;
        }
        let difference = received.as_nanos() as i128 - i128::from(capture_time_ns);
        let went_back = capture_time_ns <= self.last_capture_ns;
        self.heard += received.saturating_sub(self.last_received).min(LONGEST_GAP);
        self.last_received = received;
        self.forget();
        let Some(&(_, smallest)) = self.window.front() else {
            self.restart(difference, received, capture_time_ns);
            return Age::Fresh;
        };
        if difference < smallest - JUMP_NS {
            self.restart(difference, received, capture_time_ns);
            return Age::Stale;
        }
        if difference > smallest + JUMP_NS {
            return self.judge_after_jump(difference, received, capture_time_ns, max_age);
        }
        self.jump = None;
        if went_back {
            return Age::Stale;
        }
        self.last_capture_ns = capture_time_ns;
        self.insert(difference);
        let smallest = self.window.front().map_or(difference, |&(_, smallest)| smallest);
        if difference - smallest <= max_age.as_nanos() as i128 { Age::Fresh } else { Age::Stale }
    }

    fn judge_after_jump(&mut self, difference: i128, received: Moment, capture_ns: u64, max_age: Duration) -> Age {
        let tolerance = max_age.as_nanos() as i128;
        let (since, low, high) = match self.jump {
            Some((since, low, high)) => (since, low.min(difference), high.max(difference)),
            None => (received, difference, difference),
        };
        // A shrinking difference is a backlog, not a clock: start waiting anew.
        if high - low > tolerance {
            self.jump = Some((received, difference, difference));
        } else if received.saturating_sub(since) >= SETTLING {
            self.restart(difference, received, capture_ns);
            return Age::Fresh;
        } else {
            self.jump = Some((since, low, high));
        }
        Age::Stale
    }

    /// Drops what is older than the window.
    fn forget(&mut self) {
        while self.window.len() > 1 && self.window.front().is_some_and(|&(seen, _)| self.heard - seen > WINDOW) {
            self.window.pop_front();
        }
    }

    fn restart(&mut self, difference: i128, received: Moment, capture_time_ns: u64) {
        self.window.clear();
        self.window.push_back((self.heard, difference));
        self.jump = None;
        self.last_capture_ns = capture_time_ns;
        self.known_since = Some(received);
    }

    /// Keeps the window monotonic, so it stays short and its front is the smallest.
    fn insert(&mut self, difference: i128) {
        while self.window.back().is_some_and(|&(_, larger)| larger >= difference) {
            self.window.pop_back();
        }
        self.window.push_back((self.heard, difference));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX_AGE: Duration = Duration::from_millis(200);
    /// The sender's clock runs an arbitrary 50 years ahead.
    const CLOCK: u64 = 1_600_000_000_000_000_000;

    fn judge(estimator: &mut AgeEstimator, captured_ms: u64, received_ms: u64) -> Age {
        estimator.judge(CLOCK + captured_ms * 1_000_000, Duration::from_millis(received_ms), MAX_AGE)
    }

    /// Thirty frames a second for a second, 5 ms on the way.
    fn settled() -> AgeEstimator {
        let mut estimator = AgeEstimator::default();
        for k in 0..30 {
            assert_eq!(judge(&mut estimator, 33 * k, 33 * k + 5), Age::Fresh);
        }
        estimator
    }

    #[test]
    fn frames_delayed_beyond_the_limit_are_stale() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 1000, 1205), Age::Fresh);
        assert_eq!(judge(&mut estimator, 1033, 1239), Age::Stale);
    }

    #[test]
    fn frames_out_of_order_or_twice_are_stale() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 1000, 1005), Age::Fresh);
        assert_eq!(judge(&mut estimator, 1000, 1006), Age::Stale);
        assert_eq!(judge(&mut estimator, 980, 1007), Age::Stale);
    }

    #[test]
    fn a_backlog_from_a_healed_link_never_counts_as_fresh_until_it_is_caught_up() {
        let mut estimator = settled();
        // Five seconds of frames burst out in 150 ms.
        for k in 0..150 {
            let verdict = judge(&mut estimator, 1000 + 33 * k, 6000 + k);
            let age_ms = 6000 + k as i64 - (1000 + 33 * k as i64);
            assert!(verdict == Age::Stale || age_ms <= 205, "a frame {age_ms} ms old counted as fresh");
        }
        assert_eq!(judge(&mut estimator, 6200, 6205), Age::Fresh);
    }

    #[test]
    fn a_backlog_after_a_long_silence_is_as_stale_as_after_a_short_one() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 2000, 62_000), Age::Stale);
        assert_eq!(judge(&mut estimator, 61_995, 62_000), Age::Fresh);
    }

    #[test]
    fn silence_does_not_make_late_frames_the_measure() {
        let mut estimator = settled();
        // The way becomes slow, then nothing comes for a minute, then what waited and what is new.
        for k in 0..10 {
            assert_eq!(judge(&mut estimator, 1000 + 33 * k, 1900 + 33 * k), Age::Stale);
        }
        for k in 0..10 {
            assert_eq!(judge(&mut estimator, 61_000 + 33 * k, 61_900 + k), Age::Stale, "still 0.6 s and more too late");
        }
        assert_eq!(judge(&mut estimator, 62_000, 62_010), Age::Fresh);
    }

    #[test]
    fn an_offset_that_drifts_is_followed() {
        let mut estimator = settled();
        // The sender's clock loses 1 ms in 100: after 30 s it is 300 ms behind, and no frame was late.
        for k in 31..900 {
            assert_eq!(judge(&mut estimator, 33 * k - 33 * k / 100, 33 * k + 5), Age::Fresh, "frame {k}");
        }
    }

    #[test]
    fn a_clock_that_jumps_back_is_believed_after_it_held_for_half_a_second() {
        let mut estimator = settled();
        let verdicts: Vec<Age> = (0..40).map(|k| judge(&mut estimator, 33 * k, 61_000 + 33 * k)).collect();
        assert_eq!(verdicts[0], Age::Stale);
        let first_fresh = verdicts.iter().position(|&verdict| verdict == Age::Fresh).expect("it settles");
        assert!((15..=17).contains(&first_fresh), "500 ms at 33 ms a frame, got frame {first_fresh}");
        assert!(verdicts[first_fresh..].iter().all(|&verdict| verdict == Age::Fresh));
    }

    #[test]
    fn a_clock_that_jumps_ahead_costs_one_frame() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 61_000, 1005), Age::Stale);
        assert_eq!(judge(&mut estimator, 61_033, 1038), Age::Fresh);
    }

    #[test]
    fn frames_without_a_capture_time_are_left_to_the_watchdog() {
        assert_eq!(AgeEstimator::default().judge(0, Duration::from_secs(9), MAX_AGE), Age::Fresh);
    }
}
