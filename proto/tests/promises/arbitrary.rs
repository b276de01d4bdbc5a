//! Anything at all: what is written is read back, and no input makes a reader panic or the camera move.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use domvs_proto::body;
use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat, Secret};
use domvs_proto::keys::{Keys, Name, TaskKey};
use domvs_proto::messages::{Control, CreateReply, ErrorReply, StatusMessage, TaskState, WorkerInfo};
use domvs_proto::settings::{Camera, TaskSettings};
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_BYTES, TwistFlags, TwistMessage};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use serde_json::{Value, json};

/// A runner that draws the same cases on every machine.
fn runner() -> TestRunner {
    let config = ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() };
    TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]))
}

fn header() -> impl Strategy<Value = FrameHeader> {
    let formats = (select(&PixelFormat::ALL[..]), select(&DepthFormat::ALL[..]));
    let sizes = (any::<u32>(), any::<u32>(), any::<u32>(), any::<u32>(), any::<f32>());
    let times = (any::<u64>(), any::<u64>(), any::<u32>(), any::<Option<[u8; 16]>>());
    (formats, sizes, times).prop_map(|((pixel_format, depth_format), sizes, times)| FrameHeader {
        pixel_format,
        depth_format,
        width: sizes.0,
        height: sizes.1,
        row_bytes: sizes.2,
        depth_offset: sizes.3,
        depth_unit_m: sizes.4,
        sequence: times.0,
        capture_time_ns: times.1,
        deadline_us: times.2,
        secret: times.3.map(Secret::new),
    })
}

fn twist() -> impl Strategy<Value = TwistMessage> {
    let counts = (select(&Status::ALL[..]), 0u16..32, any::<u16>(), any::<u16>(), any::<u64>(), any::<u64>());
    let times = (any::<u32>(), any::<u32>(), any::<u32>(), any::<u32>());
    (counts, times, any::<[f64; 6]>(), any::<[f64; 4]>()).prop_map(|(counts, times, twist, diagnostics)| TwistMessage {
        status: counts.0,
        // Zeros have none.
        flags: if counts.0 == Status::Servoing { TwistFlags::from_bits(counts.1) } else { TwistFlags::default() },
        order: counts.2,
        features: counts.3,
        sequence: counts.4,
        capture_time_ns: counts.5,
        epoch: times.0,
        queue_us: times.1,
        compute_us: times.2,
        valid_ms: times.3,
        twist: if counts.0 == Status::Servoing { twist } else { [0.0; 6] },
        pixel_mse: diagnostics[0],
        feature_error_norm: diagnostics[1],
        condition_number: diagnostics[2],
        gain: diagnostics[3],
    })
}

/// JSON that resembles settings: their names, their words, and nonsense.
fn json_like_settings() -> impl Strategy<Value = Value> {
    let words =
        ["hahn", "adaptive", "map", "target", "none", "requests", "pushed", "client", "estimate", "photometric", "x"];
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i32>().prop_map(Value::from),
        (-2.0..50.0).prop_map(Value::from),
        select(words.to_vec()).prop_map(Value::from),
    ];
    let names: Vec<&str> =
        domvs_proto::settings::FIELDS.iter().flat_map(|field| field.name.split('.')).chain(["x", ""]).collect();
    leaf.prop_recursive(4, 40, 6, move |inner| {
        prop_oneof![
            vec(inner.clone(), 0..7).prop_map(Value::from),
            vec((select(names.clone()), inner), 0..6)
                .prop_map(|pairs| pairs.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()),
        ]
    })
}

fn camera() -> Camera {
    Camera { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5, width: 640, height: 480, distortion: None }
}

#[test]
fn every_header_comes_back_bit_for_bit() {
    runner()
        .run(&header(), |header| {
            let bytes = header.encode();
            prop_assert_eq!(FrameHeader::decode(&bytes).unwrap().encode(), bytes);
            Ok(())
        })
        .unwrap();
}

