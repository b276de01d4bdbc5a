//! What the paper claims, in its words and figures, and the rule by which our results are held against each claim.
//!
//! The list is `cli/experiments/claims.toml`. It holds no figure of ours: those are filled in from results, and the verdict is the
//! rule's. The reasons are words, one for each verdict that needs one.

use serde::Deserialize;

use super::landscape::Landscape;
use super::outcome::{Outcome, median};
use super::wilson::rate;

const CLAIMS: &str = include_str!("../../experiments/claims.toml");

/// One claim.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// Where it stands: a heading of the document.
    pub part: String,
    /// What is claimed, in short.
    pub claim: String,
    /// The figure that goes with it.
    pub figure: String,
    /// Which experiment tests it; `landscape` for the loss landscapes.
    pub experiment: String,
    /// Only runs of these scenes; all when there are none.
    #[serde(default)]
    pub scenes: Vec<String>,
    /// Only runs of this disturbance; all when there is none.
    #[serde(default)]
    pub disturbance: Option<String>,
    /// How it is judged.
    pub judge: Rule,
    /// Why the verdict is what it is.
    #[serde(default)]
    pub why: Why,
}

/// A reason for each verdict.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Why {
    /// When it holds.
    pub holds: String,
    /// When it holds in part.
    pub partly: String,
    /// When it does not hold.
    pub not: String,
}

/// How results are held against a claim.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Rule {
    /// All of these converge: holds when every run does, in part when some do.
    Converge(Vec<String>),
    /// None of these converges: holds when no run does, in part when some do not.
    Fail(Vec<String>),
    /// The first have a higher rate than the second: holds when every first is above every second, in part when some are.
    Above([Vec<String>; 2]),
    /// The first need fewer images than the second (medians of converged runs): likewise.
    FewerImages([Vec<String>; 2]),
    /// The error in the end is at most this, mm (mean over converged runs): holds when it is, in part when it converged.
    WithinMm(String, f64),
    /// The first ends nearer than the second (median error of all runs): holds when every first does, in part when some do.
    Nearer([Vec<String>; 2]),
    /// The interval of the pooled rate holds or exceeds this share: holds when it does, in part when the rate is above half of it.
    Rate(String, f64),
    /// The basins of these landscapes shrink in this order: holds when each does, in part when the last is smaller than the first.
    BasinsShrink(Vec<String>),
    /// These landscapes get steeper at home in this order: likewise.
    Steeper(Vec<String>),
}

/// What came of a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As claimed.
    Holds,
    /// In part.
    Partly,
    /// Not so.
    Not,
    /// There are no results.
    Untested,
}

impl Verdict {
    /// The word of the document.
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Holds => "**holds**",
            Verdict::Partly => "partly",
            Verdict::Not => "**not**",
            Verdict::Untested => "not run",
        }
    }
}

/// A verdict with our figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// What came of it.
    pub verdict: Verdict,
    /// Ours, in words.
    pub ours: String,
}

/// The list of claims.
pub fn claims() -> Vec<Claim> {
    #[derive(Deserialize)]
    struct List {
        claims: Vec<Claim>,
    }
    toml::from_str::<List>(CLAIMS).expect("a test parses the embedded file").claims
}

impl Claim {
    /// The reason for `verdict`.
    pub fn reason(&self, verdict: Verdict) -> &str {
        match verdict {
            Verdict::Holds => &self.why.holds,
            Verdict::Partly => &self.why.partly,
            Verdict::Not => &self.why.not,
            Verdict::Untested => "",
        }
    }

    /// Holds all runs of its experiment, and all landscapes, against it.
    pub fn judge(&self, runs: &[Outcome], landscapes: &[Landscape]) -> Judged {
        let fits = |run: &&Outcome| {
            run.experiment == self.experiment
                && (self.scenes.is_empty() || self.scenes.contains(&run.scene))
                && self.disturbance.as_ref().is_none_or(|disturbance| *disturbance == run.disturbance)
        };
        let runs = Runs(runs.iter().filter(fits).collect());
        let judged = self.judge_by_rule(&runs, landscapes);
        match judged.verdict {
            Verdict::Untested => Judged { ours: "–".to_owned(), ..judged },
            _ => judged,
        }
    }

