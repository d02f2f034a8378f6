//! Intel's `RealSense`: the calibration table of a D400 camera as its tools save it, and what its
//! library says of two streams.
//!
//! ```json
//! {"baseline": "-50.07", "rectified.0.width": "1920", "rectified.0.height": "1080",
//!  "rectified.0.fx": "960.1", "rectified.0.fy": "960.1", "rectified.0.ppx": "958.2", ...}
//! ```
//!
//! ```json
//! {"infra1": {"width": 640, "height": 360, "fx": 320.1, "fy": 320.1, "ppx": 319.5, "ppy": 179.5},
//!  "infra2": {...}, "baseline": 0.05}
//! ```
//!
//! The infrared streams are rectified by the camera. Tables are in millimetres; a baseline below
//! [`LEAST_MM`] is in metres.

use std::collections::{BTreeMap, BTreeSet};

use super::entries::Matrix;
use super::format::Format;
use super::json::{flat, has_names, tree};
use super::resolution::{Resolution, choose};
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, Intrinsics};

const REMEDY: &str = "save the calibration again, with both infrared cameras and their baseline";

/// No `RealSense` has its cameras this far from each other in metres, or this near in millimetres.
const LEAST_MM: f64 = 5.0;

/// Names of the left and the right camera.
const SIDES: [[&str; 2]; 5] = [
    ["infra1", "infra2"],
    ["infrared1", "infrared2"],
    ["ir1", "ir2"],
    ["left", "right"],
    ["cam0", "cam1"],
];

/// `RealSense`'s files.
pub(super) struct RealSense;

impl Format for RealSense {
    fn name(&self) -> &'static str {
        "RealSense"
    }

    fn sign(&self) -> &'static str {
        "JSON with rectified.0.fx and baseline, or infra1.ppx and infra2.ppx"
    }

    fn matches(&self, text: &str) -> bool {
        has_names(text, &["rectified.0.fx"])
            || has_names(text, &["fx", "ppx", "ppy"])
            || has_names(text, &["rect_params", "baseline"])
    }

    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts> {
        let tree = tree(texts.first().copied().unwrap_or_default())?;
        let values = flat(&tree);
        let baseline_m = match options.baseline_m {
            Some(baseline_m) => baseline_m,
            None => baseline_m(&values)?,
        };
        let resolutions = resolutions(&values)?;
        let one = if resolutions.is_empty() {
            streams(&values)?
        } else {
            choose(&resolutions, options.image_size)?
        };
        Ok(CalibrationParts::rectified(
            one.size,
            one.content,
            baseline_m,
        ))
    }
}

/// Distance between the cameras: said, or the length of the translation between them.
fn baseline_m(values: &BTreeMap<String, f64>) -> Result<f64> {
    let ends = |name: &str, end: &str| name == end || name.ends_with(&format!(".{end}"));
    let of = |end: &str| values.iter().find(|(name, _)| ends(name, end));
    let said = ["baseline", "baseline_m", "baseline_mm"]
        .into_iter()
        .find_map(of);
    let found = said
        .or_else(|| of("translation.0"))
        .or_else(|| of("translation.x"));
    let Some((_, value)) = found else {
        return Err(Error::value("baseline", "is missing", REMEDY));
    };
    let value = value.abs();
    Ok(if value >= LEAST_MM {
        value / 1000.0
    } else {
        value
    })
}

fn intrinsics(values: &BTreeMap<String, f64>, name: &str) -> Result<Intrinsics> {
    let value = |member: &str| {
        let full = format!("{name}.{member}");
        let value = values.get(&full).copied();
        value.ok_or_else(|| Error::value(full, "is missing or no number", REMEDY))
    };
    let (fx, fy, cx, cy) = (value("fx")?, value("fy")?, value("ppx")?, value("ppy")?);
    Matrix {
        rows: 3,
        columns: 3,
        values: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
    }
    .intrinsics(name, HALF_PIXEL)
}

fn size(values: &BTreeMap<String, f64>, name: &str) -> Option<[u32; 2]> {
    let side = |member: &str| {
        let side = values.get(&format!("{name}.{member}"))?;
        (side.fract() == 0.0 && (2.0..=32_768.0).contains(side)).then_some(*side as u32)
    };
    Some([side("width")?, side("height")?])
}

/// The rectified cameras of a table, which are the same on both sides.
fn resolutions(values: &BTreeMap<String, f64>) -> Result<Vec<Resolution<[Intrinsics; 2]>>> {
    let names: BTreeSet<&str> = values
        .keys()
        .filter_map(|name| name.strip_suffix(".fx"))
        .filter(|name| name.contains("rectified.") || name.contains("rect_params."))
        .collect();
    let mut resolutions = Vec::new();
    for name in names {
        // Places of the table that are not used hold zeros or anything.
        let fits = size(values, name).is_some_and(|[width, height]| {
            let near = |member: &str, side: u32| {
                let center = values.get(&format!("{name}.{member}")).copied();
                center.is_some_and(|c| (0.3..=0.7).contains(&(c / f64::from(side))))
            };
            near("ppx", width) && near("ppy", height)
        });
        if !fits {
            continue;
        }
        let one = intrinsics(values, name)?;
        resolutions.push(Resolution {
            size: size(values, name),
            center: [one.center_x_px, one.center_y_px],
            content: [one; 2],
        });
    }
    Ok(resolutions)
}

/// The two streams that the library speaks of.
fn streams(values: &BTreeMap<String, f64>) -> Result<Resolution<[Intrinsics; 2]>> {
    let names: Vec<&str> = values
        .keys()
        .filter_map(|name| name.strip_suffix(".ppx"))
        .collect();
    let of_side = |word: &str| {
        // `infra1`, `Infrared 1` and `infra1_intrinsics` are the same.
        let plain = |part: &str| part.replace(|c: char| !c.is_alphanumeric(), "");
        let is_side = |name: &&&str| name.split('.').any(|part| plain(part).contains(word));
        names.iter().find(is_side).copied()
    };
    let sides = SIDES
        .iter()
        .find_map(|[left, right]| Some([of_side(left)?, of_side(right)?]));
    let Some(sides) = sides else {
        return Err(Error::value(
            "infra1 and infra2",
            format!("there are only {}", names.join(", ")),
            REMEDY,
        ));
    };
    for side in sides {
        let coefficients: Vec<f64> = (0..14)
            .map_while(|i| values.get(&format!("{side}.coeffs.{i}")).copied())
            .collect();
        if !Distortion::from_coefficients(&coefficients)?.is_none() {
            return Err(Error::value(
                format!("{side}.coeffs"),
                "are of a stream that is not rectified",
                "give the calibration of the rectified infrared streams",
            ));
        }
    }
    let [left, right] = sides;
    let sizes = sides.map(|side| size(values, side));
    if sizes[0] != sizes[1] {
        return Err(Error::value(
            sides.join(" and "),
            "have images of different sizes",
            REMEDY,
        ));
    }
    let content = [intrinsics(values, left)?, intrinsics(values, right)?];
    Ok(Resolution {
        size: sizes[0],
        center: [content[0].center_x_px, content[0].center_y_px],
        content,
    })
}
