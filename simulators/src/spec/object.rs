//! A textured thing, as it is written.

use std::path::{Path, PathBuf};

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::error::{SpecError, check};
use super::{is_none, pose_of, texture};
use crate::mesh::Mesh;
use crate::mesh_file;
use crate::texture::Texture;

/// A textured thing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectSpec {
    /// What it is.
    pub shape: Shape,
    /// Its sides, m: two of a plane, three of a box, a ball or a cylinder; of a height field width, height and rise; of a mesh none (as the file
    /// has it), one (its longest side) or three.
    pub size_m: Vec<f64>,
    /// Where its middle is, m; of a mesh without a size, where the file's origin is.
    pub position_m: [f64; 3],
    /// How it is turned, rotation vector, deg.
    pub rotation_deg: [f64; 3],
    /// What it wears: a bundled photograph, `noise`, or a file; each face of a box wears all of it.
    #[serde(skip_serializing_if = "is_none")]
    pub texture: Option<String>,
    /// Seed of `noise`.
    #[serde(skip_serializing_if = "is_none")]
    pub texture_seed: Option<u64>,
    /// Whether only the largest square about the texture's middle is used.
    pub crop_square: bool,
    /// How often the texture is repeated to the right and down.
    #[serde(skip_serializing_if = "is_none")]
    pub repeat: Option<[f64; 2]>,
    /// One gray in [0, 1] instead of a texture.
    #[serde(skip_serializing_if = "is_none")]
    pub gray: Option<f64>,
    /// Of a mesh: an OBJ, glTF or GLB file.
    #[serde(skip_serializing_if = "is_none")]
    pub file: Option<PathBuf>,
    /// Of a height field: the picture whose gray is its height, like `texture`.
    #[serde(skip_serializing_if = "is_none")]
    pub heights: Option<String>,
    /// Seed of `noise` for the heights.
    #[serde(skip_serializing_if = "is_none")]
    pub heights_seed: Option<u64>,
    /// Squares along each side of a height field.
    #[serde(skip_serializing_if = "is_none")]
    pub cells: Option<usize>,
}

/// What an object is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// A rectangle that faces -z.
    #[default]
    Plane,
    /// Six rectangles.
    Box,
    /// A ball or an ellipsoid, its poles on its z axis.
    Ball,
    /// A cylinder along its z axis.
    Cylinder,
    /// A rectangle with heights towards -z.
    HeightField,
    /// What a file holds.
    Mesh,
}

impl ObjectSpec {
    /// Squares along each side of a height field that does not say.
    pub const CELLS: usize = 48;

    /// The meshes, in the world, with what they wear; `frame` is where the scene is.
    pub(super) fn build(&self, frame: &Isometry3<f64>, folder: &Path) -> Result<Vec<(Mesh, Texture)>, SpecError> {
        self.check_keys()?;
        let pose = frame * pose_of("scene.objects", self.position_m, self.rotation_deg)?;
        self.size_m.iter().try_for_each(|&side| check("scene.objects.size_m", side, 1e-6, 1000.0))?;
        let worn = self.worn(folder)?;
        let parts = match (self.shape, self.size_m.as_slice()) {
            (Shape::Plane, &[width, height]) => vec![(Mesh::plane([width, height]), None)],
            (Shape::Box, &[width, height, depth]) => vec![(Mesh::cuboid([width, height, depth]), None)],
            (Shape::Ball, &[width, height, depth]) => vec![(Mesh::ellipsoid([width, height, depth]), None)],
            (Shape::Cylinder, &[width, height, depth]) => vec![(Mesh::cylinder([width, height, depth]), None)],
            (Shape::HeightField, &[width, height, rise]) => {
                vec![(self.height_field([width, height, rise], folder)?, None)]
            }
            (Shape::Mesh, sides @ ([] | [_] | [_, _, _])) => self.mesh(sides, folder)?,
            (shape, sides) => {
                return Err(SpecError::Contradiction {
                    key: "scene.objects.size_m",
                    expected: "2 sides of a plane, 0, 1 or 3 of a mesh, 3 of all else",
                    got: format!("{} of a {shape:?}", sides.len()),
                });
            }
        };
        let unworn = Texture::gray(0.5);
        let dress = |own: Option<Texture>| worn.clone().or(own).unwrap_or_else(|| unworn.clone());
        Ok(parts.into_iter().map(|(mesh, own)| (mesh.placed(&pose), dress(own))).collect())
    }

    /// Fails on keys that mean nothing for this shape.
    fn check_keys(&self) -> Result<(), SpecError> {
        let heights = self.heights.is_some() || self.heights_seed.is_some() || self.cells.is_some();
        let (is_mesh, is_field) = (self.shape == Shape::Mesh, self.shape == Shape::HeightField);
        if self.file.is_some() != is_mesh || (heights && !is_field) {
            return Err(SpecError::Contradiction {
                key: "scene.objects",
                expected: "file with shape = \"mesh\" and only there, heights and cells only with \"height_field\"",
                got: format!("{self:?}"),
            });
        }
        Ok(())
    }

    fn worn(&self, folder: &Path) -> Result<Option<Texture>, SpecError> {
        match (&self.texture, self.gray) {
            (Some(name), None) => {
                let key = "scene.objects.texture";
                let mut photograph = texture::photograph(key, name, self.texture_seed.unwrap_or(1), folder)?;
                if self.crop_square {
                    photograph = photograph.cropped_square();
                }
                let Some(times) = self.repeat else {
                    return Ok(Some(Texture::once(&photograph)));
                };
                times.iter().try_for_each(|&times| check("scene.objects.repeat", times, 0.01, 1000.0))?;
                Ok(Some(Texture::repeated(&photograph, times)))
            }
            (None, Some(gray)) => {
                check("scene.objects.gray", gray, 0.0, 1.0)?;
                Ok(Some(Texture::gray(gray as f32)))
            }
            (None, None) if self.shape == Shape::Mesh => Ok(None),
            (texture, gray) => Err(SpecError::Contradiction {
                key: "scene.objects",
                expected: "texture or gray",
                got: format!("{texture:?} and {gray:?}"),
            }),
        }
    }

    fn height_field(&self, size_m: [f64; 3], folder: &Path) -> Result<Mesh, SpecError> {
        let cells = self.cells.unwrap_or(ObjectSpec::CELLS);
        check("scene.objects.cells", cells as f64, 1.0, 1024.0)?;
        let (name, seed) = (self.heights.as_deref().unwrap_or("noise"), self.heights_seed.unwrap_or(1));
        let heights = texture::photograph("scene.objects.heights", name, seed, folder)?;
        Ok(Mesh::height_field(size_m, heights.gray(), cells))
    }

    fn mesh(&self, sides: &[f64], folder: &Path) -> Result<Vec<(Mesh, Option<Texture>)>, SpecError> {
        let file = self.file.as_deref().unwrap_or(Path::new(""));
        let mut parts = mesh_file::open(&folder.join(file))?;
        mesh_file::resize(&mut parts, sides);
        Ok(parts)
    }
}