    fn judge_by_rule(&self, runs: &Runs<'_>, landscapes: &[Landscape]) -> Judged {
        match &self.judge {
            Rule::Converge(methods) => runs.share(methods, |run| run.converged),
            Rule::Fail(methods) => runs.share(methods, |run| !run.converged),
            Rule::Above(sides) => {
                runs.compare(sides, Runs::success, |a, b| a > b, &|runs, method| runs.counted(method))
            }
            Rule::FewerImages(sides) => runs.compare(sides, Runs::images, |a, b| a < b, &|runs, method| {
                let images = runs.images(method).map_or("–".into(), |images| format!("{images:.0}"));
                format!("{method} {images}")
            }),
            Rule::Nearer(sides) => runs.compare(sides, Runs::error_mm, |a, b| a < b, &|runs, method| {
                let error = runs.error_mm(method).map_or("–".into(), |error| format!("{error:.1} mm"));
                format!("{method} {error}")
            }),
            Rule::WithinMm(method, limit) => runs.within(method, *limit),
            Rule::Rate(method, least) => runs.rate(method, *least),
            Rule::BasinsShrink(methods) => monotone(
                landscapes,
                methods,
                |one| -one.basin,
                |one| format!("{} {:.0} %", one.method, 100.0 * one.basin),
            ),
            Rule::Steeper(methods) => monotone(
                landscapes,
                methods,
                |one| one.near_share,
                |one| format!("{} {:.1} %", one.method, 100.0 * one.near_share),
            ),
        }
    }
}

struct Runs<'a>(Vec<&'a Outcome>);

