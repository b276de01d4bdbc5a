//! Where one task's work is done: the compute pool takes an order, a request or a frame from the mailbox, makes
//! one plain call into the task, and answers. A refusal is an answer too: nobody waits for silence.

use std::any::Any;
use std::borrow::Cow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use domvs_proto::body;
use domvs_proto::frame::{FrameError, FrameHeader, Secret};
use domvs_proto::keys::{Leaf, TaskKey};
use domvs_proto::messages::{Control, ControlReply, ErrorCode, ErrorReply, TargetReference, TaskState};
use domvs_proto::settings::Lease;
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_ENCODING, TwistMessage};
use domvs_vision::Twist;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::Moment;
use crate::board::Board;
use crate::endpoints::Publications;
use crate::law::acceleration_limits;
use crate::mailbox::{Item, Mailbox};
use crate::outlet::{Outlet, refused};
use crate::pipeline::{is_past_deadline, on_frame};
use crate::pool::Work;
use crate::task::{Frame, Route, SentTarget, Task};
use crate::worker::Shared;

/// Something a client wants of a task, other than a twist.
pub(crate) enum Order {
    /// `control`.
    Control(Query),
    /// `settings`: get or change.
    Settings(Query),
    /// `target`: get or set.
    Target(Query, Moment),
    /// `state`.
    State(Query),
}

/// A request on `twist`.
pub(crate) struct TwistRequest {
    pub(crate) query: Query,
    pub(crate) received: Moment,
}

/// A frame that a camera has published.
pub(crate) struct PushedFrame {
    pub(crate) attachment: Option<ZBytes>,
    pub(crate) encoding: String,
    pub(crate) payload: ZBytes,
    pub(crate) received: Moment,
}

/// What is known of the client's liveliness token.
#[derive(Debug, Default)]
pub(crate) struct LeaseWatch {
    /// It has been there.
    pub(crate) seen: bool,
    /// It is not there now, and since when.
    pub(crate) gone_since: Option<Moment>,
}

/// One task with everything that waits for it.
pub(crate) struct Desk {
    pub(crate) key: TaskKey,
    pub(crate) epoch: u32,
    pub(crate) secret: Secret,
    pub(crate) born: Moment,
    pub(crate) shared: Arc<Shared>,
    pub(crate) publications: Publications,
    pub(crate) mailbox: Mailbox<Order, TwistRequest, PushedFrame>,
    pub(crate) task: Mutex<Task>,
    pub(crate) outlet: Mutex<Outlet>,
    pub(crate) board: Mutex<Board>,
    /// The client's token, as the clock sees it.
    pub(crate) lease_watch: Mutex<LeaseWatch>,
    /// Of the settings: what the clock needs without waiting for the task, which the pool may hold.
    pub(crate) lease: Lease,
    /// The same; changes with the settings.
    pub(crate) idle_close_s: AtomicU32,
    /// A status to latch before anything else is done; set by callbacks and the clock.
    pub(crate) halt: Mutex<Option<Status>>,
    /// The client, or nobody's using it, asked for the end.
    pub(crate) closing: AtomicBool,
    pub(crate) scheduled: AtomicBool,
}

impl Work for Desk {
    fn run_one(&self) {
        let begin = self.shared.now();
        self.obey_halt();
        match self.mailbox.take() {
            Some(Item::Order(order)) => self.obey(order),
            Some(Item::Request(request)) => self.answer_twist(&request),
            Some(Item::Frame(frame)) => self.follow_frame(&frame),
            None => {}
        }
        self.shared.add_busy(self.shared.now().saturating_sub(begin));
    }

    fn has_work(&self) -> bool {
        self.mailbox.has_items() || lock(&self.halt).is_some()
    }

    fn scheduled(&self) -> &AtomicBool {
        &self.scheduled
    }
}

impl Desk {
    /// Asks for a latched halt: takes effect on `command` at the clock's next look, and before the next frame.
    pub(crate) fn request_halt(&self, status: Status) {
        lock(&self.halt).get_or_insert(status);
    }

