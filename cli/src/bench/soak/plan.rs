//! What goes wrong, when, and for whom: made from the seed alone, so that the same soak can be had again.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use serde::{Serialize, Serializer};

/// Between two faults of tasks, seconds, at the mean.
const TASK_FAULT_S: f64 = 2.0;
/// Faults of workers come between these parts of the soak: behind the last one, memory is watched undisturbed.
const WORKER_FAULTS: [f64; 2] = [0.1, 0.6];
/// Between two faults of workers, seconds, about.
const WORKER_FAULT_S: f64 = 60.0;

/// One thing that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The camera sends nothing, and comes back.
    CameraStops,
    /// The camera sends one picture again and again.
    FrozenFrames,
    /// A byte is missing.
    BadFrames,
    /// The lens cap is on.
    BlackFrames,
    /// The header says what is not so.
    LyingHeaders,
    /// Every third frame is from the past.
    OldFrames,
    /// The client's session ends without a word to the task, and another client takes its place.
    ClientGoes,
    /// Somebody follows the task and then stands still (SIGSTOP), and is killed in the end.
    SlowReader,
    /// A worker is killed (SIGKILL) and started again.
    WorkerKilled,
    /// A worker stands still (SIGSTOP) and goes on (SIGCONT).
    WorkerStopped,
}

impl Fault {
    /// What happens to one task.
    const OF_TASKS: [Fault; 8] = [
        Fault::CameraStops,
        Fault::FrozenFrames,
        Fault::BadFrames,
        Fault::BlackFrames,
        Fault::LyingHeaders,
        Fault::OldFrames,
        Fault::ClientGoes,
        Fault::SlowReader,
    ];

    /// As it stands in the table.
    pub fn word(self) -> &'static str {
        match self {
            Fault::CameraStops => "camera stops",
            Fault::FrozenFrames => "frozen frames",
            Fault::BadFrames => "bad frames",
            Fault::BlackFrames => "black frames",
            Fault::LyingHeaders => "lying headers",
            Fault::OldFrames => "old frames",
            Fault::ClientGoes => "client goes",
            Fault::SlowReader => "slow reader",
            Fault::WorkerKilled => "worker killed",
            Fault::WorkerStopped => "worker stopped",
        }
    }
}

/// A fault with its time and its victim.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Event {
    /// From the begin of the soak.
    #[serde(serialize_with = "seconds", rename = "at_s")]
    pub at: Duration,
    /// For how long.
    #[serde(serialize_with = "seconds", rename = "lasts_s")]
    pub lasts: Duration,
    /// What.
    pub fault: Fault,
    /// Which task, or which worker.
    pub whom: usize,
}

fn seconds<S: Serializer>(duration: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(duration.as_secs_f64())
}

impl Event {
    /// Whether it is on.
    pub fn is_on(&self, now: Duration) -> bool {
        self.at <= now && now < self.at + self.lasts
    }
}

/// Everything that goes wrong in a soak of this length, in the order of time.
pub fn plan(seed: u64, length: Duration, tasks: usize, workers: usize) -> Vec<Event> {
    let mut dice = Dice(ChaCha8Rng::seed_from_u64(seed));
    let length_s = length.as_secs_f64();
    let mut events = Vec::new();
    for number in 0..(length_s / TASK_FAULT_S) as usize {
        let fault = Fault::OF_TASKS[number % Fault::OF_TASKS.len()];
        let (at_s, lasts_s) = (length_s * (0.03 + 0.9 * dice.part()), 0.5 + 2.0 * dice.part());
        events.push(event(at_s, lasts_s, fault, dice.below(tasks)));
    }
    let [begin, end] = WORKER_FAULTS.map(|part| part * length_s);
    // At least one of each kind.
    let count = (((end - begin) / WORKER_FAULT_S) as usize).max(2);
    for number in 0..count {
        let at_s = begin + (end - begin) * (number as f64 + 0.5 * dice.part()) / count as f64;
        let (fault, lasts_s) = match number % 2 {
            0 => (Fault::WorkerStopped, 2.0 + 2.0 * dice.part()),
            _ => (Fault::WorkerKilled, 1.0),
        };
        events.push(event(at_s, lasts_s, fault, dice.below(workers)));
    }
    events.sort_by_key(|event| event.at);
    events
}

fn event(at_s: f64, lasts_s: f64, fault: Fault, whom: usize) -> Event {
    Event { at: Duration::from_secs_f64(at_s), lasts: Duration::from_secs_f64(lasts_s), fault, whom }
}

struct Dice(ChaCha8Rng);

impl Dice {
    /// From 0 to 1.
    fn part(&mut self) -> f64 {
        f64::from(self.0.next_u32()) / f64::from(u32::MAX)
    }

    fn below(&mut self, end: usize) -> usize {
        self.0.next_u32() as usize % end.max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_plan_and_another_another() {
        let minute = Duration::from_secs(60);
        assert_eq!(plan(1, minute, 8, 2), plan(1, minute, 8, 2));
        assert_ne!(plan(1, minute, 8, 2), plan(2, minute, 8, 2));
    }

    #[test]
    fn every_kind_of_fault_comes_within_half_a_minute_and_ends_before_the_soak() {
        let length = Duration::from_secs(30);
        let events = plan(3, length, 8, 1);
        for fault in Fault::OF_TASKS.into_iter().chain([Fault::WorkerKilled, Fault::WorkerStopped]) {
            assert!(events.iter().any(|event| event.fault == fault), "{fault:?}");
        }
        assert!(events.iter().all(|event| event.at < length.mul_f64(0.95)));
        assert!(events.is_sorted_by_key(|event| event.at));
    }
}
