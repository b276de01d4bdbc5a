//! The files of a lab on the disk: keys, passwords and what holds one are readable by their owner alone from the first byte on.

use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

use anyhow::{Context, bail};

/// Who may read a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Secrecy {
    /// Everybody: mode 0644.
    Public,
    /// The owner: mode 0600.
    Secret,
}

impl Secrecy {
    /// The bits of the file's mode.
    pub fn mode(self) -> u32 {
        match self {
            Secrecy::Public => 0o644,
            Secrecy::Secret => 0o600,
        }
    }
}

/// What becomes of files that are there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Nothing is written at all.
    Refuse,
    /// They are replaced.
    Replace,
}

/// A file of the lab.
#[derive(Clone, PartialEq, Eq)]
pub struct LabFile {
    /// In the lab's folder.
    pub name: String,
    /// Who may read it.
    pub secrecy: Secrecy,
    text: String,
}

impl LabFile {
    pub(super) fn new(name: impl Into<String>, secrecy: Secrecy, text: String) -> LabFile {
        LabFile { name: name.into(), secrecy, text }
    }
}

/// Without the text, which may be a key.
impl std::fmt::Debug for LabFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LabFile").field("name", &self.name).field("secrecy", &self.secrecy).finish_non_exhaustive()
    }
}

/// Fails when one of the files is there and must not be replaced.
pub(super) fn check_absent(folder: &Path, files: &[LabFile], existing: Existing) -> anyhow::Result<()> {
    let there: Vec<&str> =
        files.iter().map(|file| file.name.as_str()).filter(|name| folder.join(name).exists()).collect();
    if existing == Existing::Refuse && !there.is_empty() {
        bail!(
            "{} has {} already; --force replaces them, and what they were good for is then lost",
            folder.display(),
            there.join(", ")
        );
    }
    Ok(())
}

/// Writes all of them, or none when one is there and must not be replaced.
pub(super) fn write(folder: &Path, files: &[LabFile], existing: Existing) -> anyhow::Result<()> {
    check_absent(folder, files, existing)?;
    std::fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    for file in files {
        write_one(folder, file).with_context(|| format!("cannot write {}", folder.join(&file.name).display()))?;
    }
    Ok(())
}

/// Whole and under its mode, or not at all: beside it first, then renamed.
fn write_one(folder: &Path, file: &LabFile) -> std::io::Result<()> {
    let beside = folder.join(format!(".{}.new", file.name));
    match std::fs::remove_file(&beside) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut open = std::fs::OpenOptions::new().write(true).create_new(true).mode(file.secrecy.mode()).open(&beside)?;
    open.write_all(file.text.as_bytes())?;
    open.sync_all()?;
    std::fs::rename(&beside, folder.join(&file.name))
}
