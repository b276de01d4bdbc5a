//! What every twist is held against, whoever sent it: it is readable, one's own, echoes its frame, stays within the limits, comes from a good
//! frame and from a young one, and does not outlive its frames. The judge knows the frames that went out; it trusts nothing else.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use domvs_proto::twist::TwistMessage;
use serde::Serialize;

use crate::bench::samples::Samples;

/// The limits of the tasks: the defaults of the settings, with what a rounding may add.
const MOST_M_PER_S: f64 = 0.2 * (1.0 + 1e-9);
const MOST_RAD_PER_S: f64 = 0.7 * (1.0 + 1e-9);
/// What the network and this process may take on top, besides the time that this process itself stood still.
const SLACK: Duration = Duration::from_millis(150);
/// Frames that are remembered: more than are ever on their way.
const REMEMBERED: usize = 1024;

/// What must never happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Wrong {
    /// Not 128 bytes, not finite, or motion without `servoing`.
    Unreadable,
    /// An answer to another question, or motion for a frame that this task never had.
    NotOwn,
    /// The capture time that came back is not the frame's.
    WrongEcho,
    /// Beyond the speed limits.
    TooFast,
    /// Motion from a frame that is no good.
    FromBadFrame,
    /// Motion that came later than its frame is worth.
    FromOldFrame,
    /// Motion that was followed by nothing.
    OutlivesItsFrames,
}

impl Wrong {
    /// All of them, in the order of the table.
    pub const ALL: [Wrong; 7] = [
        Wrong::Unreadable,
        Wrong::NotOwn,
        Wrong::WrongEcho,
        Wrong::TooFast,
        Wrong::FromBadFrame,
        Wrong::FromOldFrame,
        Wrong::OutlivesItsFrames,
    ];

    /// As it stands in the table.
    pub fn words(self) -> &'static str {
        match self {
            Wrong::Unreadable => "every answer is readable; only servoing moves",
            Wrong::NotOwn => "answers and twists are one's own",
            Wrong::WrongEcho => "sequence and capture time come back",
            Wrong::TooFast => "no twist beyond the limits",
            Wrong::FromBadFrame => "no motion from a bad, black, lying or old frame",
            Wrong::FromOldFrame => "no motion later than its frame is worth",
            Wrong::OutlivesItsFrames => "silence of a camera brakes",
        }
    }
}

/// A frame that went out.
#[derive(Clone, Copy, Debug)]
pub struct Sent {
    /// Its number; no two frames of a soak have the same.
    pub sequence: u64,
    /// What stood in its header.
    pub capture_time_ns: u64,
    /// When.
    pub at: Instant,
    /// Whether motion may come from it.
    pub good: bool,
}

/// The frames of one task.
#[derive(Debug, Default)]
pub struct Ledger {
    sent: Mutex<VecDeque<Sent>>,
}

impl Ledger {
    /// Notes a frame, before it goes.
    pub fn note(&self, frame: Sent) {
        let mut sent = lock(&self.sent);
        if sent.len() >= REMEMBERED {
            sent.pop_front();
        }
        sent.push_back(frame);
    }

    fn find(&self, sequence: u64) -> Option<Sent> {
        lock(&self.sent).iter().rev().find(|sent| sent.sequence == sequence).copied()
    }
}

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Frames that went out.
    pub frames: u64,
    /// Answers and commands that came.
    pub heard: u64,
    /// Those that move.
    pub twists: u64,
    /// All of them by the word of their status.
    pub statuses: BTreeMap<&'static str, u64>,
    /// Questions without an answer in time.
    pub unanswered: u64,
    /// Error answers by their word.
    pub refused: BTreeMap<&'static str, u64>,
    /// Twists of an owner that is no more: a client passes over them.
    pub older_epochs: u64,
    /// What was wrong: how often, and the first time in words.
    pub wrong: BTreeMap<Wrong, (u64, String)>,
    /// From a question to its answer, ms.
    pub answer_ms: Samples,
    /// From a worker's death or standstill to the next twist of a task that moved before, ms.
    pub recovery_ms: Samples,
    /// Tasks that were given up and made anew, other than by a client that went.
    pub tasks_lost: u64,
    /// The last reason for one.
    pub last_loss: Option<String>,
}

