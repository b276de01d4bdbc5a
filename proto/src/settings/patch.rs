//! How JSON becomes settings: a merge patch (RFC 7396) onto the defaults on create, onto the settings later.
//!
//! null means the default. Three things go beyond the letter of the RFC, all because a settings object is
//! complete at any time: a nested null is the nested default; a setting that chooses between forms is replaced as
//! a whole, for two forms merged are none; and on create null limits or a null step cap mean none.

use serde_json::{Map, Value};

use super::{Camera, Light, SettingsError, TaskSettings};
use crate::body;

/// Settings that are one of several forms: replaced, never merged.
const CHOICES: [&str; 7] = ["window", "order", "gain", "depth", "frames", "lease", "ros2"];

/// Settings that can be switched off as a whole.
const SWITCHES: [&str; 2] = ["limits", "step_cap"];

impl TaskSettings {
    /// Settings from the body of a `create` request; what it does not name has its default.
    /// Fails on anything unreadable, unknown, out of range or not supported.
    pub fn from_create_body(bytes: &[u8]) -> Result<TaskSettings, SettingsError> {
        TaskSettings::from_json(&body::read(bytes)?)
    }

    /// The same from a JSON value. Here null `limits` or `step_cap` mean none.
    pub fn from_json(settings: &Value) -> Result<TaskSettings, SettingsError> {
        let mut settings = object(settings)?.clone();
        for switch in SWITCHES {
            if settings.get(switch) == Some(&Value::Null) {
                settings.insert(switch.to_owned(), "none".into());
            }
        }
        merge_and_check(defaults(), &settings)
    }

    /// These settings changed by a merge patch; here null always means the default, for `limits` too.
    /// Fails as [`TaskSettings::from_json`] does, and changes nothing then.
    pub fn merge_patch(&self, patch: &Value) -> Result<TaskSettings, SettingsError> {
        merge_and_check(self.to_value(), object(patch)?)
    }

    /// These settings changed by the body of a `settings` request. Fails as [`TaskSettings::merge_patch`] does.
    pub fn merge_patch_body(&self, bytes: &[u8]) -> Result<TaskSettings, SettingsError> {
        self.merge_patch(&body::read(bytes)?)
    }

    /// The settings as a JSON value with every field.
    pub fn to_value(&self) -> Value {
        serde_json::to_value(self).expect("settings have text keys and no failing serializer")
    }
}

/// The defaults as JSON. The camera is an object with nothing but its optional part.
pub(super) fn defaults() -> Value {
    let placeholder = Camera { fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0, width: 0, height: 0, distortion: None };
    let mut defaults = TaskSettings::new(placeholder).to_value();
    defaults["camera"] = serde_json::json!({ "distortion": null });
    defaults
}

/// The parts of a switch that is off by default, for a patch that names some of them.
fn switched_on(key: &str) -> Option<Value> {
    (key == "light").then(|| serde_json::to_value(Light::default()).expect("four numbers make JSON"))
}

fn merge_and_check(mut settings: Value, patch: &Map<String, Value>) -> Result<TaskSettings, SettingsError> {
    refuse_unsupported(patch)?;
    let defaults = defaults();
    for (key, value) in patch {
        settings[key] = merged(key, &settings[key], value, defaults.get(key));
    }
    let settings: TaskSettings = serde_json::from_value(settings.clone()).map_err(|error| blame(&settings, &error))?;
    settings.validate()?;
    Ok(settings)
}

/// The value of one setting after a patch.
fn merged(key: &str, now: &Value, patch: &Value, default: Option<&Value>) -> Value {
    match patch {
        // An unknown key keeps its null, and the typed reading refuses it by name.
        Value::Null => default.cloned().unwrap_or(Value::Null),
        Value::Object(patch) if CHOICES.contains(&key) => {
            patch.iter().filter(|(_, value)| !value.is_null()).map(|(k, v)| (k.clone(), v.clone())).collect()
        }
        Value::Object(patch) => {
            let parts = default.filter(|value| value.is_object()).cloned().or_else(|| switched_on(key));
            let base = [Some(now), parts.as_ref()].into_iter().flatten().find(|value| value.is_object());
            let mut base = base.and_then(Value::as_object).cloned().unwrap_or_default();
            for (inner, value) in patch {
                let inner_default = parts.as_ref().and_then(|parts| parts.get(inner));
                let inner_now = base.get(inner).unwrap_or(&Value::Null);
                base.insert(inner.clone(), merged("", inner_now, value, inner_default));
            }
            Value::Object(base)
        }
        Value::String(word) if key == "depth" && word == "map" => serde_json::json!({ "map": {} }),
        value => value.clone(),
    }
}

/// Names what the design knows and this version does not, before the typed reading calls it unknown.
fn refuse_unsupported(patch: &Map<String, Value>) -> Result<(), SettingsError> {
    let refused = |what: String| Err(SettingsError::NotSupported { what });
    let set = |value: Option<&Value>| value.is_some_and(|value| !value.is_null() && *value != Value::Bool(false));
    if set(patch.get("ros2")) {
        return refused("ros2".to_owned());
    }
    for name in ["resize", "undistort"] {
        if set(patch.get("preprocess").and_then(|preprocess| preprocess.get(name))) {
            return refused(format!("preprocess.{name}"));
        }
    }
    for source in ["franka_cam", "ros2"] {
        if patch.get("frames").is_some_and(|frames| frames.get(source).is_some()) {
            return refused(format!("frames {source:?}"));
        }
    }
    Ok(())
}

/// Finds the setting that the parser stumbled over: the first that spoils settings which are good without it.
fn blame(settings: &Value, error: &serde_json::Error) -> SettingsError {
    let camera = Camera { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0, width: 64, height: 64, distortion: None };
    let good = TaskSettings::new(camera).to_value();
    for (key, value) in settings.as_object().into_iter().flatten() {
        let mut one_changed = good.clone();
        one_changed[key] = value.clone();
        if let Err(reason) = serde_json::from_value::<TaskSettings>(one_changed) {
            return SettingsError::Field { field: short(key), reason: body::shortened(reason.to_string()) };
        }
    }
    SettingsError::Field { field: "settings".to_owned(), reason: body::shortened(error.to_string()) }
}

fn object(value: &Value) -> Result<&Map<String, Value>, SettingsError> {
    let got = match value {
        Value::Object(map) => return Ok(map),
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "text",
        Value::Array(_) => "a list",
    };
    Err(SettingsError::NotAnObject { got })
}

/// A foreign key cut to what fits in a log line.
fn short(key: &str) -> String {
    key.chars().take(80).collect()
}
