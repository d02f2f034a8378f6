//! Two real cameras as a calibration describes them: lenses, and how they stand to each other.

use glam::{DMat3, DVec3};

use super::camera::scale_to;
use super::{Camera, Distortion, Intrinsics, RigSettings, StereoRig};
use crate::error::{Error, Result};

/// Rotations in files are rounded: their columns may differ from unit vectors at right angles by
/// this.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Cameras nearer to each other than this are none that measure, metres.
const LEAST_BASELINE_M: f64 = 0.005;

/// A larger number without further word is in another unit, metres.
const LARGEST_BASELINE_M: f64 = 5.0;

/// A baseline that the user gives may be as large as this, metres.
const LARGEST_GIVEN_BASELINE_M: f64 = 1000.0;

/// Cosine of the largest angle between the optical axes, 45 degrees.
const LEAST_AXES_COSINE: f64 = 0.707;

/// Where a calibration does not say of which size its images were, the principal point of both
/// cameras lies in this part of the image's width: another part means images of another size.
const CENTER_PART: [f64; 2] = [0.3, 0.7];

/// Rectifying rotations and projections of a file may disagree with its cameras by this part.
const AGREEMENT: f64 = 0.01;

/// One camera before rectification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensCamera {
    /// Focal lengths and principal point, pixels; the first pixel's centre is at (0.5, 0.5).
    pub intrinsics: Intrinsics,
    /// Its lens.
    pub distortion: Distortion,
}

/// Rotations and cameras that a calibration file gives for its rectified images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GivenRectification {
    /// Size of the rectified images, pixels; that of the unrectified ones where it is not said.
    pub size: Option<[u32; 2]>,
    /// From each camera's axes to those of the rectified cameras (OpenCV's `R1` and `R2`).
    pub rotations: [DMat3; 2],
    /// The rectified cameras (OpenCV's `P1` and `P2`).
    pub intrinsics: [Intrinsics; 2],
    /// Their distance from each other, metres.
    pub baseline_m: f64,
}

/// What a file or program says of two cameras, unchecked; left camera first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationParts {
    /// Size of the unrectified images, where it is known; pixels.
    pub size: Option<[u32; 2]>,
    /// The cameras.
    pub cameras: [LensCamera; 2],
    /// Takes directions from the left camera's axes to the right one's (OpenCV's `R`).
    pub rotation: DMat3,
    /// The left camera's place in the right one's axes, metres (OpenCV's `T`): a point at `p` in the
    /// left camera's axes is at `rotation * p + translation_m` in the right one's.
    pub translation_m: DVec3,
    /// What is said of rectified images.
    pub given: Option<GivenRectification>,
}

impl CalibrationParts {
    /// Those of images that are rectified already.
    pub fn rectified(size: Option<[u32; 2]>, intrinsics: [Intrinsics; 2], baseline_m: f64) -> Self {
        Self {
            size,
            cameras: intrinsics.map(|intrinsics| LensCamera {
                intrinsics,
                distortion: Distortion::NONE,
            }),
            rotation: DMat3::IDENTITY,
            translation_m: DVec3::new(-baseline_m, 0.0, 0.0),
            given: None,
        }
    }
}

/// A calibrated stereo rig, checked: left camera first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoCalibration {
    size: Option<[u32; 2]>,
    cameras: [LensCamera; 2],
    rotation: DMat3,
    translation_m: DVec3,
    given: Option<GivenRectification>,
}

impl StereoCalibration {
    /// Checks what a file or program says of two cameras.
    ///
    /// With `baseline_m` their distance is this, whatever the parts say: for calibrations that are
    /// not in metres.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that no rig of two cameras side by side has, with the reason.
    pub fn new(parts: CalibrationParts, baseline_m: Option<f64>) -> Result<Self> {
        let CalibrationParts {
            size,
            cameras,
            rotation,
            translation_m,
            given,
        } = parts;
        for (side, camera) in SIDES.iter().zip(&cameras) {
            check_intrinsics(side, &camera.intrinsics, size)?;
        }
        if let Some(given) = &given {
            for (side, intrinsics) in SIDES.iter().zip(&given.intrinsics) {
                let side = format!("rectified {side}");
                check_intrinsics(&side, intrinsics, given.size.or(size))?;
            }
        }
        let mut calibration = Self {
            size,
            cameras,
            rotation: orthonormal("R", rotation)?,
            translation_m,
            given: given.map(orthonormal_given).transpose()?,
        };
        calibration.check_places()?;
        let Some(baseline_m) = baseline_m else {
            calibration.check_baseline(LARGEST_BASELINE_M)?;
            return Ok(calibration);
        };
        let scale = baseline_m / translation_m.length();
        calibration.translation_m *= scale;
        if let Some(given) = &mut calibration.given {
            given.baseline_m *= scale;
        }
        calibration.check_baseline(LARGEST_GIVEN_BASELINE_M)?;
        // A negative one has turned the cameras round.
        calibration.check_places()?;
        Ok(calibration)
    }

    /// The calibration of images that are rectified already.
    ///
    /// # Errors
    /// As [`StereoCalibration::new`].
    pub fn rectified(
        size: Option<[u32; 2]>,
        intrinsics: [Intrinsics; 2],
        baseline_m: f64,
    ) -> Result<Self> {
        Self::new(
            CalibrationParts::rectified(size, intrinsics, baseline_m),
            None,
        )
    }

