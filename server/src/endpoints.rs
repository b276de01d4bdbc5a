//! The Zenoh keys of one task: declared when it is created, gone when it is closed.
//!
//! Zenoh 1.10 numbers the literal beginning of every key that is declared, in 16 bits, and never gives a number back. So a task declares
//! `task/*/<id>/<leaf>`, whose beginning all tasks share, and each callback looks whether the client in the key is the task's; what is
//! published is put on its key without a declaration. Left are the tokens, which `Spent` counts. What the callbacks do is in `door`.

use std::collections::HashSet;
use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Mutex};

use domvs_proto::body;
use domvs_proto::keys::{Keys, Leaf, TaskKey};
use domvs_proto::settings::Frames;
use domvs_proto::twist::TWIST_ENCODING;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::desk::{Desk, lock};
use crate::door;
use crate::outlet::Publish;
use crate::task::SentTarget;

/// What a task publishes besides `command`.
pub(crate) struct Publications {
    session: Session,
    status: KeyExpr<'static>,
    state: KeyExpr<'static>,
}

/// Everything declared for one task; dropping it undeclares.
pub(crate) struct Endpoints {
    _queryables: Vec<Queryable<()>>,
    _subscribers: Vec<Subscriber<()>>,
    /// Declared last: whoever sees it may ask.
    _owner: LivelinessToken,
}

/// Which of the 65 535 numbers that Zenoh has for the keys of a link this session may have used up: by its own tasks, and by the
/// tokens it has heard of. A key keeps its number, so one that comes again costs nothing. Rather too many are counted: beyond the end
/// one key would be taken for another.
#[derive(Debug, Default)]
pub(crate) struct Spent {
    /// Of the keys; no more than [`Spent::END`].
    hashes: Mutex<HashSet<u64>>,
    hasher: RandomState,
}

impl Spent {
    /// A worker without tasks begins a new session from here on.
    const RENEW: usize = 30_000;
    /// No task is made from here on; a worker of which no task runs begins a new session.
    const END: usize = 60_000;

    pub(crate) fn count(&self) -> usize {
        lock(&self.hashes).len()
    }

    /// A token has come, or a key is declared for a task: its owner's, its lease, its camera's.
    pub(crate) fn add(&self, key: &str) {
        let hash = self.hasher.hash_one(key);
        let mut hashes = lock(&self.hashes);
        if hashes.len() < Spent::END {
            hashes.insert(hash);
        }
    }

    pub(crate) fn is_due(&self) -> bool {
        self.count() >= Spent::RENEW
    }

    /// Why no task can be made, if none can.
    pub(crate) fn check(&self) -> Result<(), String> {
        let (count, end) = (self.count(), Spent::END);
        if count < end {
            return Ok(());
        }
        Err(format!(
            "a session has keys for {end} tasks and tokens, this one has used {count}: it is renewed as soon as none of the worker's tasks runs; ask again, or another worker"
        ))
    }
}

impl Publications {
    pub(crate) fn new(session: &Session, keys: &Keys, task: &TaskKey) -> zenoh::Result<Publications> {
        let (status, state) = (KeyExpr::try_from(keys.status(task))?, KeyExpr::try_from(keys.state(task))?);
        Ok(Publications { session: session.clone(), status, state })
    }

    pub(crate) fn status(&self, json: &[u8]) {
        log_failure(self.session.put(&self.status, json).encoding(body::JSON).wait());
    }

    // Never waits, like all that is published: a standby that misses something sees it by the revision, and asks.
    pub(crate) fn state(&self, json: Vec<u8>) {
        log_failure(self.session.put(&self.state, json).encoding(body::JSON).wait());
    }

    /// The target itself, for standbys.
    pub(crate) fn target(&self, sent: &SentTarget) {
        let put = self.session.put(&self.state, sent.payload.clone()).encoding(sent.encoding.as_str());
        log_failure(put.attachment(sent.header.encode()).wait());
    }
}

/// What makes the session learn who listens to the tasks, so that nothing is sent to nobody; for as long as these values live.
pub(crate) async fn learn_listeners(session: &Session, keys: &Keys) -> zenoh::Result<Vec<Publisher<'static>>> {
    let mut publishers = vec![];
    for leaf in [Leaf::Command, Leaf::Status, Leaf::State] {
        publishers.push(session.declare_publisher(keys.every(leaf)).await?);
    }
    Ok(publishers)
}

