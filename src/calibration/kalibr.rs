//! Kalibr's camera chain, `camchain.yaml`.
//!
//! ```yaml
//! cam0:
//!   camera_model: pinhole
//!   intrinsics: [530.0, 531.0, 322.0, 238.0]
//!   distortion_model: radtan
//!   distortion_coeffs: [-0.28, 0.08, 0.0012, -0.0001]
//!   resolution: [640, 480]
//! cam1:
//!   T_cn_cnm1: [[1, 0, 0, -0.12], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
//!   # and the same as cam0
//! ```

use super::LoadOptions;
use super::format::Format;
use super::named;
use crate::error::Result;
use crate::geometry::CalibrationParts;

/// Kalibr's file.
pub(super) struct Kalibr;

impl Format for Kalibr {
    fn name(&self) -> &'static str {
        "Kalibr"
    }

    fn sign(&self) -> &'static str {
        "YAML with cam0, cam1 and T_cn_cnm1"
    }

    fn matches(&self, text: &str) -> bool {
        let has = |key: &str| text.lines().any(|line| line.trim_start().starts_with(key));
        has("cam0:") && has("cam1:") && has("intrinsics:")
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        named::parse(texts)
    }
}
