//! `domvs serve`: one worker, until it is told to end.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};
use clap::Args;
use domvs_client::{DEFAULT_ENDPOINT, zenoh_config};
use domvs_server::{ServerConfig, Service};
use tokio::signal::unix::{Signal, SignalKind, signal};

use crate::exit;
use crate::network::router_config;
use crate::paint::{Paint, print_line};

/// Run the service
///
/// Without any network option it is its own router, on tcp/127.0.0.1:7447: cameras, clients and arms on this machine
/// connect to it. With --listen tcp/0.0.0.0:7447 others reach it too (nothing is encrypted then); with --endpoint it
/// joins a router that runs elsewhere. SIGTERM or Ctrl-C ends it in order, zeros first; a second one ends it at once.
#[derive(Args, Clone, Debug)]
pub struct ServeArgs {
    /// The worker's configuration (TOML); deploy/server.toml lists every entry with its default
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// A folder for a recording (MCAP) of all frames, twists, statuses and settings
    #[arg(long, value_name = "FOLDER")]
    record: Option<PathBuf>,

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
}

/// Serves until a signal comes.
///
/// # Errors
/// Fails when the configuration is wrong, nothing can be reached, or the endpoint is taken.
pub fn run(args: &ServeArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    give_memory_back();
    let config = server_config(args)?;
    crate::runtime()?.block_on(serve(args, config, paint))
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
    let mut signals = [signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?];
    // A configuration may make Zenoh wait for its router for ever.
    let session = tokio::select! {
        session = zenoh::open(session_config(args)?) => session,
        () = any(&mut signals) => bail!("ended by a signal before the router was found"),
    };
    let session = session.map_err(|error| anyhow::Error::from_boxed(error).context(unreachable_hint(args)))?;
    let record = config.record.clone();
    let service = Service::start(config, session).await?;
    print_line(&format!("worker {} is ready on {}", paint.bold(service.worker().as_str()), place(args)))?;
    if !record.as_os_str().is_empty() {
        print_line(&format!("recording to {}", record.display()))?;
    }
    any(&mut signals).await;
    print_line("stopping: zeros first")?;
    tokio::select! {
        () = service.shutdown() => Ok(exit::done()),
        () = any(&mut signals) => bail!("ended at once by a second signal"),
    }
}

async fn any([terminate, interrupt]: &mut [Signal; 2]) {
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
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
    if let Some(worker) = &args.worker {
        config.worker.clone_from(worker);
    }
    if let Some(prefix) = &args.prefix {
        config.prefix.clone_from(prefix);
    }
    Ok(config.checked()?)
}

fn session_config(args: &ServeArgs) -> anyhow::Result<zenoh::Config> {
    if args.zenoh_config.is_some() || !args.endpoints.is_empty() {
        return Ok(zenoh_config(args.zenoh_config.as_deref(), &args.endpoints)?);
    }
    match args.listen.is_empty() {
        true => router_config(&[DEFAULT_ENDPOINT.to_owned()]),
        false => router_config(&args.listen),
    }
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
