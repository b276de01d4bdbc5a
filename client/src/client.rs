//! A client: one Zenoh session, one name, one lease; it finds workers, makes tasks, lists them, and stops everything.

use std::sync::Arc;
use std::time::Duration;

use domvs_proto::frame::Secret;
use domvs_proto::keys::{Keys, Name, TaskKey};
use domvs_proto::messages::{CreateReply, ErrorCode, WorkerInfo};
use domvs_proto::settings::{Lease, TaskSettings};
use tokio::time::{Instant, sleep, timeout_at};
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority};

use crate::answer::Request;
use crate::error::zenoh_says;
use crate::follow::{Commands, Epoch, Statuses};
use crate::matching;
use crate::task::{NewTask, Task};
use crate::workers::{self, ListedTask};
use crate::{ClientError, ClientOptions};

/// The pause before an unsuccessful connection is tried again.
const CONNECT_PAUSE: Duration = Duration::from_millis(100);

/// A connected client; clones share the session and the lease.
///
/// Its liveliness token is the lease of its tasks: when the last clone and the last of its tasks are dropped, or the
/// process dies, the service halts those tasks and closes them after a grace time. Needs a multi-threaded Tokio runtime.
#[derive(Clone)]
pub struct Client {
    pub(crate) shared: Arc<Shared>,
}

/// What a client and its tasks hold together.
pub(crate) struct Shared {
    pub(crate) session: Session,
    pub(crate) keys: Keys,
    pub(crate) options: ClientOptions,
    /// Of this process among those of the client's name: tasks made here end with it.
    pub(crate) process: Name,
    // The leases: undeclared when this is dropped.
    _alive: [LivelinessToken; 2],
}

impl Client {
    /// Opens a session, trying until `connect_limit` has passed, and declares the client's lease.
    ///
    /// # Errors
    /// [`ClientError::Connect`] when nothing can be reached; [`ClientError::Key`] when the prefix is none.
    pub async fn connect(options: ClientOptions) -> Result<Client, ClientError> {
        let session = open(&options).await?;
        Client::with_session(session, options).await
    }

    /// As [`Client::connect`], on a session that exists; the Zenoh settings in the options are not used.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed; [`ClientError::Key`] when the prefix is none.
    pub async fn with_session(session: Session, options: ClientOptions) -> Result<Client, ClientError> {
        let keys = Keys::new(&options.prefix)?;
        // Sessions of all processes have names that differ.
        let process = Name::try_from(session.zid().to_string())?;
        let alive = [
            declare_lease(&session, keys.client_alive(&options.name)).await?,
            declare_lease(&session, keys.process_alive(&options.name, &process)).await?,
        ];
        Ok(Client { shared: Arc::new(Shared { session, keys, options, process, _alive: alive }) })
    }

    /// The name under which this client's tasks stand.
    pub fn name(&self) -> &Name {
        &self.shared.options.name
    }

