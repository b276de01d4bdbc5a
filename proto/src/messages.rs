//! The JSON bodies besides the settings: requests, answers, and what is published.
//!
//! Requests refuse unknown fields. Answers and publications are read tolerantly, so that a later service may say
//! more; what it may not do is rename or drop a field.

mod errors;
mod state;

pub use self::errors::{ErrorCode, ErrorReply};
pub use self::state::{Phase, Progress, StateMessage, TargetReference, TaskClosed, TaskProgress, TaskState};

use serde::{Deserialize, Serialize};

use crate::WIRE_VERSION;
use crate::frame::Secret;
use crate::keys::{Name, TaskKey};
use crate::settings::{Camera, Method};
use crate::status::Status;

/// The answer to `create`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CreateReply {
    /// The new task, `client/id`.
    pub task: TaskKey,
    /// The owner's epoch.
    pub epoch: u32,
    /// Who may use the task; said once, here.
    pub secret: Secret,
    /// What lets a camera push frames and do nothing else: [`Secret::for_frames`]. `None` from workers that do not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_secret: Option<Secret>,
}

/// The body of `control`: `{"do": "start"}`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(from = "ControlBody", into = "ControlBody")]
pub enum Control {
    /// Begin, or begin anew: forgets the initial image and the counters, clears any latched status.
    Start,
    /// Brake and keep everything.
    Pause,
    /// Go on after a pause or any other latched status, keeping the initial image and the counters.
    Resume,
    /// Brake until `start` or `resume`.
    Stop,
    /// End the task.
    Close,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ControlWord {
    Start,
    Pause,
    Resume,
    Stop,
    Close,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ControlBody {
    #[serde(rename = "do")]
    word: ControlWord,
}

impl From<ControlBody> for Control {
    fn from(body: ControlBody) -> Control {
        match body.word {
            ControlWord::Start => Control::Start,
            ControlWord::Pause => Control::Pause,
            ControlWord::Resume => Control::Resume,
            ControlWord::Stop => Control::Stop,
            ControlWord::Close => Control::Close,
        }
    }
}

impl From<Control> for ControlBody {
    fn from(control: Control) -> ControlBody {
        let word = match control {
            Control::Start => ControlWord::Start,
            Control::Pause => ControlWord::Pause,
            Control::Resume => ControlWord::Resume,
            Control::Stop => ControlWord::Stop,
            Control::Close => ControlWord::Close,
        };
        ControlBody { word }
    }
}

/// The answer to `control`, and to a target that was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControlReply {
    /// The status after the request.
    pub status: Status,
}

/// Frames that were not turned into a twist, by reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct FramesDropped {
    /// A newer frame came before this one's turn.
    pub superseded: u64,
    /// Undecodable, wrong size or version.
    pub bad: u64,
    /// Too old, or not newer than the one before.
    pub stale: u64,
    /// Too many requests waited, or the client sends more than it may.
    pub overloaded: u64,
    /// The deadline passed before its turn.
    pub deadline: u64,
    /// Pushed without the secret that the settings ask for.
    pub not_owner: u64,
}

/// What is published on `status`: on every change, and twice a second.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StatusMessage {
    /// The task, `client/id`.
    pub task: TaskKey,
    /// What it is doing, or why it does not move.
    pub status: Status,
    /// The status in a sentence.
    pub meaning: String,
    /// The numbers behind it, such as the sizes of a frame and its target; null if there is nothing to add.
    pub detail: Option<String>,
    /// Whether it stays until `start` or `resume`.
    pub latched: bool,
    /// The owner's epoch.
    pub epoch: u32,
    /// Frames received, requests and pushed ones.
    pub frames_in: u64,
    /// Frames that were not turned into a twist.
    pub frames_dropped: FramesDropped,
    /// Twists computed since `start`.
    pub twists: u64,
    /// Sequence of the newest frame.
    pub sequence: u64,
    /// Moment order of the newest twist; 0 = none yet.
    pub order: u16,
    /// Pixel error of the newest twist; null = none yet.
    pub pixel_mse: Option<f64>,
    /// Feature error of the newest twist, √(e·e); null = none yet.
    pub feature_error_norm: Option<f64>,
    /// How the light of the newest twist's frame differs from the target's, if it is estimated: gain (−0.3 is 30 % darker),
    /// offset, the gain's slopes along x and y, the offset's slopes; null = not estimated.
    pub light: Option<[f64; 6]>,
    /// What the constant depth is multiplied by, if it is estimated; null = not estimated.
    pub depth_scale: Option<f64>,
    /// Computation of the newest twist, µs.
    pub compute_us: u32,
    /// Since the task was created, s.
    pub uptime_s: f64,
}

