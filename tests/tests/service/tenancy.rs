//! What is one client's stays its own, whoever else asks, pushes, floods, dies or does not read; and what each may use is bounded.

use std::sync::Arc;
use std::time::Duration;

use domvs_proto::frame::{FrameHeader, PixelFormat, Secret};
use domvs_proto::settings::{Frames, Lease};
use domvs_server::ServerConfig;
use domvs_server::config::{Lease as Grace, Limits};
use serde_json::json;
use zenoh::Session;

use crate::support::{
    Answer, Client, ErrorCode, Following, OutgoingFrame, Question, Scene, Stage, Status, Task, TaskSettings, ZEROS,
    becomes_unknown, code, in_time, next_status, push, refusal, started,
};

/// A worker that grants what the test is about.
async fn stage(limits: Limits) -> Stage {
    Stage::with(ServerConfig { limits, ..ServerConfig::default() }).await
}

/// A question on `twist` with any secret.
fn twist_question(stage: &Stage, task: &Task, frame: &OutgoingFrame, secret: Option<&Secret>) -> Question {
    let header = FrameHeader { secret: secret.cloned(), ..frame.header().clone() };
    let question = Question::on(stage.keys.twist(task.key())).with(frame.payload().to_bytes().into_owned());
    question.encoded("application/octet-stream").attached(header.encode())
}

