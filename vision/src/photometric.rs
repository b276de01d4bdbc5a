//! Plain photometric servoing: the features are the pixels themselves, `e = I - I*` and `L̂ = ½(L_I + L_I*)` at every one.
//!
//! One pass over both images: a row's planes, their inner products, the next row. The matrix of all pixels is never made.

use fearless_simd::{Simd, dispatch};

use crate::camera::Intrinsics;
use crate::features::Sights;
use crate::gram::{COLUMNS, Gram};
use crate::path::Path;
use crate::planes::{Across, PLAIN, PairRow};
use crate::products::{PairSums, pair_count};
use crate::row::Row;
use crate::sample::Sample;

/// The photometric method's buffers for one camera and image size.
#[derive(Debug)]
pub(crate) struct Photometric<T> {
    across: Across<T>,
    /// One row of the planes: 7 or, with light, 13.
    planes: Vec<Row<T>>,
}

impl<T: Sample> Photometric<T> {
    /// Buffers for images of `[width, height]` pixels, for 7 planes or, with light, 13.
    pub(crate) fn new(camera: Intrinsics, [width, _]: [usize; 2], planes: usize) -> Photometric<T> {
        Photometric { across: Across::new(camera, width), planes: (0..planes).map(|_| Row::zeros(width)).collect() }
    }

    /// The inner products over all pixels, and the multiply-adds they took.
    pub(crate) fn gram(&mut self, path: Path, sights: Sights<'_, T>) -> (Gram, u64) {
        let mut gram = Gram::new();
        match self.planes.len() {
            COLUMNS => dispatch!(path.level(), simd => self.add_rows::<_, COLUMNS>(simd, sights, &mut gram)),
            _ => dispatch!(path.level(), simd => self.add_rows::<_, PLAIN>(simd, sights, &mut gram)),
        }
        gram.features = sights.current.0.samples().len();
        (gram, (gram.features * pair_count(self.planes.len())) as u64)
    }

    #[inline(always)]
    fn add_rows<S: Simd, const N: usize>(&mut self, simd: S, sights: Sights<'_, T>, gram: &mut Gram) {
        let planes = <&mut [Row<T>; N]>::try_from(&mut self.planes[..]).expect("as many rows as planes");
        let mut sums = PairSums::<S, T, N>::new(simd);
        for v in 0..sights.current.0.height() {
            let row = PairRow::of(sights, &self.across, v);
            row.fill(simd, 0..self.across.width(), planes.each_mut().map(Row::padded_mut));
            sums.add(simd, planes.each_ref().map(Row::padded));
        }
        sums.add_to(gram, 1.0);
    }
}
