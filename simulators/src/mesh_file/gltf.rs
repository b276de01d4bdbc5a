//! glTF 2.0, as JSON with its buffers beside it or within, or as one GLB file.
//! <https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html>
//!
//! Read here are triangles, the first texture coordinates, node transforms, and base colour: a few dozen lines of the
//! standard. Sparse accessors and compressed buffers are refused.

mod accessor;
mod document;

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Matrix4, Point3};

use self::document::{Document, Material, Primitive};
use super::{MeshFileError, Part, gray, project_texture};
use crate::mesh::Mesh;
use crate::photograph::Photograph;
use crate::texture::Texture;

/// `mode` of a primitive made of separate triangles.
const TRIANGLES: u32 = 4;

pub(super) fn read(path: &Path) -> Result<Vec<Part>, MeshFileError> {
    let bytes = bytes_of(path)?;
    let (json, binary) = split(&bytes).map_err(|why| broken(path, why))?;
    let document: Document = serde_json::from_slice(json).map_err(|error| broken(path, error.to_string()))?;
    let buffers = buffers(&document, binary, path)?;
    Reader { path, document, buffers }.parts()
}

struct Reader<'a> {
    path: &'a Path,
    document: Document,
    buffers: Vec<Vec<u8>>,
}

impl Reader<'_> {
    /// The meshes below the nodes of the scene, each in the scene's frame.
    fn parts(&self) -> Result<Vec<Part>, MeshFileError> {
        let nodes = &self.document.nodes;
        let scene = self.document.scenes.get(self.document.scene);
        let mut waiting: Vec<(usize, Matrix4<f64>)> =
            scene.iter().flat_map(|scene| &scene.nodes).rev().map(|&node| (node, Matrix4::identity())).collect();
        let (mut parts, mut visits) = (vec![], 0);
        while let Some((index, above)) = waiting.pop() {
            visits += 1;
            let node = nodes.get(index).ok_or_else(|| self.missing("node", index))?;
            if visits > nodes.len() {
                return Err(broken(self.path, "a node with two parents".to_owned()));
            }
            let pose = above * node.transform();
            waiting.extend(node.children.iter().rev().map(|&child| (child, pose)));
            if let Some(index) = node.mesh {
                let mesh = self.document.meshes.get(index).ok_or_else(|| self.missing("mesh", index))?;
                for primitive in mesh.primitives.iter().filter(|primitive| primitive.mode == TRIANGLES) {
                    parts.push(self.part(primitive, &pose)?);
                }
            }
        }
        Ok(parts)
    }

    fn part(&self, primitive: &Primitive, pose: &Matrix4<f64>) -> Result<Part, MeshFileError> {
        let attributes = &primitive.attributes;
        let positions = self.numbers::<3>(attributes.position)?;
        let positions: Vec<_> = positions.into_iter().map(|at| pose.transform_point(&Point3::from(at))).collect();
        let corners: Vec<u32> = match primitive.indices {
            Some(accessor) => self.numbers::<1>(accessor)?.into_iter().map(|[corner]| corner as u32).collect(),
            None => (0..positions.len() as u32).collect(),
        };
        let triangles = corners.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect();
        let places = attributes.texture_places.map(|accessor| self.numbers::<2>(accessor)).transpose()?;
        let mut mesh = Mesh { positions, texture_places: places.unwrap_or_default(), triangles, convex: false };
        if mesh.texture_places.len() != mesh.positions.len() {
            project_texture(&mut mesh);
        }
        let material = match primitive.material {
            Some(index) => self.document.materials.get(index).ok_or_else(|| self.missing("material", index))?,
            None => return Ok((mesh, None)),
        };
        Ok((mesh, Some(self.worn(material)?)))
    }

    fn worn(&self, material: &Material) -> Result<Texture, MeshFileError> {
        let surface = &material.surface;
        let Some(texture) = &surface.texture else {
            let [r, g, b, _] = surface.color;
            return Ok(Texture::gray(gray([r, g, b])));
        };
        let source = self.document.textures.get(texture.index).and_then(|texture| texture.source);
        let image = source.and_then(|source| self.document.images.get(source));
        let image = image.ok_or_else(|| self.missing("texture", texture.index))?;
        let bytes = match (&image.uri, image.view) {
            (Some(uri), _) => resource(self.path, uri)?,
            (None, Some(view)) => self.view(view)?.0.to_vec(),
            (None, None) => return Err(self.missing("texture", texture.index)),
        };
        let photograph = Photograph::decode(&bytes)
            .map_err(|source| MeshFileError::Texture { path: self.path.to_owned(), source })?;
        Ok(Texture::repeated(&photograph, [1.0; 2]))
    }

    fn missing(&self, what: &str, index: usize) -> MeshFileError {
        broken(self.path, format!("{what} {index} is not there"))
    }
}

/// The JSON and the binary part of a GLB file, or all of a file that is none.
fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let mut chunks = vec![];
    // Magic, version, length; then chunks of length, type and content.
    let mut rest = bytes.get(12..).ok_or("a GLB file of less than 12 bytes")?;
    while let Some((head, after)) = rest.split_at_checked(8) {
        let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let (chunk, after) = after
            .split_at_checked(length)
            .ok_or_else(|| format!("expected a chunk of {length} bytes, got {}", after.len()))?;
        chunks.push(chunk);
        rest = after;
    }
    let json = chunks.first().ok_or("a GLB file without a chunk")?;
    Ok((json, chunks.get(1).copied()))
}

fn buffers(document: &Document, binary: Option<&[u8]>, path: &Path) -> Result<Vec<Vec<u8>>, MeshFileError> {
    let bytes = |index: usize| match (&document.buffers[index].uri, binary) {
        (Some(uri), _) => resource(path, uri),
        (None, Some(binary)) if index == 0 => Ok(binary.to_vec()),
        _ => Err(broken(path, format!("buffer {index} is not there"))),
    };
    (0..document.buffers.len()).map(bytes).collect()
}

/// What a URI names: base64 in itself, or a file beside this one.
fn resource(path: &Path, uri: &str) -> Result<Vec<u8>, MeshFileError> {
    let Some(data) = uri.strip_prefix("data:") else {
        return bytes_of(&path.with_file_name(uri));
    };
    let text = data.split_once(";base64,").map(|(_, text)| text);
    let bytes = text.and_then(|text| STANDARD.decode(text).ok());
    bytes.ok_or_else(|| broken(path, "expected data URIs in base64".to_owned()))
}

fn bytes_of(path: &Path) -> Result<Vec<u8>, MeshFileError> {
    std::fs::read(path).map_err(|source| MeshFileError::Unreadable { path: path.to_owned(), source })
}

fn broken(path: &Path, why: String) -> MeshFileError {
    MeshFileError::Broken { path: path.to_owned(), why }
}
