//! Frame header: what the pixels in a payload are.
//!
//! `<BBBBIIIIfQQII`, 48 bytes, then 16 bytes of secret if flags bit 0 is set. `decode` checks what the header
//! says by itself; `layout` checks it against the payload, so that no length in it can lie.
//! The payload is never touched here: decoding pixels is the service's work.

mod error;
mod layout;
mod secret;

pub use error::FrameError;
pub use layout::FrameLayout;
pub use secret::{Secret, SecretError, SecretHash};

use crate::WIRE_VERSION;

/// Encoding of a PNG payload.
pub const PNG: &str = "image/png";
/// Encoding of a JPEG payload.
pub const JPEG: &str = "image/jpeg";
/// Encoding of a payload of raw pixels.
pub const RAW: &str = "application/octet-stream";

/// Bytes of a header without secret.
pub const HEADER_BYTES: usize = 48;
/// Bytes of a header with its secret.
pub const HEADER_AND_SECRET_BYTES: usize = HEADER_BYTES + Secret::BYTES;

/// Bit 0 of a header's flags: 16 bytes of secret follow.
pub const FLAG_SECRET: u8 = 1;

/// How the pixels are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PixelFormat {
    /// PNG or JPEG, as the Encoding says.
    ByEncoding = 0,
    /// 8-bit gray.
    Mono8 = 1,
    /// 16-bit gray, little-endian.
    Mono16 = 2,
    /// 8-bit R, G, B.
    Rgb8 = 3,
    /// 8-bit B, G, R.
    Bgr8 = 4,
    /// 8-bit R, G, B, A; A is ignored.
    Rgba8 = 5,
    /// 8-bit B, G, R, A; A is ignored.
    Bgra8 = 6,
    /// 32-bit float gray, little-endian, used as it is.
    Mono32F = 7,
    /// YUYV 4:2:2; Y is used.
    Yuyv = 8,
    /// NV12: a plane of Y, then one of interleaved U and V of half the height; Y is used.
    Nv12 = 9,
}

impl PixelFormat {
    /// Every format, in the order of the codes.
    pub const ALL: [PixelFormat; 10] = [
        PixelFormat::ByEncoding,
        PixelFormat::Mono8,
        PixelFormat::Mono16,
        PixelFormat::Rgb8,
        PixelFormat::Bgr8,
        PixelFormat::Rgba8,
        PixelFormat::Bgra8,
        PixelFormat::Mono32F,
        PixelFormat::Yuyv,
        PixelFormat::Nv12,
    ];

    /// The byte on the wire.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The format of a byte; `None` for an unknown one.
    pub fn from_code(code: u8) -> Option<PixelFormat> {
        PixelFormat::ALL.get(usize::from(code)).copied()
    }

    /// Bytes from one pixel to the next in a row of the first plane; 0 by Encoding.
    pub fn bytes_per_pixel(self) -> u32 {
        match self {
            PixelFormat::ByEncoding => 0,
            PixelFormat::Mono8 | PixelFormat::Nv12 => 1,
            PixelFormat::Mono16 | PixelFormat::Yuyv => 2,
            PixelFormat::Rgb8 | PixelFormat::Bgr8 => 3,
            PixelFormat::Rgba8 | PixelFormat::Bgra8 | PixelFormat::Mono32F => 4,
        }
    }
}

/// How the depth plane is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum DepthFormat {
    /// There is none.
    None = 0,
    /// 16-bit counts, little-endian.
    U16 = 1,
    /// 32-bit floats, little-endian.
    F32 = 2,
}

impl DepthFormat {
    /// Every format, in the order of the codes.
    pub const ALL: [DepthFormat; 3] = [DepthFormat::None, DepthFormat::U16, DepthFormat::F32];

    /// The byte on the wire.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The format of a byte; `None` for an unknown one.
    pub fn from_code(code: u8) -> Option<DepthFormat> {
        DepthFormat::ALL.get(usize::from(code)).copied()
    }

    /// Bytes of one depth.
    pub fn bytes_per_pixel(self) -> u32 {
        match self {
            DepthFormat::None => 0,
            DepthFormat::U16 => 2,
            DepthFormat::F32 => 4,
        }
    }
}

/// What a frame's payload holds. Version, flags and reserved bytes are the business of `encode` and `decode`.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameHeader {
    /// How the pixels are stored.
    pub pixel_format: PixelFormat,
    /// How the depth plane is stored.
    pub depth_format: DepthFormat,
    /// Pixels in a row; may be 0 for PNG and JPEG without depth.
    pub width: u32,
    /// Rows; may be 0 for PNG and JPEG without depth.
    pub height: u32,
    /// Bytes from one row to the next; 0 = tight.
    pub row_bytes: u32,
    /// Where the depth plane starts in the payload, bytes; 0 without depth.
    pub depth_offset: u32,
    /// Metres per count of depth (1.0 for metres); ignored without depth.
    pub depth_unit_m: f32,
    /// The sender's count, echoed in the twist.
    pub sequence: u64,
    /// The sender's clock at exposure, ns, echoed in the twist; 0 = unknown.
    pub capture_time_ns: u64,
    /// A twist later than this after receipt is of no use, µs; 0 = none.
    pub deadline_us: u32,
    /// Who may ask for twists; not needed on pushed frames.
    pub secret: Option<Secret>,
}

