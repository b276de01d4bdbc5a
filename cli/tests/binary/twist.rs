//! `domvs twist` as its users meet it: the built binary on files that each test writes, against direct calls of the law.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use domvs_vision::{
    Depth, DepthMap, Gain, Gaussian, GaussianForm, HoleFill, Holes, Intrinsics, Law, LightPrior, Method, NoiseFloor,
    OrderRule, Plane, Servo, Step, View, Window, WindowInUse,
};
use serde_json::Value;
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype::Gray32Float};

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const CAMERA: &str = "6e1,61.5,31.5,23.5";

struct Files {
    folder: TempDir,
}

impl Files {
    fn new() -> Files {
        let files = Files { folder: tempfile::tempdir().expect("a temporary folder") };
        files.tiff("desired.tiff", &desired());
        files.tiff("current.tiff", &current());
        files
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn tiff(&self, name: &str, plane: &Plane<f64>) {
        let samples: Vec<f32> = plane.samples().iter().map(|&value| value as f32).collect();
        let file = std::fs::File::create(self.path(name)).expect("a file");
        let mut encoder = TiffEncoder::new(file).expect("an encoder");
        let (width, height) = (plane.width() as u32, plane.height() as u32);
        encoder.write_image::<Gray32Float>(width, height, &samples).expect("a TIFF");
    }

    fn depth_png(&self, name: &str, counts: impl Fn(usize, usize) -> u16) {
        let count = |u, v| image::Luma([counts(u as usize, v as usize)]);
        let image = image::ImageBuffer::from_fn(WIDTH as u32, HEIGHT as u32, count);
        image.save(self.path(name)).expect("a PNG");
    }

    /// `domvs twist` on desired.tiff and current.tiff, with more options.
    fn twist(&self, options: &[&str]) -> Output {
        self.run(&[&["--desired", "desired.tiff", "--current", "current.tiff", "--camera", CAMERA], options].concat())
    }

    fn run(&self, options: &[&str]) -> Output {
        domvs(self.folder.path(), &[&["twist"], options].concat())
    }

    fn json(&self, options: &[&str]) -> Value {
        answer(&self.twist(&[options, &["--json"]].concat()))
    }
}

fn domvs(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_domvs"));
    command.args(arguments).current_dir(folder).env_remove("NO_COLOR").env_remove("RUST_LOG");
    command.output().expect("the binary runs")
}

fn answer(output: &Output) -> Value {
    assert!(output.status.success(), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// An error of the command: exit code 1, nothing on standard output, and every one of `words` on standard error.
fn assert_fails(output: &Output, words: &[&str]) {
    let text = stderr(output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(output.stdout.is_empty());
    for word in words {
        assert!(text.contains(word), "'{word}' is not in: {text}");
    }
}

/// Two bumps, rounded to `f32` as the file keeps them.
fn bumps(cu: f64, cv: f64) -> Plane<f64> {
    Plane::from_fn(WIDTH, HEIGHT, |u, v| {
        let bump = |u0: f64, v0: f64, size: f64| {
            (-((u as f64 - u0).powi(2) + (v as f64 - v0).powi(2)) / (2.0 * size * size)).exp()
        };
        let value = 0.7 * bump(cu, cv, 6.0) + 0.25 * bump(cu - 9.0, cv + 5.0, 4.0);
        f64::from(value as f32)
    })
}

fn desired() -> Plane<f64> {
    bumps(33.0, 22.0)
}

fn current() -> Plane<f64> {
    bumps(30.0, 25.0)
}

fn law(method: Method) -> Law {
    Law {
        method,
        window: Window::Fixed { x: [8.0, 8.0], y: [8.0, 8.0] },
        order: OrderRule::new(4, 16, 1e-3).expect("an order rule"),
        gain: Gain::PerSecond(1.0),
        step_cap: None,
        ..Law::default()
    }
}

fn direct(law: Law, depths: [&Depth<f64>; 2]) -> Step {
    let camera = Intrinsics::new([60.0, 61.5], [31.5, 23.5]).expect("a camera");
    let (desired, current) = (desired(), current());
    let mut servo = Servo::new(law, camera, View { image: &desired, depth: depths[0] }).expect("a servo");
    servo.step(View { image: &current, depth: depths[1] }).expect("a step")
}

fn assert_is(json: &Value, step: &Step) {
    let twist = json["twist"].as_array().expect("six numbers");
    assert_eq!(twist.len(), 6);
    for (got, expected) in twist.iter().zip(step.twist.to_array()) {
        assert_number(got, expected);
    }
    assert_eq!(json["order"], step.order);
    assert_eq!(json["features"], step.features);
    assert_number(&json["pixel_mse"], step.pixel_mse);
    assert_number(&json["feature_error_squared"], step.feature_error_squared);
    assert_number(&json["condition_number"], step.condition_number);
    assert_eq!(json["status"], "servoing");
}

fn assert_number(got: &Value, expected: f64) {
    assert_eq!(got.as_f64(), Some(expected), "a printed number is read back to the last bit");
}

const ONE_METRE: Depth<f64> = Depth::Constant { depth_m: 1.0 };

#[test]
fn the_answer_is_what_a_direct_call_of_the_law_gives() {
    let json = Files::new().json(&[]);
    assert_is(&json, &direct(law(Method::Hahn), [&ONE_METRE; 2]));
    assert_eq!(json["window"], serde_json::json!([8.0, 8.0, 8.0, 8.0]));
    let mut keys: Vec<&str> = json.as_object().expect("an object").keys().map(String::as_str).collect();
    keys.sort_unstable();
    let promised =
        ["condition_number", "feature_error_squared", "features", "order", "pixel_mse", "status", "twist", "window"];
    assert_eq!(keys, promised);
}

#[test]
fn every_option_reaches_the_law() {
    let options = ["--order", "5..9", "--epsilon", "2e-3", "--gain", "3e-2", "--window", "6,6,4,5"];
    let json = Files::new().json(&[&options[..], &["--desired-depth", "0.8", "--current-depth", "9e-1"]].concat());
    let law = Law {
        order: OrderRule::new(5, 9, 2e-3).expect("an order rule"),
        gain: Gain::PerSecond(0.03),
        window: Window::Fixed { x: [6.0, 6.0], y: [4.0, 5.0] },
        ..law(Method::Hahn)
    };
    let depths = [0.8, 0.9].map(|depth_m| Depth::Constant { depth_m });
    assert_is(&json, &direct(law, [&depths[0], &depths[1]]));
    assert_eq!(json["window"], serde_json::json!([6.0, 6.0, 4.0, 5.0]));
}

#[test]
fn a_depth_given_for_one_view_stands_in_for_the_other() {
    let files = Files::new();
    let both = files.json(&["--desired-depth", "0.5", "--current-depth", "0.5"]);
    assert_eq!(files.json(&["--desired-depth", "0.5"]), both);
    assert_eq!(files.json(&["--current-depth", "0.5"]), both);
    assert_ne!(files.json(&[]), both);
}

#[test]
fn krawtchouk_reports_its_centre_and_methods_without_a_window_ignore_it() {
    let files = Files::new();
    let step = direct(law(Method::Krawtchouk), [&ONE_METRE; 2]);
    let json = files.json(&["--method", "krawtchouk", "--window", "2,2"]);
    assert_is(&json, &step);
    let WindowInUse::Krawtchouk { p } = step.window else { panic!("a krawtchouk window") };
    assert_number(&json["window"][0], p[0]);
    assert_number(&json["window"][1], p[1]);
    let exact = files.json(&["--method", "krawtchouk", "--lattice", "exact"]);
    assert_ne!(exact["window"], json["window"], "N points instead of N + 1");

    for (word, method) in [("tchebichef", Method::Tchebichef), ("cosine", Method::Cosine)] {
        let json = files.json(&["--method", word, "--window", "2,2"]);
        assert_is(&json, &direct(law(method), [&ONE_METRE; 2]));
        assert!(json["window"].is_null());
    }
}

#[test]
fn methods_on_pixels_have_order_0_and_the_gaussian_mixture_its_exact_form() {
    let files = Files::new();
    let json = files.json(&["--method", "photometric"]);
    assert_is(&json, &direct(law(Method::Photometric), [&ONE_METRE; 2]));
    assert_eq!((&json["order"], &json["features"]), (&Value::from(0), &Value::from(WIDTH * HEIGHT)));
    for (options, extent_px) in [(&["--gaussian-px", "5.5"][..], 5.5), (&[], WIDTH as f64 / 8.0)] {
        let json = files.json(&[&["--method", "gaussian_mixture"], options].concat());
        let gaussian = Gaussian { extent_px, form: GaussianForm::Exact };
        assert_is(&json, &direct(Law { gaussian, ..law(Method::GaussianMixture) }, [&ONE_METRE; 2]));
        assert!(json["window"].is_null());
    }
}

#[test]
fn options_of_the_law_reach_it_and_light_is_told() {
    let files = Files::new();
    let json = files.json(&["--light", "--noise-floor", "--order", "6"]);
    let law = Law {
        light: Some(LightPrior::default()),
        noise_floor: NoiseFloor::Subtracted,
        order: OrderRule::new(6, 6, 1e-3).expect("an order rule"),
        ..law(Method::Hahn)
    };
    let step = direct(law, [&ONE_METRE; 2]);
    assert_is(&json, &step);
    for (got, expected) in json["light"].as_array().expect("six").iter().zip(step.light.expect("estimated")) {
        assert_number(got, expected);
    }
}

#[test]
fn a_mask_and_ignored_holes_leave_pixels_out() {
    let files = Files::new();
    let white = |u: u32| if u < 16 { 0u8 } else { 255 };
    let mask = image::GrayImage::from_fn(WIDTH as u32, HEIGHT as u32, |u, _| image::Luma([white(u)]));
    mask.save(files.path("mask.png")).expect("a PNG");
    let covered = Plane::from_fn(WIDTH, HEIGHT, |u, v| if u < 16 { 0.5 } else { current().at(u, v) });
    files.tiff("covered.tiff", &covered);
    let masked = |image: &str| {
        let names = ["--desired", "desired.tiff", "--current", image, "--camera", CAMERA];
        answer(&files.run(&[&names[..], &["--mask", "mask.png", "--json"]].concat()))
    };
    assert_eq!(masked("current.tiff"), masked("covered.tiff"));
    assert_ne!(masked("current.tiff"), files.json(&[]));

    files.depth_png("depth.png", |u, _| if u < 20 { 0 } else { 900 });
    let metres = Plane::from_fn(WIDTH, HEIGHT, |u, _| if u < 20 { 0.0 } else { 900.0 * 0.001 });
    let depth = Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).expect("a depth map"));
    let ignored = files.json(&["--desired-depth", "depth.png", "--ignore-holes"]);
    assert_is(&ignored, &direct(Law { holes: Holes::Ignored, ..law(Method::Hahn) }, [&depth; 2]));

    files.tiff("small.tiff", &Plane::filled(WIDTH - 1, HEIGHT, 0.5));
    assert_fails(&files.twist(&["--mask", "small.tiff"]), &["small.tiff", "63x48", "64x48"]);
    files.tiff("black.tiff", &Plane::filled(WIDTH, HEIGHT, 0.0));
    assert_fails(&files.twist(&["--mask", "black.tiff"]), &["black.tiff", "0.01"]);
}

#[test]
fn a_sixteen_bit_depth_map_is_counted_in_its_unit_and_its_holes_get_the_median() {
    let files = Files::new();
    let counts = |u: usize, v: usize| {
        if (u + v).is_multiple_of(7) { 0 } else { 3000 + 10 * u as u16 + v as u16 }
    };
    files.depth_png("depth.png", counts);
    let json = files.json(&["--desired-depth", "depth.png", "--depth-unit", "2.5e-4"]);
    let metres = Plane::from_fn(WIDTH, HEIGHT, |u, v| f64::from(counts(u, v)) * 2.5e-4);
    let depth = Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).expect("a depth map"));
    assert_is(&json, &direct(law(Method::Hahn), [&depth; 2]));
}

