//! Frames on their way out and back: pixels and depth in one contiguous buffer, and the header that tells what they are.
//!
//! The buffer is shared, not copied, by clones and by sending: one frame can be a target, a question and a push.
//! Secrets and deadlines are put into the header when it is sent, never kept here. No pixel is looked at.

use domvs_proto::frame::{DepthFormat, FrameHeader, JPEG, PNG, PixelFormat, RAW, Secret};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::sample::Sample;

use crate::ClientError;

/// Depth planes start at a multiple of this many bytes, so that readers can use them in place.
const DEPTH_ALIGNMENT: usize = 4;

/// A container of pixels that brings its own size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFile {
    /// `image/png`
    Png,
    /// `image/jpeg`
    Jpeg,
}

/// The depth that goes with an image: one value a pixel, row by row; 0, negative and not finite mean unknown.
#[derive(Debug, Clone, Copy)]
pub enum DepthPlane<'a> {
    /// Metres along the optical axis.
    Metres(&'a [f32]),
    /// Counts of a depth camera.
    Counts {
        /// One count a pixel.
        counts: &'a [u16],
        /// Metres per count, often 0.001.
        unit_m: f32,
    },
}

/// A frame to send. Cheap to clone.
#[derive(Debug, Clone)]
pub struct OutgoingFrame {
    header: FrameHeader,
    encoding: Encoding,
    payload: ZBytes,
}

impl OutgoingFrame {
    /// Tight rows of raw pixels, `width` × `height`, multi-byte values little-endian. A `Vec` is taken over without a copy.
    ///
    /// # Errors
    /// [`ClientError::Frame`] when the length is not what format and size ask for.
    pub fn raw(format: PixelFormat, width: u32, height: u32, pixels: impl Into<Vec<u8>>) -> Result<Self, ClientError> {
        Self::checked(FrameHeader::new(format, width, height), Encoding::from(RAW), pixels.into())
    }

    /// As [`OutgoingFrame::raw`], with a depth for every pixel.
    ///
    /// # Errors
    /// [`ClientError::Frame`] when a length is not what format and size ask for, or the depth unit is not positive.
    pub fn raw_with_depth(
        format: PixelFormat,
        width: u32,
        height: u32,
        pixels: impl Into<Vec<u8>>,
        depth: DepthPlane<'_>,
    ) -> Result<Self, ClientError> {
        let mut bytes = pixels.into();
        // Without depth the lengths must be right before a plane is put behind them.
        let header = FrameHeader::new(format, width, height);
        header.layout(bytes.len())?;
        bytes.resize(bytes.len().next_multiple_of(DEPTH_ALIGNMENT), 0);
        let header = append_depth(header, &mut bytes, depth);
        Self::checked(header, Encoding::from(RAW), bytes)
    }

    /// 8-bit gray, `width` × `height`.
    ///
    /// # Errors
    /// [`ClientError::Frame`] when there is not one byte for every pixel.
    pub fn mono8(width: u32, height: u32, pixels: impl Into<Vec<u8>>) -> Result<Self, ClientError> {
        Self::raw(PixelFormat::Mono8, width, height, pixels)
    }

    /// The bytes of a PNG or JPEG file, as they are.
    ///
    /// # Errors
    /// [`ClientError::Frame`] when there are none.
    pub fn file(kind: ImageFile, bytes: impl Into<Vec<u8>>) -> Result<Self, ClientError> {
        Self::checked(FrameHeader::new(PixelFormat::ByEncoding, 0, 0), kind.encoding(), bytes.into())
    }

    /// As [`OutgoingFrame::file`], with a depth for every pixel of the image, which has `width` × `height` of them.
    ///
    /// # Errors
    /// [`ClientError::Frame`] when there is not one depth for every pixel, or the depth unit is not positive.
    pub fn file_with_depth(
        kind: ImageFile,
        bytes: impl Into<Vec<u8>>,
        width: u32,
        height: u32,
        depth: DepthPlane<'_>,
    ) -> Result<Self, ClientError> {
        let mut bytes = bytes.into();
        let header = append_depth(FrameHeader::new(PixelFormat::ByEncoding, width, height), &mut bytes, depth);
        Self::checked(header, kind.encoding(), bytes)
    }

    /// With the sender's count and its clock at exposure (ns; 0 = unknown); both come back in the twist.
    #[must_use]
    pub fn numbered(mut self, sequence: u64, capture_time_ns: u64) -> Self {
        self.header.sequence = sequence;
        self.header.capture_time_ns = capture_time_ns;
        self
    }

    /// What the payload is; without secret and deadline.
    pub fn header(&self) -> &FrameHeader {
        &self.header
    }

    /// The encoding that goes with the payload.
    pub fn encoding(&self) -> &Encoding {
        &self.encoding
    }

    /// The bytes that are sent: pixels, then depth. A clone shares them.
    pub fn payload(&self) -> &ZBytes {
        &self.payload
    }

    /// The attachment for a question: with the secret, and with a deadline (µs from receipt; 0 = none).
    pub(crate) fn attachment(&self, secret: Option<&Secret>, deadline_us: u32) -> ZBytes {
        let header = FrameHeader { secret: secret.cloned(), deadline_us, ..self.header.clone() };
        header.encode().into()
    }

