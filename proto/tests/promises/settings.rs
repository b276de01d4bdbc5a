//! Settings: every default, every range, every patch, and what this version refuses.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use domvs_proto::messages::ErrorCode;
use domvs_proto::settings::{
    AdaptiveGain, Camera, Depth, DepthScale, FIELDS, Frames, Gain, Holes, KrawtchoukP, Light, Limits,
    MAX_MASK_CHARACTERS, Mask, Method, NoiseFloor, OrderRange, Range, SettingsError, StepCap, TaskSettings, Window,
};
use serde_json::{Value, json};

fn camera() -> Camera {
    Camera { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5, width: 640, height: 480, distortion: None }
}

fn defaults() -> TaskSettings {
    TaskSettings::new(camera())
}

/// The defaults with one more thing said.
fn created(change: Value) -> Result<TaskSettings, SettingsError> {
    let mut settings = json!({ "camera": camera() });
    settings.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    TaskSettings::from_json(&settings)
}

fn patched(patch: Value) -> Result<TaskSettings, SettingsError> {
    defaults().merge_patch(&patch)
}

/// `{"a": {"b": value}}` for `a.b`.
fn nested(path: &str, value: &Value) -> Value {
    path.rsplit('.').fold(value.clone(), |inner, chunk| json!({ chunk: inner }))
}

#[test]
fn defaults_are_valid_and_come_back_from_their_json() {
    defaults().validate().unwrap();
    assert_eq!(TaskSettings::from_json(&defaults().to_value()).unwrap(), defaults());
    assert_eq!(created(json!({})).unwrap(), defaults());
}

#[test]
fn every_number_is_held_to_its_documented_range() {
    for field in FIELDS {
        let Range::Between(least, most) = field.range else {
            continue;
        };
        for good in [least, most] {
            let value = if good.fract() == 0.0 { json!(good as i64) } else { json!(good) };
            let patch = nested(field.name, &value);
            if let Err(SettingsError::OutOfRange { field: name, .. }) = patched(patch) {
                panic!("{} refuses its own bound {good} by {name}", field.name);
            }
        }
        for bad in [json!(most * 2.0 + 1.0), json!(least - 1.0), json!("x"), json!(true), json!([])] {
            let refused = patched(nested(field.name, &bad));
            assert!(refused.is_err(), "{} takes {bad}", field.name);
        }
    }
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let bent: [fn(&mut TaskSettings, f64); 16] = [
            |s, x| s.epsilon = x,
            |s, x| s.frame_period_s = x,
            |s, x| s.window = Window::Fixed { a: [8.0, x], b: [8.0; 2] },
            |s, x| s.window = Window::Fixed { a: [8.0; 2], b: [x, 8.0] },
            |s, x| s.gaussian_px = Some(x),
            |s, x| s.light = Some(Light { offset_slope_std: x, ..Light::default() }),
            |s, x| s.krawtchouk.p = KrawtchoukP::Fixed([0.5, x]),
            |s, x| s.gain = Some(Gain::StepFraction(x)),
            |s, x| s.gain = Some(Gain::PerS(x)),
            |s, x| s.gain = Some(Gain::Adaptive(AdaptiveGain { at_zero: 1.0, at_infinity: 0.5, slope_at_zero: x })),
            |s, x| s.step_cap = Some(StepCap { translation_m: x, rotation_rad: 0.25 }),
            |s, x| s.camera.cx = x,
            |s, x| s.camera.distortion = Some([0.0, 0.0, x, 0.0, 0.0]),
            |s, x| s.depth = Depth::ConstantM(x),
            |s, x| s.limits = Some(Limits { linear_m_per_s: x, ..Limits::default() }),
            |s, x| s.stop.pixel_mse = Some(x),
        ];
        for (which, bend) in bent.into_iter().enumerate() {
            let mut settings = defaults();
            bend(&mut settings, bad);
            assert!(matches!(settings.validate(), Err(SettingsError::OutOfRange { .. })), "{which} takes {bad}");
        }
    }
}

#[test]
fn an_error_names_the_field_its_range_and_what_came() {
    let error = created(json!({ "epsilon": -1.0 })).unwrap_err();
    assert_eq!(error.to_string(), "epsilon must be 0.000000001 to 1, got -1");
    let error = created(json!({ "max_age_ms": -5 })).unwrap_err();
    assert!(error.to_string().starts_with("max_age_ms: invalid value"), "{error}");
    let error = created(json!({ "gian": 1 })).unwrap_err();
    assert!(error.to_string().starts_with("gian: unknown field `gian`"), "{error}");
    let error = created(json!({ "limits": { "speed": 1 } })).unwrap_err();
    assert!(error.to_string().contains("limits: unknown field `speed`"), "{error}");
}

