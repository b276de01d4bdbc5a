//! What a standby knows of the others' tasks: the newest state of each, its target, and, for those it would take over, the task made ready.
//!
//! Bounded in number and in bytes: what finds no room is counted and left out, and asked for again when there is room.

use std::collections::BTreeMap;

use domvs_proto::frame::FrameHeader;
use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::{TaskProgress, TaskState};

use super::{INCOMPLETE, RELEASED, UNOWNED};
use crate::Moment;
use crate::task::{SentTarget, Task};

/// What is known of one task.
pub(crate) struct Record {
    pub(crate) state: TaskState,
    /// The target, if it is the one that the state names.
    pub(crate) target: Option<SentTarget>,
    /// The task with its target set and its bases made.
    pub(crate) prepared: Option<Box<Task>>,
    /// It could not be made ready.
    pub(crate) refused: bool,
    /// It was this worker's own before.
    pub(crate) own: bool,
    /// Since when nobody has owned it, though it was not closed.
    pub(crate) lost: Option<Moment>,
    /// Since when its owner, who lives, has not owned it: it was closed, or the rest of the news is still on its way.
    pub(crate) released: Option<Moment>,
    /// When its owner was last asked for what is missing.
    pub(crate) asked: Option<Moment>,
    /// A takeover was begun then.
    pub(crate) taken: Option<Moment>,
    /// The newest owner whose token has been seen: its state may not have come yet.
    pub(crate) owner: Option<(u32, Name)>,
    /// When the state first came.
    pub(crate) since: Moment,
    /// When the owner last said something.
    pub(crate) heard: Moment,
}

impl Record {
    pub(crate) fn new(state: TaskState, now: Moment) -> Record {
        Record {
            state,
            target: None,
            prepared: None,
            refused: false,
            own: false,
            lost: None,
            released: None,
            asked: None,
            taken: None,
            owner: None,
            since: now,
            heard: now,
        }
    }

    /// Who owned it last, by token or by state.
    pub(crate) fn owner(&self) -> (u32, &Name) {
        let by_state = (self.state.epoch, &self.state.worker);
        self.owner.as_ref().map_or(by_state, |(epoch, worker)| by_state.max((*epoch, worker)))
    }

    /// Whether nobody will own it any more: it was given up, its target never came, or it never had an owner that could be seen.
    pub(crate) fn is_over(&self, now: Moment) -> bool {
        let past = |since: Option<Moment>, limit| since.is_some_and(|since| now.saturating_sub(since) > limit);
        past(self.released, RELEASED)
            || !self.is_complete() && past(self.lost, INCOMPLETE)
            || !self.own && self.owner.is_none() && past(Some(self.since), UNOWNED)
    }

    /// Whether all is here that a new owner needs.
    pub(crate) fn is_complete(&self) -> bool {
        self.state.target.is_none() || self.target.is_some()
    }

    fn bytes(&self) -> usize {
        let mask = self.state.settings.preprocess.mask.as_ref().map_or(0, |mask| mask.png.len());
        size_of::<Record>() + mask + self.target.as_ref().map_or(0, |target| target.payload.len())
    }
}

/// All records of a standby.
pub(crate) struct Records {
    by_task: BTreeMap<TaskKey, Record>,
    most_tasks: usize,
    most_bytes: usize,
    bytes: usize,
    /// States and targets that found no room.
    pub(crate) left_out: u64,
}

impl Records {
    pub(crate) fn new(most_tasks: usize, most_bytes: usize) -> Records {
        Records { by_task: BTreeMap::new(), most_tasks, most_bytes, bytes: 0, left_out: 0 }
    }

    pub(crate) fn get_mut(&mut self, task: &TaskKey) -> Option<&mut Record> {
        self.by_task.get_mut(task)
    }

