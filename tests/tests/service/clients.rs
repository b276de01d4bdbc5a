//! Many clients on one worker: each gets its own task's twists, and nothing of anybody else's.

use std::sync::Arc;

use domvs_proto::frame::FrameHeader;
use domvs_proto::settings::{Gain, OrderRange};
use domvs_server::ServerConfig;
use domvs_server::config::{Lease, Limits};
use domvs_simulators::Rendering;
use domvs_vision::{Depth, Intrinsics, Law, OrderRule, Plane, Servo, View};

use crate::support::{
    ErrorCode, Following, OutgoingFrame, Question, Scene, Stage, Status, TaskKey, TaskSettings, ZEROS, becomes_unknown,
    code, gray8, in_time, next_status, push, refusal, started,
};

const PHOTOGRAPHS: [&str; 4] = ["astronaut", "coffee", "chelsea", "camera"];
/// Of the law below and of the settings, 1/s.
const GAIN_PER_S: f64 = 2.0;
const ORDER: u16 = 8;

/// What the law alone says, on the planes that the service should have made of the bytes.
struct Judge {
    servo: Servo<f32>,
    depth: Depth<f32>,
}

impl Judge {
    fn new(scene: &Scene, desired: &[u8]) -> Judge {
        let optics = scene.optics();
        let camera = Intrinsics::new([optics.fx, optics.fy], [optics.cx, optics.cy]).expect("fine optics");
        let law = Law {
            gain: domvs_vision::Gain::PerSecond(GAIN_PER_S),
            order: OrderRule::fixed(usize::from(ORDER)).expect("fine"),
            ..Law::default()
        };
        let depth = Depth::Constant { depth_m: 1.0 };
        let desired = Judge::plane(scene, desired);
        let servo = Servo::new(law, camera, View { image: &desired, depth: &depth }).expect("a fine target");
        Judge { servo, depth }
    }

    fn twist(&mut self, scene: &Scene, current: &[u8]) -> [f64; 6] {
        let image = Judge::plane(scene, current);
        self.servo.step(View { image: &image, depth: &self.depth }).expect("a fine frame").twist.to_array()
    }

    fn plane(scene: &Scene, gray: &[u8]) -> Plane<f32> {
        let samples = gray.iter().map(|&gray| f32::from(gray) / 255.0).collect();
        Plane::new(scene.camera.width, scene.camera.height, samples).expect("true lengths")
    }
}

fn mono8(rendering: &Rendering, sequence: u64) -> (OutgoingFrame, Vec<u8>) {
    let gray = gray8(rendering);
    let (width, height) = (rendering.image.width() as u32, rendering.image.height() as u32);
    (OutgoingFrame::mono8(width, height, gray.clone()).expect("true lengths").numbered(sequence, 0), gray)
}

/// One client's ten frames, each asked and pushed; its sequences begin at a thousand times its number.
async fn servo_and_judge(stage: &Stage, number: usize) {
    let displacement = [0.05 - 0.01 * number as f64, 0.02, -0.01 * number as f64, 0.5, -1.0, 2.0 + number as f64];
    let mut scene = Scene::new(PHOTOGRAPHS[number % 4], [96, 72], displacement);
    let settings = TaskSettings {
        depth: domvs_proto::settings::Depth::ConstantM(1.0),
        gain: Some(Gain::PerS(GAIN_PER_S)),
        order: OrderRange { min: ORDER, max: ORDER },
        ..scene.settings()
    };
    let client = stage.client(&format!("client-{number}")).await;
    let (target, desired) = mono8(&scene.simulation.capture_desired(), 0);
    let task = started(&client, &settings, &target).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut judge = Judge::new(&scene, &desired);

    for step in 1..=10 {
        let sequence = 1000 * number as u64 + step;
        let (frame, gray) = mono8(&scene.simulation.capture(), sequence);
        let asked = task.twist(&frame).await.expect("answered");
        let pushed = push(&task, &following, &frame).await;
        // Step by step as the service: the last digits of the first are those of both images summed in one go.
        let expected = [0, 1].map(|_| judge.twist(&scene, &gray));
        for (answer, expected) in [asked, pushed].into_iter().zip(expected) {
            assert_eq!((answer.status, answer.sequence), (Status::Servoing, sequence), "client {number}");
            for (got, expected) in answer.twist.iter().zip(expected) {
                // The same f32 path on both sides, so nothing but a rounding of the compiler could differ.
                assert!((got - expected).abs() < 1e-9, "client {number}, frame {sequence}: {answer:?}, {expected:?}");
            }
        }
        scene.simulation.apply(expected[1], 0.1);
    }
    let foreign = following.drain().into_iter().find(|heard| heard.sequence / 1000 != number as u64);
    assert_eq!(foreign, None, "client {number} heard another's");
}

