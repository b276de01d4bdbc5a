//! Hostile bytes on every key: each question gets its one right answer, each pushed frame its zeros, and a good task
//! on the same worker goes on as if nothing had been.

mod bombs;
mod lies;

use domvs_client::OutgoingFrame;
use domvs_proto::body::MAX_JSON_BYTES;
use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat, Secret};
use domvs_proto::settings::Frames;
use domvs_server::ServerConfig;
use domvs_server::config::Limits;
use rand::rngs::StdRng;
use rand::{Rng, RngCore, SeedableRng};

use crate::support::{
    Answer, Client, ErrorCode, Following, Question, Scene, Stage, Status, Task, TaskKey, TaskSettings, ZEROS, code,
    in_time, next_status, push, started,
};

const SEED: u64 = 7;
/// Bytes of a payload that the worker of these tests takes.
const MAX_BYTES: usize = 1 << 20;

/// A worker, a task under attack with what its attacker knows, and a good task beside it.
struct Siege {
    stage: Stage,
    client: Client,
    scene: Scene,
    good: Task,
    attacked: Task,
    sequence: u64,
}

impl Siege {
    async fn begin() -> Siege {
        let limits = Limits { bytes_per_payload: MAX_BYTES, ..Limits::default() };
        let stage = Stage::with(ServerConfig { limits, ..ServerConfig::default() }).await;
        let client = stage.client("alice").await;
        let mut scene = Scene::small("coffee");
        let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
        let good = started(&client, &settings, &scene.target()).await;
        let attacked = started(&client, &settings, &scene.target()).await;
        Siege { stage, client, scene, good, attacked, sequence: 0 }
    }

    fn key(&self) -> &TaskKey {
        self.attacked.key()
    }

    fn secret(&self) -> Secret {
        self.attacked.secret().expect("told once").clone()
    }

    async fn ask(&self, question: Question) -> Answer {
        question.ask(self.client.session()).await
    }

    /// The next good frame.
    fn frame(&mut self) -> OutgoingFrame {
        self.sequence += 1;
        self.scene.frame(self.sequence)
    }

    /// The good task and the attacked one both move at their next good frame.
    async fn goes_on(&mut self, after: &str) {
        let frame = self.frame();
        for task in [&self.good, &self.attacked] {
            let answer = task.twist(&frame).await.expect("answered");
            assert!(answer.is_servoing() && answer.twist != ZEROS, "after {after}: {answer:?}");
        }
    }
}

