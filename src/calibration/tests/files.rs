//! The forms that are read.

use std::fs;

use glam::{DMat3, DVec3};

use super::*;

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

#[test]
fn opencv_numbers_come_as_they_are_with_the_pixel_origin_moved() {
    let calibration = read(OPENCV);
    assert_eq!(calibration.size(), Some([640, 480]));
    let [left, right] = calibration.cameras();
    assert_eq!(
        [
            left.intrinsics.focal_x_px,
            left.intrinsics.focal_y_px,
            left.intrinsics.center_x_px,
            left.intrinsics.center_y_px
        ],
        [530.0, 531.0, 322.5, 238.5]
    );
    assert_eq!(
        right.distortion.coefficients(),
        [-0.27, 0.07, -0.0004, 0.0002, 0.0, 0.0, 0.0, 0.0]
    );
    assert!(close(calibration.translation_m().x, -0.12));
    // Row 0, column 2 of R.
    assert!((calibration.right_from_left().z_axis.x - 0.01).abs() < 1e-6);
    assert!(!calibration.is_rectified());
}

/// Written by OpenCV 5.0: made-up cameras, `stereoRectify` with alpha 0.
const BY_OPENCV: &str = include_str!("../../../tests/fixtures/stereo_opencv.yml");

#[test]
fn a_file_that_opencv_wrote_rectifies_as_opencv_does() {
    let calibration = read(BY_OPENCV);
    assert_eq!(calibration.size(), Some([640, 480]));
    assert!((calibration.given().unwrap().baseline_m - 0.120_005_2).abs() < 1e-6);
    let rectification =
        crate::geometry::Rectification::new(&calibration, [640, 480], None).unwrap();
    assert!((rectification.rig.focal_px() - 502.540_472).abs() < 1e-5);
    // What `initUndistortRectifyMap` has at these pixels of the rectified images.
    let maps = [
        [
            ([0, 0], [31.573_107, 22.146_322]),
            ([320, 240], [322.027_9, 239.088_87]),
            ([639, 479], [608.777_2, 453.580_9]),
            ([100, 400], [106.445_92, 397.051_82]),
        ],
        [
            ([0, 0], [29.056_236, 23.133_745]),
            ([320, 240], [323.348_2, 239.944_78]),
            ([639, 479], [612.628_9, 453.888_37]),
            ([100, 400], [107.808_09, 399.521_5]),
        ],
    ];
    for (view, map) in rectification.views.iter().zip(maps) {
        for (pixel, expected) in map {
            let center = pixel.map(|v| f64::from(v) + HALF_PIXEL);
            let found = view.pixel_from_rectified(center).unwrap();
            for axis in 0..2 {
                let off = found[axis] - HALF_PIXEL - expected[axis];
                assert!(off.abs() < 1e-3, "{pixel:?}: {found:?} is not {expected:?}");
            }
        }
    }
}

#[test]
fn the_names_that_people_use_are_known() {
    for (left, right) in [
        ("K1", "K2"),
        ("cameraMatrix1", "cameraMatrix2"),
        ("camera_matrix_left", "camera_matrix_right"),
        ("left_camera_matrix", "right_camera_matrix"),
        ("Camera_Matrix_L", "Camera_Matrix_R"),
        ("K_0", "K_1"),
        ("mtx_left", "mtx_right"),
    ] {
        let lens = |name: &str| match name {
            "K1" => ["dist1", "dist2"],
            "K_0" => ["D_0", "D_1"],
            "Camera_Matrix_L" => ["dist_coeffs_l", "dist_coeffs_r"],
            "cameraMatrix1" => ["distCoeffs1", "distCoeffs2"],
            _ => [
                "distortion_coefficients_left",
                "distortion_coefficients_right",
            ],
        };
        let [lens_left, lens_right] = lens(left);
        let text = OPENCV
            .replace("M1:", &format!("{left}:"))
            .replace("M2:", &format!("{right}:"))
            .replace("D1:", &format!("{lens_left}:"))
            .replace("D2:", &format!("{lens_right}:"));
        assert_eq!(read(&text), read(OPENCV), "{left}");
    }
    let text = OPENCV
        .replace("R:", "rotation_matrix:")
        .replace("T:", "Translation_Vector:")
        .replace(
            "image_width: 640\nimage_height: 480",
            "imageSize: [ 640, 480 ]",
        );
    assert_eq!(read(&text), read(OPENCV));
}

