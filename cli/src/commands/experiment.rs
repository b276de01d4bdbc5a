//! `domvs experiment`: the paper's experiments and sweeps of one's own, in lock-step with a simulated camera.
//! One file per verb; what they do is in [`crate::experiment`].

mod basis;
mod landscape;
mod list;
mod report;
mod run;
mod sweep;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::{Args, Subcommand};

use crate::experiment::plan::Overrides;
use crate::experiment::pool;
use crate::experiment::service::{InProcess, Network, OverZenoh, Service};
use crate::experiment::shown::slug;
use crate::options::{SizeOption, positive};
use crate::paint::Paint;

/// Run the paper's experiments, and sweeps of your own
///
/// A run is a simulated camera that is displaced and servoed back: image, twist, move, next image. Speed limits are off, the step
/// cap is on, half a step is taken per image. By default the service's own code is called in this process; with --over-zenoh the
/// real service answers, with the same result.
#[derive(Args, Clone, Debug)]
#[command(after_long_help = FILE)]
pub struct ExperimentArgs {
    #[command(subcommand)]
    verb: Verb,
}

const FILE: &str = "\
A file of your own (TOML; only name is needed):

  name = \"mine\"
  seed = 7                  # displacement k has the seed 7 + k, whatever the method
  images = 60               # of a run at most
  displacements = 100       # of each cell, for sweep; run takes the first
  methods = [\"default\", \"HM\", { name = \"HM l=3\", settings = { method = \"hahn\", order = 3 } }]
  scenes = [\"boxes\", \"my-world.toml\", { name = \"far\", start = { random = { scale = 1.5 } } }]
  [tolerance]
  error_mm = 1.0
  error_deg = 0.1
  [camera]                  # camera, scene, target, start, disturbance: as in docs/worlds.md
  width = 320
  height = 240
  [settings]                # of the tasks, for all methods: as in docs/protocol.md
  order = { min = 4, max = 8 }
  [[disturbances]]
  name = \"dusk\"
  disturbance = { light = [{ gain = 0.7 }] }

Without methods the default law runs; without scenes, [scene]; without disturbances, [disturbance]. Tables in the three lists need a \
name and may hold camera, scene, target, start, disturbance, settings, images and tolerance, which go over the file's: camera and \
disturbance key by key, the others whole. Paths begin in the folder of the file that has them.";

#[derive(Subcommand, Clone, Debug)]
enum Verb {
    List(list::ListArgs),
    Run(run::RunArgs),
    Sweep(sweep::SweepArgs),
    Landscape(landscape::LandscapeArgs),
    Basis(basis::BasisArgs),
    All(report::AllArgs),
    Report(report::ReportArgs),
}

/// What `run` and `sweep` take alike.
#[derive(Args, Clone, Debug)]
struct Common {
    /// A name of `domvs experiment list`, or a TOML file
    #[arg(value_name = "NAME|FILE")]
    experiment: String,

    /// Only these methods: names of the file's list, or HM, KM, TM, DCT, DVS, PGM10, PGM16, PGM60, default
    #[arg(long = "method", value_name = "NAME", value_delimiter = ',')]
    methods: Vec<String>,

    /// Which share of the full step to take per image, for all methods
    #[arg(long, value_name = "FRACTION", value_parser = positive)]
    gain: Option<f64>,

    /// Images of a run at most
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    images: Option<u32>,

    /// Size of the images, pixels
    #[arg(long, value_name = "WxH")]
    size: Option<SizeOption>,

    /// Seed of the first displacement and its noise; displacement k has the seed S + k
    #[arg(long, value_name = "S")]
    seed: Option<u64>,

    /// A folder for the results [default: runs/experiments/NAME]
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,

    /// Through a router and the real service, over TCP on the loopback
    #[arg(long)]
    over_zenoh: bool,

    /// Print JSON: one object a line for every run, then one for every cell
    #[arg(long)]
    json: bool,

    /// How many runs at once; the results do not depend on it [default: as many as there are cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
}

impl Common {
    /// A name with nothing changed.
    fn of(experiment: &str) -> Common {
        Common {
            experiment: experiment.to_owned(),
            methods: Vec::new(),
            gain: None,
            images: None,
            size: None,
            seed: None,
            out: None,
            over_zenoh: false,
            json: false,
            jobs: None,
        }
    }

    fn overrides(&self) -> Overrides {
        Overrides {
            methods: self.methods.clone(),
            gain: self.gain,
            images: self.images,
            size: self.size.map(|size| [size.width, size.height]),
            seed: self.seed,
            displacements: None,
        }
    }

    fn jobs(&self) -> usize {
        self.jobs.map_or_else(pool::all_cores, usize::from)
    }

    fn out(&self, name: &str) -> PathBuf {
        self.out.clone().unwrap_or_else(|| PathBuf::from("runs/experiments").join(slug(name)))
    }

    /// Makes the services that the worker threads ask.
    fn services(&self) -> anyhow::Result<impl Fn() -> anyhow::Result<Box<dyn Service>> + Sync + use<>> {
        let network = self.over_zenoh.then(Network::start).transpose()?.map(Arc::new);
        Ok(move || -> anyhow::Result<Box<dyn Service>> {
            match &network {
                Some(network) => Ok(Box::new(OverZenoh::on(Arc::clone(network)))),
                None => Ok(Box::new(InProcess::default())),
            }
        })
    }
}

/// Runs the verb.
///
/// # Errors
/// Fails when a name or a file is none, a world or a setting is impossible, or a folder cannot be written.
pub fn run(args: &ExperimentArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    match &args.verb {
        Verb::List(args) => list::run(args, paint),
        Verb::Run(args) => run::run(args, paint, paint_errors),
        Verb::Sweep(args) => sweep::run(args, paint, paint_errors),
        Verb::Landscape(args) => landscape::run(args, paint, paint_errors),
        Verb::Basis(args) => basis::run(args, paint),
        Verb::All(args) => report::all(args, paint, paint_errors),
        Verb::Report(args) => report::report(args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::spec::Experiment;

    #[test]
    fn the_file_in_the_help_is_one_and_fits_into_a_hundred_columns() {
        let text: Vec<&str> = FILE.lines().filter_map(|line| line.strip_prefix("  ")).collect();
        let experiment = Experiment::parse(&text.join("\n")).expect("the help's example");
        assert_eq!((experiment.displacements, experiment.methods.len(), experiment.scenes.len()), (100, 3, 3));
        assert!(text.iter().all(|line| line.len() <= 98), "a longer line would be wrapped, which TOML is not");
    }
}
