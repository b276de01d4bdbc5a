//! Which facets each pixel sees: a z-buffer of facets that fill pixels, and a list for pixels that they share.
//!
//! A triangle is clipped at a near plane, projected, and cut into rows of pixels. Pixels that it fills go through an
//! ordinary z-test at their centres; of those that it only touches, and of those where two facets meet, it takes the
//! [`SAMPLES`] places that lie inside it, to be compared one by one later. A place on the common edge of two triangles is
//! in exactly one of them: the edge's function of one is the negative of the other's, bit for bit, and one of the two owns
//! its zeros. So there are neither cracks nor doubles.

use nalgebra::Point3;

use crate::camera::PinholeCamera;
use crate::shade::FacetView;

/// Nothing nearer than this is seen, m.
const NEAR_M: f64 = 1e-3;

/// Places in a pixel at which visibility is decided.
pub(crate) const SAMPLES: usize = 16;

/// The bit of the pixel's centre, after those of the samples.
pub(crate) const CENTER: u32 = 1 << SAMPLES;

/// All samples and the centre.
pub(crate) const FULL: u32 = (CENTER << 1) - 1;

/// Where the samples are, px from the centre: no two in one row or column, evenly spread (Hammersley's points), so an
/// edge of any direction covers a pixel in sixteen steps. Their mean is the centre.
pub(crate) const SAMPLE_U: [f32; SAMPLES] = sample_places(false);
/// The other coordinate.
pub(crate) const SAMPLE_V: [f32; SAMPLES] = sample_places(true);

const fn sample_places(reversed: bool) -> [f32; SAMPLES] {
    let mut places = [0.0; SAMPLES];
    let mut index = 0;
    while index < SAMPLES {
        let bits = SAMPLES.trailing_zeros();
        let row = if reversed { index.reverse_bits() >> (usize::BITS - bits) } else { index };
        places[index] = (row as f32 + 0.5) / SAMPLES as f32 - 0.5;
        index += 1;
    }
    places
}

/// No facet, no fragment.
pub(crate) const NONE: u32 = u32::MAX;

/// Part of a triangle in front of the near plane, on the image.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    view: u32,
    edges: [Edge; 3],
    /// Smallest and largest u, smallest and largest v, px.
    bounds: [f64; 4],
}

/// `a u + b v + c`, positive inside.
#[derive(Clone, Copy, Debug)]
struct Edge {
    a: f64,
    b: f64,
    c: f64,
    /// How much the function changes from the centre of a pixel to a corner.
    reach: f64,
    /// Whether points on the edge are inside.
    closed: bool,
}

/// A facet's share of a pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fragment {
    pub(crate) view: u32,
    /// Which samples, and whether the centre.
    pub(crate) mask: u32,
    /// The next fragment of the same pixel.
    pub(crate) next: u32,
}

/// The visible facets of a few rows.
pub(crate) struct Band {
    pub(crate) width: usize,
    pub(crate) first_row: usize,
    pub(crate) rows: usize,
    /// The nearest facet that fills the pixel, its 1/z at the centre, and the pixel's list of fragments.
    pub(crate) views: Vec<u32>,
    near: Vec<f32>,
    pub(crate) heads: Vec<u32>,
    pub(crate) fragments: Vec<Fragment>,
}

impl Band {
    pub(crate) fn new(width: usize) -> Band {
        Band { width, first_row: 0, rows: 0, views: vec![], near: vec![], heads: vec![], fragments: vec![] }
    }

    /// Forgets everything and stands at other rows.
    pub(crate) fn begin(&mut self, first_row: usize, rows: usize) {
        (self.first_row, self.rows) = (first_row, rows);
        let pixels = self.width * rows;
        for (plane, value) in [(&mut self.views, NONE), (&mut self.heads, NONE)] {
            plane.clear();
            plane.resize(pixels, value);
        }
        self.near.clear();
        self.near.resize(pixels, 0.0);
        self.fragments.clear();
    }

    fn share(&mut self, pixel: usize, view: u32, mask: u32) {
        let next = self.heads[pixel];
        self.heads[pixel] = self.fragments.len() as u32;
        self.fragments.push(Fragment { view, mask, next });
    }
}

