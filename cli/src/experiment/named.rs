//! The experiments and the method presets that come with the program: the TOML files of `cli/experiments`.

use std::path::Path;

use anyhow::{Context, bail};
use domvs_proto::settings::Method;
use serde::Deserialize;
use serde_json::Value;

use super::spec::{Experiment, Table, Variant};

/// The text of every experiment, in the order of `list`.
const EXPERIMENTS: &[&str] = &[
    include_str!("../../experiments/1.toml"),
    include_str!("../../experiments/2.toml"),
    include_str!("../../experiments/3.toml"),
    include_str!("../../experiments/noise.toml"),
    include_str!("../../experiments/5.toml"),
    include_str!("../../experiments/6.toml"),
    include_str!("../../experiments/7.toml"),
    include_str!("../../experiments/case1.toml"),
    include_str!("../../experiments/case2.toml"),
    include_str!("../../experiments/case3.toml"),
    include_str!("../../experiments/discussion.toml"),
    include_str!("../../experiments/base.toml"),
    include_str!("../../experiments/hard.toml"),
    include_str!("../../experiments/light.toml"),
    include_str!("../../experiments/noisy.toml"),
    include_str!("../../experiments/depth.toml"),
    include_str!("../../experiments/options.toml"),
];

/// Other names: the noise table is experiment #4.
const ALIASES: [(&str, &str); 1] = [("4", "noise")];

const METHODS: &str = include_str!("../../experiments/methods.toml");

/// Every experiment that has a name.
pub fn experiments() -> Vec<Experiment> {
    EXPERIMENTS.iter().map(|text| Experiment::parse(text).expect("a test parses every embedded file")).collect()
}

/// A named experiment, or the file of that path.
///
/// # Errors
/// Fails when there is neither, or the file is no experiment.
pub fn find(name_or_file: &str) -> anyhow::Result<Experiment> {
    let name = ALIASES.iter().find(|(alias, _)| *alias == name_or_file).map_or(name_or_file, |(_, name)| *name);
    if let Some(experiment) = experiments().into_iter().find(|experiment| experiment.name == name) {
        return Ok(experiment);
    }
    let path = Path::new(name_or_file);
    if !path.exists() {
        let names: Vec<String> = experiments().into_iter().map(|experiment| experiment.name).collect();
        bail!("'{name_or_file}' is neither a file nor one of {}", names.join(", "));
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {name_or_file}"))?;
    let mut experiment = Experiment::parse(&text).with_context(|| name_or_file.to_owned())?;
    experiment.folder = path.parent().map(Path::to_owned).unwrap_or_default();
    Ok(experiment)
}

/// The method presets: what the paper calls HM, TM and so on, in settings.
pub fn presets() -> Vec<Variant> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Presets {
        methods: Vec<Variant>,
    }
    let mut presets = toml::from_str::<Presets>(METHODS).expect("a test parses the embedded file").methods;
    presets.iter_mut().for_each(|preset| preset.is_preset = true);
    presets
}

/// A preset by its name in any case, or a method of the wire by its word.
///
/// # Errors
/// Fails when there is neither.
pub fn method(name: &str) -> anyhow::Result<Variant> {
    if let Some(preset) = presets().into_iter().find(|preset| preset.name.eq_ignore_ascii_case(name)) {
        return Ok(preset);
    }
    if let Some(method) = Method::ALL.into_iter().find(|method| method.word() == name) {
        let settings = Table::from_iter([("method".to_owned(), Value::from(method.word()))]);
        return Ok(Variant { name: name.to_owned(), settings, is_preset: true, ..Variant::default() });
    }
    let names: Vec<String> = presets().into_iter().map(|preset| preset.name).collect();
    bail!("'{name}' is no method; there are {}, and the words of the setting `method`", names.join(", "))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::super::plan::Overrides;
    use super::super::runner::{self, Nobody};
    use super::super::service::InProcess;
    use super::super::world::Worlds;
    use super::*;

    #[test]
    fn every_embedded_file_parses_and_every_name_is_its_own() {
        let mut names: Vec<String> = experiments().into_iter().map(|experiment| experiment.name).collect();
        assert!(presets().len() >= 9 && find("4").expect("an alias").name == "noise");
        assert!(experiments().iter().all(|experiment| !experiment.about.is_empty()));
        names.sort();
        let count = names.len();
        names.dedup();
        assert_eq!(names.len(), count);
    }

    #[test]
    fn every_run_of_every_experiment_has_a_world_and_settings_that_the_service_takes() {
        let worlds = Worlds::default();
        for experiment in experiments() {
            // Two images of the smallest size at which order 16 fits say whether world, settings and target go together.
            let size = Some([48, 48]);
            let over = Overrides { displacements: Some(1), images: Some(2), size, ..Overrides::default() };
            for plan in experiment.plan(&over).expect("known names") {
                let run = runner::run(&plan, &worlds, &mut InProcess::default(), &mut Nobody, &AtomicBool::new(false));
                let outcome = run.expect("a run").expect("to its end").outcome;
                assert!(outcome.answered > 0, "{}: {outcome:?}", experiment.name);
            }
        }
    }

    #[test]
    fn a_method_is_found_in_any_case_and_by_its_word_on_the_wire() {
        assert_eq!(method("hm").expect("a preset").name, "HM");
        assert_eq!(method("tchebichef").expect("a word").settings["method"], "tchebichef");
        assert!(method("sift").is_err());
    }
}
