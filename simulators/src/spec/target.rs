//! Where the camera should be.

use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::error::{SpecError, finite};
use super::is_none;
use crate::motion;

/// Where the camera should be: the world's origin, or by a displacement from it, or by what it looks at.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetSpec {
    /// m, m, m, deg, deg, deg: se(3) log coordinates of `world_from_camera`.
    #[serde(skip_serializing_if = "is_none")]
    pub displacement: Option<[f64; 6]>,
    /// The camera's place in the world, m; goes with `look_at_m`.
    #[serde(skip_serializing_if = "is_none")]
    pub position_m: Option<[f64; 3]>,
    /// What is in the middle of its image, m.
    #[serde(skip_serializing_if = "is_none")]
    pub look_at_m: Option<[f64; 3]>,
    /// How far the camera is turned about its optical axis from upright (the world's y down), deg; goes with `look_at_m`.
    #[serde(skip_serializing_if = "is_none")]
    pub roll_deg: Option<f64>,
}

impl TargetSpec {
    /// The pose, `world_from_camera`; fails when two ways are mixed, numbers are not finite, or there is no direction.
    pub fn pose(&self) -> Result<Isometry3<f64>, SpecError> {
        match (self.displacement, self.position_m, self.look_at_m, self.roll_deg) {
            (None, None, None, None) => Ok(Isometry3::identity()),
            (Some(displacement), None, None, None) => {
                finite("target.displacement", &displacement)?;
                Ok(motion::displacement_to_pose(displacement))
            }
            (None, Some(position), Some(look_at), roll) => upright(position, look_at, roll.unwrap_or(0.0)),
            _ => Err(SpecError::Contradiction {
                key: "target",
                expected: "nothing, displacement alone, or position_m and look_at_m with or without roll_deg",
                got: format!("{self:?}"),
            }),
        }
    }
}

/// Looks from `position` at `look_at` with the world's y downwards in the image, then rolled.
fn upright(position_m: [f64; 3], look_at_m: [f64; 3], roll_deg: f64) -> Result<Isometry3<f64>, SpecError> {
    finite("target.position_m", &position_m)?;
    finite("target.look_at_m", &look_at_m)?;
    finite("target.roll_deg", &[roll_deg])?;
    let position = Vector3::from(position_m);
    let forward = Vector3::from(look_at_m) - position;
    let right = Vector3::y().cross(&forward);
    if right.norm() <= 1e-9 * forward.norm() || forward.norm() == 0.0 {
        return Err(SpecError::Contradiction {
            key: "target.look_at_m",
            expected: "a point that is neither at, above nor below position_m",
            got: format!("{look_at_m:?} from {position_m:?}"),
        });
    }
    let (x, z) = (right.normalize(), forward.normalize());
    let rotation = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_deg.to_radians());
    Ok(Isometry3::from_parts(Translation3::from(position), UnitQuaternion::from_rotation_matrix(&rotation) * roll))
}
