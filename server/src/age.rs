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
//! A sender's clock that is set back by seconds and frames out of a healed link look alike at first. A clock goes back; a link gives back in
//! order what it held, after a silence as long as the frames are late. So only capture times that go back are a jump, and what ends
//! a silence is late until it has caught up, or has been a step for ten seconds, however slowly it drains. A clock that goes back does not take
//! the count of frames with it: what has a sequence that was there before is a copy, unless the source was silent and may have been restarted. After a jump nothing counts as fresh
//! until the new difference has held for [`SETTLING`]: a difference that shrinks is a backlog again. A jump towards "younger" cannot hide an
//! old frame and costs one frame.
//!
//! Frames without a capture time have their sequence, which says whether they come in order, and nothing that says how old they are.

use std::time::Duration;

use crate::Moment;

/// The smallest difference is remembered for so many of these, in time during which frames came: ten seconds.
const SLICE: Duration = Duration::from_millis(500);
const SLICES: usize = 20;
/// How much the base may rise by itself in a second. Clocks of computers and cameras drift by less.
pub const DRIFT_NS_PER_S: i128 = 1_000_000;
/// So near to each other must the smallest differences of the two halves of the window be to count as a step that is over; and so little may
/// it shrink from one half of [`SETTLING`] to the other.
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
    /// Young enough, as far as can be known: so old when it was received. Zero without a capture time.
    Fresh(Duration),
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
    /// The highest sequence of a frame in order.
    newest_sequence: u64,
    /// Nothing came for a while, and no frame in order since: its clock and its count may both begin anew.
    may_have_restarted: bool,
    known_since: Option<Moment>,
    /// The newest frame without a capture time that came in order.
    untimed: Option<Untimed>,
    /// What came without a capture time before this may have waited on the way.
    doubtful_until: Moment,
}

/// What tells the order of frames without capture times.
#[derive(Clone, Copy, Debug)]
struct Untimed {
    received: Moment,
    /// 0: none that was told.
    sequence: u64,
}

/// Capture times have gone back, and frames have become much older at once.
#[derive(Clone, Copy, Debug)]
struct Jump {
    /// The difference before it.
    from: i128,
    /// When the older half of [`SETTLING`] began.
    since: Moment,
    /// The smallest difference of each half.
    older: i128,
    newer: Option<i128>,
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

    /// Judges a frame without a capture time. Its sequence must be above the one before; 0 is none. Silence is what lasts longer than
    /// `watchdog` without a frame in order. It ends the count: a camera that was restarted begins anew. And what ends it may
    /// have waited on the way: for one watchdog time from then on such frames prove nothing. A link that holds them back gives them back
    /// within that time, or goes on being slow.
    pub fn judge_untimed(&mut self, sequence: u64, received: Moment, watchdog: Duration) -> Age {
        let before = self.untimed.filter(|before| received.saturating_sub(before.received) <= watchdog);
        if self.untimed.is_some() && before.is_none() {
            self.doubtful_until = received + watchdog;
        }
        let newest = before.map_or(0, |before| before.sequence);
        if sequence != 0 && sequence <= newest {
            return Age::Stale;
        }
        self.untimed = Some(Untimed { received, sequence: sequence.max(newest) });
        if received < self.doubtful_until { Age::Stale } else { Age::Fresh(Duration::ZERO) }
    }

    /// Whatever sequence comes next, it is the first: the owner has started the task, and perhaps the camera.
    pub fn forget_sequence(&mut self) {
        self.newest_sequence = 0;
        if let Some(untimed) = &mut self.untimed {
            untimed.sequence = 0;
        }
    }

