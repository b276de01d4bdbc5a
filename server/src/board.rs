//! What a task tells the world about itself: counters and the newest numbers, for `status`.

use std::time::Duration;

use domvs_proto::keys::TaskKey;
use domvs_proto::messages::{FramesDropped, Progress, StatusMessage};
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;

use crate::Moment;
use crate::task::Estimates;

/// `status` is repeated this often when nothing changes: 2 Hz.
const STATUS_PERIOD: Duration = Duration::from_millis(500);
/// Standbys hear this often how far a task is: 1 Hz.
const PROGRESS_PERIOD: Duration = Duration::from_secs(1);

/// The counters and the last word of one task.
#[derive(Clone, Debug)]
pub struct Board {
    message: StatusMessage,
    born: Moment,
    last_published: Option<Moment>,
    last_used: Moment,
    last_frame: Moment,
    /// As the task stood after its last piece of work.
    progress: Option<Progress>,
    progress_published: Moment,
    /// How often the whole state has been published.
    revision: u64,
}

/// How far a task is, and the revision of the state that this belongs to: taken together, so that what comes late is known to be old.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct News {
    /// Of the state published last when this was so.
    pub revision: u64,
    /// How far the task was then.
    pub progress: Progress,
}

impl Board {
    /// The board of a task created at `born`.
    pub fn new(task: TaskKey, status: Status, epoch: u32, born: Moment) -> Board {
        let message = StatusMessage::new(task, status, epoch);
        Board {
            message,
            born,
            last_published: None,
            last_used: born,
            last_frame: born,
            progress: None,
            progress_published: born,
            revision: 0,
        }
    }

    /// Goes on with the counters of the owner before.
    pub fn go_on(&mut self, progress: &Progress) {
        (self.message.twists, self.message.sequence) = (progress.twists, progress.sequence);
        (self.message.frames_in, self.message.frames_dropped) = (progress.frames_in, progress.frames_dropped);
    }

    /// Notes how far the task is now. Returns what standbys must hear at once: where it stands has changed.
    pub fn advanced(&mut self, progress: Progress) -> Option<News> {
        let before = self.progress.replace(progress);
        let changed = before.is_some_and(|before| before.phase != progress.phase);
        changed.then(|| self.news()).flatten()
    }

    /// How often the whole state has been published.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The whole state is about to be published: what was said before belongs to an older one.
    pub fn revise(&mut self) {
        self.revision += 1;
    }

    fn news(&self) -> Option<News> {
        Some(News { revision: self.revision, progress: self.progress()? })
    }

    /// How far the task is, frames counted; `None` before it has done anything.
    pub fn progress(&self) -> Option<Progress> {
        let (frames_in, frames_dropped) = (self.message.frames_in, self.message.frames_dropped);
        self.progress.map(|progress| Progress { status: self.message.status, frames_in, frames_dropped, ..progress })
    }

    /// How far the task is, if it is time to tell the standbys again.
    pub fn news_due(&mut self, now: Moment) -> Option<News> {
        if now.saturating_sub(self.progress_published) < PROGRESS_PERIOD {
            return None;
        }
        self.progress_published = now;
        self.news()
    }

    /// What the task said last.
    pub fn status(&self) -> Status {
        self.message.status
    }

    /// When a frame or an order last came.
    pub fn last_used(&self) -> Moment {
        self.last_used
    }

    /// When a frame last came, by either way.
    pub fn last_frame(&self) -> Moment {
        self.last_frame
    }

    /// Notes that a frame arrived, by either way.
    pub fn frame_arrived(&mut self, now: Moment) {
        self.message.frames_in += 1;
        (self.last_used, self.last_frame) = (now, now);
    }

    /// Notes that an order arrived.
    pub fn used(&mut self, now: Moment) {
        self.last_used = now;
    }

    /// The counters of frames that made no twist.
    pub fn dropped(&mut self) -> &mut FramesDropped {
        &mut self.message.frames_dropped
    }

    /// Notes the answer to a frame.
    pub fn answered(&mut self, answer: &TwistMessage, iterations: u64, detail: Option<&str>) {
        let dropped = &mut self.message.frames_dropped;
        match answer.status {
            Status::BadFrame => dropped.bad += 1,
            Status::StaleFrame => dropped.stale += 1,
            Status::DeadlineMissed => dropped.deadline += 1,
            _ => {}
        }
        self.message.sequence = answer.sequence;
        self.message.compute_us = answer.compute_us;
        self.message.twists = iterations;
        if answer.features > 0 {
            self.message.order = answer.order;
            self.message.pixel_mse = finite(answer.pixel_mse);
            self.message.feature_error_norm = finite(answer.feature_error_norm);
        }
        self.say(answer.status, detail);
    }

