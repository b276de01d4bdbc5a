//! A light that changes (deviation D17): `I = I* + g I* + o + (g_u u + g_v v) I* + o_u u + o_v v`, besides what motion does.
//!
//! The columns `C` are features of the six planes `{I*, 1, u I*, v I*, u, v}`, with `u` and `v` from -1 to 1 across the image. Then
//! `e + L x - C h = 0` is solved for the step `x` and the light `h` together: the most probable pair, if `h` walks from step to step
//! with the deviations of [`LightPrior`] and falls back to 9/10 of what it was. Taking `h` out (the Schur complement) leaves plain
//! [`NormalEquations`] for `x`, and whatever follows does not know that there was a light.
//!
//! From `I*` rather than the mean image: then the columns are exact for a light of this form, whatever the displacement.

use nalgebra::{Matrix6, SymmetricEigen, Vector6};

use crate::control::NormalEquations;
use crate::gram::{ERROR, Gram, LIGHT};
use crate::law::LightPrior;

/// How much of the last step's light the next one starts from.
const REMEMBERED: f64 = 0.9;

/// Least variance of a feature's residual.
const LEAST_VARIANCE: f64 = 1e-6;

/// Lowest order with which six degrees of freedom and six of light can be told apart: 15 features.
pub(crate) const LOWEST_ORDER: usize = 4;

/// The order of the moments from which the first step guesses the light alone.
pub(crate) const FIRST_GUESS_ORDER: usize = 6;

/// Equations without light, and what is needed to say afterwards what the light was.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Separated {
    /// For the step alone.
    pub equations: NormalEquations,
    /// `h = at_rest + per_step x`.
    at_rest: Vector6<f64>,
    per_step: Matrix6<f64>,
}

impl Separated {
    /// The light once the step is known.
    pub(crate) fn light(&self, gauss_newton: [f64; 6]) -> [f64; 6] {
        (self.at_rest + self.per_step * Vector6::from(gauss_newton)).into()
    }
}

/// The products `CᵀC`, `LᵀC` and `Cᵀe`, in units of the prior: a light that may not change has columns of zeros.
struct Products {
    cc: Matrix6<f64>,
    lc: Matrix6<f64>,
    ce: Vector6<f64>,
    deviations: Vector6<f64>,
}

impl Products {
    fn of(gram: &Gram, prior: &LightPrior) -> Products {
        let deviations = Vector6::from(prior.deviations());
        let mut cc: Matrix6<f64> = gram.products.fixed_view::<6, 6>(LIGHT.start, LIGHT.start).into_owned();
        cc.fill_lower_triangle_with_upper_triangle();
        let lc: Matrix6<f64> = gram.products.fixed_view::<6, 6>(0, LIGHT.start).into_owned();
        let ce: Vector6<f64> = gram.products.fixed_view::<6, 1>(LIGHT.start, ERROR).into_owned();
        let scale = Matrix6::from_diagonal(&deviations);
        Products { cc: scale * cc * scale, lc: lc * scale, ce: ce.component_mul(&deviations), deviations }
    }

