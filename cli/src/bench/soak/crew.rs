//! The workers of the soak: processes that are killed, stopped and started again, and what the system says of their memory and files.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use serde::Serialize;

use super::judge::lock;
use crate::bench::place::Background;
use crate::bench::process::{open_files, rss_mb};

/// How long a worker may take to say where its metrics are, and to answer there.
const METRICS: Duration = Duration::from_secs(5);
/// How long a worker may take to end in order: what it promises, and what a busy machine adds.
const ENDS: Duration = Duration::from_secs(5);

/// The workers.
pub struct Crew {
    endpoint: String,
    /// For all of them.
    config: PathBuf,
    slots: Vec<Mutex<Slot>>,
    begin: Instant,
}

struct Slot {
    worker: Option<Worker>,
    /// Of workers that are no more.
    past: Vec<Life>,
    /// Workers that ended though nobody ended them.
    fell: u64,
}

struct Worker {
    process: Background,
    metrics: Option<String>,
    life: Life,
}

/// Memory and files of one worker process over its life.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Life {
    /// When it was looked at, seconds of the soak; resident memory, MB; open files.
    pub looks: Vec<(f64, f64, usize)>,
}

impl Crew {
    /// Starts so many workers, which join the router at `endpoint`.
    ///
    /// # Errors
    /// Fails when one does not get ready, with what it said.
    pub fn start(endpoint: &str, config: PathBuf, workers: usize, begin: Instant) -> anyhow::Result<Crew> {
        let slot = |_| Mutex::new(Slot { worker: None, past: Vec::new(), fell: 0 });
        let crew = Crew { endpoint: endpoint.to_owned(), config, slots: (0..workers).map(slot).collect(), begin };
        (0..workers).try_for_each(|number| crew.start_one(number))?;
        Ok(crew)
    }

    /// Starts the worker of this number anew.
    ///
    /// # Errors
    /// Fails when it does not get ready.
    pub fn start_one(&self, number: usize) -> anyhow::Result<()> {
        let (config, name) = (self.config.display().to_string(), format!("soak-w{number}"));
        let words = ["serve", "--while-stdin-is-open", "--endpoint", &self.endpoint, "--config", &config];
        let words = [&words[..], &["--worker", &name, "--metrics", "127.0.0.1:0"]].concat();
        let process = Background::start(&words.into_iter().map(str::to_owned).collect::<Vec<_>>())?;
        let line = process.line(METRICS);
        let url = line.as_deref().and_then(|line| line.strip_prefix("metrics on http://"));
        let metrics = url.and_then(|url| url.strip_suffix("/metrics")).map(str::to_owned);
        lock(&self.slots[number]).worker = Some(Worker { process, metrics, life: Life::default() });
        Ok(())
    }

    /// Ends it as a crash would.
    pub fn kill(&self, number: usize) {
        let mut slot = lock(&self.slots[number]);
        if let Some(mut worker) = slot.worker.take() {
            worker.process.kill();
            slot.past.push(worker.life);
        }
    }

    /// Stops it, and lets it go on after this time, also if this process should be killed meanwhile.
    ///
    /// # Errors
    /// Fails when there is no shell.
    pub fn stop(&self, number: usize, lasts: Duration) -> anyhow::Result<()> {
        let Some(process) = lock(&self.slots[number]).worker.as_ref().map(|worker| worker.process.process()) else {
            return Ok(());
        };
        let words = format!("kill -STOP {process} && sleep {:.3}; kill -CONT {process}", lasts.as_secs_f64());
        let mut shell = Command::new("sh");
        shell.args(["-c", &words]).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut shell = shell.spawn().context("cannot start sh")?;
        // Waited for on a thread: the system keeps what nobody waits for.
        std::thread::spawn(move || shell.wait());
        Ok(())
    }

