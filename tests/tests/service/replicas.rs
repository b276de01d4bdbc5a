//! Several workers: who goes on with a task when its worker is lost, who must stop, and what a client notices.

use std::time::Duration;

use domvs_proto::frame::Secret;
use domvs_proto::messages::{ErrorCode, Phase, TaskState};
use domvs_proto::settings::{Frames, Gain, Limits};
use domvs_server::config::{Limits as ServerLimits, Replica};
use domvs_server::{ServerConfig, Service, ServiceError};
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;

use crate::support::{
    Answer, ClientError, Following, Question, Scene, Stage, Status, Task, TaskSettings, TwistMessage, ZEROS, code,
    in_time, name, push, started,
};

/// What may be lost on the way is sent again after this.
const AGAIN: Duration = Duration::from_millis(100);

/// Another worker at the same router.
struct Worker {
    service: Service,
    /// Closing it takes the worker away as a kill does.
    session: Session,
}

impl Worker {
    async fn join(stage: &Stage, worker: &str) -> Worker {
        Worker::with(stage, worker, ServerConfig::default()).await
    }

    async fn with(stage: &Stage, worker: &str, config: ServerConfig) -> Worker {
        let session = stage.stranger().await;
        let config = ServerConfig { worker: worker.into(), ..config };
        let service = Service::start(config, session.clone()).await.expect("it starts");
        Worker { service, session }
    }
}

async fn info(stage: &Stage, session: &Session, worker: &str) -> serde_json::Value {
    Question::on(stage.keys.worker_info(&name(worker))).ask(session).await.json()
}

