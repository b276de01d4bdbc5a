//! The law on two views: `step` reads top to bottom as the paper's data way.
//!
//! No clock, no thread, no randomness: the same law, desired view and images give the same twists, bit for bit, on one machine type.

use crate::basis::{BasisError, LENGTHS};
use crate::camera::Intrinsics;
use crate::control::cap_step;
use crate::depth::Depth;
use crate::family::{self, Chosen, Method};
use crate::features::{Features, Sights};
use crate::gram::Gram;
use crate::image::Plane;
use crate::law::{DepthScale, Gain, Holes, Law, LawError, NoiseFloor};
use crate::moments::{FeatureRow, Work};
use crate::sample::Sample;
use crate::twist::Twist;
use crate::window::{Brightness, NoBrightness, WindowInUse};

/// What a camera sees: an image in `[0, 1]`, and how far it is.
#[derive(Debug, Clone, Copy)]
pub struct View<'a, T> {
    /// Gray image.
    pub image: &'a Plane<T>,
    /// Its depth.
    pub depth: &'a Depth<T>,
}

/// A camera servoed to where the desired view was taken.
#[derive(Debug)]
pub struct Servo<T> {
    law: Law,
    desired_image: Plane<T>,
    desired_depth: Depth<T>,
    desired_brightness: Brightness,
    current_brightness: Brightness,
    initial_mse: Option<f64>,
    moved: Option<[f64; 6]>,
    features: Features<T>,
}

/// One step's twist, and what it was made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// `-λ` times the capped step; exactly zero if the rank is deficient.
    pub twist: Twist,
    /// The full step `-L̂⁺e`, metres and radians, before cap and gain; only along the directions seen if the rank is deficient.
    pub gauss_newton: [f64; 6],
    /// Whether the step was longer than the cap.
    pub step_capped: bool,
    /// `λ`, in 1/s.
    pub gain_per_s: f64,
    /// `l`.
    pub order: usize,
    /// How many features: `(l + 1)(l + 2)/2`.
    pub features: usize,
    /// The parameters of the bases.
    pub window: WindowInUse,
    /// Mean of `(I - I*)²`.
    pub pixel_mse: f64,
    /// `e·e`.
    pub feature_error_squared: f64,
    /// Of `L̂` over the free degrees; infinite when it is singular.
    pub condition_number: f64,
    /// Directions seen, of the free degrees.
    pub rank: usize,
    /// Whether some free direction is not seen.
    pub rank_deficient: bool,
    /// With light columns: `[gain, offset, gain slope u, gain slope v, offset slope u, offset slope v]` of the current image over
    /// the desired one, as the change from `[0, 0, …]`: a gain of -0.3 is 30 % darker.
    pub light: Option<[f64; 6]>,
    /// What the inverse of the given constant depth is multiplied by; 1 when depths are as given.
    pub depth_scale: f64,
    /// Share of pixels with weight.
    pub used_fraction: f64,
}

