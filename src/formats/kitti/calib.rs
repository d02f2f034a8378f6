//! KITTI's calibration files.

use std::fmt::Write as _;
use std::path::Path;

use crate::files;
use crate::geometry::{Camera, Intrinsics, RigSettings, StereoRig};

/// From KITTI's pixel coordinates to this crate's.
pub(super) const HALF_PIXEL: f64 = 0.5;

/// The cameras of a rectified pair may stand this much above or ahead of each other, metres: a
/// tenth of a pixel of a car at 20 m. KITTI's own calibrations say 3 mm.
const ASKEW_M: f64 = 0.02;

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
        let (left, left_m) = projection(&text, "P2")?;
        let (right, right_m) = projection(&text, "P3")?;
        let baseline_m = left_m[0] - right_m[0];
        if baseline_m <= 0.0 {
            return Err(format!(
                "P2 and P3 put the right camera {} m to the left of the left one",
                -baseline_m
            ));
        }
        if (1..3).any(|i| (left_m[i] - right_m[i]).abs() > ASKEW_M) {
            return Err("P2 and P3 are not the cameras of a rectified pair".to_owned());
        }
        Ok(Self {
            left,
            right,
            baseline_m,
            rig_from_reference_m: [0, 1, 2].map(|i| f64::midpoint(left_m[i], right_m[i])),
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

/// Intrinsics and translation of one projection matrix `K [I | t]`.
fn projection(text: &str, name: &str) -> Result<(Intrinsics, [f64; 3]), String> {
    let line = text
        .lines()
        .find_map(|line| line.trim().strip_prefix(name)?.strip_prefix(':'))
        .ok_or_else(|| format!("has no {name}"))?;
    let numbers = line
        .split_whitespace()
        .map(|word| super::super::number::finite(word, name))
        .collect::<Result<Vec<f64>, String>>()?;
    let [fx, skew, cx, px, lower, fy, cy, py, zero, zero_too, one, pz] = numbers[..] else {
        return Err(format!("{name} has {} numbers, not 12", numbers.len()));
    };
    let plain = [skew, lower, zero, zero_too].iter().all(|v| v.abs() < 1e-6);
    if !plain || (one - 1.0).abs() > 1e-6 || fx <= 0.0 || fy <= 0.0 {
        return Err(format!("{name} is no projection of a rectified camera"));
    }
    let intrinsics = Intrinsics {
        focal_x_px: fx,
        focal_y_px: fy,
        center_x_px: cx + HALF_PIXEL,
        center_y_px: cy + HALF_PIXEL,
    };
    Ok((intrinsics, [(px - cx * pz) / fx, (py - cy * pz) / fy, pz]))
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
