//! A router with a worker made of canned answers, and the waits of the tests.

use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use domvs_client::{
    Camera, Client, ClientOptions, Name, OutgoingFrame, Secret, Status, Task, TaskKey, TaskSettings, TwistMessage,
};
use domvs_proto::body;
use domvs_proto::frame::FrameHeader;
use domvs_proto::keys::Keys;
use domvs_proto::messages::{CreateReply, ErrorCode, ErrorReply, WorkerInfo};
use serde::Serialize;
use zenoh::bytes::ZBytes;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// No test waits longer for anything.
pub const LIMIT: Duration = Duration::from_secs(10);
/// The epoch of the fake's tasks.
pub const EPOCH: u32 = 5 << 16 | 77;
/// Their secret.
pub const SECRET: [u8; 16] = *b"sixteen secrets!";

/// A router; queryables and tokens declared through it stay until it is dropped.
pub struct Fake {
    pub session: Session,
    pub keys: Keys,
    pub endpoint: String,
    queryables: Mutex<Vec<Queryable<()>>>,
}

impl Fake {
    /// A router on a free loopback port; on another one when somebody was faster.
    pub async fn start() -> Fake {
        for _ in 0..20 {
            if let Ok(fake) = Fake::start_at(&free_endpoint()).await {
                return fake;
            }
        }
        panic!("no free port in 20 tries");
    }

    /// A router on this endpoint.
    pub async fn start_at(endpoint: &str) -> zenoh::Result<Fake> {
        Ok(Fake {
            session: zenoh::open(router(endpoint)).await?,
            keys: Keys::default(),
            endpoint: endpoint.to_owned(),
            queryables: Mutex::default(),
        })
    }

    /// A complete queryable; what `answer` does not reply ends empty.
    pub async fn answer(&self, key: &str, answer: impl Fn(Query) + Send + Sync + 'static) {
        let queryable = self.session.declare_queryable(key.to_owned()).complete(true).callback(answer).await;
        self.queryables.lock().expect("no panic before").push(queryable.expect("a valid key"));
    }

    /// A worker of this load that gives out [`task_key`] and answers nothing else.
    pub async fn worker(&self, worker: &str, load: f64) {
        let id = worker.to_owned();
        self.worker_that_creates(worker, load, move |query| reply_json(&query, &created(&id))).await;
    }

    /// A worker of this load that answers `create` like this.
    pub async fn worker_that_creates(&self, worker: &str, load: f64, create: impl Fn(Query) + Send + Sync + 'static) {
        let info = WorkerInfo { load, ..WorkerInfo::new(name(worker)) };
        self.answer(&self.keys.worker_info(&name(worker)), move |query| reply_json(&query, &info)).await;
        self.answer(&self.keys.creates(&name(worker)), create).await;
    }

    /// A client on this router; `change` may shorten its limits.
    pub async fn client(&self, change: impl FnOnce(&mut ClientOptions)) -> Client {
        let mut options = options(&self.endpoint);
        change(&mut options);
        Client::connect(options).await.expect("the router is there")
    }

    /// A task whose `twist` is answered by `answer`, on a client with this limit for twists.
    pub async fn task(&self, twist_timeout: Duration, answer: impl Fn(Query) + Send + Sync + 'static) -> Task {
        self.worker("w", 0.0).await;
        self.answer(&self.keys.twist(&task_key("w")), answer).await;
        let client = self.client(|options| options.twist_timeout = twist_timeout).await;
        client.create_task(&settings()).await.expect("the fake gives every task")
    }
}

fn router(endpoint: &str) -> zenoh::Config {
    let listen = format!("[{endpoint:?}]");
    let mut config = zenoh::Config::default();
    let settings = [
        ("mode", "\"router\""),
        ("listen/endpoints", &listen),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("scouting/delay", "0"),
    ];
    for (key, value) in settings {
        config.insert_json5(key, value).expect("a Zenoh setting");
    }
    config
}

/// An endpoint that was free a moment ago.
pub fn free_endpoint() -> String {
    let port = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a free port").port();
    format!("tcp/127.0.0.1:{port}")
}

/// The options of client `alice`, with room for a busy machine.
pub fn options(endpoint: &str) -> ClientOptions {
    let options = ClientOptions::named("alice").and_then(|options| options.at(endpoint)).expect("valid");
    ClientOptions {
        request_timeout: LIMIT,
        twist_timeout: LIMIT,
        discovery_limit: LIMIT,
        connect_limit: LIMIT,
        ..options
    }
}

/// A name.
pub fn name(text: &str) -> Name {
    Name::try_from(text).expect("a name")
}

/// The task that worker `worker` gives to client `alice`.
pub fn task_key(worker: &str) -> TaskKey {
    TaskKey { client: name("alice"), id: name(&format!("of-{worker}")) }
}

/// What its `create` answers.
pub fn created(worker: &str) -> CreateReply {
    CreateReply { task: task_key(worker), epoch: EPOCH, secret: Secret::new(SECRET), frame_secret: None }
}

/// Settings for an 8 × 8 camera, order 4.
pub fn settings() -> TaskSettings {
    let camera = Camera { fx: 10.0, fy: 10.0, cx: 3.5, cy: 3.5, width: 8, height: 8, distortion: None };
    TaskSettings::from_json(&serde_json::json!({ "camera": camera, "order": 4 })).expect("valid")
}

/// A frame of that camera.
pub fn frame(sequence: u64) -> OutgoingFrame {
    OutgoingFrame::mono8(8, 8, vec![9; 64]).expect("the right length").numbered(sequence, 1000 + sequence)
}

/// A twist that moves, as an owner of `epoch` answers a frame.
pub fn moving(sequence: u64, epoch: u32) -> TwistMessage {
    let twist = [0.1, 0.0, 0.0, 0.0, 0.0, 0.2];
    TwistMessage { sequence, epoch, twist, ..TwistMessage::zero(Status::Servoing) }
}

/// The header of the frame in a query.
pub fn header_of(query: &Query) -> FrameHeader {
    let attachment = query.attachment().map(ZBytes::to_bytes);
    FrameHeader::from_attachment(attachment.as_deref()).expect("clients send headers")
}

/// Replies these bytes.
pub fn reply(query: &Query, bytes: impl Into<ZBytes>) {
    query.reply(query.key_expr(), bytes).wait().expect("the session is open");
}

/// Replies a twist.
pub fn reply_twist(query: &Query, twist: TwistMessage) {
    reply(query, twist.encode());
}

/// Replies a JSON body.
pub fn reply_json(query: &Query, message: &impl Serialize) {
    reply(query, body::write(message));
}

/// Refuses.
pub fn refuse(query: &Query, code: ErrorCode, sentence: &str) {
    query.reply_err(body::write(&ErrorReply::new(code, sentence))).wait().expect("the session is open");
}

/// Queries that are neither answered nor dropped.
#[derive(Clone, Default)]
pub struct Held(Arc<Mutex<Vec<Query>>>);

impl Held {
    /// Keeps a query.
    pub fn hold(&self, query: Query) {
        self.0.lock().expect("no panic before").push(query);
    }

    /// Gives all of them back.
    pub fn release(&self) -> Vec<Query> {
        std::mem::take(&mut self.0.lock().expect("no panic before"))
    }
}

/// Waits until `condition` holds. Panics after [`LIMIT`].
pub async fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let check = async {
        while !condition() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    tokio::time::timeout(LIMIT, check).await.unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"));
}
