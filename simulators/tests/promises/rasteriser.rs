//! What a picture of triangles must be, judged by the ray caster of planes, by formulas, and by itself moved a little.

use domvs_simulators::{
    Background, Mesh, MeshScene, Photograph, PinholeCamera, PlaneScene, Scene, Texture, Wall, motion,
};
use domvs_vision::Plane;
use nalgebra::Isometry3;

fn camera(width: usize, height: usize) -> PinholeCamera {
    PinholeCamera::with_field_of_view(width, height, 60.0_f64.to_radians()).expect("60 degrees are possible")
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
