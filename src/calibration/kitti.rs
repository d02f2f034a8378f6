//! KITTI's calibration files and those of datasets that write alike.
//!
//! ```text
//! P2: 721.5 0 609.6 44.9 0 721.5 172.9 0.2 0 0 1 0.003     objects, odometry, tracks: P0 to P3
//! P_rect_02: ...                                            raw recordings' calib_cam_to_cam.txt,
//!                                                           with S K D R T S_rect R_rect
//! P_rect_00: ... P_rect_01: ...                             KITTI-360's perspective.txt
//! P_rect_101: ... P_rect_103: ...                           DrivingStereo
//! ```

use glam::{DMat3, DVec3};

use super::entries::{Matrix, number};
use super::format::Format;
use super::{HALF_PIXEL, LoadOptions};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, GivenRectification, Intrinsics, LensCamera};

/// The cameras of a rectified pair may stand this much above or ahead of each other, metres: a
/// tenth of a pixel of a car at 20 m. KITTI's own calibrations say 3 mm.
const ASKEW_M: f64 = 0.02;

const REMEDY: &str = "copy the file again from KITTI";

/// Pairs of cameras by the ends of their names, the colour pair before the grey one. `DrivingStereo`
/// has cameras 101 and 103.
const PAIRS: [[&str; 2]; 3] = [["02", "03"], ["00", "01"], ["101", "103"]];

/// KITTI's files.
pub(super) struct Kitti;

impl Format for Kitti {
    fn name(&self) -> &'static str {
        "KITTI, KITTI-360 and DrivingStereo"
    }

    fn sign(&self) -> &'static str {
        "text with P2: and P3:, or P_rect_02: and P_rect_03:"
    }

    fn matches(&self, text: &str) -> bool {
        text.lines().map(str::trim).any(is_projection)
    }

    fn parse(&self, texts: &[&str], options: &LoadOptions) -> Result<CalibrationParts> {
        parse(
            texts.first().copied().unwrap_or_default(),
            options.kitti_grey,
        )
    }
}

/// Whether a line is one of KITTI's projections, which no other format has.
fn is_projection(line: &str) -> bool {
    let Some((name, numbers)) = line.split_once(':') else {
        return false;
    };
    let is_camera = PAIRS.as_flattened().iter().any(|camera| {
        let short = camera.strip_prefix('0');
        name.strip_prefix("P_rect_") == Some(camera)
            || short.is_some_and(|short| name.strip_prefix('P') == Some(short))
    });
    // In YAML an entry of that name is a matrix over several lines.
    is_camera && numbers.split_whitespace().count() >= 3 && !numbers.contains(['[', '{', '!'])
}

/// Reads the colour pair's calibration, or the grey one's; the only pair where there is but one.
fn parse(text: &str, is_grey: bool) -> Result<CalibrationParts> {
    let has = |name: &str| Ok::<_, Error>(numbers(text, name)?.is_some());
    let has_pair = |[left, right]: [&str; 2], base: &str| {
        Ok::<_, Error>(has(&format!("{base}{left}"))? || has(&format!("{base}{right}"))?)
    };
    let wanted = usize::from(is_grey);
    let order = [PAIRS[wanted], PAIRS[1 - wanted], PAIRS[2]];
    for cameras in order {
        if has_pair(cameras, "P_rect_")? {
            return raw(text, cameras);
        }
    }
    let short = |cameras: [&'static str; 2]| cameras.map(|camera| &camera[1..]);
    let mut cameras = short(order[0]);
    if !has_pair(cameras, "P")? {
        cameras = short(order[1]);
    }
    let pair = rectified_pair(text, &cameras.map(|camera| format!("P{camera}")))?;
    // Tenths of a millimetre up or ahead are the rounding of a rectification.
    Ok(CalibrationParts::rectified(
        None,
        pair.intrinsics,
        pair.baseline_m(),
    ))
}

/// Two cameras of one rectified rig.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair {
    /// Left and right camera; the first pixel's centre is at (0.5, 0.5).
    pub intrinsics: [Intrinsics; 2],
    /// From the reference camera to each: is added to points, metres.
    pub offsets_m: [DVec3; 2],
}

impl Pair {
    /// Distance between the two, metres; negative for swapped cameras.
    pub fn baseline_m(&self) -> f64 {
        self.offsets_m[0].x - self.offsets_m[1].x
    }
}

