//! The state directory: what a worker alone owns, kept over its restart.
//!
//! One file for each task, written whole under another name, flushed, renamed, and the directory flushed; so after a crash at any moment there
//! is the old file or the new one. A thread of its own writes, the newest state of each task and no other. What cannot be written is tried
//! again, and said in `info`, in `status` and in the log; nothing else stops.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use domvs_proto::keys::TaskKey;
use domvs_proto::messages::{Phase, TaskState};
use domvs_proto::status::Status;

use crate::desk::lock;
use crate::replica::Carried;
use crate::state_file;
use crate::task::SentTarget;

/// What the files are called after `<client>.<id>`; no name has a dot.
const ENDING: &str = ".task";
const UNFINISHED: &str = ".new";
/// A file that could not be used is kept under this ending, for people to look at.
const REFUSED: &str = ".refused";
/// Changes that wait for a disk that cannot be written.
const MOST_WAITING: usize = 20_000;
/// What could not be written is tried again after this.
const AGAIN: Duration = Duration::from_secs(1);

/// Writes the states of tasks, the newest of each.
pub(crate) struct StateDir {
    shared: Arc<Shared>,
    writer: Mutex<Option<JoinHandle<()>>>,
}

/// A task's state, and its target if it has one.
type Kept = (TaskState, Option<SentTarget>);

struct Shared {
    folder: PathBuf,
    waiting: Mutex<Waiting>,
    changed: Condvar,
    /// Why the last writing failed.
    failed: Mutex<Option<String>>,
    /// Why files were refused at the start.
    refused: Option<String>,
}

#[derive(Default)]
struct Waiting {
    /// By task: what to write, or `None` to remove the file.
    changes: BTreeMap<TaskKey, Option<Kept>>,
    writing: bool,
    closed: bool,
}

impl StateDir {
    /// Opens or makes the folder, and reads what is in it: the tasks of a worker that ended, those that ran as `paused`.
    ///
    /// # Errors
    /// A folder that cannot be made or listed. Files that cannot be used are only reported.
    pub(crate) fn open(folder: &Path) -> io::Result<(StateDir, Vec<Carried>)> {
        fs::create_dir_all(folder)?;
        // A disk that takes nothing is told of now, not when the first task is to be kept.
        let probe = folder.join(format!("probe{UNFINISHED}"));
        File::create(&probe).and_then(|_| fs::remove_file(&probe))?;
        let (mut kept, mut refused) = (vec![], vec![]);
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            if name.ends_with(UNFINISHED) {
                // What a crash has left half done. If it cannot go now, it is written over later.
                let _ = fs::remove_file(&path);
            } else if name.ends_with(ENDING) {
                match read(&path, &name) {
                    Ok(carried) => kept.push(carried),
                    Err(reason) => refused.push(put_aside(&path, &name, &reason)),
                }
            }
        }
        let refused = (!refused.is_empty()).then(|| refused.join("; "));
        let shared = Arc::new(Shared {
            folder: folder.to_owned(),
            waiting: Mutex::default(),
            changed: Condvar::new(),
            failed: Mutex::default(),
            refused,
        });
        let writer = {
            let shared = Arc::clone(&shared);
            std::thread::Builder::new().name("domvs-state".to_owned()).spawn(move || shared.write_all())?
        };
        tracing::info!(folder = %folder.display(), tasks = kept.len(), "state directory");
        Ok((StateDir { shared, writer: Mutex::new(Some(writer)) }, kept))
    }

    /// Writes this state in a while, unless a newer one comes before. Never waits for the disk.
    pub(crate) fn save(&self, state: TaskState, target: Option<SentTarget>) {
        self.shared.change(state.task.clone(), Some((state, target)));
    }

    /// Removes a task that was closed, or that another worker has.
    pub(crate) fn remove(&self, task: &TaskKey) {
        self.shared.change(task.clone(), None);
    }

    /// What is wrong now; `None` when everything is written, or is about to be.
    pub(crate) fn error(&self) -> Option<String> {
        lock(&self.shared.failed).clone().or_else(|| self.shared.refused.clone())
    }

    /// Writes what waits, for `limit` at most, and ends.
    pub(crate) fn close(&self, limit: Duration) {
        let deadline = Instant::now() + limit;
        let mut waiting = lock(&self.shared.waiting);
        waiting.closed = true;
        self.shared.changed.notify_all();
        while waiting.writing || !waiting.changes.is_empty() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return tracing::error!(tasks = waiting.changes.len(), "states were not saved in time");
            }
            waiting = match self.shared.changed.wait_timeout(waiting, left) {
                Ok((waiting, _)) => waiting,
                Err(poisoned) => poisoned.into_inner().0,
            };
        }
        drop(waiting);
        if let Some(writer) = lock(&self.writer).take()
            && writer.join().is_err()
        {
            tracing::error!("the writer of states ended by a panic");
        }
    }
}

