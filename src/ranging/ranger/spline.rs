//! A natural cubic spline through values at whole numbers.

/// Interpolates values given at 0, 1, 2 and so on with continuous first and second derivatives.
#[derive(Debug, Clone)]
pub(super) struct Spline {
    values: Vec<f64>,
    /// Second derivatives at the whole numbers.
    bends: Vec<f64>,
}

impl Spline {
    /// None for fewer than two values.
    pub fn new(values: &[f64]) -> Option<Self> {
        let count = values.len();
        if count < 2 {
            return None;
        }
        // Thomas's algorithm for `bend[i-1] + 4 bend[i] + bend[i+1] = 6 (second difference)`.
        let mut bends = vec![0.0; count];
        let mut factor = vec![0.0; count];
        for i in 1..count - 1 {
            let second = values[i - 1] - 2.0 * values[i] + values[i + 1];
            let pivot = 4.0 - factor[i - 1];
            factor[i] = 1.0 / pivot;
            bends[i] = (6.0 * second - bends[i - 1]) / pivot;
        }
        for i in (1..count - 1).rev() {
            bends[i] -= factor[i] * bends[i + 1];
        }
        Some(Self {
            values: values.to_vec(),
            bends,
        })
    }

    /// The value at a place between the first and the last whole number; beyond, the cubic of the
    /// outermost piece.
    pub fn at(&self, place: f64) -> f64 {
        let i = (place.max(0.0) as usize).min(self.values.len() - 2);
        let b = place - i as f64;
        let a = 1.0 - b;
        let bent = (a * a * a - a) * self.bends[i] + (b * b * b - b) * self.bends[i + 1];
        a * self.values[i] + b * self.values[i + 1] + bent / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_passes_through_its_values_and_follows_a_smooth_curve_between_them() {
        let curve = |x: f64| libm::sin(0.7 * x) + 0.1 * x;
        let values: Vec<f64> = (0..20).map(|i| curve(f64::from(i))).collect();
        let spline = Spline::new(&values).unwrap();
        for (i, value) in values.iter().enumerate() {
            assert!((spline.at(i as f64) - value).abs() < 1e-12);
        }
        for i in 20..170 {
            let x = 0.1 * f64::from(i);
            assert!((spline.at(x) - curve(x)).abs() < 0.01, "at {x}");
        }
        assert!(Spline::new(&[1.0]).is_none());
        assert_eq!(Spline::new(&[1.0, 3.0]).unwrap().at(0.5), 2.0);
    }
}
