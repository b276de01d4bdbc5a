//! The bytes of a frame as they lie in memory: in one piece, or in the pieces that the network brought.
//!
//! A frame of 640x480 pixels arrives in half a dozen packets. Rows are read where they lie; only a row that two
//! packets share is put together, in a buffer that is kept.

use std::borrow::Cow;

use domvs_proto::frame::{FrameError, FrameHeader, HEADER_AND_SECRET_BYTES, HEADER_BYTES, PixelFormat};
use zenoh::bytes::ZBytes;

/// The bytes of a frame. Cheap to copy.
#[derive(Clone, Copy, Debug)]
pub enum Payload<'a> {
    /// In one piece.
    Whole(&'a [u8]),
    /// In the pieces of a Zenoh message.
    Pieces(&'a ZBytes),
}

impl<'a> Payload<'a> {
    /// How many bytes.
    pub fn len(self) -> usize {
        match self {
            Payload::Whole(bytes) => bytes.len(),
            Payload::Pieces(bytes) => bytes.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// The pieces in their order; never an empty one.
    pub fn pieces(self) -> impl Iterator<Item = &'a [u8]> {
        let (whole, pieces) = match self {
            Payload::Whole(bytes) => (Some(bytes), None),
            Payload::Pieces(bytes) => (None, Some(bytes.slices())),
        };
        whole.into_iter().chain(pieces.into_iter().flatten()).filter(|piece| !piece.is_empty())
    }

    /// All bytes in one piece; copied only if there are several.
    pub fn to_bytes(self) -> Cow<'a, [u8]> {
        match self {
            Payload::Whole(bytes) => Cow::Borrowed(bytes),
            Payload::Pieces(bytes) => bytes.to_bytes(),
        }
    }

    /// The bytes from the front on, row by row.
    pub(crate) fn reader(self) -> Reader<'a, impl Iterator<Item = &'a [u8]>> {
        Reader { piece: &[], rest: self.pieces() }
    }
}

impl<'a> From<&'a [u8]> for Payload<'a> {
    fn from(bytes: &'a [u8]) -> Payload<'a> {
        Payload::Whole(bytes)
    }
}

impl<'a> From<&'a Vec<u8>> for Payload<'a> {
    fn from(bytes: &'a Vec<u8>) -> Payload<'a> {
        Payload::Whole(bytes)
    }
}

impl<'a> From<&'a ZBytes> for Payload<'a> {
    fn from(bytes: &'a ZBytes) -> Payload<'a> {
        Payload::Pieces(bytes)
    }
}

/// The header of a frame, from its attachment, as [`FrameHeader::from_attachment`] has it; nothing is allocated whatever pieces it came in.
pub fn header_of(attachment: Option<&ZBytes>) -> Result<FrameHeader, FrameError> {
    let Some(attachment) = attachment else { return FrameHeader::from_attachment(None) };
    // One more than the longest, so that a longer one is seen to be too long.
    let mut room = [0; HEADER_AND_SECRET_BYTES + 1];
    let mut filled = 0;
    for piece in attachment.slices() {
        let taken = piece.len().min(room.len() - filled);
        room[filled..filled + taken].copy_from_slice(&piece[..taken]);
        filled += taken;
    }
    FrameHeader::from_attachment(Some(&room[..filled])).map_err(|error| match error {
        FrameError::HeaderLength { expected, .. } => FrameError::HeaderLength { expected, got: attachment.len() },
        error => error,
    })
}

/// Of a header that cannot be read, what an answer echoes: as far as it is there, the sequence and the capture time, and nothing else.
pub fn echo_of(attachment: Option<&ZBytes>) -> FrameHeader {
    let (mut room, mut filled) = ([0; HEADER_BYTES], 0);
    for (to, byte) in room.iter_mut().zip(attachment.into_iter().flat_map(ZBytes::slices).flatten()) {
        *to = *byte;
        filled += 1;
    }
    let (sequence, capture_time_ns) = FrameHeader::echo(&room[..filled]);
    FrameHeader { sequence, capture_time_ns, ..FrameHeader::new(PixelFormat::ByEncoding, 0, 0) }
}

/// Reads a payload from front to back.
pub(crate) struct Reader<'a, I> {
    /// What is left of the piece in hand.
    piece: &'a [u8],
    rest: I,
}

