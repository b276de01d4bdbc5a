//! Gray pictures that scenes wear: five bundled photographs, one made of noise, or any file the user names.
//!
//! Gray is in [0, 1] by `0.299 R + 0.587 G + 0.114 B`, unrounded; alpha and orientation tags are ignored.
//! Who took the bundled photographs, and under which licence: `photographs/PHOTOGRAPHS.md`.

use std::path::{Path, PathBuf};

use domvs_vision::Plane;
use image::DynamicImage;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

const NAMES: [&str; 6] = ["astronaut", "coffee", "chelsea", "camera", "brick", NOISE];
const NOISE: &str = "noise";
const NOISE_SIZE: usize = 512;
const NOISE_SEED: u64 = 1;

/// Why there is no photograph.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhotographError {
    /// No bundled photograph has this name.
    #[error("no bundled photograph is called {name:?}, expected one of {NAMES:?}")]
    UnknownName {
        /// The name asked for.
        name: String,
    },
    /// The file cannot be read, or it is neither PNG nor JPEG.
    #[error("cannot open the photograph {}: {source}", path.display())]
    Unreadable {
        /// The file asked for.
        path: PathBuf,
        /// What the decoder said.
        source: image::ImageError,
    },
    /// The bytes are neither PNG nor JPEG.
    #[error("cannot decode the photograph: {source}")]
    Undecodable {
        /// What the decoder said.
        source: image::ImageError,
    },
    /// A picture needs at least 2 pixels each way.
    #[error("a photograph needs at least 2x2 pixels, got {width}x{height}")]
    TooSmall {
        /// Pixels to the right.
        width: usize,
        /// Pixels down.
        height: usize,
    },
}

/// A gray picture in [0, 1], at least 2x2 pixels.
#[derive(Clone, Debug)]
pub struct Photograph {
    gray: Plane<f32>,
}

impl Photograph {
    /// The photographs that [`Photograph::bundled`] knows; the last is `noise`, which is computed.
    pub fn bundled_names() -> &'static [&'static str] {
        &NAMES
    }

    /// A photograph of this crate by its name; fails for a name that is not in [`Photograph::bundled_names`].
    pub fn bundled(name: &str) -> Result<Photograph, PhotographError> {
        let bytes: &[u8] = match name {
            "astronaut" => include_bytes!("../photographs/astronaut.jpg"),
            "coffee" => include_bytes!("../photographs/coffee.jpg"),
            "chelsea" => include_bytes!("../photographs/chelsea.jpg"),
            "camera" => include_bytes!("../photographs/camera.jpg"),
            "brick" => include_bytes!("../photographs/brick.jpg"),
            NOISE => return Ok(Photograph::noise(NOISE_SIZE, NOISE_SEED)),
            _ => {
                return Err(PhotographError::UnknownName { name: name.to_owned() });
            }
        };
        Photograph::decode(bytes)
    }

    /// Any PNG or JPEG file; fails when it cannot be read or decoded, or is smaller than 2x2.
    pub fn open(path: impl AsRef<Path>) -> Result<Photograph, PhotographError> {
        let path = path.as_ref();
        let unreadable = |source| PhotographError::Unreadable { path: path.to_owned(), source };
        let reader = image::ImageReader::open(path)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(|error| unreadable(error.into()))?;
        Photograph::from_gray(gray(&reader.decode().map_err(unreadable)?))
    }

    /// A PNG or JPEG file that is already in memory; fails like [`Photograph::open`].
    pub fn decode(bytes: &[u8]) -> Result<Photograph, PhotographError> {
        let picture = image::load_from_memory(bytes).map_err(|source| PhotographError::Undecodable { source })?;
        Photograph::from_gray(gray(&picture))
    }

    /// A gray picture in [0, 1] as it is; fails when it is smaller than 2x2.
    pub fn from_gray(gray: Plane<f32>) -> Result<Photograph, PhotographError> {
        let (width, height) = (gray.width(), gray.height());
        if width < 2 || height < 2 {
            return Err(PhotographError::TooSmall { width, height });
        }
        Ok(Photograph { gray })
    }

    /// One gray in [0, 1], 2x2.
    pub fn one_gray(gray: f32) -> Photograph {
        Photograph { gray: Plane::filled(2, 2, gray) }
    }

    /// A square texture of smooth noise in seven octaves, at least 2x2: the same seed gives the same picture.
    pub fn noise(size_px: usize, seed: u64) -> Photograph {
        let size_px = size_px.max(2);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut sum = Plane::filled(size_px, size_px, 0.0_f32);
        for octave in 0..7 {
            let cells = 3 << octave;
            // Amplitude falls slower than 1/frequency, as it does in photographs of rough surfaces.
            add_octave(&mut sum, cells, 0.65_f32.powi(octave), &mut rng);
        }
        let (low, high) = sum.samples().iter().fold((f32::MAX, f32::MIN), |(low, high), &s| (low.min(s), high.max(s)));
        let span = (high - low).max(f32::MIN_POSITIVE);
        sum.samples_mut().iter_mut().for_each(|s| *s = (*s - low) / span);
        Photograph { gray: sum }
    }

    /// The largest square about the middle.
    pub fn cropped_square(&self) -> Photograph {
        let size = self.width().min(self.height());
        let (left, top) = ((self.width() - size) / 2, (self.height() - size) / 2);
        Photograph { gray: Plane::from_fn(size, size, |u, v| self.gray.at(left + u, top + v)) }
    }

    /// Pixels to the right.
    pub fn width(&self) -> usize {
        self.gray.width()
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.gray.height()
    }

    /// The picture, gray in [0, 1].
    pub fn gray(&self) -> &Plane<f32> {
        &self.gray
    }
}

fn gray(picture: &DynamicImage) -> Plane<f32> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let rgb = picture.to_rgb32f();
    Plane::from_fn(width, height, |u, v| {
        let [r, g, b] = rgb.get_pixel(u as u32, v as u32).0.map(f64::from);
        (0.299 * r + 0.587 * g + 0.114 * b) as f32
    })
}

/// Adds one lattice of `cells` x `cells` random values, joined by smoothstep.
fn add_octave(sum: &mut Plane<f32>, cells: usize, amplitude: f32, rng: &mut ChaCha8Rng) {
    let mut lattice = Plane::filled(cells + 1, cells + 1, 0.0);
    lattice.samples_mut().fill_with(|| rng.gen_range(-amplitude..amplitude));
    let width = sum.width();
    let place = |pixel: usize| {
        let at = (pixel as f32 + 0.5) * cells as f32 / width as f32;
        let cell = (at as usize).min(cells - 1);
        let t = at - cell as f32;
        (cell, t * t * (3.0 - 2.0 * t))
    };
    for v in 0..sum.height() {
        let (j, t_v) = place(v);
        for u in 0..width {
            let (i, t_u) = place(u);
            let top = lattice.at(i, j) + t_u * (lattice.at(i + 1, j) - lattice.at(i, j));
            let bottom = lattice.at(i, j + 1) + t_u * (lattice.at(i + 1, j + 1) - lattice.at(i, j + 1));
            sum.samples_mut()[v * width + u] += top + t_v * (bottom - top);
        }
    }
}
