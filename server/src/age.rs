//! How old a pushed frame is, from two clocks that need not agree.
//!
//! The difference `receive time − capture time` of a source is its clock offset plus the way's delay. The
//! smallest difference seen stands for "no delay": it is the base, and a frame's age is its own difference minus the base.
//! Seconds in which no frame comes do not count: silence proves nothing, and what ends it may be old.
//!
//! Clocks drift, so the base rises by itself towards the smallest difference of the last ten seconds, but by no more than
//! [`DRIFT_NS_PER_S`]: a queue that fills makes the difference grow too, ten times as fast and more, and that is age. Where the
//! difference has grown in one step and then held (another route, a clock set back), both halves of the ten seconds have the same
//! smallest difference, and that one becomes the base.
//!
//! A jump of a sender's clock by seconds and a backlog that bursts out of a healed link look alike at first. They part soon: a
//! jumped clock keeps its new difference, a backlog's shrinks back. So after a jump towards "older" nothing counts as fresh until
//! the new difference has held for [`SETTLING`]; a jump towards "younger" cannot hide an old frame and costs one frame.

use std::time::Duration;

use crate::Moment;

/// The smallest difference is remembered for so many of these, in time during which frames came: ten seconds.
const SLICE: Duration = Duration::from_millis(500);
const SLICES: usize = 20;
/// How much the base may rise by itself in a second. Clocks of computers and cameras drift by less.
pub const DRIFT_NS_PER_S: i128 = 1_000_000;
/// So near to each other must the smallest differences of the two halves of the window be to count as a step that is over.
const STEADY_NS: i128 = 10_000_000;
/// A longer time between two frames counts as this.
const LONGEST_GAP: Duration = SLICE;
/// A change of the difference by more than this is a jump.
const JUMP_NS: i128 = 1_000_000_000;
/// How long a difference must hold after a jump before frames count as fresh again.
pub const SETTLING: Duration = Duration::from_millis(500);

/// The verdict on one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Age {
    /// Young enough, as far as can be known.
    Fresh,
    /// Too old, out of order, a duplicate, from a clock that has just jumped, or right after a silence without a capture time.
    Stale,
}

/// One source's clock, as far as its frames tell.
#[derive(Clone, Debug, Default)]
pub struct AgeEstimator {
    window: Window,
    /// The difference of a frame without delay, as far as is known.
    base: i128,
    /// Of the frame before, whatever became of it.
    last_difference: i128,
    /// For how long frames have come, without the gaps.
    heard: Duration,
    last_received: Moment,
    jump: Option<Jump>,
    last_capture_ns: u64,
    known_since: Option<Moment>,
    /// Of the last frame without a capture time.
    untimed: Option<Moment>,
    /// What came without a capture time before this may have waited on the way.
    doubtful_until: Moment,
}

/// Frames have become much older at once.
#[derive(Clone, Copy, Debug)]
struct Jump {
    /// The difference before it.
    from: i128,
    /// Since when the differences have been between these two.
    since: Moment,
    low: i128,
    high: i128,
}

/// The smallest differences of the last ten seconds, slice by slice.
#[derive(Clone, Debug)]
struct Window {
    smallest: [Option<i128>; SLICES],
    /// Slices since the beginning.
    number: usize,
}

impl Default for Window {
    fn default() -> Window {
        Window { smallest: [None; SLICES], number: 0 }
    }
}

impl Window {
    /// Goes on to the slice of this time, which is at most one away.
    fn advance(&mut self, heard: Duration) {
        let number = usize::try_from(heard.as_nanos() / SLICE.as_nanos()).unwrap_or(usize::MAX);
        if number != self.number {
            self.number = number;
            self.smallest[number % SLICES] = None;
        }
    }

    fn insert(&mut self, difference: i128) {
        let slice = &mut self.smallest[self.number % SLICES];
        *slice = Some(slice.map_or(difference, |smallest| smallest.min(difference)));
    }

