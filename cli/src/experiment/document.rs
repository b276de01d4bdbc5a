//! `docs/experiments.md`: claims with verdicts, then every sweep and every run as tables. All figures of ours come from results.

use std::collections::HashSet;
use std::fmt::Write;
use std::path::Path;
use std::time::SystemTime;

use anyhow::Context;
use serde::Deserialize;

use super::cells::{Cell, cells};
use super::claims::{Claim, Verdict, claims};
use super::landscape::Landscape;
use super::named;
use super::outcome::Outcome;
use super::spec::Experiment;
use crate::report::number;

/// What a folder of results holds.
#[derive(Default)]
pub struct Results {
    /// Every run.
    pub runs: Vec<Outcome>,
    /// Every landscape.
    pub landscapes: Vec<Landscape>,
}

impl Results {
    /// Reads `results.json` of every folder in `folder`, and `landscapes.json`.
    ///
    /// # Errors
    /// Fails, naming the file, when one cannot be read, and when there is none.
    pub fn read(folder: &Path) -> anyhow::Result<Results> {
        #[derive(Deserialize)]
        struct File {
            #[serde(default)]
            runs: Vec<Outcome>,
            #[serde(default)]
            landscapes: Vec<Landscape>,
        }
        let mut results = Results::default();
        let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
        let mut folders = entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>()?;
        folders.sort();
        for path in folders.iter().flat_map(|folder| ["results.json", "landscapes.json"].map(|name| folder.join(name)))
        {
            let Ok(text) = std::fs::read_to_string(&path) else { continue };
            let file: File = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
            results.runs.extend(file.runs);
            results.landscapes.extend(file.landscapes);
        }
        let nothing = results.runs.is_empty() && results.landscapes.is_empty();
        anyhow::ensure!(!nothing, "{} holds no results; make them with `domvs experiment all`", folder.display());
        Ok(results)
    }
}

/// The whole document; `date` stands in its head.
///
/// # Errors
/// Never in practice: text can always be written to.
pub fn document(results: &Results, date: &str) -> anyhow::Result<String> {
    let mut text = String::new();
    head(&mut text, date)?;
    write_claims(&mut text, results)?;
    let known = named::experiments();
    let (sweeps, runs): (Vec<&Experiment>, Vec<&Experiment>) = known.iter().partition(|one| one.displacements > 1);
    writeln!(text, "\n## Sweeps\n")?;
    writeln!(
        text,
        "Images and path are medians over the converged runs, the error is the median over all at their end. The row of all scenes \
         counts their runs together. Displacement k of every cell has the seed of the first plus k, for every method the same."
    )?;
    for experiment in sweeps {
        sweep(&mut text, experiment, results)?;
    }
    writeln!(text, "\n## Runs\n")?;
    writeln!(text, "The settled error is the median over the last eight images.")?;
    for experiment in runs {
        one_run_each(&mut text, experiment, results)?;
    }
    landscapes(&mut text, results)?;
    Ok(text)
}

fn head(text: &mut String, date: &str) -> anyhow::Result<()> {
    let version = env!("CARGO_PKG_VERSION");
    writeln!(text, "# What reproduces, and what does not\n")?;
    writeln!(
        text,
        "This page is written by a program: `domvs experiment all --out runs/experiments`, then `domvs experiment report --from \
         runs/experiments --out docs/experiments.md`. Domvs {version}, {date}. No figure of ours was typed by hand; the same version \
         gives the same figures on one kind of machine, for every seed is below.\n"
    )?;
    writeln!(
        text,
        "The paper's scenes and images were never published. Its displacements are used where it gives them, on scenes of our own \
         (`simulators/worlds`, `cli/experiments`), so a claim that does not hold here may hold on the paper's scenes, and one that holds \
         here holds here. A run has converged when the camera ends within the tolerance of the experiment by the simulator's truth, \
         1 mm and 0.1° where nothing else is said. Half a step is taken per image, the paper took a twentieth: our images are not its \
         iterations, only their order can be compared. Rates have their 95 % interval (Wilson) beside them; a single run says \
         very little, and its interval says so.\n"
    )?;
    Ok(())
}

