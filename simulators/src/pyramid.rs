//! A texture in octaves: level `k` holds the means of `2^k x 2^k` texels, so that a far plane is not aliased.
//!
//! Texel `(i, j)` of the picture covers `[i, i+1) x [j, j+1)`. What lies outside the picture is said by [`Wrap`]: black in
//! every level, so the border is as soft as the level is coarse; or the nearest texel; or the picture again.

use domvs_vision::Plane;

/// What lies outside a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wrap {
    /// Black.
    Black,
    /// The nearest texel of the border.
    Nearest,
    /// The picture again and again; its sides should be powers of two, or the seams blur.
    Repeat,
}

/// The octaves of a gray picture; sampled with continuous coordinates and a continuous level.
#[derive(Clone, Debug)]
pub(crate) struct Pyramid {
    levels: Vec<Level>,
    wrap: Wrap,
    size: [f32; 2],
}

/// One octave, with one texel of what lies outside around it: bilinear reads need no test at the border.
#[derive(Clone, Debug)]
struct Level {
    width: usize,
    height: usize,
    texels_per_base: f32,
    padded: Vec<f32>,
}

impl Pyramid {
    pub(crate) fn new(picture: &Plane<f32>, wrap: Wrap) -> Pyramid {
        let mut octave = picture.clone();
        let mut levels = vec![Level::new(&octave, 1.0, wrap)];
        while octave.width() > 1 || octave.height() > 1 {
            octave = halved(&octave, wrap);
            levels.push(Level::new(&octave, 0.5_f32.powi(levels.len() as i32), wrap));
        }
        Pyramid { levels, wrap, size: [picture.width() as f32, picture.height() as f32] }
    }

    /// Whether it hangs on a wall: seen from the front only.
    pub(crate) fn is_one_sided(&self) -> bool {
        self.wrap == Wrap::Black
    }

    /// The two levels on either side of `log2_texels` and how far towards the second: for texels of about
    /// `2^log2_texels` texels of the picture.
    pub(crate) fn octaves(&self, log2_texels: f32) -> Octaves<'_> {
        let last = self.levels.len() - 1;
        let at = log2_texels.clamp(0.0, last as f32);
        let fine = at as usize;
        let (fine_level, coarse_level) = (&self.levels[fine], &self.levels[(fine + 1).min(last)]);
        Octaves { pyramid: self, fine: fine_level, coarse: coarse_level, blend: at - fine as f32 }
    }
}

/// Where a sample is read: between two levels.
pub(crate) struct Octaves<'a> {
    pyramid: &'a Pyramid,
    fine: &'a Level,
    coarse: &'a Level,
    blend: f32,
}

impl Octaves<'_> {
    /// Gray at `(s, t)` in texels of the picture, linear within and between the levels.
    #[inline]
    pub(crate) fn sample(&self, s: f32, t: f32) -> f32 {
        let [width, height] = self.pyramid.size;
        let (s, t) = match self.pyramid.wrap {
            Wrap::Black => (s, t),
            Wrap::Nearest => (s.clamp(0.0, width), t.clamp(0.0, height)),
            Wrap::Repeat => (s.rem_euclid(width), t.rem_euclid(height)),
        };
        let fine = self.fine.sample(s, t);
        if self.blend == 0.0 {
            return fine;
        }
        fine + self.blend * (self.coarse.sample(s, t) - fine)
    }
}

impl Level {
    fn new(octave: &Plane<f32>, texels_per_base: f32, wrap: Wrap) -> Level {
        let (width, height) = (octave.width(), octave.height());
        let padded = (0..(width + 2) * (height + 2))
            .map(|k| outside(octave, wrap, (k % (width + 2)) as isize - 1, (k / (width + 2)) as isize - 1));
        Level { width, height, texels_per_base, padded: padded.collect() }
    }

    #[inline]
    fn sample(&self, s: f32, t: f32) -> f32 {
        // Texel centres sit at halves; the padding moves them by one.
        let (x, y) = (s * self.texels_per_base + 0.5, t * self.texels_per_base + 0.5);
        let inside = x >= 0.0 && y >= 0.0 && x < (self.width + 1) as f32 && y < (self.height + 1) as f32;
        if !inside {
            return 0.0;
        }
        // Sides are far below 2^31; an `i32` is quicker made of an `f32`, and back, than an `usize`.
        let (i, j) = (x as i32, y as i32);
        let (right, down) = (x - i as f32, y - j as f32);
        let corner = j as usize * (self.width + 2) + i as usize;
        let four = &self.padded[corner..corner + self.width + 4];
        let (top, bottom) = (&four[..2], &four[self.width + 2..]);
        let above = top[0] + right * (top[1] - top[0]);
        let below = bottom[0] + right * (bottom[1] - bottom[0]);
        above + down * (below - above)
    }
}

/// Means of 2x2 texels; what is missing at an odd border is what lies outside.
fn halved(octave: &Plane<f32>, wrap: Wrap) -> Plane<f32> {
    let texel = |u: usize, v: usize| outside(octave, wrap, u as isize, v as isize);
    Plane::from_fn(octave.width().div_ceil(2), octave.height().div_ceil(2), |u, v| {
        let (u, v) = (2 * u, 2 * v);
        (texel(u, v) + texel(u + 1, v) + texel(u, v + 1) + texel(u + 1, v + 1)) / 4.0
    })
}

/// The texel at any place, inside or outside the picture.
fn outside(octave: &Plane<f32>, wrap: Wrap, u: isize, v: isize) -> f32 {
    let (width, height) = (octave.width() as isize, octave.height() as isize);
    let inside = (0..width).contains(&u) && (0..height).contains(&v);
    let (u, v) = match wrap {
        Wrap::Black if !inside => return 0.0,
        Wrap::Repeat => (u.rem_euclid(width), v.rem_euclid(height)),
        _ => (u.clamp(0, width - 1), v.clamp(0, height - 1)),
    };
    octave.at(u as usize, v as usize)
}
