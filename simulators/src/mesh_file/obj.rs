//! Wavefront OBJ, with the diffuse texture or colour of its MTL file.

use std::path::Path;

use nalgebra::Point3;
use tobj::{GPU_LOAD_OPTIONS, LoadOptions, Material, Model};

use super::{MeshFileError, Part, gray, project_texture};
use crate::mesh::Mesh;
use crate::photograph::Photograph;
use crate::texture::Texture;

pub(super) fn read(path: &Path) -> Result<Vec<Part>, MeshFileError> {
    // Told apart from a broken file by opening it first.
    std::fs::File::open(path).map_err(|source| MeshFileError::Unreadable { path: path.to_owned(), source })?;
    let options = LoadOptions { ignore_lines: true, ignore_points: true, ..GPU_LOAD_OPTIONS };
    let broken = |error: tobj::LoadError| MeshFileError::Broken { path: path.to_owned(), why: error.to_string() };
    let (models, materials) = tobj::load_obj(path, &options).map_err(broken)?;
    let materials = materials.map_err(broken)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    models.iter().map(|model| part(model, &materials, folder)).collect()
}

fn part(model: &Model, materials: &[Material], folder: &Path) -> Result<Part, MeshFileError> {
    let positions = model.mesh.positions.chunks_exact(3).map(|at| Point3::new(at[0], at[1], at[2])).collect();
    // OBJ counts the second coordinate from the bottom.
    let texture_places = model.mesh.texcoords.chunks_exact(2).map(|place| [place[0], 1.0 - place[1]]).collect();
    let triangles = model.mesh.indices.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect();
    let mut mesh = Mesh { positions, texture_places, triangles, convex: false };
    if mesh.texture_places.len() != mesh.positions.len() {
        project_texture(&mut mesh);
    }
    let material = model.mesh.material_id.and_then(|id| materials.get(id));
    let texture = material.map(|material| worn(material, folder)).transpose()?.flatten();
    Ok((mesh, texture))
}

fn worn(material: &Material, folder: &Path) -> Result<Option<Texture>, MeshFileError> {
    if let Some(name) = &material.diffuse_texture {
        let path = folder.join(name);
        let photograph = Photograph::open(&path).map_err(|source| MeshFileError::Texture { path, source })?;
        return Ok(Some(Texture::repeated(&photograph, [1.0; 2])));
    }
    Ok(material.diffuse.map(|color| Texture::gray(gray(color.map(|part| part as f32)))))
}
