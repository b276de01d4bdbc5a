//! How far a measurement is, and whether it should end: the bar on standard error, and Ctrl-C.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::ensure;
use indicatif::ProgressBar;

use crate::experiment::{pool, progress};
use crate::paint::Paint;

/// A measurement on its way.
#[derive(Clone)]
pub struct Watch {
    bar: ProgressBar,
    stop: Arc<AtomicBool>,
}

impl Watch {
    /// A bar of so many parts; signals are heard from now on.
    ///
    /// # Errors
    /// Fails when the system gives no thread to hear signals.
    pub fn start(parts: usize, paint: Paint) -> anyhow::Result<Watch> {
        Ok(Watch { bar: progress::bar("parts", parts, 0, paint), stop: pool::interruption()? })
    }

    /// Without a bar, never stopped.
    pub fn silent() -> Watch {
        Watch { bar: ProgressBar::hidden(), stop: Arc::default() }
    }

    /// What is being done.
    pub fn says(&self, what: impl ToString) {
        self.bar.set_message(what.to_string());
    }

    /// So many parts more are done.
    pub fn done(&self, parts: usize) {
        self.bar.inc(parts as u64);
    }

    /// Whether a signal came.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// An error if a signal came.
    ///
    /// # Errors
    /// Then.
    pub fn go_on(&self) -> anyhow::Result<()> {
        ensure!(!self.is_stopped(), "interrupted; nothing was measured to its end");
        Ok(())
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
