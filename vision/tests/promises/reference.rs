//! The same promises against a folder of reference values from elsewhere, if the environment variable `DOMVS_GOLDEN` names one, and
//! against a real image pair with its depth, if `DOMVS_REAL_PAIR` does. Neither belongs to the project: unset, the tests say so and pass.

use std::path::PathBuf;

use domvs_vision::family::hahn::{Hahn, Rule, hahn_window, hahn_window_unrounded};
use domvs_vision::family::krawtchouk::{Krawtchouk, krawtchouk_p};
use domvs_vision::family::{Polynomial, Tchebichef};
use domvs_vision::window::Brightness;
use domvs_vision::{
    Depth, DepthMap, Gain, Gaussian, GaussianForm, HoleFill, Intrinsics, Lattice, Law, Method, OrderRule, Plane, Servo,
    Step, View, Window, WindowInUse,
};
use serde_json::Value;

use super::golden::{numbers, polynomial_difference, whole};
use super::scenes::relative_difference;

fn folder(variable: &str) -> Option<PathBuf> {
    let folder = std::env::var_os(variable).map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: {variable} is not set");
    }
    folder
}

fn golden(file: &str) -> Option<Value> {
    let path = folder("DOMVS_GOLDEN")?.join(file);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    Some(serde_json::from_str(&text).unwrap())
}

#[test]
fn reference_polynomials_are_met_to_1e_12() {
    let Some(golden) = golden("polynomials.json") else { return };
    let mut worst: f64 = 0.0;
    for case in golden["cases"].as_array().unwrap() {
        let number = |name: &str| case[name].as_f64().unwrap();
        let polynomial = match case["family"].as_str().unwrap() {
            "tchebichef" => Polynomial::Tchebichef(Tchebichef),
            "hahn" => Polynomial::Hahn(Hahn { a: number("a"), b: number("b") }),
            "krawtchouk_paper" => Polynomial::Krawtchouk(Krawtchouk { p: number("p"), lattice: Lattice::Paper }),
            _ => Polynomial::Krawtchouk(Krawtchouk { p: number("p"), lattice: Lattice::Exact }),
        };
        worst = worst.max(polynomial_difference(polynomial, whole(&case["N"]), case));
    }
    println!("polynomials: largest difference {worst:e}");
    assert!(worst < 1e-12);
}

/// `0.6 exp(…) + 0.15 (1 + sin(…)) + ht ((7u + 13v + 3uv) mod 32)/31`, as the files' `image` says.
fn image(case: &Value, name: &str) -> Plane<f64> {
    let [cu, cv, su, sv, ku, kv, ph, ht]: [f64; 8] = numbers(&case[name]).try_into().unwrap();
    Plane::from_fn(whole(&case["N"]), whole(&case["M"]), |u, v| {
        let (x, y) = (u as f64, v as f64);
        let bell = 0.6 * (-(x - cu).powi(2) / (2.0 * su * su) - (y - cv).powi(2) / (2.0 * sv * sv)).exp();
        let steps = ((7 * u + 13 * v + 3 * u * v) % 32) as f64 / 31.0;
        bell + 0.15 * (1.0 + (ku * x + kv * y + ph).sin()) + ht * steps
    })
}

#[test]
fn reference_parameters_are_met_exactly() {
    let Some(golden) = golden("parameters.json") else { return };
    for case in golden["cases"].as_array().unwrap() {
        let (current, desired) = (image(case, "current"), image(case, "desired"));
        let pair = [&current, &desired].map(Brightness::of);
        let close = |got: &[f64], name: &str| {
            let difference = relative_difference(got, &numbers(&case[name]));
            assert!(difference < 1e-12, "{name}: {difference:e}");
        };
        close(&pair[0].centroid_px().unwrap(), "centroid_current");
        close(&pair[1].centroid_px().unwrap(), "centroid_desired");
        close(&krawtchouk_p(Lattice::Paper, &pair[0], &pair[1]).unwrap(), "km_p_paper");
        close(&krawtchouk_p(Lattice::Exact, &pair[0], &pair[1]).unwrap(), "km_p_exact");
        for (rule, name) in [(Rule::Logs, "hm_abab_cpp"), (Rule::Paper, "hm_abab_paper")] {
            close(&hahn_window_unrounded(rule, &pair[0], &pair[1]).unwrap().concat(), &format!("{name}_unrounded"));
            assert_eq!(hahn_window(rule, &pair[0], &pair[1]).unwrap().concat(), numbers(&case[name]));
        }
    }
    for case in golden["order"].as_array().unwrap() {
        let number = |name: &str| case[name].as_f64().unwrap();
        let rule = OrderRule::new(whole(&case["lmin"]), whole(&case["lmax"]), number("eps")).unwrap();
        assert!((rule.unrounded(number("e"), number("e0")) - number("real")).abs() < 1e-12);
        assert_eq!(rule.order(number("e"), number("e0")), whole(&case["order"]));
    }
}

