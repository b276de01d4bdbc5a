//! One row per status: how it is reached, and what it takes to move again. A status without a row does not compile.

use std::time::Duration;

use domvs_proto::frame::PixelFormat;
use domvs_proto::messages::Control;
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use serde_json::{Value, json};

use crate::pictures::{Shot, flat, scene, settings, stripes};
use crate::world::World;

/// How a test comes to a status.
enum Reached {
    /// From a task that has moved: what is done, whose last message says it.
    Here(fn(&mut World) -> TwistMessage),
    /// Before anything can have moved, or where the task itself is another.
    From(fn() -> (World, TwistMessage)),
    /// Only with a network: by the test of this name in `tests/tests/service`.
    Over(&'static str),
    /// Nothing in this version says it.
    Reserved,
}

/// What it takes to move again.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Clears {
    /// The next good frame.
    Frame,
    /// A start, or whatever the status asks for before it.
    Start,
    /// A target, then a start.
    Target,
    /// Never, for this task in this worker.
    Never,
}

const PERIOD: Duration = Duration::from_millis(33);

fn row(status: Status) -> (Reached, Clears) {
    use Clears::{Frame, Never, Start, Target};
    use Reached::{From, Here, Over, Reserved};
    match status {
        Status::Servoing => (Here(|world| good(world, 10)), Frame),
        Status::Converged => (Here(|world| again(world, 5, &scene(0.0))), Start),
        Status::WaitingTarget => (From(no_target), Target),
        Status::WaitingFrame => (Here(silence), Frame),
        Status::StaleFrame => (Here(twice), Frame),
        Status::BadFrame => (Here(|world| bent(world, |shot| shot.header.width += 1)), Frame),
        Status::LowTexture => (Here(|world| world.push(&flat(255.0).numbered(10, 0))), Frame),
        Status::NoDepth => (From(no_depth), Frame),
        Status::Diverging => (From(diverging), Start),
        Status::IterationCap => {
            (From(|| with(json!({ "stop": { "max_iterations": 2 } }), |world| again(world, 2, &scene(1.0)))), Start)
        }
        Status::Paused => (Here(|world| ordered(world, Control::Pause)), Start),
        Status::Stopped => (Here(|world| ordered(world, Control::Stop)), Start),
        Status::OwnerLost => (Here(|world| halted(world, Status::OwnerLost)), Never),
        Status::Superseded => (Here(|world| halted(world, Status::Superseded)), Never),
        Status::DeadlineMissed => (Here(late), Frame),
        Status::Overloaded => (Over("of_many_requests_at_once_each_is_answered_and_the_rest_are_overloaded"), Frame),
        Status::FrozenFrame => (From(frozen), Frame),
        Status::Internal => (Here(|world| latched(world, Status::Internal)), Target),
        Status::Ready => (From(ready), Start),
        Status::ClientLost => (Here(|world| latched(world, Status::ClientLost)), Start),
        Status::RankDeficient => (From(rank_deficient), Frame),
        Status::Lost => (Reserved, Never),
    }
}

fn good(world: &mut World, sequence: u64) -> TwistMessage {
    world.pass(PERIOD);
    // Each a little different: a camera that lives.
    let shot = scene(1.0 + (sequence % 5) as f64 * 0.1);
    world.push(&shot.numbered(sequence, clock(world)))
}

/// What the camera's clock says.
fn clock(world: &World) -> u64 {
    world.now.as_nanos() as u64
}

fn again(world: &mut World, times: u64, shot: &Shot) -> TwistMessage {
    let mut push = |sequence| {
        world.pass(PERIOD);
        world.push(&shot.clone().numbered(sequence, 0))
    };
    (1..times).for_each(|sequence| assert!(push(10 + sequence).is_servoing()));
    push(10 + times)
}

fn silence(world: &mut World) -> TwistMessage {
    good(world, 10);
    world.pass(world.task.watchdog() + PERIOD);
    world.sent.last().expect("zeros").message
}

fn twice(world: &mut World) -> TwistMessage {
    world.pass(PERIOD);
    let shot = scene(1.0).numbered(10, clock(world));
    assert!(world.push(&shot).is_servoing());
    world.push(&shot)
}

