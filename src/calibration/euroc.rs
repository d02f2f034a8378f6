//! `EuRoC`'s `sensor.yaml`, one of each camera.
//!
//! ```yaml
//! sensor_type: camera
//! T_BS: {cols: 4, rows: 4, data: [...]}       # from the camera's axes to the body's
//! resolution: [752, 480]
//! camera_model: pinhole
//! intrinsics: [458.654, 457.296, 367.215, 248.375]
//! distortion_model: radial-tangential
//! distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
//! ```

use super::LoadOptions;
use super::format::Format;
use super::named;
use crate::error::{Error, Result};
use crate::geometry::CalibrationParts;

/// `EuRoC`'s files.
pub(super) struct Euroc;

impl Format for Euroc {
    fn name(&self) -> &'static str {
        "EuRoC"
    }

    fn sign(&self) -> &'static str {
        "two sensor.yaml with T_BS and intrinsics, the left camera's first"
    }

    fn matches(&self, text: &str) -> bool {
        let has = |key: &str| text.lines().any(|line| line.trim_start().starts_with(key));
        has("T_BS:") && has("intrinsics:")
    }

    fn takes_two(&self) -> bool {
        true
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        if let [_] = texts {
            return Err(Error::value(
                "sensor.yaml",
                "is of one camera",
                "give those of both: --calib cam0/sensor.yaml --calib cam1/sensor.yaml",
            ));
        }
        named::parse(texts)
    }
}
