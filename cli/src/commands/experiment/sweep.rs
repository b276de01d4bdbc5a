//! `domvs experiment sweep`: rates, over many displacements.

use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::Args;

use super::Common;
use crate::exit;
use crate::experiment::cells::cells;
use crate::experiment::outcome::Outcome;
use crate::experiment::plan::{Overrides, RunPlan};
use crate::experiment::runner::{self, Nobody};
use crate::experiment::service::Service;
use crate::experiment::store::Store;
use crate::experiment::summary::{cell_table, json_lines, write_results};
use crate::experiment::world::Worlds;
use crate::experiment::{named, pool, progress, rates};
use crate::paint::{Paint, print_line};

/// Count how often methods converge, over many displacements
///
/// Methods x scenes x disturbances x seeded displacements, on all cores. Every finished run is appended to results.jsonl in the
/// folder at once; run the same command again to go on where it stopped, after Ctrl-C or a crash. A change of the file runs
/// again only what it changes.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct SweepArgs {
    #[command(flatten)]
    pub(super) common: Common,

    /// Displacements of each cell, instead of the file's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) displacements: Option<u32>,

    /// Forget earlier results in the folder
    #[arg(long)]
    pub(super) fresh: bool,
}

const AFTER_HELP: &str = "\
A run has converged when the camera ends within the file's tolerance (1 mm and 0.1° by default) by the simulator's truth. \
images is the number of images after which it stayed there; path is the length of the camera's path over the straight line; both \
are medians over the converged runs. Intervals are Wilson's, 95 %.

The folder holds index.html (the table, and the rates with their intervals as a plot), rates.svg, results.jsonl (what is done), \
results.json (runs and cells), runs.csv and cells.csv. A texture, a photograph or a mesh that has changed counts as a change of \
the file; what a mesh's file names in turn does not (--fresh).

Exit codes: 0 every run is done, whatever the rates, 1 an error, 2 the command line was not understood, 130 interrupted.";

/// Runs what is missing and counts.
///
/// # Errors
/// Fails when a name or a file is none, a world or a setting is impossible, or the folder cannot be written.
pub fn run(args: &SweepArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let common = &args.common;
    let experiment = named::find(&common.experiment)?;
    let plans = experiment.plan(&Overrides { displacements: args.displacements, ..common.overrides() })?;
    let out = common.out(&experiment.name);
    std::fs::create_dir_all(&out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let path = out.join("results.jsonl");
    if args.fresh && path.exists() {
        std::fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
    }
    let mut store = Store::open(&path)?;
    let interrupted = pool::interruption()?;
    run_missing(common, &plans, &mut store, &interrupted, paint_errors)?;

    let outcomes: Vec<Outcome> = plans.iter().filter_map(|plan| store.get(&plan.key()).cloned()).collect();
    let cells = cells(&outcomes);
    write_results(&out, &experiment, &outcomes, &cells)?;
    rates::write(&out, &experiment, &cells)?;
    let text = match common.json {
        true => json_lines(&outcomes, &cells)?,
        false => format!("{}\nresults: {}", cell_table(&cells, paint), out.join("index.html").display()),
    };
    print_line(&text).context("cannot write the result")?;
    if interrupted.load(Ordering::Relaxed) && outcomes.len() < plans.len() {
        let (done, all) = (outcomes.len(), plans.len());
        eprintln!("interrupted after {done} of {all} runs; the same command goes on from there");
        return Ok(exit::interrupted());
    }
    Ok(exit::done())
}

/// Runs those plans that the store does not know.
fn run_missing(
    common: &Common,
    plans: &[RunPlan],
    store: &mut Store,
    interrupted: &AtomicBool,
    paint: Paint,
) -> anyhow::Result<()> {
    let missing: Vec<RunPlan> = plans.iter().filter(|plan| store.get(&plan.key()).is_none()).cloned().collect();
    let bar = progress::bar("runs", plans.len(), plans.len() - missing.len(), paint);
    let worlds = Worlds::default();
    let services = common.services()?;
    let work = |service: &mut Box<dyn Service>, plan: &RunPlan| {
        runner::run(plan, &worlds, service.as_mut(), &mut Nobody, interrupted)
    };
    let done = |_, run: Option<runner::Run>| match run {
        Some(run) => {
            bar.inc(1);
            store.add(run.outcome)
        }
        None => Ok(()),
    };
    let result = pool::in_parallel(common.jobs(), &missing, interrupted, services, work, done);
    bar.finish_and_clear();
    result
}