#[test]
fn a_float_tiff_depth_map_is_in_metres() {
    let files = Files::new();
    let metres = Plane::from_fn(WIDTH, HEIGHT, |u, _| f64::from(0.5 + u as f32 * 0.01));
    files.tiff("depth.tiff", &metres);
    let json = files.json(&["--desired-depth", "depth.tiff", "--current-depth", "1.2"]);
    let map = Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).expect("a depth map"));
    assert_is(&json, &direct(law(Method::Hahn), [&map, &Depth::Constant { depth_m: 1.2 }]));
}

#[test]
fn invert_means_one_minus_the_image() {
    let files = Files::new();
    let inverted = |plane: Plane<f64>| Plane::from_fn(WIDTH, HEIGHT, |u, v| 1.0 - plane.at(u, v));
    files.tiff("dark-desired.tiff", &inverted(desired()));
    files.tiff("dark-current.tiff", &inverted(current()));
    let names = ["--desired", "dark-desired.tiff", "--current", "dark-current.tiff", "--camera", CAMERA];
    let json = answer(&files.run(&[&names[..], &["--window", "adaptive", "--invert", "--json"]].concat()));
    let bright = files.json(&["--window", "adaptive"]);
    assert_eq!(json["window"], bright["window"]);
    for axis in 0..6 {
        let number = |value: &Value| value["twist"][axis].as_f64().expect("a number");
        // 1 - I is rounded to f32 in the file: 6e-8 per pixel, magnified by the condition number.
        assert!((number(&json) - number(&bright)).abs() < 1e-4, "axis {axis}");
    }
}

