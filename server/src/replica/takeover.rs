//! Going on with a lost task: whose turn it is, whether this worker can, and the task made ready before it is needed.

use domvs_proto::keys::TaskKey;
use zenoh::Wait;

use super::records::Record;
use super::{AGAIN, ALONE, DOUBT, JOINING, Mode, SETTLING, Standby, TURN, epoch, rendezvous};
use crate::Moment;
use crate::desk::lock;
use crate::ownership::SecretCheck;
use crate::registrar::{Adoption, Job, Seed, decode_limits};
use crate::task::Task;

/// How much time a look at a lost task took.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Followed {
    Quickly,
    /// Its target had to be decoded.
    Slowly,
}

impl Standby {
    /// Takes a lost task if it is this worker's turn.
    pub(super) fn follow(&mut self, task: &TaskKey, now: Moment) -> Followed {
        if lock(&self.shared.desks).contains_key(&task.to_string()) {
            self.records.remove(task);
            return Followed::Quickly;
        }
        let Some(record) = self.records.get(task) else { return Followed::Quickly };
        let lost = record.lost.unwrap_or(now);
        let rank = rendezvous::rank(task, &self.shared.worker, self.workers.iter());
        let settling = if self.hears_others() { SETTLING } else { ALONE };
        let turn = lost + settling + TURN * rank as u32;
        let waits = record.taken.is_some_and(|taken| now.saturating_sub(taken) < AGAIN);
        let is_early = now < turn || now < self.joined + JOINING || waits || !record.is_complete();
        if is_early || self.shared.inbox.newest_owner(task).is_some() {
            return Followed::Quickly;
        }
        if self.is_isolated() {
            self.joined = now;
            return Followed::Quickly;
        }
        if !self.has_room_for(task) {
            return Followed::Quickly;
        }
        self.take_over(task, lost, now)
    }

    fn take_over(&mut self, task: &TaskKey, lost: Moment, now: Moment) -> Followed {
        let shared = std::sync::Arc::clone(&self.shared);
        let Some(record) = self.records.get_mut(task) else { return Followed::Quickly };
        record.taken = Some(now);
        let Some(epoch) = epoch::next(record.owner().0, &shared.worker) else {
            tracing::error!(%task, "the task has had 65535 owners and gets no other");
            return Followed::Quickly;
        };
        let (made, followed) = match record.prepared.take() {
            Some(prepared) => (Ok(prepared), Followed::Quickly),
            None => (prepare(record, &shared), Followed::Slowly),
        };
        let mut made = match made {
            Ok(made) => made,
            Err(error) => {
                tracing::error!(%task, %error, "the target of a lost task cannot be used here");
                return followed;
            }
        };
        made.go_on(&record.state.progress);
        let secret = SecretCheck::by_hash(record.state.secret_hash);
        let frame_secret = SecretCheck::by_hash(record.state.frame_secret_hash);
        let stops_since = record.heard.saturating_sub(DOUBT);
        let seed = Seed { key: task.clone(), epoch, secret, frame_secret, task: *made, stops_since };
        shared.give(Job::Adopt(Box::new(Adoption { seed, progress: record.state.progress, lost })));
        followed
    }

    /// Whether this worker's limits allow the task. If not, the next one takes it.
    fn has_room_for(&self, task: &TaskKey) -> bool {
        let Some(record) = self.records.get(task) else { return false };
        self.shared.has_room_for(task, &record.state.settings)
    }

    /// Somebody else's token is still there, so the own link is too.
    fn hears_others(&self) -> bool {
        self.workers.len() > 1 || self.shared.hears_clients()
    }

    /// A worker without a link sees every token go. It cannot know who lives, and nobody would hear of a takeover.
    fn is_isolated(&self) -> bool {
        let info = self.shared.session.info();
        self.mode != Mode::Router
            && info.routers_zid().wait().next().is_none()
            && info.peers_zid().wait().next().is_none()
    }

    /// Makes one task ready that this worker would take over if its owner were lost now. Returns whether there was one.
    pub(super) fn prepare_one(&mut self) -> bool {
        let most = self.shared.config.replica.prepared;
        if self.records.iter().filter(|(_, record)| record.prepared.is_some()).count() >= most {
            return false;
        }
        let first = |record: &Record| {
            let others = self.workers.iter().filter(|worker| **worker != record.state.worker);
            rendezvous::rank(&record.state.task, &self.shared.worker, others) == 0
        };
        let wanting = |record: &Record| {
            record.prepared.is_none() && !record.refused && record.target.is_some() && record.released.is_none()
        };
        let next = self.records.iter().find(|(_, record)| wanting(record) && first(record));
        let Some(task) = next.map(|(task, _)| task.clone()) else { return false };
        let shared = std::sync::Arc::clone(&self.shared);
        let Some(record) = self.records.get_mut(&task) else { return false };
        match prepare(record, &shared) {
            Ok(made) => record.prepared = Some(made),
            Err(error) => {
                record.refused = true;
                tracing::warn!(%task, %error, "the target of another worker's task cannot be used here");
            }
        }
        true
    }
}

/// The task with its target decoded and its bases made.
fn prepare(record: &Record, shared: &crate::worker::Shared) -> Result<Box<Task>, String> {
    let mut task = Box::new(Task::new(record.state.settings.clone(), decode_limits(shared)));
    if let Some(target) = &record.target {
        task.take_target(target.clone()).map_err(|error| error.to_string())?;
    }
    Ok(task)
}
