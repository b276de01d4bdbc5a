//! The main job by requests: look, ask, move, look again, until the camera is there.

use domvs_proto::frame::FrameHeader;
use domvs_proto::settings::{Limits, OrderRange};
use serde_json::{Value, json};

use crate::support::{Question, Scene, Stage, Status, TaskSettings, ZEROS, next_status, started};

/// Images until a displacement of 12 cm and 11 degrees is undone: half of it goes with each.
const IMAGES: usize = 60;

#[tokio::test(flavor = "multi_thread")]
async fn asking_for_every_twist_brings_the_camera_there() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::new("coffee", [128, 128], [0.08, -0.05, -0.08, -2.0, -5.0, -10.0]);
    let settings = scene.settings();

    let task = client.create_task(&settings).await.expect("created");
    let early = task.twist(&scene.frame(1)).await.expect("answered");
    assert_eq!((early.status, early.twist, early.sequence), (Status::WaitingTarget, ZEROS, 1));
    assert_eq!(task.set_target(&scene.target()).await.expect("set"), Status::Ready);
    let ready = task.twist(&scene.frame(2)).await.expect("answered");
    assert_eq!((ready.status, ready.twist), (Status::Ready, ZEROS));

    task.start().await.expect("started");
    let mut statuses = task.statuses().await.expect("followed");
    let mut last = ready;
    for sequence in 3..3 + IMAGES as u64 {
        last = task.twist(&scene.frame(sequence)).await.expect("answered");
        assert_eq!((last.sequence, last.epoch), (sequence, task.epoch()));
        if !last.is_servoing() {
            break;
        }
        assert_ne!(last.twist, ZEROS);
        scene.simulation.apply(last.twist, settings.frame_period_s);
    }
    assert_eq!((last.status, last.twist), (Status::Converged, ZEROS));
    let error = scene.simulation.error();
    // Issue 2 asks for 1 mm and 0.1 degrees; the stop rule holds 0.5 mm and 0.03 degrees of remaining step.
    assert!(error.mm < 1.0 && error.deg < 0.1, "{error:?}");
    let status = next_status(&mut statuses, "converged on status", |message| message.status == Status::Converged).await;
    assert!(status.latched && status.twists >= 5, "{status:?}");

    scene.simulation.apply([0.0, 0.0, -0.05, 0.0, 0.0, 0.0], 1.0);
    let latched = task.twist(&scene.frame(1000)).await.expect("answered");
    assert_eq!((latched.status, latched.twist), (Status::Converged, ZEROS), "converged stays until start");
    assert_eq!(task.start().await.expect("started"), Status::WaitingFrame);
    assert!(task.twist(&scene.frame(1001)).await.expect("answered").is_servoing());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_answer_as_json_has_the_fields_of_the_bytes() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("camera");
    // A fixed order: the twist then depends on the frame alone, not on the frames before it.
    let settings = TaskSettings { order: OrderRange { min: 8, max: 8 }, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let frame = scene.frame(7);
    task.twist(&frame).await.expect("the target's share is in the cache now");
    let bytes = task.twist(&frame).await.expect("answered");

    let secret = task.secret().cloned();
    let header = FrameHeader { secret, ..frame.header().clone() };
    let question =
        |selector: String| Question::on(selector).with(frame.payload().to_bytes()).encoded("application/octet-stream");
    let twist = stage.keys.twist(task.key());
    let answer = question(format!("{twist}?format=json")).attached(header.encode()).ask(client.session()).await.json();
    let again = question(twist).attached(header.encode()).ask(client.session()).await.twist();

    assert_eq!(again.twist, bytes.twist, "the same frame, the same twist");
    let numbers = |field: &str| answer[field].as_f64().unwrap_or_else(|| panic!("{field} in {answer}"));
    let got: Vec<f64> = answer["twist"].as_array().expect("six").iter().filter_map(Value::as_f64).collect();
    assert_eq!(got, bytes.twist);
    assert_eq!(answer["status"], "servoing");
    assert_eq!(answer["version"], 1);
    assert_eq!(answer["flags"], json!(bytes.flags.words()));
    for (field, expected) in [
        ("order", f64::from(bytes.order)),
        ("features", f64::from(bytes.features)),
        ("sequence", 7.0),
        ("capture_time_ns", 0.0),
        ("epoch", f64::from(bytes.epoch)),
        ("valid_ms", f64::from(bytes.valid_ms)),
        ("pixel_mse", bytes.pixel_mse),
        ("feature_error_norm", bytes.feature_error_norm),
        ("condition_number", bytes.condition_number),
        ("gain", bytes.gain),
    ] {
        assert_eq!(numbers(field), expected, "{field}");
    }
    for measured in ["queue_us", "compute_us"] {
        assert!(answer[measured].is_u64(), "{measured}");
    }
    let fields = answer.as_object().expect("an object").len();
    assert_eq!(fields, 16, "version, status, flags, twist, the ten above and the two measured: {answer}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_that_cannot_be_kept_is_answered_with_zeros() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("camera");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let frame = scene.frame(5);
    // One microsecond: no frame is decoded in it.
    let (secret, deadline_us) = (task.secret().cloned(), 1);
    let header = FrameHeader { secret, deadline_us, ..frame.header().clone() };
    let question =
        Question::on(stage.keys.twist(task.key())).with(frame.payload().to_bytes()).attached(header.encode());
    let late = question.ask(client.session()).await.twist();
    assert_eq!((late.status, late.twist, late.sequence), (Status::DeadlineMissed, ZEROS, 5));
    assert!(task.twist(&scene.frame(6)).await.expect("answered").is_servoing(), "it clears at the next good frame");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_default_limits_bound_the_speed_and_keep_the_direction() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::new("coffee", [96, 72], [0.2, -0.1, -0.2, -5.0, -5.0, -20.0]);
    let free = scene.settings();
    let bound = TaskSettings { limits: Some(Limits::default()), ..free.clone() };
    let (target, frame) = (scene.target(), scene.frame(1));
    let free = started(&client, &free, &target).await.twist(&frame).await.expect("answered");
    let bound = started(&client, &bound, &target).await.twist(&frame).await.expect("answered");
    let norm = |part: &[f64]| part.iter().map(|component| component * component).sum::<f64>().sqrt();
    let (linear, angular) = (norm(&bound.twist[..3]), norm(&bound.twist[3..]));
    // Rounding of a scale and a norm in f64.
    assert!(linear <= 0.2 + 1e-12 && angular <= 0.7 + 1e-12, "{linear} m/s, {angular} rad/s");
    assert!(bound.flags.speed_limited && !free.flags.speed_limited);
    let scale = norm(&bound.twist) / norm(&free.twist);
    assert!(scale < 1.0);
    for (bound, free) in bound.twist.iter().zip(free.twist) {
        assert!((bound - scale * free).abs() < 1e-12, "one scale for all six");
    }
    stage.close().await;
}
