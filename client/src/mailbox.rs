//! A bounded box between the Zenoh receive path and the program: putting never blocks, the oldest is what gives way,
//! and what was lost is counted.
//!
//! Zenoh calls subscribers one after another on its receive path, where a full channel would stop the whole session; so the
//! callback only puts here. With room for one this is "the newest wins".

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{Instant, timeout_at};

/// Room for `room` items; one reader.
#[derive(Debug)]
pub(crate) struct Mailbox<T> {
    room: usize,
    inside: Mutex<Inside<T>>,
    arrived: Notify,
}

#[derive(Debug)]
struct Inside<T> {
    waiting: VecDeque<T>,
    missed: u64,
}

impl<T> Mailbox<T> {
    /// An empty box with room for `room` items (at least one).
    pub(crate) fn with_room(room: usize) -> Mailbox<T> {
        let room = room.max(1);
        let waiting = VecDeque::with_capacity(room);
        Mailbox { room, inside: Mutex::new(Inside { waiting, missed: 0 }), arrived: Notify::new() }
    }

    /// Puts an item; in a full box the oldest unread one is thrown away and counted.
    pub(crate) fn put(&self, item: T) {
        let mut inside = self.lock();
        if inside.waiting.len() == self.room {
            inside.waiting.pop_front();
            inside.missed += 1;
        }
        inside.waiting.push_back(item);
        drop(inside);
        self.arrived.notify_one();
    }

    /// The oldest unread item, without waiting.
    pub(crate) fn take(&self) -> Option<T> {
        self.lock().waiting.pop_front()
    }

    /// The oldest unread item, waiting for one until `limit` has passed.
    pub(crate) async fn recv(&self, limit: Duration) -> Option<T> {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(item) = self.take() {
                return Some(item);
            }
            if timeout_at(deadline, self.arrived.notified()).await.is_err() {
                return self.take();
            }
        }
    }

    /// How many items were thrown away unread.
    pub(crate) fn missed(&self) -> u64 {
        self.lock().missed
    }

    // A panic of another holder leaves a whole queue behind: every change above is a single push or pop.
    fn lock(&self) -> MutexGuard<'_, Inside<T>> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_wins_and_what_it_replaced_is_counted() {
        let mailbox = Mailbox::with_room(1);
        (1..=3).for_each(|number| mailbox.put(number));
        assert_eq!((mailbox.take(), mailbox.take(), mailbox.missed()), (Some(3), None, 2));
    }

    #[test]
    fn a_roomy_box_keeps_the_order() {
        let mailbox = Mailbox::with_room(3);
        (1..=4).for_each(|number| mailbox.put(number));
        let read: Vec<_> = std::iter::from_fn(|| mailbox.take()).collect();
        assert_eq!((read, mailbox.missed()), (vec![2, 3, 4], 1));
    }

    #[tokio::test]
    async fn waiting_ends_at_its_limit() {
        let mailbox = Mailbox::<u8>::with_room(1);
        assert_eq!(mailbox.recv(Duration::from_millis(1)).await, None);
    }

    #[tokio::test]
    async fn a_waiting_reader_gets_what_arrives() {
        let mailbox = std::sync::Arc::new(Mailbox::with_room(1));
        let reader = tokio::spawn({
            let mailbox = mailbox.clone();
            async move { mailbox.recv(Duration::from_secs(10)).await }
        });
        mailbox.put(7);
        assert_eq!(reader.await.expect("the reader ends"), Some(7));
    }
}
