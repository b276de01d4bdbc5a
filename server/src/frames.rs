//! What a desk does with a frame, by either way: one call into the pipeline, and its twist to whoever waits for it.

use std::borrow::Cow;
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::frame::{FrameError, FrameHeader, PixelFormat};
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_ENCODING, TwistMessage};
use domvs_vision::Twist;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

use crate::answers::{contiguous, log_failure, reply_error};
use crate::desk::{Desk, PushedFrame, TwistRequest, lock};
use crate::outlet::refused;
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
        let mut answer = self.compute(&mut lock(&self.task), &frame);
        if answer.is_servoing() {
            answer = self.in_time(answer, request, &header);
            lock(&self.task).told(Twist::from_array(answer.twist));
        }
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

    pub(crate) fn follow_frame(&self, pushed: &PushedFrame) {
        let attachment = pushed.attachment.as_ref().map(ZBytes::to_bytes);
        let header = self
            .check_bytes(Some(&pushed.payload))
            .and_then(|()| FrameHeader::from_attachment(attachment.as_deref()).map_err(|error| error.to_string()))
            .and_then(|header| self.check_pushed_secret(header));
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
        if answer.is_servoing() {
            task.told(Twist::from_array(sent.twist));
        }
        drop(task);
        if sent.status != answer.status {
            lock(&self.board).overruled(&sent);
        }
        let frame = self.frame(pushed, &header, &payload);
        self.record(&frame, Some(&pushed.payload), &self.shared.keys.command(&self.key), &sent);
    }

    /// A pushed frame needs no secret, but one that names another's is meant for another task.
    fn check_pushed_secret(&self, header: FrameHeader) -> Result<FrameHeader, String> {
        match &header.secret {
            Some(secret) if *secret != self.secret => Err("the frame carries another task's secret".to_owned()),
            _ => Ok(header),
        }
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
        let mut board = lock(&self.board);
        board.answered(&answer, task.iterations(), task.detail());
        board.estimated(task.estimates());
        answer
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

pub(crate) fn header_of(attachment: Option<&ZBytes>) -> Result<FrameHeader, FrameError> {
    FrameHeader::from_attachment(attachment.map(ZBytes::to_bytes).as_deref())
}

/// Stands in an answer or a recording for a header that could not be read.
fn unreadable_header() -> FrameHeader {
    FrameHeader::new(PixelFormat::ByEncoding, 0, 0)
}

fn micros(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}