fn write_claims(text: &mut String, results: &Results) -> anyhow::Result<()> {
    let judged: Vec<(Claim, _)> = claims()
        .into_iter()
        .map(|claim| {
            let judged = claim.judge(&results.runs, &results.landscapes);
            (claim, judged)
        })
        .collect();
    let count = |verdict: Verdict| judged.iter().filter(|(_, judged)| judged.verdict == verdict).count();
    let counts = [Verdict::Holds, Verdict::Partly, Verdict::Not, Verdict::Untested].map(count);
    writeln!(text, "## Claims\n")?;
    let [holds, partly, not, untested] = counts;
    write!(text, "Of {} claims and aims {holds} hold, {partly} hold in part, {not} do not", judged.len())?;
    writeln!(text, "{}.", if untested > 0 { format!(", {untested} were not run") } else { String::new() })?;
    let mut part = "";
    for (claim, judged) in &judged {
        if claim.part != part {
            part = &claim.part;
            writeln!(text, "\n### {part}\n\n| claim | paper | ours | scenes and seed | verdict | why |")?;
            writeln!(text, "|---|---|---|---|---|---|")?;
        }
        let why = claim.reason(judged.verdict);
        let (figure, ours, verdict) = (&claim.figure, &judged.ours, judged.verdict.word());
        let scenes = scenes_and_seeds(claim, results);
        writeln!(text, "| {} | {figure} | {ours} | {scenes} | {verdict} | {why} |", claim.claim)?;
    }
    Ok(())
}

/// `1: object, coffee; seed 1` or `…; seeds 1–100`.
fn scenes_and_seeds(claim: &Claim, results: &Results) -> String {
    let runs: Vec<&Outcome> = results
        .runs
        .iter()
        .filter(|run| run.experiment == claim.experiment)
        .filter(|run| claim.scenes.is_empty() || claim.scenes.contains(&run.scene))
        .collect();
    if claim.experiment == "landscape" {
        let scene = results.landscapes.first().map_or("–", |one| one.scene.as_str());
        return format!("landscape: {scene}");
    }
    let mut seen = HashSet::new();
    let scenes: Vec<&str> = runs.iter().map(|run| run.scene.as_str()).filter(|scene| seen.insert(*scene)).collect();
    format!("{}: {}; {}", claim.experiment, scenes.join(", "), seeds(runs.iter().map(|run| run.seed)))
}

fn seeds(seeds: impl Iterator<Item = u64> + Clone) -> String {
    match (seeds.clone().min(), seeds.max()) {
        (Some(first), Some(last)) if first < last => format!("seeds {first}–{last}"),
        (Some(first), _) => format!("seed {first}"),
        _ => "not run".to_owned(),
    }
}

fn heading(text: &mut String, experiment: &Experiment, runs: &[Outcome]) -> anyhow::Result<()> {
    writeln!(text, "\n### {}\n\n{}; {}.\n", experiment.name, experiment.about, seeds(runs.iter().map(|run| run.seed)))?;
    Ok(())
}

fn runs_of(experiment: &Experiment, results: &Results) -> Vec<Outcome> {
    results.runs.iter().filter(|run| run.experiment == experiment.name).cloned().collect()
}

fn sweep(text: &mut String, experiment: &Experiment, results: &Results) -> anyhow::Result<()> {
    let runs = runs_of(experiment, results);
    heading(text, experiment, &runs)?;
    if runs.is_empty() {
        return Ok(());
    }
    let everywhere: Vec<Outcome> =
        runs.iter().cloned().map(|run| Outcome { scene: "**all scenes**".into(), ..run }).collect();
    writeln!(text, "| scene | disturbance | method | converged | rate | 95 % interval | images | path | error |")?;
    writeln!(text, "|---|---|---|---|---|---|---|---|---|")?;
    for cell in cells(&everywhere).iter().chain(&cells(&runs)) {
        cell_row(text, cell)?;
    }
    Ok(())
}

