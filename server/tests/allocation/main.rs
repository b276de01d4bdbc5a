//! What the way of a frame allocates, nothing, and what a hostile one can make it allocate. Counted by a global allocator of its own, so one check runs after the other in one
//! process and nothing else does: there is no test harness whose threads would be counted along.

mod frames;
mod hostile;
mod memory;
mod network;
mod pictures;

use std::alloc::System;

use stats_alloc::{INSTRUMENTED_SYSTEM, Region, Stats, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Allocations and reallocations while `work` ran, in all threads.
fn allocations<T>(work: impl FnOnce() -> T) -> (usize, T) {
    let region = Region::new(ALLOCATOR);
    let made = work();
    let Stats { allocations, reallocations, .. } = region.change();
    (allocations + reallocations, made)
}

/// Bytes that are allocated now.
fn live_bytes() -> isize {
    let stats = ALLOCATOR.stats();
    stats.bytes_allocated as isize - stats.bytes_deallocated as isize
}

fn main() {
    let checks: [(&str, fn()); 7] = [
        ("a_steady_frame_of_any_raw_format_allocates_nothing", frames::raw_formats_allocate_nothing),
        ("a_steady_frame_of_any_method_allocates_nothing", frames::methods_allocate_nothing),
        ("a_picture_file_allocates_little_and_the_same_for_every_frame", frames::files_allocate_little),
        ("hostile_frames_are_refused_before_memory_is_taken", hostile::frames_are_refused_before_memory_is_taken),
        (
            "hostile_bodies_take_no_more_than_thirty_two_mebibytes",
            hostile::bodies_take_no_more_than_thirty_two_mebibytes,
        ),
        ("a_task_keeps_to_its_memory_and_gives_it_back", memory::a_task_gives_its_memory_back),
        ("a_twist_over_zenoh_allocates_no_more_than_an_echo", network::a_twist_allocates_no_more_than_an_echo),
    ];
    for (name, check) in checks {
        check();
        println!("check {name} ... ok");
    }
}