impl<'a, I: Iterator<Item = &'a [u8]>> Reader<'a, I> {
    /// The next `count` bytes: where they lie if they are in one piece, else put together in `seam`.
    /// Fewer when the payload ends before.
    pub(crate) fn take<'b>(&mut self, count: usize, seam: &'b mut Vec<u8>) -> &'b [u8]
    where
        'a: 'b,
    {
        if self.piece.is_empty() {
            self.piece = self.rest.next().unwrap_or_default();
        }
        if self.piece.len() >= count {
            let (taken, rest) = self.piece.split_at(count);
            self.piece = rest;
            return taken;
        }
        seam.clear();
        while seam.len() < count {
            let Some(part) = self.some_of(count - seam.len()) else { break };
            seam.extend_from_slice(part);
        }
        seam
    }

    /// Passes over the next `count` bytes.
    pub(crate) fn skip(&mut self, mut count: usize) {
        while count > 0 {
            let Some(part) = self.some_of(count) else { break };
            count -= part.len();
        }
    }

    /// What the piece in hand, or the next one, has of the next `count` bytes; `None` at the end.
    fn some_of(&mut self, count: usize) -> Option<&'a [u8]> {
        if self.piece.is_empty() {
            self.piece = self.rest.next()?;
        }
        let (taken, rest) = self.piece.split_at(count.min(self.piece.len()));
        self.piece = rest;
        Some(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes 0 to 19 in pieces of these lengths.
    fn in_pieces(lengths: &[usize]) -> ZBytes {
        let mut writer = ZBytes::writer();
        let mut next = 0;
        for &length in lengths {
            writer.append(ZBytes::from((next..next + length as u8).collect::<Vec<u8>>()));
            next += length as u8;
        }
        writer.finish()
    }

    #[test]
    fn rows_are_the_same_in_any_pieces() {
        let whole: Vec<u8> = (0..20).collect();
        for lengths in [&[20][..], &[4, 4, 4, 4, 4], &[3, 1, 7, 9], &[1; 20]] {
            let bytes = in_pieces(lengths);
            let payload = Payload::from(&bytes);
            assert_eq!((payload.len(), payload.pieces().count()), (20, lengths.len()));
            let (mut reader, mut seam) = (payload.reader(), Vec::new());
            assert_eq!(reader.take(5, &mut seam), &whole[..5], "{lengths:?}");
            reader.skip(2);
            assert_eq!(reader.take(4, &mut seam), &whole[7..11], "{lengths:?}");
            reader.skip(5);
            assert_eq!(reader.take(9, &mut seam), &whole[16..], "all that is left: {lengths:?}");
            assert_eq!(reader.take(1, &mut seam), &[0u8; 0]);
        }
    }

    #[test]
    fn a_header_is_read_from_any_pieces_and_one_too_long_is_refused_for_its_length() {
        use domvs_proto::frame::Secret;
        let secret = Some(Secret::new([7; 16]));
        let header = FrameHeader { sequence: 5, secret, ..FrameHeader::new(PixelFormat::Mono8, 640, 480) };
        let mut bytes = header.encode();
        for length in [1, 3, 64] {
            let mut writer = ZBytes::writer();
            bytes.chunks(length).for_each(|piece| writer.append(piece.into()));
            assert_eq!(header_of(Some(&writer.finish())), Ok(header.clone()), "in pieces of {length} bytes");
        }
        for length in [65, 1000] {
            bytes.resize(length, 0);
            let refused = header_of(Some(&bytes.clone().into()));
            assert_eq!(refused, Err(FrameError::HeaderLength { expected: 64, got: length }));
        }
        assert_eq!(header_of(None), Ok(FrameHeader::new(PixelFormat::ByEncoding, 0, 0)));
        let echo = FrameHeader { sequence: 5, ..FrameHeader::new(PixelFormat::ByEncoding, 0, 0) };
        assert_eq!(echo_of(Some(&header.encode().into())), echo);
        assert_eq!(echo_of(None).sequence, 0);
    }

    #[test]
    fn a_row_that_lies_in_one_piece_is_not_copied() {
        let whole: Vec<u8> = (0..20).collect();
        let (mut reader, mut seam) = (Payload::from(&whole).reader(), Vec::new());
        let row = reader.take(8, &mut seam);
        assert_eq!(row.as_ptr(), whole.as_ptr());
        assert!(seam.is_empty());
    }
}
