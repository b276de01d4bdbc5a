//! What is seen from outside: the metrics page, the worker's info, and that the two agree with what was sent.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

use domvs_proto::settings::Frames;
use domvs_server::ServerConfig;

use crate::support::*;

/// A page by its names with labels.
type Page = BTreeMap<String, f64>;

async fn stage() -> (Stage, SocketAddr) {
    let stage = Stage::with(ServerConfig { metrics: "127.0.0.1:0".into(), ..ServerConfig::default() }).await;
    let address = stage.service.metrics_address().expect("it listens");
    (stage, address)
}

/// Status line and body of an answer over HTTP; `request` is sent as it is.
async fn http(address: SocketAddr, request: String) -> (String, String) {
    let asked = tokio::task::spawn_blocking(move || {
        let mut stream = TcpStream::connect(address).expect("it listens");
        stream.set_read_timeout(Some(LIMIT)).expect("a fine limit");
        stream.write_all(request.as_bytes()).expect("it reads");
        let mut answer = Vec::new();
        // A refused request may end in a reset behind its answer.
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8(answer).expect("text")
    });
    let answer = in_time("the answer", asked).await.expect("no panic");
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    (head.lines().next().unwrap_or_default().to_owned(), body.to_owned())
}

async fn get(address: SocketAddr, path: &str) -> (String, String) {
    http(address, format!("GET {path} HTTP/1.1\r\nHost: domvs\r\n\r\n")).await
}

async fn page(address: SocketAddr) -> Page {
    let (status, body) = get(address, "/metrics").await;
    assert_eq!(status, "HTTP/1.1 200 OK");
    read(&body)
}