fn bent(world: &mut World, bend: fn(&mut Shot)) -> TwistMessage {
    let mut shot = scene(1.0).numbered(10, 0);
    bend(&mut shot);
    world.push(&shot)
}

fn late(world: &mut World) -> TwistMessage {
    let mut shot = scene(1.0).numbered(10, 0);
    shot.header.deadline_us = 1000;
    assert_eq!(world.ask_slowly(&shot, Duration::from_millis(2)).status, Status::DeadlineMissed);
    world.push_slowly(&shot, Duration::from_millis(2))
}

fn ordered(world: &mut World, control: Control) -> TwistMessage {
    world.control(control);
    let zeros = world.sent.last().expect("zeros at once").message;
    assert_eq!(zeros.status, world.task.status(), "before any frame");
    good(world, 10)
}

fn halted(world: &mut World, status: Status) -> TwistMessage {
    world.outlet.halt(Some(status), world.now);
    good(world, 10)
}

fn latched(world: &mut World, status: Status) -> TwistMessage {
    world.halt(status);
    good(world, 10)
}

/// A world of other settings, that has moved, and what is done in it.
fn with(patch: Value, act: fn(&mut World) -> TwistMessage) -> (World, TwistMessage) {
    let mut world = World::started(settings(patch), &scene(0.0));
    let message = act(&mut world);
    (world, message)
}

fn no_target() -> (World, TwistMessage) {
    let mut world = World::new(settings(json!({})));
    let message = good(&mut world, 10);
    (world, message)
}

fn ready() -> (World, TwistMessage) {
    let mut world = World::new(settings(json!({})));
    assert!(world.set_target(&scene(0.0)));
    let message = good(&mut world, 10);
    (world, message)
}

fn no_depth() -> (World, TwistMessage) {
    let settings = settings(json!({ "depth": "map" }));
    let mut world = World::started(settings, &scene(0.0).with_depth(|_| 1.0));
    let holes = scene(1.0).with_depth(|pixel| if pixel % 100 < 51 { f32::NAN } else { 1.0 });
    let message = world.push(&holes.numbered(10, 0));
    (world, message)
}

/// Rows alone, in both images: a mean of the two sees what either shows.
fn rank_deficient() -> (World, TwistMessage) {
    let mut world = World::started(settings(json!({})), &stripes());
    let message = world.push(&stripes().numbered(10, 0));
    (world, message)
}

fn diverging() -> (World, TwistMessage) {
    with(json!({ "gain": { "per_s": 0.001 } }), |world| {
        again(world, 2, &scene(0.5));
        for sequence in 20..29 {
            world.pass(PERIOD);
            assert!(world.push(&scene(9.0 + sequence as f64 * 0.01).numbered(sequence, 0)).is_servoing(), "{sequence}");
        }
        world.pass(PERIOD);
        world.push(&scene(9.0).numbered(29, 0))
    })
}

fn frozen() -> (World, TwistMessage) {
    with(json!({ "gain": { "per_s": 10 } }), |world| {
        for sequence in 10..40 {
            world.pass(PERIOD);
            let message = world.push(&scene(3.0).numbered(sequence, 0));
            if !message.is_servoing() {
                assert!(sequence >= 14, "five identical pictures at least");
                return message;
            }
        }
        panic!("the picture stands, the camera does not");
    })
}

/// A frame that is good in every one of these worlds.
fn good_again(world: &mut World, sequence: u64) -> TwistMessage {
    world.pass(PERIOD);
    let shot = scene(1.0 + (sequence % 5) as f64 * 0.1).numbered(sequence, clock(world));
    let needs_depth = matches!(world.task.settings().depth, domvs_proto::settings::Depth::Map { .. });
    world.push(&if needs_depth { shot.with_depth(|_| 1.0) } else { shot })
}

