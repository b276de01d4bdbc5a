//! Plain photometric servoing: the features are the pixels themselves, `e = I - I*` and `L̂ = ½(L_I + L_I*)` at every one.
//!
//! One pass over both images: a row's planes, their inner products, the next row. The matrix of all pixels is never made.

use crate::camera::Intrinsics;
use crate::features::Sights;
use crate::gram::Gram;
use crate::planes::RowPlanes;
use crate::products::add_products;
use crate::sample::Sample;

/// The photometric method's buffers for one camera and image size.
#[derive(Debug)]
pub(crate) struct Photometric<T> {
    rows: RowPlanes<T>,
}

impl<T: Sample> Photometric<T> {
    /// Buffers for images of `[width, height]` pixels, for 7 planes or, with light, 13.
    pub(crate) fn new(camera: Intrinsics, [width, _]: [usize; 2], planes: usize) -> Photometric<T> {
        Photometric { rows: RowPlanes::new(camera, width, planes) }
    }

    /// The inner products over all pixels.
    pub(crate) fn gram(&mut self, sights: Sights<'_, T>) -> Gram {
        let mut gram = Gram::new();
        self.rows.for_each(sights, |_, planes| add_products(planes, &mut gram));
        gram.features = sights.current.0.samples().len();
        gram
    }
}
