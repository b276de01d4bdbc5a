//! The simulated camera on a real network: two Zenoh sessions over loopback TCP on a port of the system's choice.

use std::net::TcpListener;
use std::time::Duration;

use domvs_proto::body;
use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat};
use domvs_proto::keys::{Keys, Name, TaskKey};
use domvs_proto::messages::CameraInfo;
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use domvs_simulators::node::{CameraNode, Truth};
use domvs_simulators::{
    BrakeReason, CameraSettings, DepthPacking, Disturbance, Follow, Motion, Photograph, PixelPacking, mono8,
};
use zenoh::handlers::RingChannel;
use zenoh::{Config, Session};

/// Longer than anything here takes on a busy machine; nothing waits for it when all is well.
const LIMIT: Duration = Duration::from_secs(20);
const RIGHT: [f64; 6] = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];

fn name(text: &str) -> Name {
    text.try_into().expect("letters")
}

fn task(id: &str) -> TaskKey {
    TaskKey { client: name("alice"), id: name(id) }
}

fn keys() -> Keys {
    Keys::new("domvs").expect("a fine prefix")
}

fn config(entries: &[(&str, String)]) -> Config {
    let mut config = Config::default();
    let quiet = [("scouting/multicast/enabled", "false".into()), ("scouting/gossip/enabled", "false".into())];
    for (key, value) in quiet.iter().chain(entries) {
        config.insert_json5(key, value).expect("a known key");
    }
    config
}

/// A session that listens, and the configuration of one that calls it.
async fn listener() -> (Session, Config) {
    let port = TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("loopback").port();
    let endpoint = format!(r#"["tcp/127.0.0.1:{port}"]"#);
    let session = zenoh::open(config(&[("listen/endpoints", endpoint.clone())])).await.expect("the port is free");
    let caller = config(&[("connect/endpoints", endpoint), ("listen/endpoints", "[]".into())]);
    (session, caller)
}

/// A small, fast camera.
fn settings() -> CameraSettings {
    CameraSettings {
        rate_hz: 50.0,
        width: 40,
        height: 30,
        follow: Follow::Task(task("t1")),
        ..CameraSettings::new(name("cam"), Photograph::noise(64, 1))
    }
}

fn servoing(twist: [f64; 6], epoch: u32) -> TwistMessage {
    TwistMessage { twist, epoch, valid_ms: 300, ..TwistMessage::zero(Status::Servoing) }
}

async fn limited<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, future).await.expect("in time")
}

/// Waits until the truth is as asked for.
async fn truth_when(node: &CameraNode, condition: impl Fn(&Truth) -> bool) -> Truth {
    let mut truth = node.truth();
    limited(truth.wait_for(condition)).await.expect("the camera flies").clone()
}

