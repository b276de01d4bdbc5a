//! One task: set its target, start it, send it frames, get twists.
//!
//! Every call has a limit, and no call repeats an old twist: what does not come in time is an error, and an error means brake.

mod asking;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicU32;
use std::time::Duration;

use domvs_proto::frame::Secret;
use domvs_proto::keys::TaskKey;
use domvs_proto::messages::{Control, ControlReply, TaskState};
use domvs_proto::settings::TaskSettings;
use domvs_proto::status::Status;
use serde_json::{Value, json};
use tokio::time::{Instant, sleep};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Querier, QueryTarget};

use crate::answer::Request;
use crate::client::Shared;
use crate::follow::{Commands, Epoch, Statuses};
use crate::frame::{OutgoingFrame, ReceivedFrame};
use crate::{ClientError, matching};

/// How long the service may take to see the token that a task is hung on anew.
const TAKEN_UP: Duration = Duration::from_secs(1);
/// The pause before it is asked again.
const TAKE_UP_PAUSE: Duration = Duration::from_millis(20);

/// What a handle is made of.
pub(crate) struct NewTask {
    pub(crate) shared: Arc<Shared>,
    pub(crate) key: TaskKey,
    pub(crate) epoch: u32,
    pub(crate) secret: Option<Secret>,
}

/// A handle on a task.
///
/// Dropping it sends nothing: the task goes on until it is closed, or until the client's lease ends (the last [`crate::Client`]
/// clone and task handle dropped, or the process gone), after which the service halts it and closes it after a grace time.
/// [`Task::close`] ends it at once.
pub struct Task {
    shared: Arc<Shared>,
    key: TaskKey,
    secret: Option<Secret>,
    /// Made of the secret.
    frame_secret: Option<Secret>,
    epoch: Epoch,
    misses: AtomicU32,
    asker: Querier<'static>,
    pusher: Publisher<'static>,
}

impl fmt::Debug for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Task").field("key", &self.key).field("epoch", &self.epoch.get()).finish_non_exhaustive()
    }
}

impl Task {
    /// Declares what is used for every frame, and waits (within the request timeout) until the owner's side is known.
    pub(crate) async fn open(new: NewTask) -> Result<Task, ClientError> {
        let NewTask { shared, key, epoch, secret } = new;
        let (twist, frame) = (shared.keys.twist(&key), shared.keys.frame(&key));
        let asker = shared
            .session
            .declare_querier(twist.clone())
            .target(QueryTarget::BestMatching)
            .consolidation(ConsolidationMode::None)
            .timeout(shared.options.twist_timeout)
            .priority(Priority::RealTime)
            .express(true)
            .await
            .map_err(ClientError::session("declaring questions", &twist))?;
        let pusher = shared
            .session
            .declare_publisher(frame.clone())
            .congestion_control(CongestionControl::Drop)
            .await
            .map_err(ClientError::session("declaring frames", &frame))?;
        if !matching::has_queryable(&asker, shared.options.request_timeout).await? {
            tracing::warn!(key = %twist, "nobody answers here yet");
        }
        let frame_secret = secret.as_ref().map(Secret::for_frames);
        let (epoch, misses) = (Epoch::new(epoch), AtomicU32::new(0));
        Ok(Task { shared, key, secret, frame_secret, epoch, misses, asker, pusher })
    }

    /// Which task.
    pub fn key(&self) -> &TaskKey {
        &self.key
    }

    /// What lets another process control this task; `None` when it was attached to without.
    pub fn secret(&self) -> Option<&Secret> {
        self.secret.as_ref()
    }

    /// The newest epoch seen: it grows when another worker takes the task over.
    pub fn epoch(&self) -> u32 {
        self.epoch.get()
    }

    /// Sets the desired image and its depth. The task is `ready` then; nothing moves before [`Task::start`].
    ///
    /// # Errors
    /// [`ClientError::Refused`] with the numbers when the target cannot be used, [`ClientError::NoAnswer`].
    pub async fn set_target(&self, frame: &OutgoingFrame) -> Result<Status, ClientError> {
        let mut request = self.empty_request(self.shared.keys.target(&self.key));
        request.payload = frame.payload().clone();
        request.encoding = frame.encoding().clone();
        request.attachment = Some(frame.attachment(self.secret.as_ref(), 0));
        let ControlReply { status } = request.ask_json().await?;
        Ok(status)
    }

    /// The target as it was set.
    ///
    /// # Errors
    /// [`ClientError::Refused`] when there is none yet, [`ClientError::NoAnswer`].
    pub async fn target(&self) -> Result<ReceivedFrame, ClientError> {
        let request = self.empty_request(self.shared.keys.target(&self.key));
        ReceivedFrame::from_sample(&request.key, &request.ask().await?)
    }

    /// Lets twists move the camera, from the beginning: counters and the initial image are reset. A task whose client has
    /// gone is taken up, if it is this client's: it then hangs on this process.
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn start(&self) -> Result<Status, ClientError> {
        self.control(Control::Start).await
    }

