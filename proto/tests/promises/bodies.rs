//! Hostile JSON: too large, too deep, not text, not ours.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use domvs_proto::body::{self, BodyError, MAX_JSON_BYTES, MAX_JSON_VALUES};
use domvs_proto::messages::{Control, CreateReply, ErrorCode, ErrorReply, StatusMessage};
use domvs_proto::settings::{SettingsError, TaskSettings};
use serde_json::Value;

fn create(bytes: &[u8]) -> SettingsError {
    TaskSettings::from_create_body(bytes).unwrap_err()
}

#[test]
fn a_body_over_the_limit_is_not_read() {
    let mut bytes = b"{}".to_vec();
    bytes.resize(MAX_JSON_BYTES, b' ');
    assert!(body::read::<Value>(&bytes).is_ok());
    bytes.push(b' ');
    let expected = BodyError::TooLarge { limit_bytes: 1_048_576, got_bytes: 1_048_577 };
    assert_eq!(body::read::<Value>(&bytes), Err(expected));
    assert_eq!(create(&bytes).code(), ErrorCode::TooLarge);
}

#[test]
fn a_deep_body_ends_in_an_error() {
    for open in ["[", "{\"a\":", "{\"camera\":", "{\"limits\":{\"a\":"] {
        let deep = open.repeat(MAX_JSON_VALUES / 4);
        assert_eq!(create(deep.as_bytes()).code(), ErrorCode::BadJson, "{open}");
        assert!(body::read::<Control>(deep.as_bytes()).is_err());
    }
}

#[test]
fn a_body_of_too_many_values_is_not_read() {
    let list = |values: usize| format!("[0{}]", ",0".repeat(values - 2));
    assert!(body::read::<Value>(list(MAX_JSON_VALUES).as_bytes()).is_ok());
    let one_more = list(MAX_JSON_VALUES + 1);
    let expected = BodyError::TooMany { limit: 16_384, got: 16_385 };
    assert_eq!(body::read::<Value>(one_more.as_bytes()), Err(expected));
    assert_eq!(create(one_more.as_bytes()).code(), ErrorCode::BadJson);
}

#[test]
fn a_body_that_is_not_json_is_refused() {
    for bytes in [
        &b""[..],
        b"\xFF\xFE",
        b"{\"camera\": \"\xC3\x28\"}",
        b"{",
        b"{} {}",
        b"NaN",
        b"{\"epsilon\": NaN}",
        b"{\"epsilon\": 1e999}",
        b"{'a': 1}",
        b"\0",
    ] {
        assert_eq!(create(bytes).code(), ErrorCode::BadJson, "{bytes:?}");
        assert!(body::read::<Control>(bytes).is_err());
    }
}

#[test]
fn settings_are_an_object() {
    for bytes in [&b"null"[..], b"[]", b"1", b"\"hahn\"", b"true"] {
        let error = create(bytes);
        assert!(matches!(error, SettingsError::NotAnObject { .. }), "{error}");
        assert_eq!(error.code(), ErrorCode::BadSettings);
    }
}

#[test]
fn control_takes_five_words_and_nothing_else() {
    let words = ["start", "pause", "resume", "stop", "close"];
    let controls = [Control::Start, Control::Pause, Control::Resume, Control::Stop, Control::Close];
    for (word, control) in words.into_iter().zip(controls) {
        let text = format!("{{\"do\":\"{word}\"}}");
        assert_eq!(body::read::<Control>(text.as_bytes()), Ok(control));
        assert_eq!(body::write(&control), text.as_bytes());
    }
    for text in [
        "{}",
        "\"start\"",
        "{\"do\":\"Start\"}",
        "{\"do\":\"go\"}",
        "{\"do\":null}",
        "{\"do\":\"start\",\"now\":true}",
        "{\"do\":\"start\",\"do\":\"stop\"}",
    ] {
        assert!(body::read::<Control>(text.as_bytes()).is_err(), "{text}");
    }
}

#[test]
fn answers_are_read_tolerantly() {
    let reply = format!("{{\"task\":\"a/b\",\"epoch\":1,\"secret\":\"{}\",\"new\":[]}}", "0f".repeat(16));
    assert!(body::read::<CreateReply>(reply.as_bytes()).is_ok());
    let error = body::read::<ErrorReply>(b"{\"code\":\"from_the_future\",\"error\":\"e\"}").unwrap();
    assert_eq!(error.code, ErrorCode::Internal);
}

#[test]
fn names_in_answers_are_checked() {
    let reply = format!("{{\"task\":\"a/*\",\"epoch\":1,\"secret\":\"{}\"}}", "0f".repeat(16));
    assert!(body::read::<CreateReply>(reply.as_bytes()).is_err());
    assert!(body::read::<StatusMessage>(b"{\"task\":\"../x\"}").is_err());
}

#[test]
fn every_error_word_is_read_back() {
    for code in ErrorCode::ALL {
        let text = serde_json::to_string(&code).unwrap();
        assert_eq!(text, format!("\"{code}\""));
        assert_eq!(serde_json::from_str::<ErrorCode>(&text).unwrap(), code);
    }
}
