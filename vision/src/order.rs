//! How many moments: few while the images differ much (a wide domain), more as they meet (precision), Eq. (25)–(28).
//!
//! `η = 1 / (1 + (e/ε)(e - ε)/(e° - ε))`, `l = round((l_max - l_min) η + l_min)`, with `e` the pixel mean square error to the
//! desired image now and `e°` that of the initial image. The clamps where the formula breaks are deviation D4 of `docs/paper.md`.

/// The highest order any basis here is made for.
pub(crate) const HIGHEST_ORDER: usize = 40;

/// The order `l` as a function of the pixel error; `min == max` is a fixed order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderRule {
    min: usize,
    max: usize,
    epsilon: f64,
}

/// Why numbers do not make an order rule.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum OrderError {
    /// The bounds are out of order or out of range.
    #[error("orders must satisfy 1 <= min <= max <= {HIGHEST_ORDER}, got {min}..{max}")]
    Bounds {
        /// Lowest.
        min: usize,
        /// Highest.
        max: usize,
    },
    /// `ε` is not positive and finite.
    #[error("the order rule's epsilon must be positive and finite, got {epsilon}")]
    Epsilon {
        /// As given.
        epsilon: f64,
    },
}

impl Default for OrderRule {
    /// Orders 4 to 16, the highest from a pixel mean square error of 0.001 down.
    fn default() -> OrderRule {
        OrderRule { min: 4, max: 16, epsilon: 1e-3 }
    }
}

impl OrderRule {
    /// Orders `min..=max`; `epsilon` is the pixel mean square error at which the highest is reached.
    ///
    /// # Errors
    /// Bounds outside `1..=40` or reversed, or an epsilon that is not positive and finite.
    pub fn new(min: usize, max: usize, epsilon: f64) -> Result<OrderRule, OrderError> {
        if !(1 <= min && min <= max && max <= HIGHEST_ORDER) {
            return Err(OrderError::Bounds { min, max });
        }
        if !(epsilon > 0.0 && epsilon.is_finite()) {
            return Err(OrderError::Epsilon { epsilon });
        }
        Ok(OrderRule { min, max, epsilon })
    }

    /// Always `order`.
    ///
    /// # Errors
    /// An order outside `1..=40`.
    pub fn fixed(order: usize) -> Result<OrderRule, OrderError> {
        OrderRule::new(order, order, OrderRule::default().epsilon)
    }

    /// The same rule with no order below `lowest`.
    pub(crate) fn at_least(self, lowest: usize) -> OrderRule {
        OrderRule { min: self.min.max(lowest), max: self.max.max(lowest), ..self }
    }

    /// Lowest order.
    pub fn min(&self) -> usize {
        self.min
    }

    /// Highest order.
    pub fn max(&self) -> usize {
        self.max
    }

    /// The pixel mean square error at which the highest order is reached.
    pub fn epsilon(&self) -> f64 {
        self.epsilon
    }

    /// The order at pixel mean square error `mse`, when the initial image had `initial_mse`; halves round up.
    pub fn order(&self, mse: f64, initial_mse: f64) -> usize {
        self.unrounded(mse, initial_mse).round() as usize
    }

    /// `l` before rounding, within `min..=max`, Eq. (25).
    pub fn unrounded(&self, mse: f64, initial_mse: f64) -> f64 {
        let (min, max, epsilon) = (self.min as f64, self.max as f64, self.epsilon);
        if mse <= epsilon || initial_mse <= epsilon {
            return max;
        }
        let eta = 1.0 / (1.0 + mse / epsilon * (mse - epsilon) / (initial_mse - epsilon));
        (max - min) * eta.clamp(0.0, 1.0) + min
    }
}

/// How many features `P_nm` with `n + m <= order` there are.
pub(crate) fn feature_count(order: usize) -> usize {
    (order + 1) * (order + 2) / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_rises_from_the_lowest_to_the_highest_as_the_images_meet() {
        let rule = OrderRule::new(6, 16, 1e-3).expect("valid");
        let orders: Vec<usize> = [0.06, 0.03, 0.01, 0.004, 0.001, 0.0].map(|mse| rule.order(mse, 0.06)).to_vec();
        assert!(orders.is_sorted() && orders[0] == 6 && orders[5] == 16, "{orders:?}");
    }

    #[test]
    fn an_initial_image_already_within_epsilon_gives_the_highest_order() {
        let rule = OrderRule::default();
        assert_eq!((rule.order(0.5, 0.0005), rule.order(0.5, 0.001)), (16, 16));
    }

    #[test]
    fn a_fixed_order_never_changes() {
        let rule = OrderRule::fixed(7).expect("valid");
        assert!([0.0, 1e-3, 0.1, 10.0].iter().all(|mse| rule.order(*mse, 0.2) == 7));
    }

    #[test]
    fn bounds_out_of_order_are_refused() {
        assert_eq!(OrderRule::new(8, 4, 1e-3), Err(OrderError::Bounds { min: 8, max: 4 }));
        assert!(OrderRule::new(0, 4, 1e-3).is_err() && OrderRule::fixed(41).is_err());
        assert!(OrderRule::new(4, 8, 0.0).is_err() && OrderRule::new(4, 8, f64::NAN).is_err());
    }
}
