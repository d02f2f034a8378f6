//! Stereolabs' ZED: `SN12345678.conf`, with the cameras of every resolution.
//!
//! ```text
//! [LEFT_CAM_HD]              and [RIGHT_CAM_HD]; also _2K _FHD _VGA ...
//! fx=700.1 fy=... cx=... cy=... k1=... k2=... p1=... p2=... k3=...
//! [STEREO]
//! Baseline=119.9             millimetres, with TY and TZ from the left to the right camera
//! RX_HD=... CV_HD=... RZ_HD=...    rotation vector, radians
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::entries::{Matrix, number};
use super::format::Format;
use super::resolution::{Resolution, choose};
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, Intrinsics, LensCamera};

const REMEDY: &str = "download the file again from Stereolabs, by the camera's serial number";

/// Sizes of one eye's images by the names of the resolutions, pixels.
const SIZES: [(&str, [u32; 2]); 7] = [
    ("2k", [2208, 1242]),
    ("fhd", [1920, 1080]),
    ("hd", [1280, 720]),
    ("vga", [672, 376]),
    ("fhd1200", [1920, 1200]),
    ("svga", [960, 600]),
    ("4k", [3840, 2160]),
];

/// ZED's file.
pub(super) struct Zed;

impl Format for Zed {
    fn name(&self) -> &'static str {
        "ZED"
    }

    fn sign(&self) -> &'static str {
        "SN*.conf with [LEFT_CAM_HD] and [STEREO]"
    }

    fn matches(&self, text: &str) -> bool {
        text.lines()
            .any(|line| line.trim().to_lowercase().starts_with("[left_cam_"))
    }

    fn has_name(&self, name: &Path) -> bool {
        let stem = name.file_stem().and_then(|stem| stem.to_str());
        name.extension().is_some_and(|ending| ending == "conf")
            && stem.is_some_and(|stem| stem.starts_with("SN"))
    }

    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts> {
        let sections = sections(texts.first().copied().unwrap_or_default())?;
        let names: Vec<String> = sections
            .keys()
            .filter_map(|name| name.strip_prefix("left_cam_"))
            .filter(|name| sections.contains_key(&format!("right_cam_{name}")))
            .map(str::to_owned)
            .collect();
        let mut resolutions = Vec::new();
        for name in names {
            let camera = |side: &str| camera(&sections, side, &name);
            let cameras = [camera("left")?, camera("right")?];
            let Intrinsics {
                center_x_px,
                center_y_px,
                ..
            } = cameras[0].intrinsics;
            resolutions.push(Resolution {
                size: SIZES
                    .iter()
                    .find(|(known, _)| *known == name)
                    .map(|(_, size)| *size),
                center: [center_x_px, center_y_px],
                content: (name, cameras),
            });
        }
        if resolutions.is_empty() {
            return Err(Error::value(
                "[LEFT_CAM_HD] and [RIGHT_CAM_HD]",
                "there is no resolution with both cameras",
                REMEDY,
            ));
        }
        let Resolution {
            size,
            content: (name, cameras),
            ..
        } = choose(&resolutions, options.image_size)?;
        let stereo = sections.get("stereo");
        // Some values are the same in all resolutions, and have no name of one.
        let value = |key: &str| {
            let stereo = stereo?;
            let own = stereo.get(&format!("{key}_{name}"));
            own.or_else(|| stereo.get(key)).copied()
        };
        let Some(baseline_mm) = value("baseline") else {
            return Err(Error::value("[STEREO] Baseline", "is missing", REMEDY));
        };
        let or_zero = |key: &str| value(key).unwrap_or(0.0);
        let rotation = Matrix {
            rows: 1,
            columns: 3,
            values: vec![
                or_zero("rx"),
                value("cv").or(value("ry")).unwrap_or(0.0),
                or_zero("rz"),
            ],
        };
        Ok(CalibrationParts {
            size,
            cameras,
            rotation: rotation.rotation("[STEREO] RX, CV and RZ")?,
            translation_m: -DVec3::new(baseline_mm, or_zero("ty"), or_zero("tz")) / 1000.0,
            given: None,
            disparity_correction: None,
        })
    }
}

/// Numbers by section and name, both in lower case; what is no number is left out.
type Sections = BTreeMap<String, BTreeMap<String, f64>>;

fn sections(text: &str) -> Result<Sections> {
    let mut sections = Sections::new();
    let mut current = String::new();
    for (line_number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            current = name.trim().to_lowercase();
        } else if let Some((key, value)) = line.split_once('=') {
            let is_camera = current.contains("_cam_") || current == "stereo";
            // Programs of another language wrote 0,5.
            let value = value.trim().replace(',', ".");
            if is_camera || value.parse::<f64>().is_ok() {
                let key = key.trim().to_lowercase();
                let value = number(&value, &format!("{key}, line {line_number}"))?;
                let section = sections.entry(current.clone()).or_default();
                section.insert(key, value);
            }
        }
    }
    Ok(sections)
}

fn camera(sections: &Sections, side: &str, resolution: &str) -> Result<LensCamera> {
    let name = format!("{side}_cam_{resolution}");
    let shown = format!("[{}]", name.to_uppercase());
    let section = sections.get(&name);
    let required = |key: &str| {
        let value = section.and_then(|section| section.get(key));
        let value = value.copied();
        value.ok_or_else(|| Error::value(format!("{shown} {key}"), "is missing", REMEDY))
    };
    let (fx, fy, cx, cy) = (
        required("fx")?,
        required("fy")?,
        required("cx")?,
        required("cy")?,
    );
    // Newer cameras have one lens for all resolutions.
    let lens = sections.get(&format!("{side}_disto")).or(section);
    let coefficient = |key: &str| {
        let value = lens.and_then(|lens| lens.get(key));
        value.copied().unwrap_or(0.0)
    };
    let coefficients = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"].map(coefficient);
    let prism = ["s1", "s2", "s3", "s4"].map(coefficient);
    let intrinsics = Matrix {
        rows: 3,
        columns: 3,
        values: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
    }
    .intrinsics(&shown, HALF_PIXEL)?;
    Ok(LensCamera {
        intrinsics,
        distortion: Distortion::from_coefficients(&[&coefficients[..], &prism].concat())?,
    })
}
