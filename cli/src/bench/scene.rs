//! The images that are measured on: a bright, textured thing on a dark ground, seen from three places, as a camera would deliver it
//! (8-bit gray, depth in whole millimetres). The same for the same size, on every machine.
//!
//! Speed does not depend on what is seen, but a window that follows brightness must have something to follow.

use domvs_client::{DepthPlane, OutgoingFrame, PixelFormat};
use domvs_vision::{Depth, DepthMap, HoleFill, Plane};

use super::cases::{Case, DEPTH_M, DepthKind};
use crate::options::SizeOption;

/// Metres per count of depth.
const DEPTH_UNIT_M: f32 = 0.001;
/// Where the thing is in the desired image and in the two current ones, as fractions of the size.
const PLACES: [[f64; 2]; 3] = [[0.46, 0.48], [0.48, 0.465], [0.56, 0.58]];

/// One image with its depth.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Pixels.
    pub size: SizeOption,
    /// One byte a pixel, row by row.
    pub gray: Vec<u8>,
    /// Millimetres, one for each pixel; no holes.
    pub depth_mm: Vec<u16>,
}

/// What the camera should see, and two views that it has on the way: alternated, they make an adaptive window move.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The target.
    pub desired: Picture,
    /// Seen from two places.
    pub current: [Picture; 2],
}

/// A picture as the law takes it.
#[derive(Debug)]
pub struct Sight {
    /// Gray in `[0, 1]`.
    pub image: Plane<f32>,
    /// Its depth.
    pub depth: Depth<f32>,
    /// What a depth map is made of, metres.
    pub metres: Option<Plane<f32>>,
}

impl Scene {
    /// The scene at this size.
    pub fn new(size: SizeOption) -> Scene {
        let [desired, near, far] = PLACES.map(|place| Picture::new(size, place));
        Scene { desired, current: [near, far] }
    }
}

impl Picture {
    fn new(size: SizeOption, [x, y]: [f64; 2]) -> Picture {
        let pixels = || (0..size.width * size.height).map(|i| (i % size.width, i / size.width));
        // Both axes in units of the shorter side, so that the thing is round.
        let unit = size.width.min(size.height) as f64;
        let about = |u: usize, v: usize| {
            ((u as f64 - x * size.width as f64) / unit, (v as f64 - y * size.height as f64) / unit)
        };
        let gray = |(u, v): (usize, usize)| {
            let (x, y) = about(u, v);
            let bell = (-(x * x + 1.3 * y * y) / 0.018).exp();
            let texture =
                0.6 + 0.25 * (31.0 * x + 4.0 * y).sin() * (23.0 * y).cos() + 0.15 * (57.0 * y - 11.0 * x).sin();
            (255.0 * bell * texture).round() as u8
        };
        let depth = |(u, v): (usize, usize)| {
            let (x, y) = about(u, v);
            (1e3 * (DEPTH_M + 0.08 * x - 0.05 * y + 0.03 * (9.0 * x).sin())).round() as u16
        };
        Picture { size, gray: pixels().map(gray).collect(), depth_mm: pixels().map(depth).collect() }
    }

    /// As the service decodes it.
    pub fn sight(&self, depth: DepthKind) -> Sight {
        let SizeOption { width, height } = self.size;
        let plane = |samples| Plane::new(width, height, samples).expect("one sample for every pixel");
        let image = plane(self.gray.iter().map(|&gray| f32::from(gray) / 255.0).collect());
        let metres = (depth == DepthKind::Map)
            .then(|| plane(self.depth_mm.iter().map(|&mm| f32::from(mm) * DEPTH_UNIT_M).collect()));
        let map = |metres| DepthMap::from_metres(metres, HoleFill::Median).expect("every depth is positive");
        let depth = metres.as_ref().map_or(Depth::Constant { depth_m: DEPTH_M }, |metres| Depth::Map(map(metres)));
        Sight { image, depth, metres }
    }

    /// As it is sent: 8-bit gray, and 16-bit depth behind it where the case has a map.
    pub fn frame(&self, case: &Case) -> anyhow::Result<OutgoingFrame> {
        let (width, height, gray) = (self.size.width as u32, self.size.height as u32, self.gray.clone());
        let depth = DepthPlane::Counts { counts: &self.depth_mm, unit_m: DEPTH_UNIT_M };
        Ok(match case.depth {
            DepthKind::Constant => OutgoingFrame::mono8(width, height, gray)?,
            DepthKind::Map => OutgoingFrame::raw_with_depth(PixelFormat::Mono8, width, height, gray, depth)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_fill_their_size_differ_and_know_every_depth() {
        let scene = Scene::new(SizeOption { width: 97, height: 71 });
        let pictures = [&scene.desired, &scene.current[0], &scene.current[1]];
        for picture in pictures {
            assert_eq!((picture.gray.len(), picture.depth_mm.len()), (97 * 71, 97 * 71));
            assert!(picture.gray.iter().any(|gray| *gray > 150) && picture.gray.contains(&0));
            assert!(picture.depth_mm.iter().all(|mm| (500..1200).contains(mm)));
        }
        assert!(pictures[0].gray != pictures[1].gray && pictures[1].gray != pictures[2].gray);
    }
}
