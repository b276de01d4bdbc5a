//! Words and numbers that several subcommands read alike: method, order, window, camera, depth.
//! Each type parses one option value and says in its error what was expected.
//!
//! Ranges that depend on the images (the largest order, say) are left to the crate that knows them.

mod depth;
mod method;
mod network;
mod scene;
mod servo;
mod view;
mod window;

pub use depth::DepthSource;
pub use method::MethodOption;
pub use network::NetworkOptions;
pub use scene::{DisplacementOption, LightChangeOption, SceneOptions, SizeOption};
pub use servo::{FeatureOptions, ServoOptions};
pub use view::{CameraOption, DepthOption};
pub use window::{KrawtchoukOption, LatticeOption, WindowOption};

use std::fmt;
use std::str::FromStr;

/// `--order N` or `--order MIN..MAX`, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OrderOption {
    /// The order far from the target.
    pub min: usize,
    /// The order near the target; equal to `min` for a fixed order.
    pub max: usize,
}

impl Default for OrderOption {
    fn default() -> OrderOption {
        OrderOption { min: 4, max: 16 }
    }
}

impl FromStr for OrderOption {
    type Err = String;

    fn from_str(text: &str) -> Result<OrderOption, String> {
        let number = |part: &str| part.trim().parse().map_err(|_| order_expected(text));
        let (min, max) = match text.split_once("..") {
            Some((min, max)) => (number(min)?, number(max.strip_prefix('=').unwrap_or(max))?),
            None => (number(text)?, number(text)?),
        };
        if min > max {
            return Err(format!("the smallest order comes first, got {min}..{max}"));
        }
        Ok(OrderOption { min, max })
    }
}

fn order_expected(text: &str) -> String {
    format!("expected a whole number or MIN..MAX such as 4..16, got '{text}'")
}

impl fmt::Display for OrderOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.min == self.max {
            true => write!(f, "{}", self.min),
            false => write!(f, "{}..{}", self.min, self.max),
        }
    }
}

/// A number above 0, for example a gain or a unit.
///
/// # Errors
/// Says what was expected when `text` is no number, not finite, zero or negative.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        _ => Err(format!("expected a number above 0, got '{text}'")),
    }
}

/// Any finite number.
///
/// # Errors
/// Says what was expected when `text` is no number or not finite.
pub fn finite(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("expected a finite number, got '{text}'")),
    }
}

/// Finite numbers with commas between them, or `None`.
pub fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|part| finite(part).ok()).collect()
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::*;

    #[test]
    fn an_order_is_a_number_or_a_range() {
        assert_eq!("8".parse(), Ok(OrderOption { min: 8, max: 8 }));
        assert_eq!("6..16".parse(), Ok(OrderOption { min: 6, max: 16 }));
        assert_eq!("6..=16".parse(), Ok(OrderOption { min: 6, max: 16 }));
        for bad in ["", "16..6", "6..", "..6", "6-16", "six", "-3"] {
            assert!(bad.parse::<OrderOption>().is_err(), "'{bad}'");
        }
    }

    #[test]
    fn what_is_shown_parses_again() {
        for window in ["adaptive", "adaptive_paper", "8,8", "6,6,4,5"] {
            assert_eq!(window.parse::<WindowOption>().expect("a window").to_string(), window);
        }
        for order in ["8", "4..16"] {
            assert_eq!(order.parse::<OrderOption>().expect("an order").to_string(), order);
        }
        for method in MethodOption::value_variants() {
            assert_eq!(MethodOption::from_str(method.word(), false), Ok(*method));
        }
    }
}
