//! The Zenoh keys of one task: declared when it is created, gone when it is closed.
//!
//! What their callbacks do is in `door`.

use std::sync::Arc;

use domvs_proto::body;
use domvs_proto::keys::{Keys, TaskKey};
use domvs_proto::settings::Frames;
use domvs_proto::twist::TWIST_ENCODING;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::desk::Desk;
use crate::door;
use crate::outlet::Publish;
use crate::task::SentTarget;

/// What a task publishes besides `command`.
pub(crate) struct Publications {
    status: Publisher<'static>,
    state: Publisher<'static>,
}

/// Everything declared for one task; dropping it undeclares.
pub(crate) struct Endpoints {
    _queryables: Vec<Queryable<()>>,
    _subscribers: Vec<Subscriber<()>>,
    /// Declared last: whoever sees it may ask.
    _owner: LivelinessToken,
}

impl Publications {
    pub(crate) fn declare(session: &Session, keys: &Keys, task: &TaskKey) -> zenoh::Result<Publications> {
        let status = session.declare_publisher(keys.status(task)).encoding(body::JSON).wait()?;
        // Never waits, like all that is published: a standby that misses something sees it by the revision, and asks.
        let state = session.declare_publisher(keys.state(task)).encoding(body::JSON).wait()?;
        Ok(Publications { status, state })
    }

    pub(crate) fn status(&self, json: &[u8]) {
        log_failure(self.status.put(json).wait());
    }

    pub(crate) fn state(&self, json: Vec<u8>) {
        log_failure(self.state.put(json).wait());
    }
}

impl Publications {
    /// The target itself, for standbys.
    pub(crate) fn target(&self, sent: &SentTarget) {
        let put = self.state.put(sent.payload.clone()).encoding(sent.encoding.as_str());
        log_failure(put.attachment(sent.header.encode()).wait());
    }
}

/// A function that publishes on `command`: before all other traffic, never waiting.
pub(crate) fn command(session: &Session, keys: &Keys, task: &TaskKey) -> zenoh::Result<Publish> {
    let publisher = session
        .declare_publisher(keys.command(task))
        .encoding(TWIST_ENCODING)
        .priority(Priority::RealTime)
        .congestion_control(CongestionControl::Drop)
        .express(true)
        .wait()?;
    Ok(Box::new(move |message| log_failure(publisher.put(message.encode()).wait())))
}

impl Endpoints {
    pub(crate) fn declare(desk: &Arc<Desk>, frames: &Frames) -> zenoh::Result<Endpoints> {
        let (session, keys, task) = (&desk.shared.session, &desk.shared.keys, &desk.key);
        let queryables = vec![
            queryable(session, keys.control(task), desk, door::control)?,
            queryable(session, keys.settings(task), desk, door::settings)?,
            queryable(session, keys.state(task), desk, door::state)?,
            queryable(session, keys.target(task), desk, door::target)?,
            queryable(session, keys.twist(task), desk, door::request_twist)?,
        ];
        let mut subscribers = vec![frame_subscriber(session, keys.frame(task), desk)?];
        if let Frames::Key(key) = frames {
            subscribers.push(frame_subscriber(session, key.clone(), desk)?);
        }
        let owner = keys.owner(task, &desk.shared.worker, desk.epoch);
        let owner = session.liveliness().declare_token(owner).wait()?;
        Ok(Endpoints { _queryables: queryables, _subscribers: subscribers, _owner: owner })
    }
}

fn queryable(
    session: &Session,
    key: String,
    desk: &Arc<Desk>,
    enqueue: impl Fn(&Arc<Desk>, Query) + Send + Sync + 'static,
) -> zenoh::Result<Queryable<()>> {
    let desk = Arc::clone(desk);
    session.declare_queryable(key).complete(true).callback(move |query| enqueue(&desk, query)).wait()
}

fn frame_subscriber(session: &Session, key: String, desk: &Arc<Desk>) -> zenoh::Result<Subscriber<()>> {
    let desk = Arc::clone(desk);
    session.declare_subscriber(key).callback(move |sample| door::push_frame(&desk, &sample)).wait()
}

fn log_failure(result: zenoh::Result<()>) {
    if let Err(error) = result {
        tracing::debug!(%error, "a publication could not be sent");
    }
}
