//! What a picture of triangles must be, judged by the ray caster of planes, by formulas, and by itself moved a little.

use domvs_simulators::{
    Background, Mesh, MeshScene, Photograph, PinholeCamera, PlaneScene, Scene, Texture, Wall, motion,
};
use domvs_vision::Plane;
use nalgebra::{Isometry3, Point3};

fn camera(width: usize, height: usize) -> PinholeCamera {
    PinholeCamera::with_field_of_view(width, height, 60.0_f64.to_radians()).expect("60 degrees are possible")
}

const BLACK: Background = Background { gray: 0.0, wall: None };

fn white() -> Texture {
    Texture::gray(1.0)
}

fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

/// A turned box in the middle of the view.
fn turned_box() -> ([f64; 3], Isometry3<f64>) {
    ([0.5, 0.3, 0.4], at(0.05, -0.02, 1.1) * motion::displacement_to_pose([0.0, 0.0, 0.0, 30.0, 40.0, -20.0]))
}

fn meshes(objects: &[(Mesh, Texture)], background: &Background) -> Scene {
    MeshScene::new(objects, background).expect("whole meshes").into()
}

fn poses() -> [Isometry3<f64>; 4] {
    [
        Isometry3::identity(),
        motion::displacement_to_pose(motion::EXPERIMENT_1),
        motion::displacement_to_pose([0.1, -0.2, 0.45, 20.0, -15.0, 80.0]),
        motion::displacement_to_pose([-0.1, 0.2, -3.0, 60.0, 5.0, -10.0]),
    ]
}

