//! Light, occluders and depth: each does what its name says, when it should, to what it may touch.

use domvs_simulators::{
    DepthDisturbance, Disturbance, Light, Occluder, Photograph, PinholeCamera, PlaneScene, Shot, Simulation, Slope,
    Spot, ToldDepth, motion,
};
use domvs_vision::Plane;
use nalgebra::Isometry3;

fn gray() -> Plane<f32> {
    Plane::filled(101, 81, 0.5)
}

fn lit(light: Light) -> Plane<f32> {
    let mut image = gray();
    light.shine(&mut image);
    image
}

fn simulation(disturbance: Disturbance) -> Simulation {
    let scene = PlaneScene::new(&Photograph::noise(64, 1), 1.4, 2.0).expect("lengths are positive");
    let camera = PinholeCamera::with_field_of_view(100, 100, 60.0_f64.to_radians()).expect("possible");
    let pose = motion::displacement_to_pose([0.1, 0.0, 0.2, 0.0, 3.0, 10.0]);
    Simulation::new(scene, camera, Isometry3::identity(), pose, disturbance)
}

fn with_depth(depth: DepthDisturbance) -> Simulation {
    simulation(Disturbance { depth, ..Disturbance::default() })
}

#[test]
fn a_slope_runs_from_border_to_border() {
    let slope = |angle_deg| lit(Light { slope: Some(Slope { from: 0.6, to: 1.2, angle_deg }), ..Light::default() });
    let (right, down) = (slope(0.0), slope(90.0));
    for (got, expected) in [
        (right.at(0, 3), 0.3),
        (right.at(50, 3), 0.45),
        (right.at(100, 3), 0.6),
        (down.at(7, 0), 0.3),
        (down.at(7, 80), 0.6),
    ] {
        // f32 rounding.
        assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
    }
}

#[test]
fn a_spot_is_brightest_in_its_middle_and_gone_far_away() {
    let spot = Spot { center: [0.5, 0.5], radius: 0.05, brightness: 0.4 };
    let image = lit(Light { spot: Some(spot), ..Light::default() });
    // f32 rounding; ten standard deviations away nothing is left.
    assert!((image.at(50, 40) - 0.7).abs() < 1e-6 && (image.at(0, 40) - 0.5).abs() < 1e-6);
}

#[test]
fn lights_are_switched_at_their_images_and_never_touch_the_desired_one() {
    let light = |from_image, gain| Light { from_image, gain, ..Light::default() };
    let lights = vec![light(2, 0.5), light(4, 1.0)];
    let disturbance = Disturbance { lights, gain: 0.8, ..Disturbance::default() };
    let mut plain = simulation(Disturbance::default());
    let mut simulation = simulation(disturbance);
    assert_eq!(simulation.capture_desired().image, plain.capture_desired().image);
    let undisturbed = plain.capture().image;
    for gain in [0.8, 0.8, 0.5, 0.5, 1.0, 1.0] {
        let image = simulation.capture().image;
        let expected: Vec<f32> = undisturbed.samples().iter().map(|gray| gain * gray).collect();
        let largest = image.samples().iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(largest < 1e-6, "image {} is not {gain} times as bright", simulation.images() - 1);
    }
}

#[test]
fn an_occluder_has_its_share_and_moves_but_is_not_in_the_depth() {
    let mut occluder = Occluder::new(&Photograph::one_gray(1.0), 0.09);
    (occluder.from_image, occluder.speed_px) = (1, [5.0, 0.0]);
    let cover = |image| {
        let mut picture = Plane::filled(100, 100, 0.0_f32);
        occluder.cover(&mut picture, image);
        let area: f32 = picture.samples().iter().sum();
        let weighted: f32 = (0..100 * 100).map(|pixel| picture.samples()[pixel] * ((pixel % 100) as f32 + 0.5)).sum();
        (area, weighted / area)
    };
    assert_eq!(cover(0).0, 0.0, "it comes with image 1");
    for (image, middle) in [(1, 50.0), (2, 55.0), (3, 60.0), (11, 100.0 - 0.0), (13, 90.0)] {
        let (area, center) = cover(image);
        let hidden =
            if middle > 85.0 { area < 900.5 } else { (area - 900.0).abs() < 0.5 && (center - middle).abs() < 0.01 };
        assert!(hidden, "image {image}: {area} px² about column {center}");
    }
    let hidden = Disturbance { occluders: vec![occluder], ..Disturbance::default() };
    let (mut plain, mut hidden) = (simulation(Disturbance::default()), simulation(hidden));
    assert_eq!(hidden.capture_desired().image, plain.capture_desired().image);
    let _ = (hidden.capture(), plain.capture());
    let (covered, open) = (hidden.capture(), plain.capture());
    assert_ne!(covered.image, open.image);
    assert_eq!(covered.depth, open.depth);
}

