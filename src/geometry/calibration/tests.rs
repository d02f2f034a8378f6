//! Calibrations that no rig has, and sizes of images.

use super::*;

const SIZE: [u32; 2] = [640, 480];

fn camera() -> LensCamera {
    LensCamera {
        intrinsics: Intrinsics {
            focal_x_px: 500.0,
            focal_y_px: 501.0,
            center_x_px: 322.0,
            center_y_px: 238.0,
        },
        distortion: Distortion::from_coefficients(&[-0.2, 0.05, 0.0, 0.0]).unwrap(),
    }
}

fn parts() -> CalibrationParts {
    CalibrationParts {
        size: Some(SIZE),
        cameras: [camera(); 2],
        rotation: DMat3::IDENTITY,
        translation_m: DVec3::new(-0.2, 0.001, 0.002),
        given: None,
        disparity_correction: None,
    }
}

fn refusal(change: impl FnOnce(&mut CalibrationParts)) -> String {
    let mut changed = parts();
    change(&mut changed);
    StereoCalibration::new(changed, None)
        .unwrap_err()
        .to_string()
}

#[test]
fn rigs_that_cannot_be_are_refused_with_the_reason() {
    StereoCalibration::new(parts(), None).unwrap();
    for (message, words) in [
        (
            refusal(|p| p.translation_m = DVec3::ZERO),
            ["baseline of 0 m", "one place"],
        ),
        (
            refusal(|p| p.translation_m *= 1000.0),
            ["baseline of 200", "millimetres"],
        ),
        (
            refusal(|p| p.translation_m *= 0.01),
            ["baseline of 0.002", "too small"],
        ),
        (
            refusal(|p| p.translation_m.x = 0.2),
            ["swapped", "left camera's axes"],
        ),
        (
            refusal(|p| p.translation_m = DVec3::new(-0.01, 0.2, 0.0)),
            ["one above the other", "90 degrees"],
        ),
        (
            refusal(|p| p.translation_m = DVec3::new(-0.01, 0.0, 0.2)),
            ["one behind the other", "side by side"],
        ),
        (
            refusal(|p| p.translation_m.y = f64::NAN),
            ["NaN", "not finite"],
        ),
        (
            refusal(|p| p.cameras[0].intrinsics.focal_x_px = -500.0),
            ["-500", "left camera"],
        ),
        (
            refusal(|p| p.cameras[1].intrinsics.focal_y_px = 0.0),
            ["500 x 0", "right camera"],
        ),
        (
            refusal(|p| p.cameras[1].intrinsics.focal_y_px = f64::INFINITY),
            ["inf", "not finite"],
        ),
        (
            refusal(|p| p.cameras[0].intrinsics.center_x_px = 700.0),
            ["700", "outside the image of 640x480"],
        ),
        (
            refusal(|p| {
                p.cameras[0].intrinsics.focal_x_px = 4.0;
                p.cameras[0].intrinsics.focal_y_px = 4.0;
            }),
            ["focal length 4 px", "millimetres"],
        ),
        (
            refusal(|p| p.rotation.x_axis.x = 0.5),
            ["rotation R", "is no rotation"],
        ),
        (
            refusal(|p| p.rotation.z_axis.z = -1.0),
            ["rotation R", "reflection"],
        ),
        (
            refusal(|p| p.rotation.z_axis.z = f64::NAN),
            ["rotation R", "not finite"],
        ),
        (
            // Half a turn about y: the right camera looks back.
            refusal(|p| {
                p.rotation = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0));
                p.translation_m = DVec3::new(0.2, 0.0, 0.0);
            }),
            ["R", "45 degrees apart"],
        ),
        (
            refusal(|p| p.size = Some([40_000, 480])),
            ["40000x480", "usable size"],
        ),
    ] {
        for word in words {
            assert!(message.contains(word), "{message} should contain {word}");
        }
    }
}

#[test]
fn a_given_baseline_replaces_the_unit_of_the_file_and_is_checked() {
    let mut in_millimetres = parts();
    in_millimetres.translation_m *= 1000.0;
    let calibration = StereoCalibration::new(in_millimetres, Some(0.2)).unwrap();
    assert!((calibration.baseline_m() - 0.2).abs() < 1e-12);
    assert!(
        (StereoCalibration::new(parts(), Some(12.0))
            .unwrap()
            .baseline_m()
            - 12.0)
            .abs()
            < 1e-9
    );
    for baseline_m in [0.0, -0.2, f64::NAN, f64::INFINITY, 1e6] {
        assert!(
            StereoCalibration::new(parts(), Some(baseline_m)).is_err(),
            "{baseline_m}"
        );
    }
}

#[test]
fn a_rounded_rotation_is_made_exact() {
    let mut rounded = parts();
    rounded.rotation = DMat3::from_cols(
        DVec3::new(0.99992, 0.0121, -0.0034),
        DVec3::new(-0.0121, 0.99993, 0.0001),
        DVec3::new(0.0034, -0.0001, 0.99999),
    );
    let rotation = StereoCalibration::new(rounded, None)
        .unwrap()
        .right_from_left();
    let off = rotation.transpose() * rotation - DMat3::IDENTITY;
    assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-15));
}

#[test]
fn images_of_the_same_shape_are_scaled_and_others_refused() {
    let calibration = StereoCalibration::new(parts(), None).unwrap();
    let half = calibration.for_size([320, 240]).unwrap();
    assert_eq!(half.cameras()[0].intrinsics.focal_x_px, 250.0);
    assert_eq!(half.cameras()[0].intrinsics.center_y_px, 119.0);
    assert_eq!(half.baseline_m(), calibration.baseline_m());
    // 213 x 160 is what programs make of a third.
    calibration.for_size([213, 160]).unwrap();
    for size in [[640, 400], [480, 640], [1242, 375]] {
        let message = calibration.for_size(size).unwrap_err().to_string();
        assert!(message.contains("640x480"), "{message}");
    }
}

#[test]
fn a_calibration_without_size_is_held_against_the_images_by_its_principal_point() {
    let mut sizeless = parts();
    sizeless.size = None;
    let calibration = StereoCalibration::new(sizeless, None).unwrap();
    assert_eq!(calibration.for_size(SIZE).unwrap().size(), Some(SIZE));
    for size in [[320, 240], [1280, 960]] {
        let message = calibration.for_size(size).unwrap_err().to_string();
        assert!(message.contains("principal point"), "{message}");
    }
}

#[test]
fn only_cameras_without_lenses_and_side_by_side_are_rectified_already() {
    let calibration = StereoCalibration::new(parts(), None).unwrap();
    assert!(!calibration.is_rectified());
    let message = calibration.rectified_rig(SIZE).unwrap_err().to_string();
    assert!(message.contains("P1 and P2"), "{message}");
    let plain = StereoCalibration::rectified(None, [camera().intrinsics; 2], 0.2).unwrap();
    let rig = plain.rectified_rig(SIZE).unwrap();
    assert_eq!(rig.baseline_m, 0.2);
    assert_eq!(rig.left.focal_x_px, 500.0);
    assert!(plain.rectified_rig([320, 240]).is_err());
}