/// Adds what of a triangle (camera frame, m) is in front of the near plane and may touch the image: at most two pieces.
pub(crate) fn clip(camera: &PinholeCamera, corners: [Point3<f64>; 3], view: u32, pieces: &mut Vec<Piece>) {
    let mut polygon = [[0.0; 2]; 4];
    let mut count = 0;
    let mut keep = |corner: Point3<f64>| {
        polygon[count] = [
            camera.intrinsics.focal_px()[0] * corner.x / corner.z + camera.intrinsics.center_px()[0],
            camera.intrinsics.focal_px()[1] * corner.y / corner.z + camera.intrinsics.center_px()[1],
        ];
        count += 1;
    };
    for (index, &corner) in corners.iter().enumerate() {
        let next = corners[(index + 1) % 3];
        let (inside, next_inside) = (corner.z >= NEAR_M, next.z >= NEAR_M);
        if inside {
            keep(corner);
        }
        if inside != next_inside {
            // Always from the inside outwards: both triangles of an edge find the same point.
            let (from, to) = if inside { (corner, next) } else { (next, corner) };
            let cut = from + (to - from) * ((from.z - NEAR_M) / (from.z - to.z));
            keep(Point3::new(cut.x, cut.y, NEAR_M));
        }
    }
    for last in 2..count {
        pieces.extend(Piece::new(camera, view, [polygon[0], polygon[last - 1], polygon[last]]));
    }
}

impl Piece {
    /// None when it has no area or lies beside the image.
    fn new(camera: &PinholeCamera, view: u32, corners: [[f64; 2]; 3]) -> Option<Piece> {
        let [a, b, c] = corners;
        let least = |axis: usize| a[axis].min(b[axis]).min(c[axis]);
        let most = |axis: usize| a[axis].max(b[axis]).max(c[axis]);
        let bounds = [least(0), most(0), least(1), most(1)];
        let outside = |low: f64, high: f64, pixels: usize| high < -0.5 || low > pixels as f64 - 0.5;
        let twice_area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        let nowhere = outside(bounds[0], bounds[1], camera.width) || outside(bounds[2], bounds[3], camera.height);
        if nowhere || twice_area == 0.0 || !twice_area.is_finite() {
            return None;
        }
        let turned = if twice_area > 0.0 { [a, b, c] } else { [a, c, b] };
        let edge = |k: usize| Edge::new(turned[k], turned[(k + 1) % 3]);
        Some(Piece { view, edges: [edge(0), edge(1), edge(2)], bounds })
    }
}

impl Edge {
    /// Inside is to the right of the way from `p` to `q`, as it looks on the image with v down.
    fn new(p: [f64; 2], q: [f64; 2]) -> Edge {
        let (a, b) = (p[1] - q[1], q[0] - p[0]);
        let c = p[0] * q[1] - p[1] * q[0];
        Edge { a, b, c, reach: (a.abs() + b.abs()) / 2.0, closed: a > 0.0 || (a == 0.0 && b > 0.0) }
    }
}

/// Puts a facet without borders behind everything: it fills every pixel at whose centre it is in front of the camera.
pub(crate) fn cover(band: &mut Band, views: &[FacetView], view: u32) {
    let facet = &views[view as usize];
    for row in 0..band.rows {
        for u in 0..band.width {
            let near = facet.inverse_depth_at(u as f64, (band.first_row + row) as f64);
            if near > f64::from(f32::MIN_POSITIVE) {
                let pixel = row * band.width + u;
                band.near[pixel] = near as f32;
                band.views[pixel] = view;
            }
        }
    }
}

/// Draws a piece into the rows of the band.
pub(crate) fn draw(band: &mut Band, views: &[FacetView], piece: &Piece) {
    let [_, _, top, bottom] = piece.bounds;
    let (first, end) = (band.first_row as f64, (band.first_row + band.rows) as f64);
    if bottom < first - 0.5 || top > end - 0.5 {
        return;
    }
    let rows = (top - 0.5).ceil().max(first) as usize..((bottom + 0.5).floor() + 1.0).min(end) as usize;
    for v in rows {
        draw_row(band, views, piece, v);
    }
}

