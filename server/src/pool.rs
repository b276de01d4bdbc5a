//! The compute pool: as many plain threads as cores, and every task on one thread at a time, in order.
//!
//! A task that has work stands in one queue, once. A thread takes the task in front, does one piece of its
//! work, and puts it back at the end if more is left, so a busy task delays the others by one step at most.

use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Something with a queue of its own, which the pool works off piece by piece.
pub trait Work: Send + Sync {
    /// Does one piece. Must not unwind.
    fn run_one(&self);
    /// Whether another piece waits.
    fn has_work(&self) -> bool;
    /// Whether this already stands in the pool's queue, or runs.
    fn scheduled(&self) -> &AtomicBool;
}

/// A fixed set of compute threads.
pub struct Pool {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    ready: Condvar,
}

#[derive(Default)]
struct Queue {
    waiting: VecDeque<Arc<dyn Work>>,
    closed: bool,
}

impl Pool {
    /// Starts `threads` compute threads. Fails when the system refuses one.
    pub fn start(threads: usize) -> io::Result<Pool> {
        let shared = Arc::new(Shared::default());
        let threads = (0..threads)
            .map(|index| {
                let shared = Arc::clone(&shared);
                std::thread::Builder::new().name(format!("domvs-compute-{index}")).spawn(move || shared.work())
            })
            .collect::<io::Result<Vec<_>>>()?;
        Ok(Pool { shared, threads: Mutex::new(threads) })
    }

    /// Makes sure that `work` is looked at; costs a lock and no waiting, so callbacks may call it.
    pub fn schedule(&self, work: &Arc<impl Work + 'static>) {
        if !work.scheduled().swap(true, Ordering::AcqRel) {
            self.shared.push(Arc::clone(work) as Arc<dyn Work>);
        }
    }

    /// Finishes what runs, forgets what waits, and joins the threads.
    pub fn close(&self) {
        {
            let mut queue = self.shared.lock();
            queue.closed = true;
            queue.waiting.clear();
        }
        self.shared.ready.notify_all();
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            if thread.join().is_err() {
                tracing::error!("a compute thread ended by a panic");
            }
        }
    }
}

impl Shared {
    fn work(&self) {
        while let Some(work) = self.next() {
            work.run_one();
            work.scheduled().store(false, Ordering::Release);
            // Something may have come between the last look and the store: whoever sees it first queues it.
            if work.has_work() && !work.scheduled().swap(true, Ordering::AcqRel) {
                self.push(work);
            }
        }
    }

    fn next(&self) -> Option<Arc<dyn Work>> {
        let mut queue = self.lock();
        loop {
            if queue.closed {
                return None;
            }
            if let Some(work) = queue.waiting.pop_front() {
                return Some(work);
            }
            queue = self.ready.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn push(&self, work: Arc<dyn Work>) {
        let mut queue = self.lock();
        if !queue.closed {
            queue.waiting.push_back(work);
            self.ready.notify_one();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::time::Duration;

    use super::*;

    /// Counts down its pieces and reports each; notices if two threads are ever in it at once.
    struct Countdown {
        name: usize,
        left: Mutex<usize>,
        inside: AtomicBool,
        scheduled: AtomicBool,
        report: mpsc::SyncSender<(usize, usize)>,
    }

    impl Work for Countdown {
        fn run_one(&self) {
            assert!(!self.inside.swap(true, Ordering::SeqCst), "two threads in one task");
            let mut left = self.left.lock().expect("not poisoned");
            *left -= 1;
            self.report.send((self.name, *left)).expect("the test listens");
            drop(left);
            self.inside.store(false, Ordering::SeqCst);
        }
        fn has_work(&self) -> bool {
            *self.left.lock().expect("not poisoned") > 0
        }
        fn scheduled(&self) -> &AtomicBool {
            &self.scheduled
        }
    }

    #[test]
    fn every_piece_of_every_task_runs_once_and_in_order() {
        let pool = Pool::start(4).expect("threads");
        let (report, reports) = mpsc::sync_channel(1000);
        let tasks: Vec<_> = (0..8)
            .map(|name| {
                Arc::new(Countdown {
                    name,
                    left: Mutex::new(50),
                    inside: AtomicBool::new(false),
                    scheduled: AtomicBool::new(false),
                    report: report.clone(),
                })
            })
            .collect();
        tasks.iter().for_each(|task| pool.schedule(task));
        let mut next = [50; 8];
        for _ in 0..400 {
            let (name, left) = reports.recv_timeout(Duration::from_secs(10)).expect("a piece");
            next[name] -= 1;
            assert_eq!(left, next[name]);
        }
        pool.close();
    }
}
