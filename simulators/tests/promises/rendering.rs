//! What a picture of the plane must be, judged by formulas and by brute force, never by the renderer itself.

use domvs_simulators::{Photograph, PinholeCamera, PlaneScene, motion};
use domvs_vision::Plane;
use nalgebra::{Isometry3, Point3};

const WIDTH_M: f64 = 0.7;
const DISTANCE_M: f64 = 1.0;

fn camera(width: usize, height: usize) -> PinholeCamera {
    PinholeCamera::with_field_of_view(width, height, 60.0_f64.to_radians()).expect("60 degrees are possible")
}

fn scene(photograph: &Photograph) -> PlaneScene {
    PlaneScene::new(photograph, WIDTH_M, DISTANCE_M).expect("lengths are positive")
}

fn photograph(size: usize, gray: impl Fn(usize, usize) -> f32) -> Photograph {
    Photograph::from_gray(Plane::from_fn(size, size, gray)).expect("larger than 2x2")
}

fn poses() -> [Isometry3<f64>; 4] {
    [
        Isometry3::identity(),
        motion::displacement_to_pose(motion::EXPERIMENT_1),
        motion::displacement_to_pose([0.1, -0.2, 0.45, 20.0, -15.0, 80.0]),
        motion::displacement_to_pose([-0.1, 0.2, -3.0, 60.0, 5.0, -10.0]),
    ]
}

/// Where the ray of a pixel meets the plane, in the world; from the ray's definition.
fn on_plane(camera: &PinholeCamera, pose: &Isometry3<f64>, u: f64, v: f64) -> Option<Point3<f64>> {
    let through = pose * Point3::new(camera.intrinsics.x(u), camera.intrinsics.y(v), 1.0);
    let origin = Point3::from(pose.translation.vector);
    let along = (DISTANCE_M - origin.z) / (through.z - origin.z);
    (along > 0.0).then(|| origin + along * (through - origin))
}

#[test]
fn depth_is_where_the_ray_meets_the_plane() {
    let camera = camera(48, 36);
    let scene = scene(&photograph(8, |_, _| 1.0));
    for pose in poses() {
        let depth = scene.render(&camera, &pose).depth;
        for (u, v) in (0..36).flat_map(|v| (0..48).map(move |u| (u, v))) {
            let hit = on_plane(&camera, &pose, u as f64, v as f64);
            let expected = hit.map_or(0.0, |hit| (pose.inverse() * hit).z);
            let got = f64::from(depth.at(u, v));
            // Depth is an f32: 2^-24 of its size, rounded once.
            assert!((got - expected).abs() <= 1e-7 * expected.abs(), "({u}, {v}): {got} m, expected {expected} m");
        }
    }
}

#[test]
fn depth_is_unknown_beyond_the_horizon() {
    let camera = camera(32, 32);
    let up = motion::displacement_to_pose([0.0, 0.0, 0.0, 90.0, 0.0, 0.0]);
    let rendering = scene(&photograph(8, |_, _| 1.0)).render(&camera, &up);
    let unknown = rendering.depth.samples().iter().filter(|&&z| z == 0.0).count();
    assert_eq!(unknown, 32 * 16, "the horizon halves the image");
    assert!(rendering.image.samples().iter().all(|gray| gray.is_finite()));
}

