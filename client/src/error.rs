//! Everything that can go wrong on the client's side, with the key it happened on and what to do next.

use std::time::Duration;

use domvs_proto::frame::FrameError;
use domvs_proto::keys::{KeyError, TaskKey};
use domvs_proto::messages::ErrorCode;

/// Why a call to the service did not give what was asked for. In every case there is no twist to obey: brake.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The Zenoh settings cannot be used.
    #[error("unusable Zenoh setting {what}: {error}")]
    Config {
        /// The file, or the setting and its value.
        what: String,
        /// What Zenoh says about it.
        error: String,
    },
    /// No Zenoh session could be opened within the limit.
    #[error(
        "no connection to {endpoints} within {waited:?} ({error}); start a router or `domvs serve` there, or name another endpoint"
    )]
    Connect {
        /// The endpoints that were tried, as JSON.
        endpoints: String,
        /// The limit that ran out.
        waited: Duration,
        /// The last reason.
        error: String,
    },
    /// A prefix, a name or a task key is not one.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// Nobody offers to take a task.
    #[error(
        "no worker answered on {key} within {waited:?}; start one with `domvs serve` on the same network and prefix"
    )]
    NoWorker {
        /// The key that was asked.
        key: String,
        /// The limit that ran out.
        waited: Duration,
    },
    /// No task of that name has an owner.
    #[error("task {task} has no owner on {key}; it was closed or never made: create it, or look at `domvs task list`")]
    NoTask {
        /// The task that was looked for.
        task: TaskKey,
        /// The key its owner's token would be on.
        key: String,
    },
    /// The service answered with a refusal.
    #[error("refused on {key}: {error} ({code})")]
    Refused {
        /// The key that was asked.
        key: String,
        /// The frozen word.
        code: ErrorCode,
        /// The service's sentence, with the numbers.
        error: String,
    },
    /// No answer within the limit, or an empty one. For a frame: no twist; send the next one, which is asked anew.
    #[error("no answer on {key} within {waited:?} ({reason}); ask again")]
    NoAnswer {
        /// The key that was asked.
        key: String,
        /// How long it took until that was clear.
        waited: Duration,
        /// Whether nothing is there, or something is that did not answer.
        reason: Silence,
    },
    /// Several answers in a row were missing, and the token of the task's owner is gone.
    #[error(
        "the owner of task {task} is gone after {misses} missing answers; wait for a standby, or create the task again"
    )]
    OwnerLost {
        /// The task.
        task: TaskKey,
        /// Missing answers in a row.
        misses: u32,
    },
    /// A worker that no longer owns the task has answered; its answer was dropped.
    #[error("an answer on {key} is of epoch {got}, this task is at {expected}: dropped; ask again")]
    OlderEpoch {
        /// The key that was asked.
        key: String,
        /// The newest epoch seen.
        expected: u32,
        /// The epoch that came.
        got: u32,
    },
    /// The twist belongs to another frame.
    #[error(
        "a twist on {key} is for frame {got}, expected {expected}: dropped; give every frame its own sequence number"
    )]
    WrongSequence {
        /// The key that was asked.
        key: String,
        /// The frame that was sent.
        expected: u64,
        /// The frame that was answered.
        got: u64,
    },
    /// An answer that wire version 1 does not know.
    #[error("unreadable answer on {key}: {reason}; compare the versions with `domvs --version` on both sides")]
    BadAnswer {
        /// The key that was asked.
        key: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The frame to send contradicts itself.
    #[error("this frame cannot be sent: {0}")]
    Frame(#[from] FrameError),
    /// The settings are out of range; nothing was sent.
    #[error("these settings cannot be sent: {0}")]
    Settings(#[from] domvs_proto::settings::SettingsError),
    /// A stop was sent, but nobody is listening for it as far as this session knows.
    #[error(
        "stop was sent on {key}, but nobody listens there within {waited:?}; look at the endpoint, the prefix and the arm itself"
    )]
    NobodyListens {
        /// The key it was sent on.
        key: String,
        /// How long a listener was waited for.
        waited: Duration,
    },
    /// The Zenoh session refused an operation; usually it is closed.
    #[error("{doing} failed on {key}: {error}; connect again")]
    Session {
        /// What was being done.
        doing: &'static str,
        /// On which key.
        key: String,
        /// What Zenoh says.
        error: String,
    },
}

/// What kind of silence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Silence {
    /// The answer ended empty: nothing is declared there, access is refused, or the question was dropped.
    Empty,
    /// Nothing came before the limit.
    TimedOut,
}

impl std::fmt::Display for Silence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Silence::Empty => {
                "no such task, no worker, or the router refuses access: an empty answer does not say which"
            }
            Silence::TimedOut => "timed out",
        })
    }
}

impl ClientError {
    /// Whether this is an answer that did not come, rather than one that says no.
    pub fn is_silence(&self) -> bool {
        matches!(self, ClientError::NoAnswer { .. } | ClientError::OwnerLost { .. })
    }

    pub(crate) fn session(doing: &'static str, key: &str) -> impl FnOnce(zenoh::Error) -> ClientError {
        move |error| ClientError::Session { doing, key: key.to_owned(), error: zenoh_says(&error) }
    }

    pub(crate) fn bad_answer(key: &str) -> impl FnOnce(&dyn std::error::Error) -> ClientError {
        move |error| ClientError::BadAnswer { key: key.to_owned(), reason: error.to_string() }
    }
}

/// Zenoh's sentence without the place in its source that it ends with.
pub(crate) fn zenoh_says(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let sentence = text.split(" at /").next().unwrap_or(&text);
    sentence.trim_end().trim_end_matches('!').to_owned()
}
