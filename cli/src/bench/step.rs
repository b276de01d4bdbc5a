//! The law alone: one step of [`Servo`] on `f32` planes, as a worker computes it, on one thread, the whole twist.
//!
//! `cached`: the same image again and again, so that the window stays and the desired view is kept; with the window of a task that names none,
//! unless another is asked for. `moved`: two images take turns whose brightness lies elsewhere, so that an adaptive window moves, and bases and
//! both views are made at every step; [`Servo::work`] has to say so. A family whose window never moves has no such case.
//!
//! All cases of one size take turns, a few steps each, and all sizes do so in several passes: what disturbs the machine disturbs all.

use std::time::Instant;

use anyhow::{Context, ensure};
use domvs_server::law;
use domvs_vision::{Depth, HoleFill, Path, Servo, View, Work};
use serde::Serialize;

use super::cases::{Case, DepthKind};
use super::peak::peak_gflops;
use super::rows::{Common, Row};
use super::samples::Samples;
use super::scene::{Scene, Sight};
use super::watch::Watch;
use crate::report::number;

/// How often all sizes come round.
const PASSES: usize = 4;
/// Timed steps of one case before the next has its turn; one more, which finds the caches cold, goes before them untimed.
const BURST: usize = 5;
/// Steps before the first that is timed.
const WARM_UP: usize = 3;

/// How long each case is measured.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Timed steps.
    pub steps: usize,
    /// Seconds of timed steps after which fewer will do.
    pub seconds: f64,
    /// The instructions to use.
    pub path: Path,
}

/// One case, measured.
#[derive(Clone, Debug, Serialize)]
pub struct StepRow {
    /// What every row has.
    #[serde(flatten)]
    pub common: Common,
    /// The shortest step.
    pub min_ms: f64,
    /// Which instructions.
    pub path: String,
    /// What one core reached in this run with nothing but multiply-adds, on this path.
    pub peak_gflops: f64,
    /// Whether the window can move: where it cannot there is no `moved` row.
    pub window_moves: bool,
    /// Bases made in a step, of one axis each; by count.
    pub bases_per_step: f64,
    /// Sweeps over the desired view in a step, alone or along with the current one; by count.
    pub desired_sweeps_per_step: f64,
    /// Multiply-adds of a step; by count.
    pub multiply_adds: u64,
}

impl Row for StepRow {
    fn common(&self) -> &Common {
        &self.common
    }

    const HEADINGS: &'static [&'static str] = &["GFLOP/s", "% of peak"];

    fn cells(&self) -> Vec<String> {
        let said = |value: Option<f64>| number(value.unwrap_or(f64::NAN));
        vec![said(self.common.gflops), said(self.common.peak_fraction.map(|fraction| 100.0 * fraction))]
    }

    fn footer(rows: &[StepRow]) -> Option<String> {
        let StepRow { path, peak_gflops, .. } = rows.first()?;
        let peak = number(*peak_gflops);
        Some(format!("one thread, {path}; with nothing but multiply-adds a core reached {peak} GFLOP/s in this run"))
    }
}

/// Times and counts of one case over all passes.
#[derive(Default)]
struct Tally {
    times: Samples,
    steps: usize,
    work: Work,
}

/// A case whose images take turns, or one that sees the same image.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Images {
    Alternate,
    Same,
}

/// A servo in the middle of being measured.
struct Running<'a> {
    images: Images,
    servo: Servo<f32>,
    views: &'a [Sight; 3],
    /// Of the current view; a map is made anew from its metres for every step.
    depth: Depth<f32>,
    step: usize,
}

/// Measures every case, in [`parts`] parts.
///
/// # Errors
/// Fails, naming the case, when the law does not take it; and when it is stopped.
pub fn measure(cases: &[Case], effort: Effort, watch: &Watch) -> anyhow::Result<Vec<StepRow>> {
    let mut moves = Vec::new();
    let mut tallies: Vec<[Tally; 2]> = cases.iter().map(|_| Default::default()).collect();
    let mut peak = peak_gflops(effort.path);
    for _ in 0..PASSES {
        let mut first = 0;
        for group in cases.chunk_by(|a, b| a.size == b.size) {
            watch.says(format!("{} {}", group[0].method, group[0].size));
            let sights = Sights::of(group);
            if moves.len() < cases.len() {
                for case in group {
                    moves.push(window_moves(case, sights.of_kind(case.depth)).with_context(|| case.to_string())?);
                }
            }
            let range = first..first + group.len();
            measure_group(group, &sights, &moves[range.clone()], effort, &mut tallies[range], watch)?;
            peak = peak.max(peak_gflops(effort.path));
            first += group.len();
            watch.done(group.len());
        }
    }
    let rows = cases.iter().zip(&tallies).zip(&moves).flat_map(|((case, tallies), &moves)| {
        let rows = tallies.iter().zip(["moved", "cached"]).filter(|(tally, _)| tally.steps > 0);
        rows.map(move |(tally, name)| tally.row(name, case, moves, effort.path, peak))
    });
    Ok(rows.collect())
}