/// Why there is no servo, or no step.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum ServoError {
    /// The law's own numbers.
    #[error(transparent)]
    Law(#[from] LawError),
    /// A side is too short or too long.
    #[error("images have {} to {} pixels a side, got {got:?}", LENGTHS.start(), LENGTHS.end())]
    SizeOutOfRange {
        /// `[width, height]`.
        got: [usize; 2],
    },
    /// The order is too high for the size.
    #[error("expected orders up to {highest} for {size:?} pixels (shorter side - 3), got {got}")]
    OrderTooHigh {
        /// `min(width, height) - 3`.
        highest: usize,
        /// The rule's highest order.
        got: usize,
        /// `[width, height]`.
        size: [usize; 2],
    },
    /// An image has another size than the desired one.
    #[error("expected an image of {expected:?} pixels, got {got:?}")]
    ImageSize {
        /// `[width, height]` of the desired image.
        expected: [usize; 2],
        /// `[width, height]` given.
        got: [usize; 2],
    },
    /// A depth map has another size than the desired image.
    #[error("expected a depth map of {expected:?} pixels, got {got:?}")]
    DepthSize {
        /// `[width, height]` of the desired image.
        expected: [usize; 2],
        /// `[width, height]` given.
        got: [usize; 2],
    },
    /// A constant depth is not positive and finite.
    #[error("a constant depth must be positive and finite, got {depth_m} m")]
    DepthNotPositive {
        /// As given, metres.
        depth_m: f64,
    },
    /// A pixel is not a finite number, or so large that sums over the image are not.
    #[error("the image holds numbers that are not finite, or sums beyond all numbers")]
    ImageNotFinite,
    /// An adaptive window needs brightness to follow.
    #[error(transparent)]
    NoBrightness(#[from] NoBrightness),
    /// The window leaves no orthonormal basis.
    #[error(transparent)]
    Basis(#[from] BasisError),
    /// A part of the law that this version does not serve.
    #[error("this version does not serve {what}")]
    NotServed {
        /// The method or option.
        what: &'static str,
    },
}

impl<T: Sample> Servo<T> {
    /// A servo to `desired`, which is copied. All buffers are made here: a step allocates nothing.
    ///
    /// # Errors
    /// A law, size, order or depth out of range, or a desired image that is not finite or (for an adaptive window) black.
    pub fn new(law: Law, camera: Intrinsics, desired: View<'_, T>) -> Result<Servo<T>, ServoError> {
        law.check()?;
        check_served(&law)?;
        let size = desired.image.size();
        if !size.iter().all(|side| LENGTHS.contains(side)) {
            return Err(ServoError::SizeOutOfRange { got: size });
        }
        let (highest, got) = (size[0].min(size[1]) - 3, law.order.max());
        if got > highest {
            return Err(ServoError::OrderTooHigh { highest, got, size });
        }
        check_view(desired, size)?;
        mean_square_difference(desired.image, desired.image)?;
        let brightness = Brightness::of(desired.image);
        let chosen = family::choose(&law, &brightness, &brightness)?;
        let features = match chosen {
            Some(chosen) => Features::moments(camera, size, law.order.max(), chosen)?,
            None => return Err(not_served("this method")),
        };
        Ok(Servo {
            law,
            desired_image: desired.image.clone(),
            desired_depth: desired.depth.clone(),
            current_brightness: brightness.clone(),
            desired_brightness: brightness,
            initial_mse: None,
            moved: None,
            features,
        })
    }

    /// The twist that brings `current` nearer to the desired view. After an error the servo is as if it had not been called.
    ///
    /// # Errors
    /// A size or depth that does not fit, pixels that are not finite, or (for an adaptive window) a black image.
    pub fn step(&mut self, current: View<'_, T>) -> Result<Step, ServoError> {
        check_view(current, self.desired_image.size())?;
        let pixel_mse = mean_square_difference(current.image, &self.desired_image)?;

        let chosen = self.choose_rows(current.image)?;
        let initial_mse = self.initial_mse.unwrap_or(pixel_mse);
        let order = self.law.order.order(pixel_mse, initial_mse);

        let equations = self.gram(current, chosen, order)?.normal_equations();
        if !equations.is_finite() {
            return Err(ServoError::ImageNotFinite);
        }

        let free = self.law.degrees_of_freedom;
        let solution = equations.solve(free);
        let rank_deficient = solution.rank < free.iter().filter(|free| **free).count();
        let (capped, step_capped) = cap_step(solution.gauss_newton, self.law.step_cap);
        let gain_per_s = self.law.gain.per_second(pixel_mse);
        let twist = if rank_deficient { Twist::ZERO } else { Twist::from_array(capped).scaled(gain_per_s) };

        self.initial_mse = Some(initial_mse);
        self.moved = None;
        Ok(Step {
            twist,
            gauss_newton: solution.gauss_newton,
            step_capped,
            gain_per_s,
            order,
            features: equations.features,
            window: chosen.map_or(WindowInUse::Whole, |chosen| chosen.window),
            pixel_mse,
            feature_error_squared: equations.error_squared,
            condition_number: solution.condition_number,
            rank: solution.rank,
            rank_deficient,
            light: None,
            depth_scale: 1.0,
            used_fraction: 1.0,
        })
    }

    /// Takes weights in `[0, 1]`, one per pixel of the desired image, from the next step on: they multiply `I - I*` and all six
    /// planes of `L_I` of both images. `None` counts every pixel fully.
    ///
    /// # Errors
    /// Another size, a weight outside `[0, 1]`, or a share of pixels with weight too small to servo by; the servo then keeps the mask it had.
    pub fn set_mask(&mut self, mask: Option<&Plane<T>>) -> Result<(), ServoError> {
        match mask {
            None => Ok(()),
            Some(mask) => {
                check_size(mask, self.desired_image.size())?;
                Err(ServoError::NotServed { what: "a mask" })
            }
        }
    }

    /// What the camera was really told to do since the last step: twist times seconds, metres and radians, camera frame. The
    /// depth-scale estimate learns from it; without it the next step leaves the estimate as it was.
    pub fn moved(&mut self, displacement: [f64; 6]) {
        self.moved = Some(displacement);
    }

    /// Sets the initial image `I°` of the order rule; otherwise it is the image of the first step.
    ///
    /// # Errors
    /// Another size, or pixels that are not finite.
    pub fn set_initial(&mut self, image: &Plane<T>) -> Result<(), ServoError> {
        check_size(image, self.desired_image.size())?;
        self.initial_mse = Some(mean_square_difference(image, &self.desired_image)?);
        Ok(())
    }

    /// Forgets `I°`: the next step's image takes its place.
    pub fn restart(&mut self) {
        self.initial_mse = None;
    }

    /// Takes another gain from the next step on; everything else stays.
    ///
    /// # Errors
    /// A gain that makes no law; the servo then keeps the one it had.
    pub fn set_gain(&mut self, gain: Gain) -> Result<(), LawError> {
        let law = Law { gain, ..self.law };
        law.check()?;
        self.law = law;
        Ok(())
    }

    /// The law as it was given, with the gain set last.
    pub fn law(&self) -> &Law {
        &self.law
    }

    /// The features of the last step, `n` outside, `m` inside: what `e` and `L̂` were.
    pub fn features(&self) -> impl Iterator<Item = FeatureRow> {
        self.features.rows()
    }

    /// What has been computed so far; the rest was found in the cache.
    pub fn work(&self) -> Work {
        self.features.work()
    }

    fn choose_rows(&mut self, current: &Plane<T>) -> Result<Option<Chosen>, NoBrightness> {
        if family::follows_images(&self.law) {
            self.current_brightness.set(current);
        }
        family::choose(&self.law, &self.current_brightness, &self.desired_brightness)
    }

    fn gram(&mut self, current: View<'_, T>, chosen: Option<Chosen>, order: usize) -> Result<Gram, BasisError> {
        let sights =
            Sights { current: (current.image, current.depth), desired: (&self.desired_image, &self.desired_depth) };
        self.features.gram(chosen, order, sights)
    }
}

fn not_served(what: &'static str) -> ServoError {
    ServoError::NotServed { what }
}

/// Refuses what is declared and not yet made.
fn check_served(law: &Law) -> Result<(), ServoError> {
    match law {
        Law { method: Method::Photometric, .. } => Err(not_served("the method photometric")),
        Law { method: Method::GaussianMixture, .. } => Err(not_served("the method gaussian_mixture")),
        Law { light: Some(_), .. } => Err(not_served("light columns")),
        Law { noise_floor: NoiseFloor::Subtracted, .. } => Err(not_served("a noise floor")),
        Law { depth_scale: DepthScale::Estimated, .. } => Err(not_served("a depth scale")),
        Law { holes: Holes::Ignored, .. } => Err(not_served("ignored holes")),
        _ => Ok(()),
    }
}

fn check_view<T: Sample>(view: View<'_, T>, expected: [usize; 2]) -> Result<(), ServoError> {
    check_size(view.image, expected)?;
    match view.depth {
        Depth::Constant { depth_m } if *depth_m > 0.0 && depth_m.is_finite() => Ok(()),
        Depth::Constant { depth_m } => Err(ServoError::DepthNotPositive { depth_m: *depth_m }),
        Depth::Map(map) if map.inverse_per_m().size() == expected => Ok(()),
        Depth::Map(map) => Err(ServoError::DepthSize { expected, got: map.inverse_per_m().size() }),
    }
}

fn check_size<T: Sample>(image: &Plane<T>, expected: [usize; 2]) -> Result<(), ServoError> {
    let got = image.size();
    if got == expected { Ok(()) } else { Err(ServoError::ImageSize { expected, got }) }
}

/// Mean of `(I - I*)²` over the pixels: `ē_I` of Eq. (26).
fn mean_square_difference<T: Sample>(image: &Plane<T>, desired: &Plane<T>) -> Result<f64, ServoError> {
    const STRANDS: usize = 8;
    let mut strands = [0.0; STRANDS];
    let [(image, image_rest), (desired, desired_rest)] =
        [image, desired].map(|plane| plane.samples().as_chunks::<STRANDS>());
    let square = |a: T, b: T| (a - b).to_f64() * (a - b).to_f64();
    for (a, b) in image.iter().zip(desired) {
        for i in 0..STRANDS {
            strands[i] += square(a[i], b[i]);
        }
    }
    let rest: f64 = image_rest.iter().zip(desired_rest).map(|(a, b)| square(*a, *b)).sum();
    let count = (STRANDS * image.len() + image_rest.len()) as f64;
    let mean = (strands.iter().sum::<f64>() + rest) / count;
    if mean.is_finite() { Ok(mean) } else { Err(ServoError::ImageNotFinite) }
}
