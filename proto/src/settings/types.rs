//! The shape of task settings and their defaults. Every field has its unit in its name.
//!
//! Shapes that JSON writes in more than one way (a number or a pair, a value or "none") are in `forms`.

use serde::{Deserialize, Serialize};

use super::forms;
use super::mask::Mask;
use super::methods::Method;
use crate::keys::Name;

/// The window of Hahn moments; other methods ignore it. For each axis, `[x, y]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Window {
    /// By the rule that reproduces the authors' logs.
    Adaptive,
    /// By the rule as the paper prints it.
    AdaptivePaper,
    /// Always the same. JSON: `{"fixed": {"a": 8, "b": 8}}`, or a pair `[x, y]` for either.
    Fixed {
        /// Hahn's a, per axis.
        #[serde(with = "forms::per_axis")]
        a: [f64; 2],
        /// Hahn's b, per axis.
        #[serde(with = "forms::per_axis")]
        b: [f64; 2],
    },
}

impl Default for Window {
    fn default() -> Window {
        Window::Fixed { a: [8.0; 2], b: [8.0; 2] }
    }
}

/// Where the Krawtchouk window is.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum KrawtchoukP {
    /// From the centroids of the images. JSON: `"adaptive"`.
    #[default]
    Adaptive,
    /// Always the same, per axis. JSON: a number or a pair `[x, y]`.
    Fixed([f64; 2]),
}

/// On how many points Krawtchouk polynomials are orthonormal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lattice {
    /// N + 1 points cut to N pixels, as the paper has it.
    #[default]
    Paper,
    /// N points for N pixels.
    Exact,
}

/// Settings of Krawtchouk moments; other methods ignore them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Krawtchouk {
    /// Where the window is.
    pub p: KrawtchoukP,
    /// On how many points.
    pub lattice: Lattice,
}

/// Moment orders: from `min` far away to `max` close to the target. JSON: a number stands for both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OrderRange {
    /// The order far away.
    pub min: u16,
    /// The order at the target; at most min(width, height) − 3.
    pub max: u16,
}

impl Default for OrderRange {
    fn default() -> OrderRange {
        OrderRange { min: 4, max: 16 }
    }
}

/// Whether the order rule knows of the sensor's noise.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseFloor {
    /// The pixel error is taken as it is.
    #[default]
    Ignore,
    /// What noise alone would make of it is subtracted, so that a noisy image too may reach the largest order.
    Subtract,
}

/// How far the light may go from one frame to the next, with the target's light as its beginning: standard deviations
/// of its estimate, for gray in [0, 1]. 0 holds a part still; not all are 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Of the factor of the gray values.
    pub gain_std: f64,
    /// Of what is added to them.
    pub offset_std: f64,
    /// Of the factor's slope along each axis, from the centre to the border.
    pub gain_slope_std: f64,
    /// Of the slope of what is added, likewise.
    pub offset_slope_std: f64,
}

impl Default for Light {
    fn default() -> Light {
        Light { gain_std: 0.06, offset_std: 0.015, gain_slope_std: 0.05, offset_slope_std: 0.015 }
    }
}

/// How much of the step is taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gain {
    /// This share of the step within one `frame_period_s`: λ = share / `frame_period_s`.
    StepFraction(f64),
    /// λ itself, 1/s. Keep λ · delay ≤ 0.35.
    PerS(f64),
    /// λ grows as the error shrinks.
    Adaptive(AdaptiveGain),
}

/// λ at r = √pixel_mse: (at_zero − at_infinity) · exp(−slope_at_zero · r / (at_zero − at_infinity)) + at_infinity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdaptiveGain {
    /// λ at the target, 1/s.
    pub at_zero: f64,
    /// λ far away, 1/s; below `at_zero`.
    pub at_infinity: f64,
    /// How fast λ falls at the target, 1/s per unit of √pixel_mse.
    pub slope_at_zero: f64,
}

/// Bounds of the full Gauss-Newton step, before the gain; one scale for both.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepCap {
    /// Norm of the translation, m.
    pub translation_m: f64,
    /// Norm of the rotation, rad.
    pub rotation_rad: f64,
}

impl Default for StepCap {
    fn default() -> StepCap {
        StepCap { translation_m: 0.25, rotation_rad: 0.25 }
    }
}

