//! What a caller of `Servo` may rely on: zeros, signs of trouble, caches, repeatability, caps and gains.

use domvs_vision::{
    Depth, Gain, Law, LawError, Method, OrderRule, Plane, Servo, ServoError, StepCap, Twist, View, Window, WindowInUse,
};

use super::scenes::{Pair, every_method, every_method_on_pixels, relative_difference, with_order};

#[test]
fn twist_is_zero_when_current_equals_desired() {
    for (law, order) in every_method().into_iter().flat_map(|law| [4, 9].map(|order| (law, order))) {
        let pair = Pair::<f32>::at_mapped_depth(52, 38);
        let step = pair.servo(with_order(law, order)).step(pair.desired()).unwrap();
        assert!(step.twist.to_array().iter().all(|x| *x == 0.0), "exactly: I - I* is taken before any rounding");
        assert_eq!((step.feature_error_squared, step.pixel_mse, step.rank_deficient), (0.0, 0.0, false));
    }
}

#[test]
fn the_same_inputs_give_the_same_bits_whatever_came_before() {
    let pair = Pair::<f32>::at_mapped_depth(80, 60);
    for law in every_method().into_iter().chain(every_method_on_pixels()) {
        let law = Law { order: OrderRule::new(4, 12, 1e-3).unwrap(), ..law };
        let fresh = pair.servo(law).step(pair.current()).unwrap();
        let mut used = pair.servo(law);
        let dim = Plane::from_fn(80, 60, |u, v| 0.4 * pair.current.0.at(u, v) + 0.002 * u as f32);
        used.step(View { image: &dim, depth: &pair.current.1 }).unwrap();
        assert!(used.step(View { image: &Plane::filled(80, 60, f32::NAN), depth: &pair.current.1 }).is_err());
        used.step(pair.desired()).unwrap();
        used.restart();
        assert_eq!(format!("{:?}", used.step(pair.current()).unwrap()), format!("{fresh:?}"));
    }
}

#[test]
fn bases_and_the_desired_half_are_made_once_while_the_parameters_stay() {
    for (width, height) in [(64, 64), (80, 48)] {
        let pair = Pair::<f32>::at_mapped_depth(width, height);
        let mut servo = pair.servo(with_order(Law::default(), 6));
        for _ in 0..10 {
            servo.step(pair.current()).unwrap();
        }
        let work = servo.work();
        let sweeps = (work.joint_sweeps, work.desired_sweeps, work.current_sweeps);
        assert_eq!(
            (work.bases, sweeps),
            (2, (1, 1, 9)),
            "{width}x{height}: both at once, then the desired half, then it is there"
        );
    }
}

#[test]
fn a_moved_window_makes_only_what_it_touches() {
    for (width, height) in [(64, 64), (80, 48)] {
        let pair = Pair::<f32>::at_constant_depth(width, height);
        let mut servo = pair.servo(with_order(Law { window: Window::Adaptive, ..Law::default() }, 5));
        let first = servo.step(pair.current()).unwrap().window;
        assert_eq!(servo.step(pair.current()).unwrap().window, first);
        let before = servo.work();
        assert_eq!(servo.step(pair.current()).unwrap().window, first);
        assert_eq!((servo.work().bases, servo.work().desired_sweeps), (before.bases, before.desired_sweeps));
        let moved = Plane::from_fn(width, height, |u, v| if u < 9 && v < 9 { 1.0 } else { 0.0 });
        let second = servo.step(View { image: &moved, depth: &pair.current.1 }).unwrap().window;
        assert!(second != first && servo.work().bases > before.bases);
        assert_eq!(servo.work().joint_sweeps, before.joint_sweeps + 1, "once, with no half to keep");
        assert_eq!(servo.work().desired_sweeps, before.desired_sweeps);
    }
}

