//! A run with its images, as `run` shows it: a folder for each, comparisons for each scene and disturbance, and the page.

use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use domvs_proto::settings::TaskSettings;
use domvs_simulators::Rendering;
use domvs_vision::Plane;

use super::outcome::Outcome;
use super::page::Page;
use super::plan::RunPlan;
use super::runner::{self, Watcher};
use super::service::Service;
use super::spec::Experiment;
use super::world::Worlds;
use crate::report::plots::{self, Plot};
use crate::report::{RunImages, RunRecord, RunRow, png, strip, write_run};

/// A run that was written to its folder.
pub struct Shown {
    /// How it ended.
    pub outcome: Outcome,
    /// Image by image.
    pub record: RunRecord,
    /// Some of its images side by side, as a PNG.
    film: Vec<u8>,
    /// Which images those are.
    caption: String,
}

/// Keeps the images of a run, 8 bits each.
#[derive(Default)]
struct Film {
    desired: Option<Plane<f32>>,
    images: Vec<Vec<u8>>,
}

impl Watcher for Film {
    fn desired(&mut self, _: &TaskSettings, desired: &Rendering) {
        self.desired = Some(desired.image.clone());
    }

    fn image(&mut self, _: &mut RunRow, current: &Rendering) {
        self.images.push(current.image.samples().iter().map(|gray| (gray * 255.0).round() as u8).collect());
    }
}

impl Film {
    fn image(&self, index: usize, desired: &Plane<f32>) -> Plane<f32> {
        let levels = &self.images[index];
        let width = desired.width();
        Plane::from_fn(width, desired.height(), |u, v| f32::from(levels[v * width + u]) / 255.0)
    }
}

/// Runs `plan` and writes its folder; `None` when it was interrupted.
///
/// # Errors
/// Fails as [`runner::run`] does, and when the folder cannot be written.
pub fn run(
    plan: &RunPlan,
    worlds: &Worlds,
    service: &mut dyn Service,
    folder: &Path,
    interrupted: &AtomicBool,
) -> anyhow::Result<Option<Shown>> {
    let mut film = Film::default();
    let Some(run) = runner::run(plan, worlds, service, &mut film, interrupted)? else {
        return Ok(None);
    };
    let mut shown =
        Shown { outcome: run.outcome, record: run.record, film: Vec::new(), caption: "the target was refused".into() };
    let (Some(desired), Some(last)) = (&film.desired, film.images.len().checked_sub(1)) else {
        return Ok(Some(shown));
    };
    let picks = picks(last);
    let mut frames: Vec<Plane<f32>> = picks.iter().map(|&image| film.image(image, desired)).collect();
    let images = RunImages { desired, initial: &frames[0], last: &frames[frames.len() - 1] };
    write_run(folder, &shown.record, &run.settings.to_value(), &images)?;
    frames.push(desired.clone());
    shown.film = png(&strip(&frames.iter().collect::<Vec<_>>()))?;
    let numbers: Vec<String> = picks.iter().map(usize::to_string).collect();
    shown.caption = format!("{}: images {}, and the desired one", plan.cell.method, numbers.join(", "));
    let path = folder.join("film.png");
    std::fs::write(&path, &shown.film).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(Some(shown))
}

/// 0, 1, 2, 4, 8, … and the last one: most happens at the beginning.
fn picks(last: usize) -> Vec<usize> {
    let powers = std::iter::successors(Some(1), |power| Some(2 * power)).take_while(|power| *power < last);
    let mut picks: Vec<usize> = [0].into_iter().chain(powers).chain([last]).collect();
    picks.dedup();
    picks
}

/// A folder's name for each run, all different: names that differ in signs only get numbers.
pub fn folder_names(plans: &[RunPlan]) -> Vec<String> {
    let comparisons = plans.iter().map(|plan| slug(&format!("{} {}", plan.cell.scene, plan.cell.disturbance)));
    let mut taken: HashSet<String> = comparisons.collect();
    let free = |plan: &RunPlan| {
        let slug = slug(&format!("{} {} {}", plan.cell.scene, plan.cell.disturbance, plan.cell.method));
        let numbered = (2..).map(|number| format!("{slug}-{number}"));
        let name = std::iter::once(slug.clone()).chain(numbered).find(|name| !taken.contains(name));
        let name = name.unwrap_or(slug);
        taken.insert(name.clone());
        name
    };
    plans.iter().map(free).collect()
}

