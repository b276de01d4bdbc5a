//! Task settings: what a client may choose, with its default, its range and its unit in its name.
//!
//! `types` is the shape (`methods`: the list of methods; `mask`: the PNG in it; `forms`: what JSON writes in two ways), `fields` the
//! table of names, ranges and meanings,
//! `patch` how JSON becomes settings, `validate` what must hold between the numbers. The table in `docs/protocol.md` is printed from `fields`.

mod fields;
mod forms;
mod mask;
mod methods;
mod patch;
mod types;
mod validate;

pub use fields::{FIELDS, Field, Range, table};
pub use mask::{MAX_MASK_CHARACTERS, Mask};
pub use methods::Method;
pub use types::{
    AdaptiveGain, Camera, Depth, DepthScale, Frames, Gain, Holes, Krawtchouk, KrawtchoukP, Lattice, Lease, Light,
    Limits, NoiseFloor, OrderRange, Preprocess, Resize, Ros2, StepCap, Stop, TaskSettings, Window,
};

use crate::body::BodyError;
use crate::messages::ErrorCode;

/// Why settings were refused.
#[derive(Debug, Clone, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum SettingsError {
    /// The body is too large or not JSON.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// The body is not a JSON object.
    #[error("settings are a JSON object, got {got}")]
    NotAnObject {
        /// The kind of value that came.
        got: &'static str,
    },
    /// A field is unknown, missing, or of another type.
    #[error("{field}: {reason}")]
    Field {
        /// The field's path.
        field: String,
        /// What the parser said.
        reason: String,
    },
    /// A number is outside its range.
    #[error("{field} must be {range}, got {got}")]
    OutOfRange {
        /// The field's path.
        field: String,
        /// Its documented range.
        range: String,
        /// The number that came.
        got: f64,
    },
    /// Two settings contradict each other.
    #[error("{reason}")]
    Contradiction {
        /// A sentence with the numbers.
        reason: String,
    },
    /// The setting exists in the design, but this version cannot do it.
    #[error("{what} is not supported by this version")]
    NotSupported {
        /// The field and its value.
        what: String,
    },
}

impl SettingsError {
    /// The frozen word to answer with.
    pub fn code(&self) -> ErrorCode {
        match self {
            SettingsError::Body(error) => error.code(),
            SettingsError::NotSupported { .. } => ErrorCode::NotSupported,
            _ => ErrorCode::BadSettings,
        }
    }
}