#[test]
fn the_first_image_is_the_initial_one_until_another_is_set_or_forgotten() {
    let pair = Pair::<f64>::at_constant_depth(48, 48);
    let law = Law { order: OrderRule::new(4, 12, 2e-5).unwrap(), ..Law::default() };
    let mut servo = pair.servo(law);
    let first = servo.step(pair.current()).unwrap();
    let near = Plane::from_fn(48, 48, |u, v| {
        pair.desired.0.at(u, v) + 0.15 * (pair.current.0.at(u, v) - pair.desired.0.at(u, v))
    });
    let near = View { image: &near, depth: &pair.current.1 };
    let second = servo.step(near).unwrap();
    assert!(first.order == 4 && second.order > 4, "{} then {}", first.order, second.order);

    servo.restart();
    let restarted = servo.step(near).unwrap().order;
    servo.set_initial(&pair.current.0).unwrap();
    assert!(restarted < second.order && servo.step(near).unwrap().order == second.order);
}

#[test]
fn a_refused_image_is_not_the_initial_one() {
    let pair = Pair::<f64>::at_constant_depth(48, 48);
    let law = Law { window: Window::Adaptive, order: OrderRule::new(4, 12, 1e-4).unwrap(), ..Law::default() };
    let mut servo = pair.servo(law);
    let black = Plane::filled(48, 48, 0.0);
    let refused = servo.step(View { image: &black, depth: &pair.current.1 });
    assert!(matches!(refused, Err(ServoError::NoBrightness(_))));
    assert_eq!(servo.step(pair.current()).unwrap(), pair.servo(law).step(pair.current()).unwrap());
}

#[test]
fn a_window_too_narrow_for_its_rows_is_an_error_and_not_remembered() {
    let pair = Pair::<f64>::at_constant_depth(48, 48);
    let law = with_order(Law { method: Method::Krawtchouk, ..Law::default() }, 5);
    let mut servo = pair.servo(law);
    let corner = Plane::from_fn(48, 48, |u, v| if u + v == 0 { 1e12 } else { 0.0 });
    let first = servo.step(View { image: &corner, depth: &pair.current.1 });
    servo.restart();
    let second = servo.step(View { image: &corner, depth: &pair.current.1 });
    assert_eq!(format!("{first:?}"), format!("{second:?}"));
    servo.restart();
    assert_eq!(servo.step(pair.current()).unwrap(), pair.servo(law).step(pair.current()).unwrap());
}

#[test]
fn views_that_do_not_fit_are_refused_with_both_sizes() {
    let pair = Pair::<f32>::at_mapped_depth(40, 30);
    let other = Pair::<f32>::at_mapped_depth(30, 40);
    let mut servo = pair.servo(with_order(Law::default(), 5));
    let (expected, got) = ([40, 30], [30, 40]);
    assert_eq!(servo.step(other.current()), Err(ServoError::ImageSize { expected, got }));
    let mixed = View { image: &pair.current.0, depth: &other.current.1 };
    assert_eq!(servo.step(mixed), Err(ServoError::DepthSize { expected, got }));
    assert_eq!(servo.set_initial(&other.current.0), Err(ServoError::ImageSize { expected, got }));
    let flat = View { image: &pair.current.0, depth: &Depth::Constant { depth_m: -1.0 } };
    assert_eq!(servo.step(flat), Err(ServoError::DepthNotPositive { depth_m: -1.0 }));
}

#[test]
fn a_servo_that_cannot_work_is_not_made() {
    let pair = Pair::<f32>::at_constant_depth(20, 30);
    let make = |law| Servo::new(law, pair.camera, pair.desired()).err();
    assert_eq!(
        make(with_order(Law::default(), 18)),
        Some(ServoError::OrderTooHigh { highest: 17, got: 18, size: [20, 30] })
    );
    assert_eq!(make(with_order(Law::default(), 17)), None);
    let law = Law { degrees_of_freedom: [false; 6], ..Law::default() };
    assert_eq!(make(law), Some(ServoError::Law(LawError::NothingMoves)));
    let tiny = Plane::filled(7, 30, 0.5f32);
    let depth = Depth::Constant { depth_m: 1.0 };
    let refused = Servo::new(with_order(Law::default(), 3), pair.camera, View { image: &tiny, depth: &depth });
    assert_eq!(refused.err(), Some(ServoError::SizeOutOfRange { got: [7, 30] }));
}

