//! The life of a task against a small model of it, written from docs/safety.md and from nothing else.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::time::Duration;

use domvs_proto::messages::Control;
use domvs_proto::status::Status;
use proptest::prelude::*;
use proptest::sample::select;
use serde_json::json;

use crate::anything::every;
use crate::pictures::{Shot, flat, scene, settings};
use crate::world::World;

const HOLD_FRAMES: u32 = 3;
const MAX_ITERATIONS: u32 = 25;
const DIVERGING_FRAMES: u32 = 10;

#[derive(Clone, Copy, Debug)]
enum Step {
    Control(Control),
    Target,
    /// A target that shows nothing.
    FlatTarget,
    Frame(View),
    StopAll,
    ClientLost,
    Panic,
    Silence,
}

#[derive(Clone, Copy, Debug)]
enum View {
    There,
    Near,
    Far,
    /// As dark as the lens cap.
    Black,
    WrongSize,
}

impl View {
    fn shot(self) -> Shot {
        match self {
            View::There => scene(0.0),
            View::Near => scene(1.0),
            View::Far => scene(9.0),
            View::Black => flat(0.0),
            View::WrongSize => {
                let mut shot = scene(1.0);
                shot.header.height -= 1;
                shot.payload.truncate((shot.header.width * shot.header.height) as usize);
                shot
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Waiting,
    Running,
    Latched(Status),
}

/// What the documents say a task does.
#[derive(Debug)]
struct Model {
    autostart: bool,
    has_target: bool,
    phase: Phase,
    iterations: u32,
    held: u32,
    worse: u32,
    initial: Option<f64>,
}

impl Model {
    fn new(autostart: bool) -> Model {
        Model { autostart, has_target: false, phase: Phase::Waiting, iterations: 0, held: 0, worse: 0, initial: None }
    }

    fn begin_anew(&mut self) {
        (self.iterations, self.held, self.worse, self.initial) = (0, 0, 0, None);
    }

    fn standing(&self) -> Status {
        match self.phase {
            Phase::Latched(status) => status,
            _ if !self.has_target => Status::WaitingTarget,
            Phase::Waiting => Status::Ready,
            Phase::Running => Status::WaitingFrame,
        }
    }

    fn control(&mut self, control: Control) {
        match control {
            Control::Stop => self.phase = Phase::Latched(Status::Stopped),
            Control::Start if self.has_target => {
                self.begin_anew();
                self.phase = Phase::Running;
            }
            Control::Pause if self.has_target && self.phase == Phase::Running => {
                self.phase = Phase::Latched(Status::Paused);
            }
            Control::Resume if self.has_target && matches!(self.phase, Phase::Latched(_)) => {
                self.phase = Phase::Running;
                (self.held, self.worse) = (0, 0);
            }
            _ => {}
        }
    }

    fn frame(&mut self, view: View) -> Status {
        if self.autostart && self.has_target && self.phase == Phase::Waiting {
            self.phase = Phase::Running;
        }
        if self.standing() != Status::WaitingFrame {
            return self.standing();
        }
        match view {
            View::WrongSize => return Status::BadFrame,
            View::Black => return Status::LowTexture,
            View::There | View::Near | View::Far => {}
        }
        let pixel_mse = view.shot().pixel_mse(&scene(0.0));
        let initial = *self.initial.get_or_insert(pixel_mse);
        let is_close = matches!(view, View::There);
        self.iterations += 1;
        self.held = if is_close { self.held + 1 } else { 0 };
        self.worse = if pixel_mse > 2.0 * initial + 0.01 { self.worse + 1 } else { 0 };
        let end = if self.held >= HOLD_FRAMES {
            Status::Converged
        } else if self.worse >= DIVERGING_FRAMES {
            Status::Diverging
        } else if self.iterations >= MAX_ITERATIONS {
            Status::IterationCap
        } else {
            return Status::Servoing;
        };
        self.phase = Phase::Latched(end);
        end
    }

    fn step(&mut self, step: Step) -> Option<Status> {
        match step {
            Step::Control(control) => self.control(control),
            Step::Target => {
                self.has_target = true;
                self.begin_anew();
            }
            Step::FlatTarget | Step::Silence => {}
            Step::Frame(view) => return Some(self.frame(view)),
            Step::StopAll => self.phase = Phase::Latched(Status::Stopped),
            Step::ClientLost => self.phase = Phase::Latched(Status::ClientLost),
            Step::Panic => {
                self.phase = Phase::Latched(Status::Internal);
                self.has_target = false;
            }
        }
        None
    }
}

/// The same step in the world.
fn obey(world: &mut World, step: Step, sequence: u64) -> Option<Status> {
    match step {
        Step::Control(control) => world.control(control),
        Step::Target => assert!(world.set_target(&scene(0.0))),
        Step::FlatTarget => assert!(!world.set_target(&flat(0.5))),
        Step::Frame(view) => {
            world.pass(Duration::from_millis(33));
            let captured = world.now.as_nanos() as u64;
            return Some(world.push(&view.shot().numbered(sequence, captured)).status);
        }
        Step::StopAll => world.halt(Status::Stopped),
        Step::ClientLost => world.halt(Status::ClientLost),
        Step::Panic => world.halt(Status::Internal),
        Step::Silence => world.pass(Duration::from_millis(700)),
    }
    None
}

fn step() -> impl Strategy<Value = Step> {
    let controls =
        select(vec![Control::Start, Control::Start, Control::Pause, Control::Resume, Control::Resume, Control::Stop]);
    let view = prop_oneof![
        6 => Just(View::Near), 4 => Just(View::Far), 6 => Just(View::There), 1 => Just(View::Black), 1 => Just(View::WrongSize)
    ];
    prop_oneof![
        6 => controls.prop_map(Step::Control),
        2 => Just(Step::Target),
        1 => Just(Step::FlatTarget),
        20 => view.prop_map(Step::Frame),
        1 => Just(Step::StopAll),
        1 => Just(Step::ClientLost),
        1 => Just(Step::Panic),
        1 => Just(Step::Silence),
    ]
}

/// Runs of one step, because some ends need many frames alike.
fn steps() -> impl Strategy<Value = Vec<(Step, usize)>> {
    let runs = select(vec![1usize, 1, 1, 2, 3, 12, 30]);
    proptest::collection::vec((step(), runs), 1..30)
}

#[test]
fn a_task_lives_as_the_model_written_from_the_documents_says() {
    let seen = RefCell::new(BTreeSet::new());
    every(128, (any::<bool>(), steps()), |(autostart, steps)| {
        let settings = settings(json!({
            "autostart": autostart, "gain": { "per_s": 0.01 },
            "stop": { "hold_frames": HOLD_FRAMES, "max_iterations": MAX_ITERATIONS },
        }));
        let (mut world, mut model) = (World::new(settings), Model::new(autostart));
        let mut sequence = 0;
        for (step, times) in steps {
            for _ in 0..times {
                sequence += 1;
                let (said, expected) = (obey(&mut world, step, sequence), model.step(step));
                assert_eq!(said, expected, "{step:?}, {model:?}");
                assert_eq!(world.task.status(), model.standing(), "after {step:?}, {model:?}");
                seen.borrow_mut().extend(said);
            }
        }
    });
    use Status::{
        BadFrame, ClientLost, Converged, Diverging, Internal, IterationCap, LowTexture, Paused, Ready, Servoing,
        Stopped, WaitingTarget,
    };
    let all = [
        BadFrame,
        ClientLost,
        Converged,
        Diverging,
        Internal,
        IterationCap,
        LowTexture,
        Paused,
        Ready,
        Servoing,
        Stopped,
        WaitingTarget,
    ];
    let seen = seen.into_inner();
    let missing: Vec<Status> = all.into_iter().filter(|status| !seen.contains(status)).collect();
    assert!(missing.is_empty(), "the steps never came to {missing:?}");
}
