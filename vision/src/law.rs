//! The control law as a client sets it: which features, which window, which order, how fast, how far.
//!
//! All fields are plain values; [`Law::check`] holds the rules between them and [`crate::Servo::new`] calls it.

use crate::family::hahn::{HAHN_LIMIT, Window};
use crate::family::krawtchouk::{KrawtchoukP, Lattice};
use crate::family::{self, Method};
use crate::order::OrderRule;

/// The bell of the gaussian mixture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaussian {
    /// `λ_g`: the standard deviation of `exp(-r²/2λ_g²)`, pixels.
    pub extent_px: f64,
    /// How the sums with it are made.
    pub form: GaussianForm,
}

/// How the sums with a bell are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GaussianForm {
    /// Every term of every sum over the image.
    Exact,
    /// Approximately, in a time that does not grow with the extent.
    Fast,
}

/// How the light may change, from what is known to what a step finds: standard deviations of a walk, images in `[0, 1]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightPrior {
    /// Of the gain, a factor to the desired image.
    pub gain: f64,
    /// Of the offset, a brightness.
    pub offset: f64,
    /// Of the gain's slope along `u` and along `v`, from the centre to the border.
    pub gain_slope: f64,
    /// Of the offset's slope along `u` and along `v`, from the centre to the border.
    pub offset_slope: f64,
}

/// Whether the order rule sees the images' noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoiseFloor {
    /// The pixel error as it is.
    Ignored,
    /// The pixel error without the part that the images' own noise makes up.
    Subtracted,
}

/// Whether a constant depth is believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthScale {
    /// Depths are as given.
    Given,
    /// A constant depth is right but for a factor, which the camera's own motion tells.
    Estimated,
}

/// What becomes of pixels whose depth a map does not know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holes {
    /// They count like all others, with the depth that fills them.
    Filled,
    /// They have no weight, in both images, where either map has a hole.
    Ignored,
}

/// How much of the Gauss-Newton step is taken per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Gain {
    /// `λ`, in 1/s.
    PerSecond(f64),
    /// This fraction of the step within one frame period: `λ = fraction / frame_period_s`.
    StepFraction {
        /// Of the full step; 1 is all of it.
        fraction: f64,
        /// Seconds between frames: a setting, never measured.
        frame_period_s: f64,
    },
    /// `λ(r) = (λ_0 - λ_∞) exp(-s r / (λ_0 - λ_∞)) + λ_∞` of the pixel error `r = √pixel_mse`.
    Adaptive {
        /// `λ_0`, in 1/s, at no pixel error.
        at_zero: f64,
        /// `λ_∞`, in 1/s, at a large pixel error.
        at_infinity: f64,
        /// `s`, how fast the gain falls at no pixel error, in 1/s per unit of `r`.
        slope_at_zero: f64,
    },
}

/// The longest full Gauss-Newton step that is believed; a longer one is shortened, its direction kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepCap {
    /// Longest translation, metres.
    pub translation_m: f64,
    /// Largest rotation, radians.
    pub rotation_rad: f64,
}

/// Everything that decides a twist, save the camera and the two views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    /// Which features.
    pub method: Method,
    /// Hahn's window; the other methods ignore it.
    pub window: Window,
    /// Krawtchouk's point; the other methods ignore it.
    pub krawtchouk_p: KrawtchoukP,
    /// Krawtchouk's lattice; the other methods ignore it.
    pub lattice: Lattice,
    /// How many features.
    pub order: OrderRule,
    /// How fast.
    pub gain: Gain,
    /// How far at most; `None` is without bound.
    pub step_cap: Option<StepCap>,
    /// Which of `[v_x, v_y, v_z, ω_x, ω_y, ω_z]` may move; the others leave before the solve.
    pub degrees_of_freedom: [bool; 6],
    /// The gaussian mixture's bell; the other methods ignore it.
    pub gaussian: Gaussian,
    /// How the light may change; `None` takes brightness as it is.
    pub light: Option<LightPrior>,
    /// Whether the order rule sees the images' noise.
    pub noise_floor: NoiseFloor,
    /// Whether a constant depth is believed.
    pub depth_scale: DepthScale,
    /// What becomes of the holes of depth maps.
    pub holes: Holes,
}

