//! `domvs experiment`: the same rows however they are computed, sweeps that go on where they stopped, and what programs read.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// Two methods on a small image: a second of work in all.
const FILE: &str = r#"
name = "small"
images = 25
displacements = 3
methods = ["TM", "HM"]
[camera]
width = 48
height = 48
[start]
displacement = [0.06, -0.05, -0.08, -2, -4, -8]
[disturbance]
noise_variance = 0.0004
[settings]
order = { min = 4, max = 8 }
"#;

fn domvs(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_domvs")).arg("experiment").args(arguments).output().unwrap()
}

fn experiment(folder: &Path, verb: &str, arguments: &[&str]) -> Output {
    let file = folder.join("small.toml");
    std::fs::write(&file, FILE).unwrap();
    domvs(&[&[verb, file.to_str().unwrap(), "--json"], arguments].concat())
}

fn lines(output: &Output) -> Vec<Value> {
    let text = std::str::from_utf8(&output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The rows of a run without the two columns that a clock made.
fn rows(folder: &Path) -> Vec<Vec<String>> {
    let mut reader = csv::Reader::from_path(folder.join("frames.csv")).unwrap();
    let kept: Vec<usize> = reader
        .headers()
        .unwrap()
        .iter()
        .enumerate()
        .filter(|(_, name)| !name.ends_with("_us"))
        .map(|(i, _)| i)
        .collect();
    reader.records().map(|row| row.unwrap()).map(|row| kept.iter().map(|&i| row[i].to_owned()).collect()).collect()
}

#[test]
fn the_real_service_gives_the_same_rows_as_the_call_in_process_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    let run = |name: &str, more: &[&str]| {
        let output = experiment(folder.path(), "run", &[&["--out", out(name).to_str().unwrap()], more].concat());
        assert!(output.status.code().is_some_and(|code| code == 0 || code == 3), "{output:?}");
        lines(&output)
    };
    assert_eq!(run("process", &[]), run("zenoh", &["--over-zenoh"]));
    for method in ["small-tm", "small-hm"] {
        let rows = [rows(&out("process").join(method)), rows(&out("zenoh").join(method))];
        assert!(rows[0].len() > 5);
        assert_eq!(rows[0], rows[1], "{method}");
    }
}

#[test]
fn a_sweep_does_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = |jobs: &str| {
        let out = folder.path().join(jobs);
        lines(&experiment(folder.path(), "sweep", &["--jobs", jobs, "--out", out.to_str().unwrap()]))
    };
    let alone = sweep("1");
    assert_eq!(alone.len(), 2 * 3 + 2, "six runs, then two cells");
    assert_eq!(alone, sweep("4"));
    let seeds: Vec<&Value> = alone[..6].iter().map(|run| &run["seed"]).collect();
    assert_eq!(seeds, [1, 1, 2, 2, 3, 3], "methods share their seeds");
    assert!(alone[6]["success_rate"].is_number() && alone[6]["wilson_low"].is_number());
}

#[test]
fn a_sweep_goes_on_where_it_was_torn_and_does_only_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let sweep = || lines(&experiment(folder.path(), "sweep", &["--jobs", "1", "--out", out.to_str().unwrap()]));
    let whole = sweep();
    let file = out.join("results.jsonl");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() - 20]).unwrap();

    assert_eq!(sweep(), whole);
    let mended = std::fs::read(&file).unwrap();
    assert_eq!(mended, bytes, "the torn line was written again, and no other");
    sweep();
    assert_eq!(std::fs::read(&file).unwrap(), bytes, "nothing was missing");
}

#[test]
fn what_is_no_experiment_method_or_key_is_named_in_the_error() {
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.toml");
    std::fs::write(&bad, "name = 'bad'\nimage = 3").unwrap();
    let cases: [(&[&str], &[&str]); 3] = [
        (&["run", "no-such"], &["no-such", "1"]),
        (&["run", bad.to_str().unwrap()], &["bad.toml", "image"]),
        (&["run", "1", "--method", "sift"], &["sift", "HM"]),
    ];
    for (arguments, words) in cases {
        let output = domvs(arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn the_list_names_every_experiment_of_the_paper() {
    let names: Vec<Value> = lines(&domvs(&["list", "--json"])).into_iter().map(|line| line["name"].clone()).collect();
    for name in ["1", "2", "3", "noise", "5", "6", "7", "case1", "case2", "case3", "discussion"] {
        assert!(names.contains(&name.into()), "{name} in {names:?}");
    }
}

#[test]
fn a_small_grid_converges_where_it_did() {
    /// Three starts of each cell at 64 pixels: a law that gets worse shows here. Successes of three, as they were when last looked at.
    const GRID: &str = r#"
        name = "grid"
        seed = 5
        displacements = 3
        methods = ["default", "HM", "TM", "KM", "DCT", "DVS", { name = "PGM8", settings = { method = "gaussian_mixture", gaussian_px = 8.0 } }]
        scenes = ["object", "plane", "boxes", "terrain"]
        [camera]
        width = 64
        height = 64
        [start]
        random = { scale = 0.6, roll_deg = 20 }
    "#;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("grid.toml");
    std::fs::write(&file, GRID).unwrap();
    let out = folder.path().join("out");
    let output = domvs(&["sweep", file.to_str().unwrap(), "--json", "--out", out.to_str().unwrap()]);
    let cells: Vec<Value> = lines(&output).into_iter().filter(|line| line["success_rate"].is_number()).collect();
    let table: Vec<String> = cells
        .chunks(7)
        .map(|scene| {
            let successes: Vec<String> = scene.iter().map(|cell| cell["successes"].to_string()).collect();
            format!("{} {}", scene[0]["scene"].as_str().unwrap(), successes.join(" "))
        })
        .collect();
    // In the order of the methods above. Another kind of machine may differ by a run that is at its limit.
    let seen = ["object 3 3 3 3 3 3 3", "plane 3 3 3 3 3 3 3", "boxes 3 3 3 3 3 2 3", "terrain 3 3 3 3 3 3 3"];
    assert_eq!(table, seen);
}

#[test]
fn results_become_a_report_and_pictures_without_a_word_from_outside() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let small = ["--images", "3", "--size", "48x48", "--method", "TM"];
    domvs(&[&["run", "5", "--out", &at("r/5")], &small[..]].concat());
    let output = domvs(&["report", "--from", &at("r"), "--out", &at("report.md")]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = std::fs::read_to_string(at("report.md")).unwrap();
    assert!(report.contains("## Claims") && report.contains("| picture on a wall |"), "{report}");
    let size = ["--size", "48x48", "--steps", "5"];
    let maps = ["landscape", "--method", "TM,DVS", "--order", "4", "--out", &at("l")];
    assert_eq!(domvs(&[&maps[..], &size[..]].concat()).status.code(), Some(0));
    assert_eq!(domvs(&["basis", "--length", "64", "--out", &at("b")]).status.code(), Some(0));
    for page in ["r/5/index.html", "l/index.html", "b/index.html"] {
        let html = std::fs::read_to_string(at(page)).unwrap();
        let svg_name = html.replace("http://www.w3.org/2000/svg", "").replace("http://www.w3.org/1999/xlink", "");
        assert!(html.contains("<svg") && !svg_name.contains("http") && !html.contains("<script"), "{page}");
    }
}
