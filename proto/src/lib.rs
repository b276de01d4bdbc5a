//! What crosses the network between Domvs, its cameras and its clients: wire version 1.
//!
//! `keys` says where a message goes, `frame` and `twist` are the two binary messages of the hot path,
//! `settings` and `messages` are the JSON bodies, `status` is the reason behind every zero twist.
//! `docs/protocol.md` says the same for other languages; `golden/v1` holds one example of each message.
//!
//! Deliberately not here: Zenoh, images, clocks, randomness. Bytes in, checked values out, and back.

pub mod body;
pub mod frame;
pub mod keys;
pub mod messages;
pub mod settings;
pub mod status;
pub mod twist;

/// The version in byte 0 of a frame header and of a twist.
pub const WIRE_VERSION: u8 = 1;
