//! JSON bodies: one way in, one way out, with a limit in bytes and one in values: a million bytes of little objects would make a
//! hundred million of memory.
//!
//! Depth needs no limit of its own: `serde_json` stops at 128 levels.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::messages::ErrorCode;

/// The largest JSON body that is read, in bytes.
pub const MAX_JSON_BYTES: usize = 1024 * 1024;

/// The most values, lists and objects among them, in a JSON body that is read. No message comes near it.
pub const MAX_JSON_VALUES: usize = 16_384;

/// The Encoding of every JSON body.
pub const JSON: &str = "application/json";

/// Why a JSON body was refused.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum BodyError {
    /// The body is larger than [`MAX_JSON_BYTES`].
    #[error("a body has at most {limit_bytes} bytes, got {got_bytes}")]
    TooLarge {
        /// The limit in force, bytes.
        limit_bytes: usize,
        /// What came, bytes.
        got_bytes: usize,
    },
    /// The body has more than [`MAX_JSON_VALUES`] values.
    #[error("a body has at most {limit} values, got {got}")]
    TooMany {
        /// The limit in force.
        limit: usize,
        /// What came, by its commas and brackets.
        got: usize,
    },
    /// The body is not JSON, or not the JSON that this key takes.
    #[error("unreadable body: {reason}")]
    Unreadable {
        /// What the parser said, with line and column.
        reason: String,
    },
}

impl BodyError {
    /// The frozen word to answer with.
    pub fn code(&self) -> ErrorCode {
        match self {
            BodyError::TooLarge { .. } => ErrorCode::TooLarge,
            BodyError::TooMany { .. } | BodyError::Unreadable { .. } => ErrorCode::BadJson,
        }
    }
}

/// Reads a JSON body. Fails when it is too large, has too many values, is not JSON, or not a `T`.
pub fn read<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, BodyError> {
    if bytes.len() > MAX_JSON_BYTES {
        return Err(BodyError::TooLarge { limit_bytes: MAX_JSON_BYTES, got_bytes: bytes.len() });
    }
    // Each value but the first stands behind a comma or an opening bracket. Those in texts are counted too, which are few.
    let got = 1 + bytes.iter().filter(|byte| b",[{".contains(byte)).count();
    if got > MAX_JSON_VALUES {
        return Err(BodyError::TooMany { limit: MAX_JSON_VALUES, got });
    }
    serde_json::from_slice(bytes).map_err(|error| BodyError::Unreadable { reason: shortened(error.to_string()) })
}

/// What a parser said, with the middle left out where it repeats a long word of the body: a refusal is read by people and
/// kept in logs, and must not grow with what was refused.
pub(crate) fn shortened(reason: String) -> String {
    const KEPT: usize = 160;
    let characters = reason.chars().count();
    if characters <= 2 * KEPT {
        return reason;
    }
    let (first, last) = (reason.chars().take(KEPT), reason.chars().skip(characters - KEPT));
    first.chain(" … ".chars()).chain(last).collect()
}

/// Writes a JSON body: one line, no trailing newline.
pub fn write<T: Serialize>(message: &T) -> Vec<u8> {
    serde_json::to_vec(message).expect("messages have text keys and no failing serializer")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Control;

    #[test]
    fn a_refusal_keeps_its_beginning_and_its_place_and_not_what_was_refused() {
        let body = format!(r#"{{"do": "{}"}}"#, "ä".repeat(100_000));
        let refused = read::<Control>(body.as_bytes()).expect_err("no such word").to_string();
        assert!(
            refused.starts_with("unreadable body: unknown variant") && refused.contains("line 1 column"),
            "{refused}"
        );
        assert!(refused.chars().count() < 400, "{refused}");
    }
}