#[test]
fn unknown_fields_are_refused_everywhere() {
    for path in [
        "x",
        "window.fixed.x",
        "window.x",
        "krawtchouk.x",
        "order.x",
        "gain.x",
        "gain.adaptive.x",
        "step_cap.x",
        "camera.x",
        "depth.x",
        "depth.map.x",
        "light.x",
        "preprocess.x",
        "preprocess.mask.x",
        "limits.x",
        "stop.x",
        "frames.x",
    ] {
        for value in [json!(1), json!({})] {
            assert!(patched(nested(path, &value)).is_err(), "{path} {value}");
            assert!(created(nested(path, &value)).is_err(), "{path} {value}");
        }
    }
    assert!(patched(json!({ "x": null })).is_err());
}

#[test]
fn only_the_camera_is_required() {
    for missing in [json!({}), json!({ "camera": null }), json!({ "camera": { "fx": 1.0 } })] {
        let error = TaskSettings::from_json(&missing).unwrap_err();
        assert!(error.to_string().starts_with("camera: missing field"), "{error}");
        assert_eq!(error.code(), ErrorCode::BadSettings);
    }
    assert!(patched(json!({ "camera": null })).is_err());
}

#[test]
fn order_is_a_number_or_a_range() {
    assert_eq!(created(json!({ "order": 8 })).unwrap().order, OrderRange { min: 8, max: 8 });
    assert_eq!(created(json!({ "order": { "min": 6, "max": 16 } })).unwrap().order, OrderRange { min: 6, max: 16 });
    for bad in
        [json!({ "min": 9, "max": 8 }), json!({ "min": 4 }), json!(0), json!(41), json!(8.5), json!(-1), json!("8")]
    {
        assert!(created(json!({ "order": bad })).is_err(), "{bad}");
    }
}

#[test]
fn order_is_at_most_the_smaller_side_less_three() {
    let small = |max: u16| created(json!({ "camera": Camera { width: 100, height: 12, ..camera() }, "order": max }));
    assert!(small(9).is_ok());
    let error = small(10).unwrap_err().to_string();
    assert_eq!(error, "order.max must be at most min(width, height) - 3 = 9 for 100x12 pixels, got 10");
}

#[test]
fn gain_is_by_the_way_each_frame_comes_unless_set() {
    assert_eq!(defaults().gain_for_requests(), Gain::StepFraction(0.5));
    assert_eq!(defaults().gain_for_pushed_frames(), Gain::PerS(1.0));
    let set = created(json!({ "gain": { "step_fraction": 0.2 } })).unwrap();
    assert_eq!(
        (set.gain_for_requests(), set.gain_for_pushed_frames()),
        (Gain::StepFraction(0.2), Gain::StepFraction(0.2))
    );
    let swapped = json!({ "adaptive": { "at_zero": 0.4, "at_infinity": 4.0, "slope_at_zero": 30.0 } });
    assert!(created(json!({ "gain": swapped })).is_err());
    assert!(created(json!({ "gain": { "per_s": 1.0, "step_fraction": 0.5 } })).is_err());
    assert!(created(json!({ "gain": 0.5 })).is_err());
}

#[test]
fn depth_has_four_forms() {
    let depth = |value: Value| created(json!({ "depth": value })).map(|settings| settings.depth);
    assert_eq!(depth(json!({ "constant_m": 0.8 })).unwrap(), Depth::ConstantM(0.8));
    let map = |fallback_m, holes| Depth::Map { fallback_m, holes };
    assert_eq!(depth(json!("map")).unwrap(), map(None, Holes::Fill));
    assert_eq!(depth(json!({ "map": { "fallback_m": null } })).unwrap(), map(None, Holes::Fill));
    assert_eq!(depth(json!({ "map": { "fallback_m": 2.0 } })).unwrap(), map(Some(2.0), Holes::Fill));
    assert_eq!(depth(json!({ "map": { "holes": "ignore" } })).unwrap(), map(None, Holes::Ignore));
    assert_eq!(depth(json!("target")).unwrap(), Depth::Target);
    for bad in [
        json!("constant_m"),
        json!(1.0),
        json!({ "constant_m": 0 }),
        json!({ "map": { "fallback_m": -1 } }),
        json!({ "map": { "holes": "guess" } }),
        json!({ "holes": "ignore" }),
        json!({}),
    ] {
        assert!(depth(bad.clone()).is_err(), "{bad}");
    }
}

