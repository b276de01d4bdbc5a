//! A worker alone in a session of its own: what it takes over, what it hands over, and what it refuses.

use domvs_proto::frame::Secret;
use domvs_proto::keys::TaskKey;
use domvs_proto::messages::{Phase, Progress};
use domvs_proto::settings::{Camera, Lease, TaskSettings};

use super::*;
use crate::ownership::SecretCheck;
use crate::registrar::{Adoption, Seed, decode_limits};
use crate::task::Task;

const LIMIT: Duration = Duration::from_secs(20);
const EPOCH: u32 = 2 << 16;

async fn worker() -> Worker {
    let mut config = zenoh::Config::default();
    for (key, value) in [("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]")] {
        config.insert_json5(key, value).expect("a known key");
    }
    let session = zenoh::open(config).await.expect("it needs nobody");
    let config = ServerConfig { worker: "w1".to_owned(), ..ServerConfig::default() };
    let metrics = Arc::new(Metrics::new().expect("metrics"));
    Worker::start(config, session, vec![], None, metrics).await.expect("it starts")
}

fn task(id: &str) -> TaskKey {
    format!("alice/{id}").parse().expect("a task")
}

/// A task of another worker in this phase, that hangs on no token.
fn adoption(shared: &Shared, id: &str, phase: Phase, stops_since: Moment) -> Job {
    let camera = Camera { fx: 9.0, fy: 9.0, cx: 3.5, cy: 3.5, width: 8, height: 8, distortion: None };
    let settings = TaskSettings { lease: Lease::None, ..TaskSettings::new(camera) };
    let mut made = Task::new(settings, decode_limits(shared));
    let progress = Progress { phase, ..made.progress(Status::WaitingTarget) };
    made.go_on(&progress);
    let [secret, frame_secret] = [1, 2].map(|byte| SecretCheck::of(Secret::new([byte; 16])));
    let seed = Seed { key: task(id), epoch: EPOCH, secret, frame_secret, task: made, stops_since };
    Job::Adopt(Box::new(Adoption { seed, progress, lost: shared.now() }))
}

async fn until(what: &str, condition: impl Fn() -> bool) {
    let waiting = async {
        while !condition() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(LIMIT, waiting).await.unwrap_or_else(|_| panic!("never: {what}"));
}

fn desk(shared: &Shared, id: &str) -> Option<Arc<Desk>> {
    lock(&shared.desks).get(&task(id).to_string()).cloned()
}

/// Takes the task over, and waits until it is here.
async fn adopted(shared: &Shared, id: &str, phase: Phase, stops_since: Moment) -> Arc<Desk> {
    assert!(shared.give(adoption(shared, id, phase, stops_since)));
    until("the task is here", || desk(shared, id).is_some()).await;
    desk(shared, id).expect("it is here")
}

fn phase(desk: &Desk) -> Phase {
    lock(&desk.task).life.phase()
}

const STOPPED: Phase = Phase::Latched(Status::Stopped);

#[tokio::test(flavor = "multi_thread")]
async fn a_task_whose_owner_may_have_missed_a_stop_for_all_comes_stopped() {
    let worker = worker().await;
    let shared = Arc::clone(&worker.shared);
    shared.stop_all();
    let stopped = adopted(&shared, "missed", Phase::Running, Moment::ZERO).await;
    assert_eq!(phase(&stopped), STOPPED);
    let later = shared.now() + Duration::from_nanos(1);
    let obeyed = adopted(&shared, "obeyed", Phase::Running, later).await;
    assert_eq!(phase(&obeyed), Phase::Running, "its owner spoke after the stop");
    let paused = adopted(&shared, "paused", Phase::Latched(Status::Paused), Moment::ZERO).await;
    assert_eq!(phase(&paused), Phase::Latched(Status::Paused), "it stands already");
    worker.shutdown(async {}).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_halt_that_still_waits_is_handed_over() {
    for status in [Status::Stopped, Status::ClientLost] {
        let worker = worker().await;
        let running = adopted(&worker.shared, "t1", Phase::Running, Moment::ZERO).await;
        running.request_halt(status);
        let carried = worker.shutdown(async {}).await;
        assert_eq!(carried[0].state.progress.phase, Phase::Latched(status));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_for_all_heard_by_a_session_that_closes_holds_in_the_next() {
    let worker = worker().await;
    let shared = Arc::clone(&worker.shared);
    adopted(&shared, "t1", Phase::Running, Moment::ZERO).await;
    let carried = worker.shutdown(async move { shared.stop_all() }).await;
    assert_eq!(carried[0].state.progress.phase, STOPPED);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_takeover_gives_way_to_an_owner_whose_token_came_before() {
    let worker = worker().await;
    let shared = Arc::clone(&worker.shared);
    let rival = "w2".try_into().expect("a name");
    // Older or newer, it is there: neither is a reason to have two.
    for (id, epoch) in [("older", EPOCH - 1), ("newer", EPOCH + 1)] {
        let token = shared.keys.owner(&task(id), &rival, epoch);
        let token = shared.session.liveliness().declare_token(token).await.expect("declared");
        until("the token is heard", || shared.inbox.newest_owner(&task(id)).is_some()).await;
        assert!(shared.give(adoption(&shared, id, Phase::Running, Moment::ZERO)));
        // The registrar does one after the other.
        let after = format!("after-{id}");
        adopted(&shared, &after, Phase::Running, Moment::ZERO).await;
        assert!(desk(&shared, id).is_none(), "{id}");
        drop(token);
    }
    worker.shutdown(async {}).await;
}

/// Asks for a task and returns the refusal.
async fn refused(shared: &Shared) -> ErrorReply {
    let key = shared.keys.create(&shared.worker, &"bob".try_into().expect("a name"));
    let answers = shared.session.get(key).await.expect("asked");
    let answer = answers.recv_async().await.expect("an answer").into_result().expect_err("a refusal");
    domvs_proto::body::read(&answer.payload().to_bytes()).expect("an error body")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_without_keys_renews_its_session_if_no_task_runs_and_keeps_their_phases() {
    let worker = worker().await;
    let shared = Arc::clone(&worker.shared);
    let running = adopted(&shared, "running", Phase::Running, Moment::ZERO).await;
    let [idle, paused] = [Phase::Idle, Phase::Latched(Status::Paused)];
    adopted(&shared, "idle", idle, Moment::ZERO).await;
    adopted(&shared, "paused", paused, Moment::ZERO).await;
    (0..70_000).for_each(|number| shared.spent.add(&number.to_string()));
    assert_eq!(refused(&shared).await.code, ErrorCode::Quota);
    tokio::select! {
        biased;
        () = worker.fenced() => panic!("a task runs"),
        () = std::future::ready(()) => {}
    }
    running.request_halt(Status::Stopped);
    until("it stands", || lock(&running.board).progress().is_some_and(|progress| progress.phase == STOPPED)).await;
    assert_eq!(refused(&shared).await.code, ErrorCode::Quota);
    tokio::time::timeout(LIMIT, worker.fenced()).await.expect("no task runs");
    let mut carried = worker.shutdown(async {}).await;
    carried.sort_by(|one, other| one.state.task.cmp(&other.state.task));
    let phases: Vec<_> = carried.iter().map(|carried| carried.state.progress.phase).collect();
    assert_eq!(phases, [idle, paused, STOPPED]);
}
