//! One file per subcommand: its arguments (`…Args`) and `run`, which returns the exit code.

pub mod twist;