#[test]
fn lists_and_cameras_as_tables_are_read_as_well() {
    let text = "
size: [640, 480]
left:
  camera_matrix: [[530, 0, 322], [0, 531, 238], [0, 0, 1]]
  distortion: [-0.28, 0.08, 0.0012, -0.0001, 0]
right:
  camera_matrix: [[532, 0, 318], [0, 533, 241], [0, 0, 1]]
  distortion: [-0.27, 0.07, -0.0004, 0.0002, 0]
R: [[0.99995, 0, 0.01], [0, 1, 0], [-0.01, 0, 0.99995]]
T: [-0.12, 0.001, -0.0005]
";
    assert_eq!(read(text), read(OPENCV));
    // The rotation as a vector: 0.01 rad about y.
    let vector = text.replace(
        "R: [[0.99995, 0, 0.01], [0, 1, 0], [-0.01, 0, 0.99995]]",
        "R: [0, 0.01, 0]",
    );
    let off = read(&vector).right_from_left() - read(OPENCV).right_from_left();
    assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-6));
}

#[test]
fn two_files_complete_each_other_in_any_order_and_one_alone_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let at = OPENCV.find("R: ").unwrap();
    let (intrinsics, extrinsics) = (
        folder.path().join("intrinsics.yml"),
        folder.path().join("extrinsics.yml"),
    );
    fs::write(&intrinsics, &OPENCV[..at]).unwrap();
    fs::write(&extrinsics, format!("%YAML:1.0\n---\n{}", &OPENCV[at..])).unwrap();
    let options = LoadOptions::default();
    for pair in [[&intrinsics, &extrinsics], [&extrinsics, &intrinsics]] {
        assert_eq!(load(&pair, &options).unwrap(), read(OPENCV));
    }
    let message = load(&[&intrinsics], &options).unwrap_err().to_string();
    assert!(
        message.contains("intrinsics.yml") && message.contains("extrinsics.yml"),
        "{message}"
    );
    let message = load(&[&extrinsics], &options).unwrap_err().to_string();
    assert!(message.contains("give both files"), "{message}");
}

/// One camera as ROS writes it; the right one's projection holds the baseline.
fn camera_info(projection_x: f64) -> String {
    format!(
        "image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [530, 0, 320, 0, 530, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0.05, 0, 0, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [500, 0, 321, {projection_x}, 0, 500, 239, 0, 0, 0, 1, 0]
"
    )
}

#[test]
fn two_ros_files_are_the_left_and_the_right_camera() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["left.yaml", "right.yaml"].map(|name| folder.path().join(name));
    fs::write(&paths[0], camera_info(0.0)).unwrap();
    fs::write(&paths[1], camera_info(-60.0)).unwrap();
    let calibration = load(&paths, &LoadOptions::default()).unwrap();
    assert!(close(calibration.baseline_m(), 0.12));
    assert_eq!(calibration.right_from_left(), DMat3::IDENTITY);
    let given = calibration.given().unwrap();
    assert_eq!(given.intrinsics[1].focal_x_px, 500.0);
    assert_eq!(given.intrinsics[0].center_x_px, 321.5);

    let [left, right] = paths;
    let message = load(&[right, left], &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(message.contains("swapped"), "{message}");
}

#[test]
fn kalibr_chains_are_read() {
    let text = "
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.08, 0.0012, -0.0001]
  distortion_model: radtan
  intrinsics: [530.0, 531.0, 322.0, 238.0]
  resolution: [640, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.12]
  - [0.0, 1.0, 0.0, 0.001]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.27, 0.07, -0.0004, 0.0002]
  distortion_model: radtan
  intrinsics: [532.0, 533.0, 318.0, 241.0]
  resolution: [640, 480]
