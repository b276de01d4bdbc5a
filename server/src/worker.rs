//! One worker: its session, its own keys, its start and its end. The registrar creates and closes tasks, the
//! clock watches them, the pool computes.

use std::collections::{HashMap, HashSet};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use domvs_proto::keys::{Keys, Name};
use domvs_proto::messages::{ErrorCode, WorkerInfo};
use domvs_proto::status::Status;
use zenoh::Session;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};

use crate::config::ServerConfig;
use crate::desk::{Desk, lock};
use crate::metrics::{Asked, Event, Metrics, MetricsEndpoint};
use crate::pool::Pool;
use crate::record::{RecordError, Recorder};
use crate::registrar::{Job, Registrar};
use crate::throttle::Throttle;
use crate::{Moment, clock};

/// Jobs that may wait for the registrar; more are dropped, and their clients see an empty answer.
const JOBS: usize = 256;
/// Clients whose tokens are remembered.
const CLIENTS: usize = 10_000;
/// Frames that may wait for the disk.
const RECORDED_FRAMES: usize = 64;
/// What the last zeros get before the session ends: Zenoh sends the end of a token before any data that waits.
const HEAD_START: Duration = Duration::from_millis(20);
/// How long the threads may take to end: longer only if one hangs in a reply to a client that does not read.
const THREADS_END: Duration = Duration::from_millis(700);
/// How long the session may take to close, and the recording meanwhile. With the threads' time it stays under two seconds, whatever hangs.
const SESSION_CLOSE: Duration = Duration::from_millis(800);

