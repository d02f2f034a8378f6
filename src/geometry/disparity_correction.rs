//! A correction of measured disparities: the part of a rig's error that its calibration left.
//!
//! Two rectified cameras that are turned a little against each other, or whose focal lengths differ a
//! little, see every point at another disparity than its depth says. The error is a smooth function
//! of the place in the image, the same at every depth:
//!
//! ```text
//! measured disparity = focal * baseline / z + delta(x, y)
//! delta(x, y) = constant + x_term x + y_term y + xx_term x² + xy_term x y
//! ```
//!
//! with `x`, `y` the direction of the left camera's pixel, counted from its principal point in focal
//! lengths. A rotation of the right camera by small angles gives exactly this form: roll the term
//! of y, yaw those of 1 and x², pitch that of x y; unequal focal lengths give that of x.

use serde::{Deserialize, Serialize};

use super::Camera;
use crate::error::{Error, Result};

/// A larger error is no remainder of a calibration, radians: 36 pixels of a camera with a field of
/// view of 90 degrees that is 1440 pixels wide.
const LARGEST: f64 = 0.05;

/// The coefficients of a correction, in pixels of images of a certain focal length; as a calibration
/// file holds them in its table `disparity_correction`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DisparityTerms {
    /// The left camera's focal length, pixels, of the images whose pixels the other numbers are.
    pub focal_px: f64,
    /// What disparities are too large by at the principal point.
    pub constant_px: f64,
    /// Standard deviation of the constant: how well it is known.
    pub constant_std_px: f64,
    /// Change over one focal length to the right.
    #[serde(default)]
    pub x_px: f64,
    /// Change over one focal length down.
    #[serde(default)]
    pub y_px: f64,
    /// Times x².
    #[serde(default)]
    pub xx_px: f64,
    /// Times x y.
    #[serde(default)]
    pub xy_px: f64,
    /// Standard deviation of what the terms other than the constant sum up to, root mean square over
    /// the image.
    #[serde(default)]
    pub shape_std_px: f64,
}

impl DisparityTerms {
    /// Refuses what no rig has.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that are not finite, a focal length that is not above 0, standard
    /// deviations below 0, and terms of more than 3 degrees.
    pub fn check(&self) -> Result<()> {
        let refuse = |name: &str, value: f64, problem: &str, remedy: &str| {
            Err(Error::value(
                format!("disparity_correction: {name} = {value}"),
                problem,
                remedy,
            ))
        };
        if !(self.focal_px.is_finite() && self.focal_px > 0.0) {
            return refuse(
                "focal_px",
                self.focal_px,
                "is no focal length",
                "give that of the left camera, pixels",
            );
        }
        for (name, value) in [
            ("constant_std_px", self.constant_std_px),
            ("shape_std_px", self.shape_std_px),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return refuse(
                    name,
                    value,
                    "is no standard deviation",
                    "give pixels, 0 or above",
                );
            }
        }
        for (name, value) in [
            ("constant_px", self.constant_px),
            ("x_px", self.x_px),
            ("y_px", self.y_px),
            ("xx_px", self.xx_px),
            ("xy_px", self.xy_px),
        ] {
            // Not a number is not below the limit either.
            if !((value / self.focal_px).abs() <= LARGEST) {
                return refuse(
                    name,
                    value,
                    "is no small error of a calibrated rig",
                    "calibrate the cameras anew, or write the table with `twinsight calibrate`",
                );
            }
        }
        Ok(())
    }

    /// The same correction in pixels of images of another focal length: of resized images, or of
    /// those that a rectification with other borders gives.
    #[must_use]
    pub fn for_focal(&self, focal_px: f64) -> Self {
        let scale = focal_px / self.focal_px;
        Self {
            focal_px,
            constant_px: scale * self.constant_px,
            constant_std_px: scale * self.constant_std_px,
            x_px: scale * self.x_px,
            y_px: scale * self.y_px,
            xx_px: scale * self.xx_px,
            xy_px: scale * self.xy_px,
            shape_std_px: scale * self.shape_std_px,
        }
    }
}

