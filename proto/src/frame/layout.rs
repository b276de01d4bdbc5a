//! Where pixels and depth lie in a payload, after every length in the header was checked against it.
//!
//! A payload has no byte too few and none too many: trailing bytes are refused. Between the pixels and the depth
//! plane there may be a gap, for alignment; it is skipped.

use std::ops::Range;

use super::{DepthFormat, FrameError, FrameHeader, PixelFormat};

/// Byte ranges of a payload that the header was found to tell the truth about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameLayout {
    /// The pixels: for raw formats `row_bytes` × rows (NV12: and half as many rows of U and V), else the PNG or JPEG.
    pub pixels: Range<usize>,
    /// Bytes from one row to the next, never less than a tight row; 0 for PNG and JPEG.
    pub row_bytes: usize,
    /// The tight depth plane, of the image's size; `None` without depth.
    pub depth: Option<Range<usize>>,
}

impl FrameHeader {
    /// Where things lie in a payload of `payload_len` bytes. Fails when the header and the payload disagree
    /// in any way; cannot overflow. The size of a decoded PNG or JPEG must be compared with the header's by the caller.
    pub fn layout(&self, payload_len: usize) -> Result<FrameLayout, FrameError> {
        let payload_bytes = payload_len as u64;
        self.check_size()?;
        let row_bytes = self.row_bytes_in_use()?;
        let depth_bytes = self.depth_bytes()?;
        let pixel_bytes = match self.pixel_format {
            PixelFormat::ByEncoding if depth_bytes.is_some() => u64::from(self.depth_offset),
            PixelFormat::ByEncoding => payload_bytes,
            _ => row_bytes.checked_mul(self.rows()).ok_or_else(|| self.too_large())?,
        };
        let end = match depth_bytes {
            None if self.depth_offset != 0 => return Err(self.bad_depth_offset(0)),
            None => pixel_bytes,
            Some(_) if u64::from(self.depth_offset) < pixel_bytes => {
                return Err(self.bad_depth_offset(pixel_bytes));
            }
            Some(depth_bytes) => {
                u64::from(self.depth_offset).checked_add(depth_bytes).ok_or_else(|| self.too_large())?
            }
        };
        if end != payload_bytes {
            return Err(FrameError::PayloadLength { expected: end, got: payload_bytes });
        }
        if pixel_bytes == 0 {
            return Err(FrameError::EmptyPayload);
        }
        // Everything is at most payload_len from here on, so the conversions keep their values.
        Ok(FrameLayout {
            pixels: 0..pixel_bytes as usize,
            row_bytes: row_bytes as usize,
            depth: depth_bytes.map(|_| self.depth_offset as usize..payload_len),
        })
    }

    fn check_size(&self) -> Result<(), FrameError> {
        let (width, height) = (self.width, self.height);
        let encoded = self.pixel_format == PixelFormat::ByEncoding;
        let unsaid = encoded && self.depth_format == DepthFormat::None && width == 0 && height == 0;
        if (width == 0 || height == 0) && !unsaid {
            return Err(FrameError::EmptyImage { width, height });
        }
        let odd = match self.pixel_format {
            PixelFormat::Yuyv => width % 2 != 0,
            PixelFormat::Nv12 => width % 2 != 0 || height % 2 != 0,
            _ => false,
        };
        if odd {
            return Err(FrameError::OddSize { pixel_format: self.pixel_format, width, height });
        }
        Ok(())
    }

    fn row_bytes_in_use(&self) -> Result<u64, FrameError> {
        let tight = u64::from(self.width) * u64::from(self.pixel_format.bytes_per_pixel());
        let encoded = self.pixel_format == PixelFormat::ByEncoding;
        match u64::from(self.row_bytes) {
            0 if tight <= u64::from(u32::MAX) => Ok(tight),
            0 => Err(self.too_large()),
            given if given < tight || encoded => Err(FrameError::RowBytes { expected: tight, got: self.row_bytes }),
            given => Ok(given),
        }
    }

    fn depth_bytes(&self) -> Result<Option<u64>, FrameError> {
        if self.depth_format == DepthFormat::None {
            return Ok(None);
        }
        if !(self.depth_unit_m.is_finite() && self.depth_unit_m > 0.0) {
            return Err(FrameError::DepthUnit { got: self.depth_unit_m });
        }
        let pixels = u64::from(self.width) * u64::from(self.height);
        let bytes = pixels.checked_mul(u64::from(self.depth_format.bytes_per_pixel()));
        bytes.map(Some).ok_or_else(|| self.too_large())
    }

    /// Rows of `row_bytes` in all planes of pixels: NV12 has half as many again for U and V.
    fn rows(&self) -> u64 {
        let height = u64::from(self.height);
        match self.pixel_format {
            PixelFormat::Nv12 => height + height / 2,
            _ => height,
        }
    }

    fn too_large(&self) -> FrameError {
        FrameError::TooLarge { width: self.width, height: self.height }
    }

    fn bad_depth_offset(&self, expected: u64) -> FrameError {
        FrameError::DepthOffset { expected, got: self.depth_offset }
    }
}
