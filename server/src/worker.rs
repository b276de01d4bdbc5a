//! One worker in one session: its own keys, its start and its end. The registrar creates and closes tasks, the
//! clock watches them, the pool computes.

use std::collections::HashMap;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use domvs_proto::keys::{Keys, Name};
use domvs_proto::messages::{ErrorCode, ErrorReply, WorkerInfo};
use domvs_proto::status::Status;
use tokio::sync::Notify;
use zenoh::Session;
use zenoh::key_expr::KeyExpr;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};

use crate::clerk::{Asker, Clerks, JustClosed, Note};
use crate::config::ServerConfig;
use crate::desk::{Desk, lock};
use crate::endpoints::{Spent, learn_listeners};
use crate::error::ServiceError;
use crate::metrics::{Asked, Dropped, Event, Metrics};
use crate::pool::Pool;
use crate::record::{RecordCounts, Recorder};
use crate::registrar::{Creation, Job, Jobs, Registrar};
use crate::replica::{self, Carried, Inbox, Listening, Standby};
use crate::state_dir::StateDir;
use crate::tenants::{Doing, Tenants};
use crate::throttle::Throttle;
use crate::{Moment, clock};

/// Frames that may wait for the disk.
const RECORDED_FRAMES: usize = 64;
/// What the last zeros get before the session ends: Zenoh sends the end of a token before any data that waits.
const HEAD_START: Duration = Duration::from_millis(20);
/// How long the threads may take to end: longer only if one hangs in a reply to a client that does not read.
const THREADS_END: Duration = Duration::from_millis(700);
/// How long the session may take to close, and meanwhile the recording and whatever else is written. With the threads' time it stays
/// under two seconds, whatever hangs.
pub(crate) const SESSION_CLOSE: Duration = Duration::from_millis(800);

/// A worker in one session. Ends with [`Worker::shutdown`]; dropped, it ends in the same order, but nobody waits for it.
pub(crate) struct Worker {
    shared: Arc<Shared>,
    _queryables: Vec<Queryable<()>>,
    _subscribers: Vec<Subscriber<()>>,
    _publishers: Vec<Publisher<'static>>,
    _listening: Listening,
    standby: JoinHandle<()>,
    clock: (mpsc::SyncSender<()>, JoinHandle<()>),
    registrar: JoinHandle<()>,
}

/// What every part of a worker may use.
pub(crate) struct Shared {
    pub(crate) worker: Name,
    pub(crate) keys: Keys,
    pub(crate) config: ServerConfig,
    pub(crate) session: Session,
    pub(crate) pool: Pool,
    pub(crate) recorder: Option<Recorder>,
    /// By `client/id`, as it stands in a key: every query is looked up here.
    pub(crate) desks: Mutex<HashMap<String, Arc<Desk>>>,
    pub(crate) tenants: Tenants,
    clerks: Clerks,
    /// Of this session's keys.
    pub(crate) spent: Spent,
    /// The tasks that were closed just now.
    pub(crate) closed: JustClosed,
    /// How many tokens of clients there are, counted only.
    clients: AtomicI64,
    jobs: Jobs,
    /// When a stop for all was last heard.
    stop_heard: Mutex<Option<Moment>>,
    /// What is heard of other workers and their tasks.
    pub(crate) inbox: Inbox,
    /// Where the tasks are kept over a restart.
    pub(crate) states: Option<Arc<StateDir>>,
    fenced: Notify,
    /// When the last act began.
    leaving_since: Mutex<Option<Moment>>,
    /// The tasks that were owned to the end.
    pub(crate) carried: Mutex<Vec<Carried>>,
    origin: Instant,
    wall_origin_ns: u64,
    /// The service's: one worker after another counts on.
    pub(crate) metrics: Arc<Metrics>,
    /// What the recordings of the workers before this one have counted.
    recorded_before: RecordCounts,
    /// Which refusals the log says.
    pub(crate) refusals: Throttle<{ ErrorCode::ALL.len() }>,
    busy_lines: Throttle<1>,
    /// When the clock last looked, nanoseconds.
    clock_looked_ns: AtomicU64,
    busy_ns: AtomicU64,
    load: AtomicU64,
}

