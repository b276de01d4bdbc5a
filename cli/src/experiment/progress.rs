//! The bar of a long command on standard error: how far, how long still. Silent when that is no terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::paint::Paint;

/// A bar for `all` runs, of which `known` were done before; only the others count for the time left.
pub fn bar(all: usize, known: usize, paint: Paint) -> ProgressBar {
    let template = match paint.colored {
        true => "{bar:30.green} {pos}/{len} runs  {eta} left  {msg}",
        false => "{bar:30} {pos}/{len} runs  {eta} left  {msg}",
    };
    let style = ProgressStyle::with_template(template).expect("the template is a constant that parses");
    let bar = ProgressBar::new(all as u64).with_style(style).with_position(known as u64);
    bar.reset_eta();
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}
