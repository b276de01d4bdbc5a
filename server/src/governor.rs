//! The last gate before `command`: a twist leaves the worker only through here.
//!
//! It limits how fast the commanded twist may change, judges silence, and remembers what was sent. It has no
//! clock: every time is an argument, so a recording can feed the same times back and get the same twists.
//! It never ramps down: a zero is sent as a zero at once, and the arm's side brakes inside its own limits.

use std::time::Duration;

use domvs_vision::Twist;

use crate::Moment;

/// How fast a commanded twist may change; `None` in the settings means no such limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelerationLimits {
    /// Largest change of the linear part, in m/s².
    pub linear_m_per_s2: f64,
    /// Largest change of the angular part, in rad/s².
    pub angular_rad_per_s2: f64,
}

/// How fast a twist may be; `None` in the settings means no such limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedLimits {
    /// Largest norm of the linear part, in m/s.
    pub linear_m_per_s: f64,
    /// Largest norm of the angular part, in rad/s.
    pub angular_rad_per_s: f64,
}

/// What the governor let through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Governed {
    /// The twist to send.
    pub twist: Twist,
    /// Whether the acceleration limit shortened the change.
    pub acceleration_limited: bool,
}

/// The state behind one task's `command`.
#[derive(Clone, Debug)]
pub struct Governor {
    limits: Option<AccelerationLimits>,
    watchdog: Duration,
    longest_interval: Duration,
    last: Twist,
    /// Whether a twist was sent last, and not the zeros of a brake.
    servoing: bool,
    last_sent: Option<Moment>,
    newest_frame: Option<Moment>,
}

impl Governor {
    /// A governor at rest. `longest_interval` (one frame period) bounds the time over which a change may build
    /// up, so a pause does not turn into a jump.
    pub fn new(limits: Option<AccelerationLimits>, watchdog: Duration, longest_interval: Duration) -> Governor {
        Governor {
            limits,
            watchdog,
            longest_interval,
            last: Twist::ZERO,
            servoing: false,
            last_sent: None,
            newest_frame: None,
        }
    }

    /// Takes new limits; what was sent stays known, so the change itself cannot jump.
    pub fn reconfigure(&mut self, limits: Option<AccelerationLimits>, watchdog: Duration, longest_interval: Duration) {
        (self.limits, self.watchdog, self.longest_interval) = (limits, watchdog, longest_interval);
    }

    /// Takes new bounds of the twist itself: what they forbid ends with the next twist, at once, as with zeros. Only from what is
    /// left of the last twist does the next one start.
    pub fn confine(&mut self, speed: Option<SpeedLimits>, free: [bool; 6]) {
        let components = self.last.to_array();
        let masked = Twist::from_array(std::array::from_fn(|i| if free[i] { components[i] } else { 0.0 }));
        self.last = speed.map_or(masked, |limits| limit_speed(masked, limits).0);
    }

    /// How long frames may stay away.
    pub fn watchdog(&self) -> Duration {
        self.watchdog
    }

    /// Whether a frame received at `received` is still young enough to move anything at `now`.
    pub fn is_current(&self, received: Moment, now: Moment) -> bool {
        now.saturating_sub(received) <= self.watchdog
    }

    /// Passes a speed-limited twist made from a frame received at `received`: from the last twist sent towards
    /// this one, along the straight line between them, one fraction for all six.
    pub fn pass(&mut self, wanted: Twist, received: Moment, now: Moment) -> Governed {
        let fraction = self.limits.map_or(1.0, |limits| {
            let interval = self.last_sent.map_or(self.longest_interval, |sent| now.saturating_sub(sent));
            let seconds = interval.min(self.longest_interval).as_secs_f64();
            let change = difference(wanted, self.last);
            allowed_fraction(change.linear_norm(), limits.linear_m_per_s2 * seconds)
                .min(allowed_fraction(change.angular_norm(), limits.angular_rad_per_s2 * seconds))
        });
        let twist = if fraction < 1.0 { between(self.last, wanted, fraction) } else { wanted };
        self.newest_frame = Some(received);
        self.servoing = true;
        self.remember(twist, now);
        Governed { twist, acceleration_limited: fraction < 1.0 }
    }

    /// Notes that exact zeros are being sent.
    pub fn brake(&mut self, now: Moment) {
        self.servoing = false;
        self.remember(Twist::ZERO, now);
    }

    /// Whether a twist is in force and no frame has come for longer than the watchdog allows.
    pub fn is_silent(&self, now: Moment) -> bool {
        self.is_servoing() && self.newest_frame.is_none_or(|received| !self.is_current(received, now))
    }

    /// Whether a twist was sent last, and not the zeros of a brake.
    pub fn is_servoing(&self) -> bool {
        self.servoing
    }

    /// When the last twist, or zero, was sent.
    pub fn last_sent(&self) -> Option<Moment> {
        self.last_sent
    }

    fn remember(&mut self, twist: Twist, now: Moment) {
        self.last = twist;
        self.last_sent = Some(now);
    }
}

/// One scale for all six so that neither part exceeds its limit; the direction is kept. Says whether it scaled.
pub fn limit_speed(twist: Twist, limits: SpeedLimits) -> (Twist, bool) {
    let scale = allowed_fraction(twist.linear_norm(), limits.linear_m_per_s)
        .min(allowed_fraction(twist.angular_norm(), limits.angular_rad_per_s));
    if scale < 1.0 { (twist.scaled(scale), true) } else { (twist, false) }
}

