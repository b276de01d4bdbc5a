//! JSON bodies, keys, twists, the operator's file and the files of the state directory.

use std::fmt::Debug;

use domvs_proto::body;
use domvs_proto::keys::{Keys, Name, TaskKey};
use domvs_proto::messages::{
    CameraInfo, Control, ControlReply, CreateReply, ErrorReply, StatusMessage, TaskState, WorkerInfo,
};
use domvs_proto::settings::TaskSettings;
use domvs_proto::twist::TwistMessage;
use domvs_server::ServerConfig;
use domvs_server::law::{intrinsics, law};
use domvs_server::state_file;
use domvs_server::task::SentTarget;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A refusal goes back over the network and into the log: it must not carry the whole of what was refused.
const LONGEST_REFUSAL: usize = 1000;

/// The body of `create`, and after a byte 0 the body of a change. What is accepted can be sent again.
pub fn settings(data: &[u8]) {
    let (create, patch) =
        data.iter().position(|byte| *byte == 0).map_or((data, None), |zero| (&data[..zero], Some(&data[zero + 1..])));
    let settings = match TaskSettings::from_create_body(create) {
        Ok(settings) => settings,
        Err(error) => return refused(&ErrorReply::from(&error).error),
    };
    accepted(&settings);
    match patch.map(|patch| settings.merge_patch_body(patch)) {
        None => {}
        Some(Ok(changed)) => accepted(&changed),
        Some(Err(error)) => refused(&ErrorReply::from(&error).error),
    }
}

fn accepted(settings: &TaskSettings) {
    let again = TaskSettings::from_create_body(&body::write(settings)).expect("a complete answer can be sent again");
    assert_eq!(&again, settings);
    assert_eq!(settings.merge_patch_body(b"{}").as_ref(), Ok(settings));
    intrinsics(&settings.camera).expect("checked");
    law(settings).expect("checked");
}

/// Every other body, the answers that a client reads among them.
pub fn messages(data: &[u8]) {
    both_ways::<Control>(data);
    both_ways::<ControlReply>(data);
    both_ways::<CreateReply>(data);
    both_ways::<ErrorReply>(data);
    both_ways::<StatusMessage>(data);
    both_ways::<WorkerInfo>(data);
    both_ways::<CameraInfo>(data);
    both_ways::<TaskState>(data);
}

fn both_ways<T: Serialize + DeserializeOwned + PartialEq + Debug>(data: &[u8]) {
    match body::read::<T>(data) {
        Ok(message) => assert_eq!(body::read::<T>(&body::write(&message)).as_ref(), Ok(&message)),
        Err(error) => refused(&error.to_string()),
    }
}

/// A twist in bytes and in JSON: finite, and zero unless servoing, however it came.
pub fn twist(data: &[u8]) {
    for read in [TwistMessage::decode(data), TwistMessage::from_json(data)] {
        match read {
            Ok(message) => {
                assert!(message.twist.iter().all(|component| component.is_finite()));
                assert!(message.is_servoing() || message.twist == [0.0; 6]);
                let bytes = message.encode();
                let again = TwistMessage::decode(&bytes).expect("our own bytes");
                assert_eq!((again.encode(), again.status, again.twist), (bytes, message.status, message.twist));
                assert_eq!(
                    TwistMessage::from_json(message.to_json().as_bytes()).map(|read| read.twist),
                    Ok(message.twist)
                );
            }
            Err(error) => refused(&error.to_string()),
        }
    }
}

/// A key, a name, a prefix or a task. What is accepted is safe in a key and reads back.
pub fn keys(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let keys = Keys::default();
    let safe = |text: &str| text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_-/".contains(&byte));
    match Name::try_from(text) {
        Ok(name) => assert!(safe(name.as_str()) && !text.contains('/') && (1..=64).contains(&text.len())),
        Err(error) => refused(&error.to_string()),
    }
    match text.parse::<TaskKey>() {
        Ok(task) => assert!(task.to_string() == text && safe(text)),
        Err(error) => refused(&error.to_string()),
    }
    match Keys::new(text) {
        Ok(keys) => assert!(keys.prefix() == text && safe(text) && !text.contains("//")),
        Err(error) => refused(&error.to_string()),
    }
    if let Some((worker, client)) = keys.parse_create(text) {
        assert_eq!(keys.create(&worker, &client), text);
    }
    if let Some(worker) = keys.parse_worker_alive(text) {
        assert_eq!(keys.worker_alive(&worker), text);
    }
    if let Some(client) = keys.parse_client_alive(text) {
        assert_eq!(keys.client_alive(&client), text);
    }
    if let Some(camera) = keys.parse_camera_alive(text) {
        assert_eq!(keys.camera_alive(&camera), text);
    }
    if let Some((task, worker, epoch)) = keys.parse_owner(text) {
        assert_eq!(keys.owner(&task, &worker, epoch), text);
    }
    if let Some((task, leaf)) = keys.parse_task(text) {
        assert_eq!(keys.task(&task, leaf), text);
        assert_eq!(keys.split_task(text), Some((task.to_string().as_str(), leaf)));
    }
}

/// `server.toml`.
pub fn config(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(config) = ServerConfig::parse(text) {
        assert_eq!(config.clone().checked().expect("checked"), config);
        config.worker_name();
    }
}

/// A file of the state directory as it is; and its parts, cut where its lengths say as far as they go, under a checksum that is right. What is
/// accepted is written and read back the same.
pub fn state(data: &[u8]) {
    const LENGTHS: usize = 14;
    state_read(data);
    let Some((lengths, mut rest)) = data.get(LENGTHS..).and_then(|rest| rest.split_at_checked(4 * 8)) else { return };
    let parts = std::array::from_fn(|part| {
        let length = u64::from_le_bytes(std::array::from_fn(|byte| lengths[8 * part + byte]));
        let (cut, left) = rest.split_at(rest.len().min(usize::try_from(length).unwrap_or(usize::MAX)));
        rest = left;
        cut
    });
    state_read(&state_file::of_parts(parts));
}

fn state_read(file: &[u8]) {
    match state_file::decode(file) {
        Ok((state, target)) => {
            let (again, target_again) = state_file::decode(&state_file::encode(&state, target.as_ref())).expect("ours");
            assert_eq!(again, state);
            let parts = |sent: &SentTarget| (sent.header.clone(), sent.encoding.clone(), sent.payload.clone());
            assert_eq!(target_again.as_ref().map(parts), target.as_ref().map(parts));
        }
        Err(error) => refused(&error.to_string()),
    }
}

fn refused(sentence: &str) {
    assert!(sentence.len() <= LONGEST_REFUSAL, "a refusal of {} bytes", sentence.len());
}