    /// The smallest of the newer half of the slices, and of the older one.
    fn halves(&self) -> [Option<i128>; 2] {
        let slice = |age: usize| self.smallest[(self.number % SLICES + SLICES - age) % SLICES];
        [0, SLICES / 2].map(|from| (from..from + SLICES / 2).filter_map(slice).min())
    }
}

impl AgeEstimator {
    /// Since when ages have been judged against the same clock: its first frame, or the last jump.
    pub fn known_since(&self) -> Option<Moment> {
        self.known_since
    }

    /// Judges a frame without a capture time, where silence is what lasts longer than `watchdog`. What ends a silence may be
    /// what waited on the way: for one watchdog time from then on such frames prove nothing. A link that holds them back gives them
    /// back within that time, or goes on being slow.
    pub fn judge_untimed(&mut self, received: Moment, watchdog: Duration) -> Age {
        let before = self.untimed.replace(received);
        if before.is_some_and(|before| received.saturating_sub(before) > watchdog) {
            self.doubtful_until = received + watchdog;
        }
        if received < self.doubtful_until { Age::Stale } else { Age::Fresh }
    }

    /// Judges a frame captured at `capture_time_ns` (sender's clock) and received at `received`.
    pub fn judge(&mut self, capture_time_ns: u64, received: Moment, max_age: Duration) -> Age {
        let difference = received.as_nanos() as i128 - i128::from(capture_time_ns);
        let went_back = capture_time_ns <= self.last_capture_ns;
        let heard = received.saturating_sub(self.last_received).min(LONGEST_GAP);
        self.heard += heard;
        self.last_received = received;
        let before = std::mem::replace(&mut self.last_difference, difference);
        if self.known_since.is_none() {
            self.restart(difference, received, capture_time_ns);
            return Age::Fresh;
        }
        self.window.advance(self.heard);
        self.raise_base(heard);
        if difference < self.base - JUMP_NS {
            self.restart(difference, received, capture_time_ns);
            return Age::Stale;
        }
        // What has grown to more than a second frame by frame is a delay, and no jump of a clock.
        let from = self.jump.map_or(before, |jump| jump.from).max(self.base);
        if difference > from + JUMP_NS {
            return self.judge_after_jump(from, difference, received, capture_time_ns, max_age);
        }
        self.jump = None;
        if went_back {
            return Age::Stale;
        }
        self.last_capture_ns = capture_time_ns;
        self.window.insert(difference);
        self.base = self.base.min(difference);
        if difference - self.base <= max_age.as_nanos() as i128 { Age::Fresh } else { Age::Stale }
    }

    /// Follows the window's smallest difference: slowly, as clocks drift, or at once where a step is over.
    fn raise_base(&mut self, heard: Duration) {
        let halves = self.window.halves();
        let Some(smallest) = halves.into_iter().flatten().min() else { return };
        let is_steady = matches!(halves, [Some(newer), Some(older)] if (newer - older).abs() <= STEADY_NS);
        let drift = heard.as_nanos() as i128 * DRIFT_NS_PER_S / 1_000_000_000;
        self.base = if is_steady { smallest } else { smallest.min(self.base + drift) };
    }

    fn judge_after_jump(
        &mut self,
        from: i128,
        difference: i128,
        received: Moment,
        capture_ns: u64,
        max_age: Duration,
    ) -> Age {
        let here = Jump { from, since: received, low: difference, high: difference };
        let Jump { since, low, high, .. } = self.jump.unwrap_or(here);
        let (low, high) = (low.min(difference), high.max(difference));
        // A shrinking difference is a backlog, not a clock: start waiting anew.
        if high - low > max_age.as_nanos() as i128 {
            self.jump = Some(here);
        } else if received.saturating_sub(since) >= SETTLING {
            self.restart(difference, received, capture_ns);
            return Age::Fresh;
        } else {
            self.jump = Some(Jump { from, since, low, high });
        }
        Age::Stale
    }

