//! JPEG: its markers are walked before it is decoded, because a small file can ask for much work.
//!
//! A decoder repeats the whole image for every scan that it is told of, and builds every table that it is sent: 20 MB of
//! empty scans once took it 20 s. So size, scans, tables and segments are counted first, which costs a look at each byte, and
//! what no camera sends is refused.
//!
//! Where coded data ends too early the decoder reads on in zeros, which mean something: the rest of the picture comes out gray, and the
//! camera would be moved by it. So it is told to be strict, and ones are put where a scan or a part of it ends: no Huffman table of
//! an encoder has a word of ones only (<https://www.w3.org/Graphics/JPEG/itu-t81.pdf>, K.2), and an error is a bad frame.

use std::borrow::Cow;
use std::ops::Range;

use image::ColorType;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Scans of one image. Encoders make 1, one per component, or about 10 for a progressive image.
pub(super) const MOST_SCANS: usize = 32;
/// Segments of one image: tables, profiles, comments.
const MOST_SEGMENTS: usize = 256;
/// Bytes of all segments together; an image with a large colour profile and a preview stays below.
const MOST_SEGMENT_BYTES: usize = 1 << 20;
/// Bytes of all Huffman and quantisation tables; the largest set for every scan stays below.
const MOST_TABLE_BYTES: usize = 64 << 10;

/// Ones behind the coded data of a scan: more bits than the decoder looks ahead.
const ONES: [u8; 16] = [0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0, 0xff, 0];
/// Restarts of which each gets its ones; a camera makes one for each row of blocks, or none.
const MOST_RESTARTS: usize = 1 << 14;

/// What the markers say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Outline {
    pub width: u32,
    pub height: u32,
    pub scans: usize,
    /// The coded data of a picture that has all of it in one piece: not of a progressive one, whose decoder takes the first scan's
    /// end from what it has looked ahead.
    pub coded: Option<Range<usize>>,
}

/// Walks the markers from the first to the end of the image; what comes behind it is not looked at. Fails on a file that is
/// cut off, that holds what a decoder might read in another way, or that asks for more work than a camera's picture.
pub(super) fn outline(bytes: &[u8]) -> Result<Outline, String> {
    let rest = bytes.strip_prefix(b"\xff\xd8").ok_or("it does not begin like a JPEG")?;
    let mut walk = Walk { rest, ..Walk::default() };
    while walk.one_segment()? {}
    let scans = walk.scans;
    match walk.size {
        Some([width, height]) if scans > 0 => {
            let in_one_piece = scans == 1 && !walk.progressive;
            let coded = in_one_piece.then(|| bytes.len() - walk.coded.0..bytes.len() - walk.coded.1);
            Ok(Outline { width, height, scans, coded })
        }
        _ => Err("it ends before its image".to_owned()),
    }
}

#[derive(Default)]
struct Walk<'a> {
    rest: &'a [u8],
    size: Option<[u32; 2]>,
    progressive: bool,
    scans: usize,
    /// How many bytes of the file are left where the last scan's coded data begins and where it ends.
    coded: (usize, usize),
    segments: usize,
    segment_bytes: usize,
    table_bytes: usize,
}

impl<'a> Walk<'a> {
    /// The next marker and its segment; false at the end of the image.
    fn one_segment(&mut self) -> Result<bool, String> {
        let marker = self.marker()?;
        if marker == 0xd9 {
            return Ok(false);
        }
        let segment = self.segment()?;
        match marker {
            0xc0..=0xc2 => {
                self.progressive = marker == 0xc2;
                self.frame(segment)?;
            }
            0xc4 => self.tables(segment, huffman_table)?,
            0xdb => self.tables(segment, quantisation_table)?,
            0xdd if segment.len() == 2 => {}
            0xda => self.scan(segment)?,
            0xe0..=0xef | 0xfe => {}
            _ => return Err(format!("a marker ff{marker:02x} with {} bytes is not supported", segment.len())),
        }
        Ok(true)
    }

    /// The byte after one or more `ff`.
    fn marker(&mut self) -> Result<u8, String> {
        let after = self.rest.iter().position(|byte| *byte != 0xff).ok_or_else(cut_off)?;
        if after == 0 {
            return Err(format!("a marker was expected, got {:02x}", self.rest[0]));
        }
        let marker = self.rest[after];
        self.rest = &self.rest[after + 1..];
        Ok(marker)
    }

