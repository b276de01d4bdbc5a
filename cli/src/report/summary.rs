//! How a run ended, as one row of a table and as one JSON object.

use std::path::PathBuf;

use comfy_table::{Cell, CellAlignment, Table};
use serde::Serialize;

use super::{RunRecord, RunRow};
use crate::paint::Paint;

/// The end of a run. As JSON it is the last line of `--json`; what does not apply is null there and `–` in the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    /// The method's word.
    pub method: String,
    /// By the simulator's truth.
    pub converged: bool,
    /// The service's own verdict.
    pub status: String,
    /// How many images were answered.
    pub images: usize,
    /// At the last image.
    pub error_mm: f64,
    /// At the last image.
    pub error_deg: f64,
    /// The median over the images.
    pub compute_ms: f64,
    /// The median over the images.
    pub round_trip_ms: f64,
    /// The folder with everything else.
    pub out: PathBuf,
}

impl RunRecord {
    /// The last errors and the median times; `out` is the folder that the run was written to.
    pub fn summary(&self, out: impl Into<PathBuf>) -> RunSummary {
        let last = |value: fn(&RunRow) -> f64| self.rows.last().map_or(f64::NAN, value);
        RunSummary {
            method: self.method.clone(),
            converged: self.converged,
            status: self.status.clone(),
            images: self.rows.len(),
            error_mm: last(|row| row.error_mm),
            error_deg: last(|row| row.error_deg),
            compute_ms: median(self.rows.iter().map(|row| row.compute_us / 1e3)),
            round_trip_ms: median(self.rows.iter().map(|row| row.round_trip_us / 1e3)),
            out: out.into(),
        }
    }
}

/// The middle one of the finite values; of two the mean; NaN of none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    match (values.len(), values.len() / 2) {
        (0, _) => f64::NAN,
        (count, middle) if count % 2 == 1 => values[middle],
        (_, middle) => 0.5 * (values[middle - 1] + values[middle]),
    }
}

/// One row per run: method, verdict, images, final error, times.
pub fn summary_table(runs: &[RunSummary], paint: Paint) -> Table {
    let mut table = paint.table(&["method", "status", "images", "error mm", "error °", "compute ms", "round trip ms"]);
    for run in runs {
        let right = |text: String| Cell::new(text).set_alignment(CellAlignment::Right);
        table.add_row([
            paint.bold_cell(&run.method),
            paint.verdict_cell(&verdict(run), run.converged),
            right(run.images.to_string()),
            right(number(run.error_mm)),
            right(number(run.error_deg)),
            right(number(run.compute_ms)),
            right(number(run.round_trip_ms)),
        ]);
    }
    table
}

/// The service's word, and the truth where the two differ.
fn verdict(run: &RunSummary) -> String {
    match (run.converged, run.status.as_str()) {
        (true, "converged") => "converged".to_owned(),
        (true, status) => format!("{status}, but there"),
        (false, "converged") => "converged, but not there".to_owned(),
        (false, status) => status.to_owned(),
    }
}

/// Three digits after the point below 10, then fewer.
pub fn number(value: f64) -> String {
    match value.abs() {
        _ if !value.is_finite() => "–".to_owned(),
        size if size < 10.0 => format!("{value:.3}"),
        size if size < 100.0 => format!("{value:.2}"),
        _ => format!("{value:.1}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::synthetic;
    use super::*;

    #[test]
    fn the_median_leaves_out_what_is_not_a_number() {
        assert_eq!(median([3.0, f64::NAN, 1.0, 2.0].into_iter()), 2.0);
        assert_eq!(median([4.0, 1.0].into_iter()), 2.5);
        assert!(median([f64::NAN].into_iter()).is_nan());
    }

    #[test]
    fn a_summary_has_the_last_error_and_the_median_times() {
        let record = synthetic::run();
        let summary = record.summary("runs/one");
        assert_eq!(summary.images, 30);
        assert_eq!(summary.error_mm, record.rows[29].error_mm);
        assert_eq!(summary.compute_ms, 1.85);
        let json = serde_json::to_value(&summary).expect("JSON");
        assert_eq!(json["converged"], true);
        assert_eq!(json["out"], "runs/one");
    }

    #[test]
    fn a_run_without_images_has_nulls_and_dashes() {
        let summary = RunRecord::default().summary("out");
        assert!(serde_json::to_value(&summary).expect("JSON")["error_mm"].is_null());
        assert!(summary_table(&[summary], Paint::default()).to_string().contains('–'));
    }

    #[test]
    fn the_table_fits_eighty_columns_and_can_be_narrower() {
        let mut table = summary_table(&[synthetic::run().summary("out")], Paint::default());
        let widest = |text: &str| text.lines().map(|line| line.chars().count()).max().unwrap_or(0);
        let text = table.to_string();
        assert!(widest(&text) <= 80, "{} columns:\n{text}", widest(&text));
        table.set_width(60);
        let text = table.to_string();
        assert!(widest(&text) <= 60, "{} columns:\n{text}", widest(&text));
    }

    #[test]
    fn a_verdict_that_the_simulator_contradicts_says_so() {
        let mut summary = synthetic::run().summary("out");
        assert_eq!(verdict(&summary), "converged");
        summary.converged = false;
        assert_eq!(verdict(&summary), "converged, but not there");
        summary.status = "iteration_cap".into();
        assert_eq!(verdict(&summary), "iteration_cap");
    }
}