/// The attacker's session asks everything of `task` with `secret`, and every answer says that it is not the owner.
async fn is_refused_everywhere(stage: &Stage, attacker: &Session, task: &Task, secret: &Secret, frame: &OutgoingFrame) {
    let keys = &stage.keys;
    let image = twist_question(stage, task, frame, Some(secret));
    for question in [
        Question::on(keys.control(task.key())).with(r#"{"do": "stop"}"#).attached(secret.as_bytes()),
        Question::on(keys.settings(task.key())).with(r#"{"order": 6}"#).attached(secret.as_bytes()),
        Question::on(keys.target(task.key())).attached(secret.as_bytes()),
        Question { selector: keys.target(task.key()), ..image.clone() },
        image,
    ] {
        assert_eq!(code(question.ask(attacker).await), ErrorCode::NotOwner, "{}", question.selector);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn eight_clients_that_try_each_others_keys_all_the_time_get_their_own_twists_and_not_owner() {
    const CLIENTS: usize = 8;
    let stage = Arc::new(Stage::open().await);
    let mut tenants = vec![];
    for number in 0..CLIENTS {
        let client = stage.client(&format!("client-{number}")).await;
        let mut scene = Scene::small("coffee");
        let task = started(&client, &scene.settings(), &scene.target()).await;
        tenants.push(Arc::new((client, task, scene.frame(0))));
    }
    let tenants = Arc::new(tenants);
    let asking: Vec<_> = (0..CLIENTS)
        .map(|number| {
            let (stage, tenants) = (stage.clone(), tenants.clone());
            tokio::spawn(async move {
                let (client, own, frame) = &*tenants[number];
                for step in 1..CLIENTS {
                    let sequence = (1000 * number + step) as u64;
                    let answer = own.twist(&frame.clone().numbered(sequence, 0)).await.expect("answered");
                    assert!(answer.is_servoing() && answer.sequence == sequence, "client {number}: {answer:?}");
                    let other = &tenants[(number + step) % CLIENTS].1;
                    let (mine, random) = (own.secret().expect("told").clone(), Secret::new([step as u8; 16]));
                    for secret in [mine, random] {
                        is_refused_everywhere(&stage, client.session(), other, &secret, frame).await;
                    }
                }
            })
        })
        .collect();
    for asking in asking {
        in_time("a client's tries", asking).await.expect("no client fails");
    }
    drop(tenants);
    Arc::into_inner(stage).expect("all have ended").close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stranger_takes_no_room_of_the_owner_and_leaves_no_trace_in_its_status() {
    let limits = Limits { frames_per_s_per_client: 1000, requests_per_s_per_client: 20, ..Limits::default() };
    let stage = stage(limits).await;
    let alice = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&alice, &scene.settings(), &scene.target()).await;
    let mut statuses = task.statuses().await.expect("followed");
    let stranger = stage.stranger().await;
    let wrong = Secret::new([7; 16]);
    let frame = scene.frame(1);
    for number in 0..60 {
        let question = match number % 4 {
            0 => twist_question(&stage, &task, &frame, Some(&wrong)),
            1 => twist_question(&stage, &task, &frame, None).attached([0xff; 30]),
            2 => Question::on(stage.keys.control(task.key())).with(r#"{"do": "stop"}"#).attached(wrong.as_bytes()),
            _ => Question::on(stage.keys.settings(task.key())).attached(wrong.as_bytes()),
        };
        match question.ask(&stranger).await {
            Answer::Refused(error) => assert_eq!(error.code, ErrorCode::NotOwner, "{error}"),
            good => assert_eq!(good.twist().twist, ZEROS),
        }
    }
    // More than the client may ask in a second was asked in its name, and it may still ask.
    task.settings().await.expect("answered");
    assert!(task.twist(&scene.frame(2)).await.expect("answered").is_servoing());
    let said = next_status(&mut statuses, "the owner's frame", |message| message.sequence == 2).await;
    assert_eq!((said.frames_in, said.frames_dropped.bad), (1, 0), "{said:?}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wildcard_with_one_tasks_secret_acts_on_that_task_alone() {
    let stage = Stage::open().await;
    let (alice, mallory) = (stage.client("alice").await, stage.client("mallory").await);
    let mut scene = Scene::small("coffee");
    let (settings, target) = (scene.settings(), scene.target());
    let task = started(&alice, &settings, &target).await;
    let own = started(&mallory, &settings, &target).await;
    let secret = own.secret().expect("told once").clone();
    for selector in ["domvs/task/*/*/control", "domvs/task/**", "domvs/task/alice/*/control", "domvs/**/control"] {
        let question = Question::on(selector).with(r#"{"do": "stop"}"#).attached(secret.as_bytes());
        for answer in question.ask_all(mallory.session()).await {
            if let Answer::Good { key, .. } = answer {
                let public = key.ends_with("/state") || key.ends_with("/info");
                assert!(public || key.starts_with(&format!("domvs/task/{}/", own.key())), "{selector}: {key}");
            }
        }
        assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing(), "after {selector}");
    }
    assert_eq!(own.twist(&scene.frame(2)).await.expect("answered").status, Status::Stopped, "its own was stopped");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tricks_with_names_and_parameters_are_refused_and_act_on_nothing() {
    let stage = Stage::open().await;
    let alice = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&alice, &scene.settings(), &scene.target()).await;
    let stranger = stage.stranger().await;
    let settings = serde_json::to_vec(&scene.settings()).expect("JSON");
    let long = "x".repeat(10_000);
    for name in ["*", "**", "a$*", "@x", "älice", "al.ice", "a b", "%2F", long.as_str()] {
        let create = Question::on(format!("domvs/worker/w1/create/{name}")).with(settings.clone());
        for answer in create.ask_all(&stranger).await {
            assert_eq!(code(answer), ErrorCode::BadName, "create for {:.20}", name);
        }
        for key in [format!("domvs/task/{name}/x/control"), format!("domvs/task/alice/{name}/control")] {
            for answer in Question::on(key).with(r#"{"do": "stop"}"#).ask_all(&stranger).await {
                let told = code(answer);
                assert!([ErrorCode::BadName, ErrorCode::NotOwner].contains(&told), "{:.20}: {told}", name);
            }
        }
    }
    let junk = "x=1;".repeat(1000);
    for parameters in
        ["secret=00000000000000000000000000000000", "format=json;secret=0", "_time=[now()]", junk.as_str()]
    {
        let question = Question::on(format!("{}?{parameters}", stage.keys.control(task.key())));
        let answer = question.with(r#"{"do": "stop"}"#).ask(&stranger).await;
        assert_eq!(code(answer), ErrorCode::NotOwner, "{:.40}", parameters);
    }
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    assert_eq!(alice.list_workers().await.expect("answered")[0].tasks, 1, "nobody has made another");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pushed_frames_without_the_secret_are_dropped_and_counted_if_the_settings_say_so() {
    let stage = Stage::open().await;
    let alice = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, frame_secret: true, ..scene.settings() };
    let task = started(&alice, &settings, &scene.target()).await;
    let following = Following::on(alice.session(), stage.keys.command(task.key())).await;
    let mut statuses = task.statuses().await.expect("followed");
    let camera = stage.stranger().await;
    let secret = task.secret().expect("told once");
    let frame_key = stage.keys.frame(task.key());
    for (before, wrong) in (0..).zip([None, Some(Secret::new([1; 16]))]) {
        let header = FrameHeader { secret: wrong, ..FrameHeader::new(PixelFormat::Mono8, 5, 2) };
        in_time("a frame that is counted", async {
            loop {
                camera.put(&frame_key, vec![0u8; 10]).attachment(header.encode()).await.expect("open");
                let heard = statuses.recv(Duration::from_millis(700)).await;
                if heard.is_some_and(|heard| heard.frames_dropped.not_owner > before) {
                    return;
                }
            }
        })
        .await;
    }
    assert!(following.drain().iter().all(|message| message.status != Status::BadFrame), "they change nothing");
    // The client's own way carries the frame secret; the task's own secret would do as well.
    assert!(push(&task, &following, &scene.frame(100)).await.is_servoing());
    let frame = scene.frame(101);
    let header = FrameHeader { secret: Some(secret.clone()), ..frame.header().clone() };
    in_time("the task's secret", async {
        loop {
            let put = camera.put(&frame_key, frame.payload().clone()).attachment(header.encode());
            put.await.expect("open");
            let heard = following.until("its twist", |message| message.sequence == 101);
            if tokio::time::timeout(Duration::from_millis(500), heard).await.is_ok() {
                return;
            }
        }
    })
    .await;
    // A frame secret controls nothing.
    let question = Question::on(stage.keys.control(task.key())).with(r#"{"do": "stop"}"#);
    let answer = question.attached(secret.for_frames().as_bytes()).ask(&camera).await;
    assert_eq!(code(answer), ErrorCode::NotOwner);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_beyond_the_rate_are_overloaded_and_counted_and_a_stop_is_always_let_in() {
    let limits = Limits { frames_per_s_per_client: 5, requests_per_s_per_client: 5, ..Limits::default() };
    let stage = stage(limits).await;
    let (alice, bob) = (stage.client("alice").await, stage.client("bob").await);
    let mut scene = Scene::small("coffee");
    let (settings, target) = (scene.settings(), scene.target());
    let task = started(&alice, &settings, &target).await;
    let other = started(&bob, &settings, &target).await;
    let mut statuses = task.statuses().await.expect("followed");
    let (mut servoing, mut overloaded) = (0, 0);
    while overloaded < 50 {
        let answer = task.twist(&scene.frame(servoing + overloaded + 1)).await.expect("answered");
        match answer.status {
            Status::Servoing => servoing += 1,
            Status::Overloaded => {
                assert_eq!(answer.twist, ZEROS);
                overloaded += 1;
            }
            other => panic!("{other}"),
        }
    }
    let counted =
        next_status(&mut statuses, "the count", |message| message.frames_dropped.overloaded == overloaded).await;
    assert_eq!(counted.frames_in, servoing + overloaded, "{counted:?}");
    assert!(other.twist(&scene.frame(1)).await.expect("answered").is_servoing(), "another client has its own rate");

    // Requests likewise, but for a stop.
    let refused = in_time("a refusal", async {
        loop {
            if let Err(error) = task.settings().await {
                return refusal::<()>(Err(error));
            }
        }
    })
    .await;
    assert!(refused.0 == ErrorCode::Quota && refused.1.contains('5'), "{refused:?}");
    let words = async {
        loop {
            if let Err(error) = task.pause().await {
                return refusal::<()>(Err(error));
            }
        }
    };
    assert_eq!(in_time("a refused pause", words).await.0, ErrorCode::Quota);
    assert_eq!(task.stop().await.expect("a stop is let in"), Status::Stopped);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pixels_and_bytes_are_bounded_for_a_client_and_the_worker_also_in_a_change() {
    let picture = 96 * 72;
    let limits = Limits {
        pixels_per_frame: 2 * picture,
        pixels_per_client: 3 * picture,
        pixels: 4 * picture,
        // A target of 32-bit gray and depth has 8 bytes a pixel.
        bytes_per_client: 10 * picture,
        ..Limits::default()
    };
    let stage = stage(limits).await;
    let (alice, bob) = (stage.client("alice").await, stage.client("bob").await);
    let mut scene = Scene::small("coffee");
    let settings = scene.settings();
    let first = alice.create_task(&settings).await.expect("created");
    let wider = |times: u32| json!({ "camera": { "width": 96 * times } });
    let (code, error) = refusal(first.change_settings(&wider(3)).await);
    assert!(code == ErrorCode::Quota && error.contains("13824") && error.contains("20736"), "{error}");
    first.change_settings(&wider(2)).await.expect("two pictures");
    let second = alice.create_task(&settings).await.expect("the third picture");
    let (code, error) = refusal(alice.create_task(&settings).await);
    assert!(code == ErrorCode::Quota && error.contains("20736") && error.contains("alice"), "{error}");
    let (code, _) = refusal(second.change_settings(&wider(2)).await);
    assert_eq!(code, ErrorCode::Quota);
    bob.create_task(&settings).await.expect("the fourth of the worker");
    let (code, error) = refusal(bob.create_task(&settings).await);
    assert!(code == ErrorCode::Quota && error.contains("27648"), "{error}");
    first.change_settings(&wider(1)).await.expect("a smaller one");
    let third = alice.create_task(&settings).await.expect("there is room again");

    let target = scene.target();
    second.set_target(&target).await.expect("room for one");
    let (code, error) = refusal(third.set_target(&target).await);
    assert!(code == ErrorCode::Quota && error.contains("69120"), "{error}");
    let key = second.key().clone();
    second.close().await.expect("closed");
    becomes_unknown(&stage, bob.session(), &key).await;
    third.set_target(&target).await.expect("the closed task's bytes are free");
    let info = &alice.list_workers().await.expect("answered")[0];
    assert_eq!(info.quotas.bytes_used, target.payload().len() as u64, "{info:?}");
    stage.close().await;
}

/// A client of this name in a session of its own, and a task of it that is started.
async fn tenant(stage: &Stage, name: &str, scene: &mut Scene) -> (Client, Task) {
    let client = stage.client(name).await;
    let task = started(&client, &scene.settings(), &scene.target()).await;
    (client, task)
}

#[tokio::test(flavor = "multi_thread")]
async fn two_processes_of_one_name_each_keep_their_own_tasks_alive() {
    let stage = Stage::with(ServerConfig { lease: Grace { grace_s: 1 }, ..ServerConfig::default() }).await;
    let mut scene = Scene::small("coffee");
    let (first, of_first) = tenant(&stage, "alice", &mut scene).await;
    let (second, of_second) = tenant(&stage, "alice", &mut scene).await;
    let witness = stage.client("bob").await;
    let mut statuses = witness.statuses(of_first.key()).await.expect("followed");
    let key = of_first.key().clone();
    first.close().await.expect("the session closes");
    next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;
    becomes_unknown(&stage, witness.session(), &key).await;
    assert!(of_second.twist(&scene.frame(1)).await.expect("answered").is_servoing(), "the other process lives");
    drop((of_first, second));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lease_by_name_alone_lives_as_long_as_any_process_of_that_name() {
    let stage = Stage::open().await;
    let scene = Scene::small("coffee");
    let session = stage.stranger().await;
    let tokens = [stage.stranger().await, stage.stranger().await];
    let mut held = vec![];
    for token in &tokens {
        held.push(token.liveliness().declare_token("domvs/client/alice/alive").await.expect("a fine key"));
    }
    let settings = serde_json::to_vec(&TaskSettings { lease: Lease::Client, ..scene.settings() }).expect("JSON");
    let created = Question::on("domvs/worker/w1/create/alice").with(settings).ask(&session).await.json();
    let key = created["task"].as_str().expect("text").parse().expect("a task");
    let witness = stage.client("bob").await;
    let mut statuses = witness.statuses(&key).await.expect("followed");
    held.pop().expect("two").undeclare().await.expect("it was there");
    // Two periods of the status without a word of a loss.
    for _ in 0..5 {
        let heard = statuses.recv(Duration::from_secs(20)).await.expect("twice a second");
        assert_eq!(heard.status, Status::WaitingTarget);
    }
    held.pop().expect("one").undeclare().await.expect("it was there");
    next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_thousand_tokens_of_strangers_harm_no_lease() {
    let stage = Stage::open().await;
    let crowd = stage.stranger().await;
    let mut tokens = vec![];
    for number in 0..10_001 {
        let key = format!("domvs/client/n{number}/alive");
        tokens.push(crowd.liveliness().declare_token(key).await.expect("a fine key"));
    }
    let mut scene = Scene::small("coffee");
    let (client, task) = tenant(&stage, "alice", &mut scene).await;
    let mut statuses = task.statuses().await.expect("followed");
    // Longer than a token may take to arrive.
    next_status(&mut statuses, "three seconds", |message| message.uptime_s > 3.0).await;
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing(), "its lease is seen");
    client.close().await.expect("the session closes");
    let witness = stage.client("bob").await;
    let mut statuses = witness.statuses(task.key()).await.expect("followed");
    next_status(&mut statuses, "client_lost", |message| message.status == Status::ClientLost).await;
    drop((task, tokens));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_never_reads_holds_up_nobody() {
    /// Together far more than the buffers of the system hold.
    const ANSWERS: usize = 100;
    /// Half of what Zenoh waits for a client that does not read before it closes the link.
    const PATIENCE: Duration = Duration::from_millis(2500);
    let stage = Stage::open().await;
    let mut scene = Scene::small("coffee");
    let (bob, of_bob) = tenant(&stage, "bob", &mut scene).await;
    let (link, mallory) = stage.deaf_client("mallory").await;
    let mut large = Scene::new("coffee", [512, 512], [0.0; 6]);
    let task = mallory.create_task(&large.settings()).await.expect("created");
    task.set_target(&large.target()).await.expect("set");
    let secret = task.secret().expect("told once").as_bytes().to_vec();
    link.turn_deaf();
    for _ in 0..ANSWERS {
        let asked = mallory.session().get(stage.keys.target(task.key())).attachment(secret.clone());
        asked.callback(|_| {}).await.expect("the session is open");
        let answer = tokio::time::timeout(PATIENCE, of_bob.twist(&scene.frame(1))).await;
        assert!(answer.expect("nobody is held up").expect("answered").is_servoing());
    }
    drop(bob);
    stage.close().await;
}
