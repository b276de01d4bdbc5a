//! A textured square between the camera and the scene, still or moving; it is not in the depth map.

use domvs_vision::Plane;

use crate::photograph::Photograph;
use crate::pyramid::{Pyramid, Wrap};

/// A square that hides a part of the image.
#[derive(Clone, Debug)]
pub struct Occluder {
    texture: Pyramid,
    texture_size: [f64; 2],
    /// Its area as a share of the image's.
    pub share: f64,
    /// The first image it hides a part of, from 0.
    pub from_image: u64,
    /// Its centre in that image: parts of the width and the height, from the upper left corner.
    pub center: [f64; 2],
    /// How far it moves from image to image, px; at the borders its centre turns back.
    pub speed_px: [f64; 2],
}

impl Occluder {
    /// A square with the whole of `photograph` on it, still in the middle from the first image on.
    pub fn new(photograph: &Photograph, share: f64) -> Occluder {
        Occluder {
            texture: Pyramid::new(photograph.gray(), Wrap::Nearest),
            texture_size: [photograph.width() as f64, photograph.height() as f64],
            share,
            from_image: 0,
            center: [0.5; 2],
            speed_px: [0.0; 2],
        }
    }

    /// Draws it over the image of this number; its border is as soft as the pixels.
    pub fn cover(&self, picture: &mut Plane<f32>, image: u64) {
        let Some(moves) = image.checked_sub(self.from_image) else { return };
        let (width, height) = (picture.width(), picture.height());
        let side_px = (self.share * (width * height) as f64).sqrt();
        if !side_px.is_finite() || side_px <= 0.0 {
            return;
        }
        let size = [width as f64, height as f64];
        // Pixel (u, v) covers [u, u + 1) x [v, v + 1) here.
        let corner = [0, 1].map(|axis| {
            let at = self.center[axis] * size[axis] + moves as f64 * self.speed_px[axis];
            reflected(at, size[axis]) - side_px / 2.0
        });
        let per_px = self.texture_size.map(|size| size / side_px);
        let octaves = self.texture.octaves((per_px[0].max(per_px[1]) as f32).log2());
        for (v, row) in picture.samples_mut().chunks_mut(width).enumerate() {
            let down = overlap(v as f64 - corner[1], side_px);
            if down <= 0.0 {
                continue;
            }
            for (u, gray) in row.iter_mut().enumerate() {
                let hidden = (down * overlap(u as f64 - corner[0], side_px)) as f32;
                if hidden > 0.0 {
                    let place = |at: usize, axis: usize| ((at as f64 + 0.5 - corner[axis]) * per_px[axis]) as f32;
                    *gray += hidden * (octaves.sample(place(u, 0), place(v, 1)) - *gray);
                }
            }
        }
    }
}

/// How much of `[at, at + 1]` lies in `[0, side]`.
fn overlap(at: f64, side: f64) -> f64 {
    ((at + 1.0).min(side) - at.max(0.0)).max(0.0)
}

/// A place that runs to and fro between 0 and `size`.
fn reflected(at: f64, size: f64) -> f64 {
    let round = at.rem_euclid(2.0 * size);
    if round > size { 2.0 * size - round } else { round }
}