/// A pinhole camera. Pixel centres are at whole numbers, the first at (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Focal length along u, pixels.
    pub fx: f64,
    /// Focal length along v, pixels.
    pub fy: f64,
    /// Principal point along u, pixels.
    pub cx: f64,
    /// Principal point along v, pixels.
    pub cy: f64,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// k1 k2 p1 p2 k3; kept for the record, not applied in this version.
    #[serde(default)]
    pub distortion: Option<[f64; 5]>,
}

/// Where depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Depth {
    /// The same for every pixel of both images, m. Depth planes in frames are ignored.
    ConstantM(f64),
    /// Each frame brings its own depth plane, the target too. JSON: `"map"` alone has no fallback.
    Map {
        /// What an unknown depth becomes, m; without it the frame's median, and `no_depth` over half unknown.
        #[serde(default)]
        fallback_m: Option<f64>,
        /// What becomes of pixels with unknown depth.
        #[serde(default)]
        holes: Holes,
    },
    /// The target's depth plane for both images; frames need none.
    Target,
}

impl Default for Depth {
    fn default() -> Depth {
        Depth::ConstantM(1.0)
    }
}

/// What becomes of pixels with unknown depth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holes {
    /// Their depth is filled in, and they count.
    #[default]
    Fill,
    /// They do not count, in either image.
    Ignore,
}

/// Whether a constant depth is taken at its word.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthScale {
    /// It is right.
    #[default]
    Given,
    /// It is a guess: its scale is estimated from how the images answer to the motion.
    Estimate,
}

/// A new image size. There is none in this version.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Resize {}

/// What is done to every gray image first.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preprocess {
    /// 1 − gray: the object should be brighter than its surroundings.
    pub invert: bool,
    /// Not supported by this version: null.
    pub resize: Option<Resize>,
    /// Which pixels count; none = all. It has the camera's size.
    pub mask: Option<Mask>,
    /// Not supported by this version: false.
    pub undistort: bool,
}

/// Speed limits, in every twist; acceleration limits, on `command` only. Norms of three components.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Speed, m/s.
    pub linear_m_per_s: f64,
    /// Angular speed, rad/s.
    pub angular_rad_per_s: f64,
    /// Acceleration, m/s².
    pub linear_m_per_s2: f64,
    /// Angular acceleration, rad/s².
    pub angular_rad_per_s2: f64,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits { linear_m_per_s: 0.2, angular_rad_per_s: 0.7, linear_m_per_s2: 0.5, angular_rad_per_s2: 2.0 }
    }
}

/// When the task has arrived, and when it gives up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    /// Arrived: translation of the full Gauss-Newton step at most this, m.
    pub step_m: f64,
    /// Arrived: rotation of the full step at most this, rad.
    pub step_rad: f64,
    /// Arrived: pixel error at most this as well; null = not asked.
    pub pixel_mse: Option<f64>,
    /// For so many frames in a row.
    pub hold_frames: u32,
    /// Give up after so many twists; 0 = never.
    pub max_iterations: u32,
}

impl Default for Stop {
    fn default() -> Stop {
        Stop { step_m: 0.0005, step_rad: 0.0005, pixel_mse: None, hold_frames: 5, max_iterations: 0 }
    }
}

/// How frames come in: chooses the default gain, and what is subscribed besides the task's own `frame` key.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Frames {
    /// With requests on `twist`.
    #[default]
    Requests,
    /// Pushed on the task's own `frame` key.
    Pushed,
    /// Pushed on this key too, by a camera of our own format.
    Key(String),
}

/// A ROS 2 topic for twists. There is none in this version.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ros2 {}

/// Whose going ends the task.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lease {
    /// The client's liveliness token: of any process of that name.
    #[default]
    Client,
    /// The liveliness token of this one process of the client. JSON: `{"process": "p1"}`.
    Process(Name),
    /// Nobody's: only `idle_close_s`.
    None,
}

