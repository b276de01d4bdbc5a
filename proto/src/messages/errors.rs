//! Error answers: a frozen word for programs and a sentence for people.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::settings::SettingsError;

/// The body of every error answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{code}: {error}")]
pub struct ErrorReply {
    /// For programs.
    pub code: ErrorCode,
    /// For people: a sentence with the numbers.
    pub error: String,
}

impl ErrorReply {
    /// An answer of this code with this sentence.
    pub fn new(code: ErrorCode, error: impl fmt::Display) -> ErrorReply {
        ErrorReply { code, error: error.to_string() }
    }
}

impl From<&SettingsError> for ErrorReply {
    fn from(error: &SettingsError) -> ErrorReply {
        ErrorReply::new(error.code(), error)
    }
}

/// The frozen words of error answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorCode {
    /// No such task.
    UnknownTask,
    /// The body is not JSON, or not the one this key takes.
    BadJson,
    /// A setting is unknown, out of range or at odds with another.
    BadSettings,
    /// The target cannot be used.
    BadTarget,
    /// The request needs a target and none is set.
    NoTarget,
    /// Byte 0 of a header is not 1.
    WrongVersion,
    /// A limit of the worker is reached.
    Quota,
    /// The secret is missing or wrong.
    NotOwner,
    /// A name in the key is not `[A-Za-z0-9_-]{1,64}`.
    BadName,
    /// The body or payload is larger than the worker takes.
    TooLarge,
    /// The task was closed.
    Closed,
    /// A newer owner or request took its place.
    Superseded,
    /// A defect in the service. Unknown words are read as this.
    Internal,
    /// This version cannot do it.
    NotSupported,
}

impl ErrorCode {
    /// Every code.
    pub const ALL: [ErrorCode; 14] = [
        ErrorCode::UnknownTask,
        ErrorCode::BadJson,
        ErrorCode::BadSettings,
        ErrorCode::BadTarget,
        ErrorCode::NoTarget,
        ErrorCode::WrongVersion,
        ErrorCode::Quota,
        ErrorCode::NotOwner,
        ErrorCode::BadName,
        ErrorCode::TooLarge,
        ErrorCode::Closed,
        ErrorCode::Superseded,
        ErrorCode::Internal,
        ErrorCode::NotSupported,
    ];

    /// The word in JSON.
    pub fn word(self) -> &'static str {
        match self {
            ErrorCode::UnknownTask => "unknown_task",
            ErrorCode::BadJson => "bad_json",
            ErrorCode::BadSettings => "bad_settings",
            ErrorCode::BadTarget => "bad_target",
            ErrorCode::NoTarget => "no_target",
            ErrorCode::WrongVersion => "wrong_version",
            ErrorCode::Quota => "quota",
            ErrorCode::NotOwner => "not_owner",
            ErrorCode::BadName => "bad_name",
            ErrorCode::TooLarge => "too_large",
            ErrorCode::Closed => "closed",
            ErrorCode::Superseded => "superseded",
            ErrorCode::Internal => "internal",
            ErrorCode::NotSupported => "not_supported",
        }
    }

    /// One sentence for people.
    pub fn meaning(self) -> &'static str {
        match self {
            ErrorCode::UnknownTask => "no such task",
            ErrorCode::BadJson => "the body is not JSON, or not the one this key takes",
            ErrorCode::BadSettings => "a setting is unknown, missing, out of range or at odds with another",
            ErrorCode::BadTarget => "the target cannot be used",
            ErrorCode::NoTarget => "the request needs a target and none is set",
            ErrorCode::WrongVersion => "byte 0 of the header is not 1",
            ErrorCode::Quota => "a limit of the worker is reached",
            ErrorCode::NotOwner => "the secret is missing or wrong",
            ErrorCode::BadName => "a name in the key is not 1 to 64 of A-Z a-z 0-9 _ -",
            ErrorCode::TooLarge => "the body or payload is larger than the worker takes",
            ErrorCode::Closed => "the task was closed",
            ErrorCode::Superseded => "a newer owner or request took its place",
            ErrorCode::Internal => "a defect in the service",
            ErrorCode::NotSupported => "this version cannot do it",
        }
    }
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl Serialize for ErrorCode {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.word())
    }
}

impl<'de> Deserialize<'de> for ErrorCode {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<ErrorCode, D::Error> {
        let word = String::deserialize(deserializer)?;
        let known = ErrorCode::ALL.into_iter().find(|code| code.word() == word);
        Ok(known.unwrap_or(ErrorCode::Internal))
    }
}
