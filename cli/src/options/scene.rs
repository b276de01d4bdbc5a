//! What a simulated camera looks at, from where, and what spoils its images: alike for `demo` and `sim camera`.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use anyhow::Context;
use clap::Args;
use domvs_proto::keys::Name;
use domvs_simulators::motion::EXPERIMENT_1;
use domvs_simulators::spec::named_worlds;
use domvs_simulators::{CameraSettings, Disturbance, Photograph, World, WorldSpec};

use super::numbers;

/// The scene, the start and the disturbances.
#[derive(Args, Clone, Debug)]
pub struct SceneOptions {
    /// A photograph: a PNG or JPEG file, or one that is bundled: astronaut, coffee, chelsea, camera, brick, noise
    #[arg(long, value_name = "FILE", default_value = "astronaut")]
    pub texture: String,

    /// A world instead, with its camera, start and disturbances: a TOML file as in docs/worlds.md, or one that is bundled:
    /// object, plane, boxes
    #[arg(
        long,
        value_name = "NAME|FILE",
        conflicts_with_all = ["texture", "size", "displacement", "noise", "light_change"]
    )]
    pub world: Option<String>,

    /// Size of the images, pixels
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    pub size: SizeOption,

    /// Where the camera starts, as seen from the desired pose: m,m,m,deg,deg,deg, the se(3) log coordinates of
    /// T_desired⁻¹ T_initial [default: the paper's experiment #1]
    #[arg(long, value_name = "X,Y,Z,RX,RY,RZ", default_value_t, allow_hyphen_values = true, hide_default_value = true)]
    pub displacement: DisplacementOption,

    /// Standard deviation of the noise in every image, gray in [0, 1]
    #[arg(long, value_name = "STD", default_value_t = 0.0)]
    pub noise: f64,

    /// Another light than in the desired image: every image becomes GAIN · I + OFFSET
    #[arg(long, value_name = "GAIN,OFFSET", default_value_t, allow_hyphen_values = true)]
    pub light_change: LightChangeOption,

    /// Seed of the noise; in a world with random starts, which of them
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
}

impl SceneOptions {
    /// The camera these options describe: that of the world, or one before the photograph cropped square, 0.7 m wide, 1 m away, 60°
    /// field of view.
    ///
    /// # Errors
    /// Fails, naming the file, when the photograph or the world cannot be read.
    pub fn camera(&self, name: Name) -> anyhow::Result<CameraSettings> {
        if let Some(world) = &self.world {
            return Ok(CameraSettings::of_world(name, &open_world(world)?, self.seed));
        }
        let photograph = photograph(&self.texture)?.cropped_square();
        Ok(CameraSettings {
            width: self.size.width,
            height: self.size.height,
            displacement: self.displacement.0,
            disturbance: Disturbance {
                noise_std: self.noise,
                gain: self.light_change.gain,
                offset: self.light_change.offset,
                seed: self.seed,
                ..Disturbance::default()
            },
            ..CameraSettings::new(name, photograph)
        })
    }
}

/// A bundled name is one unless a file of that name lies here.
fn photograph(texture: &str) -> anyhow::Result<Photograph> {
    if Photograph::bundled_names().contains(&texture) && !Path::new(texture).exists() {
        return Ok(Photograph::bundled(texture)?);
    }
    Photograph::open(texture).with_context(|| {
        format!("--texture takes a PNG or JPEG file, or one of {}", Photograph::bundled_names().join(", "))
    })
}

/// A bundled name is one unless a file of that name lies here.
fn open_world(world: &str) -> anyhow::Result<World> {
    let path = Path::new(world);
    let built = match named_worlds().contains(&world) && !path.exists() {
        true => WorldSpec::named(world).and_then(|spec| spec.build(Path::new("."))),
        false => {
            let folder = path.parent().unwrap_or(Path::new("."));
            WorldSpec::open(path).and_then(|spec| spec.build(folder))
        }
    };
    built.with_context(|| format!("--world {world}: expected a TOML file, or one of {}", named_worlds().join(", ")))
}