fn draw_row(band: &mut Band, views: &[FacetView], piece: &Piece, v: usize) {
    /// Far more than the rounding of an edge, far less than a sample's distance from a pixel's border.
    const SLACK_PX: f64 = 1e-6;
    /// So few pixels are tested faster than they are counted.
    const FEW_PX: f64 = 4.0;
    let [left, right, _, _] = piece.bounds;
    let last = (band.width - 1) as f64;
    if right - left < FEW_PX {
        if let Some((start, end)) = whole([(left - 0.5).max(0.0), (right + 0.5).min(last)]) {
            (start..end).for_each(|u| touch(band, views, piece, u, v));
        }
        return;
    }
    let (mut touched, mut filled) = ([(left - 0.5).max(0.0), (right + 0.5).min(last)], [0.0, last]);
    for edge in &piece.edges {
        let at_zero = edge.b * v as f64 + edge.c;
        narrow(&mut touched, edge.a, at_zero + edge.reach, SLACK_PX);
        narrow(&mut filled, edge.a, at_zero - edge.reach, -SLACK_PX);
    }
    let Some((start, end)) = whole(touched) else { return };
    let (fill_start, fill_end) = whole(filled).map_or((end, end), |(from, to)| (from.max(start), to.min(end)));
    let (fill_start, fill_end) = if fill_start < fill_end { (fill_start, fill_end) } else { (end, end) };
    for u in (start..fill_start).chain(fill_end..end) {
        touch(band, views, piece, u, v);
    }
    fill(band, views, piece.view, fill_start..fill_end, v);
}

/// Keeps the part of the span where `a u + c >= 0`, and `slack` more.
fn narrow(span: &mut [f64; 2], a: f64, c: f64, slack: f64) {
    if a > 0.0 {
        span[0] = span[0].max(-c / a - slack);
    } else if a < 0.0 {
        span[1] = span[1].min(-c / a + slack);
    } else if c < 0.0 {
        *span = [1.0, 0.0];
    }
}

/// The whole numbers of a span, as start and end.
fn whole([low, high]: [f64; 2]) -> Option<(usize, usize)> {
    let (start, end) = (low.max(0.0).ceil(), high.floor() + 1.0);
    (start < end).then_some((start as usize, end as usize))
}

fn touch(band: &mut Band, views: &[FacetView], piece: &Piece, u: usize, v: usize) {
    let pixel = (v - band.first_row) * band.width + u;
    let (column, row) = (u as f64, v as f64);
    let view = &views[piece.view as usize];
    let holder = band.views[pixel];
    if holder != NONE {
        let near = view.inverse_depth_at(column, row) as f32;
        if near + view.reach < band.near[pixel] - views[holder as usize].reach {
            return;
        }
    }
    let mut mask = FULL;
    for edge in &piece.edges {
        mask &= edge.mask(column, row);
        if mask == 0 {
            return;
        }
    }
    band.share(pixel, piece.view, mask);
}

impl Edge {
    /// The samples on the inside, and the centre.
    fn mask(&self, u: f64, v: f64) -> u32 {
        let at_center = self.a * u + self.b * v + self.c;
        if at_center >= self.reach {
            return FULL;
        } else if at_center <= -self.reach {
            return 0;
        }
        let (value, a, b) = (at_center as f32, self.a as f32, self.b as f32);
        let mut mask = 0;
        for index in 0..SAMPLES {
            let at_sample = value + (a * SAMPLE_U[index] + b * SAMPLE_V[index]);
            let inside = if self.closed { at_sample >= 0.0 } else { at_sample > 0.0 };
            mask |= u32::from(inside) << index;
        }
        let inside = if self.closed { at_center >= 0.0 } else { at_center > 0.0 };
        mask | (u32::from(inside) << SAMPLES)
    }
}

fn fill(band: &mut Band, views: &[FacetView], view: u32, columns: std::ops::Range<usize>, v: usize) {
    let facet = &views[view as usize];
    let [per_u, per_v, at_zero] = facet.inverse_depth;
    let at_row = per_v * v as f64 + at_zero;
    let first_pixel = (v - band.first_row) * band.width;
    for u in columns {
        let pixel = first_pixel + u;
        let near = (per_u * u as f64 + at_row) as f32;
        let holder = band.views[pixel];
        let apart = near - band.near[pixel];
        let reach = if holder == NONE { 0.0 } else { facet.reach + views[holder as usize].reach };
        // Within a few roundings of each other, or crossing inside the pixel: to be decided sample by sample.
        if holder != NONE && apart.abs() <= reach + 1e-6 * near.abs() {
            let behind = if apart > 0.0 { holder } else { view };
            band.share(pixel, behind, FULL);
        }
        if apart > 0.0 || holder == NONE {
            band.near[pixel] = near;
            band.views[pixel] = view;
        }
    }
}
