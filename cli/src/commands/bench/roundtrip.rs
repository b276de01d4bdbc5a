//! `domvs bench roundtrip`: a frame's way over the network and back.

use std::process::ExitCode;

use clap::Args;

use super::{at_least_one, finish};
use crate::bench::cases::CaseOptions;
use crate::bench::place::{Place, PlaceOptions};
use crate::bench::roundtrip::{Effort, measure};
use crate::bench::rows::{OutOptions, growth_panels};
use crate::bench::watch::Watch;
use crate::options::positive;
use crate::paint::Paint;

/// A frame's way from a client to the worker and its twist's way back, beside an echo
///
/// Without an endpoint, a worker (`domvs serve`) and an echo are started as two processes, each one TCP link on the loopback away. The
/// echo answers as many bytes at once. Frames are 8-bit gray, with 16-bit depth for --depth map. The same client asks the echo, a task
/// whose window moves and one whose window stays in turns, one request at a time.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct RoundtripArgs {
    #[command(flatten)]
    cases: CaseOptions,

    /// Requests of each kind, for each case
    #[arg(long, value_name = "N", default_value = "300", value_parser = at_least_one)]
    samples: usize,

    /// Seconds for a case after which fewer will do
    #[arg(long, value_name = "S", default_value = "10", value_parser = positive)]
    seconds: f64,

    #[command(flatten)]
    place: PlaceOptions,

    #[command(flatten)]
    out: OutOptions,
}

const AFTER_HELP: &str = "\
With --endpoint the service that runs there is measured; the echo joins it, and is one link further away when that service is its own router.

The JSON objects have case (echo, moved or cached), size, order, method, depth, median_ms, p99_ms, mean_ms, frames_per_s, samples, \
step_ms (what the worker says that it computed, decoding included), queue_ms (what the frame waited before), echo_ms, overhead_ms (median_ms - \
echo_ms - step_ms) and payload_bytes; gflops and peak_fraction are null.

Exit codes: 0 done, 1 an error, 2 the command line was not understood, 130 interrupted.";

/// Measures.
pub(super) fn run(args: &RoundtripArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let cases = args.cases.cases()?;
    let watch = Watch::start(cases.len(), paint_errors)?;
    let effort = Effort { samples: args.samples as u64, seconds: args.seconds };
    let rows =
        Place::open(&args.place).and_then(|place| crate::runtime()?.block_on(measure(&place, &cases, effort, &watch)));
    finish(rows, &watch, &args.out, "roundtrip", growth_panels, paint)
}
