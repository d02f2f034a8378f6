//! The TOML form: this crate's own units and pixel coordinates.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::LoadOptions;
use super::format::Format;
use crate::error::{Error, Result};
use crate::geometry::{
    CalibrationParts, Camera, DisparityTerms, Distortion, Intrinsics, LensCamera, StereoCalibration,
};

/// This program's own form.
pub(super) struct Settings;

/// Names at the beginning of lines that only this form has.
const NAMES: [&str; 7] = [
    "width",
    "height",
    "hfov_deg",
    "baseline_m",
    "rotation",
    "translation_m",
    "version",
];

impl Format for Settings {
    fn name(&self) -> &'static str {
        "TOML"
    }

    fn sign(&self) -> &'static str {
        "width, height, baseline_m and hfov_deg or [left] and [right]; also a dataset.toml"
    }

    fn matches(&self, text: &str) -> bool {
        text.lines().map(str::trim).any(|line| {
            let is_table = ["[left]", "[right]", "[rig]"].contains(&line);
            let key = line.split_once('=').map(|(key, _)| key.trim());
            is_table || key.is_some_and(|key| NAMES.contains(&key))
        })
    }

    fn has_name(&self, name: &Path) -> bool {
        name.extension().is_some_and(|ending| ending == "toml")
    }

    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts> {
        let text = texts.first().copied().unwrap_or_default();
        parse(text, options.baseline_m)
    }
}

/// A calibration as people write it; a dataset's `[rig]` is one too.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Written {
    width: u32,
    height: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    hfov_deg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    baseline_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    translation_m: Option<[f64; 3]>,
    /// Rows of the matrix that takes the left camera's axes to the right one's.
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    left: Option<CameraSettings>,
    #[serde(skip_serializing_if = "Option::is_none")]
    right: Option<CameraSettings>,
    #[serde(skip_serializing_if = "Option::is_none")]
    disparity_correction: Option<DisparityTerms>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraSettings {
    focal_x_px: f64,
    focal_y_px: f64,
    center_x_px: f64,
    center_y_px: f64,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    distortion: Vec<f64>,
}

/// A dataset's `dataset.toml`, of which only the rig matters here.
#[derive(Debug, Deserialize)]
struct WithRig {
    rig: Written,
}

fn parse(text: &str, baseline_m: Option<f64>) -> Result<CalibrationParts> {
    let invalid = |error: toml::de::Error| {
        Error::value(
            "TOML",
            error.to_string().trim_end().to_owned(),
            "correct it; docs/calibration.md has an example",
        )
    };
    let table: toml::Table = text.parse().map_err(invalid)?;
    let settings = if table.contains_key("rig") {
        toml::from_str::<WithRig>(text).map_err(invalid)?.rig
    } else {
        toml::from_str(text).map_err(invalid)?
    };
    parts(settings, baseline_m)
}

fn parts(settings: Written, baseline_m: Option<f64>) -> Result<CalibrationParts> {
    let Written { width, height, .. } = settings;
    let cameras = match (settings.hfov_deg, settings.left, settings.right) {
        (Some(hfov_deg), None, None) if hfov_deg > 0.0 && hfov_deg < 180.0 => {
            [plain(Camera::from_hfov(width, height, hfov_deg)); 2]
        }
        (Some(hfov_deg), None, None) => {
            return Err(Error::value(
                format!("hfov_deg = {hfov_deg}"),
                "is no field of view of a pinhole camera",
                "give degrees between 0 and 180",
            ));
        }
        (None, Some(left), Some(right)) => [lens(&left)?, lens(&right)?],
        _ => {
            return Err(Error::value(
                "cameras",
                "either hfov_deg or both [left] and [right] are needed",
                "give exactly one of the two forms",
            ));
        }
    };
    let rotation = settings.rotation.map_or(DMat3::IDENTITY, |rows| {
        // The columns of the transpose are its rows.
        DMat3::from_cols_array_2d(&rows).transpose()
    });
    let translation_m = match (settings.translation_m, settings.baseline_m.or(baseline_m)) {
        (Some(_), Some(_)) if settings.baseline_m.is_some() => {
            return Err(Error::value(
                "baseline_m and translation_m",
                "say the same thing twice",
                "leave one of them",
            ));
        }
        (Some(translation_m), _) => DVec3::from_array(translation_m),
        (None, Some(baseline_m)) => rotation * DVec3::new(-baseline_m, 0.0, 0.0),
        (None, None) => {
            return Err(Error::value(
                "baseline_m",
                "the distance between the cameras is missing",
                "give baseline_m or translation_m, or --calib-baseline",
            ));
        }
    };
    Ok(CalibrationParts {
        size: Some([width, height]),
        cameras,
        rotation,
        translation_m,
        given: None,
        disparity_correction: settings.disparity_correction,
    })
}

impl Written {
    /// What is written of a calibration; None for one without a size.
    pub fn of(calibration: &StereoCalibration) -> Option<Self> {
        let [width, height] = calibration.size()?;
        let [left, right] = calibration.cameras().each_ref().map(camera_settings);
        let is_rectified = calibration.is_rectified();
        let rotation = calibration.right_from_left().transpose();
        Some(Self {
            width,
            height,
            hfov_deg: None,
            baseline_m: is_rectified.then(|| calibration.baseline_m()),
            translation_m: (!is_rectified).then(|| calibration.translation_m().to_array()),
            rotation: (!is_rectified).then(|| rotation.to_cols_array_2d()),
            left: Some(left),
            right: Some(right),
            disparity_correction: calibration.disparity_correction().copied(),
        })
    }
}

fn camera_settings(camera: &LensCamera) -> CameraSettings {
    let Intrinsics {
        focal_x_px,
        focal_y_px,
        center_x_px,
        center_y_px,
    } = camera.intrinsics;
    CameraSettings {
        focal_x_px,
        focal_y_px,
        center_x_px,
        center_y_px,
        distortion: if camera.distortion.is_none() {
            Vec::new()
        } else {
            camera.distortion.coefficients().to_vec()
        },
    }
}

fn plain(camera: Camera) -> LensCamera {
    LensCamera {
        intrinsics: camera.intrinsics(),
        distortion: Distortion::NONE,
    }
}

fn lens(settings: &CameraSettings) -> Result<LensCamera> {
    Ok(LensCamera {
        intrinsics: Intrinsics {
            focal_x_px: settings.focal_x_px,
            focal_y_px: settings.focal_y_px,
            center_x_px: settings.center_x_px,
            center_y_px: settings.center_y_px,
        },
        distortion: Distortion::from_coefficients(&settings.distortion)?,
    })
}
