//! From the tables of a plan to a camera in front of a scene. A scene with a name brings its whole world along: what the plan does
//! not say (target, start, disturbance) is as that world has it. Without any scene there is the world "object" and experiment #1's start.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::Context;
use domvs_proto::settings::Camera;
use domvs_simulators::spec::{self, WorldSpec};
use domvs_simulators::{PinholeCamera, Simulation, motion};
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::plan::RunPlan;

/// What is looked at where nothing is said.
const SCENE: &str = "object";

/// A camera where a run begins.
pub struct World {
    /// What looks and moves.
    pub simulation: Simulation,
    /// Its optics, as settings have them.
    pub camera: Camera,
    /// Where it starts: se(3) log coordinates of `T_desired⁻¹ T_initial`, m and degrees.
    pub displacement: [f64; 6],
}

/// Worlds that were built, for all threads: only seeds differ between most runs of a sweep.
#[derive(Default)]
pub struct Worlds {
    built: Mutex<HashMap<(PathBuf, String), spec::World>>,
}

impl Worlds {
    /// The world of a plan; what is random in it comes from the plan's seed.
    ///
    /// # Errors
    /// Fails, naming the key, on what is unknown or impossible, and when a file cannot be read.
    pub fn open(&self, plan: &RunPlan) -> anyhow::Result<World> {
        let key = (plan.folder.clone(), Value::Object(plan.world.clone()).to_string());
        let known = self.built().get(&key).cloned();
        let mut world = match known {
            Some(world) => world,
            None => {
                let world = described(plan)?.build(&plan.folder)?;
                self.built().insert(key, world.clone());
                world
            }
        };
        world.seed = plan.seed;
        let simulation = world.simulation(0);
        let [x, y, z, a, b, c] = motion::log(&(simulation.desired.inverse() * simulation.pose));
        let displacement = [x, y, z, a.to_degrees(), b.to_degrees(), c.to_degrees()];
        Ok(World { camera: settings_camera(&simulation.camera), simulation, displacement })
    }

    fn built(&self) -> std::sync::MutexGuard<'_, HashMap<(PathBuf, String), spec::World>> {
        // A thread that panicked has left nothing half done: insertions are whole.
        self.built.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

fn described(plan: &RunPlan) -> anyhow::Result<WorldSpec> {
    let named = plan.world.get("scene").and_then(|scene| scene.get("named")).and_then(Value::as_str);
    let base = match named {
        Some(name) => WorldSpec::named(name)?,
        None => WorldSpec { scene: WorldSpec::named(SCENE)?.scene, ..WorldSpec::default() },
    };
    let mut world = base.clone();
    let mut all = serde_json::to_value(base)?;
    for (key, table) in &plan.world {
        match (&mut all[key], table) {
            (Value::Object(there), Value::Object(table)) if key == "camera" || key == "disturbance" => {
                there.extend(table.clone());
            }
            (place, table) => *place = table.clone(),
        }
        let part = all[key].take();
        match key.as_str() {
            "camera" => world.camera = part_of(key, part)?,
            "scene" => world.scene = part_of(key, part)?,
            "target" => world.target = part_of(key, part)?,
            "start" => world.start = part_of(key, part)?,
            _ => world.disturbance = part_of(key, part)?,
        }
    }
    Ok(world)
}

/// One table of a world.
fn part_of<T: DeserializeOwned>(key: &str, part: Value) -> anyhow::Result<T> {
    serde_json::from_value(part).with_context(|| format!("[{key}]"))
}

fn settings_camera(camera: &PinholeCamera) -> Camera {
    let ([fx, fy], [cx, cy]) = (camera.intrinsics.focal_px(), camera.intrinsics.center_px());
    Camera { fx, fy, cx, cy, width: camera.width as u32, height: camera.height as u32, distortion: None }
}

/// Where the camera is, seen from where it should be, m.
pub fn position_m(simulation: &Simulation) -> [f64; 3] {
    (simulation.desired.inverse() * simulation.pose).translation.vector.into()
}

#[cfg(test)]
mod tests {
    use super::super::plan::Overrides;
    use super::super::spec::Experiment;
    use super::*;

    fn plan(text: &str) -> RunPlan {
        let experiment = Experiment::parse(&format!("name = 'x'\n{text}")).expect("a file");
        experiment.plan(&Overrides::default()).expect("a plan").remove(0)
    }

    #[test]
    fn a_world_starts_where_its_table_says() {
        let world =
            Worlds::default().open(&plan("start = { displacement = [0.1, 0, -0.2, 1, 2, -3] }")).expect("a world");
        for (got, expected) in world.displacement.iter().zip([0.1, 0.0, -0.2, 1.0, 2.0, -3.0]) {
            assert!((got - expected).abs() < 1e-12, "log and exp are inverse to round-off: {:?}", world.displacement);
        }
        assert_eq!((world.camera.width, world.camera.cx), (128, 63.5));
    }

    #[test]
    fn a_named_scene_brings_its_random_start_and_every_seed_has_its_own() {
        let worlds = Worlds::default();
        let mut plan = plan("scenes = ['boxes']");
        let starts = [1, 2, 1].map(|seed| {
            plan.seed = seed;
            worlds.open(&plan).expect("a world").displacement
        });
        assert_ne!(starts[0], starts[1]);
        assert_eq!(starts[0], starts[2]);
    }

    #[test]
    fn an_unknown_key_is_named() {
        let error = Worlds::default().open(&plan("disturbance = { noise_varianze = 1 }")).err().expect("no such key");
        let error = format!("{error:#}");
        assert!(error.contains("[disturbance]") && error.contains("noise_varianze"), "{error}");
    }
}
