//! Many times of one thing, and the few numbers that are said of them.

/// Times in milliseconds, in the order in which they were taken.
#[derive(Clone, Debug, Default)]
pub struct Samples(Vec<f64>);

/// What is said of samples; NaN of none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// How many.
    pub count: usize,
    /// The middle one; of two the mean.
    pub median_ms: f64,
    /// 99 of 100 are not longer.
    pub p99_ms: f64,
    /// Their mean.
    pub mean_ms: f64,
    /// The shortest.
    pub min_ms: f64,
}

impl Samples {
    /// Adds one.
    pub fn add(&mut self, ms: f64) {
        self.0.push(ms);
    }

    /// Adds all of another.
    pub fn extend(&mut self, other: &Samples) {
        self.0.extend_from_slice(&other.0);
    }

    /// How many.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// All together, seconds.
    pub fn total_s(&self) -> f64 {
        self.0.iter().sum::<f64>() / 1e3
    }

    /// The numbers.
    pub fn summary(&self) -> Summary {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        let count = sorted.len();
        let at = |index: usize| sorted.get(index).copied().unwrap_or(f64::NAN);
        Summary {
            count,
            median_ms: 0.5 * (at(count / 2) + at(count.saturating_sub(1) / 2)),
            p99_ms: at((99 * count).div_ceil(100).saturating_sub(1)),
            mean_ms: sorted.iter().sum::<f64>() / count as f64,
            min_ms: at(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times: impl IntoIterator<Item = u32>) -> Summary {
        let mut samples = Samples::default();
        times.into_iter().for_each(|ms| samples.add(f64::from(ms)));
        samples.summary()
    }

    #[test]
    fn the_median_is_the_middle_and_the_99th_percentile_leaves_one_in_a_hundred_out() {
        let hundred = of((1..=100).rev());
        assert_eq!((hundred.median_ms, hundred.p99_ms, hundred.mean_ms, hundred.min_ms), (50.5, 99.0, 50.5, 1.0));
        let three = of([3, 1, 2]);
        assert_eq!((three.count, three.median_ms, three.p99_ms), (3, 2.0, 3.0));
    }

    #[test]
    fn of_nothing_nothing_is_known() {
        let none = of([]);
        assert!(none.median_ms.is_nan() && none.p99_ms.is_nan() && none.mean_ms.is_nan());
    }
}
