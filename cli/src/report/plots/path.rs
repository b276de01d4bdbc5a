//! The camera's way in the desired frame, seen from above and along the optical axis, both on one scale.

use std::ops::Range;
use std::path::Path;

use plotters::prelude::*;

use super::chart::{Area, COLORS, FONT, GRID, TEXT, drawing, plain, span};
use crate::report::RunRow;

const SIZE: (u32, u32) = (860, 470);
const MARGIN_PX: u32 = 22;
const MARGIN_LEFT_PX: u32 = 14;
const X_LABELS_PX: u32 = 44;
const Y_LABELS_PX: u32 = 76;
const HEAD_PX: u32 = 48;

/// Two of the three coordinates, and how their axes run.
struct View {
    x_label: &'static str,
    y_label: &'static str,
    x_axis: usize,
    y_axis: usize,
    y_runs: YRuns,
}

#[derive(PartialEq, Eq)]
enum YRuns {
    Up,
    Down,
}

/// Draws the positions in `rows`; the desired camera is at the origin.
pub fn draw_path(path: &Path, rows: &[RunRow], name: &str) -> anyhow::Result<()> {
    let views = [
        View { x_label: "x right (m), from above", y_label: "z forward (m)", x_axis: 0, y_axis: 2, y_runs: YRuns::Up },
        View {
            x_label: "x right (m), along the optical axis",
            y_label: "y down (m)",
            x_axis: 0,
            y_axis: 1,
            y_runs: YRuns::Down,
        },
    ];
    let known = |row: &&RunRow| row.position_m.iter().all(|value| value.is_finite());
    let positions: Vec<[f64; 3]> = rows.iter().filter(known).map(|row| row.position_m).collect();
    let explain = |error: anyhow::Error| error.context(format!("cannot write {}", path.display()));
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE).map_err(|error| explain(drawing(error)))?;
    let ranges = common_ranges(&positions);
    let title = Text::new(format!("Camera path · {name}"), (20, 13), (FONT, 18).into_font().color(&TEXT));
    root.draw(&title).map_err(|error| explain(drawing(error)))?;
    draw_legend(&root).map_err(explain)?;
    let (_, body) = root.split_vertically(HEAD_PX);
    for (area, view) in body.split_evenly((1, 2)).iter().zip(&views) {
        draw_view(area, view, &positions, &ranges).map_err(explain)?;
    }
    root.present().map_err(|error| explain(drawing(error)))
}

/// Per axis the range to show: the path and the origin, so wide that a metre has the same length on all of them.
fn common_ranges(positions: &[[f64; 3]]) -> [Range<f64>; 3] {
    let spans = [0, 1, 2].map(|axis| span(positions.iter().map(|position| position[axis]).chain([0.0])));
    let plot_width = SIZE.0 / 2 - MARGIN_LEFT_PX - MARGIN_PX - Y_LABELS_PX;
    let plot_height = SIZE.1 - HEAD_PX - X_LABELS_PX - MARGIN_PX;
    let pixels = [plot_width, plot_height, plot_height].map(f64::from);
    let metres_per_px = [0, 1, 2].map(|axis| 1.15 * (spans[axis].end - spans[axis].start) / pixels[axis]);
    let scale = metres_per_px.into_iter().fold(1e-5, f64::max);
    [0, 1, 2].map(|axis| {
        let middle = 0.5 * (spans[axis].start + spans[axis].end);
        let half = 0.5 * scale * pixels[axis];
        middle - half..middle + half
    })
}

/// Top right: a dot is the start, a cross the desired camera.
fn draw_legend(root: &Area<'_>) -> anyhow::Result<()> {
    let style = || (FONT, 15).into_font().color(&TEXT);
    let x = SIZE.0 as i32 - 250;
    root.draw(&Circle::new((x, 23), 6, COLORS[1].filled())).map_err(drawing)?;
    root.draw(&Text::new("start", (x + 14, 15), style())).map_err(drawing)?;
    root.draw(&Cross::new((x + 90, 23), 6, COLORS[2].stroke_width(3))).map_err(drawing)?;
    root.draw(&Text::new("desired", (x + 104, 15), style())).map_err(drawing)
}

fn draw_view(area: &Area<'_>, view: &View, positions: &[[f64; 3]], ranges: &[Range<f64>; 3]) -> anyhow::Result<()> {
    let upwards = ranges[view.y_axis].clone();
    let y_range = if view.y_runs == YRuns::Up { upwards } else { upwards.end..upwards.start };
    let mut chart = ChartBuilder::on(area)
        .margin_left(MARGIN_LEFT_PX)
        .margin_right(MARGIN_PX)
        .margin_bottom(MARGIN_PX)
        .x_label_area_size(X_LABELS_PX)
        .y_label_area_size(Y_LABELS_PX)
        .build_cartesian_2d(ranges[view.x_axis].clone(), y_range)
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .x_desc(view.x_label)
        .y_desc(view.y_label)
        .x_label_formatter(&|value| plain(*value))
        .y_label_formatter(&|value| plain(*value))
        .x_labels(6)
        .y_labels(7)
        .axis_style(TEXT.mix(0.6))
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .label_style((FONT, 14).into_font().color(&TEXT))
        .axis_desc_style((FONT, 15).into_font().color(&TEXT))
        .draw()
        .map_err(drawing)?;
    let points: Vec<(f64, f64)> =
        positions.iter().map(|position| (position[view.x_axis], position[view.y_axis])).collect();
    chart.draw_series(LineSeries::new(points.iter().copied(), COLORS[0].stroke_width(2))).map_err(drawing)?;
    chart.draw_series(points.iter().map(|point| Circle::new(*point, 2, COLORS[0].filled()))).map_err(drawing)?;
    let marks = points.first().map(|start| Circle::new(*start, 6, COLORS[1].filled()));
    chart.draw_series(marks).map_err(drawing)?;
    chart.draw_series([Cross::new((0.0, 0.0), 7, COLORS[2].stroke_width(3))]).map_err(drawing)?;
    Ok(())
}
