//! `domvs experiment run`: one displacement of each cell, with everything that can be seen of it.

use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::Args;

use super::Common;
use crate::exit;
use crate::experiment::cells::cells;
use crate::experiment::outcome::Outcome;
use crate::experiment::plan::{Overrides, RunPlan};
use crate::experiment::service::Service;
use crate::experiment::shown::{self, Shown};
use crate::experiment::spec::Experiment;
use crate::experiment::summary::{json_lines, run_table, write_results};
use crate::experiment::world::Worlds;
use crate::experiment::{named, pool, progress};
use crate::paint::{Paint, print_line};

/// Run an experiment: every method, scene and disturbance of it once
///
/// Runs differ by nothing but the method, and can be repeated to the last digit.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct RunArgs {
    #[command(flatten)]
    pub(super) common: Common,
}

const AFTER_HELP: &str = "\
A run has converged when the camera ends within the file's tolerance (1 mm and 0.1° by default) by the simulator's truth. \
A status that latches (converged, diverging, …) ends a run where it is; the law's own stop is at 0.01 mm and 0.01 mrad here, so \
that no run is cut off where the comparison begins. The number of images ends the others.

The folder holds index.html (everything in one page), results.json, runs.csv, cells.csv, comparisons of the methods for each scene \
and disturbance (SVG), and a folder for each run: frames.csv, settings.json, images, film.png and plots.

Exit codes: 0 every run converged, 1 an error, 2 the command line was not understood, 3 a run did not converge, 130 interrupted.";

/// Runs the experiment and writes its folder.
///
/// # Errors
/// Fails when a name or a file is none, a world or a setting is impossible, or the folder cannot be written.
pub fn run(args: &RunArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let common = &args.common;
    let experiment = named::find(&common.experiment)?;
    let plans = experiment.plan(&Overrides { displacements: Some(1), ..common.overrides() })?;
    let out = common.out(&experiment.name);
    let interrupted = pool::interruption()?;
    let worlds = Worlds::default();
    let bar = progress::bar("runs", plans.len(), 0, paint_errors);
    let folders = shown::folder_names(&plans);
    let jobs: Vec<(&RunPlan, &String)> = plans.iter().zip(&folders).collect();
    let work = |service: &mut Box<dyn Service>, (plan, folder): &(&RunPlan, &String)| {
        shown::run(plan, &worlds, service.as_mut(), &out.join(folder), &interrupted)
    };
    let mut runs: Vec<Option<Shown>> = plans.iter().map(|_| None).collect();
    let done = |index: usize, run: Option<Shown>| {
        bar.inc(1);
        runs[index] = run;
        Ok(())
    };
    let result = pool::in_parallel(common.jobs(), &jobs, &interrupted, common.services()?, work, done);
    bar.finish_and_clear();
    result?;
    let runs: Vec<Shown> = runs.into_iter().flatten().collect();
    let outcomes: Vec<Outcome> = runs.iter().map(|run| run.outcome.clone()).collect();
    report(&out, &experiment, &runs, &outcomes)?;
    let text = match common.json {
        true => json_lines(&outcomes, &cells(&outcomes))?,
        false => format!("{}\nresults: {}", run_table(&outcomes, paint), out.join("index.html").display()),
    };
    print_line(&text).context("cannot write the result")?;
    if interrupted.load(Ordering::Relaxed) {
        eprintln!("interrupted after {} of {} runs", outcomes.len(), plans.len());
    }
    Ok(match outcomes.iter().all(|outcome| outcome.converged) {
        _ if interrupted.load(Ordering::Relaxed) => exit::interrupted(),
        true => exit::done(),
        false => exit::not_converged(),
    })
}

fn report(out: &Path, experiment: &Experiment, runs: &[Shown], outcomes: &[Outcome]) -> anyhow::Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    write_results(out, experiment, outcomes, &cells(outcomes))?;
    let path = out.join("index.html");
    let page = shown::page(out, experiment, runs)?;
    std::fs::write(&path, page).with_context(|| format!("cannot write {}", path.display()))
}
