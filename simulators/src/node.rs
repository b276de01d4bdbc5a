//! A simulated camera on the network: frames out, commands in, in a Zenoh session of its own.
//!
//! Callbacks only leave what came in an inbox; one plain thread hears it, moves the camera, renders and sends.
//! Frames go with congestion control Drop, as a camera would: who cannot keep up misses some.

mod flight;
mod inbox;
mod schedule;

use std::sync::Arc;
use std::thread::JoinHandle;

use domvs_proto::body::{self, JSON};
use domvs_proto::frame::{FrameHeader, RAW};
use domvs_proto::keys::Keys;
use domvs_proto::twist::TWIST_BYTES;
use nalgebra::Isometry3;
use tokio::sync::{mpsc, watch};
use zenoh::Session;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};
use zenoh::sample::Sample;

use crate::free_camera::{BrakeReason, Motion};
use crate::motion::PoseError;
use crate::packet;
use crate::settings::{CameraSettings, CameraSettingsError, Follow};
use crate::simulation::Simulation;
use flight::{Flight, Outputs};
use inbox::{Event, Inbox};

/// Questions for the desired image that may wait.
const QUESTIONS: usize = 4;

/// Enough for 30 frames a second of 512x512; more would take cores from the service beside it.
const RENDER_THREADS: usize = 2;

/// Why a camera does not fly.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// The settings make no camera.
    #[error(transparent)]
    Settings(#[from] CameraSettingsError),
    /// Zenoh refused to open, declare or close.
    #[error("zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
    /// The operating system gave no thread.
    #[error("no thread for the camera: {0}")]
    Thread(#[from] std::io::Error),
    /// The flying thread panicked.
    #[error("the camera's thread panicked")]
    Crashed,
}

/// What only a simulator can know, and its counters; told after every move.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// How far the camera is from where it should be.
    pub error: PoseError,
    /// Where it is, `world_from_camera`.
    pub pose: Isometry3<f64>,
    /// Whether it moves, and if not, why.
    pub motion: Motion,
    /// The twist in force, m/s then rad/s.
    pub twist: [f64; 6],
    /// Pictures taken; the sequence of the last one.
    pub captured: u64,
    /// Pictures handed to Zenoh, after their latency.
    pub sent: u64,
    /// Commands taken.
    pub commands: u64,
    /// Commands refused: unreadable, not finite, of an older epoch, or too early after a stop of everything.
    pub refused: u64,
}

/// A flying camera. Dropping it lands it without waiting; [`CameraNode::stop`] waits.
#[derive(Debug)]
pub struct CameraNode {
    session: Session,
    inbox: Arc<Inbox>,
    thread: Option<JoinHandle<()>>,
    truth: watch::Receiver<Truth>,
    _commands: Option<Subscriber<()>>,
    _stop: Subscriber<()>,
    _desired: Queryable<()>,
    _alive: LivelinessToken,
}

impl CameraNode {
    /// Opens a session with `config` and flies. Fails on impossible settings and when Zenoh refuses.
    pub async fn open(config: zenoh::Config, keys: Keys, settings: CameraSettings) -> Result<CameraNode, NodeError> {
        let mut simulation = settings.simulation()?;
        simulation.scene = simulation.scene.with_threads(RENDER_THREADS);
        let target = packet::pack(&simulation.capture_desired(), settings.pixels, settings.depth, 0, 0);
        let frame_period = settings.frame_period()?;
        let session = zenoh::open(config).await?;
        let inbox = Arc::new(Inbox::default());
        let stop = listen_to_stop(&session, &keys, &inbox).await?;
        let desired = show_desired(&session, keys.camera_desired(&settings.name), target).await?;
        let commands = listen_to_commands(&session, &keys, &settings.follow, &inbox).await?;
        let first = first_truth(&simulation);
        let (truth_sender, truth) = watch::channel(first.clone());
        let outputs = Outputs {
            frames: declare_frames(&session, &keys, &settings).await?,
            info: session.declare_publisher(keys.camera_info(&settings.name)).encoding(JSON).await?,
            info_json: body::write(&settings.info()?),
            truth: truth_sender,
        };
        let alive = session.liveliness().declare_token(keys.camera_alive(&settings.name)).await?;
        let name = format!("camera {}", settings.name);
        let flight_inbox = Arc::clone(&inbox);
        let thread = std::thread::Builder::new().name(name).spawn(move || {
            Flight::new(settings, simulation, frame_period, outputs, first).run(&flight_inbox);
        })?;
        Ok(CameraNode {
            session,
            inbox,
            thread: Some(thread),
            truth,
            _commands: commands,
            _stop: stop,
            _desired: desired,
            _alive: alive,
        })
    }

