//! The clerks: two threads that give the short answers for which neither callbacks nor compute threads have time.
//!
//! One answers those who have shown a task's secret, the other everybody else, each from a bounded queue of its own: a
//! stranger who asks ten thousand times a second fills the second queue, and no client's refusal is lost for it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::messages::{ErrorCode, ErrorReply};
use domvs_proto::status::Status;
use zenoh::Wait;
use zenoh::query::{Query, Reply};

use crate::answers::reply_json;
use crate::desk::Desk;
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
    /// The search for an owner is over.
    LookedUp,
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
pub(crate) struct Trays([Tray; 2]);

struct Tray {
    notes: flume::Receiver<Note>,
    /// The other end; it keeps no clerk at work.
    wake: flume::WeakSender<Note>,
}

impl Clerks {
    pub(crate) fn new() -> (Clerks, Trays) {
        let (owners, of_owners) = flume::bounded(WAITING);
        let (strangers, of_strangers) = flume::bounded(WAITING);
        let trays = [(of_owners, &owners), (of_strangers, &strangers)]
            .map(|(notes, sender)| Tray { notes, wake: sender.downgrade() });
        (Clerks { owners, strangers }, Trays(trays))
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
            let clerk = Clerk { shared: Arc::downgrade(shared), tray, lookups: Vec::new() };
            std::thread::Builder::new().name(name.to_owned()).spawn(move || clerk.work())?;
        }
        Ok(())
    }
}

/// One of the two threads.
struct Clerk {
    shared: Weak<Shared>,
    tray: Tray,
    lookups: Vec<Lookup>,
}

/// A query for a task that may be another worker's, which answers for itself. It stays with the clerk: Zenoh 1.10 calls, and drops, the
/// callback of a question for tokens under the lock of its session, and whoever lets go of a query there may wait for that lock for ever.
struct Lookup {
    query: Query,
    unknown: ErrorReply,
    tokens: Arc<Tokens>,
}

/// What has been heard of an owner's tokens.
#[derive(Default)]
struct Tokens {
    found: AtomicBool,
    /// Nothing more will be heard.
    ended: AtomicBool,
}

/// Zenoh's end of a lookup. Dropped, it tells the clerk; if the tray is full, the clerk looks anyway after what is in it.
struct Listener {
    tokens: Arc<Tokens>,
    wake: flume::WeakSender<Note>,
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.tokens.ended.store(true, Ordering::Release);
        if let Some(tray) = self.wake.upgrade() {
            // Full: see above.
            let _ = tray.try_send(Note::LookedUp);
        }
    }
}

impl Clerk {
    fn work(mut self) {
        while let Ok(note) = self.tray.notes.recv() {
            let Some(shared) = self.shared.upgrade() else { return };
            match note {
                Note::Info(query) => {
                    reply_json(&query, shared.keys.worker_info(&shared.worker), &body::write(&shared.info()));
                }
                Note::Unclaimed(query) => self.answer_unclaimed(&shared, query),
                Note::LookedUp => {}
                Note::Refused(query, error) => shared.refuse(&query, &error),
                Note::TwistRefused(desk, query, status) => desk.refuse_twist(&query, status),
            }
            self.end_lookups(&shared);
        }
    }

    /// A task's key that no task of this worker answers.
    fn answer_unclaimed(&mut self, shared: &Arc<Shared>, query: Query) {
        let key = query.key_expr();
        let Some((task, _)) = shared.keys.parse_task(key.as_str()) else {
            let error = format!("{key} is not a key of a task");
            return shared.refuse(&query, &ErrorReply::new(ErrorCode::BadName, error));
        };
        if self.lookups.len() >= LOOKUPS {
            return shared.dropped_note("a question for an unknown task");
        }
        let unknown =
            ErrorReply::new(ErrorCode::UnknownTask, format!("there is no task {task}; it may have been closed"));
        let tokens = Arc::<Tokens>::default();
        let listener = Listener { tokens: Arc::clone(&tokens), wake: self.tray.wake.clone() };
        self.lookups.push(Lookup { query, unknown, tokens });
        let found = move |reply: Reply| {
            if reply.result().is_ok() {
                listener.tokens.found.store(true, Ordering::Release);
            }
        };
        let owners = shared.keys.owners_of(&task);
        if let Err(error) = shared.session.liveliness().get(owners).timeout(LOOKUP).callback(found).wait() {
            tracing::debug!(%error, "no owner could be looked for");
        }
    }

    /// Says that there is no such task where no owner was found; an owner answers for itself.
    fn end_lookups(&mut self, shared: &Shared) {
        for lookup in self.lookups.extract_if(.., |lookup| lookup.tokens.ended.load(Ordering::Acquire)) {
            if !lookup.tokens.found.load(Ordering::Acquire) {
                shared.refuse(&lookup.query, &lookup.unknown);
            }
        }
    }
}
