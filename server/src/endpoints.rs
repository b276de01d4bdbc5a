//! The Zenoh keys of one task: declared when it is created, gone when it is closed.
//!
//! Callbacks run one after another on the session's receive path, so each only puts what came into the mailbox
//! and wakes the pool.

use std::sync::Arc;

use domvs_proto::body;
use domvs_proto::keys::{Keys, TaskKey};
use domvs_proto::messages::{ErrorCode, ErrorReply};
use domvs_proto::settings::Frames;
use domvs_proto::status::Status;
use domvs_proto::twist::TWIST_ENCODING;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::desk::{Desk, Order, PushedFrame, TwistRequest, lock};
use crate::metrics::{Asked, Dropped};
use crate::orders::attached_secret;
use crate::outlet::Publish;
use crate::registrar::Job;
use crate::task::Route;
use crate::worker::Shared;

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
            queryable(session, keys.control(task), desk, control)?,
            queryable(session, keys.settings(task), desk, |desk, query| order(desk, Order::Settings(query)))?,
            queryable(session, keys.state(task), desk, |desk, query| order(desk, Order::State(query)))?,
            queryable(session, keys.target(task), desk, |desk, query| {
                let received = desk.shared.now();
                order(desk, Order::Target(query, received));
            })?,
            queryable(session, keys.twist(task), desk, request_twist)?,
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
    session.declare_subscriber(key).callback(move |sample| push_frame(&desk, &sample)).wait()
}

/// A stop must find room: only the owner's words are let in, and they have a queue of their own.
fn control(desk: &Arc<Desk>, query: Query) {
    desk.shared.metrics.asked(Asked::Control);
    match desk.check_owner(attached_secret(&query).as_ref()) {
        Ok(()) => enqueued(desk, desk.mailbox.push_urgent(Order::Control(query))),
        Err(error) => {
            desk.shared.give(Job::Refused(query, error));
        }
    }
}

fn order(desk: &Arc<Desk>, order: Order) {
    desk.shared.metrics.asked(match order {
        Order::Control(_) => Asked::Control,
        Order::Settings(_) => Asked::Settings,
        Order::Target(..) => Asked::Target,
        Order::State(_) => Asked::State,
    });
    enqueued(desk, desk.mailbox.push_order(order));
}

fn enqueued(desk: &Arc<Desk>, pushed: Result<(), Order>) {
    match pushed {
        Ok(()) => desk.shared.pool.schedule(desk),
        Err(order) => {
            let busy = ErrorReply::new(ErrorCode::Quota, "too many requests wait for this task; ask again");
            desk.shared.give(Job::Refused(order.into_query(), busy));
        }
    }
}

fn request_twist(desk: &Arc<Desk>, query: Query) {
    let shared: &Shared = &desk.shared;
    let received = shared.now();
    lock(&desk.board).frame_arrived(received);
    let size = query.payload().map_or(0, zenoh::bytes::ZBytes::len);
    shared.metrics.asked(Asked::Twist);
    shared.metrics.received(Route::Requested, size);
    let refused = match size {
        size if size > shared.config.limits.bytes_per_payload => Some((query, Status::BadFrame)),
        size => {
            let full = desk.mailbox.push_request(TwistRequest { query, received }, size);
            full.err().map(|request| (request.query, Status::Overloaded))
        }
    };
    match refused {
        None => shared.pool.schedule(desk),
        Some((query, status)) => {
            shared.give(Job::TwistRefused(Arc::clone(desk), query, status));
        }
    }
}

fn push_frame(desk: &Arc<Desk>, sample: &Sample) {
    let shared: &Shared = &desk.shared;
    let received = shared.now();
    let frame = PushedFrame {
        attachment: sample.attachment().cloned(),
        encoding: sample.encoding().clone(),
        payload: sample.payload().clone(),
        received,
    };
    shared.metrics.received(Route::Pushed, sample.payload().len());
    let passed_over = desk.mailbox.put_frame(frame).is_some();
    if passed_over {
        shared.metrics.dropped(Dropped::Superseded);
    }
    let mut board = lock(&desk.board);
    board.frame_arrived(received);
    board.dropped().superseded += u64::from(passed_over);
    drop(board);
    shared.pool.schedule(desk);
}

fn log_failure(result: zenoh::Result<()>) {
    if let Err(error) = result {
        tracing::debug!(%error, "a publication could not be sent");
    }
}
