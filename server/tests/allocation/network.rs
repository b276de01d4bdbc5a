//! The same over Zenoh: a twist against an echo of as many bytes, each counted with all that Zenoh itself allocates on both sides.

use std::time::{Duration, Instant};

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat, RAW, Secret};
use domvs_proto::keys::Keys;
use domvs_proto::messages::CreateReply;
use domvs_proto::settings::{Depth, TaskSettings};
use domvs_proto::twist::TwistMessage;
use domvs_server::{ServerConfig, Service};
use zenoh::bytes::ZBytes;
use zenoh::query::{ConsolidationMode, Querier, QueryTarget};
use zenoh::{Config, Session, Wait};

use crate::allocations;
use crate::pictures::{in_packets, picture, settings};

const SIZE: [u32; 2] = [320, 240];
const LIMIT: Duration = Duration::from_secs(20);
/// Questions before the counted ones, and those.
const FIRST: usize = 20;
const COUNTED: usize = 150;
/// Zenoh's own allocations differ by a few with the time between packets and the thread that answers.
const TIMING: usize = 4;

#[tokio::main(flavor = "multi_thread", worker_threads = 1)]
pub async fn a_twist_allocates_no_more_than_an_echo() {
    let (server, endpoint) = listening().await;
    let _echo = server
        .declare_queryable("echo")
        .complete(true)
        .callback(|query| query.reply("echo", [0u8; 128]).wait().expect("somebody asked"))
        .await
        .expect("a fine key");
    // A worker answers for the keys that no task has, too, and Zenoh hands it its share of every query.
    let _unclaimed = server.declare_queryable("echo/**").complete(false).callback(drop).await.expect("a fine key");
    let service = Service::start(ServerConfig::default(), server).await.expect("the worker starts");
    let session = zenoh::open(client(&endpoint)).await.expect("the server is there");
    let asked = asked(&session, service.worker().as_str()).await;

    let queriers = [querier(&session, "echo".into()).await, querier(&session, asked.key.clone()).await];
    let [echo, twist] = least_allocations(&queriers, &asked);
    println!("allocations from question to answer, both ends and Zenoh: twist {twist}, echo {echo}");
    assert!(twist <= echo + TIMING, "a twist {twist}, an echo {echo}");
    session.close().await.expect("it closes");
    service.shutdown().await;
}

/// A task that has been started, and what to ask it.
struct Asked {
    key: String,
    secret: Secret,
    frame: (FrameHeader, ZBytes),
}

async fn asked(session: &Session, worker: &str) -> Asked {
    let keys = Keys::default();
    let settings = TaskSettings { depth: Depth::ConstantM(1.0), ..settings(SIZE[0], SIZE[1]) };
    let settings = TaskSettings { lease: domvs_proto::settings::Lease::None, ..settings };
    let create = keys.create(&worker.try_into().expect("a name"), &"counter".try_into().expect("a name"));
    let body = serde_json::to_vec(&settings).expect("settings are JSON");
    let CreateReply { task, secret, .. } =
        serde_json::from_slice(&answer(session, create, body, vec![]).await).expect("a task");
    let (header, target) = picture(PixelFormat::Mono8, DepthFormat::None, SIZE, 0);
    let header = FrameHeader { secret: Some(secret.clone()), ..header };
    answer(session, keys.target(&task), target.to_bytes().into_owned(), header.encode()).await;
    answer(session, keys.control(&task), br#"{"do": "start"}"#.to_vec(), secret.as_bytes().to_vec()).await;
    Asked { key: keys.twist(&task), secret, frame: picture(PixelFormat::Mono8, DepthFormat::None, SIZE, 1) }
}

/// The one answer; asked anew while nobody is there yet.
async fn answer(session: &Session, key: String, payload: Vec<u8>, attachment: Vec<u8>) -> Vec<u8> {
    let begin = Instant::now();
    while begin.elapsed() < LIMIT {
        let replies = session.get(&key).payload(payload.clone()).encoding(RAW).attachment(attachment.clone());
        let replies = replies.timeout(LIMIT).await.expect("the session is open");
        if let Ok(reply) = replies.recv_async().await {
            let sample = reply.into_result().unwrap_or_else(|error| panic!("{key}: {:?}", error.payload()));
            return sample.payload().to_bytes().into_owned();
        }
        tokio::task::yield_now().await;
    }
    panic!("nobody answers on {key}");
}

async fn querier(session: &Session, key: String) -> Querier<'static> {
    let querier = session
        .declare_querier(key)
        .target(QueryTarget::BestMatching)
        .consolidation(ConsolidationMode::None)
        .timeout(LIMIT)
        .await
        .expect("a fine key");
    let begin = Instant::now();
    while !querier.matching_status().await.expect("open").matching() {
        assert!(begin.elapsed() < LIMIT, "nobody is there");
        tokio::task::yield_now().await;
    }
    querier
}

/// Of each, asked in turns: the least of all, for now and then a status, a lease or a buffer that grows comes between.
fn least_allocations(queriers: &[Querier<'_>; 2], asked: &Asked) -> [usize; 2] {
    let header = FrameHeader { secret: Some(asked.secret.clone()), ..asked.frame.0.clone() };
    let attachment = in_packets(&header.encode());
    let mut least = [usize::MAX; 2];
    for number in 0..FIRST + COUNTED {
        for (least, querier) in least.iter_mut().zip(queriers) {
            let (count, last) = allocations(|| ask(querier, &asked.frame.1, &attachment));
            if querier.key_expr().as_str() != "echo" {
                assert!(TwistMessage::decode(&last).expect("a twist").is_servoing());
            }
            if number >= FIRST {
                *least = count.min(*least);
            }
        }
    }
    least
}

/// Asks, and waits until Zenoh says that no more answers come.
fn ask(querier: &Querier<'_>, payload: &ZBytes, attachment: &ZBytes) -> [u8; 128] {
    let question = querier.get().payload(payload.clone()).encoding(RAW).attachment(attachment.clone());
    let replies = question.wait().expect("the session is open");
    let mut last = [0; 128];
    while let Ok(reply) = replies.recv() {
        let sample = reply.into_result().expect("no error");
        last.copy_from_slice(&sample.payload().to_bytes());
    }
    last
}

/// A peer on a free port of the loopback.
async fn listening() -> (Session, String) {
    let session = zenoh::open(config("peer", "listen/endpoints", "tcp/127.0.0.1:0")).await.expect("a free port");
    let locator = session.info().locators().await.first().expect("it listens").to_string();
    (session, locator)
}

fn client(endpoint: &str) -> Config {
    config("client", "connect/endpoints", endpoint)
}

fn config(mode: &str, endpoints: &str, endpoint: &str) -> Config {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        (endpoints, format!("[{endpoint:?}]")),
        ("scouting/multicast/enabled", "false".into()),
        ("scouting/gossip/enabled", "false".into()),
        ("scouting/delay", "0".into()),
    ] {
        config.insert_json5(key, &value).expect("a known key");
    }
    config
}
