//! What a lens does to the straight lines of a pinhole camera.
//!
//! OpenCV's model: with `r2 = x^2 + y^2` of an undistorted direction `(x, y, 1)`,
//!
//! ```text
//! radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
//! x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2)
//! y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y
//! ```
//!
//! and `pixel = focal (x', y') + center`. Source: OpenCV's documentation of `calib3d`, "Detailed
//! Description".

use crate::error::{Error, Result};

/// Steps of Newton's method: a lens that people use takes five.
const STEPS: usize = 40;

/// Largest error of an undistorted direction, distorted again: a billionth of a pixel.
const TOLERANCE: f64 = 1e-12;

/// Directions are looked at up to this tangent of the angle to the axis, 84 degrees.
const WIDEST: f64 = 10.0;

/// Steps in which the widest valid direction is looked for.
const WIDTH_STEPS: u32 = 4096;

/// Coefficients of a lens, OpenCV's model.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Distortion {
    /// Radial: `k1` to `k6`.
    pub radial: [f64; 6],
    /// Tangential: `p1` and `p2`.
    pub tangential: [f64; 2],
}

impl Distortion {
    /// A lens without distortion.
    pub const NONE: Self = Self {
        radial: [0.0; 6],
        tangential: [0.0; 2],
    };

    /// From coefficients in OpenCV's order, `k1 k2 p1 p2 [k3 [k4 k5 k6]]`: none, 4, 5 or 8 of them;
    /// also 12 or 14 of which those after the eighth are zero.
    ///
    /// # Errors
    /// Another number of coefficients, the thin prism and tilt that coefficients 9 to 14 describe,
    /// or one that is not finite.
    pub fn from_coefficients(coefficients: &[f64]) -> Result<Self> {
        if let Some(value) = coefficients.iter().find(|value| !value.is_finite()) {
            return Err(Error::value(
                format!("distortion coefficient {value}"),
                "is not a finite number",
                "calibrate again",
            ));
        }
        let count = coefficients.len();
        let refused = |problem: String| {
            Err(Error::value(
                format!("distortion with {count} coefficients"),
                problem,
                "calibrate with 4, 5 or 8 coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6]]",
            ))
        };
        match count {
            0 | 4 | 5 | 8 => {}
            12 | 14 if coefficients[8..].iter().all(|value| *value == 0.0) => {}
            12 | 14 => return refused("the thin prism or tilted sensor is not known".to_owned()),
            _ => return refused("is none of the models that are known".to_owned()),
        }
        let at = |i: usize| coefficients.get(i).copied().unwrap_or(0.0);
        Ok(Self {
            radial: [at(0), at(1), at(4), at(5), at(6), at(7)],
            tangential: [at(2), at(3)],
        })
    }

    /// The eight coefficients in OpenCV's order.
    pub fn coefficients(&self) -> [f64; 8] {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [p1, p2] = self.tangential;
        [k1, k2, p1, p2, k3, k4, k5, k6]
    }

