//! Whatever comes, in whatever order: [`World`] holds every message against the promises as it leaves. Here is what may come, and
//! what an old frame is, by a clock that nobody in the service sees.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::time::Duration;

use domvs_proto::messages::Control;
use domvs_proto::status::Status;
use proptest::prelude::*;
use serde_json::json;

use crate::anything::{Event, FrameLike, events, every, frame, settings};
use crate::pictures::{self, Shot, scene};
use crate::world::World;

const MS: fn(u64) -> Duration = Duration::from_millis;

#[test]
fn whatever_comes_every_twist_is_finite_within_its_limits_and_zero_unless_servoing() {
    let seen = RefCell::new(BTreeSet::new());
    every(96, (settings(), frame(), events(60)), |(settings, target, events)| {
        let mut world = World::new(settings);
        set_target(&mut world, &target);
        let mut last: Option<Shot> = None;
        for (number, event) in events.into_iter().enumerate() {
            happen(&mut world, event, &mut last, number as u64 + 1);
        }
        seen.borrow_mut().extend(world.sent.iter().map(|sent| sent.message.status));
    });
    let seen = seen.into_inner();
    assert!(!seen.contains(&Status::Internal), "nothing that comes from outside is a defect in the service");
    // The generator is worth its name only if it comes this far.
    for status in
        [Status::Servoing, Status::BadFrame, Status::LowTexture, Status::NoDepth, Status::StaleFrame, Status::Paused]
    {
        assert!(seen.contains(&status), "no {status} among {seen:?}");
    }
}

fn set_target(world: &mut World, target: &FrameLike) {
    let shot = target.shot(world.task.settings(), world.now, 0);
    world.set_target(&shot);
}

fn happen(world: &mut World, event: Event, last: &mut Option<Shot>, sequence: u64) {
    let shot = |frame: FrameLike, world: &World| frame.shot(world.task.settings(), world.now, sequence);
    let before = world.task.status();
    match event {
        Event::Push { frame, takes_ms } => {
            let shot = shot(frame, world);
            world.push_slowly(&shot, MS(takes_ms.into()));
            *last = Some(shot);
        }
        Event::PushAgain => {
            if let Some(shot) = last {
                world.push(shot);
            }
        }
        Event::Ask { frame, takes_ms } => {
            let shot = shot(frame, world);
            world.ask_slowly(&shot, MS(takes_ms.into()));
        }
        Event::Order(control) => return world.control(control),
        Event::Target(frame) => set_target(world, &frame),
        Event::StopAll => return world.halt(Status::Stopped),
        Event::ClientLost => return world.halt(Status::ClientLost),
        Event::Patch(patch) => {
            world.change_settings(&patch);
        }
        Event::Wait { ms } => world.pass(MS(ms.into())),
        Event::StandStill { ms, clock_wakes_first } => world.stand_still(MS(ms.into()), clock_wakes_first),
    }
    if before.is_latched() {
        assert_eq!(world.task.status(), before, "latched until start or resume");
    }
}

/// A camera at some 30 frames a second, and what delays its frames on the way.
#[derive(Clone, Debug)]
enum Weather {
    /// So many frames come as they are taken, each within 10 ms.
    Fair(u8),
    /// The way holds everything back for so long; then all of it comes at once.
    LinkStands { ms: u16 },
    /// The way holds everything back for so long, and then gives it back in order, at so many hundredths of the camera's rate. What has
    /// not come after [`DRAINING`] comes at once.
    SlowDrain { ms: u16, percent: u16 },
    /// The process stands still for so long; what came meanwhile waits in the system's buffers.
    ProcessStands { ms: u16, clock_wakes_first: bool },
    /// The next frames come in another order, the first of them twice.
    Shuffled,
    /// The camera stops for so long.
    Dark { ms: u16 },
}

fn weather() -> impl Strategy<Value = Vec<Weather>> {
    let one = prop_oneof![
        4 => (1u8..40).prop_map(Weather::Fair),
        2 => (10u16..6000).prop_map(|ms| Weather::LinkStands { ms }),
        1 => (1000u16..6000, 102u16..300).prop_map(|(ms, percent)| Weather::SlowDrain { ms, percent }),
        2 => (10u16..6000, any::<bool>()).prop_map(|(ms, clock_wakes_first)| Weather::ProcessStands { ms, clock_wakes_first }),
        1 => Just(Weather::Shuffled),
        1 => (10u16..15_000).prop_map(|ms| Weather::Dark { ms }),
    ];
    proptest::collection::vec(one, 1..12)
}