fn largest_difference(a: &Plane<f32>, b: &Plane<f32>) -> f32 {
    a.samples().iter().zip(b.samples()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn a_wall_is_drawn_as_the_ray_caster_draws_it() {
    let photograph = Photograph::bundled("coffee").expect("bundled");
    let judge = PlaneScene::new(&photograph, 0.7, 1.0).expect("lengths are positive");
    let wall = Wall { photograph, width_m: 0.7, distance_m: 1.0 };
    let scene = meshes(&[], &Background { gray: 0.0, wall: Some(wall) });
    for pose in poses() {
        let (got, expected) = (scene.render(&camera(96, 80), &pose), judge.render(&camera(96, 80), &pose));
        for (z, judged) in got.true_depth.samples().iter().zip(expected.true_depth.samples()) {
            // Two ways to the same f32, far beyond the horizon apart.
            assert!((z - judged).abs() <= 2e-7 * judged || *judged > 1e6, "{z} m, expected {judged} m");
        }
        // The four places of a pixel by derivatives instead of rays: of second order in a pixel.
        let difference = largest_difference(&got.image, &expected.image);
        assert!(difference < 0.02, "differs by {difference}");
    }
}

/// Where a ray enters an axis-aligned box about the origin, by the slabs of its three axes.
fn enters(size: [f64; 3], origin: Point3<f64>, through: Point3<f64>) -> Option<f64> {
    let (mut first, mut last) = (0.0_f64, f64::MAX);
    for axis in 0..3 {
        let along = through[axis] - origin[axis];
        let hits = [-size[axis] / 2.0, size[axis] / 2.0].map(|side| (side - origin[axis]) / along);
        first = first.max(hits[0].min(hits[1]));
        last = last.min(hits[0].max(hits[1]));
    }
    (first < last).then_some(first)
}

#[test]
fn depth_of_a_box_is_where_the_ray_enters_it() {
    let (size, place) = turned_box();
    let scene = meshes(&[(Mesh::cuboid(size).placed(&place), white())], &BLACK);
    let camera = camera(97, 80);
    let mut seen = 0;
    for pose in poses() {
        let depth = scene.render(&camera, &pose).true_depth;
        let in_box = place.inverse() * pose;
        for (u, v) in (0..80).flat_map(|v| (0..97).map(move |u| (u, v))) {
            let ray = Point3::new(camera.intrinsics.x(u as f64), camera.intrinsics.y(v as f64), 1.0);
            // Points of the ray at the depth z are z times its direction: the parameter is the depth.
            let expected = enters(size, in_box * Point3::origin(), in_box * ray).unwrap_or(0.0);
            let got = f64::from(depth.at(u, v));
            seen += usize::from(got > 0.0);
            // Depth is an f32.
            assert!((got - expected).abs() <= 2e-7 * expected, "({u}, {v}): {got} m, expected {expected} m");
        }
    }
    assert!(seen > 1000, "only {seen} pixels see the box");
}

#[test]
fn the_nearer_hides_the_farther_whatever_their_order() {
    let near = (Mesh::plane([0.4, 0.4]).placed(&at(0.0, 0.0, 0.8)), Texture::gray(0.25));
    let far = (Mesh::plane([2.0, 2.0]).placed(&at(0.0, 0.0, 1.2)), white());
    let camera = camera(64, 64);
    let one = meshes(&[near.clone(), far.clone()], &BLACK).render(&camera, &Isometry3::identity());
    let other = meshes(&[far, near], &BLACK).render(&camera, &Isometry3::identity());
    assert_eq!((&one.image, &one.true_depth), (&other.image, &other.true_depth));
    assert_eq!((one.image.at(32, 32), one.true_depth.at(32, 32)), (0.25, 0.8));
    assert_eq!((one.image.at(2, 2), one.true_depth.at(2, 2)), (1.0, 1.2));
}

#[test]
fn things_that_cross_inside_a_pixel_share_it() {
    // Two planes through the same line, turned by 30 degrees to either side: each is in front on its own side.
    let turned = |deg: f64| at(0.0, 0.0, 1.0) * motion::displacement_to_pose([0.0, 0.0, 0.0, 0.0, deg, 0.0]);
    let plane = |deg: f64, gray: f32| (Mesh::plane([2.0, 2.0]).placed(&turned(deg)), Texture::gray(gray));
    let scene = meshes(&[plane(30.0, 0.0), plane(-30.0, 1.0)], &BLACK);
    let image = scene.render(&camera(33, 33), &Isometry3::identity()).image;
    let row: Vec<f32> = (10..23).map(|u| image.at(u, 16)).collect();
    assert_eq!(row[6], 0.5, "the line halves the pixel: {row:?}");
    assert!(
        row[..6].iter().all(|&gray| gray == row[0]) && row[7..].iter().all(|&gray| gray == 1.0 - row[0]),
        "{row:?}"
    );
}

#[test]
fn there_are_no_cracks_between_triangles() {
    let hills = Photograph::noise(64, 3);
    let field = Mesh::height_field([4.0, 4.0, 0.3], hills.gray(), 40).placed(&at(0.0, 0.0, 1.3));
    let scene = meshes(&[(field, white())], &BLACK);
    for pose in &poses()[..3] {
        let rendering = scene.render(&camera(90, 70), pose);
        assert!(rendering.image.samples().iter().all(|&gray| gray == 1.0), "a crack is not white");
        assert!(rendering.true_depth.samples().iter().all(|&z| z > 0.0), "a crack has no depth");
    }
}

#[test]
fn a_camera_inside_a_box_sees_its_walls_all_around() {
    let room = Mesh::cuboid([2.0, 2.0, 2.0]);
    let scene = meshes(&[(room, white())], &BLACK);
    let camera = camera(40, 40);
    for turn in [[0.0, 0.0, 0.0], [0.0, 90.0, 0.0], [0.0, 180.0, 0.0], [60.0, 20.0, 10.0]] {
        let pose = at(0.2, 0.1, -0.3) * motion::displacement_to_pose([0.0, 0.0, 0.0, turn[0], turn[1], turn[2]]);
        let rendering = scene.render(&camera, &pose);
        assert!(rendering.image.samples().iter().all(|&gray| gray == 1.0), "{turn:?}: a hole in the room");
        assert!(rendering.true_depth.samples().iter().all(|&z| z > 0.4 && z < 2.5), "{turn:?}: a wall too far");
    }
}

#[test]
fn what_is_behind_the_camera_is_not_seen_and_what_passes_it_is_cut() {
    let camera = camera(40, 40);
    let floor = Mesh::plane([20.0, 20.0])
        .placed(&(at(0.0, 0.5, 0.0) * motion::displacement_to_pose([0.0, 0.0, 0.0, 90.0, 0.0, 0.0])));
    let rendering = meshes(&[(floor, white())], &BLACK).render(&camera, &Isometry3::identity());
    for v in 0..40 {
        let expected = 0.5 / camera.intrinsics.y(v as f64);
        let expected = if expected > 0.0 && expected < 10.0 { expected } else { 0.0 };
        let got = f64::from(rendering.true_depth.at(20, v));
        // Depth is an f32.
        assert!((got - expected).abs() <= 2e-7 * expected, "row {v}: {got} m, expected {expected} m");
    }
    let behind = Mesh::cuboid([1.0; 3]).placed(&at(0.0, 0.0, -2.0));
    let rendering = meshes(&[(behind, white())], &BLACK).render(&camera, &Isometry3::identity());
    assert!(rendering.image.samples().iter().all(|&gray| gray == 0.0));
}

#[test]
fn a_ball_and_a_cylinder_have_their_sizes() {
    let camera = camera(101, 101);
    for mesh in [Mesh::ellipsoid([0.4, 0.4, 0.4]), Mesh::cylinder([0.4, 0.4, 0.4])] {
        let rendering =
            meshes(&[(mesh.placed(&at(0.0, 0.0, 1.2)), white())], &BLACK).render(&camera, &Isometry3::identity());
        // The pole, or the end, is 0.2 m before the middle.
        assert!((rendering.true_depth.at(50, 50) - 1.0).abs() < 1e-6, "{} m", rendering.true_depth.at(50, 50));
        let area_px2: f64 = rendering.image.samples().iter().map(|&gray| f64::from(gray)).sum();
        let focal_px = camera.intrinsics.focal_px()[0];
        // A ball's outline is that of the cone that touches it; a cylinder's that of its nearer end.
        let smallest = std::f64::consts::PI * (0.2 * focal_px / 1.2_f64).powi(2);
        let largest = std::f64::consts::PI * (0.2 * focal_px / 1.0_f64).powi(2);
        assert!((smallest..largest).contains(&area_px2), "{area_px2} px², expected {smallest} to {largest}");
    }
}

#[test]
fn moving_right_by_a_pixel_moves_the_picture_of_a_mesh_left_by_a_pixel() {
    let camera = camera(96, 80);
    let coffee = Texture::once(&Photograph::bundled("coffee").expect("bundled"));
    let scene = meshes(&[(Mesh::plane([3.0, 3.0]).placed(&at(0.0, 0.0, 1.0)), coffee)], &BLACK);
    let before = scene.render(&camera, &Isometry3::identity()).image;
    let after = scene.render(&camera, &at(1.0 / camera.intrinsics.focal_px()[0], 0.0, 0.0)).image;
    for (u, v) in (0..80).flat_map(|v| (0..95).map(move |u| (u, v))) {
        let difference = (after.at(u, v) - before.at(u + 1, v)).abs();
        // Texel coordinates are f32: 2^-24 * 600 texels, times a contrast of 1 per texel, a few times.
        assert!(difference < 5e-4, "({u}, {v}) differs by {difference}");
    }
}

#[test]
fn a_scene_of_boxes_changes_smoothly_under_motion_of_parts_of_a_pixel() {
    let (size, place) = turned_box();
    let texture = |name: &str| Texture::once(&Photograph::bundled(name).expect("bundled"));
    let table = (Mesh::plane([3.0, 3.0]).placed(&at(0.0, 0.0, 1.3)), texture("coffee"));
    let scene = meshes(&[table, (Mesh::cuboid(size).placed(&place), texture("chelsea"))], &BLACK);
    let camera = camera(128, 128);
    let pixel_m = 1.0 / camera.intrinsics.focal_px()[0];
    let still = scene.render(&camera, &Isometry3::identity()).image;
    let mse = |shift_px: f64| {
        let moved = scene.render(&camera, &at(shift_px * pixel_m, 0.0, 0.0)).image;
        let squares = moved.samples().iter().zip(still.samples()).map(|(a, b)| f64::from(a - b).powi(2));
        squares.sum::<f64>() / still.samples().len() as f64
    };
    let shifts: Vec<f64> = (1..=20).map(|tenth| mse(f64::from(tenth) / 10.0)).collect();
    assert!(shifts.windows(2).all(|pair| pair[0] < pair[1]), "not monotonous: {shifts:?}");
    for small in [0.02, 0.05, 0.1] {
        let ratio = mse(2.0 * small) / mse(small);
        // Four for a smooth image, two if every move made pixels jump; borders of sixteen steps are between.
        assert!((2.8..4.8).contains(&ratio), "from {small} px to twice that the difference grows {ratio} times");
    }
}

#[test]
fn pixels_do_not_depend_on_the_number_of_threads() {
    let (size, place) = turned_box();
    let chelsea = Texture::once(&Photograph::bundled("chelsea").expect("bundled"));
    let scene = meshes(&[(Mesh::cuboid(size).placed(&place), chelsea)], &Background { gray: 0.3, wall: None });
    let one = scene.render(&camera(67, 81), &poses()[1]);
    for threads in [2, 3, 64] {
        let many = scene.clone().with_threads(threads).render(&camera(67, 81), &poses()[1]);
        assert_eq!((&one.image, &one.true_depth), (&many.image, &many.true_depth), "{threads} threads");
    }
}

#[test]
fn a_broken_mesh_is_refused() {
    let whole = Mesh::plane([1.0, 1.0]);
    let no_corner = Mesh { triangles: vec![[0, 1, 9]], ..whole.clone() };
    let no_place = Mesh { texture_places: vec![], ..whole.clone() };
    let mut infinite = whole;
    infinite.positions[0].x = f64::INFINITY;
    for mesh in [no_corner, no_place, infinite] {
        assert!(MeshScene::new(&[(mesh, white())], &BLACK).is_err());
    }
}
