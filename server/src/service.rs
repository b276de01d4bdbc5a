//! A service: one worker after another, each in a Zenoh session of its own.
//!
//! A worker that is fenced (a newer owner has one of its tasks) leaves with its whole session, since a key with two owners
//! does not find back to one of them before that. Then the service opens the next session, under the same name; what the worker still
//! owned is gone on with by whoever is first, the others or the next session. A worker that has no task and has used up many of its
//! session's keys leaves in the same way.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use domvs_proto::keys::{Keys, Name};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Locality;
use zenoh::{Config, Session};

use crate::config::ServerConfig;
use crate::error::ServiceError;
use crate::metrics::{Metrics, MetricsEndpoint};
use crate::replica::{Carried, epoch};
use crate::state_dir::StateDir;
use crate::worker::{SESSION_CLOSE, Worker};

/// Between two tries to open the next session.
const PAUSE: Duration = Duration::from_millis(200);
/// How long the token of a worker of the same name may take to go: one that was killed has just been lost.
const NAME_LIMIT: Duration = Duration::from_secs(3);
/// How long the tokens of the others may take to come.
const TOKENS: Duration = Duration::from_millis(500);

/// A running service. Ends with [`Service::shutdown`]; dropped, it ends in the same order, but nobody waits for it.
pub struct Service {
    worker: Name,
    metrics: Option<MetricsEndpoint>,
    end: oneshot::Sender<()>,
    supervisor: JoinHandle<()>,
}

impl Service {
    /// Starts a worker in `session`, which the service owns from now on. When this returns, the worker can be asked. Needs a
    /// multi-threaded Tokio runtime.
    ///
    /// # Errors
    /// A name that a live worker has, a prefix that is none, a thread, recording or declaration that could not be made.
    pub async fn start(config: ServerConfig, session: Session) -> Result<Service, ServiceError> {
        let worker = free_name(&config, &session).await?;
        let config = ServerConfig { worker: worker.to_string(), ..config };
        let zenoh = next_session(&session)?;
        let counted = Arc::new(Metrics::new()?);
        // Before any worker runs: the address may be taken. It outlives the workers, as the counters do.
        let metrics = open_metrics(&config, &counted).await?;
        let (states, carried) = open_states(&config)?;
        let started = Worker::start(config.clone(), session.clone(), carried, states.clone(), Arc::clone(&counted));
        let (first, next) = (started.await?, Next { config, zenoh, states, metrics: counted });
        if let Err(error) = keep_name(&next.config, &session, &worker).await {
            first.shutdown(next.end()).await;
            return Err(error);
        }
        let (end, ended) = oneshot::channel();
        let supervisor = tokio::spawn(supervise(next, first, ended));
        Ok(Service { worker, metrics, end, supervisor })
    }

    /// The name of this worker.
    pub fn worker(&self) -> &Name {
        &self.worker
    }

    /// Where `GET /metrics` is answered, if it is.
    pub fn metrics_address(&self) -> Option<SocketAddr> {
        self.metrics.as_ref().map(MetricsEndpoint::address)
    }

    /// Zeros for every task, then the end of the session, the threads and the recording. Other workers go on with the tasks.
    pub async fn shutdown(self) {
        drop(self.end);
        if self.supervisor.await.is_err() {
            tracing::error!("the service ended by a panic");
        }
    }
}

/// Follows each fenced worker with the next, until the service ends.
async fn supervise(next: Next, first: Worker, mut ended: oneshot::Receiver<()>) {
    let mut worker = first;
    loop {
        tokio::select! {
            _ = &mut ended => break,
            () = worker.fenced() => {}
        }
        let carried = worker.shutdown(async {}).await;
        tracing::warn!(tasks = carried.len(), "a new session follows, with the tasks that nobody else has taken");
        worker = tokio::select! {
            _ = &mut ended => return next.end().await,
            worker = next.worker(carried) => worker,
        };
    }
    worker.shutdown(next.end()).await;
}

/// What the next worker is made from.
struct Next {
    config: ServerConfig,
    zenoh: Config,
    states: Option<Arc<StateDir>>,
    metrics: Arc<Metrics>,
}

impl Next {
    /// Tries until there is a session with a worker in it.
    async fn worker(&self, carried: Vec<Carried>) -> Worker {
        loop {
            match zenoh::open(self.zenoh.clone()).await {
                Ok(session) => {
                    let (config, states) = (self.config.clone(), self.states.clone());
                    match Worker::start(config, session, carried.clone(), states, Arc::clone(&self.metrics)).await {
                        Ok(worker) => return worker,
                        Err(error) => tracing::error!(%error, "the worker could not start again"),
                    }
                }
                Err(error) => tracing::warn!(%error, "no session yet"),
            }
            sleep(PAUSE).await;
        }
    }

