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
use crate::pause::Pause;

/// Zeros are repeated this often while a task is not servoing: 10 Hz.
pub const ZERO_PERIOD: Duration = Duration::from_millis(100);

/// Sends one message; never waits.
pub type Publish = Box<dyn Fn(&TwistMessage) + Send>;

/// What is known of the age of the frame behind a twist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// When it arrived.
    pub at: Moment,
    /// What its sender's clock says; `None` if it came without a capture time.
    pub clock: Option<SenderClock>,
}

/// The age of a frame by its sender's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SenderClock {
    /// Since when it has been known.
    pub known_since: Moment,
    /// Until then the frame is younger than the settings allow.
    pub fresh_until: Moment,
}

impl Received {
    /// A frame of which only the receipt is known.
    pub fn at(at: Moment) -> Received {
        Received { at, clock: None }
    }
}

/// The process stood still. What was received before `until` may be as old as the pause was long.
#[derive(Clone, Copy, Debug, Default)]
struct Doubt {
    /// The pause began after this: a sender's clock that was known by then still tells the age of its frames.
    since: Moment,
    until: Moment,
}

/// The way out of one task.
pub struct Outlet {
    governor: Governor,
    publish: Publish,
    /// Repeated as zeros: what the task said last, without its twist.
    last: TwistMessage,
    halted: Option<Status>,
    /// When the clock last looked.
    looked: Moment,
    doubt: Doubt,
}

impl Outlet {
    /// An outlet at rest, which hands every message to `publish`.
    pub fn new(governor: Governor, first: TwistMessage, publish: Publish, now: Moment) -> Outlet {
        Outlet { governor, publish, last: first, halted: None, looked: now, doubt: Doubt::default() }
    }

    /// Gives the governor new limits.
    pub fn governor_mut(&mut self) -> &mut Governor {
        &mut self.governor
    }

    /// What every message says: brake if nothing newer has come by then, ms.
    pub fn valid_ms(&self) -> u32 {
        u32::try_from(self.governor.watchdog().as_millis()).unwrap_or(u32::MAX)
    }

    /// Sends the answer to a pushed frame, governed if it is servoing and as zeros if not. Returns the message as it was sent.
    pub fn send(&mut self, mut message: TwistMessage, frame: Received, now: Moment) -> TwistMessage {
        if let Some(status) = self.halted {
            message = refused(message, status);
        } else if message.is_servoing() && !self.is_trusted(frame, now) {
            message = refused(message, Status::StaleFrame);
        }
        if message.is_servoing() {
            let governed = self.governor.pass(Twist::from_array(message.twist), frame.at, now);
            message.twist = governed.twist.to_array();
            message.flags.acceleration_limited = governed.acceleration_limited;
        } else {
            self.governor.brake(now);
        }
        self.publish(message)
    }

    /// The frame is young enough, its wait here counted in, the clock is there to brake, and no pause of the process hides the frame's age.
    fn is_trusted(&self, frame: Received, now: Moment) -> bool {
        self.governor.is_current(frame.at, now)
            && frame.clock.is_none_or(|clock| now <= clock.fresh_until)
            && (self.is_awake(frame.at, now)
                || self.clock_looks(now) && frame.clock.is_some_and(|clock| clock.known_since <= self.doubt.since))
    }

    /// Whether the clock looks, and has done so for long enough that what arrived at `received` did not wait for it to wake.
    pub fn is_awake(&self, received: Moment, now: Moment) -> bool {
        self.clock_looks(now) && received >= self.doubt.until
    }

    fn clock_looks(&self, now: Moment) -> bool {
        self.governor.is_current(self.looked, now)
    }

    /// The clock looks again after this. Returns whether the process stood still for longer than the watchdog: then what waits is of no use,
    /// and for one watchdog time from now on the receipt of a frame proves nothing about its age.
    pub fn wake(&mut self, pause: Pause, now: Moment) -> bool {
        let watchdog = self.governor.watchdog();
        let stood_still = pause.length > watchdog;
        if stood_still {
            self.doubt = Doubt { since: pause.since, until: now + watchdog };
        }
        stood_still
    }

    /// Sends zeros with this status at once, whatever waits. They answer no frame, so they say nothing of one but its number and time.
    pub fn brake(&mut self, status: Status, now: Moment) {
        self.governor.brake(now);
        let TwistMessage { sequence, capture_time_ns, epoch, .. } = self.last;
        self.publish(TwistMessage { sequence, capture_time_ns, epoch, ..TwistMessage::zero(status) });
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

    /// Called often by the clock: zeros the moment the frames stay away, and at 10 Hz while no twist is in force.
    /// `status` is what to say then. Returns the status sent when the watchdog braked.
    pub fn tick(&mut self, status: Status, now: Moment) -> Option<Status> {
        self.looked = now;
        if self.governor.is_silent(now) {
            self.brake(Status::WaitingFrame, now);
            return Some(Status::WaitingFrame);
        }
        let due = self.governor.last_sent().is_none_or(|sent| now.saturating_sub(sent) >= ZERO_PERIOD);
        if due && !self.governor.is_servoing() {
            self.brake(self.halted.unwrap_or(status), now);
        }
        None
    }

    fn publish(&mut self, message: TwistMessage) -> TwistMessage {
        let message = TwistMessage { valid_ms: self.valid_ms(), ..message };
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
        (Outlet::new(governor, TwistMessage::zero(Status::Ready), publish, ms(0)), sent)
    }

    fn servoing() -> TwistMessage {
        TwistMessage { twist: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], ..TwistMessage::zero(Status::Servoing) }
    }

