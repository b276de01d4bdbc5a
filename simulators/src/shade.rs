//! From the facets of a pixel to its gray and its depth.
//!
//! A pixel that one facet fills is the mean of four texture samples, each from the octave whose texels are as large as the
//! pixel's footprint: a pixel covers `z³ n / (h fx fy)` texels², with `n` texels² on a m² and the camera `h` m from the
//! facet's plane. A pixel that several share is decided at sixteen places; each facet then gives its colour at the middle
//! of its places, with their share of the weight. Neighbours of one smooth mesh give it together. Depth is that of the
//! facet at the pixel's centre, exactly.

use std::sync::Arc;

use crate::pyramid::Pyramid;
use crate::raster::{Band, CENTER, FULL, Fragment, NONE, SAMPLE_U, SAMPLE_V, SAMPLES};

/// Where the four texture samples of a pixel are, in px from its middle.
const TAP_PX: f32 = 0.25;

/// A texture, and what is added to its samples.
#[derive(Debug)]
pub(crate) struct Surface {
    pub(crate) pyramid: Arc<Pyramid>,
    pub(crate) lift: f32,
}

/// A facet from one pose: coefficients of u, of v and of 1, with u and v in px.
#[derive(Clone, Debug)]
pub(crate) struct FacetView {
    /// 1/z, 1/m.
    pub(crate) inverse_depth: [f64; 3],
    /// How much 1/z changes from the centre of a pixel to a corner.
    pub(crate) reach: f32,
    /// `L` in `texel = texel_at_eye + z L(u, v)`, along both axes of the texture.
    pub(crate) texel_per_depth: [[f64; 3]; 2],
    pub(crate) texel_at_eye: [f64; 2],
    /// log2 of the texels along a pixel at 1 m, before perspective.
    pub(crate) log2_texels_at_1m: f32,
    pub(crate) surface: u32,
    /// Facets of one patch wear the texture on across their common edges.
    pub(crate) patch: u32,
    /// Whether the camera is on its outer side.
    pub(crate) front: bool,
}

impl FacetView {
    pub(crate) fn inverse_depth_at(&self, u: f64, v: f64) -> f64 {
        linear(&self.inverse_depth, u, v)
    }
}

fn linear([per_u, per_v, at_zero]: &[f64; 3], u: f64, v: f64) -> f64 {
    per_u * u + (per_v * v + at_zero)
}

/// What all pixels of a frame share.
pub(crate) struct Shader<'a> {
    pub(crate) views: &'a [FacetView],
    pub(crate) surfaces: &'a [Surface],
    pub(crate) gray: f32,
}

/// Makes the gray and the depth of the band's pixels.
pub(crate) fn resolve(band: &Band, shader: &Shader, image: &mut [f32], depth: &mut [f32]) {
    let mut shared = Shared::default();
    for row in 0..band.rows {
        let v = (band.first_row + row) as f64;
        for column in 0..band.width {
            let pixel = row * band.width + column;
            let u = column as f64;
            let (view, head) = (band.views[pixel], band.heads[pixel]);
            let (gray, metres) = if head != NONE {
                shared.gather(shader.views, &band.fragments, view, head, u, v);
                let metres = shared.depth_m(shader.views, u, v);
                shared.join(shader.views, u, v);
                (shared.gray(shader, u, v), metres)
            } else if view != NONE {
                let facet = &shader.views[view as usize];
                (shader.gray(facet, u, v), (1.0 / facet.inverse_depth_at(u, v)) as f32)
            } else {
                (shader.gray, 0.0)
            };
            image[pixel] = gray;
            depth[pixel] = metres;
        }
    }
}

impl Shader<'_> {
    /// The mean of the four samples about `(u, v)`.
    fn gray(&self, view: &FacetView, u: f64, v: f64) -> f32 {
        let surface = &self.surfaces[view.surface as usize];
        let near = view.inverse_depth_at(u, v);
        // Beyond a horizon or behind the camera only in the corner of a pixel that is hardly seen at all.
        if near <= f64::from(f32::MIN_POSITIVE) || (!view.front && surface.pyramid.is_one_sided()) {
            return surface.lift;
        }
        let z = 1.0 / near;
        let octaves = surface.pyramid.octaves(view.log2_texels_at_1m - 1.5 * (near as f32).log2());
        let [(s, s_u, s_v), (t, t_u, t_v)] = [0, 1].map(|axis| {
            let per_depth = linear(&view.texel_per_depth[axis], u, v);
            // d(z L) = z (dL - L z d(1/z)).
            let change = |k: usize| {
                (z * (view.texel_per_depth[axis][k] - per_depth * z * view.inverse_depth[k])) as f32 * TAP_PX
            };
            ((view.texel_at_eye[axis] + z * per_depth) as f32, change(0), change(1))
        });
        let sum = octaves.sample(s - s_u - s_v, t - t_u - t_v)
            + octaves.sample(s + s_u - s_v, t + t_u - t_v)
            + octaves.sample(s - s_u + s_v, t - t_u + t_v)
            + octaves.sample(s + s_u + s_v, t + t_u + t_v);
        sum / 4.0 + surface.lift
    }
}

