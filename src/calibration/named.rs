//! Matrices by their names, as OpenCV, ROS, Kalibr and others write them into YAML and JSON.
//!
//! The same numbers go by many names. Those of OpenCV's stereo sample are `M1 D1 M2 D2 R T` and
//! `R1 R2 P1 P2`; others say `cameraMatrix1`, `K1`, `camera_matrix_left`, `left: {camera_matrix}`
//! and so on. A base name and a word for the camera, in either order, are enough.

use super::HALF_PIXEL;
use super::documents::documents_of;
use super::entries::{Entries, Matrix};
use super::format::known_list;
use super::places::{given, places, projections};
use crate::error::{Error, Result};
use crate::geometry::{CalibrationParts, Distortion, Intrinsics, LensCamera};

/// Words for the left and the right camera. Those before others win where a file has both.
const SIDES: [[&str; 2]; 10] = [
    ["1", "2"],
    ["left", "right"],
    ["l", "r"],
    ["leftcamera", "rightcamera"],
    ["cameraleft", "cameraright"],
    ["camleft", "camright"],
    ["0", "1"],
    ["cam0", "cam1"],
    ["cam1", "cam2"],
    ["camera1", "camera2"],
];

pub(super) const MATRIX: [&str; 7] = [
    "m",
    "k",
    "cameramatrix",
    "intrinsicmatrix",
    "intrinsics",
    "intrinsic",
    "mtx",
];
const LENS: [&str; 9] = [
    "d",
    "dist",
    "distcoeffs",
    "distcoeff",
    "distcoefs",
    "distortion",
    "distortioncoefficients",
    "distortioncoeffs",
    "distortionvector",
];
pub(super) const PROJECTION: [&str; 4] = ["p", "proj", "projection", "projectionmatrix"];
const SIZE: [&str; 5] = ["imagesize", "size", "resolution", "imsize", "framesize"];
const NEW_SIZE: [&str; 3] = ["newimagesize", "rectifiedsize", "rectifiedimagesize"];

/// Lens models that are OpenCV's, by the names that ROS and Kalibr give them.
const KNOWN_MODELS: [&str; 8] = [
    "plumbbob",
    "rationalpolynomial",
    "radtan",
    "radialtangential",
    "brownconrady",
    "opencv",
    "pinhole",
    "none",
];

/// Reads one file, or two that complete each other.
pub(super) fn parse(texts: &[&str]) -> Result<CalibrationParts> {
    let mut files = Vec::new();
    for text in texts {
        files.extend(documents_of(text)?);
    }
    let mut entries = Entries::default();
    // Two files with one camera each: the first is the left one's.
    if files.len() == 2 && files.iter().all(is_one_camera) {
        for (file, side) in files.into_iter().zip(["left", "right"]) {
            entries.join(file.prefixed(side));
        }
    } else {
        for file in files {
            entries.join(file);
        }
    }
    check_models(&entries)?;
    parts(&entries)
}

/// Whether a file or message is of one camera: has a whole matrix or projection.
pub(super) fn is_one_camera(file: &Entries) -> bool {
    let has = |names: &[&str], counts: &[usize]| {
        let found = file.numbers(names);
        found.is_some_and(|(_, matrix)| counts.contains(&matrix.values.len()))
    };
    has(&MATRIX, &[4, 9, 12]) || has(&PROJECTION, &[12])
}

/// Fisheye and other lenses have other formulas.
fn check_models(entries: &Entries) -> Result<()> {
    let refused = |what: String| {
        Err(Error::value(
            what,
            "only OpenCV's pinhole model with 4, 5 or 8 coefficients is known",
            "calibrate with that model, or rectify the images yourself and give their calibration",
        ))
    };
    for (name, text) in entries.texts() {
        let plain = |text: &str| text.to_lowercase().replace(['_', '-', ' '], "");
        let is_model =
            plain(name).contains("distortionmodel") || plain(name).contains("cameramodel");
        if is_model && !text.is_empty() && !KNOWN_MODELS.contains(&plain(text).as_str()) {
            return refused(format!("{name} {text}"));
        }
        if plain(name).contains("fisheye") && !["0", "false", "no"].contains(&text) {
            return refused(name.to_owned());
        }
    }
    Ok(())
}

/// All spellings of a base name for one camera.
pub(super) fn spelled(bases: &[&str], side: &str) -> Vec<String> {
    bases
        .iter()
        .flat_map(|base| [format!("{base}{side}"), format!("{side}{base}")])
        .collect()
}

fn parts(entries: &Entries) -> Result<CalibrationParts> {
    let matrices = SIDES.iter().find_map(|sides| {
        let [left, right] = sides.map(|side| {
            let found = entries.numbers(&spelled(&MATRIX, side))?;
            let is_matrix = found.1.values.len() >= 4;
            is_matrix.then_some(found)
        });
        Some((sides, [left?, right?]))
    });
    let Some((sides, matrices)) = matrices else {
        if let Some(parts) = projections_alone(entries)? {
            return Ok(parts);
        }
        if let Some(parts) = one_for_both(entries)? {
            return Ok(parts);
        }
        let present: Vec<&str> = entries.names().take(12).collect();
        return Err(Error::value(
            "camera matrices",
            format!(
                "there are none of two cameras among {}",
                if present.is_empty() {
                    "nothing".to_owned()
                } else {
                    present.join(", ")
                }
            ),
            format!(
                "name them M1 and M2, cameraMatrix1 and cameraMatrix2 or camera_matrix_left and \
                 camera_matrix_right; if they are in a file of their own, give both files; {}",
                known_list()
            ),
        ));
    };
    let [left, right] = [0, 1].map(|i| {
        let (name, matrix) = matrices[i];
        Ok(LensCamera {
            intrinsics: intrinsics(name, matrix)?,
            distortion: lens(entries, sides, i)?,
        })
    });
    let given = given(entries, sides)?;
    let (rotation, translation_m) = places(entries, sides, given.as_ref())?;
    Ok(CalibrationParts {
        size: size(entries, sides)?,
        cameras: [left?, right?],
        rotation,
        translation_m,
        given,
        disparity_correction: None,
    })
}

