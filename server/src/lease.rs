//! Whose going ends a task: one liveliness token, watched for each task as long as it lives, so what is remembered of tokens is
//! bounded by the tasks. Tokens of strangers are never heard of.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use domvs_proto::settings::Lease;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::Moment;
use crate::desk::{Desk, lock};
use crate::replica::epoch;

/// The token that a task hangs on; nothing without one.
#[derive(Debug, Default)]
pub(crate) struct WatchedLease {
    token: Option<WatchedToken>,
}

#[derive(Debug)]
struct WatchedToken {
    present: Arc<AtomicBool>,
    _subscriber: Subscriber<()>,
}

/// What the clock knows of the token.
#[derive(Debug, Default)]
pub(crate) struct LeaseWatch {
    /// It has been there.
    pub(crate) seen: bool,
    /// Since when it has been gone; its coming back alone does not change that, a `start` or `resume` does.
    pub(crate) gone_since: Option<Moment>,
    /// When this token was chosen.
    pub(crate) chosen: Moment,
}

impl WatchedLease {
    /// Whether the token is there; nothing if the task hangs on none.
    pub(crate) fn is_present(&self) -> Option<bool> {
        self.token.as_ref().map(|token| token.present.load(Ordering::Acquire))
    }
}

impl Desk {
    /// Watches the token of `lease` from now on, and no other. Fails before anything changes.
    pub(crate) fn watch_lease(&self, lease: &Lease) -> zenoh::Result<()> {
        self.hang_on(self.lease_of(lease)?);
        Ok(())
    }

    /// The token of `lease`, watched already; the task does not hang on it yet.
    pub(crate) fn lease_of(&self, lease: &Lease) -> zenoh::Result<WatchedLease> {
        let keys = &self.shared.keys;
        let key = match lease {
            Lease::None => None,
            Lease::Client => Some(keys.client_alive(&self.key.client)),
            Lease::Process(process) => Some(keys.process_alive(&self.key.client, process)),
        };
        Ok(WatchedLease { token: key.map(|key| self.watch_token(key)).transpose()? })
    }

    /// From now on the task hangs on this token, and on no other.
    pub(crate) fn hang_on(&self, lease: WatchedLease) {
        let mut watch = lock(&self.lease_watch);
        let before = std::mem::replace(&mut *lock(&self.lease), lease);
        (watch.seen, watch.chosen) = (false, self.shared.now());
        drop(watch);
        // It says farewell to the network, for which the clock should not wait.
        drop(before);
    }

    /// The task had another owner, and its client's token has not been heard of here: nobody knows whether the client outlived that owner.
    /// The token of a client that lives comes before anything else can, as it was asked for before the task's keys were declared.
    pub(crate) fn is_client_unheard(&self) -> bool {
        if self.epoch == epoch::first(&self.shared.worker) {
            return false;
        }
        let watch = lock(&self.lease_watch);
        !watch.seen && lock(&self.lease).is_present() == Some(false)
    }

    fn watch_token(&self, key: String) -> zenoh::Result<WatchedToken> {
        self.shared.spent.add(&key);
        let present = Arc::new(AtomicBool::new(false));
        let noted = Arc::clone(&present);
        let note = move |sample: Sample| noted.store(sample.kind() == SampleKind::Put, Ordering::Release);
        let subscriber =
            self.shared.session.liveliness().declare_subscriber(key).history(true).callback(note).wait()?;
        Ok(WatchedToken { present, _subscriber: subscriber })
    }
}
