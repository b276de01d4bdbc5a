//! Photometric servoing and Gaussian mixtures are the literal sums over all pixels, their fast forms included.

use domvs_vision::{Depth, Gain, Gaussian, GaussianForm, Law, LightPrior, Method, Plane, Sample, Step, View};

use super::judge::judge_pixels;
use super::scenes::{Pair, every_method_on_pixels, relative_difference};

fn photometric() -> Law {
    every_method_on_pixels()[0]
}

fn mixture(extent_px: f64, form: GaussianForm) -> Law {
    Law { method: Method::GaussianMixture, gaussian: Gaussian { extent_px, form }, ..photometric() }
}

fn step_of<T: Sample>(pair: &Pair<T>, law: Law) -> Step {
    pair.servo(law).step(pair.current()).unwrap()
}

fn pairs() -> [Pair<f64>; 4] {
    let [map, constant] = [Pair::at_mapped_depth(29, 23), Pair::at_constant_depth(23, 30)];
    let mixed = [map.current.1.clone(), Depth::Constant { depth_m: 0.9 }];
    [Pair::with_depths(29, 23, mixed), map, constant, Pair::at_mapped_depth(16, 9)]
}

fn assert_judged(pair: &Pair<f64>, law: Law, extent_px: Option<f64>) {
    let (step, judged) = (step_of(pair, law), judge_pixels(pair, extent_px));
    assert_eq!(step.features, pair.current.0.samples().len());
    let squared = judged.error.norm_squared();
    assert!((step.feature_error_squared / squared - 1.0).abs() < 1e-12, "sums of 1e3 terms");
    assert!((step.condition_number / judged.condition_number - 1.0).abs() < 1e-8, "a square root of 1e-16 cond²");
    let difference = relative_difference(&step.gauss_newton, &judged.gauss_newton);
    // Normal equations square the condition number, which stays below 1e3 here.
    assert!(difference < 1e-9, "{law:?}: {difference:e}, condition number {}", step.condition_number);
}

#[test]
fn the_photometric_method_equals_the_literal_sums() {
    pairs().iter().for_each(|pair| assert_judged(pair, photometric(), None));
}

#[test]
fn gaussian_mixtures_equal_the_literal_sums() {
    for extent_px in [0.5, 1.7, 4.0, 9.0] {
        pairs().iter().for_each(|pair| assert_judged(pair, mixture(extent_px, GaussianForm::Exact), Some(extent_px)));
    }
}

/// The pair again with `share` of the way between its images, and a rough pattern on both, which a wide blur all but takes away.
fn rough<T: Sample>(width: usize, height: usize, share: f64) -> Pair<T> {
    let mut pair = Pair::<T>::at_mapped_depth(width, height);
    let mix = |own: T, desired: T| desired.to_f64() + share * (own.to_f64() - desired.to_f64());
    let pattern = |u: usize, v: usize| ((7 * u + 13 * v + 3 * u * v) % 32) as f64 / 155.0;
    let sample = |value: f64| T::from_f64(f64::from(value as f32));
    let Pair { current, desired, .. } = &mut pair;
    // The current image sees the pattern from 1.6 pixels further right.
    let seen = |u: usize, v: usize, by: f64| (1.0 - by) * pattern(u + 1, v) + by * pattern(u + 2, v);
    let own = |u, v| sample(mix(current.0.at(u, v), desired.0.at(u, v)) + seen(u, v, 0.6 * share));
    current.0 = Plane::from_fn(width, height, own);
    desired.0 = Plane::from_fn(width, height, |u, v| sample(desired.0.at(u, v).to_f64() + seen(u, v, 0.0)));
    pair
}

#[test]
fn fast_gaussian_mixtures_equal_the_exact_ones() {
    let (mut worst, mut compared) = (0.0f64, 0);
    for (width, height) in [(160, 120), (97, 203), (320, 64), (33, 32)] {
        for (extent_px, share) in
            [1.0, 4.0, 7.0, 11.0, 20.0, 60.0, 400.0].into_iter().flat_map(|e| [(e, 1.0), (e, 1e-3)])
        {
            let pair = rough::<f64>(width, height, share);
            let [exact, fast] =
                [GaussianForm::Exact, GaussianForm::Fast].map(|form| step_of(&pair, mixture(extent_px, form)));
            let difference = relative_difference(&fast.gauss_newton, &exact.gauss_newton);
            if exact.condition_number < 1e4 {
                assert!(difference < 1e-8, "{width}x{height}, {extent_px} px, {share}: {difference:e}");
                (worst, compared) = (worst.max(difference), compared + 1);
            }
        }
    }
    println!("{compared} pairs, largest relative difference {worst:e}");
    assert!(compared > 30, "only {compared} pairs are well conditioned enough to say anything");
}

