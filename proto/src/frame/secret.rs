//! A task's secret: 16 bytes that only its client knows. Never printed, compared in constant time.

use std::fmt;

use serde::{Deserialize, Serialize};
use sha3::{Digest, Sha3_256};

/// 16 bytes; 32 hexadecimal digits in JSON.
#[derive(Clone, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Secret([u8; Secret::BYTES]);

/// A text or attachment that is not a secret. What it was is not said: it may be most of one.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[error("a secret or its hash has {expected} bytes ({} hexadecimal digits), got {got} of them", 2 * expected)]
pub struct SecretError {
    /// How many bytes it should have.
    pub expected: usize,
    /// The length of what came: bytes, or characters of text.
    pub got: usize,
}

impl Secret {
    /// How many bytes.
    pub const BYTES: usize = 16;

    /// The secret of these bytes.
    pub fn new(bytes: [u8; Secret::BYTES]) -> Secret {
        Secret(bytes)
    }

    /// The secret that goes with pushed frames, of a task with this one: the first 16 bytes of the SHA3-256 of
    /// `domvs frame` and these bytes. Who overhears it, or keeps a camera, can push frames and control nothing.
    pub fn for_frames(&self) -> Secret {
        let digest = Sha3_256::new_with_prefix(b"domvs frame").chain_update(self.0).finalize();
        Secret(std::array::from_fn(|byte| digest[byte]))
    }

    /// The bytes, as they follow a frame header or fill an attachment.
    pub fn as_bytes(&self) -> &[u8; Secret::BYTES] {
        &self.0
    }

    /// The 32 hexadecimal digits. For JSON; never log them.
    pub fn to_hex(&self) -> String {
        to_hex(&self.0)
    }
}

impl Secret {
    /// What may be told of it: 16 random bytes cannot be found from their hash.
    pub fn hash(&self) -> SecretHash {
        SecretHash(Sha3_256::digest(self.0).into())
    }
}

/// SHA3-256 of a secret's 16 bytes; 64 hexadecimal digits in JSON. It tells whether a secret that is presented is the right one,
/// and nothing else, so a standby may know it and `state` may carry it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SecretHash([u8; SecretHash::BYTES]);

impl SecretHash {
    /// How many bytes.
    pub const BYTES: usize = 32;

    /// Whether this is the hash of `secret`.
    pub fn is_of(&self, secret: &Secret) -> bool {
        *self == secret.hash()
    }
}

impl TryFrom<String> for SecretHash {
    type Error = SecretError;

    fn try_from(text: String) -> Result<SecretHash, SecretError> {
        hex_bytes(&text).map(SecretHash)
    }
}

impl From<SecretHash> for String {
    fn from(hash: SecretHash) -> String {
        to_hex(&hash.0)
    }
}

impl PartialEq for Secret {
    /// Takes the same time wherever the first difference is.
    fn eq(&self, other: &Secret) -> bool {
        let difference = self.0.iter().zip(&other.0).fold(0, |sum, (a, b)| sum | (a ^ b));
        std::hint::black_box(difference) == 0
    }
}

impl Eq for Secret {}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl TryFrom<&[u8]> for Secret {
    type Error = SecretError;

    fn try_from(bytes: &[u8]) -> Result<Secret, SecretError> {
        let bytes = bytes.try_into().map_err(|_| SecretError { got: bytes.len(), expected: Secret::BYTES })?;
        Ok(Secret(bytes))
    }
}

impl TryFrom<String> for Secret {
    type Error = SecretError;

    fn try_from(text: String) -> Result<Secret, SecretError> {
        hex_bytes(&text).map(Secret)
    }
}

impl From<Secret> for String {
    fn from(secret: Secret) -> String {
        secret.to_hex()
    }
}

fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// `N` bytes from their hexadecimal digits. Fails when there are more or fewer, or other characters.
fn hex_bytes<const N: usize>(text: &str) -> Result<[u8; N], SecretError> {
    let refused = || SecretError { got: text.chars().count(), expected: N };
    let digits: Vec<u8> = text
        .chars()
        .map(|digit| digit.to_digit(16).and_then(|d| u8::try_from(d).ok()))
        .collect::<Option<_>>()
        .ok_or_else(refused)?;
    if digits.len() != 2 * N {
        return Err(refused());
    }
    Ok(std::array::from_fn(|i| digits[2 * i] << 4 | digits[2 * i + 1]))
}
