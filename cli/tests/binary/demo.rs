//! `domvs demo`: the main job converges, says so, and leaves its files.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn demo(out: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_domvs"));
    command.arg("demo").arg("--json").arg("--out").arg(out).args(arguments).output().unwrap()
}

fn result(output: &Output) -> Value {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(text.lines().last().unwrap()).unwrap()
}

#[test]
fn the_main_job_converges_and_leaves_its_files() {
    let out = tempfile::tempdir().unwrap();
    let output = demo(out.path(), &["--size", "160x160"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let result = result(&output);
    assert_eq!((&result["converged"], &result["status"]), (&true.into(), &"converged".into()));
    assert!(result["error_mm"].as_f64().unwrap() < 1.0 && result["error_deg"].as_f64().unwrap() < 0.1, "{result}");
    for key in ["images", "compute_ms", "round_trip_ms"] {
        assert!(result[key].as_f64().unwrap() > 0.0, "{key} in {result}");
    }
    let files = ["desired.png", "initial.png", "final.png", "difference.png", "frames.csv", "settings.json"];
    let plots = ["pixel_error.svg", "twist.svg", "order.svg", "pose_error.svg", "camera_path.svg"];
    for file in files.iter().chain(&plots) {
        assert!(out.path().join(file).metadata().unwrap().len() > 0, "{file}");
    }
    let rows = std::fs::read_to_string(out.path().join("frames.csv")).unwrap();
    assert_eq!(
        rows.lines().count() as u64,
        result["images"].as_u64().unwrap() + 1,
        "one row an image, and the headings"
    );
}

#[test]
fn the_same_demo_twice_is_the_same_to_the_last_digit() {
    let run = || {
        let out = tempfile::tempdir().unwrap();
        let output = demo(out.path(), &["--size", "96x96", "--noise", "0.01", "--seed", "7", "--max-images", "12"]);
        (result(&output)["error_mm"].clone(), std::fs::read(out.path().join("final.png")).unwrap())
    };
    assert_eq!(run(), run());
}

#[test]
fn giving_up_is_not_converging() {
    let out = tempfile::tempdir().unwrap();
    let output = demo(out.path(), &["--size", "96x96", "--max-images", "2"]);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(result(&output)["converged"], false);
}

#[test]
fn a_photograph_that_is_none_is_named_in_the_error() {
    let out = tempfile::tempdir().unwrap();
    let output = demo(out.path(), &["--texture", "no/such.jpg"]);
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error.contains("no/such.jpg") && error.contains("astronaut"), "{error}");
}

#[test]
fn a_window_or_size_that_is_none_is_a_usage_error() {
    let out = tempfile::tempdir().unwrap();
    for arguments in [["--window", "wide"], ["--size", "12"], ["--method", "sift"], ["--order", "16..4"]] {
        assert_eq!(demo(out.path(), &arguments).status.code(), Some(2), "{arguments:?}");
    }
}
