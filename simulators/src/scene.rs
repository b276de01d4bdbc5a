//! What cameras look at, of whatever kind, and what they see of it.

use domvs_vision::Plane;
use nalgebra::Isometry3;

use crate::camera::PinholeCamera;
use crate::mesh_scene::MeshScene;
use crate::plane_scene::PlaneScene;

/// Why there is no scene.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum SceneError {
    /// A length is zero, negative or not a number.
    #[error("width and distance of the photograph must be positive, got {width_m} m and {distance_m} m")]
    LengthNotPositive {
        /// Width of the photograph, m.
        width_m: f64,
        /// Distance from the desired camera, m.
        distance_m: f64,
    },
    /// A mesh has not as many texture places as corners, or one of them is not finite.
    #[error("object {object}: expected finite corners, each with its texture place, got {corners} and {places}")]
    Corners {
        /// Its place in the list, from 0.
        object: usize,
        /// Corners.
        corners: usize,
        /// Texture places.
        places: usize,
    },
    /// A triangle names a corner that is not there.
    #[error("object {object}: expected corners below {corners}, got a triangle with corner {corner}")]
    NoSuchCorner {
        /// Its place in the list, from 0.
        object: usize,
        /// The corner it names.
        corner: u32,
        /// Corners there are.
        corners: usize,
    },
}

/// What a camera sees.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Gray in [0, 1].
    pub image: Plane<f32>,
    /// Depth along the optical axis as the law is told it, m; 0 where it is unknown or a pixel's ray meets nothing.
    pub depth: Plane<f32>,
    /// Depth along the optical axis as it is, m; 0 where a pixel's ray meets nothing. For judges.
    pub true_depth: Plane<f32>,
}

impl Rendering {
    /// Black and without depth, of the camera's size.
    pub(crate) fn blank(camera: &PinholeCamera) -> Rendering {
        let blank = || Plane::filled(camera.width, camera.height, 0.0);
        Rendering { image: blank(), depth: blank(), true_depth: blank() }
    }

    /// Replaces planes of another size than the camera's.
    pub(crate) fn fit(&mut self, camera: &PinholeCamera) {
        for plane in [&mut self.image, &mut self.depth, &mut self.true_depth] {
            if (plane.width(), plane.height()) != (camera.width, camera.height) {
                *plane = Plane::filled(camera.width, camera.height, 0.0);
            }
        }
    }

    /// Fills image and true depth in bands of rows, one a thread, by `fill(first_row, image, depth)`; the depth that
    /// is told is then the true one.
    pub(crate) fn in_bands(&mut self, threads: usize, fill: impl Fn(usize, &mut [f32], &mut [f32]) + Sync) {
        let (width, height) = (self.image.width(), self.image.height());
        if threads <= 1 {
            fill(0, self.image.samples_mut(), self.true_depth.samples_mut());
        } else {
            let rows = height.div_ceil(threads);
            let image_bands = self.image.samples_mut().chunks_mut(rows * width);
            let depth_bands = self.true_depth.samples_mut().chunks_mut(rows * width);
            std::thread::scope(|scope| {
                for (index, (image, depth)) in image_bands.zip(depth_bands).enumerate() {
                    let fill = &fill;
                    scope.spawn(move || fill(index * rows, image, depth));
                }
            });
        }
        self.depth.samples_mut().copy_from_slice(self.true_depth.samples());
    }
}

/// What a camera looks at; cheap to clone.
#[derive(Clone, Debug)]
pub enum Scene {
    /// A photograph on an endless plane, by rays.
    Plane(PlaneScene),
    /// Textured triangles in front of a background, by the rasteriser.
    Meshes(MeshScene),
}

impl Scene {
    /// Renders on this many threads, at least one, which is the default; the pixels do not depend on it.
    pub fn with_threads(self, threads: usize) -> Scene {
        match self {
            Scene::Plane(scene) => Scene::Plane(scene.with_threads(threads)),
            Scene::Meshes(scene) => Scene::Meshes(scene.with_threads(threads)),
        }
    }

    /// What `camera` sees from `pose` (`world_from_camera`).
    pub fn render(&self, camera: &PinholeCamera, pose: &Isometry3<f64>) -> Rendering {
        let mut rendering = Rendering::blank(camera);
        self.render_into(camera, pose, &mut rendering);
        rendering
    }

    /// Like [`Scene::render`], into planes that are already there; other sizes are replaced.
    pub fn render_into(&self, camera: &PinholeCamera, pose: &Isometry3<f64>, rendering: &mut Rendering) {
        match self {
            Scene::Plane(scene) => scene.render_into(camera, pose, rendering),
            Scene::Meshes(scene) => scene.render_into(camera, pose, rendering),
        }
    }
}

impl From<PlaneScene> for Scene {
    fn from(scene: PlaneScene) -> Scene {
        Scene::Plane(scene)
    }
}

impl From<MeshScene> for Scene {
    fn from(scene: MeshScene) -> Scene {
        Scene::Meshes(scene)
    }
}
