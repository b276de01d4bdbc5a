//! One fuzzer for all targets: `DOMVS_FUZZ=png domvs-fuzz corpus…` with libFuzzer's own options. `fuzz/run` is how to start it.
#![no_main]

mod targets;

use std::alloc::System;
use std::sync::OnceLock;

use cap::Cap;
use libfuzzer_sys::fuzz_target;

/// What one input may make the decoders take, bytes: the limits that the targets decode under allow for a tenth of it.
const MOST_BYTES: usize = 64 << 20;

#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, usize::MAX);

static TARGET: OnceLock<fn(&[u8])> = OnceLock::new();

fn chosen() -> fn(&[u8]) {
    let name = std::env::var("DOMVS_FUZZ").unwrap_or_default();
    let known = targets::ALL.iter().find(|(known, _)| *known == name);
    let words: Vec<&str> = targets::ALL.iter().map(|(known, _)| *known).collect();
    known.unwrap_or_else(|| panic!("DOMVS_FUZZ names one of {words:?}, got {name:?}")).1
}

fuzz_target!(|data: &[u8]| {
    let target = TARGET.get_or_init(chosen);
    ALLOCATOR.set_limit(ALLOCATOR.allocated() + MOST_BYTES).expect("above what is in use");
    target(data);
    ALLOCATOR.set_limit(usize::MAX).expect("no limit");
});
