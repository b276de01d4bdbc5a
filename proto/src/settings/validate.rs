//! What must hold between the numbers: the ranges of the table, and the rules that join two settings.

use super::fields::{self, Range};
use super::{
    Camera, Depth, DepthScale, Frames, Gain, KrawtchoukP, Light, Limits, Method, OrderRange, SettingsError, StepCap,
    Stop, TaskSettings, Window,
};

/// The longest bound key expression, bytes.
const MAX_KEY_BYTES: usize = 512;

const GAUSSIAN_PX: Range = Range::Between(0.5, 512.0);
const KRAWTCHOUK_P: Range = Range::Between(0.001, 0.999);
const DISTORTION: Range = Range::Between(-1000.0, 1000.0);
const STOP_PIXEL_MSE: Range = Range::Between(1e-9, 1.0);
const WATCHDOG_MS: Range = Range::Between(20.0, 60_000.0);

impl TaskSettings {
    /// Fails on the first setting that is not finite, out of its range, at odds with another, or not supported.
    pub fn validate(&self) -> Result<(), SettingsError> {
        check_window(self.window)?;
        if let KrawtchoukP::Fixed(p) = self.krawtchouk.p {
            each("krawtchouk.p", KRAWTCHOUK_P, &p)?;
        }
        check_camera(&self.camera)?;
        within("gaussian_px", GAUSSIAN_PX, self.gaussian_px())?;
        check_order(self.order, &self.camera)?;
        check("epsilon", self.epsilon)?;
        self.light.as_ref().map_or(Ok(()), check_light)?;
        check("frame_period_s", self.frame_period_s)?;
        self.gain.map_or(Ok(()), check_gain)?;
        self.step_cap.as_ref().map_or(Ok(()), check_step_cap)?;
        check_depth(self.depth)?;
        self.check_depth_scale()?;
        if let Some(mask) = &self.preprocess.mask {
            mask.check([self.camera.width, self.camera.height])?;
        }
        if self.preprocess.undistort {
            return Err(SettingsError::NotSupported { what: "preprocess.undistort".to_owned() });
        }
        self.limits.as_ref().map_or(Ok(()), check_limits)?;
        if self.degrees_of_freedom == [false; 6] {
            return contradiction("degrees_of_freedom must leave one of six free, got none".to_owned());
        }
        check_stop(&self.stop)?;
        check_frames(&self.frames)?;
        self.check_watchdog()?;
        check("max_age_ms", f64::from(self.max_age_ms))?;
        check("idle_close_s", f64::from(self.idle_close_s))
    }

    /// The scale shows in how the moments of one constant depth, under one window, answer to the motion.
    fn check_depth_scale(&self) -> Result<(), SettingsError> {
        if self.depth_scale == DepthScale::Given {
            return Ok(());
        }
        let needs = |what: String| contradiction(format!("depth_scale \"estimate\" needs {what}"));
        let method = self.method.word();
        match self.method {
            _ if !matches!(self.depth, Depth::ConstantM(_)) => needs("a constant depth, {\"constant_m\"}".to_owned()),
            _ if !self.method.is_of_moments() => needs(format!("a method of moments, got \"{method}\"")),
            Method::Hahn if !matches!(self.window, Window::Fixed { .. }) => needs("a fixed window".to_owned()),
            Method::Krawtchouk if self.krawtchouk.p == KrawtchoukP::Adaptive => {
                needs("a fixed krawtchouk.p".to_owned())
            }
            _ => Ok(()),
        }
    }

    fn check_watchdog(&self) -> Result<(), SettingsError> {
        let watchdog_ms = f64::from(self.watchdog_ms());
        within("watchdog_ms", WATCHDOG_MS, watchdog_ms)?;
        let two_periods_ms = 2000.0 * self.frame_period_s;
        // Half a microsecond of tolerance: 1/15 s has no exact binary form.
        if watchdog_ms < two_periods_ms - 5e-4 {
            return contradiction(format!(
                "watchdog_ms must be at least two frame periods, {two_periods_ms:.1} ms, got {watchdog_ms} ms"
            ));
        }
        Ok(())
    }
}

fn check_window(window: Window) -> Result<(), SettingsError> {
    let Window::Fixed { a, b } = window else {
        return Ok(());
    };
    for axis in 0..2 {
        check("window.fixed.a", a[axis])?;
        check("window.fixed.b", b[axis])?;
    }
    Ok(())
}

fn check_camera(camera: &Camera) -> Result<(), SettingsError> {
    check("camera.fx", camera.fx)?;
    check("camera.fy", camera.fy)?;
    check("camera.cx", camera.cx)?;
    check("camera.cy", camera.cy)?;
    check("camera.width", f64::from(camera.width))?;
    check("camera.height", f64::from(camera.height))?;
    each("camera.distortion", DISTORTION, &camera.distortion.unwrap_or_default())
}

