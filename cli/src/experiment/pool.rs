//! Many runs on all cores: plain threads that take the next one from a list; results come back through a bounded channel.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;

use anyhow::Context;

/// As many as there are cores.
pub fn all_cores() -> usize {
    std::thread::available_parallelism().map_or(1, |cores| cores.get())
}

/// Does `work` on every item on `jobs` threads, each with a state of its own from `state`, and hands each result to `done` on
/// this thread, in the order in which they come. `stop` ends it early; so does the first error, which is returned.
///
/// # Errors
/// Returns the first error of `state`, `work` or `done`.
pub fn in_parallel<T: Sync, S, R: Send>(
    jobs: usize,
    items: &[T],
    stop: &AtomicBool,
    state: impl Fn() -> anyhow::Result<S> + Sync,
    work: impl Fn(&mut S, &T) -> anyhow::Result<R> + Sync,
    mut done: impl FnMut(usize, R) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let next = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let over = || stop.load(Ordering::Relaxed) || failed.load(Ordering::Relaxed);
    let (sender, receiver) = sync_channel::<anyhow::Result<(usize, R)>>(jobs.max(1));
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, items.len().max(1)) {
            let sender = sender.clone();
            let (next, over, state, work) = (&next, &over, &state, &work);
            scope.spawn(move || {
                let mut state = match state() {
                    Ok(state) => state,
                    Err(error) => return drop(sender.send(Err(error))),
                };
                while !over() {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else { return };
                    // Nobody listens any more after an error: then there is nothing left to say.
                    if sender.send(work(&mut state, item).map(|result| (index, result))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        let mut first_error = Ok(());
        for message in receiver {
            let outcome = message.and_then(|(index, result)| done(index, result));
            if let (Err(error), true) = (outcome, first_error.is_ok()) {
                failed.store(true, Ordering::Relaxed);
                first_error = Err(error);
            }
        }
        first_error
    })
}

/// A flag that Ctrl-C or SIGTERM sets; the second time they end the process at once.
///
/// # Errors
/// Fails when the system gives no thread.
pub fn interruption() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&flag);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let listen = move || {
        runtime.block_on(async {
            while crate::network::interrupted().await.is_ok() {
                if set.swap(true, Ordering::Relaxed) {
                    std::process::exit(i32::from(crate::exit::INTERRUPTED));
                }
            }
        });
    };
    std::thread::Builder::new().name("signals".into()).spawn(listen).context("cannot listen to signals")?;
    Ok(flag)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn squares(jobs: usize, items: &[u32], stop: &AtomicBool) -> anyhow::Result<Vec<(usize, u32)>> {
        let mut results = Vec::new();
        let square = |calls: &mut u32, item: &u32| {
            *calls += 1;
            anyhow::ensure!(*item != 13, "unlucky");
            Ok(item * item)
        };
        in_parallel(
            jobs,
            items,
            stop,
            || Ok(0),
            square,
            |index, result| {
                results.push((index, result));
                Ok(())
            },
        )?;
        results.sort_unstable();
        Ok(results)
    }

    #[test]
    fn every_item_is_done_once_whatever_the_number_of_threads() {
        let items: Vec<u32> = (100..150).collect();
        let expected: Vec<(usize, u32)> = items.iter().map(|item| item * item).enumerate().collect();
        for jobs in [1, 2, 7, 100] {
            assert_eq!(squares(jobs, &items, &AtomicBool::new(false)).expect("no error"), expected);
        }
        assert_eq!(squares(4, &[], &AtomicBool::new(false)).expect("no error"), []);
    }

    #[test]
    fn an_error_ends_it_and_is_returned() {
        let items: Vec<u32> = (0..1000).collect();
        assert_eq!(squares(3, &items, &AtomicBool::new(false)).expect_err("unlucky").to_string(), "unlucky");
    }

    #[test]
    fn nothing_is_begun_after_a_stop() {
        assert_eq!(squares(2, &[1, 2, 3], &AtomicBool::new(true)).expect("no error"), []);
    }
}