/// Bodies that are no JSON of this protocol, and what each is called.
fn bad_json() -> Vec<(&'static str, Vec<u8>, ErrorCode)> {
    let mut random = vec![0; 3000];
    StdRng::seed_from_u64(SEED).fill_bytes(&mut random);
    let huge = format!(r#"{{"do": "{}"}}"#, "x".repeat(MAX_JSON_BYTES));
    let objects = format!("{}1{}", r#"{"a":"#.repeat(5000), "}".repeat(5000));
    vec![
        ("random bytes", random, ErrorCode::BadJson),
        ("huge", huge.into_bytes(), ErrorCode::TooLarge),
        ("nested lists", "[".repeat(20_000).into_bytes(), ErrorCode::BadJson),
        ("nested objects", objects.into_bytes(), ErrorCode::BadJson),
        ("not UTF-8", b"{\"do\": \"st\xffart\"}".to_vec(), ErrorCode::BadJson),
        ("cut off", br#"{"do": "#.to_vec(), ErrorCode::BadJson),
        ("two values", br#"{"do": "start"} {}"#.to_vec(), ErrorCode::BadJson),
        ("NaN", b"NaN".to_vec(), ErrorCode::BadJson),
        ("zeros", vec![0; 16], ErrorCode::BadJson),
        ("a byte order mark", b"\xef\xbb\xbf{\"do\": \"start\"}".to_vec(), ErrorCode::BadJson),
        ("a byte 0 at the end", b"{\"do\": \"start\"}\0".to_vec(), ErrorCode::BadJson),
        ("half a surrogate pair", br#"{"do": "start", "\ud800": 1}"#.to_vec(), ErrorCode::BadJson),
        ("a number beyond all floats", br#"{"gain": {"per_s": 1e400}}"#.to_vec(), ErrorCode::BadJson),
        ("one byte too many", vec![b' '; MAX_JSON_BYTES + 1], ErrorCode::TooLarge),
        ("as many bytes as may be, and no more", vec![b' '; MAX_JSON_BYTES], ErrorCode::BadJson),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_are_no_json_are_refused_by_their_word_on_every_key_that_takes_json() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let create = "domvs/worker/w1/create/mallory".to_owned();
    for (what, body, expected) in bad_json() {
        for key in [keys.control(siege.key()), keys.settings(siege.key()), create.clone()] {
            let question = Question::on(key).with(body.clone()).attached(siege.secret().as_bytes());
            let selector = question.selector.clone();
            assert_eq!(code(siege.ask(question).await), expected, "{what} on {selector}");
        }
    }
    for body in ["", "{}", "null", "[]", r#"{"do": "fly"}"#, r#"{"do": "start", "now": true}"#, r#"{"do": 1}"#] {
        let question = Question::on(keys.control(siege.key())).with(body).attached(siege.secret().as_bytes());
        assert_eq!(code(siege.ask(question).await), ErrorCode::BadJson, "{body:?} on control");
    }
    siege.goes_on("bad JSON").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn questions_that_take_no_body_are_not_disturbed_by_one() {
    let mut siege = Siege::begin().await;
    let state = siege.stage.keys.state(siege.key());
    for (what, body, expected) in bad_json() {
        for key in [state.clone(), "domvs/worker/w1/info".to_owned()] {
            let answer = siege.ask(Question::on(&*key).with(body.clone()).attached([0xff; 100])).await;
            match expected {
                // It would wait for the task: not with a body of any size.
                ErrorCode::TooLarge if key == state => assert_eq!(code(answer), expected, "{what}"),
                _ => assert!(answer.json().is_object(), "{what}"),
            }
        }
    }
    siege.goes_on("bodies nobody asked for").await;
    siege.stage.close().await;
}

/// Headers that lie about a picture of 96x72 8-bit pixels with depth, and headers that are none.
fn bad_headers(secret: Option<&Secret>) -> Vec<(&'static str, Vec<u8>)> {
    let pixels = 96 * 72;
    let honest = FrameHeader {
        depth_format: DepthFormat::U16,
        depth_unit_m: 0.001,
        depth_offset: pixels,
        secret: secret.cloned(),
        ..FrameHeader::new(PixelFormat::Mono8, 96, 72)
    };
    let lie = |change: fn(&mut FrameHeader)| {
        let mut header = honest.clone();
        change(&mut header);
        header.encode()
    };
    let byte = |at: usize, value: u8| {
        let mut header = honest.encode();
        header[at] = value;
        header
    };
    let mut long = honest.encode();
    long.push(0);
    vec![
        ("version 0", byte(0, 0)),
        ("version 2", byte(0, 2)),
        ("an unknown pixel format", byte(1, 10)),
        ("an unknown depth format", byte(2, 3)),
        ("an unknown flag", byte(3, 0x80 | u8::from(secret.is_some()))),
        ("a reserved word in use", byte(44, 1)),
        ("one byte", vec![1]),
        ("cut off", honest.encode()[..47].to_vec()),
        ("one byte too long", long),
        ("no pixels", lie(|header| (header.width, header.height) = (0, 0))),
        ("a row too few", lie(|header| header.height = 71)),
        ("a row too many", lie(|header| header.height = 73)),
        ("beyond counting", lie(|header| (header.width, header.height) = (u32::MAX, u32::MAX))),
        ("an overflow", lie(|header| (header.width, header.height, header.row_bytes) = (1 << 16, 1 << 16, 1 << 16))),
        ("rows that overlap", lie(|header| header.row_bytes = 95)),
        ("rows of 4 GiB", lie(|header| header.row_bytes = u32::MAX)),
        ("depth inside the pixels", lie(|header| header.depth_offset = 0)),
        ("depth beyond the end", lie(|header| header.depth_offset = u32::MAX)),
        ("depth without a unit", lie(|header| header.depth_unit_m = 0.0)),
        ("depth of NaN units", lie(|header| header.depth_unit_m = f32::NAN)),
        ("wider pixels", lie(|header| header.pixel_format = PixelFormat::Rgba8)),
        ("wider depth", lie(|header| header.depth_format = DepthFormat::F32)),
        ("an odd size of NV12", lie(|header| (header.pixel_format, header.width) = (PixelFormat::Nv12, 95))),
        ("a PNG without one", lie(|header| header.pixel_format = PixelFormat::ByEncoding)),
    ]
}

/// What an honest header above would announce.
fn honest_payload() -> Vec<u8> {
    (0..96 * 72 * 3).map(|index: u32| (index.wrapping_mul(2_654_435_761) >> 24) as u8).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn headers_that_lie_make_bad_frames_and_bad_targets_and_never_motion() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let secret = siege.secret();
    for (what, header) in bad_headers(Some(&secret)) {
        let raw = |key: String| Question::on(key).with(honest_payload()).encoded("application/octet-stream");
        let twist = siege.ask(raw(keys.twist(siege.key())).attached(header.clone())).await.twist();
        assert_eq!((twist.status, twist.twist), (Status::BadFrame, ZEROS), "{what}");
        let expected = if what.starts_with("version") { ErrorCode::WrongVersion } else { ErrorCode::BadTarget };
        assert_eq!(code(siege.ask(raw(keys.target(siege.key())).attached(header)).await), expected, "{what}");
    }
    siege.goes_on("lies in headers").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pushed_lies_and_garbage_are_answered_by_zeros_on_command() {
    let mut siege = Siege::begin().await;
    let command = siege.stage.keys.command(siege.key());
    let following = Following::on(siege.client.session(), command).await;
    let mut statuses = siege.attacked.statuses().await.expect("followed");
    let frame_key = siege.stage.keys.frame(siege.key());
    let mut rng = StdRng::seed_from_u64(SEED);
    let mut attacks: Vec<(String, Option<Vec<u8>>, Vec<u8>)> =
        bad_headers(None).into_iter().map(|(what, header)| (what.to_owned(), Some(header), honest_payload())).collect();
    for number in 0..30 {
        let mut attachment = vec![0; rng.gen_range(0..100)];
        let mut payload = vec![0; rng.gen_range(0..20_000)];
        rng.fill_bytes(&mut attachment);
        rng.fill_bytes(&mut payload);
        let attachment = (number % 3 > 0).then_some(attachment);
        attacks.push((format!("random bytes {number}, seed {SEED}"), attachment, payload));
    }
    attacks.push(("too many bytes".to_owned(), None, vec![0; MAX_BYTES + 1]));
    for (what, attachment, payload) in attacks {
        let good = siege.frame();
        assert!(push(&siege.attacked, &following, &good).await.is_servoing(), "before {what}");
        in_time(&what, async {
            loop {
                let put = siege.client.session().put(&frame_key, payload.clone());
                put.attachment(attachment.clone()).await.expect("open");
                let (_, heard) = following.next().await;
                assert_eq!(heard.twist, ZEROS, "{what}");
                if heard.status == Status::BadFrame {
                    return;
                }
            }
        })
        .await;
    }
    let said = next_status(&mut statuses, "bad_frame", |message| message.status == Status::BadFrame).await;
    assert!(said.frames_dropped.bad > 0 && said.detail.is_some(), "{said:?}");
    siege.goes_on("pushed garbage").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn random_questions_on_every_key_each_get_an_answer() {
    let mut siege = Siege::begin().await;
    let mut rng = StdRng::seed_from_u64(SEED);
    let keys = siege.stage.keys.clone();
    let leaves =
        [keys.twist(siege.key()), keys.target(siege.key()), keys.settings(siege.key()), keys.control(siege.key())];
    for round in 0..40 {
        for key in &leaves {
            let mut payload = vec![0; rng.gen_range(1..5000)];
            let mut attachment = vec![0; [0, 1, 16, 48, 64, 1000][rng.gen_range(0..6)]];
            rng.fill_bytes(&mut payload);
            rng.fill_bytes(&mut attachment);
            let encoding = ["image/png", "image/jpeg", "application/json", "nonsense/x"][rng.gen_range(0..4)];
            let question = Question::on(key).with(payload).encoded(encoding).attached(attachment);
            let answer = siege.ask(question).await;
            match answer {
                Answer::Refused(error) => {
                    assert_ne!(error.code, ErrorCode::Internal, "seed {SEED}, round {round}: {error}")
                }
                good => assert_eq!(good.twist().twist, ZEROS, "seed {SEED}, round {round}"),
            }
        }
    }
    siege.goes_on("random questions").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn payloads_beyond_the_limit_are_refused_before_they_are_looked_at() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let header = FrameHeader { secret: Some(siege.secret()), ..FrameHeader::new(PixelFormat::Mono8, 1024, 1025) };
    let question = |key: String| Question::on(key).with(vec![0; 1024 * 1025]).attached(header.encode());
    let twist = siege.ask(question(keys.twist(siege.key()))).await.twist();
    assert_eq!((twist.status, twist.twist), (Status::BadFrame, ZEROS));
    assert_eq!(code(siege.ask(question(keys.target(siege.key()))).await), ErrorCode::TooLarge);
    siege.goes_on("too many bytes").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn publications_and_wildcards_where_they_do_not_belong_change_nothing() {
    let mut siege = Siege::begin().await;
    let stranger = siege.stage.stranger().await;
    let before = siege.good.settings().await.expect("answered");
    for key in ["command", "status", "state", "settings", "control", "target", "twist", "owner/w1/9", "nonsense"] {
        stranger.put(format!("domvs/task/{}/{key}", siege.key()), r#"{"do": "stop"}"#).await.expect("open");
    }
    for key in ["domvs/worker/w1/create/mallory", "domvs/worker/w1/info", "domvs/client/alice/alive", "domvs/stopped"] {
        stranger.put(key, "stop").await.expect("open");
    }
    // Tokens with names that no key of ours would carry.
    let _tokens = [
        stranger.liveliness().declare_token("domvs/client/al.ice/alive").await.expect("a fine key"),
        stranger.liveliness().declare_token("domvs/client/a/b/c/alive").await.expect("a fine key"),
        stranger.liveliness().declare_token("domvs/task/alice/x/owner/w1/7").await.expect("a fine key"),
    ];
    for wildcard in ["domvs/task/*/*/control", "domvs/task/**", "domvs/**"] {
        let answers = Question::on(wildcard).with(r#"{"do": "stop"}"#).ask_all(&stranger).await;
        for answer in answers {
            // Who has no secret is told so, by each task; only what everybody may read is said.
            if let Answer::Good { key, payload, .. } = answer {
                let public = key.ends_with("/state") || key.ends_with("/info") || key.ends_with("/twist");
                assert!(public, "{key}: {payload:?}");
            }
        }
    }
    assert_eq!(siege.good.settings().await.expect("answered"), before);
    siege.goes_on("strange publications").await;
    assert_eq!(siege.client.list_workers().await.expect("answered")[0].tasks, 2);
    siege.stage.close().await;
}
