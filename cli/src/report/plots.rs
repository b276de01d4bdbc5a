//! The plots of runs as SVG: errors, twist, order, parameters over the images, and the cameras' paths; of one run, or of several
//! in one picture. Which numbers go where is said here; `chart` does the drawing.

mod chart;
mod heat;
mod path;

pub use chart::{Panel, Scale, Series, charts};
pub use heat::{Colors, Heat, heats};

use std::path::Path;

use anyhow::Context;

use super::{RunRecord, RunRow};

/// A picture with the name of its file, without the ending.
#[derive(Clone, Debug)]
pub struct Plot {
    /// For example `pixel_error`.
    pub name: &'static str,
    /// The text of the SVG.
    pub svg: String,
}

/// Everything of one run: pixel error, feature error, twist, order, parameters where there are any, pose error, path.
pub fn of_run(record: &RunRecord) -> anyhow::Result<Vec<Plot>> {
    let (rows, name) = (&record.rows, &record.method);
    let run = [("", rows.as_slice())];
    let mut plots = vec![
        plot("pixel_error", charts(&[pixel_error(&run, name)])?),
        plot("feature_error", charts(&[feature_error(&run, name)])?),
        plot("twist", charts(&twist(rows, name))?),
        plot("order", charts(&[order(&run, name)])?),
        plot("pose_error", charts(&pose_error(&run, name))?),
        plot("camera_path", path::path(rows, name)?),
    ];
    if rows.iter().any(|row| !row.window.is_empty()) {
        plots.push(plot("parameters", charts(&[parameters(rows, name)])?));
    }
    Ok(plots)
}

/// Several runs in one picture each: pixel error, pose error, order, and the paths in three dimensions.
pub fn of_runs(records: &[RunRecord], name: &str) -> anyhow::Result<Vec<Plot>> {
    let runs: Vec<(&str, &[RunRow])> =
        records.iter().map(|record| (record.method.as_str(), record.rows.as_slice())).collect();
    Ok(vec![
        plot("pixel_error", charts(&[pixel_error(&runs, name)])?),
        plot("pose_error", charts(&pose_error(&runs, name))?),
        plot("order", charts(&[order(&runs, name)])?),
        plot("camera_paths", path::paths_3d(&runs)?),
    ])
}

