//! Masks and holes: what has no weight has no say, and what has some says it in proportion.

use domvs_vision::{
    Depth, DepthMap, Gaussian, GaussianForm, HoleFill, Holes, Law, LightPrior, MaskError, Method, NoiseFloor, Plane,
    ServoError, View,
};

use super::judge::{judge_weighted, polynomials};
use super::literal_sums::{assert_judged, assert_later_steps_judged};
use super::scenes::{Pair, every_method, relative_difference, with_order};

const WIDTH: usize = 52;
const HEIGHT: usize = 40;

/// Black over a block in the middle and one at the border, gray to the right, white elsewhere.
fn mask_at(u: usize, v: usize) -> f64 {
    match (u, v) {
        (20..30, 12..22) | (0..4, 30..) => 0.0,
        (40.., _) => 0.375,
        _ => 1.0,
    }
}

fn mask() -> Plane<f64> {
    Plane::from_fn(WIDTH, HEIGHT, mask_at)
}

/// The weights in use, from their definition: none beside a pixel that has none.
fn weight(u: usize, v: usize) -> f64 {
    let beside = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(du, dv)| (u as isize + du, v as isize + dv));
    let inside = |(u, v): &(isize, isize)| (0..WIDTH as isize).contains(u) && (0..HEIGHT as isize).contains(v);
    let is_black = |(u, v): (isize, isize)| mask_at(u as usize, v as usize) == 0.0;
    if beside.into_iter().filter(inside).any(is_black) { 0.0 } else { mask_at(u, v) }
}

