//! What spoils the images, as it is written.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::{SpecError, check, finite};
use super::{is_none, texture};
use crate::depth_disturbance::{DepthDisturbance, ToldDepth};
use crate::disturbance::Disturbance;
use crate::light::{Light, Slope, Spot};
use crate::occluder::Occluder;

/// What spoils the images; the default changes nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DisturbanceSpec {
    /// Variance of the noise on gray in [0, 1], as of `imnoise`.
    pub noise_variance: f64,
    /// Whether the desired image is noisy too.
    pub noise_on_desired: bool,
    /// Depth as the law is told it.
    pub depth: DepthSpec,
    /// Lights, each from its image on until the next.
    pub light: Vec<LightSpec>,
    /// Squares in front of the scene.
    pub occluders: Vec<OccluderSpec>,
}

/// A light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightSpec {
    /// The first image it falls on, from 0.
    pub from_image: u64,
    /// Factor of the gray.
    pub gain: f64,
    /// Added to the gray of [0, 1].
    pub offset: f64,
    /// A factor that goes from the first to the second number across the image.
    #[serde(skip_serializing_if = "is_none")]
    pub slope: Option<[f64; 2]>,
    /// In which direction: 0 along u, 90 along v, deg.
    pub slope_angle_deg: f64,
    /// A lamp.
    #[serde(skip_serializing_if = "is_none")]
    pub spot: Option<SpotSpec>,
}

/// A lamp that lights one place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SpotSpec {
    /// Its centre, in parts of width and height.
    pub center: [f64; 2],
    /// Its standard deviation, in parts of the width.
    pub radius: f64,
    /// By what part the gray at its centre grows.
    pub brightness: f64,
}

/// A square in front of the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OccluderSpec {
    /// Its area as a share of the image's.
    pub share: f64,
    /// What is on it: a bundled photograph, `noise`, or a file.
    pub texture: String,
    /// Seed of `noise`.
    pub texture_seed: u64,
    /// The first image it hides a part of, from 0.
    pub from_image: u64,
    /// Its centre in that image, in parts of width and height.
    pub center: [f64; 2],
    /// How far it moves from image to image, px.
    pub speed_px: [f64; 2],
}

/// Depth as the law is told it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthSpec {
    /// Standard deviation at 1 m, growing with the square of the distance, m.
    pub noise_m: f64,
    /// Share of the pixels without depth.
    pub holes: f64,
    /// About how large a hole is, px.
    pub hole_px: f64,
    /// Which depth is told.
    pub told: ToldSpec,
    /// A constant's factor of the median of the true depth of the desired image.
    pub factor: f64,
}

/// Which depth is told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToldSpec {
    /// That of each image.
    #[default]
    Map,
    /// That of the desired image for every image.
    Desired,
    /// One number.
    Constant,
}

impl Default for DisturbanceSpec {
    fn default() -> Self {
        DisturbanceSpec {
            noise_variance: 0.0,
            noise_on_desired: true,
            depth: DepthSpec::default(),
            light: vec![],
            occluders: vec![],
        }
    }
}

impl Default for LightSpec {
    fn default() -> Self {
        LightSpec { from_image: 0, gain: 1.0, offset: 0.0, slope: None, slope_angle_deg: 0.0, spot: None }
    }
}

impl Default for SpotSpec {
    fn default() -> Self {
        SpotSpec { center: [0.5; 2], radius: 0.2, brightness: 0.5 }
    }
}

impl Default for OccluderSpec {
    fn default() -> Self {
        OccluderSpec {
            share: 0.1,
            texture: "brick".to_owned(),
            texture_seed: 1,
            from_image: 0,
            center: [0.5; 2],
            speed_px: [0.0; 2],
        }
    }
}

impl Default for DepthSpec {
    fn default() -> Self {
        let DepthDisturbance { noise_m, holes, hole_px, .. } = DepthDisturbance::default();
        DepthSpec { noise_m, holes, hole_px, told: ToldSpec::Map, factor: 1.0 }
    }
}

impl DisturbanceSpec {
    /// The disturbance with its seed; `folder` is where relative paths begin. Fails when a number is out of its range or a
    /// file cannot be read.
    pub fn build(&self, folder: &Path, seed: u64) -> Result<Disturbance, SpecError> {
        check("disturbance.noise_variance", self.noise_variance, 0.0, 10.0)?;
        let mut lights = self.light.iter().map(LightSpec::build).collect::<Result<Vec<Light>, _>>()?;
        lights.sort_by_key(|light| light.from_image);
        Ok(Disturbance {
            noise_std: self.noise_variance.sqrt(),
            noise_on_desired: self.noise_on_desired,
            lights,
            occluders: self.occluders.iter().map(|occluder| occluder.build(folder)).collect::<Result<_, _>>()?,
            depth: self.depth.build()?,
            seed,
            ..Disturbance::default()
        })
    }
}

impl LightSpec {
    fn build(&self) -> Result<Light, SpecError> {
        check("disturbance.light.gain", self.gain, 0.0, 10.0)?;
        check("disturbance.light.offset", self.offset, -1.0, 1.0)?;
        finite("disturbance.light.slope_angle_deg", &[self.slope_angle_deg])?;
        if let Some(slope) = self.slope {
            slope.iter().try_for_each(|&factor| check("disturbance.light.slope", factor, 0.0, 10.0))?;
        }
        if let Some(spot) = self.spot {
            finite("disturbance.light.spot.center", &spot.center)?;
            check("disturbance.light.spot.radius", spot.radius, 0.001, 10.0)?;
            check("disturbance.light.spot.brightness", spot.brightness, -1.0, 10.0)?;
        }
        let slope = self.slope.map(|[from, to]| Slope { from, to, angle_deg: self.slope_angle_deg });
        let spot = self.spot.map(|SpotSpec { center, radius, brightness }| Spot { center, radius, brightness });
        Ok(Light { from_image: self.from_image, gain: self.gain, offset: self.offset, slope, spot })
    }
}

impl OccluderSpec {
    fn build(&self, folder: &Path) -> Result<Occluder, SpecError> {
        check("disturbance.occluders.share", self.share, 0.0, 1.0)?;
        finite("disturbance.occluders.center", &self.center)?;
        finite("disturbance.occluders.speed_px", &self.speed_px)?;
        let key = "disturbance.occluders.texture";
        let photograph = texture::photograph(key, &self.texture, self.texture_seed, folder)?;
        let mut occluder = Occluder::new(&photograph, self.share);
        (occluder.from_image, occluder.center, occluder.speed_px) = (self.from_image, self.center, self.speed_px);
        Ok(occluder)
    }
}

impl DepthSpec {
    fn build(&self) -> Result<DepthDisturbance, SpecError> {
        check("disturbance.depth.noise_m", self.noise_m, 0.0, 10.0)?;
        check("disturbance.depth.holes", self.holes, 0.0, 1.0)?;
        check("disturbance.depth.hole_px", self.hole_px, 1.0, 4096.0)?;
        check("disturbance.depth.factor", self.factor, 0.01, 100.0)?;
        let told = match self.told {
            ToldSpec::Map => ToldDepth::Map,
            ToldSpec::Desired => ToldDepth::Desired,
            ToldSpec::Constant => ToldDepth::Constant { factor: self.factor },
        };
        Ok(DepthDisturbance { noise_m: self.noise_m, holes: self.holes, hole_px: self.hole_px, told })
    }
}
