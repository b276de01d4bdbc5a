//! Textured triangles in front of a background, and their picture in a pinhole camera, with the true depth.
//!
//! What does not depend on the camera is worked out once ([`Facet`]): with the normal `n` of a triangle and the texture
//! gradient `g` in its plane, a pixel's ray `o + z r(u, v)` meets it at `1/z = n·r / (d - n·o)`, and the texel there is
//! `g·o + s0 + z g·r`. Both `n·r` and `g·r` are linear in the pixel, so a frame costs a few products per triangle.
//!
//! The data's way: [`MeshScene::new`] → facets; `render_into` → views of facets and clipped pieces (`raster.rs`) → fragments
//! of pixels → gray and depth (`shade.rs`).

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};

use crate::camera::{PinholeCamera, Rays};
use crate::mesh::Mesh;
use crate::photograph::Photograph;
use crate::pyramid::{Pyramid, Wrap};
use crate::raster::{self, Band, Piece};
use crate::scene::{Rendering, SceneError};
use crate::shade::{self, FacetView, Shader, Surface};
use crate::texture::Texture;

/// Rows that are rendered at once: their buffers stay in a core's cache.
const BAND_ROWS: usize = 32;

/// What is seen where no triangle is.
#[derive(Clone, Debug)]
pub struct Background {
    /// Gray in [0, 1] where nothing is, without depth, and of the wall beyond its photograph.
    pub gray: f32,
    /// A wall, if there is one.
    pub wall: Option<Wall>,
}

/// An endless plane that faces the world's origin, with a photograph about the world's z axis; black from behind.
#[derive(Clone, Debug)]
pub struct Wall {
    /// The photograph, upright.
    pub photograph: Photograph,
    /// How wide it is, m.
    pub width_m: f64,
    /// At which z the wall is, m.
    pub distance_m: f64,
}

/// Textured triangles in front of a background; cheap to clone.
#[derive(Clone, Debug)]
pub struct MeshScene {
    parts: Arc<Parts>,
    threads: usize,
}

#[derive(Debug)]
struct Parts {
    positions: Vec<Point3<f64>>,
    facets: Vec<Facet>,
    /// Facets of one mesh each: `facets[start..end]`, and whether it is convex.
    bodies: Vec<(usize, usize, bool)>,
    surfaces: Vec<Surface>,
    wall: Option<Facet>,
    gray: f32,
}

/// A triangle, or the wall, in the world.
#[derive(Clone, Debug)]
struct Facet {
    corners: [u32; 3],
    surface: u32,
    /// The same for all facets that hang together by their corners, over which the texture is continuous.
    patch: u32,
    /// Unit, outwards.
    normal: Vector3<f64>,
    /// `normal · X` on the plane, m.
    offset_m: f64,
    /// Texels per metre: the texel at `X` is `gradient · X + texel_at_zero`.
    gradient: [Vector3<f64>; 2],
    texel_at_zero: [f64; 2],
}

impl MeshScene {
    /// Meshes in the world with what they wear. Fails when a corner is not finite or not there, a triangle names a corner
    /// that is not, or a length of the wall is not positive; triangles without area are left out.
    pub fn new(objects: &[(Mesh, Texture)], background: &Background) -> Result<MeshScene, SceneError> {
        let mut parts = Parts {
            positions: vec![],
            facets: vec![],
            bodies: vec![],
            surfaces: vec![],
            wall: None,
            gray: background.gray,
        };
        if let Some(wall) = &background.wall {
            parts.hang(wall, background.gray)?;
        }
        for (index, (mesh, texture)) in objects.iter().enumerate() {
            parts.add(index, mesh, texture)?;
        }
        Ok(MeshScene { parts: Arc::new(parts), threads: 1 })
    }

    /// Renders on this many threads, at least one; the pixels do not depend on it.
    pub fn with_threads(mut self, threads: usize) -> MeshScene {
        self.threads = threads.max(1);
        self
    }

    /// How many triangles there are.
    pub fn triangles(&self) -> usize {
        self.parts.facets.len()
    }

