//! Light that is not that of the desired image: `I' = gain · slope(u, v) · (1 + spot(u, v)) · I + offset`, in [0, 1].

use domvs_vision::Plane;

/// A light; the default changes nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// The first image it falls on, from 0.
    pub from_image: u64,
    /// Factor of the gray.
    pub gain: f64,
    /// Added to the gray of [0, 1].
    pub offset: f64,
    /// A factor that changes along a line across the image.
    pub slope: Option<Slope>,
    /// A lamp that lights one place.
    pub spot: Option<Spot>,
}

/// A factor that grows along a direction, linearly, over the whole image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// The factor where it begins.
    pub from: f64,
    /// The factor where it ends.
    pub to: f64,
    /// The direction: 0 is along u, 90 along v, deg.
    pub angle_deg: f64,
}

/// `brightness · exp(-r² / 2 radius²)`, with r the distance from the centre, in widths of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Its centre: parts of the width and the height, from the upper left corner.
    pub center: [f64; 2],
    /// Its standard deviation, as a part of the width.
    pub radius: f64,
    /// By what part the gray at its centre grows.
    pub brightness: f64,
}

impl Default for Light {
    fn default() -> Self {
        Light { from_image: 0, gain: 1.0, offset: 0.0, slope: None, spot: None }
    }
}

impl Light {
    /// Lights a picture; clips to [0, 1] unless nothing changes.
    pub fn shine(&self, image: &mut Plane<f32>) {
        if (Light { from_image: 0, ..self.clone() }) == Light::default() {
            return;
        }
        let (width, height) = (image.width(), image.height());
        let (gain, offset) = (self.gain as f32, self.offset as f32);
        for (v, row) in image.samples_mut().chunks_mut(width).enumerate() {
            for (u, gray) in row.iter_mut().enumerate() {
                let factor = gain * self.factor(u, v, width, height);
                *gray = (factor * *gray + offset).clamp(0.0, 1.0);
            }
        }
    }

    fn factor(&self, u: usize, v: usize, width: usize, height: usize) -> f32 {
        let slope = self.slope.map_or(1.0, |slope| slope.at(u, v, width, height));
        let spot = self.spot.map_or(0.0, |spot| spot.at(u, v, width, height));
        (slope * (1.0 + spot)) as f32
    }
}

impl Slope {
    fn at(&self, u: usize, v: usize, width: usize, height: usize) -> f64 {
        let (sin, cos) = self.angle_deg.to_radians().sin_cos();
        let (half_u, half_v) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        let half = half_u * cos.abs() + half_v * sin.abs();
        let along = (u as f64 - half_u) * cos + (v as f64 - half_v) * sin;
        let part = if half > 0.0 { 0.5 + 0.5 * along / half } else { 0.5 };
        self.from + (self.to - self.from) * part
    }
}

impl Spot {
    fn at(&self, u: usize, v: usize, width: usize, height: usize) -> f64 {
        let right = (u as f64 + 0.5) / width as f64 - self.center[0];
        let down = ((v as f64 + 0.5) - self.center[1] * height as f64) / width as f64;
        self.brightness * (-(right * right + down * down) / (2.0 * self.radius * self.radius)).exp()
    }
}
