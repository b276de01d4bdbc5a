//! The part of glTF's JSON that is read; everything else in it is left out.

use nalgebra::{Matrix4, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    #[serde(default)]
    pub(super) scene: usize,
    #[serde(default)]
    pub(super) scenes: Vec<Scene>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<Primitives>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default)]
    pub(super) buffer_views: Vec<View>,
    #[serde(default)]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default)]
    pub(super) materials: Vec<Material>,
    #[serde(default)]
    pub(super) textures: Vec<TextureSource>,
    #[serde(default)]
    pub(super) images: Vec<Image>,
}

#[derive(Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub(super) nodes: Vec<usize>,
}

#[derive(Deserialize)]
pub(super) struct Node {
    pub(super) mesh: Option<usize>,
    #[serde(default)]
    pub(super) children: Vec<usize>,
    /// By columns.
    matrix: Option<[f64; 16]>,
    #[serde(default)]
    translation: [f64; 3],
    /// x, y, z, w.
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

impl Node {
    /// From the node's frame to its parent's.
    pub(super) fn transform(&self) -> Matrix4<f64> {
        if let Some(matrix) = self.matrix {
            return Matrix4::from_column_slice(&matrix);
        }
        let [x, y, z, w] = self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let scale = Vector3::from(self.scale.unwrap_or([1.0; 3]));
        let translation = Translation3::from(self.translation).to_homogeneous();
        translation * rotation.to_homogeneous() * Matrix4::new_nonuniform_scaling(&scale)
    }
}

#[derive(Deserialize)]
pub(super) struct Primitives {
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: Attributes,
    pub(super) indices: Option<usize>,
    pub(super) material: Option<usize>,
    #[serde(default = "triangles")]
    pub(super) mode: u32,
}

fn triangles() -> u32 {
    super::TRIANGLES
}

/// Accessors of what corners have.
#[derive(Deserialize)]
pub(super) struct Attributes {
    #[serde(rename = "POSITION")]
    pub(super) position: usize,
    #[serde(rename = "TEXCOORD_0")]
    pub(super) texture_places: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) kind: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
}

#[derive(Deserialize)]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
}

#[derive(Deserialize)]
pub(super) struct Material {
    #[serde(rename = "pbrMetallicRoughness", default)]
    pub(super) surface: SurfaceOf,
}

#[derive(Deserialize)]
#[serde(default)]
pub(super) struct SurfaceOf {
    #[serde(rename = "baseColorFactor")]
    pub(super) color: [f32; 4],
    #[serde(rename = "baseColorTexture")]
    pub(super) texture: Option<TextureIndex>,
}

impl Default for SurfaceOf {
    fn default() -> Self {
        SurfaceOf { color: [1.0; 4], texture: None }
    }
}

#[derive(Deserialize)]
pub(super) struct TextureIndex {
    pub(super) index: usize,
}

#[derive(Deserialize)]
pub(super) struct TextureSource {
    pub(super) source: Option<usize>,
}

#[derive(Deserialize)]
pub(super) struct Image {
    pub(super) uri: Option<String>,
    #[serde(rename = "bufferView")]
    pub(super) view: Option<usize>,
}