    /// The equations for `x` when a feature's residual has this variance `s²`: with `h` in units of the prior and `K = CᵀC + s²`,
    /// `h = K⁻¹ (Cᵀe + s² c + CᵀL x)`, put into `LᵀL x - LᵀC h = -Lᵀe`.
    /// `None` where a number is too large for one.
    fn separate(&self, plain: &NormalEquations, center: [f64; 6], variance: f64) -> Option<Separated> {
        // Only a column that is in the law has a centre; without its prior it would divide by zero.
        let center =
            Vector6::from_fn(|i, _| if self.deviations[i] > 0.0 { center[i] / self.deviations[i] } else { 0.0 });
        let k = self.cc + variance * Matrix6::identity();
        if !k.iter().all(|number| number.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(k);
        let inverse = eigen.eigenvalues.map(|eigenvalue| 1.0 / eigenvalue.max(variance));
        let k_inverse = eigen.eigenvectors * Matrix6::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        let at_rest = k_inverse * (self.ce + variance * center);
        let per_step = k_inverse * self.lc.transpose();
        let reduced = plain.matrix - self.lc * per_step;
        let scale = Matrix6::from_diagonal(&self.deviations);
        let equations = NormalEquations {
            matrix: 0.5 * (reduced + reduced.transpose()),
            vector: plain.vector - self.lc * at_rest,
            ..*plain
        };
        let is_finite = equations.is_finite();
        is_finite.then_some(Separated { equations, at_rest: scale * at_rest, per_step: scale * per_step })
    }
}

/// Takes the light out of the products of one step, `previous` being the light of the step before; `free` are the camera's degrees.
/// `None` where a number is too large for one.
pub(crate) fn separate(gram: &Gram, prior: &LightPrior, previous: [f64; 6], free: [bool; 6]) -> Option<Separated> {
    let (plain, products) = (gram.normal_equations(), Products::of(gram, prior));
    let center = previous.map(|light| REMEMBERED * light);
    let per_feature = |squares: f64| (squares / gram.features as f64).max(LEAST_VARIANCE);
    // Two passes: the variance of what a first solution leaves unexplained is the variance of the second.
    let first = products.separate(&plain, center, per_feature(plain.error_squared))?;
    let step = first.equations.solve(free).gauss_newton;
    let residual = residual_squared(gram, step, first.light(step));
    products.separate(&plain, center, per_feature(residual))
}

/// The light that alone explains `e` best, as if the camera stood at its goal: the guess of a first step.
pub(crate) fn light_alone(gram: &Gram, prior: &LightPrior) -> [f64; 6] {
    let mut matrix: Matrix6<f64> = gram.products.fixed_view::<6, 6>(LIGHT.start, LIGHT.start).into_owned();
    matrix.fill_lower_triangle_with_upper_triangle();
    let vector: Vector6<f64> = gram.products.fixed_view::<6, 1>(LIGHT.start, ERROR).into_owned();
    let equations = NormalEquations { matrix, vector: -vector, ..gram.normal_equations() };
    equations.solve(prior.deviations().map(|deviation| deviation > 0.0)).gauss_newton
}

/// `|e + L x - C h|²`.
fn residual_squared(gram: &Gram, step: [f64; 6], light: [f64; 6]) -> f64 {
    let mut factors = [0.0; ERROR + 1];
    factors[..LIGHT.start].copy_from_slice(&step);
    factors[LIGHT].iter_mut().zip(light).for_each(|(factor, light)| *factor = -light);
    factors[ERROR] = 1.0;
    let product = |i: usize, j: usize| gram.products[(i.min(j), i.max(j))] * factors[i] * factors[j];
    (0..=ERROR).flat_map(|i| (0..=ERROR).map(move |j| (i, j))).map(|(i, j)| product(i, j)).sum::<f64>().max(0.0)
}

/// Where pixel `i` of `length` lies between -1 and 1.
pub(crate) fn across(i: usize, length: usize) -> f64 {
    2.0 * i as f64 / (length - 1) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(i: usize, j: usize) -> f64 {
        (1.3 * (i + 1) as f64 * (j + 1) as f64).sin()
    }

    const STEP: [f64; 6] = [0.1, -0.2, 0.3, 0.05, -0.02, 0.4];
    const LIGHT_NOW: [f64; 6] = [-0.3, 0.05, 0.2, -0.1, 0.03, 0.01];

    /// Features whose error is a light's and a step's, and a part that neither explains.
    fn gram(unexplained: f64) -> Gram {
        let mut gram = Gram::new();
        for i in 0..40 {
            let (l, c): ([f64; 6], [f64; 6]) =
                (std::array::from_fn(|j| wave(i, j)), std::array::from_fn(|j| wave(i, 6 + j)));
            let explained: f64 = (0..6).map(|j| c[j] * LIGHT_NOW[j] - l[j] * STEP[j]).sum();
            gram.add_with_light(&l, &c, explained + unexplained * wave(i, 12));
        }
        gram
    }

    fn distance(a: [f64; 6], b: [f64; 6]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// A prior that says next to nothing.
    const LOOSE: LightPrior = LightPrior { gain: 1e4, offset: 1e4, gain_slope: 1e4, offset_slope: 1e4 };

    #[test]
    fn a_step_and_a_light_that_explain_the_error_are_both_found() {
        let gram = gram(0.0);
        let separated = separate(&gram, &LOOSE, [0.0; 6], [true; 6]).expect("numbers");
        let step = separated.equations.solve([true; 6]).gauss_newton;
        assert!(distance(step, STEP) < 1e-9, "the prior weighs 1e-6/1e8 against products near 20");
        assert!(distance(separated.light(step), LIGHT_NOW) < 1e-9);
        let alone = gram.normal_equations().solve([true; 6]).gauss_newton;
        assert!(distance(alone, STEP) > 0.01, "without the columns the light is taken for motion: {alone:?}");
    }

    #[test]
    fn the_solution_is_the_least_of_what_is_unexplained_and_unlikely() {
        let (gram, prior, previous) = (gram(0.2), LightPrior::default(), [0.1, -0.1, 0.05, 0.0, 0.02, 0.0]);
        let free = [true, true, true, true, false, true];
        let first = separate(&gram, &prior, previous, free).expect("numbers");
        let step = first.equations.solve(free).gauss_newton;
        let light = first.light(step);
        // The variance that the second pass took, from a pass of our own.
        let products = Products::of(&gram, &prior);
        let plain = gram.normal_equations();
        let center = previous.map(|light| 0.9 * light);
        let pass = products.separate(&plain, center, plain.error_squared / 40.0).expect("numbers");
        let its_step = pass.equations.solve(free).gauss_newton;
        let variance = residual_squared(&gram, its_step, pass.light(its_step)) / 40.0;
        let cost = |step: [f64; 6], light: [f64; 6]| {
            let unlikely = (0..6).map(|i| ((light[i] - center[i]) / prior.deviations()[i]).powi(2));
            residual_squared(&gram, step, light) / variance + unlikely.sum::<f64>()
        };
        let least = cost(step, light);
        for i in 0..6 {
            for change in [-1e-3, 1e-3] {
                let moved = |mut values: [f64; 6]| {
                    values[i] += change;
                    values
                };
                assert!(cost(step, moved(light)) > least);
                assert!(!free[i] || cost(moved(step), light) > least);
            }
        }
        assert_eq!(step[4], 0.0);
    }

    #[test]
    fn a_light_that_may_not_change_stays_and_a_tight_prior_keeps_it_near_what_it_was() {
        let gram = gram(0.1);
        let only_gain = LightPrior { gain: 1e4, offset: 0.0, gain_slope: 0.0, offset_slope: 0.0 };
        let separated = separate(&gram, &only_gain, [0.0; 6], [true; 6]).expect("numbers");
        let light = separated.light(separated.equations.solve([true; 6]).gauss_newton);
        assert!(light[0] != 0.0 && light[1..] == [0.0; 5]);
        let tight = LightPrior { gain: 1e-9, offset: 1e-9, gain_slope: 1e-9, offset_slope: 1e-9 };
        let separated = separate(&gram, &tight, [0.5; 6], [true; 6]).expect("numbers");
        let light = separated.light(separated.equations.solve([true; 6]).gauss_newton);
        assert!(distance(light, [0.45; 6]) < 1e-9, "nine tenths of what it was");
    }

    #[test]
    fn a_light_alone_is_found_when_nothing_moved() {
        let mut gram = Gram::new();
        for i in 0..28 {
            let c: [f64; 6] = std::array::from_fn(|j| wave(i, 6 + j));
            gram.add_with_light(&[0.0; 6], &c, c.iter().zip(LIGHT_NOW).map(|(c, h)| c * h).sum());
        }
        assert!(distance(light_alone(&gram, &LightPrior::default()), LIGHT_NOW) < 1e-12);
        let no_slope = LightPrior { gain_slope: 0.0, offset_slope: 0.0, ..LightPrior::default() };
        assert_eq!(light_alone(&gram, &no_slope)[2..], [0.0; 4]);
    }
}