/// Numbers in `[0, 1)` that follow nothing.
fn noise(i: usize) -> f64 {
    let mixed = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    ((mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 11) as f64 / (1u64 << 53) as f64
}

fn spoilt(image: &Plane<f64>, seed: usize) -> Plane<f64> {
    Plane::from_fn(
        WIDTH,
        HEIGHT,
        |u, v| {
            if mask_at(u, v) == 0.0 { noise(seed + u + WIDTH * v) } else { image.at(u, v) }
        },
    )
}

#[test]
fn every_family_equals_the_literal_sums_with_weights() {
    for pair in [Pair::at_constant_depth(WIDTH, HEIGHT), Pair::at_mapped_depth(WIDTH, HEIGHT)] {
        for law in every_method() {
            let mut servo = pair.servo(with_order(law, 5));
            servo.set_mask(Some(&mask())).unwrap();
            let step = servo.step(pair.current()).unwrap();
            let polynomials = polynomials(law.method, step.window, law.lattice);
            let judged = judge_weighted(&pair, polynomials, 5, &weight);
            assert_judged(&servo, &step, &judged);
            assert_later_steps_judged(&mut servo, &pair, &judged);
            let counted = (0..WIDTH * HEIGHT).filter(|i| weight(i % WIDTH, i / WIDTH) > 0.0).count();
            assert_eq!(step.used_fraction, counted as f64 / (WIDTH * HEIGHT) as f64);
        }
    }
}

/// Every family, and the methods on pixels.
fn every_law() -> Vec<Law> {
    let mut laws = every_method();
    laws.push(Law { method: Method::Photometric, ..laws[0] });
    for form in [GaussianForm::Exact, GaussianForm::Fast] {
        laws.push(Law { method: Method::GaussianMixture, gaussian: Gaussian { extent_px: 3.0, form }, ..laws[0] });
    }
    laws
}

#[test]
fn what_lies_under_the_mask_changes_no_bit_of_the_step() {
    let pair = Pair::<f64>::at_mapped_depth(WIDTH, HEIGHT);
    for law in every_law() {
        let options = Law { light: Some(LightPrior::default()), noise_floor: NoiseFloor::Subtracted, ..law };
        for law in [law, options] {
            let steps = [0, 1].map(|seed| {
                let [desired, current] = [&pair.desired.0, &pair.current.0].map(|image| spoilt(image, 5000 * seed));
                let desired = View { image: &desired, depth: &pair.desired.1 };
                let mut servo = domvs_vision::Servo::new(law, pair.camera, desired).unwrap();
                servo.set_mask(Some(&mask())).unwrap();
                [0, 1].map(|_| servo.step(View { image: &current, depth: &pair.current.1 }).unwrap())
            });
            assert_eq!(steps[0], steps[1], "{law:?}");
            assert!(steps[0][1].rank == 6);
        }
    }
}

#[test]
fn a_white_mask_is_no_mask_and_taking_a_mask_away_brings_the_plain_step_back() {
    let pair = Pair::<f64>::at_mapped_depth(WIDTH, HEIGHT);
    for law in every_law() {
        let mut servo = pair.servo(law);
        let plain = servo.step(pair.current()).unwrap();
        servo.set_mask(Some(&mask())).unwrap();
        assert_ne!(servo.step(pair.current()).unwrap().gauss_newton, plain.gauss_newton);
        servo.set_mask(Some(&Plane::filled(WIDTH, HEIGHT, 1.0))).unwrap();
        let white = servo.step(pair.current()).unwrap();
        let difference = relative_difference(&white.gauss_newton, &plain.gauss_newton);
        assert!(difference < 1e-12 && white.used_fraction == 1.0, "factors of one: {difference:e}");
        servo.set_mask(None).unwrap();
        let again = servo.step(pair.current()).unwrap();
        let difference = relative_difference(&again.gauss_newton, &plain.gauss_newton);
        assert!(difference < 1e-12 && again.features == plain.features, "swept apart: {difference:e}");
    }
}

#[test]
fn the_desired_half_is_made_again_only_when_a_weight_changed_and_then_stayed() {
    let pair = Pair::<f64>::at_mapped_depth(WIDTH, HEIGHT);
    let law = with_order(Law { holes: Holes::Ignored, ..Law::default() }, 5);
    let mut servo = pair.servo(law);
    servo.set_mask(Some(&mask())).unwrap();
    let mut sweeps = |depth: &Depth<f64>| {
        servo.step(View { image: &pair.current.0, depth }).unwrap();
        (servo.work().joint_sweeps, servo.work().desired_sweeps)
    };
    let [left, right] = [5, 9].map(|at| holed(|u, _| u == at, 1.0));
    let expected = [(1, 0), (1, 1), (2, 1), (2, 2), (2, 2), (3, 2)];
    assert_eq!([&left, &left, &right, &right, &right, &pair.current.1].map(&mut sweeps), expected);
}

/// A map with holes, which are filled with this depth.
fn holed(is_hole: impl Fn(usize, usize) -> bool, fill_m: f64) -> Depth<f64> {
    let metres = Plane::from_fn(WIDTH, HEIGHT, |u, v| if is_hole(u, v) { 0.0 } else { 0.9 + 0.002 * u as f64 });
    Depth::Map(DepthMap::from_metres(&metres, HoleFill::Constant(fill_m)).unwrap())
}

#[test]
fn ignored_holes_of_either_map_have_no_weight_and_their_fill_does_not_matter() {
    let own = |u, v| u > 35 && v > 20;
    let desired = |u: usize, v: usize| u + v < 20;
    for law in every_method() {
        let law = with_order(Law { holes: Holes::Ignored, ..law }, 5);
        let step = |law: Law, fill_m| {
            let depths = [holed(own, fill_m), holed(desired, fill_m)];
            let pair = Pair::with_depths(WIDTH, HEIGHT, depths);
            let mut servo = pair.servo(law);
            let step = servo.step(pair.current()).unwrap();
            let weight = |u, v| if own(u, v) || desired(u, v) { 0.0 } else { 1.0 };
            if law.holes == Holes::Ignored {
                let judged = judge_weighted(&pair, polynomials(law.method, step.window, law.lattice), 5, &weight);
                assert_judged(&servo, &step, &judged);
            }
            step
        };
        assert_eq!(step(law, 0.2), step(law, 5.0));
        let filled = Law { holes: Holes::Filled, ..law };
        assert_ne!(step(filled, 0.2).gauss_newton, step(filled, 5.0).gauss_newton);
    }
}

#[test]
fn a_mask_or_holes_that_leave_too_little_are_refused_and_forgotten() {
    let pair = Pair::<f64>::at_mapped_depth(WIDTH, HEIGHT);
    let law = Law { holes: Holes::Ignored, method: Method::Hahn, ..Law::default() };
    let mut servo = pair.servo(law);
    let refused = servo.set_mask(Some(&Plane::filled(WIDTH, HEIGHT, 0.0)));
    assert_eq!(refused, Err(ServoError::Mask(MaskError::TooFew { share: 0.0 })));
    assert!(matches!(servo.set_mask(Some(&Plane::filled(8, 8, 1.0))), Err(ServoError::ImageSize { .. })));
    let nothing = holed(|u, v| u + v > 0, 1.0);
    let step = servo.step(View { image: &pair.current.0, depth: &nothing });
    assert!(matches!(step, Err(ServoError::Mask(MaskError::TooFew { share })) if share < 0.001));
    assert_eq!(servo.step(pair.current()).unwrap(), pair.servo(law).step(pair.current()).unwrap());
}
