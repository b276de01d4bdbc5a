//! Image, twist, move, next image: by requests, without a clock of its own, so a run can be repeated exactly.

use std::time::Instant;

use anyhow::{Context, bail};
use domvs_client::{OutgoingFrame, Status, Task, TwistMessage};
use domvs_proto::settings::TaskSettings;
use domvs_simulators::{CameraSettings, Simulation};

use super::lab::Lab;
use super::{DemoArgs, Run, answer_row, task_settings};
use crate::frames::outgoing;
use crate::report::{LiveLine, RunRecord, RunRow};

pub(super) async fn run(lab: &Lab, args: &DemoArgs, camera: &CameraSettings, live: &LiveLine) -> anyhow::Result<Run> {
    let mut simulation = camera.simulation()?;
    let settings = TaskSettings { limits: None, ..task_settings(args, &camera.info()?)? };
    let desired = simulation.capture_desired();
    let initial = simulation.capture();
    let task = lab.client.create_task(&settings).await?;
    task.set_target(&outgoing(&desired, 0, 0)?).await?;
    task.start().await?;
    let record = servo(&task, args, &settings, &mut simulation, live).await?;
    task.close().await?;
    let last = simulation.capture();
    Ok(Run { record, settings, desired, initial, last })
}

async fn servo(
    task: &Task,
    args: &DemoArgs,
    settings: &TaskSettings,
    simulation: &mut Simulation,
    live: &LiveLine,
) -> anyhow::Result<RunRecord> {
    let mut rows = Vec::new();
    let mut status = Status::WaitingFrame;
    for image in 0..u64::from(args.max_images) {
        let frame = outgoing(&simulation.capture(), image + 1, 0)?;
        let (answer, round_trip_us) = ask(task, &frame).await?;
        let row = row(image, &answer, round_trip_us, settings, simulation);
        live.show(&row);
        rows.push(row);
        status = answer.status;
        if status != Status::Servoing {
            break;
        }
        simulation.apply(answer.twist, settings.frame_period_s);
    }
    Ok(RunRecord {
        method: args.servo.features.method.word().to_owned(),
        converged: simulation.error().is_converged(),
        status: status.word().to_owned(),
        rows,
    })
}

/// Nothing moves while there is no answer, so asking again is safe; a busy machine may take longer than one request.
async fn ask(task: &Task, frame: &OutgoingFrame) -> anyhow::Result<(TwistMessage, f64)> {
    const ATTEMPTS: usize = 20;
    let mut last = None;
    for _ in 0..ATTEMPTS {
        let begin = Instant::now();
        match task.twist(frame).await {
            Ok(answer) if matches!(answer.status, Status::Overloaded | Status::DeadlineMissed | Status::StaleFrame) => {
                last = Some(anyhow::anyhow!("the service answered {}", answer.status));
            }
            Ok(answer) => return Ok((answer, begin.elapsed().as_secs_f64() * 1e6)),
            Err(error) => last = Some(error.into()),
        }
    }
    match last {
        Some(error) => Err(error).with_context(|| format!("no twist after {ATTEMPTS} requests")),
        None => bail!("no request was made"),
    }
}

fn row(
    image: u64,
    answer: &TwistMessage,
    round_trip_us: f64,
    settings: &TaskSettings,
    simulation: &Simulation,
) -> RunRow {
    RunRow {
        time_s: image as f64 * settings.frame_period_s,
        round_trip_us,
        ..answer_row(image, answer, settings, &simulation.pose, simulation.error())
    }
}
