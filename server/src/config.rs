//! What the operator of a worker decides: `server.toml`. What a client decides is in the task's settings.
//!
//! `deploy/server.toml` lists every entry with its default; a test holds the two equal.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use domvs_proto::keys::Name;
use serde::{Deserialize, Serialize};

/// A worker's configuration. Unknown entries are refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServerConfig {
    /// Name of this worker, `[A-Za-z0-9_-]{1,64}`; empty: one is made up at every start.
    pub worker: String,
    /// First part of every key.
    pub prefix: String,
    /// Compute threads; 0: one for each core.
    pub threads: usize,
    /// So many orders and so many twist requests may wait for one task, 1 to 64.
    pub mailbox_depth: usize,
    /// A folder for recordings; empty: nothing is recorded.
    pub record: PathBuf,
    /// A folder in which a worker alone keeps its tasks over a restart; empty: they end with it.
    pub state: PathBuf,
    /// `ADDRESS:PORT` for `GET /metrics` (Prometheus) and `GET /healthz`, over plain HTTP; empty: neither.
    pub metrics: String,
    /// What clients may use.
    pub limits: Limits,
    /// When a task whose client has gone is closed.
    pub lease: Lease,
    /// What this worker keeps of the others' tasks, to go on with them.
    pub replica: Replica,
}

/// What one worker grants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Tasks in this worker.
    pub tasks: usize,
    /// Tasks of one client.
    pub tasks_per_client: usize,
    /// Pixels of one image; a larger one is refused before it is decoded.
    pub pixels_per_frame: usize,
    /// Pixels of the cameras of one client's tasks together: what its buffers take grows with them.
    pub pixels_per_client: usize,
    /// Pixels of the cameras of all tasks.
    pub pixels: usize,
    /// Bytes of one payload, and of all twist requests that wait for one task.
    pub bytes_per_payload: usize,
    /// Bytes that one client's targets and waiting messages take.
    pub bytes_per_client: usize,
    /// Bytes that all targets and waiting messages take.
    pub bytes: usize,
    /// Messages of one client that wait for their turn, in all of its tasks.
    pub waiting_per_client: usize,
    /// Messages of all clients that wait for their turn.
    pub waiting: usize,
    /// Frames of one client in a second, asked and pushed, with bursts of as many; 0: no limit.
    pub frames_per_s_per_client: usize,
    /// Other requests of one client in a second, with bursts of as many; 0: no limit. A stop is always let in.
    pub requests_per_s_per_client: usize,
}

/// What a standby may hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Replica {
    /// Tasks whose state is kept.
    pub tasks: usize,
    /// Bytes of their states and targets, and of those that wait to be read.
    pub bytes: usize,
    /// Tasks made ready, with buffers and bases, of those this worker would be the first to take over.
    pub prepared: usize,
}

/// How long a client may be gone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lease {
    /// From the loss of a client's liveliness token, which halts its tasks at once, to their closing.
    pub grace_s: u64,
}

impl Default for ServerConfig {
    fn default() -> Self {
        ServerConfig {
            worker: String::new(),
            prefix: "domvs".to_owned(),
            threads: 0,
            mailbox_depth: 4,
            record: PathBuf::new(),
            state: PathBuf::new(),
            metrics: String::new(),
            limits: Limits::default(),
            lease: Lease::default(),
            replica: Replica::default(),
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            tasks: 64,
            tasks_per_client: 16,
            pixels_per_frame: 3840 * 2160,
            pixels_per_client: 1 << 25,
            pixels: 1 << 27,
            bytes_per_payload: 64 << 20,
            bytes_per_client: 256 << 20,
            bytes: 1 << 30,
            waiting_per_client: 128,
            waiting: 1024,
            frames_per_s_per_client: 2000,
            requests_per_s_per_client: 500,
        }
    }
}

impl Default for Replica {
    fn default() -> Self {
        Replica { tasks: 256, bytes: 256 * 1024 * 1024, prepared: 16 }
    }
}

