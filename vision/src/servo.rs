//! The law on two views: `step` reads top to bottom as the paper's data way.
//!
//! No clock, no thread, no randomness: the same law, desired view and images, from the first on, give the same twists, bit for bit, on one machine type.

mod error;

use crate::basis::LENGTHS;
use crate::camera::Intrinsics;
use crate::control::cap_step;
use crate::depth::Depth;
use crate::depth_scale::{self, DepthScaleEstimate};
use crate::family::{self, Chosen};
use crate::features::{Features, Sights};
use crate::gram::Gram;
use crate::image::Plane;
use crate::law::{DepthScale, Gain, Law, LawError, LightPrior, NoiseFloor};
use crate::light::{self, light_alone, separate};
use crate::moments::{Extras, FeatureRow, Work};
use crate::noise;
use crate::order::OrderRule;
use crate::path::Path;
use crate::pixel_error::pixel_mse;
use crate::sample::Sample;
use crate::twist::Twist;
use crate::weights::{MaskError, Weights};
use crate::window::{Brightness, NoBrightness, WindowInUse};

pub use error::ServoError;

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
    path: Path,
    desired_image: Plane<T>,
    desired_depth: Depth<T>,
    desired_brightness: Brightness,
    current_brightness: Brightness,
    weights: Weights<T>,
    desired_noise: f64,
    initial_mse: Option<f64>,
    /// The light that the last step found.
    light: Option<[f64; 6]>,
    depth_scale: Option<DepthScaleEstimate>,
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
    /// `l`; 0 for methods whose features are pixels.
    pub order: usize,
    /// How many features: `(l + 1)(l + 2)/2`, or the pixels.
    pub features: usize,
    /// The parameters of the bases.
    pub window: WindowInUse,
    /// Mean of `(I - I*)²` over the pixels with weight; with light columns, of what the light that was known before leaves of it.
    pub pixel_mse: f64,
    /// `e·e`.
    pub feature_error_squared: f64,
    /// Of `L̂` over the free degrees; infinite when it is singular.
    pub condition_number: f64,
    /// Directions seen, of the free degrees.
    pub rank: usize,
    /// Whether some free direction is not seen.
    pub rank_deficient: bool,
    /// How far from that: smallest over largest singular value, columns scaled; deficient at [`crate::control::SMALLEST_SINGULAR_RATIO`].
    pub singular_ratio: f64,
    /// With light columns: `[gain, offset, gain slope u, gain slope v, offset slope u, offset slope v]` of the current image over
    /// the desired one, as the change from `[0, 0, …]`: a gain of -0.3 is 30 % darker.
    pub light: Option<[f64; 6]>,
    /// What the inverse of the given constant depth is multiplied by; 1 when depths are as given.
    pub depth_scale: f64,
    /// Share of pixels with weight.
    pub used_fraction: f64,
}

impl<T: Sample> Servo<T> {
    /// A servo to `desired`, which is copied. All buffers are made here: a step allocates nothing.
    ///
    /// # Errors
    /// A law, size, order or depth out of range, or a desired image that is not finite or (for an adaptive window) black.
    pub fn new(law: Law, camera: Intrinsics, desired: View<'_, T>) -> Result<Servo<T>, ServoError> {
        law.check()?;
        let size = desired.image.size();
        if !size.iter().all(|side| LENGTHS.contains(side)) {
            return Err(ServoError::SizeOutOfRange { got: size });
        }
        let (highest, got) = (size[0].min(size[1]) - 3, order_rule(&law).max());
        if law.method.is_on_moments() && got > highest {
            return Err(ServoError::OrderTooHigh { highest, got, size });
        }
        check_view(desired, size, &law)?;
        finite(pixel_mse(Path::best(), desired.image, desired.image, None, None))?;
        let mut weights = Weights::new(size, law.holes);
        weights.update(Path::best(), [desired.depth; 2])?;
        let mut brightness = Brightness::of(desired.image);
        brightness.set(desired.image, weights.plane());
        let chosen = family::choose(&law, &brightness, &brightness)?;
        let features = match chosen {
            Some(chosen) => {
                Features::moments(camera, size, highest_swept(&law, highest), chosen, extras(&law, highest))?
            }
            None => Features::pixels(&law, camera, size),
        };
        Ok(Servo {
            law,
            path: Path::best(),
            desired_image: desired.image.clone(),
            desired_depth: desired.depth.clone(),
            current_brightness: brightness.clone(),
            desired_brightness: brightness,
            desired_noise: noise_floor(Path::best(), &law, desired.image, weights.plane()),
            weights,
            initial_mse: None,
            light: None,
            depth_scale: (law.depth_scale == DepthScale::Estimated).then(DepthScaleEstimate::new),
            moved: None,
            features,
        })
    }

