//! Whether the whole process stood still between two looks of the clock: stopped, starved, or with the machine asleep.

use std::time::{Duration, SystemTime};

use crate::Moment;

/// Between two looks of the clock: how late a zero may come after the watchdog has run out.
pub const TICK: Duration = Duration::from_millis(5);

/// What both clocks said at the last look.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    monotonic: Moment,
    wall: SystemTime,
}

/// What lies between two looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pause {
    /// How long it was.
    pub length: Duration,
    /// It began after this. Zero where the machine slept: nothing that was compared with the worker's clock before holds after it.
    pub since: Moment,
}

impl Clocks {
    /// Both clocks at the first look.
    pub fn new(monotonic: Moment, wall: SystemTime) -> Clocks {
        Clocks { monotonic, wall }
    }

    /// What has passed since the last look, by the clock that says more: the monotonic one stands still while the machine sleeps.
    /// A wall clock that is set ahead looks the same and costs as little.
    pub fn look(&mut self, now: Moment, wall: SystemTime) -> Pause {
        let monotonic = now.saturating_sub(self.monotonic);
        let by_wall = wall.duration_since(self.wall).unwrap_or_default();
        let slept = by_wall > 2 * monotonic + TICK;
        let since = if slept { Moment::ZERO } else { self.monotonic };
        *self = Clocks { monotonic: now, wall };
        Pause { length: monotonic.max(by_wall), since }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_shows_by_the_clock_that_says_more() {
        let (ms, wall) = (Duration::from_millis, SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000));
        let mut clocks = Clocks::new(ms(100), wall);
        let mut look = |monotonic, since_start| clocks.look(ms(monotonic), wall + ms(since_start));
        assert_eq!(look(105, 5), Pause { length: ms(5), since: ms(100) });
        assert_eq!(look(5105, 5005), Pause { length: ms(5000), since: ms(105) }, "the process was stopped");
        assert_eq!(look(5110, 65_005), Pause { length: ms(60_000), since: ms(0) }, "the machine slept");
        assert_eq!(look(5115, 0), Pause { length: ms(5), since: ms(5110) }, "the wall clock was set back");
    }
}