/// Why a worker could not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServiceError {
    /// Zenoh refused a declaration.
    #[error("cannot declare the worker's keys: {0}")]
    Zenoh(String),
    /// The prefix is not one.
    #[error(transparent)]
    Prefix(#[from] domvs_proto::keys::KeyError),
    /// No thread could be started.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// The recording could not begin.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// Nobody can listen where the metrics should be.
    #[error("cannot serve metrics on {address}: {source}")]
    MetricsAddress {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The metrics contradict each other.
    #[error("cannot make the metrics: {0}")]
    Metrics(#[from] prometheus::Error),
}

impl From<zenoh::Error> for ServiceError {
    fn from(error: zenoh::Error) -> ServiceError {
        ServiceError::Zenoh(error.to_string())
    }
}

/// A running worker. Ends with [`Service::shutdown`]; dropped, it ends in the same order, but nobody waits for it.
pub struct Service {
    shared: Arc<Shared>,
    _queryables: Vec<Queryable<()>>,
    _subscribers: Vec<Subscriber<()>>,
    _alive: LivelinessToken,
    metrics: Option<MetricsEndpoint>,
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
    clients: Mutex<HashSet<Name>>,
    jobs: flume::Sender<Job>,
    origin: Instant,
    wall_origin_ns: u64,
    pub(crate) metrics: Metrics,
    /// Which refusals the log says.
    pub(crate) refusals: Throttle<{ ErrorCode::ALL.len() }>,
    busy_lines: Throttle<1>,
    /// When the clock last looked, nanoseconds.
    clock_looked_ns: AtomicU64,
    busy_ns: AtomicU64,
    load: AtomicU64,
}

impl Service {
    /// Starts a worker in `session`, which it owns from now on. When this returns, the worker can be asked.
    pub async fn start(config: ServerConfig, session: Session) -> Result<Service, ServiceError> {
        let (jobs, waiting) = flume::bounded(JOBS);
        let shared = Arc::new(Shared::new(config, session, jobs)?);
        // Before anything else runs: the address may be taken.
        let metrics = match shared.config.metrics_address() {
            Some(address) => {
                let opened = MetricsEndpoint::open(address, &shared).await;
                Some(opened.map_err(|source| ServiceError::MetricsAddress { address, source })?)
            }
            None => None,
        };
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
        let (queryables, subscribers) = declare(&shared).await?;
        let alive = shared.session.liveliness().declare_token(shared.keys.worker_alive(&shared.worker)).await?;
        tracing::info!(worker = %shared.worker, threads = shared.config.compute_threads(), "ready");
        Ok(Service {
            shared,
            _queryables: queryables,
            _subscribers: subscribers,
            _alive: alive,
            metrics,
            clock: (closing, clock),
            registrar,
        })
    }

    /// The name of this worker.
    pub fn worker(&self) -> &Name {
        &self.shared.worker
    }

    /// Where `GET /metrics` is answered, if it is.
    pub fn metrics_address(&self) -> Option<SocketAddr> {
        self.metrics.as_ref().map(MetricsEndpoint::address)
    }

    /// Zeros for every task, then the end of the session, the threads and the recording.
    pub async fn shutdown(self) {
        let (closing, clock) = self.clock;
        drop(closing);
        let ends = async {
            join(clock).await;
            join(self.registrar).await;
        };
        if tokio::time::timeout(THREADS_END, ends).await.is_err() {
            tracing::warn!("a thread of the worker hangs in a reply; it ends with the session");
        }
        let recording = self.shared.recorder.clone().map(|recorder| {
            // Plain waiting for a disk: on a thread of its own.
            tokio::task::spawn_blocking(move || match recorder.close(SESSION_CLOSE) {
                Ok(counts) => tracing::info!(?counts, "recording finished"),
                Err(error) => tracing::error!(%error, "recording"),
            })
        });
        match tokio::time::timeout(SESSION_CLOSE, self.shared.session.close().into_future()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the session did not close cleanly"),
            Err(_late) => tracing::warn!(limit = ?SESSION_CLOSE, "the session did not close in time"),
        }
        if let Some(recording) = recording {
            // Bounded by its own limit; a panic in it has been said.
            let _ = recording.await;
        }
        tracing::info!(worker = %self.shared.worker, "stopped");
    }
}

impl Shared {
    fn new(config: ServerConfig, session: Session, jobs: flume::Sender<Job>) -> Result<Shared, ServiceError> {
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
            config,
            session,
            recorder,
            desks: Mutex::default(),
            clients: Mutex::default(),
            jobs,
            origin: Instant::now(),
            wall_origin_ns: u64::try_from(wall.as_nanos()).unwrap_or(u64::MAX),
            metrics: Metrics::new()?,
            refusals: Throttle::new(),
            busy_lines: Throttle::new(),
            clock_looked_ns: AtomicU64::new(0),
            busy_ns: AtomicU64::new(0),
            load: AtomicU64::new(0),
        })
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
        let ours = |(task, _)| lock(&self.desks).contains_key(task);
        !key.is_wild() && !self.keys.split_task(key.as_str()).is_some_and(ours)
    }

    pub(crate) fn client_is_alive(&self, client: &Name) -> bool {
        lock(&self.clients).contains(client)
    }

    /// Hands a job to the registrar without waiting. A job that finds no room is dropped: its client sees an
    /// empty answer and asks again, and the clock asks again for a closing. Returns whether there was room.
    pub(crate) fn give(&self, job: Job) -> bool {
        let given = self.jobs.try_send(job).is_ok();
        if !given {
            self.metrics.happened(Event::RequestDropped);
            if let Some(left_out) = self.busy_lines.admit(0, self.now()) {
                tracing::warn!(left_out, "the registrar is busy; a request was dropped");
            }
        }
        given
    }

    /// The clock is alive.
    pub(crate) fn clock_looks(&self, now: Moment) {
        self.clock_looked_ns.store(u64::try_from(now.as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
    }

    /// For how long the clock has not looked.
    pub(crate) fn clock_silence(&self) -> Duration {
        self.now().saturating_sub(Duration::from_nanos(self.clock_looked_ns.load(Ordering::Relaxed)))
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
        for desk in self.desks() {
            desk.closing.store(true, Ordering::Release);
            desk.request_halt(Status::OwnerLost);
            lock(&desk.outlet).halt(Some(Status::OwnerLost), self.now());
        }
        self.pool.close();
        self.desks().iter().for_each(|desk| desk.say_last_words(self.now()));
        std::thread::sleep(HEAD_START);
        // The registrar empties its queue before it sees this.
        if self.jobs.send_timeout(Job::Shutdown, Duration::from_millis(200)).is_err() {
            tracing::warn!("the registrar is busy; it ends with the session");
        }
    }

    pub(crate) fn info(&self) -> WorkerInfo {
        WorkerInfo {
            tasks: lock(&self.desks).len() as u32,
            capacity: self.config.limits.tasks as u32,
            load: f64::from_bits(self.load.load(Ordering::Relaxed)),
            threads: self.config.compute_threads() as u32,
            max_pixels: self.config.limits.pixels_per_frame as u64,
            max_payload_bytes: self.config.limits.bytes_per_payload as u64,
            uptime_s: self.now().as_secs_f64(),
            clients: lock(&self.clients).len() as u32,
            memory_bytes: crate::metrics::resident_bytes(),
            recorder_dropped: self.recorder.as_ref().map_or(0, |recorder| recorder.counts().dropped.total()),
            counts: self.metrics.counts(),
            ..WorkerInfo::new(self.worker.clone())
        }
    }
}

/// The worker's own keys.
async fn declare(shared: &Arc<Shared>) -> zenoh::Result<(Vec<Queryable<()>>, Vec<Subscriber<()>>)> {
    let (session, keys, worker) = (&shared.session, &shared.keys, &shared.worker);
    let give = |asked: Asked, job: fn(Query) -> Job| {
        let shared = Arc::clone(shared);
        move |query: Query| {
            shared.metrics.asked(asked);
            shared.give(job(query));
        }
    };
    let clients = {
        let shared = Arc::clone(shared);
        move |sample: Sample| note_client(&shared, &sample)
    };
    let stop = {
        let shared = Arc::clone(shared);
        move |_: Sample| shared.desks().iter().for_each(|desk| desk.request_halt(Status::Stopped))
    };
    let unclaimed = {
        let shared = Arc::clone(shared);
        move |query: Query| {
            // A session hands a query to all of its queryables that match, the tasks' own among them.
            if shared.is_unclaimed(query.key_expr()) {
                shared.metrics.asked(Asked::Unclaimed);
                shared.give(Job::Unclaimed(query));
            }
        }
    };
    let subscribers = vec![
        session.liveliness().declare_subscriber(keys.clients_alive()).history(true).callback(clients).await?,
        session.declare_subscriber(keys.stop()).callback(stop).await?,
    ];
    let queryables = vec![
        session
            .declare_queryable(keys.creates(worker))
            .complete(true)
            .callback(give(Asked::Create, Job::Create))
            .await?,
        // Not complete: a task's own keys are, and they win at the router. What nobody owns lands here.
        session.declare_queryable(keys.tasks()).complete(false).callback(unclaimed).await?,
        session
            .declare_queryable(keys.worker_info(worker))
            .complete(true)
            .callback(give(Asked::Info, Job::Info))
            .await?,
    ];
    Ok((queryables, subscribers))
}

fn note_client(shared: &Shared, sample: &Sample) {
    let Some(client) = shared.keys.parse_client_alive(sample.key_expr().as_str()) else { return };
    let mut clients = lock(&shared.clients);
    match sample.kind() {
        SampleKind::Put if clients.len() < CLIENTS => {
            clients.insert(client);
        }
        SampleKind::Put => tracing::warn!(%client, "too many clients; this one's lease is not watched"),
        SampleKind::Delete => {
            clients.remove(&client);
        }
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
