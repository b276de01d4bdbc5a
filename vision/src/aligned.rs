//! Samples that begin at a cache line: the longest vector is loaded from one line, not from two.

use std::fmt;

/// Bytes of the longest vector, and of a cache line.
const ALIGNMENT: usize = 64;

/// Samples, those from `first` on; that one is at a multiple of [`ALIGNMENT`].
pub(crate) struct Aligned<T> {
    samples: Vec<T>,
    first: usize,
}

impl<T> Aligned<T> {
    pub(crate) fn as_slice(&self) -> &[T] {
        &self.samples[self.first..]
    }

    pub(crate) fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.samples[self.first..]
    }
}

impl<T: Clone> Aligned<T> {
    /// A copy of these.
    pub(crate) fn copied(samples: &[T]) -> Aligned<T> {
        // Room for all, so that they never move.
        let mut room = Vec::<T>::with_capacity(samples.len() + ALIGNMENT);
        let first = room.as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT);
        // What lies before the first is not looked at.
        room.extend(samples.iter().cycle().take(first).cloned());
        let first = room.len();
        room.extend_from_slice(samples);
        Aligned { samples: room, first }
    }

    /// Samples of one value.
    pub(crate) fn filled(length: usize, value: T) -> Aligned<T> {
        let mut samples = vec![value; length + ALIGNMENT];
        let first = samples.as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT);
        // A vector that becomes shorter stays where it is.
        samples.truncate(first + length);
        Aligned { samples, first }
    }
}

impl<T: Clone> Clone for Aligned<T> {
    fn clone(&self) -> Aligned<T> {
        Aligned::copied(self.as_slice())
    }
}

impl<T: PartialEq> PartialEq for Aligned<T> {
    fn eq(&self, other: &Aligned<T>) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl<T: fmt::Debug> fmt::Debug for Aligned<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_slice().fmt(formatter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_begin_at_a_line_of_memory_and_so_do_their_copies() {
        for length in [1, 15, 16, 97, 640, 307_200] {
            let samples: Vec<f32> = (0..length).map(|i| i as f32).collect();
            let aligned = Aligned::copied(&samples);
            let copy = aligned.clone();
            assert_eq!((aligned.as_slice(), &copy), (&samples[..], &aligned));
            for aligned in [aligned, copy] {
                assert_eq!(aligned.as_slice().as_ptr().align_offset(ALIGNMENT), 0);
            }
        }
    }
}
