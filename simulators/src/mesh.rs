//! Triangles in a frame of their own: planes, boxes, balls, cylinders, height fields, and whatever a file holds.
//!
//! Lengths are m. A texture's place is `(s, t)`, `(0, 0)` its upper left and `(1, 1)` its lower right corner. The shapes
//! made here are centred on their frame's origin and are seen upright by a camera whose x and y axes are theirs.

use std::f64::consts::{PI, TAU};

use domvs_vision::Plane;
use nalgebra::{Isometry3, Point3};

/// Corners about a ball or a cylinder.
const ROUND: usize = 32;

/// Triangles with texture coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Corners, m.
    pub positions: Vec<Point3<f64>>,
    /// Where each corner is on the texture.
    pub texture_places: Vec<[f64; 2]>,
    /// Three corners each; both sides are seen.
    pub triangles: Vec<[u32; 3]>,
    /// Whether the triangles bound a convex body with their normals `(b - a) x (c - a)` outwards: then no more is drawn
    /// of it from outside than its front.
    pub convex: bool,
}

impl Mesh {
    /// A rectangle in the plane z = 0, seen upright from -z.
    pub fn plane([width_m, height_m]: [f64; 2]) -> Mesh {
        let mut mesh = Mesh::empty(false);
        mesh.add_quad([
            ([-width_m / 2.0, -height_m / 2.0, 0.0], [0.0, 0.0]),
            ([width_m / 2.0, -height_m / 2.0, 0.0], [1.0, 0.0]),
            ([width_m / 2.0, height_m / 2.0, 0.0], [1.0, 1.0]),
            ([-width_m / 2.0, height_m / 2.0, 0.0], [0.0, 1.0]),
        ]);
        mesh
    }

