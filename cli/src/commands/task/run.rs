//! `domvs task run`: one whole servoing by pushed frames: make a task for a camera on the network, set its target,
//! start, follow it to its end, close.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;
use domvs_client::{Client, Status, Task, TaskSettings, TwistMessage};
use domvs_proto::keys::{Keys, Name};
use domvs_proto::messages::CameraInfo;
use domvs_proto::settings::{Depth, Frames};
use serde_json::Value;
use tokio::time::Instant;

use crate::exit;
use crate::frames::image_file;
use crate::network::{interrupted, passing_name};
use crate::options::{DepthSource, NetworkOptions, ServoOptions, positive};
use crate::paint::{Paint, print_line};
use crate::report::LiveLine;

/// How long a camera's info, and its desired image, may take: a camera says what it is once a second.
const CAMERA_WAIT: Duration = Duration::from_secs(5);
/// `command` repeats at 10 Hz at the slowest.
const SILENCE: Duration = Duration::from_secs(3);
/// The least watchdog of a task that this command makes.
const WATCHDOG_MS: f64 = 300.0;

/// Servo a camera on the network to a target image
///
/// Makes a task for the camera, sets the target, starts it, shows how it goes until it has ended, and closes it.
/// Ctrl-C stops the camera and closes the task; so does the end of this process, by its lease.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// Name of the camera, which publishes on domvs/camera/NAME/
    #[arg(long, value_name = "NAME", default_value = "sim")]
    camera: String,

    /// The image that the camera should see in the end, PNG or JPEG [default: a simulated camera tells]
    #[arg(long, value_name = "FILE")]
    desired: Option<PathBuf>,

    /// Its depth: a 16-bit PNG or a 32-bit float TIFF
    #[arg(long, value_name = "FILE", requires = "desired")]
    desired_depth: Option<PathBuf>,

    /// Metres per count of a 16-bit depth file
    #[arg(long, value_name = "M", default_value = "0.001", value_parser = positive)]
    depth_unit: f64,

    /// Depth that the law is told: map (each frame brings its own), or one number in metres
    /// [default: map if the camera sends depth, or else 1 m]
    #[arg(long, value_name = "map|M")]
    depth: Option<DepthSource>,

    #[command(flatten)]
    servo: ServoOptions,

    /// More settings, as a JSON merge patch; docs/protocol.md lists them
    #[arg(long, value_name = "JSON")]
    settings: Option<String>,

    /// Name of this client, which no other process may have [default: the camera's, whom a simulated camera follows]
    #[arg(long, value_name = "NAME")]
    client: Option<String>,

    /// Give up after so many seconds
    #[arg(long, value_name = "S", default_value = "300", value_parser = positive)]
    seconds: f64,

    /// Print the last twist as JSON instead of a sentence
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    network: NetworkOptions,
}

pub(super) async fn run(args: &RunArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let live = LiveLine::new(&args.camera, paint_errors);
    live.say("connecting");
    let name = args.client.as_deref().unwrap_or(&args.camera);
    let client = connect(args, name).await?;
    let camera = Name::try_from(args.camera.as_str()).with_context(|| format!("--camera {}", args.camera))?;
    live.say("waiting for the camera");
    let info =
        client.camera_info(&camera, CAMERA_WAIT).await.with_context(|| format!("is camera {camera} running?"))?;
    let target = match &args.desired {
        Some(path) => image_file(path, args.desired_depth.as_deref().map(|depth| (depth, args.depth_unit)))?,
        None => client
            .camera_desired(&camera, CAMERA_WAIT)
            .await
            .context("only a simulated camera knows its target: give --desired FILE")?,
    };
    let task = client.create_task(&settings(args, &info, client.keys())?).await?;
    task.set_target(&target).await?;
    tracing::info!(task = %task.key(), "made");
    let ended = tokio::select! {
        ended = follow(&client, &task, args, &live) => ended,
        signal = interrupted() => signal.and_then(|()| Err(anyhow::anyhow!("interrupted"))),
    };
    live.clear();
    // Whatever happened: nothing moves from here on.
    let closed = task.close().await;
    let last = ended?;
    closed.context("the task did not close in order")?;
    say_end(&last, args, paint)?;
    client.close().await?;
    Ok(if last.status == Status::Converged { exit::done() } else { exit::not_converged() })
}

/// Two processes of one name would share a lease, and one would keep the tasks of the other alive.
async fn connect(args: &RunArgs, name: &str) -> anyhow::Result<Client> {
    let looking = args.network.connect(&passing_name()).await?;
    let taken = looking.is_connected(&Name::try_from(name)?).await?;
    looking.close().await?;
    if taken {
        bail!("a client called {name} is connected already; give this one another name with --client");
    }
    args.network.connect(name).await
}

fn say_end(last: &TwistMessage, args: &RunArgs, paint: Paint) -> anyhow::Result<()> {
    if args.json {
        return Ok(print_line(&last.to_json())?);
    }
    let converged = last.status == Status::Converged;
    let verdict = if converged { paint.good(last.status.word()) } else { paint.bad(last.status.word()) };
    let out_of_time =
        if last.status.is_latched() { String::new() } else { format!(" (stopped after {} s)", args.seconds) };
    print_line(&format!("{verdict}: {}{out_of_time}; pixel error {:.2e}", last.status.meaning(), last.pixel_mse))?;
    Ok(())
}

fn settings(args: &RunArgs, info: &CameraInfo, keys: &Keys) -> anyhow::Result<TaskSettings> {
    let mut settings = TaskSettings::new(info.camera);
    args.servo.apply(&mut settings)?;
    settings.frames = Frames::Key(keys.camera_frame(&info.name));
    settings.frame_period_s = info.frame_period_s;
    settings.watchdog_ms = Some((3000.0 * info.frame_period_s).max(WATCHDOG_MS).round() as u32);
    let map = Depth::Map { fallback_m: None, holes: args.servo.features.holes() };
    settings.depth = match args.depth {
        Some(DepthSource::Constant(depth_m)) => Depth::ConstantM(depth_m),
        Some(DepthSource::Map) => map,
        None if info.depth => map,
        None => Depth::default(),
    };
    match &args.settings {
        Some(patch) => {
            let patch: Value = serde_json::from_str(patch).context("--settings is not JSON")?;
            Ok(settings.merge_patch(&patch)?)
        }
        None => Ok(settings),
    }
}

/// The last command, once the task has ended.
async fn follow(client: &Client, task: &Task, args: &RunArgs, live: &LiveLine) -> anyhow::Result<TwistMessage> {
    let mut commands = client.commands(task.key()).await?;
    task.start().await?;
    let end = Instant::now() + Duration::from_secs_f64(args.seconds);
    // Commands from before the start reached the worker may still be on their way, with another latched word.
    let mut moved = false;
    loop {
        let Some(command) = commands.recv(SILENCE).await else {
            bail!("the service said nothing for {SILENCE:?}; the camera brakes by itself");
        };
        live.say(&told(&command));
        moved |= command.status == Status::Servoing;
        if command.status.is_latched() && (moved || command.status != Status::Stopped) {
            return Ok(command);
        }
        if Instant::now() >= end {
            task.stop().await?;
            return Ok(command);
        }
    }
}

fn told(command: &TwistMessage) -> String {
    format!(
        "image {:>5}  pixel error {:.2e}  order {:>2}  {}",
        command.sequence, command.pixel_mse, command.order, command.status
    )
}
