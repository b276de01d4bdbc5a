//! The value of a given rank among many, fast enough to be asked of every frame's depth map.
//!
//! A regular sample of the values bounds the one that is sought; one sweep counts those below the bounds and collects those between
//! them, which are few; the rank is then found among these. Where the bounds miss it, which coherent images hardly ever do, all
//! values are searched: the result is the same, exactly.

use fearless_simd::dispatch;

use crate::path::Path;
use crate::sample::Sample;

/// About how many values are sampled.
const SAMPLED: usize = 4096;
/// How far the bounds lie from the rank, as a share of the sample: some three standard deviations of a random one.
const MARGIN: f64 = 0.023;
/// Values are looked at in groups of so many before any is looked at by itself.
const GROUP: usize = 64;

/// The value with `rank` smaller or equal ones before it, of the `kept` ones that are not left out: all of them numbers.
/// `room` is cleared; nothing is allocated if it has room for all values.
pub(crate) fn select<T: Sample>(values: &[T], left_out: &[bool], [rank, kept]: [usize; 2], room: &mut Vec<T>) -> T {
    bounds(values, left_out, rank as f64 / kept as f64, room)
        .and_then(|bounds| dispatch!(Path::best().level(), _ => between(values, left_out, rank, bounds, room)))
        .unwrap_or_else(|| {
            room.clear();
            room.extend(values.iter().zip(left_out).filter(|(_, out)| !**out).map(|(value, _)| *value));
            nth(room, rank)
        })
}

/// Two sampled values, most likely on either side of the one that has the share `rank` of the others before it.
fn bounds<T: Sample>(values: &[T], left_out: &[bool], rank: f64, room: &mut Vec<T>) -> Option<[T; 2]> {
    room.clear();
    // Odd, so that it does not fall on the same columns in every row of an image.
    let step = (values.len() / SAMPLED) | 1;
    room.extend(values.iter().zip(left_out).step_by(step).filter(|(_, out)| !**out).map(|(value, _)| *value));
    let place = room.len() as f64 * rank;
    let margin = room.len() as f64 * MARGIN + 2.0;
    let highest = room.len().checked_sub(1)?;
    let [low, high] = [place - margin, place + margin].map(|place| (place.max(0.0) as usize).min(highest));
    let high_value = nth(room, high);
    let low_value = nth(&mut room[..=high], low);
    Some([low_value, high_value])
}

/// The value of this rank if it lies within the bounds.
#[inline(always)]
fn between<T: Sample>(
    values: &[T],
    left_out: &[bool],
    rank: usize,
    [low, high]: [T; 2],
    room: &mut Vec<T>,
) -> Option<T> {
    room.clear();
    let (mut below, mut at_low) = (0, 0);
    for (values, left_out) in values.chunks(GROUP).zip(left_out.chunks(GROUP)) {
        let (mut less, mut equal, mut inside) = (0u32, 0u32, 0u32);
        for (value, out) in values.iter().zip(left_out) {
            less += u32::from((*value < low) & !out);
            equal += u32::from((*value == low) & !out);
            inside += u32::from((*value > low) & (*value <= high) & !out);
        }
        (below, at_low) = (below + less as usize, at_low + equal as usize);
        if inside > 0 {
            let each = values.iter().zip(left_out);
            room.extend(
                each.filter(|(value, out)| **value > low && **value <= high && !**out).map(|(value, _)| *value),
            );
        }
    }
    match rank.checked_sub(below)? {
        rank if rank < at_low => Some(low),
        rank => (rank - at_low < room.len()).then(|| nth(room, rank - at_low)),
    }
}

fn nth<T: Sample>(values: &mut [T], rank: usize) -> T {
    *values.select_nth_unstable_by(rank, |a, b| a.partial_cmp(b).expect("numbers, by the contract")).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(values: &[f32], left_out: &[bool]) {
        let mut sorted: Vec<f32> = values.iter().zip(left_out).filter(|(_, out)| !**out).map(|(v, _)| *v).collect();
        sorted.sort_by(f32::total_cmp);
        for rank in [0, sorted.len() / 3, (sorted.len() - 1) / 2, sorted.len() - 1] {
            assert_eq!(
                select(values, left_out, [rank, sorted.len()], &mut Vec::new()),
                sorted[rank],
                "rank {rank} of {}",
                sorted.len()
            );
        }
    }

    #[test]
    fn the_rank_is_found_among_walls_ramps_and_noise() {
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) >> 8;
        let scenes: [&dyn Fn(usize) -> f32; 5] = [
            &|_| 1.0,
            &|i| if i < 30_000 { 1.0 } else { 2.0 },
            &|i| (i % 640) as f32,
            &|i| noise(i) as f32,
            // What the sample sees says nothing about the rest.
            &|i| if i % 15 == 0 { 9.0 } else { (noise(i) % 7) as f32 },
        ];
        for scene in scenes {
            for count in [1, 2, 63, 4_096, 62_001] {
                let values: Vec<f32> = (0..count).map(scene).collect();
                judged(&values, &vec![false; count]);
                judged(&values, &(0..count).map(|i| i % 5 == 3).collect::<Vec<_>>());
            }
        }
    }
}
