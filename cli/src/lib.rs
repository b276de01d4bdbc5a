//! What the command `domvs` is made of, from the command line inwards: [`options`] shared by the
//! subcommands, [`commands`] (one file each), [`files`] they read, [`report`] a finished run leaves behind,
//! and [`paint`], which decides about colours. `main.rs` only reads the command line and hands over.

pub mod options;

pub mod commands;

pub mod exit;
pub mod files;
pub mod paint;
pub mod report;
