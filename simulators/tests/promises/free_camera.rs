//! A free camera moves while it is told to and brakes in every doubt.

use std::time::{Duration, Instant};

use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use domvs_simulators::{BrakeReason, CommandRefused, FreeCamera, Motion};
use nalgebra::Isometry3;

const PATIENCE: Duration = Duration::from_millis(500);
const RIGHT: [f64; 6] = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];

struct Bench {
    start: Instant,
    camera: FreeCamera,
}

impl Bench {
    fn new() -> Bench {
        let start = Instant::now();
        Bench { start, camera: FreeCamera::new(Isometry3::identity(), PATIENCE, start) }
    }

    fn at(&self, ms: u64) -> Instant {
        self.start + Duration::from_millis(ms)
    }

    fn command(&mut self, ms: u64, message: TwistMessage) -> Result<(), CommandRefused> {
        let now = self.at(ms);
        self.camera.command(&message, now)
    }

    /// Where the camera is along x, m.
    fn x_at(&mut self, ms: u64) -> f64 {
        let now = self.at(ms);
        self.camera.advance(now);
        self.camera.pose().translation.x
    }

    fn braked(&self, reason: BrakeReason) -> bool {
        self.camera.motion() == Motion::Braked(reason) && self.camera.twist() == [0.0; 6]
    }
}

fn servoing(twist: [f64; 6], epoch: u32, valid_ms: u32) -> TwistMessage {
    TwistMessage { twist, epoch, valid_ms, ..TwistMessage::zero(Status::Servoing) }
}

fn close(got_m: f64, expected_m: f64) {
    // f64 rounding of a few products.
    assert!((got_m - expected_m).abs() < 1e-12, "at {got_m} m, expected {expected_m} m");
}

#[test]
fn it_stands_until_it_is_commanded() {
    let mut bench = Bench::new();
    close(bench.x_at(1000), 0.0);
    assert!(bench.braked(BrakeReason::NoCommand));
}

#[test]
fn it_moves_by_the_twist_while_the_command_holds() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(100, servoing(RIGHT, 1, 300)), Ok(()));
    close(bench.x_at(200), 0.01);
    assert_eq!(bench.camera.motion(), Motion::Moving);
    // The next command takes over where the first had come to.
    assert_eq!(bench.command(300, servoing([-0.2, 0.0, 0.0, 0.0, 0.0, 0.0], 1, 300)), Ok(()));
    close(bench.x_at(400), 0.0);
}

#[test]
fn it_brakes_exactly_when_valid_ms_has_run_out() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 1, 200)), Ok(()));
    close(bench.x_at(5000), 0.02);
    assert!(bench.braked(BrakeReason::Silence));
}

#[test]
fn a_command_that_came_in_time_is_not_undone_by_a_late_advance() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 1, 200)), Ok(()));
    assert_eq!(bench.command(150, servoing(RIGHT, 1, 200)), Ok(()));
    close(bench.x_at(5000), 0.035);
}

#[test]
fn its_own_patience_ends_a_command_that_would_hold_longer() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 1, u32::MAX)), Ok(()));
    close(bench.x_at(5000), 0.05);
    assert!(bench.braked(BrakeReason::Silence));
}

#[test]
fn zeros_brake_at_once() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 1, 300)), Ok(()));
    assert_eq!(bench.command(100, servoing([0.0; 6], 1, 300)), Ok(()));
    assert!(bench.braked(BrakeReason::Zeros));
    close(bench.x_at(300), 0.01);
}

#[test]
fn every_status_but_servoing_brakes_whatever_the_twist() {
    for status in Status::ALL.into_iter().filter(|&status| status != Status::Servoing) {
        let mut bench = Bench::new();
        assert_eq!(bench.command(0, servoing(RIGHT, 1, 300)), Ok(()));
        assert_eq!(bench.command(100, TwistMessage { status, ..servoing(RIGHT, 1, 300) }), Ok(()));
        assert!(bench.braked(BrakeReason::Status(status)));
        close(bench.x_at(300), 0.01);
    }
}

#[test]
fn an_unknown_status_on_the_wire_brakes() {
    let mut bytes = servoing(RIGHT, 1, 300).encode();
    bytes[1] = 200;
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 1, 300)), Ok(()));
    let unknown = TwistMessage::decode(&bytes).expect("an unknown status is readable");
    assert_eq!(bench.command(100, unknown), Ok(()));
    close(bench.x_at(300), 0.01);
}

#[test]
fn an_older_epoch_is_not_heard() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 7, 300)), Ok(()));
    let older = CommandRefused::OlderEpoch { expected: 7, got: 6 };
    assert_eq!(bench.command(100, servoing([9.0; 6], 6, 300)), Err(older));
    close(bench.x_at(200), 0.02);
    assert_eq!(bench.camera.twist(), RIGHT);
}

#[test]
fn another_task_starts_its_epochs_anew() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing([0.0; 6], 7, 300)), Ok(()));
    bench.camera.change_owner();
    assert_eq!(bench.command(100, servoing(RIGHT, 1, 300)), Ok(()));
}

#[test]
fn what_is_not_finite_is_refused_and_brakes() {
    for component in [f64::NAN, f64::INFINITY] {
        let mut bench = Bench::new();
        assert_eq!(bench.command(0, servoing(RIGHT, 1, 300)), Ok(()));
        let wild = servoing([0.0, 0.0, 0.0, 0.0, component, 0.0], 1, 300);
        assert!(matches!(bench.command(100, wild), Err(CommandRefused::NotFinite { .. })));
        assert!(bench.braked(BrakeReason::Untrusted));
        close(bench.x_at(300), 0.01);
    }
}

#[test]
fn after_a_stop_of_everything_only_zeros_set_it_free() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(0, servoing(RIGHT, 1, 300)), Ok(()));
    let stop = bench.at(100);
    bench.camera.stop_all(stop);
    assert_eq!(bench.command(110, servoing(RIGHT, 1, 300)), Err(CommandRefused::StopAll));
    let doubt = bench.at(120);
    bench.camera.untrusted(doubt);
    assert!(bench.braked(BrakeReason::StopAll));
    close(bench.x_at(200), 0.01);
    assert_eq!(bench.command(210, TwistMessage { epoch: 1, ..TwistMessage::zero(Status::Stopped) }), Ok(()));
    assert_eq!(bench.command(300, servoing(RIGHT, 1, 300)), Ok(()));
    close(bench.x_at(400), 0.02);
}

#[test]
fn time_that_runs_backwards_changes_nothing() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(100, servoing(RIGHT, 1, 300)), Ok(()));
    close(bench.x_at(200), 0.01);
    close(bench.x_at(50), 0.01);
    close(bench.x_at(300), 0.02);
}
