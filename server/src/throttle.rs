//! A log that cannot be flooded: so many lines a second of each kind, and how many were left out.

use std::sync::Mutex;
use std::time::Duration;

use crate::Moment;
use crate::desk::lock;

/// Lines of one kind in one second; more are counted.
pub(crate) const LINES_PER_SECOND: u32 = 5;
const SECOND: Duration = Duration::from_secs(1);

/// Decides which lines of `KINDS` kinds are said.
pub(crate) struct Throttle<const KINDS: usize> {
    windows: Mutex<[Window; KINDS]>,
}

#[derive(Clone, Copy, Default)]
struct Window {
    since: Moment,
    said: u32,
    left_out: u64,
}

impl<const KINDS: usize> Throttle<KINDS> {
    pub(crate) fn new() -> Throttle<KINDS> {
        Throttle { windows: Mutex::new([Window::default(); KINDS]) }
    }

    /// Whether a line may be said now: how many were left out since the last one, or `None` if this one is, too.
    pub(crate) fn admit(&self, kind: usize, now: Moment) -> Option<u64> {
        let window = &mut lock(&self.windows)[kind];
        if now.saturating_sub(window.since) >= SECOND {
            (window.since, window.said) = (now, 0);
        }
        if window.said >= LINES_PER_SECOND {
            window.left_out += 1;
            return None;
        }
        window.said += 1;
        Some(std::mem::take(&mut window.left_out))
    }

    /// Kinds of which lines were left out in a second that is over, and how many: nobody else will say so.
    pub(crate) fn overdue(&self, now: Moment) -> impl Iterator<Item = (usize, u64)> + use<KINDS> {
        let mut overdue = [0; KINDS];
        for (count, window) in overdue.iter_mut().zip(lock(&self.windows).iter_mut()) {
            if now.saturating_sub(window.since) >= SECOND {
                *count = std::mem::take(&mut window.left_out);
            }
        }
        overdue.into_iter().enumerate().filter(|(_, left_out)| *left_out > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Moment {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_flood_of_one_kind_is_cut_counted_and_leaves_the_others_alone() {
        let throttle = Throttle::<2>::new();
        let said = (0..1000).filter(|at| throttle.admit(0, ms(*at)).is_some()).count();
        assert_eq!(said, LINES_PER_SECOND as usize);
        assert_eq!(throttle.admit(1, ms(999)), Some(0));
        assert_eq!(throttle.admit(0, ms(1000)), Some(1000 - u64::from(LINES_PER_SECOND)));
    }

    #[test]
    fn what_was_left_out_is_told_once_when_its_second_is_over() {
        let throttle = Throttle::<2>::new();
        (0..8).for_each(|_| _ = throttle.admit(1, ms(500)));
        assert_eq!(throttle.overdue(ms(900)).count(), 0, "its second, which began at 0, is not over");
        (0..9).for_each(|_| _ = throttle.admit(1, ms(1000)));
        assert_eq!(throttle.overdue(ms(1999)).count(), 0);
        assert_eq!(throttle.overdue(ms(2000)).collect::<Vec<_>>(), [(1, 4)]);
        assert_eq!(throttle.overdue(ms(2001)).count(), 0);
    }
}
