//! `domvs bench soak`: tasks, churn and faults together, and a verdict.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;

use super::at_least_one;
use crate::bench::soak::{Soak, run as soak};
use crate::bench::watch::Watch;
use crate::exit;
use crate::options::positive;
use crate::paint::{Paint, print_line};

/// Much at once, for long: does everything hold that is promised?
///
/// Starts a router and workers, and for each task a client with a camera; half of them ask for twists, half push frames. Cameras stop, freeze, go
/// black, lie and send frames of the past; clients vanish; readers do not read; tasks come and go; workers are killed and stopped.
/// Every twist is held against the frames that went out, memory and open files of the workers are watched, and in the
/// end there is a table of what held. The same seed makes the same plan of faults.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct SoakArgs {
    /// How long
    #[arg(long, value_name = "M", default_value = "1", value_parser = positive)]
    minutes: f64,

    /// How many tasks at once, besides those that come and go
    #[arg(long, value_name = "N", default_value = "10", value_parser = at_least_one)]
    tasks: usize,

    /// How many workers; with more than one, a task must live through the death of its worker
    #[arg(long, value_name = "N", default_value = "1", value_parser = at_least_one)]
    workers: usize,

    /// What the plan of faults is made from
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,

    /// Print JSON instead of tables
    #[arg(long)]
    json: bool,

    /// A folder for soak.json
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

const AFTER_HELP: &str = "\
The JSON object has passed, seed, minutes, tasks, workers, checks (promise, held, said), figures, statuses, refusals, faults, plan (at_s, \
lasts_s, fault, whom) and workers_over_time (looks: second, MB, open files).

Exit codes: 0 everything held, 1 something did not, or an error, 2 the command line was not understood, 130 interrupted.";

/// Runs it.
pub(super) fn run(args: &SoakArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let watch = Watch::start((60.0 * args.minutes) as usize, paint_errors)?;
    let SoakArgs { minutes, tasks, workers, seed, .. } = *args;
    let folder = std::env::temp_dir().join(format!("domvs-soak-{}", std::process::id()));
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let runtime = crate::runtime()?;
    let verdict = soak(&Soak { minutes, tasks, workers, seed }, &runtime, &folder, &watch);
    runtime.shutdown_background();
    watch.finish();
    if let Err(error) = std::fs::remove_dir_all(&folder) {
        tracing::warn!(%error, folder = %folder.display(), "left behind");
    }
    let verdict = match verdict {
        Err(error) if watch.is_stopped() => {
            eprintln!("{error:#}");
            return Ok(exit::interrupted());
        }
        verdict => verdict?,
    };
    let json = serde_json::to_string(&verdict)?;
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let path = folder.join("soak.json");
        std::fs::write(&path, format!("{json}\n")).with_context(|| path.display().to_string())?;
    }
    print_line(&if args.json { json } else { verdict.text(paint) }).context("cannot write the verdict")?;
    Ok(if verdict.passed { exit::done() } else { exit::failed() })
}
