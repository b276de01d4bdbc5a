//! The registrar: one thread that creates and closes tasks, one after another. What it grants is in `tenants`.

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
use crate::answers::reply_json;
use crate::board::Board;
use crate::decode::DecodeLimits;
use crate::desk::{Desk, lock};
use crate::endpoints::{Endpoints, Publications, command};
use crate::governor::Governor;
use crate::law::acceleration_limits;
use crate::lease::LeaseWatch;
use crate::mailbox::Mailbox;
use crate::metrics::Event;
use crate::outlet::Outlet;
use crate::ownership::SecretCheck;
use crate::quotas::pixels;
use crate::replica::epoch;
use crate::task::Task;
use crate::tenants::Bucket;
use crate::worker::Shared;

/// Questions that need no secret, of one task, in a second.
const PUBLIC_PER_S: usize = 50;

/// Requests to create a task that may wait.
const CREATIONS: usize = 256;
/// Tasks to be closed or taken over that may wait.
const JOBS: usize = 1024;

/// What the registrar does before it creates anything, so that neither callbacks nor compute threads have to.
pub(crate) enum Job {
    Close(TaskKey),
    /// A task that another worker has lost.
    Adopt(Box<Adoption>),
    Shutdown,
}

/// A request to create a task.
pub(crate) struct Creation {
    pub(crate) query: Query,
    pub(crate) client: Name,
}

/// The ways to the registrar: whoever asks for tasks, however often, holds up no closing and no takeover.
pub(crate) struct Jobs {
    jobs: flume::Sender<Job>,
    creations: flume::Sender<Creation>,
}

/// What the registrar takes from.
pub(crate) struct Waiting {
    jobs: flume::Receiver<Job>,
    creations: flume::Receiver<Creation>,
}

enum Next {
    Job(Job),
    Creation(Creation),
}

impl Jobs {
    pub(crate) fn new() -> (Jobs, Waiting) {
        let (jobs, waiting_jobs) = flume::bounded(JOBS);
        let (creations, waiting_creations) = flume::bounded(CREATIONS);
        (Jobs { jobs, creations }, Waiting { jobs: waiting_jobs, creations: waiting_creations })
    }

    /// Returns whether there was room.
    pub(crate) fn give(&self, job: Job) -> bool {
        self.jobs.try_send(job).is_ok()
    }

    /// Returns whether there was room.
    pub(crate) fn create(&self, creation: Creation) -> bool {
        self.creations.try_send(creation).is_ok()
    }

    /// Ends the registrar after the jobs that wait; creations are let go. Returns whether there was room.
    pub(crate) fn end(&self, limit: Duration) -> bool {
        self.jobs.send_timeout(Job::Shutdown, limit).is_ok()
    }
}

impl Waiting {
    /// The next thing to do: jobs first. `None` when nobody is left to ask.
    fn next(&self) -> Option<Next> {
        if let Ok(job) = self.jobs.try_recv() {
            return Some(Next::Job(job));
        }
        let job = |job: Result<Job, _>| job.ok().map(Next::Job);
        let creation = |creation: Result<Creation, _>| creation.ok().map(Next::Creation);
        flume::Selector::new().recv(&self.jobs, job).recv(&self.creations, creation).wait()
    }
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
    pub(crate) fn run(mut self, waiting: &Waiting) {
        while let Some(next) = waiting.next() {
            match next {
                Next::Creation(Creation { query, client }) => self.answer_create(&query, client),
                Next::Job(Job::Close(task)) => self.close(&task),
                Next::Job(Job::Adopt(adoption)) => self.adopt(*adoption),
                Next::Job(Job::Shutdown) => break,
            }
        }
        // They hold this worker, as it holds them.
        let desks = std::mem::take(&mut *lock(&self.shared.desks));
        drop(desks);
    }

    fn answer_create(&mut self, query: &Query, client: Name) {
        match self.create(query, client) {
            Ok(reply) => reply_json(query, query.key_expr().to_string(), &body::write(&reply)),
            Err(error) => self.shared.refuse(query, &error),
        }
    }

