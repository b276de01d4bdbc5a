//! What the system says of a process: its processor time and its memory. Linux only; elsewhere nothing is known.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;

/// How often memory is looked at.
const PERIOD: Duration = Duration::from_millis(100);
/// Ticks of processor time a second: what `/proc` counts in, on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// Processor time since the start of a process, all threads together, seconds.
pub fn cpu_s(process: u32) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The name, in parentheses, may hold anything; user and system time are the 12th and 13th number behind it.
    let mut numbers = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut next = || numbers.next()?.parse::<f64>().ok();
    Some((next()? + next()?) / TICKS_PER_S)
}

/// Resident memory of a process, MB (of 10⁶ bytes).
pub fn rss_mb(process: u32) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? * 1024.0 / 1e6)
}

/// Open file descriptors of a process.
pub fn open_files(process: u32) -> Option<usize> {
    Some(std::fs::read_dir(format!("/proc/{process}/fd")).ok()?.count())
}

/// Resident memory over a while, MB.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MemoryOverTime {
    /// At its begin.
    pub begin: f64,
    /// At its most.
    pub peak: f64,
    /// At its end.
    pub end: f64,
}

/// Looks at the memory of a process until it is told to stop.
pub struct MemoryWatch {
    stop: Sender<()>,
    thread: JoinHandle<Option<MemoryOverTime>>,
}

impl MemoryWatch {
    /// Begins to look.
    pub fn start(process: u32) -> MemoryWatch {
        let (stop, stopped) = channel();
        let thread = std::thread::spawn(move || {
            let begin = rss_mb(process)?;
            let mut seen = MemoryOverTime { begin, peak: begin, end: begin };
            while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(PERIOD) {
                seen.end = rss_mb(process)?;
                seen.peak = seen.peak.max(seen.end);
            }
            Some(seen)
        });
        MemoryWatch { stop, thread }
    }

    /// What was seen.
    pub fn finish(self) -> Option<MemoryOverTime> {
        drop(self.stop);
        self.thread.join().ok().flatten()
    }
}

impl MemoryOverTime {
    /// Both whiles together.
    pub fn and(self, later: MemoryOverTime) -> MemoryOverTime {
        MemoryOverTime { begin: self.begin, peak: self.peak.max(later.peak), end: later.end }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn this_process_uses_memory_and_nobody_else_is_known() {
        let this = std::process::id();
        assert!(cpu_s(this).is_some_and(|seconds| seconds >= 0.0));
        assert!(rss_mb(this).is_some_and(|mb| mb > 0.5));
        assert!(open_files(this).is_some_and(|files| files >= 3));
        let seen = MemoryWatch::start(this).finish().expect("the process runs");
        assert!(seen.peak >= seen.begin);
        assert_eq!((cpu_s(u32::MAX), rss_mb(u32::MAX)), (None, None));
    }
}
