//! docs/safety.md says which test holds each promise. Here is that there are such tests, and that the numbers are the code's.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use domvs_proto::settings::{Camera, TaskSettings};
use domvs_proto::status::Status;
use domvs_server::{DRIFT_NS_PER_S, SETTLING, TICK, TOKEN_GRACE, ZERO_PERIOD, screen};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace").to_owned()
}

fn safety() -> String {
    std::fs::read_to_string(root().join("docs/safety.md")).expect("the document is there")
}

/// The names of all Rust tests, and of all Python functions in `tests`.
fn tests() -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for crate_folder in ["vision", "proto", "server", "client", "simulators", "cli", "tests", "fuzz"] {
        read_folder(&root().join(crate_folder), &mut names);
    }
    names
}

fn read_folder(folder: &Path, names: &mut BTreeSet<String>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        let name = entry.file_name();
        if path.is_dir() && !["target", "node_modules", ".git"].iter().any(|skipped| name == *skipped) {
            read_folder(&path, names);
        }
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("rs") => names.extend(defined(&read(&path), "fn ", true)),
            Some("py") => names.extend(defined(&read(&path), "def ", false)),
            _ => {}
        }
    }
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// The functions of a source; of Rust only those right behind an attribute that makes them a test.
fn defined(source: &str, word: &str, needs_attribute: bool) -> Vec<String> {
    let (mut names, mut is_test) = (Vec::new(), false);
    for line in source.lines().map(str::trim) {
        if line.starts_with("#[") {
            is_test |= line.starts_with("#[test]") || line.starts_with("#[tokio::test");
            continue;
        }
        let declared = line.strip_prefix("async ").unwrap_or(line).strip_prefix(word);
        if let (Some(rest), true) = (declared, is_test || !needs_attribute) {
            names.push(rest.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect());
        }
        is_test = false;
    }
    names
}

pub fn assert_is_a_test(name: &str) {
    assert!(tests().contains(name), "there is no test {name}");
}

/// What stands between backquotes.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Whether this is a sentence, as the names of tests are.
fn is_a_name(quoted: &str) -> bool {
    quoted.matches('_').count() >= 4 && quoted.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
}

/// The rows of the table of promises: number, promise, how, held by.
fn promises(document: &str) -> Vec<Vec<String>> {
    let rows =
        document.lines().filter(|line| line.starts_with("| ") && line[2..].starts_with(|c: char| c.is_ascii_digit()));
    let cells =
        rows.map(|row| row.trim_matches('|').split(" | ").map(|cell| cell.trim().to_owned()).collect::<Vec<_>>());
    cells.filter(|cells| cells.len() == 4).collect()
}

#[test]
fn every_promise_of_the_safety_page_names_a_test_that_exists() {
    let (document, tests) = (safety(), tests());
    let promises = promises(&document);
    assert!(promises.len() >= 20, "only {} rows were found", promises.len());
    for (index, row) in promises.iter().enumerate() {
        assert_eq!(row[0], (index + 1).to_string(), "the promises are numbered");
        assert!(quoted(&row[3]).any(|name| tests.contains(name)), "promise {} has no test: {}", row[0], row[3]);
        assert!(row[2].contains('`'), "promise {} names no code: {}", row[0], row[2]);
    }
    let missing: Vec<&str> = quoted(&document).filter(|name| is_a_name(name) && !tests.contains(*name)).collect();
    assert!(missing.is_empty(), "docs/safety.md speaks of tests that do not exist: {missing:?}");
}

#[test]
fn the_safety_page_has_a_row_for_every_status_and_says_whether_it_is_latched() {
    let document = safety();
    for status in Status::ALL {
        let row = document.lines().find(|line| line.starts_with(&format!("| `{status}` |")));
        let row = row.unwrap_or_else(|| panic!("no row for {status}"));
        let latched = row.split('|').nth(2).map(str::trim) == Some("yes");
        assert_eq!(latched, status.is_latched(), "{row}");
    }
}

/// What the page says in passing, with the numbers of the code.
#[test]
fn the_times_and_limits_of_the_safety_page_are_those_of_the_code() {
    let camera = Camera { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0, width: 8, height: 8, distortion: None };
    let settings = TaskSettings::new(camera);
    let (cap, limits) = (settings.step_cap.expect("by default"), settings.limits.expect("by default"));
    let (tick, hertz) = (TICK.as_millis(), 1000 / ZERO_PERIOD.as_millis());
    let document = safety();
    let promises = promises(&document);
    let said = |row: usize| format!("{} {}", promises[row - 1][1], promises[row - 1][2]);
    for (row, words) in [
        (4, format!("at most {} m and {} rad before", cap.translation_m, cap.rotation_rad)),
        (4, format!("at most {} m/s and {} rad/s", limits.linear_m_per_s, limits.angular_rad_per_s)),
        (5, format!("at most {} m/s² and {} rad/s²", limits.linear_m_per_s2, limits.angular_rad_per_s2)),
        (9, format!("looked at every {tick} ms), then at {hertz} Hz")),
        (22, format!("looked at every {tick} ms")),
    ] {
        assert!(said(row).contains(&words), "row {row} does not say: {words}");
    }
    let document = document.replace('\n', " ");
    for words in [
        format!("at most {} ms/s", DRIFT_NS_PER_S / 1_000_000),
        format!("held for {} s", SETTLING.as_secs_f64()),
        format!("never came within {} s", TOKEN_GRACE.as_secs()),
    ] {
        assert!(document.contains(&words), "the page does not say: {words}");
    }
}

#[test]
fn the_thresholds_of_the_safety_page_are_those_of_the_code() {
    let document = safety();
    let both = |threshold: screen::Threshold| [threshold.refuse_below, threshold.until];
    for (name, numbers) in [
        ("contrast", both(screen::CONTRAST)),
        ("clipped", both(screen::UNCLIPPED)),
        ("known depth", both(screen::KNOWN_DEPTH)),
        ("rank", both(screen::SINGULAR_RATIO)),
        ("frozen", [f64::from(screen::FROZEN_FRAMES), screen::FROZEN_MOTION_PX]),
        ("diverging", [f64::from(domvs_server::DIVERGING_FRAMES), 2.0]),
    ] {
        let row = document.lines().find(|line| line.starts_with(&format!("| {name} |")));
        let row = row.unwrap_or_else(|| panic!("no threshold {name}"));
        for number in numbers {
            assert!(row.split([' ', '|', ',']).any(|word| word.parse() == Ok(number)), "{number} is not in: {row}");
        }
    }
}