fn allowed_fraction(size: f64, limit: f64) -> f64 {
    if size > limit { limit / size } else { 1.0 }
}

fn difference(to: Twist, from: Twist) -> Twist {
    let (to, from) = (to.to_array(), from.to_array());
    Twist::from_array(std::array::from_fn(|i| to[i] - from[i]))
}

fn between(from: Twist, to: Twist, fraction: f64) -> Twist {
    let (start, change) = (from.to_array(), difference(to, from).to_array());
    Twist::from_array(std::array::from_fn(|i| start[i] + fraction * change[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: AccelerationLimits = AccelerationLimits { linear_m_per_s2: 0.5, angular_rad_per_s2: 2.0 };

    fn at(ms: u64) -> Moment {
        Duration::from_millis(ms)
    }

    fn governor() -> Governor {
        Governor::new(Some(LIMITS), at(300), at(100))
    }

    fn forward(speed: f64) -> Twist {
        Twist::from_array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
    }

    #[test]
    fn speed_grows_from_rest_no_faster_than_the_acceleration_limit() {
        let mut governor = governor();
        let first = governor.pass(forward(0.2), at(0), at(0));
        assert!(first.acceleration_limited);
        assert!((first.twist.linear_norm() - 0.05).abs() < 1e-12, "0.5 m/s² over one 0.1 s period");
        let second = governor.pass(forward(0.2), at(40), at(40));
        assert!((second.twist.linear_norm() - 0.07).abs() < 1e-12, "0.5 m/s² over 40 ms more");
    }

    #[test]
    fn one_fraction_keeps_the_direction_of_a_start_from_rest() {
        let wanted = Twist::from_array([0.1, 0.0, 0.1, 0.5, 0.0, 0.2]);
        let sent = governor().pass(wanted, at(0), at(0)).twist.to_array();
        let ratio = sent[0] / 0.1;
        for (sent, wanted) in sent.iter().zip(wanted.to_array()) {
            assert!((sent - ratio * wanted).abs() < 1e-15);
        }
    }

    #[test]
    fn a_long_pause_does_not_become_a_jump() {
        let mut governor = governor();
        governor.brake(at(0));
        let sent = governor.pass(forward(0.2), at(60_000), at(60_000)).twist;
        assert!(sent.linear_norm() <= 0.05 + 1e-12);
    }

    #[test]
    fn silence_is_judged_by_the_receive_time_of_the_newest_frame() {
        let mut governor = governor();
        governor.pass(forward(0.2), at(1000), at(1020));
        assert!(!governor.is_silent(at(1300)));
        assert!(governor.is_silent(at(1301)));
        governor.brake(at(1301));
        assert!(!governor.is_silent(at(5000)), "a camera at rest is not silent, it stands");
    }

    #[test]
    fn a_lower_limit_or_a_masked_degree_holds_from_the_next_twist_on() {
        let mut governor = governor();
        let fast = Twist::from_array([0.2, 0.0, 0.0, 0.0, 0.0, 0.5]);
        for step in 1..=20 {
            governor.pass(fast, at(100 * step), at(100 * step));
        }
        let free = [true, true, true, true, true, false];
        let limits = SpeedLimits { linear_m_per_s: 0.01, angular_rad_per_s: 0.7 };
        governor.confine(Some(limits), free);
        let wanted = Twist::from_array([-0.01, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let sent = governor.pass(wanted, at(2001), at(2001)).twist;
        assert!(sent.linear_norm() <= 0.01 + 1e-15 && sent.to_array()[5] == 0.0, "{sent:?}");
        assert!((sent.to_array()[0] - 0.0095).abs() < 1e-12, "and changes by 0.5 m/s² over 1 ms from there");
    }

    #[test]
    fn a_twist_of_zeros_is_in_force_like_any_other() {
        let mut governor = governor();
        governor.pass(Twist::ZERO, at(0), at(0));
        assert!(governor.is_servoing() && !governor.is_silent(at(300)) && governor.is_silent(at(301)));
    }

    #[test]
    fn whatever_the_clock_says_the_twist_stays_finite_and_no_change_is_larger_than_a_period_allows() {
        let mut governor = governor();
        let wanted = Twist::from_array([f64::MAX, -f64::MAX, f64::MIN_POSITIVE, 5e-324, 1e200, -0.0]);
        let mut last = [0.0; 6];
        for ms in [0, 0, 5000, 4000, 4000, u64::MAX / 2, 1, 0, 7] {
            let sent = governor.pass(wanted, at(ms), at(ms)).twist.to_array();
            let change = difference(Twist::from_array(sent), Twist::from_array(last));
            assert!(sent.iter().all(|component| component.is_finite()), "{sent:?} at {ms} ms");
            assert!(change.linear_norm() <= 0.05 + 1e-12 && change.angular_norm() <= 0.2 + 1e-12, "{change:?}");
            last = sent;
        }
    }

    #[test]
    fn speed_limit_uses_one_scale_for_all_six() {
        let limits = SpeedLimits { linear_m_per_s: 0.2, angular_rad_per_s: 0.7 };
        let (limited, scaled) = limit_speed(Twist::from_array([0.4, 0.0, 0.0, 0.0, 0.7, 0.0]), limits);
        assert!(scaled);
        assert_eq!(limited.to_array(), [0.2, 0.0, 0.0, 0.0, 0.35, 0.0]);
    }
}
