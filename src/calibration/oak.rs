//! Luxonis' OAK-D: the calibration that the device keeps, as JSON.
//!
//! ```json
//! {"cameraData": [[1, {"cameraType": 0, "width": 1280, "height": 800,
//!    "intrinsicMatrix": [[...], [...], [...]], "distortionCoeff": [14 numbers],
//!    "extrinsics": {"toCameraSocket": 2, "rotationMatrix": [[...], [...], [...]],
//!                   "translation": {"x": -7.5, "y": 0.0, "z": 0.0}}}],
//!   [2, {...}]],
//!  "stereoRectificationData": {"leftCameraSocket": 1, "rightCameraSocket": 2}}
//! ```
//!
//! Extrinsics take points of a camera's axes to those of another one's, in centimetres.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use serde_json::Value;

use super::entries::Matrix;
use super::format::Format;
use super::json::{at, has_names, number, numbers, required, tree};
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, LensCamera};

const REMEDY: &str = "read the calibration from the device again";

/// OAK-D's file.
pub(super) struct Oak;

impl Format for Oak {
    fn name(&self) -> &'static str {
        "OAK-D"
    }

    fn sign(&self) -> &'static str {
        "JSON with cameraData and intrinsicMatrix"
    }

    fn matches(&self, text: &str) -> bool {
        has_names(text, &["cameraData", "intrinsicMatrix"])
    }

    fn parse(&self, texts: &[&str], _options: &LoadOptions) -> Result<CalibrationParts> {
        let tree = tree(texts.first().copied().unwrap_or_default())?;
        let cameras = cameras(&tree)?;
        let socket = |name: &str, usual: i64| {
            let said = at(&tree, &["stereoRectificationData", name]).and_then(Value::as_i64);
            // Without a stereo pair of its own it says -1.
            said.filter(|socket| *socket >= 0).unwrap_or(usual)
        };
        let sockets = [
            socket("leftCameraSocket", 1),
            socket("rightCameraSocket", 2),
        ];
        let mut lenses = Vec::new();
        let mut sizes = Vec::new();
        let mut poses = Vec::new();
        for socket in sockets {
            let camera = cameras.get(&socket).ok_or_else(|| {
                Error::value(format!("camera {socket}"), "is not in cameraData", REMEDY)
            })?;
            lenses.push(lens(camera, socket)?);
            let side = |name: &str| -> Result<f64> { required(camera, &[name]) };
            sizes.push([side("width")?, side("height")?]);
            poses.push(root_from(&cameras, socket)?);
        }
        let [(left_root, left), (right_root, right)] = [poses[0], poses[1]];
        if left_root != right_root {
            return Err(Error::value(
                "extrinsics",
                format!(
                    "do not lead from camera {} to camera {}",
                    sockets[0], sockets[1]
                ),
                REMEDY,
            ));
        }
        if sizes[0] != sizes[1] {
            return Err(Error::value(
                format!("cameras {} and {}", sockets[0], sockets[1]),
                "have images of different sizes",
                "give the calibration of two equal cameras",
            ));
        }
        let size = sizes[0].map(|side| side as u32);
        let right_from_root = right.0.transpose();
        Ok(CalibrationParts {
            size: Some(size),
            cameras: [lenses[0], lenses[1]],
            rotation: right_from_root * left.0,
            translation_m: right_from_root * (left.1 - right.1) / 100.0,
            given: None,
            disparity_correction: None,
        })
    }
}

/// The cameras by the number of their socket.
fn cameras(tree: &Value) -> Result<BTreeMap<i64, &Value>> {
    let refused = || Error::value("cameraData", "is no list of cameras", REMEDY);
    let Some(Value::Array(items)) = tree.get("cameraData") else {
        return Err(refused());
    };
    items
        .iter()
        .map(|item| match item.as_array().map(Vec::as_slice) {
            Some([socket, camera]) => Ok((socket.as_i64().ok_or_else(refused)?, camera)),
            _ => Err(refused()),
        })
        .collect()
}

fn matrix(value: Option<&Value>, name: &str) -> Result<Matrix> {
    let values = value.and_then(numbers).filter(|values| values.len() == 9);
    let values = values.ok_or_else(|| Error::value(name, "is no matrix 3 x 3", REMEDY))?;
    Ok(Matrix {
        rows: 3,
        columns: 3,
        values,
    })
}

fn lens(camera: &Value, socket: i64) -> Result<LensCamera> {
    if camera
        .get("cameraType")
        .and_then(Value::as_i64)
        .unwrap_or(0)
        != 0
    {
        return Err(Error::value(
            format!("cameraType of camera {socket}"),
            "only OpenCV's pinhole model is known",
            "rectify the images yourself and give their calibration",
        ));
    }
    let name = format!("intrinsicMatrix of camera {socket}");
    let coefficients = camera.get("distortionCoeff").and_then(numbers);
    Ok(LensCamera {
        intrinsics: matrix(camera.get("intrinsicMatrix"), &name)?.intrinsics(&name, HALF_PIXEL)?,
        distortion: Distortion::from_coefficients(&coefficients.unwrap_or_default())?,
    })
}

/// A rotation and a translation, centimetres, from a camera's axes to another one's.
type Pose = (DMat3, DVec3);

/// Follows the extrinsics from a camera to the one at their end, which has none.
fn root_from(cameras: &BTreeMap<i64, &Value>, socket: i64) -> Result<(i64, Pose)> {
    let mut pose = (DMat3::IDENTITY, DVec3::ZERO);
    let mut current = socket;
    for _ in 0..=cameras.len() {
        let extrinsics = cameras.get(&current).and_then(|c| c.get("extrinsics"));
        let next = extrinsics
            .and_then(|e| e.get("toCameraSocket"))
            .and_then(Value::as_i64);
        let (Some(extrinsics), Some(next)) = (extrinsics, next.filter(|next| *next >= 0)) else {
            return Ok((current, pose));
        };
        let name = format!("extrinsics of camera {current}");
        let rotation = matrix(extrinsics.get("rotationMatrix"), &name)?.rotation(&name)?;
        let axis = |axis: &str| at(extrinsics, &["translation", axis]).and_then(number);
        let (Some(x), Some(y), Some(z)) = (axis("x"), axis("y"), axis("z")) else {
            return Err(Error::value(name, "have no translation", REMEDY));
        };
        pose = (rotation * pose.0, rotation * pose.1 + DVec3::new(x, y, z));
        current = next;
    }
    Err(Error::value(
        format!("extrinsics of camera {socket}"),
        "lead round in a circle",
        REMEDY,
    ))
}