#[test]
fn a_layout_never_reaches_beyond_the_payload() {
    let small = (header(), 0u32..9, 0u32..9, 0u32..40, 0u32..200, 0usize..400);
    runner()
        .run(&(small, header(), any::<usize>()), |((mut small, w, h, row, offset, length), wild, any_length)| {
            (small.width, small.height, small.row_bytes, small.depth_offset) = (w, h, row, offset);
            for (header, length) in [(small, length), (wild, any_length)] {
                let Ok(layout) = header.layout(length) else {
                    continue;
                };
                let rows = if header.pixel_format == PixelFormat::ByEncoding { 0 } else { header.height as usize };
                prop_assert!(layout.row_bytes * rows <= layout.pixels.end && layout.pixels.end <= length);
                let tight = header.width as usize * header.pixel_format.bytes_per_pixel() as usize;
                prop_assert!(layout.row_bytes >= tight);
                let depth = layout.depth.unwrap_or(length..length);
                let depth_bytes =
                    header.width as usize * header.height as usize * header.depth_format.bytes_per_pixel() as usize;
                prop_assert!(layout.pixels.end <= depth.start && depth.end == length && depth.len() == depth_bytes);
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn every_twist_comes_back_bit_for_bit() {
    runner()
        .run(&twist(), |message| {
            let bytes = message.encode();
            let read = TwistMessage::decode(&bytes).unwrap();
            prop_assert_eq!(read.encode(), bytes);
            let from_json = TwistMessage::from_json(message.to_json().as_bytes()).unwrap();
            for (got, sent) in from_json.twist.into_iter().zip(read.twist) {
                prop_assert_eq!(got.to_bits(), sent.to_bits());
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn any_bytes_are_a_safe_twist_or_an_error() {
    let lucky = vec(any::<u8>(), TWIST_BYTES - 2)
        .prop_flat_map(|tail| any::<u8>().prop_map(move |status| [&[1, status], tail.as_slice()].concat()));
    runner()
        .run(&prop_oneof![vec(any::<u8>(), 0..300), lucky], |bytes| {
            for message in [TwistMessage::decode(&bytes), TwistMessage::from_json(&bytes)].into_iter().flatten() {
                prop_assert!(message.twist.iter().all(|component| component.is_finite()));
                prop_assert!(message.is_servoing() || message.twist == [0.0; 6]);
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn any_bytes_are_read_without_panic() {
    let lucky = (vec(any::<u8>(), 47), 0u8..10, 0u8..3, 0u8..2)
        .prop_map(|(tail, pixel, depth, flags)| [&[1, pixel, depth, flags], &tail[3..]].concat());
    runner()
        .run(&prop_oneof![vec(any::<u8>(), 0..200), lucky], |bytes| {
            if let Ok(header) = FrameHeader::from_attachment(Some(&bytes)) {
                let _ = header.layout(bytes.len());
            }
            let _ = TaskSettings::from_create_body(&bytes);
            let _ = body::read::<Control>(&bytes);
            let _ = body::read::<CreateReply>(&bytes);
            let _ = body::read::<StatusMessage>(&bytes);
            let _ = body::read::<WorkerInfo>(&bytes);
            let _ = body::read::<TaskState>(&bytes);
            let _ = body::read::<ErrorReply>(&bytes);
            Ok(())
        })
        .unwrap();
}

#[test]
fn any_json_makes_valid_settings_or_an_error() {
    runner()
        .run(&json_like_settings(), |change| {
            let mut on_create = json!({ "camera": camera() });
            if let (Some(all), Some(some)) = (on_create.as_object_mut(), change.as_object()) {
                all.extend(some.clone());
            }
            let patched = TaskSettings::new(camera()).merge_patch(&change);
            for settings in [TaskSettings::from_json(&on_create), patched].into_iter().flatten() {
                prop_assert!(settings.validate().is_ok());
                prop_assert_eq!(&TaskSettings::from_json(&settings.to_value()).unwrap(), &settings);
                prop_assert!(settings.watchdog_ms() >= 20);
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn any_text_in_a_key_is_a_name_or_refused() {
    let keys = Keys::default();
    runner()
        .run(&(".*", "[A-Za-z0-9_-]{1,64}", any::<u32>()), |(text, good, epoch)| {
            if let Ok(name) = Name::try_from(text.as_str()) {
                prop_assert!(name.as_str().bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-'));
            }
            let _ =
                (keys.parse_task(&text), keys.parse_owner(&text), keys.parse_create(&text), text.parse::<TaskKey>());
            let name = Name::try_from(good.as_str()).unwrap();
            let task = TaskKey { client: name.clone(), id: name.clone() };
            prop_assert_eq!(keys.parse_owner(&keys.owner(&task, &name, epoch)), Some((task, name, epoch)));
            Ok(())
        })
        .unwrap();
}
