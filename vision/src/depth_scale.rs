//! A constant depth that is wrong by a factor (deviation D18): `ζ = s/Z`, with `s` from how the features answered to the camera's motion.
//!
//! Between two steps the features under one window change by `Δe = s L_t v_t + L_r v_r`, with `L` at the depth as given, the mean
//! of both frames' own, and `v` the displacement the camera was told to make. With `p = L_t v_t` and `d = Δe - L_r v_r` the least
//! squares over all steps, older ones counting less and each measured by its `e·e`, are `s = Σ p·d / Σ p·p`, kept near 1 until motion tells.

use crate::moments::FeatureRow;

/// Orders up to this one take part always, up to [`HIGHEST_ORDER`] as far as the law's own order goes.
pub(crate) const LOWEST_ORDER: usize = 6;

const HIGHEST_ORDER: usize = 10;

/// How much of the sums a step keeps.
const KEPT: f64 = 0.95;

/// How firmly it is believed, before any motion, that the given depth is right.
const PRIOR: f64 = 0.005;

/// Between these it is looked for.
const RANGE: [f64; 2] = [0.3, 3.0];

/// The estimate, and the frame before.
#[derive(Debug, Clone)]
pub(crate) struct DepthScaleEstimate {
    /// `Σ p·p` and `Σ p·d`.
    sums: [f64; 2],
    before: Features,
    now: Features,
}

/// The features of one frame, `[n][m]`, `e` and then the row of `L`.
#[derive(Debug, Clone)]
struct Features {
    order: Option<usize>,
    rows: Vec<[f64; 7]>,
}

impl Features {
    fn none() -> Features {
        Features { order: None, rows: vec![[0.0; 7]; (HIGHEST_ORDER + 1) * (HIGHEST_ORDER + 1)] }
    }

    fn set(&mut self, order: usize, rows: impl Iterator<Item = FeatureRow>) {
        self.order = Some(order);
        for row in rows.filter(|row| row.n + row.m <= order) {
            let [e, l @ ..] = &mut self.rows[row.n * (HIGHEST_ORDER + 1) + row.m];
            (*e, *l) = (row.error, row.interaction);
        }
    }

    fn at(&self, n: usize, m: usize) -> &[f64; 7] {
        &self.rows[n * (HIGHEST_ORDER + 1) + m]
    }
}

impl DepthScaleEstimate {
    /// Believes in the depth as it is given.
    pub(crate) fn new() -> DepthScaleEstimate {
        DepthScaleEstimate { sums: [0.0; 2], before: Features::none(), now: Features::none() }
    }

    /// `s`.
    pub(crate) fn scale(&self) -> f64 {
        let [squares, products] = self.sums;
        ((products + PRIOR) / (squares + PRIOR)).clamp(RANGE[0], RANGE[1])
    }

    /// Takes in the features of a frame of this order, as many as there are, and what the camera did since the frame before.
    pub(crate) fn update(
        &mut self,
        order: usize,
        displacement: Option<[f64; 6]>,
        rows: impl Iterator<Item = FeatureRow>,
    ) {
        std::mem::swap(&mut self.before, &mut self.now);
        self.now.set(order.clamp(LOWEST_ORDER, HIGHEST_ORDER), rows);
        if let (Some(displacement), Some(before), Some(now)) = (displacement, self.before.order, self.now.order) {
            self.learn(displacement, before.min(now));
        }
    }

    /// The features are no longer those of the same pixels.
    pub(crate) fn forget_frames(&mut self) {
        self.now.order = None;
    }

