//! One line on standard error that follows a run: image, pixel error, order, pose error, status.

use std::io::{IsTerminal, stderr};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::RunRow;
use super::summary::number;
use crate::paint::Paint;

/// The live line. Silent when standard error is not a terminal.
pub struct LiveLine {
    bar: ProgressBar,
}

impl LiveLine {
    /// A line that starts with `title`, for example the method; it appears with the first thing shown or said.
    pub fn new(title: &str, paint: Paint) -> LiveLine {
        let target = if stderr().is_terminal() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let template = match paint.colored {
            true => "{spinner:.green} {prefix:.bold} {wide_msg}",
            false => "{spinner} {prefix} {wide_msg}",
        };
        let style = ProgressStyle::with_template(template).expect("the template is a constant that parses");
        let bar = ProgressBar::with_draw_target(None, target).with_style(style).with_prefix(title.to_owned());
        LiveLine { bar }
    }

    /// Shows the newest row; the terminal is written to at most 20 times a second.
    pub fn show(&self, row: &RunRow) {
        self.bar.set_message(line(row));
        self.bar.tick();
    }

    /// Says in words what happens where there is no row, for example `waiting for the camera`.
    pub fn say(&self, text: &str) {
        self.bar.set_message(text.to_owned());
        self.bar.tick();
    }

    /// Takes the line away, so that the table stands alone.
    pub fn clear(self) {
        self.bar.finish_and_clear();
    }
}

fn line(row: &RunRow) -> String {
    format!(
        "image {:>4}  pixel error {}  order {:>2}  {:>7} mm {:>6}°  {}",
        row.image,
        if row.pixel_mse.is_finite() { format!("{:.2e}", row.pixel_mse) } else { "–".to_owned() },
        row.order,
        number(row.error_mm),
        number(row.error_deg),
        row.status
    )
}

#[cfg(test)]
mod tests {
    use super::super::record::synthetic;
    use super::*;

    #[test]
    fn a_line_says_where_the_run_is_and_fits_eighty_columns() {
        let record = synthetic::run();
        let text = line(&record.rows[0]);
        assert_eq!(text, "image    0  pixel error 6.10e-2  order  4    662.0 mm  35.10°  servoing");
        assert!(record.rows.iter().all(|row| line(row).chars().count() <= 78));
    }

    #[test]
    fn a_live_line_without_a_terminal_draws_nothing_and_does_not_fail() {
        let live = LiveLine { bar: ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden()) };
        live.say("waiting");
        live.show(&RunRow::empty(0));
        assert!(live.bar.is_hidden());
        live.clear();
    }
}
