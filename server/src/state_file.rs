//! One task in a file of the state directory: all of it, or nothing.
//!
//! `domvs-state 1\n` · four u64, little-endian: how long the four parts are · JSON as on `state` · the target's header, its Encoding, its
//! payload (all three empty without a target) · SHA3-256 of everything before. Whatever is cut, longer or changed is refused.

use domvs_proto::body;
use domvs_proto::frame::FrameHeader;
use domvs_proto::messages::TaskState;
use sha3::{Digest, Sha3_256};

use crate::task::SentTarget;

const MAGIC: &[u8] = b"domvs-state 1\n";
const LENGTHS: usize = 4 * 8;
const CHECKSUM: usize = 32;

/// Why a file cannot be used. Nothing of it is.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum StateFileError {
    /// It does not begin as these files do.
    #[error("not a state file of version 1")]
    NotOne,
    /// It is shorter or longer than it says.
    #[error("expected {expected} bytes, got {got}")]
    Length {
        /// What its lengths add up to.
        expected: u64,
        /// What there is.
        got: usize,
    },
    /// Some of its bytes have changed.
    #[error("the checksum is wrong")]
    Checksum,
    /// Its parts do not make a task.
    #[error("unreadable: {reason}")]
    Unreadable {
        /// What is wrong.
        reason: String,
    },
}

/// The bytes of a file.
pub fn encode(state: &TaskState, target: Option<&SentTarget>) -> Vec<u8> {
    let json = body::write(state);
    let (header, encoding, payload) = match target {
        Some(target) => (target.header.encode(), target.encoding.as_bytes(), target.payload.as_slice()),
        None => (vec![], &[][..], &[][..]),
    };
    of_parts([&json, &header, encoding, payload])
}

/// A file of these parts, whatever they say: JSON, header, Encoding, payload.
pub fn of_parts(parts: [&[u8]; 4]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    parts.iter().for_each(|part| bytes.extend((part.len() as u64).to_le_bytes()));
    parts.iter().for_each(|part| bytes.extend(*part));
    let checksum = Sha3_256::digest(&bytes);
    bytes.extend(checksum);
    bytes
}

/// The task in a file's bytes.
///
/// # Errors
/// Anything that is not, to the last byte, what [`encode`] made.
pub fn decode(bytes: &[u8]) -> Result<(TaskState, Option<SentTarget>), StateFileError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or(StateFileError::NotOne)?;
    let cut = |expected: usize| StateFileError::Length { expected: expected as u64, got: bytes.len() };
    let (lengths, rest) = rest.split_at_checked(LENGTHS).ok_or_else(|| cut(MAGIC.len() + LENGTHS + CHECKSUM))?;
    let lengths: [u64; 4] =
        std::array::from_fn(|i| u64::from_le_bytes(std::array::from_fn(|byte| lengths[8 * i + byte])));
    let parts = lengths.iter().try_fold(0_u64, |sum, length| sum.checked_add(*length)).unwrap_or(u64::MAX);
    let expected = parts.saturating_add((MAGIC.len() + LENGTHS + CHECKSUM) as u64);
    if expected != bytes.len() as u64 {
        return Err(StateFileError::Length { expected, got: bytes.len() });
    }
    let (content, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
    if Sha3_256::digest(content).as_slice() != checksum {
        return Err(StateFileError::Checksum);
    }
    // Their sum has just been found to be no more than what there is.
    let (json, rest) = rest.split_at(lengths[0] as usize);
    let (header, rest) = rest.split_at(lengths[1] as usize);
    let (encoding, rest) = rest.split_at(lengths[2] as usize);
    read(json, header, encoding, &rest[..lengths[3] as usize])
}

fn read(
    json: &[u8],
    header: &[u8],
    encoding: &[u8],
    payload: &[u8],
) -> Result<(TaskState, Option<SentTarget>), StateFileError> {
    let unreadable = |reason: &dyn std::fmt::Display| StateFileError::Unreadable { reason: reason.to_string() };
    let state: TaskState = body::read(json).map_err(|error| unreadable(&error))?;
    let Some(reference) = &state.target else {
        return match payload {
            [] => Ok((state, None)),
            _ => Err(unreadable(&"a target that the state does not name")),
        };
    };
    let header = FrameHeader::decode(header).map_err(|error| unreadable(&error))?;
    let encoding = str::from_utf8(encoding).map_err(|error| unreadable(&error))?;
    let target = SentTarget::new(header, encoding.to_owned(), payload.to_vec());
    match target.hash() == reference.hash {
        true => Ok((state, Some(target))),
        false => Err(unreadable(&"the target is not the one that the state names")),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use domvs_proto::frame::{PixelFormat, Secret};
    use domvs_proto::messages::{FramesDropped, Phase, Progress, TargetReference};
    use domvs_proto::settings::{Camera, TaskSettings};
    use domvs_proto::status::Status;

    use super::*;

    /// A small task; `payload` makes the difference.
    pub(crate) fn task(payload: Option<&[u8]>) -> (TaskState, Option<SentTarget>) {
        let camera = Camera { fx: 9.0, fy: 9.0, cx: 3.5, cy: 3.5, width: 8, height: 8, distortion: None };
        let header = FrameHeader::new(PixelFormat::Mono8, 8, 8);
        let target = payload.map(|payload| SentTarget::new(header, "image/x".to_owned(), payload.to_vec()));
        let state = TaskState {
            task: "alice/t1".parse().expect("a task"),
            worker: "w1".try_into().expect("a name"),
            epoch: 65_578,
            revision: 7,
            secret_hash: Secret::new([7; 16]).hash(),
            frame_secret_hash: Secret::new([7; 16]).for_frames().hash(),
            settings: TaskSettings::new(camera),
            target: target.as_ref().map(|target| TargetReference {
                hash: target.hash().to_owned(),
                width: 8,
                height: 8,
                payload_bytes: target.payload.len() as u64,
            }),
            progress: Progress {
                status: Status::Servoing,
                phase: Phase::Running,
                twists: 3,
                held_frames: 0,
                sequence: 3,
                initial_pixel_mse: Some(0.25),
                initial_order_mse: Some(0.25),
                frames_in: 3,
                frames_dropped: FramesDropped::default(),
            },
        };
        (state, target)
    }

    #[test]
    fn what_was_written_is_read_with_and_without_a_target() {
        for payload in [None, Some(&[5_u8; 64][..])] {
            let (state, target) = task(payload);
            let (read_state, read_target) = decode(&encode(&state, target.as_ref())).expect("whole");
            assert_eq!(read_state, state);
            let parts = |target: SentTarget| (target.header, target.encoding, target.payload);
            assert_eq!(read_target.map(parts), target.map(parts));
        }
    }

    #[test]
    fn a_file_cut_or_changed_at_any_byte_or_longer_is_refused() {
        let (state, target) = task(Some(&[5; 64]));
        let whole = encode(&state, target.as_ref());
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "cut to {length} bytes");
        }
        for place in 0..whole.len() {
            for change in [1_u8, 0x80, 0xff] {
                let mut changed = whole.clone();
                changed[place] ^= change;
                assert!(decode(&changed).is_err(), "byte {place} changed by {change:#x}");
            }
        }
        let longer = [&whole[..], &[0]].concat();
        assert_eq!(
            decode(&longer).map(|_| ()),
            Err(StateFileError::Length { expected: whole.len() as u64, got: whole.len() + 1 })
        );
    }

    #[test]
    fn lengths_that_lie_allocate_nothing() {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([0xff; LENGTHS + CHECKSUM]);
        assert!(matches!(decode(&bytes), Err(StateFileError::Length { .. })));
    }
}
