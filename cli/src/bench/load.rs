//! Many tasks at once: what is answered, how late, how evenly, and what it costs the worker. Every task has a client with a session of its
//! own. The same cameras then send the same frames to the echo, in turns with the worker: its 99th percentile is what network and senders
//! take by themselves.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use domvs_client::{Client, OutgoingFrame, Status, Task};
use serde::Serialize;
use tokio::runtime::Runtime;

use super::cameras::{Heard, Rate, drive};
use super::cases::Case;
use super::place::{Peer, Place, started};
use super::process::{MemoryOverTime, MemoryWatch, cpu_s, rss_mb};
use super::rows::{Common, Row};
use super::samples::Samples;
use super::scene::Scene;
use super::watch::Watch;
use crate::report::number;

/// How often worker and echo take turns.
const ROUNDS: u32 = 2;
/// How long the capacity is measured that an overload is a multiple of, seconds.
const CAPACITY_S: f64 = 1.0;
/// Before the first round, seconds: not counted.
const WARM_UP_S: f64 = 0.3;
/// How often the echo is asked while the worker has its load.
const BESIDE: Rate = Rate::Hz(30.0);

/// What a worker gets to give memory back after its tasks were closed.
const SETTLING: Duration = Duration::from_millis(500);
/// What it gets to let go of them.
const CLOSING: Duration = Duration::from_secs(5);

/// How much is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// So many frames a second from each task.
    Hz(f64),
    /// The next frame of each task when one was answered, with so many that wait for their answers.
    AsAnswered {
        /// From 1 on.
        ahead: usize,
    },
    /// So many times what the worker answers when asked as it answers.
    TimesCapacity(f64),
}

/// One case under load.
#[derive(Clone, Debug, Serialize)]
pub struct LoadRow {
    /// What every row has: times are of answers with a twist, from when the frame was due; frames/s are those answers.
    #[serde(flatten)]
    pub common: Common,
    /// How many at once.
    pub tasks: usize,
    /// Frames a second from each task; null when the next frame went out with an answer.
    pub rate_hz: Option<f64>,
    /// Frames of each task that waited for their answers then; null at a rate.
    pub ahead: Option<usize>,
    /// How long.
    pub seconds: f64,
    /// Frames that went out.
    pub sent: u64,
    /// Answers with a twist.
    pub servoing: u64,
    /// Answers `overloaded`.
    pub overloaded: u64,
    /// Answers `deadline_missed`.
    pub deadline_missed: u64,
    /// Answers with any other status.
    pub other_status: u64,
    /// Frames without an answer in time.
    pub unanswered: u64,
    /// Frames that the cameras did not send, because 64 waited for their answers.
    pub unsent: u64,
    /// Twists of the slowest task over those of the fastest.
    pub fairness: f64,
    /// The echo's median under the same load.
    pub echo_median_ms: f64,
    /// The echo's 99th percentile under the same load.
    pub echo_p99_ms: f64,
    /// `p99_ms / echo_p99_ms`.
    pub p99_over_echo: f64,
    /// The echo's 99th percentile for one camera at 30 Hz while the worker had its load: what the busy machine itself takes.
    pub echo_beside_p99_ms: f64,
    /// `p99_ms / echo_beside_p99_ms`.
    pub p99_over_echo_beside: f64,
    /// Cores that the worker kept busy.
    pub worker_cores: Option<f64>,
    /// Memory of the worker, MB.
    pub worker_rss_mb: Option<Memory>,
    /// Each task's own figures.
    pub per_task: Vec<TaskFigures>,
}

/// Resident memory of a worker, MB.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Memory {
    /// Before there was any task.
    pub before: f64,
    /// With all tasks started.
    pub started: f64,
    /// While frames came.
    pub during: Option<MemoryOverTime>,
    /// After all tasks were closed.
    pub closed: f64,
}

/// One task under load.
#[derive(Clone, Debug, Serialize)]
pub struct TaskFigures {
    /// Median of the answers with a twist.
    pub median_ms: f64,
    /// 99 of 100 are not longer.
    pub p99_ms: f64,
    /// What became of its frames.
    #[serde(flatten)]
    pub heard: Heard,
}

impl Row for LoadRow {
    fn common(&self) -> &Common {
        &self.common
    }

    const HEADINGS: &'static [&'static str] =
        &["tasks", "sent", "twists", "overloaded", "lost", "fairness", "echo p99", "beside", "cores", "MB"];

    fn cells(&self) -> Vec<String> {
        let memory = self.worker_rss_mb.and_then(|memory| memory.during).map_or(f64::NAN, |during| during.peak);
        let counts = [self.tasks as u64, self.sent, self.servoing, self.overloaded];
        let lost = self.deadline_missed + self.other_status + self.unanswered + self.unsent;
        let mut cells: Vec<String> = counts.iter().chain([&lost]).map(u64::to_string).collect();
        let cores = self.worker_cores.unwrap_or(f64::NAN);
        cells.extend([self.fairness, self.echo_p99_ms, self.echo_beside_p99_ms, cores, memory].map(number));
        cells
    }
}