    /// What `camera` sees from `pose` (`world_from_camera`), into planes that are already there; other sizes are replaced.
    pub fn render_into(&self, camera: &PinholeCamera, pose: &Isometry3<f64>, rendering: &mut Rendering) {
        rendering.fit(camera);
        let frame = self.parts.seen(camera, pose);
        let shader = Shader { views: &frame.views, surfaces: &self.parts.surfaces, gray: self.parts.gray };
        let width = camera.width;
        rendering.in_bands(self.threads, |first_row, image, depth| {
            let mut band = Band::new(width);
            let bands = image.chunks_mut(BAND_ROWS * width).zip(depth.chunks_mut(BAND_ROWS * width));
            for (index, (image, depth)) in bands.enumerate() {
                let first = first_row + index * BAND_ROWS;
                band.begin(first, image.len() / width);
                if frame.has_wall {
                    raster::cover(&mut band, &frame.views, 0);
                }
                frame.pieces.iter().for_each(|piece| raster::draw(&mut band, &frame.views, piece));
                shade::resolve(&band, &shader, image, depth);
            }
        });
    }
}

/// What one pose makes of the scene.
struct Frame {
    views: Vec<FacetView>,
    pieces: Vec<Piece>,
    /// Whether the first view is the wall's.
    has_wall: bool,
}

impl Parts {
    fn hang(&mut self, wall: &Wall, gray: f32) -> Result<(), SceneError> {
        let Wall { photograph, width_m, distance_m } = wall;
        let positive = |length: f64| length.is_finite() && length > 0.0;
        if !positive(*width_m) || !positive(*distance_m) {
            return Err(SceneError::LengthNotPositive { width_m: *width_m, distance_m: *distance_m });
        }
        let texels_per_m = photograph.width() as f64 / width_m;
        // Black around the picture less the gray is the gray.
        let mut picture = photograph.gray().clone();
        picture.samples_mut().iter_mut().for_each(|sample| *sample -= gray);
        self.surfaces.push(Surface { pyramid: Arc::new(Pyramid::new(&picture, Wrap::Black)), lift: gray });
        self.wall = Some(Facet {
            corners: [0; 3],
            surface: 0,
            patch: u32::MAX,
            normal: -Vector3::z(),
            offset_m: -distance_m,
            gradient: [Vector3::x() * texels_per_m, Vector3::y() * texels_per_m],
            texel_at_zero: [photograph.width() as f64 / 2.0, photograph.height() as f64 / 2.0],
        });
        Ok(())
    }

    fn add(&mut self, object: usize, mesh: &Mesh, texture: &Texture) -> Result<(), SceneError> {
        let (corners, places) = (mesh.positions.len(), mesh.texture_places.len());
        let finite = mesh.positions.iter().flat_map(|p| p.iter()).chain(mesh.texture_places.iter().flatten());
        if places != corners || !finite.into_iter().all(|number| number.is_finite()) {
            return Err(SceneError::Corners { object, corners, places });
        }
        if let Some(&corner) = mesh.triangles.iter().flatten().find(|&&corner| corner as usize >= corners) {
            return Err(SceneError::NoSuchCorner { object, corner, corners });
        }
        let first_position = self.positions.len() as u32;
        let first_facet = self.facets.len();
        let surface = self.surfaces.len() as u32;
        self.positions.extend_from_slice(&mesh.positions);
        self.surfaces.push(Surface { pyramid: Arc::clone(&texture.pyramid), lift: 0.0 });
        let patches = patches(mesh);
        let facets = mesh.triangles.iter().filter_map(|triangle| facet(mesh, triangle, texture));
        self.facets.extend(facets.map(|facet| Facet {
            corners: facet.corners.map(|corner| first_position + corner),
            surface,
            // A patch goes by its first corner.
            patch: first_position + patches[facet.corners[0] as usize],
            ..facet
        }));
        self.bodies.push((first_facet, self.facets.len(), mesh.convex));
        Ok(())
    }

