//! Every twist of a task's `command` with its time of receipt, none left out.

use std::time::{Duration, Instant};

use domvs_client::{OutgoingFrame, Statuses, Task};
use domvs_proto::messages::StatusMessage;
use domvs_proto::twist::TwistMessage;
use zenoh::Session;
use zenoh::pubsub::Subscriber;

use super::{LIMIT, in_time};

/// A frame that was dropped on its way is sent again after this.
const AGAIN: Duration = Duration::from_millis(500);

/// What is heard on `command`.
pub struct Following {
    heard: flume::Receiver<(Instant, TwistMessage)>,
    _subscriber: Subscriber<()>,
}

impl Following {
    /// Listens, until the first message shows that the worker knows.
    pub async fn on(session: &Session, command: String) -> Following {
        let (hand_over, heard) = flume::unbounded();
        let hear = move |sample: zenoh::sample::Sample| {
            // Decoding refuses motion without servoing and what is not finite.
            let message = TwistMessage::decode(&sample.payload().to_bytes()).expect("only true twists are published");
            // Nobody listens any more.
            let _ = hand_over.send((Instant::now(), message));
        };
        let subscriber = session.declare_subscriber(command).callback(hear).await.expect("a fine key");
        let following = Following { heard, _subscriber: subscriber };
        following.next().await;
        following
    }

    /// The next message.
    pub async fn next(&self) -> (Instant, TwistMessage) {
        in_time("something on command", self.heard.recv_async()).await.expect("the subscriber is there")
    }

    /// The next message for which `condition` holds.
    pub async fn until(&self, what: &str, condition: impl Fn(&TwistMessage) -> bool) -> (Instant, TwistMessage) {
        let waiting = async {
            loop {
                let (at, message) = self.heard.recv_async().await.expect("the subscriber is there");
                if condition(&message) {
                    return (at, message);
                }
            }
        };
        in_time(what, waiting).await
    }

    /// What has been heard and not been taken.
    pub fn drain(&self) -> Vec<TwistMessage> {
        self.heard.drain().map(|(_, message)| message).collect()
    }
}

/// Pushes a frame of a new sequence, again if it is lost, and waits for the twist that answers it.
pub async fn push(task: &Task, following: &Following, frame: &OutgoingFrame) -> TwistMessage {
    let sequence = frame.header().sequence;
    let answered = async {
        loop {
            task.push(frame).await.expect("the session is open");
            let answer = following.until("the twist of a pushed frame", |message| message.sequence == sequence);
            if let Ok((_, message)) = tokio::time::timeout(AGAIN, answer).await {
                return message;
            }
        }
    };
    in_time("the twist of a pushed frame", answered).await
}

/// The next status message for which `condition` holds.
pub async fn next_status(
    statuses: &mut Statuses,
    what: &str,
    condition: impl Fn(&StatusMessage) -> bool,
) -> StatusMessage {
    let waiting = async {
        loop {
            match statuses.recv(LIMIT).await {
                Some(message) if condition(&message) => return message,
                _ => {}
            }
        }
    };
    in_time(what, waiting).await
}
