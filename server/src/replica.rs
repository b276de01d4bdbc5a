//! The standby in every worker: it keeps what it hears of the others' tasks, and goes on with those that their owner has lost.
//!
//! Who owns a task is said by its token, `task/<cid>/<id>/owner/<wid>/<epoch>`. A task is lost when its token and its worker's are both
//! gone; gone alone, it was closed. Then every standby finds by [`rendezvous`] who follows; the first takes it at once, the second if
//! nobody has after [`TURN`], and so on. The new owner's epoch is one generation higher. Callbacks only enqueue; all else happens on one thread.
//!
//! A standby that hears of a newer owner of a task of its own is fenced: it halts that task at once and leaves with its whole session,
//! for Zenoh does not find the way to the other owner before that. What else it owned goes on elsewhere, or here in the next session.

pub(crate) mod epoch;
mod inbox;
mod records;
mod rendezvous;
mod takeover;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::{Phase, StateMessage, TaskState};
use domvs_proto::status::Status;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Locality;

use crate::Moment;
use crate::desk::{Desk, lock};
use crate::metrics;
use crate::task::SentTarget;
use crate::throttle::Throttle;
use crate::worker::Shared;

use inbox::{Event, Picture};
pub(crate) use inbox::{Inbox, Listening, declare};
use records::{Record, Records};
use takeover::Followed;

/// The selector parameter that asks `state` for the target itself.
pub(crate) const TARGET: &str = "target";

/// What the next in line leaves the one before it: a live worker has taken the task by then.
const TURN: Duration = Duration::from_millis(250);
/// The news of one lost worker arrive one by one; so long they are waited for.
const SETTLING: Duration = Duration::from_millis(5);
/// The same where nobody else is left, so that the lost link may be the own one.
const ALONE: Duration = Duration::from_millis(30);
/// A worker that has just joined does not know yet who is there.
const JOINING: Duration = Duration::from_millis(500);
/// A takeover that has come to nothing is tried again.
const AGAIN: Duration = Duration::from_secs(1);
/// How long the record of a task whose owner gave it up is kept for the news that the owner itself is gone.
const RELEASED: Duration = Duration::from_secs(2);
/// Between two looks while something is on its way, and while nothing is.
const BUSY: Duration = Duration::from_millis(2);
const QUIET: Duration = Duration::from_millis(100);
/// How long a lost task is looked at often; later, for instance when all workers are full, it is enough now and then.
const SOON: Duration = Duration::from_secs(3);
/// How long a lost task without its target is kept for the target still to come.
const INCOMPLETE: Duration = Duration::from_secs(60);
/// How long the state of a task is kept for its owner's token to come.
const UNOWNED: Duration = Duration::from_secs(60);
/// A stop for all may overtake the last words of an owner that did not hear it.
const DOUBT: Duration = Duration::from_secs(1);
/// Closed tasks that are remembered, so that late news do not bring them back.
const CLOSED: usize = 1024;
/// How long an owner may take to answer.
const ANSWER: Duration = Duration::from_secs(2);

/// What a fenced worker still owned when it left, or knew to be lost, for its next session.
#[derive(Clone)]
pub(crate) struct Carried {
    pub(crate) state: TaskState,
    pub(crate) target: Option<SentTarget>,
}

impl Carried {
    /// Halts it with this status, wherever it goes on.
    pub(crate) fn latch(&mut self, status: Status) {
        (self.state.progress.phase, self.state.progress.status) = (Phase::Latched(status), status);
    }
}

/// The standby's knowledge; lives on its own thread.
pub(crate) struct Standby {
    shared: Arc<Shared>,
    records: Records,
    /// Live workers, this one among them.
    workers: BTreeSet<Name>,
    /// Live owner tokens of others' tasks.
    owners: BTreeMap<TaskKey, BTreeSet<(u32, Name)>>,
    closed: VecDeque<TaskKey>,
    /// Own tasks that a newer owner has: with the first of them this worker begins to leave.
    superseded: BTreeSet<TaskKey>,
    unreadable: Throttle<1>,
    joined: Moment,
    mode: Mode,
}