    /// Whether straight lines stay straight.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Numerator and denominator of the radial factor, and their derivatives by `r2`.
    fn radial(&self, r2: f64) -> [f64; 4] {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        [
            1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)),
            1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)),
            k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3),
            k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6),
        ]
    }

    /// Where the lens puts the direction `(x, y, 1)`, at focal length 1.
    pub fn distorted(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let [over, under, ..] = self.radial(r2);
        let factor = over / under;
        let [p1, p2] = self.tangential;
        [
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// The direction `(x, y, 1)` that the lens puts there: the inverse of
    /// [`Distortion::distorted`]. None where the model shows no direction up to
    /// [`Distortion::widest`] there.
    pub fn undistorted(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        self.undistorted_within(point, self.widest())
    }

    /// [`Distortion::undistorted`], given [`Distortion::widest`].
    pub(crate) fn undistorted_within(&self, point: [f64; 2], widest: f64) -> Option<[f64; 2]> {
        if self.is_none() {
            return Some(point);
        }
        let shrunk = |[x, y]: [f64; 2]| {
            let r = (x * x + y * y).sqrt();
            let scale = if r > widest { widest / r } else { 1.0 };
            [x * scale, y * scale]
        };
        let mut guess = shrunk(point);
        for _ in 0..STEPS {
            let [x, y] = guess;
            let found = self.distorted(guess);
            let error = [found[0] - point[0], found[1] - point[1]];
            if error[0].abs().max(error[1].abs()) < TOLERANCE {
                return Some(guess);
            }
            let r2 = x * x + y * y;
            let [over, under, over_slope, under_slope] = self.radial(r2);
            let factor = over / under;
            let slope = (over_slope - factor * under_slope) / under;
            let [p1, p2] = self.tangential;
            let xx = factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
            let xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
            let yy = factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
            let determinant = xx * yy - xy * xy;
            if !(determinant.is_finite() && determinant.abs() > f64::EPSILON) {
                return None;
            }
            guess = shrunk([
                x - (yy * error[0] - xy * error[1]) / determinant,
                y - (xx * error[1] - xy * error[0]) / determinant,
            ]);
        }
        None
    }

    /// The widest direction that the model describes, as the tangent of its angle to the axis.
    ///
    /// Polynomials that were fitted to the image turn round beyond it: wider directions land where
    /// narrower ones already are, and show ghosts.
    pub fn widest(&self) -> f64 {
        for step in 1..=WIDTH_STEPS {
            let r = WIDEST * f64::from(step) / f64::from(WIDTH_STEPS);
            let r2 = r * r;
            let [over, under, over_slope, under_slope] = self.radial(r2);
            // The derivative of r * over / under by r, times under squared.
            let growth = over * under + 2.0 * r2 * (over_slope * under - over * under_slope);
            if !(under > 0.0 && growth > 0.0) {
                return WIDEST * f64::from(step - 1) / f64::from(WIDTH_STEPS);
            }
        }
        WIDEST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hand_computed_values_of_each_term() {
        // At (0.5, 0.25): r2 = 0.3125, r2^2 = 0.09765625, r2^3 = 0.030517578125.
        let at = |coefficients: &[f64]| {
            Distortion::from_coefficients(coefficients)
                .unwrap()
                .distorted([0.5, 0.25])
        };
        for (coefficients, expected) in [
            (&[0.0; 4][..], [0.5, 0.25]),
            (&[0.1, 0.0, 0.0, 0.0], [0.515_625, 0.257_812_5]),
            (&[0.0, 0.1, 0.0, 0.0], [0.504_882_812_5, 0.252_441_406_25]),
            // 2 p1 x y = 0.025, p1 (r2 + 2 y^2) = 0.04375.
            (&[0.0, 0.0, 0.1, 0.0], [0.525, 0.29375]),
            // p2 (r2 + 2 x^2) = 0.08125, 2 p2 x y = 0.025.
            (&[0.0, 0.0, 0.0, 0.1], [0.58125, 0.275]),
            (
                &[0.0, 0.0, 0.0, 0.0, 0.1],
                [0.501_525_878_906_25, 0.250_762_939_453_125],
            ),
            // 1 / 1.03125, 1 / 1.009765625, 1 / 1.0030517578125.
            (
                &[0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0],
                [0.484_848_484_848_484_8, 0.242_424_242_424_242_4],
            ),
            (
                &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0],
                [0.495_164_410_058_027_1, 0.247_582_205_029_013_54],
            ),
            (
                &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1],
                [0.498_478_763_539_004_5, 0.249_239_381_769_502_25],
            ),
        ] {
            let found = at(coefficients);
            for axis in 0..2 {
                assert!(
                    (found[axis] - expected[axis]).abs() < 1e-12,
                    "{coefficients:?}: {found:?}"
                );
            }
        }
    }

    #[test]
    fn undistorting_inverts_distorting_over_the_whole_image() {
        for coefficients in [
            &[-0.28, 0.08, 0.001, -0.0005][..],
            &[-0.35, 0.15, -0.0015, 0.0008, -0.03],
            &[0.11, -0.05, 0.002, 0.001, 0.01],
            &[0.9, 0.3, 0.0002, -0.0001, 0.02, 1.25, 0.52, 0.06],
        ] {
            let lens = Distortion::from_coefficients(coefficients).unwrap();
            for i in -10..=10 {
                for j in -6..=6 {
                    let point = [f64::from(i) * 0.08, f64::from(j) * 0.08];
                    let back = lens.undistorted(lens.distorted(point)).unwrap();
                    for axis in 0..2 {
                        assert!((back[axis] - point[axis]).abs() < 1e-9, "{coefficients:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_model_that_turns_round_is_not_followed_beyond_that() {
        // r (1 - 0.5 r^2) grows up to r = sqrt(2 / 3), where it is 0.544.
        let lens = Distortion::from_coefficients(&[-0.5, 0.0, 0.0, 0.0]).unwrap();
        assert!((lens.widest() - (2.0_f64 / 3.0).sqrt()).abs() < 0.01);
        assert_eq!(lens.undistorted([0.6, 0.0]), None);
        let [x, y] = lens.undistorted([0.4375, 0.0]).unwrap();
        assert!((x - 0.5).abs() < 1e-9 && y == 0.0);
        assert_eq!(Distortion::NONE.widest(), WIDEST);
    }

    #[test]
    fn other_models_are_refused_naming_those_that_are_known() {
        let mut prism = [0.0; 14];
        assert_eq!(
            Distortion::from_coefficients(&prism).unwrap(),
            Distortion::NONE
        );
        prism[9] = 0.001;
        for (coefficients, word) in [
            (&prism[..], "14 coefficients"),
            (&prism[..12], "thin prism"),
            (&[0.1; 6], "6 coefficients"),
            (&[0.1, f64::NAN, 0.0, 0.0], "NaN"),
        ] {
            let message = Distortion::from_coefficients(coefficients)
                .unwrap_err()
                .to_string();
            assert!(message.contains(word), "{message}");
        }
        let message = Distortion::from_coefficients(&[0.1; 9]).unwrap_err();
        assert!(message.to_string().contains("4, 5 or 8"));
    }
}