    fn seen(&self, camera: &PinholeCamera, pose: &Isometry3<f64>) -> Frame {
        let rays = camera.rays(pose);
        let to_camera = pose.inverse();
        let positions: Vec<Point3<f64>> = self.positions.iter().map(|position| to_camera * position).collect();
        let mut frame = Frame { views: vec![], pieces: vec![], has_wall: self.wall.is_some() };
        frame.views.extend(self.wall.as_ref().map(|wall| wall.seen(camera, &rays)));
        for &(start, end, convex) in &self.bodies {
            let facets = &self.facets[start..end];
            let only_front = convex && facets.iter().any(|facet| facet.faces(&rays.origin));
            for facet in facets {
                if only_front && !facet.faces(&rays.origin) {
                    continue;
                }
                let corners = facet.corners.map(|corner| positions[corner as usize]);
                let before = frame.pieces.len();
                raster::clip(camera, corners, frame.views.len() as u32, &mut frame.pieces);
                if frame.pieces.len() > before {
                    frame.views.push(facet.seen(camera, &rays));
                }
            }
        }
        frame
    }
}

impl Facet {
    /// Whether `eye` is on the outer side.
    fn faces(&self, eye: &Vector3<f64>) -> bool {
        self.normal.dot(eye) > self.offset_m
    }

    fn seen(&self, camera: &PinholeCamera, rays: &Rays) -> FacetView {
        let distance_m = self.offset_m - self.normal.dot(&rays.origin);
        let inverse_depth = rays.project(&self.normal).map(|part| part / distance_m);
        let [focal_u, focal_v] = camera.intrinsics.focal_px();
        let texels2_per_m2 = self.gradient[0].cross(&self.gradient[1]).norm();
        let footprint_scale = texels2_per_m2 / (distance_m.abs() * focal_u * focal_v);
        FacetView {
            inverse_depth,
            reach: ((inverse_depth[0].abs() + inverse_depth[1].abs()) / 2.0) as f32,
            texel_per_depth: [0, 1].map(|axis| rays.project(&self.gradient[axis])),
            texel_at_eye: [0, 1].map(|axis| self.gradient[axis].dot(&rays.origin) + self.texel_at_zero[axis]),
            // Half of log2 is the footprint's side at 1 m.
            log2_texels_at_1m: 0.5 * (footprint_scale as f32).log2(),
            surface: self.surface,
            patch: self.patch,
            front: self.faces(&rays.origin),
        }
    }
}

/// The plane of a triangle and its texture's map; none without area.
fn facet(mesh: &Mesh, triangle: &[u32; 3], texture: &Texture) -> Option<Facet> {
    let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize].coords);
    let [place_a, place_b, place_c] = triangle.map(|corner| {
        let [s, t] = mesh.texture_places[corner as usize];
        [s * texture.texels[0], t * texture.texels[1]]
    });
    let (e, f) = (b - a, c - a);
    let twice_area = e.cross(&f).norm();
    // Thinner than this its normal is rounding.
    if !twice_area.is_finite() || twice_area <= 1e-12 * e.norm() * f.norm() {
        return None;
    }
    let normal = e.cross(&f) / twice_area;
    // The vector in the plane whose products with e and f are the differences of the texels.
    let gradient = [0, 1].map(|axis| {
        let (along_e, along_f) = (place_b[axis] - place_a[axis], place_c[axis] - place_a[axis]);
        (f.cross(&normal) * along_e + normal.cross(&e) * along_f) / twice_area
    });
    let texel_at_zero = [0, 1].map(|axis| place_a[axis] - gradient[axis].dot(&a));
    Some(Facet { corners: *triangle, surface: 0, patch: 0, normal, offset_m: normal.dot(&a), gradient, texel_at_zero })
}

/// For each corner the first of those that it hangs together with by triangles.
fn patches(mesh: &Mesh) -> Vec<u32> {
    let mut first: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let root = |first: &mut [u32], corner: u32| {
        let mut at = corner as usize;
        while first[at] as usize != at {
            // Every look halves the way for the next one.
            first[at] = first[first[at] as usize];
            at = first[at] as usize;
        }
        at as u32
    };
    for &[a, b, c] in &mesh.triangles {
        for (one, other) in [(a, b), (b, c)] {
            let (one, other) = (root(&mut first, one), root(&mut first, other));
            first[one.max(other) as usize] = one.min(other);
        }
    }
    (0..first.len() as u32).map(|corner| root(&mut first, corner)).collect()
}
