//! Twist: the camera velocity that answers a frame, and how it was found. 128 bytes, `<BBHHHQQIIII6d3dd8x`.
//!
//! Reading fails closed: what is not clearly an order to move comes out as zeros or as an error, never as motion.
//! The same fields as JSON are in `json`.

mod json;

use crate::WIRE_VERSION;
use crate::status::Status;

/// Bytes of a twist.
pub const TWIST_BYTES: usize = 128;

/// The Encoding of a twist in bytes.
pub const TWIST_ENCODING: &str = "application/octet-stream";

/// What was done to a twist on its way. Bits that this version does not know are ignored.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TwistFlags {
    /// Bit 0: scaled down to the speed limit.
    pub speed_limited: bool,
    /// Bit 1: held back by the acceleration limit.
    pub acceleration_limited: bool,
    /// Bit 2: within the stop threshold, but not yet for `stop.hold_frames` frames.
    pub within_threshold: bool,
    /// Bit 3: some depth was unknown and filled or estimated.
    pub depth_estimated: bool,
    /// Bit 4: the full step was scaled down to the step cap.
    pub step_capped: bool,
}

impl TwistFlags {
    /// The words of the bits, from bit 0.
    pub const WORDS: [&'static str; 5] =
        ["speed_limited", "acceleration_limited", "within_threshold", "depth_estimated", "step_capped"];

    /// The flags as bits.
    pub fn to_bits(self) -> u16 {
        self.in_order().into_iter().enumerate().map(|(bit, set)| u16::from(set) << bit).sum()
    }

    /// The flags of these bits; unknown ones are dropped.
    pub fn from_bits(bits: u16) -> TwistFlags {
        let set = |bit: u16| bits >> bit & 1 == 1;
        TwistFlags {
            speed_limited: set(0),
            acceleration_limited: set(1),
            within_threshold: set(2),
            depth_estimated: set(3),
            step_capped: set(4),
        }
    }

    /// The words of the flags that are set.
    pub fn words(self) -> Vec<&'static str> {
        TwistFlags::WORDS.into_iter().zip(self.in_order()).filter_map(|(word, set)| set.then_some(word)).collect()
    }

    /// The flags of these words; unknown ones are dropped.
    pub fn from_words<'a>(words: impl Iterator<Item = &'a str>) -> TwistFlags {
        let bit = |word: &str| TwistFlags::WORDS.iter().position(|known| *known == word);
        TwistFlags::from_bits(words.filter_map(bit).fold(0, |bits, bit| bits | 1 << bit))
    }

    fn in_order(self) -> [bool; 5] {
        [self.speed_limited, self.acceleration_limited, self.within_threshold, self.depth_estimated, self.step_capped]
    }
}

/// The answer to a frame. A diagnostic that does not apply is NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwistMessage {
    /// Why the camera moves or not; every status but `servoing` comes with zeros.
    pub status: Status,
    /// What was done to the twist on its way.
    pub flags: TwistFlags,
    /// The largest moment order used; 0 = none.
    pub order: u16,
    /// How many features were compared; 0 = none.
    pub features: u16,
    /// The frame's sequence, echoed.
    pub sequence: u64,
    /// The frame's capture time, echoed; the sender's clock, ns.
    pub capture_time_ns: u64,
    /// Which owner computed it: older epochs are to be ignored.
    pub epoch: u32,
    /// From receipt to the start of the computation, µs.
    pub queue_us: u32,
    /// The computation, decoding included, µs.
    pub compute_us: u32,
    /// Brake if nothing newer has come by then, ms.
    pub valid_ms: u32,
    /// Camera velocity in the camera's optical frame: 3 × m/s, then 3 × rad/s.
    pub twist: [f64; 6],
    /// Mean squared difference of the images, gray in [0, 1].
    pub pixel_mse: f64,
    /// Norm of the feature error, √(e·e).
    pub feature_error_norm: f64,
    /// Condition number of the interaction matrix over the free degrees.
    pub condition_number: f64,
    /// λ in force, 1/s.
    pub gain: f64,
}

impl TwistMessage {
    /// Exact zeros with a reason; every count 0, every diagnostic NaN, `valid_ms` 0.
    pub fn zero(status: Status) -> TwistMessage {
        TwistMessage {
            status,
            flags: TwistFlags::default(),
            order: 0,
            features: 0,
            sequence: 0,
            capture_time_ns: 0,
            epoch: 0,
            queue_us: 0,
            compute_us: 0,
            valid_ms: 0,
            twist: [0.0; 6],
            pixel_mse: f64::NAN,
            feature_error_norm: f64::NAN,
            condition_number: f64::NAN,
            gain: f64::NAN,
        }
    }

    /// Whether the twist is an order to move: the status is `servoing`.
    pub fn is_servoing(&self) -> bool {
        self.status == Status::Servoing
    }

    /// The message as it leaves. What `decode` would refuse is sent as zeros with `internal`: a wrong twist never leaves. Zeros have no
    /// sign, and no flag: nothing was done to them.
    fn sent(&self) -> TwistMessage {
        let status = if self.check().is_ok() { self.status } else { Status::Internal };
        if status == Status::Servoing {
            return *self;
        }
        TwistMessage { status, flags: TwistFlags::default(), twist: [0.0; 6], ..*self }
    }