impl Shared {
    fn change(&self, task: TaskKey, change: Option<Kept>) {
        let mut waiting = lock(&self.waiting);
        if change.is_none() && waiting.changes.len() >= MOST_WAITING {
            // A disk that cannot be written and many tasks that come and go: the file comes back as a task that nobody uses.
            return;
        }
        waiting.changes.insert(task, change);
        drop(waiting);
        self.changed.notify_all();
    }

    fn write_all(&self) {
        while let Some((task, change)) = self.next() {
            let written = match &change {
                Some((state, target)) => {
                    write_whole(&self.folder, &file_name(&task), &state_file::encode(state, target.as_ref()))
                }
                None => remove_file(&self.folder, &file_name(&task)),
            };
            let mut waiting = lock(&self.waiting);
            waiting.writing = false;
            match written {
                Ok(()) => *lock(&self.failed) = None,
                Err(error) => {
                    let text = format!("{}: {error}", self.folder.join(file_name(&task)).display());
                    if lock(&self.failed).replace(text).is_none() {
                        tracing::error!(%task, %error, folder = %self.folder.display(), "the state cannot be saved; it is tried again");
                    }
                    // A newer one that has come meanwhile is the one to write.
                    waiting.changes.entry(task).or_insert(change);
                    if waiting.closed {
                        waiting.changes.clear();
                    } else {
                        // Woken early by the next change, which may find room.
                        drop(self.changed.wait_timeout(waiting, AGAIN));
                        self.changed.notify_all();
                        continue;
                    }
                }
            }
            drop(waiting);
            self.changed.notify_all();
        }
    }

