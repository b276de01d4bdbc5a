//! Everything a simulated camera is made of, with the defaults of the demonstration.

use std::ops::RangeInclusive;
use std::time::Duration;

use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::CameraInfo;
use domvs_proto::settings::Camera;
use domvs_vision::CameraError;
use nalgebra::Isometry3;

use crate::camera::PinholeCamera;
use crate::disturbance::Disturbance;
use crate::motion::{self, EXPERIMENT_1};
use crate::packet::{DepthPacking, PixelPacking};
use crate::photograph::Photograph;
use crate::plane_scene::PlaneScene;
use crate::scene::Scene;
use crate::simulation::Simulation;
use crate::spec::World;

/// Frames a second that a schedule in nanoseconds keeps well.
const RATES_HZ: RangeInclusive<f64> = 0.01..=1000.0;

/// Frames on their way at once, at most.
const MOST_PERIODS_OF_LATENCY: u32 = 64;

/// Whose commands a camera obeys.
#[derive(Clone, Debug, PartialEq)]
pub enum Follow {
    /// Nobody's: it stands and looks.
    Nobody,
    /// One task's.
    Task(TaskKey),
    /// Any task's of this client, one at a time: while a command of one holds, the others are not heard.
    Client(Name),
}

impl Follow {
    /// Whether commands of `task` are meant for this camera.
    pub fn includes(&self, task: &TaskKey) -> bool {
        match self {
            Follow::Nobody => false,
            Follow::Task(followed) => followed == task,
            Follow::Client(client) => *client == task.client,
        }
    }
}

/// Why a simulated camera cannot be made.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum CameraSettingsError {
    /// The rate is not one that can be kept.
    #[error("expected a rate within {RATES_HZ:?} Hz, got {rate_hz} Hz")]
    Rate {
        /// The rate asked for.
        rate_hz: f64,
    },
    /// More frames would be on their way than anyone wants to keep.
    #[error("expected a latency of at most {MOST_PERIODS_OF_LATENCY} frame periods, {at_most:?}, got {latency:?}")]
    Latency {
        /// The longest at this rate.
        at_most: Duration,
        /// The latency asked for.
        latency: Duration,
    },
    /// The image has no pixels, or more than 65536 in a row or a column.
    #[error("expected an image between 1x1 and 65536x65536, got {width}x{height}")]
    Size {
        /// Pixels to the right.
        width: usize,
        /// Pixels down.
        height: usize,
    },
    /// A displacement or a disturbance is not finite, or the noise is negative.
    #[error(
        "expected finite numbers and noise of at least 0, got displacement {displacement:?}, noise {noise_std}, \
         light gain {gain} and offset {offset}"
    )]
    NotFinite {
        /// The displacement asked for.
        displacement: [f64; 6],
        /// The standard deviation of the noise asked for.
        noise_std: f64,
        /// The light's gain asked for.
        gain: f64,
        /// The light's offset asked for.
        offset: f64,
    },
    /// The field of view is impossible.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// Everything a simulated camera is made of.
#[derive(Clone, Debug)]
pub struct CameraSettings {
    /// Its name in `domvs/camera/<name>/…`.
    pub name: Name,
    /// Where its frames go; `None` is its own `domvs/camera/<name>/frame`.
    pub frame_key: Option<String>,
    /// Whose commands it obeys.
    pub follow: Follow,
    /// Frames a second.
    pub rate_hz: f64,
    /// No command holds longer than this, whatever its `valid_ms` says.
    pub patience: Duration,
    /// Pixels to the right.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Field of view over the width, rad.
    pub horizontal_fov_rad: f64,
    /// What it looks at.
    pub scene: Scene,
    /// Where the camera should be, `world_from_camera`.
    pub desired: Isometry3<f64>,
    /// Where the camera starts: m, m, m, deg, deg, deg, se(3) log coordinates of `T_desired⁻¹ T_initial`.
    pub displacement: [f64; 6],
    /// Light, noise, latency and the seed.
    pub disturbance: Disturbance,
    /// How gray is sent.
    pub pixels: PixelPacking,
    /// How depth is sent.
    pub depth: DepthPacking,
}

