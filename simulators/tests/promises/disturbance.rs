//! Noise means what it says and can be made again; light is a line, clipped.

use domvs_simulators::{Disturbance, Shot};
use domvs_vision::Plane;

const SEED: u64 = 4;

fn gray() -> Plane<f32> {
    Plane::filled(101, 100, 0.5)
}

fn disturbed(disturbance: Disturbance, frame: u64) -> Plane<f32> {
    let mut image = gray();
    disturbance.apply_to_gray(&mut image, Shot::Current { image: 0 }, frame);
    image
}

fn noise(noise_std: f64) -> Disturbance {
    Disturbance { noise_std, seed: SEED, ..Disturbance::default() }
}

#[test]
fn the_default_changes_nothing() {
    assert_eq!(disturbed(Disturbance::default(), 3), gray());
}

#[test]
fn the_same_seed_and_frame_make_the_same_noise() {
    assert_eq!(disturbed(noise(0.1), 3), disturbed(noise(0.1), 3));
    assert_ne!(disturbed(noise(0.1), 3), disturbed(noise(0.1), 4));
    assert_ne!(disturbed(noise(0.1), 3), disturbed(Disturbance { seed: SEED + 1, ..noise(0.1) }, 3));
}

#[test]
fn noise_has_the_named_standard_deviation() {
    let image = disturbed(noise(0.05), 0);
    let count = image.samples().len() as f64;
    let mean = image.samples().iter().map(|&s| f64::from(s)).sum::<f64>() / count;
    let variance = image.samples().iter().map(|&s| (f64::from(s) - mean).powi(2)).sum::<f64>() / count;
    // Five standard errors of 10100 samples; at ten deviations from the clip nothing is clipped. Seed 4.
    assert!((mean - 0.5).abs() < 5.0 * 0.05 / count.sqrt(), "mean {mean}");
    assert!((variance.sqrt() - 0.05).abs() < 5.0 * 0.05 / (2.0 * count).sqrt(), "deviation {}", variance.sqrt());
}

#[test]
fn strong_noise_is_clipped() {
    let image = disturbed(noise(2.0), 0);
    assert!(image.samples().iter().all(|gray| (0.0..=1.0).contains(gray)));
    assert!(image.samples().contains(&0.0) && image.samples().contains(&1.0));
}

#[test]
fn light_is_gain_and_offset_clipped() {
    let light = |gain, offset| disturbed(Disturbance { gain, offset, ..Disturbance::default() }, 0).at(0, 0);
    assert_eq!(light(0.5, 0.25), 0.5);
    assert_eq!(light(1.5, 0.5), 1.0);
    assert_eq!(light(1.0, -0.75), 0.0);
}
