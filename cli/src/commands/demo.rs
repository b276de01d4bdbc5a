//! `domvs demo`: the main job with nothing to set up. A Zenoh router, the service and a simulated camera in one
//! process, each in a session of its own; the camera is servoed home, and a folder tells how it went.
//! The data's way: arguments → [`Lab`] (router, service, client) → [`lock_step`] or [`stream`] → [`report`].

mod lab;
mod lock_step;
mod stream;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use domvs_proto::keys::Name;
use domvs_proto::messages::CameraInfo;
use domvs_proto::settings::{Depth, Method, TaskSettings, Window};
use domvs_proto::twist::TwistMessage;
use domvs_simulators::{CameraSettings, PoseError, Rendering};
use nalgebra::Isometry3;

pub(crate) use self::lab::Lab;
use crate::exit;
use crate::options::{DepthSource, SceneOptions, ServoOptions};
use crate::paint::{Paint, print_line};
use crate::report::{LiveLine, RunImages, RunRecord, RunRow, RunSummary, summary_table, write_run};

/// See it work: servo a simulated camera home, with nothing to set up
///
/// Starts a Zenoh router on a free loopback port, the service, and a simulated camera that was displaced from its
/// target, and servoes it back. By default in lock-step (image, twist, move, next image), which is reproducible;
/// with --stream in real time, by pushed frames and under the default limits.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct DemoArgs {
    #[command(flatten)]
    servo: ServoOptions,

    #[command(flatten)]
    scene: SceneOptions,

    /// Depth that the law is told: map (the true one, for every pixel), or one number in metres
    #[arg(long, value_name = "map|M", default_value_t)]
    depth: DepthSource,

    /// Real time: the camera publishes frames and follows the twists that come back, under the default limits
    #[arg(long)]
    stream: bool,

    /// Give up after so many images
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u32).range(1..))]
    max_images: u32,

    /// A folder for the images, plots and numbers; files of an earlier run in it are replaced
    #[arg(long, value_name = "FOLDER", default_value = "runs/demo")]
    out: PathBuf,

    /// Print one JSON object at the end instead of the table
    #[arg(long)]
    json: bool,
}

const AFTER_HELP: &str = "\
Converged means within 1 mm and 0.1° of the target by the simulator's truth; the status is the service's own verdict.

The JSON object has the keys method, converged, status, images, error_mm, error_deg, compute_ms and round_trip_ms \
(medians) and out. The folder holds desired.png, initial.png, final.png, difference.png, frames.csv, settings.json \
and plots (SVG) of the errors, the twist, the order, the window and the path.

Exit codes: 0 converged, 1 an error, 2 the command line was not understood, 3 the run ended without converging.";

/// What a way of running returns.
struct Run {
    record: RunRecord,
    settings: TaskSettings,
    desired: Rendering,
    initial: Rendering,
    last: Rendering,
}

/// Runs the demonstration.
///
/// # Errors
/// Fails when the photograph cannot be read, the scene is impossible, no port is free, or the folder cannot be written.
pub fn run(args: &DemoArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let camera = args.scene.camera(Name::try_from("demo")?)?;
    let live = LiveLine::new(args.servo.features.method.word(), paint_errors);
    let runtime = crate::runtime()?;
    let run = runtime.block_on(servo(args, camera, &live));
    live.clear();
    report(&run?, args, paint)
}

async fn servo(args: &DemoArgs, camera: CameraSettings, live: &LiveLine) -> anyhow::Result<Run> {
    live.say("starting a router and the service");
    let lab = Lab::start().await?;
    let outcome = match args.stream {
        true => stream::run(&lab, args, camera, live).await,
        false => lock_step::run(&lab, args, &camera, live).await,
    };
    lab.stop().await;
    outcome
}

/// The settings that both ways of running share.
fn task_settings(args: &DemoArgs, info: &CameraInfo) -> anyhow::Result<TaskSettings> {
    let mut settings = TaskSettings::new(info.camera);
    args.servo.apply(&mut settings)?;
    settings.frame_period_s = info.frame_period_s;
    settings.depth = match args.depth {
        DepthSource::Map => Depth::Map { fallback_m: None, holes: args.servo.features.holes() },
        DepthSource::Constant(depth_m) => Depth::ConstantM(depth_m),
    };
    Ok(settings)
}

/// The row of one image, with the window that the settings fix.
fn answer_row(
    image: u64,
    answer: &TwistMessage,
    settings: &TaskSettings,
    pose: &Isometry3<f64>,
    error: PoseError,
) -> RunRow {
    let window = match (settings.method, settings.window) {
        (Method::Hahn, Window::Fixed { a, b }) => vec![a[0], b[0], a[1], b[1]],
        _ => Vec::new(),
    };
    RunRow { window, ..RunRow::answered(image, answer, error, pose.translation.vector.into()) }
}

fn report(run: &Run, args: &DemoArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    let images = RunImages { desired: &run.desired.image, initial: &run.initial.image, last: &run.last.image };
    write_run(&args.out, &run.record, &run.settings, &images)?;
    let summary = run.record.summary(&args.out);
    let converged = summary.converged;
    print_line(&said(summary, &args.out, args.json, paint)?).context("cannot write the result")?;
    Ok(if converged { exit::done() } else { exit::not_converged() })
}

fn said(summary: RunSummary, out: &Path, json: bool, paint: Paint) -> anyhow::Result<String> {
    if json {
        return Ok(serde_json::to_string(&summary)?);
    }
    let table = summary_table(&[summary], paint);
    Ok(format!("{table}\nimages, plots and frames.csv: {}", out.display()))
}
