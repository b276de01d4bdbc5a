//! The shipped TLS configurations (`deploy/zenoh/tls`), with certificates and passwords as `domvs certs` makes them: each way that
//! is allowed works, each that is not ends in silence. A refusal cannot be waited for, so each forbidden message is followed by an
//! allowed one on the same way; when that has arrived, the first has been refused.

mod links;
mod members;
mod sharing;
mod tenants;

use std::time::Duration;

use domvs_client::{Client, Task};
use domvs_proto::settings::Frames;
use domvs_proto::twist::TwistMessage;
use zenoh::Session;
use zenoh::sample::Sample;

use crate::support::{Following, Lab, OutgoingFrame, Scene, Status, TaskSettings, in_time, started};

/// A message that was dropped on its way is sent again after this.
const AGAIN: Duration = Duration::from_millis(500);
const CAMERA_FRAME: &str = "domvs/camera/front/frame";

/// Alice's task on the camera `front`, started.
async fn task_on_camera(lab: &Lab, alice: &Client, scene: &mut Scene) -> Task {
    let settings = TaskSettings { frames: Frames::Key(CAMERA_FRAME.into()), ..scene.settings() };
    let task = started(alice, &settings, &scene.target()).await;
    assert!(lab.keys.command(task.key()).contains("/alice/"));
    task
}

async fn put(session: &Session, key: &str, frame: &OutgoingFrame) {
    let put = session.put(key, frame.payload().clone()).encoding(frame.encoding().clone());
    put.attachment(frame.header().encode()).await.expect("the session is open");
}

/// The camera sends frames until the robot hears the answer to one; its number.
async fn heard_through(camera: &Session, robot: &Following, scene: &mut Scene, first: u64) -> u64 {
    let mut sequence = first;
    let answered = async {
        loop {
            put(camera, CAMERA_FRAME, &scene.frame(sequence)).await;
            let answer = robot.until("the twist of a camera's frame", |message| message.sequence == sequence);
            if tokio::time::timeout(AGAIN, answer).await.is_ok() {
                return sequence;
            }
            sequence += 1;
        }
    };
    in_time("the twist of a camera's frame", answered).await
}

/// The numbers of forged twists, and of frames sent by who must not.
const FORGED: [u64; 2] = [666, 777];

/// Nothing of it has come to an arm that listened all the time.
async fn assert_nothing_forged(heard: &flume::Receiver<Sample>) {
    let first = in_time("something on command", heard.recv_async()).await.expect("the subscriber is there");
    for sample in [first].into_iter().chain(heard.drain()) {
        let message = TwistMessage::decode(&sample.payload().to_bytes()).expect("a twist");
        assert!(!FORGED.contains(&message.sequence), "{message:?}");
    }
}

/// A twist that would move an arm.
fn forged() -> Vec<u8> {
    let twist = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
    let valid = TwistMessage {
        status: Status::Servoing,
        twist,
        sequence: FORGED[0],
        valid_ms: 200,
        ..TwistMessage::zero(Status::Ready)
    };
    valid.encode().to_vec()
}
