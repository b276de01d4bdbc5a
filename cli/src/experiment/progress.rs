//! The bar of a long command on standard error: how far, how long still. Silent when that is no terminal.

use std::fmt::Write;
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

use crate::paint::Paint;

/// A bar for `all` of `what` ("runs", say), of which `known` were done before; only the others count for the time left.
pub fn bar(what: &str, all: usize, known: usize, paint: Paint) -> ProgressBar {
    let template = match paint.colored {
        true => format!("{{bar:30.green}} {{pos}}/{{len}} {what}{{left}}  {{msg}}"),
        false => format!("{{bar:30}} {{pos}}/{{len}} {what}{{left}}  {{msg}}"),
    };
    // Before the first run is done nothing is known of the time.
    let left = move |state: &ProgressState, line: &mut dyn Write| {
        if state.pos() > known as u64 {
            let _ = write!(line, "  {:#} left", HumanDuration(state.eta()));
        }
    };
    let style = ProgressStyle::with_template(&template).expect("the template parses whatever a word is in it");
    let style = style.with_key("left", left);
    let bar = ProgressBar::new(all as u64).with_style(style).with_position(known as u64);
    bar.reset_eta();
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}