const PERIOD: Duration = Duration::from_millis(33);
/// So long a link drains slowly.
const DRAINING: Duration = Duration::from_secs(8);

/// A camera before a task that started long ago; every frame shows something else.
struct Flight {
    world: World,
    sequence: u64,
    timed: bool,
    /// The oldest frame that moved anything, and how old it was.
    oldest: Duration,
}

impl Flight {
    fn new(timed: bool) -> Flight {
        Flight::with(timed, 200)
    }

    fn with(timed: bool, watchdog_ms: u32) -> Flight {
        let settings = pictures::settings(json!({
            "gain": { "per_s": 0.1 }, "stop": { "step_m": 1e-9, "step_rad": 1e-9 }, "watchdog_ms": watchdog_ms, "max_age_ms": 200,
        }));
        let world = World::started(settings, &scene(0.0));
        let mut flight = Flight { world, sequence: 0, timed, oldest: Duration::ZERO };
        flight.take(&[0], true);
        flight
    }

    /// Frames that were taken so long ago, in this order, come now.
    fn take(&mut self, ages_ms: &[u64], in_time: bool) {
        for age_ms in ages_ms {
            self.sequence += 1;
            let taken = self.world.now - MS(*age_ms);
            // The camera's clock is a year ahead.
            let clock = (taken + Duration::from_secs(31_536_000)).as_nanos() as u64;
            let shot = scene(1.0 + (self.sequence % 7) as f64 * 0.1);
            let sent = self.world.push(&shot.numbered(self.sequence, if self.timed { clock } else { 0 }));
            assert!(sent.is_servoing() || !in_time || *age_ms > 0, "a frame in time is of use: {sent:?}");
            if sent.is_servoing() {
                self.oldest = self.oldest.max(MS(*age_ms));
            }
        }
    }

    fn fair(&mut self, frames: u8) {
        for number in 0..u64::from(frames) {
            self.world.pass(PERIOD);
            self.take(&[number * 7 % 10], false);
        }
    }

    /// The frames of so long a time, oldest first.
    fn backlog(ms: u64) -> Vec<u64> {
        (1..=ms / PERIOD.as_millis() as u64).rev().map(|frame| frame * PERIOD.as_millis() as u64).collect()
    }

    /// Frames were held back for so long. They come at this rate until the last has caught up, or `most` has passed.
    fn drain(&mut self, held_ms: u16, percent: u16, most: Duration) {
        self.world.pass(MS(held_ms.into()));
        let mut age = MS(held_ms.into());
        let (begin, apart) = (self.world.now, PERIOD * 100 / u32::from(percent));
        while age > PERIOD && self.world.now < begin + most {
            self.take(&[age.as_millis() as u64], false);
            self.world.pass(apart);
            age = age + apart - PERIOD;
        }
        self.take(&Flight::backlog(age.as_millis() as u64), false);
    }

    /// How old a frame may be that moves something: the way itself takes up to 10 ms, which nobody can tell from an offset of the clocks, and
    /// a clock may drift by 1 ms/s.
    fn most(&self) -> Duration {
        MS(210) + (self.world.now - Duration::from_secs(100)) / 1000
    }

    fn happen(&mut self, weather: &Weather) {
        match *weather {
            Weather::Fair(frames) => self.fair(frames),
            Weather::LinkStands { ms } => {
                self.world.pass(MS(ms.into()));
                self.take(&Flight::backlog(ms.into()), false);
            }
            Weather::SlowDrain { ms, percent } => self.drain(ms, percent, DRAINING),
            Weather::ProcessStands { ms, clock_wakes_first } => {
                self.world.stand_still(MS(ms.into()), clock_wakes_first);
                self.take(&Flight::backlog(ms.into()), false);
                self.world.wake();
                self.take(&Flight::backlog(ms.into()), false);
            }
            Weather::Shuffled => {
                self.world.pass(4 * PERIOD);
                self.take(&[99, 33, 66, 33, 0, 99], false);
            }
            Weather::Dark { ms } => self.world.pass(MS(ms.into())),
        }
    }
}

#[test]
fn no_frame_that_waited_anywhere_for_longer_than_max_age_moves_anything() {
    every(96, weather(), |weather| {
        let mut flight = Flight::new(true);
        for one in &weather {
            flight.happen(one);
        }
        assert!(flight.oldest <= flight.most(), "a frame {:?} old moved the camera: {weather:?}", flight.oldest);
        flight.fair(40);
        let last = flight.world.sent.last().expect("a second of frames");
        assert!(last.message.is_servoing(), "a second of fair weather is enough: {last:?}");
    });
}