impl<'a> Runs<'a> {
    fn of(&self, method: &str) -> Vec<&'a Outcome> {
        self.0.iter().copied().filter(|run| run.method == method).collect()
    }

    fn success(&self, method: &str) -> Option<f64> {
        let runs = self.of(method);
        let converged = runs.iter().filter(|run| run.converged).count();
        (!runs.is_empty()).then(|| converged as f64 / runs.len() as f64)
    }

    fn images(&self, method: &str) -> Option<f64> {
        median(self.of(method).iter().filter(|run| run.converged).filter_map(|run| run.images.map(f64::from)))
    }

    fn error_mm(&self, method: &str) -> Option<f64> {
        median(self.of(method).iter().map(|run| run.settled_mm))
    }

    /// `HM 3/4 (30–95 %)`
    fn counted(&self, method: &str) -> String {
        let runs = self.of(method);
        let converged = runs.iter().filter(|run| run.converged).count();
        let rate = rate(converged, runs.len());
        format!("{method} {converged}/{} ({:.0}–{:.0} %)", runs.len(), 100.0 * rate.low, 100.0 * rate.high)
    }

    fn share(&self, methods: &[String], is_so: impl Fn(&Outcome) -> bool) -> Judged {
        let chosen: Vec<&Outcome> = methods.iter().flat_map(|method| self.of(method)).collect();
        let so = chosen.iter().filter(|run| is_so(run)).count();
        let verdict = match (so, chosen.len()) {
            (_, 0) => Verdict::Untested,
            (so, all) if so == all => Verdict::Holds,
            (0, _) => Verdict::Not,
            _ => Verdict::Partly,
        };
        let ours = methods.iter().map(|method| self.counted(method)).collect::<Vec<_>>().join(", ");
        Judged { verdict, ours }
    }

    /// How many pairs of a first and a second are so; a first without a value is not, a second without one is beaten.
    fn compare(
        &self,
        [firsts, seconds]: &[Vec<String>; 2],
        value: impl Fn(&Runs<'a>, &str) -> Option<f64>,
        is_better: impl Fn(f64, f64) -> bool,
        say: &dyn Fn(&Runs<'a>, &str) -> String,
    ) -> Judged {
        let everyone = || firsts.iter().chain(seconds);
        if everyone().any(|method| self.of(method).is_empty()) {
            return Judged { verdict: Verdict::Untested, ours: String::new() };
        }
        let better = |first: &str, second: &str| match (value(self, first), value(self, second)) {
            (Some(a), Some(b)) => is_better(a, b),
            (Some(_), None) => true,
            (None, _) => false,
        };
        let pairs = firsts.len() * seconds.len();
        let so =
            firsts.iter().map(|first| seconds.iter().filter(|second| better(first, second)).count()).sum::<usize>();
        let verdict = match so {
            so if so == pairs => Verdict::Holds,
            0 => Verdict::Not,
            _ => Verdict::Partly,
        };
        Judged { verdict, ours: everyone().map(|method| say(self, method)).collect::<Vec<_>>().join(", ") }
    }

    fn within(&self, method: &str, limit_mm: f64) -> Judged {
        let runs = self.of(method);
        let converged: Vec<f64> = runs.iter().filter(|run| run.converged).map(|run| run.settled_mm).collect();
        let deg = median(runs.iter().filter(|run| run.converged).map(|run| run.settled_deg));
        let mean = converged.iter().sum::<f64>() / converged.len() as f64;
        let verdict = match (runs.is_empty(), converged.is_empty()) {
            (true, _) => Verdict::Untested,
            (_, true) => Verdict::Not,
            _ if mean <= limit_mm && converged.len() == runs.len() => Verdict::Holds,
            _ => Verdict::Partly,
        };
        let ours = match deg {
            Some(deg) => format!("{mean:.2} mm, {deg:.2}°; {}", self.counted(method)),
            None => self.counted(method),
        };
        Judged { verdict, ours }
    }

    fn rate(&self, method: &str, least: f64) -> Judged {
        let runs = self.of(method);
        let converged = runs.iter().filter(|run| run.converged).count();
        let found = rate(converged, runs.len());
        let verdict = match found {
            _ if runs.is_empty() => Verdict::Untested,
            found if found.high >= least => Verdict::Holds,
            found if found.rate > 0.5 * least => Verdict::Partly,
            _ => Verdict::Not,
        };
        let percent = |share: f64| format!("{:.1}", 100.0 * share);
        let interval = format!("{}–{} %", percent(found.low), percent(found.high));
        let ours = format!("{} % of {} ({interval})", percent(found.rate), runs.len());
        Judged { verdict, ours }
    }
}

/// Whether `value` grows along the list.
fn monotone(
    landscapes: &[Landscape],
    methods: &[String],
    value: impl Fn(&Landscape) -> f64,
    say: impl Fn(&Landscape) -> String,
) -> Judged {
    let found: Vec<&Landscape> =
        methods.iter().filter_map(|method| landscapes.iter().find(|one| one.method == *method)).collect();
    let verdict = match found.as_slice() {
        found if found.len() < methods.len() => Verdict::Untested,
        found if found.windows(2).all(|pair| value(pair[0]) <= value(pair[1])) => Verdict::Holds,
        [first, .., last] if value(first) < value(last) => Verdict::Partly,
        _ => Verdict::Not,
    };
    Judged { verdict, ours: found.into_iter().map(say).collect::<Vec<_>>().join(", ") }
}

#[cfg(test)]
mod tests {
    use super::super::named;
    use super::super::outcome::synthetic;
    use super::*;

    fn claim(judge: &str) -> Claim {
        toml::from_str(&format!("part = 'p'\nclaim = 'c'\nfigure = 'f'\nexperiment = 'synthetic'\njudge = {judge}"))
            .expect("a claim")
    }

    /// HM converged three times of three, TM once of three, KM never.
    fn runs() -> Vec<Outcome> {
        let run = |method: &str, converged: bool, images: u32| Outcome {
            method: method.into(),
            converged,
            images: converged.then_some(images),
            settled_mm: if converged { 0.5 } else { 700.0 },
            ..synthetic::outcome(method)
        };
        let mut runs: Vec<Outcome> = [10, 12, 14].map(|images| run("HM", true, images)).into();
        runs.extend([run("TM", true, 20), run("TM", false, 0), run("TM", false, 0)]);
        runs.extend([run("KM", false, 0), run("KM", false, 0)]);
        runs
    }

    fn verdict(judge: &str) -> Verdict {
        claim(judge).judge(&runs(), &[]).verdict
    }

    #[test]
    fn converging_and_failing_are_all_some_or_none() {
        assert_eq!(verdict("{ converge = ['HM'] }"), Verdict::Holds);
        assert_eq!(verdict("{ converge = ['HM', 'TM'] }"), Verdict::Partly);
        assert_eq!(verdict("{ converge = ['KM'] }"), Verdict::Not);
        assert_eq!(verdict("{ fail = ['KM'] }"), Verdict::Holds);
        assert_eq!(verdict("{ fail = ['TM', 'KM'] }"), Verdict::Partly);
        assert_eq!(verdict("{ converge = ['DVS'] }"), Verdict::Untested);
    }

    #[test]
    fn comparisons_want_every_pair() {
        assert_eq!(verdict("{ above = [['HM'], ['TM', 'KM']] }"), Verdict::Holds);
        assert_eq!(verdict("{ above = [['TM'], ['HM', 'KM']] }"), Verdict::Partly);
        assert_eq!(verdict("{ fewer_images = [['HM'], ['TM', 'KM']] }"), Verdict::Holds);
        assert_eq!(verdict("{ fewer_images = [['KM'], ['HM']] }"), Verdict::Not);
        assert_eq!(verdict("{ nearer = [['HM'], ['TM']] }"), Verdict::Holds);
    }

    #[test]
    fn errors_and_rates_are_held_against_a_figure() {
        assert_eq!(verdict("{ within_mm = ['HM', 1.0] }"), Verdict::Holds);
        assert_eq!(verdict("{ within_mm = ['HM', 0.1] }"), Verdict::Partly);
        assert_eq!(verdict("{ within_mm = ['TM', 1.0] }"), Verdict::Partly);
        assert_eq!(verdict("{ within_mm = ['KM', 1.0] }"), Verdict::Not);
        assert_eq!(verdict("{ rate = ['HM', 0.99] }"), Verdict::Holds, "three of three cannot deny 99 %");
        assert_eq!(verdict("{ rate = ['KM', 0.99] }"), Verdict::Not);
    }

    #[test]
    fn our_figures_come_with_their_interval() {
        assert_eq!(claim("{ converge = ['TM'] }").judge(&runs(), &[]).ours, "TM 1/3 (6–79 %)");
    }

    #[test]
    fn landscapes_are_compared_in_their_order() {
        let one = |method: &str, basin: f64| Landscape {
            scene: "s".into(),
            method: method.into(),
            loss: Vec::new(),
            basin,
            local_minima: 0,
            near_share: 1.0 - basin,
        };
        let landscapes = [one("a", 0.9), one("b", 0.6), one("c", 0.7)];
        let verdict = |list: &str| claim(&format!("{{ basins_shrink = {list} }}")).judge(&[], &landscapes).verdict;
        assert_eq!(verdict("['a', 'c', 'b']"), Verdict::Holds);
        assert_eq!(verdict("['a', 'b', 'c']"), Verdict::Partly);
        assert_eq!(verdict("['b', 'a']"), Verdict::Not);
        assert_eq!(verdict("['a', 'd']"), Verdict::Untested);
    }

    #[test]
    fn every_claim_asks_for_methods_and_disturbances_that_its_experiment_has() {
        let experiments = named::experiments();
        for claim in claims().iter().filter(|claim| claim.experiment != "landscape") {
            let experiment = experiments.iter().find(|experiment| experiment.name == claim.experiment);
            let plans = experiment.expect("the experiment").plan(&Default::default()).expect("a plan");
            let methods: Vec<&String> = match &claim.judge {
                Rule::Converge(methods) | Rule::Fail(methods) => methods.iter().collect(),
                Rule::Above(sides) | Rule::FewerImages(sides) | Rule::Nearer(sides) => sides.iter().flatten().collect(),
                Rule::WithinMm(method, _) | Rule::Rate(method, _) => vec![method],
                Rule::BasinsShrink(_) | Rule::Steeper(_) => vec![],
            };
            for method in methods {
                let is_there = plans.iter().any(|plan| {
                    plan.cell.method == *method
                        && (claim.scenes.is_empty() || claim.scenes.contains(&plan.cell.scene))
                        && claim.disturbance.as_ref().is_none_or(|disturbance| *disturbance == plan.cell.disturbance)
                });
                assert!(is_there, "{}: {method} of {}", claim.claim, claim.experiment);
            }
        }
    }
}
