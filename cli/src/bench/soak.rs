//! Tasks, churn and faults together, for minutes or hours, and a verdict. Workers are processes that join a router in this one; every task has
//! a client and a camera in a session of its own ([`player`]); a [`plan`](mod@plan) from a seed says what goes wrong; the [`judge`] holds every
//! twist against the frames that went out; the [`crew`] is watched from the system's side; the [`verdict`] says what held.
//!
//! The data's way: [`plan`](mod@plan) → [`stage`] → [`player`]s, under the eyes of [`judge`] and [`crew`] → [`verdict`].

pub mod plan;

pub mod judge;

pub mod crew;

pub mod stage;

mod player;

pub mod verdict;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, ensure};
use domvs_client::{Client, ClientOptions};
use tokio::runtime::Runtime;

use self::crew::Crew;
use self::judge::{FirstOfSecond, Judge, lock};
use self::plan::{Event, Fault, plan};
use self::player::{Life, Player, Way};
use self::stage::{Churned, Stage};
use self::verdict::{Check, Verdict};
use super::watch::Watch;
use crate::network::open_local_router;

/// Between two looks at whether this process is late.
const LOOK: Duration = Duration::from_millis(10);
/// Between two looks at the workers.
const CREW_LOOK: Duration = Duration::from_secs(1);
/// After a worker's fault, how long nobody may be blamed for what it does not send.
const BACK: Duration = Duration::from_secs(3);
/// In the end, how long the workers may take to close what is left.
const REAPED: Duration = Duration::from_secs(15);
/// A task that still moves has moved so lately.
const LATELY: Duration = Duration::from_secs(5);

/// How long, how many, and what goes wrong.
#[derive(Clone, Debug)]
pub struct Soak {
    /// Minutes.
    pub minutes: f64,
    /// Tasks, by turns asked and pushed.
    pub tasks: usize,
    /// Worker processes.
    pub workers: usize,
    /// Where the plan comes from.
    pub seed: u64,
}

/// Everything that runs.
struct Run {
    soak: Soak,
    stage: Arc<Stage>,
    crew: Arc<Crew>,
    judge: Arc<Judge>,
    lives: Vec<Arc<Life>>,
    churned: Arc<Churned>,
    plan: Vec<Event>,
    begin: Instant,
    end: Instant,
}

/// Runs to the end, or to a signal.
///
/// # Errors
/// Fails when the workers cannot be started, and when it is stopped.
pub fn run(soak: &Soak, runtime: &Runtime, folder: &Path, watch: &Watch) -> anyhow::Result<Verdict> {
    let config = folder.join("server.toml");
    let limit = 4 * soak.tasks + 64;
    // What a client leaves behind is closed soon, so that the end can see it.
    let text = format!("[limits]\ntasks = {limit}\n\n[lease]\ngrace_s = 2\n");
    std::fs::write(&config, text).with_context(|| config.display().to_string())?;
    let (router, endpoint) = runtime.block_on(open_local_router())?;
    let length = Duration::from_secs_f64(60.0 * soak.minutes);
    let begin = Instant::now();
    let crew = Arc::new(Crew::start(&endpoint, config, soak.workers, begin)?);
    let run = Run {
        stage: Arc::new(Stage::new(endpoint, soak.workers, watch.clone())?),
        crew,
        judge: Arc::new(Judge::new(begin)),
        lives: (0..soak.tasks).map(|_| Arc::default()).collect(),
        churned: Arc::default(),
        plan: plan(soak.seed, length, soak.tasks, soak.workers),
        begin,
        end: begin + length,
        soak: soak.clone(),
    };
    let verdict = run.all(runtime, watch);
    drop(run);
    runtime.block_on(async { router.close().await }).map_err(|error| anyhow!("the router: {error}"))?;
    verdict
}

