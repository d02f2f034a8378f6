//! What no rig of two cameras side by side has.

use glam::{DMat3, DVec3};

use super::{GivenRectification, LARGEST_BASELINE_M, StereoCalibration};
use crate::error::{Error, Result};
use crate::geometry::Intrinsics;

/// Rotations in files are rounded: their columns may differ from unit vectors at right angles by
/// this.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Cameras nearer to each other than this are none that measure, metres.
const LEAST_BASELINE_M: f64 = 0.005;

/// Cosine of the largest angle between the optical axes, 45 degrees.
const LEAST_AXES_COSINE: f64 = 0.707;

/// Where a calibration does not say of which size its images were, the principal point of both
/// cameras lies in this part of the image's width: another part means images of another size.
const CENTER_PART: [f64; 2] = [0.3, 0.7];

/// Rectifying rotations and projections of a file may disagree with its cameras by this part.
const AGREEMENT: f64 = 0.01;

impl StereoCalibration {
    pub(super) fn check_baseline(&self, largest_m: f64) -> Result<()> {
        let baseline_m = self.baseline_m();
        let refused = |problem: &str| {
            Err(Error::value(
                format!("baseline of {baseline_m} m"),
                problem,
                "give metres; where the calibration is in millimetres or squares of its board, give \
                 the measured distance between the cameras with --calib-baseline",
            ))
        };
        if !baseline_m.is_finite() {
            return refused("is not a finite number");
        }
        if baseline_m == 0.0 {
            return refused("the cameras stand in one place and can measure nothing");
        }
        if baseline_m < LEAST_BASELINE_M {
            return refused("is too small to measure with");
        }
        if baseline_m > largest_m {
            return refused("is too large: are these millimetres?");
        }
        Ok(())
    }

    /// The right camera must stand to the right and look the same way.
    pub(super) fn check_places(&self) -> Result<()> {
        let place = self.right_camera_m();
        let [x, y, z] = place.to_array();
        if !place.is_finite() {
            return Err(Error::value(
                format!(
                    "T = {} {} {}",
                    self.translation_m.x, self.translation_m.y, self.translation_m.z
                ),
                "is not finite",
                "calibrate again",
            ));
        }
        if place.length() == 0.0 {
            return self.check_baseline(LARGEST_BASELINE_M);
        }
        if y.abs() > x.abs() && y.abs() >= z.abs() {
            return Err(Error::value(
                format!(
                    "T = {} {} {}",
                    self.translation_m.x, self.translation_m.y, self.translation_m.z
                ),
                "the cameras stand one above the other",
                "turn images and calibration by 90 degrees, or use cameras side by side",
            ));
        }
        if z.abs() > x.abs() {
            return Err(Error::value(
                format!(
                    "T = {} {} {}",
                    self.translation_m.x, self.translation_m.y, self.translation_m.z
                ),
                "the cameras stand one behind the other",
                "give cameras that stand side by side",
            ));
        }
        if x < 0.0 {
            return Err(Error::value(
                format!("baseline of {x} m"),
                "the right camera stands to the left of the left one: the two cameras are swapped",
                "swap them in the calibration, or the images, so that both agree; T maps points from \
                 the left camera's axes to the right one's",
            ));
        }
        // The right camera's optical axis in the left one's axes.
        let axis = self.rotation.transpose() * DVec3::Z;
        if axis.z < LEAST_AXES_COSINE {
            return Err(Error::value(
                "R",
                "the cameras look in directions more than 45 degrees apart",
                "check that R and T map points from the left camera's axes to the right one's",
            ));
        }
        self.check_given()
    }

    /// Rectification that the file gives must fit its cameras.
    fn check_given(&self) -> Result<()> {
        let Some(given) = &self.given else {
            return Ok(());
        };
        let contradiction = |problem: &str| {
            Err(Error::value(
                "R1, R2, P1 and P2",
                problem,
                "give all of one calibration, or leave them out",
            ))
        };
        let baseline_m = self.baseline_m();
        let off_m =
            given.rotations[0] * self.right_camera_m() - DVec3::new(given.baseline_m, 0.0, 0.0);
        if off_m.length() > AGREEMENT * baseline_m {
            return contradiction("do not bring the cameras of R and T beside each other");
        }
        let turned = given.rotations[1] * self.rotation - given.rotations[0];
        if turned.to_cols_array().iter().any(|v| v.abs() > AGREEMENT) {
            return contradiction("do not turn the cameras of R into the same direction");
        }
        let [left, right] = &given.intrinsics;
        let off_px = (left.focal_y_px - right.focal_y_px)
            .abs()
            .max((left.center_y_px - right.center_y_px).abs());
        if off_px > 0.5 {
            return contradiction("put the same row of both images at different heights");
        }
        Ok(())
    }
}

