//! Meshes from OBJ, glTF and GLB files: triangles, texture places, and the texture or colour of each part.
//!
//! The file's axes are the mesh's: a file whose y points up wants a turn of 180 degrees about x to stand upright in a camera.
//! A part without texture places is seen as if its texture were thrown on it along z. Lines, points, animations, normals,
//! transparency and all materials but the base colour are left out.

mod gltf;
mod obj;

use std::path::{Path, PathBuf};

use crate::mesh::Mesh;
use crate::photograph::PhotographError;
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
    /// The file, or one that it names, cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not what its name says.
    #[error("{}: {why}", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        why: String,
    },
    /// The file has no triangles.
    #[error("{}: expected triangles, got none", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A texture that the file names is no picture.
    #[error("{}: {source}", path.display())]
    Texture {
        /// The file.
        path: PathBuf,
        /// Why.
        source: PhotographError,
    },
}

/// A part of a file, with its own texture if it has one.
pub(crate) type Part = (Mesh, Option<Texture>);

/// The parts of a file, none without triangles; fails when it cannot be read, is broken, or has no triangles at all.
pub(crate) fn open(path: &Path) -> Result<Vec<Part>, MeshFileError> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("").to_ascii_lowercase();
    let mut parts = match extension.as_str() {
        "obj" => obj::read(path)?,
        "gltf" | "glb" => gltf::read(path)?,
        _ => return Err(MeshFileError::Unknown { path: path.to_owned() }),
    };
    parts.retain(|(mesh, _)| !mesh.triangles.is_empty());
    if parts.is_empty() {
        return Err(MeshFileError::Empty { path: path.to_owned() });
    }
    Ok(parts)
}

/// Centres the bounding box of all parts and gives it these sides, m: none leaves all as it is, one is the longest.
pub(crate) fn resize(parts: &mut [Part], sides: &[f64]) {
    let (low, high) = bounds(parts.iter().map(|(mesh, _)| mesh));
    let extent = [0, 1, 2].map(|axis| high[axis] - low[axis]);
    let longest = extent[0].max(extent[1]).max(extent[2]);
    if sides.is_empty() || longest <= 0.0 || !longest.is_finite() {
        return;
    }
    let scale = [0, 1, 2].map(|axis| match *sides {
        [side] => side / longest,
        // A flat mesh stays flat.
        [_, _, _] if extent[axis] > 0.0 => sides[axis] / extent[axis],
        _ => 1.0,
    });
    for position in parts.iter_mut().flat_map(|(mesh, _)| &mut mesh.positions) {
        for axis in 0..3 {
            position[axis] = (position[axis] - (low[axis] + high[axis]) / 2.0) * scale[axis];
        }
    }
}

/// Least and most along each axis.
fn bounds<'a>(meshes: impl Iterator<Item = &'a Mesh>) -> ([f64; 3], [f64; 3]) {
    let (mut low, mut high) = ([f64::MAX; 3], [f64::MIN; 3]);
    for position in meshes.flat_map(|mesh| &mesh.positions) {
        for axis in 0..3 {
            low[axis] = low[axis].min(position[axis]);
            high[axis] = high[axis].max(position[axis]);
        }
    }
    (low, high)
}

/// Throws the texture on the mesh along z, over its bounding box.
fn project_texture(mesh: &mut Mesh) {
    let (low, high) = bounds(std::iter::once(&*mesh));
    let part = |axis: usize, at: f64| {
        let extent = high[axis] - low[axis];
        if extent > 0.0 { (at - low[axis]) / extent } else { 0.5 }
    };
    mesh.texture_places = mesh.positions.iter().map(|at| [part(0, at.x), part(1, at.y)]).collect();
}

/// The gray of a colour.
fn gray([r, g, b]: [f32; 3]) -> f32 {
    (0.299 * r + 0.587 * g + 0.114 * b).clamp(0.0, 1.0)
}
