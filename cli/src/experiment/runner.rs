//! One run: image, twist, move, next image, until the images are used up or the service has ended the servoing.
//!
//! Frames are float pixels and float depth, so that nothing is lost on the way. A status that latches (`converged`, `diverging`, …)
//! ends the run, and the camera stays where it is then; under any other status without motion the camera waits for the next image.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Context;
use domvs_client::{DepthPlane, OutgoingFrame, PixelFormat, TwistMessage};
use domvs_proto::settings::TaskSettings;
use domvs_simulators::{Rendering, Simulation};
use serde_json::{Value, json};

use super::outcome::{Outcome, Track};
use super::parameters::Parameters;
use super::plan::RunPlan;
use super::service::Service;
use super::spec::Table;
use super::world::{self, World, Worlds};
use crate::report::{RunRecord, RunRow};

/// Who looks at a run while it goes on; the desired image comes first.
pub trait Watcher {
    /// Before the first image.
    fn desired(&mut self, settings: &TaskSettings, desired: &Rendering);
    /// Every image with its row, which may be completed.
    fn image(&mut self, row: &mut RunRow, current: &Rendering);
}

/// Looks away.
pub struct Nobody;

impl Watcher for Nobody {
    fn desired(&mut self, _: &TaskSettings, _: &Rendering) {}
    fn image(&mut self, _: &mut RunRow, _: &Rendering) {}
}

/// What a run was, whole.
#[derive(Clone, Debug)]
pub struct Run {
    /// How it ended.
    pub outcome: Outcome,
    /// Image by image.
    pub record: RunRecord,
    /// As they were in force.
    pub settings: TaskSettings,
}

/// Runs `plan`; `None` when `interrupted` was set before its end.
///
/// # Errors
/// Fails when the world or the settings are impossible, or the service does not answer.
pub fn run(
    plan: &RunPlan,
    worlds: &Worlds,
    service: &mut dyn Service,
    watcher: &mut dyn Watcher,
    interrupted: &AtomicBool,
) -> anyhow::Result<Option<Run>> {
    let name = || format!("{} (seed {})", plan.cell, plan.seed);
    let mut world = worlds.open(plan).with_context(name)?;
    let settings = settings(plan, &world).with_context(name)?;
    let servoed = servo(plan, &settings, &mut world, service, watcher, interrupted).with_context(name)?;
    Ok(servoed.map(|(track, rows, status)| {
        let outcome = Outcome::of(plan, world.displacement, &track, &status);
        let record = RunRecord { method: plan.cell.method.clone(), converged: outcome.converged, status, rows };
        Run { outcome, record, settings }
    }))
}

/// The settings of a run: the defaults for its camera, depth as the world tells it, and every layer of the plan over them.
///
/// # Errors
/// Fails on a setting that is unknown, out of range or not supported.
pub fn settings(plan: &RunPlan, world: &World) -> anyhow::Result<TaskSettings> {
    let camera = Table::from_iter([("camera".to_owned(), serde_json::to_value(world.camera)?)]);
    let mut settings = TaskSettings::from_json(&Value::Object(camera))?;
    let constant_depth = world.simulation.constant_depth_m().map(|depth_m| json!({ "constant_m": depth_m }));
    settings = settings.merge_patch(&json!({ "depth": constant_depth.unwrap_or_else(|| "map".into()) }))?;
    for layer in &plan.settings {
        settings = settings.merge_patch(&Value::Object(layer.clone()))?;
    }
    Ok(settings)
}

type Servoed = (Track, Vec<RunRow>, String);

