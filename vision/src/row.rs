//! A row of samples as the kernels want it: it begins where a vector register's line of memory does, and ends in zeros.

use fearless_simd::{Simd, SimdBase};

use crate::aligned::Aligned;
use crate::sample::Sample;

/// Rows are padded to whole multiples of this many samples, the most that any vector holds.
pub(crate) const PADDING: usize = 16;

/// Padded and aligned samples.
#[derive(Debug)]
pub(crate) struct Row<T>(Aligned<T>);

impl<T: Sample> Row<T> {
    /// Zeros for `length` samples.
    pub(crate) fn zeros(length: usize) -> Row<T> {
        Row(Aligned::filled(length.next_multiple_of(PADDING), T::ZERO))
    }

    /// The samples, the padding included.
    pub(crate) fn padded(&self) -> &[T] {
        self.0.as_slice()
    }

    /// The samples, the padding included; whoever writes there keeps it finite.
    pub(crate) fn padded_mut(&mut self) -> &mut [T] {
        self.0.as_mut_slice()
    }
}

/// What a kernel may take for granted of a place in a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Place {
    /// A whole vector of samples is there, and one more on each side.
    Inside,
    /// Nothing but the first sample.
    Border,
}

impl Place {
    /// Of the samples from `at` on, in a row of so many.
    #[inline(always)]
    pub(crate) fn of<S: Simd, T: Sample>(at: usize, width: usize) -> Place {
        if at > 0 && at + T::Vector::<S>::LEN < width { Place::Inside } else { Place::Border }
    }
}

/// As many samples as a vector holds, from `row[first..]`; zeros behind its end.
#[inline(always)]
pub(crate) fn load<S: Simd, T: Sample>(simd: S, row: &[T], first: usize) -> T::Vector<S> {
    let length = T::Vector::<S>::LEN;
    match row.get(first..first + length) {
        Some(samples) => T::Vector::<S>::from_slice(simd, samples),
        None => {
            let rest = rest(row, first);
            T::Vector::<S>::from_slice(simd, &rest[..length])
        }
    }
}

/// The same from one sample to the left; before its first one the row goes on in a straight line.
#[inline(always)]
pub(crate) fn load_left<S: Simd, T: Sample>(simd: S, row: &[T], first: usize) -> T::Vector<S> {
    if first == 0 {
        return load::<S, T>(simd, row, 0).shift_elements_right::<1>(line(row[0], row[1]));
    }
    load(simd, row, first - 1)
}

/// The same from one sample to the right; behind its last one the row goes on in a straight line, for one sample.
#[inline(always)]
pub(crate) fn load_right<S: Simd, T: Sample>(simd: S, row: &[T], first: usize) -> T::Vector<S> {
    let (length, last) = (T::Vector::<S>::LEN, row.len() - 1);
    match row.get(first + 1..first + 1 + length) {
        Some(samples) => T::Vector::<S>::from_slice(simd, samples),
        None if first + length == row.len() => {
            load::<S, T>(simd, row, first).shift_elements_left::<1>(line(row[last], row[last - 1]))
        }
        None => {
            let mut rest = rest(row, first + 1);
            rest[last - first] = line(row[last], row[last - 1]);
            T::Vector::<S>::from_slice(simd, &rest[..length])
        }
    }
}

/// [`load_left`], [`load`] and [`load_right`].
#[inline(always)]
pub(crate) fn load_around<S: Simd, T: Sample>(simd: S, row: &[T], first: usize, place: Place) -> [T::Vector<S>; 3] {
    match place {
        Place::Inside => {
            let samples = &row[first - 1..first + 1 + T::Vector::<S>::LEN];
            let lanes = T::Vector::<S>::LEN;
            [
                T::Vector::<S>::from_slice(simd, &samples[..lanes]),
                T::Vector::<S>::from_slice(simd, &samples[1..1 + lanes]),
                T::Vector::<S>::from_slice(simd, &samples[2..2 + lanes]),
            ]
        }
        Place::Border => [load_left(simd, row, first), load(simd, row, first), load_right(simd, row, first)],
    }
}

/// What follows `end` in a straight line from the sample before it.
#[inline(always)]
fn line<T: Sample>(end: T, inner: T) -> T {
    end + (end - inner)
}

#[cold]
#[inline(never)]
fn rest<T: Sample>(row: &[T], first: usize) -> [T; PADDING] {
    let (mut samples, rest) = ([T::ZERO; PADDING], &row[first..]);
    let count = rest.len().min(PADDING);
    samples[..count].copy_from_slice(&rest[..count]);
    samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::Path;

    #[test]
    fn a_row_ends_in_zeros() {
        for length in [1, 15, 16, 97, 640] {
            let row = Row::<f32>::zeros(length);
            assert!(row.padded().len() >= length && row.padded().len().is_multiple_of(PADDING));
            assert!(row.padded().iter().all(|sample| *sample == 0.0));
        }
    }

    #[test]
    fn beyond_its_ends_a_row_goes_on_in_a_straight_line_and_then_in_zeros() {
        let row: Vec<f64> = (0..20).map(|u| 3.0 + 2.0 * u as f64).collect();
        for path in Path::available() {
            fearless_simd::dispatch!(path.level(), simd => check(simd, &row));
        }

        #[inline(always)]
        fn check<S: Simd>(simd: S, row: &[f64]) {
            let lanes = S::f64s::LEN;
            let (left, right) = (load_left::<S, f64>(simd, row, 0), load_right::<S, f64>(simd, row, 19));
            let (inner, exact) = (load_left::<S, f64>(simd, row, lanes), load_right::<S, f64>(simd, &row[..lanes], 0));
            let rest = load::<S, f64>(simd, row, 19);
            assert_eq!((left[0], left[1], inner[0]), (1.0, 3.0, row[lanes - 1]), "{lanes} lanes");
            assert_eq!((right[0], exact[lanes - 1], rest[0]), (43.0, 3.0 + 2.0 * lanes as f64, 41.0), "{lanes} lanes");
            assert!((1..lanes).all(|lane| right[lane] == 0.0 && rest[lane] == 0.0));
        }
    }
}
