//! OpenCV's `FileStorage`, YAML or JSON, and what others name alike.
//!
//! ```yaml
//! %YAML:1.0
//! ---
//! image_width: 1280
//! image_height: 720
//! M1: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [...]}    # D1, M2, D2, R, T alike; R1 R2 P1 P2
//! ```
//!
//! Projections alone (`P1` and `P2`) are the calibration of rectified images.

use super::LoadOptions;
use super::format::Format;
use super::named;
use crate::error::Result;
use crate::geometry::CalibrationParts;

/// OpenCV's files.
pub(super) struct OpenCv;

impl Format for OpenCv {
    fn name(&self) -> &'static str {
        "OpenCV"
    }

    fn sign(&self) -> &'static str {
        "YAML or JSON with M1 D1 M2 D2 R T, in one file or two, or P1 and P2 alone"
    }

    fn matches(&self, text: &str) -> bool {
        let mut lines = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty() && !line.starts_with('#'));
        let Some(first) = lines.clone().next() else {
            return false;
        };
        if first.starts_with(['%', '{']) || first.starts_with("---") {
            return true;
        }
        // The first line that says anything is `key: value`, not `key = value`.
        let said = lines.find_map(|line| line.find([':', '=']).map(|at| &line[at..]));
        !first.starts_with('[') && said.is_some_and(|rest| rest.starts_with(':'))
    }

    fn takes_two(&self) -> bool {
        true
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        named::parse(texts)
    }
}
