//! The depth plane of a frame, converted row by row where it is used: a task whose depth is a constant never reads it.

use domvs_proto::frame::{DepthFormat, FrameHeader};
use domvs_vision::Plane;
use fearless_simd::{Level, dispatch};

use super::gray::convert;
use crate::payload::Payload;

/// Depths as they came, of the image's size; 0, negative and not finite mean unknown.
#[derive(Debug)]
pub struct DepthRows<'a> {
    pub(super) payload: Payload<'a>,
    /// Where the plane starts in the payload; it was found to reach to its end.
    pub(super) offset: usize,
    pub(super) format: DepthFormat,
    pub(super) unit_m: f32,
    pub(super) size: [usize; 2],
    pub(super) seam: &'a mut Vec<u8>,
}

impl<'a> DepthRows<'a> {
    /// The plane that this header announces, in a payload that it tells the truth about.
    pub(super) fn new(
        header: &FrameHeader,
        payload: Payload<'a>,
        offset: usize,
        seam: &'a mut Vec<u8>,
    ) -> DepthRows<'a> {
        let size = [header.width as usize, header.height as usize];
        seam.reserve(size[0] * header.depth_format.bytes_per_pixel() as usize);
        DepthRows { payload, offset, format: header.depth_format, unit_m: header.depth_unit_m, size, seam }
    }

    /// `[width, height]`.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Writes one row after the other in metres, from the top: `depth = count · depth_unit_m`; what the sender marked as unknown stays so.
    pub fn rows(self) -> impl FnMut(&mut [f32]) {
        let DepthRows { payload, offset, format, unit_m, size, seam } = self;
        let row_bytes = size[0] * format.bytes_per_pixel() as usize;
        let mut reader = payload.reader();
        reader.skip(offset);
        let level = Level::new();
        move |metres| {
            let row = reader.take(row_bytes, seam);
            dispatch!(level, _ => match format {
                DepthFormat::None => {}
                DepthFormat::U16 => convert(metres, row, |count| f32::from(u16::from_le_bytes(*count)) * unit_m),
                DepthFormat::F32 => convert(metres, row, |count| f32::from_le_bytes(*count) * unit_m),
            });
        }
    }

    /// All rows as a plane, for those who want to look at it.
    pub fn to_plane(self) -> Plane<f32> {
        let [width, height] = self.size;
        let mut plane = Plane::filled(width, height, 0.0);
        plane.samples_mut().chunks_exact_mut(width).for_each(self.rows());
        plane
    }
}
