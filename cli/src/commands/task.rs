//! `domvs task`: a client on the command line. `run` does a whole servoing; the others do one thing each.

mod orders;
mod run;

use std::process::ExitCode;

use clap::{Args, Subcommand};

use crate::paint::Paint;

/// Make, run, watch and end tasks of a running service
#[derive(Args, Clone, Debug)]
pub struct TaskArgs {
    #[command(subcommand)]
    what: TaskCommand,
}

#[derive(Subcommand, Clone, Debug)]
enum TaskCommand {
    Run(run::RunArgs),
    Create(orders::CreateArgs),
    Target(orders::TargetArgs),
    /// Start a task, or start it anew
    Start(orders::TaskChoice),
    /// Pause a task: zeros until it is resumed
    Pause(orders::TaskChoice),
    /// Resume a task after a pause or another latched status
    Resume(orders::TaskChoice),
    /// Stop a task: zeros until it is started again or resumed
    Stop(orders::TaskChoice),
    /// End a task
    Close(orders::TaskChoice),
    Settings(orders::SettingsArgs),
    Status(orders::StatusArgs),
    List(orders::ListArgs),
}

/// Runs the subcommand.
///
/// # Errors
/// Fails when nothing can be reached, and as the service refuses.
pub fn run(args: &TaskArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    use domvs_proto::messages::Control;

    let runtime = crate::runtime()?;
    runtime.block_on(async {
        match &args.what {
            TaskCommand::Run(args) => run::run(args, paint, paint_errors).await,
            TaskCommand::Create(args) => orders::create(args).await,
            TaskCommand::Target(args) => orders::target(args).await,
            TaskCommand::Start(task) => orders::control(task, Control::Start).await,
            TaskCommand::Pause(task) => orders::control(task, Control::Pause).await,
            TaskCommand::Resume(task) => orders::control(task, Control::Resume).await,
            TaskCommand::Stop(task) => orders::control(task, Control::Stop).await,
            TaskCommand::Close(task) => orders::control(task, Control::Close).await,
            TaskCommand::Settings(args) => orders::settings(args).await,
            TaskCommand::Status(args) => orders::status(args, paint).await,
            TaskCommand::List(args) => orders::list(args, paint).await,
        }
    })
}
