//! What reaches the standby's thread: callbacks put news here and return, and never decode any.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use domvs_proto::frame::FrameHeader;
use domvs_proto::keys::{Leaf, Name, TaskKey};
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::session::TransportEvent;

use crate::Moment;
use crate::desk::lock;
use crate::worker::Shared;

/// News that may wait. A worker with ten thousand tasks that vanishes makes as many.
const NEWS: usize = 16_384;
/// A task whose state is not here is asked for so often at most.
const ASKING: Duration = Duration::from_secs(1);
/// Tasks for which that is remembered.
const ASKED: usize = 4096;
/// Tasks whose owners' tokens are remembered: no session has numbers for more keys.
const OWNED: usize = 65_536;
/// Of one task, the newest. There are two for a moment.
const OWNERS: usize = 16;

/// One piece of news.
pub(crate) enum Event {
    /// A worker's token.
    Worker { worker: Name, alive: bool },
    /// An owner's token.
    Owner { task: TaskKey, worker: Name, epoch: u32, alive: bool },
    /// A JSON message on the `state` of this task.
    State { task: TaskKey, json: ZBytes, received: Moment },
    /// A target on `state`.
    Target { task: TaskKey, picture: Picture },
    /// A link of this worker came up.
    Linked,
    /// The worker ends.
    End,
}

/// A target as it came.
pub(crate) struct Picture {
    pub(crate) header: FrameHeader,
    pub(crate) encoding: String,
    pub(crate) payload: ZBytes,
}

/// Where callbacks put what they hear, and where they read what the standby knows.
pub(crate) struct Inbox {
    events: flume::Sender<Event>,
    most_bytes: usize,
    /// Of all states and targets that wait.
    bytes: AtomicUsize,
    dropped: AtomicU64,
    known: Mutex<HashSet<String>>,
    /// Live owners of tasks, this worker not among them, as soon as their tokens come.
    owners: Mutex<HashMap<TaskKey, BTreeSet<(u32, Name)>>>,
    records: AtomicUsize,
    others: AtomicUsize,
    asked: Mutex<BTreeMap<TaskKey, Moment>>,
}

impl Inbox {
    pub(crate) fn new(most_bytes: usize) -> (Inbox, flume::Receiver<Event>) {
        let (events, waiting) = flume::bounded(NEWS);
        let inbox = Inbox {
            events,
            most_bytes,
            bytes: AtomicUsize::new(0),
            dropped: AtomicU64::new(0),
            known: Mutex::default(),
            owners: Mutex::default(),
            records: AtomicUsize::new(0),
            others: AtomicUsize::new(0),
            asked: Mutex::default(),
        };
        (inbox, waiting)
    }

    /// News that found no room are counted; states and targets are asked for later.
    fn put(&self, event: Event) {
        if self.events.try_send(event).is_err() {
            self.drop_one();
        }
    }

    fn drop_one(&self) {
        let dropped = self.dropped.fetch_add(1, Ordering::Relaxed) + 1;
        if dropped.is_power_of_two() {
            tracing::warn!(dropped, "news of other workers found no room");
        }
    }

    /// A message on `state`: a target if it has an attachment, JSON if not.
    pub(crate) fn put_state(&self, task: &TaskKey, sample: &Sample, received: Moment) {
        let size = sample.payload().len();
        if self.bytes.fetch_add(size, Ordering::AcqRel) + size > self.most_bytes {
            self.taken(size);
            self.drop_one();
            return;
        }
        let payload = sample.payload().clone();
        let Some(attachment) = sample.attachment() else {
            return self.put_or_forget(Event::State { task: task.clone(), json: payload, received }, size);
        };
        match FrameHeader::decode(&attachment.to_bytes()) {
            Ok(header) => {
                let picture = Picture { header, encoding: sample.encoding().to_string(), payload };
                self.put_or_forget(Event::Target { task: task.clone(), picture }, size);
            }
            Err(_) => self.taken(size),
        }
    }

    fn put_or_forget(&self, event: Event, size: usize) {
        if self.events.try_send(event).is_err() {
            self.taken(size);
            self.drop_one();
        }
    }

    /// So many bytes wait no longer.
    pub(crate) fn taken(&self, bytes: usize) {
        self.bytes.fetch_sub(bytes, Ordering::AcqRel);
    }

    pub(crate) fn end(&self) {
        // A full queue ends with the session, whose callbacks hold the other end.
        let _ = self.events.send_timeout(Event::End, Duration::from_millis(200));
    }