    /// Answers a twist request that nobody will compute.
    pub(crate) fn refuse_twist(&self, query: &Query, status: Status) {
        let header = header_of(query.attachment()).unwrap_or_else(|_| unreadable_header());
        let mut answer = TwistMessage::zero(status);
        (answer.sequence, answer.capture_time_ns) = (header.sequence, header.capture_time_ns);
        if status == Status::Overloaded {
            lock(&self.board).dropped().overloaded += 1;
        }
        self.reply_twist(query, answer);
    }

    /// The last words of a worker that ends, after its zeros: `owner_lost`, and an answer to every request that waits.
    pub(crate) fn part(&self, now: Moment) {
        let (requests, _) = self.mailbox.discard_images();
        requests.iter().for_each(|request| self.refuse_twist(&request.query, Status::OwnerLost));
        let mut board = lock(&self.board);
        board.say(Status::OwnerLost, None);
        if let Some(message) = board.due(now) {
            self.publications.status(&body::write(&message));
        }
    }

    /// Puts the zeros, the limits and the words of the present settings everywhere they are used.
    fn settings_changed(&self, task: &Task) {
        let settings = task.settings();
        let period = std::time::Duration::from_secs_f64(settings.frame_period_s);
        self.idle_close_s.store(settings.idle_close_s, Ordering::Release);
        lock(&self.outlet).governor_mut().reconfigure(acceleration_limits(settings), task.watchdog(), period);
        if let Some(recorder) = &self.shared.recorder {
            let json = String::from_utf8_lossy(&body::write(settings)).into_owned();
            recorder.settings(&self.shared.keys.settings(&self.key), self.shared.wall_ns(self.shared.now()), json);
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

    fn obey(&self, order: Order) {
        lock(&self.board).used(self.shared.now());
        match order {
            Order::Control(query) => self.answer(&query, Leaf::Control, |desk| desk.control(&query)),
            Order::Settings(query) => self.answer(&query, Leaf::Settings, |desk| desk.settings(&query)),
            Order::Target(query, _) if query.payload().is_none_or(ZBytes::is_empty) => self.answer_target(&query),
            Order::Target(query, received) => {
                self.answer(&query, Leaf::Target, |desk| desk.set_target(&query, received));
            }
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
            Err(error) => reply_error(query, &error),
        }
    }

    fn control(&self, query: &Query) -> Result<Vec<u8>, ErrorReply> {
        self.check_owner(attached_secret(query).as_ref())?;
        let control: Control = read_json(query)?;
        if matches!(control, Control::Start | Control::Resume) && self.is_without_client() {
            return Ok(body::write(&ControlReply { status: Status::ClientLost }));
        }
        let mut task = lock(&self.task);
        let mut outlet = lock(&self.outlet);
        // Whoever closes says so before it halts the outlet for good, so nothing lifts that halt.
        if self.closing.load(Ordering::Acquire) {
            return Err(ErrorReply::new(ErrorCode::Closed, format!("task {} is being closed", self.key)));
        }
        let status = task.control(control)?;
        let now = self.shared.now();
        match control {
            Control::Start | Control::Resume => outlet.halt(None, now),
            Control::Pause | Control::Stop => outlet.brake(status, now),
            Control::Close => {
                outlet.halt(Some(Status::Stopped), now);
                task.latch(Status::Stopped);
                self.closing.store(true, Ordering::Release);
            }
        }
        drop(outlet);
        tracing::info!(task = %self.key, ?control, %status, "control");
        self.said(&task, task.status())
    }

    /// The client's token has gone and is not back: nothing may move before it is.
    fn is_without_client(&self) -> bool {
        lock(&self.lease_watch).gone_since.is_some() && !self.shared.client_is_alive(&self.key.client)
    }

    fn settings(&self, query: &Query) -> Result<Vec<u8>, ErrorReply> {
        self.check_owner(attached_secret(query).as_ref())?;
        let mut task = lock(&self.task);
        if query.payload().is_none_or(ZBytes::is_empty) {
            return Ok(body::write(task.settings()));
        }
        let json = body::write(task.change_settings(&read_json(query)?)?);
        self.settings_changed(&task);
        self.publish_state(&task);
        Ok(json)
    }

    fn set_target(&self, query: &Query, received: Moment) -> Result<Vec<u8>, ErrorReply> {
        let header = header_of(query.attachment()).map_err(|error| {
            let wrong_version = matches!(error, FrameError::WrongVersion { .. });
            ErrorReply::new(if wrong_version { ErrorCode::WrongVersion } else { ErrorCode::BadTarget }, error)
        })?;
        self.check_owner(header.secret.as_ref())?;
        self.check_bytes(query.payload()).map_err(|error| ErrorReply::new(ErrorCode::TooLarge, error))?;
        let payload = contiguous(query.payload());
        let encoding = query.encoding().map(ToString::to_string).unwrap_or_default();
        let frame =
            Frame { header: &header, encoding: &encoding, payload: &payload, received, route: Route::Requested };
        let mut task = lock(&self.task);
        let status = task.set_target(&frame)?;
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
        tracing::info!(task = %self.key, ?size, %status, "target set");
        self.said(&task, status)
    }

    fn answer_target(&self, query: &Query) {
        let sent = self.check_owner(attached_secret(query).as_ref()).and_then(|()| {
            let no_target = || ErrorReply::new(ErrorCode::NoTarget, "no target is set");
            lock(&self.task).target().cloned().ok_or_else(no_target)
        });
        match sent {
            Ok(SentTarget { header, encoding, payload, .. }) => {
                let reply = query.reply(self.shared.keys.target(&self.key), payload).encoding(encoding.as_str());
                log_failure(reply.attachment(header.encode()).wait());
            }
            Err(error) => reply_error(query, &error),
        }
    }

    fn answer_twist(&self, request: &TwistRequest) {
        let query = &request.query;
        let header = match header_of(query.attachment()) {
            Ok(header) => header,
            Err(error) => {
                let answer = self.refuse_frame(&lock(&self.task), Status::BadFrame, &error.to_string());
                return self.reply_twist(query, answer);
            }
        };
        if let Err(error) = self.check_owner(header.secret.as_ref()) {
            return reply_error(query, &error);
        }
        let payload = contiguous(query.payload());
        let encoding = query.encoding().map(ToString::to_string).unwrap_or_default();
        let frame = Frame {
            header: &header,
            encoding: &encoding,
            payload: &payload,
            received: request.received,
            route: Route::Requested,
        };
        let answer = self.compute(&mut lock(&self.task), &frame);
        let answer = if answer.is_servoing() { self.in_time(answer, request, &header) } else { answer };
        self.reply_twist(query, answer);
        self.record(&frame, query.payload(), &self.shared.keys.twist(&self.key), &answer);
    }

    /// Looks once more before motion is answered: the computation took time, and the world went on.
    fn in_time(&self, answer: TwistMessage, request: &TwistRequest, header: &FrameHeader) -> TwistMessage {
        if let Some(status) = *lock(&self.halt) {
            return refused(answer, status);
        }
        if !is_past_deadline(header.deadline_us, self.shared.now().saturating_sub(request.received)) {
            return answer;
        }
        let mut board = lock(&self.board);
        board.dropped().deadline += 1;
        board.say(Status::DeadlineMissed, Some("the computation ended after the deadline"));
        refused(answer, Status::DeadlineMissed)
    }

    fn follow_frame(&self, pushed: &PushedFrame) {
        let attachment = pushed.attachment.as_ref().map(ZBytes::to_bytes);
        let header = self
            .check_bytes(Some(&pushed.payload))
            .and_then(|()| FrameHeader::from_attachment(attachment.as_deref()).map_err(|error| error.to_string()));
        let payload = if header.is_ok() { pushed.payload.to_bytes() } else { Cow::Borrowed(&[][..]) };
        let mut task = lock(&self.task);
        let (header, answer) = match header {
            Ok(header) => {
                let frame = self.frame(pushed, &header, &payload);
                let answer = self.compute(&mut task, &frame);
                (header, answer)
            }
            Err(error) => (unreadable_header(), self.refuse_frame(&task, Status::BadFrame, &error)),
        };
        let sent = lock(&self.outlet).send(answer, pushed.received, self.shared.now());
        task.commanded(Twist::from_array(sent.twist));
        drop(task);
        if sent.status != answer.status {
            lock(&self.board).overruled(&sent);
        }
        let frame = self.frame(pushed, &header, &payload);
        self.record(&frame, Some(&pushed.payload), &self.shared.keys.command(&self.key), &sent);
    }

    fn frame<'a>(&self, pushed: &'a PushedFrame, header: &'a FrameHeader, payload: &'a [u8]) -> Frame<'a> {
        Frame { header, encoding: &pushed.encoding, payload, received: pushed.received, route: Route::Pushed }
    }