    /// The twist that brings `current` nearer to the desired view. After an error the servo is as if it had not been called, but for what it
    /// keeps to save work, on which the last digits of the next twist depend.
    ///
    /// # Errors
    /// A size or depth that does not fit, pixels that are not finite, too few pixels with weight, or (for an adaptive window) a black image.
    pub fn step(&mut self, current: View<'_, T>) -> Result<Step, ServoError> {
        check_view(current, self.desired_image.size(), &self.law)?;
        self.weigh(current.depth)?;
        let (chosen, pixel_mse) = self.choose_rows(current.image)?;
        let light_before = self.light_before(current, chosen)?;

        let pixel_mse = match pixel_mse {
            Some(pixel_mse) => finite(pixel_mse)?,
            None => self.pixel_mse(current.image, light_before)?,
        };
        let order_mse = self.order_mse(pixel_mse, current.image);
        let initial_mse = self.initial_mse.unwrap_or_else(|| self.initial(order_mse));
        let order = chosen.map_or(0, |_| order_rule(&self.law).order(order_mse, initial_mse));

        let gram = self.gram(current, chosen, order)?;
        let free = self.law.degrees_of_freedom;
        let separated = match self.law.light {
            Some(prior) => {
                let known = self.light.unwrap_or_default();
                Some(separate(&gram, &prior, known, free).ok_or(ServoError::ImageNotFinite)?)
            }
            None => None,
        };
        let equations = separated.map_or_else(|| gram.normal_equations(), |separated| separated.equations);

        let solution = equations.solve(free);
        let rank_deficient = solution.rank < free.iter().filter(|free| **free).count();
        let light = separated.map(|separated| separated.light(solution.gauss_newton));
        if !light.iter().flatten().all(|number| number.is_finite()) {
            return Err(ServoError::ImageNotFinite);
        }
        let depth_scale = self.update_depth_scale(order, light);
        let gauss_newton = at_scale(solution.gauss_newton, depth_scale);
        let (capped, step_capped) = cap_step(gauss_newton, self.law.step_cap);
        let gain_per_s = self.law.gain.per_second(pixel_mse);
        let twist = if rank_deficient { Twist::ZERO } else { Twist::from_array(capped).scaled(gain_per_s) };

        (self.initial_mse, self.light, self.moved) = (Some(initial_mse), light, None);
        Ok(Step {
            twist,
            gauss_newton,
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
            singular_ratio: solution.singular_ratio,
            light,
            depth_scale,
            used_fraction: self.weights.share(),
        })
    }

    /// Takes weights in `[0, 1]`, one per pixel of the desired image, from the next step on: they multiply `I - I*` and all six
    /// planes of `L_I` of both images. A pixel beside one without weight has none either. `None` counts every pixel fully.
    ///
    /// # Errors
    /// Another size, a weight outside `[0, 1]`, or too few pixels with weight; the servo then keeps the mask it had.
    pub fn set_mask(&mut self, mask: Option<&Plane<T>>) -> Result<(), ServoError> {
        if let Some(mask) = mask {
            check_size(mask, self.desired_image.size())?;
        }
        self.weights.set_mask(mask)?;
        Ok(())
    }

    /// What the camera was really told to do: twist times seconds, metres and radians, camera frame. Calls since the last
    /// successful step add up. The depth-scale estimate learns from it; without it the next step leaves the estimate as it was.
    pub fn moved(&mut self, displacement: [f64; 6]) {
        let before = self.moved.unwrap_or_default();
        self.moved = Some(std::array::from_fn(|i| before[i] + displacement[i]));
    }

