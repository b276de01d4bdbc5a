//! Statuses: the one word that goes with every twist and says why the camera moves or brakes.
//!
//! Only `servoing` ever comes with motion. Codes and words are frozen; new ones are added at the end, and a
//! reader that meets an unknown one brakes.

use std::fmt;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// What a task is doing, or why it does not move. The number is the byte on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Status {
    /// The twist is meant to be executed.
    Servoing = 0,
    /// The target is reached and held.
    Converged = 1,
    /// No target is set.
    WaitingTarget = 2,
    /// Started, and no frame has come within the watchdog time.
    WaitingFrame = 3,
    /// The frame is too old, or not newer than the one before.
    StaleFrame = 4,
    /// The frame cannot be used: undecodable, wrong size or version, mostly not finite.
    BadFrame = 5,
    /// The image is black, white or flat.
    LowTexture = 6,
    /// Over half of the depth is unknown and there is no fallback.
    NoDepth = 7,
    /// The error grows instead of shrinking.
    Diverging = 8,
    /// `stop.max_iterations` twists were computed without convergence.
    IterationCap = 9,
    /// A client paused the task.
    Paused = 10,
    /// A client stopped the task, or everything was stopped.
    Stopped = 11,
    /// The worker that owned the task is gone.
    OwnerLost = 12,
    /// A newer frame or a newer owner took its place.
    Superseded = 13,
    /// The twist was not ready within `deadline_us`.
    DeadlineMissed = 14,
    /// Too many requests wait already.
    Overloaded = 15,
    /// The image does not change although the camera was told to move.
    FrozenFrame = 16,
    /// A defect in the service; its log says more.
    Internal = 17,
    /// The target is set; the task waits for `start`.
    Ready = 18,
    /// The client's liveliness token is gone.
    ClientLost = 19,
    /// The image does not determine all free degrees of freedom.
    RankDeficient = 20,
    /// Reserved: nothing of the target was recognised.
    Lost = 21,
}

use Status::*;

impl Status {
    /// Every status, in the order of the codes.
    pub const ALL: [Status; 22] = [
        Servoing,
        Converged,
        WaitingTarget,
        WaitingFrame,
        StaleFrame,
        BadFrame,
        LowTexture,
        NoDepth,
        Diverging,
        IterationCap,
        Paused,
        Stopped,
        OwnerLost,
        Superseded,
        DeadlineMissed,
        Overloaded,
        FrozenFrame,
        Internal,
        Ready,
        ClientLost,
        RankDeficient,
        Lost,
    ];

    /// The byte on the wire.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The status of a byte; `None` for a code this version does not know, which means stop.
    pub fn from_code(code: u8) -> Option<Status> {
        Status::ALL.get(usize::from(code)).copied()
    }

    /// The word in JSON, logs and docs.
    pub fn word(self) -> &'static str {
        match self {
            Servoing => "servoing",
            Converged => "converged",
            WaitingTarget => "waiting_target",
            WaitingFrame => "waiting_frame",
            StaleFrame => "stale_frame",
            BadFrame => "bad_frame",
            LowTexture => "low_texture",
            NoDepth => "no_depth",
            Diverging => "diverging",
            IterationCap => "iteration_cap",
            Paused => "paused",
            Stopped => "stopped",
            OwnerLost => "owner_lost",
            Superseded => "superseded",
            DeadlineMissed => "deadline_missed",
            Overloaded => "overloaded",
            FrozenFrame => "frozen_frame",
            Internal => "internal",
            Ready => "ready",
            ClientLost => "client_lost",
            RankDeficient => "rank_deficient",
            Lost => "lost",
        }
    }

    /// The status of a word; `None` for a word this version does not know, which means stop.
    pub fn from_word(word: &str) -> Option<Status> {
        Status::ALL.into_iter().find(|status| status.word() == word)
    }

    /// Whether it stays until `start` or `resume`; the others clear at the next good frame.
    pub fn is_latched(self) -> bool {
        matches!(self, Converged | Diverging | IterationCap | Paused | Stopped | Internal | ClientLost)
    }

    /// One sentence for people.
    pub fn meaning(self) -> &'static str {
        match self {
            Servoing => "the twist is meant to be executed",
            Converged => "the target is reached and held",
            WaitingTarget => "no target is set",
            WaitingFrame => "no frame has come within the watchdog time",
            StaleFrame => "the frame is too old, or not newer than the one before",
            BadFrame => "the frame is undecodable, of the wrong size or version, or mostly not finite",
            LowTexture => "the image is black, white or flat",
            NoDepth => "over half of the depth is unknown and there is no fallback",
            Diverging => "the error grows instead of shrinking",
            IterationCap => "stop.max_iterations was reached without convergence",
            Paused => "a client paused the task",
            Stopped => "a client stopped the task, or everything was stopped",
            OwnerLost => "the worker that owned the task is gone",
            Superseded => "a newer frame or a newer owner took its place",
            DeadlineMissed => "the twist was not ready within deadline_us",
            Overloaded => "too many requests wait already",
            FrozenFrame => "the image does not change although the camera was told to move",
            Internal => "a defect in the service",
            Ready => "the target is set and the task waits for start",
            ClientLost => "the liveliness token of the client is gone",
            RankDeficient => "the image does not determine all free degrees of freedom",
            Lost => "nothing of the target was recognised (reserved)",
        }
    }

    /// What a client can do about it, for people.
    pub fn advice(self) -> &'static str {
        match self {
            Servoing => "execute the twist until valid_ms has passed",
            Converged => "done; start begins anew",
            WaitingTarget => "send a frame to target",
            WaitingFrame => "look at the camera and the network; it clears by itself",
            StaleFrame => "send fresher frames; raise max_age_ms only if the arm is slow",
            BadFrame => "compare the frame with the target; the status detail has the numbers",
            LowTexture => "look at light, exposure and lens cap",
            NoDepth => "set a constant depth or a fallback_m",
            Diverging => "look at depth, camera and gain, then start",
            IterationCap => "raise the cap or start again",
            Paused => "resume",
            Stopped => "start",
            OwnerLost => "wait for the next owner, or create the task again",
            Superseded => "use the newer twist",
            DeadlineMissed => "allow more time or send smaller frames",
            Overloaded => "ask less often or use another worker",
            FrozenFrame => "restart the camera",
            Internal => "read the log of the service, set the target again, then start",
            Ready => "start",
            ClientLost => "declare the client's token, then start or resume",
            RankDeficient => "show more texture, raise the order, or free fewer degrees",
            Lost => "bring the target into view",
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl Serialize for Status {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.word())
    }
}

impl<'de> Deserialize<'de> for Status {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Status, D::Error> {
        let word = String::deserialize(deserializer)?;
        Status::from_word(&word).ok_or_else(|| D::Error::custom(format!("unknown status {word:?}: brake")))
    }
}
