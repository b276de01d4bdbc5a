//! Anything that may come: settings within their ranges, extremes among them, frames good and bad, orders at any time.

use std::ops::Range;
use std::time::Duration;

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat};
use domvs_proto::messages::Control;
use domvs_proto::settings::{Mask, Method, TaskSettings};
use image::{ExtendedColorType, ImageEncoder};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use serde_json::{Value, json};

use crate::pictures::Shot;

/// Runs a property over so many random inputs, or as many as `DOMVS_CASES` says; the same ones every time.
pub fn every<S: Strategy>(cases: u32, inputs: S, holds: impl Fn(S::Value)) {
    let asked = std::env::var("DOMVS_CASES").ok().map(|cases| cases.parse().expect("DOMVS_CASES is a number"));
    let config = Config { cases: asked.unwrap_or(cases), failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let outcome = runner.run(&inputs, |input| {
        holds(input);
        Ok::<(), TestCaseError>(())
    });
    outcome.unwrap_or_else(|error| panic!("{error}"));
}

fn one_of<const N: usize>(values: [Value; N]) -> impl Strategy<Value = Value> {
    select(values.to_vec())
}

/// Sides from the smallest that are allowed, seldom square.
fn size() -> impl Strategy<Value = [u32; 2]> {
    prop_oneof![1 => Just([8, 8]), 4 => (8u32..40, 8u32..40).prop_map(|(width, height)| [width, height])]
}

/// Settings that a client may set, for images of some size.
pub fn settings() -> impl Strategy<Value = TaskSettings> {
    size().prop_flat_map(|size| (geometry(size), law(size), limits()).prop_map(assembled))
}

fn geometry(size: [u32; 2]) -> impl Strategy<Value = Value> {
    let focal = || prop_oneof![Just(1.0), Just(1e6), 5.0..100.0f64];
    let centre = || prop_oneof![Just(-1e5), Just(1e5), 0.0..40.0f64];
    let depth = one_of([
        json!({ "constant_m": 0.01 }),
        json!({ "constant_m": 1 }),
        json!({ "constant_m": 1000 }),
        json!("map"),
        json!({ "map": { "fallback_m": 0.01 } }),
        json!({ "map": { "holes": "ignore" } }),
        json!("target"),
    ]);
    (focal(), focal(), centre(), centre(), depth, mask(size), any::<bool>()).prop_map(
        move |(fx, fy, cx, cy, depth, mask, invert)| {
            json!({
                "camera": { "fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": size[0], "height": size[1] },
                "depth": depth,
                "preprocess": { "invert": invert, "mask": mask },
            })
        },
    )
}

/// Mostly none; else weights of any kind, among them those that leave next to nothing.
fn mask([width, height]: [u32; 2]) -> impl Strategy<Value = Value> {
    let weights = (0u32..=100, any::<u32>()).prop_map(move |(percent, seed)| {
        let gray = |pixel: u32| if noise(seed, pixel) % 100 < percent { noise(seed, !pixel) as u8 } else { 0 };
        let pixels: Vec<u8> = (0..width * height).map(gray).collect();
        let mut png = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        encoder.write_image(&pixels, width, height, ExtendedColorType::L8).expect("true lengths");
        json!(Mask { png })
    });
    prop_oneof![3 => Just(Value::Null), 1 => weights]
}

fn law([width, height]: [u32; 2]) -> impl Strategy<Value = Value> {
    let highest = (width.min(height) - 3).min(40);
    let method = select(Method::ALL.map(|method| json!(method)).to_vec());
    let window = one_of([
        json!("adaptive"),
        json!("adaptive_paper"),
        json!({ "fixed": { "a": 0, "b": 100_000 } }),
        json!({ "fixed": { "a": [8, 0.5], "b": 8 } }),
    ]);
    let krawtchouk = one_of([json!({}), json!({ "p": 0.001 }), json!({ "p": [0.999, 0.5], "lattice": "exact" })]);
    let gain = one_of([
        json!(null),
        json!({ "step_fraction": 1 }),
        json!({ "per_s": 0.001 }),
        json!({ "per_s": 100 }),
        json!({ "adaptive": { "at_zero": 100, "at_infinity": 0.001, "slope_at_zero": 10_000 } }),
    ]);
    let light = one_of([json!("none"), json!("none"), json!({}), json!({ "gain_std": 10, "offset_std": 0 })]);
    let free = prop_oneof![2 => Just([true; 6]), 1 => any::<[bool; 6]>()];
    let small = (
        one_of([json!("none"), json!({}), json!({ "translation_m": 1e-6 })]),
        one_of([json!(null), json!(0.5), json!(512)]),
    );
    (method, window, krawtchouk, 1..=highest, gain, light, free, small).prop_map(
        |(method, window, krawtchouk, order, gain, light, free, (step_cap, gaussian_px))| {
            let free = if free == [false; 6] { [true; 6] } else { free };
            json!({
                "method": method, "window": window, "krawtchouk": krawtchouk, "order": { "min": 1, "max": order },
                "gain": gain, "light": light, "degrees_of_freedom": free, "step_cap": step_cap,
                "gaussian_px": gaussian_px,
            })
        },
    )
}

fn limits() -> impl Strategy<Value = Value> {
    let limits = one_of([
        json!({}),
        json!({}),
        json!({ "linear_m_per_s": 1e-6, "angular_rad_per_s2": 1e-6 }),
        json!({ "linear_m_per_s": 10, "linear_m_per_s2": 1000, "angular_rad_per_s2": 1000 }),
        json!("none"),
    ]);
    let stop = one_of([
        json!({}),
        json!({ "hold_frames": 1, "step_m": 1, "step_rad": 1 }),
        json!({ "step_m": 1e-9, "step_rad": 1e-9, "pixel_mse": 1e-9 }),
        json!({ "max_iterations": 3 }),
    ]);
    let times = one_of([
        json!({}),
        json!({ "frame_period_s": 0.001, "watchdog_ms": 20, "max_age_ms": 1 }),
        json!({ "frame_period_s": 10, "watchdog_ms": 60_000, "max_age_ms": 60_000 }),
    ]);
    (limits, stop, times, any::<bool>()).prop_map(|(limits, stop, times, autostart)| {
        merged(&[json!({ "limits": limits, "stop": stop, "autostart": autostart }), times])
    })
}

fn merged(parts: &[Value]) -> Value {
    let entries = parts.iter().filter_map(Value::as_object).flatten();
    Value::Object(entries.map(|(key, value)| (key.clone(), value.clone())).collect())
}

fn assembled((geometry, law, limits): (Value, Value, Value)) -> TaskSettings {
    let settings = merged(&[geometry, law, limits]);
    let made = TaskSettings::from_json(&settings).or_else(|_| {
        // Light needs more features than the smallest images have.
        TaskSettings::from_json(&merged(&[settings.clone(), json!({ "light": "none" })]))
    });
    let settings = made.unwrap_or_else(|error| panic!("{error}: {settings}"));
    // Where the other settings allow for it.
    settings.merge_patch(&json!({ "depth_scale": "estimate" })).unwrap_or(settings)
}

/// What a plane of samples looks like.
#[derive(Clone, Copy, Debug)]
pub enum Look {
    Noise,
    Slope,
    Flat(f32),
    Spot,
    /// So many of 256 samples are this.
    Broken(f32, u8),
}

pub fn look() -> impl Strategy<Value = Look> {
    let broken = select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1e30, 3e38, 0.0, -0.0, 1e-42, 1.0, -1.0]);
    prop_oneof![
        3 => Just(Look::Noise),
        2 => Just(Look::Slope),
        1 => select(vec![0.0, 1.0, 0.5, f32::MAX, f32::MIN_POSITIVE]).prop_map(Look::Flat),
        2 => Just(Look::Spot),
        2 => (broken, any::<u8>()).prop_map(|(sample, share)| Look::Broken(sample, share)),
    ]
}

