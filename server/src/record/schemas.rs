//! JSON schemas of the JSON channels, so that viewers can offer the fields for plotting. They describe, they do not check.

/// The JSON form of a twist (`TwistMessage::to_json`): every field, a test holds them equal.
pub(super) const TWIST_SCHEMA: &str = r#"{
  "title": "domvs.Twist",
  "description": "camera velocity in the camera's optical frame and how it was found; null: does not apply",
  "type": "object",
  "properties": {
    "version": {"type": "integer"},
    "status": {"type": "string"},
    "flags": {"type": "array", "items": {"type": "string"}},
    "order": {"type": "integer"},
    "features": {"type": "integer"},
    "sequence": {"type": "integer"},
    "capture_time_ns": {"type": "integer"},
    "epoch": {"type": "integer"},
    "queue_us": {"type": "integer"},
    "compute_us": {"type": "integer"},
    "valid_ms": {"type": "integer"},
    "twist": {"type": "array", "items": {"type": "number"}, "description": "3 x m/s, then 3 x rad/s"},
    "pixel_mse": {"type": "number"},
    "feature_error_norm": {"type": "number"},
    "condition_number": {"type": "number"},
    "gain": {"type": "number"}
  }
}"#;

/// A status message; fields beyond these are as in `docs/protocol.md`.
pub(super) const STATUS_SCHEMA: &str = r#"{
  "title": "domvs.Status",
  "type": "object",
  "properties": {
    "task": {"type": "string"},
    "status": {"type": "string"},
    "meaning": {"type": "string"},
    "epoch": {"type": "integer"},
    "pixel_mse": {"type": "number"},
    "order": {"type": "integer"}
  }
}"#;

/// A task's settings, whole; fields as in `docs/protocol.md`.
pub(super) const SETTINGS_SCHEMA: &str = r#"{
  "title": "domvs.Settings",
  "type": "object",
  "properties": {
    "method": {"type": "string"}
  }
}"#;
