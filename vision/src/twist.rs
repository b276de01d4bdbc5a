//! The camera's velocity in its own optical frame: x right, y down, z forward; metres and radians per second.

/// A camera twist, camera frame: 3 x m/s, then 3 x rad/s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Translation rate `[x, y, z]`, m/s.
    pub linear_m_per_s: [f64; 3],
    /// Rotation rate `[x, y, z]`, rad/s.
    pub angular_rad_per_s: [f64; 3],
}

impl Twist {
    /// Standing still.
    pub const ZERO: Twist = Twist { linear_m_per_s: [0.0; 3], angular_rad_per_s: [0.0; 3] };

    /// From `[v_x, v_y, v_z, ω_x, ω_y, ω_z]`.
    pub fn from_array([vx, vy, vz, wx, wy, wz]: [f64; 6]) -> Twist {
        Twist { linear_m_per_s: [vx, vy, vz], angular_rad_per_s: [wx, wy, wz] }
    }

    /// As `[v_x, v_y, v_z, ω_x, ω_y, ω_z]`.
    pub fn to_array(self) -> [f64; 6] {
        let ([vx, vy, vz], [wx, wy, wz]) = (self.linear_m_per_s, self.angular_rad_per_s);
        [vx, vy, vz, wx, wy, wz]
    }

    /// Speed, m/s.
    pub fn linear_norm(&self) -> f64 {
        norm(self.linear_m_per_s)
    }

    /// Turning speed, rad/s.
    pub fn angular_norm(&self) -> f64 {
        norm(self.angular_rad_per_s)
    }

    /// All six components times `factor`.
    pub fn scaled(self, factor: f64) -> Twist {
        Twist::from_array(self.to_array().map(|component| factor * component))
    }

    /// Whether all six components are numbers.
    pub fn is_finite(&self) -> bool {
        self.to_array().iter().all(|component| component.is_finite())
    }
}

/// Euclidean length, without the overflow of a plain sum of squares.
fn norm([x, y, z]: [f64; 3]) -> f64 {
    x.hypot(y).hypot(z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_twist_and_its_array_are_the_same_six_numbers() {
        let six = [1.0, 2.0, 2.0, 0.0, -3.0, 4.0];
        let twist = Twist::from_array(six);
        assert_eq!((twist.to_array(), twist.linear_norm(), twist.angular_norm()), (six, 3.0, 5.0));
        assert_eq!(twist.scaled(0.0).scaled(1.0).linear_norm(), 0.0);
        assert!(!twist.scaled(f64::NAN).is_finite());
    }
}