    /// Writes what is still to be written.
    async fn end(self) {
        let Some(states) = self.states else { return };
        if tokio::task::spawn_blocking(move || states.close(SESSION_CLOSE)).await.is_err() {
            tracing::error!("the state directory ended by a panic");
        }
    }
}

/// The page of the metrics, if somebody wants one.
async fn open_metrics(config: &ServerConfig, metrics: &Arc<Metrics>) -> Result<Option<MetricsEndpoint>, ServiceError> {
    let Some(address) = config.metrics_address() else { return Ok(None) };
    let opened = MetricsEndpoint::open(address, metrics).await;
    opened.map(Some).map_err(|source| ServiceError::MetricsAddress { address, source })
}

/// The state directory, if there is one, and what a worker has left in it.
fn open_states(config: &ServerConfig) -> Result<(Option<Arc<StateDir>>, Vec<Carried>), ServiceError> {
    if config.state.as_os_str().is_empty() {
        return Ok((None, vec![]));
    }
    let failed = |source| ServiceError::StateDir { folder: config.state.clone(), source };
    let (states, carried) = StateDir::open(&config.state).map_err(failed)?;
    Ok((Some(Arc::new(states)), carried))
}

/// How to open a session like this one, under a new identity.
fn next_session(session: &Session) -> Result<Config, ServiceError> {
    let unusable = |error: &dyn std::fmt::Display| ServiceError::Zenoh(format!("its configuration: {error}"));
    let mut config: serde_json::Value =
        serde_json::from_str(&session.config().to_string()).map_err(|error| unusable(&error))?;
    if let Some(fields) = config.as_object_mut() {
        fields.remove("id");
    }
    Config::from_json5(&config.to_string()).map_err(|error| unusable(&error))
}

/// The configured name, or one made up; none whose epochs could be mistaken for a live worker's.
async fn free_name(config: &ServerConfig, session: &Session) -> Result<Name, ServiceError> {
    let keys = Keys::new(&config.prefix)?;
    let asked = Instant::now();
    loop {
        let name = config.worker_name();
        let rival = live_workers(session, &keys).await?.into_iter().find(|other| is_rival(&name, other));
        let Some(rival) = rival else { return Ok(name) };
        if asked.elapsed() > NAME_LIMIT {
            return Err(ServiceError::NameTaken { worker: name, rival });
        }
        sleep(PAUSE).await;
    }
}

/// Two workers of one name that start together may both look before either can be seen, so each looks again when it can be. The one
/// whose session has the greater identifier ends. The other waits for that, and ends too if it does not come: it was not seen.
async fn keep_name(config: &ServerConfig, session: &Session, name: &Name) -> Result<(), ServiceError> {
    let keys = Keys::new(&config.prefix)?;
    let own = session.zid().to_le_bytes();
    let looked = Instant::now();
    while let Some(other) = namesakes(session, &keys, name).await?.into_iter().min() {
        if other < own || looked.elapsed() > NAME_LIMIT {
            return Err(ServiceError::NameTaken { worker: name.clone(), rival: name.clone() });
        }
        sleep(PAUSE).await;
    }
    Ok(())
}

/// The sessions of the other workers of this name.
async fn namesakes(session: &Session, keys: &Keys, name: &Name) -> Result<Vec<[u8; 16]>, ServiceError> {
    let asked = session.get(keys.worker_info(name)).target(QueryTarget::All).consolidation(ConsolidationMode::None);
    let answers = asked.allowed_destination(Locality::Remote).timeout(TOKENS).await?;
    let mut sessions = vec![];
    while let Ok(answer) = answers.recv_async().await {
        sessions.extend(answer.replier_id().map(|replier| replier.zid().to_le_bytes()));
    }
    Ok(sessions)
}

fn is_rival(name: &Name, other: &Name) -> bool {
    epoch::name_hash(name) == epoch::name_hash(other)
}

async fn live_workers(session: &Session, keys: &Keys) -> Result<Vec<Name>, ServiceError> {
    let tokens = session.liveliness().get(keys.workers_alive()).timeout(TOKENS).await?;
    let mut workers = vec![];
    while let Ok(token) = tokens.recv_async().await {
        workers.extend(token.result().ok().and_then(|sample| keys.parse_worker_alive(sample.key_expr().as_str())));
    }
    Ok(workers)
}
