//! The bar of a long command on standard error: how far, how long still. Silent when that is no terminal.

use std::fmt::Write;
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

use crate::paint::Paint;

/// A bar for `all` runs, of which `known` were done before; only the others count for the time left.
pub fn bar(all: usize, known: usize, paint: Paint) -> ProgressBar {
    let template = match paint.colored {
        true => "{bar:30.green} {pos}/{len} runs{left}  {msg}",
        false => "{bar:30} {pos}/{len} runs{left}  {msg}",
    };
    // Before the first run is done nothing is known of the time.
    let left = move |state: &ProgressState, line: &mut dyn Write| {
        if state.pos() > known as u64 {
            let _ = write!(line, "  {:#} left", HumanDuration(state.eta()));
        }
    };
    let style = ProgressStyle::with_template(template).expect("the template is a constant that parses");
    let style = style.with_key("left", left);
    let bar = ProgressBar::new(all as u64).with_style(style).with_position(known as u64);
    bar.reset_eta();
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}
