//! `domvs bench deaf`: a reader that does not read, in a process of its own, which `soak` starts.

use std::io::Read;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::Context;
use clap::Args;

use crate::exit;
use crate::options::NetworkOptions;
use crate::paint::print_line;

/// Subscribe to a key and read nothing of it, until standard input ends
#[derive(Args, Clone, Debug)]
pub struct DeafArgs {
    /// What not to read
    #[arg(long, value_name = "KEY")]
    key: String,

    #[command(flatten)]
    network: NetworkOptions,
}

/// Does not read.
pub(super) fn run(args: &DeafArgs) -> anyhow::Result<ExitCode> {
    crate::runtime()?.block_on(async {
        let session = zenoh::open(args.network.config()?).await.map_err(anyhow::Error::from_boxed)?;
        // Holds up the thread that reads from the network, for good: what comes stays in the buffers of the system.
        let stand = |_| std::thread::sleep(Duration::MAX);
        let subscriber = session.declare_subscriber(&args.key).callback(stand).await;
        let _subscriber = subscriber.map_err(anyhow::Error::from_boxed).context("cannot subscribe")?;
        print_line("ready")?;
        let ended = tokio::task::spawn_blocking(|| std::io::stdin().read_to_end(&mut Vec::new()));
        ended.await.context("cannot wait")?.context("cannot read standard input")?;
        // A session that stands could not be closed.
        signal_hook::low_level::exit(i32::from(exit::INTERRUPTED))
    })
}