fn check_order(order: OrderRange, camera: &Camera) -> Result<(), SettingsError> {
    check("order.min", f64::from(order.min))?;
    check("order.max", f64::from(order.max))?;
    if order.min > order.max {
        return contradiction(format!("order.min must be at most order.max {}, got {}", order.max, order.min));
    }
    let largest = camera.width.min(camera.height).saturating_sub(3);
    if u32::from(order.max) > largest {
        return contradiction(format!(
            "order.max must be at most min(width, height) - 3 = {largest} for {}x{} pixels, got {}",
            camera.width, camera.height, order.max
        ));
    }
    Ok(())
}

fn check_light(light: &Light) -> Result<(), SettingsError> {
    check("light.gain_std", light.gain_std)?;
    check("light.offset_std", light.offset_std)?;
    check("light.gain_slope_std", light.gain_slope_std)?;
    check("light.offset_slope_std", light.offset_slope_std)?;
    if *light == (Light { gain_std: 0.0, offset_std: 0.0, gain_slope_std: 0.0, offset_slope_std: 0.0 }) {
        return contradiction(
            "light must leave one of its parts above 0, got none; \"none\" switches it off".to_owned(),
        );
    }
    Ok(())
}

fn check_gain(gain: Gain) -> Result<(), SettingsError> {
    match gain {
        Gain::StepFraction(share) => check("gain.step_fraction", share),
        Gain::PerS(per_s) => check("gain.per_s", per_s),
        Gain::Adaptive(gain) => {
            check("gain.adaptive.at_zero", gain.at_zero)?;
            check("gain.adaptive.at_infinity", gain.at_infinity)?;
            check("gain.adaptive.slope_at_zero", gain.slope_at_zero)?;
            if gain.at_infinity >= gain.at_zero {
                return contradiction(format!(
                    "gain.adaptive.at_infinity must be below at_zero {}, got {}",
                    gain.at_zero, gain.at_infinity
                ));
            }
            Ok(())
        }
    }
}

fn check_step_cap(cap: &StepCap) -> Result<(), SettingsError> {
    check("step_cap.translation_m", cap.translation_m)?;
    check("step_cap.rotation_rad", cap.rotation_rad)
}

fn check_depth(depth: Depth) -> Result<(), SettingsError> {
    match depth {
        Depth::ConstantM(depth_m) => check("depth.constant_m", depth_m),
        Depth::Map { fallback_m: Some(depth_m), .. } => check("depth.map.fallback_m", depth_m),
        Depth::Map { fallback_m: None, .. } | Depth::Target => Ok(()),
    }
}

fn check_limits(limits: &Limits) -> Result<(), SettingsError> {
    check("limits.linear_m_per_s", limits.linear_m_per_s)?;
    check("limits.angular_rad_per_s", limits.angular_rad_per_s)?;
    check("limits.linear_m_per_s2", limits.linear_m_per_s2)?;
    check("limits.angular_rad_per_s2", limits.angular_rad_per_s2)
}

fn check_stop(stop: &Stop) -> Result<(), SettingsError> {
    check("stop.step_m", stop.step_m)?;
    check("stop.step_rad", stop.step_rad)?;
    if let Some(pixel_mse) = stop.pixel_mse {
        within("stop.pixel_mse", STOP_PIXEL_MSE, pixel_mse)?;
    }
    check("stop.hold_frames", f64::from(stop.hold_frames))?;
    check("stop.max_iterations", f64::from(stop.max_iterations))
}

/// A bound key names one publisher: no wildcard, no empty chunk, nothing that Zenoh would refuse.
fn check_frames(frames: &Frames) -> Result<(), SettingsError> {
    let Frames::Key(key) = frames else {
        return Ok(());
    };
    let refused = |reason: String| Err(SettingsError::Field { field: "frames.key".to_owned(), reason });
    if key.len() > MAX_KEY_BYTES {
        return refused(format!("a key has at most {MAX_KEY_BYTES} bytes, got {}", key.len()));
    }
    if key.split('/').any(str::is_empty) {
        return refused(format!("a key has no empty chunk, got {key:?}"));
    }
    match key.chars().find(|c| "*$?#".contains(*c) || c.is_control()) {
        Some(got) => refused(format!("a key to bind has no wildcard or control character, got {got:?}")),
        None => Ok(()),
    }
}

/// Holds a number against the range that the table documents.
fn check(name: &str, got: f64) -> Result<(), SettingsError> {
    let field = fields::find(name).expect("every checked name is in the table: a test checks them all");
    within(name, field.range, got)
}

fn each(name: &str, range: Range, numbers: &[f64]) -> Result<(), SettingsError> {
    numbers.iter().try_for_each(|got| within(name, range, *got))
}

fn within(name: &str, range: Range, got: f64) -> Result<(), SettingsError> {
    match range {
        // Written so that NaN is outside.
        Range::Between(least, most) if !(got >= least && got <= most) => {
            Err(SettingsError::OutOfRange { field: name.to_owned(), range: range.to_string(), got })
        }
        _ => Ok(()),
    }
}

fn contradiction(reason: String) -> Result<(), SettingsError> {
    Err(SettingsError::Contradiction { reason })
}
