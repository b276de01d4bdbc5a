//! From a file to the runs it asks for, in their order: scenes, disturbances, displacements, methods.
//!
//! Displacement `k` of a cell has the seed `seed + k`, whatever the method and the disturbance: methods are compared on the
//! same starts and the same noise. So `run FILE --seed S` shows one of them again.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::{Value, json};

use super::named;
use super::spec::{self, Entry, Experiment, Table, Tolerance, Variant};

/// What a run is counted under.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CellName {
    /// The scene's name.
    pub scene: String,
    /// The disturbance's name; empty where the file has none.
    pub disturbance: String,
    /// The method's name.
    pub method: String,
}

impl std::fmt::Display for CellName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let CellName { scene, disturbance, method } = self;
        match disturbance.as_str() {
            "" => write!(f, "{scene}, {method}"),
            _ => write!(f, "{scene}, {disturbance}, {method}"),
        }
    }
}

/// One run, with nothing left to look up.
#[derive(Clone, Debug, PartialEq)]
pub struct RunPlan {
    /// The file's name.
    pub experiment: String,
    /// What it is counted under.
    pub cell: CellName,
    /// Of everything random in it.
    pub seed: u64,
    /// How long it is at most.
    pub images: u32,
    /// When it counts as converged.
    pub tolerance: Tolerance,
    /// `camera`, `scene`, `target`, `start`, `disturbance`.
    pub world: Table,
    /// Patches of the task settings, one after another.
    pub settings: Vec<Table>,
    /// Where the paths of the world begin.
    pub folder: PathBuf,
    /// What the files hold that the world names, as one number; 0 where it names none.
    pub files: u64,
}

/// What the command line says over the file.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Only these methods: of the file's list, or presets.
    pub methods: Vec<String>,
    /// The step fraction.
    pub gain: Option<f64>,
    /// Images of a run.
    pub images: Option<u32>,
    /// Width and height, pixels.
    pub size: Option<[usize; 2]>,
    /// The first seed.
    pub seed: Option<u64>,
    /// Starts of each cell.
    pub displacements: Option<u32>,
}

/// What every run starts from: no limits, half a step per image. It stops at a hundredth of a millimetre, so that
/// no run is cut off where the comparison begins.
fn base_settings() -> Table {
    let settings = json!({
        "limits": "none",
        "gain": { "step_fraction": 0.5 },
        "stop": { "step_m": 1e-5, "step_rad": 1e-5, "hold_frames": 5 },
    });
    let Value::Object(settings) = settings else { unreachable!("an object was written") };
    settings
}

impl Experiment {
    /// The runs of this file.
    ///
    /// # Errors
    /// Fails on a method that nobody knows, on a name that is there twice, and when a world file cannot be read.
    pub fn plan(&self, over: &Overrides) -> anyhow::Result<Vec<RunPlan>> {
        let methods = self.methods_of(&over.methods)?;
        let scenes = self.scene_variants()?;
        let calm = [Variant::default()];
        let disturbances = if self.disturbances.is_empty() { &calm } else { self.disturbances.as_slice() };
        for (what, variants) in [("methods", &methods[..]), ("scenes", &scenes), ("disturbances", disturbances)] {
            let mut names = HashSet::new();
            let twice = variants.iter().find(|variant| !names.insert(&variant.name));
            // They would be counted as one cell.
            anyhow::ensure!(
                twice.is_none(),
                "two {what} are called '{}': each needs a name of its own",
                twice.map_or("", |variant| &variant.name)
            );
        }
        let first_seed = over.seed.unwrap_or(self.seed);
        let count = over.displacements.unwrap_or(self.displacements);
        let mut files = Files::default();
        let mut runs = Vec::new();
        for scene in &scenes {
            for disturbance in disturbances {
                for displacement in 0..u64::from(count) {
                    for method in &methods {
                        let seed = first_seed.wrapping_add(displacement);
                        let mut run = self.run(scene, disturbance, method, seed, over);
                        run.files = files.of(&run.folder, &run.world);
                        runs.push(run);
                    }
                }
            }
        }
        Ok(runs)
    }

    /// The names of its methods.
    ///
    /// # Errors
    /// Fails on a method that nobody knows.
    pub fn method_names(&self) -> anyhow::Result<Vec<String>> {
        Ok(self.methods_of(&[])?.into_iter().map(|method| method.name).collect())
    }