impl Run {
    fn all(&self, runtime: &Runtime, watch: &Watch) -> anyhow::Result<Verdict> {
        let over = Arc::new(AtomicBool::new(false));
        let clock = self.watch_oneself(&over);
        let mut players = tokio::task::JoinSet::new();
        for number in 0..self.soak.tasks {
            players.spawn_on(self.player(number).play(), runtime.handle());
        }
        let churn = runtime.spawn(self.stage.clone().churn(self.end, self.churned.clone()));
        self.make_trouble(watch);
        let moving = self.moving();
        runtime.block_on(async {
            players.join_all().await;
            // Its own limits end it.
            let _ = churn.await;
        });
        over.store(true, Ordering::Relaxed);
        clock.join().map_err(|_| anyhow!("the clock of the soak panicked"))?;
        watch.go_on()?;
        let left = runtime.block_on(self.left_behind());
        self.verdict(moving, left?)
    }

    fn player(&self, number: usize) -> Player {
        let own =
            |event: &&Event| event.whom == number && !matches!(event.fault, Fault::WorkerKilled | Fault::WorkerStopped);
        Player {
            number,
            way: if number.is_multiple_of(2) { Way::Asked } else { Way::Pushed },
            stage: self.stage.clone(),
            judge: self.judge.clone(),
            life: self.lives[number].clone(),
            events: self.plan.iter().filter(own).copied().collect(),
            begin: self.begin,
            end: self.end,
        }
    }

    /// How late this process itself is, so that nobody else is blamed for it; and the memory of the workers.
    fn watch_oneself(&self, over: &Arc<AtomicBool>) -> std::thread::JoinHandle<()> {
        let (judge, crew, over, begin) = (self.judge.clone(), self.crew.clone(), over.clone(), self.begin);
        std::thread::spawn(move || {
            let (mut second, mut looked) = (0, begin);
            while !over.load(Ordering::Relaxed) {
                let before = Instant::now();
                std::thread::sleep(LOOK);
                let late = before.elapsed().saturating_sub(LOOK);
                let now = begin.elapsed().as_secs();
                let first = if now == second { FirstOfSecond::No } else { FirstOfSecond::Yes };
                judge.stalled(now, late, first);
                second = now;
                if looked.elapsed() >= CREW_LOOK {
                    looked = Instant::now();
                    crew.look();
                }
            }
        })
    }

    /// What happens to workers, when it is due; and the bar, a part a second.
    fn make_trouble(&self, watch: &Watch) {
        let of_workers = |event: &&Event| matches!(event.fault, Fault::WorkerKilled | Fault::WorkerStopped);
        let mut events = self.plan.iter().filter(of_workers).peekable();
        let mut restarts: Vec<(Instant, usize)> = Vec::new();
        let mut seconds = 0;
        while Instant::now() < self.end && !watch.is_stopped() {
            std::thread::sleep(LOOK);
            let now = self.begin.elapsed();
            while let Some(event) = events.next_if(|event| event.at <= now) {
                watch.says(format!("{} {}", event.fault.word(), event.whom));
                self.strike(event, &mut restarts);
            }
            if !restarts.is_empty() {
                self.judge.away_until(Instant::now() + BACK);
            }
            if let Some(due) = restarts.iter().position(|(at, _)| Instant::now() >= *at) {
                let (_, worker) = restarts.remove(due);
                if let Err(error) = self.crew.start_one(worker) {
                    tracing::error!(worker, %error, "cannot be started again");
                }
            }
            if now.as_secs() > seconds {
                watch.done((now.as_secs() - seconds) as usize);
                seconds = now.as_secs();
            }
        }
    }

    fn strike(&self, event: &Event, restarts: &mut Vec<(Instant, usize)>) {
        let now = Instant::now();
        self.judge.away_until(now + event.lasts + BACK);
        for life in &self.lives {
            if lock(&life.moved).is_some_and(|moved| moved.elapsed() < LATELY) {
                *lock(&life.struck) = Some(now);
            }
        }
        match event.fault {
            Fault::WorkerKilled => {
                self.crew.kill(event.whom);
                restarts.push((now + event.lasts, event.whom));
            }
            _ => {
                if let Err(error) = self.crew.stop(event.whom, event.lasts) {
                    tracing::error!(%error, "a worker cannot be stopped");
                }
            }
        }
    }