/// `z0 + zu u/N + zv v/M + zs sin(0.05 u + 0.03 v)`, or a number.
fn depth(case: &Value, name: &str) -> Depth<f64> {
    if let Some(depth_m) = case[name].as_f64() {
        return Depth::Constant { depth_m };
    }
    let [z0, zu, zv, zs]: [f64; 4] = numbers(&case[name]).try_into().unwrap();
    let (width, height) = (whole(&case["N"]), whole(&case["M"]));
    let metres = Plane::from_fn(width, height, |u, v| {
        let (x, y) = (u as f64, v as f64);
        z0 + zu * x / width as f64 + zv * y / height as f64 + zs * (0.05 * x + 0.03 * y).sin()
    });
    Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).unwrap())
}

fn law_of(case: &Value, result: &Value) -> Option<Law> {
    let method = match result["method"].as_str().unwrap() {
        "TM" => Method::Tchebichef,
        "KM" => Method::Krawtchouk,
        "HM" => Method::Hahn,
        "DCT" => Method::Cosine,
        "DVS" => Method::Photometric,
        "PGM" => Method::GaussianMixture,
        _ => return None,
    };
    let gaussian = |extent_px| Gaussian { extent_px, form: GaussianForm::Exact };
    Some(Law {
        method,
        gaussian: result["lambda_g"].as_f64().map_or(Gaussian::default(), gaussian),
        window: Window::Adaptive,
        lattice: if result["lattice"].as_str() == Some("exact") { Lattice::Exact } else { Lattice::Paper },
        order: result["l"].as_u64().map_or(OrderRule::default(), |l| OrderRule::fixed(l as usize).unwrap()),
        gain: Gain::PerSecond(case["gain"].as_f64().unwrap()),
        step_cap: None,
        ..Law::default()
    })
}

fn parameters(step: &Step) -> Vec<f64> {
    match step.window {
        WindowInUse::Whole => vec![],
        WindowInUse::Hahn { x, y } => [x, y].concat(),
        WindowInUse::Krawtchouk { p } => p.to_vec(),
    }
}

#[test]
fn reference_twists_are_met_to_1e_8() {
    let Some(golden) = golden("twists.json") else { return };
    let (mut compared, mut worst) = (0, 0.0f64);
    for case in golden["cases"].as_array().unwrap() {
        let [fu, fv, cu, cv]: [f64; 4] = numbers(&case["K_fx_fy_cx_cy"]).try_into().unwrap();
        let camera = Intrinsics::new([fu, fv], [cu, cv]).unwrap();
        let (current, desired) = (image(case, "current"), image(case, "desired"));
        let (own_depth, desired_depth) = (depth(case, "Z"), depth(case, "Z_star"));
        for result in case["results"].as_array().unwrap() {
            let Some(law) = law_of(case, result) else { continue };
            let mut servo = Servo::new(law, camera, View { image: &desired, depth: &desired_depth }).unwrap();
            let step = servo.step(View { image: &current, depth: &own_depth }).unwrap();
            if let Some(expected) = result.get("params").map(numbers) {
                assert!(relative_difference(&parameters(&step), &expected) < 1e-13);
            }
            if law.method.is_on_moments() {
                let column = |k: usize| servo.features().map(|f| f.interaction[k].powi(2)).sum();
                let diagonal: Vec<f64> = (0..6).map(column).collect();
                assert!(relative_difference(&diagonal, &numbers(&result["LtL_diag"])) < 1e-11);
            }
            assert!((step.feature_error_squared / result["ee"].as_f64().unwrap() - 1.0).abs() < 1e-11);
            assert!(
                (step.condition_number / result["cond_L"].as_f64().unwrap() - 1.0).abs() < 1e-3,
                "four printed digits"
            );
            if let Some(errors) = result.get("e").map(numbers) {
                let own: Vec<f64> = servo.features().map(|feature| feature.error).collect();
                assert!(relative_difference(&own, &errors) < 1e-12);
            }
            for (feature, row) in servo.features().zip(result.get("L").and_then(Value::as_array).into_iter().flatten())
            {
                assert!(relative_difference(&feature.interaction, &numbers(row)) < 1e-11);
            }
            let difference = relative_difference(&step.twist.to_array(), &numbers(&result["v"]));
            assert!(difference < 1e-8, "{} l = {}: {difference:e}", result["method"], result["l"]);
            (compared, worst) = (compared + 1, worst.max(difference));
        }
    }
    println!("twists: {compared} compared, largest relative difference {worst:e}");
    assert!(compared > 40);
}