    fn restart(&mut self, difference: i128, received: Moment, capture_time_ns: u64) {
        self.window = Window::default();
        self.window.advance(self.heard);
        self.window.insert(difference);
        self.base = difference;
        self.jump = None;
        self.last_capture_ns = capture_time_ns;
        self.known_since = Some(received);
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

    /// Judges a frame captured at this time and so many microseconds on its way, a clock that drifts among them.
    fn judge_us(estimator: &mut AgeEstimator, captured_ms: u64, on_the_way_us: u64) -> Age {
        let captured = Duration::from_millis(captured_ms);
        let received = captured + Duration::from_micros(on_the_way_us);
        estimator.judge(CLOCK + captured.as_nanos() as u64, received, MAX_AGE)
    }

    #[test]
    fn an_offset_that_drifts_is_followed() {
        let mut estimator = settled();
        // The sender's clock loses 0.2 ms a second: after 30 minutes it is 360 ms behind, and no frame was late.
        for k in 31..54_000 {
            let (ms, jitter_us) = (33 * k, k * 7919 % 3000);
            assert_eq!(judge_us(&mut estimator, ms, 5000 + ms / 5 + jitter_us), Age::Fresh, "frame {k}");
        }
    }

    #[test]
    fn a_delay_that_creeps_is_age_however_long_it_grows() {
        for us_per_s in [3_000, 10_000, 30_000, 100_000] {
            let mut estimator = settled();
            let mut stale = 0;
            for k in 31..12_000 {
                let ms = 33 * k;
                let late_us = (ms - 1000) * us_per_s / 1000;
                let verdict = judge_us(&mut estimator, ms, 5000 + late_us);
                // What a clock might have drifted is not seen.
                let most_us = 200_000 + ms + 1000;
                assert!(verdict == Age::Stale || late_us <= most_us, "{late_us} µs late at {us_per_s} µs/s");
                stale += u32::from(verdict == Age::Stale);
            }
            assert!(stale > 5000, "{stale} at {us_per_s} µs/s");
        }
    }

    #[test]
    fn a_queue_that_drains_gives_back_the_age_of_before() {
        let mut estimator = settled();
        for k in 31..2000 {
            let ms = 33 * k;
            judge_us(&mut estimator, ms, 5000 + (ms - 1000) * 30);
        }
        assert_eq!(judge(&mut estimator, 70_000, 70_005), Age::Fresh);
        assert_eq!(judge(&mut estimator, 70_033, 70_333), Age::Stale);
    }

    #[test]
    fn a_step_that_holds_is_the_measure_after_ten_seconds() {
        let mut estimator = settled();
        let (mut first_fresh, period_ms) = (None, 33);
        for k in 31..700 {
            let ms = period_ms * k;
            // 300 ms more from 1023 ms on: a longer route, or a clock set back.
            let verdict = judge_us(&mut estimator, ms, 305_000 + k * 7919 % 3000);
            assert!(first_fresh.is_none() || verdict == Age::Fresh, "frame {k}");
            first_fresh = first_fresh.or((verdict == Age::Fresh).then_some(ms));
        }
        let since_ms = first_fresh.expect("believed at last") - 1023;
        assert!((9_000..=10_600).contains(&since_ms), "after {since_ms} ms");
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
    fn without_capture_times_what_ends_a_silence_proves_nothing_for_one_watchdog_time() {
        let (mut estimator, ms) = (AgeEstimator::default(), Duration::from_millis);
        let mut judge = |received_ms| estimator.judge_untimed(ms(received_ms), ms(300));
        // The first of all, then within the watchdog time.
        for received in [9_000, 9_300, 9_333] {
            assert_eq!(judge(received), Age::Fresh, "at {received}");
        }
        // 0.6 s of silence, then what waited and what is new.
        for received in [9_934, 9_935, 9_936, 10_000, 10_233] {
            assert_eq!(judge(received), Age::Stale, "at {received}");
        }
        assert_eq!(judge(10_234), Age::Fresh);
        assert_eq!(judge(10_535), Age::Stale, "silent again");
    }
}
