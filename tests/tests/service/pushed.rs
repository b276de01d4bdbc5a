//! The main job by pushed frames: a camera that runs at its own rate, commands that come back, and what happens when the
//! camera, its clock or its link fails.

use std::time::{Duration, Instant};

use domvs_client::ImageFile;
use domvs_proto::settings::{Depth, Frames, Gain, Lease, Limits};
use domvs_server::{ServerConfig, Service};
use domvs_simulators::DepthPacking;
use domvs_simulators::node::CameraNode;

use crate::support::{
    Following, OutgoingFrame, Question, Scene, Stage, Status, TaskSettings, ZEROS, in_time, jpeg, name, next_status,
    push, started,
};

/// What is asked for beyond the watchdog. How often the clock looks is held by the safety page's numbers; the true figure is for a bench.
const PROMISED: Duration = Duration::from_millis(50);
/// What a machine of two cores with other work on them may add.
const NOISE: Duration = Duration::from_millis(500);

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_on_its_own_key_is_brought_there_by_its_commands() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::new("coffee", [96, 72], [0.02, -0.02, -0.03, -1.0, -1.0, -3.0]);
    scene.camera.depth = DepthPacking::U16;
    let native = stage.keys.camera_frame(&scene.camera.name);
    let settings = TaskSettings {
        frames: Frames::Key(native.clone()),
        frame_period_s: 1.0 / 30.0,
        // 30 frames a second and a delay of two: gain times delay is 0.2.
        gain: Some(Gain::PerS(3.0)),
        limits: Some(Limits::default()),
        watchdog_ms: Some(1000),
        ..scene.settings()
    };
    let task = started(&client, &settings, &scene.target()).await;
    let mut statuses = task.statuses().await.expect("followed");
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;

    let camera = scene.following(task.key(), native, 30.0);
    let node = CameraNode::open(stage.config(), stage.keys.clone(), camera).await.expect("it flies");
    let (_, first) = following.until("a first motion", |message| message.is_servoing()).await;
    let speed = first.twist[..3].iter().map(|component| component * component).sum::<f64>().sqrt();
    // 0.5 m/s² over at most one period, from rest.
    assert!(speed <= 0.5 / 30.0 + 1e-9, "the first command is {speed} m/s");
    next_status(&mut statuses, "converged", |message| message.status == Status::Converged).await;
    let error = node.truth().borrow().error;
    assert!(error.mm < 1.0 && error.deg < 0.1, "{error:?}");
    let (_, standing) = following.until("converged on command", |message| !message.is_servoing()).await;
    assert_eq!(standing.status, Status::Converged);
    node.stop().await.expect("it lands");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn zeros_follow_the_death_of_the_camera_within_the_watchdog_time() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let watchdog = Duration::from_millis(300);
    // So slow that the camera is still on its way when it dies.
    let settings = TaskSettings {
        gain: Some(Gain::PerS(0.2)),
        watchdog_ms: Some(300),
        frames: Frames::Pushed,
        ..scene.settings()
    };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let camera = scene.following(task.key(), stage.keys.frame(task.key()), 15.0);
    let node = CameraNode::open(stage.config(), stage.keys.clone(), camera).await.expect("it flies");
    for _ in 0..5 {
        following.until("motion", |message| message.is_servoing()).await;
    }

    let killed = Instant::now();
    node.stop().await.expect("its session closes");
    let (at, zeros) = following.until("the watchdog's zeros", |message| message.status == Status::WaitingFrame).await;
    assert_eq!(zeros.twist, ZEROS);
    let took = at.saturating_duration_since(killed);
    assert!(took <= watchdog + PROMISED + NOISE, "{took:?} after the end of the camera");
    for _ in 0..5 {
        let (_, repeated) = following.next().await;
        assert_eq!((repeated.status, repeated.twist), (Status::WaitingFrame, ZEROS), "repeated at 10 Hz");
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_that_was_taken_over_stands_until_its_client_is_heard_of() {
    let stage = Stage::open().await;
    let session = stage.stranger().await;
    let second = ServerConfig { worker: "w2".into(), ..ServerConfig::default() };
    let second = Service::start(second, session).await.expect("it starts");
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    // A process whose token nobody has: an owner gives it two seconds, as the task is new.
    let lease = Lease::Process(name("ghost"));
    let settings = TaskSettings { frames: Frames::Pushed, gain: Some(Gain::PerS(0.2)), lease, ..scene.settings() };
    let task = client.create_task_on(&name("w1"), &settings).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let info = Question::on(stage.keys.worker_info(&name("w2")));
    in_time("the standby knows the task", async {
        while info.ask(client.session()).await.json()["standby"] != 1 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    let old = task.epoch();

    stage.session.close().await.expect("it closes");
    let mut sequence = 0;
    let last = in_time("the new owner gives the client up", async {
        loop {
            sequence += 1;
            task.push(&scene.frame(sequence)).await.expect("open");
            let (_, message) = following.next().await;
            if message.epoch > old {
                assert_eq!(message.twist, ZEROS, "{message:?}");
                if message.status.is_latched() {
                    return message;
                }
            }
        }
    })
    .await;
    assert_eq!(last.status, Status::ClientLost);
    assert!(sequence > 5, "frames came all the time: {sequence}");
    second.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_that_fall_behind_their_time_are_stale_until_they_catch_up() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut statuses = task.statuses().await.expect("followed");
    // Noise, so that no two pictures are the same: the camera lives, its clock is what is judged.
    scene.simulation.disturbance.noise_std = 0.01;

    // The camera's clock: any origin, here the start of the test, plus an hour.
    let clock = Instant::now();
    let now_ns = || 3_600_000_000_000 + clock.elapsed().as_nanos() as u64;
    let mut sequence = 0;
    let mut next = |captured_ns: u64| {
        sequence += 1;
        scene.frame(sequence).numbered(sequence, captured_ns)
    };
    assert!(push(&task, &following, &next(now_ns())).await.is_servoing());

    // From here on the frames that arrive were all taken at this moment, a microsecond apart, as from a link that holds them back.
    let held_back_since = now_ns();
    let stale = in_time("a stale frame", async {
        for late in 1.. {
            let answer = push(&task, &following, &next(held_back_since + 1000 * late)).await;
            if answer.status != Status::Servoing {
                return answer;
            }
        }
        unreachable!("there are more frames than time")
    })
    .await;
    assert_eq!((stale.status, stale.twist), (Status::StaleFrame, ZEROS));
    // `max_age_ms` is 200: nothing younger was refused.
    let age_ms = (now_ns() - held_back_since) / 1_000_000;
    assert!(age_ms >= 200, "refused when {age_ms} ms old");
    let said = next_status(&mut statuses, "stale_frame", |message| message.status == Status::StaleFrame).await;
    assert!(!said.latched && said.frames_dropped.stale > 0, "{said:?}");

    let recovered = in_time("fresh frames move again", async {
        loop {
            let answer = push(&task, &following, &next(now_ns())).await;
            if answer.is_servoing() {
                return answer;
            }
        }
    })
    .await;
    assert_ne!(recovered.twist, ZEROS);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frozen_picture_under_motion_stops_the_camera_until_it_changes() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, gain: Some(Gain::PerS(5.0)), ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let picture = scene.frame(0);
    let mut identical = 0;
    let frozen = in_time("a frozen frame", async {
        loop {
            identical += 1;
            let answer = push(&task, &following, &picture.clone().numbered(identical, 0)).await;
            if !answer.is_servoing() {
                return answer;
            }
            assert_ne!(answer.twist, ZEROS);
        }
    })
    .await;
    assert_eq!((frozen.status, frozen.twist), (Status::FrozenFrame, ZEROS));
    assert!(identical >= 5, "five identical pictures at least, got {identical}");
    let still = push(&task, &following, &picture.clone().numbered(identical + 1, 0)).await;
    assert_eq!(still.status, Status::FrozenFrame, "a camera that stands is no proof that the picture lives");

    scene.simulation.apply([0.01, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0);
    assert!(push(&task, &following, &scene.frame(identical + 2)).await.is_servoing(), "another picture");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_stands_may_send_the_same_picture_for_ever() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let task = client.create_task(&settings).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let picture = scene.frame(0);
    for sequence in 1..=10 {
        let answer = push(&task, &following, &picture.clone().numbered(sequence, 0)).await;
        assert_eq!((answer.status, answer.twist), (Status::Ready, ZEROS), "nothing moves before start");
    }
    task.start().await.expect("started");
    assert!(push(&task, &following, &picture.clone().numbered(11, 0)).await.is_servoing());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_can_only_put_a_jpeg_is_servoed() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, depth: Depth::ConstantM(1.0), ..scene.settings() };
    let target = OutgoingFrame::file(ImageFile::Jpeg, jpeg(&scene.simulation.capture_desired()));
    let task = started(&client, &settings, &target.expect("not empty")).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let session = stage.stranger().await;
    let bytes = jpeg(&scene.simulation.capture());
    let moving = in_time("a twist for a bare JPEG", async {
        loop {
            let put = session.put(stage.keys.frame(task.key()), bytes.clone()).encoding("image/jpeg");
            put.await.expect("the session is open");
            let heard = following.until("a twist", |message| message.is_servoing());
            if let Ok((_, message)) = tokio::time::timeout(Duration::from_millis(500), heard).await {
                return message;
            }
        }
    })
    .await;
    assert_eq!((moving.sequence, moving.capture_time_ns), (0, 0));
    assert_ne!(moving.twist, ZEROS);
    stage.close().await;
}