/// Holds every answer against what went out.
pub struct Judge {
    begin: Instant,
    findings: Mutex<Findings>,
    /// The longest time by which this process came late, in the last second and the one before, µs.
    stalls_us: [AtomicU64; 2],
    /// A worker is away, or was a moment ago, until then (µs since the begin): nobody there can brake.
    away_until_us: AtomicU64,
}

/// How a twist came.
#[derive(Clone, Copy, Debug)]
pub struct Heard {
    /// The sequence that was asked for; `None` on `command`.
    pub asked: Option<u64>,
    /// When.
    pub at: Instant,
    /// What a frame is worth.
    pub worth: Duration,
}

impl Judge {
    /// A judge who has heard nothing.
    pub fn new(begin: Instant) -> Judge {
        Judge { begin, findings: Mutex::default(), stalls_us: Default::default(), away_until_us: AtomicU64::new(0) }
    }

    /// Looks at one message; returns it if it could be read.
    pub fn hear(&self, ledger: &Ledger, bytes: &[u8], heard: Heard) -> Option<TwistMessage> {
        let message = match TwistMessage::decode(bytes) {
            Ok(message) => message,
            Err(error) => {
                self.wrong(Wrong::Unreadable, || error.to_string());
                return None;
            }
        };
        let mut findings = lock(&self.findings);
        findings.heard += 1;
        findings.twists += u64::from(message.is_servoing());
        *findings.statuses.entry(message.status.word()).or_default() += 1;
        drop(findings);
        let sent = ledger.find(message.sequence);
        // A header that cannot be read has no sequence to echo.
        let asked = heard.asked.filter(|_| message.is_servoing() || message.sequence != 0);
        if asked.is_some_and(|asked| asked != message.sequence) {
            self.wrong(Wrong::NotOwn, || format!("asked {:?}, got {message:?}", heard.asked));
        }
        if message.is_servoing() {
            self.judge_motion(&message, sent, heard);
        }
        Some(message)
    }

    fn judge_motion(&self, message: &TwistMessage, sent: Option<Sent>, heard: Heard) {
        let norm = |part: &[f64]| part.iter().map(|value| value * value).sum::<f64>().sqrt();
        if norm(&message.twist[..3]) > MOST_M_PER_S || norm(&message.twist[3..]) > MOST_RAD_PER_S {
            self.wrong(Wrong::TooFast, || format!("{message:?}"));
        }
        let Some(sent) = sent else {
            return self.wrong(Wrong::NotOwn, || format!("no such frame: {message:?}"));
        };
        if sent.capture_time_ns != message.capture_time_ns {
            self.wrong(Wrong::WrongEcho, || format!("sent {sent:?}, got {message:?}"));
        }
        let moves = message.twist.iter().any(|value| *value != 0.0);
        if moves && !sent.good {
            self.wrong(Wrong::FromBadFrame, || format!("{message:?}"));
        }
        let (age, most) = (heard.at.saturating_duration_since(sent.at), heard.worth + self.slack());
        if moves && age > most {
            self.wrong(Wrong::FromOldFrame, || format!("{age:?} after its frame, {most:?} at most: {message:?}"));
        }
    }

    /// Called often for a task whose last command moves: something newer must have come.
    pub fn still_moves(&self, since: Instant, worth: Duration) {
        let (silence, most) = (since.elapsed(), worth + self.slack());
        if silence > most && !self.is_away() {
            self.wrong(Wrong::OutlivesItsFrames, || format!("nothing for {silence:?} after motion, {most:?} at most"));
        }
    }

    /// Counts, and keeps the first time in words.
    pub fn wrong(&self, what: Wrong, words: impl FnOnce() -> String) {
        let at_s = self.begin.elapsed().as_secs_f64();
        let mut findings = lock(&self.findings);
        let entry = findings.wrong.entry(what).or_insert_with(|| (0, format!("at {at_s:.1} s: {}", words())));
        entry.0 += 1;
        tracing::warn!(?what, first = %entry.1, "wrong");
    }