    /// Zeros for a frame that never gets to the pipeline. A task that stands says why it stands.
    fn refuse_frame(&self, task: &Task, status: Status, detail: &str) -> TwistMessage {
        let (status, detail) = if task.is_running() { (status, Some(detail)) } else { (task.status(), None) };
        let answer = TwistMessage { epoch: self.epoch, ..TwistMessage::zero(status) };
        lock(&self.board).answered(&answer, task.iterations(), detail);
        answer
    }

    fn check_bytes(&self, payload: Option<&ZBytes>) -> Result<(), String> {
        let (limit, got) = (self.shared.config.limits.bytes_per_payload, payload.map_or(0, ZBytes::len));
        if got <= limit { Ok(()) } else { Err(format!("a payload may have {limit} bytes, got {got}")) }
    }

    /// One frame through the pipeline, measured; a panic in it latches `internal`.
    fn compute(&self, task: &mut Task, frame: &Frame<'_>) -> TwistMessage {
        let begin = self.shared.now();
        let answer = self.guarded(|| on_frame(task, frame, begin));
        let mut answer = answer.unwrap_or_else(|| {
            task.latch(Status::Internal);
            TwistMessage { sequence: frame.header.sequence, ..TwistMessage::zero(Status::Internal) }
        });
        answer.epoch = self.epoch;
        answer.queue_us = micros(begin.saturating_sub(frame.received));
        answer.compute_us = micros(self.shared.now().saturating_sub(begin));
        lock(&self.board).answered(&answer, task.iterations(), task.detail());
        answer
    }

