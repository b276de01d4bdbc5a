//! What a soak says in the end: each promise with its numbers, held or not.

use std::collections::BTreeMap;

use comfy_table::{Cell, Table, TableComponent};
use serde::Serialize;

use super::crew::{Life, Page};
use super::judge::{Findings, Wrong};
use super::plan::Event;
use crate::paint::Paint;
use crate::report::number;

/// What memory may grow by from the second third of a worker's life to the last: this factor or so many MB, whichever is more.
const GROWTH: (f64, f64) = (1.15, 8.0);
/// The same of open files.
const MORE_FILES: usize = 8;
/// Looks at a worker, one a second, before its memory says anything; the first third of a life is its youth.
const LOOKS: usize = 120;

/// One promise.
#[derive(Clone, Debug, Serialize)]
pub struct Check {
    /// What must hold.
    pub promise: String,
    /// Whether it did.
    pub held: bool,
    /// With numbers.
    pub said: String,
}

impl Check {
    /// A promise and what became of it.
    pub fn new(promise: &str, held: bool, said: impl ToString) -> Check {
        Check { promise: promise.to_owned(), held, said: said.to_string() }
    }
}

/// A soak's end.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// All promises held.
    pub passed: bool,
    /// How to have it again.
    pub seed: u64,
    /// Minutes.
    pub minutes: f64,
    /// Tasks.
    pub tasks: usize,
    /// Workers.
    pub workers: usize,
    /// The promises.
    pub checks: Vec<Check>,
    /// What happened: counts and times.
    pub figures: BTreeMap<&'static str, f64>,
    /// Answers and commands by the word of their status.
    pub statuses: BTreeMap<&'static str, u64>,
    /// Error answers by their word.
    pub refusals: BTreeMap<&'static str, u64>,
    /// Faults, by kind.
    pub faults: BTreeMap<&'static str, usize>,
    /// The plan.
    pub plan: Vec<Event>,
    /// Memory and files of every worker process.
    pub workers_over_time: Vec<Life>,
}

impl Verdict {
    /// As a table with what happened below it.
    pub fn text(&self, paint: Paint) -> String {
        let mut table = dense(paint, &["promise", "", "numbers"]);
        for check in &self.checks {
            let word = if check.held { "held" } else { "BROKEN" };
            table.add_row(vec![
                Cell::new(&check.promise),
                paint.verdict_cell(word, check.held),
                Cell::new(&check.said),
            ]);
        }
        let mut happened = dense(paint, &["what happened", ""]);
        for (name, value) in &self.figures {
            // Counts as they are, measures with as many digits as they are worth.
            let value = if value.fract() == 0.0 { value.to_string() } else { number(*value) };
            happened.add_row(vec![Cell::new(name), Cell::new(value)]);
        }
        let counts = |counts: Vec<(&str, u64)>| {
            let words: Vec<String> = counts.into_iter().map(|(word, count)| format!("{word} {count}")).collect();
            Cell::new(if words.is_empty() { "none".to_owned() } else { words.join(", ") })
        };
        let of = |counts: &BTreeMap<&'static str, u64>| counts.iter().map(|(word, count)| (*word, *count)).collect();
        happened.add_row(vec![Cell::new("answers"), counts(of(&self.statuses))]);
        happened.add_row(vec![Cell::new("error answers"), counts(of(&self.refusals))]);
        let faults = self.faults.iter().map(|(word, count)| (*word, *count as u64)).collect();
        happened.add_row(vec![Cell::new("faults"), counts(faults)]);
        let end = match self.passed {
            true => paint.good("passed"),
            false => paint.bad("failed"),
        };
        let Verdict { minutes, tasks, workers, seed, .. } = self;
        format!("{happened}\n{table}\n{end}: {minutes:.1} minutes, {tasks} tasks, {workers} workers, seed {seed}")
    }
}