fn read(body: &str) -> Page {
    let values = body.lines().filter(|line| !line.starts_with('#')).map(|line| {
        let (name, value) = line.rsplit_once(' ').expect("a name and a value");
        (name.to_owned(), value.parse().expect("a number"))
    });
    values.collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_counts_what_was_sent_and_answered_and_info_says_the_same() {
    let (stage, address) = stage().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    for sequence in 1..=3 {
        assert!(task.twist(&scene.frame(sequence)).await.expect("answered").is_servoing());
    }
    let wrong_size = OutgoingFrame::mono8(8, 8, vec![7; 64]).expect("64 pixels").numbered(4, 0);
    assert_eq!(task.twist(&wrong_size).await.expect("answered").status, Status::BadFrame);
    let stranger = client.attach(task.key().clone(), Some(domvs_proto::frame::Secret::new([9; 16]))).await;
    let stranger = stranger.expect("the task is there");
    assert_eq!(refusal(stranger.stop().await).0, ErrorCode::NotOwner);

    let page = page(address).await;
    let of = |name: &str| *page.get(name).unwrap_or_else(|| panic!("{name} is not on the page: {page:?}"));
    assert_eq!(of(r#"domvs_frames_received_total{route="requested"}"#), 4.0);
    assert_eq!(of(r#"domvs_answers_total{route="requested",status="servoing"}"#), 3.0);
    assert_eq!(of(r#"domvs_answers_total{route="requested",status="bad_frame"}"#), 1.0);
    assert_eq!(of(r#"domvs_frames_dropped_total{reason="bad"}"#), 1.0);
    assert_eq!(of(r#"domvs_refusals_total{code="not_owner"}"#), 1.0);
    assert_eq!(of(r#"domvs_requests_total{key="create"}"#), 1.0);
    assert_eq!(of(r#"domvs_requests_total{key="twist"}"#), 4.0);
    assert_eq!(of(r#"domvs_frame_total_seconds_count{route="requested"}"#), 4.0);
    assert_eq!(of("domvs_frame_compute_seconds_count"), 4.0);
    assert_eq!(of(r#"domvs_tasks{status="bad_frame"}"#), 1.0);
    assert_eq!((of("domvs_clients"), of("domvs_tasks_created_total"), of("domvs_panics_total")), (1.0, 1.0, 0.0));
    assert!(of("domvs_epoch_max") > 0.0 && of("domvs_frame_bytes_received_total") > 4.0 * 64.0);
    let info = client.list_workers().await.expect("answered").remove(0);
    assert_eq!((info.counts.frames_in, info.counts.twists, info.counts.zeros, info.counts.refusals), (4, 3, 1, 1));
    assert_eq!((info.clients, info.counts.frames_dropped.bad, info.recorder_dropped), (1, 1, 0));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_pushed_frame_is_answered_or_dropped_by_a_reason_and_the_watchdog_is_counted() {
    let (stage, address) = stage().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    assert!(push(&task, &following, &scene.frame(1)).await.is_servoing());
    for sequence in 2..40 {
        task.push(&scene.frame(sequence)).await.expect("sent");
    }
    // The last frames are answered, then no more come and the watchdog brakes.
    following.until("the watchdog's zeros", |message| message.status == Status::WaitingFrame).await;

    let page = page(address).await;
    let sum = |start: &str| page.iter().filter(|(name, _)| name.starts_with(start)).map(|(_, n)| n).sum::<f64>();
    let received = sum(r#"domvs_frames_received_total{route="pushed""#);
    let answered = sum(r#"domvs_answers_total{route="pushed""#);
    let unanswered = ["superseded", "stood_still"];
    let unanswered = unanswered.map(|reason| sum(&format!("domvs_frames_dropped_total{{reason=\"{reason}\"")));
    assert!(received > 1.0);
    assert_eq!(received, answered + unanswered.iter().sum::<f64>(), "{page:?}");
    assert!(page["domvs_watchdog_brakes_total"] >= 1.0);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn names_that_clients_choose_and_secrets_are_not_on_the_page() {
    let (stage, address) = stage().await;
    let client = stage.client("mallory-the-first").await;
    let scene = Scene::small("coffee");
    let task = client.create_task(&scene.settings()).await.expect("created");
    let (_, before) = get(address, "/metrics").await;
    assert!(!before.contains("mallory") && !before.contains(task.key().id.as_str()), "{before}");
    task.close().await.expect("closed");
    let (_, after) = get(address, "/metrics").await;
    let series = |page: &str| page.lines().filter(|line| !line.starts_with('#')).count();
    assert_eq!(series(&before), series(&after), "tasks and clients come and go, the page keeps its length");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_get_of_two_paths_is_answered() {
    let (stage, address) = stage().await;
    assert_eq!(get(address, "/healthz").await, ("HTTP/1.1 200 OK".into(), "ok\n".into()));
    assert_eq!(get(address, "/").await.0, "HTTP/1.1 404 Not Found");
    assert_eq!(get(address, "/../etc/passwd").await.0, "HTTP/1.1 404 Not Found");
    let posted = http(address, "POST /metrics HTTP/1.1\r\nHost: domvs\r\nContent-Length: 0\r\n\r\n".into()).await;
    assert_eq!(posted.0, "HTTP/1.1 405 Method Not Allowed");
    let endless = format!("GET /metrics HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(200_000));
    assert!(!http(address, endless).await.0.contains("200"), "a header has a limit");
    assert!(!http(address, "\0\u{1}\u{2} nonsense\r\n\r\n".into()).await.0.contains("200"));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_that_say_nothing_are_sent_away_and_then_others_are_answered() {
    let (stage, address) = stage().await;
    // More than there is room for; the kernel takes all of them.
    let silent: Vec<TcpStream> = (0..40).map(|_| TcpStream::connect(address).expect("a connection")).collect();
    in_time("room again", async { while get(address, "/healthz").await.0 != "HTTP/1.1 200 OK" {} }).await;
    let ended = tokio::task::spawn_blocking(move || {
        silent.into_iter().all(|mut stream| {
            stream.set_read_timeout(Some(LIMIT)).expect("a fine limit");
            // The end of the stream or a reset, with or without a word before; what does not end is an error of time.
            let mut rest = Vec::new();
            match stream.read_to_end(&mut rest) {
                Ok(_) => true,
                Err(error) => error.kind() == std::io::ErrorKind::ConnectionReset,
            }
        })
    });
    assert!(in_time("every silent reader is sent away", ended).await.expect("no panic"));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_taken_address_is_an_error_that_names_it_and_without_one_nobody_listens() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = taken.local_addr().expect("bound");
    let stage = Stage::open().await;
    assert_eq!(stage.service.metrics_address(), None);
    let config = ServerConfig { metrics: address.to_string(), ..ServerConfig::default() };
    let refused = domvs_server::Service::start(config, stage.stranger().await).await;
    let error = refused.err().expect("refused").to_string();
    assert!(error.contains(&address.to_string()), "{error}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_and_its_counts_outlive_a_session_that_the_worker_had_to_leave() {
    let (stage, address) = stage().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    let other = client.create_task(&scene.settings()).await.expect("created");

    // Somebody else has one of the tasks now: the worker leaves its session and comes back with the other.
    let rival = stage.stranger().await;
    let token = stage.keys.owner(other.key(), &name("rival"), other.epoch() + (1 << 16));
    let _token = rival.liveliness().declare_token(token).await.expect("declared");
    let page = in_time("the next session", async {
        loop {
            let (status, body) = get(address, "/metrics").await;
            // Between two sessions there is no worker whose page it could be.
            if status == "HTTP/1.1 200 OK" && read(&body)["domvs_tasks_taken_over_total"] == 1.0 {
                break read(&body);
            }
        }
    })
    .await;
    assert_eq!(page["domvs_tasks_superseded_total"], 1.0);
    assert_eq!(page["domvs_tasks_created_total"], 2.0);
    assert_eq!(page[r#"domvs_answers_total{route="requested",status="servoing"}"#], 1.0);
    stage.close().await;
}