/// `--size WxH`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SizeOption {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl FromStr for SizeOption {
    type Err = String;

    fn from_str(text: &str) -> Result<SizeOption, String> {
        let expected = || format!("expected WIDTHxHEIGHT in pixels, 8x8 to 4096x4096, got '{text}'");
        let (width, height) = text.split_once(['x', 'X', '×']).ok_or_else(expected)?;
        let side = |text: &str| text.trim().parse().ok().filter(|side| (8..=4096).contains(side)).ok_or_else(expected);
        Ok(SizeOption { width: side(width)?, height: side(height)? })
    }
}

impl fmt::Display for SizeOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// `--displacement X,Y,Z,RX,RY,RZ`: metres and degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplacementOption(pub [f64; 6]);

impl Default for DisplacementOption {
    fn default() -> DisplacementOption {
        DisplacementOption(EXPERIMENT_1)
    }
}

impl FromStr for DisplacementOption {
    type Err = String;

    fn from_str(text: &str) -> Result<DisplacementOption, String> {
        numbers(text)
            .and_then(|numbers| <[f64; 6]>::try_from(numbers).ok())
            .map(DisplacementOption)
            .ok_or_else(|| format!("expected six numbers, metres then degrees, with commas, got '{text}'"))
    }
}

impl fmt::Display for DisplacementOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.map(|number| number.to_string()).join(","))
    }
}

/// `--light-change GAIN,OFFSET`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightChangeOption {
    /// Factor of the gray values.
    pub gain: f64,
    /// Added to the gray values, of [0, 1].
    pub offset: f64,
}

impl Default for LightChangeOption {
    fn default() -> LightChangeOption {
        LightChangeOption { gain: 1.0, offset: 0.0 }
    }
}

impl FromStr for LightChangeOption {
    type Err = String;

    fn from_str(text: &str) -> Result<LightChangeOption, String> {
        match numbers(text).as_deref() {
            Some(&[gain]) => Ok(LightChangeOption { gain, offset: 0.0 }),
            Some(&[gain, offset]) => Ok(LightChangeOption { gain, offset }),
            _ => Err(format!("expected GAIN or GAIN,OFFSET, got '{text}'")),
        }
    }
}

impl fmt::Display for LightChangeOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}", self.gain, self.offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_world_is_bundled_or_a_file_and_brings_its_own_camera() {
        let bundled = open_world("boxes").expect("a bundled world");
        assert_eq!((bundled.name.as_str(), bundled.camera.width), ("boxes", 128));
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("small.toml");
        std::fs::write(&path, "[camera]\nwidth = 64\n").expect("a file");
        let world = open_world(path.to_str().expect("text")).expect("a world file");
        assert_eq!((world.camera.width, world.camera.height), (64, 128));
        let error = format!("{:#}", open_world("nowhere").expect_err("no such world"));
        assert!(error.contains("nowhere") && error.contains("boxes"), "{error}");
    }

    #[test]
    fn sizes_displacements_and_lights_parse_as_they_are_shown() {
        for size in ["512x512", "640x480"] {
            assert_eq!(size.parse::<SizeOption>().expect("a size").to_string(), size);
        }
        for bad in ["512", "0x8", "5000x5000", "axb", "-8x8"] {
            assert!(bad.parse::<SizeOption>().is_err(), "'{bad}'");
        }
        let first = DisplacementOption::default();
        assert_eq!(first.to_string().parse(), Ok(first));
        assert!("1,2,3".parse::<DisplacementOption>().is_err());
        assert_eq!("0.7".parse(), Ok(LightChangeOption { gain: 0.7, offset: 0.0 }));
        assert_eq!("0.6,-0.1".parse(), Ok(LightChangeOption { gain: 0.6, offset: -0.1 }));
    }
}