/// A frame in words that shrink: what it shows, how far it is, what is wrong with it.
#[derive(Clone, Copy, Debug)]
pub struct FrameLike {
    pub image: Look,
    pub depth: Option<Look>,
    pub seed: u32,
    pub fault: Fault,
    pub capture: Capture,
    pub deadline_us: u32,
}

#[derive(Clone, Copy, Debug)]
pub enum Fault {
    None,
    /// One column more.
    Wider,
    /// Cut off.
    Short,
    /// Of no pixels.
    Empty,
    /// A unit of depth that is none.
    Unit(f32),
}

/// The camera's clock beside the worker's.
#[derive(Clone, Copy, Debug)]
pub enum Capture {
    Unknown,
    /// Taken so long ago.
    Ago(u32),
    Any(u64),
}

pub fn frame() -> impl Strategy<Value = FrameLike> {
    let fault = prop_oneof![
        12 => Just(Fault::None),
        1 => Just(Fault::Wider),
        1 => Just(Fault::Short),
        1 => Just(Fault::Empty),
        1 => select(vec![0.0, -1.0, f32::NAN, f32::MAX, 1e-40]).prop_map(Fault::Unit),
    ];
    let capture = prop_oneof![
        3 => Just(Capture::Unknown),
        5 => (0u32..20).prop_map(Capture::Ago),
        1 => (0u32..10_000).prop_map(Capture::Ago),
        1 => any::<u64>().prop_map(Capture::Any),
    ];
    let deadline = prop_oneof![4 => Just(0u32), 1 => 1u32..200_000];
    (look(), proptest::option::weighted(0.7, look()), any::<u32>(), fault, capture, deadline).prop_map(
        |(image, depth, seed, fault, capture, deadline_us)| FrameLike {
            image,
            depth,
            seed,
            fault,
            capture,
            deadline_us,
        },
    )
}

