//! `domvs bench step`: the law alone.

use std::process::ExitCode;

use anyhow::anyhow;
use clap::Args;
use domvs_vision::Path;

use super::{at_least_one, finish};
use crate::bench::cases::CaseOptions;
use crate::bench::rows::{OutOptions, Row, growth_panels};
use crate::bench::step::{Effort, measure, parts};
use crate::bench::watch::Watch;
use crate::options::positive;
use crate::paint::Paint;

/// One step of the law, on one thread: parameters, bases, both images, depth, the twist
///
/// moved: the window has moved, so that bases and both images are computed. cached: it has not, and what was made of the desired image is
/// kept. Tchebichef, cosine and a window of fixed numbers never move.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct StepArgs {
    #[command(flatten)]
    cases: CaseOptions,

    /// Timed steps of each case
    #[arg(long, value_name = "N", default_value = "200", value_parser = at_least_one)]
    steps: usize,

    /// Seconds of timed steps after which fewer will do for a case
    #[arg(long, value_name = "S", default_value = "3", value_parser = positive)]
    seconds: f64,

    /// Use these instructions, if this machine has them: avx512, avx2, sse4.2, sse2, neon, fallback [default: the best]
    #[arg(long, value_name = "PATH")]
    path: Option<String>,

    #[command(flatten)]
    out: OutOptions,
}

const AFTER_HELP: &str = "\
gflops counts two operations for each multiply-add of the sums in the equations, half as many where even and odd rows meet a folded \
image. \
peak_gflops is what one core did in the same run with nothing but multiply-adds in registers.

The JSON objects have case, size, order, method, depth, median_ms, p99_ms, mean_ms, min_ms, frames_per_s, gflops, peak_fraction, \
peak_gflops, path, samples, window_moves, bases_per_step, desired_sweeps_per_step (both counted, not assumed) and multiply_adds.

Exit codes: 0 done, 1 an error, 2 the command line was not understood, 130 interrupted.";

/// Measures.
pub(super) fn run(args: &StepArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let cases = args.cases.cases()?;
    let path = match &args.path {
        None => Path::best(),
        Some(word) => Path::named(word).ok_or_else(|| no_path(word))?,
    };
    let watch = Watch::start(parts(&cases), paint_errors)?;
    let rows = measure(&cases, Effort { steps: args.steps, seconds: args.seconds, path }, &watch);
    let still: Vec<String> =
        rows.iter().flatten().filter(|row| !row.window_moves).map(|row| row.common().method.to_owned()).collect();
    let code = finish(rows, &watch, &args.out, "step", growth_panels, paint)?;
    if let (Some(method), false) = (still.first(), args.out.json) {
        eprintln!("the window of {method} does not move here: its cases are all cached");
    }
    Ok(code)
}

fn no_path(word: &str) -> anyhow::Error {
    let available: Vec<String> = Path::available().iter().map(Path::to_string).collect();
    anyhow!("--path {word}: this machine has {}", available.join(", "))
}
