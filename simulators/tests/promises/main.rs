//! What this crate promises, in one binary: a file for each subject.

mod disturbance;
mod free_camera;
mod light;
mod mesh_files;
mod motion;
mod node;
mod photographs;
mod rasteriser;
mod rendering;
mod simulation;
mod worlds;
