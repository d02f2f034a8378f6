//! Cityscapes' `*_camera.json`, of rectified pairs.
//!
//! ```json
//! {"extrinsic": {"baseline": 0.209, "pitch": 0.03, "roll": 0.0, "x": 1.7, "y": 0.1, "yaw": -0.01, "z": 1.22},
//!  "intrinsic": {"fx": 2262.52, "fy": 2265.3, "u0": 1096.98, "v0": 513.137}}
//! ```

use std::path::Path;

use super::entries::Matrix;
use super::format::Format;
use super::json::{has_names, required, tree};
use super::{HALF_PIXEL, LoadOptions};
use crate::error::Result;
use crate::geometry::CalibrationParts;

/// Cityscapes' file.
pub(super) struct Cityscapes;

impl Format for Cityscapes {
    fn name(&self) -> &'static str {
        "Cityscapes"
    }

    fn sign(&self) -> &'static str {
        "*_camera.json with intrinsic.u0 and extrinsic.baseline"
    }

    fn matches(&self, text: &str) -> bool {
        has_names(text, &["intrinsic", "u0", "extrinsic", "baseline"])
    }

    fn has_name(&self, name: &Path) -> bool {
        let name = name.file_name().and_then(|name| name.to_str());
        name.is_some_and(|name| name.ends_with("_camera.json"))
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        let tree = tree(texts.first().copied().unwrap_or_default())?;
        let inner = |name: &str| required(&tree, &["intrinsic", name]);
        let (fx, fy, cx, cy) = (inner("fx")?, inner("fy")?, inner("u0")?, inner("v0")?);
        let intrinsics = Matrix {
            rows: 3,
            columns: 3,
            values: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        }
        .intrinsics("intrinsic", HALF_PIXEL)?;
        let baseline_m = required(&tree, &["extrinsic", "baseline"])?;
        Ok(CalibrationParts::rectified(
            None,
            [intrinsics; 2],
            baseline_m,
        ))
    }
}
