//! A task, its outlet and its clock, as a worker joins them, without Zenoh and without a clock of its own. Everything that would be
//! published is kept, and held against the promises as it leaves.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use domvs_proto::messages::Control;
use domvs_proto::settings::TaskSettings;
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use domvs_server::control::obey;
use domvs_server::decode::DecodeLimits;
use domvs_server::law::{acceleration_limits, speed_limits};
use domvs_server::pipeline::{on_frame, recheck, send_answer};
use domvs_server::task::{Frame, Route, Task};
use domvs_server::{Clocks, Governor, Moment, Outlet, TICK};
use serde_json::Value;

use crate::pictures::Shot;

pub const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 16, max_bytes: 1 << 20 };

/// What left on `command`, and when.
#[derive(Clone, Copy, Debug)]
pub struct Sent {
    pub at: Moment,
    pub message: TwistMessage,
}

/// One task in a worker of its own.
pub struct World {
    pub task: Task,
    pub outlet: Outlet,
    pub now: Moment,
    looked: Moment,
    clocks: Clocks,
    /// Heard of, and not latched yet.
    pub waiting_halt: Option<Status>,
    /// What `status` says.
    said: Status,
    published: Arc<Mutex<Vec<TwistMessage>>>,
    /// Everything that has left on `command`.
    pub sent: Vec<Sent>,
    /// What has left since a change of settings: an older twist says nothing about the next one's growth.
    unbroken: bool,
    started: bool,
}