    /// Judges a frame captured at `capture_time_ns` (sender's clock) and received at `received`; a `sequence` of 0 is none.
    pub fn judge(&mut self, capture_time_ns: u64, sequence: u64, received: Moment, max_age: Duration) -> Age {
        let difference = received.as_nanos() as i128 - i128::from(capture_time_ns);
        let went_back = capture_time_ns <= self.last_capture_ns;
        let gap = received.saturating_sub(self.last_received);
        let heard = gap.min(LONGEST_GAP);
        self.heard += heard;
        self.last_received = received;
        self.may_have_restarted |= gap > LONGEST_GAP;
        if went_back && (1..=self.newest_sequence).contains(&sequence) && !self.may_have_restarted {
            return Age::Stale;
        }
        let before = std::mem::replace(&mut self.last_difference, difference);
        if self.known_since.is_none() {
            self.restart(difference, received, [capture_time_ns, sequence]);
            return Age::Fresh(Duration::ZERO);
        }
        self.window.advance(self.heard);
        self.raise_base(heard);
        if difference < self.base - JUMP_NS {
            self.restart(difference, received, [capture_time_ns, sequence]);
            return Age::Stale;
        }
        // What has grown to more than a second frame by frame, or by a silence, is a delay and no jump of a clock.
        let from = self.jump.map_or(before, |jump| jump.from).max(self.base);
        if went_back && difference > from + JUMP_NS {
            return self.judge_after_jump(from, difference, received, [capture_time_ns, sequence], max_age);
        }
        self.jump = None;
        if went_back {
            return Age::Stale;
        }
        self.in_order(capture_time_ns, sequence);
        self.window.insert(difference);
        self.base = self.base.min(difference);
        self.verdict(difference, max_age)
    }

    fn verdict(&self, difference: i128, max_age: Duration) -> Age {
        let age = u64::try_from(difference - self.base).map_or(Duration::MAX, Duration::from_nanos);
        if age <= max_age { Age::Fresh(age) } else { Age::Stale }
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
        frame: [u64; 2],
        max_age: Duration,
    ) -> Age {
        let begins = Jump { from, since: received, older: difference, newer: None };
        let mut jump = self.jump.unwrap_or(begins);
        let held = received.saturating_sub(jump.since);
        if held < SETTLING / 2 {
            jump.older = jump.older.min(difference);
        } else {
            jump.newer = Some(jump.newer.map_or(difference, |newer| newer.min(difference)));
        }
        self.jump = Some(jump);
        let Some(newer) = jump.newer.filter(|_| held >= SETTLING) else { return Age::Stale };
        if newer < jump.older - STEADY_NS {
            // It shrinks: a backlog, and no clock. What was the newer half is the older one now.
            self.jump = Some(Jump { from, since: received - SETTLING / 2, older: newer, newer: None });
            return Age::Stale;
        }
        self.restart(newer.min(jump.older), received, frame);
        self.verdict(difference, max_age)
    }

    fn in_order(&mut self, capture_time_ns: u64, sequence: u64) {
        (self.last_capture_ns, self.newest_sequence) = (capture_time_ns, sequence);
        self.may_have_restarted = false;
    }

