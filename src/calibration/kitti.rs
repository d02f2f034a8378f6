//! KITTI's calibration files: those of the object and odometry sets (`P0` to `P3`) and the raw
//! recordings' `calib_cam_to_cam.txt`.

use glam::{DMat3, DVec3};

use super::HALF_PIXEL;
use super::entries::{Matrix, number};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, GivenRectification, Intrinsics, LensCamera};

/// The cameras of a rectified pair may stand this much above or ahead of each other, metres: a
/// tenth of a pixel of a car at 20 m. KITTI's own calibrations say 3 mm.
const ASKEW_M: f64 = 0.02;

const REMEDY: &str = "copy the file again from KITTI";

/// Whether a line is one of KITTI's projections, which no other format has.
pub(super) fn is_projection(line: &str) -> bool {
    let Some((name, numbers)) = line.split_once(':') else {
        return false;
    };
    let name = name.strip_prefix("P_rect_0").or(name.strip_prefix('P'));
    let is_camera = name.is_some_and(|number| ["0", "1", "2", "3"].contains(&number));
    // In YAML an entry of that name is a matrix over several lines.
    is_camera && numbers.split_whitespace().count() >= 3 && !numbers.contains(['[', '{', '!'])
}

/// Reads the colour pair's calibration, or the grey one's.
pub(super) fn parse(text: &str, is_grey: bool) -> Result<CalibrationParts> {
    let cameras = if is_grey { [0, 1] } else { [2, 3] };
    if numbers(text, &format!("P_rect_0{}", cameras[0]))?.is_some() {
        return raw(text, cameras);
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
fn raw(text: &str, cameras: [u8; 2]) -> Result<CalibrationParts> {
    let pair = rectified_pair(text, &cameras.map(|camera| format!("P_rect_0{camera}")))?;
    let rectified_size = size(text, "S_rect", cameras)?;
    if numbers(text, &format!("K_0{}", cameras[0]))?.is_none() {
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
        let named = |base: &str| format!("{base}_0{camera}");
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
fn size(text: &str, base: &str, cameras: [u8; 2]) -> Result<Option<[u32; 2]>> {
    let mut sizes = Vec::new();
    for camera in cameras {
        let name = format!("{base}_0{camera}");
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
            format!("{base}_0{} and {base}_0{}", cameras[0], cameras[1]),
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
