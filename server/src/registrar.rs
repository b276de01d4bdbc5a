//! The registrar: one thread that creates and closes tasks, one after another, and gives the answers that neither
//! callbacks nor compute threads have time for.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::frame::Secret;
use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::{CreateReply, ErrorCode, ErrorReply, Phase, Progress};
use domvs_proto::settings::{Frames, TaskSettings};
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::query::Query;

use crate::Moment;
use crate::answers::{reply_error, reply_json};
use crate::board::Board;
use crate::decode::DecodeLimits;
use crate::desk::{Desk, LeaseWatch, lock};
use crate::endpoints::{Endpoints, Publications, command};
use crate::governor::Governor;
use crate::law::acceleration_limits;
use crate::mailbox::Mailbox;
use crate::outlet::Outlet;
use crate::ownership::SecretCheck;
use crate::replica::epoch;
use crate::task::Task;
use crate::worker::Shared;

/// What the registrar does, so that neither callbacks nor compute threads have to.
pub(crate) enum Job {
    Create(Query),
    Info(Query),
    /// A query on a task's key that no task of this worker answers.
    Unclaimed(Query),
    /// An order that nobody will obey.
    Refused(Query, ErrorReply),
    TwistRefused(Arc<Desk>, Query, Status),
    Close(TaskKey),
    /// A task that another worker has lost.
    Adopt(Box<Adoption>),
    Shutdown,
}

/// Creates and closes tasks, one after another, on a thread of its own.
pub(crate) struct Registrar {
    shared: Arc<Shared>,
    endpoints: HashMap<TaskKey, Endpoints>,
}

impl Registrar {
    pub(crate) fn new(shared: Arc<Shared>) -> Registrar {
        Registrar { shared, endpoints: HashMap::new() }
    }

    /// Works until it is told to stop.
    pub(crate) fn run(mut self, jobs: &flume::Receiver<Job>) {
        while let Ok(job) = jobs.recv() {
            match job {
                Job::Create(query) => self.answer_create(&query),
                Job::Info(query) => {
                    let key = self.shared.keys.worker_info(&self.shared.worker);
                    reply_json(&query, key, &body::write(&self.shared.info()));
                }
                Job::Unclaimed(query) => self.answer_unclaimed(&query),
                Job::Refused(query, error) => reply_error(&query, &error),
                Job::TwistRefused(desk, query, status) => desk.refuse_twist(&query, status),
                Job::Close(task) => self.close(&task),
                Job::Adopt(adoption) => self.adopt(*adoption),
                Job::Shutdown => break,
            }
        }
        // They hold this worker, as it holds them.
        let desks = std::mem::take(&mut *lock(&self.shared.desks));
        drop(desks);
    }

    fn answer_create(&mut self, query: &Query) {
        match self.create(query) {
            Ok(reply) => reply_json(query, query.key_expr().to_string(), &body::write(&reply)),
            Err(error) => reply_error(query, &error),
        }
    }

    fn create(&mut self, query: &Query) -> Result<CreateReply, ErrorReply> {
        let shared = &self.shared;
        let bad_name = || {
            let error = format!("{} has no client name of 1 to 64 of A-Z a-z 0-9 _ -", query.key_expr());
            ErrorReply::new(ErrorCode::BadName, error)
        };
        let (_, client) = shared.keys.parse_create(query.key_expr().as_str()).ok_or_else(bad_name)?;
        self.check_quota(&client)?;
        let size = query.payload().map_or(0, ZBytes::len);
        if size > body::MAX_JSON_BYTES {
            let error = format!("settings may have {} bytes, got {size}", body::MAX_JSON_BYTES);
            return Err(ErrorReply::new(ErrorCode::TooLarge, error));
        }
        let settings = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        let settings = TaskSettings::from_create_body(&settings).map_err(|error| ErrorReply::from(&error))?;
        self.check_settings(&settings)?;
        let internal = |error: zenoh::Error| ErrorReply::new(ErrorCode::Internal, error);
        let id = format!("{:08x}", rand::random::<u32>());
        let key = TaskKey { client, id: Name::try_from(id.as_str()).expect("hexadecimal digits are a name") };
        let (epoch, secret) = (epoch::first(&shared.worker), Secret::new(rand::random()));
        let task = Task::new(settings.clone(), decode_limits(shared));
        let desk = Seed { key, epoch, secret: SecretCheck::of(secret.clone()), task };
        let desk = self.open(desk).map_err(internal)?;
        let reply = CreateReply { task: desk.key.clone(), epoch: desk.epoch, secret };
        desk.created();
        tracing::info!(task = %desk.key, method = settings.method.word(), "created");
        Ok(reply)
    }

    /// Gives a task its keys, the owner's token last.
    fn open(&mut self, seed: Seed) -> zenoh::Result<Arc<Desk>> {
        let frames = seed.task.settings().frames.clone();
        let desk = Arc::new(new_desk(&self.shared, seed)?);
        // Known before it can be asked, so nobody hears that there is no such task.
        lock(&self.shared.desks).insert(desk.key.to_string(), Arc::clone(&desk));
        let endpoints = Endpoints::declare(&desk, &frames).inspect_err(|_| {
            lock(&self.shared.desks).remove(&desk.key.to_string());
        })?;
        self.endpoints.insert(desk.key.clone(), endpoints);
        Ok(desk)
    }