/// Writes each into a file of its name.
pub fn write_plots(folder: &Path, plots: &[Plot]) -> anyhow::Result<()> {
    for Plot { name, svg } in plots {
        let path = folder.join(format!("{name}.svg"));
        std::fs::write(&path, svg).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

fn plot(name: &'static str, svg: String) -> Plot {
    Plot { name, svg }
}

type Runs<'a> = [(&'a str, &'a [RunRow])];

fn panel(title: String, y_label: &str, scale: Scale, series: Vec<Series>) -> Panel {
    Panel { title, x_label: "image".into(), y_label: y_label.into(), scale, series }
}

fn pixel_error(runs: &Runs<'_>, name: &str) -> Panel {
    let series = over_runs(runs, |row| row.pixel_mse);
    panel(format!("Pixel error · {name}"), "mean of (I − I*)²", Scale::Log, series)
}

fn feature_error(runs: &Runs<'_>, name: &str) -> Panel {
    let series = over_runs(runs, |row| row.feature_error_norm);
    panel(format!("Feature error · {name}"), "√(e·e)", Scale::Log, series)
}

fn twist(rows: &[RunRow], name: &str) -> [Panel; 2] {
    let axes = |first: usize, letter: &str| {
        let axis = |(index, axis): (usize, &str)| {
            over_images(&format!("{letter}{axis}"), rows, move |row| row.twist[first + index])
        };
        ["x", "y", "z"].into_iter().enumerate().map(axis).collect()
    };
    [
        panel(format!("Linear velocity · {name}"), "m/s, camera frame", Scale::Linear, axes(0, "v")),
        panel(format!("Angular velocity · {name}"), "rad/s, camera frame", Scale::Linear, axes(3, "ω")),
    ]
}

fn order(runs: &Runs<'_>, name: &str) -> Panel {
    let used = |row: &RunRow| {
        if row.order == 0 { f64::NAN } else { row.order as f64 }
    };
    panel(format!("Order of the moments · {name}"), "largest n + m", Scale::Whole, over_runs(runs, used))
}

/// Hahn's a and b, or Krawtchouk's p, along both axes.
fn parameters(rows: &[RunRow], name: &str) -> Panel {
    let words: &[&str] = match rows.iter().map(|row| row.window.len()).max() {
        Some(2) => &["p along u", "p along v"],
        _ => &["a along u", "b along u", "a along v", "b along v"],
    };
    let one = |(index, word): (usize, &&str)| {
        over_images(word, rows, move |row| row.window.get(index).copied().unwrap_or(f64::NAN))
    };
    let series = words.iter().enumerate().map(one).collect();
    panel(format!("Parameters · {name}"), "window", Scale::Linear, series)
}

fn pose_error(runs: &Runs<'_>, name: &str) -> [Panel; 2] {
    let mm = over_runs(runs, |row| row.error_mm);
    let deg = over_runs(runs, |row| row.error_deg);
    [
        panel(format!("Distance to the desired pose · {name}"), "mm", Scale::Log, mm),
        panel(format!("Angle to the desired pose · {name}"), "degrees", Scale::Log, deg),
    ]
}

fn over_runs(runs: &Runs<'_>, value: impl Fn(&RunRow) -> f64 + Copy) -> Vec<Series> {
    runs.iter().map(|(label, rows)| over_images(label, rows, value)).collect()
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

    fn plots_of(record: &RunRecord) -> Vec<Plot> {
        of_run(record).expect("plots")
    }

    fn svg<'a>(plots: &'a [Plot], name: &str) -> &'a str {
        &plots.iter().find(|plot| plot.name == name).expect("the plot").svg
    }

    #[test]
    fn every_plot_is_an_svg_with_labelled_axes_and_units() {
        let plots = plots_of(&synthetic::run());
        let words: [(&str, &[&str]); 7] = [
            ("pixel_error", &["Pixel error", "mean of", "image"]),
            ("feature_error", &["√(e·e)"]),
            ("twist", &["m/s", "rad/s", "vx", "ωz"]),
            ("order", &["largest n + m"]),
            ("parameters", &["a along u", "b along v"]),
            ("pose_error", &["mm", "degrees"]),
            ("camera_path", &["x right (m)", "z forward (m)", "y down (m)"]),
        ];
        for (name, words) in words {
            let plot = svg(&plots, name);
            assert!(plot.starts_with("<svg") && plot.trim_end().ends_with("</svg>"));
            for word in words {
                assert!(plot.contains(word), "'{word}' is missing in {name}");
            }
        }
    }

    #[test]
    fn several_runs_are_told_apart_by_their_methods() {
        let mut other = synthetic::run();
        other.method = "TM-VS".into();
        let plots = of_runs(&[synthetic::run(), other], "box").expect("plots");
        for plot in &plots {
            assert!(plot.svg.contains("TM-VS") && plot.svg.contains("hahn"), "{}", plot.name);
        }
        assert!(svg(&plots, "camera_paths").contains("x right, y down, z forward"));
    }

    #[test]
    fn runs_with_nothing_one_row_or_nan_still_make_plots() {
        let mut one = synthetic::run();
        one.rows.truncate(1);
        let nothing_known = RunRecord { rows: vec![RunRow::empty(0), RunRow::empty(1)], ..RunRecord::default() };
        for record in [RunRecord::default(), one, nothing_known] {
            assert!(plots_of(&record).len() >= 6);
            of_runs(&[record], "nothing").expect("plots");
        }
    }

    #[test]
    fn an_error_of_exactly_zero_does_not_break_the_log_axis() {
        let mut record = synthetic::run();
        record.rows[29].pixel_mse = 0.0;
        assert!(!svg(&plots_of(&record), "pixel_error").contains("NaN"));
    }
}