#[test]
fn images_that_say_nothing_give_a_zero_twist_and_say_so() {
    let depth = Depth::Constant { depth_m: 1.0 };
    let camera = Pair::<f32>::at_constant_depth(40, 40).camera;
    let law = with_order(Law::default(), 6);
    let flat = [Plane::filled(40, 40, 0.3f32), Plane::filled(40, 40, 0.6f32)];
    let stripes = [0.0, 1.5].map(|shift| Plane::from_fn(40, 40, |u, _| (0.4 * u as f32 + shift).sin()));
    for [current, desired] in [flat, stripes] {
        let mut servo = Servo::new(law, camera, View { image: &desired, depth: &depth }).unwrap();
        let step = servo.step(View { image: &current, depth: &depth }).unwrap();
        assert!(step.rank_deficient && step.twist == Twist::ZERO, "{step:?}");
        assert!(step.gauss_newton.iter().all(|x| x.is_finite()));
    }
}

#[test]
fn the_cap_bounds_the_full_step_before_the_gain() {
    let pair = Pair::<f64>::at_mapped_depth(64, 48);
    let law = Law { gain: Gain::PerSecond(3.0), ..with_order(Law::default(), 6) };
    let free = pair.servo(Law { step_cap: None, ..law }).step(pair.current()).unwrap();
    assert!(!free.step_capped);
    let length = Twist::from_array(free.gauss_newton).linear_norm();
    let cap = StepCap { translation_m: length / 4.0, rotation_rad: 10.0 };
    let capped = pair.servo(Law { step_cap: Some(cap), ..law }).step(pair.current()).unwrap();
    assert!(capped.step_capped && capped.gauss_newton == free.gauss_newton);
    let expected = free.twist.scaled(0.25).to_array();
    assert!(relative_difference(&capped.twist.to_array(), &expected) < 1e-14, "one scale for all six");
    assert!(relative_difference(&free.twist.to_array(), &free.gauss_newton.map(|x| 3.0 * x)) < 1e-15);
}

#[test]
fn a_degree_that_is_not_free_stays_exactly_still() {
    let pair = Pair::<f64>::at_mapped_depth(64, 48);
    let free = [true, true, false, false, false, true];
    let law = with_order(Law { degrees_of_freedom: free, ..Law::default() }, 6);
    let step = pair.servo(law).step(pair.current()).unwrap();
    assert!(step.rank == 3 && !step.rank_deficient);
    assert!(step.twist.to_array().iter().zip(free).all(|(x, free)| (*x != 0.0) == free));
}

#[test]
fn a_step_says_what_it_used() {
    let pair = Pair::<f64>::at_mapped_depth(64, 48);
    let step = pair.servo(with_order(Law::default(), 7)).step(pair.current()).unwrap();
    assert_eq!((step.order, step.features, step.rank), (7, 36, 6));
    assert_eq!(step.window, WindowInUse::Hahn { x: [8.0, 8.0], y: [8.0, 8.0] });
    assert_eq!(step.gain_per_s, 0.5);
    let pixels = pair.current.0.samples().iter().zip(pair.desired.0.samples());
    let mse = pixels.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / (64.0 * 48.0);
    assert!((step.pixel_mse / mse - 1.0).abs() < 1e-12, "the same sum in another order");
}

#[test]
fn a_gain_can_change_between_steps_and_a_bad_one_changes_nothing() {
    let pair = Pair::<f64>::at_mapped_depth(64, 48);
    let mut servo = pair.servo(with_order(Law::default(), 6));
    let before = servo.step(pair.current()).unwrap();
    servo.set_gain(Gain::PerSecond(2.0)).unwrap();
    assert!(servo.set_gain(Gain::PerSecond(f64::NAN)).is_err());
    let after = servo.step(pair.current()).unwrap();
    assert_eq!((before.gain_per_s, after.gain_per_s), (0.5, 2.0));
    let difference = relative_difference(&after.gauss_newton, &before.gauss_newton);
    assert!(difference < 1e-12, "swept together, then apart: {difference:e}");
}
