//! Pushing frames, and following `command` and `status`.

use std::time::Duration;

use domvs_client::{Commands, Status, Task, TwistMessage};
use domvs_proto::body;
use domvs_proto::frame::{FrameHeader, Secret};
use domvs_proto::messages::StatusMessage;
use zenoh::pubsub::Publisher;

use crate::fake::{EPOCH, Fake, LIMIT, SECRET, frame, moving, task_key, until};

/// A publisher that the follower is known to hear.
async fn heard(fake: &Fake, key: String) -> Publisher<'static> {
    let publisher = fake.session.declare_publisher(key).await.expect("declared");
    until("somebody follows", || zenoh::Wait::wait(publisher.matching_status()).is_ok_and(|status| status.matching()))
        .await;
    publisher
}

async fn commanded(fake: &Fake) -> (Task, Commands, Publisher<'static>) {
    let task = fake.task(LIMIT, drop).await;
    let commands = task.commands().await.expect("following");
    let publisher = heard(fake, fake.keys.command(&task_key("w"))).await;
    (task, commands, publisher)
}

async fn say(publisher: &Publisher<'_>, twist: TwistMessage) {
    publisher.put(twist.encode()).await.expect("published");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_command_wins_and_the_others_are_counted() {
    let fake = Fake::start().await;
    let (_task, mut commands, publisher) = commanded(&fake).await;
    for sequence in 1..=3 {
        say(&publisher, moving(sequence, EPOCH)).await;
    }
    until("all three have come", || commands.missed() == 2).await;
    assert_eq!(commands.recv(LIMIT).await.map(|twist| twist.sequence), Some(3));
    assert_eq!(commands.latest(), None, "a twist is never given twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_of_older_epochs_are_dropped_and_counted() {
    let fake = Fake::start().await;
    let (task, mut commands, publisher) = commanded(&fake).await;
    say(&publisher, moving(1, EPOCH + 1)).await;
    say(&publisher, moving(2, EPOCH)).await;
    until("the older one was dropped", || commands.older_epochs() == 1).await;
    assert_eq!(commands.latest().map(|twist| twist.sequence), Some(1));
    assert_eq!(task.epoch(), EPOCH + 1, "the task learns of the new owner from what it says");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_is_no_twist_comes_out_as_zeros() {
    let fake = Fake::start().await;
    let (_task, mut commands, publisher) = commanded(&fake).await;
    publisher.put("go faster").await.expect("published");
    let twist = commands.recv(LIMIT).await.expect("zeros");
    assert_eq!((twist.status, twist.twist, commands.unreadable()), (Status::Internal, [0.0; 6], 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn no_command_in_time_is_none() {
    let fake = Fake::start().await;
    let (_task, mut commands, _publisher) = commanded(&fake).await;
    assert_eq!(commands.recv(Duration::from_millis(1)).await, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn statuses_come_in_order_without_those_of_older_epochs() {
    let fake = Fake::start().await;
    let task = fake.task(LIMIT, drop).await;
    let mut statuses = task.statuses().await.expect("following");
    let publisher = heard(&fake, fake.keys.status(&task_key("w"))).await;
    for (status, epoch) in [(Status::Ready, EPOCH), (Status::Paused, EPOCH - 1), (Status::Servoing, EPOCH)] {
        publisher.put(body::write(&StatusMessage::new(task_key("w"), status, epoch))).await.expect("published");
    }
    let mut next = async || statuses.recv(LIMIT).await.map(|message| message.status);
    assert_eq!((next().await, next().await), (Some(Status::Ready), Some(Status::Servoing)));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pushed_frame_carries_its_number_and_the_secret_that_lets_nobody_do_more() {
    let fake = Fake::start().await;
    let (sent, arrived) = flume::bounded(16);
    let camera = fake.session.declare_subscriber(fake.keys.frame(&task_key("w")));
    let _camera = camera.callback(move |sample| drop(sent.try_send(sample))).await.expect("declared");
    let task = fake.task(LIMIT, drop).await;
    let pushed = frame(3);
    let mut got = None;
    while got.is_none() {
        // The first may be gone before the subscriber is known here.
        task.push(&pushed).await.expect("published");
        got = tokio::time::timeout(Duration::from_secs(1), arrived.recv_async()).await.ok();
    }
    let sample = got.expect("the loop waits for it").expect("the subscriber lives");
    let header = FrameHeader::decode(&sample.attachment().expect("a header").to_bytes()).expect("a header");
    assert_eq!(header, FrameHeader { secret: Some(Secret::new(SECRET).for_frames()), ..pushed.header().clone() });
    assert_eq!(sample.payload().to_bytes(), pushed.payload().to_bytes());
}
