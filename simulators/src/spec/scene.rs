//! What is looked at, as it is written.

use std::path::Path;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

use super::error::{SpecError, check, finite};
use super::object::ObjectSpec;
use super::{WorldSpec, is_none, pose_of, texture};
use crate::camera::PinholeCamera;
use crate::mesh_scene::{Background, MeshScene, Wall};
use crate::photograph::Photograph;
use crate::plane_scene::PlaneScene;
use crate::scene::Scene;

/// What is looked at: a named scene, or objects in front of a background.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneSpec {
    /// The scene of this named world; then nothing else is said of the scene but its middle.
    #[serde(skip_serializing_if = "is_none")]
    pub named: Option<String>,
    /// Where the frame of the objects is in the world, m.
    pub position_m: [f64; 3],
    /// How it is turned, rotation vector, deg.
    pub rotation_deg: [f64; 3],
    /// The point that random starts look about, in the frame of the objects, m; by default where the desired camera's axis
    /// meets the scene.
    #[serde(skip_serializing_if = "is_none")]
    pub middle_m: Option<[f64; 3]>,
    /// What is behind the objects.
    pub background: BackgroundSpec,
    /// Textured things; their frame is the scene's.
    pub objects: Vec<ObjectSpec>,
}

/// What is behind the objects: one gray without depth, or a wall that faces the world's origin.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BackgroundSpec {
    /// Gray in [0, 1]; of a wall, the gray beyond its photograph.
    pub gray: f64,
    /// What hangs on the wall: a bundled photograph, `noise`, or a file.
    #[serde(skip_serializing_if = "is_none")]
    pub photograph: Option<String>,
    /// Seed of `noise`.
    #[serde(skip_serializing_if = "is_none")]
    pub photograph_seed: Option<u64>,
    /// Whether only the largest square about the photograph's middle is used.
    pub crop_square: bool,
    /// How wide the photograph is, m.
    #[serde(skip_serializing_if = "is_none")]
    pub width_m: Option<f64>,
    /// At which z of the world the wall is, m.
    #[serde(skip_serializing_if = "is_none")]
    pub distance_m: Option<f64>,
}

impl SceneSpec {
    /// This scene, or the one it names; fails when it names one and says more.
    pub fn resolved(&self) -> Result<SceneSpec, SpecError> {
        let Some(name) = &self.named else {
            return Ok(self.clone());
        };
        let own = SceneSpec { named: None, middle_m: None, ..self.clone() };
        if own != SceneSpec::default() {
            return Err(SpecError::Contradiction {
                key: "scene.named",
                expected: "a named scene, or objects and background of its own",
                got: format!("{name:?} and more"),
            });
        }
        let scene = WorldSpec::named(name)?.scene;
        Ok(SceneSpec { middle_m: self.middle_m.or(scene.middle_m), ..scene })
    }

    /// The scene; `folder` is where relative paths begin. Fails like [`WorldSpec::build`].
    pub fn build(&self, folder: &Path) -> Result<Scene, SpecError> {
        let spec = self.resolved()?;
        let frame = pose_of("scene", spec.position_m, spec.rotation_deg)?;
        let background = spec.background.build(folder)?;
        if spec.objects.is_empty()
            && let Background { gray: 0.0, wall: Some(wall) } = &background
        {
            return Ok(PlaneScene::new(&wall.photograph, wall.width_m, wall.distance_m)?.into());
        }
        let objects = spec.objects.iter().map(|object| object.build(&frame, folder));
        let objects: Vec<_> = objects.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();
        Ok(MeshScene::new(&objects, &background)?.into())
    }

    /// The point that random starts look about, in the world: as said, or where the axis of the desired camera meets the
    /// scene, or 1 m ahead when it meets nothing.
    pub fn middle(&self, scene: &Scene, desired: &Isometry3<f64>) -> Result<Point3<f64>, SpecError> {
        let spec = self.resolved()?;
        if let Some(middle) = spec.middle_m {
            finite("scene.middle_m", &middle)?;
            return Ok(pose_of("scene", spec.position_m, spec.rotation_deg)? * Point3::from(middle));
        }
        // One pixel, whose centre is on the axis.
        let camera = PinholeCamera::with_field_of_view(1, 1, 0.01)?;
        let depth_m = f64::from(scene.render(&camera, desired).true_depth.at(0, 0));
        Ok(desired * Point3::new(0.0, 0.0, if depth_m > 0.0 { depth_m } else { 1.0 }))
    }
}

impl BackgroundSpec {
    fn build(&self, folder: &Path) -> Result<Background, SpecError> {
        check("scene.background.gray", self.gray, 0.0, 1.0)?;
        let gray = self.gray as f32;
        let Some(distance_m) = self.distance_m else {
            if let Some(name) = &self.photograph {
                let (expected, got) = ("distance_m with a photograph", format!("{name:?} without"));
                return Err(SpecError::Contradiction { key: "scene.background", expected, got });
            }
            return Ok(Background { gray, wall: None });
        };
        let (photograph, width_m) = match (&self.photograph, self.width_m) {
            (Some(name), Some(width_m)) => {
                let key = "scene.background.photograph";
                let photograph = texture::photograph(key, name, self.photograph_seed.unwrap_or(1), folder)?;
                (if self.crop_square { photograph.cropped_square() } else { photograph }, width_m)
            }
            (None, None) => (Photograph::one_gray(gray), 1.0),
            (photograph, width) => {
                let (expected, got) = ("photograph and width_m, or neither", format!("{photograph:?} and {width:?}"));
                return Err(SpecError::Contradiction { key: "scene.background", expected, got });
            }
        };
        check("scene.background.width_m", width_m, 0.001, 1000.0)?;
        check("scene.background.distance_m", distance_m, 0.001, 1000.0)?;
        Ok(Background { gray, wall: Some(Wall { photograph, width_m, distance_m }) })
    }
}
