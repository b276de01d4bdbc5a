//! `domvs sim`: simulated hardware on the network. So far a camera.

use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use domvs_proto::keys::{Name, TaskKey};
use domvs_simulators::node::{CameraNode, Truth};
use domvs_simulators::{CameraSettings, DepthPacking, Follow, Motion};

use crate::exit;
use crate::options::{NetworkOptions, SceneOptions, positive};
use crate::paint::{Paint, print_line};
use crate::report::LiveLine;

/// Simulated hardware on the network
#[derive(Args, Clone, Debug)]
pub struct SimArgs {
    #[command(subcommand)]
    what: Simulated,
}

#[derive(Subcommand, Clone, Debug)]
enum Simulated {
    Camera(CameraArgs),
}

/// A free-flying camera in front of a photograph, or in a world
///
/// Publishes frames on domvs/camera/NAME/frame and follows the twists of its client's tasks. It brakes on zeros, on
/// silence, when a twist has expired, and on `domvs stop --all`. Its target is what it would see from where it should
/// be; it hands that out on domvs/camera/NAME/desired, so `domvs task run` needs no file. Ends with Ctrl-C.
#[derive(Args, Clone, Debug)]
struct CameraArgs {
    /// Name of the camera
    #[arg(long, value_name = "NAME", default_value = "sim")]
    name: String,

    /// Whose twists to follow: a client, a task (client/id), or nobody
    /// [default: the client that is called like the camera, as `domvs task run` is]
    #[arg(long, value_name = "WHO")]
    follow: Option<String>,

    /// Frames a second
    #[arg(long, value_name = "HZ", default_value = "15", value_parser = positive)]
    rate: f64,

    /// How depth is sent with each frame
    #[arg(long, value_enum, default_value_t)]
    depth: DepthChoice,

    /// How much later than its capture a frame is sent, milliseconds
    #[arg(long, value_name = "MS", default_value_t = 0)]
    latency_ms: u64,

    /// End after so many seconds [default: with Ctrl-C]
    #[arg(long, value_name = "S", value_parser = positive)]
    seconds: Option<f64>,

    #[command(flatten)]
    scene: SceneOptions,

    #[command(flatten)]
    network: NetworkOptions,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum DepthChoice {
    /// 32-bit float metres
    #[default]
    F32,
    /// 16-bit millimetres
    U16,
    /// Not at all
    None,
}

/// Flies until Ctrl-C.
///
/// # Errors
/// Fails when the scene or the rate is impossible or nothing can be reached.
pub fn run(args: &SimArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let Simulated::Camera(args) = &args.what;
    crate::runtime()?.block_on(fly(args, paint, paint_errors))
}

async fn fly(args: &CameraArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let name = Name::try_from(args.name.as_str()).with_context(|| format!("--name {}", args.name))?;
    let followed = args.follow.as_deref().unwrap_or(&args.name);
    let mut settings = CameraSettings {
        rate_hz: args.rate,
        follow: follow(followed)?,
        depth: match args.depth {
            DepthChoice::F32 => DepthPacking::F32,
            DepthChoice::U16 => DepthPacking::U16,
            DepthChoice::None => DepthPacking::None,
        },
        ..args.scene.camera(name)?
    };
    settings.disturbance.latency = Duration::from_millis(args.latency_ms);
    let node = CameraNode::open(args.network.config()?, args.network.keys()?, settings).await?;
    let name = paint.bold(&args.name);
    print_line(&format!("camera {name} publishes {} frames a second and follows {followed}", args.rate))?;
    let line = LiveLine::new(&args.name, paint_errors);
    watch(args, &node, &line).await?;
    line.clear();
    let truth = node.truth().borrow().clone();
    node.stop().await?;
    print_line(&format!("camera {name} landed: {}", told(&truth)))?;
    Ok(exit::done())
}

/// Shows where the camera is until Ctrl-C, or the time is over.
async fn watch(args: &CameraArgs, node: &CameraNode, line: &LiveLine) -> anyhow::Result<()> {
    let mut truth = node.truth();
    let end = tokio::time::sleep(args.seconds.map_or(Duration::MAX, Duration::from_secs_f64));
    tokio::pin!(end);
    let interrupted = crate::network::interrupted();
    tokio::pin!(interrupted);
    loop {
        tokio::select! {
            signal = &mut interrupted => return signal,
            () = &mut end => return Ok(()),
            changed = truth.changed() => {
                changed.context("the camera has crashed")?;
                line.say(&told(&truth.borrow_and_update()));
            }
        }
    }
}

fn told(truth: &Truth) -> String {
    let motion = match truth.motion {
        Motion::Moving => "moving".to_owned(),
        Motion::Braked(reason) => format!("braked: {reason}"),
    };
    format!("{:.2} mm and {:.3}° from the target, {motion}, {} frames", truth.error.mm, truth.error.deg, truth.sent)
}

fn follow(who: &str) -> anyhow::Result<Follow> {
    match who {
        "nobody" => Ok(Follow::Nobody),
        _ if who.contains('/') => Ok(Follow::Task(who.parse::<TaskKey>().with_context(|| format!("--follow {who}"))?)),
        _ => Ok(Follow::Client(Name::try_from(who).with_context(|| format!("--follow {who}"))?)),
    }
}