/// What a worker's session is to the others.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// It has one link, to a router.
    Client,
    /// It has links to some; without any it knows nothing.
    Peer,
    /// Others come to it; it is never cut off from them.
    Router,
}

impl Mode {
    fn of(session: &zenoh::Session) -> Mode {
        match session.config().get("mode").unwrap_or_default().trim_matches('"') {
            "router" => Mode::Router,
            "client" => Mode::Client,
            _ => Mode::Peer,
        }
    }
}

impl Standby {
    pub(crate) fn new(shared: Arc<Shared>, carried: Vec<Carried>) -> Standby {
        let limits = &shared.config.replica;
        let mut records = Records::new(limits.tasks, limits.bytes);
        let joined = shared.now();
        for Carried { state, target } in carried {
            records.insert_own(Record { own: true, target, lost: Some(joined), ..Record::new(state, joined) });
        }
        let mode = Mode::of(&shared.session);
        let workers = BTreeSet::from([shared.worker.clone()]);
        Standby {
            shared,
            records,
            workers,
            owners: BTreeMap::new(),
            closed: VecDeque::new(),
            superseded: BTreeSet::new(),
            unreadable: Throttle::new(),
            joined,
            mode,
        }
    }

    /// Works until the worker ends.
    pub(crate) fn run(mut self, events: &flume::Receiver<Event>) {
        let mut pause = QUIET;
        loop {
            match events.recv_timeout(pause) {
                Ok(Event::End) | Err(flume::RecvTimeoutError::Disconnected) => return self.carry_what_is_lost(),
                Ok(event) => self.take_in(event),
                Err(flume::RecvTimeoutError::Timeout) => {}
            }
            while let Ok(event) = events.try_recv() {
                match event {
                    Event::End => return self.carry_what_is_lost(),
                    event => self.take_in(event),
                }
            }
            pause = self.look();
            self.shared.inbox.say(self.known(), self.records.len(), self.workers.len() - 1);
            // Something new comes before something made ready.
            if events.is_empty() && pause == QUIET && self.prepare_one() {
                pause = BUSY;
            }
        }
    }

    /// Nobody else may know of a task without an owner: what is lost goes along into the next session.
    fn carry_what_is_lost(&mut self) {
        let desks = self.shared.desks();
        let mut carried = lock(&self.shared.carried);
        for (task, record) in self.records.iter_mut() {
            if record.lost.is_some() && record.is_complete() && desks.iter().all(|desk| desk.key != *task) {
                carried.push(Carried { state: record.state.clone(), target: record.target.take() });
            }
        }
    }

    fn take_in(&mut self, event: Event) {
        match event {
            Event::Worker { worker, alive: true } => {
                self.workers.insert(worker);
            }
            Event::Worker { worker, alive: false } => self.worker_gone(&worker),
            Event::Owner { task, worker, epoch, alive: true } => self.owner_there(task, worker, epoch),
            Event::Owner { task, worker, epoch, alive: false } => self.owner_gone(&task, &worker, epoch),
            Event::State { task, json, received } => self.state_came(&task, &json, received),
            Event::Target { task, picture } => {
                self.shared.inbox.taken(picture.payload.len());
                let Picture { header, encoding, payload } = picture;
                self.records.put_target(&task, header, encoding, payload.to_bytes().into_owned());
            }
            // Who has been cut off must hear first who is there.
            Event::Linked if self.mode == Mode::Client => self.joined = self.shared.now(),
            Event::Linked | Event::End => {}
        }
    }

    fn worker_gone(&mut self, gone: &Name) {
        if *gone == self.shared.worker {
            return;
        }
        self.workers.remove(gone);
        let now = self.shared.now();
        tracing::info!(worker = %gone, "a worker is gone");
        for (task, record) in self.records.iter_mut() {
            if record.owner().1 == gone && record.lost.is_none() && !self.owners.contains_key(task) {
                (record.lost, record.released) = (Some(now), None);
            }
        }
    }

