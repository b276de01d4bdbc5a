//! The queue between the callers, who never wait, and the one thread that writes.
//!
//! One order, three lanes: frames, targets and notes (twists, statuses, settings). Each lane bounds its own count and bytes, so
//! a slow disk costs frames first and twists last. What does not fit is dropped and counted. The lock is held only to
//! move one entry in or out, never while writing.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use domvs_proto::frame::{self, HEADER_BYTES};
use zenoh::bytes::ZBytes;

use super::file::WrittenAs;

const FRAME_BYTES: usize = 64 << 20;
const TARGETS: usize = 16;
const NOTES: usize = 8192;
const NOTE_BYTES: usize = 8 << 20;

/// One message on its way to the file.
#[derive(Debug)]
pub(super) struct Entry {
    /// The Zenoh key, which becomes the topic.
    pub key: String,
    pub received_ns: u64,
    pub body: Body,
}

#[derive(Debug)]
pub(super) enum Body {
    Frame { header: [u8; HEADER_BYTES], picture: Picture, payload: ZBytes },
    Target { header: [u8; HEADER_BYTES], picture: Picture, payload: ZBytes },
    Twist([u8; 128]),
    Status(String),
    Settings(String),
}

/// What a frame's payload is: the header says (raw), or the Encoding does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Picture {
    Raw,
    Png,
    Jpeg,
}

impl Picture {
    pub(super) fn named(encoding: &str) -> Picture {
        match encoding {
            frame::PNG => Picture::Png,
            frame::JPEG => Picture::Jpeg,
            _ => Picture::Raw,
        }
    }

    pub(super) fn media_type(self) -> Option<&'static str> {
        match self {
            Picture::Raw => None,
            Picture::Png => Some(frame::PNG),
            Picture::Jpeg => Some(frame::JPEG),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lane {
    Frames,
    Targets,
    Notes,
}

impl Body {
    pub(super) fn lane(&self) -> Lane {
        match self {
            Body::Frame { .. } => Lane::Frames,
            Body::Target { .. } => Lane::Targets,
            Body::Twist(_) | Body::Status(_) | Body::Settings(_) => Lane::Notes,
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Body::Frame { payload, .. } | Body::Target { payload, .. } => HEADER_BYTES + payload.len(),
            Body::Twist(twist) => twist.len(),
            Body::Status(json) | Body::Settings(json) => json.len(),
        }
    }
}

/// How much may wait in one lane.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Room {
    pub count: usize,
    pub bytes: usize,
}

/// How much may wait in each lane: frames, targets, notes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits(pub [Room; 3]);

impl Limits {
    pub(super) fn for_frames(count: usize) -> Limits {
        let room = |count, bytes| Room { count, bytes };
        Limits([room(count, FRAME_BYTES), room(TARGETS, FRAME_BYTES), room(NOTES, NOTE_BYTES)])
    }
}

/// How many messages of each lane.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LaneCounts {
    /// Frames.
    pub frames: u64,
    /// Targets.
    pub targets: u64,
    /// Twists, statuses and settings.
    pub notes: u64,
}

impl LaneCounts {
    /// All lanes together.
    pub fn total(&self) -> u64 {
        self.frames + self.targets + self.notes
    }

    fn and(&self, more: &LaneCounts) -> LaneCounts {
        LaneCounts {
            frames: self.frames + more.frames,
            targets: self.targets + more.targets,
            notes: self.notes + more.notes,
        }
    }

    fn add_one(&mut self, lane: Lane) {
        match lane {
            Lane::Frames => self.frames += 1,
            Lane::Targets => self.targets += 1,
            Lane::Notes => self.notes += 1,
        }
    }
}

/// What has become of the messages of a recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RecordCounts {
    /// Given to the file. The last second of them may be lost if the process is killed or a write fails.
    pub written: LaneCounts,
    /// Dropped: the queue was full, the recording was closed or had failed, or the file has no channel left.
    pub dropped: LaneCounts,
    /// A write failed and ended the recording.
    pub failed: bool,
}

impl RecordCounts {
    /// The messages of two recordings; whether the later one, `more`, has failed.
    pub(crate) fn and(&self, more: &RecordCounts) -> RecordCounts {
        let (written, dropped) = (self.written.and(&more.written), self.dropped.and(&more.dropped));
        RecordCounts { written, dropped, failed: more.failed }
    }
}

/// What the writer does next.
#[derive(Debug)]
pub(super) enum Next {
    Entry(Entry),
    Idle,
    Closed,
}

#[derive(Debug)]
pub(super) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug)]
struct State {
    entries: VecDeque<Entry>,
    limits: Limits,
    waiting: [Room; 3],
    counts: RecordCounts,
    /// Closed: what waits is written until this time.
    write_until: Option<Instant>,
    failure: Option<String>,
    finished: bool,
}

