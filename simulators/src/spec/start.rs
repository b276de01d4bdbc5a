//! Where the camera starts: one displacement, or seeded ones.
//!
//! Random start `n` of seed `s` is a function of the two alone. In the frame of the desired camera: the translation is
//! uniform in three ranges, times `scale`; the camera then looks, by the smallest turn of its axis, at a point uniform in
//! a disc of radius `look_within_m` about the scene's middle, parallel to the desired image; last it rolls about its own
//! axis, uniform in `±roll_deg`.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};

use super::error::{SpecError, check, finite};
use super::is_none;
use crate::motion::{self, EXPERIMENT_1};

/// Keeps the numbers of starts apart from those of noise.
const START_SEED: u64 = 0x7374_6172_7473_2e2e;

/// Where the camera starts; nothing is the paper's experiment #1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartSpec {
    /// m, m, m, deg, deg, deg: se(3) log coordinates of `T_desired⁻¹ T_initial`.
    #[serde(skip_serializing_if = "is_none")]
    pub displacement: Option<[f64; 6]>,
    /// Instead: anywhere in these ranges.
    #[serde(skip_serializing_if = "is_none")]
    pub random: Option<RandomStart>,
}

/// The ranges of random starts; the default is the base set of the sweeps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RandomStart {
    /// Least and most along x, y and z of the desired camera, m.
    pub translation_m: [[f64; 2]; 3],
    /// Factor of the translation.
    pub scale: f64,
    /// Most that the camera rolls to either side, deg.
    pub roll_deg: f64,
    /// How far from the middle of the scene its axis points at most, m.
    pub look_within_m: f64,
}

impl Default for RandomStart {
    fn default() -> Self {
        RandomStart {
            translation_m: [[-0.5, 0.5], [-0.4, 0.4], [-0.4, 0.1]],
            scale: 1.0,
            roll_deg: 35.0,
            look_within_m: 0.15,
        }
    }
}

impl StartSpec {
    /// Random starts in these ranges.
    pub fn random(random: RandomStart) -> StartSpec {
        StartSpec { displacement: None, random: Some(random) }
    }

    /// Fails when both ways are given, a number is not finite, or a range is empty.
    pub fn check(&self) -> Result<(), SpecError> {
        match (&self.displacement, &self.random) {
            (None, None) => Ok(()),
            (Some(displacement), None) => finite("start.displacement", displacement),
            (None, Some(random)) => random.check(),
            (Some(displacement), Some(_)) => Err(SpecError::Contradiction {
                key: "start",
                expected: "displacement or random",
                got: format!("displacement {displacement:?} and random"),
            }),
        }
    }

    /// Start number `number` of `seed`, `world_from_camera`; `middle` is the scene's, in the world.
    pub fn pose(&self, desired: &Isometry3<f64>, middle: &Point3<f64>, seed: u64, number: u64) -> Isometry3<f64> {
        match &self.random {
            Some(random) => desired * random.pose(&(desired.inverse() * middle), seed, number),
            None => desired * motion::displacement_to_pose(self.displacement.unwrap_or(EXPERIMENT_1)),
        }
    }
}

impl RandomStart {
    fn check(&self) -> Result<(), SpecError> {
        for [least, most] in self.translation_m {
            finite("start.random.translation_m", &[least, most])?;
            if least > most {
                return Err(SpecError::Contradiction {
                    key: "start.random.translation_m",
                    expected: "three ranges [least, most]",
                    got: format!("{:?}", self.translation_m),
                });
            }
        }
        check("start.random.scale", self.scale, 0.0, 100.0)?;
        check("start.random.roll_deg", self.roll_deg, 0.0, 180.0)?;
        check("start.random.look_within_m", self.look_within_m, 0.0, 100.0)
    }

    /// `desired_from_initial`; `middle` in the desired camera's frame.
    fn pose(&self, middle: &Point3<f64>, seed: u64, number: u64) -> Isometry3<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ START_SEED);
        rng.set_stream(number);
        let mut uniform = |least: f64, most: f64| least + (most - least) * rng.r#gen::<f64>();
        let position = Vector3::from(self.translation_m.map(|[least, most]| self.scale * uniform(least, most)));
        let angle = uniform(0.0, TAU);
        // The square root makes the disc uniform.
        let radius = self.look_within_m * uniform(0.0, 1.0).sqrt();
        let roll = uniform(-self.roll_deg, self.roll_deg).to_radians();
        let look_at = middle.coords + Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.0);
        // A camera that stands on the point, or straight beyond it, keeps its direction.
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &(look_at - position)).unwrap_or_default();
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
        Isometry3::from_parts(Translation3::from(position), turn * roll)
    }
}
