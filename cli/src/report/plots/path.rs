//! Where cameras went, in the desired frame: seen from above and along the optical axis, or from aside in three dimensions,
//! always with a metre of the same length on every axis.

use std::ops::Range;

use plotters::prelude::*;

use super::chart::{Area, COLORS, FONT, GRID, TEXT, drawing, plain, span, svg};
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

/// One camera's path from above and along the optical axis; the desired camera is at the origin.
pub fn path(rows: &[RunRow], name: &str) -> anyhow::Result<String> {
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
    let positions = positions(rows);
    svg(SIZE, |root| {
        let ranges = common_ranges(&positions);
        let title = Text::new(format!("Camera path · {name}"), (20, 13), (FONT, 18).into_font().color(&TEXT));
        root.draw(&title).map_err(drawing)?;
        draw_legend(root)?;
        let (_, body) = root.split_vertically(HEAD_PX);
        for (area, view) in body.split_evenly((1, 2)).iter().zip(&views) {
            draw_view(area, view, &positions, &ranges)?;
        }
        Ok(())
    })
}

fn positions(rows: &[RunRow]) -> Vec<[f64; 3]> {
    let known = |row: &&RunRow| row.position_m.iter().all(|value| value.is_finite());
    rows.iter().filter(known).map(|row| row.position_m).collect()
}

/// The paths of several runs in three dimensions: x to the right, z into the depth, y down.
pub fn paths_3d(runs: &[(&str, &[RunRow])]) -> anyhow::Result<String> {
    let paths: Vec<Vec<[f64; 3]>> = runs.iter().map(|(_, rows)| positions(rows)).collect();
    let all: Vec<[f64; 3]> = paths.iter().flatten().copied().collect();
    svg((SIZE.0, SIZE.0 * 3 / 4), |root| {
        let (head, body) = root.split_vertically(HEAD_PX);
        draw_names(&head, runs)?;
        let [x, y, z] = cube(&all);
        // Up on the page is up in the world: against y.
        let mut chart = ChartBuilder::on(&body)
            .margin(MARGIN_PX)
            .build_cartesian_3d(x.clone(), -y.end..-y.start, z.clone())
            .map_err(drawing)?;
        chart.with_projection(|mut projection| {
            (projection.pitch, projection.yaw, projection.scale) = (0.35, 0.6, 0.85);
            projection.into_matrix()
        });
        let label = (FONT, 14).into_font().color(&TEXT);
        chart
            .configure_axes()
            .label_style(label)
            .tick_size(4)
            .x_labels(5)
            .y_labels(5)
            .z_labels(5)
            .x_formatter(&|value| plain((*value * 1e3).round() / 1e3))
            .y_formatter(&|value| plain((-*value * 1e3).round() / 1e3))
            .z_formatter(&|value| plain((*value * 1e3).round() / 1e3))
            .light_grid_style(GRID)
            .draw()
            .map_err(drawing)?;
        for (path, color) in paths.iter().zip(COLORS.iter().cycle()) {
            let points: Vec<(f64, f64, f64)> = path.iter().map(|[x, y, z]| (*x, -y, *z)).collect();
            chart.draw_series(LineSeries::new(points.iter().copied(), color.stroke_width(2))).map_err(drawing)?;
            let start = points.first().map(|start| Circle::new(*start, 5, TEXT.filled()));
            chart.draw_series(start).map_err(drawing)?;
        }
        chart.draw_series([Cross::new((0.0, 0.0, 0.0), 7, TEXT.stroke_width(3))]).map_err(drawing)?;
        Ok(())
    })
}

/// Equal ranges about the middle of the paths and the origin.
fn cube(positions: &[[f64; 3]]) -> [Range<f64>; 3] {
    let spans = [0, 1, 2].map(|axis| span(positions.iter().map(|position| position[axis]).chain([0.0])));
    let widest = spans.iter().map(|span| span.end - span.start).fold(1e-3, f64::max);
    spans.map(|span| {
        let middle = 0.5 * (span.start + span.end);
        middle - 0.55 * widest..middle + 0.55 * widest
    })
}

fn draw_names(head: &Area<'_>, runs: &[(&str, &[RunRow])]) -> anyhow::Result<()> {
    let style = |size| (FONT, size).into_font().color(&TEXT);
    let title = "Camera paths (m): x right, y down, z forward; dot: start, cross: desired";
    head.draw(&Text::new(title, (20, 2), style(17))).map_err(drawing)?;
    let mut x = 20;
    for ((name, _), color) in runs.iter().zip(COLORS.iter().cycle()) {
        head.draw(&PathElement::new(vec![(x, 36), (x + 24, 36)], color.stroke_width(3))).map_err(drawing)?;
        head.draw(&Text::new((*name).to_owned(), (x + 31, 28), style(15))).map_err(drawing)?;
        x += 46 + 8 * name.chars().count() as i32;
    }
    Ok(())
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
