//! Cameras and scenes made of numbers: what the service looks at when no robot is near.
//!
//! The data's way: `photograph → pyramid → scene + camera → rendering → disturbance → packet → node`,
//! and back: `command → free camera → motion → pose`. Start reading at [`Simulation`] (lock-step, no network)
//! or at [`node::CameraNode`] (a camera in a Zenoh session of its own).
//!
//! Rigid bodies move here by the exponential of SE(3) and rays meet planes. Nothing in this crate knows the
//! interaction matrix, so that a simulation can contradict it.

mod camera;
mod disturbance;
mod free_camera;
pub mod motion;
pub mod node;
mod packet;
mod photograph;
mod pyramid;
mod scene;
mod settings;
mod simulation;

pub use camera::PinholeCamera;
pub use disturbance::Disturbance;
pub use free_camera::{BrakeReason, CommandRefused, FreeCamera, Motion};
pub use motion::PoseError;
pub use packet::{DepthPacking, PixelPacking, mono8, pack};
pub use photograph::{Photograph, PhotographError};
pub use scene::{PlaneScene, Rendering, SceneError};
pub use settings::{CameraSettings, CameraSettingsError, Follow};
pub use simulation::Simulation;
