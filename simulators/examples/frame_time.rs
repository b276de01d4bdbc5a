//! How long a frame takes on one thread: `cargo run --release -p domvs-simulators --example frame_time`.

use std::time::Instant;

use domvs_simulators::{Background, Mesh, MeshScene, Photograph, PinholeCamera, PlaneScene, Scene, Texture, motion};
use nalgebra::Isometry3;

fn main() {
    let photograph = |name: &str| Photograph::bundled(name).expect("bundled");
    let texture = |name: &str| Texture::once(&photograph(name));
    let at = |x: f64, y: f64, z: f64| Isometry3::translation(x, y, z);
    let boxes = [
        (Mesh::plane([1.6, 1.2]).placed(&at(0.0, 0.0, 1.1)), texture("coffee")),
        (Mesh::cuboid([0.2, 0.2, 0.2]).placed(&at(-0.2, -0.1, 1.0)), texture("chelsea")),
        (Mesh::cuboid([0.15, 0.25, 0.3]).placed(&at(0.2, 0.1, 0.95)), texture("camera")),
        (Mesh::cuboid([0.2, 0.15, 0.1]).placed(&at(0.05, 0.25, 1.05)), texture("brick")),
    ];
    let field = |cells| {
        let mesh = Mesh::height_field([1.6, 1.2, 0.2], photograph("noise").gray(), cells).placed(&at(0.0, 0.0, 1.1));
        Scene::from(MeshScene::new(&[(mesh, texture("brick"))], &Background { gray: 0.0, wall: None }).expect("whole"))
    };
    let scenes = [
        ("plane", Scene::from(PlaneScene::new(&photograph("astronaut"), 0.7, 1.0).expect("positive"))),
        ("boxes", MeshScene::new(&boxes, &Background { gray: 0.0, wall: None }).expect("whole").into()),
        ("terrain 32", field(32)),
        ("terrain 64", field(64)),
        ("terrain 128", field(128)),
    ];
    for (name, scene) in &scenes {
        for (width, height) in [(128, 128), (512, 512), (640, 480)] {
            let camera = PinholeCamera::with_field_of_view(width, height, 60.0_f64.to_radians()).expect("possible");
            let pose = motion::displacement_to_pose([0.2, -0.1, -0.2, 5.0, 10.0, 20.0]);
            let mut rendering = scene.render(&camera, &pose);
            let mut best_s = f64::MAX;
            for _ in 0..20 {
                let begin = Instant::now();
                scene.render_into(&camera, &pose, &mut rendering);
                best_s = best_s.min(begin.elapsed().as_secs_f64());
            }
            println!("{name:12} {width}x{height}: {:.3} ms", best_s * 1e3);
        }
    }
}