    /// What a marker's length covers, without the length itself.
    fn segment(&mut self) -> Result<&'a [u8], String> {
        let (length, rest) = self.rest.split_first_chunk().ok_or_else(cut_off)?;
        let length = usize::from(u16::from_be_bytes(*length));
        let length = length.checked_sub(2).ok_or_else(|| format!("a segment of {length} bytes"))?;
        let (segment, rest) = rest.split_at_checked(length).ok_or_else(cut_off)?;
        self.rest = rest;
        count(&mut self.segments, 1, MOST_SEGMENTS, "segments")?;
        count(&mut self.segment_bytes, length, MOST_SEGMENT_BYTES, "bytes of segments")?;
        Ok(segment)
    }

    fn frame(&mut self, segment: &[u8]) -> Result<(), String> {
        let &[_, h, eight, w, idth, components, ref rest @ ..] = segment else { return Err(cut_off()) };
        if rest.len() != 3 * usize::from(components) || self.size.is_some() {
            return Err("it has two images in one".to_owned());
        }
        self.size = Some([u16::from_be_bytes([w, idth]).into(), u16::from_be_bytes([h, eight]).into()]);
        Ok(())
    }

    /// Tables, one behind the other, filling the segment.
    fn tables(&mut self, mut segment: &[u8], length: impl Fn(&[u8]) -> Option<usize>) -> Result<(), String> {
        count(&mut self.table_bytes, segment.len(), MOST_TABLE_BYTES, "bytes of tables")?;
        while !segment.is_empty() {
            let length = length(segment).filter(|length| *length <= segment.len()).ok_or("a table is cut off")?;
            segment = &segment[length..];
        }
        Ok(())
    }

    /// A scan's own segment and the coded image behind it, up to the next marker that ends it.
    fn scan(&mut self, segment: &[u8]) -> Result<(), String> {
        let components = usize::from(*segment.first().ok_or_else(cut_off)?);
        if segment.len() != 4 + 2 * components {
            return Err(format!("a scan of {components} components has {} bytes", segment.len()));
        }
        count(&mut self.scans, 1, MOST_SCANS, "scans")?;
        self.coded.0 = self.rest.len();
        loop {
            let at = self.rest.iter().position(|byte| *byte == 0xff).ok_or_else(cut_off)?;
            self.rest = &self.rest[at..];
            self.coded.1 = self.rest.len();
            match self.rest.get(1) {
                None => return Err(cut_off()),
                // A stuffed byte, or a restart.
                Some(0 | 0xd0..=0xd7) => self.rest = &self.rest[2..],
                Some(0xff) => self.rest = &self.rest[1..],
                Some(_) => return Ok(()),
            }
        }
    }
}

/// Bytes of the Huffman table that begins here: its place, 16 counts, as many symbols.
fn huffman_table(bytes: &[u8]) -> Option<usize> {
    let counts = bytes.get(1..17)?;
    Some(17 + counts.iter().map(|count| usize::from(*count)).sum::<usize>())
}

/// Bytes of the quantisation table that begins here: its place, 64 numbers of 1 or 2 bytes.
fn quantisation_table(bytes: &[u8]) -> Option<usize> {
    Some(1 + 64 * (1 + usize::from(bytes.first()? >> 4)))
}

/// The file with ones in front of every restart in its coded data, and behind it.
fn with_ones(bytes: &[u8], coded: Range<usize>) -> Vec<u8> {
    let mut padded = Vec::with_capacity(bytes.len() + bytes.len() / 8 + ONES.len());
    let mut copied = 0;
    let is_restart = |pair: &[u8]| pair[0] == 0xff && (0xd0..=0xd7).contains(&pair[1]);
    let pairs = bytes[coded.clone()].windows(2).enumerate();
    let restarts = pairs.filter(|(_, pair)| is_restart(pair)).map(|(at, _)| coded.start + at);
    for end in restarts.take(MOST_RESTARTS).chain([coded.end]) {
        padded.extend_from_slice(&bytes[copied..end]);
        padded.extend_from_slice(&ONES);
        copied = end;
    }
    padded.extend_from_slice(&bytes[copied..]);
    padded
}

fn count(sum: &mut usize, more: usize, limit: usize, what: &str) -> Result<(), String> {
    *sum += more;
    if *sum > limit { Err(format!("at most {limit} {what}, got more")) } else { Ok(()) }
}

fn cut_off() -> String {
    "its end is missing".to_owned()
}

