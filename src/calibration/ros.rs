//! ROS' `camera_info`: files of both cameras, and messages as `rostopic echo` and `ros2 topic echo`
//! print them.
//!
//! ```yaml
//! height: 360
//! width: 640
//! distortion_model: plumb_bob
//! D: [0.0, 0.0, 0.0, 0.0, 0.0]            # ROS 2: d k r p; files: distortion_coefficients: {rows, cols, data} ...
//! K: [320.0, 0.0, 319.5, 0.0, 320.0, 179.5, 0.0, 0.0, 1.0]
//! R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
//! P: [320.0, 0.0, 319.5, -256.0, 0.0, 320.0, 179.5, 0.0, 0.0, 0.0, 1.0, 0.0]
//! ---
//! ```
//!
//! How the cameras stand follows from their rectifications and projections.

use super::LoadOptions;
use super::format::Format;
use super::named;
use crate::error::Result;
use crate::geometry::CalibrationParts;

/// ROS' files and messages.
pub(super) struct Ros;

impl Format for Ros {
    fn name(&self) -> &'static str {
        "ROS camera_info"
    }

    fn sign(&self) -> &'static str {
        "YAML or topic echo with distortion_model, K and P, one file a camera, the left first"
    }

    fn matches(&self, text: &str) -> bool {
        let has = |keys: &[&str]| {
            text.lines()
                .map(str::trim_start)
                .any(|line| keys.iter().any(|key| line.starts_with(key)))
        };
        has(&["distortion_model:"])
            && has(&["K:", "k:", "camera_matrix:"])
            && has(&["P:", "p:", "projection_matrix:"])
    }

    fn takes_two(&self) -> bool {
        true
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        named::parse(texts)
    }
}
