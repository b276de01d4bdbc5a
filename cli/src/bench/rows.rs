//! What a measurement says: the fields that every row has, as JSON, as a table, and as plots of cost against size and order.

use std::path::{Path, PathBuf};

use anyhow::Context;
use comfy_table::{Cell, CellAlignment, Table, TableComponent};
use serde::Serialize;

use super::cases::Case;
use super::samples::Summary;
use crate::paint::Paint;
use crate::report::number;
use crate::report::plots::{Panel, Plot, Scale, Series, charts, write_plots};

/// More lines than this in one panel leave no room for its title.
const MOST_LINES: usize = 5;

/// What every row has; a number that does not apply is null in JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Common {
    /// `moved`, `cached`, `echo` or `load`.
    pub case: &'static str,
    /// `640x480`.
    pub size: String,
    /// 0 for methods without moments.
    pub order: u16,
    /// The method's word.
    pub method: &'static str,
    /// `map` or `constant`.
    pub depth: &'static str,
    /// Of one step, or of one round trip.
    pub median_ms: f64,
    /// 99 of 100 are not longer.
    pub p99_ms: f64,
    /// The mean.
    pub mean_ms: f64,
    /// `1000 / median_ms`; under load, frames answered in a second.
    pub frames_per_s: f64,
    /// Useful arithmetic: two operations for each multiply-add of the sums that the equations ask for.
    pub gflops: Option<f64>,
    /// `gflops` over what one core of this machine reached in the same run with nothing but multiply-adds.
    pub peak_fraction: Option<f64>,
    /// How many times were taken.
    pub samples: usize,
    #[serde(skip)]
    pixels: usize,
}

impl Common {
    /// The fields of one case; no arithmetic is known yet.
    pub fn new(name: &'static str, case: &Case, times: &Summary) -> Common {
        Common {
            case: name,
            size: case.size.to_string(),
            order: case.order,
            method: case.method.word(),
            depth: case.depth.word(),
            median_ms: times.median_ms,
            p99_ms: times.p99_ms,
            mean_ms: times.mean_ms,
            frames_per_s: 1e3 / times.median_ms,
            gflops: None,
            peak_fraction: None,
            samples: times.count,
            pixels: case.size.width * case.size.height,
        }
    }
}

/// A row of any measurement.
pub trait Row: Serialize {
    /// The fields that every row has.
    fn common(&self) -> &Common;
    /// Headings of the fields that only these rows have, for the table.
    const HEADINGS: &'static [&'static str];
    /// Their cells.
    fn cells(&self) -> Vec<String>;
    /// What else there is to say under the table.
    fn footer(_rows: &[Self]) -> Option<String>
    where
        Self: Sized,
    {
        None
    }
}

/// A JSON array, one object a line.
///
/// # Errors
/// Never for the rows of this crate.
pub fn json<R: Serialize>(rows: &[R]) -> serde_json::Result<String> {
    let lines = rows.iter().map(serde_json::to_string).collect::<serde_json::Result<Vec<_>>>()?;
    Ok(format!("[\n  {}\n]", lines.join(",\n  ")))
}

/// One line a row; below them the footer.
pub fn text<R: Row>(rows: &[R], paint: Paint) -> String {
    let table = table(rows, paint);
    match R::footer(rows) {
        Some(footer) => format!("{table}\n{footer}"),
        None => table.to_string(),
    }
}

fn table<R: Row>(rows: &[R], paint: Paint) -> Table {
    let headings = [&["case", "method", "size", "l", "depth", "median ms", "p99 ms", "frames/s"], R::HEADINGS].concat();
    let mut table = paint.table(&headings);
    // Many short rows are read down the columns.
    for lines in [TableComponent::HorizontalLines, TableComponent::MiddleIntersections] {
        table.remove_style(lines);
    }
    let right = |text: String| Cell::new(text).set_alignment(CellAlignment::Right);
    for row in rows {
        let Common { case, method, size, order, depth, median_ms, p99_ms, frames_per_s, .. } = row.common();
        let order = if *order == 0 { "–".to_owned() } else { order.to_string() };
        let mut cells = vec![paint.bold_cell(case), Cell::new(method), Cell::new(size), right(order), Cell::new(depth)];
        cells.extend([number(*median_ms), number(*p99_ms), number(*frames_per_s)].map(right));
        cells.extend(row.cells().into_iter().map(right));
        table.add_row(cells);
    }
    table
}

/// Where plots and rows go.
#[derive(clap::Args, Clone, Debug)]
pub struct OutOptions {
    /// A folder for the rows as JSON and plots of what was varied [default: runs/bench, when several sizes, orders or numbers of tasks
    /// are given]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Print a JSON array instead of a table
    #[arg(long)]
    pub json: bool,
}

impl OutOptions {
    /// The folder to write into, if any.
    pub fn folder(&self, several: bool) -> Option<PathBuf> {
        self.out.clone().or_else(|| several.then(|| PathBuf::from("runs/bench")))
    }
}