    fn methods_of(&self, only: &[String]) -> anyhow::Result<Vec<Variant>> {
        let resolve = |entry: &Entry| match entry {
            Entry::Named(name) => named::method(name),
            Entry::Inline(variant) => Ok((**variant).clone()),
        };
        let own = self.methods.iter().map(resolve).collect::<anyhow::Result<Vec<_>>>()?;
        let chosen = |name: &String| {
            let known = own.iter().find(|method| method.name.eq_ignore_ascii_case(name));
            known.cloned().map_or_else(|| named::method(name), Ok)
        };
        match (only.is_empty(), own.is_empty()) {
            (false, _) => only.iter().map(chosen).collect(),
            (true, false) => Ok(own),
            (true, true) => Ok(vec![named::method("default")?]),
        }
    }

    fn scene_variants(&self) -> anyhow::Result<Vec<Variant>> {
        let resolve = |entry: &Entry| match entry {
            Entry::Named(name) if name.ends_with(".toml") => self.world_file(name),
            Entry::Named(name) => {
                let scene = Table::from_iter([("named".to_owned(), Value::from(name.as_str()))]);
                Ok(Variant { name: name.clone(), scene: Some(scene), ..Variant::default() })
            }
            Entry::Inline(variant) => Ok((**variant).clone()),
        };
        if self.scenes.is_empty() {
            let named = self.scene.as_ref().and_then(|scene| scene.get("named")).and_then(Value::as_str);
            return Ok(vec![Variant { name: named.unwrap_or(&self.name).to_owned(), ..Variant::default() }]);
        }
        self.scenes.iter().map(resolve).collect()
    }

    /// A world file as a scene.
    fn world_file(&self, name: &str) -> anyhow::Result<Variant> {
        let path = self.folder.join(name);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let mut table: Table = toml::from_str(&text).with_context(|| name.to_owned())?;
        spec::only_finite(&text).with_context(|| name.to_owned())?;
        // Every displacement has a seed of its own here.
        table.remove("seed");
        let mut world: Variant = serde_json::from_value(Value::Object(table)).with_context(|| name.to_owned())?;
        if world.name.is_empty() {
            world.name = path.file_stem().map_or_else(|| name.to_owned(), |stem| stem.to_string_lossy().into_owned());
        }
        world.folder = path.parent().map(Path::to_owned);
        Ok(world)
    }

    fn run(&self, scene: &Variant, disturbance: &Variant, method: &Variant, seed: u64, over: &Overrides) -> RunPlan {
        let variants = [scene, method, disturbance];
        let mut world = Table::new();
        let own = [
            ("camera", &self.camera),
            ("scene", &self.scene),
            ("target", &self.target),
            ("start", &self.start),
            ("disturbance", &self.disturbance),
        ];
        for (key, table) in own {
            world.extend(table.clone().map(|table| (key.to_owned(), Value::Object(table))));
        }
        for variant in variants {
            lay_over(&mut world, variant);
        }
        if let Some([width, height]) = over.size {
            let size = Table::from_iter([("width".to_owned(), width.into()), ("height".to_owned(), height.into())]);
            merge_keys(&mut world, "camera", &size);
        }
        let mut settings = vec![base_settings()];
        match method.is_preset {
            true => settings.extend([method, scene, disturbance].map(|variant| variant.settings.clone())),
            false => settings.extend([scene, method, disturbance].map(|variant| variant.settings.clone())),
        }
        settings.insert(if method.is_preset { 2 } else { 1 }, self.settings.clone());
        if let Some(gain) = over.gain {
            let gain = json!({ "step_fraction": gain });
            settings.push(Table::from_iter([("gain".to_owned(), gain)]));
        }
        settings.retain(|layer| !layer.is_empty());
        let images = variants.into_iter().filter_map(|variant| variant.images).next_back().unwrap_or(self.images);
        let tolerance = variants.into_iter().filter_map(|variant| variant.tolerance).next_back();
        RunPlan {
            experiment: self.name.clone(),
            cell: CellName {
                scene: scene.name.clone(),
                disturbance: disturbance.name.clone(),
                method: method.name.clone(),
            },
            seed,
            images: over.images.unwrap_or(images),
            tolerance: tolerance.unwrap_or(self.tolerance),
            world,
            settings,
            folder: scene.folder.clone().unwrap_or_else(|| self.folder.clone()),
            files: 0,
        }
    }
}

