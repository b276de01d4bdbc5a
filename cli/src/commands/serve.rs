//! `domvs serve`: one worker, until it is told to end.

mod signals;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use domvs_client::{DEFAULT_ENDPOINT, zenoh_config};
use domvs_server::{ServerConfig, Service};

use crate::exit;
use crate::network::router_config;
use crate::paint::{Paint, print_line};
use signals::Signals;

/// Run the service
///
/// Without any network option it is its own router, on tcp/127.0.0.1:7447: cameras, clients and arms on this machine
/// connect to it. With --listen tcp/0.0.0.0:7447 others reach it too (nothing is encrypted then); with --endpoint it
/// joins a router that runs elsewhere. SIGTERM or Ctrl-C ends it in order, zeros first, in less than two seconds whatever hangs; a second
/// one ends it at once.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct ServeArgs {
    /// The worker's configuration (TOML); deploy/server.toml lists every entry with its default
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// A folder for a recording (MCAP) of all frames, twists, statuses and settings
    #[arg(long, value_name = "FOLDER")]
    record: Option<PathBuf>,

    /// A folder in which this worker, if it is alone, keeps its tasks over a restart; those that ran come back paused
    #[arg(long, value_name = "FOLDER")]
    state: Option<PathBuf>,
    /// Answer GET /metrics (Prometheus) and GET /healthz here, such as 127.0.0.1:9464 [default: nowhere]
    ///
    /// Plain HTTP without any authentication: keep it on the loopback or on a network of your own. Names of clients and
    /// tasks are not on the page.
    #[arg(long, value_name = "ADDR:PORT")]
    metrics: Option<SocketAddr>,

    /// Name of this worker [default: made up at every start]
    #[arg(long, value_name = "NAME")]
    worker: Option<String>,

    /// First part of every key [default: domvs]
    #[arg(long, value_name = "PREFIX")]
    prefix: Option<String>,

    /// Be a router that listens here [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", conflicts_with_all = ["endpoints", "zenoh_config"])]
    listen: Vec<String>,

    /// Join the router at this endpoint
    #[arg(short = 'e', long = "endpoint", value_name = "ENDPOINT")]
    endpoints: Vec<String>,

    /// A Zenoh configuration file (JSON5); one with mode "router" makes the service its own router
    #[arg(long, value_name = "FILE", env = "ZENOH_CONFIG")]
    zenoh_config: Option<PathBuf>,

    /// End as after a signal when standard input ends: for whoever starts this and may be killed
    #[arg(long, hide = true)]
    while_stdin_is_open: bool,
}

const AFTER_HELP: &str = "\
Exit codes:
  0  a signal ended it in order, or came before it was ready
  1  it could not start; standard error says why
  2  the command line was not understood
  4  forced: by a second signal, or because the end in order took two seconds

Log: standard error, -v for more, --log-format json for machines; DOMVS_LOG, or else RUST_LOG, takes a filter (docs/operating.md).";

/// Serves until a signal comes.
///
/// # Errors
/// Fails when the configuration is wrong, nothing can be reached, or the endpoint is taken.
pub fn run(args: &ServeArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    give_memory_back();
    let config = server_config(args)?;
    let runtime = crate::runtime()?;
    let ended = runtime.block_on(serve(args, config, paint));
    // A thread that hangs in a reply or at a disk would be waited for.
    runtime.shutdown_background();
    ended
}

/// Starts this program anew, as the same process, with glibc told to map every buffer of 128 KiB or more by itself. Left alone it
/// takes that limit up to the largest buffer freed so far, and keeps the planes of closed tasks for good: 20 tasks of 640x480 left 170 MB
/// behind, and left 30 MB so. And to share four arenas among all threads: Zenoh starts and ends some for each link, and with glibc's own
/// eight for each core every burst of clients left 1.5 MB in another one. Costs some milliseconds, once. What cannot be told changes nothing else.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn give_memory_back() {
    use std::os::unix::process::CommandExt;
    const LIMIT: (&str, &str) = ("MALLOC_MMAP_THRESHOLD_", "131072");
    const ARENAS: (&str, &str) = ("MALLOC_ARENA_MAX", "4");
    if std::env::var_os(LIMIT.0).is_some() {
        return;
    }
    let Ok(program) = std::env::current_exe() else { return };
    let mut words = std::env::args_os();
    let mut again = std::process::Command::new(program);
    again.arg0(words.next().unwrap_or_else(|| "domvs".into())).args(words).env(LIMIT.0, LIMIT.1);
    if std::env::var_os(ARENAS.0).is_none() {
        again.env(ARENAS.0, ARENAS.1);
    }
    // Returns only if it failed.
    let error = again.exec();
    tracing::debug!(%error, "memory of closed tasks will be kept for later ones");
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn give_memory_back() {}

