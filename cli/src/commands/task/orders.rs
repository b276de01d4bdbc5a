//! One order to one task, or a look at all of them.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Args;
use domvs_client::{Client, Secret, Task, TaskKey, TaskSettings};
use domvs_proto::keys::Name;
use domvs_proto::messages::{Control, StatusMessage};
use serde_json::Value;

use crate::exit;
use crate::frames::image_file;
use crate::network::passing_name;
use crate::options::{NetworkOptions, positive};
use crate::paint::{Paint, print_line};

/// A task says its status twice a second.
const STATUS_WAIT: Duration = Duration::from_secs(2);

/// Which task.
#[derive(Args, Clone, Debug)]
pub struct TaskChoice {
    /// The task, client/id, as `create` and `list` print it
    #[arg(value_name = "TASK")]
    task: TaskKey,

    /// The task's secret, as `create` printed it
    #[arg(long, value_name = "HEX", env = "DOMVS_SECRET", hide_env_values = true, value_parser = secret)]
    secret: Secret,

    #[command(flatten)]
    network: NetworkOptions,
}

/// Make a task and print it with its secret
///
/// It belongs to nobody's lease and is closed when nobody has used it for idle_close_s seconds.
#[derive(Args, Clone, Debug)]
pub struct CreateArgs {
    /// Name of the client that the task stands under
    #[arg(long, value_name = "NAME", default_value = "lab")]
    client: String,

    /// Settings as JSON; "camera" is required: {"camera": {"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5,
    /// "width": 640, "height": 480}}. Every setting is in docs/protocol.md
    #[arg(value_name = "JSON")]
    settings: String,

    #[command(flatten)]
    network: NetworkOptions,
}

/// Set a task's target, or fetch it
#[derive(Args, Clone, Debug)]
pub struct TargetArgs {
    #[command(flatten)]
    task: TaskChoice,

    /// The image that the camera should see in the end, PNG or JPEG
    #[arg(long, value_name = "FILE", required_unless_present = "save")]
    desired: Option<PathBuf>,

    /// Its depth: a 16-bit PNG or a 32-bit float TIFF
    #[arg(long, value_name = "FILE", requires = "desired")]
    desired_depth: Option<PathBuf>,

    /// Metres per count of a 16-bit depth file
    #[arg(long, value_name = "M", default_value = "0.001", value_parser = positive)]
    depth_unit: f64,

    /// Write the target's payload, as it was set, to this file
    #[arg(long, value_name = "FILE", conflicts_with = "desired")]
    save: Option<PathBuf>,
}

/// Print a task's settings, or change them
#[derive(Args, Clone, Debug)]
pub struct SettingsArgs {
    #[command(flatten)]
    task: TaskChoice,

    /// A JSON merge patch such as {"gain": {"per_s": 0.5}}; null is a default
    #[arg(long, value_name = "JSON")]
    change: Option<String>,
}

/// Print what a task is doing
#[derive(Args, Clone, Debug)]
pub struct StatusArgs {
    /// The task, client/id
    #[arg(value_name = "TASK")]
    task: TaskKey,

    /// Print the status message as JSON
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    network: NetworkOptions,
}

/// Print every task of every worker
#[derive(Args, Clone, Debug)]
pub struct ListArgs {
    /// Print an array of status messages as JSON; null stands for a task that says nothing
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    network: NetworkOptions,
}

fn secret(hex: &str) -> Result<Secret, String> {
    Secret::try_from(hex.to_owned()).map_err(|error| error.to_string())
}

/// Another process's task: asked under a name of its own, so that the client's lease stays where it is.
async fn attach(choice: &TaskChoice) -> anyhow::Result<(Client, Task)> {
    let client = choice.network.connect(&passing_name()).await?;
    let task = client.attach(choice.task.clone(), Some(choice.secret.clone())).await?;
    Ok((client, task))
}

