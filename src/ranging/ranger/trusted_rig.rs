//! A rig with what is known of the error of its disparities.

use crate::dataset::DatasetInfo;
use crate::geometry::{DisparityCorrection, StereoRig};

/// A rig, and how far its disparities can be trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrustedRig {
    /// The cameras.
    pub rig: StereoRig,
    /// What disparities are too large by, where that was measured.
    pub correction: Option<DisparityCorrection>,
    /// Standard deviation of what all disparities of a frame are off by beside that, pixels.
    pub disparity_std_px: f64,
}

impl TrustedRig {
    /// Standard deviation of the disparities of calibrated cameras that nobody checked, pixels: what
    /// public driving data has.
    pub const UNCHECKED_STD_PX: f64 = 0.5;

    /// Cameras that are calibrated, without a check of how well.
    pub const fn unchecked(rig: StereoRig) -> Self {
        Self {
            rig,
            correction: None,
            disparity_std_px: Self::UNCHECKED_STD_PX,
        }
    }

    /// Rendered images, whose rig is exact.
    pub const fn exact(rig: StereoRig) -> Self {
        Self {
            rig,
            correction: None,
            disparity_std_px: 0.0,
        }
    }

    /// The rig of a dataset: exact where it was rendered, unchecked otherwise.
    pub fn of_dataset(info: &DatasetInfo) -> Self {
        let program = info.made_by.get("program").and_then(toml::Value::as_str);
        if program == Some("twinsight generate") {
            Self::exact(info.rig)
        } else {
            Self::unchecked(info.rig)
        }
    }

    /// Cameras of which it was measured what their disparities are off by: `twinsight calibrate`.
    pub fn corrected(rig: StereoRig, correction: DisparityCorrection) -> Self {
        Self {
            rig,
            disparity_std_px: correction.std_px(),
            correction: Some(correction),
        }
    }

    /// What the disparity of a pixel of the left image is too large by, pixels.
    pub(super) fn delta_px(&self, pixel: [f64; 2]) -> f64 {
        self.correction
            .as_ref()
            .map_or(0.0, |correction| correction.delta_px(pixel))
    }
}
