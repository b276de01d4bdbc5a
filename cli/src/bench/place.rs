//! Where a worker and an echo are found: by default two processes of this program, each its own router on a free loopback port, so that
//! both are one TCP link away; with an endpoint, the service that runs there, and an echo process that joins it.

use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use domvs_client::{Client, ClientOptions, Task, zenoh_config};
use domvs_proto::settings::TaskSettings;

use super::echo;
use crate::options::NetworkOptions;

/// How long a process may take until it is ready.
const READY: Duration = Duration::from_secs(10);
/// Another process may take a free port first; then another one is tried.
const ATTEMPTS: usize = 5;

/// Which worker is measured.
#[derive(Args, Clone, Debug)]
pub struct PlaceOptions {
    /// The configuration (TOML) of the worker that is started when no endpoint is given
    #[arg(long, value_name = "FILE", conflicts_with = "endpoints")]
    pub config: Option<PathBuf>,

    /// Where the others are.
    #[command(flatten)]
    pub network: NetworkOptions,
}

/// A worker and an echo.
pub struct Place {
    worker: Option<Background>,
    echo_name: String,
    prefix: String,
    configs: [zenoh::Config; 2],
    _echo: Background,
}

/// Which of the two a client talks to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// The worker.
    Worker,
    /// The echo.
    Echo,
}

impl Place {
    /// Starts what has to be started.
    ///
    /// # Errors
    /// Fails when a process does not start, with what it said.
    pub fn open(options: &PlaceOptions) -> anyhow::Result<Place> {
        let network = &options.network;
        let echo_name = format!("echo-{}", std::process::id());
        let echo = ["bench", "echo", "--name", &echo_name, "--prefix", &network.prefix].map(str::to_owned);
        if !network.endpoints.is_empty() || network.zenoh_config.is_some() {
            let config = network.config()?;
            let mut arguments = echo.to_vec();
            arguments.extend(network.endpoints.iter().flat_map(|endpoint| ["-e".to_owned(), endpoint.clone()]));
            if let Some(file) = &network.zenoh_config {
                arguments.extend(["--zenoh-config".to_owned(), file.display().to_string()]);
            }
            let echo = Background::start(&arguments)?;
            let configs = [config.clone(), config];
            return Ok(Place { worker: None, echo_name, prefix: network.prefix.clone(), configs, _echo: echo });
        }
        let mut serve = ["serve", "--while-stdin-is-open", "--prefix", &network.prefix].map(str::to_owned).to_vec();
        if let Some(file) = &options.config {
            serve.extend(["--config".to_owned(), file.display().to_string()]);
        }
        let (worker, worker_endpoint) = Background::listening(&serve)?;
        let (echo, echo_endpoint) = Background::listening(&echo)?;
        let configs = [zenoh_config(None, &[worker_endpoint])?, zenoh_config(None, &[echo_endpoint])?];
        Ok(Place { worker: Some(worker), echo_name, prefix: network.prefix.clone(), configs, _echo: echo })
    }

    /// The worker's process, if it was started here.
    pub fn worker_process(&self) -> Option<u32> {
        self.worker.as_ref().map(|worker| worker.child.id())
    }

    /// A client of its own session; `number` tells those of this process apart.
    ///
    /// # Errors
    /// Fails when the peer cannot be reached.
    pub async fn client(&self, peer: Peer, number: usize) -> anyhow::Result<Client> {
        let (word, config) = match peer {
            Peer::Worker => ("worker", &self.configs[0]),
            Peer::Echo => ("echo", &self.configs[1]),
        };
        let options = ClientOptions::named(&format!("bench-{}-{word}-{number}", std::process::id()))?;
        let options = ClientOptions { zenoh: config.clone(), prefix: self.prefix.clone(), ..options };
        Client::connect(options).await.with_context(|| format!("cannot reach the {word}"))
    }

    /// The echo, as if it were a task.
    ///
    /// # Errors
    /// Fails when it is not there.
    pub async fn echo(&self, client: &Client) -> anyhow::Result<Task> {
        client.attach(echo::task(&self.echo_name)?, None).await.context("the echo")
    }
}

/// A task with its target set, started.
///
/// # Errors
/// Fails with the worker's reason.
pub async fn started(
    client: &Client,
    settings: &TaskSettings,
    target: &domvs_client::OutgoingFrame,
) -> anyhow::Result<Task> {
    let task = client.create_task(settings).await?;
    task.set_target(target).await?;
    task.start().await?;
    Ok(task)
}

/// A process of this program that does not outlive this one's use of it.
pub(super) struct Background {
    child: Child,
    /// What it says on standard output.
    lines: Mutex<Receiver<String>>,
}

impl Background {
    /// A process that listens on a free loopback port, and its endpoint.
    fn listening(arguments: &[String]) -> anyhow::Result<(Background, String)> {
        let mut last = anyhow!("not tried");
        for _ in 0..ATTEMPTS {
            let address = TcpListener::bind(("127.0.0.1", 0)).and_then(|listener| listener.local_addr());
            let endpoint = format!("tcp/{}", address.context("no loopback port is free")?);
            match Background::start(&[arguments, &["--listen".to_owned(), endpoint.clone()]].concat()) {
                Ok(process) => return Ok((process, endpoint)),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// Returns when the process has said that it is ready: its first line.
    pub(super) fn start(arguments: &[String]) -> anyhow::Result<Background> {
        let program = std::env::current_exe().context("this program does not know where it is")?;
        let mut command = Command::new(program);
        command.args(arguments).env_remove("ZENOH_CONFIG");
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().context("cannot start a process")?;
        let lines = lines_of(child.stdout.take().expect("it is piped"));
        let errors = lines_of(child.stderr.take().expect("it is piped"));
        let background = Background { child, lines: Mutex::new(lines) };
        match background.line(READY) {
            Some(_ready) => Ok(background),
            None => {
                drop(background);
                let said: Vec<String> = errors.iter().collect();
                Err(anyhow!("`domvs {}` did not get ready within {READY:?}: {}", arguments.join(" "), said.join(" ")))
            }
        }
    }
}

impl Background {
    /// The next line that it says, if one comes.
    pub(super) fn line(&self, limit: Duration) -> Option<String> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(limit).ok()
    }

    /// Its number in the system.
    pub(super) fn process(&self) -> u32 {
        self.child.id()
    }

    /// How it ended, if it has.
    pub(super) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Ends it at once, as a crash would.
    pub(super) fn kill(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Sends it a signal, such as `STOP`, by the shell's own `kill`.
    pub(super) fn signal(&self, signal: &str) -> anyhow::Result<()> {
        let words = format!("kill -{signal} {}", self.process());
        let status = Command::new("sh").args(["-c", &words]).status().context("cannot start sh")?;
        ensure!(status.success(), "`{words}` failed: {status}");
        Ok(())
    }
}

/// Reads what a process says to its end, so that it never waits for a reader.
fn lines_of(pipe: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            tracing::debug!(line, "a process of the bench");
            // Nobody listens after the first line; it is read all the same.
            let _ = sender.send(line);
        }
    });
    receiver
}

impl Drop for Background {
    fn drop(&mut self) {
        // It may have ended already, by the same Ctrl-C.
        self.kill();
    }
}
