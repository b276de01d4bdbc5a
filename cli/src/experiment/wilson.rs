//! Wilson's score interval of a rate: which true rates an observed one speaks for, with 95 % confidence.
//!
//! With `k` successes in `n` runs, `p = k/n` and `z = 1.96`:
//!
//! ```text
//! (p + z²/2n ± z √(p(1 - p)/n + z²/4n²)) / (1 + z²/n)
//! ```
//!
//! Unlike `p ± z √(p(1-p)/n)` it stays within [0, 1] and says something at 0 and at n successes.
//! E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).

/// The 97.5 % point of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// A rate with its 95 % interval, all within [0, 1]; of no runs at all the rate is NaN and the interval everything.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Successes over runs.
    pub rate: f64,
    /// The lower end of the interval.
    pub low: f64,
    /// The upper end of the interval.
    pub high: f64,
}

/// The rate of `successes` among `runs`.
pub fn rate(successes: usize, runs: usize) -> Rate {
    if runs == 0 {
        return Rate { rate: f64::NAN, low: 0.0, high: 1.0 };
    }
    let n = runs as f64;
    let p = successes as f64 / n;
    let middle = p + Z * Z / (2.0 * n);
    let half = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    // None and all are exact: round-off would leave 5e-17 of nothing.
    let low = if successes == 0 { 0.0 } else { (middle - half) / scale };
    let high = if successes == runs { 1.0 } else { (middle + half) / scale };
    Rate { rate: p, low, high }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine 17 (1998),
    /// Table I, method 3, printed to four digits.
    #[test]
    fn the_interval_is_the_published_one() {
        let published =
            [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)];
        for (successes, runs, low, high) in published {
            let rate = rate(successes, runs);
            assert!((rate.low - low).abs() < 5.1e-5, "{successes}/{runs}: {rate:?}");
            assert!((rate.high - high).abs() < 5.1e-5, "{successes}/{runs}: {rate:?}");
        }
    }

    #[test]
    fn successes_and_failures_mirror_each_other_and_none_say_nothing() {
        let (few, many) = (rate(3, 40), rate(37, 40));
        assert!((few.low - (1.0 - many.high)).abs() < 1e-12 && (few.high - (1.0 - many.low)).abs() < 1e-12);
        assert!((1..200).all(|runs| rate(0, runs).low == 0.0 && rate(runs, runs).high == 1.0));
        assert!(rate(0, 0).rate.is_nan());
    }
}
