//! What many runs leave: a table for people, lines of JSON for programs, CSV for spreadsheets.

use std::path::Path;

use anyhow::Context;
use comfy_table::{Cell as TableCell, CellAlignment, Table};
use serde::Serialize;
use serde_json::json;

use super::cells::Cell;
use super::outcome::Outcome;
use super::spec::Experiment;
use crate::paint::Paint;
use crate::report::number;

/// One row per run: how it ended.
pub fn run_table(outcomes: &[Outcome], paint: Paint) -> Table {
    let mut table = paint.table(&["scene", "disturbance", "method", "status", "images", "error mm", "error °", "path"]);
    for run in outcomes {
        let verdict = if run.converged { "converged" } else { "not converged" };
        let said = if run.status == "converged" || run.status == "servoing" {
            verdict.to_owned()
        } else {
            format!("{verdict}: {}", run.status)
        };
        table.add_row([
            TableCell::new(&run.scene),
            TableCell::new(&run.disturbance),
            paint.bold_cell(&run.method),
            paint.verdict_cell(&said, run.converged),
            right(run.images.map_or("–".into(), |images| images.to_string())),
            right(number(run.error_mm)),
            right(number(run.error_deg)),
            right(optional(run.path_ratio, 2)),
        ]);
    }
    without_empty_disturbance(table, outcomes.iter().all(|run| run.disturbance.is_empty()))
}

/// One row per cell: the rate and its interval.
pub fn cell_table(cells: &[Cell], paint: Paint) -> Table {
    let headings =
        ["scene", "disturbance", "method", "converged", "rate %", "95 % interval", "images", "path", "error mm"];
    let mut table = paint.table(&headings);
    for cell in cells {
        table.add_row([
            TableCell::new(&cell.scene),
            TableCell::new(&cell.disturbance),
            paint.bold_cell(&cell.method),
            right(format!("{}/{}", cell.successes, cell.runs)),
            right(format!("{:.1}", 100.0 * cell.success_rate)),
            right(format!("{:.1}–{:.1}", 100.0 * cell.wilson_low, 100.0 * cell.wilson_high)),
            right(optional(cell.median_images, 0)),
            right(optional(cell.median_path_ratio, 2)),
            right(cell.median_error_mm.map_or("–".into(), number)),
        ]);
    }
    without_empty_disturbance(table, cells.iter().all(|cell| cell.disturbance.is_empty()))
}

fn without_empty_disturbance(mut table: Table, empty: bool) -> Table {
    if let (true, Some(column)) = (empty, table.column_mut(1)) {
        column.set_constraint(comfy_table::ColumnConstraint::Hidden);
    }
    table
}

fn right(text: String) -> TableCell {
    TableCell::new(text).set_alignment(CellAlignment::Right)
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.digits$}"))
}

/// One object a line: the runs, then the cells.
///
/// # Errors
/// Never in practice: every value has a JSON form.
pub fn json_lines(outcomes: &[Outcome], cells: &[Cell]) -> anyhow::Result<String> {
    let runs = outcomes.iter().map(serde_json::to_string);
    let cells = cells.iter().map(serde_json::to_string);
    Ok(runs.chain(cells).collect::<Result<Vec<_>, _>>()?.join("\n"))
}

/// Writes `results.json`, `runs.csv` and `cells.csv`.
///
/// # Errors
/// Fails, naming the file, when one cannot be written.
pub fn write_results(
    folder: &Path,
    experiment: &Experiment,
    outcomes: &[Outcome],
    cells: &[Cell],
) -> anyhow::Result<()> {
    let Experiment { name, about, seed, .. } = experiment;
    let all = json!({
        "experiment": name, "about": about, "seed": seed, "version": env!("CARGO_PKG_VERSION"),
        "runs": outcomes, "cells": cells,
    });
    let path = folder.join("results.json");
    std::fs::write(&path, serde_json::to_string_pretty(&all)? + "\n")
        .with_context(|| format!("cannot write {}", path.display()))?;
    write_csv(&folder.join("runs.csv"), outcomes)?;
    write_csv(&folder.join("cells.csv"), cells)
}

/// The fields of each object as columns; lists have spaces between their numbers.
fn write_csv<T: Serialize>(path: &Path, rows: &[T]) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let mut writer = csv::Writer::from_path(path).with_context(failed)?;
    for (index, row) in rows.iter().enumerate() {
        let fields = fields_in_order(row)?;
        if index == 0 {
            writer.write_record(fields.iter().map(|(name, _)| name)).with_context(failed)?;
        }
        writer.write_record(fields.iter().map(|(_, cell)| cell)).with_context(failed)?;
    }
    writer.flush().with_context(failed)
}

/// Names and cells of a struct's fields; JSON text keeps their order, a JSON map would not.
fn fields_in_order<T: Serialize>(row: &T) -> anyhow::Result<Vec<(String, String)>> {
    let value = serde_json::to_value(row)?;
    let text = serde_json::to_string(row)?;
    let object = value.as_object().context("a row is a struct")?;
    let place = |name: &String| text.find(&format!("\"{name}\":")).unwrap_or(usize::MAX);
    let mut names: Vec<&String> = object.keys().collect();
    names.sort_by_key(|name| place(name));
    Ok(names.into_iter().map(|name| (name.clone(), csv_cell(&object[name]))).collect())
}

fn csv_cell(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Null => String::new(),
        serde_json::Value::String(text) => text.clone(),
        serde_json::Value::Array(list) => list.iter().map(csv_cell).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::cells::cells;
    use super::super::outcome::synthetic::outcome;
    use super::*;

    #[test]
    fn json_has_a_line_for_every_run_and_then_for_every_cell() {
        let outcomes = [outcome("a"), outcome("b")];
        let text = json_lines(&outcomes, &cells(&outcomes)).expect("JSON");
        let lines: Vec<serde_json::Value> =
            text.lines().map(|line| serde_json::from_str(line).expect("an object")).collect();
        assert_eq!(lines.len(), 3);
        for key in
            ["scene", "method", "seed", "displacement", "converged", "images", "error_mm", "error_deg", "path_ratio"]
        {
            assert!(!lines[0][key].is_null(), "{key}");
        }
        assert_eq!((&lines[2]["success_rate"], &lines[2]["runs"]), (&1.0.into(), &2.into()));
    }

    #[test]
    fn csv_has_the_fields_in_their_order_and_an_empty_cell_for_null() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut outcomes = vec![outcome("a")];
        outcomes[0].images = None;
        let experiment = Experiment::parse("name = 'x'").expect("a file");
        write_results(folder.path(), &experiment, &outcomes, &cells(&outcomes)).expect("three files");
        let text = std::fs::read_to_string(folder.path().join("runs.csv")).expect("the file");
        assert!(text.starts_with("experiment,scene,disturbance,method,seed,displacement,converged,images,"), "{text}");
        assert!(text.contains(",7,0.1 -0.2 0.3 1.0 -2.0 3.0,true,,30,"), "{text}");
    }

    #[test]
    fn tables_leave_out_a_disturbance_that_nobody_has() {
        let outcomes = [outcome("a")];
        let text = cell_table(&cells(&outcomes), Paint::default()).to_string();
        assert!(text.contains("1/1") && text.contains("20.7–100.0") && !text.contains("disturbance"), "{text}");
        assert!(!run_table(&outcomes, Paint::default()).to_string().contains("disturbance"));
    }
}
