//! The flying thread: hear, move, look, send. No async code runs here, and no image is made anywhere else.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use domvs_proto::keys::TaskKey;
use domvs_proto::twist::{TWIST_BYTES, TwistMessage};
use tokio::sync::watch;
use zenoh::Wait;
use zenoh::pubsub::Publisher;

use super::Truth;
use super::inbox::{Event, Inbox, Taken};
use super::schedule::Schedule;
use crate::free_camera::{BrakeReason, FreeCamera, Motion};
use crate::motion;
use crate::packet;
use crate::scene::Rendering;
use crate::settings::CameraSettings;
use crate::simulation::Simulation;

/// How often the camera says what it is: a late listener waits no longer.
const INFO_PERIOD: Duration = Duration::from_secs(1);

/// Where a flight puts what it makes.
pub(super) struct Outputs {
    pub(super) frames: Publisher<'static>,
    pub(super) info: Publisher<'static>,
    pub(super) info_json: Vec<u8>,
    pub(super) truth: watch::Sender<Truth>,
}

/// A frame that waits for its latency to pass.
struct Delayed {
    due: Instant,
    header: Vec<u8>,
    payload: Vec<u8>,
}

pub(super) struct Flight {
    settings: CameraSettings,
    simulation: Simulation,
    camera: FreeCamera,
    /// Whose commands hold.
    owner: Option<TaskKey>,
    schedule: Schedule,
    info_schedule: Schedule,
    rendering: Rendering,
    /// As many frames as fit into the latency, which the settings bound.
    in_transit: VecDeque<Delayed>,
    outputs: Outputs,
    truth: Truth,
}

impl Flight {
    pub(super) fn new(
        settings: CameraSettings,
        simulation: Simulation,
        frame_period: Duration,
        outputs: Outputs,
        truth: Truth,
    ) -> Flight {
        let now = Instant::now();
        Flight {
            camera: FreeCamera::new(simulation.pose, settings.patience, now),
            owner: None,
            schedule: Schedule::new(now, frame_period),
            info_schedule: Schedule::new(now, INFO_PERIOD),
            rendering: simulation.scene.render(&simulation.camera, &simulation.pose),
            in_transit: VecDeque::new(),
            settings,
            simulation,
            outputs,
            truth,
        }
    }

    /// Flies until the inbox closes.
    pub(super) fn run(mut self, inbox: &Arc<Inbox>) {
        while let Some(Taken { events, now }) = inbox.take_until(self.next_due()) {
            for (received, event) in events {
                self.hear(event, received);
            }
            self.camera.advance(now);
            if self.schedule.take(now) {
                self.look(now);
            }
            self.send_due(Instant::now());
            self.tell_truth();
        }
        self.camera.stop_all(Instant::now());
        self.tell_truth();
    }

    fn next_due(&self) -> Instant {
        let frame = self.in_transit.front().map_or(self.schedule.due(), |front| front.due.min(self.schedule.due()));
        frame.min(self.info_schedule.due())
    }

    fn hear(&mut self, event: Event, received: Instant) {
        match event {
            Event::StopAll => self.camera.stop_all(received),
            Event::Command { task, bytes } => self.command(task, bytes, received),
        }
    }

    fn command(&mut self, task: TaskKey, bytes: Option<[u8; TWIST_BYTES]>, received: Instant) {
        self.camera.advance(received);
        let message = bytes.ok_or(None).and_then(|bytes| TwistMessage::decode(&bytes).map_err(Some));
        if self.owner.as_ref() != Some(&task) {
            let asks_to_move = message.as_ref().is_ok_and(TwistMessage::is_servoing);
            if self.owner.is_some() && !self.may_change_hands(asks_to_move) {
                return;
            }
            tracing::info!(camera = %self.settings.name, task = %task, "follows a task");
            self.owner = Some(task);
            self.camera.change_owner();
        }
        match message {
            Ok(message) => match self.camera.command(&message, received) {
                Ok(()) => self.truth.commands += 1,
                Err(refused) => self.refuse(&refused),
            },
            Err(Some(unreadable)) => {
                self.camera.untrusted(received);
                self.refuse(&unreadable);
            }
            Err(None) => {
                self.camera.untrusted(received);
                self.refuse(&format_args!("expected {TWIST_BYTES} bytes"));
            }
        }
    }

    /// A camera in motion keeps its owner; one that stands goes to who asks it to move, and after a stop of
    /// everything to who first shows that it has stopped.
    fn may_change_hands(&self, asks_to_move: bool) -> bool {
        match self.camera.motion() {
            Motion::Moving => false,
            Motion::Braked(reason) => asks_to_move || reason == BrakeReason::StopAll,
        }
    }

    fn refuse(&mut self, why: &dyn std::fmt::Display) {
        self.truth.refused += 1;
        tracing::warn!(camera = %self.settings.name, %why, "a command is refused");
    }

    /// Takes a picture from where the camera is and sends it on its way.
    fn look(&mut self, now: Instant) {
        let pose = *self.camera.pose();
        let capture_time_ns = unix_time_ns();
        self.simulation.capture_from(&pose, &mut self.rendering);
        let sequence = self.truth.captured + 1;
        let (header, payload) =
            packet::pack(&self.rendering, self.settings.pixels, self.settings.depth, sequence, capture_time_ns);
        let due = now + self.settings.disturbance.latency;
        self.in_transit.push_back(Delayed { due, header: header.encode(), payload });
        self.truth.captured = sequence;
    }

    fn send_due(&mut self, now: Instant) {
        let due = self.in_transit.iter().take_while(|frame| frame.due <= now).count();
        for frame in self.in_transit.drain(..due) {
            match self.outputs.frames.put(frame.payload).attachment(frame.header).wait() {
                Ok(()) => self.truth.sent += 1,
                Err(error) => {
                    tracing::warn!(camera = %self.settings.name, %error, "a frame cannot be sent")
                }
            }
        }
        if self.info_schedule.take(now)
            && let Err(error) = self.outputs.info.put(self.outputs.info_json.clone()).wait()
        {
            tracing::warn!(camera = %self.settings.name, %error, "the camera's info cannot be sent");
        }
    }

    fn tell_truth(&mut self) {
        self.truth.pose = *self.camera.pose();
        self.truth.error = motion::pose_error(&self.simulation.desired, self.camera.pose());
        self.truth.motion = self.camera.motion();
        self.truth.twist = self.camera.twist();
        self.outputs.truth.send_replace(self.truth.clone());
    }
}

/// The sender's clock of the protocol; 0, unknown, on a clock before 1970.
fn unix_time_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(0)
}