impl World {
    pub fn new(settings: TaskSettings) -> World {
        let now = Duration::from_secs(100);
        let task = Task::new(settings.clone(), LIMITS);
        let period = Duration::from_secs_f64(settings.frame_period_s);
        let governor = Governor::new(acceleration_limits(&settings), task.watchdog(), period);
        let published = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&published);
        let publish =
            Box::new(move |message: &TwistMessage| sink.lock().unwrap_or_else(PoisonError::into_inner).push(*message));
        let outlet = Outlet::new(governor, TwistMessage::zero(task.status()), publish, now);
        World {
            said: task.status(),
            task,
            outlet,
            now,
            looked: now,
            clocks: Clocks::new(now, wall(now)),
            waiting_halt: None,
            published,
            sent: Vec::new(),
            unbroken: true,
            started: false,
        }
    }

    /// With this target, and started.
    pub fn started(settings: TaskSettings, target: &Shot) -> World {
        let mut world = World::new(settings);
        assert!(world.set_target(target), "a fine target");
        world.control(Control::Start);
        world
    }

    /// Whether it was taken.
    pub fn set_target(&mut self, shot: &Shot) -> bool {
        let frame = Frame {
            header: &shot.header,
            encoding: "",
            payload: (&shot.payload).into(),
            received: self.now,
            route: Route::Requested,
        };
        let taken = self.task.set_target(&frame);
        if let Ok(status) = taken {
            self.said = status;
        }
        taken.is_ok()
    }

    /// Obeys a word as a desk does.
    pub fn control(&mut self, control: Control) {
        self.control_late(control, self.now);
    }

    /// Obeys a word that was received at `received` and has waited since.
    pub fn control_late(&mut self, control: Control, received: Moment) {
        let Ok(Some(_)) = obey(&mut self.task, &mut self.outlet, control, received, self.now) else { return };
        self.started |= self.task.is_running();
        self.said = self.task.status();
        self.collect(None);
    }

    /// A stop for all, a lost client, a panic.
    pub fn halt(&mut self, status: Status) {
        self.outlet.halt(Some(status), self.now);
        self.task.latch(status);
        self.said = status;
        self.collect(None);
    }

    /// Whether it was taken.
    pub fn change_settings(&mut self, patch: &Value) -> bool {
        let changed = self.task.change_settings(patch).is_ok();
        if changed {
            let settings = self.task.settings();
            let period = Duration::from_secs_f64(settings.frame_period_s);
            let watchdog = self.task.watchdog();
            self.outlet.governor_mut().reconfigure(acceleration_limits(settings), watchdog, period);
            self.outlet.governor_mut().confine(speed_limits(settings), settings.degrees_of_freedom);
            self.unbroken = false;
        }
        changed
    }

    /// A pushed frame: received now, computed for so long, sent.
    pub fn push_slowly(&mut self, shot: &Shot, takes: Duration) -> TwistMessage {
        let frame = self.frame(shot, Route::Pushed);
        self.note_autostart();
        let answer = on_frame(&mut self.task, &frame, self.now);
        self.check_answer(&answer, shot);
        self.pass(takes);
        let sent = send_answer(&mut self.task, &mut self.outlet, &frame, answer, self.waiting_halt, self.now);
        self.said = sent.status;
        self.collect(Some((frame.received, answer.is_servoing())));
        sent
    }

    /// A pushed frame, computed at once.
    pub fn push(&mut self, shot: &Shot) -> TwistMessage {
        self.push_slowly(shot, Duration::ZERO)
    }

    /// A frame with a request, which takes so long.
    pub fn ask_slowly(&mut self, shot: &Shot, takes: Duration) -> TwistMessage {
        let frame = self.frame(shot, Route::Requested);
        self.note_autostart();
        let answer = on_frame(&mut self.task, &frame, self.now);
        self.pass(takes);
        let answer = recheck(answer, &self.outlet, &frame, self.waiting_halt, self.now);
        self.said = answer.status;
        self.check_answer(&answer, shot);
        answer
    }

    /// Lets time pass, with a clock that looks every few milliseconds.
    pub fn pass(&mut self, time: Duration) {
        if time.is_zero() {
            return;
        }
        let end = self.now + time;
        while self.looked + TICK <= end {
            self.now = self.now.max(self.looked + TICK);
            self.wake();
        }
        self.now = end;
    }

    /// The process stands still for so long. What wakes first: the clock, or the thread that receives.
    pub fn stand_still(&mut self, time: Duration, clock_wakes_first: bool) {
        self.now += time;
        if clock_wakes_first {
            self.wake();
        }
    }

    /// The clock looks, perhaps after the process stood still.
    pub fn wake(&mut self) {
        let pause = self.clocks.look(self.now, wall(self.now));
        self.outlet.wake(pause, self.now);
        self.look();
    }

    fn look(&mut self) {
        self.looked = self.now;
        let status = if self.said == Status::Servoing { Status::WaitingFrame } else { self.said };
        if let Some(status) = self.outlet.tick(status, self.now) {
            self.said = status;
        }
        self.collect(None);
    }

    fn frame<'a>(&self, shot: &'a Shot, route: Route) -> Frame<'a> {
        Frame { header: &shot.header, encoding: "", payload: (&shot.payload).into(), received: self.now, route }
    }

    fn note_autostart(&mut self) {
        self.started |= self.task.settings().autostart && self.task.target().is_some();
    }

    /// What holds for every answer, by either way.
    fn check_answer(&self, answer: &TwistMessage, shot: &Shot) {
        assert_eq!((answer.sequence, answer.capture_time_ns), (shot.header.sequence, shot.header.capture_time_ns));
        assert_eq!(answer.valid_ms, self.task.settings().watchdog_ms(), "{answer:?}");
        self.check(answer);
    }

    /// What holds for every message that says something about motion.
    fn check(&self, message: &TwistMessage) {
        let settings = self.task.settings();
        assert!(message.twist.iter().all(|component| component.is_finite()), "{message:?}");
        if !message.is_servoing() {
            assert!(message.twist.iter().all(|component| component.to_bits() == 0), "exact zeros: {message:?}");
            assert_eq!(message.flags.to_bits(), 0, "nothing was done to zeros: {message:?}");
            return;
        }
        assert!(self.started, "nothing moves before start: {message:?}");
        if let Some(limits) = settings.limits {
            let slack = 1.0 + 1e-12;
            assert!(norm(&message.twist[..3]) <= limits.linear_m_per_s * slack, "{message:?} of {limits:?}");
            assert!(norm(&message.twist[3..]) <= limits.angular_rad_per_s * slack, "{message:?} of {limits:?}");
        }
        for (component, free) in message.twist.iter().zip(settings.degrees_of_freedom) {
            assert!(free || *component == 0.0, "a masked degree moves: {message:?}");
        }
        assert!(message.gain > 0.0 && message.features > 0 && message.pixel_mse.is_finite(), "{message:?}");
    }

    /// Takes what was published, and holds it against what was before. `answered` is when the frame behind it came, and whether it was good.
    fn collect(&mut self, answered: Option<(Moment, bool)>) {
        let new = std::mem::take(&mut *self.published.lock().unwrap_or_else(PoisonError::into_inner));
        for message in new {
            self.check(&message);
            assert_eq!(message.valid_ms, self.task.settings().watchdog_ms());
            if message.is_servoing() {
                let (received, good) = answered.expect("only a frame makes a twist");
                assert!(
                    good && self.now.saturating_sub(received) <= self.task.watchdog(),
                    "an old frame moves: {message:?}"
                );
                self.check_growth(&message);
            }
            self.unbroken = true;
            self.sent.push(Sent { at: self.now, message });
        }
    }

    fn check_growth(&self, message: &TwistMessage) {
        let (Some(limits), true) = (self.task.settings().limits, self.unbroken) else { return };
        let period = self.task.settings().frame_period_s;
        let (last, seconds) = self.sent.last().map_or(([0.0; 6], period), |last| {
            (last.message.twist, self.now.saturating_sub(last.at).as_secs_f64().min(period))
        });
        let change: [f64; 6] = std::array::from_fn(|i| message.twist[i] - last[i]);
        // Rounding of a difference and a norm.
        let slack = 1e-9 * (1.0 + norm(&last));
        assert!(
            norm(&change[..3]) <= limits.linear_m_per_s2 * seconds + slack,
            "{message:?} after {last:?} in {seconds} s"
        );
        assert!(
            norm(&change[3..]) <= limits.angular_rad_per_s2 * seconds + slack,
            "{message:?} after {last:?} in {seconds} s"
        );
    }
}

/// A wall clock that goes on as the monotonic one does.
fn wall(now: Moment) -> SystemTime {
    SystemTime::UNIX_EPOCH + now
}

pub fn norm(part: &[f64]) -> f64 {
    part.iter().fold(0.0, |norm: f64, component| norm.hypot(*component))
}
