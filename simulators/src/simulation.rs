//! The lock-step simulation: look, move, look again; no clock, no network, the same every time.

use nalgebra::Isometry3;

use crate::camera::PinholeCamera;
use crate::disturbance::Disturbance;
use crate::motion::{self, PoseError};
use crate::scene::{PlaneScene, Rendering};

/// A camera in front of a scene, displaced from where it should be.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// What is looked at.
    pub scene: PlaneScene,
    /// What looks.
    pub camera: PinholeCamera,
    /// Where the camera should be, `world_from_camera`.
    pub desired: Isometry3<f64>,
    /// Where the camera is, `world_from_camera`.
    pub pose: Isometry3<f64>,
    /// What spoils the images; its latency means nothing here.
    pub disturbance: Disturbance,
    frames: u64,
}

impl Simulation {
    /// The desired pose is the world's origin; `displacement` is m, m, m, deg, deg, deg as
    /// [`motion::displacement_to_pose`] reads it.
    pub fn new(
        scene: PlaneScene,
        camera: PinholeCamera,
        displacement: [f64; 6],
        disturbance: Disturbance,
    ) -> Simulation {
        let desired = Isometry3::identity();
        let pose = desired * motion::displacement_to_pose(displacement);
        Simulation { scene, camera, desired, pose, disturbance, frames: 0 }
    }

    /// What the camera sees from where it is; every capture has noise of its own.
    pub fn capture(&mut self) -> Rendering {
        let pose = self.pose;
        self.capture_from(&pose, self.disturbance)
    }

    /// What the camera sees from where it should be: with noise, under undisturbed light.
    pub fn capture_desired(&mut self) -> Rendering {
        let desired = self.desired;
        self.capture_from(&desired, self.disturbance.without_light())
    }

    /// Moves the camera by the constant twist (m/s, then rad/s, in its own frame) for `seconds`.
    pub fn apply(&mut self, twist: [f64; 6], seconds: f64) {
        self.pose = motion::pose_after(&self.pose, twist, seconds);
    }

    /// How far the camera is from where it should be.
    pub fn error(&self) -> PoseError {
        motion::pose_error(&self.desired, &self.pose)
    }

    fn capture_from(&mut self, pose: &Isometry3<f64>, disturbance: Disturbance) -> Rendering {
        let mut rendering = self.scene.render(&self.camera, pose);
        disturbance.apply(&mut rendering.image, self.frames);
        self.frames += 1;
        rendering
    }
}