/// How many parts [`measure`] has.
pub fn parts(cases: &[Case]) -> usize {
    PASSES * cases.len()
}

/// One pass over the cases of one size, which take turns.
fn measure_group(
    cases: &[Case],
    sights: &Sights,
    moves: &[bool],
    effort: Effort,
    tallies: &mut [[Tally; 2]],
    watch: &Watch,
) -> anyhow::Result<()> {
    let mut running = Vec::new();
    for (index, case) in cases.iter().enumerate() {
        let kinds = if moves[index] { &[Images::Alternate, Images::Same][..] } else { &[Images::Same] };
        for &images in kinds {
            let views = sights.of_kind(case.depth);
            let start = || Running::start(case, views, images, effort.path);
            running.push((index, start().with_context(|| case.to_string())?));
        }
    }
    let before: Vec<f64> = tallies.iter().flatten().map(|tally| tally.times.total_s()).collect();
    for _ in 0..effort.steps.div_ceil(PASSES * BURST) {
        watch.go_on()?;
        for (index, servo) in &mut running {
            let slot = usize::from(servo.images == Images::Same);
            let tally = &mut tallies[*index][slot];
            let spent_s = tally.times.total_s() - before[2 * *index + slot];
            if spent_s < effort.seconds / PASSES as f64 {
                servo.burst(tally).with_context(|| cases[*index].to_string())?;
            }
        }
    }
    Ok(())
}

impl Tally {
    fn row(&self, name: &'static str, case: &Case, window_moves: bool, path: Path, peak: f64) -> StepRow {
        let times = self.times.summary();
        let mut common = Common::new(name, case, &times);
        let multiply_adds = self.work.multiply_adds / self.steps as u64;
        if multiply_adds > 0 {
            let gflops = 2e-6 * multiply_adds as f64 / times.median_ms;
            (common.gflops, common.peak_fraction) = (Some(gflops), Some(gflops / peak));
        }
        StepRow {
            common,
            min_ms: times.min_ms,
            path: path.to_string(),
            peak_gflops: peak,
            window_moves,
            bases_per_step: self.work.bases as f64 / self.steps as f64,
            desired_sweeps_per_step: (self.work.desired_sweeps + self.work.joint_sweeps) as f64 / self.steps as f64,
            multiply_adds,
        }
    }
}

