//! `record`: what came in and what went out is in one MCAP file after the worker has ended, and no secret with it.

use std::collections::BTreeMap;

use domvs_proto::frame::{FrameHeader, HEADER_BYTES};
use domvs_proto::messages::StatusMessage;
use domvs_proto::settings::Frames;
use domvs_server::ServerConfig;
use serde_json::{Value, json};

use crate::support::{Following, Scene, Stage, Status, TaskSettings, TwistMessage, next_status, push, started};

/// The messages of each topic.
fn read(bytes: &[u8]) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut topics = BTreeMap::<String, Vec<Vec<u8>>>::new();
    for message in mcap::MessageStream::new(bytes).expect("an MCAP file") {
        let message = message.expect("a whole message");
        topics.entry(message.channel.topic.clone()).or_default().push(message.data.to_vec());
    }
    topics
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_holds_frames_twists_statuses_and_settings_and_no_secret() {
    let folder = tempfile::tempdir().expect("a folder");
    let stage = Stage::with(ServerConfig { record: folder.path().to_owned(), ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let target = scene.target();
    let task = started(&client, &settings, &target).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut statuses = task.statuses().await.expect("followed");

    let frames: Vec<_> = (1..=6).map(|sequence| scene.frame(sequence)).collect();
    let mut pushed = vec![];
    for frame in &frames[..3] {
        pushed.push(push(&task, &following, frame).await);
    }
    let mut asked = vec![];
    for frame in &frames[3..] {
        asked.push(task.twist(frame).await.expect("answered"));
    }
    task.change_settings(&json!({ "order": 7 })).await.expect("fine");
    next_status(&mut statuses, "servoing on status", |message| message.status == Status::Servoing).await;
    let (keys, key, secret) = (stage.keys.clone(), task.key().clone(), task.secret().expect("told once").clone());
    stage.close().await;

    let files: Vec<_> =
        std::fs::read_dir(folder.path()).expect("there").map(|file| file.expect("there").path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    let bytes = std::fs::read(&files[0]).expect("readable");
    let topics = read(&bytes);

    assert_eq!(topics[&keys.frame(&key)].len(), 6);
    for (recorded, frame) in topics[&keys.frame(&key)].iter().zip(&frames) {
        let (header, payload) = recorded.split_at(HEADER_BYTES);
        assert_eq!(FrameHeader::decode(header).expect("a header").sequence, frame.header().sequence);
        assert_eq!(payload, &*frame.payload().to_bytes());
    }
    assert_eq!(topics[&keys.target(&key)][0][HEADER_BYTES..], *target.payload().to_bytes());
    let twists = |topic: String| -> Vec<TwistMessage> {
        topics[&topic].iter().map(|bytes| TwistMessage::decode(bytes).expect("a twist")).collect()
    };
    for (topic, sent) in [(keys.command(&key), &pushed), (keys.twist(&key), &asked)] {
        assert_eq!(topics[&format!("{topic}_json")].len(), topics[&topic].len());
        let recorded = twists(topic);
        for answer in sent {
            assert!(recorded.iter().any(|twist| twist == answer), "{answer:?} is not among {recorded:?}");
        }
    }
    let status: StatusMessage = serde_json::from_slice(&topics[&keys.status(&key)][0]).expect("a status");
    assert_eq!(status.task, key);
    let orders: Vec<Value> = topics[&keys.settings(&key)]
        .iter()
        .map(|json| serde_json::from_slice::<Value>(json).expect("JSON")["order"].clone())
        .collect();
    assert_eq!(orders, [json!({ "min": 4, "max": 16 }), json!(7)]);

    let hexadecimal: String = secret.as_bytes().iter().map(|byte| format!("{byte:02x}")).collect();
    for forbidden in [&secret.as_bytes()[..], hexadecimal.as_bytes()] {
        assert!(!bytes.windows(forbidden.len()).any(|window| window == forbidden), "the secret is in the file");
    }
}