/// Waits until the worker keeps the states of so many tasks of others.
async fn stands_by_for(stage: &Stage, session: &Session, worker: &str, tasks: u64) {
    in_time("the standby knows the tasks", async {
        while info(stage, session, worker).await["standby"] != tasks {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

async fn state(task: &Task) -> TaskState {
    task.state().await.expect("answered")
}

/// Asks for a twist of the next frame until there is one that moves; every other answer is exact zeros.
async fn moves_again(task: &Task, scene: &mut Scene, sequence: &mut u64) -> TwistMessage {
    in_time("it moves again", async {
        loop {
            *sequence += 1;
            match task.twist(&scene.frame(*sequence)).await {
                Ok(twist) if twist.is_servoing() => return twist,
                Ok(twist) => assert_eq!(twist.twist, ZEROS),
                Err(error) => assert!(error.is_silence(), "{error}"),
            }
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_goes_on_with_a_lost_task_and_the_client_calls_nothing() {
    let stage = Stage::open().await;
    let second = Worker::join(&stage, "w2").await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = scene.settings();
    let task = client.create_task_on(&name("w1"), &settings).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    let mut sequence = 0;
    for _ in 0..3 {
        moves_again(&task, &mut scene, &mut sequence).await;
    }
    stands_by_for(&stage, client.session(), "w2", 1).await;
    let before = task.epoch();

    stage.session.close().await.expect("it closes");
    let twist = moves_again(&task, &mut scene, &mut sequence).await;
    assert_eq!((twist.epoch >> 16, task.epoch()), ((before >> 16) + 1, twist.epoch), "one generation later");
    let after = state(&task).await;
    assert_eq!(after.worker, name("w2"));
    // The client hangs the task on its own process.
    assert_eq!(after.settings, TaskSettings { lease: after.settings.lease.clone(), ..settings });
    let arrived = in_time("it arrives under the new owner", async {
        loop {
            sequence += 1;
            let twist = task.twist(&scene.frame(sequence)).await.expect("answered");
            if !twist.is_servoing() {
                return twist.status;
            }
            scene.simulation.apply(twist.twist, settings.frame_period_s);
        }
    })
    .await;
    assert_eq!(arrived, Status::Converged);
    assert_eq!(task.target().await.expect("kept").payload, scene.target().payload().to_bytes().into_owned());
    second.service.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_pushes_goes_on_from_rest_under_the_new_owner() {
    let stage = Stage::open().await;
    let second = Worker::join(&stage, "w2").await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    // Noise, so that no two pictures are the same: this camera lives, though nobody moves it.
    scene.simulation.disturbance.noise_std = 0.01;
    let limits = Limits { linear_m_per_s2: 0.5, ..Limits::default() };
    let settings =
        TaskSettings { frames: Frames::Pushed, gain: Some(Gain::PerS(2.0)), limits: Some(limits), ..scene.settings() };
    let task = client.create_task_on(&name("w1"), &settings).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut sequence = 0;
    for _ in 0..5 {
        sequence += 1;
        assert!(push(&task, &following, &scene.frame(sequence)).await.is_servoing());
    }
    let old = task.epoch();
    stands_by_for(&stage, client.session(), "w2", 1).await;
    following.drain();

    stage.session.close().await.expect("it closes");
    let (_, standing) = following.until("zeros of the new owner", |message| message.epoch > old).await;
    assert_eq!((standing.status, standing.twist), (Status::WaitingFrame, ZEROS), "it begins at rest");
    sequence += 1;
    let first = push(&task, &following, &scene.frame(sequence)).await;
    assert!(first.is_servoing() && first.flags.acceleration_limited, "{first:?}");
    let speed = first.twist[..3].iter().map(|component| component * component).sum::<f64>().sqrt();
    assert!(speed <= limits.linear_m_per_s2 * settings.frame_period_s + 1e-9, "{speed} m/s at once");
    let epochs: Vec<u32> = following.drain().iter().map(|message| message.epoch).collect();
    assert!(epochs.is_sorted(), "{epochs:?}");
    second.service.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_latched_stays_latched_and_the_counters_go_on() {
    let stage = Stage::open().await;
    let second = Worker::join(&stage, "w2").await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = client.create_task_on(&name("w1"), &scene.settings()).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    let mut sequence = 0;
    moves_again(&task, &mut scene, &mut sequence).await;
    moves_again(&task, &mut scene, &mut sequence).await;
    task.pause().await.expect("paused");
    let before = state(&task).await;
    stands_by_for(&stage, client.session(), "w2", 1).await;

    stage.session.close().await.expect("it closes");
    let paused = task.twist(&scene.frame(100)).await.expect("the new owner answers");
    assert_eq!((paused.status, paused.twist), (Status::Paused, ZEROS));
    let after = state(&task).await;
    assert_eq!(after.progress.phase, Phase::Latched(Status::Paused));
    assert_eq!(after.progress.twists, before.progress.twists);
    assert_eq!(after.progress.initial_pixel_mse, before.progress.initial_pixel_mse);
    // What standbys have been told may be a second old.
    assert!(after.progress.frames_in >= before.progress.frames_in, "{} frames", after.progress.frames_in);
    task.resume().await.expect("resumed");
    sequence = 100;
    moves_again(&task, &mut scene, &mut sequence).await;
    assert_eq!(state(&task).await.progress.twists, before.progress.twists + 1, "resume keeps the count");
    second.service.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_new_owner_knows_the_secret_and_no_other_and_state_does_not_tell_it() {
    let stage = Stage::open().await;
    let second = Worker::join(&stage, "w2").await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = client.create_task_on(&name("w1"), &scene.settings()).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    stands_by_for(&stage, client.session(), "w2", 1).await;
    let published = Question::on(stage.keys.state(task.key())).ask(client.session()).await.payload();
    let secret = task.secret().expect("its own").to_hex();
    assert!(!String::from_utf8(published).expect("JSON").contains(&secret));

    stage.session.close().await.expect("it closes");
    let mut sequence = 0;
    task.start().await.expect("the right secret");
    moves_again(&task, &mut scene, &mut sequence).await;
    let stop = Question::on(stage.keys.control(task.key())).with(r#"{"do": "stop"}"#);
    assert_eq!(code(stop.clone().attached([0; 16]).ask(client.session()).await), ErrorCode::NotOwner);
    assert_eq!(code(stop.ask(client.session()).await), ErrorCode::NotOwner);
    second.service.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_joins_later_asks_for_the_tasks_that_are_there() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let mut sequence = 0;
    moves_again(&task, &mut scene, &mut sequence).await;
    let second = Worker::join(&stage, "w2").await;
    stands_by_for(&stage, client.session(), "w2", 1).await;
    stage.session.close().await.expect("it closes");
    moves_again(&task, &mut scene, &mut sequence).await;
    assert_eq!(state(&task).await.worker, name("w2"));
    second.service.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_owner_that_sees_a_newer_one_stops_that_task_and_keeps_the_others() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let lost = started(&client, &settings, &scene.target()).await;
    let kept = started(&client, &scene.settings(), &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(lost.key())).await;
    assert!(push(&lost, &following, &scene.frame(1)).await.is_servoing());
    let before = kept.epoch();

    // Somebody else has it now, as after a pause or a cut of the worker that was longer than the lease.
    let rival = stage.stranger().await;
    let token = stage.keys.owner(lost.key(), &name("rival"), lost.epoch() + (1 << 16));
    let _token = rival.liveliness().declare_token(token).await.expect("declared");
    let (_, last) =
        following.until("the superseded owner's zeros", |message| message.status == Status::Superseded).await;
    assert_eq!(last.twist, ZEROS);
    assert!(following.drain().iter().all(|message| !message.is_servoing()), "nothing moves after it");
    // The other task goes on in the worker's next session, one generation later.
    let mut sequence = 0;
    in_time("the other task in the next session", async {
        while moves_again(&kept, &mut scene, &mut sequence).await.epoch >> 16 != (before >> 16) + 1 {}
    })
    .await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_standby_that_is_full_leaves_the_task_to_the_next() {
    let stage = Stage::open().await;
    let full = ServerConfig { limits: ServerLimits { tasks: 1, ..ServerLimits::default() }, ..ServerConfig::default() };
    let others = [Worker::with(&stage, "w2", full.clone()).await, Worker::with(&stage, "w3", full).await];
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let mut tasks = vec![];
    for _ in 0..2 {
        let task = client.create_task_on(&name("w1"), &scene.settings()).await.expect("created");
        task.set_target(&scene.target()).await.expect("set");
        task.start().await.expect("started");
        tasks.push(task);
    }
    for worker in ["w2", "w3"] {
        stands_by_for(&stage, client.session(), worker, 2).await;
    }
    stage.session.close().await.expect("it closes");
    let mut owners = vec![];
    for task in &tasks {
        moves_again(task, &mut scene, &mut 0).await;
        owners.push(state(task).await.worker.to_string());
    }
    owners.sort();
    assert_eq!(owners, ["w2", "w3"], "each has room for one, whoever comes first for both");
    for worker in others {
        worker.service.shutdown().await;
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_tasks_of_three_workers_outlive_two_of_them() {
    let stage = Stage::open().await;
    let (second, third) = (Worker::join(&stage, "w2").await, Worker::join(&stage, "w3").await);
    let (alice, bob) = (stage.client("alice").await, stage.client("bob").await);
    let mut scene = Scene::small("coffee");
    let mut tasks = vec![];
    for number in 0..20 {
        let client = if number % 2 == 0 { &alice } else { &bob };
        let worker = format!("w{}", number % 3 + 1);
        let task = client.create_task_on(&name(&worker), &scene.settings()).await.expect("created");
        task.set_target(&scene.target()).await.expect("set");
        task.start().await.expect("started");
        tasks.push(task);
    }
    stands_by_for(&stage, alice.session(), "w2", 13).await;
    stands_by_for(&stage, alice.session(), "w3", 14).await;
    for gone in [&stage.session, &second.session] {
        gone.close().await.expect("it closes");
        for task in &tasks {
            moves_again(task, &mut scene, &mut 0).await;
        }
    }
    assert_eq!(info(&stage, alice.session(), "w3").await["tasks"], 20);
    third.service.shutdown().await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_ends_hands_its_tasks_over_and_a_closed_task_stays_closed() {
    let stage = Stage::open().await;
    let second = Worker::join(&stage, "w2").await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let (settings, w1) = (scene.settings(), name("w1"));
    let make = || client.create_task_on(&w1, &settings);
    let (task, closed) = (make().await.expect("created"), make().await.expect("created"));
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    stands_by_for(&stage, client.session(), "w2", 2).await;
    let closed_key = closed.key().clone();
    closed.close().await.expect("closed");
    stands_by_for(&stage, client.session(), "w2", 1).await;

    let Stage { service, keys, .. } = stage;
    service.shutdown().await;
    let mut sequence = 0;
    let twist = moves_again(&task, &mut scene, &mut sequence).await;
    assert_eq!(twist.epoch >> 16, 2);
    let gone = Question::on(keys.state(&closed_key)).ask_all(client.session()).await;
    assert!(gone.iter().all(|answer| matches!(answer, Answer::Refused(_))), "{gone:?}");
    second.service.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_command_of_an_older_epoch_reaches_the_client() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let mut commands = task.commands().await.expect("followed");
    let stranger = stage.stranger().await;
    let moving = |epoch| TwistMessage { epoch, twist: [0.1; 6], ..TwistMessage::zero(Status::Servoing) };
    let command = stage.keys.command(task.key());
    let newer = task.epoch() + (1 << 16);
    in_time("the newer one comes", async {
        loop {
            stranger.put(&command, moving(newer).encode()).await.expect("open");
            if commands.recv(AGAIN).await.is_some_and(|message| message.epoch == newer) {
                return;
            }
        }
    })
    .await;
    let before = commands.older_epochs();
    in_time("the older one is dropped", async {
        while commands.older_epochs() == before {
            stranger.put(&command, moving(newer - (1 << 16)).encode()).await.expect("open");
            let heard = commands.recv(AGAIN).await;
            assert!(heard.is_none_or(|message| message.epoch >= newer), "{heard:?}");
        }
    })
    .await;
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tasks_of_a_worker_alone_outlive_its_restart_and_stand() {
    let folder = tempfile::tempdir().expect("a folder");
    // The stage's own worker stands by for nobody.
    let replica = Replica { tasks: 0, ..Replica::default() };
    let stage = Stage::with(ServerConfig { replica, ..ServerConfig::default() }).await;
    let config = ServerConfig { state: folder.path().to_owned(), ..ServerConfig::default() };
    let worker = Worker::with(&stage, "w2", config.clone()).await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = client.create_task_on(&name("w2"), &scene.settings()).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    let (mut sequence, old) = (0, task.epoch());
    moves_again(&task, &mut scene, &mut sequence).await;
    let twists = state(&task).await.progress.twists;
    worker.service.shutdown().await;

    let again = Worker::with(&stage, "w2", config).await;
    let paused = in_time("the task is back", async {
        loop {
            sequence += 1;
            match task.twist(&scene.frame(sequence)).await {
                Ok(twist) if twist.epoch > old => return twist,
                Ok(twist) => assert_eq!(twist.twist, ZEROS),
                Err(error) => assert!(error.is_silence() || matches!(error, ClientError::Refused { .. }), "{error}"),
            }
        }
    })
    .await;
    assert_eq!((paused.status, paused.twist), (Status::Paused, ZEROS), "nothing moves before somebody says so");
    assert_eq!(paused.epoch >> 16, (old >> 16) + 1);
    assert_eq!(state(&task).await.progress.twists, twists);
    task.resume().await.expect("the secret is known");
    moves_again(&task, &mut scene, &mut sequence).await;
    task.close().await.expect("closed");
    again.service.shutdown().await;
    assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0, "a closed task leaves nothing");
    stage.close().await;
}

/// An owner that says nothing by itself and obeys nobody, as one that hangs.
struct Hung {
    session: Session,
    _tokens: [LivelinessToken; 2],
}

impl Hung {
    /// It has a task like `model`, in this phase, and the standbys know.
    async fn with(stage: &Stage, model: &TaskState, phase: Phase) -> (Hung, TaskState) {
        let session = stage.stranger().await;
        let mut state = TaskState { worker: name("hung"), epoch: 1 << 16, ..model.clone() };
        state.task = "alice/0123456789abcdef".parse().expect("a task");
        state.progress.phase = phase;
        let alive = session.liveliness().declare_token(stage.keys.worker_alive(&state.worker)).await;
        let owner = stage.keys.owner(&state.task, &state.worker, state.epoch);
        let owner = session.liveliness().declare_token(owner).await;
        let hung = Hung { session, _tokens: [alive.expect("declared"), owner.expect("declared")] };
        hung.says(stage, &state).await;
        (hung, state)
    }

    /// Until the standby knows it.
    async fn says(&self, stage: &Stage, state: &TaskState) {
        let json = serde_json::to_vec(state).expect("JSON");
        in_time("the standby knows the task", async {
            while info(stage, &self.session, "w1").await["standby"] != 1 {
                self.session.put(stage.keys.state(&state.task), json.clone()).await.expect("open");
            }
        })
        .await;
    }
}

/// The state of this task under its next owner.
async fn after(stage: &Stage, session: &Session, before: &TaskState) -> TaskState {
    in_time("the next owner", async {
        loop {
            for answer in Question::on(stage.keys.state(&before.task)).ask_all(session).await {
                if let Answer::Good { payload, .. } = answer {
                    return serde_json::from_slice(&payload).expect("a state");
                }
            }
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_for_all_that_a_hung_owner_did_not_hear_stops_its_task_under_the_next() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let witness = started(&client, &scene.settings(), &scene.target()).await;
    let model = TaskState { target: None, ..state(&witness).await };
    let (hung, lost) = Hung::with(&stage, &model, Phase::Running).await;
    client.session().put(stage.keys.stop(), "").await.expect("open");
    in_time("the standby has heard it", async {
        let mut sequence = 0;
        while witness.twist(&scene.frame(sequence)).await.expect("answered").status != Status::Stopped {
            sequence += 1;
        }
    })
    .await;
    hung.session.close().await.expect("it closes");
    let next = after(&stage, client.session(), &lost).await;
    assert_eq!((next.worker, next.progress.phase), (name("w1"), Phase::Latched(Status::Stopped)));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_for_all_right_before_the_end_of_a_worker_goes_on_with_the_task() {
    let stage = Stage::open().await;
    let second = Worker::join(&stage, "w2").await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = client.create_task_on(&name("w2"), &scene.settings()).await.expect("created");
    task.set_target(&scene.target()).await.expect("set");
    task.start().await.expect("started");
    stands_by_for(&stage, client.session(), "w1", 1).await;
    // From the worker's own session: heard before the next line.
    second.session.put(stage.keys.stop(), "").await.expect("open");
    second.service.shutdown().await;
    let next = in_time("the next owner", async {
        loop {
            match task.state().await {
                Ok(state) if state.worker == name("w1") => return state,
                _ => tokio::task::yield_now().await,
            }
        }
    })
    .await;
    assert_eq!(next.progress.phase, Phase::Latched(Status::Stopped));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_forged_state_with_another_secret_does_not_give_a_task_away() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let scene = Scene::small("coffee");
    let model = state(&client.create_task(&scene.settings()).await.expect("created")).await;
    let (hung, lost) = Hung::with(&stage, &model, Phase::Idle).await;
    let stolen = Secret::new([7; 16]);
    let forged = TaskState { secret_hash: stolen.hash(), revision: 1 << 63, ..lost.clone() };
    let mallory = stage.stranger().await;
    let json = serde_json::to_vec(&forged).expect("JSON");
    mallory.put(stage.keys.state(&lost.task), json.clone()).await.expect("open");
    // Nor under another task's key.
    mallory.put(stage.keys.state(&model.task), json).await.expect("open");
    mallory.close().await.expect("it closes");
    hung.session.close().await.expect("it closes");
    let next = after(&stage, client.session(), &lost).await;
    assert_eq!((next.secret_hash, next.worker), (lost.secret_hash, name("w1")));
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_workers_of_one_name_that_start_together_one_stays() {
    let stage = Stage::open().await;
    let sessions = [stage.stranger().await, stage.stranger().await];
    let config = ServerConfig { worker: "twin".into(), ..ServerConfig::default() };
    let [one, other] = sessions.map(|session| Service::start(config.clone(), session));
    let (mut stays, mut ends) = (vec![], vec![]);
    let started: [_; 2] = in_time("both starts", async { tokio::join!(one, other) }).await.into();
    for result in started {
        match result {
            Ok(service) => stays.push(service),
            Err(error) => ends.push(error),
        }
    }
    assert!(matches!(&ends[..], [ServiceError::NameTaken { .. }]), "{ends:?}");
    assert_eq!(stays.len(), 1);
    for service in stays {
        service.shutdown().await;
    }
    stage.close().await;
}