    /// Size of the unrectified images, where the calibration says it; pixels.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.size
    }

    /// Both cameras, left first.
    pub fn cameras(&self) -> &[LensCamera; 2] {
        &self.cameras
    }

    /// Takes directions from the left camera's axes to the right one's.
    pub fn right_from_left(&self) -> DMat3 {
        self.rotation
    }

    /// The left camera's place in the right one's axes, metres.
    pub fn translation_m(&self) -> DVec3 {
        self.translation_m
    }

    /// The right camera's place in the left one's axes, metres.
    pub fn right_camera_m(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation_m)
    }

    /// Distance between the cameras, metres.
    pub fn baseline_m(&self) -> f64 {
        self.translation_m.length()
    }

    /// What the file says of its rectified images.
    pub fn given(&self) -> Option<&GivenRectification> {
        self.given.as_ref()
    }

    /// Whether images come out of the cameras rectified: no distortion, parallel axes, the right
    /// camera straight to the right.
    pub fn is_rectified(&self) -> bool {
        let [_, y, z] = self.translation_m.to_array();
        self.rotation == DMat3::IDENTITY
            && y == 0.0
            && z == 0.0
            && self
                .cameras
                .iter()
                .all(|camera| camera.distortion.is_none())
    }

    /// The calibration for images of another size of the same view: focal lengths and principal
    /// points grow with the image, lenses and places stay.
    ///
    /// # Errors
    /// A size of another shape: such images show another part of the view, and nobody knows which.
    /// Where the calibration does not say its size, a principal point that does not belong to images
    /// of this one.
    pub fn for_size(mut self, size: [u32; 2]) -> Result<Self> {
        let [width, height] = size;
        let Some(own) = self.size else {
            for (side, camera) in SIDES.iter().zip(&self.cameras) {
                check_center(side, &camera.intrinsics, size)?;
            }
            self.size = Some(size);
            return Ok(self);
        };
        if own == size {
            return Ok(self);
        }
        let scale = scale_to(own, size).ok_or_else(|| {
            Error::value(
                format!("images of {width}x{height} pixels"),
                format!("the calibration is of images of {}x{}", own[0], own[1]),
                "give images as the calibrated cameras took them, or the same enlarged or shrunk \
                 without cutting",
            )
        })?;
        for camera in &mut self.cameras {
            camera.intrinsics = camera.intrinsics.scaled(scale);
        }
        self.size = Some(size);
        if let Some(given) = &mut self.given {
            given.intrinsics = given.intrinsics.map(|intrinsics| intrinsics.scaled(scale));
            given.size = given.size.map(|given| {
                [0, 1].map(|i| ((f64::from(given[i]) * scale[i]).round() as u32).max(1))
            });
        }
        Ok(self)
    }

    /// The rig of images of this size that are rectified already.
    ///
    /// # Errors
    /// Cameras that need rectification and a file that does not say what comes out of it, or images
    /// of another shape.
    pub fn rectified_rig(&self, size: [u32; 2]) -> Result<StereoRig> {
        let (own, intrinsics, baseline_m) = match &self.given {
            Some(given) => (given.size.or(self.size), given.intrinsics, given.baseline_m),
            None if self.is_rectified() => {
                let intrinsics = self.cameras.map(|camera| camera.intrinsics);
                (self.size, intrinsics, self.baseline_m())
            }
            None => {
                return Err(Error::value(
                    "rectified images",
                    "the calibration says nothing of them: it has no P1 and P2",
                    "give the images as the cameras took them, or the calibration of the rectified ones",
                ));
            }
        };
        let plain = Self {
            size: own,
            cameras: intrinsics.map(|intrinsics| LensCamera {
                intrinsics,
                distortion: Distortion::NONE,
            }),
            given: None,
            ..*self
        };
        let [left, right] = plain
            .for_size(size)?
            .cameras
            .map(|camera| camera.intrinsics);
        RigSettings {
            width: size[0],
            height: size[1],
            baseline_m,
            hfov_deg: None,
            left: Some(left),
            right: Some(right),
        }
        .try_into()
    }

    /// The camera of one side, without its lens, for images of this size.
    pub(crate) fn camera(&self, side: usize, [width, height]: [u32; 2]) -> Camera {
        self.cameras[side].intrinsics.camera(width, height)
    }

    fn check_baseline(&self, largest_m: f64) -> Result<()> {
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
    fn check_places(&self) -> Result<()> {
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

/// Names of the cameras in messages.
const SIDES: [&str; 2] = ["left camera", "right camera"];

fn check_intrinsics(side: &str, camera: &Intrinsics, size: Option<[u32; 2]>) -> Result<()> {
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
fn check_center(side: &str, camera: &Intrinsics, [width, height]: [u32; 2]) -> Result<()> {
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

fn orthonormal_given(mut given: GivenRectification) -> Result<GivenRectification> {
    let [left, right] = given.rotations;
    given.rotations = [orthonormal("R1", left)?, orthonormal("R2", right)?];
    Ok(given)
}

/// The rotation that a rounded matrix stands for.
fn orthonormal(name: &str, matrix: DMat3) -> Result<DMat3> {
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

#[cfg(test)]
mod tests;