/// Writes `<name>.json` and the plots.
///
/// # Errors
/// Fails, naming the file, when something cannot be written.
pub fn write<R: Serialize>(folder: &Path, name: &'static str, rows: &[R], panels: &[Panel]) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(format!("{name}.json"));
    std::fs::write(&path, json(rows)? + "\n").with_context(|| format!("cannot write {}", path.display()))?;
    if panels.is_empty() {
        return Ok(());
    }
    write_plots(folder, &[Plot { name, svg: charts(panels)? }])
}

/// Cost against pixels, and against order, of what was varied: one panel for each method, depth and case, one line for each order or size.
pub fn growth_panels<R: Row>(rows: &[R]) -> Vec<Panel> {
    let rows: Vec<&Common> = rows.iter().map(Row::common).collect();
    let mut groups: Vec<(&str, &str, &str)> = Vec::new();
    for row in &rows {
        let group = (row.method, row.depth, row.case);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    let mut panels = Vec::new();
    for group @ (method, depth, case) in groups {
        let members: Vec<&Common> =
            rows.iter().copied().filter(|row| (row.method, row.depth, row.case) == group).collect();
        let title = format!("{method}, {case}, depth {depth}");
        let order_label = |row: &Common| if row.order == 0 { String::new() } else { format!("l = {}", row.order) };
        let against_pixels = series(&members, order_label, |row| row.pixels as f64 / 1e3);
        panels.extend(panel(&title, "thousand pixels", against_pixels));
        let against_order = series(&members, |row| row.size.clone(), |row| f64::from(row.order));
        panels.extend(panel(&title, "order l", against_order));
    }
    panels
}

/// Lines of at least two different points, from left to right; of many lines a few, the first and the last among them.
fn series(rows: &[&Common], label: impl Fn(&Common) -> String, x: impl Fn(&Common) -> f64) -> Vec<Series> {
    let mut lines: Vec<Series> = Vec::new();
    for row in rows {
        let (label, point) = (label(row), (x(row), row.median_ms));
        match lines.iter_mut().find(|line| line.label == label) {
            Some(line) => line.points.push(point),
            None => lines.push(Series { label, points: vec![point] }),
        }
    }
    for line in &mut lines {
        line.points.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    lines.retain(|line| line.points.first().map(|point| point.0) != line.points.last().map(|point| point.0));
    let last = lines.len().saturating_sub(1);
    let is_kept =
        |index: usize| last < MOST_LINES || (0..MOST_LINES).any(|kept| kept * last / (MOST_LINES - 1) == index);
    lines.into_iter().enumerate().filter_map(|(index, line)| is_kept(index).then_some(line)).collect()
}

fn panel(title: &str, x_label: &str, series: Vec<Series>) -> Option<Panel> {
    (!series.is_empty()).then(|| Panel {
        title: title.to_owned(),
        x_label: x_label.to_owned(),
        y_label: "median, ms".to_owned(),
        scale: Scale::Linear,
        series,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    struct OneRow(Common);

    impl Serialize for OneRow {
        fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            self.0.serialize(serializer)
        }
    }

    impl Row for OneRow {
        const HEADINGS: &'static [&'static str] = &[];

        fn common(&self) -> &Common {
            &self.0
        }

        fn cells(&self) -> Vec<String> {
            Vec::new()
        }
    }

    fn row(pixels: usize, order: u16) -> OneRow {
        OneRow(Common {
            case: "cached",
            size: format!("{pixels}x1"),
            order,
            method: "hahn",
            depth: "map",
            median_ms: 1.0,
            p99_ms: 2.0,
            mean_ms: 1.0,
            frames_per_s: 1000.0,
            gflops: None,
            peak_fraction: Some(f64::NAN),
            samples: 1,
            pixels,
        })
    }

    #[test]
    fn only_what_was_varied_is_drawn_and_a_panel_has_room_for_its_title() {
        assert!(growth_panels(&[row(10, 8)]).is_empty());
        let sizes: Vec<OneRow> = (1..=9).flat_map(|size| [row(1000 * size, 4), row(1000 * size, 8)]).collect();
        let panels = growth_panels(&sizes);
        let lines: Vec<Vec<&str>> =
            panels.iter().map(|panel| panel.series.iter().map(|line| line.label.as_str()).collect()).collect();
        assert_eq!(lines, [vec!["l = 4", "l = 8"], vec!["1000x1", "3000x1", "5000x1", "7000x1", "9000x1"]]);
    }

    #[test]
    fn what_is_not_a_number_is_null() {
        let text = json(&[row(10, 8)]).expect("JSON");
        let read: serde_json::Value = serde_json::from_str(&text).expect("an array");
        assert!(read[0]["gflops"].is_null() && read[0]["peak_fraction"].is_null() && read[0].get("pixels").is_none());
    }
}