#[test]
fn a_backlog_that_drains_slowly_moves_nothing_until_it_has_caught_up() {
    for percent in [102, 104, 110, 120, 139, 141, 200, 300] {
        for held_ms in [1100, 3000] {
            let mut flight = Flight::new(true);
            flight.fair(40);
            flight.drain(held_ms, percent, Duration::from_secs(20));
            assert!(flight.oldest <= flight.most(), "{:?} old, {held_ms} ms at {percent} %", flight.oldest);
            flight.fair(2);
            assert!(flight.world.sent.last().expect("frames").message.is_servoing(), "it has caught up");
        }
    }
}

#[test]
fn a_frame_that_waits_for_its_twist_grows_older_than_max_age() {
    let mut flight = Flight::with(true, 300);
    flight.fair(10);
    for (takes_ms, moves) in [(5, true), (45, false)] {
        flight.world.pass(2 * PERIOD);
        flight.sequence += 1;
        // 160 ms old when it comes, of 200 that it may be.
        flight.world.pass(MS(160));
        let clock = (flight.world.now - MS(160) + Duration::from_secs(31_536_000)).as_nanos() as u64;
        let sent = flight.world.push_slowly(&scene(1.3).numbered(flight.sequence, clock), MS(takes_ms));
        let expected = if moves { Status::Servoing } else { Status::StaleFrame };
        assert_eq!(sent.status, expected, "after {takes_ms} ms more");
    }
}

#[test]
fn without_capture_times_nothing_out_of_order_or_twice_moves_anything() {
    let settings = pictures::settings(json!({ "gain": { "per_s": 0.1 }, "watchdog_ms": 200 }));
    let mut world = World::started(settings, &scene(0.0));
    let mut push = |sequence: u64| {
        world.pass(PERIOD);
        let sent = world.push(&scene(1.0 + (sequence % 7) as f64 * 0.1).numbered(sequence, 0));
        assert!(sent.is_servoing() || sent.status == Status::StaleFrame, "{sent:?}");
        sent.is_servoing()
    };
    assert_eq!([5, 6, 6, 5, 8, 7, 9].map(&mut push), [true, true, false, false, true, false, true]);
    assert_eq!([0, 0, 0].map(&mut push), [true; 3], "a camera that does not count");
    // The camera is started anew, and sends on at once.
    let moved: Vec<bool> = (1..=20).map(&mut push).collect();
    assert!(!moved[..6].contains(&true) && !moved[13..].contains(&false), "within two watchdog times: {moved:?}");
}

#[test]
fn a_start_that_waited_for_a_process_that_stood_still_moves_nothing() {
    for control in [Control::Start, Control::Resume] {
        for (clock_wakes_first, in_buffers) in [(true, false), (false, false), (true, true), (false, true)] {
            let mut world = World::started(pictures::settings(json!({})), &scene(0.0));
            world.control(Control::Stop);
            let asked = world.now;
            world.stand_still(MS(3000), clock_wakes_first);
            let received = if in_buffers { world.now } else { asked };
            world.control_late(control, received);
            assert_eq!(world.task.status(), Status::Stopped);
            world.wake();
            world.pass(MS(201));
            assert_eq!(world.push(&scene(1.0)).status, Status::Stopped);
            world.control(control);
            assert!(world.push(&scene(1.0)).is_servoing(), "a new one is obeyed");
        }
    }
}

#[test]
fn a_halt_that_is_heard_while_a_frame_is_computed_is_obeyed_before_its_twist() {
    for status in [Status::Stopped, Status::ClientLost, Status::Superseded] {
        let mut world = World::started(pictures::settings(json!({})), &scene(0.0));
        assert!(world.push(&scene(1.0)).is_servoing());
        world.waiting_halt = Some(status);
        let [sent, answer] = [world.push_slowly(&scene(1.1), MS(1)), world.ask_slowly(&scene(1.2), MS(1))];
        for message in [sent, answer] {
            assert_eq!((message.status, message.twist), (status, [0.0; 6]));
        }
    }
}

