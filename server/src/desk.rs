//! Where one task's work is done: the compute pool takes an order, a request or a frame from the mailbox, makes
//! one plain call into the task, and answers. A refusal is an answer too: nobody waits for silence. The work itself
//! is in `orders` and `frames`.
//!
//! Locks are taken in this order, never the other way: task, outlet, board; and halt before `halt_asked` and outlet. None is held
//! while something is computed, save the task's.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use domvs_proto::body;
use domvs_proto::frame::Secret;
use domvs_proto::keys::TaskKey;
use domvs_proto::messages::{ErrorCode, ErrorReply};
use domvs_proto::status::Status;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::key_expr::KeyExpr;
use zenoh::query::Query;

use crate::Moment;
use crate::board::Board;
use crate::endpoints::Publications;
use crate::lease::{LeaseWatch, WatchedLease};
use crate::mailbox::{Item, Mailbox};
use crate::metrics::{Dropped, Event};
use crate::outlet::Outlet;
use crate::ownership::SecretCheck;
use crate::pool::Work;
use crate::task::Task;
use crate::tenants::{Bucket, Held, Tenant};
use crate::worker::Shared;

/// Something a client wants of a task, other than a twist.
pub(crate) enum Order {
    /// `control`, and when it came.
    Control(Query, Moment),
    /// `settings`: get or change.
    Settings(Query),
    /// `target`: get or set.
    Target(Query, Moment),
    /// `state`.
    State(Query),
}

impl Order {
    /// What was asked.
    pub(crate) fn query(&self) -> &Query {
        match self {
            Order::Control(query, _) | Order::Settings(query) | Order::Target(query, _) | Order::State(query) => query,
        }
    }

    /// Who waits for an answer.
    pub(crate) fn into_query(self) -> Query {
        match self {
            Order::Control(query, _) | Order::Settings(query) | Order::Target(query, _) | Order::State(query) => query,
        }
    }
}

/// A request on `twist`.
pub(crate) struct TwistRequest {
    pub(crate) query: Query,
    pub(crate) received: Moment,
}

/// A frame that a camera has published.
pub(crate) struct PushedFrame {
    pub(crate) attachment: Option<ZBytes>,
    pub(crate) encoding: Encoding,
    pub(crate) payload: ZBytes,
    pub(crate) received: Moment,
    /// `[capture_time_ns, sequence]`; zeros without a header.
    pub(crate) taken: [u64; 2],
}

/// A message that waits, with what it takes of its client's account until it is done with.
pub(crate) struct Waiting<T> {
    pub(crate) message: T,
    pub(crate) held: Held,
}

/// One task with everything that waits for it.
pub(crate) struct Desk {
    pub(crate) key: TaskKey,
    /// Of `twist`, made once: it goes with every reply.
    pub(crate) twist_key: KeyExpr<'static>,
    pub(crate) epoch: u32,
    pub(crate) secret: SecretCheck,
    /// What lets a camera push frames, and nothing else.
    pub(crate) frame_secret: SecretCheck,
    /// Of the settings: what callbacks need without waiting for the task.
    pub(crate) frames_need_secret: AtomicBool,
    /// What its client uses and may use.
    pub(crate) tenant: Arc<Tenant>,
    /// For questions that need no secret, whoever asks them.
    pub(crate) public: Mutex<Bucket>,
    /// What the target takes of the client's account.
    pub(crate) target_bytes: Mutex<Option<Held>>,
    /// Of the camera of the settings; changes under the lock of all desks alone.
    pub(crate) pixels: AtomicU64,
    pub(crate) shared: Arc<Shared>,
    pub(crate) publications: Publications,
    pub(crate) mailbox: Mailbox<Waiting<Order>, Waiting<TwistRequest>, Waiting<PushedFrame>>,
    pub(crate) task: Mutex<Task>,
    pub(crate) outlet: Mutex<Outlet>,
    pub(crate) board: Mutex<Board>,
    /// The client's token, as the clock sees it.
    pub(crate) lease_watch: Mutex<LeaseWatch>,
    /// The token itself. Locked after the watch.
    pub(crate) lease: Mutex<WatchedLease>,
    /// Of the settings: what the clock needs without waiting for the task, which the pool may hold. Changes with the settings.
    pub(crate) idle_close_s: AtomicU32,
    /// A status to latch before anything else is done; set by callbacks and the clock.
    pub(crate) halt: Mutex<Option<Status>>,
    /// When a halt was last asked for: a `start` that came before is overruled by it, however long it waits.
    pub(crate) halt_asked: Mutex<Moment>,
    /// The client, or nobody's using it, asked for the end.
    pub(crate) closing: AtomicBool,
    /// A newer owner has it.
    pub(crate) superseded: AtomicBool,
    /// This worker ends its session; another goes on.
    pub(crate) leaving: AtomicBool,
    /// The registrar has been told.
    pub(crate) close_given: AtomicBool,
    pub(crate) scheduled: AtomicBool,
}

