//! Asking for twists: what may be obeyed, what must not, and what silence leads to.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use domvs_client::{ClientError, Secret, Silence, Status, TwistMessage};
use zenoh::query::Query;

use crate::fake::{EPOCH, Fake, Held, LIMIT, SECRET, frame, header_of, moving, name, reply, reply_twist, task_key};

const SHORT: Duration = Duration::from_millis(200);
/// Where nobody answers, or only an older owner, a frame is asked for again until this has passed.
const AGAIN: Duration = Duration::from_secs(1);

/// What a healthy owner does.
fn obey(query: Query) {
    reply_twist(&query, moving(header_of(&query).sequence, EPOCH));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_twist_comes_back_for_a_frame() {
    let fake = Fake::start().await;
    let task = fake.task(LIMIT, obey).await;
    let twist = task.twist(&frame(7)).await.expect("a twist");
    assert_eq!((twist.sequence, twist.twist), (7, moving(7, EPOCH).twist));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_carries_pixels_secret_time_and_deadline() {
    let fake = Fake::start().await;
    let (sent, arrived) = flume::bounded(1);
    let look = move |query: Query| {
        let pixels = query.payload().map(|payload| payload.to_bytes().into_owned());
        sent.try_send((header_of(&query), pixels)).expect("one frame");
        obey(query);
    };
    let task = fake.task(LIMIT, look).await;
    task.twist(&frame(7)).await.expect("a twist");
    let (header, pixels) = arrived.recv_timeout(LIMIT).expect("the frame");
    assert_eq!((header.sequence, header.capture_time_ns), (7, 1007));
    assert_eq!(header.secret, Some(Secret::new(SECRET)));
    // What is left of the client's time when the frame is sent.
    let left = Duration::from_micros(u64::from(header.deadline_us));
    assert!(left <= LIMIT && left > LIMIT / 2, "{left:?}");
    assert_eq!(pixels, Some(vec![9; 64]));
}

#[tokio::test(flavor = "multi_thread")]
async fn silence_without_an_owner_becomes_owner_lost_at_the_third_time() {
    let fake = Fake::start().await;
    let task = fake.task(AGAIN, drop).await;
    for sequence in 1..=2 {
        let error = task.twist(&frame(sequence)).await.expect_err("empty");
        assert!(matches!(error, ClientError::NoAnswer { reason: Silence::Empty, .. }), "{error}");
    }
    let error = task.twist(&frame(3)).await.expect_err("empty");
    assert!(matches!(error, ClientError::OwnerLost { misses: 3, .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn silence_under_a_new_owner_raises_the_epoch() {
    let fake = Fake::start().await;
    let newer = EPOCH + (1 << 16);
    let token = fake.session.liveliness().declare_token(fake.keys.owner(&task_key("w"), &name("standby"), newer));
    let _token = token.await.expect("declared");
    let task = fake.task(AGAIN, drop).await;
    for sequence in 1..=3 {
        let error = task.twist(&frame(sequence)).await.expect_err("empty");
        assert!(matches!(error, ClientError::NoAnswer { .. }), "{error}");
    }
    assert_eq!(task.epoch(), newer);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_finds_no_owner_is_answered_by_the_next_one() {
    let fake = Fake::start().await;
    static QUESTIONS: AtomicU32 = AtomicU32::new(0);
    // Nobody, then the old owner's late answer and its last word, then the new owner.
    let handed_over = |query: Query| {
        let sequence = header_of(&query).sequence;
        match QUESTIONS.fetch_add(1, Ordering::Relaxed) {
            0 => drop(query),
            1 => reply_twist(&query, moving(sequence, EPOCH - 1)),
            2 => {
                let zeros = TwistMessage { sequence, epoch: EPOCH, ..TwistMessage::zero(Status::OwnerLost) };
                reply_twist(&query, zeros);
            }
            _ => reply_twist(&query, moving(sequence, EPOCH + (1 << 16))),
        }
    };
    let task = fake.task(LIMIT, handed_over).await;
    let twist = task.twist(&frame(7)).await.expect("the new owner's");
    assert_eq!((twist.sequence, twist.epoch, task.epoch()), (7, EPOCH + (1 << 16), EPOCH + (1 << 16)));
    assert_eq!(QUESTIONS.load(Ordering::Relaxed), 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_in_between_forgives_the_silences_before_it() {
    let fake = Fake::start().await;
    let every_third = |query: Query| {
        if header_of(&query).sequence.is_multiple_of(3) {
            obey(query);
        }
    };
    let task = fake.task(AGAIN, every_third).await;
    for sequence in 1..=6 {
        let answer = task.twist(&frame(sequence)).await;
        assert!(!matches!(answer, Err(ClientError::OwnerLost { .. })));
        assert_eq!(answer.is_ok(), sequence % 3 == 0);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_answer_is_not_taken_for_the_next_frame() {
    let fake = Fake::start().await;
    let held = Held::default();
    let holder = held.clone();
    static HOLDING: AtomicBool = AtomicBool::new(true);
    let hold_the_first = move |query| {
        if HOLDING.swap(false, Ordering::Relaxed) { holder.hold(query) } else { obey(query) }
    };
    let task = fake.task(SHORT, hold_the_first).await;
    let error = task.twist(&frame(1)).await.expect_err("too late");
    assert!(matches!(error, ClientError::NoAnswer { reason: Silence::TimedOut, .. }), "{error}");
    for query in held.release() {
        // The route may be gone by now; then there is nothing to be confused by.
        let _ = zenoh::Wait::wait(query.reply(query.key_expr(), moving(1, EPOCH).encode()));
    }
    // Scheduling on a busy machine may cost a frame or two; the wrong one never comes.
    let mut answers = Vec::new();
    for sequence in 2..=50 {
        answers.extend(task.twist(&frame(sequence)).await.ok().map(|twist| twist.sequence == sequence));
        if !answers.is_empty() {
            break;
        }
    }
    assert_eq!(answers, [true]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_twist_of_an_older_epoch_is_dropped() {
    let fake = Fake::start().await;
    let from_the_past = |query: Query| reply_twist(&query, moving(header_of(&query).sequence, EPOCH - 1));
    let task = fake.task(AGAIN, from_the_past).await;
    let error = task.twist(&frame(1)).await.expect_err("older");
    let ClientError::OlderEpoch { expected, got, .. } = error else { panic!("{error}") };
    assert_eq!((expected, got), (EPOCH, EPOCH - 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_newer_epoch_is_taken_over_and_ends_the_older() {
    let fake = Fake::start().await;
    static ANSWERS: AtomicU32 = AtomicU32::new(0);
    let newer_then_older = |query: Query| {
        let epoch = EPOCH + 1 - ANSWERS.fetch_add(1, Ordering::Relaxed);
        reply_twist(&query, moving(header_of(&query).sequence, epoch));
    };
    let task = fake.task(AGAIN, newer_then_older).await;
    task.twist(&frame(1)).await.expect("the new owner");
    assert_eq!(task.epoch(), EPOCH + 1);
    let error = task.twist(&frame(2)).await.expect_err("the old one");
    assert!(matches!(error, ClientError::OlderEpoch { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_twist_for_another_frame_is_dropped() {
    let fake = Fake::start().await;
    let task = fake.task(LIMIT, |query| reply_twist(&query, moving(41, EPOCH))).await;
    let error = task.twist(&frame(42)).await.expect_err("another frame's");
    assert!(matches!(error, ClientError::WrongSequence { expected: 42, got: 41, .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn zeros_for_a_frame_that_could_not_be_read_are_passed_on() {
    let fake = Fake::start().await;
    let bad = TwistMessage { epoch: EPOCH, ..TwistMessage::zero(Status::BadFrame) };
    let task = fake.task(LIMIT, move |query| reply_twist(&query, bad)).await;
    assert_eq!(task.twist(&frame(42)).await.expect("zeros").status, Status::BadFrame);
}

#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_no_twist_are_an_error() {
    let fake = Fake::start().await;
    let task = fake.task(LIMIT, |query| reply(&query, vec![1; 127])).await;
    let error = task.twist(&frame(1)).await.expect_err("127 bytes");
    assert!(matches!(error, ClientError::BadAnswer { .. }), "{error}");
}
