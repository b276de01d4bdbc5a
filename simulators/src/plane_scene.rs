//! A plane that wears a photograph, and its picture in a pinhole camera, with the true depth.
//!
//! The world is the frame of the desired camera. The plane is `Z = distance`, endless and black but for the
//! photograph, which is centred on the world's z axis, upright. A pixel's ray leaves the camera's centre `o` along
//! `r = R (x, y, 1)`; with `h = distance - o_z` it meets the plane at the depth `z = h / r_z`, in the camera's own z.
//!
//! Anti-aliasing: four samples a pixel, each from the octave whose texels are as large as the pixel's footprint. One octave
//! finer, a brick wall at 128 px aliases so much that servoing comes to rest a millimetre off.
//! A pixel of area 1 px² covers `z³ / (h fx fy)` m² of the plane. The result moves smoothly with the pose.

use nalgebra::Isometry3;

use crate::camera::{PinholeCamera, Rays};
use crate::photograph::Photograph;
use crate::pyramid::{Pyramid, Wrap};
use crate::scene::{Rendering, SceneError};

/// Where the four samples of a pixel are, in px from its centre.
const SUBPIXELS: [f64; 2] = [-0.25, 0.25];

/// An endless black plane with a photograph on it, facing the desired camera.
#[derive(Clone, Debug)]
pub struct PlaneScene {
    texture: Pyramid,
    texture_size: [f64; 2],
    texels_per_m: f64,
    distance_m: f64,
    threads: usize,
}

impl PlaneScene {
    /// `photograph`, `width_m` wide, `distance_m` in front of the desired camera; fails when a length is not positive.
    pub fn new(photograph: &Photograph, width_m: f64, distance_m: f64) -> Result<PlaneScene, SceneError> {
        let positive = |length: f64| length.is_finite() && length > 0.0;
        if !positive(width_m) || !positive(distance_m) {
            return Err(SceneError::LengthNotPositive { width_m, distance_m });
        }
        Ok(PlaneScene {
            texture: Pyramid::new(photograph.gray(), Wrap::Black),
            texture_size: [photograph.width() as f64, photograph.height() as f64],
            texels_per_m: photograph.width() as f64 / width_m,
            distance_m,
            threads: 1,
        })
    }

    /// Renders on this many threads, at least one; the pixels do not depend on it.
    pub fn with_threads(mut self, threads: usize) -> PlaneScene {
        self.threads = threads.max(1);
        self
    }

    /// What `camera` sees from `pose` (`world_from_camera`). From behind, the plane is black; its depth is true.
    pub fn render(&self, camera: &PinholeCamera, pose: &Isometry3<f64>) -> Rendering {
        let mut rendering = Rendering::blank(camera);
        self.render_into(camera, pose, &mut rendering);
        rendering
    }

    /// Like [`PlaneScene::render`], into planes that are already there; other sizes are replaced.
    pub fn render_into(&self, camera: &PinholeCamera, pose: &Isometry3<f64>, rendering: &mut Rendering) {
        rendering.fit(camera);
        let rays = PlaneRays::new(self, camera, pose);
        rendering.in_bands(self.threads, |first_row, image, depth| {
            self.render_band(&rays, camera.width, first_row, image, depth);
        });
    }

    fn render_band(&self, rays: &PlaneRays, width: usize, first_row: usize, image: &mut [f32], depth: &mut [f32]) {
        let rows = image.chunks_mut(width).zip(depth.chunks_mut(width));
        for (row, (image, depth)) in rows.enumerate() {
            let v = (first_row + row) as f64;
            for (u, (gray, metres)) in image.iter_mut().zip(depth).enumerate() {
                let z = rays.depth_m(u as f64, v);
                *metres = z.unwrap_or(0.0) as f32;
                *gray = self.pixel(rays, u as f64, v, z);
            }
        }
    }

    /// The mean of a pixel's four samples.
    fn pixel(&self, rays: &PlaneRays, u: f64, v: f64, depth_m: Option<f64>) -> f32 {
        if rays.height_m <= 0.0 {
            return 0.0;
        }
        // A centre beyond the horizon may have a corner on this side of it, far away: the coarsest octave.
        let footprint_px2 = depth_m.map_or(f64::MAX, |z| z.powi(3) * rays.footprint_scale);
        // Half of log2 is the footprint's side.
        let octaves = self.texture.octaves(0.5 * (footprint_px2 as f32).log2());
        let mut sum = 0.0;
        for dv in SUBPIXELS {
            for du in SUBPIXELS {
                if let Some([s, t]) = rays.texel(u + du, v + dv) {
                    sum += octaves.sample(s as f32, t as f32);
                }
            }
        }
        sum / 4.0
    }
}

/// The rays of one pose, and where they meet the plane.
struct PlaneRays {
    rays: Rays,
    /// From the camera's centre to the plane along the world's z.
    height_m: f64,
    /// Texels² that a pixel covers at 1 m of depth.
    footprint_scale: f64,
    texels_per_m: f64,
    middle: [f64; 2],
}

impl PlaneRays {
    fn new(scene: &PlaneScene, camera: &PinholeCamera, pose: &Isometry3<f64>) -> PlaneRays {
        let [focal_u, focal_v] = camera.intrinsics.focal_px();
        let height_m = scene.distance_m - pose.translation.z;
        PlaneRays {
            rays: camera.rays(pose),
            height_m,
            footprint_scale: scene.texels_per_m.powi(2) / (height_m.abs() * focal_u * focal_v),
            texels_per_m: scene.texels_per_m,
            middle: scene.texture_size.map(|size| size / 2.0),
        }
    }

    /// `z = h / r_z` where the plane is in front of the camera.
    fn depth_m(&self, u: f64, v: f64) -> Option<f64> {
        let z = self.height_m / self.rays.direction(u, v).z;
        (z > 0.0 && z <= f64::from(f32::MAX)).then_some(z)
    }

    /// Where the ray meets the photograph's plane, in texels from the photograph's upper left corner.
    fn texel(&self, u: f64, v: f64) -> Option<[f64; 2]> {
        let r = self.rays.direction(u, v);
        let origin = &self.rays.origin;
        let z = self.height_m / r.z;
        let on_plane = |o: f64, r: f64, middle: f64| (o + z * r) * self.texels_per_m + middle;
        let texel = [on_plane(origin.x, r.x, self.middle[0]), on_plane(origin.y, r.y, self.middle[1])];
        (z > 0.0).then_some(texel)
    }
}