impl<'a> Running<'a> {
    fn start(case: &Case, views: &'a [Sight; 3], images: Images, path: Path) -> anyhow::Result<Running<'a>> {
        let mut servo = servo(case, images, &views[0])?;
        servo.set_path(path);
        let mut running = Running { images, servo, views, depth: views[1].depth.clone(), step: 0 };
        for _ in 0..WARM_UP {
            running.step_ms()?;
        }
        Ok(running)
    }

    /// A few steps: one to warm the caches, the others timed.
    fn burst(&mut self, tally: &mut Tally) -> anyhow::Result<()> {
        self.step_ms()?;
        let before = self.servo.work();
        for _ in 0..BURST {
            tally.times.add(self.step_ms()?);
        }
        let after = self.servo.work();
        let bases = after.bases - before.bases;
        let must_move = self.images == Images::Alternate;
        ensure!(!must_move || bases >= BURST, "the window moved in only {bases} of {BURST} steps");
        let made = bases + after.desired_sweeps - before.desired_sweeps;
        ensure!(
            must_move || made == 0,
            "expected nothing but current views, got {made} bases and desired halves as well"
        );
        tally.steps += BURST;
        tally.work.bases += bases;
        tally.work.desired_sweeps += after.desired_sweeps - before.desired_sweeps;
        tally.work.joint_sweeps += after.joint_sweeps - before.joint_sweeps;
        tally.work.multiply_adds += after.multiply_adds - before.multiply_adds;
        Ok(())
    }

    fn step_ms(&mut self) -> anyhow::Result<f64> {
        let current = match self.images {
            Images::Same => &self.views[1],
            Images::Alternate => &self.views[1 + self.step % 2],
        };
        self.step += 1;
        let begin = Instant::now();
        if let (Depth::Map(map), Some(metres)) = (&mut self.depth, &current.metres) {
            map.set_metres(metres, HoleFill::Median)?;
        }
        std::hint::black_box(self.servo.step(View { image: &current.image, depth: &self.depth })?);
        Ok(begin.elapsed().as_secs_f64() * 1e3)
    }
}

/// The servo that the service would make of this case.
fn servo(case: &Case, images: Images, desired: &Sight) -> anyhow::Result<Servo<f32>> {
    let settings = if images == Images::Alternate { &case.moving } else { &case.settings };
    Ok(Servo::new(law::law(settings)?, law::intrinsics(&settings.camera)?, desired.view())?)
}

/// Whether turns of the two current images move this case's window each time.
fn window_moves(case: &Case, views: &[Sight; 3]) -> anyhow::Result<bool> {
    let (servo, depth) = (servo(case, Images::Alternate, &views[0])?, views[1].depth.clone());
    let mut running = Running { images: Images::Alternate, servo, views, depth, step: 0 };
    running.step_ms()?;
    for _ in 0..2 {
        let before = running.servo.work().bases;
        running.step_ms()?;
        if running.servo.work().bases == before {
            return Ok(false);
        }
    }
    Ok(true)
}

/// As [`window_moves`], for a case that is measured elsewhere.
///
/// # Errors
/// Fails when the law does not take the case.
pub fn moves(case: &Case, scene: &Scene) -> anyhow::Result<bool> {
    window_moves(case, &sights(scene, case.depth))
}

/// The desired view and the two current ones, with each kind of depth that is needed.
struct Sights(Vec<(DepthKind, [Sight; 3])>);

impl Sights {
    fn of(cases: &[Case]) -> Sights {
        let scene = Scene::new(cases[0].size);
        let is_used = |kind: &DepthKind| cases.iter().any(|case| case.depth == *kind);
        let kinds = [DepthKind::Map, DepthKind::Constant].into_iter().filter(is_used);
        Sights(kinds.map(|kind| (kind, sights(&scene, kind))).collect())
    }

    fn of_kind(&self, depth: DepthKind) -> &[Sight; 3] {
        &self.0.iter().find(|(kind, _)| *kind == depth).expect("made for every kind of these cases").1
    }
}

fn sights(scene: &Scene, kind: DepthKind) -> [Sight; 3] {
    [&scene.desired, &scene.current[0], &scene.current[1]].map(|picture| picture.sight(kind))
}

impl Sight {
    fn view(&self) -> View<'_, f32> {
        View { image: &self.image, depth: &self.depth }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::super::cases::CaseOptions;
    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        cases: CaseOptions,
    }

    fn cases(arguments: &[&str]) -> Vec<Case> {
        let line = Line::try_parse_from([&["bench"], arguments].concat()).expect("options");
        line.cases.cases().expect("possible cases")
    }

    const LITTLE: fn() -> Effort = || Effort { steps: 20, seconds: 10.0, path: Path::best() };

    #[test]
    fn adaptive_windows_move_at_every_step_and_fixed_bases_have_no_moved_case() {
        let sizes = ["--size", "97x71,32x40", "--order", "3", "--method", "hahn,krawtchouk,tchebichef"];
        let rows = measure(&cases(&sizes), LITTLE(), &Watch::silent()).expect("measured");
        assert_eq!(rows.len(), 2 * 2 * (2 + 2 + 1));
        for row in &rows {
            let expected = match (row.common.method, row.common.case) {
                ("tchebichef", case) => {
                    assert_eq!((case, row.window_moves), ("cached", false));
                    [0.0, 0.0]
                }
                (_, "moved") => [2.0, 1.0],
                _ => [0.0, 0.0],
            };
            assert_eq!([row.bases_per_step, row.desired_sweeps_per_step], expected, "{row:?}");
            assert!(row.common.samples >= 20 && row.common.median_ms > 0.0);
        }
    }

    #[test]
    fn what_the_time_does_not_allow_is_cut_short() {
        let effort = Effort { steps: 1_000_000, seconds: 1e-6, ..LITTLE() };
        let rows = measure(&cases(&["--size", "32x32", "--order", "3", "--depth", "map"]), effort, &Watch::silent());
        assert!(rows.expect("measured").iter().all(|row| row.common.samples == PASSES * BURST));
    }
}
