//! Rigid motion: the exponential and the logarithm of SE(3), and how far two poses are apart.
//!
//! A pose is `world_from_camera`. A twist `xi = (v, w)` is the camera's own velocity in its own optical frame, so
//! it multiplies from the right: `pose(t + dt) = pose(t) exp(xi dt)`, exactly, for any `dt` over which it is constant.
//! With `W = [w]x` and `theta = |w|`:
//!
//! ```text
//! exp(v, w) = (R, V v)    R = exp(W)    V = I + (1 - cos theta)/theta² W + (theta - sin theta)/theta³ W²
//! V⁻¹ = I - W/2 + (1 - theta/2 cot(theta/2))/theta² W²
//! ```

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// The displacement of the paper's experiment #1: m, m, m, deg, deg, deg, as [`displacement_to_pose`] reads it.
pub const EXPERIMENT_1: [f64; 6] = [0.48, -0.26, -0.37, -4.54, -17.06, -30.37];

/// How far two poses are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Distance between the optical centres, mm.
    pub mm: f64,
    /// Angle of the rotation that is left, deg.
    pub deg: f64,
}

impl PoseError {
    /// Nearer than 1 mm and 0.1 degrees: the camera is there.
    pub fn is_converged(&self) -> bool {
        self.mm < 1.0 && self.deg < 0.1
    }
}

/// The pose after `seconds` of the constant camera twist (m/s, then rad/s) in the camera's own frame.
pub fn pose_after(pose: &Isometry3<f64>, twist: [f64; 6], seconds: f64) -> Isometry3<f64> {
    let mut after = pose * exp(twist.map(|component| component * seconds));
    after.rotation.renormalize();
    after
}

/// `exp`: se(3) coordinates `(v, w)`, m and rad, to the rigid motion they generate.
pub fn exp(xi: [f64; 6]) -> Isometry3<f64> {
    let (v, w) = halves(xi);
    let theta = w.norm();
    // Below this the series is exact to f64: the next terms are theta⁴/720 and theta⁴/5040.
    let (a, b) = if theta < 1e-3 {
        (0.5 - theta * theta / 24.0, 1.0 / 6.0 - theta * theta / 120.0)
    } else {
        // 1 - cos theta, without the cancellation.
        (2.0 * (theta / 2.0).sin().powi(2) / theta.powi(2), (theta - theta.sin()) / theta.powi(3))
    };
    let w_v = w.cross(&v);
    let translation = v + a * w_v + b * w.cross(&w_v);
    Isometry3::from_parts(Translation3::from(translation), UnitQuaternion::from_scaled_axis(w))
}

/// `log`: the se(3) coordinates `(v, w)` of a rigid motion, with `|w|` at most pi.
pub fn log(motion: &Isometry3<f64>) -> [f64; 6] {
    let w = motion.rotation.scaled_axis();
    let t = motion.translation.vector;
    let theta = w.norm();
    let c = if theta < 1e-3 {
        1.0 / 12.0 + theta * theta / 720.0
    } else {
        (1.0 - theta / 2.0 / (theta / 2.0).tan()) / theta.powi(2)
    };
    let w_t = w.cross(&t);
    let v = t - 0.5 * w_t + c * w.cross(&w_t);
    [v.x, v.y, v.z, w.x, w.y, w.z]
}

/// `T_desired⁻¹ T_initial` from its se(3) log coordinates: translation part in m, rotation vector in degrees.
pub fn displacement_to_pose(displacement: [f64; 6]) -> Isometry3<f64> {
    let [x, y, z, a, b, c] = displacement;
    exp([x, y, z, a.to_radians(), b.to_radians(), c.to_radians()])
}

/// How far `pose` is from `desired`, both `world_from_camera`.
pub fn pose_error(desired: &Isometry3<f64>, pose: &Isometry3<f64>) -> PoseError {
    let left = desired.inverse() * pose;
    PoseError { mm: left.translation.vector.norm() * 1e3, deg: left.rotation.angle().to_degrees() }
}

fn halves([x, y, z, a, b, c]: [f64; 6]) -> (Vector3<f64>, Vector3<f64>) {
    (Vector3::new(x, y, z), Vector3::new(a, b, c))
}
