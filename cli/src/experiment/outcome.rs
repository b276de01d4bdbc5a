//! How one run ended: what `results.jsonl` and `--json` say about it.

use domvs_simulators::PoseError;
use serde::{Deserialize, Serialize};

use super::plan::{CellName, RunPlan};
use super::spec::Tolerance;

/// Images at the end whose error is averaged under noise, where no single image is the answer.
const SETTLED_IMAGES: usize = 8;

/// The end of one run. What does not apply is null.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The file's name.
    pub experiment: String,
    /// The scene's name.
    pub scene: String,
    /// The disturbance's name; empty where the file has none.
    pub disturbance: String,
    /// The method's name.
    pub method: String,
    /// Of everything random in it.
    pub seed: u64,
    /// Where it started: se(3) log coordinates of `T_desired⁻¹ T_initial`, m and degrees.
    pub displacement: [f64; 6],
    /// Within the tolerance at the end, by the simulator's truth.
    pub converged: bool,
    /// After how many images the error came within the tolerance and stayed; null = never.
    pub images: Option<u32>,
    /// How many images were answered.
    pub answered: u32,
    /// At the end, mm.
    pub error_mm: f64,
    /// At the end, degrees.
    pub error_deg: f64,
    /// The median over the last eight images, mm.
    pub settled_mm: f64,
    /// The median over the last eight images, degrees.
    pub settled_deg: f64,
    /// Length of the camera's path over the straight distance.
    pub path_ratio: Option<f64>,
    /// The service's last word.
    pub status: String,
    /// Of the plan: what a later sweep finds it by.
    pub key: String,
}

/// Where a camera was: before every image and after the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// How far from the desired pose.
    pub errors: Vec<PoseError>,
    /// In the desired camera's frame, m.
    pub positions_m: Vec<[f64; 3]>,
}

impl Outcome {
    /// Judges a run of `plan` that started at `displacement`.
    pub fn of(plan: &RunPlan, displacement: [f64; 6], track: &Track, status: &str) -> Outcome {
        let CellName { scene, disturbance, method } = plan.cell.clone();
        let end = track.errors.last().copied().unwrap_or(PoseError { mm: f64::MAX, deg: f64::MAX });
        let settled = &track.errors[track.errors.len().saturating_sub(SETTLED_IMAGES)..];
        Outcome {
            experiment: plan.experiment.clone(),
            scene,
            disturbance,
            method,
            seed: plan.seed,
            displacement,
            converged: is_within(&end, plan.tolerance),
            images: images_until_within(&track.errors, plan.tolerance),
            answered: track.errors.len().saturating_sub(1) as u32,
            error_mm: end.mm,
            error_deg: end.deg,
            settled_mm: median(settled.iter().map(|error| error.mm)).unwrap_or(end.mm),
            settled_deg: median(settled.iter().map(|error| error.deg)).unwrap_or(end.deg),
            path_ratio: path_ratio(&track.positions_m),
            status: status.to_owned(),
            key: plan.key(),
        }
    }

    /// What it is counted under.
    pub fn cell(&self) -> CellName {
        CellName { scene: self.scene.clone(), disturbance: self.disturbance.clone(), method: self.method.clone() }
    }
}

fn is_within(error: &PoseError, tolerance: Tolerance) -> bool {
    error.mm < tolerance.error_mm && error.deg < tolerance.error_deg
}

/// The first index from which every error is within the tolerance: so many images had been answered by then.
fn images_until_within(errors: &[PoseError], tolerance: Tolerance) -> Option<u32> {
    let outside = errors.iter().rposition(|error| !is_within(error, tolerance));
    let first = outside.map_or(0, |outside| outside + 1);
    (first < errors.len()).then_some(first as u32)
}

/// The length of the path over the distance from its start to the origin; none where that is nothing.
fn path_ratio(positions_m: &[[f64; 3]]) -> Option<f64> {
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let steps = positions_m.windows(2).map(|pair| norm([0, 1, 2].map(|axis| pair[1][axis] - pair[0][axis])));
    // Not `sum`: of no steps at all that is -0.
    let length = steps.fold(0.0, |length, step| length + step);
    let straight = norm(*positions_m.first()?);
    (straight > 1e-6).then(|| length / straight)
}

/// The middle one of the finite values; of two the mean; none of none.
pub fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        count if count % 2 == 1 => Some(values[middle]),
        _ => Some(0.5 * (values[middle - 1] + values[middle])),
    }
}

#[cfg(test)]
pub(crate) mod synthetic {
    use super::*;

    /// A run that converged after 12 images.
    pub fn outcome(key: &str) -> Outcome {
        Outcome {
            experiment: "synthetic".into(),
            scene: "box".into(),
            disturbance: String::new(),
            method: "HM".into(),
            seed: 7,
            displacement: [0.1, -0.2, 0.3, 1.0, -2.0, 3.0],
            converged: true,
            images: Some(12),
            answered: 30,
            error_mm: 0.1 + 0.2,
            error_deg: 0.01,
            settled_mm: 0.3,
            settled_deg: 0.01,
            path_ratio: Some(1.2),
            status: "converged".into(),
            key: key.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLERANCE: Tolerance = Tolerance { error_mm: 1.0, error_deg: 0.1 };

    fn errors(mm: &[f64]) -> Vec<PoseError> {
        mm.iter().map(|&mm| PoseError { mm, deg: mm / 20.0 }).collect()
    }

    #[test]
    fn images_are_counted_until_the_error_stays_within() {
        assert_eq!(images_until_within(&errors(&[9.0, 0.5, 2.0, 0.9, 0.1]), TOLERANCE), Some(3));
        assert_eq!(images_until_within(&errors(&[9.0, 0.5, 2.0]), TOLERANCE), None);
        assert_eq!(images_until_within(&errors(&[0.5, 0.4]), TOLERANCE), Some(0));
        assert_eq!(images_until_within(&[], TOLERANCE), None);
    }

    #[test]
    fn the_angle_must_be_within_too() {
        assert!(!is_within(&PoseError { mm: 0.1, deg: 0.2 }, TOLERANCE));
    }

    #[test]
    fn a_straight_path_has_the_ratio_one_and_a_detour_more() {
        assert_eq!(path_ratio(&[[0.0, 0.0, 1.0], [0.0, 0.0, 0.5], [0.0; 3]]), Some(1.0));
        assert_eq!(path_ratio(&[[3.0, 0.0, 0.0], [3.0, 4.0, 0.0], [0.0; 3]]), Some(3.0));
        assert_eq!(path_ratio(&[[0.0; 3], [1.0, 0.0, 0.0]]), None);
        assert_eq!(path_ratio(&[]), None);
        assert!(path_ratio(&[[1.0, 0.0, 0.0]]).is_some_and(f64::is_sign_positive), "not -0 where nothing moved");
    }

    #[test]
    fn an_outcome_reads_back_from_its_json_to_the_last_bit() {
        let outcome = synthetic::outcome("k");
        let text = serde_json::to_string(&outcome).expect("JSON");
        assert_eq!(serde_json::from_str::<Outcome>(&text).expect("the same"), outcome);
    }
}
