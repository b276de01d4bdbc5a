//! The life of a task over the network: ready, servoing, paused, stopped, capped, closed; and the end of the worker.

use std::time::{Duration, Instant};

use domvs_proto::settings::{Frames, Gain, Lease, Stop};
use domvs_server::ServerConfig;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;

use crate::support::{
    Answer, Client, ErrorCode, Following, LIMIT, Question, Scene, Stage, Status, TaskSettings, TwistMessage, ZEROS,
    becomes_unknown, in_time, next_status, push, refusal, started,
};

#[tokio::test(flavor = "multi_thread")]
async fn stop_for_all_latches_every_task_until_each_is_started_again() {
    let stage = Stage::open().await;
    let (alice, bob) = (stage.client("alice").await, stage.client("bob").await);
    let mut scene = Scene::small("coffee");
    let target = scene.target();
    let tasks = [
        started(&alice, &scene.settings(), &target).await,
        started(&alice, &scene.settings(), &target).await,
        started(&bob, &scene.settings(), &target).await,
    ];
    let following = Following::on(alice.session(), stage.keys.command(tasks[0].key())).await;
    assert!(push(&tasks[0], &following, &scene.frame(1)).await.is_servoing());

    bob.stop_all().await.expect("the worker listens");
    let (_, stopped) = following.until("stopped on command", |message| message.status == Status::Stopped).await;
    assert_eq!(stopped.twist, ZEROS);
    for (sequence, task) in (10..).zip(&tasks) {
        in_time("stopped", async {
            while task.twist(&scene.frame(sequence)).await.expect("answered").status != Status::Stopped {}
        })
        .await;
        let answer = task.twist(&scene.frame(sequence + 100)).await.expect("answered");
        assert_eq!((answer.status, answer.twist), (Status::Stopped, ZEROS));
    }
    tasks[0].start().await.expect("obeyed");
    assert!(tasks[0].twist(&scene.frame(500)).await.expect("answered").is_servoing());
    assert!(push(&tasks[0], &following, &scene.frame(501)).await.is_servoing());
    let other = tasks[1].twist(&scene.frame(502)).await.expect("answered");
    assert_eq!(other.status, Status::Stopped, "one start starts one task");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_that_waited_behind_a_stop_for_all_lifts_nothing() {
    // One thread, kept busy by somebody else, so that a start waits.
    let stage = Stage::with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let [task, busy] = [
        started(&client, &scene.settings(), &scene.target()).await,
        started(&client, &scene.settings(), &scene.target()).await,
    ];
    let stranger = stage.stranger().await;
    let secret = task.secret().expect("it was created here").as_bytes().to_vec();
    // Until it finds the way.
    Question::on(stage.keys.state(task.key())).ask(&stranger).await;
    for round in 1..=20 {
        for sequence in 0..3 {
            busy.push(&scene.frame(sequence)).await.expect("the session is open");
        }
        // On one way and with one priority: the start arrives first, whenever it is obeyed.
        let start =
            stranger.get(stage.keys.control(task.key())).payload(r#"{"do": "start"}"#).attachment(secret.clone());
        let answers = start.timeout(LIMIT).await.expect("the session is open");
        let stop = stranger.put(stage.keys.stop(), "round").congestion_control(CongestionControl::Block);
        stop.await.expect("the session is open");
        in_time("an answer", answers.recv_async()).await.expect("one answer");
        in_time("stopped", async {
            while task.twist(&scene.frame(100 * round)).await.expect("answered").status != Status::Stopped {}
        })
        .await;
        for sequence in 1..=3 {
            let answer = task.twist(&scene.frame(100 * round + sequence)).await.expect("answered");
            assert_eq!((answer.status, answer.twist), (Status::Stopped, ZEROS), "round {round}");
        }
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pause_resume_stop_and_start_say_what_they_did() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = client.create_task(&scene.settings()).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    assert_eq!(task.pause().await.expect("answered"), Status::Ready, "a pause before the start changes nothing");
    assert_eq!(task.resume().await.expect("answered"), Status::Ready);
    assert_eq!(task.start().await.expect("answered"), Status::WaitingFrame);
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    let before = task.state().await.expect("answered").progress.twists;

    assert_eq!(task.pause().await.expect("answered"), Status::Paused);
    let paused = task.twist(&scene.frame(2)).await.expect("answered");
    assert_eq!((paused.status, paused.twist), (Status::Paused, ZEROS));
    assert_eq!(task.resume().await.expect("answered"), Status::WaitingFrame);
    assert!(task.twist(&scene.frame(3)).await.expect("answered").is_servoing());
    assert_eq!(task.state().await.expect("answered").progress.twists, before + 1, "pause and resume keep the count");

    assert_eq!(task.stop().await.expect("answered"), Status::Stopped);
    let stopped = task.twist(&scene.frame(4)).await.expect("answered");
    assert_eq!((stopped.status, stopped.twist), (Status::Stopped, ZEROS));
    assert_eq!(task.start().await.expect("answered"), Status::WaitingFrame);
    assert_eq!(task.state().await.expect("answered").progress.twists, 0, "start begins anew");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_frames_do_not_unsay_a_latched_status() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut statuses = task.statuses().await.expect("followed");
    assert!(push(&task, &following, &scene.frame(1)).await.is_servoing());
    task.pause().await.expect("obeyed");
    next_status(&mut statuses, "paused", |message| message.status == Status::Paused).await;

    let stranger = stage.stranger().await;
    let frame_key = stage.keys.frame(task.key());
    for payload in [&b"nonsense"[..], &[]] {
        stranger.put(&frame_key, payload).encoding("image/png").await.expect("open");
        stranger.put(&frame_key, payload).attachment(&[9_u8; 48][..]).await.expect("open");
        let question = Question::on(stage.keys.twist(task.key())).with(payload).attached([9_u8; 48]);
        let answer = question.ask(&stranger).await.twist();
        assert_eq!(answer.twist, ZEROS);
    }
    // A stale frame and a late request are refused before anything else, and must not unsay it either.
    let fresh = push(&task, &following, &scene.frame(2).numbered(2, 5_000_000_000)).await;
    let stale = push(&task, &following, &scene.frame(3).numbered(3, 4_000_000_000)).await;
    assert_eq!((fresh.status, stale.status), (Status::Paused, Status::Paused));
    for message in following.drain() {
        assert_eq!((message.status, message.twist), (Status::Paused, ZEROS));
    }
    let mut heard = vec![];
    while let Some(message) = statuses.recv(Duration::ZERO).await {
        heard.push(message.status);
    }
    assert!(heard.iter().all(|status| *status == Status::Paused), "{heard:?}");
    assert_eq!(task.state().await.expect("answered").progress.status, Status::Paused);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn autostart_waits_for_the_first_frame_and_only_for_that() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { autostart: true, ..scene.settings() };
    let task = client.create_task(&settings).await.expect("created");
    assert_eq!(task.twist(&scene.frame(1)).await.expect("answered").status, Status::WaitingTarget);
    assert_eq!(task.set_target(&scene.target()).await.expect("set"), Status::Ready);
    assert!(task.twist(&scene.frame(2)).await.expect("answered").is_servoing());
    task.stop().await.expect("obeyed");
    let stopped = task.twist(&scene.frame(3)).await.expect("answered");
    assert_eq!(stopped.status, Status::Stopped, "a stop is not undone by a frame");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_iteration_cap_ends_a_servoing_and_is_not_called_converged() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let stop = Stop { max_iterations: 3, ..Stop::default() };
    let task = started(&client, &TaskSettings { stop, ..scene.settings() }, &scene.target()).await;
    let mut answers = vec![];
    for sequence in 1..=4 {
        answers.push(task.twist(&scene.frame(sequence)).await.expect("answered"));
    }
    let statuses: Vec<Status> = answers.iter().map(|answer| answer.status).collect();
    assert_eq!(statuses, [Status::Servoing, Status::Servoing, Status::IterationCap, Status::IterationCap]);
    assert_eq!(answers[3].twist, ZEROS);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_moves_the_wrong_way_is_called_diverging() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = scene.settings();
    let task = started(&client, &settings, &scene.target()).await;
    let last = in_time("the end", async {
        for sequence in 1.. {
            let answer = task.twist(&scene.frame(sequence)).await.expect("answered");
            if !answer.is_servoing() {
                return answer;
            }
            scene.simulation.apply(answer.twist.map(|component| -0.5 * component), settings.frame_period_s);
        }
        unreachable!("there are more frames than time")
    })
    .await;
    assert_eq!((last.status, last.twist), (Status::Diverging, ZEROS));
    let latched = task.twist(&scene.frame(10_000)).await.expect("answered");
    assert_eq!(latched.status, Status::Diverging);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_without_a_lease_lives_until_nobody_uses_it() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { lease: Lease::None, idle_close_s: 1, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let (key, secret) = (task.key().clone(), task.secret().cloned());
    drop(task);
    client.close().await.expect("the session closes");
    let other = stage.client("bob").await;
    let task = other.attach(key.clone(), secret).await.expect("it outlives its client");
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    let tokens = tokens(&other, &stage.keys.owners_of(&key)).await;
    let (_, (kind, _)) = in_time("the token that is there", tokens.recv_async()).await.expect("open");
    assert_eq!(kind, SampleKind::Put);
    // What anybody may ask keeps nothing alive.
    let asked = async {
        loop {
            Question::on(stage.keys.state(&key)).ask_all(other.session()).await;
        }
    };
    let (_, (kind, _)) = tokio::select! {
        () = asked => unreachable!("it asks for ever"),
        token = in_time("closed after a second of silence", tokens.recv_async()) => token.expect("open"),
    };
    assert_eq!(kind, SampleKind::Delete);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn closing_a_task_takes_its_keys_away() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let key = task.key().clone();
    let tokens = tokens(&client, "domvs/task/**").await;
    let (_, token) = in_time("the owner's token", tokens.recv_async()).await.expect("open");
    assert_eq!(token, (SampleKind::Put, stage.keys.owner(&key, stage.service.worker(), task.epoch())));
    task.close().await.expect("obeyed");
    let (_, token) = in_time("the token goes", tokens.recv_async()).await.expect("open");
    assert_eq!(token.0, SampleKind::Delete);
    becomes_unknown(&stage, client.session(), &key).await;
    assert!(client.list_tasks().await.expect("answered").is_empty());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_ends_sends_zeros_before_its_tokens_go() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, gain: Some(Gain::PerS(0.2)), ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    assert!(push(&task, &following, &scene.frame(1)).await.is_servoing(), "it moves when the worker ends");
    let tokens = tokens(&client, "domvs/**").await;
    // The worker's and the task's; the client's own, of its name and of its process, are there too and stay.
    for _ in 0..2 {
        next_of_worker(&tokens, SampleKind::Put).await;
    }

    let Stage { service, .. } = stage;
    service.shutdown().await;
    let (zeros_at, zeros): (Instant, TwistMessage) =
        following.until("the last zeros", |message| message.status == Status::OwnerLost).await;
    assert_eq!(zeros.twist, ZEROS);
    for _ in 0..2 {
        let (gone_at, key) = next_of_worker(&tokens, SampleKind::Delete).await;
        assert!(gone_at >= zeros_at, "{key} went before the zeros came");
    }
    assert!(following.drain().is_empty(), "nothing after the last zeros");
}

type Token = (Instant, (SampleKind, String));

/// The next token that comes, or goes, and is no client's.
async fn next_of_worker(tokens: &flume::Receiver<Token>, wanted: SampleKind) -> (Instant, String) {
    let next = async {
        loop {
            let (at, (kind, key)) = tokens.recv_async().await.expect("open");
            if kind == wanted && !key.starts_with("domvs/client/") {
                return (at, key);
            }
        }
    };
    in_time("the tokens of the worker", next).await
}

/// Liveliness tokens as they come and go, those that are there first.
async fn tokens(client: &Client, key: &str) -> flume::Receiver<Token> {
    let (hand_over, tokens) = flume::unbounded();
    client
        .session()
        .liveliness()
        .declare_subscriber(key)
        .history(true)
        .callback(move |sample| {
            let _ = hand_over.send((Instant::now(), (sample.kind(), sample.key_expr().to_string())));
        })
        .background()
        .await
        .expect("a fine key");
    tokens
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_is_let_in_where_other_words_fill_the_queue() {
    let stage = Stage::with(ServerConfig { mailbox_depth: 1, threads: 1, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let mut scene = Scene::new("coffee", [640, 480], [0.0; 6]);
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let secret = task.secret().expect("told once").as_bytes().to_vec();
    let word = |word: &str| {
        Question::on(stage.keys.control(task.key())).with(format!(r#"{{"do": "{word}"}}"#)).attached(&*secret)
    };
    let mut refused = 0;
    for sequence in 1..=30 {
        let frame = scene.frame(sequence);
        // While the one thread computes, one word waits and no more.
        let (pause, resume, stop) = (word("pause"), word("resume"), word("stop"));
        let session = client.session();
        let (_, paused, resumed, stopped) =
            tokio::join!(task.twist(&frame), pause.ask(session), resume.ask(session), stop.ask(session));
        refused += [paused, resumed]
            .iter()
            .filter(|answer| matches!(answer, Answer::Refused(error) if error.code == ErrorCode::Quota))
            .count();
        assert_eq!(stopped.json()["status"], "stopped", "{sequence}");
        in_time("it is stopped", async {
            while task.twist(&scene.frame(100 + sequence)).await.expect("answered").status != Status::Stopped {}
        })
        .await;
        task.start().await.expect("obeyed");
    }
    println!("{refused} other words found no room");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_target_start_alone_is_an_error() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let task = client.create_task(&Scene::small("coffee").settings()).await.expect("created");
    assert_eq!(task.pause().await.expect("it changes nothing"), Status::WaitingTarget);
    assert_eq!(task.resume().await.expect("it changes nothing"), Status::WaitingTarget);
    assert_eq!(refusal(task.start().await).0, ErrorCode::NoTarget);
    stage.close().await;
}
