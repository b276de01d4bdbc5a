//! `domvs experiment run`: one displacement of each cell, with everything that can be seen of it.

use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::Args;
use domvs_simulators::Rendering;
use domvs_vision::Plane;

use super::{Common, slug};
use crate::exit;
use crate::experiment::cells::cells;
use crate::experiment::outcome::Outcome;
use crate::experiment::plan::{Overrides, RunPlan};
use crate::experiment::runner::{self, Run, Watcher};
use crate::experiment::service::Service;
use crate::experiment::summary::{json_lines, run_table, write_results};
use crate::experiment::{named, pool, progress};
use crate::paint::{Paint, print_line};
use crate::report::{RunImages, RunRow, write_run};

/// Run an experiment: every method, scene and disturbance of it once
///
/// Runs differ by nothing but the method, and can be repeated to the last digit.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct RunArgs {
    #[command(flatten)]
    common: Common,
}

const AFTER_HELP: &str = "\
A status that latches (converged, diverging, …) ends a run where it is. The stop is at 0.01 mm and 0.001 % of a radian, so that \
no run is cut off at the default half millimetre; the images end the others.

The folder holds a folder for each run, results.json, runs.csv and cells.csv.

Exit codes: 0 every run converged, 1 an error, 2 the command line was not understood, 3 a run did not converge, 130 interrupted.";

/// Keeps the images that a report shows.
#[derive(Default)]
struct Pictures {
    desired: Option<Plane<f32>>,
    initial: Option<Plane<f32>>,
    last: Option<Plane<f32>>,
}

impl Watcher for Pictures {
    fn desired(&mut self, _: &domvs_proto::settings::TaskSettings, desired: &Rendering) {
        self.desired = Some(desired.image.clone());
    }

    fn image(&mut self, _: &mut RunRow, current: &Rendering) {
        self.initial.get_or_insert_with(|| current.image.clone());
        self.last = Some(current.image.clone());
    }
}

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
    let bar = progress::bar(plans.len(), 0, paint_errors);
    let work = |service: &mut Box<dyn Service>, plan: &RunPlan| {
        let mut pictures = Pictures::default();
        let run = runner::run(plan, service.as_mut(), &mut pictures, &interrupted)?;
        run.map(|run| write_one(&out, plan, run, &pictures)).transpose()
    };
    let mut outcomes: Vec<Option<Outcome>> = vec![None; plans.len()];
    let done = |index: usize, outcome: Option<Outcome>| {
        bar.inc(1);
        outcomes[index] = outcome;
        Ok(())
    };
    let result = pool::in_parallel(common.jobs(), &plans, &interrupted, common.services()?, work, done);
    bar.finish_and_clear();
    result?;

    let outcomes: Vec<Outcome> = outcomes.into_iter().flatten().collect();
    let cells = cells(&outcomes);
    std::fs::create_dir_all(&out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    write_results(&out, &experiment, &outcomes, &cells)?;
    let text = match common.json {
        true => json_lines(&outcomes, &cells)?,
        false => format!("{}\nresults: {}", run_table(&outcomes, paint), out.display()),
    };
    print_line(&text).context("cannot write the result")?;
    Ok(match outcomes.iter().all(|outcome| outcome.converged) {
        _ if interrupted.load(Ordering::Relaxed) => exit::interrupted(),
        true => exit::done(),
        false => exit::not_converged(),
    })
}

fn write_one(out: &Path, plan: &RunPlan, run: Run, pictures: &Pictures) -> anyhow::Result<Outcome> {
    let cell = &plan.cell;
    let folder = out.join(slug(&format!("{} {} {}", cell.scene, cell.disturbance, cell.method)));
    if let (Some(desired), Some(initial), Some(last)) = (&pictures.desired, &pictures.initial, &pictures.last) {
        write_run(&folder, &run.record, &run.settings.to_value(), &RunImages { desired, initial, last })?;
    }
    Ok(run.outcome)
}
