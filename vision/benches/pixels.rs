//! A step of the methods whose features are pixels, on 640x480 of them, one thread: `cargo bench -p domvs-vision --bench pixels`.

#![expect(clippy::unwrap_used, reason = "a benchmark stops where something that must hold does not")]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use domvs_vision::{Gaussian, GaussianForm, Law, Method};

#[expect(dead_code, reason = "the tests use what is left")]
#[path = "../tests/promises/scenes.rs"]
mod scenes;

use scenes::Pair;

fn step(criterion: &mut Criterion, group: &str, law: Law, parameter: impl std::fmt::Display) {
    let pairs = [("map", Pair::<f32>::at_mapped_depth(640, 480)), ("constant", Pair::at_constant_depth(640, 480))];
    for (kind, pair) in &pairs {
        let mut servo = pair.servo(law);
        let mut group = criterion.benchmark_group(format!("{group}/{kind}"));
        group.bench_function(BenchmarkId::from_parameter(&parameter), |bencher| {
            bencher.iter(|| black_box(servo.step(pair.current()).unwrap()));
        });
    }
}

fn photometric(criterion: &mut Criterion) {
    step(criterion, "photometric", Law { method: Method::Photometric, ..Law::default() }, "plain");
}

fn mixture(criterion: &mut Criterion) {
    for extent_px in [10.0, 80.0] {
        let gaussian = Gaussian { extent_px, form: GaussianForm::Fast };
        let law = Law { method: Method::GaussianMixture, gaussian, ..Law::default() };
        step(criterion, "gaussian_mixture", law, format!("{extent_px}px"));
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2));
    targets = photometric, mixture
}
criterion_main!(benches);
