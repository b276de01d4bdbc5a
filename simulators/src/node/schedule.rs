//! When frames are due: on a fixed grid from the start; what is late is left out, never made up for in a burst.

use std::time::{Duration, Instant};

#[derive(Debug)]
pub(super) struct Schedule {
    due: Instant,
    period: Duration,
}

impl Schedule {
    /// Due at `start` and every `period` after it, which is positive.
    pub(super) fn new(start: Instant, period: Duration) -> Schedule {
        Schedule { due: start, period }
    }

    /// The next instant of the grid.
    pub(super) fn due(&self) -> Instant {
        self.due
    }

    /// Whether something is due at `now`; if so, next is the first instant of the grid after `now`.
    pub(super) fn take(&mut self, now: Instant) -> bool {
        let Some(late) = now.checked_duration_since(self.due) else {
            return false;
        };
        let periods = late.as_nanos() / self.period.as_nanos().max(1) + 1;
        self.due += self.period * u32::try_from(periods).unwrap_or(u32::MAX);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_ticks_are_left_out_and_the_grid_stays() {
        let start = Instant::now();
        let ms = |count| start + Duration::from_millis(count);
        let mut schedule = Schedule::new(start, Duration::from_millis(10));
        assert!(schedule.take(ms(0)), "the first frame is due at the start");
        assert!(!schedule.take(ms(9)));
        assert!(schedule.take(ms(37)), "three are due at once, one is taken");
        assert!(!schedule.take(ms(39)));
        assert_eq!(schedule.due(), ms(40));
    }
}
