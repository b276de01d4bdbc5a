//! What the depth that the law is told has of the true one.
//!
//! Noise of a depth camera grows with the square of the distance: `N(0, (noise_m z²)²)` with z in m. Holes are blobs: the
//! pixels where smooth noise, new on every image, is among its lowest values, so their share is exact.

use domvs_vision::Plane;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::disturbance::two_normals;

/// Keeps the numbers of depth apart from those of gray.
const DEPTH_SEED: u64 = 0x6465_7074_6820_7a7a;

/// How the told depth differs from the true one; the default is the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthDisturbance {
    /// Standard deviation at 1 m, m.
    pub noise_m: f64,
    /// Share of the pixels without depth.
    pub holes: f64,
    /// About how large a hole is, px.
    pub hole_px: f64,
    /// Of which depth all this is said.
    pub told: ToldDepth,
}

/// Which depth the law is told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ToldDepth {
    /// That of each image.
    #[default]
    Map,
    /// That of the desired image for every image: `Z = Z*`.
    Desired,
    /// One number for every pixel of every image.
    Constant {
        /// How many times the median of the true depth of the desired image.
        factor: f64,
    },
}

impl Default for DepthDisturbance {
    fn default() -> Self {
        DepthDisturbance { noise_m: 0.0, holes: 0.0, hole_px: 6.0, told: ToldDepth::Map }
    }
}

impl DepthDisturbance {
    /// Noise and holes of one picture.
    pub(crate) fn spoil(&self, depth: &mut Plane<f32>, seed: u64, frame: u64) {
        if self.noise_m <= 0.0 && self.holes <= 0.0 {
            return;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ DEPTH_SEED);
        rng.set_stream(frame);
        if self.noise_m > 0.0 {
            for pair in depth.samples_mut().chunks_mut(2) {
                let noise = two_normals(&mut rng);
                for (z, normal) in pair.iter_mut().zip(noise).filter(|(z, _)| **z > 0.0) {
                    *z = (*z + (self.noise_m * normal) as f32 * *z * *z).max(0.0);
                }
            }
        }
        if self.holes > 0.0 {
            self.punch(depth, &mut rng);
        }
    }

    fn punch(&self, depth: &mut Plane<f32>, rng: &mut ChaCha8Rng) {
        let (width, height) = (depth.width(), depth.height());
        let count = ((self.holes * (width * height) as f64).round() as usize).min(width * height);
        if count == 0 {
            return;
        }
        let values = smooth_noise(width, height, self.hole_px.max(1.0) as f32, rng);
        let mut order: Vec<usize> = (0..values.len()).collect();
        // Equal values in the order of their pixels.
        order.select_nth_unstable_by(count - 1, |&a, &b| values[a].total_cmp(&values[b]).then(a.cmp(&b)));
        for &pixel in &order[..count] {
            depth.samples_mut()[pixel] = 0.0;
        }
    }
}

/// Random values on a lattice of `cell_px`, joined by smoothstep.
fn smooth_noise(width: usize, height: usize, cell_px: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let columns = (width as f32 / cell_px) as usize + 2;
    let rows = (height as f32 / cell_px) as usize + 2;
    let mut lattice = Plane::filled(columns, rows, 0.0_f32);
    lattice.samples_mut().fill_with(|| rng.r#gen());
    let place = |pixel: usize| {
        let at = pixel as f32 / cell_px;
        let t = at - at.floor();
        (at as usize, t * t * (3.0 - 2.0 * t))
    };
    let mut values = Vec::with_capacity(width * height);
    for v in 0..height {
        let (j, down) = place(v);
        for u in 0..width {
            let (i, right) = place(u);
            let mix = |row: usize| lattice.at(i, row) + right * (lattice.at(i + 1, row) - lattice.at(i, row));
            values.push(mix(j) + down * (mix(j + 1) - mix(j)));
        }
    }
    values
}

/// The median of what is known, m; none of nothing.
pub(crate) fn median_depth_m(depth: &Plane<f32>) -> Option<f64> {
    let mut known: Vec<f32> = depth.samples().iter().copied().filter(|&z| z > 0.0).collect();
    let middle = known.len() / 2;
    (!known.is_empty()).then(|| f64::from(*known.select_nth_unstable_by(middle, f32::total_cmp).1))
}
