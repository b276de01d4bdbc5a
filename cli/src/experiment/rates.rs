//! A sweep for people: its page, and the rates with their intervals as a picture.

use std::fmt::Write;
use std::path::Path;

use anyhow::Context;

use super::cells::Cell;
use super::page::{Page, escaped};
use super::spec::Experiment;
use crate::report::plots::Plot;

const WIDTH: f64 = 760.0;
const LEFT: f64 = 230.0;
const SPAN: f64 = 420.0;
const ROW: f64 = 20.0;
const TOP: f64 = 44.0;

/// Writes `index.html` and `rates.svg` into `folder`.
///
/// # Errors
/// Fails, naming the file, when one cannot be written.
pub fn write(folder: &Path, experiment: &Experiment, cells: &[Cell]) -> anyhow::Result<()> {
    let plot = Plot { name: "rates", svg: svg(cells) };
    let mut page = Page::new(&format!("Sweep {}", experiment.name));
    page.introduction(experiment);
    page.text("Intervals are Wilson's, 95 %; images and path are medians over the converged runs.");
    page.wide([&plot]);
    page.cells(cells);
    for (name, text) in [("rates.svg", &plot.svg), ("index.html", &page.finish())] {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// A row for each cell, under headings of scene and disturbance: a bar for the rate, a line for its interval.
fn svg(cells: &[Cell]) -> String {
    let mut rows = String::new();
    let mut y = TOP;
    for group in cells.chunk_by(|a, b| (&a.scene, &a.disturbance) == (&b.scene, &b.disturbance)) {
        let first = &group[0];
        let sign = if first.disturbance.is_empty() { "" } else { " · " };
        let heading = escaped(&format!("{}{sign}{}", first.scene, first.disturbance));
        y += ROW;
        let _ = writeln!(rows, "<text x=\"12\" y=\"{}\" font-weight=\"bold\">{heading}</text>", y + 14.0);
        for cell in group {
            y += ROW;
            rows.push_str(&row(cell, y));
        }
    }
    let bottom = y + ROW + 4.0;
    let mut grid = String::new();
    for percent in [0.0, 25.0, 50.0, 75.0, 100.0] {
        let x = LEFT + SPAN * percent / 100.0;
        let _ = writeln!(
            grid,
            "<path d=\"M{x} {TOP}V{bottom}\" stroke=\"#ddd\"/><text x=\"{x}\" y=\"{}\" text-anchor=\"middle\">{percent}</text>",
            TOP - 6.0
        );
    }
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{h}\" viewBox=\"0 0 {WIDTH} {h}\" \
         font-family=\"sans-serif\" font-size=\"13\" fill=\"#222\">\n<rect width=\"{WIDTH}\" height=\"{h}\" fill=\"#fff\"/>\n\
         <text x=\"{middle}\" y=\"18\" text-anchor=\"middle\" font-size=\"14\">converged, % of the runs, with 95 % intervals\
         </text>\n{grid}{rows}</svg>\n",
        h = bottom + 8.0,
        middle = LEFT + SPAN / 2.0,
    )
}

fn row(cell: &Cell, y: f64) -> String {
    let name = escaped(&cell.method);
    let x = |rate: f64| LEFT + SPAN * rate;
    let (low, high) = (x(cell.wilson_low), x(cell.wilson_high));
    let (middle, baseline, top, end) = (y + 10.0, y + 14.0, y + 4.0, LEFT + SPAN + 14.0);
    let width = SPAN * cell.success_rate;
    format!(
        "<text x=\"{name_end}\" y=\"{baseline}\" text-anchor=\"end\">{name}</text>\
         <rect x=\"{LEFT}\" y=\"{top}\" width=\"{width:.1}\" height=\"12\" fill=\"#7fb3d9\"/>\
         <path d=\"M{low:.1} {middle}H{high:.1}M{low:.1} {top}v12M{high:.1} {top}v12\" stroke=\"#222\" fill=\"none\"/>\
         <text x=\"{end}\" y=\"{baseline}\">{}/{}</text>\n",
        cell.successes,
        cell.runs,
        name_end = LEFT - 10.0,
    )
}

#[cfg(test)]
mod tests {
    use super::super::cells::cells;
    use super::super::outcome::{Outcome, synthetic::outcome};
    use super::*;

    #[test]
    fn a_sweep_leaves_a_page_with_every_cell_and_its_plot() {
        let runs = ["A & B", "C"].map(|method| Outcome { method: method.into(), ..outcome("k") });
        let folder = tempfile::tempdir().expect("a folder");
        let experiment = Experiment::parse("name = 'x'\nabout = 'what it is'").expect("a file");
        write(folder.path(), &experiment, &cells(&runs)).expect("a page");
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("a file");
        let (page, svg) = (read("index.html"), read("rates.svg"));
        assert!(page.contains("what it is") && page.contains("<svg") && page.contains("<td>A &amp; B</td>"));
        assert!(svg.contains("A &amp; B") && svg.matches("<rect x=").count() == 2);
    }
}
