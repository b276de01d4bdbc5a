//! The MCAP file: which channel an entry goes to and what its bytes are.
//!
//! Chunks are built in memory and written in one piece (`disable_seeking`): otherwise a killed process would leave a chunk whose
//! header still holds placeholders. Channels are made at their first message.

use std::collections::{BTreeMap, HashMap};
use std::io::{BufWriter, Write};

use domvs_proto::frame::HEADER_BYTES;
use domvs_proto::twist::TwistMessage;
use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};
use mcap::{McapError, McapResult, WriteOptions, Writer};
use zenoh::bytes::ZBytes;

use super::queue::{Body, Entry, Picture, RecordCounts};
use super::schemas::{SETTINGS_SCHEMA, STATUS_SCHEMA, TWIST_SCHEMA};

const CHUNK_BYTES: u64 = 1 << 20;
/// Channel ids have 16 bits; the writer's own count of them must not run over.
const MAX_CHANNELS: usize = 65_000;

/// What `RecordFile::write` made of an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WrittenAs {
    Message,
    /// The file has all the channels that it may have and the entry needed one more.
    Nothing,
}

/// The formats of our messages: each is one channel per topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Format {
    Frame(Picture),
    Twist,
    TwistJson,
    Status,
    Settings,
}

/// A channel and how many messages it has.
#[derive(Debug)]
struct Channel {
    id: u16,
    messages: u32,
}

pub(super) struct RecordFile<W: Write> {
    writer: Writer<NoSeek<BufWriter<W>>>,
    channels: HashMap<Format, HashMap<String, Channel>>,
    pub(super) max_channels: usize,
    /// The bytes of the message being written.
    message: Vec<u8>,
}

impl<W: Write> RecordFile<W> {
    /// Writes the head of the file and the metadata record `domvs`.
    pub(super) fn begin(sink: W, worker: &str) -> McapResult<RecordFile<W>> {
        let mut writer = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .library(concat!("domvs ", env!("CARGO_PKG_VERSION")))
            .create(NoSeek::new(BufWriter::new(sink)))?;
        let about = [("worker", worker), ("version", env!("CARGO_PKG_VERSION"))];
        writer.write_metadata(&metadata("domvs", about.map(|(name, value)| (name, value.to_owned()))))?;
        Ok(RecordFile { writer, channels: HashMap::new(), max_channels: MAX_CHANNELS, message: Vec::new() })
    }

    /// Writes one entry (a twist as two messages); an error is final.
    pub(super) fn write(&mut self, entry: &Entry) -> McapResult<WrittenAs> {
        let written = match &entry.body {
            Body::Frame { header, picture, payload } | Body::Target { header, picture, payload } => {
                self.write_frame(entry, header, *picture, payload)
            }
            Body::Twist(twist) => self.write_twist(entry, twist),
            Body::Status(json) => self.write_message(Format::Status, &entry.key, entry.received_ns, json.as_bytes()),
            Body::Settings(json) => {
                self.write_message(Format::Settings, &entry.key, entry.received_ns, json.as_bytes())
            }
        };
        match written {
            Ok(()) => Ok(WrittenAs::Message),
            Err(McapError::TooManyChannels) => Ok(WrittenAs::Nothing),
            Err(error) => Err(error),
        }
    }

    /// Closes the open chunk and hands all bytes to the system.
    pub(super) fn flush(&mut self) -> McapResult<()> {
        self.writer.flush()
    }

    /// Writes the metadata record `domvs-counts`, the summary and the end of the file.
    pub(super) fn finish(mut self, counts: &RecordCounts) -> McapResult<()> {
        let (written, dropped) = (counts.written, counts.dropped);
        let counts = [
            ("written_frames", written.frames),
            ("written_targets", written.targets),
            ("written_notes", written.notes),
            ("dropped_frames", dropped.frames),
            ("dropped_targets", dropped.targets),
            ("dropped_notes", dropped.notes),
        ];
        let counts = counts.map(|(name, count)| (name, count.to_string()));
        self.writer.write_metadata(&metadata("domvs-counts", counts))?;
        self.writer.finish()?;
        self.writer.into_inner().into_inner().flush()?;
        Ok(())
    }

    fn write_frame(
        &mut self,
        entry: &Entry,
        header: &[u8; HEADER_BYTES],
        picture: Picture,
        payload: &ZBytes,
    ) -> McapResult<()> {
        let mut message = std::mem::take(&mut self.message);
        message.clear();
        message.extend_from_slice(header);
        payload.slices().for_each(|slice| message.extend_from_slice(slice));
        let written = self.write_message(Format::Frame(picture), &entry.key, entry.received_ns, &message);
        self.message = message;
        written
    }

    /// The bytes for a replay, and the same as JSON for people. The service's own bytes always decode; others are kept as bytes.
    fn write_twist(&mut self, entry: &Entry, bytes: &[u8; 128]) -> McapResult<()> {
        self.write_message(Format::Twist, &entry.key, entry.received_ns, bytes)?;
        let Ok(twist) = TwistMessage::decode(bytes) else {
            return Ok(());
        };
        let topic = format!("{}_json", entry.key);
        self.write_message(Format::TwistJson, &topic, entry.received_ns, twist.to_json().as_bytes())
    }

    fn write_message(&mut self, format: Format, topic: &str, time_ns: u64, data: &[u8]) -> McapResult<()> {
        let channel = self.channel(format, topic)?;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.messages,
            log_time: time_ns,
            publish_time: time_ns,
        };
        channel.messages = channel.messages.wrapping_add(1);
        self.writer.write_to_known_channel(&header, data)
    }

    /// The channel of a topic in a format, made if it is new.
    fn channel(&mut self, format: Format, topic: &str) -> McapResult<&mut Channel> {
        let used: usize = self.channels.values().map(HashMap::len).sum();
        let topics = self.channels.entry(format).or_default();
        if !topics.contains_key(topic) {
            if used >= self.max_channels {
                return Err(McapError::TooManyChannels);
            }
            let id = declare(&mut self.writer, format, topic)?;
            topics.insert(topic.to_owned(), Channel { id, messages: 0 });
        }
        Ok(topics.get_mut(topic).expect("the topic was there, or was put there just now"))
    }
}

/// Writes a schema (if the format has one) and a channel record; returns the channel's id.
fn declare<W: Write>(writer: &mut Writer<NoSeek<BufWriter<W>>>, format: Format, topic: &str) -> McapResult<u16> {
    let mut about = BTreeMap::new();
    let (message_encoding, schema) = match format {
        Format::Frame(picture) => {
            let media = picture.media_type();
            about.extend(media.map(|media| ("encoding".to_owned(), media.to_owned())));
            ("domvs-frame-v1", None)
        }
        Format::Twist => ("domvs-twist-v1", None),
        Format::TwistJson => ("json", Some(("domvs.Twist", TWIST_SCHEMA))),
        Format::Status => ("json", Some(("domvs.Status", STATUS_SCHEMA))),
        Format::Settings => ("json", Some(("domvs.Settings", SETTINGS_SCHEMA))),
    };
    let schema_id = match schema {
        Some((name, text)) => writer.add_schema(name, "jsonschema", text.as_bytes())?,
        None => 0,
    };
    writer.add_channel(schema_id, topic, message_encoding, &about)
}

fn metadata<const N: usize>(name: &str, values: [(&str, String); N]) -> Metadata {
    let metadata = values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    Metadata { name: name.to_owned(), metadata }
}