#[test]
fn without_capture_times_nothing_that_waited_for_a_process_that_stood_still_moves_anything() {
    let stalls = proptest::collection::vec((201u16..6000, any::<bool>()), 1..6);
    every(48, stalls, |stalls| {
        let mut flight = Flight::new(false);
        for (ms, clock_wakes_first) in stalls {
            flight.fair(10);
            flight.oldest = Duration::ZERO;
            flight.happen(&Weather::ProcessStands { ms, clock_wakes_first });
            assert_eq!(flight.oldest, Duration::ZERO);
            flight.fair(10);
            let last = flight.world.sent.last().expect("frames").message;
            assert!(last.is_servoing(), "one watchdog time later it goes on: {last:?}");
        }
    });
}

#[test]
fn without_capture_times_nothing_that_a_link_held_back_moves_anything() {
    let stalls = proptest::collection::vec(240u16..6000, 1..6);
    every(48, stalls, |stalls| {
        let mut flight = Flight::new(false);
        for ms in stalls {
            flight.fair(10);
            flight.oldest = Duration::ZERO;
            flight.happen(&Weather::LinkStands { ms });
            assert_eq!(flight.oldest, Duration::ZERO);
            flight.fair(10);
            let last = flight.world.sent.last().expect("frames").message;
            assert!(last.is_servoing(), "one watchdog time later it goes on: {last:?}");
        }
    });
}

#[test]
fn a_camera_that_was_not_known_before_the_process_stood_still_proves_nothing_by_its_clock() {
    let settings = pictures::settings(json!({ "gain": { "per_s": 0.1 } }));
    let mut world = World::started(settings, &scene(0.0));
    world.stand_still(MS(5000), true);
    for frame in 0..100 {
        let sent =
            world.push(&scene(1.0 + frame as f64 * 0.01).numbered(frame + 1, 1_000_000_000 + 33_000_000 * frame));
        assert_eq!(sent.status, Status::StaleFrame, "frame {frame} waited in a buffer");
    }
}

#[test]
fn requests_that_waited_for_a_process_that_stood_still_move_nothing() {
    for clock_wakes_first in [true, false] {
        let mut world = World::started(pictures::settings(json!({})), &scene(0.0));
        assert!(world.ask_slowly(&scene(1.0), MS(1)).is_servoing());
        world.stand_still(MS(5000), clock_wakes_first);
        let answer = world.ask_slowly(&scene(1.0), MS(1));
        assert_eq!((answer.status, answer.twist), (Status::StaleFrame, [0.0; 6]));
        world.wake();
        assert_eq!(world.ask_slowly(&scene(1.0), MS(1)).status, Status::StaleFrame);
        world.pass(MS(201));
        assert!(world.ask_slowly(&scene(1.0), MS(1)).is_servoing(), "a new one is as good as any");
    }
}

#[test]
fn a_clock_that_jumps_costs_its_frames_and_no_more() {
    every(16, (-20_000i64..20_000, 2u64..50), |(jump_ms, frames)| {
        let mut world = World::started(
            pictures::settings(json!({ "gain": { "per_s": 0.1 }, "stop": { "step_m": 1e-9, "step_rad": 1e-9 } })),
            &scene(0.0),
        );
        let mut clock_ms = 50_000i64;
        let mut last = Status::Ready;
        for frame in 0..frames + 330 {
            world.pass(PERIOD);
            clock_ms += 33 + if frame == frames { jump_ms } else { 0 };
            let shot = scene(1.0 + (frame % 9) as f64 * 0.1).numbered(frame + 1, clock_ms as u64 * 1_000_000);
            last = world.push(&shot).status;
        }
        // Back by less than a second is no jump: those frames are too old until what was before is forgotten.
        assert_eq!(last, Status::Servoing, "eleven seconds after a jump of {jump_ms} ms");
    });
}

#[test]
fn a_start_grows_from_rest_after_every_refusal() {
    let dark = pictures::flat(0.0);
    let settings = pictures::settings(json!({ "gain": { "per_s": 50 }, "step_cap": "none" }));
    let mut world = World::started(settings, &scene(0.0));
    for frame in 1..200u64 {
        world.pass(MS(33));
        let shot = if frame % 10 == 0 { dark.clone() } else { scene(2.0 + (frame % 3) as f64) };
        let sent = world.push(&shot.numbered(frame, 0));
        // `World` holds the growth itself; here is that it was needed.
        if frame % 10 == 1 && sent.is_servoing() {
            assert!(sent.flags.acceleration_limited, "{sent:?}");
        }
        if !sent.is_servoing() && sent.status != Status::LowTexture {
            world.control(Control::Start);
        }
    }
    assert!(world.sent.iter().filter(|sent| sent.message.is_servoing()).count() > 50);
}
