//! From what a client set to what the law takes. The two crates know nothing of each other; here they meet.

use domvs_proto::settings::{self, TaskSettings};
use domvs_vision::{
    CameraError, DepthScale, Gain, Gaussian, GaussianForm, Holes, Intrinsics, KrawtchoukP, Lattice, Law, LightPrior,
    Method, NoiseFloor, OrderError, OrderRule, StepCap, Window,
};

use crate::governor::{AccelerationLimits, SpeedLimits};
use crate::task::Route;

/// The law that these settings describe, for frames that come with requests. The gaussian mixture has its fast form.
/// Fails where the law is stricter than the checked settings.
pub fn law(settings: &TaskSettings) -> Result<Law, OrderError> {
    let order = OrderRule::new(usize::from(settings.order.min), usize::from(settings.order.max), settings.epsilon)?;
    Ok(Law {
        method: method(settings.method),
        window: window(settings.window),
        krawtchouk_p: match settings.krawtchouk.p {
            settings::KrawtchoukP::Adaptive => KrawtchoukP::Adaptive,
            settings::KrawtchoukP::Fixed(p) => KrawtchoukP::Fixed(p),
        },
        lattice: match settings.krawtchouk.lattice {
            settings::Lattice::Paper => Lattice::Paper,
            settings::Lattice::Exact => Lattice::Exact,
        },
        order,
        gain: gain(settings, Route::Requested),
        step_cap: settings
            .step_cap
            .map(|cap| StepCap { translation_m: cap.translation_m, rotation_rad: cap.rotation_rad }),
        degrees_of_freedom: settings.degrees_of_freedom,
        gaussian: Gaussian { extent_px: settings.gaussian_px(), form: GaussianForm::Fast },
        light: settings.light.map(light_prior),
        noise_floor: match settings.noise_floor {
            settings::NoiseFloor::Ignore => NoiseFloor::Ignored,
            settings::NoiseFloor::Subtract => NoiseFloor::Subtracted,
        },
        depth_scale: match settings.depth_scale {
            settings::DepthScale::Given => DepthScale::Given,
            settings::DepthScale::Estimate => DepthScale::Estimated,
        },
        holes: match settings.depth {
            settings::Depth::Map { holes: settings::Holes::Ignore, .. } => Holes::Ignored,
            _ => Holes::Filled,
        },
    })
}

/// The pinhole part of the camera.
pub fn intrinsics(camera: &settings::Camera) -> Result<Intrinsics, CameraError> {
    Intrinsics::new([camera.fx, camera.fy], [camera.cx, camera.cy])
}

/// The speed part of the limits.
pub fn speed_limits(settings: &TaskSettings) -> Option<SpeedLimits> {
    settings.limits.map(|limits| SpeedLimits {
        linear_m_per_s: limits.linear_m_per_s,
        angular_rad_per_s: limits.angular_rad_per_s,
    })
}

/// The acceleration part of the limits.
pub fn acceleration_limits(settings: &TaskSettings) -> Option<AccelerationLimits> {
    settings.limits.map(|limits| AccelerationLimits {
        linear_m_per_s2: limits.linear_m_per_s2,
        angular_rad_per_s2: limits.angular_rad_per_s2,
    })
}

/// The law's method of the same word.
pub fn method(method: settings::Method) -> Method {
    Method::from_word(method.word()).expect("the law knows every method of the wire: a test asks for each")
}

/// How far the light may go.
pub fn light_prior(light: settings::Light) -> LightPrior {
    LightPrior {
        gain: light.gain_std,
        offset: light.offset_std,
        gain_slope: light.gain_slope_std,
        offset_slope: light.offset_slope_std,
    }
}

fn window(window: settings::Window) -> Window {
    match window {
        settings::Window::Adaptive => Window::Adaptive,
        settings::Window::AdaptivePaper => Window::AdaptivePaper,
        settings::Window::Fixed { a, b } => Window::Fixed { x: [a[0], b[0]], y: [a[1], b[1]] },
    }
}

/// The gain for a frame that came this way.
pub fn gain(settings: &TaskSettings, route: Route) -> Gain {
    let gain = match route {
        Route::Requested => settings.gain_for_requests(),
        Route::Pushed => settings.gain_for_pushed_frames(),
    };
    match gain {
        settings::Gain::PerS(per_s) => Gain::PerSecond(per_s),
        settings::Gain::StepFraction(fraction) => {
            Gain::StepFraction { fraction, frame_period_s: settings.frame_period_s }
        }
        settings::Gain::Adaptive(gain) => {
            Gain::Adaptive { at_zero: gain.at_zero, at_infinity: gain.at_infinity, slope_at_zero: gain.slope_at_zero }
        }
    }
}

#[cfg(test)]
mod tests {
    use domvs_proto::settings::Camera;

    use super::*;

    fn settings() -> TaskSettings {
        let camera = Camera { fx: 90.0, fy: 90.0, cx: 63.5, cy: 47.5, width: 128, height: 96, distortion: None };
        TaskSettings::new(camera)
    }

    #[test]
    fn every_method_of_the_wire_is_one_of_the_law() {
        for wire in settings::Method::ALL {
            let law = method(wire);
            assert_eq!((law.word(), law.is_on_moments()), (wire.word(), wire.is_of_moments()));
        }
        assert_eq!(settings::Method::ALL.len(), Method::ALL.len());
    }

    #[test]
    fn what_a_client_sets_is_what_the_law_gets() {
        let set = settings()
            .merge_patch(&serde_json::json!({
                "method": "cosine", "gaussian_px": 12.5, "noise_floor": "subtract", "depth_scale": "estimate",
                "light": { "gain_std": 0.1, "offset_std": 0.2, "gain_slope_std": 0.3, "offset_slope_std": 0.4 },
            }))
            .expect("settings that agree");
        let made = law(&set).expect("a law");
        assert_eq!(made.method, Method::Cosine);
        assert_eq!(made.gaussian, Gaussian { extent_px: 12.5, form: GaussianForm::Fast });
        let light = LightPrior { gain: 0.1, offset: 0.2, gain_slope: 0.3, offset_slope: 0.4 };
        assert_eq!((made.light, made.noise_floor), (Some(light), NoiseFloor::Subtracted));
        assert_eq!((made.depth_scale, made.holes), (DepthScale::Estimated, Holes::Filled));
        let holes = serde_json::json!({ "depth": { "map": { "holes": "ignore" } } });
        assert_eq!(law(&settings().merge_patch(&holes).expect("fine")).expect("a law").holes, Holes::Ignored);
    }

    #[test]
    fn the_defaults_of_both_sides_are_the_same() {
        let made = law(&settings()).expect("a law");
        let gain = Gain::StepFraction { fraction: 0.5, frame_period_s: settings().frame_period_s };
        let gaussian = Gaussian { extent_px: 16.0, form: GaussianForm::Fast };
        assert_eq!(made, Law { gain, gaussian, ..Law::default() });
        assert_eq!(light_prior(settings::Light::default()), LightPrior::default());
    }
}
