//! Products of many short rows with long columns: how planes are blurred.
//!
//! A row of numbers is not zero on a stretch of pixels only. Rows are taken eight at a time, over the pixels where any of the eight is not zero, and
//! meet a block of [`WIDTH`] columns side by side: `sums[row][column] += Σ_x row(x) input[x][column]`, so that what is loaded is used often,
//! and no sum is across a vector. Sums over one block are in the samples' own precision, all others in `f64`.

use std::ops::Range;

use fearless_simd::{Simd, SimdBase, SimdFloat};

use crate::path::has_many_registers;
use crate::sample::Sample;

/// Rows of a tile.
pub(crate) const ROWS: usize = 8;

/// Columns that are summed side by side.
pub(crate) const WIDTH: usize = 32;

/// Sums of a tile, `[row][column]`.
pub(crate) const TILE: usize = ROWS * WIDTH;

/// A row that is zero outside a stretch.
#[derive(Debug, Clone)]
pub(crate) struct BandedRow {
    /// Where `values` begin.
    pub first: usize,
    /// What is not zero.
    pub values: Vec<f64>,
    /// Whether products with it are added (1) or taken off (-1).
    pub sign: f64,
}

impl BandedRow {
    /// Where the values end.
    fn end(&self) -> usize {
        self.first + self.values.len()
    }
}

/// Eight rows of one sign.
#[derive(Debug)]
pub(crate) struct Tile<T> {
    first: usize,
    /// `[x - first][row]`.
    values: Vec<[T; ROWS]>,
    sign: f64,
}

impl<T: Sample> Tile<T> {
    /// Eight rows or fewer, filled up with rows of zeros.
    fn of(rows: &[BandedRow], sign: f64) -> Tile<T> {
        let first = rows.iter().map(|row| row.first).min().unwrap_or(0);
        let end = rows.iter().map(BandedRow::end).max().unwrap_or(0);
        let mut values = vec![[T::ZERO; ROWS]; end - first];
        for (i, row) in rows.iter().enumerate() {
            for (x, value) in (row.first - first..).zip(&row.values) {
                values[x][i] = T::from_f64(*value);
            }
        }
        Tile { first, values, sign }
    }

    /// The pixels where a row is not zero.
    pub(crate) fn pixels(&self) -> Range<usize> {
        self.first..self.first + self.values.len()
    }

    /// Whether products with it are added (1) or taken off (-1).
    pub(crate) fn sign(&self) -> f64 {
        self.sign
    }

    /// Adds the part of `x` in `pixels`, whose columns are `input`, `[x - pixels.start][column]`; anew, if the tile begins there.
    #[inline(always)]
    pub(crate) fn add<S: Simd>(&self, simd: S, pixels: Range<usize>, input: &[T], sums: &mut [f64]) {
        let part = self.first.max(pixels.start)..self.pixels().end.min(pixels.end);
        if part.is_empty() {
            return;
        }
        let values = &self.values[part.start - self.first..part.end - self.first];
        let input = &input[(part.start - pixels.start) * WIDTH..][..values.len() * WIDTH];
        let is_new = self.first >= pixels.start;
        let columns = 2 * T::Vector::<S>::LEN;
        for column in (0..WIDTH).step_by(columns) {
            if has_many_registers::<S>() {
                part_of_tile::<S, T, 8>(simd, values, 0, input, column, sums, is_new);
            } else {
                part_of_tile::<S, T, 4>(simd, values, 0, input, column, sums, is_new);
                part_of_tile::<S, T, 4>(simd, values, 4, input, column, sums, is_new);
            }
        }
    }
}

/// `A` rows from `first` on and two vectors of columns.
#[inline(always)]
fn part_of_tile<S: Simd, T: Sample, const A: usize>(
    simd: S,
    values: &[[T; ROWS]],
    first: usize,
    input: &[T],
    column: usize,
    sums: &mut [f64],
    is_new: bool,
) {
    let (lanes, wide) = (T::Vector::<S>::LEN, S::f64s::LEN);
    let zero = T::Vector::<S>::splat(simd, T::ZERO);
    let mut strands = [[zero; 2]; A];
    for (values, input) in values.iter().zip(input.chunks_exact(WIDTH)) {
        let left = T::Vector::<S>::from_slice(simd, &input[column..column + lanes]);
        let right = T::Vector::<S>::from_slice(simd, &input[column + lanes..column + 2 * lanes]);
        for a in 0..A {
            let value = T::Vector::<S>::splat(simd, values[first + a]);
            strands[a][0] = value.mul_add(left, strands[a][0]);
            strands[a][1] = value.mul_add(right, strands[a][1]);
        }
    }
    for a in 0..A {
        for c in 0..2 {
            let parts = T::widened(simd, strands[a][c]);
            let sums = &mut sums[(first + a) * WIDTH + column + c * lanes..][..lanes];
            for k in 0..T::WIDE {
                let sums = &mut sums[k * wide..(k + 1) * wide];
                let before = if is_new { S::f64s::splat(simd, 0.0) } else { S::f64s::from_slice(simd, sums) };
                (before + parts[k]).store_slice(sums);
            }
        }
    }
}

