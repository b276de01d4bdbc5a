//! `domvs stop --all`: everything stands still.

use std::process::ExitCode;

use clap::Args;

use crate::exit;
use crate::options::NetworkOptions;
use crate::paint::print_line;

/// Stop everything: every task latches "stopped", every arm and simulated camera brakes
///
/// A task goes on only after a start or a resume of its own.
#[derive(Args, Clone, Debug)]
pub struct StopArgs {
    /// Every task of every worker; a single task is stopped by `domvs task stop`
    #[arg(long, required = true)]
    all: bool,

    #[command(flatten)]
    network: NetworkOptions,
}

/// Publishes the stop.
///
/// # Errors
/// Fails when nothing can be reached or nobody listens.
pub fn run(args: &StopArgs) -> anyhow::Result<ExitCode> {
    crate::runtime()?.block_on(async {
        let client = args.network.connect(&crate::network::passing_name()).await?;
        client.stop_all().await?;
        print_line("stop sent to every task and arm")?;
        client.close().await?;
        Ok(exit::done())
    })
}