/// Many short rows are read down the columns.
fn dense(paint: Paint, headings: &[&str]) -> Table {
    let mut table = paint.table(headings);
    for lines in [TableComponent::HorizontalLines, TableComponent::MiddleIntersections] {
        table.remove_style(lines);
    }
    table
}

/// Of each kind of wrong motion there was none.
pub fn motion(findings: &Findings) -> Vec<Check> {
    let of = |wrong: Wrong| match findings.wrong.get(&wrong) {
        None => Check::new(wrong.words(), true, format!("{} answers, {} twists", findings.heard, findings.twists)),
        Some((count, first)) => Check::new(wrong.words(), false, format!("{count} times; first {first}")),
    };
    Wrong::ALL.map(of).into()
}

/// Every frame that the workers had was answered or dropped for a reason that is counted.
pub fn counts(pages: &[Page]) -> Check {
    let sum = |start: &str| pages.iter().map(|page| page.sum(start)).sum::<f64>();
    let received = sum("domvs_frames_received_total");
    let unanswered = ["superseded", "stood_still", "not_owner", "quota", "no_room", "closed"];
    let dropped =
        unanswered.map(|reason| sum(&format!("domvs_frames_dropped_total{{reason=\"{reason}\""))).iter().sum();
    let (answered, dropped): (f64, f64) = (sum("domvs_answers_total"), dropped);
    let missing = received - answered - dropped;
    let said = format!("received {received}, answered {answered}, dropped unanswered {dropped}, missing {missing}");
    Check::new("the workers' counts add up", missing == 0.0 && received > 0.0, said)
}

/// Memory and files of the worker that lived longest behind its first third.
pub fn flat(lives: &[Life]) -> [Check; 2] {
    let promises = ["memory stays flat", "open files stay flat"];
    let longest = lives.iter().max_by_key(|life| life.looks.len()).filter(|life| life.looks.len() >= LOOKS);
    let Some(life) = longest else {
        let said = format!("not judged: no worker lived for {LOOKS} s");
        return promises.map(|promise| Check::new(promise, true, &said));
    };
    let third = life.looks.len() / 3;
    let median = |looks: &[(f64, f64, usize)], value: fn(&(f64, f64, usize)) -> f64| {
        let mut values: Vec<f64> = looks.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let [middle, last] = [&life.looks[third..2 * third], &life.looks[2 * third..]];
    let [mb_then, mb_now] = [middle, last].map(|looks| median(looks, |look| look.1));
    let [files_then, files_now] = [middle, last].map(|looks| median(looks, |look| look.2 as f64) as usize);
    let span_s = last[last.len() - 1].0 - middle[0].0;
    [
        Check::new(
            promises[0],
            mb_now <= (mb_then * GROWTH.0).max(mb_then + GROWTH.1),
            format!("medians {mb_then:.1} MB, then {mb_now:.1} MB, over {span_s:.0} s of one worker"),
        ),
        Check::new(
            promises[1],
            files_now <= files_then + MORE_FILES,
            format!("medians {files_then}, then {files_now}, over {span_s:.0} s of one worker"),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn life(mb: impl Fn(f64) -> f64) -> Life {
        Life { looks: (0..240).map(|at| (f64::from(at), mb(f64::from(at)), 20)).collect() }
    }

    #[test]
    fn memory_that_settles_is_flat_and_memory_that_grows_is_not() {
        let settled = life(|at| 50.0 + 40.0 * (at / 40.0).min(1.0));
        assert!(flat(&[settled]).iter().all(|check| check.held));
        let leaking = life(|at| 50.0 + 2.0 * at);
        let [memory, files] = flat(&[leaking]);
        assert!(!memory.held && files.held, "{memory:?}");
    }

    #[test]
    fn one_wrong_twist_breaks_one_promise() {
        let mut findings = Findings::default();
        findings.wrong.insert(Wrong::TooFast, (1, "at 3.0 s".to_owned()));
        let checks = motion(&findings);
        assert_eq!(checks.iter().filter(|check| !check.held).count(), 1);
    }
}