    fn learn(&mut self, displacement: [f64; 6], order: usize) {
        let (translation, rotation) = displacement.split_at(3);
        let along = |l: &[f64], part: &[f64]| l.iter().zip(part).map(|(l, v)| l * v).sum::<f64>();
        let (mut squares, mut products, mut error_squared) = (0.0, 0.0, 0.0);
        for (n, m) in (0..=order).flat_map(|n| (0..=order - n).map(move |m| (n, m))) {
            let [e_before, l_before @ ..] = self.before.at(n, m);
            let [e, l @ ..] = self.now.at(n, m);
            let mean: [f64; 6] = std::array::from_fn(|k| 0.5 * (l_before[k] + l[k]));
            let p = along(&mean[..3], translation);
            let d = e - e_before - along(&mean[3..], rotation);
            squares += p * p;
            products += p * d;
            error_squared += e * e;
        }
        let told = [squares / error_squared, products / error_squared];
        if told.iter().all(|sum| sum.is_finite()) {
            self.sums = [0, 1].map(|i| KEPT * self.sums[i] + told[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn l(i: usize, j: usize) -> f64 {
        (1.3 * (i + 1) as f64 * (j + 1) as f64).sin()
    }

    /// A camera that halves its way to the goal at every step, some axes faster; `e = truth L_t x_t + L_r x_r`.
    fn follow(truth: f64, steps: usize, order: impl Fn(usize) -> usize) -> DepthScaleEstimate {
        let mut estimate = DepthScaleEstimate::new();
        let mut way = [0.2, -0.3, 0.25, 0.1, -0.15, 0.3];
        let mut displacement = None;
        for step in 0..steps {
            let error = |i: usize| (0..6).map(|k| if k < 3 { truth } else { 1.0 } * l(i, k) * way[k]).sum::<f64>();
            let indices = (0..=10).flat_map(|n| (0..=10 - n).map(move |m| (n, m))).enumerate();
            let rows = indices.map(|(i, (n, m))| FeatureRow {
                n,
                m,
                error: error(i),
                interaction: std::array::from_fn(|k| l(i, k)),
            });
            let swept = order(step).max(6);
            estimate.update(order(step), displacement, rows.filter(|row| row.n + row.m <= swept));
            let motion: [f64; 6] = std::array::from_fn(|k| -(0.4 + 0.04 * k as f64) * way[k]);
            way = std::array::from_fn(|k| way[k] + motion[k]);
            displacement = Some(motion);
        }
        estimate
    }

    #[test]
    fn the_scale_goes_to_the_truth_as_the_camera_moves() {
        for truth in [0.5, 1.0, 1.4, 2.5] {
            let [one, few, many] = [1, 3, 12].map(|steps| (follow(truth, steps, |_| 8).scale() - truth).abs());
            assert!(one == (1.0 - truth).abs() && many <= few + 1e-12 && few <= one + 1e-12, "{one} {few} {many}");
            // |p|² is a tenth of |e|² at least, and ten steps count: the prior of 0.005 pulls by less than a hundredth.
            assert!(many <= 0.01 * one + 1e-12, "{truth}: off by {many}");
        }
    }

    #[test]
    fn an_order_that_changes_compares_what_both_frames_have() {
        let changing = follow(2.0, 12, |step| 4 + 5 * (step % 3)).scale();
        assert!((changing - 2.0).abs() < 0.01, "{changing}");
    }

    #[test]
    fn without_a_displacement_nothing_is_learnt() {
        let mut estimate = follow(2.0, 30, |_| 8);
        let before = estimate.scale();
        let row = FeatureRow { n: 1, m: 2, error: 1e3, interaction: [1.0; 6] };
        estimate.update(8, None, std::iter::once(row));
        assert_eq!(estimate.scale(), before);
        estimate.forget_frames();
        estimate.update(8, Some([0.1; 6]), std::iter::once(row));
        assert_eq!(estimate.scale(), before);
    }

    #[test]
    fn an_error_that_is_nothing_or_beyond_all_numbers_teaches_nothing() {
        for error in [0.0, 1e200] {
            let mut estimate = DepthScaleEstimate::new();
            let row = FeatureRow { n: 0, m: 0, error, interaction: [error; 6] };
            (0..2).for_each(|_| estimate.update(6, Some([0.1; 6]), std::iter::once(row)));
            assert_eq!(estimate.scale(), 1.0);
        }
    }

    #[test]
    fn the_scale_stays_within_its_range() {
        let mut estimate = DepthScaleEstimate::new();
        for sums in [[1.0, 9.0], [1.0, -9.0], [0.0, 0.0]] {
            estimate.sums = sums;
            assert!((0.3..=3.0).contains(&estimate.scale()));
        }
    }
}