    /// What to write next; `None` when nothing more comes.
    fn next(&self) -> Option<(TaskKey, Option<Kept>)> {
        let mut waiting = lock(&self.waiting);
        loop {
            if let Some(next) = waiting.changes.pop_first() {
                waiting.writing = true;
                return Some(next);
            }
            if waiting.closed {
                return None;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(std::sync::PoisonError::into_inner);
        }
    }
}

fn file_name(task: &TaskKey) -> String {
    format!("{}.{}{ENDING}", task.client, task.id)
}

/// The old file or the new one, whatever happens on the way.
fn write_whole(folder: &Path, name: &str, bytes: &[u8]) -> io::Result<()> {
    let unfinished = folder.join(format!("{name}{UNFINISHED}"));
    let mut file = File::create(&unfinished)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    drop(file);
    fs::rename(&unfinished, folder.join(name))?;
    File::open(folder)?.sync_all()
}

fn remove_file(folder: &Path, name: &str) -> io::Result<()> {
    match fs::remove_file(folder.join(name)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => File::open(folder)?.sync_all(),
    }
}

fn read(path: &Path, name: &str) -> Result<Carried, String> {
    let bytes = fs::read(path).map_err(|error| error.to_string())?;
    let (state, target) = state_file::decode(&bytes).map_err(|error| error.to_string())?;
    if file_name(&state.task) != name {
        return Err(format!("it is the file of task {}", state.task));
    }
    let begins_by_itself = state.settings.autostart && state.target.is_some();
    let phase = state.progress.phase;
    let mut carried = Carried { state, target };
    // Nothing moves after a restart before somebody says so, not by its first frame either.
    if phase == Phase::Running || phase == Phase::Idle && begins_by_itself {
        carried.latch(Status::Paused);
    }
    Ok(carried)
}

/// Keeps a file that cannot be used under another name. Returns what to say about it.
fn put_aside(path: &Path, name: &str, reason: &str) -> String {
    tracing::error!(file = %path.display(), reason, "refused: the task in this file is not restored");
    let mut aside = path.as_os_str().to_owned();
    aside.push(REFUSED);
    // On a disk that cannot be written it stays, and is refused again.
    let _ = fs::rename(path, aside);
    format!("{name} was refused: {reason}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state_file::tests::task;

    const LIMIT: Duration = Duration::from_secs(20);

    fn reopen(folder: &Path) -> (StateDir, Vec<Carried>) {
        StateDir::open(folder).expect("a folder")
    }

    /// A folder with one task in it, and the file.
    fn saved(payload: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let (states, kept) = reopen(folder.path());
        assert!(kept.is_empty());
        let (state, target) = task(Some(payload));
        states.save(state, target);
        states.close(LIMIT);
        assert_eq!(states.error(), None);
        let file = folder.path().join("alice.t1.task");
        assert!(file.exists());
        (folder, file)
    }

    #[test]
    fn a_restart_finds_the_task_and_what_ran_is_paused() {
        let (folder, _) = saved(&[5; 64]);
        let (states, kept) = reopen(folder.path());
        let [Carried { state, target }] = &kept[..] else { panic!("one task, got {}", kept.len()) };
        assert_eq!(state.progress.phase, Phase::Latched(Status::Paused));
        assert_eq!(target.as_ref().map(|target| target.payload.clone()), Some(vec![5; 64]));
        states.remove(&state.task);
        states.close(LIMIT);
        assert!(reopen(folder.path()).1.is_empty(), "a closed task does not come back");
    }

    #[test]
    fn what_would_start_by_its_first_frame_is_paused_by_a_restart() {
        for (autostart, payload, phase) in [
            (true, Some(&[5; 64][..]), Phase::Latched(Status::Paused)),
            (false, Some(&[5; 64][..]), Phase::Idle),
            (true, None, Phase::Idle),
        ] {
            let folder = tempfile::tempdir().expect("a folder");
            let (states, _) = reopen(folder.path());
            let (mut state, target) = task(payload);
            (state.progress.phase, state.settings.autostart) = (Phase::Idle, autostart);
            states.save(state, target);
            states.close(LIMIT);
            assert_eq!(reopen(folder.path()).1[0].state.progress.phase, phase, "{autostart}");
        }
    }

    #[test]
    fn a_crash_at_any_byte_of_the_next_write_leaves_the_old_state() {
        let (folder, file) = saved(&[5; 64]);
        let (state, target) = task(Some(&[6; 64]));
        let next = state_file::encode(&state, target.as_ref());
        let unfinished = folder.path().join("alice.t1.task.new");
        for length in (0..=next.len()).step_by(7).chain([next.len()]) {
            fs::write(&unfinished, &next[..length]).expect("written");
            let (states, kept) = reopen(folder.path());
            let payload = kept[0].target.as_ref().map(|target| target.payload.clone());
            assert_eq!((kept.len(), payload, states.error()), (1, Some(vec![5; 64]), None), "cut at {length}");
            assert!(!unfinished.exists());
            states.close(LIMIT);
        }
        // Once it has been renamed it is the new one.
        fs::write(&unfinished, &next).expect("written");
        fs::rename(&unfinished, &file).expect("renamed");
        let (_, kept) = reopen(folder.path());
        assert_eq!(kept[0].target.as_ref().map(|target| target.payload.clone()), Some(vec![6; 64]));
    }

    #[test]
    fn a_file_that_was_cut_is_refused_kept_aside_and_reported() {
        let (folder, file) = saved(&[5; 64]);
        let whole = fs::read(&file).expect("readable");
        fs::write(&file, &whole[..whole.len() - 1]).expect("written");
        let (states, kept) = reopen(folder.path());
        assert!(kept.is_empty());
        let error = states.error().expect("reported");
        assert!(error.contains("alice.t1.task") && error.contains("bytes"), "{error}");
        assert!(folder.path().join("alice.t1.task.refused").exists());
    }

    #[test]
    fn a_file_under_another_tasks_name_is_refused() {
        let (folder, file) = saved(&[5; 64]);
        fs::rename(&file, folder.path().join("bob.t1.task")).expect("renamed");
        let (states, kept) = reopen(folder.path());
        assert!(kept.is_empty() && states.error().is_some_and(|error| error.contains("alice/t1")));
    }

    #[test]
    fn what_cannot_be_written_is_said_and_written_later() {
        let folder = tempfile::tempdir().expect("a folder");
        let (states, _) = reopen(folder.path());
        // A folder in the place of the unfinished file: nobody can write there, not even root.
        let in_the_way = folder.path().join("alice.t1.task.new");
        fs::create_dir(&in_the_way).expect("made");
        let (state, target) = task(Some(&[5; 64]));
        states.save(state.clone(), target.clone());
        let begin = Instant::now();
        while states.error().is_none() {
            assert!(begin.elapsed() < LIMIT, "the failure is never said");
            std::thread::yield_now();
        }
        fs::remove_dir(&in_the_way).expect("removed");
        states.save(state, target);
        while states.error().is_some() {
            assert!(begin.elapsed() < LIMIT, "never written");
            std::thread::yield_now();
        }
        states.close(LIMIT);
        assert_eq!(reopen(folder.path()).1.len(), 1);
    }
}