pub(super) async fn create(args: &CreateArgs) -> anyhow::Result<ExitCode> {
    let mut body: Value = serde_json::from_str(&args.settings).context("the settings are not JSON")?;
    if let Some(settings) = body.as_object_mut() {
        settings.entry("lease").or_insert_with(|| "none".into());
    }
    let settings = TaskSettings::from_json(&body)?;
    Name::try_from(args.client.as_str()).with_context(|| format!("--client {}", args.client))?;
    let client = args.network.connect(&args.client).await?;
    let task = client.create_task(&settings).await?;
    let secret = task.secret().context("a created task has a secret")?.to_hex();
    print_line(&serde_json::json!({ "task": task.key(), "epoch": task.epoch(), "secret": secret }).to_string())?;
    Ok(exit::done())
}

pub(super) async fn target(args: &TargetArgs) -> anyhow::Result<ExitCode> {
    let (_client, task) = attach(&args.task).await?;
    match (&args.desired, &args.save) {
        (Some(desired), _) => {
            let depth = args.desired_depth.as_deref().map(|path| (path, args.depth_unit));
            let status = task.set_target(&image_file(desired, depth)?).await?;
            print_line(status.word())?;
        }
        (None, Some(save)) => {
            let target = task.target().await?;
            let bytes = &target.payload;
            std::fs::write(save, bytes).with_context(|| format!("cannot write {}", save.display()))?;
            print_line(&format!("{} bytes of {} in {}", bytes.len(), target.encoding, save.display()))?;
        }
        (None, None) => bail!("give --desired or --save"),
    }
    Ok(exit::done())
}

pub(super) async fn control(choice: &TaskChoice, control: Control) -> anyhow::Result<ExitCode> {
    let (_client, task) = attach(choice).await?;
    let status = match control {
        Control::Start => task.start().await?,
        Control::Pause => task.pause().await?,
        Control::Resume => task.resume().await?,
        Control::Stop => task.stop().await?,
        Control::Close => task.close().await?,
    };
    print_line(status.word())?;
    Ok(exit::done())
}

pub(super) async fn settings(args: &SettingsArgs) -> anyhow::Result<ExitCode> {
    let (_client, task) = attach(&args.task).await?;
    let settings = match &args.change {
        Some(patch) => task.change_settings(&serde_json::from_str(patch).context("the change is not JSON")?).await?,
        None => task.settings().await?,
    };
    print_line(&serde_json::to_string_pretty(&settings)?)?;
    Ok(exit::done())
}

pub(super) async fn status(args: &StatusArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    let client = args.network.connect(&passing_name()).await?;
    let mut statuses = client.statuses(&args.task).await?;
    let Some(message) = statuses.recv(STATUS_WAIT).await else {
        bail!("task {} said nothing for {STATUS_WAIT:?}; `domvs task list` shows which tasks there are", args.task);
    };
    if args.json {
        print_line(&serde_json::to_string(&message)?)?;
    } else {
        let mut table = paint.table(&HEADINGS);
        table.add_row(row(&message));
        print_line(&format!("{table}\n{}", message.detail.as_deref().unwrap_or(&message.meaning)))?;
    }
    Ok(exit::done())
}

pub(super) async fn list(args: &ListArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    let client = args.network.connect(&passing_name()).await?;
    let tasks = client.list_tasks().await?;
    if args.json {
        let statuses: Vec<_> = tasks.iter().map(|task| &task.status).collect();
        print_line(&serde_json::to_string(&statuses)?)?;
        return Ok(exit::done());
    }
    let mut table = paint.table(&HEADINGS);
    for listed in &tasks {
        match &listed.status {
            Some(message) => table.add_row(row(message)),
            None => table.add_row(vec![listed.task.to_string(), "silent".to_owned()]),
        };
    }
    print_line(&if tasks.is_empty() { "no tasks".to_owned() } else { table.to_string() })?;
    Ok(exit::done())
}

const HEADINGS: [&str; 7] = ["task", "status", "twists", "frames", "order", "pixel error", "compute ms"];

fn row(message: &StatusMessage) -> Vec<String> {
    vec![
        message.task.to_string(),
        message.status.word().to_owned(),
        message.twists.to_string(),
        message.frames_in.to_string(),
        message.order.to_string(),
        message.pixel_mse.map_or_else(|| "–".to_owned(), |mse| format!("{mse:.2e}")),
        format!("{:.2}", f64::from(message.compute_us) / 1e3),
    ]
}
