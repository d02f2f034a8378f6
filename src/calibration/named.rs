//! Matrices by their names, as OpenCV, ROS, Kalibr and others write them into YAML and JSON.
//!
//! The same numbers go by many names. Those of OpenCV's stereo sample are `M1 D1 M2 D2 R T` and
//! `R1 R2 P1 P2`; others say `cameraMatrix1`, `K1`, `camera_matrix_left`, `left: {camera_matrix}`
//! and so on. A base name and a word for the camera, in either order, are enough.

use glam::{DMat3, DVec3};

use super::HALF_PIXEL;
use super::entries::{Entries, Matrix};
use super::format::known_list;
use crate::error::{Error, Result, yaml_problem};
use crate::geometry::{CalibrationParts, Distortion, GivenRectification, Intrinsics, LensCamera};

/// Of more documents in a file the rest is not looked at.
const MOST_DOCUMENTS: usize = 64;

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

const MATRIX: [&str; 7] = [
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
const ROTATION: [&str; 5] = ["r", "rotation", "rotationmatrix", "rot", "om"];
const TRANSLATION: [&str; 5] = ["t", "translation", "translationvector", "trans", "tvec"];
const RECTIFYING: [&str; 4] = ["r", "rect", "rectification", "rectificationmatrix"];
const PROJECTION: [&str; 4] = ["p", "proj", "projection", "projectionmatrix"];
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
fn is_one_camera(file: &Entries) -> bool {
    let has = |names: &[&str], counts: &[usize]| {
        let found = file.numbers(names);
        found.is_some_and(|(_, matrix)| counts.contains(&matrix.values.len()))
    };
    has(&MATRIX, &[4, 9, 12]) || has(&PROJECTION, &[12])
}

/// What the documents of a file say. Messages that were printed again and again are one, and what
/// broke off after the first is left out.
fn documents_of(text: &str) -> Result<Vec<Entries>> {
    let mut found: Vec<Entries> = Vec::new();
    for document in documents(text) {
        let entries = tree(&document).and_then(|tree| Entries::of(&tree));
        let entries = match entries {
            Ok(entries) => entries,
            Err(_) if !found.is_empty() => break,
            Err(error) => return Err(error),
        };
        let numbers = |entries: &Entries| {
            [&MATRIX[..], &PROJECTION].map(|names| {
                let found = entries.numbers(names);
                found.map(|(_, matrix)| matrix.clone())
            })
        };
        let is_repeated = |known: &Entries| {
            let own = numbers(&entries);
            // One that broke off has not all of them.
            let mut both = own.iter().zip(numbers(known));
            own.iter().any(Option::is_some)
                && both.all(|(own, known)| own.is_none() || *own == known)
        };
        if !found.iter().any(is_repeated) {
            found.push(entries);
        }
    }
    // A message that broke off may still be a document, of no camera.
    if found.iter().any(is_one_camera) {
        found.retain(is_one_camera);
    }
    if found.is_empty() {
        found.push(Entries::default());
    }
    Ok(found)
}

/// The documents that lines of `---` divide, each with empty lines in place of those before it, so
/// that errors name the file's own lines. OpenCV's directive, `%YAML:1.0`, is none of YAML's and is
/// left out.
fn documents(text: &str) -> Vec<String> {
    let mut documents = Vec::new();
    let mut current = String::new();
    let mut has_content = false;
    for (line_number, line) in text.lines().enumerate() {
        let rest = line.strip_prefix("---");
        let ends = rest.is_some_and(|rest| rest.is_empty() || rest.starts_with([' ', '#']));
        if ends && has_content {
            let next = "\n".repeat(line_number + 1);
            documents.push(std::mem::replace(&mut current, next));
            has_content = false;
            continue;
        }
        if !ends && !line.starts_with('%') {
            current.push_str(line);
            has_content |= !line.trim().is_empty() && !line.trim_start().starts_with('#');
        }
        current.push('\n');
        if documents.len() > MOST_DOCUMENTS {
            break;
        }
    }
    if has_content {
        documents.push(current);
    }
    documents
}

/// The tree of a YAML text of one document.
pub(super) fn tree(text: &str) -> Result<serde_json::Value> {
    let body = documents(text).into_iter().next().unwrap_or_default();
    serde_saphyr::from_str(&body).map_err(|error| {
        Error::value(
            "YAML",
            yaml_problem(&error),
            "correct the file, or save it again with OpenCV's FileStorage",
        )
    })
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
fn spelled(bases: &[&str], side: &str) -> Vec<String> {
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

/// Rotation and translation between the cameras.
fn places(
    entries: &Entries,
    sides: &[&str; 2],
    given: Option<&GivenRectification>,
) -> Result<(DMat3, DVec3)> {
    // Kalibr's.
    if let Some((name, matrix)) = entries.numbers(&spelled(&["tcncnm1"], sides[1])) {
        return matrix.transform(name);
    }
    if let Some(place) = by_body(entries, sides)? {
        return Ok(place);
    }
    let rotation = entries
        .numbers(&ROTATION)
        .map(|(name, matrix)| matrix.rotation(name))
        .transpose()?;
    if let Some((name, matrix)) = entries.numbers(&TRANSLATION) {
        let translation_m = matrix.vector(name)?;
        let Some(rotation) = rotation else {
            return Err(Error::value(
                "R",
                "the rotation between the cameras is missing",
                "give R, or T of cameras with parallel axes together with an R of zeros and ones",
            ));
        };
        return Ok((rotation, translation_m));
    }
    if let Some((name, matrix)) = entries.numbers(&["baseline", "baselinem"]) {
        let [baseline_m] = matrix.values[..] else {
            return Err(Error::value(name, "is no single number", "give metres"));
        };
        let translation_m = DVec3::new(-baseline_m, 0.0, 0.0);
        return Ok((rotation.unwrap_or(DMat3::IDENTITY), translation_m));
    }
    // From what both became: `x = R1 p` and `x - (b, 0, 0) = R2 (R p + T)`.
    let Some(given) = given else {
        return Err(Error::value(
            "R and T",
            "how the cameras stand to each other is missing",
            "give the second file too, --calib intrinsics.yml --calib extrinsics.yml, or add R and T",
        ));
    };
    let [left, right] = given.rotations;
    let shift = DVec3::new(-given.baseline_m, 0.0, 0.0);
    Ok((right.transpose() * left, right.transpose() * shift))
}

/// Rotation and translation between cameras that each stand somewhere on a body: `EuRoC`'s from the
/// camera's axes to the body's, Kalibr's from the body's to the camera's.
fn by_body(entries: &Entries, sides: &[&str; 2]) -> Result<Option<(DMat3, DVec3)>> {
    let of_sides = |names: &[&str]| -> Result<Option<[(DMat3, DVec3); 2]>> {
        let [left, right] = sides.map(|side| entries.numbers(&spelled(names, side)));
        let (Some((left_name, left)), Some((right_name, right))) = (left, right) else {
            return Ok(None);
        };
        Ok(Some([
            left.transform(left_name)?,
            right.transform(right_name)?,
        ]))
    };
    if let Some([(left, left_m), (right, right_m)]) = of_sides(&["tbs", "timucam", "tsc"])? {
        let right_from_body = right.transpose();
        return Ok(Some((
            right_from_body * left,
            right_from_body * (left_m - right_m),
        )));
    }
    let Some([(left, left_m), (right, right_m)]) = of_sides(&["tcamimu"])? else {
        return Ok(None);
    };
    let rotation = right * left.transpose();
    Ok(Some((rotation, right_m - rotation * left_m)))
}

/// The cameras of rectified images and the distance between them; None where any of the projections
/// is missing.
fn projections(entries: &Entries, sides: &[&str; 2]) -> Result<Option<([Intrinsics; 2], f64)>> {
    let [left, right] = sides.map(|side| entries.numbers(&spelled(&PROJECTION, side)));
    let (Some(left), Some(right)) = (left, right) else {
        return Ok(None);
    };
    let shaped = |(name, matrix): (&str, &Matrix)| -> Result<(Intrinsics, DVec3)> {
        let matrix = Matrix {
            rows: 3,
            columns: if matrix.values.len() == 12 {
                4
            } else {
                matrix.columns
            },
            values: matrix.values.clone(),
        };
        if matrix.values.len() != 12 {
            return Err(Error::value(
                name,
                format!("has {} numbers, not 12", matrix.values.len()),
                "give the projections of the rectified cameras, 3 x 4",
            ));
        }
        Ok((matrix.intrinsics(name, HALF_PIXEL)?, matrix.offset(name)?))
    };
    let [(left, left_m), (right, right_m)] = [shaped(left)?, shaped(right)?];
    let apart = left_m - right_m;
    if apart == DVec3::ZERO {
        // A monocular calibration has projections, but no stereo ones.
        return Ok(None);
    }
    if apart.y.abs() > apart.x.abs() {
        return Err(Error::value(
            "P1 and P2",
            "the cameras stand one above the other",
            "turn images and calibration by 90 degrees, or use cameras side by side",
        ));
    }
    Ok(Some(([left, right], apart.x)))
}

/// `R1 R2 P1 P2`; None where any of the projections is missing.
fn given(entries: &Entries, sides: &[&str; 2]) -> Result<Option<GivenRectification>> {
    let Some((intrinsics, baseline_m)) = projections(entries, sides)? else {
        return Ok(None);
    };
    let rotation = |i: usize| -> Result<DMat3> {
        let side = sides[i];
        match entries.numbers(&spelled(&RECTIFYING, side)) {
            Some((name, matrix)) if matrix.values.len() == 9 => Matrix {
                rows: 3,
                columns: 3,
                values: matrix.values.clone(),
            }
            .rotation(name),
            Some((name, matrix)) => matrix.rotation(name),
            None => Err(Error::value(
                format!("R{}", i + 1),
                "there are projections of rectified cameras, but not the rotations to them",
                "give R1 and R2 beside P1 and P2, or none of the four",
            )),
        }
    };
    Ok(Some(GivenRectification {
        size: new_size(entries)?,
        rotations: [rotation(0)?, rotation(1)?],
        intrinsics,
        baseline_m,
    }))
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

fn new_size(entries: &Entries) -> Result<Option<[u32; 2]>> {
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
