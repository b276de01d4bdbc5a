//! Target, settings, control, state: what is sent, and what becomes of every kind of answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use domvs_client::{ClientError, ImageFile, OutgoingFrame, PixelFormat, Secret, Silence, Status, Task};
use domvs_proto::body;
use domvs_proto::messages::{Control, ControlReply, ErrorCode};
use serde_json::json;
use zenoh::Wait;
use zenoh::bytes::Encoding;

use crate::fake::{Fake, Held, SECRET, created, header_of, refuse, reply_json, settings, task_key};

const SHORT: Duration = Duration::from_millis(200);

/// A task on a client whose requests end soon.
async fn impatient_task(fake: &Fake) -> Task {
    fake.worker("w", 0.0).await;
    let client = fake.client(|options| options.request_timeout = SHORT).await;
    client.create_task(&settings()).await.expect("the fake gives every task")
}

#[tokio::test(flavor = "multi_thread")]
async fn create_is_asked_again_while_answers_are_empty() {
    let fake = Fake::start().await;
    let asked = Arc::new(AtomicU32::new(0));
    let times = asked.clone();
    let third_time = move |query| {
        if times.fetch_add(1, Ordering::Relaxed) >= 2 {
            reply_json(&query, &created("w"));
        }
    };
    fake.worker_that_creates("w", 0.0, third_time).await;
    fake.answer(&fake.keys.twist(&task_key("w")), |_| {}).await;
    fake.client(|_| {}).await.create_task(&settings()).await.expect("created in the end");
    assert_eq!(asked.load(Ordering::Relaxed), 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_control_carries_word_and_secret_and_gives_the_status() {
    let fake = Fake::start().await;
    let answer = |query: zenoh::query::Query| {
        let secret = query.attachment().map(|bytes| bytes.to_bytes().into_owned());
        assert_eq!(secret.as_deref(), Some(&SECRET[..]));
        let control: Control = body::read(&query.payload().expect("a body").to_bytes()).expect("a control");
        let status = match control {
            Control::Start | Control::Resume => Status::Servoing,
            Control::Pause => Status::Paused,
            Control::Stop | Control::Close => Status::Stopped,
        };
        reply_json(&query, &ControlReply { status });
    };
    fake.answer(&fake.keys.control(&task_key("w")), answer).await;
    let task = fake.task(SHORT, |_| {}).await;
    assert_eq!(task.start().await.expect("answered"), Status::Servoing);
    assert_eq!(task.pause().await.expect("answered"), Status::Paused);
    assert_eq!(task.resume().await.expect("answered"), Status::Servoing);
    assert_eq!(task.stop().await.expect("answered"), Status::Stopped);
    assert_eq!(task.close().await.expect("answered"), Status::Stopped);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_target_is_set_with_its_secret_and_comes_back_without() {
    let fake = Fake::start().await;
    let bytes = b"a PNG, as far as the client cares";
    let answer = move |query: zenoh::query::Query| {
        let header = header_of(&query);
        assert_eq!(header.secret, Some(Secret::new(SECRET)));
        match query.payload().filter(|payload| !payload.is_empty()) {
            Some(payload) => {
                assert_eq!((&*payload.to_bytes(), query.encoding()), (&bytes[..], Some(&Encoding::IMAGE_PNG)));
                assert_eq!(header.pixel_format, PixelFormat::ByEncoding);
                reply_json(&query, &ControlReply { status: Status::Ready });
            }
            None => {
                let header =
                    OutgoingFrame::file(ImageFile::Png, bytes).expect("not empty").numbered(4, 5).header().encode();
                let reply = query.reply(query.key_expr(), bytes).encoding(Encoding::IMAGE_PNG).attachment(header);
                reply.wait().expect("the session is open");
            }
        }
    };
    fake.answer(&fake.keys.target(&task_key("w")), answer).await;
    let task = fake.task(SHORT, |_| {}).await;
    let target = OutgoingFrame::file(ImageFile::Png, bytes).expect("not empty").numbered(4, 5);
    assert_eq!(task.set_target(&target).await.expect("taken"), Status::Ready);
    let got = task.target().await.expect("there is one");
    assert_eq!((got.payload.as_slice(), &got.encoding, &got.header), (&bytes[..], target.encoding(), target.header()));
}

#[tokio::test(flavor = "multi_thread")]
async fn settings_are_read_and_patched() {
    let fake = Fake::start().await;
    let answer = |query: zenoh::query::Query| {
        let patch =
            query.payload().map(|payload| payload.to_bytes().into_owned()).filter(|payload| !payload.is_empty());
        let in_force = match patch {
            Some(patch) => settings().merge_patch_body(&patch).expect("a patch in range"),
            None => settings(),
        };
        reply_json(&query, &in_force.to_value());
    };
    fake.answer(&fake.keys.settings(&task_key("w")), answer).await;
    let task = fake.task(SHORT, |_| {}).await;
    assert_eq!(task.settings().await.expect("answered"), settings());
    let changed = task.change_settings(&json!({ "epsilon": 0.5 })).await.expect("answered");
    assert_eq!(changed.epsilon, 0.5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_keeps_its_word_and_sentence() {
    let fake = Fake::start().await;
    let no = |query| refuse(&query, ErrorCode::NoTarget, "set a target first");
    fake.answer(&fake.keys.control(&task_key("w")), no).await;
    let error = fake.task(SHORT, |_| {}).await.start().await.expect_err("refused");
    let ClientError::Refused { key, code, error } = error else { panic!("{error}") };
    assert_eq!(key, fake.keys.control(&task_key("w")));
    assert_eq!((code, error.as_str()), (ErrorCode::NoTarget, "set a target first"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_that_is_not_ours_is_an_unreadable_answer() {
    let fake = Fake::start().await;
    let nonsense = |query: zenoh::query::Query| query.reply_err("no JSON").wait().expect("the session is open");
    fake.answer(&fake.keys.control(&task_key("w")), nonsense).await;
    let error = fake.task(SHORT, |_| {}).await.start().await.expect_err("unreadable");
    assert!(matches!(error, ClientError::BadAnswer { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_nobody_serves_ends_empty_at_its_limit() {
    let fake = Fake::start().await;
    let error = impatient_task(&fake).await.start().await.expect_err("nobody serves control");
    assert!(matches!(error, ClientError::NoAnswer { reason: Silence::Empty, .. }), "{error}");
    assert!(error.to_string().contains(&fake.keys.control(&task_key("w"))), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_is_never_answered_times_out() {
    let fake = Fake::start().await;
    let held = Held::default();
    let holder = held.clone();
    fake.answer(&fake.keys.control(&task_key("w")), move |query| holder.hold(query)).await;
    let error = impatient_task(&fake).await.start().await.expect_err("never answered");
    assert!(matches!(error, ClientError::NoAnswer { reason: Silence::TimedOut, .. }), "{error}");
    // Asked once: a start that may have been heard is not repeated behind the caller's back.
    assert_eq!(held.release().len(), 1);
}