    fn guarded<T>(&self, work: impl FnOnce() -> T) -> Option<T> {
        // What a panic leaves half done belongs to this task alone, and a latched task does nothing with it.
        catch_unwind(AssertUnwindSafe(work))
            .map_err(|panic| {
                tracing::error!(task = %self.key, panic = panic_text(&*panic), "a panic ended the task");
                self.request_halt(Status::Internal);
            })
            .ok()
    }

    fn said(&self, task: &Task, status: Status) -> Result<Vec<u8>, ErrorReply> {
        lock(&self.board).say(status, None);
        self.publish_state(task);
        Ok(body::write(&ControlReply { status }))
    }

    fn state(&self, task: &Task) -> TaskState {
        TaskState {
            task: self.key.clone(),
            worker: self.shared.worker.clone(),
            epoch: self.epoch,
            settings: task.settings().clone(),
            target: task.target().map(|sent| TargetReference {
                hash: sent.hash(),
                width: sent.size[0] as u32,
                height: sent.size[1] as u32,
                payload_bytes: sent.payload.len() as u64,
            }),
            progress: task.progress(lock(&self.board).status()),
        }
    }

    pub(crate) fn publish_state(&self, task: &Task) {
        self.publications.state(body::write(&self.state(task)));
    }

    /// Tells the recorder about the settings a task was created with.
    pub(crate) fn created(&self) {
        self.settings_changed(&lock(&self.task));
    }

