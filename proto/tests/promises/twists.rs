//! Reading a twist fails closed: nothing but a clear order to move comes out as motion.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_BYTES, TwistError, TwistFlags, TwistMessage};

fn moving() -> TwistMessage {
    TwistMessage { twist: [0.1, 0.0, 0.0, 0.0, 0.0, -0.2], valid_ms: 200, ..TwistMessage::zero(Status::Servoing) }
}

fn changed(at: usize, byte: u8) -> [u8; TWIST_BYTES] {
    let mut bytes = moving().encode();
    bytes[at] = byte;
    bytes
}

#[test]
fn every_unknown_status_stops() {
    for code in 22..=u8::MAX {
        let read = TwistMessage::decode(&changed(1, code)).unwrap();
        assert_eq!((read.status, read.twist), (Status::Internal, [0.0; 6]), "{code}");
    }
    let json = moving().to_json().replace("servoing", "dancing");
    let read = TwistMessage::from_json(json.as_bytes()).unwrap();
    assert_eq!((read.status, read.twist), (Status::Internal, [0.0; 6]));
}

#[test]
fn motion_with_any_known_status_but_servoing_is_refused() {
    for status in Status::ALL.into_iter().filter(|status| *status != Status::Servoing) {
        let expected = TwistError::MotionWithoutServoing { status, got: moving().twist };
        assert_eq!(TwistMessage::decode(&changed(1, status.code())), Err(expected.clone()));
        let json = moving().to_json().replace("servoing", status.word());
        assert_eq!(TwistMessage::from_json(json.as_bytes()), Err(expected));
    }
}

#[test]
fn every_component_must_be_finite() {
    for at in 0..6 {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut bytes = moving().encode();
            bytes[40 + 8 * at..48 + 8 * at].copy_from_slice(&wrong.to_le_bytes());
            assert!(matches!(TwistMessage::decode(&bytes), Err(TwistError::NotFinite { .. })));
        }
    }
}

#[test]
fn every_other_version_is_refused_whatever_its_length() {
    for got in (0..=u8::MAX).filter(|version| *version != 1) {
        assert_eq!(TwistMessage::decode(&changed(0, got)), Err(TwistError::WrongVersion { got }));
        assert_eq!(TwistMessage::decode(&[got]), Err(TwistError::WrongVersion { got }));
    }
    let json = moving().to_json().replace("\"version\":1", "\"version\":2");
    assert_eq!(TwistMessage::from_json(json.as_bytes()), Err(TwistError::WrongVersion { got: 2 }));
}

#[test]
fn every_other_length_is_refused() {
    for got in (0..300).filter(|length| *length != TWIST_BYTES) {
        let mut bytes = moving().encode().to_vec();
        bytes.resize(got, 0);
        assert_eq!(TwistMessage::decode(&bytes), Err(TwistError::Length { expected: TWIST_BYTES, got }));
    }
}

#[test]
fn unknown_flags_and_the_last_bytes_are_ignored() {
    let mut bytes = moving().encode();
    bytes[2..4].copy_from_slice(&0xFFE4u16.to_le_bytes());
    bytes[120..].fill(0xFF);
    let flags = TwistFlags { within_threshold: true, ..TwistFlags::default() };
    assert_eq!(TwistMessage::decode(&bytes).unwrap().flags, flags);
}

#[test]
fn what_would_be_refused_is_sent_as_a_stop() {
    let nan = TwistMessage { twist: [f64::NAN; 6], ..moving() };
    let paused_but_moving = TwistMessage { status: Status::Paused, ..moving() };
    for wrong in [nan, paused_but_moving] {
        for read in [TwistMessage::decode(&wrong.encode()), TwistMessage::from_json(wrong.to_json().as_bytes())] {
            let read = read.unwrap();
            assert_eq!((read.status, read.twist), (Status::Internal, [0.0; 6]));
        }
    }
}

#[test]
fn zeros_leave_without_flags() {
    let flags = TwistFlags { speed_limited: true, step_capped: true, ..TwistFlags::default() };
    let paused = TwistMessage { flags, ..TwistMessage::zero(Status::Paused) };
    let refused = TwistMessage { flags, twist: [f64::NAN; 6], ..moving() };
    for message in [paused, refused] {
        for read in [TwistMessage::decode(&message.encode()), TwistMessage::from_json(message.to_json().as_bytes())] {
            assert_eq!(read.unwrap().flags, TwistFlags::default());
        }
    }
}

#[test]
fn a_twist_in_json_must_be_complete() {
    for missing in ["status", "twist", "epoch", "valid_ms"] {
        let json = moving().to_json().replace(&format!("\"{missing}\":"), "\"other\":");
        assert!(matches!(TwistMessage::from_json(json.as_bytes()), Err(TwistError::Unreadable { .. })), "{missing}");
    }
}

#[test]
fn infinite_diagnostics_are_null_in_json() {
    let message = TwistMessage { condition_number: f64::INFINITY, ..moving() };
    assert!(message.to_json().contains("\"condition_number\":null"));
    assert_eq!(TwistMessage::decode(&message.encode()).unwrap().condition_number, f64::INFINITY);
}

#[test]
fn codes_words_and_order_of_statuses_agree() {
    for (code, status) in Status::ALL.into_iter().enumerate() {
        assert_eq!(usize::from(status.code()), code);
        assert_eq!(Status::from_code(status.code()), Some(status));
        assert_eq!(Status::from_word(status.word()), Some(status));
        assert_eq!(serde_json::to_string(&status).unwrap(), format!("\"{status}\""));
    }
    assert_eq!(Status::from_code(22), None);
    assert!(serde_json::from_str::<Status>("\"dancing\"").is_err());
}

#[test]
fn seven_statuses_are_latched() {
    let latched = Status::ALL.into_iter().filter(|status| status.is_latched()).map(Status::code);
    assert_eq!(latched.collect::<Vec<_>>(), [1, 8, 9, 10, 11, 17, 19]);
}