    /// Brakes until [`Task::resume`].
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn pause(&self) -> Result<Status, ClientError> {
        self.control(Control::Pause).await
    }

    /// Goes on after a pause or any other latched status, where it was.
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn resume(&self) -> Result<Status, ClientError> {
        self.control(Control::Resume).await
    }

    /// Brakes until [`Task::start`] or [`Task::resume`].
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn stop(&self) -> Result<Status, ClientError> {
        self.control(Control::Stop).await
    }

    /// Ends the task now.
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn close(self) -> Result<Status, ClientError> {
        self.control(Control::Close).await
    }

    /// The settings in force, defaults filled in.
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn settings(&self) -> Result<TaskSettings, ClientError> {
        self.ask_settings(self.empty_request(self.shared.keys.settings(&self.key))).await
    }

    /// Changes settings by a JSON merge patch (RFC 7396; null = the default). Gives those in force afterwards.
    ///
    /// # Errors
    /// [`ClientError::Refused`] with the setting and its range, [`ClientError::NoAnswer`].
    pub async fn change_settings(&self, patch: &Value) -> Result<TaskSettings, ClientError> {
        self.ask_settings(self.json_request(self.shared.keys.settings(&self.key), patch)).await
    }

    /// What a standby would need: owner, settings, which target, how far it got.
    ///
    /// # Errors
    /// [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn state(&self) -> Result<TaskState, ClientError> {
        let state: TaskState = self.empty_request(self.shared.keys.state(&self.key)).ask_json().await?;
        match self.epoch.admit(state.epoch) {
            Ok(()) => Ok(state),
            Err(newest) => Err(Task::older_epoch(&self.shared.keys.state(&self.key), newest, state.epoch)),
        }
    }

    /// Publishes a frame; its twist comes on [`Task::commands`]. On a congested link the frame is dropped, not queued.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn push(&self, frame: &OutgoingFrame) -> Result<(), ClientError> {
        self.pusher
            .put(frame.payload().clone())
            .encoding(frame.encoding().clone())
            // Everybody may read this key, so the secret stays out; this one lets nobody do more than push.
            .attachment(frame.attachment(self.frame_secret.as_ref(), 0))
            .await
            .map_err(ClientError::session("pushing a frame", self.pusher.key_expr().as_str()))
    }

    /// The twists for pushed frames.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn commands(&self) -> Result<Commands, ClientError> {
        Commands::follow(&self.shared.session, self.shared.keys.command(&self.key), self.epoch.clone()).await
    }

    /// What the task says about itself: on every change, and twice a second.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn statuses(&self) -> Result<Statuses, ClientError> {
        let key = self.shared.keys.status(&self.key);
        Statuses::follow(&self.shared.session, key, Some(self.epoch.clone())).await
    }

    fn older_epoch(key: &str, expected: u32, got: u32) -> ClientError {
        ClientError::OlderEpoch { key: key.to_owned(), expected, got }
    }

    async fn ask_settings(&self, request: Request<'_>) -> Result<TaskSettings, ClientError> {
        let settings: Value = request.ask_json().await?;
        TaskSettings::from_json(&settings).map_err(|error| ClientError::bad_answer(&request.key)(&error))
    }

    async fn control(&self, control: Control) -> Result<Status, ClientError> {
        let status = self.ask_control(control).await?;
        let ours = self.secret.is_some() && self.key.client == self.shared.options.name;
        match control {
            Control::Start | Control::Resume if status == Status::ClientLost && ours => self.take_up(control).await,
            _ => Ok(status),
        }
    }

    /// Hangs a task of this client, whose process has gone, on this process; its token is seen a moment later.
    async fn take_up(&self, control: Control) -> Result<Status, ClientError> {
        let deadline = Instant::now() + self.shared.options.request_timeout.min(TAKEN_UP);
        self.change_settings(&json!({ "lease": { "process": self.shared.process } })).await?;
        loop {
            let status = self.ask_control(control).await?;
            if status != Status::ClientLost || Instant::now() >= deadline {
                return Ok(status);
            }
            sleep(TAKE_UP_PAUSE).await;
        }
    }

    async fn ask_control(&self, control: Control) -> Result<Status, ClientError> {
        let request = self.json_request(self.shared.keys.control(&self.key), &control);
        let ControlReply { status } = request.ask_json().await?;
        Ok(status)
    }

    fn empty_request(&self, key: String) -> Request<'_> {
        self.with_secret(Request::empty(&self.shared.session, key, self.shared.options.request_timeout))
    }

    fn json_request(&self, key: String, message: &impl serde::Serialize) -> Request<'_> {
        self.with_secret(Request::json(&self.shared.session, key, message, self.shared.options.request_timeout))
    }

    fn with_secret<'a>(&self, request: Request<'a>) -> Request<'a> {
        let attachment = self.secret.as_ref().map(|secret| secret.as_bytes().into());
        Request { attachment, ..request }
    }
}
