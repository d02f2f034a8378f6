//! `ORB_SLAM3`'s and `ORB_SLAM2`'s settings.
//!
//! ```yaml
//! %YAML:1.0
//! Camera.type: "PinHole"          # or "Rectified", with Stereo.b in place of the second camera
//! Camera1.fx: 458.654             # fy cx cy k1 k2 p1 p2 [k3]; Camera2 alike
//! Camera.width: 752               # and height
//! Stereo.T_c1_c2: !!opencv-matrix {rows: 4, cols: 4, dt: f, data: [...]}   # second camera's place
//! ```
//!
//! The older form has one rectified camera, `Camera.fx`, and `Camera.bf`, its focal length times the
//! baseline.

use glam::{DMat3, DVec3};

use super::documents::tree;
use super::entries::{Entries, Matrix};
use super::format::Format;
use super::named;
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, LensCamera};

const REMEDY: &str = "complete the settings as ORB_SLAM3's examples have them";

/// The settings.
pub(super) struct OrbSlam;

impl Format for OrbSlam {
    fn name(&self) -> &'static str {
        "ORB_SLAM"
    }

    fn sign(&self) -> &'static str {
        "YAML with Camera1.fx and Stereo.T_c1_c2, or Camera.fx and Camera.bf"
    }

    fn matches(&self, text: &str) -> bool {
        text.lines().map(str::trim_start).any(|line| {
            ["Camera1.fx:", "Camera.fx:"]
                .iter()
                .any(|key| line.starts_with(key))
        })
    }

    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts> {
        let text = texts.first().copied().unwrap_or_default();
        let entries = Entries::of(&tree(text)?)?;
        // The older form for unrectified images has whole matrices beside it.
        if entries.numbers(&["leftk"]).is_some() && entries.numbers(&["rightk"]).is_some() {
            return named::parse(texts);
        }
        let kind = entries
            .texts()
            .find(|(name, _)| *name == "Camera.type")
            .map(|(_, kind)| kind.to_lowercase());
        if let Some(kind) = kind.filter(|kind| !["pinhole", "rectified"].contains(&kind.as_str())) {
            return Err(Error::value(
                format!("Camera.type {kind}"),
                "only OpenCV's pinhole model is known",
                "calibrate with that model, or rectify the images yourself and give their \
                 calibration",
            ));
        }
        let value = |name: &str| {
            let (_, matrix) = entries.numbers(&[name])?;
            match matrix.values[..] {
                [value] => Some(value),
                _ => None,
            }
        };
        let first = if value("camera1fx").is_some() {
            "camera1"
        } else {
            "camera"
        };
        let left = camera(first, &value)?;
        let size = match (value("camerawidth"), value("cameraheight")) {
            (Some(width), Some(height)) => Some(named::whole_size(
                "Camera.width and height",
                &[width, height],
            )?),
            _ => None,
        };
        if let Some((name, matrix)) = entries.numbers(&["stereotc1c2"]) {
            let (turn, place) = matrix.transform(name)?;
            let rotation: DMat3 = turn.transpose();
            let translation_m: DVec3 = -(rotation * place);
            return Ok(CalibrationParts {
                size,
                cameras: [left, camera("camera2", &value)?],
                rotation,
                translation_m,
                given: None,
                disparity_correction: None,
            });
        }
        let focal_px = left.intrinsics.focal_x_px;
        let of_bf = || Some(value("camerabf")? / focal_px);
        let baseline_m = value("stereob").or_else(of_bf).or(options.baseline_m);
        let baseline_m = baseline_m.ok_or_else(|| {
            Error::value(
                "Stereo.T_c1_c2, Stereo.b and Camera.bf",
                "are all missing: these are settings of a single camera",
                REMEDY,
            )
        })?;
        Ok(CalibrationParts::rectified(
            size,
            [left.intrinsics; 2],
            baseline_m,
        ))
    }
}

fn camera(name: &str, value: &impl Fn(&str) -> Option<f64>) -> Result<LensCamera> {
    let required = |member: &str| {
        let value = value(&format!("{name}{member}"));
        value.ok_or_else(|| {
            let mut shown = name.replacen('c', "C", 1);
            shown.push('.');
            Error::value(shown + member, "is missing or no number", REMEDY)
        })
    };
    let (fx, fy, cx, cy) = (
        required("fx")?,
        required("fy")?,
        required("cx")?,
        required("cy")?,
    );
    let coefficients = ["k1", "k2", "p1", "p2", "k3"]
        .map(|member| value(&format!("{name}{member}")).unwrap_or(0.0));
    let intrinsics = Matrix {
        rows: 3,
        columns: 3,
        values: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
    }
    .intrinsics(name, HALF_PIXEL)?;
    Ok(LensCamera {
        intrinsics,
        distortion: Distortion::from_coefficients(&coefficients)?,
    })
}