";
    let calibration = read(text);
    assert_eq!(calibration.size(), Some([640, 480]));
    assert_eq!(calibration.cameras()[0], read(OPENCV).cameras()[0]);
    assert_eq!(calibration.translation_m(), DVec3::new(-0.12, 0.001, 0.0));
}

/// Four cameras like KITTI's object set, with round numbers.
const KITTI: &str = "P0: 700 0 600 0 0 700 170 0 0 0 1 0
P1: 700 0 600 -350 0 700 170 0 0 0 1 0
P2: 7.0e+02 0 600 42 0 700 170 0.2 0 0 1 0.003
P3: 700 0 600 -308 0 700 170 1.6 0 0 1 0.003
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0
";

#[test]
fn kitti_gives_the_colour_pair_or_the_grey_one() {
    let colour = read(KITTI);
    assert!(colour.is_rectified() && colour.size().is_none());
    assert!(close(colour.baseline_m(), 0.5));
    assert_eq!(colour.cameras()[0].intrinsics.center_y_px, 170.5);
    let text = KITTI.replace("P1: 700 0 600 -350", "P1: 700 0 600 -280");
    let options = LoadOptions {
        kitti_grey: true,
        ..LoadOptions::default()
    };
    assert!(close(from_text(&text, &options).unwrap().baseline_m(), 0.4));
}

/// Two colour cameras like those of KITTI's raw recordings, with round numbers.
const KITTI_RAW: &str = "calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_02: 1392 512
K_02: 960 0 690 0 955 240 0 0 1
D_02: -0.37 0.2 0.0006 0.0007 -0.06
R_02: 1 0 0 0 1 0 0 0 1
T_02: 0.06 0 0
S_rect_02: 1242 375
R_rect_02: 1 0 0 0 1 0 0 0 1
P_rect_02: 720 0 610 43.2 0 720 173 0 0 0 1 0
S_03: 1392 512
K_03: 900 0 690 0 895 250 0 0 1
D_03: -0.36 0.18 0.0004 -0.0002 -0.05
R_03: 1 0 0 0 1 0 0 0 1
T_03: -0.44 0 0
S_rect_03: 1242 375
R_rect_03: 1 0 0 0 1 0 0 0 1
P_rect_03: 720 0 610 -316.8 0 720 173 0 0 0 1 0
";

#[test]
fn kitti_raw_serves_both_kinds_of_image_by_their_size() {
    let calibration = read(KITTI_RAW);
    assert!(close(calibration.baseline_m(), 0.5));
    let options = RigOptions::default();
    let unrectified = CalibratedRig::new(&calibration, [1392, 512], options).unwrap();
    assert!(unrectified.rectifies());
    let rectified = CalibratedRig::new(&calibration, [1242, 375], options).unwrap();
    assert!(!rectified.rectifies());
    assert_eq!(unrectified.rig(), rectified.rig());
    assert_eq!(
        [rectified.rig().left.width, rectified.rig().left.height],
        [1242, 375]
    );
    assert!(close(rectified.rig().focal_px(), 720.0));
    let message = CalibratedRig::new(&calibration, [1000, 800], options).unwrap_err();
    assert!(message.to_string().contains("1392x512"), "{message}");
}

#[test]
fn a_matrix_and_a_baseline_in_two_lines_are_a_rectified_rig() {
    for text in [
        "754.6 0.0 489.3 0.0 754.6 265.8 0.0 0.0 1.0\n0.063\n",
        "# fx 0 cx 0 fy cy 0 0 1\n754.6, 0, 489.3, 0, 754.6, 265.8, 0, 0, 1\n\n0.063 # metres\n",
        "[754.6 0 489.3\n 0 754.6 265.8\n 0 0 1]\n0.063",
    ] {
        let calibration = read(text);
        assert!(calibration.is_rectified());
        assert!(close(calibration.baseline_m(), 0.063));
        let rig = calibration.rectified_rig([960, 540]).unwrap();
        assert!(close(rig.left.center_x_px, 489.8) && close(rig.focal_px(), 754.6));
    }
    let options = LoadOptions {
        baseline_m: Some(0.1),
        ..LoadOptions::default()
    };
    let matrix_alone = "754.6 0.0 489.3 0.0 754.6 265.8 0.0 0.0 1.0";
    assert!(close(
        from_text(matrix_alone, &options).unwrap().baseline_m(),
        0.1
    ));
}