/// A PGM (P5) plane, 8 or 16 bit, times `unit`: `image.pgm` files can be made from PNG by any converter.
fn pgm(path: PathBuf, unit: f64) -> Plane<f64> {
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut at = 0;
    let mut word = || {
        let start = at + bytes[at..].iter().position(|b| !b.is_ascii_whitespace()).unwrap();
        at = start + bytes[start..].iter().position(|b| b.is_ascii_whitespace()).unwrap();
        String::from_utf8(bytes[start..at].to_vec()).unwrap()
    };
    assert_eq!(word(), "P5");
    let [width, height, most]: [usize; 3] = std::array::from_fn(|_| word().parse().unwrap());
    let pixels = &bytes[at + 1..];
    let value = |i: usize| match most {
        255 => f64::from(pixels[i]),
        _ => f64::from(u16::from_be_bytes([pixels[2 * i], pixels[2 * i + 1]])),
    };
    Plane::from_fn(width, height, |u, v| unit * value(v * width + u))
}

#[test]
fn the_real_pair_gives_the_logged_row() {
    let Some(folder) = folder("DOMVS_REAL_PAIR") else { return };
    let [current, desired] = ["initial", "desired"].map(|name| {
        let metres = pgm(folder.join(format!("{name}_depth_mm.pgm")), 1e-3);
        let map = DepthMap::from_metres(&metres, HoleFill::Median).unwrap();
        println!("{name}: {} pixels without depth", map.unknown());
        (pgm(folder.join(format!("{name}.pgm")), 1.0 / 255.0), Depth::Map(map))
    });
    let law = Law {
        window: Window::Adaptive,
        order: OrderRule::new(6, 16, 1e-3).unwrap(),
        gain: Gain::PerSecond(0.03),
        step_cap: None,
        ..Law::default()
    };
    let camera = Intrinsics::new([605.689, 606.215], [324.855, 236.483]).unwrap();
    let mut servo = Servo::new(law, camera, View { image: &desired.0, depth: &desired.1 }).unwrap();
    let step = servo.step(View { image: &current.0, depth: &current.1 }).unwrap();
    let mean_error = step.feature_error_squared / step.features as f64;
    println!("{step:#?}\ne·e/n {mean_error}");

    assert_eq!(
        (format!("{:.7}", step.pixel_mse).as_str(), format!("{mean_error:.3}").as_str()),
        ("0.0609571", "252.757")
    );
    assert_eq!((step.order, parameters(&step)), (6, vec![6.0, 6.0, 4.0, 5.0]));
    let logged = [-0.00234573, -0.00198887, 0.00240528, -0.00369989, -0.000561695, 0.001116];
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let apart: Vec<f64> = step.twist.to_array().iter().zip(logged).map(|(a, b)| a - b).collect();
    println!("twist: {:.2} % from the logged one", 100.0 * norm(&apart) / norm(&logged));
    assert!(norm(&apart) / norm(&logged) < 0.03, "the depth maps were not taken at the same moment");
}