fn check_clears(world: &mut World, status: Status, clears: Clears) {
    let next = good_again(world, 100);
    match clears {
        Clears::Frame => assert!(next.is_servoing(), "{status} clears at the next good frame: {next:?}"),
        Clears::Never | Clears::Start | Clears::Target => {
            assert_eq!(next.status, status, "a good frame does not clear it");
        }
    }
    if clears == Clears::Target {
        world.control(Control::Start);
        assert!(!good_again(world, 101).is_servoing(), "{status} wants a target first");
        assert!(world.set_target(&scene(0.0)));
    }
    if matches!(clears, Clears::Start | Clears::Target) {
        assert!(!good_again(world, 102).is_servoing(), "not before start");
        world.control(Control::Start);
        assert!(good_again(world, 103).is_servoing(), "{status} clears at start");
    }
}

#[test]
fn every_status_is_reached_comes_with_exact_zeros_and_clears_as_the_documents_say() {
    for status in Status::ALL {
        let (reached, clears) = row(status);
        let (mut world, message) = match reached {
            Reached::Here(act) => {
                let mut world = World::started(settings(json!({ "gain": { "per_s": 10 } })), &scene(0.0));
                assert!(good(&mut world, 1).is_servoing());
                let message = act(&mut world);
                (world, message)
            }
            Reached::From(make) => make(),
            Reached::Over(test) => {
                crate::documents::assert_is_a_test(test);
                continue;
            }
            Reached::Reserved => continue,
        };
        assert_eq!(message.status, status, "{message:?}");
        if status != Status::Servoing {
            assert!(message.twist.iter().all(|component| component.to_bits() == 0), "{message:?}");
        }
        assert_eq!(status.is_latched(), is_latched(&world), "{status}: latched or not");
        check_clears(&mut world, status, clears);
    }
}

/// Whether the task itself will say so until it is told to start or resume.
fn is_latched(world: &World) -> bool {
    world.task.status().is_latched()
}

#[test]
fn resume_lifts_every_latched_status_but_internal_and_keeps_the_count() {
    for status in Status::ALL.into_iter().filter(|status| status.is_latched()) {
        let mut world = World::started(settings(json!({ "gain": { "per_s": 10 } })), &scene(0.0));
        assert!(good(&mut world, 1).is_servoing());
        world.halt(status);
        world.control(Control::Resume);
        let resumes = good(&mut world, 2).is_servoing();
        assert_eq!(resumes, status != Status::Internal, "{status}");
        assert!(!resumes || world.task.iterations() == 2);
    }
}

#[test]
fn whatever_the_status_no_zero_has_a_sign() {
    for status in Status::ALL.into_iter().filter(|status| *status != Status::Servoing) {
        let bytes = TwistMessage { twist: [-0.0; 6], ..TwistMessage::zero(status) }.encode();
        assert!(bytes[40..88].iter().all(|byte| *byte == 0), "{status}");
    }
}

#[test]
fn a_picture_at_the_border_does_not_flicker() {
    let mut world = World::started(settings(json!({ "gain": { "per_s": 0.01 } })), &scene(0.0));
    let contrasts = [0.02, 0.0105, 0.0095, 0.0105, 0.0095, 0.0115, 0.0121, 0.0105];
    let moves: Vec<bool> = contrasts
        .iter()
        .enumerate()
        .map(|(number, contrast)| {
            world.pass(PERIOD);
            world.push(&with_contrast(&scene(1.0), *contrast).numbered(number as u64 + 1, 0)).is_servoing()
        })
        .collect();
    assert_eq!(moves, [true, true, false, false, false, false, true, true]);
}

/// The same picture, as pale as this.
fn with_contrast(shot: &Shot, contrast: f64) -> Shot {
    let gray: Vec<f64> = shot.payload.iter().map(|gray| f64::from(*gray)).collect();
    let mean = gray.iter().sum::<f64>() / gray.len() as f64;
    let deviation = (gray.iter().map(|gray| (gray - mean).powi(2)).sum::<f64>() / gray.len() as f64).sqrt();
    let pale = |gray: &f64| (0.5 + contrast * (gray - mean) / deviation) as f32;
    let mut header = shot.header.clone();
    header.pixel_format = PixelFormat::Mono32F;
    Shot { header, payload: gray.iter().flat_map(|gray| pale(gray).to_le_bytes()).collect() }
}
