//! Names and task keys: checked text, safe to put into a key.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The longest name, in bytes.
pub const MAX_NAME_BYTES: usize = 64;

/// Why a name, a task key or a prefix was refused.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum KeyError {
    /// A name is empty or longer than [`MAX_NAME_BYTES`].
    #[error("a name has 1 to 64 characters, got {got_bytes} bytes")]
    NameLength {
        /// The length of what came, bytes.
        got_bytes: usize,
    },
    /// A name holds something else than `[A-Za-z0-9_-]`.
    #[error("a name is made of A-Z a-z 0-9 _ -, got {got:?}")]
    NameCharacter {
        /// The first character that is not allowed.
        got: char,
    },
    /// A task key is not `client/id`.
    #[error("a task is written client/id, got {got:?}")]
    NotATask {
        /// The text that came, cut to 80 characters.
        got: String,
    },
}

/// One chunk of a key that a person or a program chose: `[A-Za-z0-9_-]{1,64}`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Name(String);

impl Name {
    /// The text of the name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<&str> for Name {
    type Error = KeyError;

    fn try_from(text: &str) -> Result<Name, KeyError> {
        if text.is_empty() || text.len() > MAX_NAME_BYTES {
            return Err(KeyError::NameLength { got_bytes: text.len() });
        }
        let allowed = |c: &char| c.is_ascii_alphanumeric() || *c == '_' || *c == '-';
        match text.chars().find(|c| !allowed(c)) {
            Some(got) => Err(KeyError::NameCharacter { got }),
            None => Ok(Name(text.to_owned())),
        }
    }
}

impl TryFrom<String> for Name {
    type Error = KeyError;

    fn try_from(text: String) -> Result<Name, KeyError> {
        Name::try_from(text.as_str())
    }
}

impl FromStr for Name {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Name, KeyError> {
        Name::try_from(text)
    }
}

impl From<Name> for String {
    fn from(name: Name) -> String {
        name.0
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Which task: the client that made it, and its id among that client's tasks. Written `client/id`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TaskKey {
    /// The client's name.
    pub client: Name,
    /// The task's id.
    pub id: Name,
}

impl fmt::Display for TaskKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.client, self.id)
    }
}

impl FromStr for TaskKey {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<TaskKey, KeyError> {
        let (client, id) =
            text.split_once('/').ok_or_else(|| KeyError::NotATask { got: text.chars().take(80).collect() })?;
        Ok(TaskKey { client: client.parse()?, id: id.parse()? })
    }
}

impl TryFrom<String> for TaskKey {
    type Error = KeyError;

    fn try_from(text: String) -> Result<TaskKey, KeyError> {
        text.parse()
    }
}

impl From<TaskKey> for String {
    fn from(task: TaskKey) -> String {
        task.to_string()
    }
}
