//! What a desk does with an order: control, settings, target, state. The secret was looked at before it was let in, in `door`.

use std::sync::atomic::Ordering;

use domvs_proto::body;
use domvs_proto::frame::Secret;
use domvs_proto::keys::Leaf;
use domvs_proto::messages::{
    Control, ControlReply, ErrorCode, ErrorReply, TargetReference, TaskClosed, TaskProgress, TaskState,
};
use domvs_proto::settings::TaskSettings;
use domvs_proto::status::Status;
use serde_json::Value;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::Moment;
use crate::answers::{log_failure, read_json, reply_json};
use crate::board::{Board, News};
use crate::control::{moves, obey};
use crate::desk::{Desk, Order, lock};
use crate::law::{acceleration_limits, speed_limits};
use crate::payload::{Payload, header_of};
use crate::replica::TARGET;
use crate::task::{Frame, Route, SentTarget, Task};
use crate::tenants::Held;

impl Desk {
    /// `held` is what the order takes of its client's account until it is done with; a target keeps its bytes.
    pub(crate) fn obey(&self, order: Order, held: Held) {
        if !matches!(order, Order::State(_)) {
            // Anybody may ask for the state: that is no sign of the owner's.
            lock(&self.board).used(self.shared.now());
        }
        match order {
            Order::Control(query, received) => {
                self.answer(&query, Leaf::Control, |desk| desk.control(&query, received));
            }
            Order::Settings(query) => self.answer(&query, Leaf::Settings, |desk| desk.settings(&query)),
            Order::Target(query, _) if query.payload().is_none_or(ZBytes::is_empty) => self.answer_target(&query),
            Order::Target(query, received) => {
                self.answer(&query, Leaf::Target, |desk| desk.set_target(&query, received, held.settled()));
            }
            Order::State(query) if query.parameters().contains_key(TARGET) => self.answer_state_target(&query),
            Order::State(query) => {
                self.answer(&query, Leaf::State, |desk| Ok(body::write(&desk.state(&lock(&desk.task)))));
            }
        }
    }

    /// Runs an order and replies with its JSON or its error; a panic in it ends the task, not the worker.
    fn answer(&self, query: &Query, leaf: Leaf, order: impl FnOnce(&Desk) -> Result<Vec<u8>, ErrorReply>) {
        let outcome = self.guarded(|| order(self));
        let outcome = outcome
            .unwrap_or_else(|| Err(ErrorReply::new(ErrorCode::Internal, "the task failed; see the worker's log")));
        match outcome {
            Ok(json) => reply_json(query, self.shared.keys.task(&self.key, leaf), &json),
            Err(error) => self.shared.refuse(query, &error),
        }
    }

    /// The secret was looked at before this was let in.
    fn control(&self, query: &Query, received: Moment) -> Result<Vec<u8>, ErrorReply> {
        let control: Control = read_json(query)?;
        let moves = moves(control);
        if moves && self.is_without_client() {
            return Ok(body::write(&ControlReply { status: Status::ClientLost }));
        }
        let mut task = lock(&self.task);
        if moves && !task.is_running() && received <= *lock(&self.halt_asked) {
            tracing::warn!(task = %self.key, client = %self.key.client, ?control, "came before the halt that it would lift; nothing changes");
            return Ok(body::write(&ControlReply { status: task.status() }));
        }
        let mut outlet = lock(&self.outlet);
        // Whoever closes says so before it halts the outlet for good, so nothing lifts that halt.
        if self.closing.load(Ordering::Acquire) {
            return Err(ErrorReply::new(ErrorCode::Closed, format!("task {} is being closed", self.key)));
        }
        if self.leaving.load(Ordering::Acquire) || self.superseded.load(Ordering::Acquire) {
            let error = format!("another worker takes task {} over; ask again", self.key);
            return Err(ErrorReply::new(ErrorCode::Superseded, error));
        }
        let Some(status) = obey(&mut task, &mut outlet, control, received, self.shared.now())? else {
            tracing::warn!(task = %self.key, client = %self.key.client, ?control, "may have waited while the worker stood still; nothing changes");
            return Ok(body::write(&ControlReply { status: task.status() }));
        };
        drop(outlet);
        if control == Control::Close {
            self.closing.store(true, Ordering::Release);
        }
        if moves {
            // The client is there: its task is wanted again.
            lock(&self.lease_watch).gone_since = None;
        }
        tracing::info!(task = %self.key, client = %self.key.client, ?control, %status, "control");
        self.said(&task, task.status())
    }

