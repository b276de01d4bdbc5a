//! In real time: the camera publishes frames, the service answers on `command`, the camera follows.

use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use domvs_client::{Client, Status, Task};
use domvs_proto::keys::Keys;
use domvs_proto::settings::{Frames, TaskSettings};
use domvs_simulators::node::{CameraNode, Truth};
use domvs_simulators::{CameraSettings, Follow};
use tokio::sync::watch;

use super::lab::Lab;
use super::{DemoArgs, Run, answer_row, task_settings};
use crate::frames::outgoing;
use crate::report::{LiveLine, RunRecord, RunRow};

/// The watchdog of a camera with 15 frames a second: four and a half periods.
const WATCHDOG_MS: u32 = 300;
/// Without any word from the service for so long, the run has failed.
const SILENCE: Duration = Duration::from_secs(5);

pub(super) async fn run(lab: &Lab, args: &DemoArgs, camera: CameraSettings, live: &LiveLine) -> anyhow::Result<Run> {
    let mut simulation = camera.simulation()?;
    let (desired, initial) = (simulation.capture_desired(), simulation.capture());
    let settings = TaskSettings {
        frames: Frames::Pushed,
        watchdog_ms: Some(WATCHDOG_MS),
        ..task_settings(args, &camera.info()?)?
    };
    let task = lab.client.create_task(&settings).await?;
    task.set_target(&outgoing(&desired, 0, 0)?).await?;
    let keys = Keys::default();
    let camera =
        CameraSettings { frame_key: Some(keys.frame(task.key())), follow: Follow::Task(task.key().clone()), ..camera };
    let node = CameraNode::open(lab.config()?, keys, camera).await?;
    let truth = node.truth();
    let outcome = follow(&lab.client, &task, args, &settings, &truth, live).await;
    node.stop().await?;
    let record = outcome?;
    task.close().await?;
    simulation.pose = truth.borrow().pose;
    let last = simulation.capture();
    Ok(Run { record, settings, desired, initial, last })
}

async fn follow(
    client: &Client,
    task: &Task,
    args: &DemoArgs,
    settings: &TaskSettings,
    truth: &watch::Receiver<Truth>,
    live: &LiveLine,
) -> anyhow::Result<RunRecord> {
    let mut commands = client.commands(task.key()).await?;
    task.start().await?;
    let begin = Instant::now();
    let mut rows: Vec<RunRow> = Vec::new();
    let mut newest = 0;
    let status = loop {
        if rows.len() >= args.max_images as usize {
            break Status::IterationCap;
        }
        let Some(command) = commands.recv(SILENCE).await else {
            bail!("the service said nothing for {SILENCE:?}");
        };
        let over = command.status.is_latched();
        // Repeated zeros belong to no new image.
        if command.sequence == newest && !over {
            continue;
        }
        newest = command.sequence;
        let (pose, error) = {
            let truth = truth.borrow();
            (truth.pose, truth.error)
        };
        let row = RunRow {
            time_s: begin.elapsed().as_secs_f64(),
            round_trip_us: f64::from(command.queue_us) + f64::from(command.compute_us),
            ..answer_row(rows.len() as u64, &command, settings, &pose, error)
        };
        live.show(&row);
        rows.push(row);
        if over {
            break command.status;
        }
    };
    task.stop().await.context("cannot stop the task")?;
    Ok(RunRecord {
        method: args.servo.features.method.word().to_owned(),
        converged: truth.borrow().error.is_converged(),
        status: status.word().to_owned(),
        rows,
    })
}