/// A correction made ready for the images of one rectified left camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisparityCorrection {
    camera: Camera,
    terms: DisparityTerms,
}

impl DisparityCorrection {
    /// The correction for pixels of this rectified left camera, whatever the size of the images that
    /// it was measured in.
    ///
    /// # Errors
    /// As [`DisparityTerms::check`].
    pub fn new(terms: DisparityTerms, camera: Camera) -> Result<Self> {
        terms.check()?;
        Ok(Self {
            camera,
            terms: terms.for_focal(camera.focal_x_px),
        })
    }

    /// What the measured disparity of a pixel of the left image is too large by, pixels: subtract it,
    /// or expect `focal * baseline / z + delta`.
    pub fn delta_px(&self, pixel: [f64; 2]) -> f64 {
        let [x, y, _] = self.camera.camera_from_pixel(pixel);
        let terms = &self.terms;
        terms.constant_px + x * (terms.x_px + terms.xx_px * x + terms.xy_px * y) + terms.y_px * y
    }

    /// How well that is known: its standard deviation, pixels.
    pub fn std_px(&self) -> f64 {
        self.terms.constant_std_px.hypot(self.terms.shape_std_px)
    }

    /// Its coefficients, in pixels of the camera's images.
    pub fn terms(&self) -> &DisparityTerms {
        &self.terms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TERMS: DisparityTerms = DisparityTerms {
        focal_px: 720.0,
        constant_px: -0.5,
        constant_std_px: 0.3,
        x_px: 0.1,
        y_px: -0.2,
        xx_px: -1.6,
        xy_px: 0.4,
        shape_std_px: 0.4,
    };

    fn camera(scale: f64) -> Camera {
        Camera {
            width: (1440.0 * scale) as u32,
            height: (400.0 * scale) as u32,
            focal_x_px: 720.0 * scale,
            focal_y_px: 700.0 * scale,
            center_x_px: 710.0 * scale,
            center_y_px: 180.0 * scale,
        }
    }

    #[test]
    fn a_correction_is_the_polynomial_of_the_pixels_direction() {
        let correction = DisparityCorrection::new(TERMS, camera(1.0)).unwrap();
        assert_eq!(correction.delta_px([710.0, 180.0]), -0.5);
        // One focal length to the left, a fifth of one down.
        let expected = -0.5 - 0.1 - 0.2 * 0.2 - 1.6 - 0.4 * 0.2;
        assert!((correction.delta_px([-10.0, 320.0]) - expected).abs() < 1e-12);
        assert!((correction.std_px() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn resized_images_have_the_same_correction_in_their_own_pixels() {
        let whole = DisparityCorrection::new(TERMS, camera(1.0)).unwrap();
        let half = DisparityCorrection::new(TERMS, camera(0.5)).unwrap();
        for pixel in [[0.0, 0.0], [300.0, 390.0], [1440.0, 20.0]] {
            let halved = half.delta_px(pixel.map(|v| v / 2.0));
            assert!((halved - whole.delta_px(pixel) / 2.0).abs() < 1e-12);
        }
        assert!((half.std_px() - whole.std_px() / 2.0).abs() < 1e-12);
        assert_eq!(half.terms().focal_px, 360.0);
    }

    #[test]
    fn corrections_that_no_rig_has_are_refused_with_the_term_named() {
        type Change = fn(&mut DisparityTerms);
        let cases: [(Change, &str); 5] = [
            (|t| t.focal_px = 0.0, "focal_px = 0"),
            (|t| t.constant_px = f64::NAN, "constant_px = NaN"),
            (|t| t.xx_px = 200.0, "xx_px = 200"),
            (|t| t.constant_std_px = -1.0, "constant_std_px = -1"),
            (|t| t.shape_std_px = f64::INFINITY, "shape_std_px = inf"),
        ];
        for (change, words) in cases {
            let mut terms = TERMS;
            change(&mut terms);
            let refusal = DisparityCorrection::new(terms, camera(1.0)).unwrap_err();
            assert!(refusal.to_string().contains(words), "{refusal}");
        }
    }
}
