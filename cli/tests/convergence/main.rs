//! Convergence, judged by cameras that really move: interaction matrices against rendered images, a small grid of all methods against its
//! snapshot, and each option doing what docs/options.md says it is for. Everything runs in this process, through the experiments' own code.

#![expect(clippy::unwrap_used, reason = "a test stops where something that must hold does not")]

mod derivatives;
mod grid;
mod holes;
mod lab;
mod options;
