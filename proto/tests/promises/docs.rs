//! `docs/protocol.md` says what the code does: its tables, layouts, defaults and examples are compared here.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::PathBuf;

use domvs_proto::body::MAX_JSON_BYTES;
use domvs_proto::frame::{DepthFormat, HEADER_BYTES, PixelFormat};
use domvs_proto::keys::{Keys, Leaf, Name, TaskKey};
use domvs_proto::messages::ErrorCode;
use domvs_proto::settings::{TaskSettings, table};
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_BYTES, TwistFlags};
use serde_json::Value;

fn file(path: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn protocol() -> String {
    file("../docs/protocol.md")
}

fn assert_documented(text: &str) {
    assert!(protocol().contains(text), "docs/protocol.md must hold:\n{text}");
}

/// The contents of the fenced blocks of one language.
fn blocks(language: &str) -> Vec<String> {
    let (text, fence) = (protocol(), format!("```{language}\n"));
    text.split(&fence).skip(1).map(|rest| rest.split("```").next().unwrap().to_owned()).collect()
}

fn json_blocks() -> Vec<Value> {
    blocks("json").iter().map(|block| serde_json::from_str(block).unwrap()).collect()
}

#[test]
fn settings_table_is_the_one_in_the_code() {
    assert_documented(&table());
}

#[test]
fn status_table_is_the_one_in_the_code() {
    let mut rows = "| code | status | latched | meaning | what to do |\n|---|---|---|---|---|".to_owned();
    for status in Status::ALL {
        let latched = if status.is_latched() { "yes" } else { "" };
        let (code, meaning, advice) = (status.code(), status.meaning(), status.advice());
        rows += &format!("\n| {code} | `{status}` | {latched} | {meaning} | {advice} |");
    }
    assert_documented(&rows);
}

#[test]
fn error_code_table_is_the_one_in_the_code() {
    let mut rows = "| code | meaning |\n|---|---|".to_owned();
    for code in ErrorCode::ALL {
        rows += &format!("\n| `{code}` | {} |", code.meaning());
    }
    assert_documented(&rows);
}

#[test]
fn default_settings_are_those_of_the_code() {
    let defaults = json_blocks().into_iter().find(|block| block.get("idle_close_s").is_some()).unwrap();
    let read = TaskSettings::from_json(&defaults).unwrap();
    assert_eq!(read, TaskSettings::new(read.camera));
    assert_eq!(defaults, read.to_value());
}

#[test]
fn json_examples_are_the_golden_ones() {
    let documented = json_blocks();
    for name in [
        "create",
        "create_reply",
        "control",
        "control_reply",
        "status",
        "task_progress",
        "task_closed",
        "worker_info",
        "camera_info",
        "error_reply",
        "twist",
    ] {
        let golden: Value = serde_json::from_str(&file(&format!("golden/v1/{name}.json"))).unwrap();
        assert!(documented.contains(&golden), "{name} is not among the examples");
    }
}

#[test]
fn layouts_and_sizes_are_printed() {
    for text in ["`<BBBBIIIIfQQII`", "`<BBHHHQQIIII6d3dd8x`"] {
        assert_documented(text);
    }
    assert_documented(&format!("{HEADER_BYTES} bytes"));
    assert_documented(&format!("{TWIST_BYTES} bytes"));
    assert_documented(&format!("{} KiB", MAX_JSON_BYTES / 1024));
    for (bit, word) in TwistFlags::WORDS.iter().enumerate() {
        assert_documented(&format!("| {bit} | `{word}` |"));
    }
}

#[test]
fn every_format_code_is_printed() {
    let names = ["by Encoding", "mono8", "mono16", "rgb8", "bgr8", "rgba8", "bgra8", "mono32f", "yuyv", "nv12"];
    for (format, name) in PixelFormat::ALL.into_iter().zip(names) {
        assert_documented(&format!("| {} | {name} |", format.code()));
    }
    for (format, name) in DepthFormat::ALL.into_iter().zip(["none", "u16", "f32"]) {
        assert_documented(&format!("| {} | {name} |", format.code()));
    }
}

#[test]
fn every_key_is_printed() {
    let keys = Keys::default();
    let (wid, cid, id) = ("W", "C", "I");
    let name = |text: &str| Name::try_from(text).unwrap();
    let task = TaskKey { client: name(cid), id: name(id) };
    let mut all: Vec<String> = Leaf::ALL.iter().map(|leaf| keys.task(&task, *leaf)).collect();
    all.extend([
        keys.worker_alive(&name(wid)),
        keys.worker_info(&name(wid)),
        keys.create(&name(wid), &name(cid)),
        keys.owner(&task, &name(wid), 0).replace("/0", "/<epoch>"),
        keys.client_alive(&name(cid)),
        keys.camera_frame(&name("N")).replace("frame", "{frame,info,alive}"),
        keys.stop(),
    ]);
    for key in all {
        let key =
            key.replace("/W", "/<wid>").replace("/C/", "/<cid>/").replace("/I/", "/<id>/").replace("/N/", "/<name>/");
        let key = key.strip_suffix("/C").map(|rest| format!("{rest}/<cid>")).unwrap_or(key);
        assert_documented(&format!("| `{key}` |"));
    }
}

#[test]
fn there_is_one_complete_example_in_python() {
    let complete = blocks("python").into_iter().filter(|block| block.contains("zenoh.open"));
    assert_eq!(complete.count(), 1);
}
