//! How `domvs serve` hears that it should end. The first SIGTERM or SIGINT ends it in order; a second one ends it at once, from
//! the signal handler itself, so that nothing that hangs can be in the way; and so does a clock, if the orderly end takes too long.

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use signal_hook::low_level::{exit as end_process, raise};
use tokio::signal::unix::{Signal, SignalKind, signal};

use crate::exit;

/// From the first signal to the end, whatever hangs.
const LONGEST_END: Duration = Duration::from_millis(1850);

/// Tells this process to end when whoever holds the other end of its standard input is gone, however that ended.
///
/// # Errors
/// Fails when the system gives no thread.
pub fn end_with_stdin() -> io::Result<()> {
    let wait = || {
        // Nothing is expected; an error is an end as well.
        let _ = io::stdin().read_to_end(&mut Vec::new());
        if let Err(error) = raise(SIGTERM) {
            tracing::error!(%error, "standard input ended, and this process cannot be told to end");
        }
    };
    std::thread::Builder::new().name("stdin".into()).spawn(wait).map(drop)
}

/// Hears signals from when it is made.
pub struct Signals {
    hear: [Signal; 2],
    /// The worker has ended in order: what still hangs is not ours.
    in_order: Arc<AtomicBool>,
}

impl Signals {
    /// Listens; must be called in the runtime.
    ///
    /// # Errors
    /// Fails when the system refuses a handler.
    pub fn listen() -> io::Result<Signals> {
        let told = Arc::new(AtomicBool::new(false));
        for number in [SIGTERM, SIGINT] {
            // Handlers run in this order: the first signal finds the flag down, and raises it for the second.
            flag::register_conditional_shutdown(number, i32::from(exit::FORCED), Arc::clone(&told))?;
            flag::register(number, Arc::clone(&told))?;
        }
        let hear = [signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?];
        Ok(Signals { hear, in_order: Arc::default() })
    }

    /// Returns when the first signal came. From then on the program has not long.
    pub async fn first(&mut self) {
        let [terminate, interrupt] = &mut self.hear;
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
        let in_order = Arc::clone(&self.in_order);
        let clock = move || {
            std::thread::sleep(LONGEST_END);
            end_process(i32::from(if in_order.load(Ordering::Acquire) { 0 } else { exit::FORCED }));
        };
        if let Err(error) = std::thread::Builder::new().name("last-end".into()).spawn(clock) {
            tracing::warn!(%error, "no thread to bound the time of the end");
        }
    }

    /// Everything that had to be done is done.
    pub fn ended_in_order(&self) {
        self.in_order.store(true, Ordering::Release);
    }
}
