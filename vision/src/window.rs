//! Where the moments look: Krawtchouk's point and Hahn's window, from where the brightness of both images lies.
//!
//! `p̄ = ū_c/N` is the mean centroid of the two images (Eq. (15), (16), (19)), `d` how far from it 99.73 % of an image's
//! brightness lies (Eq. (23), (24)), `t = exp(κ d + ϱ)` (Eq. (21)) and `a = (1 - p̄) t`, `b = p̄ t`, rounded (Eq. (20)).
//! [`Window::Adaptive`] is the rule that reproduces the authors' logs; [`Window::AdaptivePaper`] is the printed one: they differ
//! in two places (deviation D2). Brightness means bright on dark: on a bright background the window becomes wide.

use crate::image::Plane;
use crate::sample::Sample;

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

/// How Krawtchouk's point is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KrawtchoukP {
    /// The mean centroid of the two images.
    Adaptive,
    /// Always `[p along u, p along v]`, strictly between 0 and 1.
    Fixed([f64; 2]),
}

/// On which points Krawtchouk's polynomials are orthonormal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lattice {
    /// `0 … N`, as printed, cut to the `N` pixels: not quite orthonormal on them when `p` nears 1 (erratum E2).
    Paper,
    /// `0 … N - 1`.
    Exact,
}

/// The parameters a step used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WindowInUse {
    /// The method has no window.
    Whole,
    /// Hahn's.
    Hahn {
        /// `[a, b]` along `u`.
        x: [f64; 2],
        /// `[a, b]` along `v`.
        y: [f64; 2],
    },
    /// Krawtchouk's.
    Krawtchouk {
        /// `[p along u, p along v]`.
        p: [f64; 2],
    },
}

impl Default for Window {
    /// `a = b = 8` on both axes: a bell about the centre, 11.5 % of the side in standard deviation.
    fn default() -> Window {
        Window::Fixed { x: [8.0, 8.0], y: [8.0, 8.0] }
    }
}

/// The brightness of a plane summed onto its two axes, Eq. (14), and its centroid, Eq. (15).
#[derive(Debug, Clone, PartialEq)]
pub struct Brightness {
    along_u: Vec<f64>,
    along_v: Vec<f64>,
    total: f64,
}

/// An image without a brightness distribution: black, not finite, or with negative pixels that move its centroid outside.
#[derive(Debug, Clone, Copy, thiserror::Error, PartialEq)]
#[error(
    "an adaptive window needs brightness to follow, got a total of {total} with its centroid at {centroid_px:?} px"
)]
pub struct NoBrightness {
    /// Sum over all pixels.
    pub total: f64,
    /// `[u_c, v_c]`.
    pub centroid_px: [f64; 2],
}

impl Brightness {
    /// The sums of `image`.
    pub fn of<T: Sample>(image: &Plane<T>) -> Brightness {
        let mut brightness =
            Brightness { along_u: vec![0.0; image.width()], along_v: vec![0.0; image.height()], total: 0.0 };
        brightness.set(image);
        brightness
    }

    /// The sums of another image of the same size, in place.
    pub fn set<T: Sample>(&mut self, image: &Plane<T>) {
        debug_assert_eq!(image.size(), [self.along_u.len(), self.along_v.len()]);
        self.along_u.fill(0.0);
        for (v, sum) in self.along_v.iter_mut().enumerate() {
            for (column, sample) in self.along_u.iter_mut().zip(image.row(v)) {
                *column += sample.to_f64();
            }
            *sum = image.row(v).iter().map(|sample| sample.to_f64()).sum();
        }
        self.total = self.along_v.iter().sum();
    }

    /// `[u_c, v_c]` in pixels.
    ///
    /// # Errors
    /// [`NoBrightness`].
    pub fn centroid_px(&self) -> Result<[f64; 2], NoBrightness> {
        let centroid_px = [&self.along_u, &self.along_v].map(|sums| {
            let moment: f64 = sums.iter().enumerate().map(|(i, sum)| i as f64 * sum).sum();
            moment / self.total
        });
        let ends = [self.along_u.len(), self.along_v.len()].map(|length| (length - 1) as f64);
        let is_inside = centroid_px.iter().zip(ends).all(|(c, end)| (0.0..=end).contains(c));
        if self.total > 0.0 && is_inside {
            Ok(centroid_px)
        } else {
            Err(NoBrightness { total: self.total, centroid_px })
        }
    }