    /// The message as bytes. What `decode` would refuse is sent as zeros with `internal`, and zeros have neither sign nor flag.
    pub fn encode(&self) -> [u8; TWIST_BYTES] {
        let sent = self.sent();
        let mut out = Writer { bytes: [0; TWIST_BYTES], at: 0 };
        out.put([WIRE_VERSION, sent.status.code()]);
        for half in [sent.flags.to_bits(), sent.order, sent.features] {
            out.put(half.to_le_bytes());
        }
        for long in [sent.sequence, sent.capture_time_ns] {
            out.put(long.to_le_bytes());
        }
        for word in [sent.epoch, sent.queue_us, sent.compute_us, sent.valid_ms] {
            out.put(word.to_le_bytes());
        }
        for number in sent.twist.into_iter().chain(sent.diagnostics()) {
            out.put(number.to_le_bytes());
        }
        out.bytes
    }

    /// Reads a twist. An unknown status comes out as `internal` with zeros. Fails on another version or length, on
    /// a twist that is not finite, and on a known status other than `servoing` with a twist that is not zero.
    /// The last 8 bytes are not looked at.
    pub fn decode(bytes: &[u8]) -> Result<TwistMessage, TwistError> {
        // The version first: a later version may have another length.
        match bytes.first() {
            Some(&WIRE_VERSION) | None => {}
            Some(&got) => return Err(TwistError::WrongVersion { got }),
        }
        let bytes: &[u8; TWIST_BYTES] =
            bytes.try_into().map_err(|_| TwistError::Length { expected: TWIST_BYTES, got: bytes.len() })?;
        let mut input = Reader { bytes, at: 1 };
        let code = input.take::<1>()[0];
        let mut half = || u16::from_le_bytes(input.take());
        let (flags, order, features) = (TwistFlags::from_bits(half()), half(), half());
        let mut long = || u64::from_le_bytes(input.take());
        let (sequence, capture_time_ns) = (long(), long());
        let mut word = || u32::from_le_bytes(input.take());
        let (epoch, queue_us, compute_us, valid_ms) = (word(), word(), word(), word());
        let mut number = || f64::from_le_bytes(input.take());
        let twist = std::array::from_fn(|_| number());
        TwistMessage {
            status: Status::Internal,
            flags,
            order,
            features,
            sequence,
            capture_time_ns,
            epoch,
            queue_us,
            compute_us,
            valid_ms,
            twist,
            pixel_mse: number(),
            feature_error_norm: number(),
            condition_number: number(),
            gain: number(),
        }
        .with_status(Status::from_code(code))
    }

    /// The message with the status that was read: an unknown one (`None`) stops, a known one must fit the twist.
    fn with_status(self, status: Option<Status>) -> Result<TwistMessage, TwistError> {
        match status {
            None => Ok(TwistMessage { status: Status::Internal, twist: [0.0; 6], ..self }),
            Some(status) => {
                let message = TwistMessage { status, ..self };
                message.check().map(|()| message)
            }
        }
    }

    /// Fails when the twist is not finite, or not zero although the status says that nothing moves.
    fn check(&self) -> Result<(), TwistError> {
        if !self.twist.iter().all(|component| component.is_finite()) {
            return Err(TwistError::NotFinite { got: self.twist });
        }
        if !self.is_servoing() && self.twist.iter().any(|component| *component != 0.0) {
            return Err(TwistError::MotionWithoutServoing { status: self.status, got: self.twist });
        }
        Ok(())
    }

    fn diagnostics(&self) -> [f64; 4] {
        [self.pixel_mse, self.feature_error_norm, self.condition_number, self.gain]
    }
}

/// Why a twist was refused. Whoever meets one brakes.
#[derive(Debug, Clone, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum TwistError {
    /// Not 128 bytes.
    #[error("a twist has {expected} bytes, got {got}")]
    Length {
        /// [`TWIST_BYTES`].
        expected: usize,
        /// What came, bytes.
        got: usize,
    },
    /// Byte 0, or `version` in JSON, is not [`WIRE_VERSION`].
    #[error("this reader speaks wire version 1, got {got}")]
    WrongVersion {
        /// The version that came.
        got: u8,
    },
    /// A component is NaN or infinite.
    #[error("a twist must be finite, got {got:?}")]
    NotFinite {
        /// What came.
        got: [f64; 6],
    },
    /// A status that means standing still came with motion.
    #[error("{status} comes with zeros, got {got:?}")]
    MotionWithoutServoing {
        /// The status that came.
        status: Status,
        /// The twist that came.
        got: [f64; 6],
    },
    /// The JSON form is not JSON, or not that of a twist.
    #[error("unreadable twist: {reason}")]
    Unreadable {
        /// What the parser said.
        reason: String,
    },
}

/// Fills the fixed bytes from the front; the golden twist proves that the fields fill them as they should.
struct Writer {
    bytes: [u8; TWIST_BYTES],
    at: usize,
}

impl Writer {
    fn put<const N: usize>(&mut self, field: [u8; N]) {
        self.bytes[self.at..self.at + N].copy_from_slice(&field);
        self.at += N;
    }
}

/// Takes fields from the front of the fixed bytes.
struct Reader<'a> {
    bytes: &'a [u8; TWIST_BYTES],
    at: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let field = std::array::from_fn(|i| self.bytes[self.at + i]);
        self.at += N;
        field
    }
}
