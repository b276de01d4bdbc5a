//! A steady step allocates nothing, whatever the method, option, depth and window: counted by the allocator itself. One test, so that nothing
//! else runs beside it.

#![expect(clippy::unwrap_used, reason = "a test stops where something that must hold does not")]

use std::alloc::System;

use domvs_vision::{
    Depth, DepthMap, DepthScale, Gain, Gaussian, GaussianForm, HoleFill, Holes, Intrinsics, Law, LightPrior, Method,
    NoiseFloor, OrderRule, Plane, Servo, View, Window,
};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const SIZE: [usize; 2] = [97, 71];

fn image(shift: f64) -> Plane<f32> {
    Plane::from_fn(SIZE[0], SIZE[1], |u, v| {
        let (x, y) = (u as f64 - 40.0 - shift, v as f64 - 30.0 + 0.5 * shift);
        (0.7 * (-(x * x + 1.4 * y * y) / 700.0).exp() + 0.1 * (0.3 * x).sin() * (0.2 * y).cos() + 0.15) as f32
    })
}

fn metres(near_m: f64, hole: usize) -> Plane<f32> {
    Plane::from_fn(SIZE[0], SIZE[1], |u, v| if u == hole { 0.0 } else { (near_m + 0.002 * (u + v) as f64) as f32 })
}

fn map(near_m: f64, hole: usize) -> DepthMap<f32> {
    DepthMap::from_metres(&metres(near_m, hole), HoleFill::Median).unwrap()
}

/// Every method, then every option on the default one.
fn laws() -> Vec<Law> {
    let law = Law { order: OrderRule::new(4, 12, 1e-3).unwrap(), ..Law::default() };
    let mixture = |extent_px| Law {
        method: Method::GaussianMixture,
        gaussian: Gaussian { extent_px, form: GaussianForm::Fast },
        ..law
    };
    let mut laws: Vec<Law> = Method::ALL.iter().map(|method| Law { method: *method, ..law }).collect();
    laws.extend([0.6, 3.0, 30.0].map(mixture));
    laws.extend([
        Law { window: Window::Adaptive, ..law },
        Law { light: Some(LightPrior::default()), ..law },
        Law { method: Method::Photometric, light: Some(LightPrior::default()), ..law },
        Law { noise_floor: NoiseFloor::Subtracted, ..law },
        Law { holes: Holes::Ignored, ..law },
        Law { gain: Gain::Adaptive { at_zero: 2.0, at_infinity: 0.5, slope_at_zero: 6.0 }, ..law },
        Law { depth_scale: DepthScale::Estimated, ..law },
    ]);
    laws
}

#[test]
fn a_steady_step_allocates_nothing() {
    let camera = Intrinsics::new([90.0, 92.0], [48.0, 35.0]).unwrap();
    let (desired, currents) = (image(0.0), [image(3.0), image(-11.0)]);
    let mask = Plane::from_fn(SIZE[0], SIZE[1], |u, _| if u < 9 { 0.0 } else { 1.0 });
    for (law, is_mapped) in laws().into_iter().flat_map(|law| [(law, true), (law, false)]) {
        if is_mapped && law.depth_scale == DepthScale::Estimated {
            continue;
        }
        let depth = |near_m| match is_mapped {
            true => Depth::Map(map(near_m, 5)),
            false => Depth::Constant { depth_m: near_m },
        };
        let (mut current, known) = (depth(0.8), depth(0.9));
        let arriving = [metres(0.8, 5), metres(0.7, 20)];
        let mut servo = Servo::new(law, camera, View { image: &desired, depth: &known }).unwrap();
        for mask in [None, Some(&mask)] {
            servo.set_mask(mask).unwrap();
            let mut step = |i: usize| {
                if let Depth::Map(map) = &mut current {
                    map.set_metres(&arriving[i % 2], HoleFill::Median).unwrap();
                }
                servo.step(View { image: &currents[i % 2], depth: &current }).unwrap();
                servo.moved([1e-3; 6]);
            };
            (0..4).for_each(&mut step);
            let region = Region::new(ALLOCATOR);
            (0..6).for_each(&mut step);
            let change = region.change();
            let counts = (change.allocations, change.reallocations, change.deallocations);
            assert_eq!(counts, (0, 0, 0), "mapped: {is_mapped}, masked: {}, {law:?}", mask.is_some());
        }
    }
}