/// All rows of an axis, in tiles.
#[derive(Debug)]
pub(crate) struct Tiles<T> {
    tiles: Vec<Tile<T>>,
    rows: usize,
    values: usize,
}

impl<T: Sample> Tiles<T> {
    /// These rows by where they begin; of each sign a multiple of `multiple` tiles, the last of which may be empty.
    pub(crate) fn new(rows: &[BandedRow], multiple: usize) -> Tiles<T> {
        let (count, values) = (rows.len(), rows.iter().map(|row| row.values.len()).sum());
        let mut tiles = Vec::new();
        for sign in [1.0, -1.0] {
            let mut rows: Vec<BandedRow> = rows.iter().filter(|row| row.sign == sign).cloned().collect();
            rows.sort_by_key(|row| row.first);
            // Rows that do not meet, as those of both ends, are not put together: all between them would be zeros.
            for meeting in rows.chunk_by(|row, next| next.first < row.end()) {
                tiles.extend(meeting.chunks(ROWS).map(|rows| Tile::of(rows, sign)));
            }
            while !tiles.len().is_multiple_of(multiple) {
                tiles.push(Tile::of(&[], sign));
            }
        }
        Tiles { tiles, rows: count, values }
    }

    /// The same by where they begin, whatever their sign.
    pub(crate) fn in_order(mut self) -> Tiles<T> {
        self.tiles.sort_by_key(|tile| tile.first);
        self
    }

    /// The tiles.
    pub(crate) fn all(&self) -> &[Tile<T>] {
        &self.tiles
    }

    /// Rows that were given.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// Numbers that were given.
    pub(crate) fn values(&self) -> usize {
        self.values
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;
    use crate::path::Path;

    #[test]
    fn rows_at_either_end_stay_in_tiles_of_their_own() {
        let row = |first: usize| BandedRow { first, values: vec![1.0; 9], sign: -1.0 };
        let tiles = Tiles::<f64>::new(&[row(0), row(300), row(2), row(303)], 1);
        let pixels: Vec<Range<usize>> = tiles.all().iter().map(Tile::pixels).collect();
        assert_eq!(pixels, [0..11, 300..312]);
    }

    #[test]
    fn tiles_gather_what_the_rows_say_block_by_block_on_every_path() {
        let row = |first: usize, count: usize| {
            let values = (0..count).map(|i| ((3 * i + first) % 7) as f64 - 3.0).collect();
            BandedRow { first, values, sign: 1.0 }
        };
        let rows: Vec<BandedRow> = (0..11).map(|i| row(4 * i, 5 + i)).collect();
        let tiles = Tiles::<f32>::new(&rows, 4);
        assert_eq!((tiles.all().len(), tiles.rows(), tiles.values()), (4, 11, 110));
        let input: Vec<f32> = (0..64 * WIDTH).map(|i| (i % 13) as f32 - 4.0).collect();
        for path in Path::available() {
            let mut sums = vec![7.0; 2 * TILE];
            for (tile, sums) in tiles.all().iter().zip(sums.chunks_exact_mut(TILE)) {
                for pixels in [0..20, 20..52, 52..64] {
                    let input = &input[pixels.start * WIDTH..pixels.end * WIDTH];
                    dispatch!(path.level(), simd => tile.add(simd, pixels, input, sums));
                }
            }
            for (i, column) in (0..11).flat_map(|i| (0..WIDTH).map(move |column| (i, column))) {
                let at = |x: usize| f64::from(input[x * WIDTH + column]);
                let expected: f64 = (rows[i].first..).zip(&rows[i].values).map(|(x, value)| value * at(x)).sum();
                assert_eq!(sums[i * WIDTH + column], expected, "whole numbers: row {i}, column {column}, {path}");
            }
        }
    }
}
