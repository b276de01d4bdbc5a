//! SE(3): the closed forms against the definition of the exponential, and the conventions against plain cases.

use domvs_simulators::motion::{EXPERIMENT_1, displacement_to_pose, exp, log, pose_after, pose_error};
use nalgebra::{Isometry3, Matrix4, Translation3, UnitQuaternion, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

const SEED: u64 = 20;

/// Coordinates with rotations of up to `largest_rad`, both tiny and large.
fn coordinates(largest_rad: f64) -> Vec<[f64; 6]> {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut draw = |scale: f64| -> [f64; 6] {
        let w = Vector3::from_fn(|_, _| rng.gen_range(-1.0..1.0)).normalize() * scale;
        let v: [f64; 3] = std::array::from_fn(|_| rng.gen_range(-1.0..1.0));
        [v[0], v[1], v[2], w.x, w.y, w.z]
    };
    [0.0, 1e-12, 1e-6, 0.9e-3, 1.1e-3, 0.1, 1.0, 0.999].map(|part| draw(part * largest_rad)).into()
}

/// `sum X^k / k!`: the definition.
fn exponential_series(xi: [f64; 6]) -> Matrix4<f64> {
    let [x, y, z, a, b, c] = xi;
    #[rustfmt::skip]
    let hat = Matrix4::new(
        0.0,  -c,   b,   x,
          c, 0.0,  -a,   y,
         -b,   a, 0.0,   z,
        0.0, 0.0, 0.0, 0.0,
    );
    let mut term = Matrix4::identity();
    let mut sum = Matrix4::identity();
    for k in 1..60 {
        term = term * hat / f64::from(k);
        sum += term;
    }
    sum
}

fn difference(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.to_homogeneous() - b.to_homogeneous()).amax()
}

#[test]
fn the_exponential_is_its_series() {
    for xi in coordinates(6.0) {
        let error = (exp(xi).to_homogeneous() - exponential_series(xi)).amax();
        // Terms of the series grow to 6^6/6! = 65 before they cancel: 65 times f64 rounding, a few times.
        assert!(error < 1e-13, "seed {SEED}, {xi:?}: off by {error}");
    }
}

#[test]
fn one_step_is_many_small_steps() {
    let twist = [0.3, -0.2, 0.1, 0.5, -0.4, 0.8];
    let start = displacement_to_pose(EXPERIMENT_1);
    let once = pose_after(&start, twist, 2.0);
    let often = (0..10_000).fold(start, |pose, _| pose_after(&pose, twist, 2.0e-4));
    // Rounding of 10000 products: 1e4 * 1e-16.
    assert!(difference(&once, &often) < 1e-12);
    // Straight small steps of the plain velocities, no exponential at all: first order in the step.
    let straight = (0..100_000).fold(start, |pose, _| {
        let part = Vector3::new(twist[0], twist[1], twist[2]) * 2.0e-5;
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(twist[3], twist[4], twist[5]) * 2.0e-5);
        pose * Isometry3::from_parts(Translation3::from(part), turn)
    });
    // Half a step of |v||w| over 2 s: 0.5 * 2e-5 * 0.37 * 1.02 * 2 = 8e-6.
    assert!(difference(&once, &straight) < 1e-5);
}

#[test]
fn the_logarithm_undoes_the_exponential() {
    for xi in coordinates(3.1) {
        let back = log(&exp(xi));
        let error = xi.iter().zip(back).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        // Near pi the axis is well known, the angle to 1e-15 / (1 - cos).
        assert!(error < 1e-12, "seed {SEED}, {xi:?}: back as {back:?}");
    }
}

#[test]
fn a_twist_is_in_the_cameras_own_frame() {
    // Turned by 90 degrees about y, the camera's z is the world's x.
    let turned = displacement_to_pose([0.0, 0.0, 0.0, 0.0, 90.0, 0.0]);
    let after = pose_after(&turned, [0.0, 0.0, 0.5, 0.0, 0.0, 0.0], 2.0);
    // f64 rounding of a product.
    assert!((after.translation.vector - Vector3::new(1.0, 0.0, 0.0)).norm() < 1e-15);
}

#[test]
fn the_displacement_is_read_as_log_coordinates() {
    let [x, y, z, a, b, c] = log(&displacement_to_pose(EXPERIMENT_1));
    let back = [x, y, z, a.to_degrees(), b.to_degrees(), c.to_degrees()];
    let error = EXPERIMENT_1.iter().zip(back).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // f64 rounding of 30 degrees.
    assert!(error < 1e-13, "{back:?}");
}

#[test]
fn pose_error_is_millimetres_and_degrees() {
    let desired = displacement_to_pose(EXPERIMENT_1);
    let beside = desired * Isometry3::translation(0.003, 0.0, 0.004);
    let pose = beside * UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.2_f64.to_radians(), 0.0));
    let error = pose_error(&desired, &pose);
    // f64 rounding, and the arc cosine's loss near 0 that nalgebra avoids.
    assert!((error.mm - 5.0).abs() < 1e-10 && (error.deg - 0.2).abs() < 1e-10, "{error:?}");
    assert!(!error.is_converged());
    assert!(pose_error(&desired, &desired).is_converged());
}