    fn owner_there(&mut self, task: TaskKey, worker: Name, epoch: u32) {
        if worker == self.shared.worker {
            return;
        }
        let own = lock(&self.shared.desks).get(&task.to_string()).cloned();
        if let Some(desk) = own {
            self.yield_to_newer(&desk, epoch, &worker);
        }
        let now = self.shared.now();
        if let Some(record) = self.records.get_mut(&task) {
            (record.lost, record.released, record.taken) = (None, None, None);
            record.owner = record.owner.take().max(Some((epoch, worker.clone())));
            record.heard = now;
            if std::mem::take(&mut record.own) {
                self.shared.states.iter().for_each(|states| states.remove(&task));
            }
        }
        self.owners.entry(task).or_default().insert((epoch, worker));
    }

    /// Halts a task that a newer owner has, and begins to leave.
    fn yield_to_newer(&mut self, desk: &Arc<Desk>, epoch: u32, worker: &Name) {
        if epoch <= desk.epoch || !self.superseded.insert(desk.key.clone()) {
            return;
        }
        let task = &desk.key;
        tracing::warn!(%task, epoch, owner = %worker, own_epoch = desk.epoch, "a newer owner has the task: this worker leaves and comes back");
        desk.supersede();
        self.shared.metrics.happened(metrics::Event::TaskSuperseded);
        self.shared.pool.schedule(desk);
        self.shared.fence();
    }

    fn owner_gone(&mut self, task: &TaskKey, worker: &Name, epoch: u32) {
        if *worker == self.shared.worker {
            return;
        }
        if let Some(tokens) = self.owners.get_mut(task) {
            tokens.remove(&(epoch, worker.clone()));
            if !tokens.is_empty() {
                return;
            }
            self.owners.remove(task);
        }
        let (now, worker_lives) = (self.shared.now(), self.workers.contains(worker));
        if let Some(record) = self.records.get_mut(task) {
            match worker_lives {
                true => record.released = Some(now),
                false => record.lost = Some(now),
            }
        }
    }

    fn state_came(&mut self, of: &TaskKey, json: &ZBytes, received: Moment) {
        self.shared.inbox.taken(json.len());
        let message = match read_state(of, json) {
            Ok(message) => message,
            Err(error) => return self.say_ignored(of, &error),
        };
        if self.closed.contains(of) {
            return;
        }
        match message {
            StateMessage::Full(state) => {
                if let Err(error) = self.records.put_state(*state, received) {
                    return self.say_ignored(of, &error);
                }
                if let Some(record) = self.records.get_mut(of) {
                    let seen = self.owners.get(of).and_then(|owners| owners.last().cloned());
                    record.owner = record.owner.take().max(seen);
                }
            }
            StateMessage::Progress(news) => {
                let known = self.records.put_progress(&news, received);
                if !known && self.owners.contains_key(&news.task) {
                    self.ask_state(&news.task);
                }
            }
            StateMessage::Closed(end) => {
                let older = self.records.get(&end.task).is_none_or(|record| end.epoch >= record.state.epoch);
                if older {
                    self.records.remove(&end.task);
                    self.closed.truncate(CLOSED - 1);
                    self.closed.push_front(end.task);
                }
            }
        }
    }

    /// Somebody publishes what no worker would: said, but not as often as it comes.
    fn say_ignored(&self, task: &TaskKey, error: &str) {
        if let Some(left_out) = self.unreadable.admit(0, self.shared.now()) {
            tracing::warn!(%task, error, left_out, "a state was ignored");
        }
    }