impl Work for Desk {
    fn run_one(&self) {
        let begin = self.shared.now();
        // What panics inside a single call is answered there; whatever else might is stopped here.
        self.guarded(|| {
            self.obey_halt();
            match self.mailbox.take() {
                Some(Item::Order(Waiting { message, held })) => self.obey(message, held),
                Some(Item::Request(Waiting { message, held: _held })) => self.answer_twist(&message),
                Some(Item::Frame(Waiting { message, held: _held })) => self.follow_frame(&message),
                None => {}
            }
        });
        self.shared.add_busy(self.shared.now().saturating_sub(begin));
    }

    fn has_work(&self) -> bool {
        self.mailbox.has_items() || lock(&self.halt).is_some()
    }

    fn scheduled(&self) -> &AtomicBool {
        &self.scheduled
    }
}

impl Drop for Desk {
    /// Nobody will look at what waits.
    fn drop(&mut self) {
        let (requests, frame) = self.mailbox.discard_images();
        self.shared.metrics.dropped_many(Dropped::Closed, requests.len() + usize::from(frame.is_some()));
    }
}

impl Desk {
    /// Asks for a latched halt: takes effect on `command` at the clock's next look, and before the next frame.
    pub(crate) fn request_halt(&self, status: Status) {
        let mut halt = lock(&self.halt);
        halt.get_or_insert(status);
        *lock(&self.halt_asked) = self.shared.now();
    }

    /// A newer owner has the task: asks for the last halt, whatever other one waits.
    pub(crate) fn supersede(&self) {
        self.superseded.store(true, Ordering::Release);
        *lock(&self.halt) = Some(Status::Superseded);
    }

    /// The last words of a worker that ends, after its zeros: `owner_lost`, and an answer to every request that waits.
    pub(crate) fn say_last_words(&self, now: Moment) {
        let (requests, frame) = self.mailbox.discard_images();
        self.shared.metrics.dropped_many(Dropped::Closed, usize::from(frame.is_some()));
        requests.iter().for_each(|request| self.refuse_twist(&request.message.query, Status::OwnerLost));
        let mut board = lock(&self.board);
        board.say(Status::OwnerLost, None);
        if let Some(message) = board.due(now) {
            self.publications.status(&body::write(&message));
        }
    }

    fn obey_halt(&self) {
        let Some(status) = lock(&self.halt).take() else { return };
        let mut task = lock(&self.task);
        task.latch(status);
        lock(&self.outlet).halt(Some(status), self.shared.now());
        lock(&self.board).say(status, None);
        self.publish_state(&task);
    }

    pub(crate) fn guarded<T>(&self, work: impl FnOnce() -> T) -> Option<T> {
        // What a panic leaves half done belongs to this task alone, and a latched task does nothing with it.
        catch_unwind(AssertUnwindSafe(work))
            .map_err(|panic| {
                self.shared.metrics.happened(Event::Panic);
                let panic = panic_text(&*panic);
                tracing::error!(task = %self.key, client = %self.key.client, panic, "a panic ended the task");
                self.request_halt(Status::Internal);
            })
            .ok()
    }

    pub(crate) fn check_owner(&self, secret: Option<&Secret>) -> Result<(), ErrorReply> {
        match secret {
            Some(secret) if self.secret.admits(secret) => Ok(()),
            Some(_) => Err(ErrorReply::new(ErrorCode::NotOwner, "the secret is not this task's")),
            None => Err(ErrorReply::new(ErrorCode::NotOwner, "the request carries no secret; create returned it")),
        }
    }

    /// Whether a pushed frame with this secret is this task's.
    pub(crate) fn takes_frames_of(&self, secret: &Secret) -> bool {
        // Both are compared whatever the first says.
        self.frame_secret.admits(secret) | self.secret.admits(secret)
    }

    /// The task is closed: what it took of its client's account is given back, whoever still looks at it.
    pub(crate) fn forget(&self) {
        lock(&self.target_bytes).take();
        let lease = std::mem::take(&mut *lock(&self.lease));
        drop(lease);
    }

    pub(crate) fn check_bytes(&self, payload: Option<&ZBytes>) -> Result<(), String> {
        let (limit, got) = (self.shared.config.limits.bytes_per_payload, payload.map_or(0, ZBytes::len));
        if got <= limit { Ok(()) } else { Err(format!("a payload may have {limit} bytes, got {got}")) }
    }
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic is caught inside the lock, so a poisoned mutex can only mean that a guard was dropped while unwinding.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}
