//! A rendering as the bytes of a frame: pixels, then depth, and the header that says what they are.

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat};
use domvs_vision::Plane;

use crate::scene::Rendering;

/// Metres per count of a 16-bit depth.
const DEPTH_UNIT_M: f32 = 0.001;

/// How gray in [0, 1] is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelPacking {
    /// 8 bits, rounded: what cameras do.
    #[default]
    Mono8,
    /// 32-bit float, as it is.
    Mono32f,
}

/// How depth in m is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthPacking {
    /// Not at all.
    None,
    /// 16 bits of millimetres, rounded; beyond 65.535 m it is unknown.
    U16,
    /// 32-bit float metres.
    #[default]
    F32,
}

/// A frame's header (tight rows, no deadline, no secret) and payload.
pub fn pack(
    rendering: &Rendering,
    pixels: PixelPacking,
    depth: DepthPacking,
    sequence: u64,
    capture_time_ns: u64,
) -> (FrameHeader, Vec<u8>) {
    let Rendering { image, depth: metres, .. } = rendering;
    let (pixel_format, mut payload) = match pixels {
        PixelPacking::Mono8 => (PixelFormat::Mono8, mono8(image)),
        PixelPacking::Mono32f => (PixelFormat::Mono32F, little_endian(image.samples(), |gray| gray.to_le_bytes())),
    };
    let depth_offset = payload.len();
    let depth_format = match depth {
        DepthPacking::None => DepthFormat::None,
        DepthPacking::U16 => {
            payload.extend(little_endian(metres.samples(), |z| millimetres(z).to_le_bytes()));
            DepthFormat::U16
        }
        DepthPacking::F32 => {
            payload.extend(little_endian(metres.samples(), |z| z.to_le_bytes()));
            DepthFormat::F32
        }
    };
    let header = FrameHeader {
        depth_format,
        depth_offset: if depth_format == DepthFormat::None { 0 } else { depth_offset as u32 },
        depth_unit_m: if depth_format == DepthFormat::U16 { DEPTH_UNIT_M } else { 1.0 },
        sequence,
        capture_time_ns,
        ..FrameHeader::new(pixel_format, image.width() as u32, image.height() as u32)
    };
    (header, payload)
}

/// Gray in [0, 1] to 8 bits, rounded; what lies outside is clipped.
pub fn mono8(image: &Plane<f32>) -> Vec<u8> {
    image.samples().iter().map(|gray| (gray * 255.0).round() as u8).collect()
}

/// Whole millimetres; 0, unknown, when there are more than 16 bits hold.
fn millimetres(depth_m: f32) -> u16 {
    let counts = (depth_m / DEPTH_UNIT_M).round();
    if counts <= f32::from(u16::MAX) { counts as u16 } else { 0 }
}

fn little_endian<const BYTES: usize>(samples: &[f32], bytes: impl Fn(f32) -> [u8; BYTES]) -> Vec<u8> {
    samples.iter().flat_map(|&sample| bytes(sample)).collect()
}
