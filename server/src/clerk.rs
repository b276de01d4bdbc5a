//! The clerks: two threads that give the short answers for which neither callbacks nor compute threads have time.
//!
//! One answers those who have shown a task's secret, the other everybody else, each from a bounded queue of its own: a
//! stranger who asks ten thousand times a second fills the second queue, and no client's refusal is lost for it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::messages::{ErrorCode, ErrorReply};
use domvs_proto::status::Status;
use zenoh::Wait;
use zenoh::query::{Query, Reply};

use crate::answers::reply_json;
use crate::desk::{Desk, lock};
use crate::worker::Shared;

/// Answers that may wait for one clerk; more are dropped and counted, and their clients see an empty answer.
const WAITING: usize = 256;
/// Unknown tasks whose owner is being looked for at once.
const LOOKUPS: usize = 64;
/// How long the owner of a task that is not ours is looked for.
const LOOKUP: Duration = Duration::from_millis(500);

/// A short answer.
pub(crate) enum Note {
    /// What the worker is.
    Info(Query),
    /// A query on a task's key that no task of this worker answers.
    Unclaimed(Query),
    /// An order that nobody will obey.
    Refused(Query, ErrorReply),
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
    let lookups = Arc::new(AtomicUsize::new(0));
    while let Ok(note) = tray.recv() {
        let Some(shared) = shared.upgrade() else { return };
        match note {
            Note::Info(query) => {
                reply_json(&query, shared.keys.worker_info(&shared.worker), &body::write(&shared.info()));
            }
            Note::Unclaimed(query) => answer_unclaimed(&shared, query, &lookups),
            Note::Refused(query, error) => shared.refuse(&query, &error),
            Note::TwistRefused(desk, query, status) => desk.refuse_twist(&query, status),
        }
    }
}

/// A query for a task that may be another worker's, which answers for itself; the last one to let go of this says
/// that there is no such task, unless its owner was found.
struct Lookup {
    query: Mutex<Option<Query>>,
    unknown: ErrorReply,
    /// Weak: the session, which the worker has, holds this.
    shared: Weak<Shared>,
    running: Arc<AtomicUsize>,
}

impl Drop for Lookup {
    fn drop(&mut self) {
        self.running.fetch_sub(1, Ordering::AcqRel);
        if let (Some(query), Some(shared)) = (lock(&self.query).take(), self.shared.upgrade()) {
            shared.refuse(&query, &self.unknown);
        }
    }
}

/// A task's key that no task of this worker answers.
fn answer_unclaimed(shared: &Arc<Shared>, query: Query, running: &Arc<AtomicUsize>) {
    let key = query.key_expr();
    let Some((task, _)) = shared.keys.parse_task(key.as_str()) else {
        let error = format!("{key} is not a key of a task");
        return shared.refuse(&query, &ErrorReply::new(ErrorCode::BadName, error));
    };
    if running.fetch_add(1, Ordering::AcqRel) >= LOOKUPS {
        running.fetch_sub(1, Ordering::AcqRel);
        shared.dropped_note("a question for an unknown task");
        return;
    }
    let unknown = ErrorReply::new(ErrorCode::UnknownTask, format!("there is no task {task}; it may have been closed"));
    let (query, running) = (Mutex::new(Some(query)), Arc::clone(running));
    let lookup = Lookup { query, unknown, shared: Arc::downgrade(shared), running };
    let found = move |reply: Reply| {
        if reply.result().is_ok() {
            lock(&lookup.query).take();
        }
    };
    let owners = shared.keys.owners_of(&task);
    if let Err(error) = shared.session.liveliness().get(owners).timeout(LOOKUP).callback(found).wait() {
        tracing::debug!(%error, "no owner could be looked for");
    }
}
