//! How long one step takes: `cargo run --release -p domvs-vision --example step_time`.
//!
//! Median over 41 steps (fewer where one takes long) of a 640x480 pair with the default window, one thread, for each method, order or extent,
//! and kind of depth, and for each option; the first step, which also makes the desired view's half of the moments, stands apart. Numbers depend on the
//! machine: no test asserts them. Words choose the lines that hold them all: `-- f32 photometric`.

use std::time::Instant;

use domvs_vision::{
    Depth, DepthMap, DepthScale, Gaussian, GaussianForm, HoleFill, Intrinsics, Law, LightPrior, Method, NoiseFloor,
    OrderRule, Plane, Sample, Servo, View,
};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// No line takes much longer than this.
const PATIENCE_S: f64 = 2.0;

fn image<T: Sample>(shift: f64) -> Plane<T> {
    Plane::from_fn(WIDTH, HEIGHT, |u, v| {
        let (x, y) = (u as f64 - 300.0 - shift, v as f64 - 250.0 + 0.5 * shift);
        let bell = (-(x * x + 1.4 * y * y) / 2e4).exp();
        T::from_f64(0.7 * bell + 0.1 * (0.07 * x).sin() * (0.05 * y).cos() + 0.15)
    })
}

fn depth_map<T: Sample>(tilt: f64) -> Depth<T> {
    let metres = Plane::from_fn(WIDTH, HEIGHT, |u, _| T::from_f64(0.8 + tilt * u as f64));
    Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).expect("positive depths"))
}

/// `[median, first]` step in milliseconds.
fn step_ms<T: Sample>(law: Law, depths: [&Depth<T>; 2], mask: Option<&Plane<T>>) -> [f64; 2] {
    let (current, desired) = (image::<T>(12.0), image::<T>(0.0));
    let camera = Intrinsics::new([605.7, 606.2], [324.9, 236.5]).expect("a real camera");
    let mut servo = Servo::new(law, camera, View { image: &desired, depth: depths[1] }).expect("a valid law");
    servo.set_mask(mask).expect("weights enough");
    let begin = Instant::now();
    let mut times: Vec<f64> = (0..42)
        .take_while(|i| *i < 2 || begin.elapsed().as_secs_f64() < PATIENCE_S)
        .map(|_| {
            let start = Instant::now();
            let step = servo.step(View { image: &current, depth: depths[0] });
            std::hint::black_box(step.expect("a good pair"));
            servo.moved([0.001; 6]);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    let first = times.remove(0);
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], first]
}

/// Every law that is timed, and what its line calls it.
fn laws() -> Vec<(String, Law)> {
    let mut laws = Vec::new();
    for method in Method::ALL.iter().copied().filter(|method| method.is_on_moments()) {
        for order in [8, 16] {
            let law = Law { method, order: OrderRule::fixed(order).expect("in range"), ..Law::default() };
            laws.push((format!("{}, order {order}", method.word()), law));
        }
    }
    laws.push(("photometric".to_owned(), Law { method: Method::Photometric, ..Law::default() }));
    for (form, name) in [(GaussianForm::Fast, "fast"), (GaussianForm::Exact, "exact")] {
        for extent_px in [4.0, 10.0, 20.0, 40.0, 80.0, 160.0] {
            let gaussian = Gaussian { extent_px, form };
            let law = Law { method: Method::GaussianMixture, gaussian, ..Law::default() };
            laws.push((format!("gaussian mixture, {name}, {extent_px} px"), law));
        }
    }
    laws
}

/// The default law at order 16 with each option.
fn options() -> Vec<(String, Law)> {
    let law = Law { order: OrderRule::fixed(16).expect("in range"), ..Law::default() };
    let options = [
        ("light", Law { light: Some(LightPrior::default()), ..law }),
        ("noise floor", Law { noise_floor: NoiseFloor::Subtracted, ..law }),
        ("depth scale", Law { depth_scale: DepthScale::Estimated, ..law }),
        (MASK, law),
    ];
    options.map(|(option, law)| (format!("hahn, order 16, {option}"), law)).to_vec()
}

/// The option that no law has.
const MASK: &str = "mask";

fn report<T: Sample>(sample: &str, words: &[String]) {
    let constants = [Depth::Constant { depth_m: 1.0 }, Depth::Constant { depth_m: 1.1 }];
    let maps = [depth_map::<T>(2e-4), depth_map::<T>(1e-4)];
    let mask = Plane::from_fn(WIDTH, HEIGHT, |u, _| T::from_f64(if u < 40 { 0.0 } else { 1.0 }));
    for (name, law) in laws().into_iter().chain(options()) {
        for (kind, depths) in [("constant", &constants), ("map", &maps)] {
            let line = format!("{sample}  {name:<32}  {kind:<8}");
            let is_possible = law.depth_scale == DepthScale::Given || kind == "constant";
            if is_possible && words.iter().all(|word| line.contains(word)) {
                let mask = name.ends_with(MASK).then_some(&mask);
                let [median, first] = step_ms::<T>(law, [&depths[0], &depths[1]], mask);
                println!("{line}  {median:8.2} ms  (first {first:.2} ms)");
            }
        }
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    println!("one step, {WIDTH}x{HEIGHT}, one thread");
    report::<f32>("f32", &words);
    report::<f64>("f64", &words);
}
