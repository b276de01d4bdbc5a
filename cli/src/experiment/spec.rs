//! What an experiment's TOML file holds: methods x scenes x disturbances, and how many displacements of each.
//!
//! ```toml
//! name = "mine"
//! seed = 7                 # of noise, random starts and textures; displacement k has the seed 7 + k
//! images = 60
//! displacements = 20
//! methods = ["HM", "DCT", { name = "HM l=3", settings = { order = 3, window = "adaptive" } }]
//! scenes = ["boxes", "my-world.toml", { name = "far", scene = { named = "object" }, start = { random = { scale = 1.5 } } }]
//! [tolerance]
//! error_mm = 1.0
//! error_deg = 0.1
//! [camera]                 # camera, scene, target, start, disturbance: as a world file has them
//! width = 128
//! [settings]               # a merge patch of task settings
//! order = { min = 4, max = 8 }
//! [[disturbances]]
//! name = "noise 0.2"
//! disturbance = { noise_variance = 0.2 }
//! ```
//!
//! A named method is a starting point: the file's settings go over it, those of a table in the list over both. Scenes are named
//! worlds, world files, or tables. A file without lists is one run. Entries of the three lists are [`Variant`]s: what they name goes over what the file says.
//! `camera` and `disturbance` are merged key by key; `scene`, `target` and `start` replace those of the file.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// A TOML table, read as JSON.
pub type Table = Map<String, Value>;

/// When a run counts as converged, by the simulator's truth at its end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// The camera must be nearer than this, mm.
    pub error_mm: f64,
    /// Its rotation must be smaller than this, degrees.
    pub error_deg: f64,
}

impl Tolerance {
    /// Fails unless both are finite and above 0: nothing would ever converge.
    fn check(&self) -> anyhow::Result<()> {
        for (key, value) in [("error_mm", self.error_mm), ("error_deg", self.error_deg)] {
            anyhow::ensure!(value.is_finite() && value > 0.0, "tolerance.{key} must be above 0, got {value}");
        }
        Ok(())
    }
}

impl Default for Tolerance {
    fn default() -> Tolerance {
        Tolerance { error_mm: 1.0, error_deg: 0.1 }
    }
}

/// One entry of `methods`, `scenes` or `disturbances`: a name, and what it changes.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Variant {
    /// What tables call it.
    pub name: String,
    /// One line about it, for people.
    pub about: String,
    /// Changes of the camera, key by key.
    pub camera: Option<Table>,
    /// Another scene.
    pub scene: Option<Table>,
    /// Another target.
    pub target: Option<Table>,
    /// Another start.
    pub start: Option<Table>,
    /// Changes of the disturbance, key by key.
    pub disturbance: Option<Table>,
    /// Changes of the task settings: a merge patch.
    pub settings: Table,
    /// Another number of images.
    pub images: Option<u32>,
    /// Another tolerance.
    pub tolerance: Option<Tolerance>,
    /// Of the file it was read from.
    #[serde(skip)]
    pub folder: Option<PathBuf>,
    /// A method with a name is a starting point: the file's settings go over it.
    #[serde(skip)]
    pub is_preset: bool,
}

/// An entry as it is written: a name that is known, or a table.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Entry {
    /// Looked up: a method preset or a named scene.
    Named(String),
    /// Written out.
    Inline(Box<Variant>),
}

/// A file of `domvs experiment`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Its name: of the folder, and in every result.
    pub name: String,
    /// One line for `list`.
    #[serde(default)]
    pub about: String,
    /// Of noise, random starts and procedural textures.
    #[serde(default = "one")]
    pub seed: u64,
    /// How long a run is at most.
    #[serde(default = "sixty")]
    pub images: u32,
    /// How many starts of each cell.
    #[serde(default = "one_displacement")]
    pub displacements: u32,
    /// When a run counts as converged.
    #[serde(default)]
    pub tolerance: Tolerance,
    /// As in a world file.
    #[serde(default)]
    pub camera: Option<Table>,
    /// As in a world file.
    #[serde(default)]
    pub scene: Option<Table>,
    /// As in a world file.
    #[serde(default)]
    pub target: Option<Table>,
    /// As in a world file.
    #[serde(default)]
    pub start: Option<Table>,
    /// As in a world file.
    #[serde(default)]
    pub disturbance: Option<Table>,
    /// A merge patch of task settings, for all methods.
    #[serde(default)]
    pub settings: Table,
    /// What is compared; none means the default law.
    #[serde(default)]
    pub methods: Vec<Entry>,
    /// Where; none means the file's own scene.
    #[serde(default)]
    pub scenes: Vec<Entry>,
    /// Under what; none means the file's own disturbance.
    #[serde(default)]
    pub disturbances: Vec<Variant>,
    /// Of the file: where its paths begin.
    #[serde(skip)]
    pub folder: PathBuf,
}