/// The cameras of two projections.
pub(crate) fn rectified_pair(text: &str, names: &[String; 2]) -> Result<Pair> {
    let camera = |name: &str| -> Result<(Intrinsics, DVec3)> {
        let matrix = required(text, name, 3, 4)?;
        Ok((matrix.intrinsics(name, HALF_PIXEL)?, matrix.offset(name)?))
    };
    let [(left, left_m), (right, right_m)] = [camera(&names[0])?, camera(&names[1])?];
    let apart = left_m - right_m;
    if apart.y.abs() > ASKEW_M || apart.z.abs() > ASKEW_M {
        return Err(Error::value(
            names.join(" and "),
            "are not the cameras of a rectified pair",
            REMEDY,
        ));
    }
    Ok(Pair {
        intrinsics: [left, right],
        offsets_m: [left_m, right_m],
    })
}

/// `calib_cam_to_cam.txt`: both the unrectified cameras and what they become.
fn raw(text: &str, cameras: [&str; 2]) -> Result<CalibrationParts> {
    let pair = rectified_pair(text, &cameras.map(|camera| format!("P_rect_{camera}")))?;
    let rectified_size = size(text, "S_rect", cameras)?;
    let has_lenses = numbers(text, &format!("K_{}", cameras[0]))?.is_some();
    // DrivingStereo has no unrectified images.
    if !has_lenses || cameras == PAIRS[2] {
        let baseline_m = pair.baseline_m();
        return Ok(CalibrationParts::rectified(
            rectified_size,
            pair.intrinsics,
            baseline_m,
        ));
    }
    let mut lenses = Vec::new();
    let mut poses = Vec::new();
    let mut rotations = Vec::new();
    for camera in cameras {
        let named = |base: &str| format!("{base}_{camera}");
        let [k, d, r, t, r_rect] = ["K", "D", "R", "T", "R_rect"].map(named);
        let coefficients = numbers(text, &d)?.unwrap_or_default();
        lenses.push(LensCamera {
            intrinsics: required(text, &k, 3, 3)?.intrinsics(&k, HALF_PIXEL)?,
            distortion: Distortion::from_coefficients(&coefficients)?,
        });
        poses.push((
            required(text, &r, 3, 3)?.rotation(&r)?,
            required(text, &t, 3, 1)?.vector(&t)?,
        ));
        rotations.push(required(text, &r_rect, 3, 3)?.rotation(&r_rect)?);
    }
    let [(left_r, left_t), (right_r, right_t)]: [(DMat3, DVec3); 2] = [poses[0], poses[1]];
    let rotation = right_r * left_r.transpose();
    Ok(CalibrationParts {
        size: size(text, "S", cameras)?,
        cameras: [lenses[0], lenses[1]],
        rotation,
        translation_m: right_t - rotation * left_t,
        given: Some(GivenRectification {
            size: rectified_size,
            rotations: [rotations[0], rotations[1]],
            intrinsics: pair.intrinsics,
            baseline_m: pair.baseline_m(),
        }),
        disparity_correction: None,
    })
}

/// The size of both cameras' images.
fn size(text: &str, base: &str, cameras: [&str; 2]) -> Result<Option<[u32; 2]>> {
    let mut sizes = Vec::new();
    for camera in cameras {
        let name = format!("{base}_{camera}");
        match numbers(text, &name)?.as_deref() {
            None => {}
            Some(&[width, height]) if width >= 1.0 && height >= 1.0 => {
                sizes.push([width as u32, height as u32]);
            }
            Some(_) => return Err(Error::value(name, "is no size of an image", REMEDY)),
        }
    }
    match sizes[..] {
        [left, right] if left != right => Err(Error::value(
            format!("{base}_{} and {base}_{}", cameras[0], cameras[1]),
            "are of different sizes",
            REMEDY,
        )),
        _ => Ok(sizes.first().copied()),
    }
}

/// The numbers of the line of this name; None where there is no such line.
fn numbers(text: &str, name: &str) -> Result<Option<Vec<f64>>> {
    let line = (1..).zip(text.lines()).find_map(|(line_number, line)| {
        let rest = line.trim().strip_prefix(name)?.strip_prefix(':')?;
        Some((line_number, rest))
    });
    let Some((line_number, line)) = line else {
        return Ok(None);
    };
    let name = format!("{name}, line {line_number}");
    line.split_whitespace()
        .map(|word| number(word, &name))
        .collect::<Result<_>>()
        .map(Some)
}

fn required(text: &str, name: &str, rows: usize, columns: usize) -> Result<Matrix> {
    let Some(values) = numbers(text, name)? else {
        return Err(Error::value(name, "is missing", REMEDY));
    };
    if values.len() != rows * columns {
        return Err(Error::value(
            name,
            format!("has {} numbers, not {}", values.len(), rows * columns),
            REMEDY,
        ));
    }
    Ok(Matrix {
        rows,
        columns,
        values,
    })
}