/// Everything a client may choose for a task. Only the camera has no default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSettings {
    /// What is compared.
    pub method: Method,
    /// The Hahn window.
    pub window: Window,
    /// The Krawtchouk window.
    pub krawtchouk: Krawtchouk,
    /// Standard deviation of the Gaussian mixture's blur, pixels; none = width / 8, see [`TaskSettings::gaussian_px`].
    pub gaussian_px: Option<f64>,
    /// Moment orders.
    pub order: OrderRange,
    /// Pixel error below which the order is at its largest.
    pub epsilon: f64,
    /// Whether the order rule knows of noise.
    pub noise_floor: NoiseFloor,
    /// How far the light may go; none = it is the target's. JSON: `"none"`.
    #[serde(with = "forms::value_or_none")]
    pub light: Option<Light>,
    /// How much of the step is taken; none = by the way each frame came, see
    /// [`TaskSettings::gain_for_requests`] and [`TaskSettings::gain_for_pushed_frames`].
    pub gain: Option<Gain>,
    /// Time between two frames, s.
    pub frame_period_s: f64,
    /// Bounds of the full step; none = unbounded. JSON: `"none"`.
    #[serde(with = "forms::value_or_none")]
    pub step_cap: Option<StepCap>,
    /// The camera, of the target and of the frames.
    pub camera: Camera,
    /// Where depth comes from.
    pub depth: Depth,
    /// Whether a constant depth is right, or a guess.
    pub depth_scale: DepthScale,
    /// What is done to every image first.
    pub preprocess: Preprocess,
    /// Speed and acceleration limits; none = unlimited. JSON: `"none"`.
    #[serde(with = "forms::value_or_none")]
    pub limits: Option<Limits>,
    /// Which of x, y, z, ωx, ωy, ωz may move.
    pub degrees_of_freedom: [bool; 6],
    /// When to stop.
    pub stop: Stop,
    /// How frames come in.
    pub frames: Frames,
    /// Whether pushed frames must carry the task's frame secret, or its secret.
    pub frame_secret: bool,
    /// Not supported by this version: null.
    pub ros2: Option<Ros2>,
    /// Zeros on `command` when no frame came for so long, ms; none = by `frame_period_s`, see [`TaskSettings::watchdog_ms`].
    pub watchdog_ms: Option<u32>,
    /// Older frames are stale, ms.
    pub max_age_ms: u32,
    /// Whose going ends the task.
    pub lease: Lease,
    /// Without a lease, a task that nobody uses is closed after so long, s.
    pub idle_close_s: u32,
    /// Start with the first frame after the target is set.
    pub autostart: bool,
}

impl TaskSettings {
    /// The defaults for this camera.
    pub fn new(camera: Camera) -> TaskSettings {
        TaskSettings {
            method: Method::default(),
            window: Window::default(),
            krawtchouk: Krawtchouk::default(),
            gaussian_px: None,
            order: OrderRange::default(),
            epsilon: 1e-3,
            noise_floor: NoiseFloor::default(),
            light: None,
            gain: None,
            frame_period_s: 1.0 / 15.0,
            step_cap: Some(StepCap::default()),
            camera,
            depth: Depth::default(),
            depth_scale: DepthScale::default(),
            preprocess: Preprocess::default(),
            limits: Some(Limits::default()),
            degrees_of_freedom: [true; 6],
            stop: Stop::default(),
            frames: Frames::default(),
            frame_secret: false,
            ros2: None,
            watchdog_ms: None,
            max_age_ms: 200,
            lease: Lease::default(),
            idle_close_s: 600,
            autostart: false,
        }
    }

    /// The Gaussian mixture's blur, or its default, pixels: an eighth of the width.
    pub fn gaussian_px(&self) -> f64 {
        self.gaussian_px.unwrap_or(f64::from(self.camera.width) / 8.0)
    }

    /// The gain for a frame that came with a request; half a step per frame by default.
    pub fn gain_for_requests(&self) -> Gain {
        self.gain.unwrap_or(Gain::StepFraction(0.5))
    }

    /// The gain for a frame that was pushed; 1/s by default.
    pub fn gain_for_pushed_frames(&self) -> Gain {
        self.gain.unwrap_or(Gain::PerS(1.0))
    }

    /// The watchdog time, or its default, ms: three frame periods, at least 100.
    pub fn watchdog_ms(&self) -> u32 {
        let three_periods = (3000.0 * self.frame_period_s).round();
        // Periods are at most 10 s, so the conversion keeps the value.
        self.watchdog_ms.unwrap_or((three_periods as u32).max(100))
    }
}