    /// Goes on with a task that another worker has lost: at rest, with the phase and the counters it had.
    fn adopt(&mut self, adoption: Adoption) {
        let Adoption { seed, progress, lost } = adoption;
        let (task, epoch) = (seed.key.clone(), seed.epoch);
        if lock(&self.shared.desks).contains_key(&task.to_string()) {
            return;
        }
        let desk = match self.open(seed) {
            Ok(desk) => desk,
            Err(error) => return tracing::error!(%task, %error, "cannot take the task over"),
        };
        let now = self.shared.now();
        let mut board = lock(&desk.board);
        board.go_on(&progress);
        drop(board);
        if progress.phase == Phase::Latched(Status::ClientLost) {
            // It must be taken up again, or it is closed after the grace.
            lock(&desk.lease_watch).gone_since = Some(now);
        }
        desk.created();
        let took_ms = now.saturating_sub(lost).as_millis() as u64;
        tracing::info!(%task, epoch, phase = ?progress.phase, took_ms, "took over");
    }

    fn check_quota(&self, client: &Name) -> Result<(), ErrorReply> {
        let desks = lock(&self.shared.desks);
        let limits = &self.shared.config.limits;
        let of_client = desks.values().filter(|desk| desk.key.client == *client).count();
        let quota = |what: &str, limit: usize| {
            Err(ErrorReply::new(ErrorCode::Quota, format!("{what} may have {limit} tasks, and has them")))
        };
        if desks.len() >= limits.tasks {
            return quota("this worker", limits.tasks);
        }
        if of_client >= limits.tasks_per_client {
            return quota(&format!("client {client}"), limits.tasks_per_client);
        }
        Ok(())
    }

    fn check_settings(&self, settings: &TaskSettings) -> Result<(), ErrorReply> {
        let limit = self.shared.config.limits.pixels_per_frame as u64;
        let pixels = u64::from(settings.camera.width) * u64::from(settings.camera.height);
        if pixels > limit {
            return Err(ErrorReply::new(
                ErrorCode::Quota,
                format!("an image may have {limit} pixels, the camera has {pixels}"),
            ));
        }
        if let Frames::Key(key) = &settings.frames {
            self.check_frame_key(key).map_err(|error| ErrorReply::new(ErrorCode::BadSettings, error))?;
        }
        Ok(())
    }

    /// A camera's key: one that Zenoh takes, and none on which a task itself speaks or listens.
    fn check_frame_key(&self, key: &str) -> Result<(), String> {
        let key = KeyExpr::new(key).map_err(|error| format!("frames.key: {error}"))?;
        let tasks = KeyExpr::new(self.shared.keys.tasks()).map_err(|error| error.to_string())?;
        if key.intersects(&tasks) {
            return Err(format!("frames.key must be a camera's key, not one under {tasks}, got {key}"));
        }
        Ok(())
    }

    /// A task's key that no task answers.
    fn answer_unclaimed(&self, query: &Query) {
        let key = query.key_expr();
        match self.shared.keys.parse_task(key.as_str()) {
            Some((task, _)) => {
                let error = format!("there is no task {task}; it may have been closed");
                reply_error(query, &ErrorReply::new(ErrorCode::UnknownTask, error));
            }
            None => reply_error(query, &ErrorReply::new(ErrorCode::BadName, format!("{key} is not a key of a task"))),
        }
    }

    fn close(&mut self, task: &TaskKey) {
        let Some(desk) = lock(&self.shared.desks).remove(&task.to_string()) else { return };
        desk.closing.store(true, Ordering::Release);
        desk.publish_end();
        self.shared.states.iter().for_each(|states| states.remove(task));
        lock(&desk.outlet).halt(Some(Status::Stopped), self.shared.now());
        self.endpoints.remove(task);
        tracing::info!(%task, "closed");
    }
}

/// What a task is made from.
pub(crate) struct Seed {
    pub(crate) key: TaskKey,
    pub(crate) epoch: u32,
    pub(crate) secret: SecretCheck,
    pub(crate) task: Task,
}

/// A task that another worker has lost, ready to be opened here.
pub(crate) struct Adoption {
    pub(crate) seed: Seed,
    /// How far it was.
    pub(crate) progress: Progress,
    /// When it was lost.
    pub(crate) lost: Moment,
}

/// What a worker decodes at most.
pub(crate) fn decode_limits(shared: &Shared) -> DecodeLimits {
    let limits = &shared.config.limits;
    DecodeLimits { max_pixels: limits.pixels_per_frame as u64, max_bytes: limits.bytes_per_payload }
}

fn new_desk(shared: &Arc<Shared>, seed: Seed) -> zenoh::Result<Desk> {
    let Seed { key, epoch, secret, task } = seed;
    let settings = task.settings();
    let period = Duration::from_secs_f64(settings.frame_period_s);
    let governor = Governor::new(acceleration_limits(settings), task.watchdog(), period);
    let born = shared.now();
    let first = TwistMessage { epoch, valid_ms: settings.watchdog_ms(), ..TwistMessage::zero(task.status()) };
    Ok(Desk {
        twist_key: KeyExpr::try_from(shared.keys.twist(&key))?,
        publications: Publications::declare(&shared.session, &shared.keys, &key)?,
        outlet: Mutex::new(Outlet::new(governor, first, command(&shared.session, &shared.keys, &key)?)),
        board: Mutex::new(Board::new(key.clone(), task.status(), epoch, born)),
        mailbox: Mailbox::new(shared.config.mailbox_depth, shared.config.limits.bytes_per_payload),
        lease: settings.lease,
        idle_close_s: AtomicU32::new(settings.idle_close_s),
        task: Mutex::new(task),
        secret,
        shared: Arc::clone(shared),
        halt: Mutex::new(None),
        lease_watch: Mutex::new(LeaseWatch::default()),
        closing: AtomicBool::new(false),
        revision: AtomicU64::new(0),
        superseded: AtomicBool::new(false),
        leaving: AtomicBool::new(false),
        close_given: AtomicBool::new(false),
        scheduled: AtomicBool::new(false),
        key,
        epoch,
        born,
    })
}