impl Worker {
    /// Starts a worker in `session`, which it owns from now on, with what it owned in the session before.
    pub(crate) async fn start(
        config: ServerConfig,
        session: Session,
        carried: Vec<Carried>,
        states: Option<Arc<StateDir>>,
        metrics: Arc<Metrics>,
    ) -> Result<Worker, ServiceError> {
        let (jobs, waiting) = Jobs::new();
        let (inbox, news) = Inbox::new(config.replica.bytes);
        let (clerks, trays) = Clerks::new();
        let shared = Arc::new(Shared::new(config, session, jobs, clerks, inbox, states, metrics)?);
        trays.work_off(&shared)?;
        let registrar = {
            let shared = Arc::clone(&shared);
            spawn("domvs-registrar", move || Registrar::new(shared).run(&waiting))?
        };
        let (closing, closed) = mpsc::sync_channel(1);
        let clock = {
            let shared = Arc::clone(&shared);
            spawn("domvs-clock", move || {
                clock::run(&shared, &closed);
                shared.end();
            })?
        };
        let standby = {
            let standby = Standby::new(Arc::clone(&shared), carried);
            spawn("domvs-standby", move || standby.run(&news))?
        };
        let (queryables, subscribers) = declare(&shared).await?;
        let publishers = learn_listeners(&shared.session, &shared.keys).await?;
        let listening = replica::declare(&shared).await?;
        shared.metrics.show(&shared);
        tracing::info!(worker = %shared.worker, threads = shared.config.compute_threads(), "ready");
        Ok(Worker {
            shared,
            _queryables: queryables,
            _subscribers: subscribers,
            _publishers: publishers,
            _listening: listening,
            standby,
            clock: (closing, clock),
            registrar,
        })
    }

    /// Returns when a newer owner has a task of this worker, so that it must leave its session.
    pub(crate) async fn fenced(&self) {
        self.shared.fenced.notified().await;
    }

    /// Zeros for every task, then the end of the threads, then of the session and the recording, and `meanwhile` beside these. Returns the
    /// tasks that it owned to the end.
    pub(crate) async fn shutdown(self, meanwhile: impl Future<Output = ()>) -> Vec<Carried> {
        let (closing, clock) = self.clock;
        drop(closing);
        let ends = async {
            join(clock).await;
            join(self.registrar).await;
            join(self.standby).await;
        };
        if tokio::time::timeout(THREADS_END, ends).await.is_err() {
            tracing::warn!("a thread of the worker hangs in a reply; it ends with the session");
        }
        tokio::join!(self.shared.close_session(), self.shared.close_recording(), meanwhile);
        self.shared.metrics.keep_recorded(self.shared.recorded());
        tracing::info!(worker = %self.shared.worker, "stopped");
        self.shared.carried()
    }
}

impl Shared {
    fn new(
        config: ServerConfig,
        session: Session,
        jobs: Jobs,
        clerks: Clerks,
        inbox: Inbox,
        states: Option<Arc<StateDir>>,
        metrics: Arc<Metrics>,
    ) -> Result<Shared, ServiceError> {
        let worker = config.worker_name();
        let wall = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let recorder = match config.record.as_os_str().is_empty() {
            true => None,
            false => {
                let stem = format!("{worker}-{}", wall.as_millis());
                Some(Recorder::start(&config.record, &stem, worker.as_str(), RECORDED_FRAMES)?)
            }
        };
        Ok(Shared {
            keys: Keys::new(&config.prefix)?,
            pool: Pool::start(config.compute_threads())?,
            worker,
            tenants: Tenants::new(&config.limits),
            config,
            session,
            recorder,
            desks: Mutex::default(),
            clerks,
            spent: Spent::default(),
            closed: JustClosed::default(),
            clients: AtomicI64::new(0),
            jobs,
            stop_heard: Mutex::default(),
            inbox,
            states,
            fenced: Notify::new(),
            leaving_since: Mutex::default(),
            carried: Mutex::default(),
            origin: Instant::now(),
            wall_origin_ns: u64::try_from(wall.as_nanos()).unwrap_or(u64::MAX),
            recorded_before: metrics.kept_recorded(),
            metrics,
            refusals: Throttle::new(),
            busy_lines: Throttle::new(),
            clock_looked_ns: AtomicU64::new(0),
            busy_ns: AtomicU64::new(0),
            load: AtomicU64::new(0),
        })
    }

