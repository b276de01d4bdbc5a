//! One file per subcommand: its arguments (`…Args`) and `run`, which returns the exit code.

pub mod bench;
pub mod certs;
pub mod demo;
pub mod experiment;
pub mod serve;
pub mod sim;
pub mod stop;
pub mod task;
pub mod twist;
