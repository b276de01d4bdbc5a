//! Who is there: workers that take tasks, and tasks that somebody owns.

use std::time::Duration;

use domvs_proto::body;
use domvs_proto::keys::{Keys, Name, TaskKey};
use domvs_proto::messages::{StatusMessage, WorkerInfo};
use tokio::time::{Instant, sleep, timeout_at};
use zenoh::Session;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};

use crate::ClientError;
use crate::answer::answers;
use crate::follow::Statuses;

/// How long one round of questions to all waits for the slowest.
const ROUND: Duration = Duration::from_millis(500);
/// How long the others get once the first has answered: a hung worker must not hold up a task that a live one would take.
const OTHERS: Duration = Duration::from_millis(100);
/// The pause before a round without any answer is repeated.
const PAUSE: Duration = Duration::from_millis(50);
/// Answers to one round that are looked at.
const ROOM: usize = 1024;
/// A task says its status twice a second; this is a little more than one period.
const STATUS_PERIOD: Duration = Duration::from_millis(700);

/// A task that somebody owns.
#[derive(Debug, Clone)]
pub struct ListedTask {
    /// Which task.
    pub task: TaskKey,
    /// Who owns it.
    pub worker: Name,
    /// The owner's epoch.
    pub epoch: u32,
    /// What it last said; `None` when it said nothing within 0.7 s.
    pub status: Option<StatusMessage>,
}

/// The owner of a task, as its token says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Owner {
    pub(crate) task: TaskKey,
    pub(crate) worker: Name,
    pub(crate) epoch: u32,
}

/// Every worker that answers, least loaded first. Rounds are repeated until one does or `limit` has passed.
pub(crate) async fn workers(session: &Session, keys: &Keys, limit: Duration) -> Result<Vec<WorkerInfo>, ClientError> {
    let started = Instant::now();
    loop {
        let mut found = one_round(session, keys, ROUND.min(limit)).await?;
        if !found.is_empty() {
            found.sort_by(|a, b| burden(a).total_cmp(&burden(b)).then(a.worker.cmp(&b.worker)));
            return Ok(found);
        }
        if started.elapsed() + PAUSE >= limit {
            return Err(ClientError::NoWorker { key: keys.workers_info(), waited: started.elapsed() });
        }
        sleep(PAUSE).await;
    }
}

/// How busy a worker is and how full: the load of the last second knows nothing of the tasks that were made since.
fn burden(worker: &WorkerInfo) -> f64 {
    worker.load + f64::from(worker.tasks) / f64::from(worker.capacity.max(1))
}

async fn one_round(session: &Session, keys: &Keys, limit: Duration) -> Result<Vec<WorkerInfo>, ClientError> {
    let key = keys.workers_info();
    let (callback, answers) = answers::<Reply>(ROOM);
    session
        .get(&key)
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        .timeout(limit)
        .callback(callback)
        .await
        .map_err(ClientError::session("looking for workers", &key))?;
    let mut deadline = Instant::now() + limit;
    let mut found = Vec::new();
    while let Ok(Ok(reply)) = timeout_at(deadline, answers.recv_async()).await {
        if let Some(info) = read_info(&reply) {
            found.push(info);
            deadline = deadline.min(Instant::now() + OTHERS);
        }
    }
    Ok(found)
}

fn read_info(reply: &Reply) -> Option<WorkerInfo> {
    let sample = reply.result().ok()?;
    body::read(&sample.payload().to_bytes())
        .inspect_err(|error| tracing::warn!(key = %sample.key_expr(), %error, "a worker's info is unreadable: ignored"))
        .ok()
}

/// The owners whose tokens match `key`.
pub(crate) async fn owners(
    session: &Session,
    keys: &Keys,
    key: &str,
    limit: Duration,
) -> Result<Vec<Owner>, ClientError> {
    let (callback, answers) = answers::<Reply>(ROOM);
    session
        .liveliness()
        .get(key)
        .timeout(limit)
        .callback(callback)
        .await
        .map_err(ClientError::session("looking for owners", key))?;
    let deadline = Instant::now() + limit;
    let mut found = Vec::new();
    while let Ok(Ok(reply)) = timeout_at(deadline, answers.recv_async()).await {
        let token = reply.result().ok().and_then(|sample| keys.parse_owner(sample.key_expr().as_str()));
        found.extend(token.map(|(task, worker, epoch)| Owner { task, worker, epoch }));
    }
    Ok(found)
}

/// The newest owner of one task; `None` when it has none.
pub(crate) async fn owner_of(
    session: &Session,
    keys: &Keys,
    task: &TaskKey,
    limit: Duration,
) -> Result<Option<Owner>, ClientError> {
    let found = owners(session, keys, &keys.owners_of(task), limit).await?;
    Ok(found.into_iter().max_by_key(|owner| owner.epoch))
}

/// Every task with an owner, by name, and what each says within one status period.
pub(crate) async fn tasks(session: &Session, keys: &Keys, limit: Duration) -> Result<Vec<ListedTask>, ClientError> {
    // Listening begins before the question, so that a status right after it is not missed.
    let mut statuses = Statuses::follow(session, keys.statuses(), None).await?;
    let mut owners = owners(session, keys, &keys.owners(), limit).await?;
    owners.sort_by(|a, b| a.task.cmp(&b.task).then(b.epoch.cmp(&a.epoch)));
    owners.dedup_by(|older, newest| older.task == newest.task);
    let unheard =
        |owner: Owner| ListedTask { task: owner.task, worker: owner.worker, epoch: owner.epoch, status: None };
    let mut listed: Vec<_> = owners.into_iter().map(unheard).collect();
    let deadline = Instant::now() + STATUS_PERIOD;
    while listed.iter().any(|task| task.status.is_none()) {
        let Some(message) = statuses.recv(deadline.saturating_duration_since(Instant::now())).await else {
            break;
        };
        if let Some(task) = listed.iter_mut().find(|listed| listed.task == message.task) {
            task.status = Some(message);
        }
    }
    Ok(listed)
}
