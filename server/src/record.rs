//! Recording: what came in and what went out, into one MCAP file, without ever holding up servoing.
//!
//! Callers hand over a message and go on: it is put into a bounded queue, or dropped and counted. One plain thread writes.
//! The queue has three lanes with limits of their own (`record/queue.rs`), so that a full lane of frames never
//! costs a twist. A failed write (a full disk) ends the recording with one logged error; servoing does not notice.
//!
//! # What is in the file
//!
//! The topic of every channel is the Zenoh key that the message belongs to. `log_time` is the time of receipt (for what the
//! service makes itself: of making) in nanoseconds of the Unix epoch, `publish_time` is the same; the sender's own clock
//! is inside the frame header and the twist.
//!
//! | message encoding | topic | content |
//! |---|---|---|
//! | `domvs-frame-v1` | `…/frame`, `…/target` | the 48-byte frame header, then the payload as it came |
//! | `domvs-twist-v1` | `…/command` or `…/twist` | the 128 bytes of the twist |
//! | `json`, schema `domvs.Twist` | the same with `_json` behind it | the same twist for tools that plot |
//! | `json`, schema `domvs.Status`, `domvs.Settings` | `…/status`, `…/settings` | as published |
//!
//! - The task's secret never reaches the queue: the header is written anew without it.
//! - A PNG or JPEG that came without a header gets the header that this stands for (size and times 0). A header that cannot be
//!   read is 48 zeros (version 0): what cannot be read cannot be cleaned of its secret. A PNG or JPEG names itself in the
//!   channel's metadata (`encoding`), so a task that changes its encoding gets a second channel of the same topic.
//! - Metadata records `domvs` (worker, version) at the start, `domvs-counts` (written and dropped) at the end.
//!
//! Images are kept in our own encoding, not as `foxglove.RawImage` in JSON: base64 would cost a third more bytes, and
//! a replay needs the bytes that came, depth and lies included. Twists and statuses are JSON as well, which every viewer plots.
//!
//! # After a crash
//!
//! Chunks of about 1 MiB (a larger frame makes a larger chunk) are built in memory and written whole, and an open chunk is written out
//! after one second. So a killed process leaves a file of whole chunks without a summary, perhaps with one torn chunk
//! at its end: readers that go from the front get everything but the last second. Nothing is synced to the disk
//! (`fsync`): a power cut may take more. Chunks are not compressed.

mod file;
mod queue;
mod schemas;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use domvs_proto::frame::{FrameHeader, HEADER_BYTES};
use zenoh::bytes::ZBytes;

use self::file::{RecordFile, WrittenAs};
use self::queue::{Body, Entry, Limits, Next, Picture, Queue};
pub use self::queue::{LaneCounts, RecordCounts};

/// The payload of a frame: reference-counted slices, so that handing over a frame copies nothing.
pub type RecordedBytes = ZBytes;

/// An open chunk is written out after this time.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// How long the thread goes on writing what is queued when the last handle goes without `close`.
const LEFT_ALONE: Duration = Duration::from_secs(2);

/// A handle to one recording; cheap to clone. When the last one goes, the file is finished in the background.
#[derive(Clone, Debug)]
pub struct Recorder {
    handle: Arc<Handle>,
}

/// Ends the writer thread when the last [`Recorder`] goes.
#[derive(Debug)]
struct Handle {
    queue: Arc<Queue>,
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.queue.close(Instant::now() + LEFT_ALONE);
    }
}

