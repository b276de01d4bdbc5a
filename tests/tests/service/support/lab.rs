//! A lab behind the shipped TLS configurations: a router, a worker, and members whose files `domvs certs` would write.

use std::path::Path;

use domvs::certs::{self, Existing, Members, Plan, Role};
use domvs_server::{ServerConfig, Service};
use flume::Receiver;
use tempfile::TempDir;
use zenoh::sample::{Locality, Sample};
use zenoh::{Config, Session};

use super::{Client, ClientOptions, Keys, LIMIT, WORKER, free_port, name};

/// Who takes part.
const MEMBERS: [(&str, Role); 6] = [
    ("service", Role::Service),
    ("alice", Role::Client),
    ("bob", Role::Client),
    ("viewer", Role::Viewer),
    ("robot", Role::Robot),
    ("front", Role::Camera),
];

/// Router and worker, joined by TLS, under the shipped access control.
pub struct Lab {
    pub service: Service,
    pub keys: Keys,
    pub endpoint: String,
    pub folder: TempDir,
    router: Session,
}

impl Lab {
    pub async fn open() -> Lab {
        let folder = tempfile::tempdir().expect("a folder");
        certs::make(&plan(folder.path(), &MEMBERS)).expect("made");
        let (router, endpoint) = router(folder.path(), &[]).await;
        let session = zenoh::open(config(folder.path(), "service", &endpoint)).await.expect("the router lets it in");
        let worker = ServerConfig { worker: WORKER.into(), ..ServerConfig::default() }.checked().expect("fine");
        let service = Service::start(worker, session).await.expect("the worker starts");
        Lab { service, keys: Keys::default(), endpoint, folder, router }
    }

    /// The file of a member, as it is, with this test's port.
    pub fn config(&self, member: &str) -> Config {
        config(self.folder.path(), member, &self.endpoint)
    }

    /// A member's session.
    pub async fn session(&self, member: &str) -> Session {
        zenoh::open(self.config(member)).await.expect("the router lets it in")
    }

    /// A member as a client of that name, with the patience of the tests.
    pub async fn client(&self, member: &str) -> Client {
        let options = ClientOptions {
            zenoh: self.config(member),
            connect_limit: LIMIT,
            discovery_limit: LIMIT,
            request_timeout: LIMIT,
            twist_timeout: LIMIT,
            ..ClientOptions::named(member).expect("a fine name")
        };
        Client::connect(options).await.expect("the router lets it in")
    }

    pub async fn close(self) {
        self.service.shutdown().await;
        self.router.close().await.expect("the router closes");
    }
}

/// A plan of these members in this folder.
pub fn plan(folder: &Path, members: &[(&str, Role)]) -> Plan {
    let mut all = Members::new();
    for (member, role) in members {
        all.entry(name(member)).or_default().insert(*role);
    }
    let hosts = vec!["127.0.0.1".into()];
    Plan { folder: folder.into(), at: folder.into(), hosts, days: 2, existing: Existing::Refuse, members: all }
}

/// The shipped router on a free port; on another one when somebody was faster.
pub async fn router(folder: &Path, changes: &[(&str, &str)]) -> (Session, String) {
    for _ in 0..20 {
        let endpoint = format!("tls/127.0.0.1:{}", free_port());
        let mut config = Config::from_file(folder.join("router.json5")).expect("Zenoh reads it");
        config.insert_json5("listen/endpoints", &format!("[{endpoint:?}]")).expect("a known key");
        for (key, value) in changes {
            config.insert_json5(key, value).expect("a known key");
        }
        if let Ok(session) = zenoh::open(config).await {
            return (session, endpoint);
        }
    }
    panic!("no free port in 20 tries");
}

/// The shipped file of a member with this endpoint.
pub fn config(folder: &Path, member: &str, endpoint: &str) -> Config {
    domvs_client::zenoh_config(Some(&folder.join(format!("{member}.json5"))), &[endpoint.to_owned()])
        .expect("Zenoh reads it")
}

/// Whether the router lets somebody in, by one attempt.
pub async fn is_let_in(mut config: Config) -> bool {
    for (key, value) in [("connect/timeout_ms", "0"), ("connect/exit_on_failure", "true")] {
        config.insert_json5(key, value).expect("a known key");
    }
    match zenoh::open(config).await {
        Ok(session) => {
            // The verdict on the password may still be on its way to this side.
            let inside = session.info().routers_zid().await.next().is_some();
            session.close().await.expect("it closes");
            inside
        }
        Err(_) => false,
    }
}

/// Everything that others say on a key.
pub async fn ear(session: &Session, key: &str) -> Receiver<Sample> {
    let (hand_over, heard) = flume::unbounded();
    // Nobody may listen any more.
    let hear = move |sample| drop(hand_over.send(sample));
    session
        .declare_subscriber(key.to_owned())
        .allowed_origin(Locality::Remote)
        .callback(hear)
        .background()
        .await
        .expect("a fine key");
    heard
}