/// A name as a folder's: letters, digits, dots; the rest becomes a dash.
pub fn slug(name: &str) -> String {
    let keep = |c: char| if c.is_ascii_alphanumeric() || c == '.' { c.to_ascii_lowercase() } else { '-' };
    let dashed: String = name.chars().map(keep).collect();
    dashed.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
}

/// The page about `runs`, of which each scene and disturbance has its comparisons, which are written to `out` too.
///
/// # Errors
/// Fails when a plot cannot be drawn or written.
pub fn page(out: &Path, experiment: &Experiment, runs: &[Shown]) -> anyhow::Result<String> {
    let mut page = Page::new(&format!("Experiment {}", experiment.name));
    page.introduction(experiment);
    for group in groups(runs) {
        let first = &group[0].outcome;
        let name = match first.disturbance.as_str() {
            "" => first.scene.clone(),
            disturbance => format!("{} · {disturbance}", first.scene),
        };
        page.heading(&name);
        let displacement: Vec<String> = first.displacement.iter().map(|number| format!("{number:.3}")).collect();
        page.text(&format!("Displacement (m, degrees): {}", displacement.join(", ")));
        page.runs(&group.iter().map(|run| &run.outcome).collect::<Vec<_>>());
        for run in group.iter().filter(|run| !run.film.is_empty()) {
            page.image(&run.film, &run.caption);
        }
        let records: Vec<RunRecord> = group.iter().map(|run| run.record.clone()).collect();
        let compared = plots::of_runs(&records, &name)?;
        let folder = out.join(slug(&format!("{} {}", first.scene, first.disturbance)));
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        plots::write_plots(&folder, &compared)?;
        page.plots(&compared);
        for run in group {
            page.folded(&format!("{}, by itself", run.outcome.method), &of_one(&run.record)?);
        }
    }
    Ok(page.finish())
}

/// What a comparison does not show.
fn of_one(record: &RunRecord) -> anyhow::Result<Vec<Plot>> {
    let mut plots = plots::of_run(record)?;
    plots.retain(|plot| matches!(plot.name, "feature_error" | "twist" | "parameters" | "camera_path"));
    Ok(plots)
}

/// Runs of one scene and disturbance stand together in the plan's order.
fn groups(runs: &[Shown]) -> impl Iterator<Item = &[Shown]> {
    runs.chunk_by(|a, b| (&a.outcome.scene, &a.outcome.disturbance) == (&b.outcome.scene, &b.outcome.disturbance))
}

#[cfg(test)]
mod tests {
    use super::super::plan::Overrides;
    use super::*;

    #[test]
    fn a_film_has_the_first_and_the_last_image_and_more_of_the_beginning() {
        assert_eq!(picks(0), [0]);
        assert_eq!(picks(1), [0, 1]);
        assert_eq!(picks(20), [0, 1, 2, 4, 8, 16, 20]);
    }

    #[test]
    fn no_two_runs_share_a_folder_nor_one_with_a_comparison() {
        let text = "name = 'x'\nmethods = [{ name = 'a=1' }, { name = 'a 1' }]\n[[disturbances]]\nname = 'd'\n\
                    [[disturbances]]\nname = 'd a:1'";
        let plans = Experiment::parse(text).and_then(|file| file.plan(&Overrides::default())).expect("a plan");
        assert_eq!(folder_names(&plans), ["x-d-a-1-2", "x-d-a-1-3", "x-d-a-1-a-1", "x-d-a-1-a-1-2"]);
    }

    #[test]
    fn any_name_makes_a_folder_name() {
        assert_eq!(slug("Case 1: σ² = 0.6"), "case-1-0.6");
        assert_eq!(slug("HM l=3"), "hm-l-3");
    }
}