    /// The client's token has gone and is not back: nothing may move before it is.
    fn is_without_client(&self) -> bool {
        lock(&self.lease_watch).gone_since.is_some() && lock(&self.lease).is_present() == Some(false)
    }

    fn settings(&self, query: &Query) -> Result<Vec<u8>, ErrorReply> {
        let mut task = lock(&self.task);
        if query.payload().is_none_or(ZBytes::is_empty) {
            return Ok(body::write(task.settings()));
        }
        let json = body::write(self.change_settings(&mut task, &read_json(query)?)?);
        self.settings_changed(&task);
        self.publish_state(&task);
        Ok(json)
    }

    /// Changes the settings within the client's quotas. On an error nothing changes.
    fn change_settings<'t>(&self, task: &'t mut Task, patch: &Value) -> Result<&'t TaskSettings, ErrorReply> {
        let next = task.settings().merge_patch(patch).map_err(|error| ErrorReply::from(&error))?;
        let pixels = self.shared.resize(self, &next)?;
        let new_lease = (next.lease != task.settings().lease).then_some(next.lease);
        // All that can fail comes before anything changes.
        let watched = new_lease.map(|lease| self.lease_of(&lease)).transpose();
        let changed = watched
            .map_err(|error| ErrorReply::new(ErrorCode::Internal, error))
            .and_then(|watched| Ok((task.change_settings(patch)?, watched)));
        let (changed, watched) = changed.inspect_err(|_| self.pixels.store(pixels, Ordering::Release))?;
        if let Some(watched) = watched {
            self.hang_on(watched);
        }
        Ok(changed)
    }

    /// Puts the zeros, the limits and the words of the present settings everywhere they are used.
    fn settings_changed(&self, task: &Task) {
        let settings = task.settings();
        let period = std::time::Duration::from_secs_f64(settings.frame_period_s);
        self.idle_close_s.store(settings.idle_close_s, Ordering::Release);
        self.frames_need_secret.store(settings.frame_secret, Ordering::Release);
        let mut outlet = lock(&self.outlet);
        outlet.governor_mut().reconfigure(acceleration_limits(settings), task.watchdog(), period);
        outlet.governor_mut().confine(speed_limits(settings), settings.degrees_of_freedom);
        drop(outlet);
        if let Some(recorder) = &self.shared.recorder {
            let json = String::from_utf8_lossy(&body::write(settings)).into_owned();
            recorder.settings(&self.shared.keys.settings(&self.key), self.shared.wall_ns(self.shared.now()), json);
        }
    }

    fn set_target(&self, query: &Query, received: Moment, held: Held) -> Result<Vec<u8>, ErrorReply> {
        // Whoever let it in has read it once.
        let header = header_of(query.attachment()).map_err(|error| ErrorReply::new(ErrorCode::BadTarget, error))?;
        let payload = query.payload().map_or(Payload::Whole(&[]), Payload::from);
        let encoding = query.encoding().map(ToString::to_string).unwrap_or_default();
        let frame = Frame { header: &header, encoding: &encoding, payload, received, route: Route::Requested };
        let mut task = lock(&self.task);
        let status = task.set_target(&frame)?;
        *lock(&self.target_bytes) = Some(held);
        if let Some(recorder) = &self.shared.recorder {
            let key = self.shared.keys.target(&self.key);
            recorder.target(
                &key,
                self.shared.wall_ns(received),
                &header.encode(),
                &encoding,
                query.payload().cloned().unwrap_or_default(),
            );
        }
        let size = task.target().map(|sent| sent.size);
        let sequence = header.sequence;
        tracing::info!(task = %self.key, client = %self.key.client, sequence, ?size, %status, "target set");
        let said = self.said(&task, status);
        if let Some(sent) = task.target() {
            // After the state that names it: standbys keep no other.
            self.publications.target(sent);
        }
        said
    }

    fn answer_target(&self, query: &Query) {
        let no_target = || ErrorReply::new(ErrorCode::NoTarget, "no target is set");
        let sent = lock(&self.task).target().cloned().ok_or_else(no_target);
        match sent {
            Ok(SentTarget { header, encoding, payload, .. }) => {
                let reply = query.reply(self.shared.keys.target(&self.key), payload).encoding(encoding.as_str());
                log_failure(reply.attachment(header.encode()).wait());
            }
            Err(error) => self.shared.refuse(query, &error),
        }
    }

    /// A standby asks for the target itself.
    fn answer_state_target(&self, query: &Query) {
        match lock(&self.task).target().cloned() {
            Some(SentTarget { header, encoding, payload, .. }) => {
                let reply = query.reply(self.shared.keys.state(&self.key), payload).encoding(encoding.as_str());
                log_failure(reply.attachment(header.encode()).wait());
            }
            None => self.shared.refuse(query, &ErrorReply::new(ErrorCode::NoTarget, "no target is set")),
        }
    }

    fn said(&self, task: &Task, status: Status) -> Result<Vec<u8>, ErrorReply> {
        lock(&self.board).say(status, None);
        self.publish_state(task);
        Ok(body::write(&ControlReply { status }))
    }

    pub(crate) fn state(&self, task: &Task) -> TaskState {
        self.state_by(&mut lock(&self.board), task)
    }

    fn state_by(&self, board: &mut Board, task: &Task) -> TaskState {
        let progress = task.progress(board.status());
        board.advanced(progress);
        TaskState {
            task: self.key.clone(),
            worker: self.shared.worker.clone(),
            epoch: self.epoch,
            revision: board.revision(),
            secret_hash: self.secret.hash(),
            frame_secret_hash: self.frame_secret.hash(),
            settings: task.settings().clone(),
            target: task.target().map(|sent| TargetReference {
                hash: sent.hash().to_owned(),
                width: sent.size[0] as u32,
                height: sent.size[1] as u32,
                payload_bytes: sent.payload.len() as u64,
            }),
            progress: board.progress().unwrap_or(progress),
        }
    }

    pub(crate) fn publish_state(&self, task: &Task) {
        let mut board = lock(&self.board);
        board.revise();
        let state = self.state_by(&mut board, task);
        drop(board);
        self.publications.state(body::write(&state));
        self.keep(task);
    }

    /// Saves the task, if there is a state directory.
    pub(crate) fn keep(&self, task: &Task) {
        let ours = !self.closing.load(Ordering::Acquire) && !self.superseded.load(Ordering::Acquire);
        if let Some(states) = self.shared.states.as_ref().filter(|_| ours) {
            states.save(self.state(task), task.target().cloned());
        }
    }

    /// The small part of the state.
    pub(crate) fn publish_progress(&self, News { revision, progress }: News) {
        let (task, worker) = (self.key.clone(), self.shared.worker.clone());
        self.publications.state(body::write(&TaskProgress { task, worker, epoch: self.epoch, revision, progress }));
    }

    /// The last word: nobody takes this task over.
    pub(crate) fn publish_end(&self) {
        let (task, worker) = (self.key.clone(), self.shared.worker.clone());
        self.publications.state(body::write(&TaskClosed { task, worker, epoch: self.epoch, closed: true }));
    }

    /// Tells the recorder about the settings, and the target if there is one, that a task begins with here, and the standbys about the task.
    pub(crate) fn created(&self) {
        let task = lock(&self.task);
        self.settings_changed(&task);
        if let (Some(recorder), Some(sent)) = (&self.shared.recorder, task.target()) {
            let (key, now) = (self.shared.keys.target(&self.key), self.shared.wall_ns(self.shared.now()));
            recorder.target(&key, now, &sent.header.encode(), &sent.encoding, sent.payload.clone().into());
        }
        self.publish_state(&task);
    }
}

pub(crate) fn attached_secret(query: &Query) -> Option<Secret> {
    // Whatever is longer is not put together.
    let bytes = query.attachment().filter(|attachment| attachment.len() == Secret::BYTES)?.to_bytes();
    <[u8; Secret::BYTES]>::try_from(&*bytes).ok().map(Secret::new)
}
