//! The client over real Zenoh sessions, against a small worker made of canned answers.
//!
//! Each test has a router of its own on a port that the system chose. Waits are on conditions, with a limit.

mod discovery;
mod fake;
mod following;
mod requests;
mod twists;