impl Default for Lease {
    fn default() -> Self {
        Lease { grace_s: 30 }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not the TOML that is expected.
    #[error("cannot understand the server configuration: {0}")]
    Malformed(#[from] toml::de::Error),
    /// A value is out of its range.
    #[error("{entry} must be {expected}, got {got}")]
    OutOfRange {
        /// Which entry.
        entry: &'static str,
        /// Its range.
        expected: &'static str,
        /// What it is.
        got: String,
    },
}

impl ServerConfig {
    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<ServerConfig, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })?;
        ServerConfig::parse(&text)
    }

    /// Reads and checks a text.
    pub fn parse(text: &str) -> Result<ServerConfig, ConfigError> {
        let config: ServerConfig = toml::from_str(text)?;
        config.checked()
    }

    /// The configuration itself when every entry is in its range.
    pub fn checked(self) -> Result<ServerConfig, ConfigError> {
        let name_fits = |name: &str| Name::try_from(name).is_ok();
        if !self.worker.is_empty() && !name_fits(&self.worker) {
            return Err(out_of_range("worker", "empty or 1 to 64 of A-Z a-z 0-9 _ -", &self.worker));
        }
        if !self.metrics.is_empty() && self.metrics_address().is_none() {
            return Err(out_of_range("metrics", "empty or ADDRESS:PORT such as 127.0.0.1:9464", &self.metrics));
        }
        check_range("threads", "0 to 256", self.threads, 0, 256)?;
        check_range("mailbox_depth", "1 to 64", self.mailbox_depth, 1, 64)?;
        check_range("replica.tasks", "0 to 10000", self.replica.tasks, 0, 10_000)?;
        check_range("replica.bytes", "0 to 17179869184", self.replica.bytes, 0, 1 << 34)?;
        check_range("replica.prepared", "0 to 10000", self.replica.prepared, 0, 10_000)?;
        self.limits.check()?;
        Ok(self)
    }

    /// This worker's name: the configured one, or a new random one.
    pub fn worker_name(&self) -> Name {
        let text =
            if self.worker.is_empty() { format!("w-{:08x}", rand::random::<u32>()) } else { self.worker.clone() };
        Name::try_from(text.as_str()).expect("checked names and hexadecimal ones are valid")
    }

    /// Where the metrics are to be had; `None`: nowhere.
    pub fn metrics_address(&self) -> Option<SocketAddr> {
        self.metrics.parse().ok()
    }

    /// How many compute threads to start.
    pub fn compute_threads(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        }
    }
}

impl Limits {
    fn check(&self) -> Result<(), ConfigError> {
        const MOST_PIXELS: usize = 1 << 37;
        const MOST_BYTES: usize = 1 << 40;
        check_range("limits.tasks", "1 to 10000", self.tasks, 1, 10_000)?;
        check_range("limits.tasks_per_client", "1 to 10000", self.tasks_per_client, 1, 10_000)?;
        check_range("limits.pixels_per_frame", "64 to 16777216", self.pixels_per_frame, 64, 1 << 24)?;
        check_range("limits.pixels_per_client", "64 to 137438953472", self.pixels_per_client, 64, MOST_PIXELS)?;
        check_range("limits.pixels", "64 to 137438953472", self.pixels, 64, MOST_PIXELS)?;
        check_range("limits.bytes_per_payload", "1024 to 1073741824", self.bytes_per_payload, 1024, 1 << 30)?;
        check_range("limits.bytes_per_client", "1024 to 1099511627776", self.bytes_per_client, 1024, MOST_BYTES)?;
        check_range("limits.bytes", "1024 to 1099511627776", self.bytes, 1024, MOST_BYTES)?;
        check_range("limits.waiting_per_client", "1 to 1000000", self.waiting_per_client, 1, 1_000_000)?;
        check_range("limits.waiting", "1 to 1000000", self.waiting, 1, 1_000_000)?;
        let (frames, requests) = (self.frames_per_s_per_client, self.requests_per_s_per_client);
        check_range("limits.frames_per_s_per_client", "0 to 1000000", frames, 0, 1_000_000)?;
        check_range("limits.requests_per_s_per_client", "0 to 1000000", requests, 0, 1_000_000)
    }
}

impl Lease {
    /// The grace as a duration.
    pub fn grace(&self) -> Duration {
        Duration::from_secs(self.grace_s)
    }
}

fn check_range(
    entry: &'static str,
    expected: &'static str,
    got: usize,
    min: usize,
    max: usize,
) -> Result<(), ConfigError> {
    if (min..=max).contains(&got) { Ok(()) } else { Err(out_of_range(entry, expected, &got.to_string())) }
}

fn out_of_range(entry: &'static str, expected: &'static str, got: &str) -> ConfigError {
    ConfigError::OutOfRange { entry, expected, got: got.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_file_means_the_defaults() {
        assert_eq!(ServerConfig::parse("").expect("valid"), ServerConfig::default());
    }

    #[test]
    fn the_shipped_file_lists_every_entry_with_its_default() {
        let shipped = include_str!("../../deploy/server.toml");
        assert_eq!(ServerConfig::parse(shipped).expect("valid"), ServerConfig::default());
        let parsed: toml::Table = shipped.parse().expect("TOML");
        let defaults = toml::Table::try_from(ServerConfig::default()).expect("TOML");
        assert_eq!(parsed, defaults, "no entry may be missing from the file");
    }

    #[test]
    fn wrong_entries_are_refused_with_the_numbers() {
        let message = |text: &str| ServerConfig::parse(text).expect_err("refused").to_string();
        assert!(message("mailbox_depth = 0").contains("1 to 64, got 0"));
        assert!(message("worker = \"a/b\"").contains("a/b"));
        assert!(message("mailbox_dept = 4").contains("mailbox_dept"));
        assert!(message("metrics = \"9464\"").contains("got 9464"));
    }
}