    /// How many tasks moved lately.
    fn moving(&self) -> usize {
        self.lives.iter().filter(|life| lock(&life.moved).is_some_and(|moved| moved.elapsed() < LATELY)).count()
    }

    /// Tasks that are still there when every client is gone for longer than its grace.
    async fn left_behind(&self) -> anyhow::Result<u32> {
        let options = ClientOptions { zenoh: self.stage.config()?, ..ClientOptions::named("soak-end")? };
        let client = Client::connect(options).await?;
        let begin = Instant::now();
        let left = loop {
            let workers = client.list_workers().await?;
            ensure!(!workers.is_empty(), "no worker is there in the end");
            let left = workers.iter().map(|worker| worker.tasks).sum();
            if left == 0 || begin.elapsed() > REAPED {
                break left;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        };
        client.close().await?;
        Ok(left)
    }

    fn verdict(&self, moving: usize, left: u32) -> anyhow::Result<Verdict> {
        let pages = self.crew.pages()?;
        let codes = self.crew.end()?;
        let lives = self.crew.lives();
        let findings = self.judge.findings();
        let count = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::Relaxed);
        let Soak { minutes, tasks, workers, seed } = self.soak;

        let mut checks = verdict::motion(&findings);
        checks.push(verdict::counts(&pages));
        checks.extend(verdict::flat(&lives));
        let fell = self.crew.fell();
        checks.push(Check::new("no worker ends by itself", fell == 0, format!("{fell} did")));
        let panics: f64 = pages.iter().map(|page| page.sum("domvs_panics_total")).sum();
        checks.push(Check::new("no task ends by a defect", panics == 0.0, format!("{panics} did")));
        checks.push(Check::new(
            "every task moves in the end",
            moving == tasks,
            format!("{moving} of {tasks} within the last {LATELY:?}"),
        ));
        if workers > 1 {
            let said = format!("{} lost{}", findings.tasks_lost, last(&findings.last_loss));
            checks.push(Check::new("no task is lost with its worker", findings.tasks_lost == 0, said));
        }
        checks.push(Check::new("nothing is left behind", left == 0, format!("{left} tasks after {REAPED:?}")));
        let in_order = codes.iter().all(|code| *code == Some(0)) && !codes.is_empty();
        checks.push(Check::new("workers end in order", in_order, format!("exit codes {codes:?}")));

        let (answer, recovery) = (findings.answer_ms.summary(), findings.recovery_ms.summary());
        let peak_mb = lives.iter().flat_map(|life| &life.looks).map(|look| look.1).fold(0.0, f64::max);
        let figures = BTreeMap::from([
            ("frames sent", findings.frames as f64),
            ("answers and commands", findings.heard as f64),
            ("twists", findings.twists as f64),
            ("questions without an answer", findings.unanswered as f64),
            ("twists of older epochs", findings.older_epochs as f64),
            ("answer, median, ms", answer.median_ms),
            ("answer, 99th percentile, ms", answer.p99_ms),
            ("next twist after a worker's fault, median, ms", recovery.median_ms),
            ("next twist after a worker's fault, 99th percentile, ms", recovery.p99_ms),
            ("tasks lost and made anew", findings.tasks_lost as f64),
            ("tasks that came and went", count(&self.churned.closed) as f64),
            ("tasks that could not come or go", count(&self.churned.failed) as f64),
            ("memory of a worker, peak, MB", peak_mb),
        ]);
        let mut faults = BTreeMap::new();
        self.plan.iter().for_each(|event| *faults.entry(event.fault.word()).or_default() += 1);
        Ok(Verdict {
            passed: checks.iter().all(|check| check.held),
            seed,
            minutes,
            tasks,
            workers,
            checks,
            figures,
            statuses: findings.statuses.clone(),
            refusals: findings.refused.clone(),
            faults,
            plan: self.plan.clone(),
            workers_over_time: lives,
        })
    }
}

fn last(reason: &Option<String>) -> String {
    reason.as_ref().map(|reason| format!("; last {reason}")).unwrap_or_default()
}
