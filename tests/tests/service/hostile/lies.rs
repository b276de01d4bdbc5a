//! What is well formed and lies: a name that is a book, a mask that is none, an Encoding of something else, attachments of any length.

use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use domvs_proto::body::MAX_JSON_BYTES;
use domvs_proto::frame::{FrameHeader, PixelFormat};
use image::ExtendedColorType;
use rand::rngs::StdRng;
use rand::{RngCore, SeedableRng};
use serde_json::{Value, json};

use super::bombs::{bombs, pattern, photo};
use super::{MAX_BYTES, SEED, Siege};
use crate::support::{Answer, ErrorCode, Question, Status, ZEROS, code, png};

/// A refusal is read by people: it does not repeat a body of a megabyte.
const LONGEST_REFUSAL: usize = 1000;

fn refusal(answer: Answer) -> (ErrorCode, String) {
    match answer {
        Answer::Refused(error) => (error.code, error.error),
        good => panic!("expected a refusal, got {good:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_does_not_carry_what_was_refused() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let book = "x".repeat(MAX_JSON_BYTES / 3);
    let same_again = format!("{{{}}}", vec![r#""method":"hahn""#; 50_000].join(","));
    let many: Value =
        (0..50_000).map(|number| (format!("key{number}"), json!(1))).collect::<serde_json::Map<_, _>>().into();
    let create = "domvs/worker/w1/create/mallory".to_owned();
    for (what, body) in [
        ("an unknown name", json!({ &book: 1 }).to_string()),
        ("an unknown word", json!({ "method": &book, "do": &book }).to_string()),
        ("a word for a number", json!({ "epsilon": &book }).to_string()),
        ("the same name, 5 000 times, and no camera", format!("{{{}}}", vec![r#""method":"hahn""#; 5_000].join(","))),
        ("one name, 50 000 times, which are too many values", same_again),
        ("50 000 names", many.to_string()),
        ("a list of a list", json!({ "depth": vec![vec![0; 1000]; 100] }).to_string()),
    ] {
        assert!(body.len() <= MAX_JSON_BYTES, "{what} gets as far as the reader");
        for key in [keys.control(siege.key()), keys.settings(siege.key()), create.clone()] {
            let question = Question::on(key.as_str()).with(body.clone()).attached(siege.secret().as_bytes());
            if key == keys.settings(siege.key()) && what.starts_with("the same") {
                // The last of them counts, as everywhere in JSON, and it is the one in force.
                assert!(siege.ask(question).await.json().is_object());
                continue;
            }
            let (code, sentence) = refusal(siege.ask(question).await);
            assert!([ErrorCode::BadJson, ErrorCode::BadSettings].contains(&code), "{what} on {key}: {code}");
            assert!(sentence.len() <= LONGEST_REFUSAL, "{what} on {key}: a sentence of {} bytes", sentence.len());
        }
    }
    siege.goes_on("books").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn masks_that_lie_are_refused_when_they_are_sent_or_when_they_are_opened() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let white = |size: [u32; 2]| png(&vec![255; (size[0] * size[1]) as usize], size, ExtendedColorType::L8);
    let text = |png: &[u8]| STANDARD.encode(png);
    let wide = png(&vec![255; 96 * 72 * 2], [96, 72], ExtendedColorType::L16);
    let patch = |text: &str| json!({ "preprocess": { "mask": { "png_base64": text } } }).to_string();
    let settings =
        |body: String| Question::on(keys.settings(siege.key())).with(body).attached(siege.secret().as_bytes());
    for (what, body) in [
        ("no base64", patch("%%%")),
        ("no PNG", patch(&text(b"GIF89a"))),
        ("another size", patch(&text(&white([72, 96])))),
        ("2^62 pixels", patch(&text(&bombs().swap_remove(1).1))),
        ("16 bits", patch(&text(&wide))),
        ("cut off in its size", patch(&text(&white([96, 72])[..20]))),
        ("longer than it may be", patch(&"A".repeat(800_000))),
        ("a name more", json!({ "preprocess": { "mask": { "png_base64": "", "more": 1 } } }).to_string()),
    ] {
        let (code, sentence) = refusal(siege.ask(settings(body)).await);
        assert_eq!(code, ErrorCode::BadSettings, "{what}: {sentence}");
        assert!(sentence.len() <= LONGEST_REFUSAL, "{what}: a sentence of {} bytes", sentence.len());
    }
    // The right size in front, and something else behind: found when it is opened, which is at once, for there is a target.
    for (what, file) in bombs().into_iter().filter(|(what, _)| what.starts_with("96x72") || what.starts_with("no data"))
    {
        let answer = refusal(siege.ask(settings(patch(&text(&file)))).await);
        assert_eq!(answer.0, ErrorCode::BadTarget, "{what}: {}", answer.1);
    }
    siege.goes_on("masks").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_encoding_of_something_else_makes_a_bad_frame() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let (gray, photo) = (pattern(), photo());
    let file = png(&gray, [96, 72], ExtendedColorType::L8);
    for (what, encoding, payload) in [
        ("a PNG called JPEG", "image/jpeg", file.clone()),
        ("a JPEG called PNG", "image/png", photo.clone()),
        ("a PNG called GIF", "image/gif", file.clone()),
        ("a PNG called nothing", "", file.clone()),
        ("a PNG called JSON", "application/json", file.clone()),
        ("JSON called PNG", "image/png", br#"{"do": "start"}"#.to_vec()),
        ("pixels called PNG", "image/png", gray.clone()),
        ("a byte called JPEG", "image/jpeg", vec![0xff]),
        ("a JPEG without its end", "image/jpeg", photo[..photo.len() - 2].to_vec()),
        ("half a JPEG", "image/jpeg", photo[..photo.len() / 2].to_vec()),
    ] {
        let question =
            |key: String| Question::on(key).with(payload.clone()).encoded(encoding).attached(siege.secret().as_bytes());
        let twist = siege.ask(question(keys.twist(siege.key()))).await.twist();
        assert_eq!((twist.status, twist.twist), (Status::BadFrame, ZEROS), "{what}");
        assert_eq!(code(siege.ask(question(keys.target(siege.key()))).await), ErrorCode::BadTarget, "{what}");
    }
    siege.goes_on("wrong encodings").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn attachments_of_any_length_are_answered_and_move_nothing() {
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let mut rng = StdRng::seed_from_u64(SEED);
    let honest = FrameHeader { secret: Some(siege.secret()), ..FrameHeader::new(PixelFormat::Mono8, 96, 72) }.encode();
    for length in (0..=200).chain([1000, 100_000]) {
        let mut random = vec![0; length];
        rng.fill_bytes(&mut random);
        // The true bytes as far as they go, and more of them.
        let stretched: Vec<u8> = honest.iter().copied().cycle().take(length).collect();
        let attachments = if length == honest.len() { vec![random] } else { vec![random, stretched] };
        for attachment in attachments {
            let question = Question::on(keys.twist(siege.key())).with(vec![9; 96 * 72]).attached(attachment.clone());
            match siege.ask(question.encoded("application/octet-stream")).await {
                Answer::Refused(error) => assert_eq!(error.code, ErrorCode::NotOwner, "{length} bytes"),
                answer => {
                    let twist = answer.twist();
                    assert_eq!((twist.status, twist.twist), (Status::BadFrame, ZEROS), "{length} bytes");
                }
            }
            let question = Question::on(keys.control(siege.key())).with(r#"{"do": "stop"}"#).attached(attachment);
            assert_eq!(code(siege.ask(question).await), ErrorCode::NotOwner, "{length} bytes");
        }
    }
    siege.goes_on("attachments").await;
    siege.stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn sixty_four_mebibytes_on_any_key_are_refused_and_others_are_served() {
    const { assert!(64 << 20 > MAX_BYTES) };
    let mut siege = Siege::begin().await;
    let keys = siege.stage.keys.clone();
    let payload = vec![b' '; 64 << 20];
    let ask = |key: String| Question::on(key).with(payload.clone()).attached(siege.secret().as_bytes());
    for key in [keys.control(siege.key()), keys.settings(siege.key()), "domvs/worker/w1/create/mallory".to_owned()] {
        let question = ask(key);
        let selector = question.selector.clone();
        let (code, _) = refusal(siege.ask(question).await);
        assert!([ErrorCode::TooLarge, ErrorCode::BadJson].contains(&code), "{selector}: {code}");
    }
    let twist = siege.ask(ask(keys.twist(siege.key())).encoded("image/jpeg")).await.twist();
    assert_eq!((twist.status, twist.twist), (Status::BadFrame, ZEROS));
    assert_eq!(code(siege.ask(ask(keys.target(siege.key())).encoded("image/jpeg")).await), ErrorCode::TooLarge);
    siege.client.session().put(keys.frame(siege.key()), payload).await.expect("open");
    // The largest takes a while to arrive on a busy machine, before the questions that come behind it.
    tokio::time::timeout(Duration::from_secs(60), siege.goes_on("64 MiB")).await.expect("served");
    siege.stage.close().await;
}