impl StatusMessage {
    /// A message with the words that belong to the status, every count 0.
    pub fn new(task: TaskKey, status: Status, epoch: u32) -> StatusMessage {
        StatusMessage {
            task,
            status,
            meaning: status.meaning().to_owned(),
            detail: None,
            latched: status.is_latched(),
            epoch,
            frames_in: 0,
            frames_dropped: FramesDropped::default(),
            twists: 0,
            sequence: 0,
            order: 0,
            pixel_mse: None,
            feature_error_norm: None,
            light: None,
            depth_scale: None,
            compute_us: 0,
            uptime_s: 0.0,
        }
    }
}

/// What a worker has counted since it started. Every frame that came was answered (with a twist or with zeros), was passed over
/// for a newer one, was thrown away, was refused for want of the secret, or still waits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct WorkerCounts {
    /// Frames received, requests and pushed ones.
    pub frames_in: u64,
    /// Answers that are meant to be executed: status `servoing`.
    pub twists: u64,
    /// Answers with any other status: exact zeros.
    pub zeros: u64,
    /// Frames that were not turned into a twist.
    pub frames_dropped: FramesDropped,
    /// Queries of every kind.
    pub requests: u64,
    /// Error answers.
    pub refusals: u64,
    /// How often zeros were sent because no frame came within the watchdog time.
    pub watchdog_brakes: u64,
    /// How often a task was halted because its client's token went.
    pub clients_lost: u64,
    /// Tasks ended by a defect.
    pub panics: u64,
}

/// The answer on a worker's `info`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorkerInfo {
    /// The worker's name.
    pub worker: Name,
    /// Version of the program.
    pub version: String,
    /// Version of these bytes.
    pub wire_version: u8,
    /// Words of the methods it knows.
    pub methods: Vec<String>,
    /// Tasks it owns.
    pub tasks: u32,
    /// Tasks it can own.
    pub capacity: u32,
    /// Tasks of other workers that it keeps ready to take over.
    #[serde(default)]
    pub standby: u32,
    /// Why its state directory cannot be written now; null when it can, or when there is none.
    #[serde(default)]
    pub state_error: Option<String>,
    /// Busy share of its compute threads over the last second, 0 to 1.
    pub load: f64,
    /// Compute threads.
    pub threads: u32,
    /// Largest image, pixels.
    pub max_pixels: u64,
    /// Largest payload, bytes.
    pub max_payload_bytes: u64,
    /// What it grants besides; 0 = not limited.
    #[serde(default)]
    pub quotas: Quotas,
    /// Requests since its start that found no room even for a refusal, and ended empty.
    #[serde(default)]
    pub unanswered: u64,
    /// Since it started, s.
    pub uptime_s: f64,
    /// Clients whose liveliness token it sees.
    #[serde(default)]
    pub clients: u32,
    /// Resident memory of its process, bytes; 0 = not known.
    #[serde(default)]
    pub memory_bytes: u64,
    /// Messages that its recording had to drop.
    #[serde(default)]
    pub recorder_dropped: u64,
    /// What happened since it started.
    #[serde(default)]
    pub counts: WorkerCounts,
}

impl WorkerInfo {
    /// An idle worker of this version, with every number 0.
    pub fn new(worker: Name) -> WorkerInfo {
        WorkerInfo {
            worker,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            wire_version: WIRE_VERSION,
            methods: Method::ALL.into_iter().map(|method| method.word().to_owned()).collect(),
            tasks: 0,
            capacity: 0,
            standby: 0,
            state_error: None,
            load: 0.0,
            threads: 0,
            max_pixels: 0,
            max_payload_bytes: 0,
            quotas: Quotas::default(),
            unanswered: 0,
            uptime_s: 0.0,
            clients: 0,
            memory_bytes: 0,
            recorder_dropped: 0,
            counts: WorkerCounts::default(),
        }
    }
}

/// What a worker grants to one client and to all together, and what it grants now; 0 = not limited.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quotas {
    /// Tasks of one client.
    pub tasks_per_client: u64,
    /// Pixels of the cameras of one client's tasks.
    pub pixels_per_client: u64,
    /// Pixels of the cameras of all tasks.
    pub pixels: u64,
    /// Bytes that one client's targets and waiting messages take.
    pub bytes_per_client: u64,
    /// Bytes that all targets and waiting messages take.
    pub bytes: u64,
    /// Messages of one client that wait for their turn.
    pub waiting_per_client: u64,
    /// Messages of all clients that wait for their turn.
    pub waiting: u64,
    /// Frames of one client in a second, asked and pushed.
    pub frames_per_s_per_client: u64,
    /// Other requests of one client in a second.
    pub requests_per_s_per_client: u64,
    /// Pixels in use.
    pub pixels_used: u64,
    /// Bytes in use.
    pub bytes_used: u64,
}

/// What a camera publishes on its `info`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// The camera's name.
    pub name: Name,
    /// Its optics and size, ready for the settings of a task.
    pub camera: Camera,
    /// Time between two frames, s.
    pub frame_period_s: f64,
    /// Whether its frames have a depth plane.
    pub depth: bool,
}
