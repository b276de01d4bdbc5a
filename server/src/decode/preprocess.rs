//! What a task's settings may do to the gray image before it is compared.

use domvs_vision::Plane;

/// `I ← 1 − I`, for a scene that is dark on bright: outside the image counts as 0, so the object should be bright.
pub fn invert(image: &mut Plane<f32>) {
    for sample in image.samples_mut() {
        *sample = 1.0 - *sample;
    }
}
