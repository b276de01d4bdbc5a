//! Written and read back; slow, failing and cut-off sinks. Gates and conditions stand for time: nothing sleeps.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat, Secret};
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use mcap::{MessageStream, Summary};

use super::queue::{Limits, Room};
use super::*;

/// Long enough for a loaded machine; a test that waits so long has failed.
const LONG: Duration = Duration::from_secs(60);
const FRAME: &str = "domvs/task/alice/arm/frame";
const TARGET: &str = "domvs/task/alice/arm/target";
const COMMAND: &str = "domvs/task/alice/arm/command";
const STATUS: &str = "domvs/task/alice/arm/status";
const SETTINGS: &str = "domvs/task/alice/arm/settings";

/// A sink that the test can look into, shut and break.
#[derive(Clone, Default)]
struct Sink {
    state: Arc<(Mutex<SinkState>, Condvar)>,
}

#[derive(Default)]
struct SinkState {
    bytes: Vec<u8>,
    shut: bool,
    capacity: Option<usize>,
    panics: bool,
}

impl Sink {
    fn change(&self, change: impl FnOnce(&mut SinkState)) {
        change(&mut self.state.0.lock().unwrap());
        self.state.1.notify_all();
    }

    fn bytes(&self) -> Vec<u8> {
        self.state.0.lock().unwrap().bytes.clone()
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.state.1.wait_while(self.state.0.lock().unwrap(), |state| state.shut).unwrap();
        if state.panics {
            drop(state);
            panic!("a sink that panics");
        }
        if state.capacity.is_some_and(|capacity| state.bytes.len() + bytes.len() > capacity) {
            return Err(io::Error::new(io::ErrorKind::StorageFull, "the disk is full"));
        }
        state.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn recorder(sink: &Sink, queued_frames: usize) -> Recorder {
    Recorder::to_sink(sink.clone(), "w1", Limits::for_frames(queued_frames)).unwrap()
}

fn raw_header(secret: Option<Secret>) -> FrameHeader {
    FrameHeader { sequence: 7, capture_time_ns: 5, secret, ..FrameHeader::new(PixelFormat::Mono8, 4, 2) }
}

fn servoing(sequence: u64) -> TwistMessage {
    TwistMessage { sequence, twist: [0.5, 0.0, 0.0, 0.0, 0.0, -0.25], order: 6, ..TwistMessage::zero(Status::Servoing) }
}

/// The data of every message by topic, in the file's order.
fn by_topic(file: &[u8]) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut topics: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    for message in MessageStream::new(file).unwrap() {
        let message = message.unwrap();
        topics.entry(message.channel.topic.clone()).or_default().push(message.data.to_vec());
    }
    topics
}

fn record_one_of_each(recorder: &Recorder) {
    let header = raw_header(Some(Secret::new([0xab; 16]))).encode();
    recorder.settings(SETTINGS, 1_000, r#"{"method":"hahn"}"#.into());
    recorder.target(TARGET, 2_000, &[0xab; 16], "image/png", vec![1, 2, 3].into());
    recorder.frame(FRAME, 3_000, &header, "application/octet-stream", vec![9; 8].into());
    recorder.twist(COMMAND, 4_000, servoing(7).encode());
    recorder.status(STATUS, 5_000, r#"{"status":"servoing"}"#.into());
}

#[test]
fn what_was_recorded_is_read_back_from_the_file() {
    let dir = std::env::temp_dir().join(format!("domvs-record-{}", std::process::id()));
    let recorder = Recorder::start(&dir, "round-trip", "w1", 8).unwrap();
    record_one_of_each(&recorder);
    let counts = recorder.close(LONG).unwrap();
    let path = dir.join("round-trip.mcap");
    let file = std::fs::read(&path).unwrap();
    let again = Recorder::start(&dir, "round-trip", "w1", 8);
    keep_for_the_python_reader(&path);
    std::fs::remove_dir_all(&dir).unwrap();

    assert_eq!(counts.written, LaneCounts { frames: 1, targets: 1, notes: 3 });
    assert_eq!((counts.dropped, counts.failed), (LaneCounts::default(), false));
    assert!(matches!(again, Err(RecordError::Create { .. })), "a recording must not be overwritten");
    let topics = by_topic(&file);
    assert_eq!(topics.len(), 6);
    assert_eq!(topics[FRAME], [[raw_header(None).encode(), vec![9; 8]].concat()]);
    let bare = FrameHeader::new(PixelFormat::ByEncoding, 0, 0).encode();
    assert_eq!(topics[TARGET], [[bare, vec![1, 2, 3]].concat()]);
    assert_eq!(topics[COMMAND], [servoing(7).encode().to_vec()]);
    assert_eq!(topics[STATUS], [br#"{"status":"servoing"}"#.to_vec()]);
    assert_eq!(topics[SETTINGS], [br#"{"method":"hahn"}"#.to_vec()]);
    let json: serde_json::Value = serde_json::from_slice(&topics["domvs/task/alice/arm/command_json"][0]).unwrap();
    assert_eq!(json["twist"][5], -0.25);
    assert!(json["pixel_mse"].is_null());
}

/// `DOMVS_KEEP_RECORDING=FILE` keeps the file for `tests/python/read_mcap.py`.
fn keep_for_the_python_reader(path: &Path) {
    if let Some(keep) = std::env::var_os("DOMVS_KEEP_RECORDING") {
        std::fs::copy(path, keep).unwrap();
    }
}

#[test]
fn channels_times_and_metadata_say_what_the_messages_are() {
    let sink = Sink::default();
    let recorder = recorder(&sink, 8);
    record_one_of_each(&recorder);
    recorder.close(LONG).unwrap();
    let file = sink.bytes();

    let mut encodings = BTreeMap::new();
    for message in MessageStream::new(&file).unwrap() {
        let message = message.unwrap();
        assert_eq!(message.log_time, message.publish_time);
        let schema = message.channel.schema.as_ref().map_or("", |schema| &schema.name).to_owned();
        encodings.insert(
            message.channel.topic.clone(),
            (message.channel.message_encoding.clone(), schema, message.log_time),
        );
    }
    let said = |encoding: &str, schema: &str, time: u64| (encoding.to_owned(), schema.to_owned(), time);
    assert_eq!(encodings[SETTINGS], said("json", "domvs.Settings", 1_000));
    assert_eq!(encodings[TARGET], said("domvs-frame-v1", "", 2_000));
    assert_eq!(encodings[COMMAND], said("domvs-twist-v1", "", 4_000));
    assert_eq!(encodings["domvs/task/alice/arm/command_json"], said("json", "domvs.Twist", 4_000));
    let summary = Summary::read(&file).unwrap().unwrap();
    let png = summary.channels.values().find(|channel| channel.topic == TARGET).unwrap();
    assert_eq!(png.metadata["encoding"], "image/png");
    let records = |name: &str| {
        let index = summary.metadata_indexes.iter().find(|index| index.name == name).unwrap();
        mcap::read::metadata(&file, index).unwrap().metadata
    };
    assert_eq!(records("domvs")["worker"], "w1");
    assert_eq!(records("domvs")["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(records("domvs-counts")["written_notes"], "3");
    assert_eq!(records("domvs-counts")["dropped_frames"], "0");
}

#[test]
fn a_secret_is_nowhere_in_the_file() {
    let sink = Sink::default();
    let recorder = recorder(&sink, 8);
    let secret = [0x5a; 16];
    let mut unreadable = raw_header(Some(Secret::new(secret))).encode();
    unreadable[0] = 2;
    for header in [&raw_header(Some(Secret::new(secret))).encode()[..], &secret[..], &unreadable[..]] {
        recorder.frame(FRAME, 1, header, "image/png", vec![1, 2, 3].into());
    }
    recorder.close(LONG).unwrap();
    let file = sink.bytes();
    assert!(!file.windows(16).any(|bytes| bytes == secret));
    let frames = &by_topic(&file)[FRAME];
    assert_eq!(frames[2], [&[0; 48][..], &[1, 2, 3]].concat(), "an unreadable header is recorded as zeros");
}

#[test]
fn a_slow_disk_loses_frames_and_no_twist_and_holds_nobody_up() {
    let sink = Sink::default();
    let recorder = recorder(&sink, 4);
    sink.change(|state| state.shut = true);
    // Each frame fills a chunk, so the writer stands before the shut sink at the second one at the latest:
    // it has taken at most two and four wait. These calls would hang here if one of them waited for the disk.
    for i in 0..100 {
        recorder.frame(FRAME, i, &raw_header(None).encode(), "", vec![0; 2 << 20].into());
        recorder.twist(COMMAND, i, servoing(i).encode());
    }
    let stuck = recorder.counts();
    assert!(stuck.dropped.frames >= 100 - 4 - 2, "{stuck:?}");
    assert_eq!(stuck.dropped.notes, 0);
    sink.change(|state| state.shut = false);
    let counts = recorder.close(LONG).unwrap();
    assert_eq!(counts.written.frames + counts.dropped.frames, 100);
    assert_eq!(counts.written.notes, 100);
    let topics = by_topic(&sink.bytes());
    assert_eq!(topics[FRAME].len() as u64, counts.written.frames);
    let twists: Vec<_> = topics[COMMAND].iter().map(|twist| TwistMessage::decode(twist).unwrap().sequence).collect();
    assert_eq!(twists, (0..100).collect::<Vec<_>>());
}

#[test]
fn a_lane_is_bounded_by_bytes_too() {
    let sink = Sink::default();
    sink.change(|state| state.shut = true);
    let room = |count, bytes| Room { count, bytes };
    let limits = Limits([room(100, 1000), room(100, 1000), room(100, 1000)]);
    let recorder = Recorder::to_sink(sink.clone(), "w1", limits).unwrap();
    recorder.frame(FRAME, 0, &[], "image/png", vec![0; 1001 - 48].into());
    recorder.frame(FRAME, 0, &[], "image/png", vec![0; 1000 - 48].into());
    recorder.status(STATUS, 0, "0".repeat(1001));
    assert_eq!(recorder.counts().dropped, LaneCounts { frames: 1, targets: 0, notes: 1 });
    sink.change(|state| state.shut = false);
    assert_eq!(recorder.close(LONG).unwrap().written.frames, 1);
}

#[test]
fn a_full_disk_ends_the_recording_and_nothing_else() {
    let sink = Sink::default();
    sink.change(|state| state.capacity = Some(3 << 20));
    let recorder = recorder(&sink, 100);
    for i in 0..10 {
        recorder.frame(FRAME, i, &raw_header(None).encode(), "", vec![0; 1 << 20].into());
    }
    let closed = recorder.close(LONG);
    assert!(
        matches!(&closed, Err(RecordError::Failed { reason }) if reason.contains("the disk is full")),
        "{closed:?}"
    );
    recorder.twist(COMMAND, 11, servoing(11).encode());
    let counts = recorder.counts();
    assert!(counts.failed);
    assert_eq!(counts.written.frames + counts.dropped.frames, 10);
    assert_eq!(counts.dropped.notes, 1);
    assert!(!by_topic_until_torn(&sink.bytes()).is_empty(), "what was written before can be read");
}

#[test]
fn a_panic_while_writing_is_reported_and_not_waited_for() {
    let sink = Sink::default();
    sink.change(|state| state.panics = true);
    let recorder = recorder(&sink, 8);
    recorder.frame(FRAME, 0, &[], "image/png", vec![0; 2 << 20].into());
    assert!(matches!(recorder.close(LONG), Err(RecordError::Failed { .. })));
    recorder.status(STATUS, 0, "{}".into());
    assert_eq!(recorder.counts().dropped.notes, 1);
}

#[test]
fn closing_on_a_hanging_disk_gives_up_in_time() {
    let sink = Sink::default();
    let recorder = recorder(&sink, 8);
    sink.change(|state| state.shut = true);
    recorder.frame(FRAME, 0, &[], "image/png", vec![0; 2 << 20].into());
    assert!(matches!(recorder.close(Duration::from_millis(20)), Err(RecordError::CloseTimeout { .. })));
    sink.change(|state| state.shut = false);
    // The disk came back: the file still gets its end.
    assert!(recorder.close(LONG).is_ok());
    assert!(Summary::read(&sink.bytes()).unwrap().is_some());
}

#[test]
fn the_last_handle_finishes_the_file() {
    let sink = Sink::default();
    let recorder = recorder(&sink, 8);
    let queue = Arc::clone(&recorder.handle.queue);
    record_one_of_each(&recorder.clone());
    drop(recorder);
    assert!(queue.wait_finished(LONG));
    assert_eq!(by_topic(&sink.bytes()).len(), 6);
}

/// Messages from the front until the file ends or tears.
fn by_topic_until_torn(file: &[u8]) -> Vec<u64> {
    let options = mcap::read::Options::IgnoreEndMagic.into();
    let stream = MessageStream::new_with_options(file, options).unwrap();
    stream.map_while(Result::ok).map(|message| message.log_time).collect()
}

#[test]
fn a_killed_process_leaves_all_whole_chunks_readable() {
    let mut bytes = Vec::new();
    let mut file = RecordFile::begin(&mut bytes, "w1").unwrap();
    for i in 0..5 {
        let header = [0; HEADER_BYTES];
        let body = Body::Frame { header, picture: Picture::Raw, payload: vec![0; 2 << 20].into() };
        file.write(&Entry { key: FRAME.into(), received_ns: i, body }).unwrap();
    }
    file.flush().unwrap();
    // The end of the file is never written, as after kill -9.
    std::mem::forget(file);
    assert_eq!(by_topic_until_torn(&bytes), [0, 1, 2, 3, 4]);
    let torn = &bytes[..bytes.len() - 1000];
    assert_eq!(by_topic_until_torn(torn), [0, 1, 2, 3], "only the torn chunk is lost");
}

#[test]
fn a_file_without_room_for_channels_drops_what_needs_one_and_goes_on() {
    let mut file = RecordFile::begin(io::sink(), "w1").unwrap();
    file.max_channels = 3;
    let status = |i: u32| Entry { key: format!("k/{i}"), received_ns: 0, body: Body::Status("{}".into()) };
    for i in 0..3 {
        assert_eq!(file.write(&status(i)).unwrap(), WrittenAs::Message, "channel {i}");
    }
    assert_eq!(file.write(&status(3)).unwrap(), WrittenAs::Nothing);
    assert_eq!(file.write(&status(0)).unwrap(), WrittenAs::Message);
}

#[test]
fn a_name_that_leaves_the_directory_is_refused() {
    for name in ["", ".hidden", "../up", "a/b", "a\0b", &"x".repeat(129)] {
        assert!(matches!(check_name(name), Err(RecordError::BadName { .. })), "{name:?}");
    }
    assert!(check_name("w1-2026-11-22T10.00.00").is_ok());
}

#[test]
fn the_twist_schema_names_every_field_of_the_json() {
    let schema: serde_json::Value = serde_json::from_str(schemas::TWIST_SCHEMA).unwrap();
    let twist: serde_json::Value = serde_json::from_str(&servoing(1).to_json()).unwrap();
    let names = |value: &serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&schema["properties"]), names(&twist));
    for schema in [schemas::STATUS_SCHEMA, schemas::SETTINGS_SCHEMA] {
        serde_json::from_str::<serde_json::Value>(schema).unwrap();
    }
}

#[test]
fn a_header_is_kept_but_for_its_secret() {
    let header = FrameHeader {
        row_bytes: 8,
        depth_format: DepthFormat::U16,
        depth_offset: 16,
        depth_unit_m: 0.001,
        deadline_us: 3,
        ..raw_header(Some(Secret::new([1; 16])))
    };
    let kept = FrameHeader::decode(&clean_header(&header.encode())).unwrap();
    assert_eq!(kept, FrameHeader { secret: None, ..header });
}
