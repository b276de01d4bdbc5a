//! Random settings and random frames through the pure task, without a network: whatever comes, every twist is finite,
//! within the limits, and zero unless the status is `servoing`.

mod corpora;

use std::time::Duration;

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat};
use domvs_proto::messages::Control;
use domvs_proto::settings::{Limits, Mask, Method, TaskSettings};
use domvs_proto::status::Status;
use domvs_server::decode::DecodeLimits;
use domvs_server::pipeline::on_frame;
use domvs_server::task::{Frame, Route, Task};
use domvs_server::{AccelerationLimits, Governor};
use domvs_vision::Twist;
use image::ExtendedColorType;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use serde_json::{Value, json};

use crate::support::png;

/// Printed with every failure.
const SEED: u64 = 20_261_122;
const TASKS: usize = 200;
const FRAMES: usize = 12;
const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 16, max_bytes: 1 << 20 };

fn pick<const N: usize>(rng: &mut StdRng, values: [Value; N]) -> Value {
    values.choose(rng).expect("not empty").clone()
}

fn settings(rng: &mut StdRng) -> TaskSettings {
    let (width, height) = (rng.gen_range(24..64), rng.gen_range(24..64));
    let settings = json!({
        "camera": {
            "fx": rng.gen_range(1.0..200.0), "fy": rng.gen_range(1.0..200.0),
            "cx": rng.gen_range(-100.0..100.0), "cy": rng.gen_range(-100.0..100.0),
            "width": width, "height": height,
        },
        "method": pick(rng, Method::ALL.map(|method| json!(method))),
        "gaussian_px": pick(rng, [json!(null), json!(0.5), json!(512)]),
        "light": pick(rng, [json!("none"), json!({}), json!({ "gain_std": 10, "offset_std": 0 })]),
        "noise_floor": pick(rng, [json!("ignore"), json!("subtract")]),
        "window": pick(rng, [
            json!("adaptive"), json!("adaptive_paper"), json!({ "fixed": { "a": 0, "b": 100_000 } }),
            json!({ "fixed": { "a": 8, "b": 8 } }),
        ]),
        "krawtchouk": pick(rng, [
            json!({}), json!({ "p": 0.001, "lattice": "paper" }), json!({ "p": [0.999, 0.5] }),
        ]),
        "order": pick(rng, [json!(1), json!(4), json!({ "min": 2, "max": 21 }), json!(21)]),
        "gain": pick(rng, [
            json!(null), json!({ "step_fraction": 1 }), json!({ "per_s": 100 }),
            json!({ "adaptive": { "at_zero": 100, "at_infinity": 0.001, "slope_at_zero": 10_000 } }),
        ]),
        "depth": pick(rng, [
            json!({ "constant_m": 0.01 }), json!({ "constant_m": 1000 }), json!("map"),
            json!({ "map": { "fallback_m": 1 } }), json!({ "map": { "holes": "ignore" } }), json!("target"),
        ]),
        "limits": pick(rng, [json!({}), json!({ "linear_m_per_s": 1e-6 }), json!("none")]),
        "step_cap": pick(rng, [json!({}), json!("none")]),
        "degrees_of_freedom": pick(rng, [
            json!([true, true, true, true, true, true]), json!([false, false, false, false, false, true]),
        ]),
        "preprocess": { "invert": rng.r#gen::<bool>(), "mask": mask(rng, [width, height]) },
        "autostart": rng.r#gen::<bool>(),
    });
    let settings = TaskSettings::from_json(&settings).unwrap_or_else(|error| panic!("{error}: {settings}"));
    // Where the other settings allow for it.
    settings.merge_patch(&json!({ "depth_scale": "estimate" })).unwrap_or(settings)
}

/// None as a rule; else any weights.
fn mask(rng: &mut StdRng, size: [u32; 2]) -> Value {
    if rng.gen_bool(0.7) {
        return Value::Null;
    }
    let black = rng.gen_range(0.0..1.0);
    let gray: Vec<u8> = (0..size[0] * size[1]).map(|_| if rng.gen_bool(black) { 0 } else { rng.r#gen() }).collect();
    json!(Mask { png: png(&gray, size, ExtendedColorType::L8) })
}

/// A frame that is mostly well made: random content, now and then a wrong size, a lie or garbage.
fn frame(rng: &mut StdRng, settings: &TaskSettings) -> (FrameHeader, Vec<u8>) {
    let mut size = [settings.camera.width, settings.camera.height];
    if rng.gen_bool(0.05) {
        size[rng.gen_range(0..2)] = rng.gen_range(0..128);
    }
    let pixels = (size[0] * size[1]) as usize;
    let mut header = FrameHeader::new(PixelFormat::Mono32F, size[0], size[1]);
    let mut payload = samples(rng, pixels, 0.0..1.0);
    if rng.gen_bool(0.7) {
        header = FrameHeader { depth_format: DepthFormat::F32, depth_unit_m: 1.0, ..header };
        header.depth_offset = payload.len() as u32;
        payload.extend(samples(rng, pixels, 0.1..5.0));
    }
    header.sequence = rng.r#gen();
    header.capture_time_ns = if rng.gen_bool(0.5) { 0 } else { rng.r#gen() };
    match rng.gen_range(0..40) {
        0 => header.width = rng.r#gen(),
        1 => header.row_bytes = rng.r#gen(),
        2 => header.depth_offset = rng.r#gen(),
        3 => header.depth_unit_m = f32::from_bits(rng.r#gen()),
        4 => payload.truncate(rng.gen_range(0..=payload.len())),
        5 => rng.fill(&mut payload[..]),
        _ => {}
    }
    (header, payload)
}

/// Noise, a gradient, a flat picture or a bright spot, with some samples that are no numbers.
fn samples(rng: &mut StdRng, count: usize, range: std::ops::Range<f32>) -> Vec<u8> {
    let (kind, broken) = (rng.gen_range(0..4), if rng.gen_bool(0.2) { rng.gen_range(0.0..1.0) } else { 0.0 });
    let spot = rng.gen_range(0..count.max(1));
    let broken_sample = *[f32::NAN, f32::INFINITY, -1e30, 3e38, 0.0].choose(rng).expect("not empty");
    let level: f32 = rng.gen_range(range.clone());
    let sample = |index: usize, rng: &mut StdRng| match kind {
        0 => rng.gen_range(range.clone()),
        1 => range.start + (range.end - range.start) * (index as f32 / count as f32),
        2 => level,
        _ => {
            if index.abs_diff(spot) < 40 {
                range.end
            } else {
                range.start
            }
        }
    };
    (0..count)
        .flat_map(|index| if rng.gen_bool(broken) { broken_sample } else { sample(index, rng) }.to_le_bytes())
        .collect()
}

fn norm(part: &[f64]) -> f64 {
    part.iter().map(|component| component * component).sum::<f64>().sqrt()
}

#[test]
fn every_twist_is_finite_within_its_limits_and_zero_unless_servoing() {
    let mut rng = StdRng::seed_from_u64(SEED);
    let mut seen = std::collections::BTreeMap::<&str, usize>::new();
    for number in 0..TASKS {
        let settings = settings(&mut rng);
        let mut task = Task::new(settings.clone(), LIMITS);
        let mut now = Duration::from_secs(1);
        for step in 0..FRAMES {
            let (header, payload) = frame(&mut rng, &settings);
            let route = if rng.r#gen() { Route::Requested } else { Route::Pushed };
            let frame = Frame { header: &header, encoding: "", payload: (&payload).into(), received: now, route };
            now += Duration::from_micros(rng.gen_range(0..200_000));
            match rng.gen_range(0..if step < 3 { 3 } else { 30 }) {
                0 => drop(task.set_target(&frame)),
                1 => drop(task.control(Control::Start)),
                _ => {}
            }
            let answer = on_frame(&mut task, &frame, now);
            *seen.entry(answer.status.word()).or_default() += 1;
            let what = || format!("seed {SEED}, task {number}, frame {step}: {answer:?} of {settings:?}");
            assert!(answer.twist.iter().all(|component| component.is_finite()), "{}", what());
            assert!(answer.is_servoing() || answer.twist == [0.0; 6], "{}", what());
            assert_eq!(answer.sequence, header.sequence);
            if let Some(limits) = settings.limits {
                let slack = 1.0 + 1e-12;
                assert!(norm(&answer.twist[..3]) <= limits.linear_m_per_s * slack, "{}", what());
                assert!(norm(&answer.twist[3..]) <= limits.angular_rad_per_s * slack, "{}", what());
            }
            for (component, free) in answer.twist.iter().zip(settings.degrees_of_freedom) {
                assert!(free || *component == 0.0, "a masked degree moves: {}", what());
            }
        }
    }
    // The generator is worth its name only if all of these are reached.
    for word in ["servoing", "waiting_target", "ready", "bad_frame", "stale_frame", "low_texture", "no_depth"] {
        assert!(seen.contains_key(word), "no {word} among {seen:?}");
    }
}

#[test]
fn whatever_is_wanted_the_command_never_changes_faster_than_the_acceleration_limits() {
    let mut rng = StdRng::seed_from_u64(SEED);
    let limits = Limits::default();
    let acceleration =
        AccelerationLimits { linear_m_per_s2: limits.linear_m_per_s2, angular_rad_per_s2: limits.angular_rad_per_s2 };
    let period = Duration::from_millis(66);
    let mut governor = Governor::new(Some(acceleration), Duration::from_millis(200), period);
    let (mut now, mut last, mut sent_at) = (Duration::from_secs(1), [0.0; 6], None::<Duration>);
    for step in 0..5000 {
        now += Duration::from_micros(rng.gen_range(0..150_000));
        if rng.gen_bool(0.1) {
            governor.brake(now);
            (last, sent_at) = ([0.0; 6], Some(now));
            continue;
        }
        let wanted: [f64; 6] = std::array::from_fn(|_| rng.gen_range(-1.0..1.0));
        let sent = governor.pass(Twist::from_array(wanted), now, now).twist.to_array();
        let seconds = sent_at.map_or(period, |at| now - at).min(period).as_secs_f64();
        let change: [f64; 6] = std::array::from_fn(|i| sent[i] - last[i]);
        // Rounding of a difference and a norm.
        assert!(norm(&change[..3]) <= acceleration.linear_m_per_s2 * seconds + 1e-12, "seed {SEED}, step {step}");
        assert!(norm(&change[3..]) <= acceleration.angular_rad_per_s2 * seconds + 1e-12, "seed {SEED}, step {step}");
        (last, sent_at) = (sent, Some(now));
    }
}

#[test]
fn the_same_frames_at_the_same_times_give_the_same_twists_bit_for_bit() {
    let run = || {
        let mut rng = StdRng::seed_from_u64(SEED + 1);
        let settings = TaskSettings { autostart: true, ..settings(&mut rng) };
        let mut task = Task::new(settings.clone(), LIMITS);
        let mut answers = vec![];
        for step in 0..30 {
            let (header, payload) = frame(&mut rng, &settings);
            let received = Duration::from_millis(66 * step);
            let frame =
                Frame { header: &header, encoding: "", payload: (&payload).into(), received, route: Route::Requested };
            if step < 5 {
                drop(task.set_target(&frame));
            }
            answers.push(on_frame(&mut task, &frame, received).encode());
        }
        answers
    };
    let (first, second) = (run(), run());
    assert_eq!(first, second);
    assert!(first.iter().any(|answer| answer[1] == Status::Servoing.code()), "some of them move");
}
