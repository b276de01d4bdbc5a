//! What a task lets in: the callbacks of its keys. They run one after another on the session's receive path, so each only looks
//! at the secret and the client's account, puts what came into the mailbox, and wakes the pool.
//!
//! Who does not show the secret costs the owner nothing: neither room in a queue nor a message of its rate.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use domvs_proto::body::MAX_JSON_BYTES;
use domvs_proto::frame::{FLAG_SECRET, FrameError, FrameHeader, HEADER_AND_SECRET_BYTES, HEADER_BYTES, Secret};
use domvs_proto::messages::{Control, ErrorCode, ErrorReply};
use domvs_proto::status::Status;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;
use zenoh::sample::Sample;

use crate::Moment;
use crate::answers::read_json;
use crate::clerk::{Asker, Note};
use crate::desk::{Desk, Order, PushedFrame, TwistRequest, Waiting, lock};
use crate::metrics::{Asked, Dropped};
use crate::orders::attached_secret;
use crate::payload::header_of;
use crate::task::Route;
use crate::tenants::{Doing, Held};

/// A control word is a few bytes; whatever is longer is no stop.
const LONGEST_STOP: usize = 256;

/// A stop is always let in: only the owner's words are, they have a queue of their own, no rate holds a stop back, and where others fill
/// the queue it is not queued, but halts the task as a stop for all does.
pub(crate) fn control(desk: &Arc<Desk>, query: Query) {
    desk.shared.metrics.asked(Asked::Control);
    let received = desk.shared.now();
    if let Err(error) = desk.check_owner(attached_secret(&query).as_ref()) {
        return refuse(desk, Asker::Stranger, query, error);
    }
    match desk.tenant.may(Doing::Control, received) {
        Err(error) if !is_stop(&query) => refuse(desk, Asker::Owner, query, ErrorReply::new(ErrorCode::Quota, error)),
        _ => enqueue(desk, Order::Control(query, received)),
    }
}

pub(crate) fn settings(desk: &Arc<Desk>, query: Query) {
    desk.shared.metrics.asked(Asked::Settings);
    match desk.check_owner(attached_secret(&query).as_ref()) {
        Ok(()) => order(desk, Order::Settings(query)),
        Err(error) => refuse(desk, Asker::Stranger, query, error),
    }
}

pub(crate) fn target(desk: &Arc<Desk>, query: Query) {
    desk.shared.metrics.asked(Asked::Target);
    let received = desk.shared.now();
    match check_target(desk, &query) {
        Ok(()) => order(desk, Order::Target(query, received)),
        Err((asker, error)) => refuse(desk, asker, query, error),
    }
}

/// Anybody may ask, so it is not the client's account that this is charged to.
pub(crate) fn state(desk: &Arc<Desk>, query: Query) {
    desk.shared.metrics.asked(Asked::State);
    let may = lock(&desk.public).take(desk.shared.now());
    if !may {
        let error = "the state of this task is asked for too often; ask again";
        return refuse(desk, Asker::Stranger, query, ErrorReply::new(ErrorCode::Quota, error));
    }
    enqueue(desk, Order::State(query));
}

pub(crate) fn request_twist(desk: &Arc<Desk>, query: Query) {
    let (shared, received) = (&desk.shared, desk.shared.now());
    let size = query.payload().map_or(0, ZBytes::len);
    shared.metrics.asked(Asked::Twist);
    shared.metrics.received(Route::Requested, size);
    match secret_of_frame(query.attachment()) {
        // Nothing in it can be trusted, not even whose it is: it changes nothing of the task.
        Unreadable => return refuse_twist(desk, Asker::Stranger, query, Status::BadFrame),
        Shown(secret) => {
            if let Err(error) = desk.check_owner(secret.as_ref()) {
                shared.metrics.dropped(Dropped::NotOwner);
                return refuse(desk, Asker::Stranger, query, error);
            }
        }
    }
    lock(&desk.board).frame_arrived(received);
    if size > shared.config.limits.bytes_per_payload {
        return refuse_twist(desk, Asker::Owner, query, Status::BadFrame);
    }
    let held = hold_frame(desk, received, size + query.attachment().map_or(0, ZBytes::len));
    let Ok(held) = held else {
        return refuse_twist(desk, Asker::Owner, query, Status::Overloaded);
    };
    match desk.mailbox.push_request(Waiting { message: TwistRequest { query, received }, held }, size) {
        Ok(()) => shared.pool.schedule(desk),
        Err(full) => refuse_twist(desk, Asker::Owner, full.message.query, Status::Overloaded),
    }
}