#[test]
fn a_ramp_is_seen_as_the_ray_says() {
    // A linear picture survives linear interpolation and any mean about its centre, at any size.
    let gray = |x_m: f64, y_m: f64| 0.5 + 0.5 * x_m - 0.4 * y_m;
    let texels = 256;
    let metres = |texel: usize| ((texel as f64 + 0.5) / texels as f64 - 0.5) * WIDTH_M;
    let scene = scene(&photograph(texels, |i, j| gray(metres(i), metres(j)) as f32));
    let camera = camera(96, 96);
    for pose in &poses()[..3] {
        let image = scene.render(&camera, pose).image;
        let mut seen = 0;
        for (u, v) in (0..96).flat_map(|v| (0..96).map(move |u| (u, v))) {
            let Some(hit) = on_plane(&camera, pose, u as f64, v as f64) else {
                continue;
            };
            if hit.x.abs().max(hit.y.abs()) < 0.8 * WIDTH_M / 2.0 {
                seen += 1;
                let error = (f64::from(image.at(u, v)) - gray(hit.x, hit.y)).abs();
                // The four samples of a tilted pixel are centred on its ray to second order of 1/96 of the view.
                assert!(error < 1e-4, "({u}, {v}) is off by {error}");
            }
        }
        assert!(seen > 500, "only {seen} pixels see the photograph");
    }
}

#[test]
fn the_centre_pixel_sees_the_centre_of_the_photograph() {
    let spot = photograph(9, |i, j| if (i, j) == (4, 4) { 1.0 } else { 0.0 });
    // 0.7 m over 9 texels is 0.078 m; a pixel at 1 m is 0.035 m: the centre pixel is inside the spot.
    let image = scene(&spot).render(&camera(33, 33), &Isometry3::identity()).image;
    let brightest = (0..33 * 33).max_by(|&a, &b| image.samples()[a].total_cmp(&image.samples()[b]));
    assert_eq!(brightest, Some(16 * 33 + 16));
}

#[test]
fn moving_right_by_a_pixel_moves_the_image_left_by_a_pixel() {
    let camera = camera(128, 96);
    let scene = scene(&Photograph::bundled("coffee").expect("bundled"));
    let pixel_m = DISTANCE_M / camera.intrinsics.focal_px()[0];
    let before = scene.render(&camera, &Isometry3::identity()).image;
    let after = scene.render(&camera, &Isometry3::translation(pixel_m, 0.0, 0.0)).image;
    for (u, v) in (0..96).flat_map(|v| (0..127).map(move |u| (u, v))) {
        let difference = (after.at(u, v) - before.at(u + 1, v)).abs();
        // Texel coordinates are f32: 2^-24 * 600 texels, times a contrast of 1 per texel.
        assert!(difference < 2e-4, "({u}, {v}) differs by {difference}");
    }
}

#[test]
fn a_white_photograph_covers_its_area() {
    let camera = camera(256, 256);
    for texels in [3, 64, 1000] {
        let scene = scene(&photograph(texels, |_, _| 1.0));
        for back_m in [0.0, 1.0, 7.0, 30.0] {
            let image = scene.render(&camera, &Isometry3::translation(0.003, 0.002, -back_m)).image;
            let side_px = WIDTH_M * camera.intrinsics.focal_px()[0] / (DISTANCE_M + back_m);
            let area_px2: f64 = image.samples().iter().map(|&gray| f64::from(gray)).sum();
            let relative = area_px2 / side_px.powi(2) - 1.0;
            // The border is softened on a grid of half pixels, or of a texel: a few percent of the smallest, 5 px.
            assert!(relative.abs() < 0.03, "{texels} texels, {back_m} m back: area is off by {relative}");
        }
    }
}

#[test]
fn pixels_are_means_of_what_they_cover() {
    let photograph = Photograph::bundled("coffee").expect("bundled").cropped_square();
    let camera = camera(64, 64);
    let scene = scene(&photograph);
    for pose in poses() {
        let image = scene.render(&camera, &pose).image;
        let mut squares = 0.0;
        for (u, v) in (0..64).flat_map(|v| (0..64).map(move |u| (u, v))) {
            let judge = brute_force(&photograph, &camera, &pose, u as f64, v as f64);
            squares += (f64::from(image.at(u, v)) - judge).powi(2);
        }
        let rms = (squares / 4096.0).sqrt();
        // The renderer's filter is a little wider than the box of the judge; a picture without it is off by 0.07.
        assert!(rms < 0.03, "rms {rms}");
    }
}

