//! `domvs bench echo`: the yardstick's own process, which `roundtrip` and `load` start.

use std::io::Read;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;

use crate::bench::echo::Echo;
use crate::exit;
use crate::network::router_config;
use crate::options::NetworkOptions;
use crate::paint::print_line;

/// Answer frames at once with twists of zeros, until standard input ends
#[derive(Args, Clone, Debug)]
pub struct EchoArgs {
    /// Which task to stand for
    #[arg(long, value_name = "NAME")]
    name: String,

    /// Be a router that listens here
    #[arg(long, value_name = "ENDPOINT", conflicts_with_all = ["endpoints", "zenoh_config"])]
    listen: Vec<String>,

    #[command(flatten)]
    network: NetworkOptions,
}

/// Echoes.
pub(super) fn run(args: &EchoArgs) -> anyhow::Result<ExitCode> {
    crate::runtime()?.block_on(async {
        let config = if args.listen.is_empty() { args.network.config()? } else { router_config(&args.listen)? };
        let session = zenoh::open(config).await.map_err(anyhow::Error::from_boxed).context("no session")?;
        let _echo = Echo::start(&session, &args.network.keys()?, &args.name).await?;
        print_line("ready")?;
        // Whoever started this holds the other end, and may die.
        let ended = tokio::task::spawn_blocking(|| std::io::stdin().read_to_end(&mut Vec::new()));
        ended.await.context("cannot wait")?.context("cannot read standard input")?;
        Ok(exit::done())
    })
}
