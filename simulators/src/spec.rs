//! A world as a TOML file: camera, scene, target, start, disturbances. Every key, its unit, default and range:
//! `docs/worlds.md`.
//!
//! The types here say what is written; `build` checks the numbers and makes what they describe. Rotations are rotation
//! vectors (axis times angle) in degrees, as in [`crate::motion::displacement_to_pose`]. Paths are relative to the folder
//! of the file. The world's frame is the desired camera's unless the target says otherwise.

mod disturbance;
mod error;
mod named;
mod object;
mod scene;
mod start;
mod target;
mod texture;

use std::path::Path;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

use crate::camera::PinholeCamera;
use crate::disturbance::Disturbance;
use crate::scene::Scene;
use crate::simulation::Simulation;

pub use disturbance::{DepthSpec, DisturbanceSpec, LightSpec, OccluderSpec, SpotSpec, ToldSpec};
pub use error::SpecError;
pub use named::named_worlds;
pub use object::{ObjectSpec, Shape};
pub use scene::{BackgroundSpec, SceneSpec};
pub use start::{RandomStart, StartSpec};
pub use target::TargetSpec;

use error::{check, finite};

/// A world as it is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldSpec {
    /// What it is called.
    pub name: String,
    /// Seed of noise and random starts.
    pub seed: u64,
    /// What looks.
    pub camera: CameraSpec,
    /// What is looked at.
    pub scene: SceneSpec,
    /// Where the camera should be.
    pub target: TargetSpec,
    /// Where it starts.
    pub start: StartSpec,
    /// What spoils its images.
    pub disturbance: DisturbanceSpec,
}

impl Default for WorldSpec {
    fn default() -> Self {
        WorldSpec {
            name: "world".to_owned(),
            seed: 1,
            camera: CameraSpec::default(),
            scene: SceneSpec::default(),
            target: TargetSpec::default(),
            start: StartSpec::default(),
            disturbance: DisturbanceSpec::default(),
        }
    }
}

/// The optics: square pixels, the principal point in the middle of the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSpec {
    /// Pixels to the right.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Field of view over the width, deg.
    pub horizontal_fov_deg: f64,
}

impl Default for CameraSpec {
    fn default() -> Self {
        CameraSpec { width: 128, height: 128, horizontal_fov_deg: 60.0 }
    }
}

impl CameraSpec {
    /// The optics; fails outside the ranges of `docs/worlds.md`.
    pub fn build(&self) -> Result<PinholeCamera, SpecError> {
        check("camera.width", self.width as f64, 8.0, 4096.0)?;
        check("camera.height", self.height as f64, 8.0, 4096.0)?;
        check("camera.horizontal_fov_deg", self.horizontal_fov_deg, 1.0, 170.0)?;
        Ok(PinholeCamera::with_field_of_view(self.width, self.height, self.horizontal_fov_deg.to_radians())?)
    }
}

impl WorldSpec {
    /// Reads TOML; fails on unknown keys and wrong types, with their line.
    pub fn from_toml(text: &str) -> Result<WorldSpec, SpecError> {
        toml::from_str(text).map_err(|error| SpecError::Toml { error: Box::new(error) })
    }

    /// As TOML, with every default written out.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("strings, numbers and tables with string keys are TOML")
    }

    /// One of [`named_worlds`]; fails for any other name.
    pub fn named(name: &str) -> Result<WorldSpec, SpecError> {
        WorldSpec::from_toml(named::text(name)?)
    }

    /// Reads a file of this format; `build` it with the file's folder. Fails when it cannot be read or is no such file.
    pub fn open(path: &Path) -> Result<WorldSpec, SpecError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| SpecError::Unreadable { path: path.to_owned(), source })?;
        WorldSpec::from_toml(&text)
    }

    /// The world that is described; `folder` is where relative paths begin. Fails when a number is out of its range, a
    /// file cannot be read, or parts contradict each other.
    pub fn build(&self, folder: &Path) -> Result<World, SpecError> {
        let camera = self.camera.build()?;
        let scene_spec = self.scene.resolved()?;
        let scene = scene_spec.build(folder)?;
        let desired = self.target.pose()?;
        let middle = scene_spec.middle(&scene, &desired)?;
        self.start.check()?;
        let disturbance = self.disturbance.build(folder, self.seed)?;
        let (name, start) = (self.name.clone(), self.start.clone());
        Ok(World { name, seed: self.seed, camera, scene, desired, middle, start, disturbance })
    }
}

/// A world that is there: what simulations are made from. Cheap to clone but for the occluders' textures.
#[derive(Clone, Debug)]
pub struct World {
    /// What it is called.
    pub name: String,
    /// Seed of noise and random starts.
    pub seed: u64,
    /// What looks.
    pub camera: PinholeCamera,
    /// What is looked at.
    pub scene: Scene,
    /// Where the camera should be, `world_from_camera`.
    pub desired: Isometry3<f64>,
    /// The point that random starts look about, in the world, m.
    pub middle: Point3<f64>,
    /// Where the camera starts.
    pub start: StartSpec,
    /// What spoils its images.
    pub disturbance: Disturbance,
}

impl World {
    /// Where the camera starts, `world_from_camera`: a function of the seed and of `displacement`, the number of a random
    /// start; a start that is not random is the same for every number.
    pub fn start_pose(&self, displacement: u64) -> Isometry3<f64> {
        self.start.pose(&self.desired, &self.middle, self.seed, displacement)
    }

    /// The camera at its start number `displacement`, with noise that is that number's own.
    pub fn simulation(&self, displacement: u64) -> Simulation {
        /// 2^64 over the golden ratio: neighbouring numbers give far seeds.
        const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
        let seed = self.seed.wrapping_add(displacement.wrapping_mul(STEP));
        let disturbance = Disturbance { seed, ..self.disturbance.clone() };
        Simulation::new(self.scene.clone(), self.camera, self.desired, self.start_pose(displacement), disturbance)
    }
}

/// A pose from a place in m and a rotation vector in deg.
fn pose_of(key: &'static str, position_m: [f64; 3], rotation_deg: [f64; 3]) -> Result<Isometry3<f64>, SpecError> {
    finite(key, &position_m)?;
    finite(key, &rotation_deg)?;
    Ok(Isometry3::new(position_m.into(), rotation_deg.map(f64::to_radians).into()))
}

/// For `skip_serializing_if`: TOML has no word for nothing.
fn is_none<T>(value: &Option<T>) -> bool {
    value.is_none()
}