    fn create(&mut self, query: &Query, client: Name) -> Result<CreateReply, ErrorReply> {
        let (shared, asked) = (&self.shared, self.shared.now());
        shared.check_tasks(&client)?;
        shared.spent.check().map_err(|error| {
            tracing::warn!(%client, error, "no task can be created");
            self.renew_if_due();
            ErrorReply::new(ErrorCode::Quota, error)
        })?;
        let size = query.payload().map_or(0, ZBytes::len);
        if size > body::MAX_JSON_BYTES {
            let error = format!("settings may have {} bytes, got {size}", body::MAX_JSON_BYTES);
            return Err(ErrorReply::new(ErrorCode::TooLarge, error));
        }
        let settings = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        let settings = TaskSettings::from_create_body(&settings).map_err(|error| ErrorReply::from(&error))?;
        self.check_settings(&settings)?;
        let key = TaskKey { client, id: self.new_id() };
        let (epoch, secret) = (epoch::first(&shared.worker), Secret::new(rand::random()));
        let frame_secret = secret.for_frames();
        let checks = [&secret, &frame_secret].map(|secret| SecretCheck::of(secret.clone()));
        let [of_owner, of_frames] = checks;
        let task = Task::new(settings.clone(), decode_limits(shared));
        let seed = Seed { key, epoch, secret: of_owner, frame_secret: of_frames, task, stops_since: asked };
        let desk = self.open(seed)?;
        let frame_secret = Some(frame_secret);
        let reply = CreateReply { task: desk.key.clone(), epoch: desk.epoch, secret, frame_secret };
        desk.created();
        self.shared.metrics.happened(Event::TaskCreated);
        let (task, client, epoch) = (&desk.key, &desk.key.client, desk.epoch);
        tracing::info!(%task, %client, epoch, method = settings.method.word(), "created");
        Ok(reply)
    }

    /// An identifier that no other task has, whosever it is: the keys of a task are told apart by it.
    fn new_id(&self) -> Name {
        let desks = lock(&self.shared.desks);
        loop {
            let id = format!("{:016x}", rand::random::<u64>());
            let id = Name::try_from(id.as_str()).expect("hexadecimal digits are a name");
            if desks.values().all(|desk| desk.key.id != id) {
                return id;
            }
        }
    }

    /// A session that has used up many keys is left for a new one: early if there is no task, at the end if none runs. The tasks go
    /// on there as they stand.
    fn renew_if_due(&self) {
        let (spent, desks) = (&self.shared.spent, self.shared.desks());
        let may = match spent.check() {
            Ok(()) => spent.is_due() && desks.is_empty(),
            Err(_) => !desks.iter().any(|desk| runs(desk)),
        };
        if may {
            tracing::info!(
                keys = spent.count(),
                tasks = desks.len(),
                "no task runs: the session is renewed, with all its keys"
            );
            self.shared.metrics.happened(Event::SessionRenewed);
            self.shared.fence();
        }
    }

    /// Gives a task its keys, the owner's token last, if there is room for it and nobody else has it.
    fn open(&mut self, mut seed: Seed) -> Result<Arc<Desk>, ErrorReply> {
        let internal = |error: zenoh::Error| ErrorReply::new(ErrorCode::Internal, error);
        let (settings, stops_since) = (seed.task.settings().clone(), seed.stops_since);
        if self.shared.is_stopped_since(stops_since) && !seed.task.status().is_latched() {
            seed.task.latch(Status::Stopped);
        }
        let desk = Arc::new(new_desk(&self.shared, seed).map_err(internal)?);
        // Known before it can be asked, so nobody hears that there is no such task.
        self.shared.admit(&desk, &settings)?;
        // From here on callbacks see it. What they heard before, nobody has told it.
        let declared = self.check_owner(&desk.key).and_then(|()| {
            if self.shared.is_stopped_since(stops_since) && !lock(&desk.task).status().is_latched() {
                desk.request_halt(Status::Stopped);
            }
            desk.watch_lease(&settings.lease)
                .and_then(|()| Endpoints::declare(&desk, &settings.frames))
                .map_err(internal)
        });
        let endpoints = declared.inspect_err(|_| {
            lock(&self.shared.desks).remove(&desk.key.to_string());
        })?;
        self.endpoints.insert(desk.key.clone(), endpoints);
        Ok(desk)
    }

    /// Two standbys may begin to take the same task. Whoever sees the other's token here has not declared anything yet.
    fn check_owner(&self, task: &TaskKey) -> Result<(), ErrorReply> {
        let Some((epoch, worker)) = self.shared.inbox.newest_owner(task) else { return Ok(()) };
        Err(ErrorReply::new(ErrorCode::Superseded, format!("worker {worker} has the task, with epoch {epoch}")))
    }

    /// Goes on with a task that another worker has lost: at rest, with the phase and the counters it had.
    fn adopt(&mut self, adoption: Adoption) {
        let Adoption { seed, progress, lost } = adoption;
        let (task, epoch) = (seed.key.clone(), seed.epoch);
        if lock(&self.shared.desks).contains_key(&task.to_string()) {
            return;
        }
        let target_bytes = seed.task.target().map_or(0, |sent| sent.payload.len());
        let desk = match self.open(seed) {
            Ok(desk) => desk,
            Err(error) if error.code == ErrorCode::Superseded => {
                return tracing::info!(%task, %error, "not taken over");
            }
            Err(error) => return tracing::error!(%task, %error, "cannot take the task over"),
        };
        let held = desk.tenant.hold_bytes(target_bytes);
        *lock(&desk.target_bytes) = held
            .inspect_err(
                |error| tracing::warn!(%task, error, "the target of a task that was taken over is beyond the quota"),
            )
            .ok();
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
        self.shared.metrics.happened(Event::TaskTakenOver);
        let phase = lock(&desk.task).life.phase();
        tracing::info!(%task, client = %task.client, epoch, ?phase, took_ms, "took over");
    }

