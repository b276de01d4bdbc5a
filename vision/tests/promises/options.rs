//! The noise floor and the depth scale do what they are for, and cost nothing when there is nothing to do. No option makes more sweeps.

use domvs_vision::{
    Depth, DepthScale, Gain, Law, LawError, LightPrior, Method, NoiseFloor, OrderRule, Plane, Servo, ServoError,
    StepCap, View, Window, Work,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::motion::{camera, render};
use super::scenes::Pair;

/// An image with nearly normal noise of this deviation: the sum of twelve numbers from a fixed sequence.
fn noisy(image: &Plane<f64>, sigma: f64, seed: u64) -> Plane<f64> {
    let mut state = seed;
    let mut even = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut image = image.clone();
    for sample in image.samples_mut() {
        *sample += sigma * ((0..12).map(|_| even()).sum::<f64>() - 6.0);
    }
    image
}

#[test]
fn without_its_noise_floor_a_noisy_pair_gets_the_order_of_the_clean_one() {
    let pair = Pair::<f64>::at_constant_depth(160, 120);
    let far = Plane::from_fn(160, 120, |u, v| pair.desired.0.at((u + 30).min(159), v));
    let order = |sigma: f64, noise_floor| {
        let law = Law { noise_floor, order: OrderRule::new(4, 16, 3e-4).unwrap(), ..Law::default() };
        let [desired, current, initial] =
            [(&pair.desired.0, 1), (&pair.current.0, 2), (&far, 3)].map(|(image, seed)| noisy(image, sigma, seed));
        let mut servo = Servo::new(law, pair.camera, View { image: &desired, depth: &pair.desired.1 }).unwrap();
        servo.set_initial(&initial).unwrap();
        servo.step(View { image: &current, depth: &pair.current.1 }).unwrap().order
    };
    let clean = order(0.0, NoiseFloor::Ignored);
    assert!((8..16).contains(&clean) && order(0.0, NoiseFloor::Subtracted) == clean, "{clean}");
    assert!(order(0.1, NoiseFloor::Ignored) < clean - 2);
    // The estimate is good to some per cent of 2 σ² = 0.02, the clean error is about 0.003: two orders either way.
    assert!(order(0.1, NoiseFloor::Subtracted).abs_diff(clean) <= 2, "{}", order(0.1, NoiseFloor::Subtracted));
}

#[test]
fn pure_noise_on_a_goal_reached_does_not_keep_the_order_down() {
    let pair = Pair::<f64>::at_constant_depth(160, 120);
    let [desired, first, second] = [1, 2, 3].map(|seed| noisy(&pair.desired.0, 0.3, seed));
    let orders = [NoiseFloor::Ignored, NoiseFloor::Subtracted].map(|noise_floor| {
        let law = Law { noise_floor, ..Law::default() };
        let mut servo = Servo::new(law, pair.camera, View { image: &desired, depth: &pair.desired.1 }).unwrap();
        [&first, &second].map(|image| servo.step(View { image, depth: &pair.desired.1 }).unwrap().order)[1]
    });
    assert!(orders[0] < 5 && orders[1] > 9, "{orders:?}");
}

/// Six frames of a camera that comes nearer by known displacements, over a plane about 1 m away that is said to be at `depth_m`.
fn come_nearer(law: Law, depth_m: f64, tells: bool) -> domvs_vision::Step {
    let desired = render(&Isometry3::identity());
    let depth = Depth::Constant { depth_m };
    let mut servo = Servo::new(law, camera(), View { image: &desired.0, depth: &depth }).unwrap();
    let mut pose = Isometry3::from_parts(
        Translation3::new(0.04, -0.03, 0.03),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.02, -0.05)),
    );
    let mut last = None;
    for frame in 0..6 {
        let image = render(&pose).0;
        last = Some(servo.step(View { image: &image, depth: &depth }).unwrap());
        let motion = [-0.012, 0.008, -0.009, -0.003, -0.005, 0.012].map(|step| step * 0.8f64.powi(frame));
        let [vx, vy, vz, wx, wy, wz] = motion;
        pose *= Isometry3::from_parts(
            Translation3::new(vx, vy, vz),
            UnitQuaternion::from_scaled_axis(Vector3::new(wx, wy, wz)),
        );
        if tells {
            servo.moved(motion);
        }
    }
    last.unwrap()
}

