//! Cameras and scenes made of numbers: what the service looks at when no robot is near.
//!
//! The data's way: `TOML → spec → world`, `photograph → pyramid → scene + camera → rendering → disturbance → packet → node`,
//! and back: `command → free camera → motion → pose`. Start reading at [`WorldSpec`] (what is written), [`Simulation`]
//! (lock-step, no network) or [`node::CameraNode`] (a camera in a Zenoh session of its own).
//!
//! Rigid bodies move here by the exponential of SE(3), and rays meet planes and triangles. Nothing in this crate knows the
//! interaction matrix, so that a simulation can contradict it.

mod camera;
mod depth_disturbance;
mod disturbance;
mod free_camera;
mod light;
mod mesh;
mod mesh_file;
mod mesh_scene;
pub mod motion;
pub mod node;
mod occluder;
mod packet;
mod photograph;
mod plane_scene;
mod pyramid;
mod raster;
mod scene;
mod settings;
mod shade;
mod simulation;
pub mod spec;
mod texture;

pub use camera::PinholeCamera;
pub use depth_disturbance::{DepthDisturbance, ToldDepth};
pub use disturbance::{Disturbance, Shot};
pub use free_camera::{BrakeReason, CommandRefused, FreeCamera, Motion};
pub use light::{Light, Slope, Spot};
pub use mesh::Mesh;
pub use mesh_file::MeshFileError;
pub use mesh_scene::{Background, MeshScene, Wall};
pub use motion::PoseError;
pub use occluder::Occluder;
pub use packet::{DepthPacking, PixelPacking, mono8, pack};
pub use photograph::{Photograph, PhotographError};
pub use plane_scene::PlaneScene;
pub use scene::{Rendering, Scene, SceneError};
pub use settings::{CameraSettings, CameraSettingsError, Follow};
pub use simulation::Simulation;
pub use spec::{SpecError, World, WorldSpec};
pub use texture::Texture;
