//! Who knows whom: the crates of the workspace depend on each other as ARCHITECTURE.md draws it, and on nothing more.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

/// What each crate is built from; tests of a crate may use more.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/../Cargo.toml");
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--format-version", "1", "--offline", "--manifest-path", manifest])
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let text = |value: &Value| value.as_str().expect("text").to_owned();
    let needed = |package: &Value| {
        let all = package["dependencies"].as_array().expect("a list").iter();
        all.filter(|dependency| dependency["kind"].is_null()).map(|dependency| text(&dependency["name"])).collect()
    };
    let packages = metadata["packages"].as_array().expect("a list").iter();
    packages.map(|package| (text(&package["name"]), needed(package))).collect()
}

/// The crates of this workspace that a crate is built from.
fn ours(all: &BTreeMap<String, BTreeSet<String>>, package: &str) -> Vec<String> {
    all[package].iter().filter(|dependency| dependency.starts_with("domvs")).cloned().collect()
}

#[test]
fn vision_and_proto_know_nothing_of_each_other_and_server_and_simulators_join_them() {
    let all = dependencies();
    let none: [&str; 0] = [];
    assert_eq!(ours(&all, "domvs-vision"), none);
    assert_eq!(ours(&all, "domvs-proto"), none);
    assert_eq!(ours(&all, "domvs-client"), ["domvs-proto"]);
    assert_eq!(ours(&all, "domvs-server"), ["domvs-proto", "domvs-vision"]);
    assert_eq!(ours(&all, "domvs-simulators"), ["domvs-proto", "domvs-vision"]);
    assert_eq!(ours(&all, "domvs-tests"), none, "only the tests themselves see everything");
}

#[test]
fn nothing_depends_on_the_command_line() {
    for (package, needed) in dependencies() {
        assert!(!needed.contains("domvs"), "{package} is built from the command line");
    }
}

#[test]
fn the_paper_knows_no_network_no_image_files_and_no_serialisation() {
    let all = dependencies();
    let of = |package: &str| all[package].iter().map(String::as_str).collect::<Vec<_>>();
    assert_eq!(of("domvs-vision"), ["fearless_simd", "nalgebra", "thiserror"]);
    assert_eq!(of("domvs-proto"), ["base64", "serde", "serde_json", "sha3", "thiserror"]);
}
