//! The exact bytes of wire version 1, both ways: `golden/v1` holds one file per message.
//!
//! Golden bytes of a released version never change. If a test here fails, the change is wrong.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::fmt::Debug;
use std::path::PathBuf;

use domvs_proto::body;
use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat, Secret};
use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::{
    CameraInfo, Control, ControlReply, CreateReply, ErrorCode, ErrorReply, FramesDropped, Phase, Progress, Quotas,
    StateMessage, StatusMessage, TargetReference, TaskClosed, TaskProgress, TaskState, WorkerCounts, WorkerInfo,
};
use domvs_proto::settings::{
    AdaptiveGain, Camera, Depth, DepthScale, Frames, Gain, Holes, Krawtchouk, KrawtchoukP, Lattice, Lease, Light,
    Limits, Mask, Method, NoiseFloor, OrderRange, Preprocess, Stop, TaskSettings, Window,
};
use domvs_proto::status::Status;
use domvs_proto::twist::{TwistFlags, TwistMessage};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

fn golden(name: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden/v1").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn golden_bytes(name: &str) -> Vec<u8> {
    golden(name).split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// Both ways: the file reads as `message`, and `message` writes what is in the file.
fn same_as_file<T: Serialize + DeserializeOwned + PartialEq + Debug>(name: &str, message: &T) {
    let file = golden(name);
    assert_eq!(&body::read::<T>(file.as_bytes()).unwrap(), message);
    let written: Value = serde_json::from_slice(&body::write(message)).unwrap();
    assert_eq!(written, serde_json::from_str::<Value>(&file).unwrap());
}

fn secret() -> Secret {
    Secret::new(std::array::from_fn(|i| 0x10 + i as u8))
}

fn task() -> TaskKey {
    "alice/t1".parse().unwrap()
}

fn name(text: &str) -> Name {
    Name::try_from(text).unwrap()
}

fn camera() -> Camera {
    Camera {
        fx: 600.5,
        fy: 601.5,
        cx: 319.5,
        cy: 239.5,
        width: 640,
        height: 480,
        distortion: Some([0.1, -0.2, 0.001, -0.001, 0.05]),
    }
}

/// The mask of the golden settings begins as every PNG does; its pixels are the service's business.
fn mask() -> Mask {
    let settings: Value = serde_json::from_str(&golden("settings.json")).unwrap();
    let mask: Mask = serde_json::from_value(settings["preprocess"]["mask"].clone()).unwrap();
    assert!(mask.png.starts_with(b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0\x02\x80\0\0\x01\xe0\x08\0"), "{mask:?}");
    mask
}

fn settings() -> TaskSettings {
    TaskSettings {
        method: Method::Krawtchouk,
        window: Window::Fixed { a: [6.0, 4.0], b: [5.0, 5.0] },
        krawtchouk: Krawtchouk { p: KrawtchoukP::Fixed([0.4, 0.6]), lattice: Lattice::Paper },
        gaussian_px: Some(16.0),
        order: OrderRange { min: 8, max: 8 },
        epsilon: 0.002,
        noise_floor: NoiseFloor::Subtract,
        light: Some(Light { gain_std: 0.25, offset_std: 0.125, gain_slope_std: 0.5, offset_slope_std: 0.0625 }),
        gain: Some(Gain::Adaptive(AdaptiveGain { at_zero: 4.0, at_infinity: 0.4, slope_at_zero: 30.0 })),
        frame_period_s: 0.04,
        step_cap: None,
        camera: camera(),
        depth: Depth::Map { fallback_m: Some(0.9), holes: Holes::Ignore },
        depth_scale: DepthScale::Given,
        preprocess: Preprocess { invert: true, mask: Some(mask()), ..Preprocess::default() },
        limits: Some(Limits {
            linear_m_per_s: 0.1,
            angular_rad_per_s: 0.3,
            linear_m_per_s2: 0.4,
            angular_rad_per_s2: 1.0,
        }),
        degrees_of_freedom: [true, true, true, false, false, true],
        stop: Stop { step_m: 0.001, step_rad: 0.002, pixel_mse: Some(0.0004), hold_frames: 3, max_iterations: 500 },
        frames: Frames::Key("domvs/camera/front/frame".to_owned()),
        frame_secret: true,
        ros2: None,
        watchdog_ms: Some(300),
        max_age_ms: 150,
        lease: Lease::None,
        idle_close_s: 60,
        autostart: true,
    }
}

fn twist() -> TwistMessage {
    TwistMessage {
        status: Status::Servoing,
        flags: TwistFlags { speed_limited: true, depth_estimated: true, step_capped: true, ..TwistFlags::default() },
        order: 12,
        features: 91,
        sequence: 4711,
        capture_time_ns: 1_700_000_000_123_456_789,
        epoch: 65_578,
        queue_us: 120,
        compute_us: 2345,
        valid_ms: 200,
        twist: [0.03125, -0.0625, 0.125, -0.25, 0.5, -1.0],
        pixel_mse: 0.0609571,
        feature_error_norm: 15.75,
        condition_number: 212.5,
        gain: 7.5,
    }
}

fn twist_zero() -> TwistMessage {
    TwistMessage {
        sequence: 4712,
        epoch: 65_578,
        queue_us: 80,
        compute_us: 310,
        ..TwistMessage::zero(Status::LowTexture)
    }
}

#[test]
fn frame_header_is_48_bytes_as_printed() {
    let header = FrameHeader {
        depth_format: DepthFormat::U16,
        row_bytes: 704,
        depth_offset: 337_920,
        depth_unit_m: 0.001,
        sequence: 4711,
        capture_time_ns: 1_700_000_000_123_456_789,
        deadline_us: 50_000,
        ..FrameHeader::new(PixelFormat::Mono8, 640, 480)
    };
    let bytes = golden_bytes("frame_header.hex");
    assert_eq!(bytes.len(), 48);
    assert_eq!(header.encode(), bytes);
    assert_eq!(FrameHeader::decode(&bytes).unwrap(), header);
}

#[test]
fn frame_header_with_secret_is_64_bytes_as_printed() {
    let header =
        FrameHeader { sequence: u64::MAX, secret: Some(secret()), ..FrameHeader::new(PixelFormat::Nv12, 1280, 720) };
    let bytes = golden_bytes("frame_header_secret.hex");
    assert_eq!(bytes.len(), 64);
    assert_eq!(header.encode(), bytes);
    assert_eq!(FrameHeader::decode(&bytes).unwrap(), header);
}

#[test]
fn twist_is_128_bytes_as_printed() {
    let bytes = golden_bytes("twist.hex");
    assert_eq!(twist().encode().as_slice(), bytes);
    assert_eq!(TwistMessage::decode(&bytes).unwrap(), twist());
}

#[test]
fn zero_twist_has_nan_for_what_does_not_apply() {
    let bytes = golden_bytes("twist_zero.hex");
    assert_eq!(twist_zero().encode().as_slice(), bytes);
    let read = TwistMessage::decode(&bytes).unwrap();
    assert_eq!(read.encode().as_slice(), bytes);
    assert!(read.pixel_mse.is_nan() && read.gain.is_nan());
}

#[test]
fn twist_as_json_has_the_same_fields() {
    for (file, message) in [("twist.json", twist()), ("twist_zero.json", twist_zero())] {
        let file = golden(file);
        let written: Value = serde_json::from_str(&message.to_json()).unwrap();
        assert_eq!(written, serde_json::from_str::<Value>(&file).unwrap());
        assert_eq!(TwistMessage::from_json(file.as_bytes()).unwrap().encode(), message.encode());
    }
}

#[test]
fn settings_are_as_printed() {
    same_as_file("settings.json", &settings());
    assert_eq!(TaskSettings::from_create_body(golden("settings.json").as_bytes()).unwrap(), settings());
}

#[test]
fn create_needs_nothing_but_a_camera() {
    let created = TaskSettings::from_create_body(golden("create.json").as_bytes()).unwrap();
    assert_eq!(created, TaskSettings::new(Camera { distortion: None, ..camera() }));
}

#[test]
fn create_reply_is_as_printed() {
    let frame_secret = Some(secret().for_frames());
    let created = CreateReply { task: task(), epoch: 65_578, secret: secret(), frame_secret };
    same_as_file("create_reply.json", &created);
}

#[test]
fn control_is_as_printed() {
    same_as_file("control.json", &Control::Start);
    same_as_file("control_reply.json", &ControlReply { status: Status::Ready });
}

#[test]
fn status_message_is_as_printed() {
    let message = StatusMessage {
        detail: Some("the target has 640x480 pixels, the frame 320x240".to_owned()),
        frames_in: 120,
        frames_dropped: FramesDropped { superseded: 3, bad: 1, stale: 2, ..FramesDropped::default() },
        twists: 114,
        sequence: 4713,
        order: 12,
        pixel_mse: Some(0.0609571),
        feature_error_norm: Some(15.75),
        light: Some([-0.25, 0.0625, 0.125, 0.0, 0.03125, 0.0]),
        depth_scale: Some(1.5),
        compute_us: 2345,
        uptime_s: 9.5,
        ..StatusMessage::new(task(), Status::BadFrame, 65_578)
    };
    same_as_file("status.json", &message);
}

#[test]
fn worker_info_is_as_printed() {
    let info = WorkerInfo {
        version: "0.1.0".to_owned(),
        tasks: 2,
        capacity: 64,
        standby: 3,
        load: 0.25,
        threads: 2,
        max_pixels: 16_777_216,
        max_payload_bytes: 134_217_728,
        quotas: Quotas {
            tasks_per_client: 16,
            pixels_per_client: 33_554_432,
            pixels: 134_217_728,
            bytes_per_client: 268_435_456,
            bytes: 1_073_741_824,
            waiting_per_client: 128,
            waiting: 1024,
            frames_per_s_per_client: 2000,
            requests_per_s_per_client: 500,
            pixels_used: 614_400,
            bytes_used: 921_600,
        },
        unanswered: 3,
        uptime_s: 3600.5,
        clients: 3,
        memory_bytes: 104_857_600,
        recorder_dropped: 1,
        counts: WorkerCounts {
            frames_in: 1200,
            twists: 1100,
            zeros: 90,
            frames_dropped: FramesDropped { superseded: 8, bad: 5, stale: 4, overloaded: 3, deadline: 2, not_owner: 1 },
            requests: 1300,
            refusals: 6,
            watchdog_brakes: 7,
            clients_lost: 1,
            panics: 0,
        },
        ..WorkerInfo::new(name("w1"))
    };
    same_as_file("worker_info.json", &info);
}

#[test]
fn camera_info_is_as_printed() {
    let camera = Camera { distortion: None, ..camera() };
    same_as_file("camera_info.json", &CameraInfo { name: name("front"), camera, frame_period_s: 0.0625, depth: true });
}

#[test]
fn task_state_is_as_printed() {
    let target = TargetReference {
        hash: "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08".to_owned(),
        width: 640,
        height: 480,
        payload_bytes: 921_600,
    };
    let state = TaskState {
        task: task(),
        worker: name("w1"),
        epoch: 65_578,
        revision: 7,
        secret_hash: secret().hash(),
        frame_secret_hash: secret().for_frames().hash(),
        settings: settings(),
        target: Some(target),
        progress: progress(Status::Servoing, Phase::Running),
    };
    same_as_file("task_state.json", &state);
    let read = StateMessage::read(golden("task_state.json").as_bytes()).unwrap();
    assert_eq!(read, StateMessage::Full(Box::new(state)));
}

#[test]
fn task_progress_and_the_end_are_as_printed() {
    let progress = progress(Status::Converged, Phase::Latched(Status::Converged));
    let progress = TaskProgress { task: task(), worker: name("w1"), epoch: 65_578, revision: 7, progress };
    same_as_file("task_progress.json", &progress);
    let read = StateMessage::read(golden("task_progress.json").as_bytes()).unwrap();
    assert_eq!(read, StateMessage::Progress(progress));
    let closed = TaskClosed { task: task(), worker: name("w1"), epoch: 65_578, closed: true };
    same_as_file("task_closed.json", &closed);
    let read = StateMessage::read(golden("task_closed.json").as_bytes()).unwrap();
    assert_eq!(read, StateMessage::Closed(closed));
}

#[test]
fn the_hash_of_a_secret_knows_its_secret_and_no_other() {
    let hash = secret().hash();
    assert!(hash.is_of(&secret()) && !hash.is_of(&Secret::new([0; 16])));
    // SHA3-256 of 16 zeros, as hashlib says it.
    let zeros: String = Secret::new([0; 16]).hash().into();
    assert_eq!(zeros, "61664696888a110278ff672620c85217e69aa662a83304052f1014d395f545bf");
}

fn progress(status: Status, phase: Phase) -> Progress {
    Progress {
        status,
        phase,
        twists: 114,
        held_frames: 0,
        sequence: 4713,
        initial_pixel_mse: Some(0.0625),
        initial_order_mse: Some(0.03125),
        frames_in: 120,
        frames_dropped: FramesDropped { superseded: 3, bad: 1, stale: 2, overloaded: 0, deadline: 0, not_owner: 0 },
    }
}

#[test]
fn error_reply_is_as_printed() {
    let error = "order.max must be at most min(width, height) - 3 = 5 for 640x8 pixels, got 16";
    same_as_file("error_reply.json", &ErrorReply::new(ErrorCode::BadSettings, error));
    let refused = TaskSettings::new(Camera { height: 8, ..camera() }).validate().unwrap_err();
    assert_eq!(ErrorReply::from(&refused).error, error);
}
