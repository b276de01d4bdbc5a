//! Pictures to servo on, and pictures to stumble over.

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat};
use domvs_proto::settings::{Camera, TaskSettings};
use serde_json::{Value, json};

/// Pixels along each side, where nothing else is said.
pub const SIDE: u32 = 32;

/// A frame as it leaves a camera.
#[derive(Clone, Debug)]
pub struct Shot {
    pub header: FrameHeader,
    pub payload: Vec<u8>,
}

impl Shot {
    /// 8-bit gray of a square image.
    pub fn mono8(gray: impl Fn(f64, f64) -> f64) -> Shot {
        let pixel = |index: u32| gray(f64::from(index % SIDE), f64::from(index / SIDE)).clamp(0.0, 255.0) as u8;
        let payload = (0..SIDE * SIDE).map(pixel).collect();
        Shot { header: FrameHeader::new(PixelFormat::Mono8, SIDE, SIDE), payload }
    }

    /// The same with a depth plane in metres.
    pub fn with_depth(mut self, metres: impl Fn(usize) -> f32) -> Shot {
        self.header.depth_format = DepthFormat::F32;
        self.header.depth_unit_m = 1.0;
        self.header.depth_offset = self.payload.len() as u32;
        let pixels = self.payload.len();
        self.payload.extend((0..pixels).flat_map(|pixel| metres(pixel).to_le_bytes()));
        self
    }

    /// The same, numbered and with a time of the camera's clock.
    pub fn numbered(mut self, sequence: u64, capture_time_ns: u64) -> Shot {
        (self.header.sequence, self.header.capture_time_ns) = (sequence, capture_time_ns);
        self
    }

    /// Mean squared difference of two 8-bit pictures, gray in [0, 1].
    pub fn pixel_mse(&self, other: &Shot) -> f64 {
        let squares = self.payload.iter().zip(&other.payload).map(|(a, b)| {
            let difference = (f64::from(*a) - f64::from(*b)) / 255.0;
            difference * difference
        });
        squares.sum::<f64>() / self.payload.len() as f64
    }
}

/// Three soft spots on a slope, shifted to the right by so many pixels: all six degrees show.
pub fn scene(shift_px: f64) -> Shot {
    let spots = [(9.0, 10.0, 30.0, 150.0), (22.0, 8.0, 12.0, 120.0), (17.0, 23.0, 40.0, 170.0)];
    Shot::mono8(|u, v| {
        let spot = |&(x, y, width, height): &(f64, f64, f64, f64)| {
            height * (-((u - shift_px - x).powi(2) + (v - y).powi(2)) / width).exp()
        };
        spots.iter().map(spot).sum::<f64>() + u - shift_px + 0.5 * v
    })
}

/// One gray everywhere.
pub fn flat(gray: f64) -> Shot {
    Shot::mono8(|_, _| gray)
}

/// Nothing but rows: no motion to the side shows.
pub fn stripes() -> Shot {
    Shot::mono8(|_, v| 120.0 + 100.0 * (0.5 * v).sin())
}

/// Settings for these pictures, changed by a patch.
pub fn settings(patch: Value) -> TaskSettings {
    let centre = (f64::from(SIDE) - 1.0) / 2.0;
    let camera = Camera { fx: 30.0, fy: 30.0, cx: centre, cy: centre, width: SIDE, height: SIDE, distortion: None };
    let base =
        TaskSettings::new(camera).merge_patch(&json!({ "frames": "pushed", "order": 8 })).expect("fine settings");
    base.merge_patch(&patch).unwrap_or_else(|error| panic!("{error}: {patch}"))
}