pub(crate) fn push_frame(desk: &Arc<Desk>, sample: &Sample) {
    let (metrics, received, size) = (&desk.shared.metrics, desk.shared.now(), sample.payload().len());
    metrics.received(Route::Pushed, size);
    let header = header_of(sample.attachment()).ok();
    if desk.frames_need_secret.load(Ordering::Acquire) && !shows_secret(desk, header.as_ref()) {
        metrics.dropped(Dropped::NotOwner);
        lock(&desk.board).dropped().not_owner += 1;
        return;
    }
    let held = hold_frame(desk, received, size + sample.attachment().map_or(0, ZBytes::len));
    let Ok(held) = held else {
        metrics.dropped(Dropped::Quota);
        let mut board = lock(&desk.board);
        board.frame_arrived(received);
        board.dropped().overloaded += 1;
        return;
    };
    let frame = PushedFrame {
        attachment: sample.attachment().cloned(),
        encoding: sample.encoding().clone(),
        payload: sample.payload().clone(),
        received,
        taken: header.map_or([0; 2], |header| [header.capture_time_ns, header.sequence]),
    };
    // Without a capture time on either, the sequence says which is the newer one.
    let ([captured, sequence], waiting) = (frame.taken, Waiting { message: frame, held });
    let was_taken_later = |before: &Waiting<PushedFrame>| match before.message.taken {
        [0, before] => captured == 0 && sequence != 0 && before > sequence,
        [before, _] => captured != 0 && before > captured,
    };
    let passed_over = desk.mailbox.put_frame(waiting, was_taken_later).is_some();
    metrics.dropped_many(Dropped::Superseded, usize::from(passed_over));
    let mut board = lock(&desk.board);
    board.frame_arrived(received);
    board.dropped().superseded += u64::from(passed_over);
    drop(board);
    desk.shared.pool.schedule(desk);
}

/// Room for a frame of so many bytes in the client's account, within its rate.
fn hold_frame(desk: &Desk, received: Moment, bytes: usize) -> Result<Held, String> {
    desk.tenant.may(Doing::Frame, received)?;
    desk.tenant.hold_message(bytes)
}

/// What an attachment says of its sender.
enum OfFrame {
    /// It is a header; the secret in it, if there is one.
    Shown(Option<Secret>),
    /// It is none.
    Unreadable,
}
use OfFrame::{Shown, Unreadable};

/// The secret in a frame's attachment, also of a header that is wrong in some other way: its owner is told so.
fn secret_of_frame(attachment: Option<&ZBytes>) -> OfFrame {
    match header_of(attachment) {
        Ok(header) => Shown(header.secret),
        Err(_) => {
            let short = attachment.filter(|attachment| attachment.len() <= HEADER_AND_SECRET_BYTES);
            let bytes = short.map(ZBytes::to_bytes).unwrap_or_default();
            let flagged = bytes.get(3).is_some_and(|flags| flags & FLAG_SECRET != 0);
            let secret = bytes.get(HEADER_BYTES..).and_then(|bytes| Secret::try_from(bytes).ok());
            secret.filter(|_| flagged).map_or(Unreadable, |secret| Shown(Some(secret)))
        }
    }
}

fn shows_secret(desk: &Desk, header: Option<&FrameHeader>) -> bool {
    header.and_then(|header| header.secret.as_ref()).is_some_and(|secret| desk.takes_frames_of(secret))
}

