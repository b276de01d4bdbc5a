//! `frames.csv`: one line per image, units in the headings, an empty cell for what does not apply.

use std::path::Path;

use anyhow::Context;

use super::RunRow;

const HEADINGS: [&str; 21] = [
    "image",
    "time_s",
    "status",
    "order",
    "window",
    "vx_m_per_s",
    "vy_m_per_s",
    "vz_m_per_s",
    "wx_rad_per_s",
    "wy_rad_per_s",
    "wz_rad_per_s",
    "pixel_mse",
    "feature_error_norm",
    "condition_number",
    "compute_us",
    "round_trip_us",
    "error_mm",
    "error_deg",
    "x_m",
    "y_m",
    "z_m",
];

/// Writes `rows` with a heading line.
pub fn write_csv(path: &Path, rows: &[RunRow]) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let mut writer = csv::Writer::from_path(path).with_context(failed)?;
    writer.write_record(HEADINGS).with_context(failed)?;
    for row in rows {
        writer.write_record(cells(row)).with_context(failed)?;
    }
    writer.flush().with_context(failed)
}

fn cells(row: &RunRow) -> Vec<String> {
    let mut cells = vec![row.image.to_string(), cell(row.time_s), row.status.clone(), row.order.to_string()];
    cells.push(row.window.iter().map(f64::to_string).collect::<Vec<_>>().join(" "));
    cells.extend(row.twist.map(cell));
    cells.extend([row.pixel_mse, row.feature_error_norm, row.condition_number].map(cell));
    cells.extend([row.compute_us, row.round_trip_us, row.error_mm, row.error_deg].map(cell));
    cells.extend(row.position_m.map(cell));
    cells
}

/// As many digits as it takes to read the same number back.
fn cell(value: f64) -> String {
    if value.is_finite() { value.to_string() } else { String::new() }
}

#[cfg(test)]
mod tests {
    use super::super::record::synthetic;
    use super::*;

    #[test]
    fn every_number_reads_back_exactly_and_nan_is_an_empty_cell() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("frames.csv");
        let mut rows = synthetic::run().rows;
        rows.push(RunRow::empty(30));
        write_csv(&path, &rows).expect("a file");

        let mut reader = csv::Reader::from_path(&path).expect("the file");
        let headings = reader.headers().expect("headings").clone();
        let column = |name: &str| headings.iter().position(|heading| heading == name).expect("the column");
        let lines: Vec<_> = reader.records().map(|line| line.expect("as many cells as headings")).collect();
        assert_eq!(lines.len(), rows.len());
        for (line, row) in lines.iter().zip(&rows).take(30) {
            assert_eq!(line[column("wz_rad_per_s")].parse(), Ok(row.twist[5]));
            assert_eq!(line[column("pixel_mse")].parse(), Ok(row.pixel_mse));
            assert_eq!(line[column("z_m")].parse(), Ok(row.position_m[2]));
            assert_eq!(&line[column("window")], "8 8 8 8");
        }
        assert_eq!(&lines[30][column("pixel_mse")], "");
        assert_eq!(&lines[30][column("status")], "");
    }
}
