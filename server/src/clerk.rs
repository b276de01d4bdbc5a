//! The clerks: two threads that give the short answers for which neither callbacks nor compute threads have time.
//!
//! One answers those who have shown a task's secret, the other everybody else, each from a bounded queue of its own: a
//! stranger who asks ten thousand times a second fills the second queue, and no client's refusal is lost for it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use domvs_proto::body;
use domvs_proto::keys::{Leaf, TaskKey};
use domvs_proto::messages::{ControlReply, ErrorCode, ErrorReply};
use domvs_proto::status::Status;
use flume::RecvTimeoutError;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::Moment;
use crate::answers::reply_json;
use crate::desk::{Desk, lock};
use crate::worker::Shared;

/// Answers that may wait for one clerk; more are dropped and counted, and their clients see an empty answer.
const WAITING: usize = 256;
/// Questions for unknown tasks that may be held, and the bytes of all their payloads; more are dropped and counted.
const HELD: usize = 64;
const HELD_BYTES: usize = 16 << 20;
/// How long the news of a task's owner may take: the answer to `create` may be faster than they are.
const NEWS: Duration = Duration::from_millis(200);
/// How long a worker that has just joined may take to hear of the others.
const JOINING: Duration = Duration::from_millis(500);
/// How long a closed task is remembered, and how many.
const REMEMBERED: Duration = Duration::from_secs(1);
const CLOSED: usize = 1024;

/// A short answer.
pub(crate) enum Note {
    /// What the worker is.
    Info(Query),
    /// A query on a task's key that no task of this worker answers.
    Unclaimed(Query),
    /// An order that nobody will obey.
    Refused(Query, ErrorReply),
    /// A stop that was obeyed without waiting its turn.
    Stopped(Arc<Desk>, Query),
    /// A frame that nobody will look at.
    TwistRefused(Arc<Desk>, Query, Status),
}

/// Who asks.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Asker {
    /// Somebody with the secret of the task.
    Owner,
    /// Anybody.
    Stranger,
}

/// The tasks closed in the last second. A session hands a question to the task's own queryable and to the one for unknown tasks: a
/// `close` that was obeyed in between must not be answered by the second.
#[derive(Debug, Default)]
pub(crate) struct JustClosed(Mutex<VecDeque<(Moment, String)>>);

impl JustClosed {
    pub(crate) fn note(&self, task: &str, now: Moment) {
        let mut closed = lock(&self.0);
        closed.truncate(CLOSED - 1);
        closed.push_front((now, task.to_owned()));
    }

    pub(crate) fn knows(&self, task: &str, now: Moment) -> bool {
        let closed = lock(&self.0);
        let mut fresh = closed.iter().take_while(|(at, _)| now.saturating_sub(*at) <= REMEMBERED);
        fresh.any(|(_, closed)| closed == task)
    }
}

/// The ways to the clerks.
pub(crate) struct Clerks {
    owners: flume::Sender<Note>,
    strangers: flume::Sender<Note>,
}

/// What the two threads take from.
pub(crate) struct Trays([flume::Receiver<Note>; 2]);

impl Clerks {
    pub(crate) fn new() -> (Clerks, Trays) {
        let (owners, of_owners) = flume::bounded(WAITING);
        let (strangers, of_strangers) = flume::bounded(WAITING);
        (Clerks { owners, strangers }, Trays([of_owners, of_strangers]))
    }

    /// Hands a note over without waiting; returns whether there was room.
    pub(crate) fn give(&self, asker: Asker, note: Note) -> bool {
        let tray = match asker {
            Asker::Owner => &self.owners,
            Asker::Stranger => &self.strangers,
        };
        tray.try_send(note).is_ok()
    }
}

impl Trays {
    /// Starts the threads. They end with the worker.
    pub(crate) fn work_off(self, shared: &Arc<Shared>) -> std::io::Result<()> {
        for (tray, name) in self.0.into_iter().zip(["domvs-clerk", "domvs-doorman"]) {
            let shared = Arc::downgrade(shared);
            std::thread::Builder::new().name(name.to_owned()).spawn(move || work(&shared, &tray))?;
        }
        Ok(())
    }
}

fn work(shared: &Weak<Shared>, tray: &flume::Receiver<Note>) {
    let mut held: VecDeque<Held> = VecDeque::new();
    loop {
        let note = match held.front() {
            Some(first) => tray.recv_deadline(first.until),
            None => tray.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        let Some(shared) = shared.upgrade() else { return };
        match note {
            Ok(Note::Info(query)) => {
                reply_json(&query, shared.keys.worker_info(&shared.worker), &body::write(&shared.info()));
            }
            Ok(Note::Unclaimed(query)) => hold(&shared, &mut held, query),
            Ok(Note::Refused(query, error)) => shared.refuse(&query, &error),
            Ok(Note::Stopped(desk, query)) => {
                let key = shared.keys.task(&desk.key, Leaf::Control);
                reply_json(&query, key, &body::write(&ControlReply { status: Status::Stopped }));
            }
            Ok(Note::TwistRefused(desk, query, status)) => desk.refuse_twist(&query, status),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let now = Instant::now();
        while held.front().is_some_and(|first| first.until <= now) {
            held.pop_front().into_iter().for_each(|Held { query, task, .. }| answer_unknown(&shared, &query, &task));
        }
    }
}

/// A question for a task that nobody is known to have.
struct Held {
    query: Query,
    task: TaskKey,
    until: Instant,
}

/// A task's key that no task of this worker answers: the task may be another worker's, which answers for itself.
fn hold(shared: &Shared, held: &mut VecDeque<Held>, query: Query) {
    let key = query.key_expr();
    let Some((task, _)) = shared.keys.parse_task(key.as_str()) else {
        let error = format!("{key} is not a key of a task");
        return shared.refuse(&query, &ErrorReply::new(ErrorCode::BadName, error));
    };
    // Who has just joined does not know yet who is there.
    if !shared.inbox.has_others() && shared.now() > JOINING {
        return answer_unknown(shared, &query, &task);
    }
    let bytes = |query: &Query| query.payload().map_or(0, ZBytes::len);
    if held.len() >= HELD || bytes(&query) + held.iter().map(|held| bytes(&held.query)).sum::<usize>() > HELD_BYTES {
        return shared.dropped_note("a question for an unknown task");
    }
    held.push_back(Held { query, task, until: Instant::now() + NEWS });
}

/// No answer where there is an owner after all: whoever asked asks again.
fn answer_unknown(shared: &Shared, query: &Query, task: &TaskKey) {
    if !shared.is_owned(&task.to_string()) {
        let error = format!("there is no task {task}; it may have been closed");
        shared.refuse(query, &ErrorReply::new(ErrorCode::UnknownTask, error));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_is_remembered_for_a_second_after_its_end() {
        let (closed, ms) = (JustClosed::default(), Duration::from_millis);
        closed.note("alice/1", ms(100));
        assert!(closed.knows("alice/1", ms(900)));
        assert!(!closed.knows("alice/2", ms(900)));
        assert!(!closed.knows("alice/1", ms(1200)));
        (0..3 * CLOSED).for_each(|number| closed.note(&format!("bob/{number}"), ms(2000)));
        assert_eq!(lock(&closed.0).len(), CLOSED);
        assert!(closed.knows(&format!("bob/{}", 3 * CLOSED - 1), ms(2000)));
    }
}
