//! What a desk does with a frame, by either way: one call into the pipeline, and its twist to whoever waits for it.

use std::borrow::Cow;
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::frame::{FrameHeader, PixelFormat};
use domvs_proto::keys::Leaf;
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_ENCODING, TwistMessage};
use domvs_vision::Twist;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::answers::log_failure;
use crate::desk::{Desk, PushedFrame, TwistRequest, lock};
use crate::metrics::Dropped;
use crate::outlet::refused;
use crate::payload::{Payload, header_of};
use crate::pipeline::{is_past_deadline, on_frame};
use crate::task::{Frame, Route, Task};

impl Desk {
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

    pub(crate) fn answer_twist(&self, request: &TwistRequest) {
        let query = &request.query;
        let header = match header_of(query.attachment()) {
            Ok(header) => header,
            Err(error) => {
                let answer = self.refuse_frame(&lock(&self.task), Status::BadFrame, &error.to_string());
                return self.reply_twist(query, answer);
            }
        };
        if let Err(error) = self.check_owner(header.secret.as_ref()) {
            self.shared.metrics.dropped(Dropped::NotOwner);
            return self.shared.refuse(query, &error);
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
            answer = self.in_time(answer, request, &header);
            lock(&self.task).told(Twist::from_array(answer.twist));
        }
        self.reply_twist(query, answer);
        self.took(&frame, &answer);
        self.record(&frame, query.payload(), Leaf::Twist, &answer);
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

    pub(crate) fn follow_frame(&self, pushed: &PushedFrame) {
        let header = self
            .check_bytes(Some(&pushed.payload))
            .and_then(|()| header_of(pushed.attachment.as_ref()).map_err(|error| error.to_string()))
            .and_then(|header| self.check_pushed_secret(header));
        let (header, refusal) = header.map_or_else(|error| (unreadable_header(), Some(error)), |header| (header, None));
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
            Some(error) => self.refuse_frame(&task, Status::BadFrame, error),
        };
        let sent = lock(&self.outlet).send(answer, pushed.received, self.shared.now());
        task.commanded(Twist::from_array(sent.twist));
        if answer.is_servoing() {
            task.told(Twist::from_array(sent.twist));
        }
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

    /// A pushed frame needs no secret, but one that names another's is meant for another task.
    fn check_pushed_secret(&self, header: FrameHeader) -> Result<FrameHeader, String> {
        match &header.secret {
            Some(secret) if *secret != self.secret => Err("the frame carries another task's secret".to_owned()),
            _ => Ok(header),
        }
    }

    /// Zeros for a frame that never gets to the pipeline. A task that stands says why it stands.
    fn refuse_frame(&self, task: &Task, status: Status, detail: &str) -> TwistMessage {
        let (status, detail) = if task.is_running() { (status, Some(detail)) } else { (task.status(), None) };
        let answer = TwistMessage { epoch: self.epoch, ..TwistMessage::zero(status) };
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
            TwistMessage { sequence: frame.header.sequence, ..TwistMessage::zero(Status::Internal) }
        });
        answer.epoch = self.epoch;
        answer.queue_us = micros(begin.saturating_sub(frame.received));
        answer.compute_us = micros(self.shared.now().saturating_sub(begin));
        let mut board = lock(&self.board);
        board.answered(&answer, task.iterations(), task.detail());
        board.estimated(task.estimates());
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

/// Stands in an answer or a recording for a header that could not be read.
fn unreadable_header() -> FrameHeader {
    FrameHeader::new(PixelFormat::ByEncoding, 0, 0)
}

fn micros(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}
