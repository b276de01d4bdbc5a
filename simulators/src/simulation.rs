//! The lock-step simulation: look, move, look again; no clock, no network, the same every time.

use domvs_vision::Plane;
use nalgebra::Isometry3;

use crate::camera::PinholeCamera;
use crate::depth_disturbance::{ToldDepth, median_depth_m};
use crate::disturbance::{Disturbance, Shot};
use crate::motion::{self, PoseError};
use crate::scene::{Rendering, Scene};

/// A camera in front of a scene, displaced from where it should be.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// What is looked at.
    pub scene: Scene,
    /// What looks.
    pub camera: PinholeCamera,
    /// Where the camera should be, `world_from_camera`.
    pub desired: Isometry3<f64>,
    /// Where the camera is, `world_from_camera`.
    pub pose: Isometry3<f64>,
    /// What spoils the images; its latency means nothing here.
    pub disturbance: Disturbance,
    told: Told,
    /// Pictures taken, of both kinds.
    frames: u64,
    /// Pictures taken from where the camera was.
    images: u64,
}

/// Where the told depth comes from.
#[derive(Clone, Debug)]
enum Told {
    Map,
    /// As the desired image was last told it.
    Desired(Plane<f32>),
    Constant {
        depth_m: f64,
    },
}

impl Simulation {
    /// A camera at `pose` that should be at `desired`, both `world_from_camera`.
    pub fn new(
        scene: impl Into<Scene>,
        camera: PinholeCamera,
        desired: Isometry3<f64>,
        pose: Isometry3<f64>,
        disturbance: Disturbance,
    ) -> Simulation {
        let scene = scene.into();
        let truth = || scene.render(&camera, &desired).true_depth;
        let told = match disturbance.depth.told {
            ToldDepth::Map => Told::Map,
            ToldDepth::Desired => Told::Desired(truth()),
            // A camera that sees nothing is told 1 m, as good as any guess.
            ToldDepth::Constant { factor } => {
                Told::Constant { depth_m: factor * median_depth_m(&truth()).unwrap_or(1.0) }
            }
        };
        Simulation { scene, camera, desired, pose, disturbance, told, frames: 0, images: 0 }
    }

    /// What the camera sees from where it is; every capture has noise of its own and counts as one image.
    pub fn capture(&mut self) -> Rendering {
        let pose = self.pose;
        let mut rendering = Rendering::blank(&self.camera);
        self.capture_from(&pose, &mut rendering);
        rendering
    }

    /// What the camera would see from `pose` (`world_from_camera`), into planes that are already there; it counts as one
    /// image, and the camera stays where it is.
    pub fn capture_from(&mut self, pose: &Isometry3<f64>, rendering: &mut Rendering) {
        self.scene.render_into(&self.camera, pose, rendering);
        self.tell(rendering);
        self.disturb(rendering, Shot::Current { image: self.images });
        self.images += 1;
    }

    /// What the camera sees from where it should be: with noise if that is wanted, under undisturbed light, unhidden.
    pub fn capture_desired(&mut self) -> Rendering {
        let mut rendering = self.scene.render(&self.camera, &self.desired);
        if let Told::Constant { .. } = self.told {
            self.tell(&mut rendering);
        }
        self.disturb(&mut rendering, Shot::Desired);
        if let Told::Desired(depth) = &mut self.told {
            depth.clone_from(&rendering.depth);
        }
        rendering
    }

    /// The one depth that the law is told, m, if it is told a constant.
    pub fn constant_depth_m(&self) -> Option<f64> {
        match self.told {
            Told::Constant { depth_m } => Some(depth_m),
            _ => None,
        }
    }

    /// Images captured from where the camera was, so far; the number of the next one.
    pub fn images(&self) -> u64 {
        self.images
    }

    /// Moves the camera by the constant twist (m/s, then rad/s, in its own frame) for `seconds`.
    pub fn apply(&mut self, twist: [f64; 6], seconds: f64) {
        self.pose = motion::pose_after(&self.pose, twist, seconds);
    }

    /// How far the camera is from where it should be.
    pub fn error(&self) -> PoseError {
        motion::pose_error(&self.desired, &self.pose)
    }

    fn tell(&self, rendering: &mut Rendering) {
        match &self.told {
            Told::Map => {}
            Told::Desired(depth) => rendering.depth.clone_from(depth),
            Told::Constant { depth_m } => rendering.depth.samples_mut().fill(*depth_m as f32),
        }
    }

    /// Noise and holes are those of a depth camera: a number, or the desired image's map, has no more of them.
    fn disturb(&mut self, rendering: &mut Rendering, shot: Shot) {
        let measured = match (&self.told, shot) {
            (Told::Map, _) | (Told::Desired(_), Shot::Desired) => true,
            (Told::Desired(_), Shot::Current { .. }) | (Told::Constant { .. }, _) => false,
        };
        self.disturbance.apply_to_gray(&mut rendering.image, shot, self.frames);
        if measured {
            self.disturbance.apply_to_depth(&mut rendering.depth, self.frames);
        }
        self.frames += 1;
    }
}