    fn along(&self, axis: usize) -> &[f64] {
        [&self.along_u, &self.along_v][axis]
    }

    /// `d`: the fewest pixels to both sides of `center` that hold 99.73 % of the brightness, Eq. (24); outside is black.
    fn dispersion_px(&self, axis: usize, center: usize) -> usize {
        const THREE_SIGMA: f64 = 0.9973;
        let sums = self.along(axis);
        let at = |i: Option<usize>| i.and_then(|i| sums.get(i)).map_or(0.0, |sum| sum / self.total);
        let mut held = at(Some(center));
        for d in 0..sums.len() {
            if held > THREE_SIGMA {
                return d;
            }
            held += at(center.checked_add(d + 1)) + at(center.checked_sub(d + 1));
        }
        sums.len() - 1
    }
}

/// Krawtchouk's `[p along u, p along v]` from the mean centroid of both images, Eq. (19).
///
/// # Errors
/// [`NoBrightness`].
pub fn krawtchouk_p(lattice: Lattice, current: &Brightness, desired: &Brightness) -> Result<[f64; 2], NoBrightness> {
    let center = mean_centroid(current, desired)?;
    Ok([0, 1].map(|axis| match lattice {
        Lattice::Paper => center[axis] / current.along(axis).len() as f64,
        Lattice::Exact => center[axis] / (current.along(axis).len() - 1) as f64,
    }))
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

/// `[ū_c, v̄_c]`, Eq. (16).
fn mean_centroid(current: &Brightness, desired: &Brightness) -> Result<[f64; 2], NoBrightness> {
    let (current, desired) = (current.centroid_px()?, desired.centroid_px()?);
    Ok([0, 1].map(|axis| (current[axis] + desired[axis]) / 2.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(width: usize, height: usize, at: [usize; 2]) -> Brightness {
        Brightness::of(&Plane::from_fn(width, height, |u, v| if [u, v] == at { 1.0 } else { 0.0 }))
    }

    #[test]
    fn a_spot_has_its_place_and_no_spread() {
        let spot = spot(20, 10, [7, 3]);
        assert_eq!(spot.centroid_px(), Ok([7.0, 3.0]));
        assert_eq!((spot.dispersion_px(0, 7), spot.dispersion_px(0, 9), spot.dispersion_px(1, 0)), (0, 2, 3));
    }

    #[test]
    fn krawtchouk_looks_at_the_mean_centroid() {
        let (current, desired) = (spot(20, 11, [4, 2]), spot(20, 11, [8, 4]));
        assert_eq!(krawtchouk_p(Lattice::Paper, &current, &desired), Ok([6.0 / 20.0, 3.0 / 11.0]));
        assert_eq!(krawtchouk_p(Lattice::Exact, &current, &desired), Ok([6.0 / 19.0, 0.3]));
    }

    #[test]
    fn the_two_rules_agree_on_one_image_up_to_the_largest_sum() {
        let flat = Brightness::of(&Plane::filled(64, 64, 0.5f32));
        let [logs, paper] =
            [Rule::Logs, Rule::Paper].map(|rule| hahn_window_unrounded(rule, &flat, &flat).expect("bright"));
        assert!((logs[0][0] - paper[0][0]).abs() < 0.1 && hahn_window(Rule::Logs, &flat, &flat).is_ok());
    }

    #[test]
    fn a_black_image_has_no_place() {
        let black = Brightness::of(&Plane::filled(16, 16, 0.0f32));
        assert!(black.centroid_px().is_err());
        let not_a_number = Brightness::of(&Plane::filled(16, 16, f32::NAN));
        assert!(hahn_window(Rule::Paper, &not_a_number, &not_a_number).is_err());
    }
}
