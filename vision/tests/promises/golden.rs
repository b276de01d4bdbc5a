//! Values made at 60 to 200 digits by `tests/data/make_golden.py`, from the definitions: polynomials, windows, orders, whole steps.

use domvs_vision::basis::Basis;
use domvs_vision::family::hahn::{Hahn, Rule, hahn_window, hahn_window_unrounded};
use domvs_vision::family::krawtchouk::{Krawtchouk, krawtchouk_p};
use domvs_vision::family::{Cosine, Polynomial, Tchebichef};
use domvs_vision::window::Brightness;
use domvs_vision::{
    Depth, DepthMap, Gain, HoleFill, Intrinsics, Lattice, Law, Method, OrderRule, Plane, Servo, View, Window,
};
use serde_json::Value;

use super::scenes::relative_difference;

fn golden() -> Value {
    serde_json::from_str(include_str!("../data/golden.json")).unwrap()
}

pub fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

pub fn whole(value: &Value) -> usize {
    value.as_u64().unwrap() as usize
}

fn polynomial(case: &Value) -> Polynomial {
    let number = |name: &str| case[name].as_f64().unwrap();
    match (case["kind"].as_str().unwrap(), case["lattice"].as_str()) {
        ("hahn", _) => Polynomial::Hahn(Hahn { a: number("a"), b: number("b") }),
        ("krawtchouk", Some("paper")) => Polynomial::Krawtchouk(Krawtchouk { p: number("p"), lattice: Lattice::Paper }),
        ("krawtchouk", _) => Polynomial::Krawtchouk(Krawtchouk { p: number("p"), lattice: Lattice::Exact }),
        ("tchebichef", _) => Polynomial::Tchebichef(Tchebichef),
        (kind, _) => {
            assert_eq!(kind, "cosine");
            Polynomial::Cosine(Cosine)
        }
    }
}

/// Largest absolute difference of a basis from `values[i][j] = p_n[i](u[j])`.
pub fn polynomial_difference(polynomial: Polynomial, length: usize, case: &Value) -> f64 {
    let degrees = numbers(&case["n"]);
    let rows = degrees.iter().fold(0.0, |most: f64, n| most.max(*n)) as usize + 1;
    let basis = Basis::new(length, rows, polynomial).unwrap();
    let mut worst: f64 = 0.0;
    for (n, values) in degrees.iter().zip(case["values"].as_array().unwrap()) {
        for (u, value) in numbers(&case["u"]).iter().zip(numbers(values)) {
            worst = worst.max((basis.row(*n as usize)[*u as usize] - value).abs());
        }
    }
    worst
}

#[test]
fn polynomials_equal_their_closed_forms_at_200_digits() {
    for case in golden()["polynomials"].as_array().unwrap() {
        let difference = polynomial_difference(polynomial(case), whole(&case["length"]), case);
        // Unit rows; re-orthogonalised Stieltjes loses a few hundred roundings of 1e-16 at most.
        assert!(difference < 1e-12, "{difference:e} for {case}");
    }
}

/// `I(u, v) = h / (1 + ((u - cu)/ru)² + ((v - cv)/rv)²) + k cos²(wu u + wv v)`.
fn image([width, height]: [usize; 2], parameters: &Value) -> Plane<f64> {
    let [h, cu, cv, ru, rv, k, wu, wv]: [f64; 8] = numbers(parameters).try_into().unwrap();
    Plane::from_fn(width, height, |u, v| {
        let (u, v) = (u as f64, v as f64);
        h / (1.0 + ((u - cu) / ru).powi(2) + ((v - cv) / rv).powi(2)) + k * (wu * u + wv * v).cos().powi(2)
    })
}

/// `Z(u, v) = z0 + z1 u v/(W H) + z2 v/H`; a constant where the slopes are zero.
fn depth([width, height]: [usize; 2], parameters: &Value) -> Depth<f64> {
    let [z0, z1, z2]: [f64; 3] = numbers(parameters).try_into().unwrap();
    if z1 == 0.0 && z2 == 0.0 {
        return Depth::Constant { depth_m: z0 };
    }
    let (w, h) = (width as f64, height as f64);
    let metres = Plane::from_fn(width, height, |u, v| z0 + z1 * u as f64 * v as f64 / (w * h) + z2 * v as f64 / h);
    Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).unwrap())
}