/// The cameras of rectified images, where a file has nothing but their projections.
fn projections_alone(entries: &Entries) -> Result<Option<CalibrationParts>> {
    for sides in &SIDES {
        if let Some((intrinsics, baseline_m)) = projections(entries, sides)? {
            let size = match new_size(entries)? {
                Some(size) => Some(size),
                None => size(entries, sides)?,
            };
            return Ok(Some(CalibrationParts::rectified(
                size, intrinsics, baseline_m,
            )));
        }
    }
    Ok(None)
}

/// The cameras of rectified images, where a file has one camera without a lens and a baseline.
fn one_for_both(entries: &Entries) -> Result<Option<CalibrationParts>> {
    let baseline = entries.numbers(&["baseline", "baselinem"]);
    let (Some((name, matrix)), Some((_, baseline))) = (entries.numbers(&MATRIX), baseline) else {
        return Ok(None);
    };
    let has_lens = entries
        .numbers(&LENS)
        .is_some_and(|(_, lens)| lens.values.iter().any(|value| *value != 0.0));
    let ([baseline_m], false) = (&baseline.values[..], has_lens) else {
        return Ok(None);
    };
    Ok(Some(CalibrationParts::rectified(
        size(entries, &["", ""])?,
        [intrinsics(name, matrix)?; 2],
        *baseline_m,
    )))
}

/// A camera matrix, or Kalibr's four numbers.
fn intrinsics(name: &str, matrix: &Matrix) -> Result<Intrinsics> {
    match matrix.values[..] {
        [fx, fy, cx, cy] if matrix.rows == 1 => Matrix {
            rows: 3,
            columns: 3,
            values: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        }
        .intrinsics(name, HALF_PIXEL),
        // A 3 x 3 matrix in one line, as ROS 2 has it.
        [..] if matrix.values.len() == 9 => Matrix {
            rows: 3,
            columns: 3,
            values: matrix.values.clone(),
        }
        .intrinsics(name, HALF_PIXEL),
        _ => matrix.intrinsics(name, HALF_PIXEL),
    }
}

fn lens(entries: &Entries, sides: &[&str; 2], side: usize) -> Result<Distortion> {
    let [own, other] = [side, 1 - side].map(|i| entries.numbers(&spelled(&LENS, sides[i])));
    match (own, other) {
        (Some((name, coefficients)), _) => Distortion::from_coefficients(&coefficients.values)
            .map_err(|error| match error {
                Error::Value {
                    name: what,
                    problem,
                    remedy,
                } => Error::value(format!("{name}: {what}"), problem, remedy),
                error => error,
            }),
        (None, None) => Ok(Distortion::NONE),
        (None, Some((name, _))) => Err(Error::value(
            name,
            "only one camera has distortion coefficients",
            "give those of both, zeros for a camera without distortion",
        )),
    }
}

/// Two whole numbers, width and height.
pub(super) fn whole_size(name: &str, values: &[f64]) -> Result<[u32; 2]> {
    let whole = |value: f64| {
        (value.fract() == 0.0 && (1.0..=32_768.0).contains(&value)).then_some(value as u32)
    };
    match values {
        [width, height] if whole(*width).is_some() && whole(*height).is_some() => {
            Ok([*width as u32, *height as u32])
        }
        _ => Err(Error::value(
            format!("{name} = {values:?}"),
            "is no size of an image",
            "give width and height in pixels",
        )),
    }
}

pub(super) fn new_size(entries: &Entries) -> Result<Option<[u32; 2]>> {
    let found = entries.numbers(&NEW_SIZE);
    found
        .map(|(name, matrix)| whole_size(name, &matrix.values))
        .transpose()
}

fn size(entries: &Entries, sides: &[&str; 2]) -> Result<Option<[u32; 2]>> {
    let mut sizes = Vec::new();
    for prefix in [sides[0], sides[1], ""] {
        if let Some((name, matrix)) = entries.numbers(&spelled(&SIZE, prefix)) {
            sizes.push((name.to_owned(), whole_size(name, &matrix.values)?));
        }
        let [width, height] = ["width", "height"]
            .map(|side| entries.numbers(&spelled(&[&format!("image{side}"), side], prefix)));
        if let (Some((name, width)), Some((_, height))) = (width, height) {
            let values = [&width.values[..], &height.values].concat();
            sizes.push((name.to_owned(), whole_size(name, &values)?));
        }
    }
    let first = sizes.first().map(|(_, size)| *size);
    match sizes.iter().find(|(_, size)| Some(*size) != first) {
        None => Ok(first),
        Some((name, [width, height])) => Err(Error::value(
            name,
            format!("says {width}x{height} pixels, and another entry another size"),
            "give two cameras with images of the same size",
        )),
    }
}
