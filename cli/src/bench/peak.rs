//! What one core can do at most: multiply-adds in registers and nothing else, against the clock.

use std::time::Instant;

use domvs_vision::{Path, spin};

/// Rounds that take about a millisecond.
const ROUNDS: u64 = 200_000;
/// The best of so many is taken: the others were disturbed.
const TRIES: usize = 30;

/// GFLOP/s of one core that does nothing but `f32` multiply-adds on this path, measured now in about 50 ms.
pub fn peak_gflops(path: Path) -> f64 {
    let reached = (0..TRIES).map(|_| {
        let begin = Instant::now();
        let operations = spin(path, ROUNDS);
        operations as f64 / begin.elapsed().as_secs_f64() / 1e9
    });
    reached.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_of_this_machine_reaches_something() {
        assert!(Path::available().into_iter().all(|path| peak_gflops(path) > 0.0));
    }
}