    fn record(&self, frame: &Frame<'_>, payload: Option<&ZBytes>, key: &str, answer: &TwistMessage) {
        let Some(recorder) = &self.shared.recorder else { return };
        let (received, now) = (self.shared.wall_ns(frame.received), self.shared.wall_ns(self.shared.now()));
        let frame_key = self.shared.keys.frame(&self.key);
        recorder.frame(
            &frame_key,
            received,
            &frame.header.encode(),
            frame.encoding,
            payload.cloned().unwrap_or_default(),
        );
        recorder.twist(key, now, answer.encode());
    }

    fn check_owner(&self, secret: Option<&Secret>) -> Result<(), ErrorReply> {
        match secret {
            Some(secret) if *secret == self.secret => Ok(()),
            Some(_) => Err(ErrorReply::new(ErrorCode::NotOwner, "the secret is not this task's")),
            None => Err(ErrorReply::new(ErrorCode::NotOwner, "the request carries no secret; create returned it")),
        }
    }

    fn reply_twist(&self, query: &Query, mut answer: TwistMessage) {
        answer.epoch = self.epoch;
        let key = self.shared.keys.twist(&self.key);
        let as_json = query.parameters().get("format") == Some("json");
        log_failure(if as_json {
            query.reply(key, answer.to_json()).encoding(body::JSON).wait()
        } else {
            query.reply(key, answer.encode()).encoding(TWIST_ENCODING).wait()
        });
    }
}

/// Replies on `key`, which is ours: the query's own may be a wildcard, and Zenoh keeps one answer per key.
pub(crate) fn reply_json(query: &Query, key: String, json: &[u8]) {
    log_failure(query.reply(key, json).encoding(body::JSON).wait());
}

/// Replies with an error body.
pub(crate) fn reply_error(query: &Query, error: &ErrorReply) {
    tracing::warn!(key = %query.key_expr(), %error, "refused");
    log_failure(query.reply_err(body::write(error)).encoding(body::JSON).wait());
}

/// Reads a JSON body of bounded size.
pub(crate) fn read_json<T: serde::de::DeserializeOwned>(query: &Query) -> Result<T, ErrorReply> {
    let size = query.payload().map_or(0, ZBytes::len);
    if size > body::MAX_JSON_BYTES {
        let error = format!("a body may have {} bytes, got {size}", body::MAX_JSON_BYTES);
        return Err(ErrorReply::new(ErrorCode::TooLarge, error));
    }
    body::read(&contiguous(query.payload())).map_err(|error| ErrorReply::new(error.code(), error))
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic is caught inside the lock, so a poisoned mutex can only mean that a guard was dropped while unwinding.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn log_failure(result: zenoh::Result<()>) {
    if let Err(error) = result {
        tracing::debug!(%error, "a reply could not be sent; its client is gone");
    }
}

fn contiguous(payload: Option<&ZBytes>) -> Cow<'_, [u8]> {
    payload.map_or(Cow::Borrowed(&[]), ZBytes::to_bytes)
}

fn header_of(attachment: Option<&ZBytes>) -> Result<FrameHeader, FrameError> {
    FrameHeader::from_attachment(attachment.map(ZBytes::to_bytes).as_deref())
}

/// Stands in an answer or a recording for a header that could not be read.
fn unreadable_header() -> FrameHeader {
    FrameHeader::new(domvs_proto::frame::PixelFormat::ByEncoding, 0, 0)
}

fn attached_secret(query: &Query) -> Option<Secret> {
    let bytes = query.attachment()?.to_bytes();
    <[u8; Secret::BYTES]>::try_from(&*bytes).ok().map(Secret::new)
}

fn micros(duration: std::time::Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}