#[test]
fn window_and_krawtchouk_take_a_number_or_a_pair() {
    let fixed = created(json!({ "window": { "fixed": { "a": 6, "b": [5, 4] } } })).unwrap();
    assert_eq!(fixed.window, Window::Fixed { a: [6.0, 6.0], b: [5.0, 4.0] });
    assert_eq!(created(json!({ "window": "adaptive" })).unwrap().window, Window::Adaptive);
    assert_eq!(created(json!({ "window": "adaptive_paper" })).unwrap().window, Window::AdaptivePaper);
    let p = |value: Value| created(json!({ "krawtchouk": { "p": value } })).map(|settings| settings.krawtchouk.p);
    assert_eq!(p(json!(0.5)).unwrap(), KrawtchoukP::Fixed([0.5; 2]));
    assert_eq!(p(json!("adaptive")).unwrap(), KrawtchoukP::Adaptive);
    for bad in [json!(0), json!(1), json!([0.5]), json!([0.5, 0.5, 0.5]), json!("fixed"), json!({})] {
        assert!(p(bad.clone()).is_err(), "{bad}");
    }
    assert!(created(json!({ "window": { "fixed": { "a": 6 } } })).is_err());
}

#[test]
fn every_method_is_chosen_by_its_word() {
    for method in Method::ALL {
        assert_eq!(created(json!({ "method": method.word() })).unwrap().method, method);
        assert_eq!(json!(method), json!(method.word()));
    }
    assert!(created(json!({ "method": "Photometric" })).is_err());
}

#[test]
fn the_gaussian_is_an_eighth_of_the_width_unless_set() {
    assert_eq!(defaults().gaussian_px(), 80.0);
    assert_eq!(created(json!({ "gaussian_px": 16 })).unwrap().gaussian_px(), 16.0);
    for bad in [json!(0.4), json!(513), json!("wide"), json!([16, 16])] {
        assert!(created(json!({ "gaussian_px": bad })).is_err(), "{bad}");
    }
}

#[test]
fn light_is_none_or_four_deviations_of_which_each_has_a_default() {
    assert_eq!(defaults().light, None);
    let on = patched(json!({ "light": {} })).unwrap();
    assert_eq!(on.light, Some(Light::default()));
    let wide = json!({ "light": { "gain_std": 0.3 } });
    let widened = Some(Light { gain_std: 0.3, ..Light::default() });
    assert_eq!((created(wide.clone()).unwrap().light, on.merge_patch(&wide).unwrap().light), (widened, widened));
    let narrow = json!({ "light": { "gain_std": null, "offset_std": 0.5 } });
    let narrowed = Light { offset_std: 0.5, ..Light::default() };
    assert_eq!(on.merge_patch(&wide).unwrap().merge_patch(&narrow).unwrap().light, Some(narrowed));
    for none in [json!(null), json!("none")] {
        assert_eq!(on.merge_patch(&json!({ "light": none })).unwrap(), defaults());
    }
    for bad in [
        json!("on"),
        json!(true),
        json!({ "gain_std": -1 }),
        json!({ "gain_std": 0, "offset_std": 0, "gain_slope_std": 0, "offset_slope_std": 0 }),
        json!({ "gain": 0.1 }),
    ] {
        assert!(created(json!({ "light": bad })).is_err(), "{bad}");
    }
}

#[test]
fn depth_scale_is_estimated_for_moments_of_a_constant_depth_under_a_fixed_window_only() {
    let estimate = |more: Value| {
        let mut change = json!({ "depth_scale": "estimate" });
        change.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        created(change)
    };
    for good in [
        json!({ "method": "cosine", "window": "adaptive" }),
        json!({ "method": "krawtchouk", "krawtchouk": { "p": 0.5 } }),
    ] {
        assert!(estimate(good.clone()).is_ok(), "{good}");
    }
    assert_eq!(estimate(json!({})).unwrap().depth_scale, DepthScale::Estimate);
    assert_eq!(created(json!({ "noise_floor": "subtract" })).unwrap().noise_floor, NoiseFloor::Subtract);
    for (more, words) in [
        (json!({ "depth": "map" }), "needs a constant depth"),
        (json!({ "depth": "target" }), "needs a constant depth"),
        (json!({ "window": "adaptive" }), "a fixed window"),
        (json!({ "method": "krawtchouk" }), "a fixed krawtchouk.p"),
        (json!({ "method": "photometric" }), "a method of moments, got \"photometric\""),
        (json!({ "method": "gaussian_mixture" }), "a method of moments, got \"gaussian_mixture\""),
    ] {
        let error = estimate(more).unwrap_err();
        assert!(error.to_string().contains(words) && error.code() == ErrorCode::BadSettings, "{error}");
    }
}