/// Measures every case with every number of tasks.
///
/// # Errors
/// Fails, naming the case, when a task cannot be made, when nothing at all is answered, and when it is stopped.
pub fn measure(
    place: &Place,
    runtime: &Runtime,
    cases: &[Case],
    tasks: &[usize],
    demand: Demand,
    seconds: f64,
    watch: &Watch,
) -> anyhow::Result<Vec<LoadRow>> {
    let mut rows = Vec::new();
    for (case, &tasks) in cases.iter().flat_map(|case| tasks.iter().map(move |tasks| (case, tasks))) {
        watch.says(format!("{case}, {tasks} tasks"));
        let measurement = Measurement { place, runtime, case, tasks, demand, seconds, watch };
        rows.push(measurement.run().with_context(|| format!("{case}, {tasks} tasks"))?);
        watch.done(1);
    }
    Ok(rows)
}

struct Measurement<'a> {
    place: &'a Place,
    runtime: &'a Runtime,
    case: &'a Case,
    tasks: usize,
    demand: Demand,
    seconds: f64,
    watch: &'a Watch,
}

/// Everything that answers, and the sequence of the next frame.
struct Crowd {
    clients: Vec<Client>,
    workers: Vec<Arc<Task>>,
    echoes: Vec<Arc<Task>>,
    next: u64,
}

