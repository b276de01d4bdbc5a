//! The inner products of two blurred planes, without the blurred planes: `⟨G*a, G*b⟩ = Σ_ik D_i D_k (F_v a F_uᵀ)_ik (F_v b F_uᵀ)_ik`.
//!
//! `F` and the signs `D` are those of [`crate::low_rank`], or of the blur itself ([`crate::convolution`]), with a row for each pixel and no minus. A strip
//! of columns at a time, all planes meet the rows along `v`; what comes out is turned, so that the rows along `u` meet it just so; and what they
//! have seen the last of is multiplied at once and forgotten. So all sums are of columns side by side, and little has to be kept.

use std::ops::Range;

use fearless_simd::Simd;

use crate::banded::{BandedRow, ROWS, TILE, Tiles, WIDTH};
use crate::products::{PairSums, pair_count};
use crate::sample::Sample;

/// Rows of an image that meet the rows along `v` together.
pub(crate) const BLOCK: usize = 32;

/// Samples of one plane in a block of a strip, `[v][u]`.
pub(crate) const PART: usize = BLOCK * WIDTH;

/// Tiles along `v` whose rows are side by side once they are turned.
const TILES_OF_A_GROUP: usize = WIDTH / ROWS;

/// Buffers for products of planes of samples `P`.
#[derive(Debug)]
pub(crate) struct BlurredProducts<P> {
    size: [usize; 2],
    along_v: Tiles<P>,
    along_u: Tiles<f64>,
    /// Of one strip, `[plane][tile along v][row][u]`.
    strip: Vec<f64>,
    /// The same, `[plane][group of rows along v][u][row]`.
    turned: Vec<f64>,
    /// `[group][plane][slot][row along u][row along v]`: a tile along `u` uses the slot of its number modulo `slots`.
    products: Vec<f64>,
    slots: usize,
    /// The first tile along `u` that is not finished.
    next: usize,
}

impl<P: Sample> BlurredProducts<P> {
    /// Buffers for `planes` planes of `[width, height]` samples, with these rows along `u` and `v`.
    pub(crate) fn new(size: [usize; 2], planes: usize, [along_u, along_v]: [&[BandedRow]; 2]) -> BlurredProducts<P> {
        let (along_u, along_v) = (Tiles::new(along_u, 1).in_order(), Tiles::new(along_v, TILES_OF_A_GROUP));
        let slots = most_at_once(&along_u);
        let tiles = along_v.all().len();
        BlurredProducts {
            size,
            strip: vec![0.0; planes * tiles * TILE],
            turned: vec![0.0; planes * tiles * TILE],
            products: vec![0.0; planes * tiles / TILES_OF_A_GROUP * slots * TILE],
            along_u,
            along_v,
            slots,
            next: 0,
        }
    }

    /// Strips of an image.
    pub(crate) fn strips(&self) -> usize {
        self.size[0].div_ceil(WIDTH)
    }

    /// The columns of a strip.
    pub(crate) fn columns(&self, strip: usize) -> Range<usize> {
        strip * WIDTH..((strip + 1) * WIDTH).min(self.size[0])
    }

    /// Multiply-adds of one pair of images: the rows along both axes, and the products.
    pub(crate) fn multiply_adds(&self, planes: usize) -> u64 {
        let (rows_u, rows_v) = (self.along_u.rows(), self.along_v.rows());
        let projections = planes * (self.size[0] * self.along_v.values() + rows_v * self.along_u.values());
        (projections + rows_u * rows_v * pair_count(planes)) as u64
    }

    /// Takes the image rows `rows` of a strip: `parts`, `[plane][v - rows.start][u]` with room for [`BLOCK`] rows each.
    #[inline(always)]
    pub(crate) fn take_rows<S: Simd>(&mut self, simd: S, rows: Range<usize>, parts: &[P]) {
        let tiles = self.along_v.all();
        for (part, sums) in parts.chunks_exact(PART).zip(self.strip.chunks_exact_mut(tiles.len() * TILE)) {
            for (tile, sums) in tiles.iter().zip(sums.chunks_exact_mut(TILE)) {
                tile.add(simd, rows.clone(), part, sums);
            }
        }
    }

    /// Ends a strip; adds the products of what it finishes to the sum of those that are added, or of those that are taken off.
    #[inline(always)]
    pub(crate) fn end_strip<S: Simd, const N: usize>(
        &mut self,
        simd: S,
        strip: usize,
        [plus, minus]: &mut [PairSums<S, f64, N>; 2],
    ) {
        self.turn();
        let columns = self.columns(strip);
        let tiles = self.along_u.all();
        let (groups, first) = (self.along_v.all().len() / TILES_OF_A_GROUP, self.next);
        let live = tiles[first..].iter().take_while(|tile| tile.pixels().start < columns.end).count();
        for group in 0..groups {
            for plane in 0..N {
                let input = &self.turned[(plane * groups + group) * WIDTH * WIDTH..][..WIDTH * WIDTH];
                let sums = &mut self.products[(group * N + plane) * self.slots * TILE..][..self.slots * TILE];
                for (number, tile) in (first..).zip(&tiles[first..first + live]) {
                    let sums = &mut sums[number % self.slots * TILE..][..TILE];
                    tile.add(simd, columns.clone(), input, sums);
                }
            }
        }
        while let Some(tile) = tiles.get(self.next).filter(|tile| tile.pixels().end <= columns.end) {
            for group in 0..groups {
                let sign = tile.sign() * self.along_v.all()[group * TILES_OF_A_GROUP].sign();
                let mut planes: [&[f64]; N] = [&[]; N];
                for plane in 0..N {
                    let slot = (group * N + plane) * self.slots + self.next % self.slots;
                    planes[plane] = &self.products[slot * TILE..][..TILE];
                }
                let sums = if sign > 0.0 { &mut *plus } else { &mut *minus };
                sums.add(simd, planes);
            }
            self.next += 1;
        }
        if columns.end == self.size[0] {
            self.next = 0;
        }
    }

    /// `turned` from `strip`.
    #[inline(always)]
    fn turn(&mut self) {
        let group = TILES_OF_A_GROUP * TILE;
        for (from, to) in self.strip.chunks_exact(group).zip(self.turned.chunks_exact_mut(group)) {
            for i in 0..WIDTH {
                for u in 0..WIDTH {
                    to[u * WIDTH + i] = from[i * WIDTH + u];
                }
            }
        }
    }
}

/// How many tiles, from one that is not finished to the last that has begun, there are at most at the end of a strip.
fn most_at_once(along_u: &Tiles<f64>) -> usize {
    let tiles = along_u.all();
    let last_strip = |i: usize| tiles[i].pixels().end.saturating_sub(1) / WIDTH;
    let mut finished_by = 0;
    (0..tiles.len()).fold(1, |most, i| {
        // Tiles leave in order: this one stays for those before it.
        finished_by = finished_by.max(last_strip(i));
        let begun = tiles.partition_point(|tile| tile.pixels().start / WIDTH <= finished_by);
        most.max(begun - i)
    })
}
