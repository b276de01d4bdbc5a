//! A step of the moments on 640x480 pixels, one thread: `cargo bench -p domvs-vision --bench step`. Words choose: `-- moved/map`.
//!
//! `moved`: two images take turns, so that an adaptive window moves at every step. `cached`: the same image, under a fixed window.
//! `literal`: the double sums of the tests' judge, at a small size, beside the fast way at the same size.

#![expect(clippy::unwrap_used, reason = "a benchmark stops where something that must hold does not")]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use domvs_vision::{Law, Method, Sample, Servo, View, Window};

#[expect(dead_code, reason = "the tests use what is left")]
#[path = "../tests/promises/judge.rs"]
mod judge;

#[expect(dead_code, reason = "the tests use what is left")]
#[path = "../tests/promises/scenes.rs"]
mod scenes;

use scenes::{Pair, with_order};

const SIZE: [usize; 2] = [640, 480];

fn depths<T: Sample>() -> [(&'static str, Pair<T>); 2] {
    let [width, height] = SIZE;
    [("map", Pair::at_mapped_depth(width, height)), ("constant", Pair::at_constant_depth(width, height))]
}

/// Steps through the views in turns.
fn steps<T: Sample>(servo: &mut Servo<T>, views: [View<'_, T>; 2], turn: &mut usize) {
    *turn += 1;
    black_box(servo.step(views[*turn % 2]).unwrap());
}

fn moved(criterion: &mut Criterion) {
    let law = Law { window: Window::Adaptive, ..Law::default() };
    for (kind, pair) in depths::<f32>() {
        let mut group = criterion.benchmark_group(format!("moved/{kind}"));
        for order in [8, 16, 24] {
            let (mut servo, mut turn) = (pair.servo(with_order(law, order)), 0);
            let views = [pair.current(), pair.desired()];
            (0..4).for_each(|_| steps(&mut servo, views, &mut turn));
            assert_eq!(servo.work().joint_sweeps, 4, "the window moves at every step");
            group.bench_function(BenchmarkId::from_parameter(order), |bencher| {
                bencher.iter(|| steps(&mut servo, views, &mut turn));
            });
        }
    }
}

fn cached(criterion: &mut Criterion) {
    for (kind, pair) in depths::<f32>() {
        let mut group = criterion.benchmark_group(format!("cached/{kind}"));
        for method in [Method::Hahn, Method::Cosine] {
            for order in [8, 16, 24] {
                let law = with_order(Law { method, ..Law::default() }, order);
                let (mut servo, mut turn) = (pair.servo(law), 0);
                let views = [pair.current(); 2];
                group.bench_function(BenchmarkId::new(method.word(), order), |bencher| {
                    bencher.iter(|| steps(&mut servo, views, &mut turn));
                });
            }
        }
    }
}

/// Both in `f64`, bases included.
fn literal(criterion: &mut Criterion) {
    let (pair, order) = (Pair::<f64>::at_mapped_depth(96, 72), 8);
    let law = with_order(Law { window: Window::Adaptive, ..Law::default() }, order);
    let mut group = criterion.benchmark_group("literal/96x72");
    let (mut servo, mut turn) = (pair.servo(law), 0);
    let window = servo.step(pair.current()).unwrap().window;
    let polynomials = judge::polynomials(law.method, window, law.lattice);
    group.bench_function("double sums", |bencher| bencher.iter(|| judge::judge(&pair, polynomials, order)));
    let views = [pair.current(), pair.desired()];
    group.bench_function("fast", |bencher| bencher.iter(|| steps(&mut servo, views, &mut turn)));
}

criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2));
    targets = moved, cached, literal
}
criterion_main!(benches);