    /// Sets the initial image `I°` of the order rule; otherwise it is the image of the first step. Its error is taken under the
    /// mask of now and, with light columns, as the light that alone explains it best leaves it.
    ///
    /// # Errors
    /// Another size, pixels that are not finite, or (for an adaptive window and light) a black image.
    pub fn set_initial(&mut self, image: &Plane<T>) -> Result<(), ServoError> {
        check_size(image, self.desired_image.size())?;
        let depth = self.desired_depth.clone();
        self.weigh(&depth)?;
        let light = match self.law.light {
            Some(prior) => {
                let (chosen, _) = self.choose_rows(image)?;
                Some(self.guess_light(View { image, depth: &depth }, chosen, &prior)?)
            }
            None => None,
        };
        let pixel_mse = self.pixel_mse(image, light)?;
        self.initial_mse = Some(self.initial(self.order_mse(pixel_mse, image)));
        Ok(())
    }

    /// What the order rule measures against: the initial image's error as the rule sees it. None before the first step.
    pub fn initial_mse(&self) -> Option<f64> {
        self.initial_mse
    }

    /// Goes on from an initial image that another servo with the same law and desired view has seen, by what
    /// [`Servo::initial_mse`] said there.
    pub fn set_initial_mse(&mut self, initial_mse: Option<f64>) {
        self.initial_mse = initial_mse;
    }

