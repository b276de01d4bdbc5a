//! Cameras under load: a plain thread each, which sends a frame whenever one is due, whether the last was answered or not, or as fast
//! as answers come. A frame's time counts from when it was due, so that a sender that falls behind hides nothing.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use domvs_client::{ClientError, OutgoingFrame, Status, Task, TwistMessage};
use serde::Serialize;
use tokio::runtime::Handle;

use super::samples::Samples;
use super::watch::Watch;

/// Frames of one camera that may wait for their answers; further ones are not sent, and counted.
const MOST_WAITING: u64 = 64;
/// Between the making of the threads and the first frame.
const HEAD_START: Duration = Duration::from_millis(50);

/// How fast each camera is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// So many frames a second.
    Hz(f64),
    /// The next frame when one was answered, with so many that wait for their answers.
    AsAnswered {
        /// From 1 on.
        ahead: usize,
    },
}

/// What became of one camera's frames.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Heard {
    /// Frames that went out.
    pub sent: u64,
    /// Frames that did not, because too many waited for their answers.
    pub unsent: u64,
    /// Answers with a twist.
    pub servoing: u64,
    /// Other answers, by status.
    pub refused: BTreeMap<&'static str, u64>,
    /// No answer in time.
    pub unanswered: u64,
    /// The last reason for no answer.
    pub error: Option<String>,
    /// Of the answers with a twist.
    #[serde(skip)]
    pub times: Samples,
}

impl Heard {
    /// Adds what another while brought.
    pub fn add(&mut self, other: &Heard) {
        self.sent += other.sent;
        self.unsent += other.unsent;
        self.servoing += other.servoing;
        self.unanswered += other.unanswered;
        for (status, count) in &other.refused {
            *self.refused.entry(status).or_default() += count;
        }
        self.error = other.error.clone().or(self.error.take());
        self.times.extend(&other.times);
    }

    /// Answers with this status.
    pub fn with_status(&self, status: Status) -> u64 {
        self.refused.get(status.word()).copied().unwrap_or(0)
    }

    fn answered(&mut self, time: Duration, answer: Result<TwistMessage, ClientError>) {
        match answer {
            Ok(twist) if twist.is_servoing() => {
                self.servoing += 1;
                self.times.add(time.as_secs_f64() * 1e3);
            }
            Ok(twist) => *self.refused.entry(twist.status.word()).or_default() += 1,
            Err(error) => {
                self.unanswered += 1;
                self.error = Some(error.to_string());
            }
        }
    }

    fn heard(&self) -> u64 {
        self.servoing + self.refused.values().sum::<u64>() + self.unanswered
    }
}

/// One camera each for `tasks`, for so many seconds; `first` is the first sequence number. Blocks until all is answered or given up.
pub fn drive(
    runtime: &Handle,
    tasks: &[Arc<Task>],
    frames: &[OutgoingFrame],
    rate: Rate,
    seconds: f64,
    first: u64,
    watch: &Watch,
) -> Vec<Heard> {
    let begin = Instant::now() + HEAD_START;
    let end = begin + Duration::from_secs_f64(seconds);
    std::thread::scope(|scope| {
        let camera = |(index, task): (usize, &Arc<Task>)| {
            let camera = Camera { runtime, task: task.clone(), frames, first, watch };
            let phase = phase(index as u64);
            scope.spawn(move || match rate {
                Rate::Hz(rate_hz) => camera.at_rate(begin, end, rate_hz, phase),
                Rate::AsAnswered { ahead } => camera.as_answered(begin, end, ahead),
            })
        };
        let cameras: Vec<_> = tasks.iter().enumerate().map(camera).collect();
        cameras.into_iter().map(|camera| camera.join().unwrap_or_default()).collect()
    })
}

struct Camera<'a> {
    runtime: &'a Handle,
    task: Arc<Task>,
    frames: &'a [OutgoingFrame],
    first: u64,
    watch: &'a Watch,
}