/// Why a law cannot work.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum LawError {
    /// A gain is negative, not finite, or divides by no time.
    #[error("gains must be finite and not negative, and the frame period positive, got {gain:?}")]
    Gain {
        /// As given.
        gain: Gain,
    },
    /// A bound of the step cap is not positive.
    #[error("a step cap must be positive, got {step_cap:?}")]
    StepCap {
        /// As given.
        step_cap: StepCap,
    },
    /// A Hahn parameter is negative, too large or not a number.
    #[error("hahn window parameters must be in 0..={}, got x {x:?} and y {y:?}", HAHN_LIMIT)]
    Window {
        /// `[a, b]` along `u`.
        x: [f64; 2],
        /// `[a, b]` along `v`.
        y: [f64; 2],
    },
    /// A Krawtchouk parameter is not strictly between 0 and 1.
    #[error("krawtchouk p must be strictly between 0 and 1, got {p:?}")]
    KrawtchoukP {
        /// `[p along u, p along v]`.
        p: [f64; 2],
    },
    /// The gaussian mixture's extent is not positive and finite.
    #[error("a gaussian extent must be positive and finite, got {extent_px} px")]
    GaussianExtent {
        /// As given, pixels.
        extent_px: f64,
    },
    /// A standard deviation of the light prior is negative or not finite, or all are zero.
    #[error("a light prior's deviations must be finite, not negative and not all zero, got {light:?}")]
    Light {
        /// As given.
        light: LightPrior,
    },
    /// The depth scale shows in how moments under one window change; this law has none.
    #[error("a depth scale is estimated from moments under a fixed window only, not with {method:?} and {window:?}")]
    DepthScale {
        /// As given.
        method: Method,
        /// As given.
        window: Window,
    },
    /// No degree of freedom is left.
    #[error("at least one degree of freedom must be free")]
    NothingMoves,
}

impl Default for Law {
    /// Hahn moments with the fixed window a = b = 8, orders 4 to 16, half of the step per second, capped at 0.25 m and 0.25 rad.
    fn default() -> Law {
        Law {
            method: Method::Hahn,
            window: Window::default(),
            krawtchouk_p: KrawtchoukP::Adaptive,
            lattice: Lattice::Paper,
            order: OrderRule::default(),
            gain: Gain::PerSecond(0.5),
            step_cap: Some(StepCap { translation_m: 0.25, rotation_rad: 0.25 }),
            degrees_of_freedom: [true; 6],
            gaussian: Gaussian::default(),
            light: None,
            noise_floor: NoiseFloor::Ignored,
            depth_scale: DepthScale::Given,
            holes: Holes::Filled,
        }
    }
}

impl Default for Gaussian {
    /// 16 pixels, every sum in full.
    fn default() -> Gaussian {
        Gaussian { extent_px: 16.0, form: GaussianForm::Exact }
    }
}

impl Default for LightPrior {
    /// From one step to the next: 6 % of gain, 1.5 % of offset, 5 % and 1.5 % of their slopes.
    fn default() -> LightPrior {
        LightPrior { gain: 0.06, offset: 0.015, gain_slope: 0.05, offset_slope: 0.015 }
    }
}

impl LightPrior {
    /// The deviations of `[gain, offset, gain slope u, gain slope v, offset slope u, offset slope v]`.
    pub fn deviations(&self) -> [f64; 6] {
        [self.gain, self.offset, self.gain_slope, self.gain_slope, self.offset_slope, self.offset_slope]
    }
}

impl Gain {
    /// `λ` in 1/s at this pixel mean square error.
    pub fn per_second(&self, pixel_mse: f64) -> f64 {
        match *self {
            Gain::PerSecond(per_s) => per_s,
            Gain::StepFraction { fraction, frame_period_s } => fraction / frame_period_s,
            Gain::Adaptive { at_zero, at_infinity, .. } if at_zero == at_infinity => at_zero,
            Gain::Adaptive { at_zero, at_infinity, slope_at_zero } => {
                let span = at_zero - at_infinity;
                span * (-slope_at_zero / span * pixel_mse.sqrt()).exp() + at_infinity
            }
        }
    }
}

