//! What the exit code of `domvs` says; scripts may rely on it.

use std::process::ExitCode;

/// The same words for `--help`.
pub const HELP: &str = "\
Exit codes:
  0  done; a run that servoed has converged
  1  an error, explained on standard error
  2  the command line was not understood
  3  a run ended without converging
  4  serve was forced: by a second signal, or not ended two seconds after the first
  130  interrupted; what was done is kept";

/// 130, as shells say it: interrupted by a signal; what was done is kept.
pub const INTERRUPTED: u8 = 130;

/// 4: `serve` was ended by force, before everything was in order.
pub const FORCED: u8 = 4;

/// 0: the command did what it was asked; a run converged.
pub fn done() -> ExitCode {
    ExitCode::SUCCESS
}

/// 1: an error, which has been explained on standard error.
pub fn failed() -> ExitCode {
    ExitCode::FAILURE
}

/// 3: the run came to its end, but not to the desired image.
pub fn not_converged() -> ExitCode {
    ExitCode::from(3)
}

/// 130: interrupted.
pub fn interrupted() -> ExitCode {
    ExitCode::from(INTERRUPTED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn not_converged_differs_from_done_and_failed() {
        assert_ne!(not_converged(), done());
        assert_ne!(not_converged(), failed());
    }
}
