//! Whatever the pixels and depths are, a step is finite or an error: never a twist that is not a number, never a panic.

use domvs_vision::{
    Depth, DepthMap, HoleFill, Holes, Intrinsics, Law, LightPrior, NoiseFloor, OrderRule, Plane, Sample, Servo, View,
};
use proptest::prelude::*;

use super::scenes::{every_method, every_method_on_pixels, relative_difference, with_order};

fn sample() -> impl Strategy<Value = f64> {
    prop_oneof![
        12 => 0.0..1.0f64,
        2 => Just(0.0),
        1 => Just(1.0),
        1 => -2.0..3.0f64,
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e38), Just(-1e300), Just(1e-310)],
    ]
}

/// Mostly ordinary planes; some with a few wild pixels.
fn plane(width: usize, height: usize) -> impl Strategy<Value = Vec<f64>> {
    let size = width * height;
    let tame = prop::collection::vec(0.0..1.0f64, size);
    prop_oneof![3 => tame, 2 => prop::collection::vec(sample(), size), 1 => Just(vec![0.7; size])]
}

fn check<T: Sample>(law: Law, [width, height]: [usize; 2], planes: &[Vec<f64>]) -> Result<(), TestCaseError> {
    let [current, desired, metres] =
        [0, 1, 2].map(|i| Plane::new(width, height, planes[i].iter().map(|x| T::from_f64(*x)).collect()).unwrap());
    let Ok(map) = DepthMap::from_metres(&metres, HoleFill::Constant(1.0)) else { return Ok(()) };
    let (map, constant) = (Depth::Map(map), Depth::Constant { depth_m: 0.8 });
    let camera = Intrinsics::new([15.0, 16.0], [7.0, 6.0]).unwrap();
    let Ok(mut servo) = Servo::new(law, camera, View { image: &desired, depth: &map }) else { return Ok(()) };
    for depth in [&map, &constant, &map] {
        if let Ok(step) = servo.step(View { image: &current, depth }) {
            prop_assert!(step.twist.is_finite() && step.gauss_newton.iter().all(|x| x.is_finite()));
            prop_assert!(step.light.iter().flatten().all(|x| x.is_finite()));
            prop_assert!(step.rank <= 6 && step.condition_number >= 1.0);
            if let Some(cap) = law.step_cap {
                prop_assert!(step.twist.linear_norm() <= step.gain_per_s * cap.translation_m * (1.0 + 1e-12));
                prop_assert!(step.twist.angular_norm() <= step.gain_per_s * cap.rotation_rad * (1.0 + 1e-12));
            }
        }
    }
    Ok(())
}

fn law_of(method: usize) -> Law {
    every_method().into_iter().chain(every_method_on_pixels()).nth(method).unwrap()
}

/// The same cases on every run.
fn config() -> ProptestConfig {
    let rng_seed = prop::test_runner::RngSeed::Fixed(20_240_229);
    ProptestConfig { cases: 96, rng_seed, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn a_step_is_finite_or_an_error(
        method in 0..13usize,
        options in prop::array::uniform3(any::<bool>()),
        planes in prop::collection::vec(plane(16, 13), 3),
    ) {
        let [light, noise, holes] = options;
        let law = Law {
            order: OrderRule::new(2, 8, 1e-3).unwrap(),
            step_cap: Law::default().step_cap,
            light: light.then(LightPrior::default),
            noise_floor: if noise { NoiseFloor::Subtracted } else { NoiseFloor::Ignored },
            holes: if holes { Holes::Ignored } else { Holes::Filled },
            ..law_of(method)
        };
        check::<f32>(law, [16, 13], &planes)?;
        check::<f64>(law, [16, 13], &planes)?;
    }

    #[test]
    fn a_brighter_pair_asks_for_the_same_step(
        method in 0..13usize,
        doublings in -3..4i32,
        planes in prop::collection::vec(prop::collection::vec(0.05..1.0f64, 20 * 15), 2),
    ) {
        let camera = Intrinsics::new([15.0, 16.0], [9.0, 7.0]).unwrap();
        let depth = Depth::Constant { depth_m: 0.8 };
        let law = with_order(law_of(method), 6);
        let [plain, bright] = [0, doublings].map(|doublings| 2f64.powi(doublings)).map(|gain| {
            let [current, desired] = [0, 1].map(|i| Plane::new(20, 15, planes[i].iter().map(|x| gain * x).collect()).unwrap());
            let mut servo = Servo::new(law, camera, View { image: &desired, depth: &depth }).unwrap();
            servo.step(View { image: &current, depth: &depth }).unwrap()
        });
        // e and L scale alike, and a power of two rounds nothing.
        prop_assert_eq!(bright.gauss_newton, plain.gauss_newton);
        prop_assert_eq!(bright.window, plain.window);
    }

    #[test]
    fn a_mirrored_pair_asks_for_the_mirrored_step(
        planes in prop::collection::vec(prop::collection::vec(0.0..1.0f64, 17 * 14), 2),
    ) {
        let depth = Depth::Constant { depth_m: 0.8 };
        let camera = Intrinsics::new([15.0, 16.0], [8.0, 7.0]).unwrap();
        let [plain, mirrored] = [false, true].map(|mirror| {
            let [current, desired] = [0, 1].map(|i| {
                Plane::from_fn(17, 14, |u, v| planes[i][v * 17 + if mirror { 16 - u } else { u }])
            });
            let mut servo = Servo::new(with_order(Law::default(), 5), camera, View { image: &desired, depth: &depth }).unwrap();
            servo.step(View { image: &current, depth: &depth }).unwrap().gauss_newton
        });
        let [x, y, z, rx, ry, rz] = plain;
        let difference = relative_difference(&mirrored, &[-x, y, z, rx, -ry, -rz]);
        prop_assert!(difference < 1e-8, "left and right change places: {difference:e}");
    }
}
