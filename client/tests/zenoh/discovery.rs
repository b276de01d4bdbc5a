//! Connecting, finding workers and tasks, the lease, stopping everything.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use domvs_client::{Client, ClientError, ClientOptions, Secret, Status};
use domvs_proto::body;
use domvs_proto::messages::{ErrorCode, StatusMessage};

use crate::fake::{EPOCH, Fake, Held, LIMIT, SECRET, free_endpoint, name, options, refuse, settings, task_key, until};

const SHORT: Duration = Duration::from_millis(200);

#[tokio::test(flavor = "multi_thread")]
async fn connecting_to_nothing_ends_at_its_limit_and_names_the_endpoint() {
    let endpoint = free_endpoint();
    let refused = Client::connect(ClientOptions { connect_limit: SHORT, ..options(&endpoint) }).await;
    let error = refused.err().expect("nothing listens there");
    assert!(matches!(error, ClientError::Connect { waited: SHORT, .. }), "{error}");
    let sentence = error.to_string();
    assert!(sentence.contains(&endpoint) && !sentence.contains(".rs:"), "{sentence}");
}

#[tokio::test(flavor = "multi_thread")]
async fn connecting_waits_for_a_router_that_comes_later() {
    let endpoint = free_endpoint();
    let connecting = tokio::spawn(Client::connect(options(&endpoint)));
    tokio::task::yield_now().await;
    let _fake = Fake::start_at(&endpoint).await.expect("the port is still free");
    connecting.await.expect("no panic").expect("connected");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_lease_begins_with_the_client_and_ends_with_its_last_handle() {
    let fake = Fake::start().await;
    let (changed, changes) = flume::bounded(8);
    let lease = fake.session.liveliness().declare_subscriber(fake.keys.client_alive(&name("alice")));
    let _lease = lease.callback(move |sample| changed.try_send(sample.kind()).expect("room")).await.expect("declared");
    let task = fake.task(LIMIT, |_| {}).await;
    let next = || changes.recv_timeout(LIMIT).expect("a change of the lease");
    assert_eq!(next(), zenoh::sample::SampleKind::Put);
    // The client itself is gone already: the task keeps the lease.
    assert!(changes.is_empty());
    drop(task);
    assert_eq!(next(), zenoh::sample::SampleKind::Delete);
}

#[tokio::test(flavor = "multi_thread")]
async fn workers_are_listed_with_the_least_loaded_first() {
    let fake = Fake::start().await;
    fake.worker("busy", 0.9).await;
    fake.worker("idle", 0.1).await;
    let workers = fake.client(|_| {}).await.list_workers().await.expect("two workers");
    let names: Vec<_> = workers.iter().map(|worker| worker.worker.as_str()).collect();
    assert_eq!(names, ["idle", "busy"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_goes_to_the_least_loaded_worker() {
    let fake = Fake::start().await;
    fake.worker("busy", 0.9).await;
    fake.worker("idle", 0.1).await;
    let client = fake.client(|options| options.request_timeout = SHORT).await;
    let task = client.create_task(&settings()).await.expect("a task");
    assert_eq!((task.key(), task.epoch()), (&task_key("idle"), EPOCH));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_worker_is_passed_over() {
    let fake = Fake::start().await;
    fake.worker("busy", 0.9).await;
    let full = |query| refuse(&query, ErrorCode::Quota, "8 of 8 tasks");
    fake.worker_that_creates("full", 0.1, full).await;
    let client = fake.client(|options| options.request_timeout = SHORT).await;
    let task = client.create_task(&settings()).await.expect("the other worker has room");
    assert_eq!(task.key(), &task_key("busy"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hung_worker_does_not_hide_a_live_one() {
    let fake = Fake::start().await;
    let held = Held::default();
    let holder = held.clone();
    fake.answer(&fake.keys.worker_info(&name("hung")), move |query| holder.hold(query)).await;
    fake.worker("live", 0.5).await;
    let workers = fake.client(|_| {}).await.list_workers().await.expect("one worker answers");
    assert_eq!(workers.len(), 1);
    assert_eq!(held.release().len(), 1, "the hung one was asked too");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_worker_the_error_says_what_to_start() {
    let fake = Fake::start().await;
    let client = fake.client(|options| options.discovery_limit = SHORT).await;
    let error = client.create_task(&settings()).await.expect_err("nobody is there");
    assert!(matches!(error, ClientError::NoWorker { .. }), "{error}");
    assert!(error.to_string().contains("domvs serve"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn settings_out_of_range_are_refused_before_anything_is_sent() {
    let fake = Fake::start().await;
    let bad = domvs_client::TaskSettings { epsilon: -1.0, ..settings() };
    let error = fake.client(|_| {}).await.create_task(&bad).await.expect_err("out of range");
    assert!(matches!(error, ClientError::Settings(_)), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn tasks_are_listed_with_owner_and_status() {
    let fake = Fake::start().await;
    let (silent, talking) = (task_key("silent"), task_key("talking"));
    let mut tokens = Vec::new();
    for (task, epoch) in [(&silent, 1), (&talking, 2), (&talking, 3)] {
        let token = fake.session.liveliness().declare_token(fake.keys.owner(task, &name("w"), epoch));
        tokens.push(token.await.expect("declared"));
    }
    let says = body::write(&StatusMessage::new(talking.clone(), Status::Ready, 3));
    let talker = fake.session.declare_publisher(fake.keys.status(&talking)).await.expect("declared");
    let client = fake.client(|_| {}).await;
    let listing = tokio::spawn(async move { client.list_tasks().await });
    // A real task repeats itself twice a second; this one does until it was heard.
    until("the list is made", || {
        zenoh::Wait::wait(talker.put(says.clone())).expect("published");
        listing.is_finished()
    })
    .await;
    let listed = listing.await.expect("no panic").expect("a list");
    let told: Vec<_> = listed.iter().map(|t| (&t.task, t.epoch, t.status.as_ref().map(|s| s.status))).collect();
    assert_eq!(told, [(&silent, 1, None), (&talking, 3, Some(Status::Ready))]);
}

#[tokio::test(flavor = "multi_thread")]
async fn attaching_finds_the_newest_owner() {
    let fake = Fake::start().await;
    let owner = |epoch| fake.session.liveliness().declare_token(fake.keys.owner(&task_key("w"), &name("w"), epoch));
    let (_old, _new) = (owner(3).await.expect("declared"), owner(9).await.expect("declared"));
    fake.answer(&fake.keys.twist(&task_key("w")), |_| {}).await;
    let client = fake.client(|_| {}).await;
    let task = client.attach(task_key("w"), Some(Secret::new(SECRET))).await.expect("it has an owner");
    assert_eq!(task.epoch(), 9);
}

#[tokio::test(flavor = "multi_thread")]
async fn attaching_to_a_task_without_an_owner_says_so() {
    let fake = Fake::start().await;
    let client = fake.client(|options| options.discovery_limit = SHORT).await;
    let error = client.attach(task_key("w"), None).await.expect_err("no owner");
    assert!(matches!(error, ClientError::NoTask { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_reaches_whoever_listens() {
    let fake = Fake::start().await;
    static HEARD: AtomicU32 = AtomicU32::new(0);
    let listener = fake.session.declare_subscriber(fake.keys.stop()).callback(|_| {
        HEARD.fetch_add(1, Ordering::Relaxed);
    });
    let _listener = listener.await.expect("declared");
    fake.client(|_| {}).await.stop_all().await.expect("somebody listens");
    until("the stop is heard", || HEARD.load(Ordering::Relaxed) > 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_that_nobody_hears_is_an_error() {
    let fake = Fake::start().await;
    let client = fake.client(|options| options.discovery_limit = SHORT).await;
    let error = client.stop_all().await.expect_err("nobody listens");
    assert!(matches!(error, ClientError::NobodyListens { .. }), "{error}");
}