/// Decodes into tight rows of the colour type that is returned. The outline's size was found to be within the limits.
pub(super) fn read(bytes: &[u8], outline: &Outline, samples: &mut Vec<u8>) -> Result<ColorType, String> {
    let [width, height] = [outline.width as usize, outline.height as usize];
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(width)
        .set_max_height(height)
        .jpeg_set_max_scans(MOST_SCANS);
    let bytes = outline.coded.clone().map_or(Cow::Borrowed(bytes), |coded| Cow::Owned(with_ones(bytes, coded)));
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&*bytes), options);
    decoder.decode_headers().map_err(|error| error.to_string())?;
    let (space, color) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, ColorType::L8),
        _ => (ColorSpace::RGB, ColorType::Rgb8),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let length = width * height * usize::from(color.bytes_per_pixel());
    if decoder.dimensions() != Some((width, height)) || decoder.output_buffer_size() != Some(length) {
        return Err(format!("its size is {:?}, and {width}x{height} in its frame", decoder.dimensions()));
    }
    samples.clear();
    samples.resize(length, 0);
    decoder.decode_into(samples).map_err(|error| error.to_string())?;
    Ok(color)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Pictures of 24x16 pixels as an encoder of another project writes them: the seeds of the fuzzer.
    fn picture(name: &str) -> Vec<u8> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus/jpeg");
        std::fs::read(folder.join(format!("seed-{name}"))).expect("a seed")
    }

    /// A picture in front of its first segment of this kind, and from there on.
    fn cut_at(picture: &[u8], marker: u8) -> (&[u8], &[u8]) {
        let at = picture.windows(2).position(|pair| pair == [0xff, marker]).expect("a segment");
        picture.split_at(at)
    }

    fn segment(marker: u8, content: &[u8]) -> Vec<u8> {
        let length = (content.len() as u16 + 2).to_be_bytes();
        [&[0xff, marker][..], &length, content].concat()
    }

    /// The picture with these bytes in front of its first scan.
    fn with(picture: &[u8], more: &[u8]) -> Vec<u8> {
        let (head, scan) = cut_at(picture, 0xda);
        [head, more, scan].concat()
    }

    fn refusal(bytes: &[u8]) -> String {
        outline(bytes).expect_err("refused")
    }

    #[test]
    fn pictures_of_every_kind_are_read() {
        for (name, color, scans) in [
            ("l", ColorType::L8, 1),
            ("rgb", ColorType::Rgb8, 1),
            ("cmyk", ColorType::Rgb8, 1),
            ("l_progressive", ColorType::L8, 6),
            ("rgb_progressive", ColorType::Rgb8, 10),
            ("subsampled_0", ColorType::Rgb8, 1),
            ("subsampled_1", ColorType::Rgb8, 1),
            ("subsampled_2", ColorType::Rgb8, 1),
            ("subsampled_0_progressive", ColorType::Rgb8, 10),
            ("subsampled_1_progressive", ColorType::Rgb8, 10),
            ("subsampled_2_progressive", ColorType::Rgb8, 10),
            ("restarts", ColorType::Rgb8, 1),
            ("restarts_progressive", ColorType::Rgb8, 10),
            ("commented", ColorType::L8, 1),
        ] {
            let bytes = picture(name);
            let found = outline(&bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!((found.width, found.height, found.scans), (24, 16, scans), "{name}");
            assert_eq!(found.coded.is_some(), !name.ends_with("progressive"), "{name}");
            let mut samples = vec![];
            assert_eq!(read(&bytes, &found, &mut samples).as_ref(), Ok(&color), "{name}");
            assert_eq!(samples.len(), 24 * 16 * usize::from(color.bytes_per_pixel()), "{name}");
        }
    }

    #[test]
    fn what_comes_behind_the_image_is_not_looked_at() {
        let mut bytes = picture("rgb");
        let found = outline(&bytes).expect("a picture");
        bytes.extend([0; 100]);
        bytes.extend(picture("l"));
        assert_eq!(outline(&bytes).as_ref(), Ok(&found));
        assert!(read(&bytes, &found, &mut vec![]).is_ok());
    }

    #[test]
    fn scans_without_end_are_refused_before_anything_is_decoded() {
        let bytes = picture("l");
        let (head, scan) = cut_at(&bytes, 0xda);
        let scan = &scan[..scan.len() - 2];
        let bomb = |scans: usize| [head, &scan.repeat(scans), b"\xff\xd9"].concat();
        assert_eq!(outline(&bomb(MOST_SCANS)).expect("as many as may be").scans, MOST_SCANS);
        assert_eq!(refusal(&bomb(MOST_SCANS + 1)), "at most 32 scans, got more");
    }

    #[test]
    fn segments_and_tables_without_end_are_refused() {
        let bytes = picture("l");
        let note = segment(0xfe, b"a note");
        assert!(outline(&with(&bytes, &note.repeat(200))).is_ok());
        assert_eq!(refusal(&with(&bytes, &note.repeat(256))), "at most 256 segments, got more");
        let profile = segment(0xe2, &[0; 65_000]);
        assert!(outline(&with(&bytes, &profile.repeat(16))).is_ok());
        assert_eq!(refusal(&with(&bytes, &profile.repeat(17))), "at most 1048576 bytes of segments, got more");
        // A table of one word, 3600 times in a segment.
        let table = [&[0x10, 1][..], &[0; 15], &[0]].concat();
        let tables = segment(0xc4, &table.repeat(3600));
        assert!(outline(&with(&bytes, &tables)).is_ok());
        assert_eq!(refusal(&with(&bytes, &tables.repeat(2))), "at most 65536 bytes of tables, got more");
    }

    #[test]
    fn what_a_decoder_might_read_in_another_way_is_refused() {
        let bytes = picture("l");
        let (_, frame) = cut_at(&bytes, 0xc0);
        let second_frame = &frame[..13];
        let table = [&[0x10, 1][..], &[0; 15], &[0]].concat();
        for (what, more) in [
            ("a second frame", second_frame.to_vec()),
            ("bytes between segments", vec![0; 2]),
            ("a table that is longer than its segment", segment(0xc4, &table[..17])),
            ("bytes behind a table", segment(0xc4, &[&table[..], b"\xff\xda\0\x08\x01"].concat())),
            ("half a table of quantisation", segment(0xdb, &[0; 64])),
            ("a restart interval of three bytes", segment(0xdd, &[0; 3])),
            ("a scan that names more components than it has", segment(0xda, &[9, 1, 0, 0, 63, 0])),
            ("a segment shorter than its length", vec![0xff, 0xfe, 0, 1]),
            ("a hierarchical image", segment(0xde, &[0; 6])),
            ("arithmetic tables", segment(0xcc, &[0; 2])),
        ] {
            assert!(outline(&with(&bytes, &more)).is_err(), "{what}");
        }
        assert_eq!(refusal(b"\xff\xd8\xff\xd9"), "it ends before its image");
        assert_eq!(refusal(b"\x89PNG"), "it does not begin like a JPEG");
        for kept in 2..bytes.len() - 1 {
            assert!(outline(&bytes[..kept]).is_err(), "cut to {kept} of {} bytes", bytes.len());
        }
    }

    #[test]
    fn ones_change_nothing_in_a_whole_picture() {
        for name in ["l", "rgb", "cmyk", "subsampled_1", "subsampled_2", "restarts", "commented"] {
            let bytes = picture(name);
            let found = outline(&bytes).expect("a picture");
            let (mut with, mut without) = (vec![], vec![]);
            read(&bytes, &found, &mut with).expect("whole");
            read(&bytes, &Outline { coded: None, ..found }, &mut without).expect("whole");
            assert_eq!(with, without, "{name}");
        }
    }

    #[test]
    fn a_picture_that_lost_the_end_of_its_coded_data_is_refused_wherever_it_is_cut() {
        for name in ["l", "rgb", "cmyk", "subsampled_1", "subsampled_2", "restarts"] {
            let bytes = picture(name);
            let coded = outline(&bytes).expect("a picture").coded.expect("in one piece");
            // A cut behind an ff would leave half a marker, and the last byte may hold nothing but filling bits.
            for kept in (coded.start..coded.end - 1).filter(|kept| bytes[kept - 1] != 0xff) {
                let cut = [&bytes[..kept], &bytes[coded.end..]].concat();
                let found = outline(&cut).expect("every marker is there");
                assert!(read(&cut, &found, &mut vec![]).is_err(), "{name}, cut at {kept} of {coded:?}");
            }
        }
    }

    #[test]
    fn damage_that_the_decoder_sees_is_an_error_and_no_gray_picture() {
        let bytes = picture("rgb_progressive");
        let found = outline(&bytes).expect("a picture");
        let (head, scans) = cut_at(&bytes, 0xda);
        // The table of the first scan is gone: a lenient decoder would stop there and be content.
        let (before, _) = cut_at(head, 0xc4);
        let bare = [before, scans].concat();
        assert_eq!(outline(&bare).map(|found| [found.width, found.height]), Ok([found.width, found.height]));
        assert!(read(&bare, &found, &mut vec![]).is_err());
    }
}