/// Why a recording could not begin, or did not end well.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The file's name would not be a plain file name.
    #[error("a recording's name must be 1 to 128 of A-Z a-z 0-9 . _ - and not begin with a dot, got {file_stem:?}")]
    BadName {
        /// The name that was refused.
        file_stem: String,
    },
    /// The directory or the file cannot be made, or the file exists (nothing is ever overwritten).
    #[error("cannot create the recording {}: {source}", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file's first bytes could not be written.
    #[error("cannot begin the recording: {0}")]
    Begin(#[from] mcap::McapError),
    /// The thread that writes could not be started.
    #[error("cannot start the recording thread: {0}")]
    Thread(#[source] io::Error),
    /// A write failed and the recording ended early; the file holds what came before.
    #[error("the recording ended early: {reason}")]
    Failed {
        /// What the writer said.
        reason: String,
    },
    /// The file was not finished in time: the disk is slow, or hangs.
    #[error("the recording was not finished in {limit:?}")]
    CloseTimeout {
        /// The time that was allowed.
        limit: Duration,
    },
}

impl Recorder {
    /// Opens `dir/<file_stem>.mcap` (the directory is made, a file that exists is an error) and starts the writer thread.
    ///
    /// `worker` goes into the file's metadata; `queued_frames` bounds how many frames wait (64 MiB bound them too).
    pub fn start(dir: &Path, file_stem: &str, worker: &str, queued_frames: usize) -> Result<Recorder, RecordError> {
        check_name(file_stem)?;
        let path = dir.join(format!("{file_stem}.mcap"));
        let file = std::fs::create_dir_all(dir)
            .and_then(|()| File::create_new(&path))
            .map_err(|source| RecordError::Create { path, source })?;
        Recorder::to_sink(file, worker, Limits::for_frames(queued_frames))
    }

    /// The same into any sink: what the tests call.
    fn to_sink<W: Write + Send + 'static>(sink: W, worker: &str, limits: Limits) -> Result<Recorder, RecordError> {
        let file = RecordFile::begin(sink, worker)?;
        let queue = Arc::new(Queue::new(limits));
        let writers_end = Arc::clone(&queue);
        thread::Builder::new()
            .name("domvs-record".into())
            .spawn(move || write_until_closed(&writers_end, file))
            .map_err(RecordError::Thread)?;
        Ok(Recorder { handle: Arc::new(Handle { queue }) })
    }

    /// Records a frame that came for a task: `header` is the attachment as it came (empty: none), `encoding` the
    /// payload's media type, `received_ns` nanoseconds of the Unix epoch.
    pub fn frame(&self, key: &str, received_ns: u64, header: &[u8], encoding: &str, payload: RecordedBytes) {
        let body = Body::Frame { header: clean_header(header), picture: Picture::named(encoding), payload };
        self.handle.queue.push(Entry { key: key.into(), received_ns, body });
    }

    /// Records a target; like [`Recorder::frame`], in a lane of its own, because a replay is worth nothing without it.
    pub fn target(&self, key: &str, received_ns: u64, header: &[u8], encoding: &str, payload: RecordedBytes) {
        let body = Body::Target { header: clean_header(header), picture: Picture::named(encoding), payload };
        self.handle.queue.push(Entry { key: key.into(), received_ns, body });
    }

    /// Records a twist as it was sent (`…/command`) or answered (`…/twist`), and the same as JSON on `<key>_json`.
    pub fn twist(&self, key: &str, made_ns: u64, twist: [u8; 128]) {
        self.handle.queue.push(Entry { key: key.into(), received_ns: made_ns, body: Body::Twist(twist) });
    }

    /// Records a status message as published: one JSON object.
    pub fn status(&self, key: &str, made_ns: u64, json: String) {
        self.handle.queue.push(Entry { key: key.into(), received_ns: made_ns, body: Body::Status(json) });
    }

    /// Records the settings in force: one JSON object, whole (not a patch, which could not be replayed alone).
    pub fn settings(&self, key: &str, received_ns: u64, json: String) {
        self.handle.queue.push(Entry { key: key.into(), received_ns, body: Body::Settings(json) });
    }

    /// What was written and what was dropped so far, and whether a failed write has ended the recording.
    pub fn counts(&self) -> RecordCounts {
        self.handle.queue.counts()
    }

    /// Bytes that wait to be written.
    pub fn waiting_bytes(&self) -> usize {
        self.handle.queue.waiting_bytes()
    }

    /// Writes what is queued, finishes the file and waits for that, at most `limit`; past three quarters of it what is
    /// still queued is dropped and counted, to leave time for the end of the file. Messages that come later are dropped.
    ///
    /// Fails when a write failed at any time ([`RecordError::Failed`]) or the disk is too slow ([`RecordError::CloseTimeout`]).
    pub fn close(&self, limit: Duration) -> Result<RecordCounts, RecordError> {
        let queue = &self.handle.queue;
        queue.close(Instant::now() + limit * 3 / 4);
        if !queue.wait_finished(limit) {
            return Err(RecordError::CloseTimeout { limit });
        }
        match queue.failure() {
            Some(reason) => Err(RecordError::Failed { reason }),
            None => Ok(queue.counts()),
        }
    }
}

/// Refuses what would leave the directory or hide the file.
fn check_name(file_stem: &str) -> Result<(), RecordError> {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-');
    let length_fits = (1..=128).contains(&file_stem.len());
    if length_fits && !file_stem.starts_with('.') && file_stem.bytes().all(plain) {
        return Ok(());
    }
    Err(RecordError::BadName { file_stem: file_stem.into() })
}

/// The 48 bytes that are recorded for a header: without a secret, and zeros for what cannot be read.
fn clean_header(attachment: &[u8]) -> [u8; HEADER_BYTES] {
    let mut clean = [0; HEADER_BYTES];
    if let Ok(header) = FrameHeader::from_attachment(Some(attachment)) {
        clean.copy_from_slice(&FrameHeader { secret: None, ..header }.encode());
    }
    clean
}

/// The writer thread: ends when the queue is closed and empty, or at the first failed write.
fn write_until_closed<W: Write>(queue: &Queue, file: RecordFile<W>) {
    let _says_finished = queue.finished_when_dropped();
    if let Err(error) = write_entries(queue, file) {
        let reason = match error {
            mcap::McapError::Io(error) => error.to_string(),
            error => error.to_string(),
        };
        tracing::error!(reason, "recording ended early, servoing goes on");
        queue.fail(reason);
    }
}

fn write_entries<W: Write>(queue: &Queue, mut file: RecordFile<W>) -> Result<(), mcap::McapError> {
    let mut flushed = Instant::now();
    loop {
        match queue.next(FLUSH_EVERY) {
            Next::Entry(entry) => {
                let lane = entry.body.lane();
                let written = file.write(&entry).inspect_err(|_| queue.count(lane, WrittenAs::Nothing))?;
                queue.count(lane, written);
            }
            Next::Idle => {}
            Next::Closed => return file.finish(&queue.counts()),
        }
        if flushed.elapsed() >= FLUSH_EVERY {
            file.flush()?;
            flushed = Instant::now();
        }
    }
}