/// Puts what a variant says of the world over what is there.
fn lay_over(world: &mut Table, variant: &Variant) {
    for (key, table) in [("scene", &variant.scene), ("target", &variant.target), ("start", &variant.start)] {
        world.extend(table.clone().map(|table| (key.to_owned(), Value::Object(table))));
    }
    for (key, table) in [("camera", &variant.camera), ("disturbance", &variant.disturbance)] {
        if let Some(table) = table {
            merge_keys(world, key, table);
        }
    }
}

fn merge_keys(world: &mut Table, key: &str, table: &Table) {
    match world.get_mut(key) {
        Some(Value::Object(there)) => there.extend(table.clone()),
        _ => {
            world.insert(key.to_owned(), Value::Object(table.clone()));
        }
    }
}

impl RunPlan {
    /// 16 hexadecimal digits that change with anything that could change the result: the plan, the files it names (not what
    /// a mesh names in turn), and the program's version.
    pub fn key(&self) -> String {
        let CellName { scene, disturbance, method } = &self.cell;
        let mut plan = json!([
            env!("CARGO_PKG_VERSION"),
            self.experiment,
            [scene, disturbance, method],
            self.seed,
            self.images,
            self.tolerance,
            self.world,
            self.settings,
        ]);
        if let (Value::Array(parts), true) = (&mut plan, self.files != 0) {
            parts.push(self.files.into());
        }
        format!("{:016x}", fnv1a(plan.to_string().as_bytes()))
    }
}

/// Hashes of files, each read once.
#[derive(Default)]
struct Files {
    known: HashMap<PathBuf, u64>,
}

impl Files {
    /// One number for what all files hold that `world` names from `folder`; 0 without any. What cannot be read counts as
    /// nothing here: the run will say so.
    fn of(&mut self, folder: &Path, world: &Table) -> u64 {
        let mut names = Vec::new();
        world.values().for_each(|value| file_names(value, &mut names));
        names.into_iter().fold(0, |all, name| {
            let hash = |path: &PathBuf| std::fs::read(path).map_or(0, |bytes| fnv1a(&bytes));
            let path = folder.join(name);
            let one = *self.known.entry(path).or_insert_with_key(hash);
            fnv1a(&[all.to_le_bytes(), one.to_le_bytes()].concat())
        })
    }
}

/// The texts with an extension: names without are those of bundled photographs and worlds.
fn file_names<'a>(value: &'a Value, names: &mut Vec<&'a str>) {
    match value {
        Value::String(text) if Path::new(text).extension().is_some() => names.push(text),
        Value::Array(values) => values.iter().for_each(|value| file_names(value, names)),
        Value::Object(table) => table.values().for_each(|value| file_names(value, names)),
        _ => {}
    }
}

