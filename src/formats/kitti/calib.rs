//! KITTI's calibration files.

use std::fmt::Write as _;
use std::path::Path;

use crate::calibration::HALF_PIXEL;
use crate::calibration::kitti::rectified_pair;
use crate::files;
use crate::geometry::{Camera, Intrinsics, RigSettings, StereoRig};

/// Both cameras as one calibration file gives them; sizes of images are not in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Calibration {
    pub left: Intrinsics,
    pub right: Intrinsics,
    pub baseline_m: f64,
    /// From KITTI's reference camera to the middle between the colour cameras: is added to points.
    pub rig_from_reference_m: [f64; 3],
}

impl Calibration {
    /// Reads a file; the reason against it in words.
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = files::read_text(path).map_err(|error| error.to_string())?;
        let names = ["P2", "P3"].map(str::to_owned);
        let pair = rectified_pair(&text, &names).map_err(|error| error.to_string())?;
        let baseline_m = pair.baseline_m();
        if baseline_m <= 0.0 {
            return Err(format!(
                "P2 and P3 put the right camera {} m to the left of the left one",
                -baseline_m
            ));
        }
        let [left, right] = pair.intrinsics;
        if left.focal_x_px <= 0.0 || left.focal_y_px <= 0.0 || right.focal_x_px <= 0.0 {
            return Err("P2 and P3 have focal lengths that are not above 0".to_owned());
        }
        let middle_m = (pair.offsets_m[0] + pair.offsets_m[1]) / 2.0;
        Ok(Self {
            left,
            right,
            baseline_m,
            rig_from_reference_m: middle_m.to_array(),
        })
    }

    /// The same for equal rigs, whatever the size of their images.
    pub fn key(&self) -> Vec<i64> {
        let intrinsics = [self.left, self.right].into_iter().flat_map(|camera| {
            [
                camera.focal_x_px,
                camera.focal_y_px,
                camera.center_x_px,
                camera.center_y_px,
            ]
        });
        // A hundredth of a pixel and a tenth of a millimetre.
        let mut key: Vec<_> = intrinsics.map(|v| (v * 100.0).round() as i64).collect();
        key.push((self.baseline_m * 1e4).round() as i64);
        key
    }

    pub fn rig(&self, [width, height]: [u32; 2]) -> crate::Result<StereoRig> {
        RigSettings {
            width,
            height,
            baseline_m: self.baseline_m,
            hfov_deg: None,
            left: Some(self.left),
            right: Some(self.right),
        }
        .try_into()
    }
}

/// A calibration file for a rig; the left camera is the reference.
pub(super) fn text(rig: &StereoRig) -> String {
    let line = |name: &str, camera: &Camera, x_m: f64| {
        let [fx, fy] = [camera.focal_x_px, camera.focal_y_px];
        let [cx, cy] = [camera.center_x_px, camera.center_y_px].map(|c| c - HALF_PIXEL);
        let numbers = [fx, 0.0, cx, fx * x_m, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
        let mut line = format!("{name}:");
        for number in numbers {
            // Writing to a String cannot fail.
            write!(line, " {number:.12e}").ok();
        }
        line
    };
    let (left, right) = (&rig.left, &rig.right);
    let identity = "1 0 0 0 1 0 0 0 1";
    [
        line("P0", left, 0.0),
        line("P1", right, -rig.baseline_m),
        line("P2", left, 0.0),
        line("P3", right, -rig.baseline_m),
        format!("R0_rect: {identity}"),
        "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0".to_owned(),
        "Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0".to_owned(),
    ]
    .join("\n")
        + "\n"
}