fn one() -> u64 {
    1
}

fn sixty() -> u32 {
    60
}

fn one_displacement() -> u32 {
    1
}

impl Experiment {
    /// Reads a file's text.
    ///
    /// # Errors
    /// Fails, naming line and key, on what is no TOML, unknown, of the wrong kind, or a number that makes no sense.
    pub fn parse(text: &str) -> anyhow::Result<Experiment> {
        let experiment: Experiment = toml::from_str(text)?;
        only_finite(text)?;
        experiment.check()?;
        Ok(experiment)
    }

    fn check(&self) -> anyhow::Result<()> {
        anyhow::ensure!(!self.name.trim().is_empty(), "an experiment needs a name");
        let counts = [("images", self.images), ("displacements", self.displacements)];
        for (what, count) in counts {
            anyhow::ensure!((1..=100_000).contains(&count), "{what} must be 1 to 100000, got {count}");
        }
        let entries = self.methods.iter().chain(&self.scenes).filter_map(|entry| match entry {
            Entry::Named(_) => None,
            Entry::Inline(variant) => Some(&**variant),
        });
        self.tolerance.check()?;
        for variant in entries.chain(&self.disturbances) {
            anyhow::ensure!(!variant.name.trim().is_empty(), "every method, scene and disturbance needs a name");
            if let Some(tolerance) = variant.tolerance {
                tolerance.check()?;
            }
        }
        Ok(())
    }
}

/// TOML has NaN and infinity, settings and worlds have not; read as JSON they would be null, which stands for a default.
///
/// # Errors
/// Fails, naming the key, where a number is not finite; and on what is no TOML.
pub fn only_finite(text: &str) -> anyhow::Result<()> {
    fn check(value: &toml::Value, path: &str) -> anyhow::Result<()> {
        match value {
            toml::Value::Float(number) => {
                anyhow::ensure!(number.is_finite(), "{path} must be a finite number, got {number}");
                Ok(())
            }
            toml::Value::Array(values) => {
                values.iter().enumerate().try_for_each(|(index, value)| check(value, &format!("{path}[{index}]")))
            }
            toml::Value::Table(table) => table.iter().try_for_each(|(key, value)| match path {
                "" => check(value, key),
                _ => check(value, &format!("{path}.{key}")),
            }),
            _ => Ok(()),
        }
    }
    check(&toml::Value::Table(toml::from_str(text)?), "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_with_nothing_but_a_name_is_one_run_of_sixty_images() {
        let experiment = Experiment::parse("name = 'x'").expect("a file");
        assert_eq!((experiment.seed, experiment.images, experiment.displacements), (1, 60, 1));
        assert_eq!(experiment.tolerance, Tolerance { error_mm: 1.0, error_deg: 0.1 });
        assert!(experiment.methods.is_empty() && experiment.scenes.is_empty() && experiment.disturbances.is_empty());
    }

    #[test]
    fn lists_take_names_and_tables() {
        let text = "name = 'x'\nmethods = ['HM', { name = 'three', settings = { order = 3 } }]\nscenes = ['box']";
        let experiment = Experiment::parse(text).expect("a file");
        assert_eq!(experiment.methods[0], Entry::Named("HM".into()));
        let Entry::Inline(three) = &experiment.methods[1] else { panic!("a table") };
        assert_eq!((three.name.as_str(), &three.settings["order"]), ("three", &Value::from(3)));
        assert_eq!(experiment.scenes, [Entry::Named("box".into())]);
    }

    #[test]
    fn what_is_unknown_or_makes_no_sense_is_refused() {
        for bad in [
            "seed = 1",
            "name = ''",
            "name = 'x'\nimages = 0",
            "name = 'x'\nimage = 60",
            "name = 'x'\n[[disturbances]]\nsettings = {}",
            "name = 'x'\nmethods = [{ name = 'y', order = 3 }]",
            "name = 'x'\n[tolerance]\nerror_mm = 'far'\nerror_deg = 1",
        ] {
            assert!(Experiment::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_number_that_is_none_is_refused_with_its_key_instead_of_taken_for_a_default() {
        for (bad, key) in [
            ("[settings]\ngain = nan", "settings.gain"),
            ("[start]\ndisplacement = [0, inf, 0, 0, 0, 0]", "start.displacement[1]"),
            ("[[disturbances]]\nname = 'd'\ndisturbance = { light = [{ gain = nan }] }", "light[0].gain"),
            ("[tolerance]\nerror_mm = -1\nerror_deg = 0.1", "tolerance.error_mm must be above 0, got -1"),
            ("scenes = [{ name = 's', tolerance = { error_mm = 1, error_deg = 0 } }]", "tolerance.error_deg"),
        ] {
            let error = Experiment::parse(&format!("name = 'x'\n{bad}")).expect_err(bad).to_string();
            assert!(error.contains(key), "{error}");
        }
    }
}
