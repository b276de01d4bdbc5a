//! What every decoder promises, whatever comes: no panic, and what was accepted is what it says. One function for each.
//!
//! `fuzz/run` lets libFuzzer choose the bytes; `tests/tests/service/fuzz/corpora.rs` includes this file and replays every
//! committed input in `cargo test`.

mod images;
mod servoing;
mod text;

/// What is done with an input.
pub type Target = fn(&[u8]);

/// Every target by its name, which is its corpus's folder.
pub const ALL: [(&str, Target); 11] = [
    ("header", images::header),
    ("raw", images::raw),
    ("png", images::png),
    ("jpeg", images::jpeg),
    ("settings", text::settings),
    ("messages", text::messages),
    ("twist", text::twist),
    ("keys", text::keys),
    ("config", text::config),
    ("state", text::state),
    ("task", servoing::task),
];