impl Law {
    /// Whether the law's own numbers make sense; images and sizes come later.
    ///
    /// # Errors
    /// The first number that does not.
    pub fn check(&self) -> Result<(), LawError> {
        let gain_ok = match self.gain {
            Gain::PerSecond(per_s) => at_least_zero(per_s),
            Gain::StepFraction { fraction, frame_period_s } => at_least_zero(fraction) && positive(frame_period_s),
            Gain::Adaptive { at_zero, at_infinity, slope_at_zero } => {
                at_zero >= at_infinity
                    && at_zero.is_finite()
                    && at_least_zero(at_infinity)
                    && at_least_zero(slope_at_zero)
            }
        };
        if !gain_ok {
            return Err(LawError::Gain { gain: self.gain });
        }
        if let Some(step_cap) = self.step_cap
            && !(positive(step_cap.translation_m) && positive(step_cap.rotation_rad))
        {
            return Err(LawError::StepCap { step_cap });
        }
        family::check(self)?;
        if !positive(self.gaussian.extent_px) {
            return Err(LawError::GaussianExtent { extent_px: self.gaussian.extent_px });
        }
        if let Some(light) = self.light
            && (!light.deviations().into_iter().all(at_least_zero) || light.deviations() == [0.0; 6])
        {
            return Err(LawError::Light { light });
        }
        if self.depth_scale == DepthScale::Estimated && (!self.method.is_on_moments() || family::follows_images(self)) {
            return Err(LawError::DepthScale { method: self.method, window: self.window });
        }
        if self.degrees_of_freedom == [false; 6] { Err(LawError::NothingMoves) } else { Ok(()) }
    }
}

fn at_least_zero(value: f64) -> bool {
    value >= 0.0 && value.is_finite()
}

fn positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_law_is_valid() {
        assert_eq!(Law::default().check(), Ok(()));
    }

    #[test]
    fn a_step_fraction_is_taken_within_one_frame_period() {
        let gain = Gain::StepFraction { fraction: 0.5, frame_period_s: 0.1 };
        assert_eq!(gain.per_second(0.3), 5.0);
    }

    #[test]
    fn the_adaptive_gain_falls_from_one_limit_to_the_other_with_the_slope_asked_for() {
        let gain = Gain::Adaptive { at_zero: 2.0, at_infinity: 0.5, slope_at_zero: 6.0 };
        assert_eq!(gain.per_second(0.0), 2.0);
        assert!((gain.per_second(1e4) - 0.5).abs() < 1e-12, "exp(-400) is nothing");
        let slope = (gain.per_second(1e-12) - 2.0) / 1e-6;
        assert!((slope + 6.0).abs() < 1e-4, "one-sided difference over 1e-6 of a curve with second derivative 24");
    }

    #[test]
    fn numbers_that_make_no_law_are_refused() {
        let law = Law::default();
        let refused = [
            Law { gain: Gain::PerSecond(-1.0), ..law },
            Law { gain: Gain::StepFraction { fraction: 0.5, frame_period_s: 0.0 }, ..law },
            Law { gain: Gain::Adaptive { at_zero: 1.0, at_infinity: 2.0, slope_at_zero: 1.0 }, ..law },
            Law { step_cap: Some(StepCap { translation_m: 0.0, rotation_rad: 1.0 }), ..law },
            Law { window: Window::Fixed { x: [8.0, 8.0], y: [f64::NAN, 8.0] }, ..law },
            Law { krawtchouk_p: KrawtchoukP::Fixed([0.5, 1.0]), ..law },
            Law { degrees_of_freedom: [false; 6], ..law },
            Law { depth_scale: DepthScale::Estimated, window: Window::Adaptive, ..law },
            Law { depth_scale: DepthScale::Estimated, method: Method::Photometric, ..law },
            Law { gaussian: Gaussian { extent_px: 0.0, ..law.gaussian }, ..law },
            Law { light: Some(LightPrior { gain: f64::NAN, ..LightPrior::default() }), ..law },
            Law { light: Some(LightPrior { gain: 0.0, offset: 0.0, gain_slope: 0.0, offset_slope: 0.0 }), ..law },
        ];
        assert!(refused.iter().all(|law| law.check().is_err()));
    }
}