impl FrameHeader {
    /// A tight image without depth, number, time, deadline or secret: set what you have.
    pub fn new(pixel_format: PixelFormat, width: u32, height: u32) -> FrameHeader {
        FrameHeader {
            pixel_format,
            depth_format: DepthFormat::None,
            width,
            height,
            row_bytes: 0,
            depth_offset: 0,
            depth_unit_m: 0.0,
            sequence: 0,
            capture_time_ns: 0,
            deadline_us: 0,
            secret: None,
        }
    }

    /// The header as bytes: 48, or 64 with a secret.
    pub fn encode(&self) -> Vec<u8> {
        let flags = if self.secret.is_some() { FLAG_SECRET } else { 0 };
        let mut bytes = Vec::with_capacity(HEADER_AND_SECRET_BYTES);
        bytes.extend([WIRE_VERSION, self.pixel_format.code(), self.depth_format.code(), flags]);
        bytes.extend(self.width.to_le_bytes());
        bytes.extend(self.height.to_le_bytes());
        bytes.extend(self.row_bytes.to_le_bytes());
        bytes.extend(self.depth_offset.to_le_bytes());
        bytes.extend(self.depth_unit_m.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.capture_time_ns.to_le_bytes());
        bytes.extend(self.deadline_us.to_le_bytes());
        bytes.extend(0u32.to_le_bytes());
        if let Some(secret) = &self.secret {
            bytes.extend(secret.as_bytes());
        }
        bytes
    }

    /// Reads a header. Fails on another version, an unknown format or flag, a reserved byte in use,
    /// or a length that is not what the flags say. The payload is not looked at: see [`FrameHeader::layout`].
    pub fn decode(bytes: &[u8]) -> Result<FrameHeader, FrameError> {
        // The version first: a later version may have another length.
        let version = *bytes.first().ok_or(FrameError::HeaderLength { expected: HEADER_BYTES, got: 0 })?;
        if version != WIRE_VERSION {
            return Err(FrameError::WrongVersion { got: version });
        }
        let short = || FrameError::HeaderLength { expected: HEADER_BYTES, got: bytes.len() };
        let (fixed, rest) = bytes.split_first_chunk::<HEADER_BYTES>().ok_or_else(short)?;
        let secret = read_flags(fixed[3], rest)?;
        let word = |at: usize| u32::from_le_bytes(four(fixed, at));
        let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 4)) << 32;
        if word(44) != 0 {
            return Err(FrameError::ReservedInUse { got: word(44) });
        }
        Ok(FrameHeader {
            pixel_format: PixelFormat::from_code(fixed[1]).ok_or(FrameError::UnknownPixelFormat { got: fixed[1] })?,
            depth_format: DepthFormat::from_code(fixed[2]).ok_or(FrameError::UnknownDepthFormat { got: fixed[2] })?,
            width: word(4),
            height: word(8),
            row_bytes: word(12),
            depth_offset: word(16),
            depth_unit_m: f32::from_le_bytes(four(fixed, 20)),
            sequence: long(24),
            capture_time_ns: long(32),
            deadline_us: word(40),
            secret,
        })
    }

    /// `(sequence, capture_time_ns)` of a header that need not be one, for the answer that refuses it: both 0 unless the version is ours and
    /// both are there.
    pub fn echo(bytes: &[u8]) -> (u64, u64) {
        match (bytes.first(), bytes.get(24..40)) {
            (Some(&WIRE_VERSION), Some(both)) => {
                let long = |at: usize| both[at..at + 8].iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte));
                (long(0), long(8))
            }
            _ => (0, 0),
        }
    }

    /// The header of a frame from its attachment: none at all and 16 bytes (a bare secret) both stand for a
    /// PNG or JPEG payload; anything else is decoded. Fails as [`FrameHeader::decode`] does.
    pub fn from_attachment(attachment: Option<&[u8]>) -> Result<FrameHeader, FrameError> {
        let by_encoding = FrameHeader::new(PixelFormat::ByEncoding, 0, 0);
        match attachment {
            None | Some([]) => Ok(by_encoding),
            Some(bytes) => match <[u8; Secret::BYTES]>::try_from(bytes) {
                Ok(secret) => Ok(FrameHeader { secret: Some(Secret::new(secret)), ..by_encoding }),
                Err(_) => FrameHeader::decode(bytes),
            },
        }
    }
}

/// The secret that the flags announce, if what follows the fixed part is exactly that.
fn read_flags(flags: u8, rest: &[u8]) -> Result<Option<Secret>, FrameError> {
    if flags & !FLAG_SECRET != 0 {
        return Err(FrameError::UnknownFlags { got: flags });
    }
    let expected = if flags & FLAG_SECRET != 0 { Secret::BYTES } else { 0 };
    if rest.len() != expected {
        return Err(FrameError::HeaderLength { expected: HEADER_BYTES + expected, got: HEADER_BYTES + rest.len() });
    }
    Ok(<[u8; Secret::BYTES]>::try_from(rest).ok().map(Secret::new))
}

fn four(bytes: &[u8; HEADER_BYTES], at: usize) -> [u8; 4] {
    [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]
}