#[test]
fn toml_is_in_our_units_and_a_dataset_is_a_calibration() {
    let text = "
width = 640
height = 480
translation_m = [-0.12, 0.001, -0.0005]
rotation = [[0.99995, 0.0, 0.01], [0.0, 1.0, 0.0], [-0.01, 0.0, 0.99995]]
[left]
focal_x_px = 530.0
focal_y_px = 531.0
center_x_px = 322.5
center_y_px = 238.5
distortion = [-0.28, 0.08, 0.0012, -0.0001, 0.0]
[right]
focal_x_px = 532.0
focal_y_px = 533.0
center_x_px = 318.5
center_y_px = 241.5
distortion = [-0.27, 0.07, -0.0004, 0.0002, 0.0]
";
    assert_eq!(read(text), read(OPENCV));
    let rig = "version = 1\nclasses = [\"car\"]\n[rig]\nwidth = 640\nheight = 360\nhfov_deg = 90.0\nbaseline_m = 0.8\n";
    let rig = read(rig).rectified_rig([640, 360]).unwrap();
    assert_eq!(
        rig,
        crate::geometry::StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap()
    );
}

#[test]
fn a_byte_order_mark_and_foreign_line_ends_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stereo.yml");
    fs::write(&path, format!("\u{feff}{}", OPENCV.replace('\n', "\r\n"))).unwrap();
    assert_eq!(
        load(&[&path], &LoadOptions::default()).unwrap(),
        read(OPENCV)
    );
}

#[test]
fn a_baseline_given_beside_a_file_in_millimetres_makes_it_metres() {
    let text = OPENCV.replace("[ -1.2e-01, 1.0e-03, -5.0e-04 ]", "[ -120., 1., -0.5 ]");
    assert!(refusal(&text).contains("millimetres"));
    let options = LoadOptions {
        baseline_m: Some(read(OPENCV).baseline_m()),
        ..LoadOptions::default()
    };
    let calibration = from_text(&text, &options).unwrap();
    let off = calibration.translation_m() - read(OPENCV).translation_m();
    assert!(off.length() < 1e-12);
}

#[test]
fn a_disparity_correction_belongs_to_the_rectified_images_of_any_size() {
    let rig = "width = 1280
height = 720
hfov_deg = 90
baseline_m = 0.5
";
    let table = "[disparity_correction]
focal_px = 640
constant_px = -0.4
constant_std_px = 0.2
xx_px = 1.6
";
    let calibration = read(&format!("{rig}{table}"));
    let corrected = |size: [u32; 2]| {
        let rig = CalibratedRig::new(&calibration, size, RigOptions::default()).unwrap();
        *rig.disparity_correction().unwrap()
    };
    let whole = corrected([1280, 720]);
    assert!(close(whole.delta_px([640.0, 360.0]), -0.4) && close(whole.std_px(), 0.2));
    assert!(close(whole.delta_px([1280.0, 100.0]), 1.2));
    assert!(close(corrected([640, 360]).delta_px([640.0, 50.0]), 0.6));
    let none = CalibratedRig::new(&read(rig), [1280, 720], RigOptions::default()).unwrap();
    assert_eq!(none.disparity_correction(), None);

    let refused = refusal(&format!("{rig}{table}xx_pixels = 3"));
    assert!(refused.contains("xx_pixels"), "{refused}");
    let refused = refusal(&format!("{rig}{table}y_px = 900.0"));
    assert!(refused.contains("y_px = 900"), "{refused}");
}
