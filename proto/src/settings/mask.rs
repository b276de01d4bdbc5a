//! The mask: which pixels count. An 8-bit gray PNG, carried in JSON as base64.
//!
//! What the PNG says of itself is read here, from its first bytes; its pixels are for the service to decode.

use std::fmt;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::SettingsError;

/// The longest `png_base64`, characters: with the other settings it fits into one JSON body.
pub const MAX_MASK_CHARACTERS: usize = 768 * 1024;

/// Colour type of a gray PNG, <https://www.w3.org/TR/png-3/#11IHDR>.
const GRAY: u8 = 0;

/// Which pixels count: white does, black does not, gray in between. JSON: `{"png_base64": "…"}`.
#[derive(Clone, PartialEq, Eq)]
pub struct Mask {
    /// An 8-bit gray PNG of the camera's size.
    pub png: Vec<u8>,
}

/// What the first chunk of a PNG says.
struct Head {
    size: [u32; 2],
    bit_depth: u8,
    color_type: u8,
}

impl Mask {
    /// Fails when this is not the beginning of an 8-bit gray PNG of `size` (width, height) pixels.
    pub(super) fn check(&self, size: [u32; 2]) -> Result<(), SettingsError> {
        let refused = |reason: String| Err(SettingsError::Field { field: "preprocess.mask".to_owned(), reason });
        let characters = self.png.len().div_ceil(3) * 4;
        if characters > MAX_MASK_CHARACTERS {
            return refused(format!("png_base64 has at most {MAX_MASK_CHARACTERS} characters, got {characters}"));
        }
        let Some(head) = Head::read(&self.png) else {
            return refused(format!("png_base64 holds a PNG, and these {} bytes are none", self.png.len()));
        };
        if (head.bit_depth, head.color_type) != (8, GRAY) {
            let (bits, color) = (head.bit_depth, head.color_type);
            return refused(format!(
                "a mask has 8 bits of gray (colour type 0), got {bits} bits of colour type {color}"
            ));
        }
        if head.size != size {
            let ([width, height], [got_width, got_height]) = (size, head.size);
            return refused(format!(
                "a mask has the {width}x{height} pixels of the camera, got {got_width}x{got_height}"
            ));
        }
        Ok(())
    }
}

impl Head {
    /// From the signature and the IHDR chunk, which have a fixed place.
    fn read(png: &[u8]) -> Option<Head> {
        let rest = png.strip_prefix(b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR")?;
        let (width, rest) = rest.split_first_chunk()?;
        let (height, rest) = rest.split_first_chunk()?;
        let (&[bit_depth, color_type], _) = rest.split_first_chunk()?;
        Some(Head { size: [u32::from_be_bytes(*width), u32::from_be_bytes(*height)], bit_depth, color_type })
    }
}

/// Its size only: the bytes would fill pages.
impl fmt::Debug for Mask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Mask {{ png: {} bytes }}", self.png.len())
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaskJson {
    png_base64: String,
}

impl Serialize for Mask {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        MaskJson { png_base64: STANDARD.encode(&self.png) }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Mask {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Mask, D::Error> {
        let MaskJson { png_base64 } = MaskJson::deserialize(deserializer)?;
        let png = STANDARD.decode(png_base64).map_err(|error| D::Error::custom(format!("png_base64: {error}")))?;
        Ok(Mask { png })
    }
}
