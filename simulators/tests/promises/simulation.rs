//! The lock-step simulation: the same every time, and back at the start when the displacement is undone.

use domvs_proto::keys::Name;
use domvs_simulators::{CameraSettings, Disturbance, Photograph, Simulation, motion};

fn simulation(disturbance: Disturbance) -> Simulation {
    let name = Name::try_from("cam").expect("letters");
    let settings =
        CameraSettings { width: 48, height: 48, disturbance, ..CameraSettings::new(name, Photograph::noise(64, 1)) };
    settings.simulation().expect("possible")
}

fn noisy() -> Disturbance {
    Disturbance { noise_std: 0.05, gain: 0.5, offset: 0.1, ..Disturbance::default() }
}

#[test]
fn undoing_the_displacement_arrives() {
    let mut simulation = simulation(Disturbance::default());
    // |t| of the exponential, not of its coordinates: the path is a screw.
    assert!(simulation.error().mm > 500.0 && simulation.error().deg > 30.0);
    let back = motion::log(&(simulation.pose.inverse() * simulation.desired));
    simulation.apply(back.map(|part| part / 4.0), 4.0);
    // f64 rounding of one exponential and one logarithm, in mm and degrees.
    assert!(simulation.error().mm < 1e-9 && simulation.error().deg < 1e-9);
    assert!(simulation.error().is_converged());
    let (current, desired) = (simulation.capture(), simulation.capture_desired());
    let largest = current.image.samples().iter().zip(desired.image.samples()).map(|(a, b)| (a - b).abs());
    // Poses equal to 1e-12 m, texel coordinates in f32.
    assert!(largest.fold(0.0, f32::max) < 1e-4);
}

#[test]
fn two_runs_are_equal_bit_for_bit() {
    let run = || {
        let mut simulation = simulation(noisy());
        let desired = simulation.capture_desired();
        simulation.apply([0.1, 0.2, -0.1, 0.05, 0.1, -0.2], 0.5);
        let current = simulation.capture();
        (desired.image, current.image, current.depth)
    };
    assert_eq!(run(), run());
}

#[test]
fn every_capture_has_noise_of_its_own() {
    let mut simulation = simulation(noisy());
    assert_ne!(simulation.capture().image, simulation.capture().image);
}

#[test]
fn light_does_not_touch_the_desired_image() {
    let mut dimmed = simulation(Disturbance { gain: 0.5, ..Disturbance::default() });
    let mut plain = simulation(Disturbance::default());
    assert_eq!(dimmed.capture_desired().image, plain.capture_desired().image);
    assert_ne!(dimmed.capture().image, plain.capture().image);
}