    /// A box, with the whole texture on each of its six faces, upright to a camera that looks at the face.
    pub fn cuboid([width_m, height_m, depth_m]: [f64; 3]) -> Mesh {
        /// Right and down on each face; outwards is down x right.
        const FACES: [[[f64; 3]; 2]; 6] = [
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
            [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
            [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
            [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        ];
        let half = [width_m / 2.0, height_m / 2.0, depth_m / 2.0];
        let mut mesh = Mesh::empty(true);
        for [right, down] in FACES {
            let out = cross(down, right);
            let corner = |s: f64, t: f64| {
                let at = |k: usize| half[k] * (out[k] + (2.0 * s - 1.0) * right[k] + (2.0 * t - 1.0) * down[k]);
                ([at(0), at(1), at(2)], [s, t])
            };
            mesh.add_quad([corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)]);
        }
        mesh
    }

    /// A ball or an ellipsoid with these diameters, the texture once around it, its poles on the z axis.
    pub fn ellipsoid(diameters_m: [f64; 3]) -> Mesh {
        let mut mesh = Mesh::empty(true);
        mesh.add_grid([ROUND, ROUND / 2], |i, j| {
            // The poles are one point each, not a circle of 1e-16.
            let sin = if j == 0 || j == ROUND / 2 { 0.0 } else { (PI * j as f64 / (ROUND / 2) as f64).sin() };
            let cos = (PI * j as f64 / (ROUND / 2) as f64).cos();
            let [x, y] = around(i);
            let at = [sin * x, sin * y, -cos];
            [0, 1, 2].map(|axis| at[axis] * diameters_m[axis] / 2.0)
        });
        mesh
    }

    /// An upright cylinder along z with these diameters and height, the texture once around it and once on each end.
    pub fn cylinder([width_m, depth_m, height_m]: [f64; 3]) -> Mesh {
        let mut mesh = Mesh::empty(true);
        let ring = |i: usize, z_m: f64| {
            let [x, y] = around(i);
            [x * width_m / 2.0, y * depth_m / 2.0, z_m]
        };
        mesh.add_grid([ROUND, 1], |i, j| ring(i, (j as f64 - 0.5) * height_m));
        for (z_m, turned) in [(-height_m / 2.0, false), (height_m / 2.0, true)] {
            let middle = mesh.positions.len() as u32;
            mesh.add_corner([0.0, 0.0, z_m], [0.5, 0.5]);
            for i in 0..ROUND {
                let [x, y] = around(i);
                let s = if turned { -x } else { x };
                mesh.add_corner(ring(i, z_m), [0.5 + s / 2.0, 0.5 + y / 2.0]);
            }
            for i in 0..ROUND as u32 {
                let (one, other) = (middle + 1 + i, middle + 1 + (i + 1) % ROUND as u32);
                mesh.triangles.push(if turned { [middle, other, one] } else { [middle, one, other] });
            }
        }
        mesh
    }

    /// A rectangle of `cells` x `cells` squares, each of two triangles, raised towards -z by `rise_m` times the gray of
    /// `heights`, which lies on it like its texture.
    pub fn height_field([width_m, height_m, rise_m]: [f64; 3], heights: &Plane<f32>, cells: usize) -> Mesh {
        let cells = cells.max(1);
        let mut mesh = Mesh::empty(false);
        mesh.add_grid([cells, cells], |i, j| {
            let (s, t) = (i as f64 / cells as f64, j as f64 / cells as f64);
            [(s - 0.5) * width_m, (t - 0.5) * height_m, -rise_m * linear(heights, s, t)]
        });
        mesh
    }

    /// Moved rigidly.
    pub fn placed(mut self, pose: &Isometry3<f64>) -> Mesh {
        self.positions.iter_mut().for_each(|position| *position = pose * *position);
        self
    }

    fn empty(convex: bool) -> Mesh {
        Mesh { positions: vec![], texture_places: vec![], triangles: vec![], convex }
    }

    /// `columns` x `rows` quads with the texture over all of them; `corner(i, j)` is the one `i` to the right and `j` down
    /// as seen from outside.
    fn add_grid(&mut self, [columns, rows]: [usize; 2], corner: impl Fn(usize, usize) -> [f64; 3]) {
        let first = self.positions.len();
        for (i, j) in (0..=rows).flat_map(|j| (0..=columns).map(move |i| (i, j))) {
            self.add_corner(corner(i, j), [i as f64 / columns as f64, j as f64 / rows as f64]);
        }
        for (i, j) in (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j))) {
            let left = (first + j * (columns + 1) + i) as u32;
            let below = left + columns as u32 + 1;
            self.triangles.push([left, below + 1, left + 1]);
            self.triangles.push([left, below, below + 1]);
        }
    }

    /// Upper left, upper right, lower right, lower left, as seen from outside.
    fn add_quad(&mut self, corners: [([f64; 3], [f64; 2]); 4]) {
        let first = self.positions.len() as u32;
        for (position, place) in corners {
            self.add_corner(position, place);
        }
        self.triangles.push([first, first + 2, first + 1]);
        self.triangles.push([first, first + 3, first + 2]);
    }

    fn add_corner(&mut self, position: [f64; 3], place: [f64; 2]) {
        self.positions.push(Point3::from(position));
        self.texture_places.push(place);
    }
}

/// Corner `i` of the unit circle, the last the same as the first bit for bit; to the right as seen from outside with z
/// down.
fn around(i: usize) -> [f64; 2] {
    let (sin, cos) = (-TAU * (i % ROUND) as f64 / ROUND as f64).sin_cos();
    [cos, sin]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The picture at `(s, t)` in [0, 1], joined by lines from pixel centre to pixel centre and level beyond them.
fn linear(picture: &Plane<f32>, s: f64, t: f64) -> f64 {
    let axis = |part: f64, size: usize| {
        let at = (part * size as f64 - 0.5).clamp(0.0, (size - 1) as f64);
        let low = (at as usize).min(size.saturating_sub(2));
        (low, (low + 1).min(size - 1), at - low as f64)
    };
    let (left, right, along) = axis(s, picture.width());
    let (top, bottom, down) = axis(t, picture.height());
    let row = |v: usize| {
        let (a, b) = (f64::from(picture.at(left, v)), f64::from(picture.at(right, v)));
        a + along * (b - a)
    };
    row(top) + down * (row(bottom) - row(top))
}