fn cell_row(text: &mut String, cell: &Cell) -> anyhow::Result<()> {
    let optional = |value: Option<f64>, digits: usize| value.map_or("–".into(), |value| format!("{value:.digits$}"));
    let Cell { scene, disturbance, method, successes, runs, .. } = cell;
    writeln!(
        text,
        "| {scene} | {disturbance} | {method} | {successes}/{runs} | {:.1} % | {:.1}–{:.1} % | {} | {} | {} mm |",
        100.0 * cell.success_rate,
        100.0 * cell.wilson_low,
        100.0 * cell.wilson_high,
        optional(cell.median_images, 0),
        optional(cell.median_path_ratio, 2),
        cell.median_error_mm.map_or("–".into(), number),
    )?;
    Ok(())
}

fn one_run_each(text: &mut String, experiment: &Experiment, results: &Results) -> anyhow::Result<()> {
    let runs = runs_of(experiment, results);
    heading(text, experiment, &runs)?;
    if runs.is_empty() {
        return Ok(());
    }
    writeln!(text, "| scene | disturbance | method | converged | status | images | error | settled error | path |")?;
    writeln!(text, "|---|---|---|---|---|---|---|---|---|")?;
    for run in &runs {
        let Outcome { scene, disturbance, method, status, .. } = run;
        writeln!(
            text,
            "| {scene} | {disturbance} | {method} | {} | {status} | {} | {} mm, {}° | {} mm, {}° | {} |",
            if run.converged { "yes" } else { "no" },
            run.images.map_or("–".into(), |images| images.to_string()),
            number(run.error_mm),
            number(run.error_deg),
            number(run.settled_mm),
            number(run.settled_deg),
            run.path_ratio.map_or("–".into(), |ratio| format!("{ratio:.2}")),
        )?;
    }
    Ok(())
}

fn landscapes(text: &mut String, results: &Results) -> anyhow::Result<()> {
    if results.landscapes.is_empty() {
        return Ok(());
    }
    writeln!(text, "\n## Landscapes\n")?;
    writeln!(
        text,
        "The basin is the share of the shifts along x and y from which the steepest way down ends at the desired pose; near is the \
         loss at a twentieth of the reach over the largest.\n\n| scene | method | basin | other minima | near |\n|---|---|---|---|---|"
    )?;
    for Landscape { scene, method, basin, local_minima, near_share, .. } in &results.landscapes {
        let (basin, near) = (100.0 * basin, 100.0 * near_share);
        writeln!(text, "| {scene} | {method} | {basin:.1} % | {local_minima} | {near:.2} % |")?;
    }
    Ok(())
}

/// Today, UTC, as 2026-11-22.
pub fn today() -> String {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    date_of((since.as_secs() / 86_400) as i64)
}

/// The date of so many days since 1970-01-01, by Howard Hinnant's `civil_from_days`,
/// <https://howardhinnant.github.io/date_algorithms.html>.
fn date_of(days: i64) -> String {
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::super::outcome::synthetic::outcome;
    use super::*;

    #[test]
    fn dates_are_right_over_leap_days_and_centuries() {
        assert_eq!([0, 11_016, 11_017, 20_779].map(date_of), ["1970-01-01", "2000-02-29", "2000-03-01", "2026-11-22"]);
    }

    #[test]
    fn the_document_counts_its_claims_and_says_what_was_not_run() {
        let run = |method: &str| Outcome {
            experiment: "1".into(),
            scene: "object".into(),
            method: method.into(),
            ..outcome("k")
        };
        let results = Results { runs: ["TM", "KM", "HM"].map(run).into(), landscapes: Vec::new() };
        let text = document(&results, "2026-11-22").expect("a document");
        assert!(text.contains("| TM, KM and HM converge | 3 of 3 | TM 1/1 (21–100 %), KM 1/1"), "{text}");
        assert!(text.contains("1: object; seed 7 | **holds**") && text.contains("not run"));
        for line in text.lines().filter(|line| line.starts_with('|')) {
            let columns = line.matches('|').count();
            assert!([6, 7, 10].contains(&columns), "{line}");
        }
    }

    #[test]
    fn a_folder_without_results_is_an_error_that_says_what_to_do() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let error = Results::read(folder.path()).err().expect("nothing there");
        assert!(error.to_string().contains("experiment all"));
    }
}