/// The 64-bit hash FNV-1a, <http://www.isthe.com/chongo/tech/comp/fnv/>: the same with every compiler, which files outlive.
fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_BY_TWO: &str = r#"
        name = "grid"
        seed = 100
        displacements = 3
        methods = ["HM", { name = "three", settings = { order = 3 } }]
        scenes = ["coffee", { name = "far", start = { random = { scale = 1.5 } }, images = 40 }]
        [camera]
        width = 64
        [start]
        displacement = [0, 0, 0, 0, 0, 0]
        [disturbance]
        noise_variance = 0.1
        [[disturbances]]
        name = "dark"
        disturbance = { gain = 0.7 }
        tolerance = { error_mm = 100, error_deg = 6 }
    "#;

    fn plan(over: &Overrides) -> Vec<RunPlan> {
        Experiment::parse(TWO_BY_TWO).expect("a file").plan(over).expect("known names")
    }

    #[test]
    fn every_combination_has_its_runs_and_methods_share_their_seeds() {
        let runs = plan(&Overrides::default());
        assert_eq!(runs.len(), 2 * 2 * 3);
        let seeds = |method: &str| -> Vec<u64> {
            runs.iter().filter(|run| run.cell.method == method && run.cell.scene == "far").map(|run| run.seed).collect()
        };
        assert_eq!(seeds("HM"), [100, 101, 102]);
        assert_eq!(seeds("HM"), seeds("three"));
    }

    #[test]
    fn a_variant_replaces_the_start_and_adds_to_the_disturbance() {
        let runs = plan(&Overrides::default());
        let far = runs.iter().find(|run| run.cell.scene == "far").expect("far");
        assert_eq!(far.world["start"], json!({ "random": { "scale": 1.5 } }));
        assert_eq!(far.world["disturbance"], json!({ "noise_variance": 0.1, "gain": 0.7 }));
        assert_eq!((far.images, far.tolerance.error_mm), (40, 100.0));
        assert_eq!(runs[0].world["scene"], json!({ "named": "coffee" }));
        assert_eq!(runs[0].images, 60);
    }

    #[test]
    fn the_command_line_has_the_last_word() {
        let over = Overrides {
            methods: vec!["three".into(), "tm".into()],
            gain: Some(0.2),
            images: Some(5),
            size: Some([32, 24]),
            seed: Some(7),
            displacements: Some(1),
        };
        let runs = plan(&over);
        assert_eq!(runs.iter().map(|run| run.cell.method.as_str()).collect::<Vec<_>>(), ["three", "TM", "three", "TM"]);
        assert!(runs.iter().all(|run| run.images == 5 && run.seed == 7));
        assert_eq!(runs[0].world["camera"], json!({ "width": 32, "height": 24 }));
        assert_eq!(runs[0].settings.last().expect("layers")["gain"], json!({ "step_fraction": 0.2 }));
    }

    #[test]
    fn the_files_settings_go_over_a_named_method_and_under_a_table() {
        let text = "name = 'x'\nmethods = ['HM', { name = 'own', settings = { order = 3 } }]\nsettings = { order = 9 }";
        let runs = Experiment::parse(text).expect("a file").plan(&Overrides::default()).expect("a plan");
        let orders = |run: &RunPlan| -> Vec<Value> {
            run.settings.iter().filter_map(|layer| layer.get("order").cloned()).collect()
        };
        assert_eq!(orders(&runs[0]), [json!({ "min": 4, "max": 8 }), json!(9)]);
        assert_eq!(orders(&runs[1]), [json!(9), json!(3)]);
    }

    #[test]
    fn the_key_changes_with_whatever_changes_the_result() {
        let run = plan(&Overrides::default()).remove(0);
        let mut other = run.clone();
        assert_eq!(run.key(), other.key());
        other.seed += 1;
        assert_ne!(run.key(), other.key());
        let mut other = run.clone();
        other.settings.push(Table::from_iter([("order".to_owned(), Value::from(5))]));
        assert_ne!(run.key(), other.key());
    }

    #[test]
    fn a_name_that_is_there_twice_is_refused() {
        let tables = "[{ name = 'A', settings = { order = 5 } }, { name = 'A', settings = { order = 9 } }]";
        for lists in [format!("methods = {tables}"), "methods = ['HM', 'hm']".into(), "scenes = ['box', 'box']".into()]
        {
            let experiment = Experiment::parse(&format!("name = 'x'\n{lists}")).expect("a file");
            let error = experiment.plan(&Overrides::default()).expect_err("twice").to_string();
            assert!(error.contains("are called"), "{error}");
        }
    }

    #[test]
    fn the_key_changes_with_what_is_in_a_texture() {
        let folder = tempfile::tempdir().expect("a folder");
        let text = "name = 'x'\n[scene]\nobjects = [{ shape = 'plane', size_m = [1, 1], texture = 'a.png' }]";
        let key = |bytes: &[u8]| {
            std::fs::write(folder.path().join("a.png"), bytes).expect("a file");
            let mut experiment = Experiment::parse(text).expect("a file");
            experiment.folder = folder.path().to_owned();
            experiment.plan(&Overrides::default()).expect("a plan")[0].key()
        };
        assert_ne!(key(b"one"), key(b"two"));
        assert_eq!(key(b"one"), key(b"one"));
        assert_eq!(plan(&Overrides::default())[0].files, 0, "bundled photographs are no files");
    }

    /// The published test vectors of FNV-1a, 64 bit.
    #[test]
    fn the_hash_is_the_published_one() {
        assert_eq!(fnv1a(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a(b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a(b"foobar"), 0x8594_4171_f739_67e8);
    }
}
