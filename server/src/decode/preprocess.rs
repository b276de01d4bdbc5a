//! What a task's settings may do to the gray image before it is compared, and which of its pixels count.

use domvs_proto::frame;
use domvs_proto::settings::Mask;
use domvs_vision::Plane;

use super::{DecodeError, DecodeLimits, Decoder};

/// `I ← 1 − I`, for a scene that is dark on bright: outside the image counts as 0, so the object should be bright.
pub fn invert(image: &mut Plane<f32>) {
    for sample in image.samples_mut() {
        *sample = 1.0 - *sample;
    }
}

/// The weights of a mask: 1 where it is white, 0 where it is black. Its size was compared with the camera's when the settings
/// were read; memory is bounded by `limits` as a frame's is. Fails on a broken PNG.
pub fn weights(mask: &Mask, limits: DecodeLimits) -> Result<Plane<f32>, DecodeError> {
    let mut decoder = Decoder::new();
    decoder.decode(None, frame::PNG, (&mask.png).into(), limits).map(|decoded| decoded.image.clone())
}