    /// Forgets what earlier images told: `I°`, whose place the next step's image takes, the light, the depth scale, and what is kept of the desired
    /// view. What follows is, bit for bit, what a new servo would do.
    pub fn restart(&mut self) {
        self.features.forget_desired();
        (self.initial_mse, self.light, self.moved) = (None, None, None);
        self.depth_scale = self.depth_scale.take().map(|_| DepthScaleEstimate::new());
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

    /// Uses these instructions from the next step on, in place of the widest this machine has.
    pub fn set_path(&mut self, path: Path) {
        self.path = path;
        self.features.set_path(path);
    }

    /// The law as it was given, with the gain set last.
    pub fn law(&self) -> &Law {
        &self.law
    }

    /// The moments of the last step, `n` outside, `m` inside: what `e` and `L̂` were. None for methods whose features are pixels:
    /// see [`crate::planes::pair_planes`].
    pub fn features(&self) -> impl Iterator<Item = FeatureRow> {
        self.features.rows()
    }

    /// What has been computed so far; the rest was found in the cache.
    pub fn work(&self) -> Work {
        self.features.work()
    }

    /// Makes the weights for a current view of this depth, and drops what was made of the desired view under others.
    fn weigh(&mut self, current: &Depth<T>) -> Result<(), MaskError> {
        if !self.weights.update(self.path, [current, &self.desired_depth])? {
            return Ok(());
        }
        let weight = self.weights.plane();
        self.features.forget_desired();
        self.desired_brightness.set(&self.desired_image, weight);
        self.desired_noise = noise_floor(self.path, &self.law, &self.desired_image, weight);
        if let Some(estimate) = &mut self.depth_scale {
            estimate.forget_frames();
        }
        Ok(())
    }

    /// Chooses the rows, by where the current image's brightness lies if the law follows that; the plain pixel error may come along.
    fn choose_rows(&mut self, current: &Plane<T>) -> Result<(Option<Chosen>, Option<f64>), NoBrightness> {
        let mut pixel_mse = None;
        if family::follows_images(&self.law) {
            let weight = self.weights.plane();
            let desired = (weight.is_none() && self.law.light.is_none()).then_some(&self.desired_image);
            let squares = self.current_brightness.set_beside(self.path, current, weight, desired);
            pixel_mse = desired.map(|desired| squares / desired.samples().len() as f64);
        }
        let chosen = family::choose(&self.law, &self.current_brightness, &self.desired_brightness)?;
        Ok((chosen, pixel_mse))
    }

    /// The light that is known before this step: that of the last one, or on a first step the one that alone explains the pair best.
    fn light_before(&mut self, current: View<'_, T>, chosen: Option<Chosen>) -> Result<Option<[f64; 6]>, ServoError> {
        match (self.law.light, self.light) {
            (Some(prior), None) => self.guess_light(current, chosen, &prior).map(Some),
            (_, known) => Ok(known),
        }
    }

    fn guess_light(
        &mut self,
        current: View<'_, T>,
        chosen: Option<Chosen>,
        prior: &LightPrior,
    ) -> Result<[f64; 6], ServoError> {
        let order = light::FIRST_GUESS_ORDER.min(order_rule(&self.law).max());
        Ok(light_alone(&self.gram(current, chosen, order)?, prior))
    }

    fn pixel_mse(&self, image: &Plane<T>, light: Option<[f64; 6]>) -> Result<f64, ServoError> {
        finite(pixel_mse(self.path, image, &self.desired_image, self.weights.plane(), light))
    }

    /// What the order rule sees of the pixel error: without the images' noise, if the law says so (deviation D16).
    fn order_mse(&self, pixel_mse: f64, image: &Plane<T>) -> f64 {
        let noise = noise_floor(self.path, &self.law, image, self.weights.plane()) + self.desired_noise;
        (pixel_mse - noise).max(0.0)
    }

    /// The initial error that an error as the order rule sees it makes: without noise there is always some left to go by.
    fn initial(&self, order_mse: f64) -> f64 {
        match self.law.noise_floor {
            NoiseFloor::Ignored => order_mse,
            NoiseFloor::Subtracted => order_mse.max(noise::LEAST_INITIAL_MSE),
        }
    }

    fn gram(&mut self, current: View<'_, T>, chosen: Option<Chosen>, order: usize) -> Result<Gram, ServoError> {
        let sights = Sights {
            current: (current.image, current.depth),
            desired: (&self.desired_image, &self.desired_depth),
            weight: self.weights.plane(),
        };
        let gram = self.features.gram(chosen, order, sights)?;
        if gram.is_finite() { Ok(gram) } else { Err(ServoError::ImageNotFinite) }
    }

    /// Learns from the last step's features, and says what the inverse of the given depth is to be multiplied by.
    fn update_depth_scale(&mut self, order: usize, light: Option<[f64; 6]>) -> f64 {
        let Some(estimate) = &mut self.depth_scale else { return 1.0 };
        estimate.update(order, self.moved, self.features.own_rows(light.unwrap_or_default()));
        estimate.scale()
    }
}

/// The law's order rule, with enough features for the light's columns too.
fn order_rule(law: &Law) -> OrderRule {
    if law.light.is_some() { law.order.at_least(light::LOWEST_ORDER) } else { law.order }
}

/// What the law needs of moments besides the features, on images that allow orders up to `highest`.
fn extras(law: &Law, highest: usize) -> Extras {
    let least_swept = match law.depth_scale {
        DepthScale::Given => 0,
        DepthScale::Estimated => depth_scale::LOWEST_ORDER.min(highest),
    };
    Extras { light: law.light.is_some(), least_swept }
}

fn highest_swept(law: &Law, highest: usize) -> usize {
    order_rule(law).max().max(extras(law, highest).least_swept)
}

/// `σ²` of an image's noise, if the law subtracts it.
fn noise_floor<T: Sample>(path: Path, law: &Law, image: &Plane<T>, weight: Option<&Plane<T>>) -> f64 {
    match law.noise_floor {
        NoiseFloor::Ignored => 0.0,
        NoiseFloor::Subtracted => noise::noise_variance(path, image, weight),
    }
}

/// A step solved at the depth as given, when its inverse is to be multiplied by `scale`: the translation columns grow, the translation shrinks.
fn at_scale(step: [f64; 6], scale: f64) -> [f64; 6] {
    std::array::from_fn(|i| if i < 3 { step[i] / scale } else { step[i] })
}

fn finite(number: f64) -> Result<f64, ServoError> {
    if number.is_finite() { Ok(number) } else { Err(ServoError::ImageNotFinite) }
}

fn check_view<T: Sample>(view: View<'_, T>, expected: [usize; 2], law: &Law) -> Result<(), ServoError> {
    check_size(view.image, expected)?;
    match view.depth {
        Depth::Constant { depth_m } if *depth_m > 0.0 && depth_m.is_finite() => Ok(()),
        Depth::Constant { depth_m } => Err(ServoError::DepthNotPositive { depth_m: *depth_m }),
        Depth::Map(_) if law.depth_scale == DepthScale::Estimated => Err(ServoError::DepthScaleOfMap),
        Depth::Map(map) if map.inverse_per_m().size() == expected => Ok(()),
        Depth::Map(map) => Err(ServoError::DepthSize { expected, got: map.inverse_per_m().size() }),
    }
}

fn check_size<T: Sample>(image: &Plane<T>, expected: [usize; 2]) -> Result<(), ServoError> {
    let got = image.size();
    if got == expected { Ok(()) } else { Err(ServoError::ImageSize { expected, got }) }
}