    /// The findings, to add to or to read.
    pub fn findings(&self) -> MutexGuard<'_, Findings> {
        lock(&self.findings)
    }

    /// A worker is away until then.
    pub fn away_until(&self, until: Instant) {
        let until = until.saturating_duration_since(self.begin).as_micros();
        self.away_until_us.fetch_max(u64::try_from(until).unwrap_or(u64::MAX), Ordering::Relaxed);
    }

    fn is_away(&self) -> bool {
        self.begin.elapsed() < Duration::from_micros(self.away_until_us.load(Ordering::Relaxed))
    }

    /// This process came so late; `second` counts the seconds of the soak.
    pub fn stalled(&self, second: u64, by: Duration, is_first: FirstOfSecond) {
        let stall = &self.stalls_us[(second % 2) as usize];
        let by = u64::try_from(by.as_micros()).unwrap_or(u64::MAX);
        match is_first {
            FirstOfSecond::Yes => stall.store(by, Ordering::Relaxed),
            FirstOfSecond::No => _ = stall.fetch_max(by, Ordering::Relaxed),
        }
    }

    fn slack(&self) -> Duration {
        let stall = self.stalls_us.iter().map(|stall| stall.load(Ordering::Relaxed)).max();
        SLACK + 2 * Duration::from_micros(stall.unwrap_or(0))
    }
}

/// Whether a look is the first of its second, which forgets the one before the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FirstOfSecond {
    /// It is.
    Yes,
    /// It is not.
    No,
}

/// What a panic left behind is whole: nothing here can panic half way.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use domvs_proto::status::Status;

    use super::*;

    const WORTH: Duration = Duration::from_millis(200);

    fn motion(sequence: u64) -> TwistMessage {
        let twist = [0.1, 0.0, 0.0, 0.0, 0.0, 0.1];
        TwistMessage { sequence, capture_time_ns: 10 * sequence, twist, ..TwistMessage::zero(Status::Servoing) }
    }

    fn case() -> (Judge, Ledger, Instant) {
        let (now, ledger) = (Instant::now(), Ledger::default());
        for (sequence, good) in [(1, true), (2, false)] {
            ledger.note(Sent { sequence, capture_time_ns: 10 * sequence, at: now, good });
        }
        (Judge::new(now), ledger, now)
    }

    fn found(judge: &Judge) -> Vec<Wrong> {
        judge.findings().wrong.keys().copied().collect()
    }

    #[test]
    fn a_young_twist_of_ones_own_good_frame_is_fine() {
        let (judge, ledger, at) = case();
        judge.hear(&ledger, &motion(1).encode(), Heard { asked: Some(1), at, worth: WORTH });
        assert!(found(&judge).is_empty());
    }

    #[test]
    fn each_kind_of_wrong_motion_is_found() {
        let late = Duration::from_secs(1);
        let cases: [(TwistMessage, Option<u64>, Duration, Wrong); 6] = [
            (motion(1), Some(2), Duration::ZERO, Wrong::NotOwn),
            (motion(3), None, Duration::ZERO, Wrong::NotOwn),
            (TwistMessage { capture_time_ns: 11, ..motion(1) }, None, Duration::ZERO, Wrong::WrongEcho),
            (TwistMessage { twist: [0.3, 0.0, 0.0, 0.0, 0.0, 0.0], ..motion(1) }, None, Duration::ZERO, Wrong::TooFast),
            (motion(2), None, Duration::ZERO, Wrong::FromBadFrame),
            (motion(1), None, late, Wrong::FromOldFrame),
        ];
        for (message, asked, after, wrong) in cases {
            let (judge, ledger, at) = case();
            judge.hear(&ledger, &message.encode(), Heard { asked, at: at + after, worth: WORTH });
            assert_eq!(found(&judge), [wrong]);
        }
    }

    #[test]
    fn what_cannot_be_read_is_found() {
        let (judge, ledger, at) = case();
        judge.hear(&ledger, &[0; 5], Heard { asked: None, at, worth: WORTH });
        assert_eq!(found(&judge), [Wrong::Unreadable]);
    }
}
