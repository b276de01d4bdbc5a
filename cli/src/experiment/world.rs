//! From the tables of a plan to a camera in front of a scene.

use super::plan::RunPlan;
use super::spec::Table;
use anyhow::Context;
use domvs_proto::settings::Camera;
use domvs_simulators::{Disturbance, Photograph, PinholeCamera, PlaneScene, Simulation, motion};
use nalgebra::Isometry3;
use serde::Deserialize;

/// A camera where the run begins.
pub struct World {
    /// What looks and moves.
    pub simulation: Simulation,
    /// Its optics, as settings have them.
    pub camera: Camera,
    /// Where it starts: se(3) log coordinates of `T_desired⁻¹ T_initial`, m and degrees.
    pub displacement: [f64; 6],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct CameraTable {
    width: usize,
    height: usize,
    horizontal_fov_deg: f64,
}

impl Default for CameraTable {
    fn default() -> CameraTable {
        CameraTable { width: 128, height: 128, horizontal_fov_deg: 60.0 }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct SceneTable {
    named: String,
    width_m: f64,
    distance_m: f64,
}

impl Default for SceneTable {
    fn default() -> SceneTable {
        SceneTable { named: "astronaut".into(), width_m: 0.7, distance_m: 1.0 }
    }
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct StartTable {
    displacement: [f64; 6],
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct DisturbanceTable {
    noise_variance: f64,
}

/// Makes the world of a plan; what is random in it comes from the plan's seed.
///
/// # Errors
/// Fails, naming the table, on what is unknown or impossible.
pub fn open(plan: &RunPlan) -> anyhow::Result<World> {
    let (tables, seed) = (&plan.world, plan.seed);
    let CameraTable { width, height, horizontal_fov_deg } = table(tables, "camera")?;
    let camera = PinholeCamera::with_field_of_view(width, height, horizontal_fov_deg.to_radians())?;
    let SceneTable { named, width_m, distance_m } = table(tables, "scene")?;
    let scene = PlaneScene::new(&Photograph::bundled(&named)?.cropped_square(), width_m, distance_m)?.with_threads(1);
    let StartTable { displacement } = table(tables, "start")?;
    let DisturbanceTable { noise_variance } = table(tables, "disturbance")?;
    let disturbance = Disturbance { noise_std: noise_variance.sqrt(), seed, ..Disturbance::default() };
    let (desired, pose) = (Isometry3::identity(), motion::displacement_to_pose(displacement));
    let simulation = Simulation::new(scene, camera, desired, pose, disturbance);
    let displacement = displacement_of(&simulation);
    Ok(World { simulation, camera: settings_camera(&camera), displacement })
}

fn table<T: for<'a> Deserialize<'a> + Default>(tables: &Table, name: &'static str) -> anyhow::Result<T> {
    match tables.get(name) {
        Some(value) => T::deserialize(value.clone()).context(name),
        None => Ok(T::default()),
    }
}

fn settings_camera(camera: &PinholeCamera) -> Camera {
    let ([fx, fy], [cx, cy]) = (camera.intrinsics.focal_px(), camera.intrinsics.center_px());
    Camera { fx, fy, cx, cy, width: camera.width as u32, height: camera.height as u32, distortion: None }
}

fn displacement_of(simulation: &Simulation) -> [f64; 6] {
    let [x, y, z, a, b, c] = motion::log(&(simulation.desired.inverse() * simulation.pose));
    [x, y, z, a.to_degrees(), b.to_degrees(), c.to_degrees()]
}

/// Where the camera is, seen from where it should be, m.
pub fn position_m(simulation: &Simulation) -> [f64; 3] {
    (simulation.desired.inverse() * simulation.pose).translation.vector.into()
}