    /// Notes what the law has found out besides the twist.
    pub fn estimated(&mut self, estimates: Estimates) {
        self.message.light = estimates.light;
        self.message.depth_scale = estimates.depth_scale;
    }

    /// Notes that zeros were sent instead of the answer, because the world went on while it was computed.
    pub fn overruled(&mut self, sent: &TwistMessage) {
        let dropped = &mut self.message.frames_dropped;
        let detail = match sent.status {
            Status::StaleFrame => {
                dropped.stale += 1;
                Some("the twist was ready too late, or the worker stood still")
            }
            Status::DeadlineMissed => {
                dropped.deadline += 1;
                Some("the computation ended after the deadline")
            }
            _ => None,
        };
        self.say(sent.status, detail);
    }

    /// Changes the last word; a change is published at the clock's next look.
    pub fn say(&mut self, status: Status, detail: Option<&str>) {
        if status != self.message.status {
            let (task, sequence) = (&self.message.task, self.message.sequence);
            tracing::info!(%task, client = %task.client, sequence, %status, detail, "status");
            self.message.status = status;
            self.message.meaning = status.meaning().to_owned();
            self.message.latched = status.is_latched();
            self.last_published = None;
        }
        if detail != self.message.detail.as_deref() {
            self.message.detail = detail.map(str::to_owned);
        }
    }

    /// The message to publish now, if it is time to.
    pub fn due(&mut self, now: Moment) -> Option<StatusMessage> {
        if self.last_published.is_some_and(|last| now.saturating_sub(last) < STATUS_PERIOD) {
            return None;
        }
        self.last_published = Some(now);
        self.message.uptime_s = now.saturating_sub(self.born).as_secs_f64();
        Some(self.message.clone())
    }
}

fn finite(number: f64) -> Option<f64> {
    number.is_finite().then_some(number)
}

#[cfg(test)]
mod tests {
    use domvs_proto::messages::Phase;

    use super::*;

    fn board() -> Board {
        Board::new("alice/one".parse().expect("a task"), Status::WaitingTarget, 7, Duration::ZERO)
    }

    fn ms(ms: u64) -> Moment {
        Duration::from_millis(ms)
    }

    #[test]
    fn status_is_published_on_change_and_twice_a_second() {
        let mut board = board();
        let published: Vec<u64> = (0..1200)
            .filter(|&t| {
                if t == 700 {
                    board.say(Status::Ready, None);
                }
                board.due(ms(t)).is_some()
            })
            .collect();
        assert_eq!(published, [0, 500, 700]);
    }

    #[test]
    fn news_belong_to_the_state_that_was_published_before_them() {
        let mut board = board();
        let at = |phase| Progress { phase, ..progress() };
        board.revise();
        assert_eq!(board.advanced(at(Phase::Running)), None, "the state itself says it");
        let running = board.news_due(ms(1000)).expect("after a second");
        // The clock has taken it and not published it yet when a stop comes.
        board.revise();
        let stopped = board.advanced(at(Phase::Latched(Status::Stopped))).expect("at once");
        assert_eq!((running.progress.phase, stopped.progress.phase), (Phase::Running, Phase::Latched(Status::Stopped)));
        assert!(running.revision < stopped.revision && stopped.revision == board.revision());
    }

    fn progress() -> Progress {
        Progress {
            status: Status::Servoing,
            phase: Phase::Running,
            twists: 1,
            held_frames: 0,
            sequence: 1,
            initial_pixel_mse: None,
            initial_order_mse: None,
            frames_in: 1,
            frames_dropped: FramesDropped::default(),
        }
    }

    #[test]
    fn a_refused_frame_is_counted_by_its_reason_and_keeps_the_last_numbers() {
        let mut board = board();
        let good = TwistMessage {
            order: 6,
            features: 28,
            pixel_mse: 0.25,
            sequence: 3,
            ..TwistMessage::zero(Status::Servoing)
        };
        board.answered(&good, 1, None);
        board.answered(&TwistMessage::zero(Status::BadFrame), 1, Some("expected 4x4 pixels"));
        let message = board.due(ms(0)).expect("a change");
        assert_eq!((message.status, message.frames_dropped.bad), (Status::BadFrame, 1));
        assert_eq!((message.order, message.pixel_mse), (6, Some(0.25)));
        assert_eq!(message.detail.as_deref(), Some("expected 4x4 pixels"));
    }
}