    /// Whether the owner of a task whose state is not here may be asked now; notes that it was.
    pub(crate) fn may_ask(&self, task: &TaskKey, now: Moment) -> bool {
        let mut asked = lock(&self.asked);
        asked.retain(|_, at| now.saturating_sub(*at) <= ASKING);
        if asked.contains_key(task) || asked.len() >= ASKED {
            return false;
        }
        asked.insert(task.clone(), now);
        true
    }

    /// What the standby knows now.
    pub(crate) fn say<'a>(&self, known: impl Iterator<Item = &'a TaskKey>, records: usize, others: usize) {
        self.others.store(others, Ordering::Relaxed);
        *lock(&self.known) = known.map(ToString::to_string).collect();
        self.records.store(records, Ordering::Relaxed);
    }

    /// Whether `client/id` is a task of another worker, as far as this one knows.
    pub(crate) fn knows(&self, task: &str) -> bool {
        lock(&self.known).contains(task)
    }

    /// An owner's token, of another worker, has come or gone.
    fn note_owner(&self, task: &TaskKey, owner: (u32, Name), alive: bool) {
        let mut owners = lock(&self.owners);
        if alive && (owners.len() < OWNED || owners.contains_key(task)) {
            let tokens = owners.entry(task.clone()).or_default();
            tokens.insert(owner);
            if tokens.len() > OWNERS {
                tokens.pop_first();
            }
        } else if let Some(tokens) = owners.get_mut(task) {
            tokens.remove(&owner);
            if tokens.is_empty() {
                owners.remove(task);
            }
        }
    }

    /// The other worker that has the task now, the newest if there are several.
    pub(crate) fn newest_owner(&self, task: &TaskKey) -> Option<(u32, Name)> {
        lock(&self.owners).get(task).and_then(|owners| owners.last().cloned())
    }

    /// Whether there are other workers, whose news may be on their way.
    pub(crate) fn has_others(&self) -> bool {
        self.others.load(Ordering::Relaxed) > 0
    }

    /// Tasks of others whose state is here.
    pub(crate) fn records(&self) -> usize {
        self.records.load(Ordering::Relaxed)
    }
}

/// What a standby listens to; ends with these values.
pub(crate) struct Listening {
    _subscribers: Vec<Subscriber<()>>,
    /// Declared last: from here on others count on this worker.
    _alive: LivelinessToken,
}

/// Begins to listen, then says that this worker is there.
pub(crate) async fn declare(shared: &Arc<Shared>) -> zenoh::Result<Listening> {
    let (session, keys) = (&shared.session, &shared.keys);
    let owners = {
        let shared = Arc::clone(shared);
        move |sample: Sample| note_owner(&shared, &sample)
    };
    let workers = {
        let shared = Arc::clone(shared);
        move |sample: Sample| {
            if let Some(worker) = shared.keys.parse_worker_alive(sample.key_expr().as_str()) {
                shared.inbox.put(Event::Worker { worker, alive: sample.kind() == SampleKind::Put });
            }
        }
    };
    let states = {
        let shared = Arc::clone(shared);
        move |sample: Sample| {
            if let Some((task, Leaf::State)) = shared.keys.parse_task(sample.key_expr().as_str()) {
                shared.inbox.put_state(&task, &sample, shared.now());
            }
        }
    };
    let states =
        session.declare_subscriber(keys.every(Leaf::State)).allowed_origin(Locality::Remote).callback(states).await?;
    let links = {
        let shared = Arc::clone(shared);
        move |event: TransportEvent| {
            if event.kind() == SampleKind::Put {
                shared.inbox.put(Event::Linked);
            }
        }
    };
    session.info().transport_events_listener().history(false).callback(links).background().await?;
    let subscribers = vec![
        states,
        session.liveliness().declare_subscriber(keys.workers_alive()).history(true).callback(workers).await?,
        session.liveliness().declare_subscriber(keys.owners()).history(true).callback(owners).await?,
    ];
    let alive = session.liveliness().declare_token(keys.worker_alive(&shared.worker)).await?;
    Ok(Listening { _subscribers: subscribers, _alive: alive })
}

fn note_owner(shared: &Shared, sample: &Sample) {
    let Some((task, worker, epoch)) = shared.keys.parse_owner(sample.key_expr().as_str()) else { return };
    let alive = sample.kind() == SampleKind::Put;
    if worker != shared.worker {
        shared.inbox.note_owner(&task, (epoch, worker.clone()), alive);
    }
    if alive {
        shared.spent.add(sample.key_expr());
        // At once, whatever the standby's thread is doing: nothing more moves by this worker's word.
        let own = lock(&shared.desks).get(&task.to_string()).cloned();
        own.filter(|desk| epoch > desk.epoch).inspect(|desk| desk.supersede());
    }
    shared.inbox.put(Event::Owner { task, worker, epoch, alive });
}
