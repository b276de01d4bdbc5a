//! Sweeps in this process, on all cores, with nothing left on the disk.

use std::sync::atomic::AtomicBool;

use domvs::experiment::outcome::{Outcome, median};
use domvs::experiment::plan::Overrides;
use domvs::experiment::pool::{all_cores, in_parallel};
use domvs::experiment::runner::{Nobody, run};
use domvs::experiment::service::InProcess;
use domvs::experiment::spec::Experiment;
use domvs::experiment::world::Worlds;

/// Every run of an experiment's text, in the plan's order.
pub fn sweep(text: &str) -> Vec<Outcome> {
    sweep_of(&Experiment::parse(text).unwrap(), &Overrides::default())
}

/// Every run of an experiment, in the plan's order.
pub fn sweep_of(experiment: &Experiment, over: &Overrides) -> Vec<Outcome> {
    let runs = experiment.plan(over).unwrap();
    let (worlds, never) = (Worlds::default(), AtomicBool::new(false));
    let mut outcomes = vec![None; runs.len()];
    in_parallel(
        all_cores(),
        &runs,
        &never,
        || Ok(InProcess::default()),
        |service, plan| Ok(run(plan, &worlds, service, &mut Nobody, &never)?.unwrap().outcome),
        |index, outcome| {
            outcomes[index] = Some(outcome);
            Ok(())
        },
    )
    .unwrap();
    outcomes.into_iter().flatten().collect()
}

/// What a few runs of one kind came to.
#[derive(Debug)]
pub struct Group {
    pub runs: usize,
    pub successes: usize,
    /// Of those that converged; infinite if none did.
    pub images: f64,
    /// Of those that converged; infinite if none did.
    pub path_ratio: f64,
    /// Of all.
    pub settled_mm: f64,
}

/// The runs that `wanted` picks.
pub fn group(outcomes: &[Outcome], wanted: impl Fn(&Outcome) -> bool) -> Group {
    let all: Vec<&Outcome> = outcomes.iter().filter(|outcome| wanted(outcome)).collect();
    let converged = || all.iter().filter(|outcome| outcome.converged);
    let group = Group {
        runs: all.len(),
        successes: converged().count(),
        images: median(converged().filter_map(|outcome| outcome.images.map(f64::from))).unwrap_or(f64::INFINITY),
        path_ratio: median(converged().filter_map(|outcome| outcome.path_ratio)).unwrap_or(f64::INFINITY),
        settled_mm: median(all.iter().map(|outcome| outcome.settled_mm)).unwrap_or(f64::INFINITY),
    };
    assert!(group.runs > 0, "nothing was picked");
    group
}

/// The runs of two methods, all scenes together.
pub fn pair(text: &str, methods: [&str; 2]) -> [Group; 2] {
    let outcomes = sweep(text);
    let groups = methods.map(|method| group(&outcomes, |outcome| outcome.method == method));
    println!("{methods:?}: {groups:?}");
    groups
}