    pub(crate) fn get(&self, task: &TaskKey) -> Option<&Record> {
        self.by_task.get(task)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (&TaskKey, &Record)> {
        self.by_task.iter()
    }

    pub(crate) fn iter_mut(&mut self) -> impl Iterator<Item = (&TaskKey, &mut Record)> {
        self.by_task.iter_mut()
    }

    pub(crate) fn len(&self) -> usize {
        self.by_task.len()
    }

    /// Takes a whole state, unless a newer owner's is known, or the task was this worker's and nobody else's token has come. What was
    /// made for other settings or another target goes.
    ///
    /// Fails for a known task with another secret: a task keeps its secret, whoever owns it.
    pub(crate) fn put_state(&mut self, state: TaskState, received: Moment) -> Result<(), String> {
        let Some(record) = self.by_task.get_mut(&state.task) else {
            self.insert(Record::new(state, received));
            return Ok(());
        };
        let secrets = |state: &TaskState| (state.secret_hash, state.frame_secret_hash);
        if secrets(&state) != secrets(&record.state) {
            return Err(format!("worker {} says another secret than the one that the task has", state.worker));
        }
        if record.own || (state.epoch, state.revision) < (record.state.epoch, record.state.revision) {
            return Ok(());
        }
        record.heard = received;
        let before = record.bytes();
        let same_target = state.target == record.state.target;
        if !same_target {
            record.target = None;
        }
        if !same_target || state.settings != record.state.settings {
            (record.prepared, record.refused) = (None, false);
        }
        record.state = state;
        self.bytes = self.bytes - before + record.bytes();
        Ok(())
    }

    /// Takes the small part of a known task. Returns whether the rest of it is known as its owner last said it.
    pub(crate) fn put_progress(&mut self, news: &TaskProgress, received: Moment) -> bool {
        let Some(record) = self.by_task.get_mut(&news.task) else { return false };
        let known = &mut record.state;
        // What was said before the whole that is known is over: a pause, say.
        if !record.own && known.epoch == news.epoch && known.worker == news.worker && news.revision >= known.revision {
            known.progress = news.progress;
            record.heard = received;
        }
        (known.epoch, known.revision) >= (news.epoch, news.revision)
    }

    /// Takes a target, if it is the one that the state names.
    pub(crate) fn put_target(&mut self, task: &TaskKey, header: FrameHeader, encoding: String, payload: Vec<u8>) {
        let room = self.most_bytes.saturating_sub(self.bytes);
        let Some(record) = self.by_task.get_mut(task) else { return };
        if record.target.is_some() {
            return;
        }
        if payload.len() > room {
            self.left_out += 1;
            tracing::warn!(%task, bytes = payload.len(), room, "no room for the target of another worker's task");
            return;
        }
        let target = SentTarget::new(header, encoding, payload);
        if record.state.target.as_ref().is_some_and(|reference| reference.hash == target.hash()) {
            self.bytes += target.payload.len();
            record.target = Some(target);
        }
    }

    /// What this worker owned, or knew to be lost, before its session ended; its own limits are looked at when it takes it up.
    pub(crate) fn insert_own(&mut self, record: Record) {
        self.bytes += record.bytes();
        self.by_task.insert(record.state.task.clone(), record);
    }

    fn insert(&mut self, record: Record) {
        if self.by_task.len() >= self.most_tasks || self.bytes + record.bytes() > self.most_bytes {
            self.left_out += 1;
            tracing::warn!(task = %record.state.task, tasks = self.len(), bytes = self.bytes, "no room for another worker's task");
            return;
        }
        let key = record.state.task.clone();
        self.remove(&key);
        self.bytes += record.bytes();
        self.by_task.insert(key, record);
    }

    /// Forgets every task of which this is true.
    pub(crate) fn forget(&mut self, over: impl Fn(&Record) -> bool) {
        let tasks: Vec<TaskKey> =
            self.iter().filter(|(_, record)| over(record)).map(|(task, _)| task.clone()).collect();
        tasks.iter().for_each(|task| _ = self.remove(task));
    }

    pub(crate) fn remove(&mut self, task: &TaskKey) -> Option<Record> {
        let record = self.by_task.remove(task)?;
        self.bytes -= record.bytes();
        Some(record)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use domvs_proto::frame::{PixelFormat, Secret};
    use domvs_proto::messages::{FramesDropped, Phase, Progress, TargetReference};
    use domvs_proto::settings::{Camera, TaskSettings};
    use domvs_proto::status::Status;

    use super::*;

    fn progress(twists: u64) -> Progress {
        Progress {
            status: Status::Servoing,
            phase: Phase::Running,
            twists,
            held_frames: 0,
            sequence: 0,
            initial_pixel_mse: None,
            initial_order_mse: None,
            frames_in: 0,
            frames_dropped: FramesDropped::default(),
        }
    }

    fn news(epoch: u32, revision: u64, twists: u64) -> TaskProgress {
        let TaskState { task, worker, .. } = state(1, epoch, None);
        TaskProgress { task, worker, epoch, revision, progress: progress(twists) }
    }

    const NOW: Moment = Duration::from_secs(100);

    fn put(records: &mut Records, state: TaskState) {
        records.put_state(state, NOW).expect("its secret");
    }

    fn header() -> FrameHeader {
        FrameHeader::new(PixelFormat::Mono8, 8, 8)
    }

    fn state(id: usize, epoch: u32, target: Option<&[u8]>) -> TaskState {
        let camera = Camera { fx: 9.0, fy: 9.0, cx: 3.5, cy: 3.5, width: 8, height: 8, distortion: None };
        TaskState {
            task: format!("alice/t{id}").parse().expect("a task"),
            worker: "w1".try_into().expect("a name"),
            epoch,
            revision: 1,
            secret_hash: Secret::new([7; 16]).hash(),
            frame_secret_hash: Secret::new([7; 16]).for_frames().hash(),
            settings: TaskSettings::new(camera),
            target: target.map(|payload| TargetReference {
                hash: SentTarget::new(header(), String::new(), payload.to_vec()).hash().to_owned(),
                width: 8,
                height: 8,
                payload_bytes: 64,
            }),
            progress: progress(0),
        }
    }

    #[test]
    fn a_state_needs_its_own_target_to_be_complete() {
        let mut records = Records::new(10, 1 << 20);
        let state = state(1, 5, Some(&[1; 64]));
        let task = state.task.clone();
        put(&mut records, state);
        records.put_target(&task, header(), String::new(), vec![2; 64]);
        assert!(!records.get(&task).expect("known").is_complete(), "another target");
        records.put_target(&task, header(), String::new(), vec![1; 64]);
        assert!(records.get(&task).expect("known").is_complete());
    }

    #[test]
    fn an_older_owner_changes_nothing() {
        let mut records = Records::new(10, 1 << 20);
        let task = state(1, 5, None).task;
        put(&mut records, state(1, 5, None));
        put(&mut records, state(1, 4, Some(&[1; 64])));
        assert!(records.put_progress(&news(4, 9, 9), NOW), "nothing is missing");
        let known = &records.get(&task).expect("known").state;
        assert_eq!((known.epoch, known.progress.twists, known.target.is_none()), (5, 0, true));
        assert!(!records.put_progress(&news(6, 1, 9), NOW), "a newer owner's state is missing");
    }

    #[test]
    fn a_revision_that_was_missed_is_noticed() {
        let mut records = Records::new(10, 1 << 20);
        let task = state(1, 5, None).task;
        assert!(!records.put_progress(&news(5, 1, 3), NOW), "nothing is known");
        put(&mut records, state(1, 5, None));
        assert!(records.put_progress(&news(5, 1, 4), NOW));
        assert_eq!(records.get(&task).expect("known").state.progress.twists, 4);
        assert!(!records.put_progress(&news(5, 2, 5), NOW), "the settings have changed meanwhile");
    }

    #[test]
    fn a_task_keeps_its_secret_whatever_a_newer_state_says() {
        let mut records = Records::new(10, 1 << 20);
        put(&mut records, state(1, 5, None));
        let stolen = Secret::new([8; 16]);
        for forged in [
            TaskState { secret_hash: stolen.hash(), revision: 1 << 63, ..state(1, 5, None) },
            TaskState { frame_secret_hash: stolen.hash(), ..state(1, 6, None) },
        ] {
            let task = forged.task.clone();
            assert!(records.put_state(forged, NOW).expect_err("refused").contains("secret"));
            assert_eq!(records.get(&task).expect("known").state, state(1, 5, None));
        }
    }

    #[test]
    fn what_was_this_workers_own_is_changed_by_nobody_before_another_owners_token() {
        let mut records = Records::new(10, 1 << 20);
        let task = state(1, 5, None).task;
        records.insert_own(Record { own: true, ..Record::new(state(1, 5, None), NOW) });
        put(&mut records, TaskState { revision: 9, ..state(1, 7, Some(&[1; 64])) });
        records.put_progress(&news(5, 9, 9), NOW);
        assert_eq!(records.get(&task).expect("known").state, state(1, 5, None));
        records.get_mut(&task).expect("known").own = false;
        put(&mut records, TaskState { revision: 9, ..state(1, 7, Some(&[1; 64])) });
        assert_eq!(records.get(&task).expect("known").state.epoch, 7);
    }

    #[test]
    fn progress_of_before_the_whole_that_is_known_changes_nothing() {
        let mut records = Records::new(10, 1 << 20);
        let task = state(1, 5, None).task;
        put(&mut records, TaskState { revision: 2, ..state(1, 5, None) });
        assert!(records.put_progress(&news(5, 1, 9), NOW), "nothing is missing");
        assert_eq!(records.get(&task).expect("known").state.progress.twists, 0);
    }

    #[test]
    fn the_last_owner_is_the_one_whose_token_or_state_came_last() {
        let mut record = Record::new(state(1, 5, None), NOW);
        let by_state = record.state.worker.clone();
        assert_eq!(record.owner(), (5, &by_state));
        let next: Name = "w9".try_into().expect("a name");
        record.owner = Some((6, next.clone()));
        assert_eq!(record.owner(), (6, &next), "its state has not come");
        record.state.epoch = 7;
        assert_eq!(record.owner(), (7, &by_state));
    }

    #[test]
    fn a_state_without_an_owner_is_forgotten() {
        let mut records = Records::new(10, 1 << 20);
        (1..=3).for_each(|id| put(&mut records, state(id, 5, None)));
        records.get_mut(&state(2, 5, None).task).expect("known").owner = Some((5, "w1".try_into().expect("a name")));
        records.get_mut(&state(3, 5, None).task).expect("known").own = true;
        records.forget(|record| record.is_over(NOW + UNOWNED));
        assert_eq!(records.len(), 3);
        records.forget(|record| record.is_over(NOW + UNOWNED + Duration::from_millis(1)));
        assert_eq!(records.len(), 2);
        assert!(records.get(&state(1, 5, None).task).is_none());
    }

    #[test]
    fn tasks_and_bytes_are_bounded_and_what_goes_makes_room() {
        let mut records = Records::new(2, 100_000);
        (1..=3).for_each(|id| put(&mut records, state(id, 1, Some(&[id as u8; 90_000]))));
        assert_eq!((records.len(), records.left_out), (2, 1));
        let tasks = [1, 2].map(|id| state(id, 1, None).task);
        for (task, id) in tasks.iter().zip([1, 2]) {
            records.put_target(task, header(), String::new(), vec![id; 90_000]);
        }
        let complete =
            |records: &Records| tasks.clone().map(|task| records.get(&task).is_some_and(Record::is_complete));
        assert_eq!((complete(&records), records.left_out), ([true, false], 2));
        records.remove(&tasks[0]);
        records.put_target(&tasks[1], header(), String::new(), vec![2; 90_000]);
        assert_eq!(complete(&records), [false, true]);
        records.remove(&tasks[1]);
        assert_eq!(records.bytes, 0);
    }
}