impl CameraSettings {
    /// The paper's experiment #1: 512x512 over 60 degrees, 0.7 m wide at 1 m, 15 frames a second, undisturbed.
    pub fn new(name: Name, photograph: Photograph) -> CameraSettings {
        let scene = PlaneScene::new(&photograph, 0.7, 1.0).expect("both lengths are positive");
        CameraSettings::looking_at(name, scene.into())
    }

    /// The camera of a world at its start number `displacement`; the rest as in [`CameraSettings::new`].
    pub fn of_world(name: Name, world: &World, displacement: u64) -> CameraSettings {
        let start = motion::log(&(world.desired.inverse() * world.start_pose(displacement)));
        let [x, y, z, a, b, c] = start;
        let half_width_px = world.camera.width as f64 / 2.0;
        CameraSettings {
            width: world.camera.width,
            height: world.camera.height,
            horizontal_fov_rad: 2.0 * (half_width_px / world.camera.intrinsics.focal_px()[0]).atan(),
            desired: world.desired,
            displacement: [x, y, z, a.to_degrees(), b.to_degrees(), c.to_degrees()],
            disturbance: world.disturbance.clone(),
            ..CameraSettings::looking_at(name, world.scene.clone())
        }
    }

    fn looking_at(name: Name, scene: Scene) -> CameraSettings {
        CameraSettings {
            name,
            frame_key: None,
            follow: Follow::Nobody,
            rate_hz: 15.0,
            patience: Duration::from_millis(500),
            width: 512,
            height: 512,
            horizontal_fov_rad: 60.0_f64.to_radians(),
            scene,
            desired: Isometry3::identity(),
            displacement: EXPERIMENT_1,
            disturbance: Disturbance::default(),
            pixels: PixelPacking::default(),
            depth: DepthPacking::default(),
        }
    }

    /// The optics alone; fails when the size or the field of view is impossible.
    pub fn camera(&self) -> Result<PinholeCamera, CameraSettingsError> {
        let (width, height) = (self.width, self.height);
        let possible = 1..=65536;
        if !possible.contains(&width) || !possible.contains(&height) {
            return Err(CameraSettingsError::Size { width, height });
        }
        Ok(PinholeCamera::with_field_of_view(width, height, self.horizontal_fov_rad)?)
    }

    /// The camera in front of its scene, in lock-step; fails when any setting is impossible.
    pub fn simulation(&self) -> Result<Simulation, CameraSettingsError> {
        let Disturbance { noise_std, gain, offset, .. } = self.disturbance;
        let displacement = self.displacement;
        let finite = displacement.iter().chain(&[noise_std, gain, offset]).all(|number| number.is_finite());
        if !finite || noise_std < 0.0 {
            return Err(CameraSettingsError::NotFinite { displacement, noise_std, gain, offset });
        }
        let pose = self.desired * motion::displacement_to_pose(displacement);
        Ok(Simulation::new(self.scene.clone(), self.camera()?, self.desired, pose, self.disturbance.clone()))
    }

    /// What the camera says of itself on the network; fails when the optics or the rate are impossible.
    pub fn info(&self) -> Result<CameraInfo, CameraSettingsError> {
        let intrinsics = self.camera()?.intrinsics;
        let ([fx, fy], [cx, cy]) = (intrinsics.focal_px(), intrinsics.center_px());
        let (width, height) = (self.width as u32, self.height as u32);
        Ok(CameraInfo {
            name: self.name.clone(),
            camera: Camera { fx, fy, cx, cy, width, height, distortion: None },
            frame_period_s: self.frame_period()?.as_secs_f64(),
            depth: self.depth != DepthPacking::None,
        })
    }

    /// Time between two frames; fails when the rate is impossible, or the latency is over 64 of these periods.
    pub fn frame_period(&self) -> Result<Duration, CameraSettingsError> {
        let (rate_hz, latency) = (self.rate_hz, self.disturbance.latency);
        if !RATES_HZ.contains(&rate_hz) {
            return Err(CameraSettingsError::Rate { rate_hz });
        }
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        let at_most = period.saturating_mul(MOST_PERIODS_OF_LATENCY);
        if latency > at_most {
            return Err(CameraSettingsError::Latency { at_most, latency });
        }
        Ok(period)
    }
}
