//! A twist as JSON, for `?format=json` and for logs: the same fields, NaN as null, status and flags as words.
//!
//! JSON has no infinity either: an infinite diagnostic is null as well.

use serde::{Deserialize, Serialize};

use super::{TwistError, TwistFlags, TwistMessage};
use crate::status::Status;
use crate::{WIRE_VERSION, body};

#[derive(Serialize, Deserialize)]
struct TwistJson {
    version: u8,
    status: String,
    flags: Vec<String>,
    order: u16,
    features: u16,
    sequence: u64,
    capture_time_ns: u64,
    epoch: u32,
    queue_us: u32,
    compute_us: u32,
    valid_ms: u32,
    twist: [f64; 6],
    pixel_mse: Option<f64>,
    feature_error_norm: Option<f64>,
    condition_number: Option<f64>,
    gain: Option<f64>,
}

impl TwistMessage {
    /// The message as JSON text. As in `encode`, what would be refused is sent as zeros with `internal`.
    pub fn to_json(&self) -> String {
        let sent = self.sent();
        let finite = |number: f64| number.is_finite().then_some(number);
        let json = TwistJson {
            version: WIRE_VERSION,
            status: sent.status.word().to_owned(),
            flags: sent.flags.words().into_iter().map(str::to_owned).collect(),
            order: self.order,
            features: self.features,
            sequence: self.sequence,
            capture_time_ns: self.capture_time_ns,
            epoch: self.epoch,
            queue_us: self.queue_us,
            compute_us: self.compute_us,
            valid_ms: self.valid_ms,
            twist: sent.twist,
            pixel_mse: finite(self.pixel_mse),
            feature_error_norm: finite(self.feature_error_norm),
            condition_number: finite(self.condition_number),
            gain: finite(self.gain),
        };
        serde_json::to_string(&json).expect("text keys and finite numbers always serialize")
    }

    /// Reads the JSON form, as closed as [`TwistMessage::decode`]; fields it does not know are ignored.
    pub fn from_json(text: &[u8]) -> Result<TwistMessage, TwistError> {
        let json: TwistJson = body::read(text).map_err(|error| TwistError::Unreadable { reason: error.to_string() })?;
        if json.version != WIRE_VERSION {
            return Err(TwistError::WrongVersion { got: json.version });
        }
        let number = |field: Option<f64>| field.unwrap_or(f64::NAN);
        TwistMessage {
            status: Status::Internal,
            flags: TwistFlags::from_words(json.flags.iter().map(String::as_str)),
            order: json.order,
            features: json.features,
            sequence: json.sequence,
            capture_time_ns: json.capture_time_ns,
            epoch: json.epoch,
            queue_us: json.queue_us,
            compute_us: json.compute_us,
            valid_ms: json.valid_ms,
            twist: json.twist,
            pixel_mse: number(json.pixel_mse),
            feature_error_norm: number(json.feature_error_norm),
            condition_number: number(json.condition_number),
            gain: number(json.gain),
        }
        .with_status(Status::from_word(&json.status))
    }
}
