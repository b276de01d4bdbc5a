//! What the system says of this process. Linux only; elsewhere nothing is known and nothing is said.

/// Ticks of processor time a second: what `/proc` counts in, on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// Resident memory, bytes.
pub(crate) fn resident_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

/// Open file descriptors.
pub(crate) fn open_files() -> Option<u64> {
    // One of them is the folder that is read.
    Some((std::fs::read_dir("/proc/self/fd").ok()?.count() as u64).saturating_sub(1))
}

/// Processor time of all threads, seconds.
pub(crate) fn cpu_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name, in parentheses, may hold anything; user and system time are the 12th and 13th number behind it.
    let mut numbers = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut next = || numbers.next()?.parse::<f64>().ok();
    Some((next()? + next()?) / TICKS_PER_S)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_memory_files_and_time() {
        assert!(resident_bytes().is_some_and(|bytes| bytes > 500_000));
        assert!(open_files().is_some_and(|files| files >= 3));
        assert!(cpu_s().is_some_and(|seconds| seconds >= 0.0));
    }
}
