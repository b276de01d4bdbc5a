//! What a desk does with a frame, by either way: one call into the pipeline, and its twist to whoever waits for it.

use std::borrow::Cow;
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::frame::FrameHeader;
use domvs_proto::keys::Leaf;
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_ENCODING, TwistMessage};
use domvs_vision::Twist;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::answers::log_failure;
use crate::desk::{Desk, PushedFrame, TwistRequest, lock};
use crate::payload::{Payload, echo_of, header_of};
use crate::pipeline::{on_frame, recheck, send_answer};
use crate::task::{Frame, Route, Task};

impl Desk {
    /// Answers a twist request that nobody will compute.
    pub(crate) fn refuse_twist(&self, query: &Query, status: Status) {
        let header = header_or_echo(query.attachment()).0;
        // A task that stands says why it stands, to whoever it is.
        let standing = Some(lock(&self.board).status()).filter(|now| status == Status::BadFrame && now.is_latched());
        let status = standing.unwrap_or(status);
        if status == Status::Overloaded {
            lock(&self.board).dropped().overloaded += 1;
        }
        self.reply_twist(query, self.zeros(&header, status));
    }

    pub(crate) fn answer_twist(&self, request: &TwistRequest) {
        let query = &request.query;
        let (header, refusal) = header_or_echo(query.attachment());
        if let Some(error) = refusal {
            let answer = self.refuse_frame(&lock(&self.task), &header, &error);
            return self.reply_twist(query, answer);
        }
        let payload = query.payload().map_or(Payload::Whole(&[]), Payload::from);
        let encoding: Cow<'static, str> = query.encoding().map(Cow::from).unwrap_or_default();
        let frame = Frame {
            header: &header,
            encoding: &encoding,
            payload,
            received: request.received,
            route: Route::Requested,
        };
        let mut answer = self.compute(&mut lock(&self.task), &frame);
        if answer.is_servoing() {
            let halted = self.waiting_halt();
            answer = recheck(answer, &lock(&self.outlet), &frame, halted, self.shared.now());
            lock(&self.task).told(Twist::from_array(answer.twist));
            if !answer.is_servoing() {
                lock(&self.board).overruled(&answer);
            }
        }
        self.reply_twist(query, answer);
        self.took(&frame, &answer);
        self.record(&frame, query.payload(), Leaf::Twist, &answer);
    }

    pub(crate) fn follow_frame(&self, pushed: &PushedFrame) {
        let (header, unreadable) = header_or_echo(pushed.attachment.as_ref());
        let refusal =
            self.check_bytes(Some(&pushed.payload)).err().or(unreadable).or(self.check_pushed_secret(&header));
        let frame = Frame {
            header: &header,
            encoding: &Cow::from(&pushed.encoding),
            payload: Payload::from(&pushed.payload),
            received: pushed.received,
            route: Route::Pushed,
        };
        let mut task = lock(&self.task);
        let answer = match &refusal {
            None => self.compute(&mut task, &frame),
            Some(error) => self.refuse_frame(&task, &header, error),
        };
        let halted = self.waiting_halt();
        let sent = send_answer(&mut task, &mut lock(&self.outlet), &frame, answer, halted, self.shared.now());
        drop(task);
        if sent.status != answer.status {
            lock(&self.board).overruled(&sent);
        }
        self.shared.metrics.answered(Route::Pushed, sent.status);
        if refusal.is_none() {
            self.took(&frame, &sent);
        }
        self.record(&frame, Some(&pushed.payload), Leaf::Command, &sent);
    }

    /// What was heard of while a frame was computed, and is latched before the next one; or that nobody has heard of the client of a task
    /// that was taken over. Looked at before the outlet, as everywhere.
    fn waiting_halt(&self) -> Option<Status> {
        let halt = *lock(&self.halt);
        halt.or_else(|| self.is_client_unheard().then_some(Status::WaitingFrame))
    }

    /// A pushed frame needs no secret unless the settings ask for it, but one that names another's is meant for another task.
    fn check_pushed_secret(&self, header: &FrameHeader) -> Option<String> {
        let is_anothers = header.secret.as_ref().is_some_and(|secret| !self.takes_frames_of(secret));
        is_anothers.then(|| "the frame carries another task's secret".to_owned())
    }

    /// Zeros for a frame of which nothing but the header was looked at.
    fn zeros(&self, header: &FrameHeader, status: Status) -> TwistMessage {
        TwistMessage {
            sequence: header.sequence,
            capture_time_ns: header.capture_time_ns,
            epoch: self.epoch,
            valid_ms: lock(&self.outlet).valid_ms(),
            ..TwistMessage::zero(status)
        }
    }

    /// Zeros for a frame that never gets to the pipeline. A task that stands says why it stands.
    fn refuse_frame(&self, task: &Task, header: &FrameHeader, detail: &str) -> TwistMessage {
        let (status, detail) = if task.is_running() { (Status::BadFrame, Some(detail)) } else { (task.status(), None) };
        let answer = self.zeros(header, status);
        lock(&self.board).answered(&answer, task.iterations(), detail);
        answer
    }

    /// One frame through the pipeline, measured; a panic in it latches `internal`.
    fn compute(&self, task: &mut Task, frame: &Frame<'_>) -> TwistMessage {
        let begin = self.shared.now();
        let stood = !task.is_running();
        let answer = self.guarded(|| on_frame(task, frame, begin));
        if stood && task.is_running() {
            let sequence = frame.header.sequence;
            tracing::info!(task = %self.key, client = %self.key.client, sequence, "started by the first frame");
        }
        let mut answer = answer.unwrap_or_else(|| {
            task.latch(Status::Internal);
            self.zeros(frame.header, Status::Internal)
        });
        answer.epoch = self.epoch;
        answer.queue_us = micros(begin.saturating_sub(frame.received));
        answer.compute_us = micros(self.shared.now().saturating_sub(begin));
        let mut board = lock(&self.board);
        board.answered(&answer, task.iterations(), task.detail());
        board.estimated(task.estimates());
        let news = board.advanced(task.progress(answer.status));
        drop(board);
        if let Some(news) = news {
            self.publish_progress(news);
            self.keep(task);
        }
        answer
    }

    fn took(&self, frame: &Frame<'_>, answer: &TwistMessage) {
        self.shared.metrics.took(frame.route, answer, self.shared.now().saturating_sub(frame.received));
    }

    fn record(&self, frame: &Frame<'_>, payload: Option<&ZBytes>, leaf: Leaf, answer: &TwistMessage) {
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
        recorder.twist(&self.shared.keys.task(&self.key, leaf), now, answer.encode());
    }

    fn reply_twist(&self, query: &Query, mut answer: TwistMessage) {
        answer.epoch = self.epoch;
        self.shared.metrics.answered(Route::Requested, answer.status);
        let key = self.twist_key.clone();
        let as_json = query.parameters().get("format") == Some("json");
        log_failure(if as_json {
            query.reply(key, answer.to_json()).encoding(body::JSON).wait()
        } else {
            query.reply(key, answer.encode()).encoding(TWIST_ENCODING).wait()
        });
    }
}

/// The header of a frame; of one that cannot be read what is echoed, and why.
fn header_or_echo(attachment: Option<&ZBytes>) -> (FrameHeader, Option<String>) {
    header_of(attachment).map_or_else(|error| (echo_of(attachment), Some(error.to_string())), |header| (header, None))
}

fn micros(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}
