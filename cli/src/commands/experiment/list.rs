//! `domvs experiment list`: every experiment that has a name, with one line.

use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use serde_json::json;

use crate::exit;
use crate::experiment::named;
use crate::experiment::spec::Experiment;
use crate::paint::{Paint, print_line};

/// Say which experiments have a name
///
/// `run NAME` shows one displacement of each cell with plots and pages; `sweep NAME` counts all its displacements.
#[derive(Args, Clone, Debug)]
pub struct ListArgs {
    /// Print JSON: one object a line
    #[arg(long)]
    json: bool,
}

/// Prints the list.
///
/// # Errors
/// Fails when standard output cannot be written to.
pub fn run(args: &ListArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    let experiments = named::experiments();
    let text = if args.json {
        let lines: anyhow::Result<Vec<String>> = experiments.iter().map(json_line).collect();
        lines?.join("\n")
    } else {
        let mut table = paint.table(&["name", "runs", "what"]);
        for experiment in &experiments {
            let runs = experiment.plan(&Default::default())?.len().to_string();
            table.add_row([paint.bold_cell(&experiment.name), runs.into(), experiment.about.clone().into()]);
        }
        table.to_string()
    };
    print_line(&text).context("cannot write the list")?;
    Ok(exit::done())
}

fn json_line(experiment: &Experiment) -> anyhow::Result<String> {
    let Experiment { name, about, seed, images, displacements, .. } = experiment;
    let (methods, runs) = (experiment.method_names()?, experiment.plan(&Default::default())?.len());
    let line = json!({
        "name": name, "about": about, "seed": seed, "images": images,
        "displacements": displacements, "methods": methods, "runs": runs,
    });
    Ok(line.to_string())
}