#[tokio::test(flavor = "multi_thread")]
async fn eight_clients_at_once_each_get_their_own_twists() {
    let stage = Arc::new(Stage::open().await);
    let clients: Vec<_> = (1..=8)
        .map(|number| {
            let stage = stage.clone();
            tokio::spawn(async move { servo_and_judge(&stage, number).await })
        })
        .collect();
    for client in clients {
        in_time("a client's ten frames", client).await.expect("no client fails");
    }
    let stage = Arc::into_inner(stage).expect("all clients have ended");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_the_secret_nothing_can_be_asked_or_changed() {
    let stage = Stage::open().await;
    let alice = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&alice, &scene.settings(), &scene.target()).await;
    let before = task.settings().await.expect("answered");

    let mallory = stage.client("mallory").await;
    let own = mallory.create_task(&scene.settings()).await.expect("created");
    let others = own.secret().expect("told once").clone();
    let (keys, key) = (&stage.keys, task.key());
    let frame = scene.frame(1);
    for secret in [None, Some(others)] {
        let attached = |question: Question| match &secret {
            Some(secret) => question.attached(secret.as_bytes()),
            None => question,
        };
        let header = FrameHeader { secret: secret.clone(), ..frame.header().clone() };
        let image = Question { payload: frame.payload().to_bytes().into_owned(), ..Question::on("") };
        let image = image.attached(header.encode());
        let questions = [
            attached(Question::on(keys.control(key)).with(r#"{"do": "stop"}"#)),
            attached(Question::on(keys.control(key)).with(r#"{"do": "close"}"#)),
            attached(Question::on(keys.settings(key))),
            attached(Question::on(keys.settings(key)).with(r#"{"order": 6}"#)),
            attached(Question::on(keys.target(key))),
            Question { selector: keys.target(key), ..image.clone() },
            Question { selector: keys.twist(key), ..image },
        ];
        for question in questions {
            let answer = question.ask(mallory.session()).await;
            assert_eq!(code(answer), ErrorCode::NotOwner, "{}", question.selector);
        }
    }
    for cut in [&[][..], &task.secret().expect("told once").as_bytes()[..15]] {
        let question = Question::on(keys.control(key)).with(r#"{"do": "stop"}"#).attached(cut);
        assert_eq!(code(question.ask(mallory.session()).await), ErrorCode::NotOwner);
    }
    let stranger = mallory.attach(key.clone(), None).await.expect("it has an owner");
    assert_eq!(refusal(stranger.stop().await).0, ErrorCode::NotOwner);

    assert_eq!(task.settings().await.expect("answered"), before);
    assert!(task.twist(&scene.frame(2)).await.expect("answered").is_servoing(), "nothing was stopped");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_terminal_with_the_secret_may_do_everything() {
    let stage = Stage::open().await;
    let alice = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&alice, &scene.settings(), &scene.target()).await;
    let terminal = stage.client("alice-2").await;
    let attached = terminal.attach(task.key().clone(), task.secret().cloned()).await.expect("it has an owner");
    assert_eq!(attached.pause().await.expect("obeyed"), Status::Paused);
    assert_eq!(task.twist(&scene.frame(1)).await.expect("answered").status, Status::Paused);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_does_not_exist_and_what_is_no_name_are_told_apart() {
    let stage = Stage::open().await;
    let session = stage.stranger().await;
    for leaf in ["twist", "target", "settings", "control", "state"] {
        let unknown = Question::on(format!("domvs/task/alice/nothing/{leaf}")).ask(&session).await;
        assert_eq!(code(unknown), ErrorCode::UnknownTask, "{leaf}");
        let no_name = Question::on(format!("domvs/task/al.ice/nothing/{leaf}")).ask(&session).await;
        assert_eq!(code(no_name), ErrorCode::BadName, "{leaf}");
    }
    let long = "x".repeat(65);
    for name in ["al.ice", "älice", "a b", long.as_str()] {
        let answer = Question::on(format!("domvs/worker/w1/create/{name}")).with("{}").ask(&session).await;
        assert_eq!(code(answer), ErrorCode::BadName, "{name:?}");
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_is_not_reached_under_another_clients_name() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let task = client.create_task(&Scene::small("coffee").settings()).await.expect("created");
    let secret = task.secret().expect("told once").as_bytes().to_vec();
    let question = |key: String| Question::on(key).attached(secret.as_slice());
    let id = &task.key().id;
    for leaf in ["settings", "control", "state"] {
        let unknown = question(format!("domvs/task/bob/{id}/{leaf}")).ask(client.session()).await;
        assert_eq!(code(unknown), ErrorCode::UnknownTask, "{leaf}");
    }
    assert!(question("domvs/task/bob/*/settings".into()).ask_all(client.session()).await.is_empty());
    assert_eq!(question("domvs/task/*/*/settings".into()).ask_all(client.session()).await.len(), 1);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn quotas_hold_for_one_client_and_for_the_worker_and_closing_makes_room() {
    let limits = Limits { tasks: 3, tasks_per_client: 2, ..Limits::default() };
    let stage = Stage::with(ServerConfig { limits, ..ServerConfig::default() }).await;
    let (alice, bob) = (stage.client("alice").await, stage.client("bob").await);
    let settings = Scene::small("coffee").settings();
    let first = alice.create_task(&settings).await.expect("created");
    alice.create_task(&settings).await.expect("created");
    let (code, error) = refusal(alice.create_task(&settings).await);
    assert!(code == ErrorCode::Quota && error.contains('2'), "{error}");
    bob.create_task(&settings).await.expect("created");
    let (code, error) = refusal(bob.create_task(&settings).await);
    assert!(code == ErrorCode::Quota && error.contains('3'), "{error}");

    let closed = first.key().clone();
    first.close().await.expect("closed");
    becomes_unknown(&stage, bob.session(), &closed).await;
    bob.create_task(&settings).await.expect("there is room again");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_halts_when_its_client_goes_and_is_closed_after_the_grace_time() {
    let lease = Lease { grace_s: 1 };
    let stage = Stage::with(ServerConfig { lease, ..ServerConfig::default() }).await;
    let mut scene = Scene::small("coffee");
    let client = stage.client("alice").await;
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let (key, secret) = (task.key().clone(), task.secret().cloned());

    let witness = stage.client("bob").await;
    let following = Following::on(witness.session(), stage.keys.command(&key)).await;
    let mut statuses = witness.statuses(&key).await.expect("followed");
    let seen = witness.attach(key.clone(), secret).await.expect("it has an owner");
    assert!(push(&seen, &following, &scene.frame(1)).await.is_servoing(), "it moves");

    client.close().await.expect("the session closes");
    let (_, halted) = following.until("zeros", |message| message.status == Status::ClientLost).await;
    assert_eq!(halted.twist, ZEROS);
    let status = next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;
    assert!(status.latched);
    let after = push(&seen, &following, &scene.frame(2)).await;
    assert_eq!((after.status, after.twist), (Status::ClientLost, ZEROS), "a living camera moves nothing");

    // The lease is gone: who has nothing but the secret cannot set the camera in motion.
    assert_eq!(seen.start().await.expect("answered"), Status::ClientLost);
    assert_eq!(seen.resume().await.expect("answered"), Status::ClientLost);
    becomes_unknown(&stage, witness.session(), &key).await;
    drop(task);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_comes_back_in_time_may_start_again() {
    let stage = Stage::open().await;
    let mut scene = Scene::small("coffee");
    let client = stage.client("alice").await;
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let (key, secret) = (task.key().clone(), task.secret().cloned());
    let witness = stage.client("bob").await;
    let mut statuses = witness.statuses(&key).await.expect("followed");
    client.close().await.expect("the session closes");
    next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;

    let client = stage.client("alice").await;
    let task = client.attach(key, secret).await.expect("it still has an owner");
    assert_eq!(task.twist(&scene.frame(1)).await.expect("answered").status, Status::ClientLost, "latched");
    in_time("the token is seen and start obeyed", async {
        while task.start().await.expect("answered") != Status::WaitingFrame {}
    })
    .await;
    assert!(task.twist(&scene.frame(2)).await.expect("answered").is_servoing());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_only_comes_back_loses_the_tasks_it_left() {
    let lease = Lease { grace_s: 1 };
    let stage = Stage::with(ServerConfig { lease, ..ServerConfig::default() }).await;
    let mut scene = Scene::small("coffee");
    let client = stage.client("alice").await;
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let key = task.key().clone();
    let witness = stage.client("bob").await;
    let mut statuses = witness.statuses(&key).await.expect("followed");
    client.close().await.expect("the session closes");
    next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;

    let _again = stage.client("alice").await;
    becomes_unknown(&stage, witness.session(), &key).await;
    drop(task);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_whose_client_never_had_a_token_does_not_move_for_long() {
    let stage = Stage::open().await;
    let session = stage.stranger().await;
    let settings = serde_json::to_vec(&Scene::small("coffee").settings()).expect("JSON");
    let created = Question::on("domvs/worker/w1/create/ghost").with(settings).ask(&session).await.json();
    let key: TaskKey = created["task"].as_str().expect("text").parse().expect("a task");
    let witness = stage.client("bob").await;
    let mut statuses = witness.statuses(&key).await.expect("followed");
    // Two seconds by docs/protocol.md.
    next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;
    stage.close().await;
}