    /// Looks after what is lost, released or incomplete. Returns how long there will be nothing to do, if no news come.
    fn look(&mut self) -> Duration {
        let now = self.shared.now();
        self.yield_what_others_have();
        self.ask_for_what_is_missing(now);
        self.records.forget(|record| record.is_over(now));
        let lost: Vec<TaskKey> =
            self.records.iter().filter(|(_, record)| record.lost.is_some()).map(|(task, _)| task.clone()).collect();
        for task in &lost {
            // Each at its own time, and news in between: decoding a target takes long enough for another worker to take the next task.
            if self.follow(task, self.shared.now()) == Followed::Slowly {
                return Duration::ZERO;
            }
        }
        let soon = |record: &Record| record.lost.is_some_and(|lost| now.saturating_sub(lost) < SOON);
        if self.records.iter().any(|(_, record)| soon(record)) { BUSY } else { QUIET }
    }

    /// A newer owner's token may have come before the own task could be seen, or have found no room among the news.
    fn yield_what_others_have(&mut self) {
        for desk in self.shared.desks() {
            if let Some((epoch, worker)) = self.shared.inbox.newest_owner(&desk.key) {
                self.yield_to_newer(&desk, epoch, &worker);
            }
        }
    }

    /// Owners whose states or targets are not here; each is asked once in a while.
    fn ask_for_what_is_missing(&mut self, now: Moment) {
        let unknown: Vec<TaskKey> =
            self.owners.keys().filter(|task| self.records.get(task).is_none()).cloned().collect();
        // Without room the answer would be left out again.
        if self.records.len() < self.shared.config.replica.tasks {
            for task in unknown {
                if self.shared.inbox.may_ask(&task, now) {
                    self.ask_state(&task);
                }
            }
        }
        let due = |record: &Record| record.asked.is_none_or(|asked| now.saturating_sub(asked) > AGAIN);
        let incomplete: Vec<TaskKey> = self
            .records
            .iter()
            .filter(|(task, record)| !record.is_complete() && due(record) && self.owners.contains_key(*task))
            .map(|(task, _)| task.clone())
            .collect();
        for task in incomplete {
            if let Some(record) = self.records.get_mut(&task) {
                // The target may be right behind the state that names it: the first time it is only noted.
                let first = record.asked.replace(now).is_none();
                if !first {
                    self.ask(&task, &format!("{}?{TARGET}", self.shared.keys.state(&task)));
                }
            }
        }
    }

    fn ask_state(&self, task: &TaskKey) {
        self.ask(task, &self.shared.keys.state(task));
        self.ask(task, &format!("{}?{TARGET}", self.shared.keys.state(task)));
    }

    /// The answer comes like any other news.
    fn ask(&self, task: &TaskKey, selector: &str) {
        let (shared, of) = (Arc::clone(&self.shared), task.clone());
        let answer = move |reply: Reply| {
            if let Ok(sample) = reply.result() {
                shared.inbox.put_state(&of, sample, shared.now());
            }
        };
        let asked = self
            .shared
            .session
            .get(selector)
            .target(QueryTarget::BestMatching)
            .consolidation(ConsolidationMode::None)
            // Never to this worker's own wildcard: it answers for nobody, and Zenoh may hold the session's lock when such a query ends.
            .allowed_destination(Locality::Remote)
            .timeout(ANSWER)
            .callback(answer)
            .wait();
        if let Err(error) = asked {
            tracing::debug!(%task, %error, "the owner could not be asked");
        }
    }

    /// Every task of others: a question that lands here instead of there is not answered with "no such task".
    fn known(&self) -> impl Iterator<Item = &TaskKey> {
        self.owners.keys().chain(self.records.iter().map(|(task, _)| task))
    }
}

/// A message on the `state` of a task, which must be of that task.
fn read_state(of: &TaskKey, json: &ZBytes) -> Result<StateMessage, String> {
    let message = StateMessage::read(&json.to_bytes()).map_err(|error| error.to_string())?;
    match message.owner() {
        (task, ..) if task == of => Ok(message),
        (task, ..) => Err(format!("it is of task {task}")),
    }
}
