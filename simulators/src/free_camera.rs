//! A camera that flies where twists tell it, and stands when they do not: pure, time is an argument.
//!
//! A command holds from its receipt until the first of: a newer one, its own `valid_ms`, the camera's own patience.
//! Between those instants the twist is constant, so the pose is exact however rarely [`FreeCamera::advance`] is
//! called. Braking is at once: this camera has no mass. What it cannot trust, it brakes on; what is from an older
//! epoch it does not hear.

use std::fmt;
use std::time::{Duration, Instant};

use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use nalgebra::Isometry3;

use crate::motion;

/// Whether the camera moves, and if not, why.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// A command holds.
    Moving,
    /// The camera stands.
    Braked(BrakeReason),
}

/// Why the camera stands.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum BrakeReason {
    /// Nothing has been commanded yet.
    NoCommand,
    /// The last command was exact zeros.
    Zeros,
    /// The last command had a status other than servoing.
    Status(Status),
    /// The last command ran out and nothing newer came.
    Silence,
    /// The last command was not finite, or no command at all.
    Untrusted,
    /// Everything was told to stop, and the service has not yet been seen to have stopped.
    StopAll,
}

impl fmt::Display for BrakeReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BrakeReason::NoCommand => f.write_str("nothing commanded yet"),
            BrakeReason::Zeros => f.write_str("zeros commanded"),
            BrakeReason::Status(status) => status.fmt(f),
            BrakeReason::Silence => f.write_str("no newer command came"),
            BrakeReason::Untrusted => f.write_str("a command was unreadable or not finite"),
            BrakeReason::StopAll => f.write_str("everything was stopped"),
        }
    }
}

/// Why a command was not taken.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum CommandRefused {
    /// The command comes from an owner that has been replaced; nothing changes.
    #[error("expected epoch {expected} or newer, got {got}")]
    OlderEpoch {
        /// The newest epoch heard.
        expected: u32,
        /// The command's.
        got: u32,
    },
    /// A component is not a number or infinite; the camera brakes.
    #[error("expected a finite twist, got {twist:?}")]
    NotFinite {
        /// The twist as it came.
        twist: [f64; 6],
    },
    /// After a stop of everything only zeros are heard first; the camera stays braked.
    #[error("everything was told to stop, expected zeros first")]
    StopAll,
}

/// The state of a free-flying camera.
#[derive(Clone, Debug)]
pub struct FreeCamera {
    pose: Isometry3<f64>,
    /// The pose is the one at this instant.
    at: Instant,
    twist: [f64; 6],
    /// The twist holds until here.
    until: Instant,
    motion: Motion,
    newest_epoch: Option<u32>,
    patience: Duration,
}

impl FreeCamera {
    /// A camera at rest at `pose` (`world_from_camera`); no command holds longer than `patience`, whatever it says.
    pub fn new(pose: Isometry3<f64>, patience: Duration, now: Instant) -> FreeCamera {
        FreeCamera {
            pose,
            at: now,
            twist: [0.0; 6],
            until: now,
            motion: Motion::Braked(BrakeReason::NoCommand),
            newest_epoch: None,
            patience,
        }
    }

    /// Obeys a command received at `now`; a refused one of the present epoch leaves the camera braked.
    pub fn command(&mut self, message: &TwistMessage, now: Instant) -> Result<(), CommandRefused> {
        self.advance(now);
        let got = message.epoch;
        if let Some(expected) = self.newest_epoch.filter(|&newest| got < newest) {
            return Err(CommandRefused::OlderEpoch { expected, got });
        }
        self.newest_epoch = Some(got);
        let twist = message.twist;
        if twist.iter().any(|component| !component.is_finite()) {
            self.distrust();
            return Err(CommandRefused::NotFinite { twist });
        }
        if message.status != Status::Servoing {
            self.brake(BrakeReason::Status(message.status));
        } else if twist == [0.0; 6] {
            self.brake(BrakeReason::Zeros);
        } else if self.motion == Motion::Braked(BrakeReason::StopAll) {
            return Err(CommandRefused::StopAll);
        } else {
            self.twist = twist;
            self.until = now + self.patience.min(Duration::from_millis(u64::from(message.valid_ms)));
            self.motion = Motion::Moving;
        }
        Ok(())
    }

    /// Something came where a command should be, and it is none: brakes, from `now`.
    pub fn untrusted(&mut self, now: Instant) {
        self.advance(now);
        self.distrust();
    }

    /// Forgets the newest epoch: from now on another task's owner commands.
    pub fn change_owner(&mut self) {
        self.newest_epoch = None;
    }

    /// Everything stops, from `now`; moves again only after zeros or another status show that the service stopped too.
    pub fn stop_all(&mut self, now: Instant) {
        self.advance(now);
        self.brake(BrakeReason::StopAll);
    }

    /// Moves the pose on to `now`, or to where the command ran out. An earlier `now` changes nothing.
    pub fn advance(&mut self, now: Instant) {
        if self.motion == Motion::Moving {
            let moving = now.min(self.until).saturating_duration_since(self.at);
            self.pose = motion::pose_after(&self.pose, self.twist, moving.as_secs_f64());
            if now >= self.until {
                self.brake(BrakeReason::Silence);
            }
        }
        self.at = self.at.max(now);
    }

    /// Where the camera was when it last advanced, `world_from_camera`.
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.pose
    }

    /// Whether the camera moved when it last advanced.
    pub fn motion(&self) -> Motion {
        self.motion
    }

    /// The twist in force, m/s then rad/s in the camera's own frame; exact zeros while braked.
    pub fn twist(&self) -> [f64; 6] {
        self.twist
    }

    /// Brakes, but a stop of everything stays one.
    fn distrust(&mut self) {
        if self.motion != Motion::Braked(BrakeReason::StopAll) {
            self.brake(BrakeReason::Untrusted);
        }
    }

    fn brake(&mut self, reason: BrakeReason) {
        self.twist = [0.0; 6];
        self.motion = Motion::Braked(reason);
    }
}
