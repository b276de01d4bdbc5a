//! A row of samples as the kernels want it: it begins where a vector register's line of memory does, and ends in zeros.

use fearless_simd::{Simd, SimdBase};

use crate::sample::Sample;

/// Rows are padded to whole multiples of this many samples, the most that any vector holds.
pub(crate) const PADDING: usize = 16;

/// Bytes of the longest vector, and of a cache line.
const ALIGNMENT: usize = 64;

/// Padded and aligned samples.
#[derive(Debug)]
pub(crate) struct Row<T> {
    samples: Vec<T>,
    first: usize,
    padded: usize,
}

impl<T: Sample> Row<T> {
    /// Zeros for `length` samples.
    pub(crate) fn zeros(length: usize) -> Row<T> {
        let padded = length.next_multiple_of(PADDING);
        let samples = vec![T::ZERO; padded + ALIGNMENT];
        // The vector never grows, so its samples stay where they are.
        let first = samples.as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT);
        Row { samples, first, padded }
    }

    /// The samples, the padding included.
    pub(crate) fn padded(&self) -> &[T] {
        &self.samples[self.first..][..self.padded]
    }

    /// The samples, the padding included; whoever writes there keeps it finite.
    pub(crate) fn padded_mut(&mut self) -> &mut [T] {
        &mut self.samples[self.first..][..self.padded]
    }
}

/// As many samples as a vector holds, from `row[first..]`; zeros behind its end.
#[inline(always)]
pub(crate) fn load<S: Simd, T: Sample>(simd: S, row: &[T], first: usize) -> T::Vector<S> {
    let length = T::Vector::<S>::LEN;
    match row.get(first..first + length) {
        Some(samples) => T::Vector::<S>::from_slice(simd, samples),
        None => {
            let rest = rest(row, first as isize);
            T::Vector::<S>::from_slice(simd, &rest[..length])
        }
    }
}

/// The same from one sample to the left (`BY = -1`) or right (`BY = 1`); one sample beyond each border the row goes on in a straight line.
#[inline(always)]
pub(crate) fn load_beside<S: Simd, T: Sample, const BY: isize>(simd: S, row: &[T], first: usize) -> T::Vector<S> {
    let (length, from) = (T::Vector::<S>::LEN, first.wrapping_add_signed(BY));
    match row.get(from..from.wrapping_add(length)) {
        Some(samples) => T::Vector::<S>::from_slice(simd, samples),
        None => {
            let beside = beside(row, first as isize + BY);
            T::Vector::<S>::from_slice(simd, &beside[..length])
        }
    }
}

#[cold]
#[inline(never)]
fn rest<T: Sample>(row: &[T], first: isize) -> [T; PADDING] {
    std::array::from_fn(|lane| row.get((first + lane as isize) as usize).copied().unwrap_or(T::ZERO))
}

#[cold]
#[inline(never)]
fn beside<T: Sample>(row: &[T], first: isize) -> [T; PADDING] {
    let last = row.len() - 1;
    let line = |end: T, inner: T| end + (end - inner);
    std::array::from_fn(|lane| match first + lane as isize {
        -1 => line(row[0], row[1]),
        u if u as usize == row.len() => line(row[last], row[last - 1]),
        u => row.get(u as usize).copied().unwrap_or(T::ZERO),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::Path;

    #[test]
    fn a_row_begins_at_a_line_of_memory_and_ends_in_zeros() {
        for length in [1, 15, 16, 97, 640] {
            let mut row = Row::<f32>::zeros(length);
            assert_eq!(row.padded().as_ptr().align_offset(ALIGNMENT), 0);
            assert!(row.padded().len() >= length && row.padded_mut().len().is_multiple_of(PADDING));
        }
    }

    #[test]
    fn beyond_its_ends_a_row_goes_on_in_a_straight_line_and_then_in_zeros() {
        let row: Vec<f64> = (0..20).map(|u| 3.0 + 2.0 * u as f64).collect();
        for path in Path::available() {
            let (left, right, rest) = fearless_simd::dispatch!(path.level(), simd => {
                let left = load_beside::<_, f64, -1>(simd, &row, 0).as_slice()[0];
                let at_19 = load_beside::<_, f64, 1>(simd, &row, 19);
                (left, at_19.as_slice().to_vec(), load::<_, f64>(simd, &row, 19).as_slice().to_vec())
            });
            assert_eq!((left, right[0], rest[0]), (1.0, 43.0, 41.0), "{path}");
            assert!(right[1..].iter().chain(&rest[1..]).all(|beyond| *beyond == 0.0));
        }
    }
}
