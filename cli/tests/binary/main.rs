//! The built binary, as a shell sees it: arguments, output, files, exit codes.

#![expect(clippy::unwrap_used, reason = "a test stops where something that must hold does not")]

mod bench;
mod demo;
mod experiment;
mod network;
mod serve;
mod standstill;
mod twist;