impl Queue {
    pub(super) fn new(limits: Limits) -> Queue {
        let state = State {
            entries: VecDeque::with_capacity(limits.0.iter().map(|room| room.count).sum::<usize>().min(NOTES)),
            limits,
            waiting: [Room::default(); 3],
            counts: RecordCounts::default(),
            write_until: None,
            failure: None,
            finished: false,
        };
        Queue { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Takes the entry, or drops and counts it: never waits for the writer.
    pub(super) fn push(&self, entry: Entry) {
        let mut state = self.state();
        let lane = entry.body.lane();
        let bytes = entry.body.bytes();
        if !state.has_room(lane, bytes) {
            state.counts.dropped.add_one(lane);
            return;
        }
        let waiting = &mut state.waiting[lane as usize];
        waiting.count += 1;
        waiting.bytes += bytes;
        state.entries.push_back(entry);
        drop(state);
        self.changed.notify_all();
    }

    /// The next entry; waits at most `limit` for one.
    pub(super) fn next(&self, limit: Duration) -> Next {
        let nothing_to_do = |state: &mut State| state.entries.is_empty() && state.write_until.is_none();
        let (mut state, _) =
            self.changed.wait_timeout_while(self.state(), limit, nothing_to_do).unwrap_or_else(PoisonError::into_inner);
        if state.write_until.is_some_and(|until| Instant::now() >= until) {
            state.drop_all();
        }
        if let Some(entry) = state.take() {
            return Next::Entry(entry);
        }
        if state.write_until.is_some() { Next::Closed } else { Next::Idle }
    }

    /// Says what became of an entry that the writer took.
    pub(super) fn count(&self, lane: Lane, written: WrittenAs) {
        let counts = &mut self.state().counts;
        match written {
            WrittenAs::Message => counts.written.add_one(lane),
            WrittenAs::Nothing => counts.dropped.add_one(lane),
        }
    }

    /// No more entries; what waits is written until `write_until`. The first call decides.
    pub(super) fn close(&self, write_until: Instant) {
        self.state().write_until.get_or_insert(write_until);
        self.changed.notify_all();
    }

    /// The recording is over: what waits and what comes is dropped.
    pub(super) fn fail(&self, reason: String) {
        let mut state = self.state();
        state.failure = Some(reason);
        state.counts.failed = true;
        state.drop_all();
    }

    pub(super) fn failure(&self) -> Option<String> {
        self.state().failure.clone()
    }

    pub(super) fn counts(&self) -> RecordCounts {
        self.state().counts
    }

    /// Bytes that wait to be written.
    pub(super) fn waiting_bytes(&self) -> usize {
        self.state().waiting.iter().map(|room| room.bytes).sum()
    }

    /// True once the writer has ended; waits at most `limit` for that.
    pub(super) fn wait_finished(&self, limit: Duration) -> bool {
        let (state, _) = self
            .changed
            .wait_timeout_while(self.state(), limit, |state| !state.finished)
            .unwrap_or_else(PoisonError::into_inner);
        state.finished
    }

    /// Says that the writer has ended when it goes, even by a panic, so that nobody waits for it in vain.
    pub(super) fn finished_when_dropped(&self) -> SaysFinished<'_> {
        SaysFinished { queue: self }
    }

    /// Every change leaves the state whole, so a caller's panic elsewhere does not spoil it.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn has_room(&self, lane: Lane, bytes: usize) -> bool {
        let (limit, waiting) = (self.limits.0[lane as usize], self.waiting[lane as usize]);
        let open = self.write_until.is_none() && self.failure.is_none() && !self.finished;
        open && waiting.count < limit.count && bytes <= limit.bytes.saturating_sub(waiting.bytes)
    }

    fn take(&mut self) -> Option<Entry> {
        let entry = self.entries.pop_front()?;
        let waiting = &mut self.waiting[entry.body.lane() as usize];
        waiting.count -= 1;
        waiting.bytes -= entry.body.bytes();
        Some(entry)
    }

    fn drop_all(&mut self) {
        while let Some(entry) = self.take() {
            self.counts.dropped.add_one(entry.body.lane());
        }
    }
}

/// See [`Queue::finished_when_dropped`].
pub(super) struct SaysFinished<'a> {
    queue: &'a Queue,
}

impl Drop for SaysFinished<'_> {
    fn drop(&mut self) {
        let mut state = self.queue.state();
        state.finished = true;
        if std::thread::panicking() {
            state.failure = Some("the recording thread panicked".into());
            state.counts.failed = true;
        }
        state.drop_all();
        drop(state);
        self.queue.changed.notify_all();
    }
}
