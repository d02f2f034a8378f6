//! Laws of rectification, on points projected through real cameras.

use super::*;
use crate::geometry::{CalibrationParts, LensCamera};

/// A rotation by these angles about x, y and z, radians.
fn turned(x: f64, y: f64, z: f64) -> DMat3 {
    let (sx, cx) = (libm::sin(x), libm::cos(x));
    let (sy, cy) = (libm::sin(y), libm::cos(y));
    let (sz, cz) = (libm::sin(z), libm::cos(z));
    let about_x = DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, cx, sx, 0.0, -sx, cx]);
    let about_y = DMat3::from_cols_array(&[cy, 0.0, -sy, 0.0, 1.0, 0.0, sy, 0.0, cy]);
    let about_z = DMat3::from_cols_array(&[cz, sz, 0.0, -sz, cz, 0.0, 0.0, 0.0, 1.0]);
    about_x * about_y * about_z
}

fn intrinsics(focal: [f64; 2], center: [f64; 2]) -> Intrinsics {
    Intrinsics {
        focal_x_px: focal[0],
        focal_y_px: focal[1],
        center_x_px: center[0],
        center_y_px: center[1],
    }
}

const SIZE: [u32; 2] = [1024, 576];

/// Between the points that follow the border it bends by hundredths of a pixel.
const BEND: f64 = 0.05;

/// Two unequal cameras with lenses, 0.5 m apart, turned and shifted against each other.
fn parts(coefficients: [&[f64]; 2]) -> CalibrationParts {
    let rotation = turned(0.02, -0.035, 0.015);
    let camera = |focal, center, coefficients| LensCamera {
        intrinsics: intrinsics(focal, center),
        distortion: Distortion::from_coefficients(coefficients).unwrap(),
    };
    CalibrationParts {
        size: Some(SIZE),
        cameras: [
            camera([620.0, 622.5], [520.3, 280.1], coefficients[0]),
            camera([634.0, 633.0], [505.0, 296.4], coefficients[1]),
        ],
        rotation,
        translation_m: rotation * DVec3::new(-0.5, 0.012, -0.02),
        given: None,
        disparity_correction: None,
    }
}

const LENSES: [[&[f64]; 2]; 4] = [
    [&[], &[]],
    [
        &[-0.28, 0.08, 0.001, -0.0005],
        &[-0.31, 0.1, -0.0012, 0.0004],
    ],
    [
        &[-0.30, 0.12, 0.0006, 0.001, -0.02],
        &[-0.27, 0.09, 0.0, -0.0011, -0.01],
    ],
    [
        &[0.9, 0.3, 0.0002, -0.0001, 0.02, 1.25, 0.52, 0.06],
        &[0.7, 0.2, -0.0003, 0.0004, 0.01, 1.0, 0.4, 0.05],
    ],
];

/// A point of the left camera's axes as both real cameras see it.
fn seen(parts: &CalibrationParts, point: DVec3) -> [[f64; 2]; 2] {
    [point, parts.rotation * point + parts.translation_m]
        .into_iter()
        .zip(&parts.cameras)
        .map(|(p, camera)| {
            let [x, y] = camera.distortion.distorted([p.x / p.z, p.y / p.z]);
            let plain = camera.intrinsics.camera(SIZE[0], SIZE[1]);
            plain.pixel_from_camera([x, y, 1.0]).unwrap()
        })
        .collect::<Vec<_>>()
        .try_into()
        .unwrap()
}

/// Points over the whole view, 3 to 150 m away.
fn points() -> impl Iterator<Item = DVec3> {
    (0..400u32).map(|i| {
        let i = f64::from(i);
        let z = 3.0 + 147.0 * (i / 399.0) * (i / 399.0);
        DVec3::new(
            z * 0.6 * libm::sin(1.7 * i),
            z * 0.3 * libm::cos(2.9 * i),
            z,
        )
    })
}

#[test]
fn points_lie_on_equal_rows_and_their_disparity_is_their_depth() {
    for coefficients in LENSES {
        let parts = parts(coefficients);
        let calibration = StereoCalibration::new(parts, None).unwrap();
        for alpha in [None, Some(0.0), Some(0.4), Some(1.0)] {
            let rectification = Rectification::new(&calibration, SIZE, alpha).unwrap();
            let [left_view, right_view] = &rectification.views;
            let rectified_from_left = left_view.camera_from_rectified.transpose();
            for point in points() {
                let [left, right] = seen(&parts, point);
                let left = left_view.rectified_from_pixel(left).unwrap();
                let right = right_view.rectified_from_pixel(right).unwrap();
                assert!((left[1] - right[1]).abs() < 1e-6, "{left:?} {right:?}");
                let disparity_px = rectification.rig.disparity_of_pixels(left[0], right[0]);
                let z = (rectified_from_left * point).z;
                let depth_m = rectification.rig.depth_m(disparity_px);
                assert!((depth_m / z - 1.0).abs() < 1e-6, "{depth_m} is not {z}");
            }
        }
    }
}