    /// Where the camera really is; changes after every move and every event.
    pub fn truth(&self) -> watch::Receiver<Truth> {
        self.truth.clone()
    }

    /// Lands: stops the thread, then closes the session. Fails when the thread has panicked or Zenoh refuses.
    pub async fn stop(mut self) -> Result<(), NodeError> {
        self.inbox.close();
        let landed = match self.thread.take() {
            Some(thread) => tokio::task::spawn_blocking(move || thread.join()).await,
            None => Ok(Ok(())),
        };
        self.session.close().await?;
        if matches!(landed, Ok(Ok(()))) { Ok(()) } else { Err(NodeError::Crashed) }
    }
}

impl Drop for CameraNode {
    fn drop(&mut self) {
        self.inbox.close();
    }
}

fn first_truth(simulation: &Simulation) -> Truth {
    Truth {
        error: simulation.error(),
        pose: simulation.pose,
        motion: Motion::Braked(BrakeReason::NoCommand),
        twist: [0.0; 6],
        captured: 0,
        sent: 0,
        commands: 0,
        refused: 0,
    }
}

async fn declare_frames(
    session: &Session,
    keys: &Keys,
    settings: &CameraSettings,
) -> zenoh::Result<zenoh::pubsub::Publisher<'static>> {
    let key = settings.frame_key.clone().unwrap_or_else(|| keys.camera_frame(&settings.name));
    session.declare_publisher(key).congestion_control(CongestionControl::Drop).encoding(RAW).await
}

/// Answers whoever asks what the camera would see from where it should be.
async fn show_desired(
    session: &Session,
    key: String,
    (header, payload): (FrameHeader, Vec<u8>),
) -> zenoh::Result<Queryable<()>> {
    let (asked, mut questions) = mpsc::channel::<Query>(QUESTIONS);
    let (reply_key, header, payload) = (key.clone(), header.encode(), ZBytes::from(payload));
    tokio::spawn(async move {
        while let Some(query) = questions.recv().await {
            let reply = query.reply(&reply_key, payload.clone()).attachment(header.clone()).encoding(RAW);
            if let Err(error) = reply.await {
                tracing::debug!(%error, "nobody waits for the desired image any more");
            }
        }
    });
    // A question that finds no room is dropped: whoever asked sees an empty answer and asks again.
    let enqueue = move |query: Query| drop(asked.try_send(query));
    session.declare_queryable(key).complete(true).callback(enqueue).await
}

async fn listen_to_stop(session: &Session, keys: &Keys, inbox: &Arc<Inbox>) -> zenoh::Result<Subscriber<()>> {
    let inbox = Arc::clone(inbox);
    let leave = move |_: Sample| inbox.push(Event::StopAll);
    session.declare_subscriber(keys.stop()).callback(leave).await
}

async fn listen_to_commands(
    session: &Session,
    keys: &Keys,
    follow: &Follow,
    inbox: &Arc<Inbox>,
) -> zenoh::Result<Option<Subscriber<()>>> {
    let key = match follow {
        Follow::Nobody => return Ok(None),
        Follow::Task(task) => keys.command(task),
        Follow::Client(_) => keys.commands(),
    };
    let (inbox, keys, follow) = (Arc::clone(inbox), keys.clone(), follow.clone());
    let leave = move |sample: Sample| {
        let Some((task, _)) = keys.parse_task(sample.key_expr().as_str()) else {
            return;
        };
        if follow.includes(&task) {
            // The length first: a hostile payload is not worth a copy.
            let payload = sample.payload();
            let bytes = if payload.len() == TWIST_BYTES { payload.to_bytes().as_ref().try_into().ok() } else { None };
            inbox.push(Event::Command { task, bytes });
        }
    };
    Ok(Some(session.declare_subscriber(key).callback(leave).await?))
}
