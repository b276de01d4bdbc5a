//! What spoils a picture between the scene and the service: occluders, light, noise, depth and time.
//!
//! In this order: an occluder stands in front of the scene, the light falls on both, the sensor adds noise as Matlab's
//! `imnoise(I, 'gaussian', 0, noise_std²)` means it: a fresh `N(0, noise_std²)` on every pixel in [0, 1]. Gray is clipped
//! to [0, 1] after the light and after the noise. Neither occluders nor light touch the desired image.

use std::f64::consts::TAU;
use std::time::Duration;

use domvs_vision::Plane;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::depth_disturbance::DepthDisturbance;
use crate::light::Light;
use crate::occluder::Occluder;

/// A disturbance of images; the default changes nothing.
#[derive(Clone, Debug)]
pub struct Disturbance {
    /// Standard deviation of the noise, in gray of [0, 1]: the square root of `imnoise`'s variance.
    pub noise_std: f64,
    /// Whether the desired image is noisy too.
    pub noise_on_desired: bool,
    /// The light from the first image on: `gain * I + offset`.
    pub gain: f64,
    /// The light from the first image on: `gain * I + offset`.
    pub offset: f64,
    /// Lights that replace it, each from its image on until the next; in rising order of `from_image`.
    pub lights: Vec<Light>,
    /// What stands between the camera and the scene; the last is in front.
    pub occluders: Vec<Occluder>,
    /// What the depth that is told has of the true one.
    pub depth: DepthDisturbance,
    /// How much later than its capture a frame leaves; the node keeps it, lock-step simulations have no time.
    pub latency: Duration,
    /// Seed of the noise, of gray and of depth.
    pub seed: u64,
}

impl Default for Disturbance {
    fn default() -> Self {
        Disturbance {
            noise_std: 0.0,
            noise_on_desired: true,
            gain: 1.0,
            offset: 0.0,
            lights: vec![],
            occluders: vec![],
            depth: DepthDisturbance::default(),
            latency: Duration::ZERO,
            seed: 1,
        }
    }
}

/// Which picture of a run is spoilt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shot {
    /// The desired one, taken on a better day.
    Desired,
    /// One from where the camera is.
    Current {
        /// Its number, from 0.
        image: u64,
    },
}

impl Disturbance {
    /// Spoils a picture. The noise is a function of the seed and of `frame` alone, so any picture can be made again.
    pub fn apply_to_gray(&self, picture: &mut Plane<f32>, shot: Shot, frame: u64) {
        if let Shot::Current { image } = shot {
            for occluder in &self.occluders {
                occluder.cover(picture, image);
            }
            self.light(image).shine(picture);
        }
        if self.noise_on_desired || shot != Shot::Desired {
            self.add_noise(picture, frame);
        }
    }

    /// Spoils a measured depth, m, in the same way.
    pub fn apply_to_depth(&self, depth: &mut Plane<f32>, frame: u64) {
        self.depth.spoil(depth, self.seed, frame);
    }

    /// The light in force on the image of this number.
    pub fn light(&self, image: u64) -> Light {
        let switched = self.lights.iter().rev().find(|light| light.from_image <= image);
        switched.cloned().unwrap_or(Light { gain: self.gain, offset: self.offset, ..Light::default() })
    }

    fn add_noise(&self, image: &mut Plane<f32>, frame: u64) {
        if self.noise_std > 0.0 {
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            rng.set_stream(frame);
            for pair in image.samples_mut().chunks_mut(2) {
                let noise = two_normals(&mut rng);
                for (gray, normal) in pair.iter_mut().zip(noise) {
                    *gray = (*gray + (self.noise_std * normal) as f32).clamp(0.0, 1.0);
                }
            }
        }
    }
}

/// Two independent `N(0, 1)`, by Box and Muller.
pub(crate) fn two_normals(rng: &mut ChaCha8Rng) -> [f64; 2] {
    // 1 - [0, 1) is (0, 1]: its logarithm exists.
    let radius = (-2.0 * (1.0 - rng.r#gen::<f64>()).ln()).sqrt();
    let (sin, cos) = (TAU * rng.r#gen::<f64>()).sin_cos();
    [radius * cos, radius * sin]
}
