//! The interaction matrix says how features move: checked against images of a textured plane, rendered by ray casting.
//!
//! The renderer knows rays, a plane and rigid motion, and nothing of interaction matrices.

use domvs_vision::convolution::blur;
use domvs_vision::planes::pair_planes;
use domvs_vision::{Depth, DepthMap, HoleFill, Intrinsics, Law, Method, Plane, Servo, View};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::scenes::with_order;

const SIZE: usize = 256;

pub fn camera() -> Intrinsics {
    Intrinsics::new([230.0, 236.0], [128.5, 125.0]).unwrap()
}

/// Brightness of the world plane `z = 1 + 0.15 x - 0.1 y` (metres) at `(x, y)`: smooth, dark towards the view's border.
fn texture(x: f64, y: f64) -> f64 {
    let spot = |cx: f64, cy: f64, r: f64| (-((x - cx).powi(2) + (y - cy).powi(2)) / (r * r)).exp();
    0.6 * spot(0.02, -0.03, 0.16) + 0.4 * spot(-0.1, 0.07, 0.07) - 0.25 * spot(0.09, 0.05, 0.06)
        + 0.3 * spot(0.05, -0.12, 0.05)
}

/// What a camera at `pose` (world from camera) sees.
pub fn render(pose: &Isometry3<f64>) -> (Plane<f64>, Depth<f64>) {
    let (camera, normal) = (camera(), Vector3::new(-0.15, 0.1, 1.0));
    let hit = |u: usize, v: usize| {
        let ray = Vector3::new(camera.x(u as f64), camera.y(v as f64), 1.0);
        let depth_m = (1.0 - normal.dot(&pose.translation.vector)) / normal.dot(&(pose.rotation * ray));
        (pose * nalgebra::Point3::from(depth_m * ray), depth_m)
    };
    let image = Plane::from_fn(SIZE, SIZE, |u, v| texture(hit(u, v).0.x, hit(u, v).0.y));
    let metres = Plane::from_fn(SIZE, SIZE, |u, v| hit(u, v).1);
    (image, Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).unwrap()))
}

/// The pose after a small step along one degree of freedom of the camera's own frame.
fn moved(degree: usize, amount: f64) -> Isometry3<f64> {
    let axis = Vector3::ith(degree % 3, amount);
    let (none, still) = (Vector3::zeros(), Translation3::identity());
    let (moved, turned) = if degree < 3 { (Translation3::from(axis), none) } else { (still, axis) };
    Isometry3::from_parts(moved, UnitQuaternion::from_scaled_axis(turned))
}

fn servo(method: Method) -> (Servo<f64>, (Plane<f64>, Depth<f64>)) {
    let start = render(&Isometry3::identity());
    let law = with_order(Law { method, step_cap: None, ..Law::default() }, 6);
    (Servo::new(law, camera(), View { image: &start.0, depth: &start.1 }).unwrap(), start)
}

#[test]
fn the_interaction_matrix_is_the_finite_difference_of_rendered_features() {
    for method in [Method::Hahn, Method::Tchebichef, Method::Cosine] {
        let (mut servo, start) = servo(method);
        let mut errors = |image: &Plane<f64>, depth: &Depth<f64>| -> Vec<f64> {
            servo.step(View { image, depth }).unwrap();
            servo.features().map(|feature| feature.error).collect()
        };
        const H: f64 = 1e-4;
        let differences: Vec<Vec<f64>> = (0..6)
            .map(|k| {
                let [ahead, behind] =
                    [H, -H].map(|h| render(&moved(k, h))).map(|(image, depth)| errors(&image, &depth));
                ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * H)).collect()
            })
            .collect();
        errors(&start.0, &start.1);
        for (k, difference) in differences.iter().enumerate() {
            let column: Vec<f64> = servo.features().map(|feature| feature.interaction[k]).collect();
            let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let apart: Vec<f64> = column.iter().zip(difference).map(|(a, b)| a - b).collect();
            let relative = norm(&apart) / norm(&column);
            // Central pixel differences see a spot of 12 pixels about 0.3 % too flat; H adds 1e-6.
            assert!(relative < 0.006, "column {k} of {method:?}: {relative}");
        }
    }
}

#[test]
fn the_step_points_back_along_the_way_the_camera_was_moved() {
    for method in Method::ALL.iter().copied() {
        let (mut servo, _) = servo(method);
        for k in 0..6 {
            let (image, depth) = render(&moved(k, 4e-3));
            let step = servo.step(View { image: &image, depth: &depth }).unwrap();
            let mut expected = [0.0; 6];
            expected[k] = -4e-3;
            let worst = step.gauss_newton.iter().zip(expected).fold(0.0, |w: f64, (a, b)| w.max((a - b).abs()));
            // Gradient bias (0.3 %), magnified by coupled valleys (x with turning about y) at these condition numbers.
            assert!(worst < 4e-4, "{method:?}, degree {k}: {:?}", step.gauss_newton);
        }
    }
}

#[test]
fn planes_blurred_or_not_are_the_finite_difference_of_rendered_pixels() {
    const H: f64 = 1e-4;
    let (image, depth) = render(&Isometry3::identity());
    let start = View { image: &image, depth: &depth };
    let planes = pair_planes(camera(), start, start);
    for (k, plane) in planes[..6].iter().enumerate() {
        let [ahead, behind] = [H, -H].map(|h| render(&moved(k, h)).0);
        let difference = Plane::from_fn(SIZE, SIZE, |u, v| (ahead.at(u, v) - behind.at(u, v)) / (2.0 * H));
        let blurred = |extent_px| [plane, &difference].map(|plane| blur(plane, extent_px));
        for (what, [column, difference]) in
            [("pixels", [plane.clone(), difference.clone()]), ("4 px", blurred(4.0)), ("30 px", blurred(30.0))]
        {
            let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
            let apart = norm(&mut column.samples().iter().zip(difference.samples()).map(|(a, b)| a - b));
            let relative = apart / norm(&mut column.samples().iter().copied());
            // Central pixel differences see a spot of 12 pixels about 0.3 % too flat, and its blur less so; H adds 1e-6.
            assert!(relative < 0.005, "column {k} of {what}: {relative}");
        }
    }
}
