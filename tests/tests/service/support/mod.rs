//! What every test stands on: a router of its own, a worker in a session of its own, pictures of a true scene, and
//! waits that are on a condition and have a limit.

#[macro_use]
mod alone;
mod deaf;
mod following;
mod lab;
mod pictures;
mod questions;

use std::net::TcpListener;
use std::time::Duration;

pub use domvs_client::{Client, ClientError, ClientOptions, OutgoingFrame, Task};
pub use domvs_proto::keys::{Keys, Name, TaskKey};
pub use domvs_proto::messages::ErrorCode;
pub use domvs_proto::settings::TaskSettings;
pub use domvs_proto::status::Status;
pub use domvs_proto::twist::TwistMessage;
use domvs_server::session::prepared;
use domvs_server::{ServerConfig, Service};
use zenoh::{Config, Session};

pub use alone::{alone, holds_alone};
pub use deaf::DeafLink;
pub use following::{Following, next_status, push};
pub use lab::{Lab, config as lab_config, ear, is_let_in, plan as lab_plan, router as lab_router};
pub use pictures::{Scene, exact, gray8, jpeg, png};
pub use questions::{Answer, Question, code};

/// Longer than anything here takes on a busy machine of two cores; nothing waits for it when all is well.
pub const LIMIT: Duration = Duration::from_secs(20);
/// The worker's name in every test.
pub const WORKER: &str = "w1";
/// What every status but servoing comes with.
pub const ZEROS: [f64; 6] = [0.0; 6];

/// A router and a worker.
pub struct Stage {
    pub service: Service,
    /// The worker's own: closing it takes the worker away as a kill does, without a last word.
    pub session: Session,
    pub keys: Keys,
    router: Session,
    endpoint: String,
}

impl Stage {
    /// A worker with the defaults.
    pub async fn open() -> Stage {
        Stage::with(ServerConfig::default()).await
    }

    /// A worker with this configuration, but for its name.
    pub async fn with(config: ServerConfig) -> Stage {
        let (router, endpoint) = router().await;
        let joined = prepared(client_config(&endpoint), config.limits.bytes_per_payload);
        let joined = joined.expect("a fine configuration");
        let session = zenoh::open(joined).await.expect("the router is there");
        let config = ServerConfig { worker: WORKER.into(), ..config }.checked().expect("a fine configuration");
        let service = Service::start(config, session.clone()).await.expect("the worker starts");
        Stage { service, session, keys: Keys::default(), router, endpoint }
    }

    /// How to reach the router.
    pub fn config(&self) -> Config {
        client_config(&self.endpoint)
    }

    /// A way to the router that can turn deaf, and a client on it.
    pub async fn deaf_client(&self, name: &str) -> (DeafLink, Client) {
        let link = DeafLink::to(&self.endpoint);
        let options = ClientOptions { zenoh: client_config(&link.endpoint), ..self.options(name) };
        (link, Client::connect(options).await.expect("the router is there"))
    }

    /// A session of somebody who is not a client of this project.
    pub async fn stranger(&self) -> Session {
        zenoh::open(self.config()).await.expect("the router is there")
    }

    /// A client in a session of its own, with the patience of the tests.
    pub async fn client(&self, name: &str) -> Client {
        Client::connect(self.options(name)).await.expect("the router is there")
    }

    fn options(&self, name: &str) -> ClientOptions {
        ClientOptions {
            zenoh: self.config(),
            connect_limit: LIMIT,
            discovery_limit: LIMIT,
            request_timeout: LIMIT,
            twist_timeout: LIMIT,
            ..ClientOptions::named(name).expect("a fine name")
        }
    }

    /// The worker ends in order, then the router.
    pub async fn close(self) {
        self.service.shutdown().await;
        self.router.close().await.expect("the router closes");
    }
}

/// A task with its target set and started.
pub async fn started(client: &Client, settings: &TaskSettings, target: &OutgoingFrame) -> Task {
    let task = client.create_task(settings).await.expect("created");
    assert_eq!(task.set_target(target).await.expect("set"), Status::Ready);
    task.start().await.expect("started");
    task
}

/// The same, or a panic that says what did not come in time.
pub async fn in_time<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(LIMIT, future).await.unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"))
}

/// The word of a refusal, or a panic with what came instead.
pub fn refusal<T: std::fmt::Debug>(result: Result<T, ClientError>) -> (ErrorCode, String) {
    match result {
        Err(ClientError::Refused { code, error, .. }) => (code, error),
        other => panic!("expected a refusal, got {other:?}"),
    }
}

/// Waits until nobody knows the task any more; the question needs no secret to be told so.
pub async fn becomes_unknown(stage: &Stage, session: &Session, key: &TaskKey) {
    let question = Question::on(stage.keys.control(key)).with(r#"{"do": "stop"}"#);
    let closed = |answer: &Answer| matches!(answer, Answer::Refused(error) if error.code == ErrorCode::UnknownTask);
    // While its keys are taken away one by one, the task and the worker may both answer.
    in_time("the closed task is unknown", async { while !question.ask_all(session).await.iter().any(closed) {} }).await;
}

pub fn name(text: &str) -> Name {
    text.try_into().expect("a fine name")
}

/// A router on a free loopback port; on another one when somebody was faster.
async fn router() -> (Session, String) {
    for _ in 0..20 {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
        if let Ok(session) = zenoh::open(router_config(&endpoint)).await {
            return (session, endpoint);
        }
    }
    panic!("no free port in 20 tries");
}

/// A port that nobody has at this moment.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("loopback").port()
}

fn router_config(endpoint: &str) -> Config {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", r#""router""#.to_owned()),
        ("listen/endpoints", format!("[{endpoint:?}]")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("scouting/delay", "0".to_owned()),
        // As the shipped router has them.
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "20000".to_owned()),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", "1000000".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a known key");
    }
    config
}

fn client_config(endpoint: &str) -> Config {
    domvs_client::zenoh_config(None, &[endpoint.to_owned()]).expect("an endpoint")
}
