//! Settings and target: what was set comes back, what is wrong is refused with the numbers and changes nothing.

use domvs_proto::frame::{FrameHeader, HEADER_BYTES};
use domvs_proto::settings::{Depth, Frames, Limits, Method, OrderRange};
use serde_json::json;

use crate::support::{Answer, ErrorCode, Question, Scene, Stage, TaskSettings, in_time, refusal, started};

#[tokio::test(flavor = "multi_thread")]
async fn a_patch_changes_what_it_names_and_null_brings_the_default_back() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let created = task.settings().await.expect("answered");
    // The Rust client hangs a task on its own process.
    assert_eq!(created, TaskSettings { lease: created.lease.clone(), ..scene.settings() });

    let patch = json!({ "order": 6, "method": "tchebichef", "limits": { "linear_m_per_s": 0.05 } });
    let changed = task.change_settings(&patch).await.expect("fine");
    let expected = TaskSettings {
        order: OrderRange { min: 6, max: 6 },
        method: Method::Tchebichef,
        limits: Some(Limits { linear_m_per_s: 0.05, ..Limits::default() }),
        ..created.clone()
    };
    assert_eq!(changed, expected);
    let answer = task.twist(&scene.frame(1)).await.expect("answered");
    assert!(answer.is_servoing() && answer.order == 6, "a change does not stop the task: {answer:?}");
    let speed = answer.twist[..3].iter().map(|component| component * component).sum::<f64>().sqrt();
    assert!(speed <= 0.05 + 1e-12, "{speed} m/s");

    let restored = task.change_settings(&json!({ "order": null, "method": null, "limits": null })).await.expect("fine");
    assert_eq!(restored, TaskSettings { limits: Some(Limits::default()), ..created });
    assert_eq!(task.settings().await.expect("answered"), restored);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_patch_is_refused_with_the_numbers_and_changes_nothing() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let before = task.settings().await.expect("answered");
    for (patch, expected, words) in [
        (json!({ "order": 41 }), ErrorCode::BadSettings, ["41", "40"]),
        (json!({ "method": "cosine", "max_age_ms": 0 }), ErrorCode::BadSettings, ["max_age_ms", "60000"]),
        (json!({ "watchdog_ms": 30 }), ErrorCode::BadSettings, ["30", "133.3"]),
        (json!({ "ordre": 4 }), ErrorCode::BadSettings, ["ordre", "unknown"]),
        (json!({ "gain": { "per_s": -1 } }), ErrorCode::BadSettings, ["gain.per_s", "-1"]),
        (
            json!({ "degrees_of_freedom": [false, false, false, false, false, false] }),
            ErrorCode::BadSettings,
            ["six", "none"],
        ),
        (json!({ "preprocess": { "undistort": true } }), ErrorCode::NotSupported, ["undistort", "not supported"]),
        (json!({ "depth_scale": "estimate" }), ErrorCode::BadSettings, ["depth_scale", "constant depth"]),
        (
            json!({ "preprocess": { "mask": { "png_base64": "aGVsbG8=" } } }),
            ErrorCode::BadSettings,
            ["mask", "5 bytes"],
        ),
        (json!({ "frames": "pushed" }), ErrorCode::NotSupported, ["frames", "create"]),
        (json!({ "lease": { "process": "a/b" } }), ErrorCode::BadSettings, ["lease", "a name"]),
        (json!({ "camera": { "width": 64 } }), ErrorCode::BadTarget, ["64x72", "96x72"]),
        (json!([]), ErrorCode::BadSettings, ["object", "list"]),
    ] {
        let (code, error) = refusal(task.change_settings(&patch).await);
        assert_eq!(code, expected, "{patch}: {error}");
        for word in words {
            assert!(error.contains(word), "{patch}: {word:?} is not in {error:?}");
        }
        assert_eq!(task.settings().await.expect("answered"), before, "{patch}");
    }
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_target_comes_back_as_it_was_set_without_the_secret() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = client.create_task(&scene.settings()).await.expect("created");
    assert_eq!(refusal(task.target().await).0, ErrorCode::NoTarget);
    assert_eq!(refusal(task.start().await).0, ErrorCode::NoTarget);

    let target = scene.target().numbered(42, 4711);
    task.set_target(&target).await.expect("set");
    let back = task.target().await.expect("answered");
    assert_eq!(&back.header, target.header());
    assert_eq!((back.payload.as_slice(), &back.encoding), (&*target.payload().to_bytes(), target.encoding()));

    let secret = task.secret().expect("told once").as_bytes().to_vec();
    let question = Question::on(stage.keys.target(task.key())).attached(secret.clone());
    let Answer::Good { attachment: Some(header), payload, .. } = question.ask(client.session()).await else {
        panic!("a target with its header")
    };
    assert_eq!(header.len(), HEADER_BYTES);
    assert_eq!(FrameHeader::decode(&header).expect("a header").secret, None);
    for bytes in [header, payload] {
        assert!(!bytes.windows(secret.len()).any(|window| window == secret));
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn create_refuses_what_it_does_not_understand() {
    let stage = Stage::open().await;
    let session = stage.stranger().await;
    let camera = json!({ "fx": 80, "fy": 80, "cx": 47.5, "cy": 35.5, "width": 96, "height": 72 });
    let with = |name: &str, value: serde_json::Value| {
        let mut settings = json!({ "camera": camera });
        settings[name] = value;
        settings
    };
    for (settings, expected, word) in [
        (json!({}), ErrorCode::BadSettings, "camera"),
        (json!(null), ErrorCode::BadSettings, "object"),
        (with("order", json!(70)), ErrorCode::BadSettings, "70"),
        (with("depth", json!({ "constant_m": 0 })), ErrorCode::BadSettings, "depth.constant_m"),
        (with("frames", json!({ "key": "domvs/**" })), ErrorCode::BadSettings, "wildcard"),
        (with("frames", json!({ "key": "a//b" })), ErrorCode::BadSettings, "empty"),
        (with("frames", json!({ "franka_cam": "left" })), ErrorCode::NotSupported, "franka_cam"),
        (with("secret", json!("mine")), ErrorCode::BadSettings, "secret"),
    ] {
        let question = Question::on("domvs/worker/w1/create/alice").with(settings.to_string());
        let Answer::Refused(error) = question.ask(&session).await else { panic!("{settings} was taken") };
        assert!(error.code == expected && error.error.contains(word), "{settings}: {error}");
    }
    let listed = stage.client("bob").await.list_tasks().await.expect("answered");
    assert!(listed.is_empty(), "{listed:?}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_says_what_it_is_and_a_task_what_a_standby_needs() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, depth: Depth::ConstantM(1.5), ..scene.settings() };
    let task = client.create_task(&settings).await.expect("created");
    let empty = task.state().await.expect("answered");
    // The client hangs the task on its own process.
    let settings = TaskSettings { lease: empty.settings.lease.clone(), ..settings };
    assert_eq!((empty.target, empty.settings), (None, settings));
    let target = scene.target();
    task.set_target(&target).await.expect("set");
    let state = task.state().await.expect("answered");
    let reference = state.target.expect("it was set");
    let bytes = target.payload().len() as u64;
    assert_eq!((reference.width, reference.height, reference.payload_bytes), (96, 72, bytes));
    assert_eq!((state.worker.as_str(), state.epoch), (crate::support::WORKER, task.epoch()));

    let workers = client.list_workers().await.expect("one answers");
    assert_eq!((workers.len(), workers[0].tasks, workers[0].wire_version), (1, 1, 1));
    let listed = in_time("the list", client.list_tasks()).await.expect("answered");
    assert_eq!(listed.iter().map(|task| &task.task).collect::<Vec<_>>(), [task.key()]);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_states_of_all_tasks_are_gathered_by_one_question() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let settings = Scene::small("coffee").settings();
    let mut expected = vec![];
    for _ in 0..3 {
        let task = client.create_task(&settings).await.expect("created");
        expected.push(stage.keys.state(task.key()));
    }
    expected.sort();
    let gather = Question::on("domvs/task/*/*/state");
    let mut keys: Vec<String> = gather
        .ask_all(client.session())
        .await
        .into_iter()
        .map(|answer| match answer {
            Answer::Good { key, .. } => key,
            Answer::Refused(error) => panic!("{error}"),
        })
        .collect();
    keys.sort();
    // On its own key each, or Zenoh would take them for several versions of one answer.
    assert_eq!(keys, expected);
    stage.close().await;
}
