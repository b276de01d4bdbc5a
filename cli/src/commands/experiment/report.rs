//! `domvs experiment report` and `all`: every experiment, and the page about what came of it.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;

use super::{Common, landscape, run, sweep};
use crate::exit;
use crate::experiment::document::{Results, document, today};
use crate::experiment::named;
use crate::experiment::shown::slug;
use crate::paint::{Paint, print_line};

/// Write the page that holds the results against the paper's claims
///
/// Reads the results.json of every folder in a folder, as `domvs experiment all` leaves them, and writes Markdown: each claim of the
/// paper with its figure, ours with 95 % intervals, scenes and seeds, and whether it holds; then all rates and runs.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Exit codes: 0 done, 1 an error, 2 the command line was not understood.")]
pub struct ReportArgs {
    /// The folder with the results
    #[arg(long, value_name = "FOLDER", default_value = "runs/experiments")]
    from: PathBuf,

    /// The file to write
    #[arg(long, value_name = "FILE", default_value = "docs/experiments.md")]
    out: PathBuf,
}

/// Run every experiment that has a name, and the landscapes
///
/// Runs and sweeps as `domvs experiment list` names them, each into a folder of its name. Sweeps go on where they stopped.
#[derive(Args, Clone, Debug)]
#[command(after_help = "Exit codes: 0 done, 1 an error, 2 the command line was not understood, 130 interrupted.")]
pub struct AllArgs {
    /// A folder for the folders
    #[arg(long, value_name = "FOLDER", default_value = "runs/experiments")]
    out: PathBuf,

    /// How many runs at once [default: as many as there are cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,

    /// Displacements of each cell of the sweeps, instead of the files'
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    displacements: Option<u32>,

    /// Write the page about them to this file in the end
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// Writes the page.
///
/// # Errors
/// Fails when there are no results, or a file cannot be read or written.
pub fn report(args: &ReportArgs) -> anyhow::Result<ExitCode> {
    let text = document(&Results::read(&args.from)?, &today())?;
    if let Some(folder) = args.out.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    std::fs::write(&args.out, text).with_context(|| format!("cannot write {}", args.out.display()))?;
    print_line(&format!("report: {}", args.out.display())).context("cannot write the result")?;
    Ok(exit::done())
}

/// Runs everything.
///
/// # Errors
/// Fails as each experiment does.
pub fn all(args: &AllArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    for experiment in named::experiments() {
        print_line(&paint.bold(&format!("{}: {}", experiment.name, experiment.about)))?;
        let common = Common {
            out: Some(args.out.join(slug(&experiment.name))),
            jobs: args.jobs,
            ..Common::of(&experiment.name)
        };
        let code = match experiment.displacements {
            1 => run::run(&run::RunArgs { common }, paint, paint_errors)?,
            _ => {
                let displacements = args.displacements;
                sweep::run(&sweep::SweepArgs { common, displacements, fresh: false }, paint, paint_errors)?
            }
        };
        if code == exit::interrupted() {
            return Ok(code);
        }
    }
    let code =
        landscape::run(&landscape::LandscapeArgs::of_the_paper(args.out.join("landscape")), paint, paint_errors)?;
    match &args.report {
        Some(out) if code == exit::done() => report(&ReportArgs { from: args.out.clone(), out: out.clone() }),
        _ => Ok(code),
    }
}