    fn check_settings(&self, settings: &TaskSettings) -> Result<(), ErrorReply> {
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

    fn close(&mut self, task: &TaskKey) {
        let name = task.to_string();
        // Noted first: a question that came before the end may be looked at after it.
        self.shared.closed.note(&name, self.shared.now());
        let Some(desk) = lock(&self.shared.desks).remove(&name) else { return };
        desk.closing.store(true, Ordering::Release);
        desk.publish_end();
        self.shared.states.iter().for_each(|states| states.remove(task));
        lock(&desk.outlet).halt(Some(Status::Stopped), self.shared.now());
        self.endpoints.remove(task);
        desk.forget();
        self.shared.metrics.happened(Event::TaskClosed);
        tracing::info!(%task, client = %task.client, "closed");
        self.renew_if_due();
    }
}

/// Whether frames move it, as far as the last piece of its work says.
fn runs(desk: &Desk) -> bool {
    lock(&desk.board).progress().is_some_and(|progress| progress.phase == Phase::Running)
}

/// What a task is made from.
pub(crate) struct Seed {
    pub(crate) key: TaskKey,
    pub(crate) epoch: u32,
    pub(crate) secret: SecretCheck,
    pub(crate) frame_secret: SecretCheck,
    pub(crate) task: Task,
    /// A stop for all that came later than this is this task's too: nobody else may have obeyed it.
    pub(crate) stops_since: Moment,
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
    let Seed { key, epoch, secret, frame_secret, task, .. } = seed;
    let settings = task.settings();
    let period = Duration::from_secs_f64(settings.frame_period_s);
    let governor = Governor::new(acceleration_limits(settings), task.watchdog(), period);
    let born = shared.now();
    let first = TwistMessage { epoch, valid_ms: settings.watchdog_ms(), ..TwistMessage::zero(task.status()) };
    Ok(Desk {
        twist_key: KeyExpr::try_from(shared.keys.twist(&key))?,
        publications: Publications::new(&shared.session, &shared.keys, &key)?,
        outlet: Mutex::new(Outlet::new(governor, first, command(&shared.session, &shared.keys, &key)?, born)),
        board: Mutex::new(Board::new(key.clone(), task.status(), epoch, born)),
        mailbox: Mailbox::new(shared.config.mailbox_depth, shared.config.limits.bytes_per_payload),
        frames_need_secret: AtomicBool::new(settings.frame_secret),
        pixels: AtomicU64::new(pixels(settings)),
        idle_close_s: AtomicU32::new(settings.idle_close_s),
        task: Mutex::new(task),
        secret,
        frame_secret,
        tenant: shared.tenants.of(&key.client, born),
        public: Mutex::new(Bucket::new(PUBLIC_PER_S)),
        target_bytes: Mutex::new(None),
        shared: Arc::clone(shared),
        halt: Mutex::new(None),
        halt_asked: Mutex::new(Moment::ZERO),
        lease_watch: Mutex::new(LeaseWatch::default()),
        lease: Mutex::default(),
        closing: AtomicBool::new(false),
        superseded: AtomicBool::new(false),
        leaving: AtomicBool::new(false),
        close_given: AtomicBool::new(false),
        scheduled: AtomicBool::new(false),
        key,
        epoch,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn closings_go_before_creations_and_have_room_of_their_own() {
        let mut config = zenoh::Config::default();
        config.insert_json5("scouting/multicast/enabled", "false").expect("a known key");
        config.insert_json5("listen/endpoints", "[]").expect("a known key");
        let session = zenoh::open(config).await.expect("it needs nobody");
        let queries = session.declare_queryable("test/create").await.expect("declared");
        let _answers = session.get("test/create").await.expect("asked");
        let query = queries.recv_async().await.expect("a query");
        let (jobs, waiting) = Jobs::new();
        let creation = || Creation { query: query.clone(), client: "alice".try_into().expect("a name") };
        assert_eq!((0..=CREATIONS).filter(|_| jobs.create(creation())).count(), CREATIONS);
        assert!(jobs.give(Job::Close("alice/t1".parse().expect("a task"))));
        assert!(matches!(waiting.next(), Some(Next::Job(Job::Close(_)))));
        assert!(matches!(waiting.next(), Some(Next::Creation(_))));
    }
}