#[test]
fn the_initial_image_decides_how_far_along_the_order_is() {
    let files = Files::new();
    files.tiff("initial.tiff", &bumps(20.0, 33.0));
    let first = files.json(&[]);
    let later = files.json(&["--initial", "initial.tiff"]);
    assert!(later["order"].as_u64() > first["order"].as_u64(), "{first} {later}");
}

#[test]
fn black_images_give_a_zero_twist_and_say_rank_deficient() {
    let files = Files::new();
    files.tiff("black.tiff", &Plane::filled(WIDTH, HEIGHT, 0.0));
    let black = ["--desired", "black.tiff", "--current", "black.tiff", "--camera", CAMERA, "--json"];
    let json = answer(&files.run(&black));
    assert_eq!(json["status"], "rank_deficient");
    assert_eq!(json["twist"], serde_json::json!([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn errors_name_the_file_and_the_numbers_and_exit_with_one() {
    let files = Files::new();
    let missing = files.run(&["--desired", "nowhere.png", "--current", "current.tiff", "--camera", CAMERA]);
    assert_fails(&missing, &["nowhere.png"]);

    files.tiff("small.tiff", &Plane::filled(WIDTH - 1, HEIGHT, 0.5));
    let sizes = files.run(&["--desired", "desired.tiff", "--current", "small.tiff", "--camera", CAMERA]);
    assert_fails(&sizes, &["desired.tiff", "64x48", "small.tiff", "63x48"]);

    files.depth_png("holes.png", |u, _| if u < WIDTH / 2 + 1 { 0 } else { 900 });
    let holes = files.twist(&["--desired-depth", "holes.png"]);
    assert_fails(&holes, &["holes.png", &(33 * HEIGHT).to_string(), &(WIDTH * HEIGHT).to_string(), "more than half"]);

    assert_fails(&files.twist(&["--desired-depth", "small.tiff"]), &["small.tiff", "63x48", "64x48"]);
    assert_fails(&files.twist(&["--order", "4..41"]), &["41", "40"]);
    files.tiff("tiny.tiff", &Plane::filled(30, 24, 0.5));
    let tiny = ["--desired", "tiny.tiff", "--current", "tiny.tiff", "--camera", CAMERA];
    let order = files.run(&[&tiny[..], &["--order", "22"]].concat());
    assert_fails(&order, &["tiny.tiff", "22", "21"]);
}

#[test]
fn a_wrong_command_line_exits_with_two_and_says_what_was_expected() {
    let files = Files::new();
    assert_eq!(files.twist(&["--gain", "-1"]).status.code(), Some(2));
    for (option, value, word) in [
        ("--order", "16..4", "smallest"),
        ("--order", "-4", "MIN..MAX"),
        ("--window", "8", "ax,bx,ay,by"),
        ("--camera", "-1,60,30,20", "positive"),
        ("--desired-depth", "-0.5", "positive"),
        ("--depth-unit", "-1e-3", "above 0"),
        ("--epsilon", "nan", "above 0"),
        ("--method", "photographic", "gaussian_mixture"),
        ("--gaussian-px", "-3", "above 0"),
    ] {
        let options = ["--desired", "desired.tiff", "--current", "current.tiff", option, value];
        let output = if option == "--camera" { files.run(&options) } else { files.twist(&[option, value]) };
        assert_eq!(output.status.code(), Some(2), "{option} {value}: {}", stderr(&output));
        assert!(stderr(&output).contains(word), "{option} {value}: {}", stderr(&output));
    }
}

#[test]
fn the_table_is_plain_in_a_pipe_and_coloured_on_demand() {
    let files = Files::new();
    let text = |options: &[&str]| String::from_utf8(files.twist(options).stdout).expect("text");
    let plain = text(&[]);
    assert!(!plain.contains('\x1b'), "{plain}");
    for word in ["linear", "rad/s", "servoing", "hahn", "desired.tiff", "64x48", "1 m everywhere"] {
        assert!(plain.contains(word), "'{word}' is not in:\n{plain}");
    }
    assert!(text(&["--color", "always"]).contains('\x1b'));
}

#[test]
fn help_explains_the_exit_codes_and_lists_the_command() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let output = domvs(folder.path(), &["--help"]);
    assert_eq!(output.status.code(), Some(0));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("Exit codes") && text.contains("twist"), "{text}");
}
