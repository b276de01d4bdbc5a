//! Renderings and image files as frames to send.

use std::path::Path;

use anyhow::{Context, bail};
use domvs_client::{DepthPlane, ImageFile, OutgoingFrame, PixelFormat};
use domvs_simulators::{Rendering, mono8};

/// A rendering as 8-bit gray with its depth in metres.
///
/// # Errors
/// Fails when the two planes differ in size.
pub fn outgoing(rendering: &Rendering, sequence: u64, capture_time_ns: u64) -> anyhow::Result<OutgoingFrame> {
    let (width, height) = (rendering.image.width() as u32, rendering.image.height() as u32);
    let depth = DepthPlane::Metres(rendering.depth.samples());
    let frame = OutgoingFrame::raw_with_depth(PixelFormat::Mono8, width, height, mono8(&rendering.image), depth)?;
    Ok(frame.numbered(sequence, capture_time_ns))
}

/// A PNG or JPEG file as it is, with the depth of a file of [`crate::files::read_depth`] if there is one.
///
/// # Errors
/// Fails, naming the file, when it cannot be read or is neither PNG nor JPEG.
pub fn image_file(path: &Path, depth: Option<(&Path, f64)>) -> anyhow::Result<OutgoingFrame> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let kind = match bytes.as_slice() {
        [0x89, b'P', b'N', b'G', ..] => ImageFile::Png,
        [0xff, 0xd8, 0xff, ..] => ImageFile::Jpeg,
        _ => bail!("{} is neither PNG nor JPEG", path.display()),
    };
    let Some((depth_path, unit_m)) = depth else {
        return Ok(OutgoingFrame::file(kind, bytes)?);
    };
    let depth = crate::files::read_depth(depth_path, unit_m)?.metres;
    let metres: Vec<f32> = depth.samples().iter().map(|&z| z as f32).collect();
    let (width, height) = (depth.width() as u32, depth.height() as u32);
    Ok(OutgoingFrame::file_with_depth(kind, bytes, width, height, DepthPlane::Metres(&metres))?)
}
