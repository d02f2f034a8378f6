//! How two cameras stand to each other, by the names of matrices.

use glam::{DMat3, DVec3};

use super::HALF_PIXEL;
use super::entries::{Entries, Matrix};
use super::named::{PROJECTION, new_size, spelled};
use crate::error::{Error, Result};
use crate::geometry::{GivenRectification, Intrinsics};

const ROTATION: [&str; 5] = ["r", "rotation", "rotationmatrix", "rot", "om"];
const TRANSLATION: [&str; 5] = ["t", "translation", "translationvector", "trans", "tvec"];
const RECTIFYING: [&str; 4] = ["r", "rect", "rectification", "rectificationmatrix"];

/// Rotation and translation between the cameras.
pub(super) fn places(
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
pub(super) fn projections(
    entries: &Entries,
    sides: &[&str; 2],
) -> Result<Option<([Intrinsics; 2], f64)>> {
    // Coefficients of a lens are called p1 and p2 as well.
    let [left, right] = sides.map(|side| {
        let found = entries.numbers(&spelled(&PROJECTION, side));
        found.filter(|(_, matrix)| matrix.values.len() > 1)
    });
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
pub(super) fn given(entries: &Entries, sides: &[&str; 2]) -> Result<Option<GivenRectification>> {
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
