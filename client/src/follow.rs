//! Following a task: its twists on `command` and its words on `status`, as they are published.
//!
//! Zenoh calls in on its receive path, so what happens there is small: read the fixed bytes, drop what an older owner
//! says, put the rest into a bounded box. Nothing is ever repeated: a twist that was read is gone.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::messages::StatusMessage;
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

use crate::ClientError;
use crate::mailbox::Mailbox;

/// Status messages that wait for a slow reader; every change matters, so there is some room.
const STATUS_ROOM: usize = 64;

/// The newest epoch that any part of a task's handle has seen.
#[derive(Debug, Clone, Default)]
pub(crate) struct Epoch(Arc<AtomicU32>);

impl Epoch {
    pub(crate) fn new(epoch: u32) -> Epoch {
        Epoch(Arc::new(AtomicU32::new(epoch)))
    }

    pub(crate) fn get(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }

    /// Takes over a newer epoch. An older one is refused with the newest.
    pub(crate) fn admit(&self, epoch: u32) -> Result<(), u32> {
        let newest = self.0.fetch_max(epoch, Ordering::Relaxed);
        if epoch < newest { Err(newest) } else { Ok(()) }
    }
}

/// The twists on a task's `command`; the newest wins.
///
/// Obey a twist until its `valid_ms` have passed, then brake. When [`Commands::recv`] gives nothing in time: brake.
#[derive(Debug)]
pub struct Commands {
    inbox: Arc<CommandInbox>,
    // Ends with this value.
    _subscriber: Subscriber<()>,
}

#[derive(Debug)]
struct CommandInbox {
    newest: Mailbox<TwistMessage>,
    epoch: Epoch,
    older_epochs: AtomicU64,
    unreadable: AtomicU64,
}

impl Commands {
    pub(crate) async fn follow(session: &Session, key: String, epoch: Epoch) -> Result<Commands, ClientError> {
        let inbox = Arc::new(CommandInbox {
            newest: Mailbox::with_room(1),
            epoch,
            older_epochs: AtomicU64::new(0),
            unreadable: AtomicU64::new(0),
        });
        let receiver = inbox.clone();
        let on_sample = move |sample: Sample| receiver.take_in(&sample.payload().to_bytes());
        let subscriber = subscribe(session, &key, on_sample).await?;
        Ok(Commands { inbox, _subscriber: subscriber })
    }

    /// The newest twist that was not read yet, waiting for one until `limit` has passed. `None` means brake.
    pub async fn recv(&mut self, limit: Duration) -> Option<TwistMessage> {
        self.inbox.newest.recv(limit).await
    }

    /// The newest twist that was not read yet, without waiting.
    pub fn latest(&mut self) -> Option<TwistMessage> {
        self.inbox.newest.take()
    }

    /// How many twists were replaced by newer ones before they were read.
    pub fn missed(&self) -> u64 {
        self.inbox.newest.missed()
    }

    /// How many twists of owners that were already replaced were dropped.
    pub fn older_epochs(&self) -> u64 {
        self.inbox.older_epochs.load(Ordering::Relaxed)
    }

    /// How many messages were no twist; each came out as zeros with `internal`.
    pub fn unreadable(&self) -> u64 {
        self.inbox.unreadable.load(Ordering::Relaxed)
    }
}

impl CommandInbox {
    fn take_in(&self, bytes: &[u8]) {
        match TwistMessage::decode(bytes) {
            Ok(twist) if self.epoch.admit(twist.epoch).is_ok() => self.newest.put(twist),
            Ok(_older) => {
                self.older_epochs.fetch_add(1, Ordering::Relaxed);
            }
            Err(_no_twist) => {
                self.unreadable.fetch_add(1, Ordering::Relaxed);
                self.newest.put(TwistMessage { epoch: self.epoch.get(), ..TwistMessage::zero(Status::Internal) });
            }
        }
    }
}

/// The messages on a task's `status`, in order; the oldest of too many unread ones is dropped and counted.
#[derive(Debug)]
pub struct Statuses {
    inbox: Arc<Mailbox<StatusMessage>>,
    // Ends with this value.
    _subscriber: Subscriber<()>,
}

impl Statuses {
    /// `key` may be that of one task or of every task; `epoch` drops what older owners say, when there is one task.
    pub(crate) async fn follow(session: &Session, key: String, epoch: Option<Epoch>) -> Result<Statuses, ClientError> {
        let inbox = Arc::new(Mailbox::with_room(STATUS_ROOM));
        let receiver = inbox.clone();
        let on_sample = move |sample: Sample| match body::read::<StatusMessage>(&sample.payload().to_bytes()) {
            Ok(message) if is_current(&message, epoch.as_ref()) => receiver.put(message),
            Ok(_older) => {}
            Err(error) => tracing::warn!(key = %sample.key_expr(), %error, "unreadable status"),
        };
        let subscriber = subscribe(session, &key, on_sample).await?;
        Ok(Statuses { inbox, _subscriber: subscriber })
    }

    /// The next message, waiting for one until `limit` has passed.
    pub async fn recv(&mut self, limit: Duration) -> Option<StatusMessage> {
        self.inbox.recv(limit).await
    }

    /// How many messages were dropped because nobody read them.
    pub fn missed(&self) -> u64 {
        self.inbox.missed()
    }
}

fn is_current(message: &StatusMessage, epoch: Option<&Epoch>) -> bool {
    epoch.is_none_or(|epoch| epoch.admit(message.epoch).is_ok())
}

async fn subscribe(
    session: &Session,
    key: &str,
    on_sample: impl Fn(Sample) + Send + Sync + 'static,
) -> Result<Subscriber<()>, ClientError> {
    session.declare_subscriber(key.to_owned()).callback(on_sample).await.map_err(ClientError::session("following", key))
}