/// The facets of one shared pixel, each with the places where it is the nearest.
#[derive(Default)]
struct Shared {
    parts: Vec<(u32, u32)>,
}

impl Shared {
    fn gather(&mut self, views: &[FacetView], fragments: &[Fragment], holder: u32, head: u32, u: f64, v: f64) {
        self.parts.clear();
        if holder != NONE {
            self.parts.push((holder, FULL));
        }
        let mut at = head;
        while at != NONE {
            let Fragment { view, mask, next } = fragments[at as usize];
            self.parts.push((view, mask));
            at = next;
        }
        let claimed = self.parts.iter().fold(0, |claimed: u32, (_, mask)| claimed + mask.count_ones());
        let union = self.parts.iter().fold(0, |union, (_, mask)| union | mask);
        if claimed != union.count_ones() {
            self.decide(views, u, v);
        }
    }

    /// Gives each place to the nearest facet there; of equally near ones, to the first in the scene.
    fn decide(&mut self, views: &[FacetView], u: f64, v: f64) {
        const PLACES: usize = SAMPLES + 1;
        let mut nearest = [f32::MIN; PLACES];
        let mut owner = [usize::MAX; PLACES];
        for (part, &(view, mask)) in self.parts.iter().enumerate() {
            let facet = &views[view as usize];
            let at_center = facet.inverse_depth_at(u, v) as f32;
            let (per_u, per_v) = (facet.inverse_depth[0] as f32, facet.inverse_depth[1] as f32);
            for place in 0..PLACES {
                let near = match place {
                    SAMPLES => at_center,
                    _ => at_center + (per_u * SAMPLE_U[place] + per_v * SAMPLE_V[place]),
                };
                let first = near > nearest[place]
                    || (near == nearest[place] && owner[place] != usize::MAX && view < self.parts[owner[place]].0);
                if mask >> place & 1 == 1 && first {
                    (nearest[place], owner[place]) = (near, part);
                }
            }
        }
        self.parts.iter_mut().for_each(|(_, mask)| *mask = 0);
        for (place, &part) in owner.iter().enumerate() {
            if part != usize::MAX {
                self.parts[part].1 |= 1 << place;
            }
        }
    }

    /// Gives the places of facets that hang together in this pixel to the one of them that has most: where their common
    /// edge runs through the pixel their planes and textures go on into each other.
    fn join(&mut self, views: &[FacetView], u: f64, v: f64) {
        for part in 1..self.parts.len() {
            let (view, mask) = self.parts[part];
            let facet = &views[view as usize];
            let near = facet.inverse_depth_at(u, v);
            let hangs_together = |&(other, other_mask): &(u32, u32)| {
                let other = &views[other as usize];
                let apart = (other.inverse_depth_at(u, v) - near).abs() as f32;
                other_mask != 0 && other.patch == facet.patch && apart <= other.reach + facet.reach
            };
            if mask != 0
                && let Some(neighbour) = self.parts[..part].iter().position(hangs_together)
            {
                let (other, other_mask) = self.parts[neighbour];
                let larger =
                    if (mask & !CENTER).count_ones() > (other_mask & !CENTER).count_ones() { view } else { other };
                self.parts[neighbour] = (larger, mask | other_mask);
                self.parts[part].1 = 0;
            }
        }
    }

    fn gray(&self, shader: &Shader, u: f64, v: f64) -> f32 {
        let mut sum = 0.0;
        let mut left = SAMPLES as u32;
        for &(view, mask) in &self.parts {
            let samples = mask & !CENTER;
            let count = samples.count_ones();
            if count == 0 {
                continue;
            }
            let [du, dv] = middle(samples, count);
            sum += count as f32 * shader.gray(&shader.views[view as usize], u + f64::from(du), v + f64::from(dv));
            left -= count;
        }
        (sum + left as f32 * shader.gray) / SAMPLES as f32
    }

    fn depth_m(&self, views: &[FacetView], u: f64, v: f64) -> f32 {
        let center = self.parts.iter().find(|(_, mask)| mask & CENTER != 0);
        center.map_or(0.0, |&(view, _)| (1.0 / views[view as usize].inverse_depth_at(u, v)) as f32)
    }
}

/// The mean place of some samples, px from the centre.
fn middle(samples: u32, count: u32) -> [f32; 2] {
    let (mut sum_u, mut sum_v) = (0.0, 0.0);
    for index in 0..SAMPLES {
        let weight = (samples >> index & 1) as f32;
        sum_u += weight * SAMPLE_U[index];
        sum_v += weight * SAMPLE_V[index];
    }
    [sum_u / count as f32, sum_v / count as f32]
}