async fn serve(args: &ServeArgs, config: ServerConfig, paint: Paint) -> anyhow::Result<ExitCode> {
    // Before anything is announced: a signal from here on ends the service in order.
    let mut signals = Signals::listen()?;
    if args.while_stdin_is_open {
        signals::end_with_stdin()?;
    }
    // A configuration may make Zenoh wait for its router for ever.
    let session = tokio::select! {
        session = zenoh::open(session_config(args, config.limits.bytes_per_payload)?) => session,
        () = signals.first() => {
            print_line("ended by a signal before the router was found")?;
            return Ok(exit::done());
        }
    };
    let session = session.map_err(|error| anyhow::Error::from_boxed(error).context(unreachable_hint(args)))?;
    let record = config.record.clone();
    let service = Service::start(config, session).await?;
    print_line(&format!("worker {} is ready on {}", paint.bold(service.worker().as_str()), place(args)))?;
    if !record.as_os_str().is_empty() {
        print_line(&format!("recording to {}", record.display()))?;
    }
    if let Some(address) = service.metrics_address() {
        print_line(&format!("metrics on http://{address}/metrics"))?;
    }
    signals.first().await;
    say_without_waiting("stopping: zeros first");
    service.shutdown().await;
    signals.ended_in_order();
    Ok(exit::done())
}

/// Whoever reads standard output may stand still; the zeros must not wait for that.
fn say_without_waiting(line: &'static str) {
    let said = std::thread::Builder::new().name("last-words".into()).spawn(move || print_line(line));
    if let Err(error) = said {
        tracing::debug!(%error, line, "not said");
    }
}

fn server_config(args: &ServeArgs) -> anyhow::Result<ServerConfig> {
    let mut config = match &args.config {
        Some(path) => ServerConfig::read(path).with_context(|| path.display().to_string())?,
        None => ServerConfig::default(),
    };
    if let Some(record) = &args.record {
        config.record.clone_from(record);
    }
    if let Some(state) = &args.state {
        config.state.clone_from(state);
    }
    if let Some(metrics) = &args.metrics {
        config.metrics = metrics.to_string();
    }
    if let Some(worker) = &args.worker {
        config.worker.clone_from(worker);
    }
    if let Some(prefix) = &args.prefix {
        config.prefix.clone_from(prefix);
    }
    Ok(config.checked()?)
}

fn session_config(args: &ServeArgs, bytes_per_payload: usize) -> anyhow::Result<zenoh::Config> {
    let config = if args.zenoh_config.is_some() || !args.endpoints.is_empty() {
        zenoh_config(args.zenoh_config.as_deref(), &args.endpoints)?
    } else if args.listen.is_empty() {
        router_config(&[DEFAULT_ENDPOINT.to_owned()])?
    } else {
        router_config(&args.listen)?
    };
    domvs_server::session::prepared(config, bytes_per_payload).map_err(anyhow::Error::from_boxed)
}

fn place(args: &ServeArgs) -> String {
    match (&args.zenoh_config, args.endpoints.is_empty(), args.listen.is_empty()) {
        (Some(file), ..) => format!("the network of {}", file.display()),
        (None, false, _) => args.endpoints.join(", "),
        (None, true, false) => args.listen.join(", "),
        (None, true, true) => DEFAULT_ENDPOINT.to_owned(),
    }
}

fn unreachable_hint(args: &ServeArgs) -> String {
    match args.endpoints.is_empty() && args.zenoh_config.is_none() {
        true => format!("cannot listen on {}; is another service running there?", place(args)),
        false => format!("cannot join {}; is a router running there?", place(args)),
    }
}