impl Measurement<'_> {
    fn run(&self) -> anyhow::Result<LoadRow> {
        let scene = Scene::new(self.case.size);
        let target = scene.desired.frame(self.case)?;
        let frames = [scene.current[0].frame(self.case)?, scene.current[1].frame(self.case)?];
        let process = self.place.worker_process();
        let before = process.and_then(rss_mb);
        let mut crowd = self.runtime.block_on(self.crowd(&target))?;
        let started = process.and_then(rss_mb);

        let rate = self.rate(&mut crowd, &frames);
        self.drive(&mut crowd, &frames, Peer::Worker, rate, WARM_UP_S);
        self.drive(&mut crowd, &frames, Peer::Echo, rate, WARM_UP_S);
        let mut heard = [vec![Heard::default(); self.tasks], vec![Heard::default(); self.tasks]];
        let mut beside = Heard::default();
        let (mut during, mut cores_s) = (None::<MemoryOverTime>, None::<f64>);
        for _ in 0..ROUNDS {
            for (peer, heard) in [Peer::Worker, Peer::Echo].into_iter().zip(&mut heard) {
                self.watch.go_on()?;
                let observed = process.filter(|_| peer == Peer::Worker);
                let cpu_before_s = observed.and_then(cpu_s);
                let memory = observed.map(MemoryWatch::start);
                let seconds = self.seconds / f64::from(ROUNDS);
                let more = match peer {
                    Peer::Worker => self.drive_beside_echo(&mut crowd, &frames, rate, seconds, &mut beside),
                    Peer::Echo => self.drive(&mut crowd, &frames, peer, rate, seconds),
                };
                heard.iter_mut().zip(&more).for_each(|(heard, more)| heard.add(more));
                if let (Some(before_s), Some(after_s)) = (cpu_before_s, observed.and_then(cpu_s)) {
                    cores_s = Some(cores_s.unwrap_or_default() + after_s - before_s);
                }
                let seen = memory.and_then(MemoryWatch::finish);
                during = during.zip(seen).map(|(before, seen)| before.and(seen)).or(during).or(seen);
            }
        }
        self.runtime.block_on(close(crowd, process))?;
        std::thread::sleep(SETTLING);
        let closed = process.and_then(rss_mb);
        let memory = before.zip(started).zip(closed);
        let memory = memory.map(|((before, started), closed)| Memory { before, started, during, closed });
        self.row(&heard, &beside, rate, cores_s.map(|cpu_s| cpu_s / self.seconds), memory)
    }

    async fn crowd(&self, target: &OutgoingFrame) -> anyhow::Result<Crowd> {
        let mut crowd = Crowd { clients: Vec::new(), workers: Vec::new(), echoes: Vec::new(), next: 1 };
        for number in 0..self.tasks {
            self.watch.go_on()?;
            let (worker, echo) =
                (self.place.client(Peer::Worker, number).await?, self.place.client(Peer::Echo, number).await?);
            let task = started(&worker, &self.case.settings, target).await;
            crowd.workers.push(Arc::new(task.with_context(|| format!("task {} of {}", number + 1, self.tasks))?));
            crowd.echoes.push(Arc::new(self.place.echo(&echo).await?));
            crowd.clients.extend([worker, echo]);
        }
        Ok(crowd)
    }

    fn rate(&self, crowd: &mut Crowd, frames: &[OutgoingFrame]) -> Rate {
        match self.demand {
            Demand::Hz(rate_hz) => Rate::Hz(rate_hz),
            Demand::AsAnswered { ahead } => Rate::AsAnswered { ahead },
            Demand::TimesCapacity(times) => {
                let heard = self.drive(crowd, frames, Peer::Worker, Rate::AsAnswered { ahead: 1 }, CAPACITY_S);
                let answers: u64 = heard.iter().map(|heard| heard.servoing).sum();
                // At least one frame a second, so that a worker that answers nothing is heard of.
                Rate::Hz((times * answers as f64 / CAPACITY_S / self.tasks as f64).max(1.0))
            }
        }
    }

    fn drive(&self, crowd: &mut Crowd, frames: &[OutgoingFrame], peer: Peer, rate: Rate, seconds: f64) -> Vec<Heard> {
        let tasks = match peer {
            Peer::Worker => &crowd.workers,
            Peer::Echo => &crowd.echoes,
        };
        let heard = drive(self.runtime.handle(), tasks, frames, rate, seconds, crowd.next, self.watch);
        crowd.next += heard.iter().map(|heard| heard.sent + heard.unsent).max().unwrap_or(0);
        heard
    }

    /// The worker under load, and one camera that asks the echo meanwhile.
    fn drive_beside_echo(
        &self,
        crowd: &mut Crowd,
        frames: &[OutgoingFrame],
        rate: Rate,
        seconds: f64,
        beside: &mut Heard,
    ) -> Vec<Heard> {
        let (runtime, echo, first) = (self.runtime.handle(), crowd.echoes[0].clone(), crowd.next);
        std::thread::scope(|scope| {
            let asked = scope.spawn(move || drive(runtime, &[echo], frames, BESIDE, seconds, first, self.watch));
            let heard = self.drive(crowd, frames, Peer::Worker, rate, seconds);
            asked.join().iter().flatten().for_each(|more| beside.add(more));
            heard
        })
    }

    fn row(
        &self,
        [workers, echoes]: &[Vec<Heard>; 2],
        beside: &Heard,
        rate: Rate,
        worker_cores: Option<f64>,
        worker_rss_mb: Option<Memory>,
    ) -> anyhow::Result<LoadRow> {
        let all = total(workers);
        let error = all.error.clone().unwrap_or_else(|| format!("{:?}", all.refused));
        ensure!(all.servoing > 0, "not one of {} frames was answered with a twist: {error}", all.sent);
        let [times, echo, beside] = [&all, &total(echoes), beside].map(|heard| heard.times.summary());
        let twists = workers.iter().map(|heard| heard.servoing as f64);
        let named = all.with_status(Status::Overloaded) + all.with_status(Status::DeadlineMissed);
        let mut common = Common::new("load", self.case, &times);
        common.frames_per_s = all.servoing as f64 / self.seconds;
        Ok(LoadRow {
            common,
            tasks: self.tasks,
            rate_hz: if let Rate::Hz(rate_hz) = rate { Some(rate_hz) } else { None },
            ahead: if let Rate::AsAnswered { ahead } = rate { Some(ahead) } else { None },
            seconds: self.seconds,
            sent: all.sent,
            servoing: all.servoing,
            overloaded: all.with_status(Status::Overloaded),
            deadline_missed: all.with_status(Status::DeadlineMissed),
            other_status: all.refused.values().sum::<u64>() - named,
            unanswered: all.unanswered,
            unsent: all.unsent,
            fairness: twists.clone().fold(f64::INFINITY, f64::min) / twists.fold(0.0, f64::max),
            echo_median_ms: echo.median_ms,
            echo_p99_ms: echo.p99_ms,
            p99_over_echo: times.p99_ms / echo.p99_ms,
            echo_beside_p99_ms: beside.p99_ms,
            p99_over_echo_beside: times.p99_ms / beside.p99_ms,
            worker_cores,
            worker_rss_mb,
            per_task: workers.iter().map(TaskFigures::of).collect(),
        })
    }
}

impl TaskFigures {
    fn of(heard: &Heard) -> TaskFigures {
        let times = heard.times.summary();
        TaskFigures {
            median_ms: times.median_ms,
            p99_ms: times.p99_ms,
            heard: Heard { times: Samples::default(), ..heard.clone() },
        }
    }
}

fn total(all: &[Heard]) -> Heard {
    let mut total = Heard::default();
    all.iter().for_each(|heard| total.add(heard));
    total
}

/// Closes the tasks and the sessions; when this returns, a worker of our own has let go of them. Any other may have the tasks of others.
async fn close(crowd: Crowd, process: Option<u32>) -> anyhow::Result<()> {
    for task in crowd.workers {
        Arc::into_inner(task).context("every camera has ended")?.close().await?;
    }
    if let Some(client) = crowd.clients.first().filter(|_| process.is_some()) {
        // The worker answers for its tasks until the last of their buffers is gone.
        let begin = Instant::now();
        while let Some(worker) = client.list_workers().await?.first().filter(|worker| worker.tasks > 0) {
            ensure!(begin.elapsed() < CLOSING, "{} closed tasks are still there after {CLOSING:?}", worker.tasks);
        }
    }
    drop(crowd.echoes);
    for client in crowd.clients {
        client.close().await?;
    }
    Ok(())
}
