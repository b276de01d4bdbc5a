//! More than a worker can do: every request is answered, at once if not with a twist, and the newest pushed frame wins.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use domvs_client::{ImageFile, OutgoingFrame};
use domvs_proto::frame::FrameHeader;
use domvs_proto::settings::Depth;
use domvs_server::ServerConfig;
use domvs_server::config::Limits;
use image::ExtendedColorType;

use crate::support::{
    Answer, Client, ErrorCode, Following, LIMIT, Question, Scene, Stage, Status, Task, TaskSettings, ZEROS, gray8,
    in_time, next_status, png, push, started,
};

/// Requests at once; a mailbox holds four.
const REQUESTS: u64 = 64;

/// A task on one compute thread whose frames are small to send and long to decode.
async fn slow(client: &Client) -> (Task, OutgoingFrame) {
    let mut scene = Scene::new("coffee", [512, 512], [0.02, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let settings = TaskSettings { depth: Depth::ConstantM(1.0), ..scene.settings() };
    let task = started(client, &settings, &scene.target()).await;
    let file = png(&gray8(&scene.simulation.capture()), [512, 512], ExtendedColorType::L8);
    (task, OutgoingFrame::file(ImageFile::Png, file).expect("not empty"))
}

#[tokio::test(flavor = "multi_thread")]
async fn of_many_requests_at_once_each_is_answered_and_the_rest_are_overloaded() {
    let stage = Stage::with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let (task, frame) = slow(&client).await;
    let task = Arc::new(task);
    let asked: Vec<_> = (1..=REQUESTS)
        .map(|sequence| {
            let (task, frame) = (task.clone(), frame.clone().numbered(sequence, 0));
            tokio::spawn(async move { task.twist(&frame).await.expect("answered") })
        })
        .collect();
    let mut counts = [0; 2];
    for (sequence, asked) in (1..).zip(asked) {
        let answer = in_time("an answer", asked).await.expect("no panic");
        assert_eq!(answer.sequence, sequence);
        match answer.status {
            Status::Servoing => counts[0] += 1,
            Status::Overloaded => counts[1] += 1,
            other => panic!("{other}"),
        }
        assert_eq!(answer.is_servoing(), answer.twist != ZEROS);
    }
    let [servoing, overloaded] = counts;
    // Four wait while one is computed; on a slow day more are computed meanwhile.
    assert!(servoing >= 4 && overloaded >= 1, "{servoing} servoing, {overloaded} overloaded");
    let mut statuses = task.statuses().await.expect("followed");
    let status = next_status(&mut statuses, "the counts", |message| message.frames_in == REQUESTS).await;
    assert_eq!(status.frames_dropped.overloaded, overloaded);
    assert!(task.twist(&frame.numbered(1000, 0)).await.expect("answered").is_servoing(), "and then it goes on");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_that_waited_past_their_deadline_get_zeros() {
    let stage = Stage::with(ServerConfig { threads: 1, mailbox_depth: 64, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let (task, frame) = slow(&client).await;
    // A quarter of what the whole queue takes at least: 64 PNGs of 512x512 pixels in 1 ms each.
    let (secret, deadline_us) = (task.secret().cloned(), 16_000);
    let payload = frame.payload().to_bytes().into_owned();
    let asked: Vec<_> = (1..=REQUESTS)
        .map(|sequence| {
            let header = FrameHeader { secret: secret.clone(), deadline_us, sequence, ..frame.header().clone() };
            let question = Question::on(stage.keys.twist(task.key())).with(payload.clone()).encoded("image/png");
            let (question, session) = (question.attached(header.encode()), client.session().clone());
            tokio::spawn(async move { question.ask(&session).await.twist() })
        })
        .collect();
    let mut missed = 0;
    for asked in asked {
        let answer = in_time("an answer", asked).await.expect("no panic");
        match answer.status {
            Status::Servoing => assert_ne!(answer.twist, ZEROS),
            Status::DeadlineMissed => missed += 1,
            other => panic!("{other}"),
        }
        assert_eq!(answer.is_servoing(), answer.twist != ZEROS);
    }
    assert!(missed > 0, "64 decoded pictures in 16 ms");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_many_pushed_frames_the_newest_wins_and_the_others_are_counted() {
    let stage = Stage::with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let (task, frame) = slow(&client).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut statuses = task.statuses().await.expect("followed");
    let mut sequence = 0;
    let superseded = in_time("a frame that is passed over", async {
        loop {
            for _ in 0..REQUESTS {
                sequence += 1;
                task.push(&frame.clone().numbered(sequence, 0)).await.expect("open");
            }
            let heard = statuses.recv(LIMIT).await.expect("twice a second");
            if heard.frames_dropped.superseded > 0 {
                return heard;
            }
        }
    })
    .await;
    assert!(superseded.frames_in >= superseded.frames_dropped.superseded, "{superseded:?}");
    let sequences: Vec<u64> =
        following.drain().into_iter().filter(|message| message.is_servoing()).map(|message| message.sequence).collect();
    assert!(!sequences.is_empty() && sequences.is_sorted_by(|a, b| a < b), "in order and once: {sequences:?}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_too_many_pushed_frames_each_is_used_or_counted_and_none_waits_for_long() {
    let stage = Stage::with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let (task, frame) = slow(&client).await;
    // A second picture, so that the camera does not look frozen.
    let mut scene = Scene::new("coffee", [512, 512], [0.03, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let file = png(&gray8(&scene.simulation.capture()), [512, 512], ExtendedColorType::L8);
    let other = OutgoingFrame::file(ImageFile::Png, file).expect("not empty");
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    for sequence in 1..=3 * REQUESTS {
        let frame = if sequence % 2 == 0 { &frame } else { &other };
        task.push(&frame.clone().numbered(sequence, 0)).await.expect("open");
    }
    // A queue that grew would still be worked off: what comes last is answered although most were not.
    let last = 3 * REQUESTS + 1;
    let answer = push(&task, &following, &frame.numbered(last, 0)).await;
    assert!(answer.is_servoing(), "{answer:?}");
    let mut statuses = task.statuses().await.expect("followed");
    let status = next_status(&mut statuses, "every frame is accounted for", |message| {
        let dropped = message.frames_dropped;
        message.sequence == last && message.frames_in == message.twists + dropped.superseded + dropped.stale
    })
    .await;
    assert!(status.frames_dropped.superseded > 0, "{status:?}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_tasks_that_never_rest_get_fair_shares() {
    const TASKS: usize = 20;
    /// Requests of one task that are on their way at any time; its mailbox holds four.
    const AT_ONCE: usize = 3;
    let limits = Limits { tasks_per_client: TASKS, ..Limits::default() };
    let stage = Stage::with(ServerConfig { threads: 1, limits, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let mut tasks = vec![];
    for _ in 0..TASKS {
        let (task, frame) = slow(&client).await;
        tasks.push((Arc::new(task), frame));
    }
    let answered: Arc<[AtomicUsize; TASKS]> = Arc::default();
    let mut asking = vec![];
    for (number, (task, frame)) in tasks.iter().enumerate() {
        for _ in 0..AT_ONCE {
            let (task, frame, answered) = (task.clone(), frame.clone(), answered.clone());
            asking.push(tokio::spawn(async move {
                while answered.iter().map(|count| count.load(Relaxed)).sum::<usize>() < 30 * TASKS {
                    let answer = task.twist(&frame).await.expect("answered");
                    assert!(answer.is_servoing(), "{answer:?}");
                    answered[number].fetch_add(1, Relaxed);
                }
            }));
        }
    }
    for asking in asking {
        in_time("the shares", asking).await.expect("no request fails");
    }
    let shares: Vec<usize> = answered.iter().map(|count| count.load(Relaxed)).collect();
    let (least, most) = (shares.iter().min().expect("twenty"), shares.iter().max().expect("twenty"));
    assert!(10 * least >= 8 * most, "{shares:?}");
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_orders_is_answered_one_by_one() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let scene = Scene::small("coffee");
    let task = client.create_task(&scene.settings()).await.expect("created");
    let secret = task.secret().expect("told once").as_bytes().to_vec();
    let asked: Vec<_> = (0..REQUESTS)
        .map(|_| {
            let question =
                Question::on(stage.keys.control(task.key())).with(r#"{"do": "stop"}"#).attached(secret.clone());
            let session = client.session().clone();
            tokio::spawn(async move { question.ask(&session).await })
        })
        .collect();
    let mut obeyed = 0;
    for asked in asked {
        match in_time("an answer", asked).await.expect("no panic") {
            Answer::Refused(error) => assert_eq!(error.code, ErrorCode::Quota, "{error}"),
            good => {
                assert_eq!(good.json()["status"], "stopped");
                obeyed += 1;
            }
        }
    }
    assert!(obeyed > 0);
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_task_that_never_rests_still_halts_when_its_client_goes() {
    let stage = Stage::with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    let client = stage.client("alice").await;
    let (task, frame) = slow(&client).await;
    let witness = stage.client("bob").await;
    let following = Following::on(witness.session(), stage.keys.command(task.key())).await;
    let camera = witness.attach(task.key().clone(), None).await.expect("it has an owner");
    let flood = tokio::spawn(async move {
        for sequence in 1.. {
            // Frames go with congestion control Drop: those that are too many are lost on their way.
            camera.push(&frame.clone().numbered(sequence, 0)).await.expect("open");
            tokio::task::yield_now().await;
        }
    });
    following.until("motion", |message| message.is_servoing()).await;
    client.close().await.expect("the session closes");
    let (_, halted) = following.until("client_lost under load", |message| message.status == Status::ClientLost).await;
    assert_eq!(halted.twist, ZEROS);
    flood.abort();
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tasks_that_come_and_go_leave_nothing_behind() {
    let stage = Arc::new(Stage::open().await);
    let scene = Scene::small("coffee");
    let clients: Vec<_> = (0..4)
        .map(|number| {
            let (stage, settings) = (stage.clone(), scene.settings());
            tokio::spawn(async move {
                let client = stage.client(&format!("client-{number}")).await;
                for _ in 0..15 {
                    let task = client.create_task(&settings).await.expect("created");
                    task.close().await.expect("closed");
                }
            })
        })
        .collect();
    for client in clients {
        in_time("sixty tasks", client).await.expect("no client fails");
    }
    let witness = stage.client("witness").await;
    in_time("the last one goes", async { while witness.list_workers().await.expect("it answers")[0].tasks > 0 {} })
        .await;
    assert!(witness.list_tasks().await.expect("answered").is_empty());
    Arc::into_inner(stage).expect("all clients have ended").close().await;
}