/// The mean of 32x32 nearest texels in a pixel.
fn brute_force(photograph: &Photograph, camera: &PinholeCamera, pose: &Isometry3<f64>, u: f64, v: f64) -> f64 {
    let gray = photograph.gray();
    let texel = |metres: f64, size: usize| {
        let at = (metres / WIDTH_M + 0.5) * size as f64;
        (at >= 0.0 && at < size as f64).then_some(at as usize)
    };
    let mut sum = 0.0;
    for (i, j) in (0..32).flat_map(|j| (0..32).map(move |i| (i, j))) {
        let part = |k: i32| (f64::from(k) + 0.5) / 32.0 - 0.5;
        let hit = on_plane(camera, pose, u + part(i), v + part(j));
        let texel = hit.and_then(|hit| Some((texel(hit.x, gray.width())?, texel(hit.y, gray.height())?)));
        sum += texel.map_or(0.0, |(s, t)| f64::from(gray.at(s, t)));
    }
    sum / 1024.0
}

#[test]
fn the_image_changes_smoothly_under_motion_of_parts_of_a_pixel() {
    // Fine noise, four texels a pixel: what aliases worst.
    let scene = scene(&Photograph::bundled("noise").expect("bundled"));
    let camera = camera(128, 128);
    let pixel_m = DISTANCE_M / camera.intrinsics.focal_px()[0];
    let still = scene.render(&camera, &Isometry3::identity()).image;
    let mse = |shift_px: f64| {
        let moved = scene.render(&camera, &Isometry3::translation(shift_px * pixel_m, 0.0, 0.0)).image;
        let squares = moved.samples().iter().zip(still.samples()).map(|(a, b)| f64::from(a - b).powi(2));
        squares.sum::<f64>() / still.samples().len() as f64
    };
    let shifts: Vec<f64> = (1..=20).map(|tenth| mse(f64::from(tenth) / 10.0)).collect();
    assert!(shifts.windows(2).all(|pair| pair[0] < pair[1]), "not monotonous: {shifts:?}");
    // A smooth image differs by (shift * gradient)²: twice the shift, four times the difference; where every move
    // makes some pixels jump it would be two times. Texels are joined by lines, not curves: hence not just four.
    for small in [0.01, 0.05, 0.1] {
        let ratio = mse(2.0 * small) / mse(small);
        assert!((3.0..4.5).contains(&ratio), "from {small} px to twice that the difference grows {ratio} times");
    }
}

#[test]
fn pixels_do_not_depend_on_the_number_of_threads() {
    let camera = camera(67, 41);
    let scene = scene(&Photograph::bundled("chelsea").expect("bundled"));
    let [_, pose, ..] = poses();
    let one = scene.clone().with_threads(1).render(&camera, &pose);
    for threads in [2, 3, 64] {
        let many = scene.clone().with_threads(threads).render(&camera, &pose);
        assert_eq!((&one.image, &one.depth), (&many.image, &many.depth), "{threads} threads");
    }
}

#[test]
fn the_back_of_the_plane_is_black_and_has_depth() {
    let turned = motion::displacement_to_pose([0.0, 0.0, 0.0, 0.0, 180.0, 0.0]);
    let behind = Isometry3::translation(0.0, 0.0, 2.0) * turned;
    let rendering = scene(&photograph(8, |_, _| 1.0)).render(&camera(16, 16), &behind);
    assert!(rendering.image.samples().iter().all(|&gray| gray == 0.0));
    // f32 rounding of exactly 1 m.
    assert!(rendering.depth.samples().iter().all(|&z| (z - 1.0).abs() < 1e-6));
}

#[test]
fn a_scene_without_size_is_refused() {
    let photograph = photograph(8, |_, _| 1.0);
    for (width_m, distance_m) in [(0.0, 1.0), (1.0, -1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY)] {
        assert!(PlaneScene::new(&photograph, width_m, distance_m).is_err(), "{width_m} m, {distance_m} m");
    }
}
