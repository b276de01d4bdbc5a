//! Pictures in every format, moving a little from one to the next.

use domvs_proto::frame::{DepthFormat, FrameHeader, PixelFormat};
use domvs_proto::settings::{Camera, Depth, Holes, TaskSettings};
use zenoh::bytes::ZBytes;

/// What a network packet carries at most.
const PACKET_BYTES: usize = 65_000;

/// Settings for pictures of this size under which a servoing never ends.
pub fn settings(width: u32, height: u32) -> TaskSettings {
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    let camera = Camera { fx: 500.0, fy: 500.0, cx, cy, width, height, distortion: None };
    let mut settings = TaskSettings::new(camera);
    (settings.stop.step_m, settings.stop.step_rad) = (1e-9, 1e-9);
    settings.depth = Depth::Map { fallback_m: None, holes: Holes::Fill };
    settings
}

/// A picture whose pattern has moved `number` steps: its header and its bytes, in packets.
pub fn picture(
    format: PixelFormat,
    depth: DepthFormat,
    [width, height]: [u32; 2],
    number: u64,
) -> (FrameHeader, ZBytes) {
    let mut header = FrameHeader { sequence: number, ..FrameHeader::new(format, width, height) };
    let rows = if format == PixelFormat::Nv12 { height + height / 2 } else { height };
    let mut bytes = Vec::new();
    for v in 0..rows {
        for u in 0..width {
            pixel(format, gray(u, v, number), &mut bytes);
        }
    }
    if depth != DepthFormat::None {
        header = FrameHeader { depth_format: depth, depth_offset: bytes.len() as u32, depth_unit_m: 0.001, ..header };
        for at in 0..width * height {
            // Every 23rd is a hole.
            let count = if at % 23 == 0 { 0 } else { 900 + (at % width) as u16 };
            match depth {
                DepthFormat::F32 => bytes.extend(f32::from(count).to_le_bytes()),
                _ => bytes.extend(count.to_le_bytes()),
            }
        }
    }
    (header, in_packets(&bytes))
}

/// Bytes as the network brings them.
pub fn in_packets(bytes: &[u8]) -> ZBytes {
    let mut writer = ZBytes::writer();
    bytes.chunks(PACKET_BYTES).for_each(|packet| writer.append(packet.into()));
    writer.finish()
}

/// From 0 to 1.
pub fn gray(u: u32, v: u32, number: u64) -> f64 {
    let (x, y) = (f64::from(u) - 1.5 * number as f64, f64::from(v));
    0.5 + 0.3 * (x / 11.0).sin() * (y / 9.0).cos() + 0.15 * ((0.6 * x + y) / 17.0).sin()
}

fn pixel(format: PixelFormat, gray: f64, bytes: &mut Vec<u8>) {
    let level = (255.0 * gray) as u8;
    match format {
        PixelFormat::Mono8 | PixelFormat::Nv12 => bytes.push(level),
        PixelFormat::Yuyv => bytes.extend([level, 128]),
        PixelFormat::Rgb8 | PixelFormat::Bgr8 => bytes.extend([level; 3]),
        PixelFormat::Rgba8 | PixelFormat::Bgra8 => bytes.extend([level, level, level, 255]),
        PixelFormat::Mono16 => bytes.extend(((65_535.0 * gray) as u16).to_le_bytes()),
        PixelFormat::Mono32F => bytes.extend((gray as f32).to_le_bytes()),
        PixelFormat::ByEncoding => {}
    }
}
