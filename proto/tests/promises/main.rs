//! What this crate promises, in one binary: a file for each subject.

mod arbitrary;
mod bodies;
mod docs;
mod frames;
mod golden;
mod keys;
mod settings;
mod twists;
