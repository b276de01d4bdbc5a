//! What a mesh wears: a photograph once over the whole of it, or again and again, or one gray.

use std::sync::Arc;

use domvs_vision::Plane;

use crate::photograph::Photograph;
use crate::pyramid::{Pyramid, Wrap};

/// A gray texture with its octaves; cheap to clone.
#[derive(Clone, Debug)]
pub struct Texture {
    pub(crate) pyramid: Arc<Pyramid>,
    /// Texels of the finest octave from texture place 0 to 1.
    pub(crate) texels: [f64; 2],
}

impl Texture {
    /// The photograph from `(0, 0)` to `(1, 1)`; its border goes on beyond.
    pub fn once(photograph: &Photograph) -> Texture {
        let texels = [photograph.width() as f64, photograph.height() as f64];
        Texture { pyramid: Arc::new(Pyramid::new(photograph.gray(), Wrap::Nearest)), texels }
    }

    /// The photograph `times` beside itself and `times` below itself from `(0, 0)` to `(1, 1)`, and on beyond.
    pub fn repeated(photograph: &Photograph, times: [f64; 2]) -> Texture {
        let tile = to_powers_of_two(photograph.gray());
        let texels = [times[0] * tile.width() as f64, times[1] * tile.height() as f64];
        Texture { pyramid: Arc::new(Pyramid::new(&tile, Wrap::Repeat)), texels }
    }

    /// One gray everywhere.
    pub fn gray(gray: f32) -> Texture {
        Texture { pyramid: Arc::new(Pyramid::new(&Plane::filled(1, 1, gray), Wrap::Nearest)), texels: [1.0; 2] }
    }
}

/// The picture, by linear interpolation, with the next larger powers of two as its sides: only those halve evenly.
fn to_powers_of_two(picture: &Plane<f32>) -> Plane<f32> {
    let (width, height) = (picture.width().next_power_of_two(), picture.height().next_power_of_two());
    if (width, height) == (picture.width(), picture.height()) {
        return picture.clone();
    }
    let octave = Pyramid::new(picture, Wrap::Repeat);
    let finest = octave.octaves(0.0);
    let (per_u, per_v) = (picture.width() as f32 / width as f32, picture.height() as f32 / height as f32);
    Plane::from_fn(width, height, |u, v| finest.sample((u as f32 + 0.5) * per_u, (v as f32 + 0.5) * per_v))
}