/// The first bytes of a PNG of this size, bit depth and colour type, then zeros.
fn png_like(size: [u32; 2], bit_depth: u8, color_type: u8, bytes: usize) -> Mask {
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    png.extend(size.iter().flat_map(|side| side.to_be_bytes()));
    png.extend([bit_depth, color_type]);
    png.resize(bytes, 0);
    Mask { png }
}

#[test]
fn a_mask_is_a_gray_png_of_the_cameras_size_and_no_larger_than_a_body_can_carry() {
    let masked = |mask: &Mask| patched(json!({ "preprocess": { "mask": mask } }));
    let mask = png_like([640, 480], 8, 0, 60);
    let settings = masked(&mask).unwrap();
    assert_eq!(settings.preprocess.mask, Some(mask.clone()));
    assert_eq!(settings.merge_patch(&json!({ "preprocess": { "mask": null } })).unwrap(), defaults());

    let most = MAX_MASK_CHARACTERS / 4 * 3;
    let largest = masked(&png_like([640, 480], 8, 0, most)).unwrap();
    assert_eq!(TaskSettings::from_create_body(&domvs_proto::body::write(&largest)).unwrap(), largest);
    for (mask, words) in [
        (png_like([640, 480], 8, 0, most + 1), "at most 786432 characters, got 786436"),
        (png_like([640, 479], 8, 0, 60), "640x480 pixels of the camera, got 640x479"),
        (png_like([640, 480], 1, 0, 60), "8 bits of gray (colour type 0), got 1 bits of colour type 0"),
        (png_like([640, 480], 8, 2, 60), "got 8 bits of colour type 2"),
        (png_like([640, 480], 8, 0, 25), "these 25 bytes are none"),
        (Mask { png: vec![] }, "these 0 bytes are none"),
        (Mask { png: b"GIF89a".to_vec() }, "these 6 bytes are none"),
    ] {
        let error = masked(&mask).unwrap_err();
        assert!(error.to_string().contains(words) && error.code() == ErrorCode::BadSettings, "{error}");
    }
    let other_camera = settings.merge_patch(&json!({ "camera": { "width": 320 } })).unwrap_err();
    assert!(other_camera.to_string().contains("320x480 pixels of the camera, got 640x480"), "{other_camera}");
    for bad in [json!("x"), json!({}), json!({ "png_base64": "====" }), json!({ "png_base64": 1 })] {
        let error = patched(json!({ "preprocess": { "mask": bad } })).unwrap_err();
        assert!(error.to_string().starts_with("preprocess: "), "{error}");
    }
}

#[test]
fn watchdog_is_three_periods_and_at_least_100_ms() {
    let watchdog = |period: f64| created(json!({ "frame_period_s": period })).unwrap().watchdog_ms();
    assert_eq!(watchdog(0.01), 100);
    assert_eq!(watchdog(0.05), 150);
    assert_eq!(watchdog(10.0), 30_000);
    assert_eq!(defaults().watchdog_ms(), 200);
}

#[test]
fn watchdog_under_two_periods_is_refused() {
    assert_eq!(created(json!({ "frame_period_s": 0.05, "watchdog_ms": 100 })).unwrap().watchdog_ms(), 100);
    let error = created(json!({ "frame_period_s": 0.05, "watchdog_ms": 99 })).unwrap_err();
    assert_eq!(error.to_string(), "watchdog_ms must be at least two frame periods, 100.0 ms, got 99 ms");
    assert!(created(json!({ "frame_period_s": 0.001, "watchdog_ms": 19 })).is_err());
    assert!(patched(json!({ "watchdog_ms": 100, "frame_period_s": 0.2 })).is_err());
}

#[test]
fn a_bound_key_is_one_plain_key() {
    let frames = |key: &str| created(json!({ "frames": { "key": key } })).map(|settings| settings.frames);
    assert_eq!(frames("domvs/camera/front/frame").unwrap(), Frames::Key("domvs/camera/front/frame".to_owned()));
    for bad in ["", "/a", "a/", "a//b", "a/*", "**", "a$*", "a?b", "a#b", "a\0b", &"a".repeat(513)] {
        assert!(frames(bad).is_err(), "{bad:?}");
    }
}

#[test]
fn one_degree_of_freedom_must_be_free() {
    assert!(created(json!({ "degrees_of_freedom": [false, false, false, false, false, true] })).is_ok());
    for bad in [json!([false, false, false, false, false, false]), json!([true]), json!([1, 1, 1, 1, 1, 1])] {
        assert!(created(json!({ "degrees_of_freedom": bad })).is_err(), "{bad}");
    }
}

