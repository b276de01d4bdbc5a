//! What the command `domvs` is made of, from the command line inwards: [`options`] shared by the subcommands,
//! [`commands`] (one file each), [`files`] they read, [`frames`] they send, the [`network`] they join, the [`report`] that
//! a finished run leaves behind, the laboratory of [`experiment`]s, what [`mod@bench`] measures, and [`paint`], which decides about colours. `main.rs` only reads the command line and hands over.

pub mod options;

pub mod commands;

pub mod bench;
pub mod exit;
pub mod experiment;
pub mod explain;
pub mod files;
pub mod frames;
pub mod log;
pub mod network;
pub mod paint;
pub mod report;

/// The runtime of a command that talks to the network: a few threads, for I/O only.
///
/// # Errors
/// Fails when the system gives no threads.
pub fn runtime() -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()
}
