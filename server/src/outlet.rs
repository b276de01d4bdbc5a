//! Where `command` is published: one outlet per task, shared by the compute pool and the clock.
//!
//! The pool sends a twist for each pushed frame, the clock sends zeros when frames stay away, and the lock
//! around an outlet puts the two in order. So the watchdog never waits for a computation.

use std::time::Duration;

use domvs_proto::status::Status;
use domvs_proto::twist::{TwistFlags, TwistMessage};
use domvs_vision::Twist;

use crate::Moment;
use crate::governor::Governor;

/// Zeros are repeated this often while a task is not servoing: 10 Hz.
pub const ZERO_PERIOD: Duration = Duration::from_millis(100);

/// Sends one message; never waits.
pub type Publish = Box<dyn Fn(&TwistMessage) + Send>;

/// The way out of one task.
pub struct Outlet {
    governor: Governor,
    publish: Publish,
    /// Repeated as zeros: what the task said last, without its twist.
    last: TwistMessage,
    halted: Option<Status>,
    /// When the clock last looked.
    looked: Option<Moment>,
    /// Frames without a capture time that were received before this are of unknown age.
    doubtful_until: Moment,
}

impl Outlet {
    /// An outlet at rest, which hands every message to `publish`.
    pub fn new(governor: Governor, first: TwistMessage, publish: Publish) -> Outlet {
        Outlet { governor, publish, last: first, halted: None, looked: None, doubtful_until: Moment::ZERO }
    }

    /// Gives the governor new limits.
    pub fn governor_mut(&mut self) -> &mut Governor {
        &mut self.governor
    }

    /// Sends the answer to a pushed frame received at `received`, governed if it is servoing and as zeros if
    /// not. Returns the message as it was sent.
    pub fn send(&mut self, mut message: TwistMessage, received: Moment, now: Moment) -> TwistMessage {
        if let Some(status) = self.halted {
            message = refused(message, status);
        } else if message.is_servoing() && !self.is_trusted(&message, received, now) {
            message = refused(message, Status::StaleFrame);
        }
        if message.is_servoing() {
            let governed = self.governor.pass(Twist::from_array(message.twist), received, now);
            message.twist = governed.twist.to_array();
            message.flags.acceleration_limited = governed.acceleration_limited;
        } else {
            self.governor.brake(now);
        }
        self.publish(message)
    }

    /// The frame is young enough, the clock is there to brake, and no pause of the process hides the frame's age.
    fn is_trusted(&self, message: &TwistMessage, received: Moment, now: Moment) -> bool {
        self.governor.is_current(received, now)
            && self.looked.is_none_or(|looked| self.governor.is_current(looked, now))
            && (message.capture_time_ns != 0 || received >= self.doubtful_until)
    }

    /// The process stood still: for one watchdog time, frames without a capture time prove nothing about now.
    pub fn doubt(&mut self, now: Moment) {
        self.doubtful_until = now + self.governor.watchdog();
    }

    /// Sends zeros with this status at once, whatever waits.
    pub fn brake(&mut self, status: Status, now: Moment) {
        self.governor.brake(now);
        self.publish(refused(self.last, status));
    }

    /// Answers every frame with zeros and this status until it is lifted with `None`.
    pub fn halt(&mut self, status: Option<Status>, now: Moment) {
        self.halted = status;
        if let Some(status) = status {
            self.brake(status, now);
        }
    }

    /// Whether only zeros leave, whatever the frames say.
    pub fn is_halted(&self) -> bool {
        self.halted.is_some()
    }

    /// Called often by the clock: zeros the moment the frames stay away, and at 10 Hz while nothing moves.
    /// `status` is what to say when nothing moves. Returns the status sent when the watchdog braked.
    pub fn tick(&mut self, status: Status, now: Moment) -> Option<Status> {
        self.looked = Some(now);
        if self.governor.is_silent(now) {
            self.brake(Status::WaitingFrame, now);
            return Some(Status::WaitingFrame);
        }
        let due = self.governor.last_sent().is_none_or(|sent| now.saturating_sub(sent) >= ZERO_PERIOD);
        if due && !self.governor.is_moving() {
            self.brake(self.halted.unwrap_or(status), now);
        }
        None
    }