fn size(case: &Value) -> [usize; 2] {
    [whole(&case["size"][0]), whole(&case["size"][1])]
}

#[test]
fn adaptive_windows_equal_their_formulas() {
    let golden = golden();
    let cases = golden["windows"].as_array().unwrap().iter().chain(golden["scenes"].as_array().unwrap());
    for case in cases {
        let [current, desired] = ["current", "desired"].map(|name| Brightness::of(&image(size(case), &case[name])));
        let expect = |name: &str| -> Vec<f64> {
            let axes = case["window"].as_array().unwrap();
            axes.iter()
                .flat_map(|axis| axis[name].as_array().map_or(vec![axis[name].clone()], Vec::clone))
                .map(|x| x.as_f64().unwrap())
                .collect()
        };
        for (rule, name) in [(Rule::Logs, "logs"), (Rule::Paper, "paper")] {
            let unrounded = hahn_window_unrounded(rule, &current, &desired).unwrap().concat();
            assert!(relative_difference(&unrounded, &expect(name)) < 1e-12, "sums over 1e4 pixels: {unrounded:?}");
            let rounded: Vec<f64> = expect(name).iter().map(|x| x.round()).collect();
            assert_eq!(hahn_window(rule, &current, &desired).unwrap().concat(), rounded);
        }
        for (lattice, name) in [(Lattice::Paper, "p_paper"), (Lattice::Exact, "p_exact")] {
            let p = krawtchouk_p(lattice, &current, &desired).unwrap();
            assert!(relative_difference(&p, &expect(name)) < 1e-13, "sums over 1e4 pixels");
        }
    }
}

#[test]
fn orders_equal_their_formula() {
    for case in golden()["orders"].as_array().unwrap() {
        let number = |name: &str| case[name].as_f64().unwrap();
        let rule = OrderRule::new(whole(&case["min"]), whole(&case["max"]), number("epsilon")).unwrap();
        let (mse, initial) = (number("mse"), number("initial_mse"));
        assert!((rule.unrounded(mse, initial) - number("unrounded")).abs() < 1e-13, "a few roundings near 10");
        assert_eq!(rule.order(mse, initial), whole(&case["order"]));
    }
}

#[test]
fn whole_steps_equal_those_made_at_60_digits() {
    for case in golden()["scenes"].as_array().unwrap() {
        let [fu, fv, cu, cv]: [f64; 4] = numbers(&case["camera"]).try_into().unwrap();
        let camera = Intrinsics::new([fu, fv], [cu, cv]).unwrap();
        let [(own, own_depth), (desired, desired_depth)] = ["current", "desired"]
            .map(|name| (image(size(case), &case[name]), depth(size(case), &case[format!("depth_{name}")])));
        for result in case["results"].as_array().unwrap() {
            let law = Law {
                order: OrderRule::fixed(whole(&case["order"])).unwrap(),
                window: Window::Adaptive,
                gain: Gain::PerSecond(1.0),
                step_cap: None,
                ..law_of(result["method"].as_str().unwrap())
            };
            let mut servo = Servo::new(law, camera, View { image: &desired, depth: &desired_depth }).unwrap();
            let step = servo.step(View { image: &own, depth: &own_depth }).unwrap();
            let close = |got: f64, name: &str| (got / result[name].as_f64().unwrap() - 1.0).abs() < 1e-11;
            assert!((step.pixel_mse / case["pixel_mse"].as_f64().unwrap() - 1.0).abs() < 1e-13);
            assert!(
                close(step.feature_error_squared, "feature_error_squared")
                    && close(step.condition_number, "condition_number")
            );
            let errors: Vec<f64> = servo.features().map(|feature| feature.error).collect();
            assert!(relative_difference(&errors, &numbers(&result["e"])) < 1e-12, "sums over 400 pixels");
            // Rounding times cond² of the normal equations, which is at most 5e3 here.
            let difference = relative_difference(&step.twist.to_array(), &numbers(&result["gauss_newton"]));
            assert!(difference < 1e-11, "{}: {difference:e}", result["method"]);
        }
    }
}

