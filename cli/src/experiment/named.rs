//! The experiments and the method presets that come with the program: the TOML files of `cli/experiments`.

use std::path::Path;

use anyhow::{Context, bail};
use domvs_proto::settings::Method;
use serde::Deserialize;
use serde_json::Value;

use super::spec::{Experiment, Table, Variant};

/// The text of every experiment, in the order of `list`.
const EXPERIMENTS: &[&str] = &[include_str!("../../experiments/1.toml")];

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
    if let Some(experiment) = experiments().into_iter().find(|experiment| experiment.name == name_or_file) {
        return Ok(experiment);
    }
    let path = Path::new(name_or_file);
    if !path.exists() {
        let names: Vec<String> = experiments().into_iter().map(|experiment| experiment.name).collect();
        bail!("'{name_or_file}' is neither a file nor one of {}", names.join(", "));
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {name_or_file}"))?;
    Experiment::parse(&text).with_context(|| name_or_file.to_owned())
}

/// The method presets: what the paper calls HM, TM and so on, in settings.
pub fn presets() -> Vec<Variant> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Presets {
        methods: Vec<Variant>,
    }
    toml::from_str::<Presets>(METHODS).expect("a test parses the embedded file").methods
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
        return Ok(Variant { name: name.to_owned(), settings, ..Variant::default() });
    }
    let names: Vec<String> = presets().into_iter().map(|preset| preset.name).collect();
    bail!("'{name}' is no method; there are {}, and the words of the setting `method`", names.join(", "))
}