#[test]
fn depth_noise_grows_with_the_square_of_the_distance() {
    let mut simulation = with_depth(DepthDisturbance { noise_m: 0.005, ..DepthDisturbance::default() });
    let rendering = simulation.capture_desired();
    let errors = rendering.depth.samples().iter().zip(rendering.true_depth.samples());
    let (count, squares) =
        errors.fold((0.0, 0.0), |(n, sum), (told, z)| (n + 1.0_f64, sum + f64::from((told - z) / (z * z)).powi(2)));
    let deviation = (squares / count).sqrt();
    // Five standard errors of 10000 samples at 2 m: 5 mm at 1 m are 20 mm there. Seed 1.
    assert!((deviation - 0.005).abs() < 5.0 * 0.005 / (2.0 * count).sqrt(), "{deviation} m at 1 m");
    assert!(rendering.true_depth.samples().iter().all(|&z| (z - 2.0).abs() < 1e-6), "judges see the truth");
}

#[test]
fn holes_have_their_share_and_are_blobs() {
    let mut simulation = with_depth(DepthDisturbance { holes: 0.1, hole_px: 8.0, ..DepthDisturbance::default() });
    let depth = simulation.capture().depth;
    let hole = |u: usize, v: usize| depth.at(u, v) == 0.0;
    let holes = (0..100 * 100).filter(|pixel| hole(pixel % 100, pixel / 100)).count();
    assert_eq!(holes, 1000);
    let pairs = (0..99 * 100).filter(|pixel| hole(pixel % 99, pixel / 99) && hole(pixel % 99 + 1, pixel / 99)).count();
    assert!(pairs > 700, "holes are more than single pixels: {pairs} of 1000 have a hole to their right");
    assert_ne!(depth, simulation.capture().depth, "every image has holes of its own");
}

#[test]
fn a_law_can_be_told_the_desired_depth_or_one_number() {
    let told = |told| with_depth(DepthDisturbance { told, ..DepthDisturbance::default() });
    let mut desired = told(ToldDepth::Desired);
    let (target, current) = (desired.capture_desired(), desired.capture());
    assert_eq!(current.depth, target.depth);
    assert_ne!(current.true_depth, target.true_depth);
    let mut constant = told(ToldDepth::Constant { factor: 1.5 });
    let depth_m = constant.constant_depth_m().expect("one number");
    assert!((depth_m - 3.0).abs() < 1e-6, "1.5 times the median of 2 m, got {depth_m} m");
    for rendering in [constant.capture_desired(), constant.capture()] {
        assert!(rendering.depth.samples().iter().all(|&z| z == depth_m as f32));
        assert_ne!(rendering.depth, rendering.true_depth);
    }
    assert_eq!(told(ToldDepth::Map).constant_depth_m(), None);
}

#[test]
fn the_desired_image_can_be_kept_free_of_noise() {
    let noisy = Disturbance { noise_std: 0.1, noise_on_desired: false, ..Disturbance::default() };
    let (mut plain, mut noisy) = (simulation(Disturbance::default()), simulation(noisy));
    assert_eq!(noisy.capture_desired().image, plain.capture_desired().image);
    assert_ne!(noisy.capture().image, plain.capture().image);
    let mut image = gray();
    Disturbance { noise_std: 0.1, noise_on_desired: false, ..Disturbance::default() }.apply_to_gray(
        &mut image,
        Shot::Current { image: 0 },
        0,
    );
    assert_ne!(image, gray());
}
