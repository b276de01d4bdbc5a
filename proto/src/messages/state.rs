//! What workers tell each other on `state`, so that one can go on where another ended.
//!
//! Three JSON messages share the key: everything, on every change; how far it is, once a second; the end. The target itself is
//! the fourth, a frame: told by its attachment, which JSON messages do not have.

use serde::{Deserialize, Serialize};

use crate::body::{self, BodyError};
use crate::frame::SecretHash;
use crate::keys::{Name, TaskKey};
use crate::messages::FramesDropped;
use crate::settings::TaskSettings;
use crate::status::Status;

/// Which target a task has, without its pixels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TargetReference {
    /// SHA3-256 of header (without secret and deadline), length of the Encoding (u64, little-endian), Encoding and payload, in hexadecimal.
    pub hash: String,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Size of the payload, bytes.
    pub payload_bytes: u64,
}

/// What is published on every change and answered on `state`: what a standby needs, but for the target's pixels. The secret is
/// not in it; its hash is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskState {
    /// The task, `client/id`.
    pub task: TaskKey,
    /// The owner.
    pub worker: Name,
    /// The owner's epoch.
    pub epoch: u32,
    /// How often the whole has been published under this epoch.
    pub revision: u64,
    /// What tells the task's secret from any other.
    pub secret_hash: SecretHash,
    /// The same of the secret that pushed frames may carry.
    pub frame_secret_hash: SecretHash,
    /// The settings in force.
    pub settings: TaskSettings,
    /// The target; null = none set.
    pub target: Option<TargetReference>,
    /// How far it is.
    pub progress: Progress,
}

/// The small part, published once a second, and at once when a servoing ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskProgress {
    /// The task, `client/id`.
    pub task: TaskKey,
    /// The owner.
    pub worker: Name,
    /// The owner's epoch.
    pub epoch: u32,
    /// Of the whole state that this belongs to: whoever knows another one asks for it.
    pub revision: u64,
    /// How far it is.
    pub progress: Progress,
}

/// The last message: the task was closed, so nobody takes it over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskClosed {
    /// The task, `client/id`.
    pub task: TaskKey,
    /// The owner.
    pub worker: Name,
    /// The owner's epoch.
    pub epoch: u32,
    /// Always true.
    pub closed: bool,
}

/// Where a task stands, whatever its frames say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Not started.
    Idle,
    /// Started: a good frame moves the camera.
    Running,
    /// Ended or halted with this status, until `start` or `resume`.
    Latched(Status),
}

/// How far a task is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// What it is doing, or why it does not move.
    pub status: Status,
    /// Where it stands: what a new owner goes on from.
    pub phase: Phase,
    /// Twists computed since `start`.
    pub twists: u64,
    /// Frames in a row within the stop threshold.
    pub held_frames: u32,
    /// Sequence of the newest frame.
    pub sequence: u64,
    /// Pixel error of the first frame since `start`, by which divergence is judged; null = none yet.
    pub initial_pixel_mse: Option<f64>,
    /// What the adaptive order is measured against: the initial image's error as the order rule sees it; null = none yet.
    pub initial_order_mse: Option<f64>,
    /// Frames received since the task was created, by all its owners.
    pub frames_in: u64,
    /// Those that were not turned into a twist.
    pub frames_dropped: FramesDropped,
}

/// A JSON message on `state`.
#[derive(Debug, Clone, PartialEq)]
pub enum StateMessage {
    /// Everything.
    Full(Box<TaskState>),
    /// The small part.
    Progress(TaskProgress),
    /// The end.
    Closed(TaskClosed),
}

impl StateMessage {
    /// Reads any of the three, told apart by their fields.
    ///
    /// # Errors
    /// What is too large, not JSON, or none of them.
    pub fn read(bytes: &[u8]) -> Result<StateMessage, BodyError> {
        #[derive(Deserialize)]
        struct Fields {
            settings: Option<serde::de::IgnoredAny>,
            progress: Option<serde::de::IgnoredAny>,
        }
        match body::read::<Fields>(bytes)? {
            Fields { settings: Some(_), .. } => body::read(bytes).map(|state| StateMessage::Full(Box::new(state))),
            Fields { progress: Some(_), .. } => body::read(bytes).map(StateMessage::Progress),
            Fields { .. } => body::read(bytes).map(StateMessage::Closed),
        }
    }

    /// Which task, whose, and of which epoch.
    pub fn owner(&self) -> (&TaskKey, &Name, u32) {
        match self {
            StateMessage::Full(state) => (&state.task, &state.worker, state.epoch),
            StateMessage::Progress(progress) => (&progress.task, &progress.worker, progress.epoch),
            StateMessage::Closed(closed) => (&closed.task, &closed.worker, closed.epoch),
        }
    }
}
