//! Frame headers and the images behind them.

use domvs_proto::frame::{DepthFormat, FrameHeader, HEADER_BYTES, JPEG, PNG, PixelFormat};
use domvs_proto::settings::Mask;
use domvs_server::decode::{DecodeError, DecodeLimits, Decoder, weights};
use domvs_server::payload::{Payload, header_of};
use zenoh::bytes::ZBytes;

/// Small, so that an input which takes more than it may is seen.
const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 16, max_bytes: 1 << 20 };

/// An attachment. It reads the same from any pieces, comes out as it went in, and lies about no payload.
pub fn header(data: &[u8]) {
    let read = FrameHeader::from_attachment(Some(data));
    // As bytes, for a unit that is NaN is not itself.
    let bytes = |header: &FrameHeader| header.encode();
    assert_eq!(header_of(Some(&in_pieces(data, 7))).as_ref().map(bytes), read.as_ref().map(bytes));
    let Ok(header) = read else { return };
    if data.len() >= HEADER_BYTES {
        assert_eq!(header.encode(), data);
    }
    let near = u64::from(header.row_bytes).saturating_mul(header.height.into());
    let plane = u64::from(header.width) * u64::from(header.height);
    let lengths = [
        0,
        1,
        near,
        plane,
        plane.saturating_mul(3) / 2,
        plane.saturating_mul(2).saturating_add(header.depth_offset.into()),
    ];
    for payload in lengths.into_iter().filter_map(|length| usize::try_from(length).ok()) {
        let Ok(layout) = header.layout(payload) else { continue };
        assert!(layout.pixels.start == 0 && layout.pixels.end <= payload);
        if let Some(depth) = layout.depth {
            assert!(layout.pixels.end <= depth.start && depth.end == payload);
            assert_eq!(Some(depth.len() as u64), plane.checked_mul(header.depth_format.bytes_per_pixel().into()));
        }
    }
}

/// A header and its raw pixels: the same in one piece and in many.
pub fn raw(data: &[u8]) {
    let Some((attachment, payload)) = data.split_at_checked(HEADER_BYTES) else { return };
    let Ok(header) = FrameHeader::decode(attachment) else { return };
    let whole = decode(Some(&header), "", payload.into());
    let pieces = in_pieces(payload, 5);
    match (whole, decode(Some(&header), "", Payload::from(&pieces))) {
        (Ok(whole), Ok(pieces)) => assert_eq!(whole, pieces),
        // In words, for a unit that is NaN is not itself.
        (whole, pieces) => {
            assert_eq!(whole.err().map(|error| error.to_string()), pieces.err().map(|error| error.to_string()))
        }
    }
}

/// A PNG: as it is, with depth behind it, and as a mask.
pub fn png(data: &[u8]) {
    file(PNG, data);
    let _ = weights(&Mask { png: data.to_vec() }, LIMITS);
}

/// A JPEG: as it is, and with depth behind it.
pub fn jpeg(data: &[u8]) {
    file(JPEG, data);
}

fn file(encoding: &str, data: &[u8]) {
    let Ok(alone) = decode(None, encoding, data.into()) else { return };
    let [width, height] = alone.size.map(|side| side as u32);
    let header = FrameHeader {
        depth_format: DepthFormat::U16,
        depth_unit_m: 0.001,
        depth_offset: data.len() as u32,
        ..FrameHeader::new(PixelFormat::ByEncoding, width, height)
    };
    let payload: Vec<u8> = data.iter().copied().chain((0..2 * width * height).map(|at| at as u8)).collect();
    match decode(Some(&header), encoding, (&payload).into()) {
        Ok(deep) => assert_eq!((deep.size, deep.gray, deep.has_depth), (alone.size, alone.gray, true)),
        Err(error) => assert!(matches!(error, DecodeError::TooManyBytes { .. }), "{error} with depth only"),
    }
}

#[derive(Debug, PartialEq)]
struct Image {
    size: [usize; 2],
    /// Bits, so that equal is equal.
    gray: Vec<u32>,
    has_depth: bool,
}

/// Decodes, and looks at what every caller relies on.
fn decode(header: Option<&FrameHeader>, encoding: &str, payload: Payload<'_>) -> Result<Image, DecodeError> {
    let mut decoder = Decoder::new();
    let decoded = decoder.decode(header, encoding, payload, LIMITS)?;
    let size = [decoded.image.width(), decoded.image.height()];
    let samples = decoded.image.samples();
    assert!(samples.iter().all(|sample| sample.is_finite()));
    assert!(samples.len() as u64 <= LIMITS.max_pixels && samples.len() == size[0] * size[1]);
    let contrast = decoded.sums.contrast();
    assert!(contrast >= 0.0 || contrast.is_nan(), "{contrast}");
    if let Some(header) = header.filter(|header| header.width > 0) {
        assert_eq!(size, [header.width as usize, header.height as usize]);
    }
    let gray = samples.iter().map(|sample| sample.to_bits()).collect();
    let has_depth = decoded.depth.map(|depth| assert_eq!(depth.to_plane().samples().len(), size[0] * size[1]));
    Ok(Image { size, gray, has_depth: has_depth.is_some() })
}

fn in_pieces(bytes: &[u8], length: usize) -> ZBytes {
    let mut writer = ZBytes::writer();
    bytes.chunks(length).for_each(|piece| writer.append(piece.into()));
    writer.finish()
}
