//! What spoils a picture between the scene and the service: light, noise and time.
//!
//! Light first, then noise as Matlab's `imnoise(I, 'gaussian', 0, noise_std²)` means it: a fresh `N(0, noise_std²)`
//! on every pixel in [0, 1], clipped to [0, 1] after each of the two.

use std::f64::consts::TAU;
use std::time::Duration;

use domvs_vision::Plane;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// A disturbance of images; the default changes nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disturbance {
    /// Standard deviation of the noise, in gray of [0, 1]: the square root of `imnoise`'s variance.
    pub noise_std: f64,
    /// The light: `gain * I + offset`.
    pub gain: f64,
    /// The light: `gain * I + offset`.
    pub offset: f64,
    /// How much later than its capture a frame leaves; the node keeps it, lock-step simulations have no time.
    pub latency: Duration,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Disturbance {
    fn default() -> Self {
        Disturbance { noise_std: 0.0, gain: 1.0, offset: 0.0, latency: Duration::ZERO, seed: 1 }
    }
}

impl Disturbance {
    /// The same noise under undisturbed light: for a desired image, taken on a better day.
    pub fn without_light(self) -> Disturbance {
        Disturbance { gain: 1.0, offset: 0.0, ..self }
    }

    /// Spoils `image`. The noise is a function of the seed and of `frame` alone, so any frame can be made again.
    pub fn apply(&self, image: &mut Plane<f32>, frame: u64) {
        if self.gain != 1.0 || self.offset != 0.0 {
            let (gain, offset) = (self.gain as f32, self.offset as f32);
            image.samples_mut().iter_mut().for_each(|gray| *gray = (gain * *gray + offset).clamp(0.0, 1.0));
        }
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
fn two_normals(rng: &mut ChaCha8Rng) -> [f64; 2] {
    // 1 - [0, 1) is (0, 1]: its logarithm exists.
    let radius = (-2.0 * (1.0 - rng.r#gen::<f64>()).ln()).sqrt();
    let (sin, cos) = (TAU * rng.r#gen::<f64>()).sin_cos();
    [radius * cos, radius * sin]
}
