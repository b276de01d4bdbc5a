//! The fast form is the literal double sums: Eq. (9), (29), (31), (40), (52), for every family, depth, shape and number type.

use domvs_vision::{Depth, Law, Method, Servo, Step};

use super::judge::{Judgement, judge, polynomials};
use super::scenes::{Pair, every_method, relative_difference, with_order};

/// The fast and the literal sums round differently: about 1e-15 for each of the 1e3 to 1e4 terms of a sum, at worst.
const SUMS: f64 = 1e-10;

fn assert_equal_to_the_literal_sums(pair: &Pair<f64>, law: Law, order: usize) {
    let mut servo = pair.servo(with_order(law, order));
    let first = servo.step(pair.current()).unwrap();
    let judged = judge(pair, polynomials(law.method, first.window, law.lattice), order);
    assert_judged(&servo, &first, &judged);
    assert_later_steps_judged(&mut servo, pair, &judged);
}

/// The first step swept both views at once; the second sweeps them apart, the third only the current one.
pub fn assert_later_steps_judged(servo: &mut Servo<f64>, pair: &Pair<f64>, judged: &Judgement) {
    for _ in 0..2 {
        let step = servo.step(pair.current()).unwrap();
        assert_judged(servo, &step, judged);
    }
    let work = servo.work();
    assert_eq!((work.joint_sweeps, work.desired_sweeps, work.current_sweeps), (1, 1, 2));
}

pub fn assert_judged(servo: &Servo<f64>, step: &Step, judged: &Judgement) {
    let law = servo.law();
    let errors: Vec<f64> = servo.features().map(|feature| feature.error).collect();
    assert!(relative_difference(&errors, judged.error.as_slice()) < SUMS, "e of {law:?}");
    for k in 0..6 {
        let column: Vec<f64> = servo.features().map(|feature| feature.interaction[k]).collect();
        let difference = relative_difference(&column, judged.interaction.column(k).as_slice());
        assert!(difference < SUMS, "column {k} of L for {law:?}: {difference:e}");
    }
    let squared = judged.error.norm_squared();
    assert!((step.feature_error_squared / squared - 1.0).abs() < SUMS);
    assert!((step.condition_number / judged.condition_number - 1.0).abs() < 1e-8, "a square root of 1e-16 cond²");
    // Normal equations square the condition number, which stays below 1e3 here.
    let difference = relative_difference(&step.gauss_newton, &judged.gauss_newton);
    assert!(difference < 1e-9, "step of {law:?}: {difference:e}, condition number {}", step.condition_number);
}

#[test]
fn every_family_equals_the_literal_sums_at_constant_depth() {
    let pair = Pair::at_constant_depth(61, 44);
    every_method().into_iter().for_each(|law| assert_equal_to_the_literal_sums(&pair, law, 6));
}

#[test]
fn every_family_equals_the_literal_sums_with_a_depth_map() {
    let pair = Pair::at_mapped_depth(44, 61);
    every_method().into_iter().for_each(|law| assert_equal_to_the_literal_sums(&pair, law, 7));
}

#[test]
fn a_map_on_one_side_and_a_constant_on_the_other_equal_the_literal_sums() {
    let [map, constant] = [Pair::at_mapped_depth(40, 40), Pair::at_constant_depth(40, 40)];
    for (own, desired) in [(&map, &constant), (&constant, &map)] {
        let depths = [own.current.1.clone(), desired.desired.1.clone()];
        let pair = Pair::with_depths(40, 40, depths);
        assert_equal_to_the_literal_sums(&pair, every_method()[1], 5);
    }
}

#[test]
fn the_highest_order_that_a_size_allows_equals_the_literal_sums() {
    for method in Method::ALL.iter().copied().filter(|method| method.is_on_moments()) {
        let law = Law { method, ..every_method()[0] };
        assert_equal_to_the_literal_sums(&Pair::at_mapped_depth(17, 12), law, 9);
        assert_equal_to_the_literal_sums(&Pair::at_mapped_depth(8, 8), law, 5);
    }
}

#[test]
fn a_wide_image_equals_the_literal_sums() {
    let pair = Pair::at_mapped_depth(1920, 33);
    assert_equal_to_the_literal_sums(&pair, every_method()[0], 4);
    assert_equal_to_the_literal_sums(&pair, every_method()[4], 4);
}

#[test]
fn a_lower_order_keeps_the_features_of_a_higher_one() {
    let pair = Pair::<f64>::at_mapped_depth(48, 36);
    for law in every_method() {
        let [low, high] = [5, 9].map(|order| {
            let mut servo = pair.servo(with_order(law, order));
            servo.step(pair.current()).unwrap();
            servo.features().filter(|f| f.n + f.m <= 5).map(|f| f.interaction[4]).collect::<Vec<f64>>()
        });
        assert!(relative_difference(&low, &high) < 1e-13, "the same sums, of rows made alike");
    }
}

#[test]
fn single_precision_gives_the_same_twist_while_the_condition_number_is_below_500() {
    let (mut compared, mut worst) = (0, 0.0f64);
    for (law, order) in every_method().into_iter().flat_map(|law| [4, 8, 16].map(|order| (law, order))) {
        for (width, height) in [(160, 120), (97, 131)] {
            let law = with_order(law, order);
            let (narrow, wide) =
                (Pair::<f32>::at_mapped_depth(width, height), Pair::<f64>::at_mapped_depth(width, height));
            let single = narrow.servo(law).step(narrow.current()).unwrap();
            let double = wide.servo(law).step(wide.current()).unwrap();
            if double.condition_number < 500.0 {
                let difference = relative_difference(&single.twist.to_array(), &double.twist.to_array());
                assert!(difference < 1e-5, "{law:?}: {difference:e} at {}", double.condition_number);
                (compared, worst) = (compared + 1, worst.max(difference));
            }
        }
    }
    println!("{compared} pairs, largest relative difference {worst:e}");
    assert!(compared > 40, "only {compared} pairs are well conditioned enough to say anything");
}

#[test]
fn equal_constants_and_a_map_of_that_constant_give_the_same_twist() {
    let constant = Pair::<f64>::with_depths(64, 48, [0.8, 0.8].map(|depth_m| Depth::Constant { depth_m }));
    let map = || {
        let metres = domvs_vision::Plane::filled(64, 48, 0.8);
        Depth::Map(domvs_vision::DepthMap::from_metres(&metres, domvs_vision::HoleFill::Median).unwrap())
    };
    let mapped = Pair::<f64>::with_depths(64, 48, [map(), map()]);
    for law in every_method() {
        let law = with_order(law, 6);
        let steps = [&constant, &mapped].map(|pair| pair.servo(law).step(pair.current()).unwrap().gauss_newton);
        assert!(relative_difference(&steps[0], &steps[1]) < 1e-10, "the same sums in another order, times cond² < 1e5");
    }
}