/// Sends `bytes` again and again until the truth is as asked for: subscriptions take their time to spread.
async fn send_until(
    session: &Session,
    key: String,
    bytes: &[u8],
    node: &CameraNode,
    condition: impl Fn(&Truth) -> bool + Copy,
) -> Truth {
    limited(async {
        loop {
            session.put(&key, bytes).await.expect("open");
            let mut truth = node.truth();
            let wait = truth.wait_for(condition);
            if let Ok(found) = tokio::time::timeout(Duration::from_millis(20), wait).await {
                return found.expect("the camera flies").clone();
            }
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_hold_what_the_camera_sees() {
    let (session, caller) = listener().await;
    for (camera, pixels, depth) in [
        ("a", PixelPacking::Mono8, DepthPacking::F32),
        ("b", PixelPacking::Mono32f, DepthPacking::U16),
        ("c", PixelPacking::Mono8, DepthPacking::None),
    ] {
        let frames = session.declare_subscriber(keys().camera_frame(&name(camera))).with(RingChannel::new(1)).await;
        let frames = frames.expect("open");
        let settings = CameraSettings { name: name(camera), pixels, depth, ..settings() };
        let expected = settings.simulation().expect("possible").capture();
        let node = CameraNode::open(caller.clone(), keys(), settings).await.expect("flies");
        let sample = limited(frames.recv_async()).await.expect("a frame");
        node.stop().await.expect("lands");
        let attachment = sample.attachment().expect("a header").to_bytes();
        let header = FrameHeader::decode(&attachment).expect("version 1");
        let payload = sample.payload().to_bytes();
        let layout = header.layout(payload.len()).expect("lengths agree");
        assert_eq!(attachment.len(), 48);
        assert_eq!((header.width, header.height), (40, 30));
        assert!(header.sequence > 0 && header.capture_time_ns > 0);
        let floats = |bytes: &[u8]| -> Vec<f32> {
            bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().expect("four"))).collect()
        };
        match header.pixel_format {
            PixelFormat::Mono8 => assert_eq!(payload[layout.pixels], mono8(&expected.image)),
            _ => assert_eq!(floats(&payload[layout.pixels]), expected.image.samples()),
        }
        match header.depth_format {
            DepthFormat::None => assert_eq!(layout.depth, None),
            DepthFormat::F32 => assert_eq!(floats(&payload[layout.depth.expect("depth")]), expected.depth.samples()),
            DepthFormat::U16 => {
                let counts = payload[layout.depth.expect("depth")].chunks_exact(2);
                let metres = counts.map(|two| f32::from(u16::from_le_bytes([two[0], two[1]])) * header.depth_unit_m);
                // Half a millimetre of rounding.
                assert!(metres.zip(expected.depth.samples()).all(|(got, z)| (got - z).abs() < 0.000_51));
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn it_says_what_it_is_and_that_it_lives() {
    let (session, caller) = listener().await;
    let info = session.declare_subscriber(keys().camera_info(&name("cam"))).await.expect("open");
    let alive = session.liveliness().declare_subscriber(keys().cameras_alive()).await.expect("open");
    let settings = settings();
    let expected = settings.info().expect("possible");
    let node = CameraNode::open(caller, keys(), settings).await.expect("flies");
    let sample = limited(info.recv_async()).await.expect("info");
    let got: CameraInfo = body::read(&sample.payload().to_bytes()).expect("JSON");
    assert_eq!(got, expected);
    let token = limited(alive.recv_async()).await.expect("a token");
    assert_eq!(keys().parse_camera_alive(token.key_expr().as_str()), Some(name("cam")));
    node.stop().await.expect("lands");
    let gone = limited(alive.recv_async()).await.expect("the token goes");
    assert_eq!(gone.kind(), zenoh::sample::SampleKind::Delete);
}

#[tokio::test(flavor = "multi_thread")]
async fn it_moves_on_command_and_brakes_on_silence() {
    let (session, caller) = listener().await;
    let node = CameraNode::open(caller, keys(), settings()).await.expect("flies");
    let start = node.truth().borrow().pose;
    let command = keys().command(&task("t1"));
    send_until(&session, command, &servoing(RIGHT, 1).encode(), &node, |truth| truth.motion == Motion::Moving).await;
    let silent = Motion::Braked(BrakeReason::Silence);
    let end = truth_when(&node, |truth| truth.motion == silent).await;
    let moved = (start.inverse() * end.pose).translation.vector;
    // 0.1 m/s along its own x for 300 ms of the last command, longer when several had to be sent.
    assert!(moved.x > 0.03 - 1e-9, "moved {moved}");
    assert!(moved.y.abs().max(moved.z.abs()) < 1e-12, "moved {moved}");
    assert_eq!(end.twist, [0.0; 6]);
    node.stop().await.expect("lands");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_does_not_hear_another_task() {
    let (session, caller) = listener().await;
    let node = CameraNode::open(caller, keys(), settings()).await.expect("flies");
    session.put(keys().command(&task("t2")), servoing(RIGHT, 9).encode().as_slice()).await.expect("open");
    let zeros = TwistMessage { epoch: 1, ..TwistMessage::zero(Status::Ready) }.encode();
    let told = |truth: &Truth| truth.commands > 0;
    let truth = send_until(&session, keys().command(&task("t1")), &zeros, &node, told).await;
    assert_eq!(truth.motion, Motion::Braked(BrakeReason::Status(Status::Ready)));
    node.stop().await.expect("lands");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_may_move_it_by_one_task_after_the_other() {
    let (session, caller) = listener().await;
    let settings = CameraSettings { follow: Follow::Client(name("alice")), ..settings() };
    let node = CameraNode::open(caller, keys(), settings).await.expect("flies");
    for (id, twist, epoch) in [("t1", RIGHT, 9), ("t2", [0.0, 0.2, 0.0, 0.0, 0.0, 0.0], 1)] {
        let bytes = servoing(twist, epoch).encode();
        let obeys = move |truth: &Truth| truth.twist == twist;
        send_until(&session, keys().command(&task(id)), &bytes, &node, obeys).await;
    }
    node.stop().await.expect("lands");
}

#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_no_twist_brake_it() {
    let (session, caller) = listener().await;
    let node = CameraNode::open(caller, keys(), settings()).await.expect("flies");
    let command = keys().command(&task("t1"));
    let mut wrong_version = servoing(RIGHT, 1).encode();
    wrong_version[0] = 9;
    for bytes in [&b"no twist"[..], &wrong_version] {
        let moving = |truth: &Truth| truth.motion == Motion::Moving;
        send_until(&session, command.clone(), &servoing(RIGHT, 1).encode(), &node, moving).await;
        let untrusted = |truth: &Truth| truth.motion == Motion::Braked(BrakeReason::Untrusted);
        send_until(&session, command.clone(), bytes, &node, untrusted).await;
    }
    node.stop().await.expect("lands");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_of_everything_stops_it() {
    let (session, caller) = listener().await;
    let node = CameraNode::open(caller, keys(), settings()).await.expect("flies");
    let stopped = |truth: &Truth| truth.motion == Motion::Braked(BrakeReason::StopAll);
    send_until(&session, keys().stop(), b"", &node, stopped).await;
    let command = keys().command(&task("t1"));
    let refused = |truth: &Truth| truth.refused > 0;
    let truth = send_until(&session, command, &servoing(RIGHT, 1).encode(), &node, refused).await;
    assert!(stopped(&truth), "{truth:?}");
    node.stop().await.expect("lands");
}

#[tokio::test(flavor = "multi_thread")]
async fn latency_delays_frames_and_keeps_their_capture_time() {
    let (session, caller) = listener().await;
    let latency = Duration::from_millis(150);
    let settings = CameraSettings { disturbance: Disturbance { latency, ..Disturbance::default() }, ..settings() };
    let frames = session.declare_subscriber(keys().camera_frame(&name("cam"))).await.expect("open");
    let node = CameraNode::open(caller, keys(), settings).await.expect("flies");
    let sample = limited(frames.recv_async()).await.expect("a frame");
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).expect("after 1970");
    let header = FrameHeader::decode(&sample.attachment().expect("a header").to_bytes()).expect("version 1");
    // Both clocks are this machine's; the latency is a lower bound, whatever else was slow.
    assert!(now - Duration::from_nanos(header.capture_time_ns) >= latency);
    node.stop().await.expect("lands");
}

#[tokio::test(flavor = "multi_thread")]
async fn impossible_settings_are_refused() {
    for settings in [
        CameraSettings { rate_hz: 0.0, ..settings() },
        CameraSettings { rate_hz: f64::NAN, ..settings() },
        CameraSettings { width: 0, ..settings() },
        CameraSettings {
            disturbance: Disturbance { latency: Duration::from_secs(2), ..Disturbance::default() },
            ..settings()
        },
        CameraSettings { horizontal_fov_rad: 4.0, ..settings() },
        CameraSettings { displacement: [f64::NAN; 6], ..settings() },
    ] {
        assert!(CameraNode::open(config(&[]), keys(), settings).await.is_err());
    }
}
