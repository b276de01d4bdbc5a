//! Every input of `fuzz/corpus` again: the seeds, and what the fuzzer found and was mended. `fuzz/run` looks for more.

use std::path::{Path, PathBuf};

#[path = "../../../../fuzz/src/targets/mod.rs"]
mod targets;

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target)
}

/// The committed inputs of one target.
fn inputs(target: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder(target)).unwrap_or_else(|error| panic!("{target}: {error}"));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.sort();
    paths
}

#[test]
fn every_committed_input_keeps_what_its_decoder_promises() {
    for (target, look) in targets::ALL {
        let inputs = inputs(target);
        assert!(!inputs.is_empty(), "{target} has no seeds");
        for path in inputs {
            // A panic says nothing of the file.
            println!("{}", path.display());
            look(&std::fs::read(&path).expect("readable"));
        }
    }
}

#[test]
fn every_folder_of_inputs_has_its_target() {
    for entry in std::fs::read_dir(folder("")).expect("a folder") {
        let name = entry.expect("readable").file_name();
        assert!(targets::ALL.iter().any(|(target, _)| *target == name), "{name:?}");
    }
}

#[test]
fn a_state_file_written_by_another_program_is_read() {
    let read = |name: &str| {
        let bytes = std::fs::read(folder("state").join(name)).expect("fuzz/seeds.py wrote it");
        domvs_server::state_file::decode(&bytes).map(|(_, target)| target.map(|target| target.payload.len()))
    };
    assert_eq!(read("seed-bare"), Ok(None));
    assert_eq!(read("seed-target"), Ok(Some(24 * 16)));
    assert!(read("seed-another_target").is_err() && read("seed-unnamed_target").is_err());
}
