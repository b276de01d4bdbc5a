//! What happens when nothing comes: the watchdog's zeros, repeated zeros, repeated status, leases and idle tasks.
//!
//! One thread looks at every task each few milliseconds. It never computes and never waits for a computation.
//! It also notices when the whole process stood still, and throws away what was queued meanwhile.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, SystemTime};

use domvs_proto::body;
use domvs_proto::status::Status;

use crate::Moment;
use crate::clerk::{Asker, Note};
use crate::desk::{Desk, lock};
use crate::metrics::{Dropped, Event};
use crate::pause::{Clocks, Pause, TICK};
use crate::registrar::Job;
use crate::worker::Shared;

/// A task without a frame for this long is not said to be servoing any more, even if it only answers requests.
const QUIET: Duration = Duration::from_secs(2);
/// A client whose token has not arrived this long after its task was created, or given this token, counts as gone.
pub const TOKEN_GRACE: Duration = Duration::from_secs(2);

/// Looks after every task until `closing` is dropped.
pub(crate) fn run(shared: &Arc<Shared>, closing: &Receiver<()>) {
    let mut clocks = Clocks::new(shared.now(), SystemTime::now());
    let mut load = LoadMeter::default();
    while closing.recv_timeout(TICK) == Err(RecvTimeoutError::Timeout) {
        let now = shared.now();
        let pause = clocks.look(now, SystemTime::now());
        shared.clock_looks(now);
        load.measure(shared, now);
        for desk in shared.desks() {
            look_after(&desk, pause, now);
        }
    }
}

fn look_after(desk: &Arc<Desk>, pause: Pause, now: Moment) {
    throw_away_after_pause(desk, pause, now);
    let leased = !desk.closing.load(Ordering::Acquire) && watch_client(desk, now);
    obey_halt(desk, now);
    let status = match lock(&desk.board).status() {
        Status::Servoing => Status::WaitingFrame,
        status => status,
    };
    // Published without the board, which callbacks need.
    let braked = lock(&desk.outlet).tick(status, now);
    if braked.is_some() {
        desk.shared.metrics.happened(Event::WatchdogBrake);
    }
    let mut board = lock(&desk.board);
    let quiet = now.saturating_sub(board.last_frame()) > QUIET;
    if board.status() == Status::Servoing && (braked.is_some() || quiet) {
        board.say(Status::WaitingFrame, Some("no frame came within the watchdog time"));
    }
    let idle_close = Duration::from_secs(u64::from(desk.idle_close_s.load(Ordering::Acquire)));
    if !leased && now.saturating_sub(board.last_used()) > idle_close {
        desk.closing.store(true, Ordering::Release);
    }
    let mut message = board.due(now);
    if let Some(message) = message.as_mut().filter(|message| message.detail.is_none()) {
        let error = desk.shared.states.as_ref().and_then(|states| states.error());
        message.detail = error.map(|error| format!("the task is not saved for a restart: {error}"));
    }
    let news = board.news_due(now);
    drop(board);
    if let Some(news) = news {
        desk.publish_progress(news);
    }
    if let Some(message) = message {
        let json = body::write(&message);
        desk.publications.status(&json);
        if let Some(recorder) = &desk.shared.recorder {
            let text = String::from_utf8_lossy(&json).into_owned();
            recorder.status(&desk.shared.keys.status(&desk.key), desk.shared.wall_ns(now), text);
        }
    }
    if desk.closing.load(Ordering::Acquire) && !desk.close_given.load(Ordering::Acquire) {
        desk.close_given.store(desk.shared.give(Job::Close(desk.key.clone())), Ordering::Release);
    }
}

/// Brakes on `command` at once; the pool latches the task before it does anything else.
fn obey_halt(desk: &Arc<Desk>, now: Moment) {
    // Held while the outlet is halted, so a `start` that has obeyed this halt already is not overruled.
    let halt = lock(&desk.halt);
    let Some(status) = *halt else { return };
    let mut outlet = lock(&desk.outlet);
    if !outlet.is_halted() {
        outlet.halt(Some(status), now);
    }
    drop(outlet);
    drop(halt);
    desk.shared.pool.schedule(desk);
}

/// Returns whether the task hangs on a token at all.
fn watch_client(desk: &Arc<Desk>, now: Moment) -> bool {
    let mut lease = lock(&desk.lease_watch);
    let Some(present) = lock(&desk.lease).is_present() else {
        lease.gone_since = None;
        return false;
    };
    lease.seen |= present;
    // A client that comes back must take its task up again, or it is closed all the same: see `Desk::control`.
    if lease.gone_since.is_none() && (present || !lease.seen && now.saturating_sub(lease.chosen) < TOKEN_GRACE) {
        return true;
    }
    match lease.gone_since {
        None => {
            lease.gone_since = Some(now);
            desk.shared.metrics.happened(Event::ClientLost);
            tracing::warn!(task = %desk.key, client = %desk.key.client, "the client's token is gone");
            desk.request_halt(Status::ClientLost);
        }
        Some(since) if now.saturating_sub(since) > desk.shared.config.lease.grace() => {
            desk.closing.store(true, Ordering::Release);
        }
        Some(_) => {}
    }
    true
}

/// A process that was stopped, or starved, finds old frames in its queues. They tell nothing about now.
fn throw_away_after_pause(desk: &Arc<Desk>, pause: Pause, now: Moment) {
    if !lock(&desk.outlet).wake(pause, now) {
        return;
    }
    desk.shared.metrics.happened(Event::StoodStill);
    let (task, pause_ms) = (&desk.key, pause.length.as_millis());
    tracing::warn!(%task, client = %task.client, pause_ms, "the worker stood still; what waited is thrown away");
    let (requests, frame) = desk.mailbox.discard_images();
    if frame.is_some() {
        desk.shared.metrics.dropped(Dropped::StoodStill);
    }
    lock(&desk.board).dropped().stale += requests.len() as u64 + u64::from(frame.is_some());
    for request in requests {
        let note = Note::TwistRefused(Arc::clone(desk), request.message.query, Status::StaleFrame);
        desk.shared.note(Asker::Owner, note);
    }
}

/// Share of the compute threads' time that was spent computing, over the last second.
#[derive(Default)]
struct LoadMeter {
    since: Moment,
    busy: Duration,
}

impl LoadMeter {
    fn measure(&mut self, shared: &Shared, now: Moment) {
        let interval = now.saturating_sub(self.since);
        if interval < Duration::from_secs(1) {
            return;
        }
        let busy = shared.busy();
        let capacity = interval.as_secs_f64() * shared.config.compute_threads() as f64;
        shared.say_left_out(now);
        shared.set_load(busy.saturating_sub(self.busy).as_secs_f64() / capacity);
        (self.since, self.busy) = (now, busy);
    }
}