    /// Looks at the memory and the files of all, and starts anew who fell.
    pub fn look(&self) {
        let at_s = self.begin.elapsed().as_secs_f64();
        for (number, slot) in self.slots.iter().enumerate() {
            let mut slot = lock(slot);
            let Some(worker) = &mut slot.worker else { continue };
            if let Some(status) = worker.process.ended() {
                tracing::error!(worker = number, %status, "a worker ended by itself");
                let fallen = slot.worker.take();
                slot.past.extend(fallen.map(|worker| worker.life));
                slot.fell += 1;
                drop(slot);
                if let Err(error) = self.start_one(number) {
                    tracing::error!(worker = number, %error, "and cannot be started again");
                }
                continue;
            }
            let process = worker.process.process();
            if let (Some(rss_mb), Some(files)) = (rss_mb(process), open_files(process)) {
                worker.life.looks.push((at_s, rss_mb, files));
            }
        }
    }

    /// Workers that ended though nobody ended them.
    pub fn fell(&self) -> u64 {
        self.slots.iter().map(|slot| lock(slot).fell).sum()
    }

    /// The lives of all workers, the past ones first.
    pub fn lives(&self) -> Vec<Life> {
        let mut lives: Vec<Life> = self.slots.iter().flat_map(|slot| lock(slot).past.clone()).collect();
        let present = |slot: &Mutex<Slot>| lock(slot).worker.as_ref().map(|worker| worker.life.clone());
        lives.extend(self.slots.iter().filter_map(present));
        lives
    }

    /// The metrics pages of all workers.
    ///
    /// # Errors
    /// Fails when one does not answer.
    pub fn pages(&self) -> anyhow::Result<Vec<Page>> {
        let address = |slot: &Mutex<Slot>| lock(slot).worker.as_ref().and_then(|worker| worker.metrics.clone());
        self.slots.iter().filter_map(address).map(|address| Page::get(&address)).collect()
    }

    /// Ends all in order. Returns the exit codes; `None` for one that had to be killed.
    ///
    /// # Errors
    /// Fails when there is no shell to send signals.
    pub fn end(&self) -> anyhow::Result<Vec<Option<i32>>> {
        let mut codes = Vec::new();
        for slot in &self.slots {
            let mut slot = lock(slot);
            let Some(worker) = &mut slot.worker else { continue };
            worker.process.signal("TERM")?;
            let begin = Instant::now();
            let code = loop {
                match worker.process.ended() {
                    Some(status) => break status.code(),
                    None if begin.elapsed() > ENDS => break None,
                    None => std::thread::sleep(Duration::from_millis(20)),
                }
            };
            codes.push(code);
        }
        Ok(codes)
    }
}

/// A metrics page.
pub struct Page(String);

impl Page {
    fn get(address: &str) -> anyhow::Result<Page> {
        let failed = || format!("the metrics at {address}");
        let mut stream = TcpStream::connect(address).with_context(failed)?;
        stream.set_read_timeout(Some(METRICS))?;
        write!(stream, "GET /metrics HTTP/1.1\r\nHost: soak\r\n\r\n").with_context(failed)?;
        let mut page = String::new();
        stream.read_to_string(&mut page).with_context(failed)?;
        ensure!(page.starts_with("HTTP/1.1 200"), "{}: {}", failed(), page.lines().next().unwrap_or_default());
        Ok(Page(page))
    }

    /// The sum of all that begins like this.
    pub fn sum(&self, start: &str) -> f64 {
        let values = self.0.lines().filter(|line| line.starts_with(start));
        values.filter_map(|line| line.rsplit_once(' ')?.1.parse::<f64>().ok()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_summed_over_its_labels() {
        let page = Page("# HELP a b\na_total{x=\"1\"} 2\na_total{x=\"2\"} 3\nab 7\n".to_owned());
        assert_eq!((page.sum("a_total"), page.sum("a_total{x=\"2\""), page.sum("none")), (5.0, 3.0, 0.0));
    }
}
