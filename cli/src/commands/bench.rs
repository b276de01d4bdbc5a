//! `domvs bench`: does this machine keep up? One verb for the law alone, one for the way over the network, one for many tasks at once, one for everything that can go wrong meanwhile.

mod deaf;
mod echo;
mod images;
mod load;
mod roundtrip;
mod soak;
mod step;

use std::process::ExitCode;

use anyhow::Context;
use clap::{Args, Subcommand};

use crate::bench::rows::{OutOptions, Row, json, text, write};
use crate::bench::watch::Watch;
use crate::exit;
use crate::paint::{Paint, print_line};
use crate::report::plots::Panel;

/// Measure whether this machine keeps up
///
/// Median, 99th percentile, frames a second, GFLOP/s, and the share of what one core of this machine reached in the same run. Options that
/// name sizes, orders, methods, depths or numbers of tasks take several, with commas between them: every combination is measured, and
/// plots of cost against what was varied are drawn.
#[derive(Args, Clone, Debug)]
pub struct BenchArgs {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand, Clone, Debug)]
enum Verb {
    Step(step::StepArgs),
    Roundtrip(roundtrip::RoundtripArgs),
    Load(load::LoadArgs),
    Soak(soak::SoakArgs),
    Images(images::ImagesArgs),
    #[command(hide = true)]
    Deaf(deaf::DeafArgs),
    #[command(hide = true)]
    Echo(echo::EchoArgs),
}

/// Measures.
///
/// # Errors
/// Fails when the law does not take a case, a worker cannot be started or reached, or a folder cannot be written.
pub fn run(args: &BenchArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    match &args.verb {
        Verb::Step(args) => step::run(args, paint, paint_errors),
        Verb::Roundtrip(args) => roundtrip::run(args, paint, paint_errors),
        Verb::Load(args) => load::run(args, paint, paint_errors),
        Verb::Soak(args) => soak::run(args, paint, paint_errors),
        Verb::Images(args) => images::run(args),
        Verb::Deaf(args) => deaf::run(args),
        Verb::Echo(args) => echo::run(args),
    }
}

/// Prints the rows, writes the folder if there is one, and gives the exit code; an interrupted measurement has none.
fn finish<R: Row>(
    measured: anyhow::Result<Vec<R>>,
    watch: &Watch,
    out: &OutOptions,
    name: &'static str,
    panels: impl FnOnce(&[R]) -> Vec<Panel>,
    paint: Paint,
) -> anyhow::Result<ExitCode> {
    watch.finish();
    let rows = match measured {
        Err(error) if watch.is_stopped() => {
            eprintln!("{error:#}");
            return Ok(exit::interrupted());
        }
        measured => measured?,
    };
    let panels = panels(&rows);
    let folder = out.folder(!panels.is_empty());
    if let Some(folder) = &folder {
        write(folder, name, &rows, &panels)?;
    }
    let said = if out.json { json(&rows)? } else { text(&rows, paint) };
    print_line(&said).context("cannot write the result")?;
    if let Some(folder) = folder {
        let plot = if panels.is_empty() { String::new() } else { format!(" and {name}.svg") };
        eprintln!("written: {name}.json{plot} in {}", folder.display());
    }
    Ok(exit::done())
}

/// A whole number above 0.
fn at_least_one(text: &str) -> Result<usize, String> {
    match text.trim().parse() {
        Ok(number @ 1..=1_000_000) => Ok(number),
        _ => Err(format!("expected a whole number from 1 to 1000000, got '{text}'")),
    }
}