    fn restart(&mut self, difference: i128, received: Moment, [capture_time_ns, sequence]: [u64; 2]) {
        self.window = Window::default();
        self.window.advance(self.heard);
        self.window.insert(difference);
        self.base = difference;
        self.jump = None;
        self.in_order(capture_time_ns, sequence);
        self.known_since = Some(received);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAX_AGE: Duration = Duration::from_millis(200);
    const FRESH: bool = true;
    const STALE: bool = false;
    /// The sender's clock runs an arbitrary 50 years ahead.
    const CLOCK: u64 = 1_600_000_000_000_000_000;

    fn judge(estimator: &mut AgeEstimator, captured_ms: u64, received_ms: u64) -> bool {
        is_fresh(estimator.judge(CLOCK + captured_ms * 1_000_000, 0, Duration::from_millis(received_ms), MAX_AGE))
    }

    fn is_fresh(age: Age) -> bool {
        matches!(age, Age::Fresh(_))
    }

    /// Thirty frames a second for a second, 5 ms on the way.
    fn settled() -> AgeEstimator {
        let mut estimator = AgeEstimator::default();
        for k in 0..30 {
            assert_eq!(judge(&mut estimator, 33 * k, 33 * k + 5), FRESH);
        }
        estimator
    }

    #[test]
    fn frames_delayed_beyond_the_limit_are_stale() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 1000, 1205), FRESH);
        assert_eq!(judge(&mut estimator, 1033, 1239), STALE);
    }

    #[test]
    fn frames_out_of_order_or_twice_are_stale() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 1000, 1005), FRESH);
        assert_eq!(judge(&mut estimator, 1000, 1006), STALE);
        assert_eq!(judge(&mut estimator, 980, 1007), STALE);
    }

    #[test]
    fn a_backlog_from_a_healed_link_never_counts_as_fresh_until_it_is_caught_up() {
        let mut estimator = settled();
        // Five seconds of frames burst out in 150 ms.
        for k in 0..150 {
            let verdict = judge(&mut estimator, 1000 + 33 * k, 6000 + k);
            let age_ms = 6000 + k as i64 - (1000 + 33 * k as i64);
            assert!(verdict == STALE || age_ms <= 205, "a frame {age_ms} ms old counted as fresh");
        }
        assert_eq!(judge(&mut estimator, 6200, 6205), FRESH);
    }

    #[test]
    fn a_backlog_after_a_long_silence_is_as_stale_as_after_a_short_one() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 2000, 62_000), STALE);
        assert_eq!(judge(&mut estimator, 61_995, 62_000), FRESH);
    }

    #[test]
    fn silence_does_not_make_late_frames_the_measure() {
        let mut estimator = settled();
        // The way becomes slow, then nothing comes for a minute, then what waited and what is new.
        for k in 0..10 {
            assert_eq!(judge(&mut estimator, 1000 + 33 * k, 1900 + 33 * k), STALE);
        }
        for k in 0..10 {
            assert_eq!(judge(&mut estimator, 61_000 + 33 * k, 61_900 + k), STALE, "still 0.6 s and more too late");
        }
        assert_eq!(judge(&mut estimator, 62_000, 62_010), FRESH);
    }

    /// Judges a frame captured at this time and so many microseconds on its way, a clock that drifts among them.
    fn judge_us(estimator: &mut AgeEstimator, captured_ms: u64, on_the_way_us: u64) -> bool {
        let captured = Duration::from_millis(captured_ms);
        let received = captured + Duration::from_micros(on_the_way_us);
        is_fresh(estimator.judge(CLOCK + captured.as_nanos() as u64, 0, received, MAX_AGE))
    }

    #[test]
    fn an_offset_that_drifts_is_followed() {
        let mut estimator = settled();
        // The sender's clock loses 0.2 ms a second: after 30 minutes it is 360 ms behind, and no frame was late.
        for k in 31..54_000 {
            let (ms, jitter_us) = (33 * k, k * 7919 % 3000);
            assert_eq!(judge_us(&mut estimator, ms, 5000 + ms / 5 + jitter_us), FRESH, "frame {k}");
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
                assert!(verdict == STALE || late_us <= most_us, "{late_us} µs late at {us_per_s} µs/s");
                stale += u32::from(verdict == STALE);
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
        assert_eq!(judge(&mut estimator, 70_000, 70_005), FRESH);
        assert_eq!(judge(&mut estimator, 70_033, 70_333), STALE);
    }

    #[test]
    fn a_step_that_holds_is_the_measure_after_ten_seconds() {
        let mut estimator = settled();
        let (mut first_fresh, period_ms) = (None, 33);
        for k in 31..700 {
            let ms = period_ms * k;
            // 300 ms more from 1023 ms on: a longer route, or a clock set back.
            let verdict = judge_us(&mut estimator, ms, 305_000 + k * 7919 % 3000);
            assert!(first_fresh.is_none() || verdict == FRESH, "frame {k}");
            first_fresh = first_fresh.or((verdict == FRESH).then_some(ms));
        }
        let since_ms = first_fresh.expect("believed at last") - 1023;
        assert!((9_000..=10_600).contains(&since_ms), "after {since_ms} ms");
    }

    #[test]
    fn a_clock_that_jumps_back_is_believed_after_it_held_for_half_a_second() {
        let mut estimator = settled();
        let verdicts: Vec<bool> = (0..40).map(|k| judge(&mut estimator, 33 * k, 61_000 + 33 * k)).collect();
        assert_eq!(verdicts[0], STALE);
        let first_fresh = verdicts.iter().position(|&verdict| verdict == FRESH).expect("it settles");
        assert!((15..=17).contains(&first_fresh), "500 ms at 33 ms a frame, got frame {first_fresh}");
        assert!(verdicts[first_fresh..].iter().all(|&verdict| verdict == FRESH));
    }

    #[test]
    fn a_clock_that_jumps_ahead_costs_one_frame() {
        let mut estimator = settled();
        assert_eq!(judge(&mut estimator, 61_000, 1005), STALE);
        assert_eq!(judge(&mut estimator, 61_033, 1038), FRESH);
    }

    #[test]
    fn without_capture_times_what_ends_a_silence_proves_nothing_for_one_watchdog_time() {
        let (mut estimator, ms) = (AgeEstimator::default(), Duration::from_millis);
        let mut judge = |received_ms| is_fresh(estimator.judge_untimed(0, ms(received_ms), ms(300)));
        // The first of all, then within the watchdog time.
        for received in [9_000, 9_300, 9_333] {
            assert_eq!(judge(received), FRESH, "at {received}");
        }
        // 0.6 s of silence, then what waited and what is new.
        for received in [9_934, 9_935, 9_936, 10_000, 10_233] {
            assert_eq!(judge(received), STALE, "at {received}");
        }
        assert_eq!(judge(10_234), FRESH);
        assert_eq!(judge(10_535), STALE, "silent again");
    }

    /// Frames held back for `stall_ms`, then given back in order at `percent` of the camera's rate. The oldest that counted as fresh, in ms.
    fn oldest_of_a_drain(stall_ms: u64, percent: u64, jitter_us: u64) -> u64 {
        let mut estimator = settled();
        let mut oldest = 0;
        for k in 0..4000 {
            let captured_us = 1_000_000 + 33_000 * k;
            let jitter = if jitter_us == 0 { 0 } else { k * 7919 % jitter_us };
            let received_us = 1_000_000 + 1000 * stall_ms + 33_000 * k * 100 / percent + jitter;
            if received_us < captured_us + 5000 {
                break;
            }
            let (captured, received) = (CLOCK + captured_us * 1000, Duration::from_micros(received_us));
            if is_fresh(estimator.judge(captured, 0, received, MAX_AGE)) {
                // What a clock might have drifted is not seen.
                oldest = oldest.max((received_us - captured_us).saturating_sub(received_us / 1000) / 1000);
            }
        }
        oldest
    }

    #[test]
    fn a_backlog_that_drains_slowly_is_no_clock_that_jumped() {
        for percent in [102, 105, 110, 120, 139, 141, 200, 300] {
            for (stall_ms, jitter_us) in [(1100, 0), (3000, 0), (3000, 8000), (10_000, 3000)] {
                let oldest = oldest_of_a_drain(stall_ms, percent, jitter_us);
                assert!(oldest <= 205, "{oldest} ms after {stall_ms} ms at {percent} %, jitter {jitter_us} µs");
            }
        }
    }

    #[test]
    fn a_backlog_that_drains_from_a_clock_set_back_is_no_jump_that_has_held() {
        for percent in [110, 139, 200] {
            let mut estimator = settled();
            // 3 s held back by the link, and the clock a minute behind.
            for k in 0..60 {
                let (captured_ms, received_ms) = (k * 33, 64_000 + k * 3300 / percent);
                assert_eq!(judge(&mut estimator, captured_ms, received_ms), STALE, "frame {k} at {percent} %");
            }
        }
    }

    #[test]
    fn a_clock_set_back_settles_in_spite_of_jitter() {
        for jitter_ms in [1, 5, 10, 20] {
            let mut estimator = settled();
            let mut verdicts = (0..40).map(|k| judge(&mut estimator, 33 * k, 61_000 + 33 * k + k * 7919 % jitter_ms));
            let first_fresh = verdicts.position(|verdict| verdict == FRESH).expect("it settles");
            assert!((15..=26).contains(&first_fresh), "frame {first_fresh} with {jitter_ms} ms");
            assert!(verdicts.all(|verdict| verdict == FRESH), "{jitter_ms} ms");
        }
    }

    #[test]
    fn the_age_of_a_frame_is_what_it_waited_beyond_the_quickest() {
        let mut estimator = settled();
        let (captured, received) = (CLOCK + 1_000_000_000, Duration::from_millis(1155));
        assert_eq!(estimator.judge(captured, 0, received, MAX_AGE), Age::Fresh(Duration::from_millis(150)));
    }

    #[test]
    fn without_capture_times_what_is_out_of_order_or_twice_is_stale() {
        let (mut estimator, ms) = (AgeEstimator::default(), Duration::from_millis);
        let mut judge = |sequence, received_ms| is_fresh(estimator.judge_untimed(sequence, ms(received_ms), ms(300)));
        assert_eq!([judge(7, 0), judge(8, 33), judge(8, 40), judge(7, 50)], [FRESH, FRESH, STALE, STALE]);
        assert_eq!([judge(10, 66), judge(9, 70), judge(11, 99)], [FRESH, STALE, FRESH]);
        // 0 is no sequence, and neither forgets nor moves the count.
        assert_eq!([judge(0, 120), judge(0, 121), judge(11, 130), judge(12, 140)], [FRESH, FRESH, STALE, FRESH]);
    }

    #[test]
    fn without_capture_times_a_camera_that_was_restarted_counts_anew_after_a_silence() {
        let (mut estimator, ms) = (AgeEstimator::default(), Duration::from_millis);
        let mut judge = |sequence, received_ms| is_fresh(estimator.judge_untimed(sequence, ms(received_ms), ms(300)));
        assert_eq!(judge(1000, 0), FRESH);
        // After a silence, and without one: frames that are not in order keep no silence away.
        for begin in [1000, 2000] {
            let fresh: Vec<u64> = (0..30).filter(|&k| judge(1 + k, begin + 33 * k) == FRESH).collect();
            assert!(fresh.iter().copied().eq(fresh[0]..30), "all from one on: {fresh:?}");
            assert!((10..=20).contains(&fresh[0]), "within two watchdog times, got frame {}", fresh[0]);
        }
    }

    #[test]
    fn a_start_forgets_the_sequence() {
        let mut estimator = AgeEstimator::default();
        let judge = |estimator: &mut AgeEstimator, sequence| {
            is_fresh(estimator.judge_untimed(sequence, Duration::ZERO, SETTLING))
        };
        assert_eq!([judge(&mut estimator, 9), judge(&mut estimator, 1)], [FRESH, STALE]);
        estimator.forget_sequence();
        assert_eq!([judge(&mut estimator, 1), judge(&mut estimator, 1)], [FRESH, STALE]);
    }

    #[test]
    fn copies_of_old_frames_are_no_clock_that_went_back() {
        let (period_ms, late_ms) = (50, 2000);
        let ms = Duration::from_millis;
        let captured = |frame: u64| CLOCK + frame * period_ms * 1_000_000;
        // A link that gives nothing but what it gave before, for as long as it likes; then the camera is heard again.
        let mut estimator = AgeEstimator::default();
        for frame in 1..100 {
            assert!(is_fresh(estimator.judge(captured(frame), frame, ms(frame * period_ms + 5), MAX_AGE)));
        }
        for frame in 60..100 {
            let received = ms(frame * period_ms + 5 + late_ms);
            assert_eq!(estimator.judge(captured(frame), frame, received, MAX_AGE), Age::Stale, "{frame}");
        }
        let now = 100 * period_ms + late_ms;
        assert!(is_fresh(estimator.judge(CLOCK + now * 1_000_000, 200, ms(now + 5), MAX_AGE)));
        // A camera that was away and counts anew, by a clock of an hour ago.
        let hour_ns = 3_600_000_000_000;
        let verdicts: Vec<bool> = (1..40)
            .map(|frame| {
                let received = ms(now + 5000 + frame * period_ms);
                is_fresh(estimator.judge(captured(frame) - hour_ns, frame, received, MAX_AGE))
            })
            .collect();
        assert!(!verdicts[0] && verdicts[20..].iter().all(|fresh| *fresh), "{verdicts:?}");
    }
}