impl FrameLike {
    /// As bytes, from a camera whose clock is an hour ahead.
    pub fn shot(&self, settings: &TaskSettings, now: Duration, sequence: u64) -> Shot {
        let [mut width, height] = [settings.camera.width, settings.camera.height];
        width += u32::from(matches!(self.fault, Fault::Wider));
        let pixels = (width * height) as usize;
        let mut header = FrameHeader::new(PixelFormat::Mono32F, width, height);
        let mut payload = bytes(self.image, self.seed, pixels, 0.0..1.0);
        if let Some(depth) = self.depth {
            header.depth_format = DepthFormat::F32;
            header.depth_unit_m = if let Fault::Unit(unit) = self.fault { unit } else { 1.0 };
            header.depth_offset = payload.len() as u32;
            payload.extend(bytes(depth, !self.seed, pixels, 0.2..4.0));
        }
        match self.fault {
            Fault::Short => payload.truncate(payload.len() / 2 + 1),
            Fault::Empty => (header.width, header.height) = (0, 0),
            _ => {}
        }
        header.sequence = sequence;
        header.deadline_us = self.deadline_us;
        header.capture_time_ns = match self.capture {
            Capture::Unknown => 0,
            Capture::Ago(ms) => (now + Duration::from_secs(3600) - Duration::from_millis(ms.into())).as_nanos() as u64,
            Capture::Any(ns) => ns,
        };
        Shot { header, payload }
    }
}

fn bytes(look: Look, seed: u32, count: usize, range: Range<f32>) -> Vec<u8> {
    let width = range.end - range.start;
    let random = |index: usize| range.start + width * (noise(seed, index as u32) % 4096) as f32 / 4096.0;
    let sample = |index: usize| match look {
        Look::Noise => random(index),
        Look::Slope => range.start + width * index as f32 / count as f32,
        Look::Flat(level) => level,
        Look::Spot if index.abs_diff(seed as usize % count.max(1)) < count / 5 => range.end,
        Look::Spot => range.start,
        Look::Broken(broken, share) if (noise(seed, !(index as u32)) as u8) < share => broken,
        Look::Broken(..) => random(index),
    };
    (0..count).flat_map(|index| sample(index).to_le_bytes()).collect()
}

/// A number without a pattern.
fn noise(seed: u32, index: u32) -> u32 {
    let mixed = (seed ^ index.wrapping_mul(0x9e37_79b9)).wrapping_mul(0x85eb_ca6b);
    (mixed ^ mixed >> 15).wrapping_mul(0xc2b2_ae35) >> 7
}

/// One thing that happens.
#[derive(Clone, Debug)]
pub enum Event {
    Push {
        frame: FrameLike,
        takes_ms: u16,
    },
    /// The same frame as the last one, to the bit.
    PushAgain,
    Ask {
        frame: FrameLike,
        takes_ms: u16,
    },
    Order(Control),
    Target(FrameLike),
    StopAll,
    ClientLost,
    Patch(Value),
    Wait {
        ms: u16,
    },
    StandStill {
        ms: u16,
        clock_wakes_first: bool,
    },
}

pub fn events(most: usize) -> impl Strategy<Value = Vec<Event>> {
    let control = select(vec![Control::Start, Control::Start, Control::Pause, Control::Resume, Control::Stop]);
    let patch = one_of([
        json!({ "limits": { "linear_m_per_s": 0.001, "angular_rad_per_s": 0.001 } }),
        json!({ "limits": null }),
        json!({ "degrees_of_freedom": [true, false, true, false, true, false] }),
        json!({ "gain": { "per_s": 5 } }),
        json!({ "order": 2 }),
        json!({ "stop": { "max_iterations": 1 } }),
    ]);
    let takes = || prop_oneof![6 => Just(0u16), 1 => 0u16..500];
    let event = prop_oneof![
        20 => (frame(), takes()).prop_map(|(frame, takes_ms)| Event::Push { frame, takes_ms }),
        4 => Just(Event::PushAgain),
        6 => (frame(), takes()).prop_map(|(frame, takes_ms)| Event::Ask { frame, takes_ms }),
        6 => control.prop_map(Event::Order),
        2 => frame().prop_map(Event::Target),
        1 => Just(Event::StopAll),
        1 => Just(Event::ClientLost),
        2 => patch.prop_map(Event::Patch),
        10 => (0u16..150).prop_map(|ms| Event::Wait { ms }),
        1 => (150u16..5000, any::<bool>()).prop_map(|(ms, clock_wakes_first)| Event::StandStill { ms, clock_wakes_first }),
    ];
    vec(event, 1..most)
}
