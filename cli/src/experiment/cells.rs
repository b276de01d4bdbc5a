//! Runs counted by scene, disturbance and method.

use std::collections::HashMap;

use serde::Serialize;

use super::outcome::{Outcome, median};
use super::plan::CellName;
use super::wilson::rate;

/// One cell of a sweep. What does not apply is null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// The file's name.
    pub experiment: String,
    /// The scene's name.
    pub scene: String,
    /// The disturbance's name; empty where the file has none.
    pub disturbance: String,
    /// The method's name.
    pub method: String,
    /// How many displacements were run.
    pub runs: usize,
    /// How many converged.
    pub successes: usize,
    /// Their share.
    pub success_rate: f64,
    /// The lower end of its 95 % interval (Wilson).
    pub wilson_low: f64,
    /// The upper end.
    pub wilson_high: f64,
    /// Of the converged runs.
    pub median_images: Option<f64>,
    /// Of the converged runs.
    pub median_path_ratio: Option<f64>,
    /// Of all runs: the error at the end, mm.
    pub median_error_mm: Option<f64>,
    /// Of all runs: the error at the end, degrees.
    pub median_error_deg: Option<f64>,
    /// Of the converged runs: the mean of their medians over the last eight images, mm.
    pub mean_settled_mm: Option<f64>,
    /// Likewise, degrees.
    pub mean_settled_deg: Option<f64>,
}

/// The cells of `outcomes`, in the order in which they first appear.
pub fn cells(outcomes: &[Outcome]) -> Vec<Cell> {
    let mut order: Vec<CellName> = Vec::new();
    let mut of: HashMap<CellName, Vec<&Outcome>> = HashMap::new();
    for outcome in outcomes {
        let runs = of.entry(outcome.cell()).or_default();
        if runs.is_empty() {
            order.push(outcome.cell());
        }
        runs.push(outcome);
    }
    order.into_iter().map(|name| cell(&name, &of[&name])).collect()
}

fn cell(name: &CellName, runs: &[&Outcome]) -> Cell {
    let converged: Vec<&Outcome> = runs.iter().copied().filter(|run| run.converged).collect();
    let rate = rate(converged.len(), runs.len());
    let of_converged = |value: &dyn Fn(&Outcome) -> Option<f64>| median(converged.iter().filter_map(|run| value(run)));
    let mean = |value: &dyn Fn(&Outcome) -> f64| {
        (!converged.is_empty()).then(|| converged.iter().map(|run| value(run)).sum::<f64>() / converged.len() as f64)
    };
    Cell {
        experiment: runs.first().map(|run| run.experiment.clone()).unwrap_or_default(),
        scene: name.scene.clone(),
        disturbance: name.disturbance.clone(),
        method: name.method.clone(),
        runs: runs.len(),
        successes: converged.len(),
        success_rate: rate.rate,
        wilson_low: rate.low,
        wilson_high: rate.high,
        median_images: of_converged(&|run| run.images.map(f64::from)),
        median_path_ratio: of_converged(&|run| run.path_ratio),
        median_error_mm: median(runs.iter().map(|run| run.error_mm)),
        median_error_deg: median(runs.iter().map(|run| run.error_deg)),
        mean_settled_mm: mean(&|run| run.settled_mm),
        mean_settled_deg: mean(&|run| run.settled_deg),
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcome::synthetic::outcome;
    use super::*;

    #[test]
    fn runs_are_counted_in_their_cells_and_only_converged_ones_have_a_speed() {
        let mut outcomes = vec![outcome("a"), outcome("b"), outcome("c"), outcome("d")];
        outcomes[1].images = Some(20);
        (outcomes[2].converged, outcomes[2].images, outcomes[2].error_mm) = (false, None, 500.0);
        outcomes[3].method = "TM".into();
        let cells = cells(&outcomes);
        assert_eq!(cells.iter().map(|cell| cell.method.as_str()).collect::<Vec<_>>(), ["HM", "TM"]);
        assert_eq!((cells[0].runs, cells[0].successes, cells[0].median_images), (3, 2, Some(16.0)));
        assert!(cells[0].wilson_low < 2.0 / 3.0 && cells[0].wilson_high > 2.0 / 3.0);
        assert_eq!(cells[1].success_rate, 1.0);
    }
}
