//! Hahn: `w(u)/w(u-1) = (b + u)(N - u) / (u (N + a - u))`, with real `a, b >= 0`, Table I; the paper's own family.
//!
//! The adaptive window: `p̄ = ū_c/N` is the mean centroid of the two images (Eq. (15), (16)), `d` how far from it 99.73 % of an image's
//! brightness lies (Eq. (23), (24)), `t = exp(κ d + ϱ)` (Eq. (21)) and `a = (1 - p̄) t`, `b = p̄ t`, rounded (Eq. (20)).
//! [`Window::Adaptive`] is the rule that reproduces the authors' logs; [`Window::AdaptivePaper`] is the printed one: they differ
//! in two places (deviation D2). Brightness means bright on dark: on a bright background the window becomes wide.

use crate::family::{Family, Rows};
use crate::law::{Law, LawError};
use crate::window::{Brightness, NoBrightness, WindowInUse, mean_centroid};

/// Largest Hahn parameter a basis is made for; the adaptive rule stays below it at every size here.
pub const HAHN_LIMIT: f64 = 1e9;

/// Hahn rows, `a, b >= 0`, real; a larger `b` moves the window right, a larger `a + b` narrows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hahn {
    /// Weighs the right end down.
    pub a: f64,
    /// Weighs the left end down.
    pub b: f64,
}

/// How Hahn's window is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Window {
    /// From the two images, by the rule that reproduces the authors' logs.
    Adaptive,
    /// From the two images, by the rule as printed.
    AdaptivePaper,
    /// Always this one; `a, b >= 0`, real.
    Fixed {
        /// `[a, b]` along `u`.
        x: [f64; 2],
        /// `[a, b]` along `v`.
        y: [f64; 2],
    },
}

impl Default for Window {
    /// `a = b = 8` on both axes: a bell about the centre, 11.5 % of the side in standard deviation.
    fn default() -> Window {
        Window::Fixed { x: [8.0, 8.0], y: [8.0, 8.0] }
    }
}

impl Family for Hahn {
    const WORD: &'static str = "hahn";
    const ROWS: Rows<Hahn> =
        Rows::UnderWeight(|Hahn { a, b }, u, points| (b + u) / u * (points - u) / (points + a - u));

    fn is_in_range(&self) -> bool {
        [self.a, self.b].iter().all(|c| (0.0..=HAHN_LIMIT).contains(c))
    }

    fn check(law: &Law) -> Result<(), LawError> {
        match law.window {
            Window::Fixed { x, y } if ![x, y].iter().all(|[a, b]| Hahn { a: *a, b: *b }.is_in_range()) => {
                Err(LawError::Window { x, y })
            }
            _ => Ok(()),
        }
    }

    fn follows_images(law: &Law) -> bool {
        !matches!(law.window, Window::Fixed { .. })
    }

    fn choose(law: &Law, current: &Brightness, desired: &Brightness) -> Result<[Hahn; 2], NoBrightness> {
        let axes = match law.window {
            Window::Adaptive => hahn_window(Rule::Logs, current, desired)?,
            Window::AdaptivePaper => hahn_window(Rule::Paper, current, desired)?,
            Window::Fixed { x, y } => [x, y],
        };
        Ok(axes.map(|[a, b]| Hahn { a, b }))
    }

    fn window(rows: [Hahn; 2]) -> WindowInUse {
        let [x, y] = rows.map(|Hahn { a, b }| [a, b]);
        WindowInUse::Hahn { x, y }
    }
}

/// Hahn's `[[a, b] along u, [a, b] along v]` by one of the two adaptive rules, rounded as the paper rounds them.
///
/// # Errors
/// [`NoBrightness`].
pub fn hahn_window(rule: Rule, current: &Brightness, desired: &Brightness) -> Result<[[f64; 2]; 2], NoBrightness> {
    Ok(hahn_window_unrounded(rule, current, desired)?.map(|ab| ab.map(f64::round)))
}

/// Which adaptive rule: the two places where the authors' program and paper differ (deviation D2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// `t` at the narrowest is `20 (N - 1)`; the mean of the two images' `t`.
    Logs,
    /// `t` at the narrowest is `20 N`; `t` of the mean of the two images' `d`.
    Paper,
}

/// [`hahn_window`] before rounding.
///
/// # Errors
/// [`NoBrightness`].
pub fn hahn_window_unrounded(
    rule: Rule,
    current: &Brightness,
    desired: &Brightness,
) -> Result<[[f64; 2]; 2], NoBrightness> {
    let center = mean_centroid(current, desired)?;
    Ok([0, 1].map(|axis| {
        let p = center[axis] / current.along(axis).len() as f64;
        let t = hahn_sum(rule, p, axis, current, desired);
        [(1.0 - p) * t, p * t]
    }))
}

/// `t = a + b` along one axis. `κ` and `ϱ` (Eq. (22)) make `t = 0.01` for a spread image and the most for a spot of `3σ`.
fn hahn_sum(rule: Rule, p: f64, axis: usize, current: &Brightness, desired: &Brightness) -> f64 {
    const LEAST: f64 = 0.01;
    let length = current.along(axis).len() as f64;
    let center = (p * length).round() as usize;
    let [d, d_desired] = [current, desired].map(|b| b.dispersion_px(axis, center) as f64);
    let most = match rule {
        Rule::Logs => 20.0 * (length - 1.0),
        Rule::Paper => 20.0 * length,
    };
    let three_sigma = 3.0 * (length * p * (1.0 - p)).sqrt();
    let kappa = (LEAST.ln() - most.ln()) / (length - 1.0 - three_sigma);
    let rho = LEAST.ln() - kappa * (length - 1.0);
    let sum_at = |d: f64| (kappa * d + rho).exp();
    match rule {
        Rule::Logs => (sum_at(d) + sum_at(d_desired)) / 2.0,
        Rule::Paper => sum_at((d + d_desired) / 2.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn the_two_rules_agree_on_one_image_up_to_the_largest_sum() {
        let flat = Brightness::of(&Plane::filled(64, 64, 0.5f32));
        let [logs, paper] =
            [Rule::Logs, Rule::Paper].map(|rule| hahn_window_unrounded(rule, &flat, &flat).expect("bright"));
        assert!((logs[0][0] - paper[0][0]).abs() < 0.1 && hahn_window(Rule::Logs, &flat, &flat).is_ok());
    }

    #[test]
    fn an_image_that_is_not_a_number_has_no_window() {
        let not_a_number = Brightness::of(&Plane::filled(16, 16, f32::NAN));
        assert!(hahn_window(Rule::Paper, &not_a_number, &not_a_number).is_err());
    }
}
