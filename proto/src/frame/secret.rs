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
#[error("a secret has 16 bytes (32 hexadecimal digits), got {got} of them")]
pub struct SecretError {
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
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
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
        let bytes = bytes.try_into().map_err(|_| SecretError { got: bytes.len() })?;
        Ok(Secret(bytes))
    }
}

impl TryFrom<String> for Secret {
    type Error = SecretError;

    fn try_from(text: String) -> Result<Secret, SecretError> {
        let refused = || SecretError { got: text.chars().count() };
        let digits: Vec<u8> = text
            .chars()
            .map(|digit| digit.to_digit(16).and_then(|d| u8::try_from(d).ok()))
            .collect::<Option<_>>()
            .ok_or_else(refused)?;
        if digits.len() != 2 * Secret::BYTES {
            return Err(refused());
        }
        Ok(Secret(std::array::from_fn(|i| digits[2 * i] << 4 | digits[2 * i + 1])))
    }
}

impl From<Secret> for String {
    fn from(secret: Secret) -> String {
        secret.to_hex()
    }
}
