//! The rows of a run: one per image that was answered.

use domvs_proto::twist::TwistMessage;
use domvs_simulators::PoseError;

/// One image of a run and the answer to it. A number that does not apply is NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct RunRow {
    /// Counts from 0.
    pub image: u64,
    /// Since the first image, on the run's own clock: simulated in lock-step, real when streaming.
    pub time_s: f64,
    /// As the service answered: 3 × m/s, then 3 × rad/s, camera frame.
    pub twist: [f64; 6],
    /// The status word of the answer, for example `servoing`.
    pub status: String,
    /// The largest n + m in use; 0 where none was.
    pub order: usize,
    /// Hahn: ax, bx, ay, by; Krawtchouk: p_x, p_y; otherwise, or where unknown, empty.
    pub window: Vec<f64>,
    /// Mean of (I − I*)².
    pub pixel_mse: f64,
    /// √(e·e).
    pub feature_error_norm: f64,
    /// Of the interaction matrix.
    pub condition_number: f64,
    /// Inside the service, from the start of the computation to its end.
    pub compute_us: f64,
    /// From sending the image to having the twist.
    pub round_trip_us: f64,
    /// Distance of the camera to the desired pose, by the simulator's truth.
    pub error_mm: f64,
    /// Angle between the camera and the desired pose, by the simulator's truth.
    pub error_deg: f64,
    /// The camera's position in the desired camera frame: x right, y down, z forward.
    pub position_m: [f64; 3],
}

/// A whole run, as its end leaves it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunRecord {
    /// The method's word, for example `hahn`.
    pub method: String,
    /// By the truth of whoever knows it (the simulator), not by the service.
    pub converged: bool,
    /// The service's own verdict: the last status word.
    pub status: String,
    /// In the order of the images.
    pub rows: Vec<RunRow>,
}

impl RunRow {
    /// A row of which only the number is known: everything else is NaN, zero or empty.
    pub fn empty(image: u64) -> RunRow {
        RunRow {
            image,
            time_s: f64::NAN,
            twist: [0.0; 6],
            status: String::new(),
            order: 0,
            window: Vec::new(),
            pixel_mse: f64::NAN,
            feature_error_norm: f64::NAN,
            condition_number: f64::NAN,
            compute_us: f64::NAN,
            round_trip_us: f64::NAN,
            error_mm: f64::NAN,
            error_deg: f64::NAN,
            position_m: [f64::NAN; 3],
        }
    }

    /// What the answer to one image says, with the simulator's truth about where the camera was.
    pub fn answered(image: u64, answer: &TwistMessage, error: PoseError, position_m: [f64; 3]) -> RunRow {
        RunRow {
            twist: answer.twist,
            status: answer.status.word().to_owned(),
            order: usize::from(answer.order),
            pixel_mse: answer.pixel_mse,
            feature_error_norm: answer.feature_error_norm,
            condition_number: answer.condition_number,
            compute_us: f64::from(answer.compute_us),
            error_mm: error.mm,
            error_deg: error.deg,
            position_m,
            ..RunRow::empty(image)
        }
    }
}

#[cfg(test)]
pub(super) mod synthetic {
    use super::*;

    /// Thirty images on the way home: every error falls by a fifth per image, the order climbs from 4 to 16.
    pub fn run() -> RunRecord {
        let rows = (0..30).map(row).collect();
        RunRecord { method: "hahn".into(), converged: true, status: "converged".into(), rows }
    }

    fn row(image: u64) -> RunRow {
        let left = 0.8f64.powi(image as i32);
        let turn = image as f64 * 0.12;
        RunRow {
            image,
            time_s: image as f64 / 15.0,
            twist: [0.24, -0.13, -0.185, -0.04, -0.15, -0.26].map(|start| -start * left),
            status: if image < 29 { "servoing".into() } else { "converged".into() },
            order: 4 + (12.0 * (1.0 - left)).round() as usize,
            window: vec![8.0, 8.0, 8.0, 8.0],
            pixel_mse: 0.0609571 * left * left,
            feature_error_norm: 16.0 * left,
            condition_number: 40.0 + 10.0 * left,
            compute_us: 1800.0 + 25.0 * (image % 5) as f64,
            round_trip_us: 2600.0 + 40.0 * (image % 7) as f64,
            error_mm: 662.0 * left,
            error_deg: 35.1 * left,
            position_m: [0.48 * left * turn.cos(), -0.26 * left, -0.37 * left + 0.05 * turn.sin() * left],
        }
    }
}
