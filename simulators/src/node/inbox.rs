//! What the Zenoh callbacks leave for the flying thread: bounded, in order, each with its time of receipt.
//!
//! The time is taken under the lock, as is the reader's: what the reader has not got yet came after its `now`.
//! When it is full the oldest command goes, so that the newest and every stop are always heard.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use domvs_proto::keys::TaskKey;
use domvs_proto::twist::TWIST_BYTES;

/// A camera that is this far behind has other problems.
const CAPACITY: usize = 64;

/// Something the camera has to hear.
#[derive(Debug, PartialEq)]
pub(super) enum Event {
    /// A payload on a task's `command`; `None` when it has not the length of a twist.
    Command { task: TaskKey, bytes: Option<[u8; TWIST_BYTES]> },
    /// Everything stops.
    StopAll,
}

/// What has come, and the instant up to which that is all.
#[derive(Debug)]
pub(super) struct Taken {
    pub(super) events: VecDeque<(Instant, Event)>,
    pub(super) now: Instant,
}

#[derive(Debug, Default)]
pub(super) struct Inbox {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    events: VecDeque<(Instant, Event)>,
    closed: bool,
}

impl Inbox {
    /// Leaves an event; never waits for its reader.
    pub(super) fn push(&self, event: Event) {
        let mut state = self.lock();
        if state.events.len() == CAPACITY {
            let oldest_command = state.events.iter().position(|(_, event)| *event != Event::StopAll);
            // All stops: one more says nothing new.
            let Some(index) = oldest_command else { return };
            state.events.remove(index);
        }
        state.events.push_back((Instant::now(), event));
        self.changed.notify_one();
    }

    /// Ends the reader.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }

    /// Waits for events until `deadline`; takes them all, oldest first, and says when. `None` when closed.
    pub(super) fn take_until(&self, deadline: Instant) -> Option<Taken> {
        let mut state = self.lock();
        while !state.closed && state.events.is_empty() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        (!state.closed).then(|| Taken { events: std::mem::take(&mut state.events), now: Instant::now() })
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code panics while it holds the lock, and the queue is whole at any instant.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(id: usize) -> Event {
        let name = |text: String| text.try_into().expect("letters and digits");
        Event::Command { task: TaskKey { client: name("c".into()), id: name(format!("t{id}")) }, bytes: None }
    }

    #[test]
    fn a_full_inbox_loses_the_oldest_command_and_no_stop() {
        let inbox = Inbox::default();
        inbox.push(Event::StopAll);
        (0..CAPACITY).for_each(|id| inbox.push(command(id)));
        let taken = inbox.take_until(Instant::now()).expect("open");
        assert!(taken.events.iter().all(|(received, _)| *received <= taken.now));
        let events: Vec<Event> = taken.events.into_iter().map(|(_, event)| event).collect();
        let expected: Vec<Event> = std::iter::once(Event::StopAll).chain((1..CAPACITY).map(command)).collect();
        assert_eq!(events, expected);
    }

    #[test]
    fn a_closed_inbox_ends_its_reader() {
        let inbox = Inbox::default();
        inbox.close();
        assert!(inbox.take_until(Instant::now()).is_none());
    }
}