/// A function that publishes on `command`: before all other traffic, never waiting.
pub(crate) fn command(session: &Session, keys: &Keys, task: &TaskKey) -> zenoh::Result<Publish> {
    let (session, key) = (session.clone(), KeyExpr::try_from(keys.command(task))?);
    Ok(Box::new(move |message| {
        let put = session.put(&key, message.encode()).encoding(TWIST_ENCODING);
        let put = put.priority(Priority::RealTime).congestion_control(CongestionControl::Drop).express(true);
        log_failure(put.wait());
    }))
}

impl Endpoints {
    pub(crate) fn declare(desk: &Arc<Desk>, frames: &Frames) -> zenoh::Result<Endpoints> {
        let (session, keys, task) = (&desk.shared.session, &desk.shared.keys, &desk.key);
        let queryables = vec![
            queryable(Leaf::Control, desk, door::control)?,
            queryable(Leaf::Settings, desk, door::settings)?,
            queryable(Leaf::State, desk, door::state)?,
            queryable(Leaf::Target, desk, door::target)?,
            queryable(Leaf::Twist, desk, door::request_twist)?,
        ];
        let own = KeyExpr::try_from(keys.frame(task))?;
        let mut subscribers = vec![frame_subscriber(keys.of_any_client(task, Leaf::Frame), Some(own), desk)?];
        if let Frames::Key(key) = frames {
            desk.shared.spent.add(key);
            subscribers.push(frame_subscriber(key.clone(), None, desk)?);
        }
        let owner = keys.owner(task, &desk.shared.worker, desk.epoch);
        desk.shared.spent.add(&owner);
        let owner = session.liveliness().declare_token(owner).wait()?;
        Ok(Endpoints { _queryables: queryables, _subscribers: subscribers, _owner: owner })
    }
}

fn queryable(
    leaf: Leaf,
    desk: &Arc<Desk>,
    enqueue: impl Fn(&Arc<Desk>, Query) + Send + Sync + 'static,
) -> zenoh::Result<Queryable<()>> {
    let keys = &desk.shared.keys;
    let (any, own) = (keys.of_any_client(&desk.key, leaf), KeyExpr::try_from(keys.task(&desk.key, leaf))?);
    let (session, desk) = (&desk.shared.session, Arc::clone(desk));
    let answer = move |query: Query| {
        // Another client's name: the queryable for the tasks that nobody has gets it too, and says so.
        if own.intersects(query.key_expr()) {
            enqueue(&desk, query);
        }
    };
    session.declare_queryable(any).complete(true).callback(answer).wait()
}

/// `own`: only what is put on this key is the task's.
fn frame_subscriber(key: String, own: Option<KeyExpr<'static>>, desk: &Arc<Desk>) -> zenoh::Result<Subscriber<()>> {
    let (session, desk) = (&desk.shared.session, Arc::clone(desk));
    let take = move |sample: Sample| {
        if own.as_ref().is_none_or(|own| own.intersects(sample.key_expr())) {
            door::push_frame(&desk, &sample);
        }
    };
    session.declare_subscriber(key).callback(take).wait()
}

fn log_failure(result: zenoh::Result<()>) {
    if let Err(error) = result {
        tracing::debug!(%error, "a publication could not be sent");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_that_has_used_its_keys_up_takes_no_task_and_is_renewed_long_before() {
        let spent = Spent::default();
        for number in 0..Spent::RENEW {
            assert!(!spent.is_due() && spent.check().is_ok(), "{number}");
            spent.add(&format!("domvs/client/n{number}/alive"));
        }
        assert!(spent.is_due() && spent.check().is_ok());
        (Spent::RENEW..2 * Spent::END).for_each(|number| spent.add(&format!("domvs/client/n{number}/alive")));
        assert!(spent.check().expect_err("none is left").contains("60000"));
        assert_eq!(spent.count(), Spent::END, "what is remembered is bounded");
    }

    #[test]
    fn a_token_that_comes_and_goes_costs_one_key() {
        let spent = Spent::default();
        (0..Spent::END).for_each(|_| spent.add("domvs/client/mallory/alive"));
        assert_eq!(spent.count(), 1);
    }
}
