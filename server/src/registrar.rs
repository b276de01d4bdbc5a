//! The registrar: one thread that creates and closes tasks, one after another, and gives the answers that neither
//! callbacks nor compute threads have time for.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::frame::Secret;
use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::{CreateReply, ErrorCode, ErrorReply};
use domvs_proto::settings::{Frames, TaskSettings};
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::query::Query;

use crate::answers::reply_json;
use crate::board::Board;
use crate::decode::DecodeLimits;
use crate::desk::{Desk, LeaseWatch, lock};
use crate::endpoints::{Endpoints, Publications, command};
use crate::governor::Governor;
use crate::law::acceleration_limits;
use crate::mailbox::Mailbox;
use crate::metrics::Event;
use crate::outlet::Outlet;
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
                Job::Refused(query, error) => self.shared.refuse(&query, &error),
                Job::TwistRefused(desk, query, status) => desk.refuse_twist(&query, status),
                Job::Close(task) => self.close(&task),
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
            Err(error) => self.shared.refuse(query, &error),
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
        let desk = Arc::new(new_desk(shared, client, &settings).map_err(internal)?);
        // Known before it can be asked, so nobody hears that there is no such task.
        lock(&shared.desks).insert(desk.key.to_string(), Arc::clone(&desk));
        let endpoints = Endpoints::declare(&desk, &settings.frames).map_err(|error| {
            lock(&shared.desks).remove(&desk.key.to_string());
            internal(error)
        })?;
        let reply = CreateReply { task: desk.key.clone(), epoch: desk.epoch, secret: desk.secret.clone() };
        self.endpoints.insert(desk.key.clone(), endpoints);
        desk.created();
        shared.metrics.happened(Event::TaskCreated);
        let (task, client, epoch) = (&desk.key, &desk.key.client, desk.epoch);
        tracing::info!(%task, %client, epoch, method = settings.method.word(), "created");
        Ok(reply)
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
                self.shared.refuse(query, &ErrorReply::new(ErrorCode::UnknownTask, error));
            }
            None => {
                let error = format!("{key} is not a key of a task");
                self.shared.refuse(query, &ErrorReply::new(ErrorCode::BadName, error));
            }
        }
    }

    fn close(&mut self, task: &TaskKey) {
        let Some(desk) = lock(&self.shared.desks).remove(&task.to_string()) else { return };
        desk.closing.store(true, Ordering::Release);
        lock(&desk.outlet).halt(Some(Status::Stopped), self.shared.now());
        self.endpoints.remove(task);
        self.shared.metrics.happened(Event::TaskClosed);
        tracing::info!(%task, client = %task.client, "closed");
    }
}

fn new_desk(shared: &Arc<Shared>, client: Name, settings: &TaskSettings) -> zenoh::Result<Desk> {
    let id = format!("{:08x}", rand::random::<u32>());
    let key = TaskKey { client, id: Name::try_from(id.as_str()).expect("hexadecimal digits are a name") };
    let limits = DecodeLimits {
        max_pixels: shared.config.limits.pixels_per_frame as u64,
        max_bytes: shared.config.limits.bytes_per_payload,
    };
    let task = Task::new(settings.clone(), limits);
    let period = Duration::from_secs_f64(settings.frame_period_s);
    let governor = Governor::new(acceleration_limits(settings), task.watchdog(), period);
    let (epoch, born) = (epoch(&shared.worker), shared.now());
    let first = TwistMessage { epoch, valid_ms: settings.watchdog_ms(), ..TwistMessage::zero(task.status()) };
    Ok(Desk {
        twist_key: KeyExpr::try_from(shared.keys.twist(&key))?,
        publications: Publications::declare(&shared.session, &shared.keys, &key)?,
        outlet: Mutex::new(Outlet::new(governor, first, command(&shared.session, &shared.keys, &key)?)),
        board: Mutex::new(Board::new(key.clone(), epoch, born)),
        mailbox: Mailbox::new(shared.config.mailbox_depth, shared.config.limits.bytes_per_payload),
        task: Mutex::new(task),
        secret: Secret::new(rand::random()),
        shared: Arc::clone(shared),
        halt: Mutex::new(None),
        lease_watch: Mutex::new(LeaseWatch::default()),
        lease: settings.lease,
        idle_close_s: AtomicU32::new(settings.idle_close_s),
        closing: AtomicBool::new(false),
        close_given: AtomicBool::new(false),
        scheduled: AtomicBool::new(false),
        key,
        epoch,
        born,
    })
}

/// Generation 1 and 16 bits of the worker's name (FNV-1a, folded): two workers hardly ever share an epoch.
fn epoch(worker: &Name) -> u32 {
    let hash =
        worker.as_str().bytes().fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    1 << 16 | (hash >> 16 ^ hash) & 0xffff
}
