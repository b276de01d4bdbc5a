//! The way of a frame over the network: from a client's request to the twist in its hands. A worker's task whose window stays, one whose
//! window moves, and the echo take turns, each with the same payload, so that what the service adds can be told from what the network takes.

use std::time::Instant;

use anyhow::{Context, ensure};
use domvs_client::{Client, OutgoingFrame, Status, Task, TwistMessage};
use serde::Serialize;

use super::cases::Case;
use super::place::{Peer, Place, started};
use super::rows::{Common, Row};
use super::samples::Samples;
use super::scene::Scene;
use super::step;
use super::watch::Watch;
use crate::report::number;

/// Requests of each kind before the first that is timed.
const WARM_UP: u64 = 10;

/// How long each case is measured.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Requests of each kind.
    pub samples: u64,
    /// Seconds for one case after which fewer will do.
    pub seconds: f64,
}

/// One kind of request, measured.
#[derive(Clone, Debug, Serialize)]
pub struct RoundtripRow {
    /// What every row has.
    #[serde(flatten)]
    pub common: Common,
    /// The median of what the worker says that it computed, decoding included; null for the echo.
    pub step_ms: Option<f64>,
    /// The median of what the worker says that the frame waited.
    pub queue_ms: Option<f64>,
    /// The echo's median with the same payload.
    pub echo_ms: f64,
    /// `median_ms - echo_ms - step_ms`: what the service adds to the network and the law.
    pub overhead_ms: Option<f64>,
    /// Payload of a request; a reply has 128 bytes.
    pub payload_bytes: usize,
}

impl Row for RoundtripRow {
    fn common(&self) -> &Common {
        &self.common
    }

    const HEADINGS: &'static [&'static str] = &["step ms", "echo ms", "overhead ms"];

    fn cells(&self) -> Vec<String> {
        let said = |value: Option<f64>| number(value.unwrap_or(f64::NAN));
        vec![said(self.step_ms), number(self.echo_ms), said(self.overhead_ms)]
    }
}

/// What takes turns: a task, and the frames that it is asked with.
struct Asked {
    name: &'static str,
    task: Task,
    frames: Vec<OutgoingFrame>,
    times: [Samples; 3],
}

/// Measures every case.
///
/// # Errors
/// Fails, naming the case, when a task cannot be made or does not answer with motion; and when it is stopped.
pub async fn measure(
    place: &Place,
    cases: &[Case],
    effort: Effort,
    watch: &Watch,
) -> anyhow::Result<Vec<RoundtripRow>> {
    let worker = place.client(Peer::Worker, 0).await?;
    let echo = place.client(Peer::Echo, 0).await?;
    let mut rows = Vec::new();
    for case in cases {
        watch.says(case);
        let scene = Scene::new(case.size);
        let mut asked = tasks(place, &worker, &echo, case, &scene).await.with_context(|| case.to_string())?;
        take_turns(&mut asked, effort, watch).await.with_context(|| case.to_string())?;
        rows.extend(rows_of(case, &asked));
        for asked in asked.into_iter().filter(|asked| asked.name != ECHO) {
            asked.task.close().await?;
        }
        watch.done(1);
    }
    worker.close().await?;
    echo.close().await?;
    Ok(rows)
}

const ECHO: &str = "echo";

/// The echo first.
async fn tasks(
    place: &Place,
    worker: &Client,
    echo: &Client,
    case: &Case,
    scene: &Scene,
) -> anyhow::Result<Vec<Asked>> {
    let target = scene.desired.frame(case)?;
    let [near, far] = [scene.current[0].frame(case)?, scene.current[1].frame(case)?];
    let asked = |name, task, frames| Asked { name, task, frames, times: Default::default() };
    let mut all = vec![asked(ECHO, place.echo(echo).await?, vec![near.clone()])];
    if step::moves(case, scene)? {
        let task = started(worker, &case.moving, &target).await?;
        all.push(asked("moved", task, vec![near.clone(), far]));
    }
    all.push(asked("cached", started(worker, &case.settings, &target).await?, vec![near]));
    Ok(all)
}

async fn take_turns(asked: &mut [Asked], effort: Effort, watch: &Watch) -> anyhow::Result<()> {
    let begin = Instant::now();
    for sequence in 1..=WARM_UP + effort.samples {
        watch.go_on()?;
        let counts = sequence > WARM_UP;
        for asked in &mut *asked {
            let (ms, twist) = asked.ask(sequence).await?;
            if counts {
                let microseconds = [twist.compute_us, twist.queue_us].map(|us| f64::from(us) / 1e3);
                for (times, ms) in asked.times.iter_mut().zip([ms, microseconds[0], microseconds[1]]) {
                    times.add(ms);
                }
            }
        }
        if counts && begin.elapsed().as_secs_f64() > effort.seconds {
            break;
        }
    }
    Ok(())
}

impl Asked {
    /// The time between asking and having the answer, ms, and the answer.
    async fn ask(&self, sequence: u64) -> anyhow::Result<(f64, TwistMessage)> {
        let frame = self.frames[sequence as usize % self.frames.len()].clone().numbered(sequence, 0);
        let begin = Instant::now();
        let twist = self.task.twist(&frame).await?;
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        let is_step = matches!(twist.status, Status::Servoing | Status::RankDeficient);
        ensure!(is_step, "expected servoing from the {} task, got {}", self.name, twist.status);
        Ok((ms, twist))
    }
}

fn rows_of(case: &Case, asked: &[Asked]) -> Vec<RoundtripRow> {
    let echo_ms = asked[0].times[0].summary().median_ms;
    let row = |asked: &Asked| {
        let [whole, step, queue] = [0, 1, 2].map(|i| asked.times[i].summary());
        let of_worker = |ms: f64| (asked.name != ECHO).then_some(ms);
        RoundtripRow {
            common: Common::new(asked.name, case, &whole),
            step_ms: of_worker(step.median_ms),
            queue_ms: of_worker(queue.median_ms),
            echo_ms,
            overhead_ms: of_worker(whole.median_ms - echo_ms - step.median_ms),
            payload_bytes: asked.frames[0].payload().len(),
        }
    };
    asked.iter().map(row).collect()
}