    async fn close_session(&self) {
        match tokio::time::timeout(SESSION_CLOSE, self.session.close().into_future()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the session did not close cleanly"),
            Err(_late) => tracing::warn!(limit = ?SESSION_CLOSE, "the session did not close in time"),
        }
    }

    async fn close_recording(&self) {
        let Some(recorder) = self.recorder.clone() else { return };
        // Plain waiting for a disk: on a thread of its own. Bounded by its own limit; a panic in it has been said.
        let _ = tokio::task::spawn_blocking(move || match recorder.close(SESSION_CLOSE) {
            Ok(counts) => tracing::info!(?counts, "recording finished"),
            Err(error) => tracing::error!(%error, "recording"),
        })
        .await;
    }

    /// What this service's recordings have counted.
    pub(crate) fn recorded(&self) -> RecordCounts {
        let counts = self.recorder.as_ref().map(|recorder| recorder.counts()).unwrap_or_default();
        self.recorded_before.and(&counts)
    }

    /// The clock is alive.
    pub(crate) fn clock_looks(&self, now: Moment) {
        self.clock_looked_ns.store(u64::try_from(now.as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
    }

    /// For how long the clock has not looked.
    pub(crate) fn clock_silence(&self) -> Duration {
        self.now().saturating_sub(Duration::from_nanos(self.clock_looked_ns.load(Ordering::Relaxed)))
    }

    /// Now, by the worker's clock.
    pub(crate) fn now(&self) -> Moment {
        self.origin.elapsed()
    }

    /// A moment as wall-clock time, for recordings only.
    pub(crate) fn wall_ns(&self, moment: Moment) -> u64 {
        self.wall_origin_ns.saturating_add(u64::try_from(moment.as_nanos()).unwrap_or(u64::MAX))
    }

    pub(crate) fn desks(&self) -> Vec<Arc<Desk>> {
        lock(&self.desks).values().cloned().collect()
    }

    /// Whether a key under `task` belongs to nobody here. With a wildcard somebody is gathering; silence is right then.
    fn is_unclaimed(&self, key: &KeyExpr<'_>) -> bool {
        // A standby is silent about the others' tasks: their owner, or the next one, answers.
        !key.is_wild() && !self.keys.split_task(key.as_str()).is_some_and(|(task, _)| self.is_owned(task))
    }

    /// Whether `client/id` is a task of this worker, was one just now, or is another worker's.
    pub(crate) fn is_owned(&self, task: &str) -> bool {
        lock(&self.desks).contains_key(task) || self.closed.knows(task, self.now()) || self.inbox.knows(task)
    }

    /// A newer owner has a task of this worker, or its keys are used up: it leaves its session.
    pub(crate) fn fence(&self) {
        self.fenced.notify_one();
    }

    /// Whether any client's token is there.
    pub(crate) fn hears_clients(&self) -> bool {
        self.clients.load(Ordering::Acquire) > 0
    }

    /// Stops every task that is here, and those that come while it is not known whether their owner heard this too.
    fn stop_all(&self) {
        // Noted first: whoever opens a task now looks at this after the task can be seen here.
        *lock(&self.stop_heard) = Some(self.now());
        self.desks().iter().for_each(|desk| desk.request_halt(Status::Stopped));
    }

    /// Whether a stop for all has been heard since then.
    pub(crate) fn is_stopped_since(&self, since: Moment) -> bool {
        lock(&self.stop_heard).is_some_and(|heard| heard >= since)
    }

    /// Hands a job to the registrar without waiting. One that finds no room is dropped: the clock asks again for a closing, the standby
    /// for a takeover. Returns whether there was room.
    pub(crate) fn give(&self, job: Job) -> bool {
        let given = self.jobs.give(job);
        if !given {
            self.dropped_note("a task to close or to take over");
        }
        given
    }

    /// Hands a short answer to a clerk without waiting. One that finds no room is dropped and counted: whoever asked sees an
    /// empty answer.
    pub(crate) fn note(&self, asker: Asker, note: Note) {
        let is_frame = matches!(note, Note::TwistRefused(..));
        if !self.clerks.give(asker, note) {
            if is_frame {
                self.metrics.dropped(Dropped::NoRoom);
            }
            self.dropped_note("a short answer");
        }
    }

    /// Counts what found no room; a few a second are logged.
    pub(crate) fn dropped_note(&self, what: &str) {
        self.metrics.happened(Event::RequestDropped);
        if let Some(left_out) = self.busy_lines.admit(0, self.now()) {
            let dropped = self.metrics.how_often(Event::RequestDropped);
            tracing::warn!(what, left_out, dropped, "more is asked than can be answered; dropped");
        }
    }

    pub(crate) fn add_busy(&self, busy: Duration) {
        self.busy_ns.fetch_add(u64::try_from(busy.as_nanos()).unwrap_or(0), Ordering::Relaxed);
    }

    pub(crate) fn busy(&self) -> Duration {
        Duration::from_nanos(self.busy_ns.load(Ordering::Relaxed))
    }

    pub(crate) fn set_load(&self, load: f64) {
        self.load.store(load.to_bits(), Ordering::Relaxed);
    }

    /// The clock's last act, so that a service which is only dropped ends in the same way: zeros at once, then the
    /// threads, then the last words, then the keys.
    fn end(&self) {
        *lock(&self.leaving_since) = Some(self.now());
        for desk in self.desks() {
            desk.leaving.store(true, Ordering::Release);
            // The pool may have had no time to say that a newer owner has it.
            let is_superseded = desk.superseded.load(Ordering::Acquire);
            let status = if is_superseded { Status::Superseded } else { Status::OwnerLost };
            desk.request_halt(status);
            lock(&desk.outlet).halt(Some(status), self.now());
        }
        self.pool.close();
        self.inbox.end();
        self.hand_over();
        self.desks().iter().for_each(|desk| desk.say_last_words(self.now()));
        std::thread::sleep(HEAD_START);
        if !self.jobs.end(Duration::from_millis(200)) {
            tracing::warn!("the registrar is busy; it ends with the session");
        }
    }

    /// The newest state of each task for those who take them over, and for this worker's next session.
    fn hand_over(&self) {
        for desk in self.desks() {
            if desk.superseded.load(Ordering::Acquire) || desk.closing.load(Ordering::Acquire) {
                self.states.iter().for_each(|states| states.remove(&desk.key));
                continue;
            }
            // What the pool had no time to obey, the next owner must.
            let waiting = lock(&desk.halt).take();
            let missed = waiting.filter(|status| !matches!(status, Status::OwnerLost | Status::Superseded));
            let mut task = lock(&desk.task);
            if let Some(status) = missed.or_else(|| self.stopped_while_leaving()) {
                task.latch(status);
                lock(&desk.board).say(status, None);
            }
            let state = desk.state(&task);
            desk.publish_state(&task);
            lock(&self.carried).push(Carried { state, target: task.target().cloned() });
        }
    }

    /// `Stopped`, if a stop for all came after this worker had begun to leave: no `start` has been obeyed since.
    fn stopped_while_leaving(&self) -> Option<Status> {
        let since = *lock(&self.leaving_since);
        since.filter(|since| self.is_stopped_since(*since)).map(|_| Status::Stopped)
    }

    /// What the next session goes on with, stopped if that was the last thing that this one heard.
    fn carried(&self) -> Vec<Carried> {
        let mut carried = std::mem::take(&mut *lock(&self.carried));
        if let Some(status) = self.stopped_while_leaving() {
            carried.iter_mut().for_each(|carried| carried.latch(status));
        }
        carried
    }

    pub(crate) fn info(&self) -> WorkerInfo {
        // The quotas look at the tasks too, one after the other.
        let tasks = lock(&self.desks).len() as u32;
        WorkerInfo {
            tasks,
            capacity: self.config.limits.tasks as u32,
            standby: self.inbox.records() as u32,
            state_error: self.states.as_ref().and_then(|states| states.error()),
            load: f64::from_bits(self.load.load(Ordering::Relaxed)),
            threads: self.config.compute_threads() as u32,
            max_pixels: self.config.limits.pixels_per_frame as u64,
            max_payload_bytes: self.config.limits.bytes_per_payload as u64,
            quotas: self.quotas(),
            unanswered: self.metrics.how_often(Event::RequestDropped),
            uptime_s: self.metrics.uptime().as_secs_f64(),
            clients: u32::try_from(self.clients.load(Ordering::Acquire)).unwrap_or(0),
            memory_bytes: crate::metrics::resident_bytes(),
            recorder_dropped: self.recorded().dropped.total(),
            counts: self.metrics.counts(),
            ..WorkerInfo::new(self.worker.clone())
        }
    }
}

/// The worker's own keys.
async fn declare(shared: &Arc<Shared>) -> zenoh::Result<(Vec<Queryable<()>>, Vec<Subscriber<()>>)> {
    let (session, keys, worker) = (&shared.session, &shared.keys, &shared.worker);
    let create = {
        let shared = Arc::clone(shared);
        move |query: Query| enqueue_create(&shared, query)
    };
    let info = {
        let shared = Arc::clone(shared);
        move |query: Query| {
            shared.metrics.asked(Asked::Info);
            shared.note(Asker::Stranger, Note::Info(query));
        }
    };
    let stop = {
        let shared = Arc::clone(shared);
        move |_: Sample| shared.stop_all()
    };
    let unclaimed = {
        let shared = Arc::clone(shared);
        move |query: Query| {
            // A session hands a query to all of its queryables that match, the tasks' own among them.
            if shared.is_unclaimed(query.key_expr()) {
                shared.metrics.asked(Asked::Unclaimed);
                shared.note(Asker::Stranger, Note::Unclaimed(query));
            }
        }
    };
    let clients = {
        let shared = Arc::clone(shared);
        move |sample: Sample| {
            let more = if sample.kind() == SampleKind::Put { 1 } else { -1 };
            if more > 0 {
                shared.spent.add(sample.key_expr());
            }
            shared.clients.fetch_add(more, Ordering::AcqRel);
        }
    };
    let subscribers = vec![
        session.liveliness().declare_subscriber(keys.clients_alive()).history(true).callback(clients).await?,
        session.declare_subscriber(keys.stop()).callback(stop).await?,
    ];
    let queryables = vec![
        session.declare_queryable(keys.creates(worker)).complete(true).callback(create).await?,
        // Not complete: a task's own keys are, and they win at the router. What nobody owns lands here.
        session.declare_queryable(keys.tasks()).complete(false).callback(unclaimed).await?,
        session.declare_queryable(keys.worker_info(worker)).complete(true).callback(info).await?,
    ];
    Ok((queryables, subscribers))
}

/// A name that is none, and a client that creates too fast, are told so here, and take nobody's place at the registrar.
fn enqueue_create(shared: &Shared, query: Query) {
    shared.metrics.asked(Asked::Create);
    let refuse = |query, error| shared.note(Asker::Stranger, Note::Refused(query, error));
    let Some((_, client)) = shared.keys.parse_create(query.key_expr().as_str()) else {
        let error = format!("{} has no client name of 1 to 64 of A-Z a-z 0-9 _ -", query.key_expr());
        return refuse(query, ErrorReply::new(ErrorCode::BadName, error));
    };
    let now = shared.now();
    if let Err(error) = shared.tenants.of(&client, now).may(Doing::Creation, now) {
        return refuse(query, ErrorReply::new(ErrorCode::Quota, error));
    }
    // One that finds no room is dropped: its client sees an empty answer and asks again.
    if !shared.jobs.create(Creation { query, client }) {
        shared.dropped_note("a request to create a task");
    }
}

fn spawn(name: &str, body: impl FnOnce() + Send + 'static) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new().name(name.to_owned()).spawn(body)
}

async fn join(thread: JoinHandle<()>) {
    let joined = tokio::task::spawn_blocking(move || thread.join().is_ok()).await;
    if !matches!(joined, Ok(true)) {
        tracing::error!("a thread of the worker ended by a panic");
    }
}

#[cfg(test)]
mod tests;