fn servo(
    plan: &RunPlan,
    settings: &TaskSettings,
    world: &mut World,
    service: &mut dyn Service,
    watcher: &mut dyn Watcher,
    interrupted: &AtomicBool,
) -> anyhow::Result<Option<Servoed>> {
    let simulation = &mut world.simulation;
    let desired = simulation.capture_desired();
    watcher.desired(settings, &desired);
    let mut parameters = Parameters::new(settings, &desired.image);
    let mut track = Track::default();
    note(&mut track, simulation);
    if let Some(code) = service.begin(settings, &frame(&desired, 0)?)? {
        return Ok(Some((track, Vec::new(), code.to_owned())));
    }
    let mut rows: Vec<RunRow> = Vec::new();
    let mut status = String::new();
    for image in 0..u64::from(plan.images) {
        if interrupted.load(Ordering::Relaxed) {
            service.end()?;
            return Ok(None);
        }
        let current = simulation.capture();
        let begin = Instant::now();
        let answer = service.ask(&frame(&current, image + 1)?)?;
        let mut row = row(image, &answer, settings, simulation);
        row.window = parameters.of(&current.image);
        row.round_trip_us = begin.elapsed().as_secs_f64() * 1e6;
        watcher.image(&mut row, &current);
        rows.push(row);
        status = answer.status.word().to_owned();
        simulation.apply(answer.twist, settings.frame_period_s);
        note(&mut track, simulation);
        if answer.status.is_latched() {
            break;
        }
    }
    service.end()?;
    Ok(Some((track, rows, status)))
}

fn note(track: &mut Track, simulation: &Simulation) {
    track.errors.push(simulation.error());
    track.positions_m.push(world::position_m(simulation));
}

/// Float pixels and float depth.
///
/// # Errors
/// Fails when the two planes differ in size.
pub fn frame(rendering: &Rendering, sequence: u64) -> anyhow::Result<OutgoingFrame> {
    let (width, height) = (rendering.image.width() as u32, rendering.image.height() as u32);
    let pixels: Vec<u8> = rendering.image.samples().iter().flat_map(|gray| gray.to_le_bytes()).collect();
    let depth = DepthPlane::Metres(rendering.depth.samples());
    Ok(OutgoingFrame::raw_with_depth(PixelFormat::Mono32F, width, height, pixels, depth)?.numbered(sequence, 0))
}

fn row(image: u64, answer: &TwistMessage, settings: &TaskSettings, simulation: &Simulation) -> RunRow {
    let row = RunRow::answered(image, answer, simulation.error(), world::position_m(simulation));
    RunRow { time_s: image as f64 * settings.frame_period_s, ..row }
}

#[cfg(test)]
mod tests {
    use super::super::plan::Overrides;
    use super::super::service::InProcess;
    use super::super::spec::Experiment;
    use super::*;

    const EASY: &str = "name = 'easy'\nimages = 40\n[camera]\nwidth = 64\nheight = 64\n\
        [start]\ndisplacement = [0.05, -0.03, -0.04, 1, -2, -4]\n[settings]\norder = { min = 4, max = 8 }";

    fn run_easy(interrupted: bool) -> Option<Run> {
        let plan = Experiment::parse(EASY).expect("a file").plan(&Overrides::default()).expect("a plan").remove(0);
        run(&plan, &Worlds::default(), &mut InProcess::default(), &mut Nobody, &AtomicBool::new(interrupted))
            .expect("a run")
    }

    #[test]
    fn an_easy_run_converges_without_being_cut_off_at_the_default_stop() {
        let run = run_easy(false).expect("to its end");
        assert!(run.outcome.converged, "{:?}", run.outcome);
        assert!(run.outcome.error_mm < 0.1, "the stop is far below a millimetre: {:?}", run.outcome);
        let images = run.outcome.images.expect("it came there");
        assert!(images > 3 && images < run.outcome.answered, "{:?}", run.outcome);
        assert_eq!(run.record.rows.len() as u32, run.outcome.answered);
        assert!(run.settings.limits.is_none() && run.settings.step_cap.is_some());
    }

    #[test]
    fn a_run_is_the_same_again_and_an_interrupted_one_is_none() {
        let outcomes = [(); 2].map(|()| run_easy(false).expect("to its end").outcome);
        assert_eq!(outcomes[0], outcomes[1]);
        assert!(run_easy(true).is_none());
    }
}
