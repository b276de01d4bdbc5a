//! What a finished run leaves in its folder, and what it says on the terminal.
//! The data's way: one [`RunRow`] per image → [`RunRecord`] → [`write_run`] → `frames.csv`, `settings.json`, four
//! PNGs, SVG plots, and a [`RunSummary`] for the table and the JSON line. [`LiveLine`] shows the rows as they come.
//!
//! Nothing here knows of Zenoh, of the service or of how the rows came about.

mod record;
mod table;

mod base64;
mod pictures;
pub mod plots;

mod live;
mod summary;

pub use base64::base64;
pub use live::LiveLine;
pub use pictures::{RunImages, png, strip};
pub use record::{RunRecord, RunRow};
pub use summary::{RunSummary, number, summary_table};

use std::path::Path;

use anyhow::Context;
use serde::Serialize;

/// Writes all that is known about a run into `folder`, which is made if need be; files of an earlier run are replaced.
/// `settings` is whatever the run was made with; it becomes `settings.json`.
///
/// # Errors
/// Fails, naming the file, when something cannot be written or an image has no pixels.
pub fn write_run(
    folder: &Path,
    record: &RunRecord,
    settings: &impl Serialize,
    images: &RunImages<'_>,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join("settings.json");
    let json = serde_json::to_string_pretty(settings).context("settings.json")?;
    std::fs::write(&path, json + "\n").with_context(|| format!("cannot write {}", path.display()))?;
    table::write_csv(&folder.join("frames.csv"), &record.rows)?;
    pictures::write_pictures(folder, images)?;
    plots::write_plots(folder, &plots::of_run(record)?)
}