pub(super) fn check_intrinsics(
    side: &str,
    camera: &Intrinsics,
    size: Option<[u32; 2]>,
) -> Result<()> {
    let (fx, fy) = (camera.focal_x_px, camera.focal_y_px);
    let (cx, cy) = (camera.center_x_px, camera.center_y_px);
    let refused = |what: String, problem: &str, remedy: &str| {
        Err(Error::value(
            format!("{what} of the {side}"),
            problem,
            remedy,
        ))
    };
    if ![fx, fy, cx, cy].iter().all(|value| value.is_finite()) {
        let matrix = format!("matrix with {fx} {fy} {cx} {cy}");
        return refused(matrix, "has numbers that are not finite", "calibrate again");
    }
    if fx <= 0.0 || fy <= 0.0 {
        return refused(
            format!("focal length {fx} x {fy} px"),
            "must be a positive number",
            "give the calibrated camera matrix in pixels",
        );
    }
    if !(0.2..=5.0).contains(&(fx / fy)) {
        return refused(
            format!("focal length {fx} x {fy} px"),
            "no camera's pixels are that far from square",
            "give the calibrated camera matrix in pixels",
        );
    }
    let Some([width, height]) = size else {
        return Ok(());
    };
    if width < 2 || height < 2 || width > 32_768 || height > 32_768 {
        return refused(
            format!("image size {width}x{height}"),
            "is no usable size",
            "give width and height between 2 and 32768 pixels",
        );
    }
    let inside = (0.0..=f64::from(width)).contains(&cx) && (0.0..=f64::from(height)).contains(&cy);
    if !inside {
        return refused(
            format!("principal point {cx} {cy}"),
            &format!("lies outside the image of {width}x{height} pixels"),
            "check that matrix and image size belong together",
        );
    }
    if fx < 0.1 * f64::from(width) || fx > 100.0 * f64::from(width) {
        return refused(
            format!("focal length {fx} px"),
            &format!("no lens has that over {width} pixels"),
            "give the focal length in pixels, not in millimetres",
        );
    }
    Ok(())
}

/// Whether the principal point belongs to images of this size.
pub(super) fn check_center(
    side: &str,
    camera: &Intrinsics,
    [width, height]: [u32; 2],
) -> Result<()> {
    check_intrinsics(side, camera, Some([width, height]))?;
    let part = camera.center_x_px / f64::from(width);
    if (CENTER_PART[0]..=CENTER_PART[1]).contains(&part) {
        return Ok(());
    }
    Err(Error::value(
        format!("images of {width}x{height} pixels"),
        format!(
            "the {side}'s principal point {:.1} is far from their middle: the calibration seems to \
             be of images about {:.0} pixels wide",
            camera.center_x_px,
            2.0 * camera.center_x_px
        ),
        "give the images that were calibrated; where these are a part of them, write the \
         calibration as TOML, which states its width and height",
    ))
}

pub(super) fn orthonormal_given(mut given: GivenRectification) -> Result<GivenRectification> {
    let [left, right] = given.rotations;
    given.rotations = [orthonormal("R1", left)?, orthonormal("R2", right)?];
    Ok(given)
}

/// The rotation that a rounded matrix stands for.
pub(super) fn orthonormal(name: &str, matrix: DMat3) -> Result<DMat3> {
    let refused = |problem: &str| {
        Err(Error::value(
            format!("rotation {name}"),
            problem,
            "give the calibrated rotation: rows and columns of length 1 at right angles",
        ))
    };
    if !matrix.is_finite() {
        return refused("has numbers that are not finite");
    }
    if matrix == DMat3::IDENTITY {
        return Ok(matrix);
    }
    let off = matrix.transpose() * matrix - DMat3::IDENTITY;
    if off
        .to_cols_array()
        .iter()
        .any(|v| v.abs() > ROTATION_TOLERANCE)
    {
        return refused("is no rotation");
    }
    if matrix.determinant() < 0.0 {
        return refused("is a reflection");
    }
    let x = matrix.x_axis.normalize();
    let y = (matrix.y_axis - x * x.dot(matrix.y_axis)).normalize();
    Ok(DMat3::from_cols(x, y, x.cross(y)))
}
