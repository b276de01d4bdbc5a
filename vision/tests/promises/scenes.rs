//! Test pairs: smooth images that no basis can hide from, tilted depths, and the laws and cameras that go with them.

use domvs_vision::{
    Depth, DepthMap, Gain, Gaussian, GaussianForm, HoleFill, Intrinsics, KrawtchoukP, Lattice, Law, Method, OrderRule,
    Plane, Sample, Servo, View, Window,
};

/// Two views of one scene, made in `f64` and rounded to `f32` values, so that both number types see the same pixels.
pub struct Pair<T> {
    pub camera: Intrinsics,
    pub current: (Plane<T>, Depth<T>),
    pub desired: (Plane<T>, Depth<T>),
}

/// Every family, each on a window of its own.
pub fn every_method() -> Vec<Law> {
    let law = Law { step_cap: None, gain: Gain::PerSecond(1.0), ..Law::default() };
    let uneven = Window::Fixed { x: [3.5, 6.0], y: [9.0, 4.25] };
    vec![
        Law { method: Method::Hahn, ..law },
        Law { method: Method::Hahn, window: uneven, ..law },
        Law { method: Method::Hahn, window: Window::Adaptive, ..law },
        Law { method: Method::Hahn, window: Window::AdaptivePaper, ..law },
        Law { method: Method::Krawtchouk, ..law },
        Law { method: Method::Krawtchouk, lattice: Lattice::Exact, ..law },
        Law { method: Method::Krawtchouk, krawtchouk_p: KrawtchoukP::Fixed([0.4, 0.55]), ..law },
        Law { method: Method::Tchebichef, ..law },
        Law { method: Method::Cosine, ..law },
    ]
}

/// The methods whose features are pixels; the fast mixture in both its ways.
pub fn every_method_on_pixels() -> [Law; 4] {
    let photometric = Law { method: Method::Photometric, step_cap: None, gain: Gain::PerSecond(1.0), ..Law::default() };
    let mixture = |extent_px, form| Law {
        method: Method::GaussianMixture,
        gaussian: Gaussian { extent_px, form },
        ..photometric
    };
    let (exact, fast) = (GaussianForm::Exact, GaussianForm::Fast);
    [photometric, mixture(3.0, exact), mixture(0.7, fast), mixture(6.0, fast)]
}

pub fn with_order(law: Law, order: usize) -> Law {
    Law { order: OrderRule::fixed(order).unwrap(), ..law }
}

fn picture<T: Sample>(width: usize, height: usize, shift: f64) -> Plane<T> {
    let (w, h) = (width as f64, height as f64);
    Plane::from_fn(width, height, |u, v| {
        let (x, y) = ((u as f64 / w - 0.47 - shift), (v as f64 / h - 0.52 + 0.6 * shift));
        let spots = 0.5 * (-(9.0 * x * x + 14.0 * y * y)).exp()
            + 0.25 * (-(60.0 * (x - 0.2).powi(2) + 35.0 * (y + 0.15).powi(2))).exp();
        let waves = 0.06 * (11.0 * x + 17.0 * y).sin() * (23.0 * x * y + 1.0).cos();
        T::from_f64(f64::from((0.1 + spots + waves) as f32))
    })
}

fn tilted<T: Sample>(width: usize, height: usize, near_m: f64) -> Depth<T> {
    let metres = Plane::from_fn(width, height, |u, v| {
        let slope = 0.2 * u as f64 / width as f64 - 0.1 * v as f64 / height as f64;
        T::from_f64(f64::from((near_m + slope + 0.02 * (0.3 * u as f64).sin()) as f32))
    });
    Depth::Map(DepthMap::from_metres(&metres, HoleFill::Median).unwrap())
}

fn camera(width: usize, height: usize) -> Intrinsics {
    let (w, h) = (width as f64, height as f64);
    Intrinsics::new([0.93 * w, 0.95 * w], [0.49 * w, 0.53 * h]).unwrap()
}

impl<T: Sample> Pair<T> {
    /// Constant depths, differing between the views.
    pub fn at_constant_depth(width: usize, height: usize) -> Pair<T> {
        let depths = [0.9, 1.15].map(|depth_m| Depth::Constant { depth_m });
        Pair::with_depths(width, height, depths)
    }

    /// A depth map each.
    pub fn at_mapped_depth(width: usize, height: usize) -> Pair<T> {
        Pair::with_depths(width, height, [tilted(width, height, 0.8), tilted(width, height, 0.7)])
    }

    pub fn with_depths(width: usize, height: usize, [own, desired]: [Depth<T>; 2]) -> Pair<T> {
        Pair {
            camera: camera(width, height),
            current: (picture(width, height, 0.04), own),
            desired: (picture(width, height, 0.0), desired),
        }
    }

    pub fn current(&self) -> View<'_, T> {
        View { image: &self.current.0, depth: &self.current.1 }
    }

    pub fn desired(&self) -> View<'_, T> {
        View { image: &self.desired.0, depth: &self.desired.1 }
    }

    pub fn servo(&self, law: Law) -> Servo<T> {
        Servo::new(law, self.camera, self.desired()).unwrap()
    }
}

/// Largest difference over the largest of `expected`.
pub fn relative_difference(got: &[f64], expected: &[f64]) -> f64 {
    let largest = expected.iter().fold(0.0, |worst: f64, x| worst.max(x.abs()));
    let worst = got.iter().zip(expected).fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs()));
    assert!(got.len() == expected.len() && largest > 0.0 && worst.is_finite());
    worst / largest
}