#[test]
fn a_depth_that_is_wrong_by_a_factor_is_put_right_by_what_motion_does() {
    for method in [Method::Hahn, Method::Tchebichef] {
        let law = Law { method, depth_scale: DepthScale::Estimated, step_cap: None, ..Law::default() };
        let right = come_nearer(Law { depth_scale: DepthScale::Given, ..law }, 1.0, true);
        for depth_m in [0.6, 1.0, 2.0] {
            let told = come_nearer(law, depth_m, true);
            println!("{method:?}: {depth_m} m is to be divided by {}", told.depth_scale);
            // The plane is tilted, motion is finite, and the prior pulls towards 1: a tenth.
            assert!((told.depth_scale / depth_m - 1.0).abs() < 0.1, "{method:?}, {depth_m} m: {}", told.depth_scale);
            let shift = |step: &domvs_vision::Step| step.gauss_newton[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((shift(&told) / shift(&right) - 1.0).abs() < 0.1, "{} and {}", shift(&told), shift(&right));
        }
    }
}

#[test]
fn a_depth_scale_without_displacements_or_switched_off_stays_one() {
    let law = Law { depth_scale: DepthScale::Estimated, ..Law::default() };
    assert_eq!(come_nearer(law, 2.0, false).depth_scale, 1.0);
    assert_eq!(come_nearer(Law::default(), 2.0, true).depth_scale, 1.0);
    assert_eq!(come_nearer(law, 2.0, false), come_nearer(Law::default(), 2.0, true));
}

#[test]
fn a_depth_scale_is_refused_where_it_cannot_be_told() {
    let law = Law { depth_scale: DepthScale::Estimated, ..Law::default() };
    let mapped = Pair::<f64>::at_mapped_depth(48, 40);
    let refused = Servo::new(law, mapped.camera, mapped.desired()).err();
    assert_eq!(refused, Some(ServoError::DepthScaleOfMap));
    let constant = Pair::<f64>::at_constant_depth(48, 40);
    assert_eq!(constant.servo(law).step(mapped.current()).err(), Some(ServoError::DepthScaleOfMap));
    let adaptive = Servo::new(Law { window: Window::Adaptive, ..law }, constant.camera, constant.desired()).err();
    assert!(matches!(adaptive, Some(ServoError::Law(LawError::DepthScale { .. }))));
}

/// The cost that docs/options.md states, as far as it can be counted: an option adds to a sweep, but never a sweep.
#[test]
fn an_option_adds_no_basis_and_no_sweep_but_for_the_first_look_at_the_light() {
    let pair = Pair::<f32>::at_constant_depth(48, 40);
    let work = |law: Law| {
        let mut servo = pair.servo(law);
        for _ in 0..4 {
            servo.step(pair.current()).unwrap();
            servo.moved([1e-3; 6]);
        }
        // How many multiply-adds depends on the order, which an option may change.
        Work { multiply_adds: 0, ..servo.work() }
    };
    let light = Some(LightPrior::default());
    for law in [Law::default(), Law { window: Window::Adaptive, ..Law::default() }] {
        let plain = work(law);
        assert_eq!((plain.joint_sweeps, plain.desired_sweeps, plain.current_sweeps), (1, 1, 3));
        let others = [
            Law { noise_floor: NoiseFloor::Subtracted, ..law },
            Law { step_cap: Some(StepCap { translation_m: 1e-3, rotation_rad: 1e-3 }), ..law },
            Law { gain: Gain::Adaptive { at_zero: 2.0, at_infinity: 0.5, slope_at_zero: 6.0 }, ..law },
            Law { degrees_of_freedom: [true, true, true, false, false, false], ..law },
        ];
        others.into_iter().for_each(|other| assert_eq!(work(other), plain, "{other:?}"));
        // A first step looks at the light twice: alone, to have something to go by, and with the motion.
        let lit = work(Law { light, ..law });
        assert_eq!((lit.bases, lit.desired_sweeps), (plain.bases, plain.desired_sweeps), "{lit:?}");
        assert!(lit.current_sweeps <= plain.current_sweeps + 1, "{lit:?}");
    }
    // The estimate needs the current view's own half of every step, so its first one sweeps the views apart.
    let estimated = work(Law { depth_scale: DepthScale::Estimated, ..Law::default() });
    assert_eq!((estimated.bases, estimated.joint_sweeps), (2, 0));
    assert_eq!((estimated.desired_sweeps, estimated.current_sweeps), (1, 4));
}