    #[test]
    fn silence_brakes_once_and_then_repeats_zeros_at_ten_hertz() {
        let (mut outlet, sent) = outlet();
        outlet.send(servoing(), Received::at(ms(0)), ms(5));
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
        let message = outlet.send(servoing(), Received::at(ms(0)), ms(301));
        assert_eq!((message.status, message.twist), (Status::StaleFrame, [0.0; 6]));
    }

    #[test]
    fn a_frame_grows_older_while_it_waits_for_its_twist() {
        let (mut outlet, _) = outlet();
        // 190 ms old when it came, of 200 that it may be: 10 more it may wait.
        let clock = SenderClock { known_since: ms(0), fresh_until: ms(110) };
        let frame = Received { at: ms(100), clock: Some(clock) };
        assert_eq!(outlet.send(servoing(), frame, ms(110)).status, Status::Servoing);
        let message = outlet.send(servoing(), frame, ms(111));
        assert_eq!((message.status, message.twist), (Status::StaleFrame, [0.0; 6]));
    }

    #[test]
    fn a_halted_outlet_sends_nothing_but_zeros() {
        let (mut outlet, _) = outlet();
        outlet.halt(Some(Status::Stopped), ms(0));
        let message = outlet.send(servoing(), Received::at(ms(1)), ms(2));
        assert_eq!((message.status, message.twist), (Status::Stopped, [0.0; 6]));
        outlet.halt(None, ms(3));
        assert_eq!(outlet.send(servoing(), Received::at(ms(4)), ms(5)).status, Status::Servoing);
    }

    #[test]
    fn without_a_clock_that_brakes_nothing_moves() {
        let (mut outlet, _) = outlet();
        assert_eq!(outlet.send(servoing(), Received::at(ms(300)), ms(300)).status, Status::Servoing);
        let message = outlet.send(servoing(), Received::at(ms(301)), ms(301));
        assert_eq!(
            (message.status, message.twist),
            (Status::StaleFrame, [0.0; 6]),
            "it has not looked since it was made"
        );
        outlet.tick(Status::Ready, ms(400));
        assert_eq!(outlet.send(servoing(), Received::at(ms(700)), ms(700)).status, Status::Servoing);
        assert_eq!(outlet.send(servoing(), Received::at(ms(701)), ms(701)).status, Status::StaleFrame);
    }

    #[test]
    fn after_a_pause_only_a_clock_that_was_known_before_tells_the_age() {
        let (mut outlet, _) = outlet();
        assert!(!outlet.wake(Pause { length: ms(300), since: ms(100) }, ms(400)), "no longer than the watchdog");
        assert!(outlet.wake(Pause { length: ms(600), since: ms(400) }, ms(1000)));
        outlet.tick(Status::Ready, ms(1000));
        let clock = |known_since| SenderClock { known_since, fresh_until: ms(1299) };
        let known = |since: Option<Moment>| Received { at: ms(1299), clock: since.map(clock) };
        assert_eq!(outlet.send(servoing(), known(None), ms(1299)).status, Status::StaleFrame);
        assert_eq!(outlet.send(servoing(), known(Some(ms(401))), ms(1299)).status, Status::StaleFrame);
        assert_eq!(outlet.send(servoing(), known(Some(ms(400))), ms(1299)).status, Status::Servoing);
        assert!(!outlet.is_awake(ms(1299), ms(1299)) && outlet.is_awake(ms(1300), ms(1300)));
        assert_eq!(outlet.send(servoing(), Received::at(ms(1300)), ms(1300)).status, Status::Servoing);
    }

    #[test]
    fn repeated_zeros_say_which_frame_was_the_last_and_nothing_else_of_it() {
        let (mut outlet, sent) = outlet();
        let flags = TwistFlags { step_capped: true, ..TwistFlags::default() };
        let answer =
            TwistMessage { sequence: 7, capture_time_ns: 9, epoch: 3, pixel_mse: 0.5, order: 4, flags, ..servoing() };
        outlet.send(answer, Received::at(ms(0)), ms(1));
        outlet.tick(Status::WaitingFrame, ms(301));
        let sent = sent.lock().expect("whole");
        let [answer, zeros] = sent[..] else { panic!("two messages") };
        assert_eq!((answer.valid_ms, answer.flags.step_capped, answer.pixel_mse), (300, true, 0.5));
        assert_eq!((zeros.sequence, zeros.capture_time_ns, zeros.epoch, zeros.valid_ms), (7, 9, 3, 300));
        assert_eq!((zeros.order, zeros.flags), (0, TwistFlags::default()));
        assert!(zeros.pixel_mse.is_nan() && zeros.twist.iter().all(|component| component.to_bits() == 0));
    }

    #[test]
    fn a_twist_of_zeros_is_not_called_silence_before_the_watchdog_time() {
        let (mut outlet, sent) = outlet();
        let standing = TwistMessage { twist: [0.0; 6], ..servoing() };
        outlet.send(standing, Received::at(ms(0)), ms(0));
        let braked: Vec<u64> = (1..=400).filter(|&t| outlet.tick(Status::WaitingFrame, ms(t)).is_some()).collect();
        assert_eq!(braked, [301]);
        assert_eq!(sent.lock().expect("whole").len(), 2);
    }
}
