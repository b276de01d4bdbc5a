//! The plots of a run as SVG: pixel error, twist, order, pose error over the images, and the camera's path.
//! Which numbers go where is said here; `chart` does the drawing.

mod chart;
mod path;

use std::path::Path;

use self::chart::{Panel, Scale, Series, draw_charts};
use super::{RunRecord, RunRow};

/// Writes `pixel_error.svg`, `twist.svg`, `order.svg`, `pose_error.svg` and `camera_path.svg`.
pub fn write_plots(folder: &Path, record: &RunRecord) -> anyhow::Result<()> {
    let rows = &record.rows;
    let name = &record.method;
    draw_charts(&folder.join("pixel_error.svg"), &[pixel_error(rows, name)])?;
    draw_charts(&folder.join("twist.svg"), &twist(rows, name))?;
    draw_charts(&folder.join("order.svg"), &[order(rows, name)])?;
    draw_charts(&folder.join("pose_error.svg"), &pose_error(rows, name))?;
    path::draw_path(&folder.join("camera_path.svg"), rows, name)
}

fn pixel_error(rows: &[RunRow], name: &str) -> Panel {
    let series = vec![over_images("", rows, |row| row.pixel_mse)];
    Panel { title: format!("Pixel error · {name}"), y_label: "mean of (I − I*)²".into(), scale: Scale::Log, series }
}

fn twist(rows: &[RunRow], name: &str) -> [Panel; 2] {
    let axes = |first: usize, letter: &str| {
        let axis = |(index, axis): (usize, &str)| {
            over_images(&format!("{letter}{axis}"), rows, move |row| row.twist[first + index])
        };
        ["x", "y", "z"].into_iter().enumerate().map(axis).collect()
    };
    [
        Panel {
            title: format!("Linear velocity · {name}"),
            y_label: "m/s, camera frame".into(),
            scale: Scale::Linear,
            series: axes(0, "v"),
        },
        Panel {
            title: format!("Angular velocity · {name}"),
            y_label: "rad/s, camera frame".into(),
            scale: Scale::Linear,
            series: axes(3, "ω"),
        },
    ]
}

fn order(rows: &[RunRow], name: &str) -> Panel {
    let used = |row: &RunRow| {
        if row.order == 0 { f64::NAN } else { row.order as f64 }
    };
    let series = vec![over_images("", rows, used)];
    Panel {
        title: format!("Order of the moments · {name}"),
        y_label: "largest n + m".into(),
        scale: Scale::Whole,
        series,
    }
}

fn pose_error(rows: &[RunRow], name: &str) -> [Panel; 2] {
    [
        Panel {
            title: format!("Distance to the desired pose · {name}"),
            y_label: "mm".into(),
            scale: Scale::Log,
            series: vec![over_images("", rows, |row| row.error_mm)],
        },
        Panel {
            title: format!("Angle to the desired pose · {name}"),
            y_label: "degrees".into(),
            scale: Scale::Log,
            series: vec![over_images("", rows, |row| row.error_deg)],
        },
    ]
}

/// One value per image; a series without a label has no legend.
fn over_images(label: &str, rows: &[RunRow], value: impl Fn(&RunRow) -> f64) -> Series {
    let points = rows.iter().map(|row| (row.image as f64, value(row))).collect();
    Series { label: label.to_owned(), points }
}

#[cfg(test)]
mod tests {
    use super::super::record::synthetic;
    use super::*;

    const NAMES: [&str; 5] = ["pixel_error.svg", "twist.svg", "order.svg", "pose_error.svg", "camera_path.svg"];

    fn plots_of(record: &RunRecord) -> Vec<String> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        write_plots(folder.path(), record).expect("five plots");
        NAMES.iter().map(|name| std::fs::read_to_string(folder.path().join(name)).expect("the plot")).collect()
    }

    #[test]
    fn every_plot_is_an_svg_with_labelled_axes_and_units() {
        let plots = plots_of(&synthetic::run());
        let words: [&[&str]; 5] = [
            &["Pixel error", "mean of", "image"],
            &["m/s", "rad/s", "vx", "ωz"],
            &["largest n + m"],
            &["mm", "degrees"],
            &["x right (m)", "z forward (m)", "y down (m)"],
        ];
        for (plot, words) in plots.iter().zip(words) {
            assert!(plot.starts_with("<svg") && plot.trim_end().ends_with("</svg>"));
            for word in words {
                assert!(plot.contains(word), "'{word}' is missing");
            }
        }
    }

    #[test]
    fn runs_with_nothing_one_row_or_nan_still_make_plots() {
        let mut one = synthetic::run();
        one.rows.truncate(1);
        let nothing_known = RunRecord { rows: vec![RunRow::empty(0), RunRow::empty(1)], ..RunRecord::default() };
        for record in [RunRecord::default(), one, nothing_known] {
            assert_eq!(plots_of(&record).len(), 5);
        }
    }

    #[test]
    fn an_error_of_exactly_zero_does_not_break_the_log_axis() {
        let mut record = synthetic::run();
        record.rows[29].pixel_mse = 0.0;
        assert!(!plots_of(&record)[0].contains("NaN"));
    }
}