#[test]
fn null_on_create_means_the_default_or_no_limits() {
    let nulls = json!({ "method": null, "gain": null, "watchdog_ms": null, "stop": { "step_m": null }, "ros2": null });
    assert_eq!(created(nulls).unwrap(), defaults());
    for none in [json!(null), json!("none")] {
        let free = created(json!({ "limits": none, "step_cap": none })).unwrap();
        assert_eq!((free.limits, free.step_cap), (None, None));
        assert_eq!(free.to_value()["limits"], json!("none"));
    }
}

#[test]
fn a_patch_changes_what_it_names_and_null_brings_the_default_back() {
    let changed =
        patched(json!({ "epsilon": 0.01, "limits": { "linear_m_per_s": 0.1 }, "stop": { "hold_frames": 2 } })).unwrap();
    let limits = changed.limits.unwrap();
    assert_eq!((limits.linear_m_per_s, limits.angular_rad_per_s), (0.1, 0.7));
    assert_eq!((changed.stop.hold_frames, changed.stop.step_m), (2, 0.0005));
    let back =
        changed.merge_patch(&json!({ "epsilon": null, "limits": { "linear_m_per_s": null }, "stop": null })).unwrap();
    assert_eq!(back, defaults());
}

#[test]
fn a_patch_can_drop_the_limits_and_bring_them_back() {
    let free = patched(json!({ "limits": "none" })).unwrap();
    assert_eq!(free.limits, None);
    assert_eq!(free.merge_patch(&json!({ "limits": null })).unwrap(), defaults());
    let some = free.merge_patch(&json!({ "limits": { "linear_m_per_s": 0.1 } })).unwrap();
    assert_eq!(some.limits, Some(Limits { linear_m_per_s: 0.1, ..Limits::default() }));
}

#[test]
fn a_patch_replaces_one_form_by_another() {
    let per_s = patched(json!({ "gain": { "per_s": 2.0 } })).unwrap();
    assert_eq!(per_s.gain, Some(Gain::PerS(2.0)));
    let letter_of_the_rfc = per_s.merge_patch(&json!({ "gain": { "per_s": null, "step_fraction": 0.4 } })).unwrap();
    assert_eq!(letter_of_the_rfc.gain, Some(Gain::StepFraction(0.4)));
    let depth = patched(json!({ "depth": { "map": { "fallback_m": 2.0 } } })).unwrap();
    assert_eq!(depth.merge_patch(&json!({ "depth": { "constant_m": 0.5 } })).unwrap().depth, Depth::ConstantM(0.5));
    let order = patched(json!({ "order": 8 })).unwrap();
    assert_eq!(
        order.merge_patch(&json!({ "order": { "min": 4, "max": 9 } })).unwrap().order,
        OrderRange { min: 4, max: 9 }
    );
}

#[test]
fn the_settings_that_are_answered_can_be_sent_back() {
    let odd = patched(json!({ "limits": "none", "step_cap": "none", "order": 7, "depth": "map", "frames": "pushed",
        "krawtchouk": { "p": [0.3, 0.4] }, "gain": { "per_s": 2 }, "watchdog_ms": 400 }))
    .unwrap();
    assert_eq!(TaskSettings::from_json(&odd.to_value()).unwrap(), odd);
    assert_eq!(defaults().merge_patch(&odd.to_value()).unwrap(), odd);
    assert_eq!(odd.merge_patch(&json!({})).unwrap(), odd);
}

#[test]
fn what_later_versions_bring_is_refused_by_name() {
    for (later, what) in [
        (json!({ "ros2": { "topic": "/cmd" } }), "ros2"),
        (json!({ "preprocess": { "resize": { "width": 320, "height": 240 } } }), "preprocess.resize"),
        (json!({ "preprocess": { "undistort": true } }), "preprocess.undistort"),
        (json!({ "frames": { "franka_cam": "wrist" } }), "frames \"franka_cam\""),
        (json!({ "frames": { "ros2": "/camera" } }), "frames \"ros2\""),
    ] {
        for refused in [created(later.clone()), patched(later.clone())] {
            let error = refused.unwrap_err();
            assert_eq!(error.to_string(), format!("{what} is not supported by this version"));
            assert_eq!(error.code(), ErrorCode::NotSupported);
        }
    }
    let mut by_hand = defaults();
    by_hand.preprocess.undistort = true;
    assert!(matches!(by_hand.validate(), Err(SettingsError::NotSupported { .. })));
}