#[test]
fn single_precision_gives_the_same_twist_on_pixels_while_the_condition_number_is_below_500() {
    let (mut worst, mut compared) = (0.0f64, 0);
    let mut compare = |law: Law, width: usize, height: usize, share: f64| {
        let single = step_of(&rough::<f32>(width, height, share), law);
        let double = step_of(&rough::<f64>(width, height, share), law);
        if double.condition_number < 500.0 {
            let difference = relative_difference(&single.twist.to_array(), &double.twist.to_array());
            assert!(difference < 1e-5, "{law:?} at {width}x{height}, {share}: {difference:e}");
            (worst, compared) = (worst.max(difference), compared + 1);
        }
    };
    for (width, height, share) in [(160, 120, 1.0), (160, 120, 1e-2), (97, 131, 1.0), (320, 240, 1.0)] {
        compare(photometric(), width, height, share);
        for extent_px in [1.0, 5.0, 14.0, 40.0] {
            compare(mixture(extent_px, GaussianForm::Exact), width, height, share);
            compare(mixture(extent_px, GaussianForm::Fast), width, height, share);
        }
    }
    for extent_px in [10.0, 20.0, 80.0, 160.0] {
        compare(mixture(extent_px, GaussianForm::Fast), 640, 480, 1.0);
    }
    println!("{compared} pairs, largest relative difference {worst:e}");
    assert!(compared > 35, "only {compared} pairs are well conditioned enough to say anything");
}

#[test]
fn what_lies_under_a_mask_reaches_no_pixel_method() {
    let mask =
        Plane::from_fn(80, 60, |u, v| if (20..45).contains(&u) && v > 25 { 0.0 } else { 0.5 + 0.005 * u as f64 });
    for law in every_method_on_pixels() {
        let pair = Pair::<f64>::at_mapped_depth(80, 60);
        let mut servo = pair.servo(law);
        servo.set_mask(Some(&mask)).unwrap();
        let clean = servo.step(pair.current()).unwrap();
        let painted = Plane::from_fn(80, 60, |u, v| if mask.at(u, v) == 0.0 { 0.9 } else { pair.current.0.at(u, v) });
        let step = servo.step(View { image: &painted, depth: &pair.current.1 }).unwrap();
        assert_eq!(step, clean);
        assert!(clean.used_fraction < 0.85 && clean.rank == 6, "{}", clean.used_fraction);
        servo.set_mask(None).unwrap();
        assert_eq!(servo.step(pair.current()).unwrap().gauss_newton, step_of(&pair, law).gauss_newton);
    }
}

#[test]
fn a_light_of_the_laws_form_asks_a_camera_at_its_goal_for_no_motion() {
    let light = [-0.3, 0.1, 0.05, -0.04, 0.02, 0.03];
    let [gain, offset, gain_u, gain_v, offset_u, offset_v] = light;
    for law in every_method_on_pixels() {
        let pair = Pair::<f64>::at_mapped_depth(80, 60);
        let lit = Plane::from_fn(80, 60, |u, v| {
            let (right, down) = (2.0 * u as f64 / 79.0 - 1.0, 2.0 * v as f64 / 59.0 - 1.0);
            let gain = 1.0 + gain + gain_u * right + gain_v * down;
            gain * pair.desired.0.at(u, v) + offset + offset_u * right + offset_v * down
        });
        let lit = View { image: &lit, depth: &pair.desired.1 };
        let blind = pair.servo(law).step(lit).unwrap();
        let mut servo = pair.servo(Law { light: Some(LightPrior::default()), ..law });
        servo.step(lit).unwrap();
        let step = servo.step(lit).unwrap();
        let size = |step: &Step| step.gauss_newton.iter().fold(0.0, |worst: f64, x| worst.max(x.abs()));
        // The prior pulls the light a little towards none.
        assert!(size(&step) < 0.01 * size(&blind), "{:?} after {:?}", step.gauss_newton, blind.gauss_newton);
        let found = step.light.unwrap();
        assert!(found.iter().zip(light).all(|(a, b)| (a - b).abs() < 0.01), "{found:?}");
    }
}

#[test]
fn a_pixel_method_at_its_goal_stands_exactly_still_and_has_no_order() {
    for law in every_method_on_pixels() {
        let pair = Pair::<f32>::at_mapped_depth(52, 38);
        let step = pair.servo(Law { gain: Gain::PerSecond(2.0), ..law }).step(pair.desired()).unwrap();
        assert!(step.twist.to_array().iter().all(|x| *x == 0.0), "exactly: I - I* is taken before any rounding");
        assert_eq!((step.order, step.features, step.rank_deficient), (0, 52 * 38, false));
    }
}