    fn checked(header: FrameHeader, encoding: Encoding, bytes: Vec<u8>) -> Result<Self, ClientError> {
        header.layout(bytes.len())?;
        Ok(OutgoingFrame { header, encoding, payload: bytes.into() })
    }
}

impl ImageFile {
    fn encoding(self) -> Encoding {
        match self {
            ImageFile::Png => Encoding::from(PNG),
            ImageFile::Jpeg => Encoding::from(JPEG),
        }
    }
}

/// Puts the plane behind what is there and says so in the header. An offset beyond 32 bits saturates, and is refused by the check.
fn append_depth(mut header: FrameHeader, bytes: &mut Vec<u8>, depth: DepthPlane<'_>) -> FrameHeader {
    header.depth_offset = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    match depth {
        DepthPlane::Metres(depth_m) => {
            (header.depth_format, header.depth_unit_m) = (DepthFormat::F32, 1.0);
            bytes.reserve_exact(4 * depth_m.len());
            bytes.extend(depth_m.iter().flat_map(|metres| metres.to_le_bytes()));
        }
        DepthPlane::Counts { counts, unit_m } => {
            (header.depth_format, header.depth_unit_m) = (DepthFormat::U16, unit_m);
            bytes.reserve_exact(2 * counts.len());
            bytes.extend(counts.iter().flat_map(|count| count.to_le_bytes()));
        }
    }
    header
}

/// A frame that came back: a target as it was set.
#[derive(Debug, Clone)]
pub struct ReceivedFrame {
    /// What the payload is.
    pub header: FrameHeader,
    /// `image/png`, `image/jpeg` or what else was said.
    pub encoding: Encoding,
    /// The bytes as they were sent: pixels, then depth.
    pub payload: Vec<u8>,
}

impl ReceivedFrame {
    /// The same frame, to be sent on.
    ///
    /// # Errors
    /// [`ClientError::Frame`] when the header and the payload disagree.
    pub fn into_outgoing(self) -> Result<OutgoingFrame, ClientError> {
        OutgoingFrame::checked(self.header, self.encoding, self.payload)
    }

    pub(crate) fn from_sample(key: &str, sample: &Sample) -> Result<Self, ClientError> {
        let attachment = sample.attachment().map(ZBytes::to_bytes);
        let header = FrameHeader::from_attachment(attachment.as_deref())
            .map_err(|error| ClientError::bad_answer(key)(&error))?;
        Ok(ReceivedFrame {
            header,
            encoding: sample.encoding().clone(),
            payload: sample.payload().to_bytes().into_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_lies_behind_the_pixels_in_one_piece() {
        let depth = DepthPlane::Metres(&[1.0, 2.0, 3.0]);
        let frame = OutgoingFrame::raw_with_depth(PixelFormat::Mono8, 3, 1, vec![7, 8, 9], depth).expect("valid");
        assert_eq!(frame.payload().slices().count(), 1);
        let layout = frame.header().layout(frame.payload().len()).expect("true lengths");
        let bytes = frame.payload().to_bytes();
        assert_eq!(&bytes[layout.pixels], [7, 8, 9]);
        assert_eq!(&bytes[layout.depth.expect("there is depth")][4..8], 2.0f32.to_le_bytes());
    }

    #[test]
    fn counts_keep_their_unit() {
        let depth = DepthPlane::Counts { counts: &[500, 1000], unit_m: 0.001 };
        let frame = OutgoingFrame::raw_with_depth(PixelFormat::Mono16, 2, 1, vec![0; 4], depth).expect("valid");
        assert_eq!((frame.header().depth_format, frame.header().depth_unit_m), (DepthFormat::U16, 0.001));
    }

    #[test]
    fn a_frame_with_a_missing_byte_is_refused_before_it_is_sent() {
        assert!(matches!(OutgoingFrame::mono8(4, 4, vec![0; 15]), Err(ClientError::Frame(_))));
        let depth = DepthPlane::Metres(&[1.0; 15]);
        assert!(matches!(
            OutgoingFrame::raw_with_depth(PixelFormat::Mono8, 4, 4, vec![0; 16], depth),
            Err(ClientError::Frame(_))
        ));
        assert!(matches!(OutgoingFrame::file(ImageFile::Png, vec![]), Err(ClientError::Frame(_))));
    }

    #[test]
    fn pixels_that_are_too_few_are_not_made_up_by_the_gap_before_the_depth() {
        let depth = DepthPlane::Metres(&[1.0; 4]);
        assert!(matches!(
            OutgoingFrame::raw_with_depth(PixelFormat::Mono8, 4, 1, vec![0; 3], depth),
            Err(ClientError::Frame(_))
        ));
    }

    #[test]
    fn secret_and_deadline_are_only_in_what_is_sent() {
        let frame = OutgoingFrame::file(ImageFile::Jpeg, vec![1]).expect("valid").numbered(5, 6);
        let secret = Secret::new([3; 16]);
        let sent = FrameHeader::decode(&frame.attachment(Some(&secret), 250_000).to_bytes()).expect("a header");
        assert_eq!((sent.secret, sent.deadline_us, sent.sequence, sent.capture_time_ns), (Some(secret), 250_000, 5, 6));
        assert_eq!((frame.header().secret.as_ref(), frame.header().deadline_us), (None, 0));
    }
}
