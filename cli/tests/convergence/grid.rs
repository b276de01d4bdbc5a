//! The grid of grid.toml, counted, against grid.txt. After a change that is meant to move it:
//! `DOMVS_BLESS=1 cargo test --release -p domvs --test convergence grid`, and look at the diff.

use std::fmt::Write as _;

use domvs::experiment::cells::{Cell, cells};

use super::lab::sweep;

const SNAPSHOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/convergence/grid.txt");

/// A line for each scene and disturbance, a column for each method: how many runs converged, and after how many images (median).
fn table(cells: &[Cell]) -> String {
    let mut methods: Vec<&str> = Vec::new();
    let mut places: Vec<(&str, &str)> = Vec::new();
    for cell in cells {
        if !methods.contains(&cell.method.as_str()) {
            methods.push(&cell.method);
        }
        if !places.contains(&(&cell.scene, &cell.disturbance)) {
            places.push((&cell.scene, &cell.disturbance));
        }
    }
    let mut text = format!("{:9}{:13}", "scene", "disturbance");
    methods.iter().for_each(|method| write!(text, "{method:>12}").expect("a string takes all"));
    for (scene, disturbance) in places {
        write!(text, "\n{scene:9}{disturbance:13}").expect("a string takes all");
        for method in &methods {
            let is_here = |cell: &&Cell| {
                (&cell.scene[..], &cell.disturbance[..], &cell.method[..]) == (scene, disturbance, *method)
            };
            let cell = cells.iter().find(is_here).expect("a full grid");
            let images = cell.median_images.map_or_else(|| "-".to_owned(), |images| format!("{images:.0}"));
            write!(text, "{:>12}", format!("{}/{} {images:>3}", cell.successes, cell.runs))
                .expect("a string takes all");
        }
    }
    text + "\n"
}

/// The successes of a table, line by line.
fn successes(table: &str) -> Vec<u32> {
    table.split_whitespace().filter_map(|word| word.split_once('/')?.0.parse().ok()).collect()
}

fn difference(expected: &str, got: &str) -> String {
    let mut text = String::new();
    for (expected, got) in expected.lines().zip(got.lines()) {
        let sign = |sign: char, line: &str| format!("{sign} {line}\n");
        text += &if expected == got { sign(' ', got) } else { sign('-', expected) + &sign('+', got) };
    }
    text
}

#[test]
fn the_small_grid_comes_out_as_its_snapshot_says() {
    let got = table(&cells(&sweep(include_str!("grid.toml"))));
    if std::env::var_os("DOMVS_BLESS").is_some() {
        std::fs::write(SNAPSHOT, &got).unwrap();
    }
    let expected = std::fs::read_to_string(SNAPSHOT).unwrap();
    let (before, now) = (successes(&expected), successes(&got));
    // On x86-64 with glibc a run is the same to the last bit. Elsewhere sine and exponential round otherwise, and a run on the edge may tip.
    let slack = if cfg!(all(target_arch = "x86_64", target_env = "gnu")) { 0 } else { 1 };
    let tipped = before.iter().zip(&now).filter(|(before, now)| before.abs_diff(**now) > slack).count();
    let is_same = before.len() == now.len() && tipped == 0 && (slack > 0 || expected == got);
    assert!(is_same, "grid.txt (-) and this run (+):\n{}", difference(&expected, &got));
}

#[test]
fn a_snapshot_that_differs_is_shown_as_its_lines() {
    assert_eq!(difference("a 1/3\nb 2/3", "a 1/3\nb 3/3"), "  a 1/3\n- b 2/3\n+ b 3/3\n");
    assert_eq!(successes("x 0.7 I 1/3 12 0/3 -\ny 3/3 9"), [1, 0, 3]);
}
