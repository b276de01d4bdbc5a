//! Epochs: which owner of a task is the newer one. Generation in the upper 16 bits, a hash of the worker's name in the lower, so that
//! two workers that take a task at the same moment do not have the same epoch.

use domvs_proto::keys::Name;

/// 16 bits of a worker's name: FNV-1a, folded. No two live workers may share them.
pub(crate) fn name_hash(worker: &Name) -> u16 {
    let hash =
        worker.as_str().bytes().fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    (hash >> 16 ^ hash) as u16
}

/// The epoch of a task that `worker` creates.
pub(crate) fn first(worker: &Name) -> u32 {
    1 << 16 | u32::from(name_hash(worker))
}

/// The epoch with which `worker` follows an owner of `epoch`, itself before a restart or another; `None` after 65 535 owners.
pub(crate) fn next(epoch: u32, worker: &Name) -> Option<u32> {
    let generation = u16::try_from((epoch >> 16) + 1).ok()?;
    Some(u32::from(generation) << 16 | u32::from(name_hash(worker)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        text.try_into().expect("a name")
    }

    #[test]
    fn every_owner_is_newer_than_the_one_before_whatever_the_names() {
        let mut epoch = first(&name("w1"));
        for generation in 2..=200 {
            let after =
                next(epoch, &name(if generation % 2 == 0 { "w2" } else { "w1" })).expect("generations are left");
            assert!(after > epoch);
            assert_eq!(after >> 16, generation);
            epoch = after;
        }
    }

    #[test]
    fn two_that_follow_the_same_owner_differ() {
        let epoch = first(&name("w1"));
        assert_ne!(next(epoch, &name("w2")), next(epoch, &name("w3")));
    }

    #[test]
    fn the_last_generation_has_no_successor() {
        assert_eq!(next(u32::MAX, &name("w1")), None);
        assert!(next(0xfffe_ffff, &name("w1")).is_some());
    }
}