fn law_of(name: &str) -> Law {
    let law = Law::default();
    match name {
        "hahn" => Law { method: Method::Hahn, ..law },
        "krawtchouk_paper" => Law { method: Method::Krawtchouk, lattice: Lattice::Paper, ..law },
        "krawtchouk_exact" => Law { method: Method::Krawtchouk, lattice: Lattice::Exact, ..law },
        "tchebichef" => Law { method: Method::Tchebichef, ..law },
        name => {
            assert_eq!(name, "cosine");
            Law { method: Method::Cosine, ..law }
        }
    }
}

#[test]
fn narrow_windows_and_long_axes_stay_orthonormal() {
    let krawtchouk = |p, lattice| Polynomial::Krawtchouk(Krawtchouk { p, lattice });
    let mut polynomials = vec![Polynomial::Tchebichef(Tchebichef), Polynomial::Cosine(Cosine)];
    for narrow in [0.0, 0.3, 8.0, 1e3, 1e5] {
        polynomials
            .extend([(narrow, narrow), (0.5, narrow), (narrow, 2.0)].map(|(a, b)| Polynomial::Hahn(Hahn { a, b })));
    }
    for p in [1e-3, 0.02, 0.5, 0.97, 0.9999] {
        polynomials.extend([Lattice::Paper, Lattice::Exact].map(|lattice| krawtchouk(p, lattice)));
    }
    for (length, polynomial) in [8, 45, 640, 4096].into_iter().flat_map(|n| polynomials.iter().map(move |p| (n, *p))) {
        let rows = length.min(43);
        let basis = Basis::new(length, rows, polynomial).unwrap_or_else(|e| panic!("{length} pixels: {e}"));
        let may_be_cut = matches!(polynomial, Polynomial::Krawtchouk(Krawtchouk { lattice: Lattice::Paper, .. }));
        assert!(may_be_cut || basis.defect() < 1e-12, "{length} pixels, {polynomial:?}: {:e}", basis.defect());
        assert!((0..rows).all(|n| basis.row(n).iter().all(|x| x.is_finite())));
    }
}

#[test]
fn the_highest_coefficient_is_positive() {
    for polynomial in [Polynomial::Tchebichef(Tchebichef), Polynomial::Hahn(Hahn { a: 2.0, b: 5.0 })] {
        let basis = Basis::new(30, 20, polynomial).unwrap();
        for n in 0..20 {
            let sign = if n % 2 == 0 { 1.0 } else { -1.0 };
            assert!(basis.row(n)[29] > 0.0 && sign * basis.row(n)[0] > 0.0, "no zero lies outside the lattice");
        }
    }
}

#[test]
fn tchebichef_and_even_hahn_rows_are_even_and_odd_in_turn() {
    for polynomial in
        [Polynomial::Tchebichef(Tchebichef), Polynomial::Hahn(Hahn { a: 8.0, b: 8.0 }), Polynomial::Cosine(Cosine)]
    {
        let basis = Basis::new(51, 30, polynomial).unwrap();
        for (n, u) in (0..30).flat_map(|n| (0..51).map(move |u| (n, u))) {
            let sign = if n % 2 == 0 { 1.0 } else { -1.0 };
            let difference = (basis.row(n)[50 - u] - sign * basis.row(n)[u]).abs();
            assert!(difference < 1e-12, "Eq. (8), to the accuracy of the rows");
        }
    }
}

#[test]
fn a_very_tight_hahn_window_is_krawtchouk() {
    let (p, t) = (0.25, 1e9);
    let hahn = Basis::new(64, 6, Polynomial::Hahn(Hahn { a: (1.0 - p) * t, b: p * t })).unwrap();
    let krawtchouk = Basis::new(64, 6, Polynomial::Krawtchouk(Krawtchouk { p, lattice: Lattice::Exact })).unwrap();
    for n in 0..6 {
        let worst = hahn.row(n).iter().zip(krawtchouk.row(n)).fold(0.0, |w: f64, (a, b)| w.max((a - b).abs()));
        assert!(worst < 1e-5, "Eq. (7): the limit is approached as N²/t = 4e-6, got {worst:e}");
    }
}