    fn publish(&mut self, message: TwistMessage) -> TwistMessage {
        (self.publish)(&message);
        self.last = message;
        message
    }
}

/// The same message as exact zeros with this status; nothing was done to such a twist, so no flag stays.
pub fn refused(message: TwistMessage, status: Status) -> TwistMessage {
    TwistMessage { status, twist: [0.0; 6], flags: TwistFlags::default(), ..message }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    fn ms(ms: u64) -> Moment {
        Duration::from_millis(ms)
    }

    /// An outlet without acceleration limits and a 300 ms watchdog, and what it sent.
    fn outlet() -> (Outlet, Arc<Mutex<Vec<TwistMessage>>>) {
        let sent = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&sent);
        let publish = Box::new(move |message: &TwistMessage| sink.lock().expect("whole").push(*message));
        let governor = Governor::new(None, ms(300), ms(66));
        (Outlet::new(governor, TwistMessage::zero(Status::Ready), publish), sent)
    }

    fn servoing() -> TwistMessage {
        TwistMessage { twist: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], ..TwistMessage::zero(Status::Servoing) }
    }

    #[test]
    fn silence_brakes_once_and_then_repeats_zeros_at_ten_hertz() {
        let (mut outlet, sent) = outlet();
        outlet.send(servoing(), ms(0), ms(5));
        let braked: Vec<u64> = (5..=1000).filter(|&t| outlet.tick(Status::Servoing, ms(t)).is_some()).collect();
        assert_eq!(braked, [301], "the first millisecond after the watchdog");
        let sent = sent.lock().expect("whole");
        assert_eq!(sent[1].status, Status::WaitingFrame);
        assert!(sent[1..].iter().all(|message| message.twist == [0.0; 6]));
        assert_eq!(sent.len(), 1 + 7, "at 301, 401, ... 901 ms");
    }

    #[test]
    fn a_twist_that_was_computed_too_late_goes_out_as_zeros() {
        let (mut outlet, _) = outlet();
        let message = outlet.send(servoing(), ms(0), ms(301));
        assert_eq!((message.status, message.twist), (Status::StaleFrame, [0.0; 6]));
    }

    #[test]
    fn a_halted_outlet_sends_nothing_but_zeros() {
        let (mut outlet, _) = outlet();
        outlet.halt(Some(Status::Stopped), ms(0));
        let message = outlet.send(servoing(), ms(1), ms(2));
        assert_eq!((message.status, message.twist), (Status::Stopped, [0.0; 6]));
        outlet.halt(None, ms(3));
        assert_eq!(outlet.send(servoing(), ms(4), ms(5)).status, Status::Servoing);
    }

    #[test]
    fn without_a_clock_that_brakes_nothing_moves() {
        let (mut outlet, _) = outlet();
        outlet.tick(Status::Ready, ms(0));
        assert_eq!(outlet.send(servoing(), ms(300), ms(300)).status, Status::Servoing);
        let message = outlet.send(servoing(), ms(301), ms(301));
        assert_eq!((message.status, message.twist), (Status::StaleFrame, [0.0; 6]));
    }

    #[test]
    fn after_a_pause_only_a_capture_time_tells_the_age() {
        let (mut outlet, _) = outlet();
        outlet.doubt(ms(1000));
        let timed = TwistMessage { capture_time_ns: 1, ..servoing() };
        assert_eq!(outlet.send(servoing(), ms(1299), ms(1299)).status, Status::StaleFrame);
        assert_eq!(outlet.send(timed, ms(1299), ms(1299)).status, Status::Servoing);
        assert_eq!(outlet.send(servoing(), ms(1300), ms(1300)).status, Status::Servoing);
    }
}
