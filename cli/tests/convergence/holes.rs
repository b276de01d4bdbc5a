//! Holes that are not where the median is: a depth camera that knows nothing near, and a thing that is near.

use domvs::experiment::plan::{Overrides, RunPlan};
use domvs::experiment::runner::{frame, settings};
use domvs::experiment::service::{InProcess, Service};
use domvs::experiment::spec::Experiment;
use domvs::experiment::world::Worlds;
use domvs_simulators::Rendering;

use super::lab::pair;

/// Nearer than this, the depth camera knows nothing, m.
const NEAREST_M: f32 = 0.7;

/// A wall two metres away, and a small picture before it, 0.45 m away, that fills a third of the image.
const WORLD: &str = r#"
name = "near and far"
images = 40
seed = 33000
displacements = 3
methods = [
    { name = "filled", settings = { depth = { map = { holes = "fill" } } } },
    { name = "ignored", settings = { depth = { map = { holes = "ignore" } } } },
]
[scene]
middle_m = [0.0, 0.0, 2.0]
[scene.background]
photograph = "coffee"
width_m = 3.2
distance_m = 2.0
[[scene.objects]]
size_m = [0.24, 0.24]
position_m = [0.1, 0.05, 0.45]
texture = "astronaut"
[start.random]
translation_m = [[-0.1, 0.1], [-0.1, 0.1], [-0.1, 0.05]]
roll_deg = 10.0
"#;

fn shortsighted(mut rendering: Rendering) -> Rendering {
    rendering.depth.samples_mut().iter_mut().filter(|depth| **depth < NEAREST_M).for_each(|depth| *depth = 0.0);
    rendering
}

/// The error at the end, mm.
fn servoed(plan: &RunPlan) -> f64 {
    let mut world = Worlds::default().open(plan).unwrap();
    let (settings, mut service) = (settings(plan, &world).unwrap(), InProcess::default());
    let simulation = &mut world.simulation;
    let desired = shortsighted(simulation.capture_desired());
    let holes = desired.depth.samples().iter().filter(|depth| **depth == 0.0).count();
    let share = holes as f64 / desired.depth.samples().len() as f64;
    assert!((0.15..0.45).contains(&share), "{share}");
    assert_eq!(service.begin(&settings, &frame(&desired, 0).unwrap()).unwrap(), None);
    for image in 1..=u64::from(plan.images) {
        let current = shortsighted(simulation.capture());
        let answer = service.ask(&frame(&current, image).unwrap()).unwrap();
        simulation.apply(answer.twist, settings.frame_period_s);
    }
    simulation.error().mm
}

#[test]
fn ignored_holes_are_better_than_filled_ones_where_the_median_is_wrong() {
    let plans = Experiment::parse(WORLD).unwrap().plan(&Overrides::default()).unwrap();
    assert_eq!(plans.len(), 6);
    for plan in &plans {
        let (error_mm, is_ignored) = (servoed(plan), plan.cell.method == "ignored");
        println!("{} {}: {error_mm} mm", plan.cell.method, plan.seed);
        assert_eq!(error_mm < 0.1, is_ignored, "{} {}: {error_mm} mm", plan.cell.method, plan.seed);
        assert_eq!(error_mm > 100.0, !is_ignored, "{} {}: {error_mm} mm", plan.cell.method, plan.seed);
    }
}

/// The limit that docs/options.md states: an ignored pixel is also one that no longer helps.
#[test]
fn holes_scattered_over_a_scene_of_one_distance_are_better_filled() {
    let text = r#"
        name = "scattered"
        images = 40
        seed = 32300
        displacements = 2
        methods = [
            { name = "filled", settings = { depth = { map = { holes = "fill" } } } },
            { name = "ignored", settings = { depth = { map = { holes = "ignore" } } } },
        ]
        scenes = ["boxes", "case3", "object"]
        start = { random = {} }
        disturbance = { depth = { holes = 0.3, hole_px = 20.0 } }
    "#;
    let [filled, ignored] = pair(text, ["filled", "ignored"]);
    assert!(filled.successes == filled.runs && ignored.successes == ignored.runs, "{filled:?}, {ignored:?}");
    assert!(filled.images < ignored.images && filled.path_ratio < ignored.path_ratio, "{filled:?}, {ignored:?}");
}
