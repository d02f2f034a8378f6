//! Pictures of a known scene, taken through lenses and rectified.

use glam::{DMat3, DVec3};
use image::{Rgb, RgbImage};

use super::*;
use crate::geometry::{
    CalibrationParts, Camera, Distortion, Intrinsics, LensCamera, PixelBox, Rectification,
    RectifiedView,
};
use crate::pairing::PairingConfig;
use crate::pairing::search::disparity_px;

const SIZE: [u32; 2] = [512, 288];

/// Distance of a wall with a smooth, lively pattern, metres; it stands square to the left camera.
const WALL_M: f64 = 12.0;

/// The wall's colour at a place on it, metres.
fn wall(x: f64, y: f64) -> [f64; 3] {
    let wave = |phase: f64, a: f64, b: f64| libm::sin(a * x + b * y + phase);
    let sum =
        wave(0.3, 1.1, 0.4) + wave(1.9, -0.7, 1.3) + wave(2.2, 2.3, 0.9) + wave(0.9, 0.5, -2.1);
    [0.0, 0.7, 1.9].map(|phase| 128.0 + 24.0 * sum + 20.0 * wave(phase, 0.9, 1.7))
}

/// What a camera sees of the wall: `ray` gives the direction of a pixel in the camera's axes, and the
/// camera stands at `place` in the left camera's axes, turned by `camera_from_left`.
fn picture(
    ray: impl Fn([f64; 2]) -> Option<DVec3>,
    camera_from_left: DMat3,
    place: DVec3,
) -> RgbImage {
    const PARTS: u32 = 3;
    RgbImage::from_fn(SIZE[0], SIZE[1], |column, row| {
        let mut sum = DVec3::ZERO;
        for i in 0..PARTS * PARTS {
            let part = |i: u32| (f64::from(i) + 0.5) / f64::from(PARTS);
            let pixel = [
                f64::from(column) + part(i % PARTS),
                f64::from(row) + part(i / PARTS),
            ];
            if let Some(ray) = ray(pixel) {
                let ray = camera_from_left.transpose() * ray;
                let hit = place + ray * ((WALL_M - place.z) / ray.z);
                sum += DVec3::from_array(wall(hit.x, hit.y));
            }
        }
        let mean = sum / f64::from(PARTS * PARTS);
        Rgb(mean.to_array().map(|v| v.round().clamp(0.0, 255.0) as u8))
    })
}

fn calibration() -> StereoCalibration {
    let camera = |focal_px, center: [f64; 2], coefficients: &[f64]| LensCamera {
        intrinsics: Intrinsics {
            focal_x_px: focal_px,
            focal_y_px: focal_px + 1.0,
            center_x_px: center[0],
            center_y_px: center[1],
        },
        distortion: Distortion::from_coefficients(coefficients).unwrap(),
    };
    let (s, c) = (libm::sin(0.02), libm::cos(0.02));
    let rotation = DMat3::from_cols(DVec3::new(c, s, 0.0), DVec3::new(-s, c, 0.0), DVec3::Z);
    let parts = CalibrationParts {
        size: Some(SIZE),
        cameras: [
            camera(300.0, [258.0, 141.0], &[-0.25, 0.06, 0.001, -0.0007, 0.0]),
            camera(306.0, [251.0, 147.0], &[-0.22, 0.05, -0.0008, 0.0005]),
        ],
        rotation,
        translation_m: rotation * DVec3::new(-0.4, 0.008, 0.015),
        given: None,
        disparity_correction: None,
    };
    StereoCalibration::new(parts, None).unwrap()
}

/// The wall through both real cameras.
fn taken(calibration: &StereoCalibration) -> [RgbImage; 2] {
    let ray = |camera: &LensCamera| {
        let plain = camera.intrinsics.camera(SIZE[0], SIZE[1]);
        let lens = camera.distortion;
        let widest = lens.widest();
        move |pixel: [f64; 2]| {
            let [x, y, _] = plain.camera_from_pixel(pixel);
            let [x, y] = lens.undistorted_within([x, y], widest)?;
            Some(DVec3::new(x, y, 1.0))
        }
    };
    let [left, right] = calibration.cameras();
    [
        picture(ray(left), DMat3::IDENTITY, DVec3::ZERO),
        picture(
            ray(right),
            calibration.right_from_left(),
            calibration.right_camera_m(),
        ),
    ]
}

/// The wall as ideal cameras would show it in the place of the rectified ones.
fn ideal(rectification: &Rectification, calibration: &StereoCalibration) -> [RgbImage; 2] {
    let [left, right] = &rectification.views;
    let ray = |camera: Camera| {
        move |pixel: [f64; 2]| Some(DVec3::from_array(camera.camera_from_pixel(pixel)))
    };
    let turned = |view: &RectifiedView| view.camera_from_rectified.transpose();
    [
        picture(ray(left.rectified), turned(left), DVec3::ZERO),
        picture(
            ray(right.rectified),
            turned(right) * calibration.right_from_left(),
            calibration.right_camera_m(),
        ),
    ]
}