/// Whether a target may be looked at; if not, why, and who is told so.
fn check_target(desk: &Desk, query: &Query) -> Result<(), (Asker, ErrorReply)> {
    let stranger = |error| (Asker::Stranger, error);
    if query.payload().is_none_or(ZBytes::is_empty) {
        return desk.check_owner(attached_secret(query).as_ref()).map_err(stranger);
    }
    let header = header_of(query.attachment()).map_err(|error| {
        let wrong_version = matches!(error, FrameError::WrongVersion { .. });
        stranger(ErrorReply::new(if wrong_version { ErrorCode::WrongVersion } else { ErrorCode::BadTarget }, error))
    })?;
    desk.check_owner(header.secret.as_ref()).map_err(stranger)?;
    desk.check_bytes(query.payload()).map_err(|error| (Asker::Owner, ErrorReply::new(ErrorCode::TooLarge, error)))
}

/// An order of the owner's, within the rate of its client.
fn order(desk: &Arc<Desk>, order: Order) {
    let received: Moment = desk.shared.now();
    if let Err(error) = desk.tenant.may(Doing::Order, received) {
        return refuse(desk, Asker::Owner, order.into_query(), ErrorReply::new(ErrorCode::Quota, error));
    }
    enqueue(desk, order);
}

fn enqueue(desk: &Arc<Desk>, order: Order) {
    let bytes = order.query().payload().map_or(0, ZBytes::len);
    if bytes > MAX_JSON_BYTES && !matches!(order, Order::Target(..)) {
        let error = format!("a body may have {MAX_JSON_BYTES} bytes, got {bytes}");
        return refuse(desk, Asker::Owner, order.into_query(), ErrorReply::new(ErrorCode::TooLarge, error));
    }
    // What is small and has a queue of its own takes nothing of the account, so that a full account holds back no stop.
    let held = match order {
        Order::Control(..) | Order::State(_) => desk.tenant.hold_bytes(0),
        Order::Settings(_) | Order::Target(..) => desk.tenant.hold_message(bytes),
    };
    let held = match held {
        Ok(held) => held,
        Err(error) => {
            return refuse(desk, Asker::Owner, order.into_query(), ErrorReply::new(ErrorCode::Quota, error));
        }
    };
    let waiting = Waiting { message: order, held };
    let pushed = match waiting.message {
        Order::Control(..) => desk.mailbox.push_urgent(waiting),
        Order::State(_) => desk.mailbox.push_question(waiting),
        Order::Settings(_) | Order::Target(..) => desk.mailbox.push_order(waiting),
    };
    match pushed {
        Ok(()) => desk.shared.pool.schedule(desk),
        Err(Waiting { message: Order::Control(query, _), .. }) if is_stop(&query) && reads_as_stop(&query) => {
            desk.request_halt(Status::Stopped);
            desk.shared.pool.schedule(desk);
            desk.shared.note(Asker::Owner, Note::Stopped(Arc::clone(desk), query));
        }
        Err(full) => {
            let depth = desk.shared.config.mailbox_depth;
            let error = format!("{depth} requests of this kind may wait for a task, and do; ask again");
            refuse(desk, Asker::Owner, full.message.into_query(), ErrorReply::new(ErrorCode::Quota, error));
        }
    }
}

/// Whether this is a stop, as far as a look tells; whatever it is, it is read in its turn.
fn is_stop(query: &Query) -> bool {
    query
        .payload()
        .filter(|payload| payload.len() <= LONGEST_STOP)
        .is_some_and(|payload| payload.to_bytes().windows(4).any(|word| word == b"stop"))
}

fn reads_as_stop(query: &Query) -> bool {
    matches!(read_json(query), Ok(Control::Stop))
}

fn refuse(desk: &Desk, asker: Asker, query: Query, error: ErrorReply) {
    desk.shared.note(asker, Note::Refused(query, error));
}

fn refuse_twist(desk: &Arc<Desk>, asker: Asker, query: Query, status: Status) {
    desk.shared.note(asker, Note::TwistRefused(Arc::clone(desk), query, status));
}
