//! The judge of the fast way: the literal double sums over full planes, and an SVD for the pseudo-inverse. Slow, and plain.

use domvs_vision::basis::Basis;
use domvs_vision::family::{Cosine, Hahn, Krawtchouk, Polynomial, Tchebichef};
use domvs_vision::interaction::point_interaction;
use domvs_vision::{Depth, Lattice, Method, Plane, View, WindowInUse};
use nalgebra::{DMatrix, DVector, RowVector2};

use super::scenes::Pair;

/// `e`, `L̂` (a row per feature, `n` outside, `m` inside), and `-L̂⁺e`.
pub struct Judgement {
    pub error: DVector<f64>,
    pub interaction: DMatrix<f64>,
    pub gauss_newton: Vec<f64>,
    pub condition_number: f64,
}

/// The rows along `[u, v]` that a step said it used.
pub fn polynomials(method: Method, window: WindowInUse, lattice: Lattice) -> [Polynomial; 2] {
    match window {
        WindowInUse::Hahn { x, y } => [x, y].map(|[a, b]| Polynomial::Hahn(Hahn { a, b })),
        WindowInUse::Krawtchouk { p } => p.map(|p| Polynomial::Krawtchouk(Krawtchouk { p, lattice })),
        WindowInUse::Whole if method == Method::Cosine => [Polynomial::Cosine(Cosine); 2],
        WindowInUse::Whole => [Polynomial::Tchebichef(Tchebichef); 2],
    }
}

pub fn judge(pair: &Pair<f64>, polynomials: [Polynomial; 2], order: usize) -> Judgement {
    judge_weighted(pair, polynomials, order, &|_, _| 1.0)
}

/// The same sums with a weight on every pixel's `I - I*` and `L_I`.
pub fn judge_weighted(
    pair: &Pair<f64>,
    [along_u, along_v]: [Polynomial; 2],
    order: usize,
    weight: &dyn Fn(usize, usize) -> f64,
) -> Judgement {
    let (width, height) = (pair.current.0.width(), pair.current.0.height());
    let p = Basis::new(width, order + 1, along_u).unwrap();
    let q = Basis::new(height, order + 1, along_v).unwrap();
    let own = interaction_planes(pair, pair.current());
    let desired = interaction_planes(pair, pair.desired());

    let features: Vec<(usize, usize)> = (0..=order).flat_map(|n| (0..=order - n).map(move |m| (n, m))).collect();
    let double_sum = |(n, m): (usize, usize), plane: &dyn Fn(usize, usize) -> f64| -> f64 {
        let pixels = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
        pixels.map(|(u, v)| p.row(n)[u] * q.row(m)[v] * weight(u, v) * plane(u, v)).sum()
    };
    let error = DVector::from_iterator(
        features.len(),
        features.iter().map(|nm| double_sum(*nm, &|u, v| pair.current.0.at(u, v) - pair.desired.0.at(u, v))),
    );
    let interaction = DMatrix::from_fn(features.len(), 6, |i, k| {
        double_sum(features[i], &|u, v| 0.5 * (own[v * width + u][k] + desired[v * width + u][k]))
    });

    solve(error, interaction)
}

/// `-L̂⁺e` by singular values.
fn solve(error: DVector<f64>, interaction: DMatrix<f64>) -> Judgement {
    let svd = interaction.clone().svd(true, true);
    let condition_number = svd.singular_values.max() / svd.singular_values.min();
    let gauss_newton = -svd.pseudo_inverse(0.0).unwrap() * &error;
    Judgement { error, interaction, gauss_newton: gauss_newton.as_slice().to_vec(), condition_number }
}

/// The pixels themselves as features or, with an extent, the Gaussian mixture at every pixel.
pub fn judge_pixels(pair: &Pair<f64>, extent_px: Option<f64>) -> Judgement {
    let (width, height) = (pair.current.0.width(), pair.current.0.height());
    let (own, desired) = (interaction_planes(pair, pair.current()), interaction_planes(pair, pair.desired()));
    let gathered = |i: usize, plane: &dyn Fn(usize) -> f64| -> f64 {
        let Some(extent_px) = extent_px else { return plane(i) };
        let along = |i: usize, j: usize| (i as f64 - j as f64).powi(2);
        let squared = |j: usize| along(i % width, j % width) + along(i / width, j / width);
        (0..width * height).map(|j| plane(j) * (-squared(j) / (2.0 * extent_px * extent_px)).exp()).sum()
    };
    let difference = |j: usize| pair.current.0.samples()[j] - pair.desired.0.samples()[j];
    let error = DVector::from_fn(width * height, |i, _| gathered(i, &difference));
    let interaction = DMatrix::from_fn(width * height, 6, |i, k| gathered(i, &|j| 0.5 * (own[j][k] + desired[j][k])));
    solve(error, interaction)
}

/// `L_I = -∇Iᵀ L_κ L_x` at every pixel.
fn interaction_planes(pair: &Pair<f64>, view: View<'_, f64>) -> Vec<[f64; 6]> {
    let (image, [f_u, f_v]) = (view.image, pair.camera.focal_px());
    let pixels = (0..image.height()).flat_map(|v| (0..image.width()).map(move |u| (u, v)));
    pixels
        .map(|(u, v)| {
            let depth_m = match view.depth {
                Depth::Constant { depth_m } => *depth_m,
                Depth::Map(map) => 1.0 / map.inverse_per_m().at(u, v),
            };
            let [along_u, along_v] = gradient(image, u, v);
            let (x, y) = (pair.camera.x(u as f64), pair.camera.y(v as f64));
            let row = -RowVector2::new(f_u * along_u, f_v * along_v) * point_interaction(x, y, depth_m);
            row.into()
        })
        .collect()
}

/// Central differences, one-sided at the border, straight from their definition.
fn gradient(image: &Plane<f64>, u: usize, v: usize) -> [f64; 2] {
    let slope = |i: usize, last: usize, at: &dyn Fn(usize) -> f64| match i {
        0 => at(1) - at(0),
        i if i == last => at(last) - at(last - 1),
        i => (at(i + 1) - at(i - 1)) / 2.0,
    };
    [slope(u, image.width() - 1, &|u| image.at(u, v)), slope(v, image.height() - 1, &|v| image.at(u, v))]
}
