//! `domvs bench`: what a script reads, and what it is told when it asks for the impossible. No time is asserted.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn bench(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_domvs"));
    command.current_dir(folder).arg("bench").args(arguments).output().unwrap()
}

fn rows(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn has_positive(row: &Value, keys: &[&str]) {
    for key in keys {
        assert!(row[key].as_f64().is_some_and(|number| number > 0.0), "{key} in {row}");
    }
}

const TIMES: [&str; 3] = ["median_ms", "p99_ms", "frames_per_s"];

#[test]
fn steps_are_an_array_of_objects_with_the_promised_keys_and_a_plot_of_what_was_varied() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["step", "--json", "--steps", "20", "--size", "48x36,37x41", "--order", "3,8", "--depth", "map"];
    let rows = rows(&bench(folder.path(), &sizes));
    assert_eq!(rows.len(), 2 * 2 * 2);
    for row in &rows {
        has_positive(row, &TIMES);
        has_positive(row, &["gflops", "peak_fraction", "peak_gflops", "multiply_adds"]);
        assert_eq!((&row["method"], &row["depth"]), (&"hahn".into(), &"map".into()));
        let bases = if row["case"] == "moved" { 2.0 } else { 0.0 };
        assert_eq!(row["bases_per_step"].as_f64(), Some(bases), "{row}");
    }
    assert_eq!((&rows[0]["case"], &rows[0]["size"], &rows[0]["order"]), (&"moved".into(), &"48x36".into(), &3.into()));
    let plot = std::fs::read_to_string(folder.path().join("runs/bench/step.svg")).unwrap();
    assert!(plot.contains("thousand pixels") && plot.contains("order l") && plot.contains("l = 3"));
}

#[test]
fn methods_on_pixels_have_no_order_and_are_always_cached() {
    let folder = tempfile::tempdir().unwrap();
    let methods = "photometric,gaussian_mixture";
    let output = bench(folder.path(), &["step", "--json", "--steps", "5", "--size", "32x32", "--method", methods]);
    let rows = rows(&output);
    assert_eq!(rows.len(), 2 * 2, "two depths, and nothing that could move");
    for row in &rows {
        has_positive(row, &TIMES);
        has_positive(row, &["gflops", "peak_fraction"]);
        assert_eq!((&row["case"], &row["order"]), (&"cached".into(), &0.into()));
    }
    assert!(!folder.path().join("runs").exists(), "one size and no order: nothing to draw");
}

#[test]
fn a_round_trip_stands_beside_its_echo() {
    let folder = tempfile::tempdir().unwrap();
    let case = ["--json", "--size", "64x48", "--order", "4", "--depth", "map", "--samples", "5"];
    let rows = rows(&bench(folder.path(), &[&["roundtrip"], &case[..]].concat()));
    assert_eq!(rows.iter().map(|row| row["case"].as_str().unwrap()).collect::<Vec<_>>(), ["echo", "moved", "cached"]);
    for row in &rows {
        has_positive(row, &TIMES);
        assert_eq!((&row["payload_bytes"], &row["gflops"]), (&(3 * 64 * 48).into(), &Value::Null));
    }
    assert!(rows[0]["step_ms"].is_null() && rows[1]["step_ms"].is_number() && rows[2]["overhead_ms"].is_number());
}

#[test]
fn under_load_every_frame_is_accounted_for() {
    let folder = tempfile::tempdir().unwrap();
    let load =
        ["load", "--json", "--size", "48x36", "--order", "4", "--tasks", "1,3", "--rate", "40", "--seconds", "0.25"];
    let rows = rows(&bench(folder.path(), &load));
    assert_eq!(rows.len(), 2);
    for row in &rows {
        has_positive(row, &TIMES);
        let count = |key: &str| row[key].as_u64().unwrap();
        let parts = ["servoing", "overloaded", "deadline_missed", "other_status", "unanswered"];
        assert_eq!(parts.iter().map(|key| count(key)).sum::<u64>(), count("sent"), "{row}");
        assert_eq!(row["per_task"].as_array().unwrap().len() as u64, count("tasks"));
    }
    assert!(folder.path().join("runs/bench/load.svg").exists());
}

#[test]
fn the_images_are_there_for_others() {
    let folder = tempfile::tempdir().unwrap();
    assert!(bench(folder.path(), &["images", "--size", "33x20", "--out", "."]).status.success());
    for name in ["desired", "current", "moved"] {
        let gray = image::open(folder.path().join(format!("{name}.png"))).unwrap();
        let depth = image::open(folder.path().join(format!("{name}_depth.png"))).unwrap();
        assert_eq!((gray.width(), gray.height(), depth.width()), (33, 20, 33));
        assert!(depth.as_luma16().unwrap().pixels().all(|pixel| pixel.0[0] > 0));
    }
}

#[test]
fn the_impossible_is_refused_with_the_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |code: i32, arguments: &[&str], words: &[&str]| {
        let output = bench(folder.path(), arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {error}");
        assert!(words.iter().all(|word| error.contains(word)), "{arguments:?}: {error}");
    };
    refused(1, &["step", "--size", "64x48", "--order", "46"], &["64x48", "46", "up to 45"]);
    refused(2, &["step", "--size", "5000x100"], &["5000x100", "4096x4096"]);
    refused(2, &["step", "--method", "sift"], &["sift", "hahn"]);
    refused(2, &["step", "--steps", "0"], &["0", "1 to 1000000"]);
    refused(1, &["step", "--path", "quantum"], &["quantum", "this machine has"]);
    refused(2, &["load", "--rate", "-1"], &["-1"]);
    refused(2, &["load", "--overload", "3", "--rate", "10"], &["--overload", "--rate"]);
    refused(1, &["roundtrip", "-e", "tcp/127.0.0.1:1", "--size", "32x32"], &["127.0.0.1:1"]);
}

/// Too short for memory to say anything; every fault comes all the same.
#[test]
fn a_short_soak_judges_every_twist_and_finds_no_wrong_motion() {
    let folder = tempfile::tempdir().unwrap();
    let short = ["soak", "--minutes", "0.3", "--tasks", "4", "--seed", "7", "--json", "--out", "out"];
    let output = bench(folder.path(), &short);
    let verdict: Value = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
    let checks = verdict["checks"].as_array().unwrap();
    // What is said of motion must hold on any machine; a busy one may be too slow for the rest within seconds.
    for check in &checks[..7] {
        assert_eq!(check["held"], true, "{check}");
    }
    assert_eq!(output.status.code(), Some(if verdict["passed"] == true { 0 } else { 1 }));
    has_positive(&verdict["figures"], &["frames sent", "twists", "answers and commands"]);
    assert_eq!(verdict["faults"]["worker killed"], 1);
    assert!(folder.path().join("out/soak.json").exists());
}
