//! Two real cameras as a calibration describes them: lenses, and how they stand to each other.

mod checks;

use glam::{DMat3, DVec3};

use super::resized::scale_to;
use super::{Camera, DisparityTerms, Distortion, Intrinsics, RigSettings, StereoRig};
use crate::error::{Error, Result};

use checks::{check_center, check_intrinsics, orthonormal, orthonormal_given};

/// A larger number without further word is in another unit, metres.
const LARGEST_BASELINE_M: f64 = 5.0;

/// A baseline that the user gives may be as large as this, metres.
const LARGEST_GIVEN_BASELINE_M: f64 = 1000.0;

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
    /// What is known of the error of disparities in the rectified images.
    pub disparity_correction: Option<DisparityTerms>,
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
            disparity_correction: None,
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
    disparity_correction: Option<DisparityTerms>,
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
            disparity_correction,
        } = parts;
        if let Some(terms) = &disparity_correction {
            terms.check()?;
        }
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
            disparity_correction,
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

    /// What is known of the error of disparities in the rectified images.
    pub fn disparity_correction(&self) -> Option<&DisparityTerms> {
        self.disparity_correction.as_ref()
    }

    /// The calibration with another knowledge of that error.
    ///
    /// # Errors
    /// As [`DisparityTerms::check`].
    pub fn with_disparity_correction(mut self, terms: Option<DisparityTerms>) -> Result<Self> {
        if let Some(terms) = &terms {
            terms.check()?;
        }
        self.disparity_correction = terms;
        Ok(self)
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
}

/// Names of the cameras in messages.
const SIDES: [&str; 2] = ["left camera", "right camera"];

#[cfg(test)]
mod tests;