    /// Whether a client of this name holds its token now.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn is_connected(&self, client: &Name) -> Result<bool, ClientError> {
        let key = self.shared.keys.client_alive(client);
        let tokens = self
            .shared
            .session
            .liveliness()
            .get(&key)
            .timeout(self.shared.options.request_timeout)
            .await
            .map_err(ClientError::session("looking for a client", &key))?;
        Ok(tokens.recv_async().await.is_ok_and(|token| token.result().is_ok()))
    }

    /// The keys under this client's prefix.
    pub fn keys(&self) -> &Keys {
        &self.shared.keys
    }

    /// The session, for publishing what else the program has to say.
    pub fn session(&self) -> &Session {
        &self.shared.session
    }

    /// Every worker that answers, least loaded first.
    ///
    /// # Errors
    /// [`ClientError::NoWorker`] when none does within `discovery_limit`.
    pub async fn list_workers(&self) -> Result<Vec<WorkerInfo>, ClientError> {
        let Shared { session, keys, options, .. } = &*self.shared;
        workers::workers(session, keys, options.discovery_limit).await
    }

    /// Every task that somebody owns, by name, with what it says within one status period (0.7 s at most).
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn list_tasks(&self) -> Result<Vec<ListedTask>, ClientError> {
        let Shared { session, keys, options, .. } = &*self.shared;
        workers::tasks(session, keys, options.request_timeout).await
    }

    /// Makes a task on the least loaded worker; on the next one when that is full or silent.
    ///
    /// # Errors
    /// [`ClientError::Settings`] before anything is sent, [`ClientError::NoWorker`], or the last worker's answer.
    pub async fn create_task(&self, settings: &TaskSettings) -> Result<Task, ClientError> {
        settings.validate()?;
        let mut last = None;
        for worker in self.list_workers().await? {
            match self.create_task_on(&worker.worker, settings).await {
                Err(error) if is_worth_another_worker(&error) => {
                    tracing::info!(worker = %worker.worker, %error, "trying the next worker");
                    last = Some(error);
                }
                made_or_refused => return made_or_refused,
            }
        }
        Err(last.expect("the list of workers is never empty, and the loop ends early unless a worker failed"))
    }

    /// Makes a task on this worker. With [`Lease::Client`] it hangs on this process's token, and ends with it
    /// whatever other processes of this name do.
    ///
    /// # Errors
    /// [`ClientError::Settings`] before anything is sent, [`ClientError::Refused`], [`ClientError::NoAnswer`].
    pub async fn create_task_on(&self, worker: &Name, settings: &TaskSettings) -> Result<Task, ClientError> {
        settings.validate()?;
        let Shared { session, keys, options, .. } = &*self.shared;
        let key = keys.create(worker, &options.name);
        let lease = match &settings.lease {
            Lease::Client => Lease::Process(self.shared.process.clone()),
            chosen => chosen.clone(),
        };
        let settings = TaskSettings { lease, ..settings.clone() };
        let request = Request::json(session, key, &settings, options.request_timeout);
        let CreateReply { task, epoch, secret, .. } = request.ask_json().await?;
        Task::open(NewTask { shared: self.shared.clone(), key: task, epoch, secret: Some(secret) }).await
    }

    /// A handle on a task that exists, from another terminal. Without its secret only reading works.
    ///
    /// # Errors
    /// [`ClientError::NoTask`] when it has no owner.
    pub async fn attach(&self, task: TaskKey, secret: Option<Secret>) -> Result<Task, ClientError> {
        let Shared { session, keys, options, .. } = &*self.shared;
        let deadline = Instant::now() + options.discovery_limit;
        loop {
            if let Some(owner) = workers::owner_of(session, keys, &task, options.request_timeout).await? {
                return Task::open(NewTask { shared: self.shared.clone(), key: task, epoch: owner.epoch, secret })
                    .await;
            }
            if Instant::now() + CONNECT_PAUSE >= deadline {
                return Err(ClientError::NoTask { key: keys.owners_of(&task), task });
            }
            sleep(CONNECT_PAUSE).await;
        }
    }

    /// The twists that are published for a task; needs no secret.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn commands(&self, task: &TaskKey) -> Result<Commands, ClientError> {
        Commands::follow(&self.shared.session, self.shared.keys.command(task), Epoch::default()).await
    }

    /// What a task says about itself; needs no secret.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session is closed.
    pub async fn statuses(&self, task: &TaskKey) -> Result<Statuses, ClientError> {
        Statuses::follow(&self.shared.session, self.shared.keys.status(task), Some(Epoch::default())).await
    }

    /// Stops everything: every task latches `stopped`, every arm brakes. Sent even when no listener is known.
    ///
    /// # Errors
    /// [`ClientError::NobodyListens`] when it was sent, but no listener showed up within `discovery_limit`.
    pub async fn stop_all(&self) -> Result<(), ClientError> {
        let Shared { session, keys, options, .. } = &*self.shared;
        let key = keys.stop();
        let publisher = session
            .declare_publisher(key.clone())
            .congestion_control(CongestionControl::Block)
            .priority(Priority::RealTime)
            .express(true)
            .await
            .map_err(ClientError::session("stopping", &key))?;
        publisher.put("stop").await.map_err(ClientError::session("stopping", &key))?;
        if !matching::has_subscriber(&publisher, options.discovery_limit).await? {
            return Err(ClientError::NobodyListens { key, waited: options.discovery_limit });
        }
        // The first may have been sent before the listener was known.
        publisher.put("stop").await.map_err(ClientError::session("stopping", &key))
    }

    /// Ends the lease and the session now, for all clones and tasks; tasks that were not closed are halted by the service.
    ///
    /// # Errors
    /// [`ClientError::Session`] when the session did not close in order.
    pub async fn close(self) -> Result<(), ClientError> {
        let key = self.shared.keys.client_alive(self.name());
        self.shared.session.close().await.map_err(ClientError::session("closing", &key))
    }
}

async fn declare_lease(session: &Session, key: String) -> Result<LivelinessToken, ClientError> {
    let declared = session.liveliness().declare_token(key.clone()).await;
    declared.map_err(ClientError::session("declaring the lease", &key))
}

/// Another worker may be better when this one is full, gone or on its way out.
fn is_worth_another_worker(error: &ClientError) -> bool {
    match error {
        ClientError::Refused { code, .. } => matches!(code, ErrorCode::Quota | ErrorCode::Closed | ErrorCode::NotOwner),
        error => error.is_silence(),
    }
}

/// In client mode Zenoh gives up at once when nothing listens, so it is asked again until the limit.
async fn open(options: &ClientOptions) -> Result<Session, ClientError> {
    let deadline = Instant::now() + options.connect_limit;
    let failed = |error: String| ClientError::Connect {
        endpoints: options.zenoh.get_json("connect/endpoints").unwrap_or_default(),
        waited: options.connect_limit,
        error,
    };
    loop {
        match timeout_at(deadline, zenoh::open(options.zenoh.clone())).await {
            Ok(Ok(session)) => return Ok(session),
            Ok(Err(error)) if Instant::now() + CONNECT_PAUSE >= deadline => {
                return Err(failed(zenoh_says(&error)));
            }
            Ok(Err(error)) => tracing::debug!(%error, "not connected yet"),
            Err(_late) => return Err(failed("Zenoh is still trying".to_owned())),
        }
        sleep(CONNECT_PAUSE).await;
    }
}