type Answer = (Duration, Result<TwistMessage, ClientError>);

impl Camera<'_> {
    fn at_rate(&self, begin: Instant, end: Instant, rate_hz: f64, phase: f64) -> Heard {
        let mut heard = Heard::default();
        let (sender, answers) = channel::<Answer>();
        for number in 0.. {
            let due = begin + Duration::from_secs_f64((phase + number as f64) / rate_hz);
            if due >= end || self.watch.is_stopped() {
                break;
            }
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            answers.try_iter().for_each(|(time, answer)| heard.answered(time, answer));
            if heard.sent - heard.heard() < MOST_WAITING {
                heard.sent += 1;
                self.send(number, due, sender.clone());
            } else {
                heard.unsent += 1;
            }
        }
        drop(sender);
        // Every question has a limit, so this ends.
        answers.iter().for_each(|(time, answer)| heard.answered(time, answer));
        heard
    }

    fn send(&self, number: u64, due: Instant, sender: Sender<Answer>) {
        let (task, frame) = (self.task.clone(), self.frame(number));
        self.runtime.spawn(async move {
            let answer = task.twist(&frame).await;
            // The camera waits for every answer.
            let _ = sender.send((due.elapsed(), answer));
        });
    }

    fn as_answered(&self, begin: Instant, end: Instant, ahead: usize) -> Heard {
        let mut heard = Heard::default();
        std::thread::sleep(begin.saturating_duration_since(Instant::now()));
        if ahead == 1 {
            // Without a task and a channel in between.
            while Instant::now() < end && !self.watch.is_stopped() {
                let frame = self.frame(heard.sent);
                let asked = Instant::now();
                heard.sent += 1;
                let answer = self.runtime.block_on(self.task.twist(&frame));
                heard.answered(asked.elapsed(), answer);
            }
            return heard;
        }
        let (sender, answers) = channel::<Answer>();
        while Instant::now() < end && !self.watch.is_stopped() {
            while heard.sent - heard.heard() < ahead as u64 {
                self.send(heard.sent, Instant::now(), sender.clone());
                heard.sent += 1;
            }
            // Every question has a limit, so this ends.
            answers.iter().take(1).for_each(|(time, answer)| heard.answered(time, answer));
        }
        drop(sender);
        answers.iter().for_each(|(time, answer)| heard.answered(time, answer));
        heard
    }

    fn frame(&self, number: u64) -> OutgoingFrame {
        let sequence = self.first + number;
        self.frames[sequence as usize % self.frames.len()].clone().numbered(sequence, 0)
    }
}

/// When in its period a camera takes its images: anywhere, as cameras that know nothing of each other do, and the same in every run
/// (the mixing function of SplitMix64).
fn phase(camera: u64) -> f64 {
    let mut mixed = camera.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (mixed ^ (mixed >> 31)) as f64 / 2f64.powi(64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_take_their_images_at_different_times_of_the_period() {
        let phases: Vec<f64> = (0..20).map(phase).collect();
        assert!(phases.iter().all(|phase| (0.0..1.0).contains(phase)));
        for quarter in 0..4 {
            assert!(phases.iter().any(|phase| (phase * 4.0) as usize == quarter), "none in quarter {quarter}");
        }
    }

    #[test]
    fn every_answer_is_counted_once() {
        let mut heard = Heard { sent: 3, ..Heard::default() };
        heard.answered(Duration::from_millis(2), Ok(TwistMessage::zero(Status::Servoing)));
        heard.answered(Duration::from_millis(1), Ok(TwistMessage::zero(Status::Overloaded)));
        let mut both = heard.clone();
        both.add(&heard);
        assert_eq!((heard.heard(), both.heard(), both.sent), (2, 4, 6));
        assert_eq!((both.servoing, both.with_status(Status::Overloaded), both.times.count()), (2, 2, 2));
    }
}