#[test]
fn a_picture_taken_through_a_lens_and_rectified_is_that_of_an_ideal_camera() {
    let calibration = calibration();
    let calibrated = CalibratedRig::new(&calibration, SIZE, RigOptions::default()).unwrap();
    let rectification = Rectification::new(&calibration, SIZE, None).unwrap();
    assert_eq!(calibrated.rig(), &rectification.rig);
    assert_eq!(calibrated.black_shares(), [0.0; 2]);
    let rectified = calibrated.rectify(taken(&calibration)).unwrap();
    for (rectified, ideal) in rectified.iter().zip(&ideal(&rectification, &calibration)) {
        let differences = rectified.as_raw().iter().zip(ideal.as_raw());
        let differences: Vec<f64> = differences
            .map(|(a, b)| f64::from(a.abs_diff(*b)))
            .collect();
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        let worst = differences.iter().copied().fold(0.0, f64::max);
        // Rounding to levels twice, and the curvature of the pattern between pixels.
        assert!(mean < 0.6 && worst <= 4.0, "mean {mean}, worst {worst}");
    }
    // Without rectification it is another picture.
    let [left, _] = taken(&calibration);
    let off = left.as_raw().iter().zip(rectified[0].as_raw());
    let mean = off.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / left.len() as f64;
    assert!(mean > 5.0, "{mean}");
}

#[test]
fn matching_in_rectified_pictures_measures_the_wall() {
    let calibration = calibration();
    let calibrated = CalibratedRig::new(&calibration, SIZE, RigOptions::default()).unwrap();
    let rectification = Rectification::new(&calibration, SIZE, None).unwrap();
    let [left, right] = calibrated.rectify(taken(&calibration)).unwrap();
    let rig = calibrated.rig();
    let mut count = 0;
    for (x, y) in [
        (120.0, 70.0),
        (256.0, 144.0),
        (400.0, 200.0),
        (300.0, 60.0),
        (180.0, 220.0),
    ] {
        let area = PixelBox::from_center([x, y], 60.0, 60.0);
        let Some(found) = disparity_px([&left, &right], &area, rig, &PairingConfig::default())
        else {
            continue;
        };
        // The wall's depth in rectified axes at that pixel.
        let view = &rectification.views[0];
        let ray = DVec3::from_array(rig.left.camera_from_pixel([x, y]));
        let depth_m = WALL_M / (view.camera_from_rectified * ray).z;
        let error = rig.depth_m(found) / depth_m - 1.0;
        assert!(error.abs() < 0.02, "{error} at {x} {y}");
        count += 1;
    }
    assert!(count >= 3, "{count} of 5 places were matched");
}

#[test]
fn rectified_images_and_identity_maps_leave_every_byte() {
    let [left, right] = taken(&calibration());
    let intrinsics = Intrinsics {
        focal_x_px: 300.0,
        focal_y_px: 300.0,
        center_x_px: 256.0,
        center_y_px: 144.0,
    };
    let plain = StereoCalibration::rectified(Some(SIZE), [intrinsics; 2], 0.4).unwrap();
    for images in [
        ImageState::Auto,
        ImageState::Rectified,
        ImageState::Unrectified,
    ] {
        let options = RigOptions {
            images,
            alpha: None,
        };
        let calibrated = CalibratedRig::new(&plain, SIZE, options).unwrap();
        assert_eq!(calibrated.rectifies(), images == ImageState::Unrectified);
        let same = calibrated.rectify([left.clone(), right.clone()]).unwrap();
        assert!(same == [left.clone(), right.clone()], "{images:?}");
    }
}

#[test]
fn black_borders_appear_where_everything_is_kept() {
    let calibration = calibration();
    let options = RigOptions {
        alpha: Some(1.0),
        ..RigOptions::default()
    };
    let calibrated = CalibratedRig::new(&calibration, SIZE, options).unwrap();
    let [left, right] = calibrated.black_shares();
    assert!((0.02..0.5).contains(&left) && (0.02..0.5).contains(&right));
    let [image, _] = calibrated.rectify(taken(&calibration)).unwrap();
    assert_eq!(image.get_pixel(0, 0).0, [0; 3]);
}

#[test]
fn images_of_another_size_than_prepared_for_are_refused() {
    let calibrated = CalibratedRig::new(&calibration(), SIZE, RigOptions::default()).unwrap();
    let small = RgbImage::new(256, 144);
    let message = calibrated.rectify([small.clone(), small]).unwrap_err();
    assert!(message.to_string().contains("256x144"), "{message}");
    let half = CalibratedRig::new(&calibration(), [256, 144], RigOptions::default()).unwrap();
    assert_eq!(half.scaled_from(), Some(SIZE));
    assert!(half.note().is_some());
}
