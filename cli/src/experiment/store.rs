//! The results of a sweep on disk: one JSON object a line, only ever appended to. What was interrupted goes on from here.
//!
//! A line is written in one call and flushed; a crash can only tear the last one, and a torn line is cut off when the file
//! is opened again. Lines of another plan (another file, seed or version) stay and are not looked at.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::outcome::Outcome;

/// An open results file.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    file: File,
    known: HashMap<String, Outcome>,
}

impl Store {
    /// Opens `path`, or makes it, and reads what is there.
    ///
    /// # Errors
    /// Fails when the file cannot be read or written.
    pub fn open(path: &Path) -> anyhow::Result<Store> {
        let failed = || format!("cannot open {}", path.display());
        let mut file = OpenOptions::new().read(true).append(true).create(true).open(path).with_context(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).with_context(failed)?;
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |newline| newline + 1);
        if whole < bytes.len() {
            tracing::warn!(path = %path.display(), bytes = bytes.len() - whole, "a torn last line was dropped");
            file.set_len(whole as u64).with_context(failed)?;
            file.seek(SeekFrom::End(0)).with_context(failed)?;
        }
        let mut known = HashMap::new();
        for line in bytes[..whole].split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            match serde_json::from_slice::<Outcome>(line) {
                Ok(outcome) => {
                    known.insert(outcome.key.clone(), outcome);
                }
                Err(error) => {
                    tracing::warn!(path = %path.display(), %error, "a line that is no result was passed over")
                }
            }
        }
        Ok(Store { path: path.to_owned(), file, known })
    }

    /// The result of this key, if it is there.
    pub fn get(&self, key: &str) -> Option<&Outcome> {
        self.known.get(key)
    }

    /// Appends a result.
    ///
    /// # Errors
    /// Fails when the disk does not take it.
    pub fn add(&mut self, outcome: Outcome) -> anyhow::Result<()> {
        let line = serde_json::to_string(&outcome)? + "\n";
        let written = self.file.write_all(line.as_bytes()).and_then(|()| self.file.flush());
        written.with_context(|| format!("cannot write {}", self.path.display()))?;
        self.known.insert(outcome.key.clone(), outcome);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcome::synthetic;
    use super::*;

    #[test]
    fn what_was_added_is_there_after_opening_again() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("results.jsonl");
        let mut store = Store::open(&path).expect("a new file");
        for key in ["a", "b"] {
            store.add(synthetic::outcome(key)).expect("room");
        }
        let again = Store::open(&path).expect("the file");
        assert_eq!(again.get("b"), Some(&synthetic::outcome("b")));
        assert_eq!(again.get("c"), None);
    }

    #[test]
    fn a_torn_last_line_is_cut_off_and_the_next_one_is_whole() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("results.jsonl");
        let mut store = Store::open(&path).expect("a new file");
        store.add(synthetic::outcome("a")).expect("room");
        store.add(synthetic::outcome("b")).expect("room");
        let bytes = std::fs::read(&path).expect("the file");
        std::fs::write(&path, &bytes[..bytes.len() - 9]).expect("a torn file");

        let mut store = Store::open(&path).expect("the torn file");
        assert!(store.get("a").is_some() && store.get("b").is_none());
        store.add(synthetic::outcome("c")).expect("room");
        let store = Store::open(&path).expect("the mended file");
        assert!(store.get("a").is_some() && store.get("c").is_some());
        assert_eq!(std::fs::read_to_string(&path).expect("text").lines().count(), 2);
    }

    #[test]
    fn a_line_that_is_no_result_costs_only_itself() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("results.jsonl");
        Store::open(&path).expect("a file").add(synthetic::outcome("a")).expect("room");
        let text = std::fs::read_to_string(&path).expect("text");
        std::fs::write(&path, format!("{{}}\n{text}")).expect("a file");
        assert!(Store::open(&path).expect("the file").get("a").is_some());
    }
}