#[test]
fn the_ways_between_both_images_invert_each_other() {
    for coefficients in LENSES {
        let calibration = StereoCalibration::new(parts(coefficients), None).unwrap();
        let rectification = Rectification::new(&calibration, SIZE, None).unwrap();
        for view in rectification.views {
            for (x, y) in [(0.5, 0.5), (512.0, 288.0), (1023.5, 575.5), (900.0, 11.0)] {
                let pixel = view.pixel_from_rectified([x, y]).unwrap();
                let back = view.rectified_from_pixel(pixel).unwrap();
                assert!((back[0] - x).abs() < 1e-6 && (back[1] - y).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn without_black_borders_every_pixel_is_seen_and_with_them_every_seen_pixel_is_kept() {
    for coefficients in LENSES {
        let calibration = StereoCalibration::new(parts(coefficients), None).unwrap();
        let full = Rectification::new(&calibration, SIZE, Some(0.0)).unwrap();
        let whole = Rectification::new(&calibration, SIZE, Some(1.0)).unwrap();
        assert!(full.rig.focal_px() > whole.rig.focal_px());
        let (width, height) = (f64::from(SIZE[0]), f64::from(SIZE[1]));
        let holds = |[x, y]: [f64; 2]| {
            (-BEND..=width + BEND).contains(&x) && (-BEND..=height + BEND).contains(&y)
        };
        for i in 0..=40 {
            for j in 0..=40 {
                let pixel = [width * f64::from(i) / 40.0, height * f64::from(j) / 40.0];
                for side in 0..2 {
                    let source = full.views[side].pixel_from_rectified(pixel).unwrap();
                    assert!(holds(source), "{pixel:?} comes from {source:?}");
                    let target = whole.views[side].rectified_from_pixel(pixel).unwrap();
                    assert!(holds(target), "{pixel:?} goes to {target:?}");
                }
            }
        }
    }
}

#[test]
fn cameras_that_are_a_rig_already_stay_one() {
    let same = intrinsics([700.0, 700.0], [512.0, 288.0]);
    let calibration = StereoCalibration::rectified(Some(SIZE), [same; 2], 0.3).unwrap();
    assert!(calibration.is_rectified());
    let rectification = Rectification::new(&calibration, SIZE, None).unwrap();
    assert!((rectification.rig.focal_px() - 700.0).abs() < 1e-9);
    assert_eq!(rectification.rig.baseline_m, 0.3);
    let pixel = rectification.views[1]
        .pixel_from_rectified([3.5, 500.5])
        .unwrap();
    assert!((pixel[0] - 3.5).abs() < 1e-9 && (pixel[1] - 500.5).abs() < 1e-9);
}

#[test]
fn halved_images_have_half_the_focal_length_and_the_same_depth() {
    let parts = parts(LENSES[1]);
    let calibration = StereoCalibration::new(parts, None).unwrap();
    let whole = Rectification::new(&calibration, SIZE, None).unwrap();
    let half = Rectification::new(&calibration, [512, 288], None).unwrap();
    assert!((whole.rig.focal_px() / half.rig.focal_px() - 2.0).abs() < 1e-9);
    for point in points() {
        let [left, right] = seen(&parts, point).map(|[x, y]| [x / 2.0, y / 2.0]);
        let left = half.views[0].rectified_from_pixel(left).unwrap();
        let right = half.views[1].rectified_from_pixel(right).unwrap();
        let z = (half.views[0].camera_from_rectified.transpose() * point).z;
        assert!(
            (half
                .rig
                .depth_m(half.rig.disparity_of_pixels(left[0], right[0]))
                / z
                - 1.0)
                .abs()
                < 1e-6
        );
    }
    let message = Rectification::new(&calibration, [1024, 768], None)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("1024x768") && message.contains("1024x576"),
        "{message}"
    );
}

#[test]
fn a_given_rectification_is_used_and_one_that_contradicts_the_cameras_is_refused() {
    let parts = parts(LENSES[2]);
    let own = Rectification::new(
        &StereoCalibration::new(parts, None).unwrap(),
        SIZE,
        Some(0.5),
    )
    .unwrap();
    let camera = own.rig.left;
    let given = crate::geometry::GivenRectification {
        size: None,
        rotations: own.views.map(|view| view.camera_from_rectified.transpose()),
        intrinsics: [intrinsics(
            [camera.focal_x_px, camera.focal_y_px],
            [camera.center_x_px, camera.center_y_px],
        ); 2],
        baseline_m: own.rig.baseline_m,
    };
    let with = |given| {
        StereoCalibration::new(
            CalibrationParts {
                given: Some(given),
                ..parts
            },
            None,
        )
    };
    let used = Rectification::new(&with(given).unwrap(), SIZE, None).unwrap();
    assert!((used.rig.focal_px() - own.rig.focal_px()).abs() < 1e-9);
    let [a, b] = [&used, &own].map(|r| r.views[1].pixel_from_rectified([30.0, 40.0]).unwrap());
    assert!((a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9);

    let mut swapped = given;
    swapped.rotations.swap(0, 1);
    let mut other_unit = given;
    other_unit.baseline_m *= 1000.0;
    let mut uneven = given;
    uneven.intrinsics[1].center_y_px += 3.0;
    for (wrong, word) in [
        (swapped, "R1, R2"),
        (other_unit, "beside each other"),
        (uneven, "different heights"),
    ] {
        let message = with(wrong).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    }
}

#[test]
fn cameras_that_see_nothing_in_common_and_senseless_alphas_are_refused() {
    let mut parts = parts(LENSES[0]);
    for alpha in [-0.1, 1.1, f64::NAN] {
        let calibration = StereoCalibration::new(parts, None).unwrap();
        let message = Rectification::new(&calibration, SIZE, Some(alpha)).unwrap_err();
        assert!(message.to_string().contains("alpha"), "{message}");
    }
    for camera in &mut parts.cameras {
        camera.intrinsics.focal_x_px = 4000.0;
        camera.intrinsics.focal_y_px = 4000.0;
    }
    parts.rotation = turned(0.0, 0.6, 0.0);
    parts.translation_m = parts.rotation * DVec3::new(-0.5, 0.0, 0.0);
    let calibration = StereoCalibration::new(parts, None).unwrap();
    let message = Rectification::new(&calibration, SIZE, None).unwrap_err();
    assert!(message.to_string().contains("in common"), "{message}");
}
