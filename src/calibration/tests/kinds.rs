//! Calibrations as cameras and datasets come with them, kind by kind, with the right numbers.

use std::fs;

use glam::DVec3;

use super::*;
use crate::geometry::StereoRig;

/// The rig of images of this size.
fn rig_of(text: &str, size: [u32; 2]) -> StereoRig {
    let options = LoadOptions {
        image_size: Some(size),
        ..LoadOptions::default()
    };
    let calibration = from_text(text, &options).unwrap();
    let rig = CalibratedRig::new(&calibration, size, RigOptions::default()).unwrap();
    assert!(!rig.rectifies(), "{text}");
    *rig.rig()
}

/// Two files, in this order.
fn pair(left: &str, right: &str) -> Result<StereoCalibration> {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["left.yaml", "right.yaml"].map(|name| folder.path().join(name));
    fs::write(&paths[0], left).unwrap();
    fs::write(&paths[1], right).unwrap();
    load(&paths, &LoadOptions::default())
}

/// What all rectified examples here describe: 320 px of focal length and 0.8 m on 640x360 pixels.
fn assert_plain(rig: &StereoRig) {
    let expected = StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap();
    let numbers = |rig: &StereoRig| {
        let of = |camera: &crate::geometry::Camera| {
            [
                camera.focal_x_px,
                camera.focal_y_px,
                camera.center_x_px,
                camera.center_y_px,
            ]
        };
        [&of(&rig.left)[..], &of(&rig.right), &[rig.baseline_m]].concat()
    };
    for (found, expected) in numbers(rig).iter().zip(numbers(&expected)) {
        assert!((found - expected).abs() < 1e-9, "{rig:?}");
    }
}

/// A ZED's file: cameras of a resolution as `fx cx cy`, the lens of all, and the turn between them.
fn zed(resolutions: &[(&str, [f64; 3])], lens: &str, stereo: &str) -> String {
    let cameras = resolutions.iter().flat_map(|(name, [f, cx, cy])| {
        ["LEFT", "RIGHT"].map(|side| {
            format!("[{side}_CAM_{name}]\nfx={f}\nfy={f}\ncx={cx}\ncy={cy}\n{lens}\n\n")
        })
    });
    cameras.collect::<String>() + "[STEREO]\n" + stereo + "\n[MISC]\nSensor_ID=0\n"
}

#[test]
fn zed_gives_the_cameras_of_the_images_resolution() {
    let all = [
        ("2K", [1104.0, 1102.275, 619.275]),
        ("FHD", [960.0, 958.5, 538.5]),
        ("HD", [640.0, 639.0, 359.0]),
        ("VGA", [320.0, 319.5, 179.5]),
    ];
    let text = zed(
        &all,
        "k1=0\nk2=0\nk3=0\np1=0\np2=0",
        "Baseline=800.0\nTY=0\nTZ=0\nCV_HD=0",
    );
    // Their names say 672x376, and their principal points 640x360.
    assert_plain(&rig_of(&text, [640, 360]));
    let hd = rig_of(&text, [1280, 720]);
    assert_eq!((hd.focal_px(), hd.left.center_x_px), (640.0, 639.5));
    // Resized from the next larger one of that shape.
    let small = rig_of(&text, [960, 540]);
    assert!((small.focal_px() - 480.0).abs() < 1e-9);
    let options = LoadOptions::default();
    let message = from_text(&text, &options).unwrap_err().to_string();
    assert!(message.contains("2208x1242") && message.contains("size of the images"));
    assert_eq!(
        read(&zed(&all[2..3], "", "baseline=120")).size(),
        Some([1280, 720])
    );
}

#[test]
fn zed_turns_and_lenses_are_those_of_its_own_program() {
    let lens = "k1=-0.17\nk2=0.025\nk3=0.001\np1=0.0002\np2=-0.0003";
    let stereo = "Baseline=119.9\nTY=0.2\nTZ=-0.3\nCV_HD=0.004\nRX_HD=0.002\nRZ_HD=-0.001";
    let calibration = read(&zed(&[("HD", [700.0, 640.0, 360.0])], lens, stereo));
    let [left, _] = calibration.cameras();
    assert_eq!(
        left.distortion.coefficients(),
        [-0.17, 0.025, 0.0002, -0.0003, 0.001, 0.0, 0.0, 0.0]
    );
    let off = calibration.translation_m() - DVec3::new(-0.1199, -0.0002, 0.0003);
    assert!(off.length() < 1e-12);
    // A small rotation vector's entries stand beside the matrix's diagonal.
    let rotation = calibration.right_from_left();
    for (found, expected) in [
        (rotation.z_axis.x, 0.004),
        (rotation.y_axis.z, 0.002),
        (rotation.x_axis.y, -0.001),
    ] {
        assert!((found - expected).abs() < 1e-5, "{rotation}");
    }
}

#[test]
fn middlebury_cityscapes_and_driving_stereo_are_rectified_rigs() {
    let middlebury = "cam0=[320 0 319.5; 0 320 179.5; 0 0 1]\ncam1=[320 0 319.5; 0 320 179.5; 0 0 1]\n\
                      doffs=0\nbaseline=800\nwidth=640\nheight=360\nndisp=280\nisint=0\n";
    assert_plain(&rig_of(middlebury, [640, 360]));
    let shifted = middlebury.replace("cam1=[320 0 319.5", "cam1=[320 0 330.25");
    let rig = rig_of(&shifted, [640, 360]);
    assert_eq!(rig.right.center_x_px - rig.left.center_x_px, 10.75);
    let without_right: String = shifted
        .replace("doffs=0", "doffs=10.75")
        .lines()
        .filter(|line| !line.starts_with("cam1"))
        .fold(String::new(), |text, line| text + line + "\n");
    assert_eq!(rig_of(&without_right, [640, 360]), rig);
    let cityscapes = r#"{"extrinsic": {"baseline": 0.8, "pitch": 0.03, "roll": 0.0, "x": 1.7},
        "intrinsic": {"fx": 320.0, "fy": 320.0, "u0": 319.5, "v0": 179.5}}"#;
    assert_plain(&rig_of(cityscapes, [640, 360]));
    let driving = "calib_time: 09-Jul-2018\nS_101: 1762 800\nK_101: 1 0 0 0 1 0 0 0 1\n\
                   D_101: 0.1 0 0 0 0\nR_101: 1 0 0 0 1 0 0 0 1\nT_101: 0 0 0\nS_rect_101: 640 360\n\
                   R_rect_101: 1 0 0 0 1 0 0 0 1\nP_rect_101: 320 0 319.5 0 0 320 179.5 0 0 0 1 0\n\
                   T_103: -0.8 0 0\nS_rect_103: 640 360\n\
                   P_rect_103: 320 0 319.5 -256 0 320 179.5 0 0 0 1 0\n";
    assert_plain(&rig_of(driving, [640, 360]));
    // Its images of half the size.
    assert_eq!(rig_of(driving, [320, 180]).focal_px(), 160.0);
    let kitti_360 = "P_rect_00: 320 0 319.5 0 0 320 179.5 0 0 0 1 0\nS_rect_00: 640 360\n\
                     P_rect_01: 320 0 319.5 -256 0 320 179.5 0 0 0 1 0\nS_rect_01: 640 360\n";
    assert_plain(&rig_of(kitti_360, [640, 360]));
}

/// An `EuRoC` camera that stands so many metres along the body's x.
fn sensor(x_m: f64, lens: &str) -> String {
    format!(
        "#Default imu sensor yaml file\nsensor_type: camera\ncomment: VI-Sensor cam0\n\n\
         # Sensor extrinsics wrt. the body-frame.\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0.0, -1.0, \
         0.0, -0.02,\n         1.0, 0.0, 0.0, {x_m},\n        0.0, 0.0, 1.0, 0.01,\n         0.0, 0.0, \
         0.0, 1.0]\n\nrate_hz: 20\nresolution: [640, 360]\ncamera_model: pinhole\nintrinsics: [320, \
         320, 319.5, 179.5] #fu, fv, cu, cv\ndistortion_model: radial-tangential\n\
         distortion_coefficients: {lens}\n"
    )
}

#[test]
fn euroc_gives_how_two_cameras_stand_to_each_other_from_where_they_stand_on_the_body() {
    // The cameras' x is the body's y.
    let plain = "[0, 0, 0, 0]";
    let calibration = pair(&sensor(0.1, plain), &sensor(0.9, plain)).unwrap();
    assert_eq!(calibration.size(), Some([640, 360]));
    let off = calibration.translation_m() - DVec3::new(-0.8, 0.0, 0.0);
    assert!(off.length() < 1e-12);
    let lens = "[-0.28, 0.07, 0.0002, 1.8e-05]";
    let calibration = pair(&sensor(0.1, lens), &sensor(0.9, lens)).unwrap();
    let found = calibration.cameras()[1].distortion.coefficients();
    assert_eq!(found[..4], [-0.28, 0.07, 0.0002, 1.8e-5]);
    let message = pair(&sensor(0.9, plain), &sensor(0.1, plain)).unwrap_err();
    assert!(message.to_string().contains("swapped"), "{message}");
    let message = refusal(&sensor(0.1, plain));
    assert!(message.contains("cam1/sensor.yaml"), "{message}");
}

#[test]
fn orb_slam_gives_two_cameras_or_one_rectified() {
    let camera = |name: &str| {
        format!("{name}.fx: 320.0\n{name}.fy: 320.0\n{name}.cx: 319.5\n{name}.cy: 179.5\n")
    };
    let head = "%YAML:1.0\n\n#---\n# Camera Parameters.\n#---\nFile.version: \"1.0\"\n";
    let size = "Camera.width: 640\nCamera.height: 360\nCamera.newWidth: 600\nCamera.fps: 20\n";
    let both = camera("Camera1") + &camera("Camera2");
    let pinhole = format!(
        "{head}Camera.type: \"PinHole\"\n{both}{size}Stereo.ThDepth: 60.0\nStereo.T_c1_c2: \
         !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n  data: [1, 0, 0, 0.8, 0, 1, 0, 0, 0, 0, 1, 0, \
         0, 0, 0, 1]\n"
    );
    assert_plain(&rig_of(&pinhole, [640, 360]));
    let lenses = pinhole.replace(
        "Camera2.cy: 179.5",
        "Camera2.cy: 179.5\nCamera2.k1: -0.28\nCamera2.p2: 1e-5",
    );
    let found = read(&lenses).cameras()[1].distortion.coefficients();
    assert_eq!(found[..4], [-0.28, 0.0, 0.0, 1e-5]);
    let first = camera("Camera1");
    let rectified = format!("{head}Camera.type: \"Rectified\"\n{first}{size}Stereo.b: 0.8\n");
    assert_plain(&rig_of(&rectified, [640, 360]));
    let older = format!("{head}{}{size}Camera.bf: 256.0\n", camera("Camera"));
    assert_plain(&rig_of(&older, [640, 360]));
    let fisheye = pinhole.replace("PinHole", "KannalaBrandt8");
    assert!(refusal(&fisheye).contains("Camera.type kannalabrandt8"));
    assert!(refusal(&older.replace("Camera.bf", "Camera.x")).contains("single camera"));
}

#[test]
fn oak_cameras_stand_as_their_extrinsics_lead_from_one_to_the_other() {
    let camera = |socket: i64, to: i64, x: f64, lens: &str| {
        format!(
            r#"[{socket}, {{"cameraType": 0, "width": 640, "height": 360, "distortionCoeff": [{lens}],
            "intrinsicMatrix": [[320.0, 0.0, 319.5], [0.0, 320.0, 179.5], [0.0, 0.0, 1.0]],
            "extrinsics": {{"toCameraSocket": {to}, "rotationMatrix":
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "specTranslation": {{"x": 1.0, "y": 0.0, "z": 0.0}},
            "translation": {{"x": {x}, "y": 0.0, "z": 0.0}}}}}}]"#
        )
    };
    let file = |cameras: [String; 3]| {
        format!(
            r#"{{"boardName": "DM9098", "cameraData": [{}], "stereoRectificationData":
            {{"leftCameraSocket": 1, "rightCameraSocket": 2}}, "version": 7}}"#,
            cameras.join(", ")
        )
    };
    let none = ["0.0"; 14].join(", ");
    let straight = [
        camera(0, -1, 0.0, &none),
        camera(1, 2, -80.0, &none),
        camera(2, 0, 40.0, &none),
    ];
    assert_plain(&rig_of(&file(straight.clone()), [640, 360]));
    // Both lead to the camera in the middle.
    let middle = [
        camera(0, -1, 0.0, &none),
        camera(1, 0, -40.0, &none),
        camera(2, 0, 40.0, &none),
    ];
    assert_plain(&rig_of(&file(middle), [640, 360]));
    let lens = format!(
        "-5.2, 9.1, 0.0002, -0.0001, 4.0, -5.3, 9.4, 3.5, {}",
        ["0.0"; 6].join(", ")
    );
    let bent = [
        straight[0].clone(),
        camera(1, 2, -80.0, &lens),
        straight[2].clone(),
    ];
    let found = read(&file(bent)).cameras()[0].distortion.coefficients();
    assert_eq!(found, [-5.2, 9.1, 0.0002, -0.0001, 4.0, -5.3, 9.4, 3.5]);
    let circle = [
        camera(0, -1, 0.0, &none),
        camera(1, 2, -80.0, &none),
        camera(2, 1, 80.0, &none),
    ];
    assert!(refusal(&file(circle)).contains("in a circle"));
    let apart = [
        camera(0, -1, 0.0, &none),
        camera(1, -1, 0.0, &none),
        camera(2, 0, 40.0, &none),
    ];
    assert!(refusal(&file(apart)).contains("do not lead"));
    let alone = file(straight).replace("[2, {", "[3, {");
    assert!(refusal(&alone).contains("camera 2"));
}

#[test]
fn real_sense_tables_give_the_resolution_and_streams_their_own() {
    let table = |number: u32, [width, height]: [u32; 2]| {
        let f = f64::from(width) / 2.0;
        let [cx, cy] = [width, height].map(|side| f64::from(side) / 2.0 - 0.5);
        format!(
            r#""rectified.{number}.width": "{width}", "rectified.{number}.height": "{height}",
            "rectified.{number}.fx": "{f}", "rectified.{number}.fy": "{f}",
            "rectified.{number}.ppx": "{cx}", "rectified.{number}.ppy": "{cy}""#
        )
    };
    let tables = [
        table(0, [1280, 720]),
        table(1, [640, 360]),
        table(2, [0, 0]),
        table(10, [848, 480]),
    ];
    let text = format!(
        r#"{{"baseline": "-800.0", "intrinsic_left.x.x": "1.1", {}}}"#,
        tables.join(", ")
    );
    assert_plain(&rig_of(&text, [640, 360]));
    assert_eq!(rig_of(&text, [848, 480]).focal_px(), 424.0);
    assert_eq!(rig_of(&text, [1280, 720]).focal_px(), 640.0);
    let stream = |name: &str, coeffs: &str| {
        format!(
            r#""{name}": {{"width": 640, "height": 360, "fx": 320.0, "fy": 320.0, "ppx": 319.5,
            "ppy": 179.5, "model": "brown_conrady", "coeffs": [{coeffs}]}}"#
        )
    };
    let plain = "0.0, 0.0, 0.0, 0.0, 0.0";
    for (sides, between) in [
        (["infra1", "infra2"], r#""baseline": 0.8"#),
        (["left", "right"], r#""baseline_mm": 800"#),
        (
            ["Infrared 1", "Infrared 2"],
            r#""extrinsics": {"rotation": [1,0,0,0,1,0,0,0,1], "translation": [-0.8, 0.0, 0.0]}"#,
        ),
    ] {
        let [left, right] = sides.map(|side| stream(side, plain));
        let depth = stream("depth", plain);
        let text = format!("{{\"streams\": {{{depth}, {left}, {right}}}, {between}}}");
        assert_plain(&rig_of(&text, [640, 360]));
    }
    let [left, right] = ["left", "right"].map(|side| stream(side, "0.1, 0, 0, 0, 0"));
    let bent = format!("{{{left}, {right}, \"baseline\": 0.8}}");
    assert!(refusal(&bent).contains("not rectified"));
    let alone = format!("{{{}, \"baseline\": 0.8}}", stream("color", plain));
    assert!(refusal(&alone).contains("only color"));
}

#[test]
fn cameras_whose_numbers_stand_one_by_one_are_read() {
    let camera = r#"{"fx": 320, "fy": 320.0, "cx": 319.5, "cy": 179.5}"#;
    let both = format!(
        r#"{{"left": {camera}, "right": {camera}, "width": 640, "height": 360, "baseline": 0.8}}"#
    );
    assert_plain(&rig_of(&both, [640, 360]));
    let one = "fx: 320.0\nfy: 320.0\ncx: 319.5\ncy: 179.5\nbaseline: 0.8\n";
    assert_plain(&rig_of(one, [640, 360]));
    let lens = both.replace(
        "179.5}",
        "179.5, \"k1\": -0.2, \"k2\": 0.1, \"p1\": 0, \"p2\": 0.001}",
    );
    let found = read(&lens).cameras()[1].distortion.coefficients();
    assert_eq!(found[..5], [-0.2, 0.1, 0.0, 0.001, 0.0]);
    let bent = format!("{one}k1: -0.2\nk2: 0.1\np1: 0\np2: 0\n");
    assert!(refusal(&bent).contains("camera matrices"));
}

#[test]
fn projections_alone_are_enough_for_rectified_images() {
    let matrix = |name: &str, x: f64| {
        format!(
            "{name}: !!opencv-matrix\n   rows: 3\n   cols: 4\n   dt: d\n   data: [ 3.2e+02, 0., \
             3.195e+02, {x}, 0., 3.2e+02, 1.795e+02, 0., 0., 0., 1., 0. ]\n"
        )
    };
    for names in [
        ["P1", "P2"],
        ["P_left", "P_right"],
        ["projection_matrix_l", "projection_matrix_r"],
    ] {
        let [left, right] = names;
        let text = format!(
            "%YAML:1.0\n---\n{}{}",
            matrix(left, 0.0),
            matrix(right, -256.0)
        );
        assert_plain(&rig_of(&text, [640, 360]));
    }
    let same = format!("%YAML:1.0\n---\n{}{}", matrix("P1", 0.0), matrix("P2", 0.0));
    assert!(refusal(&same).contains("camera matrices"));
}

/// A message of ROS 1 or 2 as its program prints it.
fn echo(x: f64, is_second: bool, stamp: u32) -> String {
    let k = [320.0, 0.0, 319.5, 0.0, 320.0, 179.5, 0.0, 0.0, 1.0];
    let p = [
        320.0, 0.0, 319.5, x, 0.0, 320.0, 179.5, 0.0, 0.0, 0.0, 1.0, 0.0,
    ];
    let r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let roi = "binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n---\n";
    if is_second {
        let list = |name: &str, values: &[f64]| {
            let lines: Vec<String> = values.iter().map(|v| format!("- {v:?}")).collect();
            format!("{name}:\n{}\n", lines.join("\n"))
        };
        return format!(
            "header:\n  stamp:\n    sec: {stamp}\n    nanosec: 3\n  frame_id: left\nheight: 360\nwidth: \
             640\ndistortion_model: plumb_bob\n{}{}{}{}{roi}",
            list("d", &[0.0; 5]),
            list("k", &k),
            list("r", &r),
            list("p", &p)
        );
    }
    format!(
        "header: \n  seq: 867\n  stamp: \n    secs: {stamp}\n    nsecs: 4\n  frame_id: \
         \"camera_infra1_optical_frame\"\nheight: 360\nwidth: 640\ndistortion_model: \"plumb_bob\"\nD: \
         [0.0, 0.0, 0.0, 0.0, 0.0]\nK: {k:?}\nR: {r:?}\nP: {p:?}\n{roi}"
    )
}

#[test]
fn messages_of_ros_are_read_as_they_are_printed() {
    for is_second in [false, true] {
        let [left, right] = [0.0, -256.0].map(|x| echo(x, is_second, 1));
        let calibration = pair(&left, &right).unwrap();
        let rig = CalibratedRig::new(&calibration, [640, 360], RigOptions::default()).unwrap();
        assert_plain(rig.rig());
        // Printed again and again, and broken off.
        let often = |x| {
            let many: String = (0..5).map(|stamp| echo(x, is_second, stamp)).collect();
            many + &echo(x, is_second, 9)[..150]
        };
        assert_eq!(pair(&often(0.0), &often(-256.0)).unwrap(), calibration);
        // Both in one file.
        assert_eq!(read(&(left.clone() + &right)), calibration);
        assert!(
            pair(&right, &left)
                .unwrap_err()
                .to_string()
                .contains("swapped")
        );
    }
}

#[test]
fn unknown_formats_are_told_what_they_look_like_and_which_are_known() {
    for (text, looks) in [
        ("{\"a\": 1, \"b\": {}}", "none of two cameras among a"),
        (
            "[camera]\nfx = 1\n[other]\n",
            "an INI file with the sections camera, other",
        ),
        ("fov = 1\naspect = 2\n", "settings of fov, aspect"),
        (
            "frame 7 has no lens\n",
            "a text that begins with \"frame 7 has no lens\"",
        ),
        ("<?xml version=\"1.0\"?><opencv_storage/>", "XML"),
        ("", "empty"),
    ] {
        let message = refusal(text);
        assert!(message.contains(looks), "{message}");
        for known in known() {
            assert!(message.contains(known.name), "{message}");
        }
        assert!(!message.contains("TOML parse error"), "{message}");
    }
    // Where the content says nothing, the name does.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("SN1234.conf");
    fs::write(&path, "[STEREO]\nBaseline=120\n").unwrap();
    let message = load(&[path], &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(message.contains("[LEFT_CAM_HD]"), "{message}");
}

#[test]
fn wide_characters_of_windows_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stereo.yml");
    let units = OPENCV.encode_utf16().flat_map(u16::to_le_bytes);
    let bytes: Vec<u8> = [0xFF, 0xFE].into_iter().chain(units).collect();
    fs::write(&path, bytes).unwrap();
    assert_eq!(
        load(&[path], &LoadOptions::default()).unwrap(),
        read(OPENCV)
    );
}

/// The examples of the page about formats, each with its heading.
fn examples() -> Vec<(&'static str, &'static str)> {
    let page = include_str!("../../../docs/formats.md");
    let begin = page.find("\n## Calibrations").unwrap();
    let end = page.find("\n## Weights").unwrap();
    let sections = page[begin..end].split("\n### ").skip(1);
    let blocks = sections.flat_map(|section| {
        let title = section.lines().next().unwrap();
        // Between two fences, without the word behind the first.
        let blocks = section.split("```").skip(1).step_by(2);
        blocks.map(move |block| (title, block.split_once('\n').unwrap().1))
    });
    blocks.collect()
}

#[test]
fn damaged_calibrations_are_refused_or_read_and_nothing_else() {
    let mut texts: Vec<String> = examples()
        .iter()
        .map(|(_, text)| text.to_string())
        .collect();
    let lens = "k1=-0.17\nk2=0.025\nk3=0.001\np1=0.0002\np2=-0.0003";
    texts.push(OPENCV.to_owned());
    texts.push(zed(
        &[
            ("HD", [700.0, 640.0, 360.0]),
            ("VGA", [350.0, 336.0, 188.0]),
        ],
        lens,
        "Baseline=120",
    ));
    texts.push(sensor(0.1, "[-0.28, 0.07, 0.0002, 1.8e-05]"));
    texts.extend([echo(-256.0, false, 1), echo(0.0, true, 2)]);
    let seeds: Vec<&[u8]> = texts.iter().map(String::as_bytes).collect();
    let options = LoadOptions {
        image_size: Some([64, 36]),
        ..LoadOptions::default()
    };
    crate::mutate::damaged(&seeds, |bytes| {
        let Some(text) = text_of(bytes.to_vec()) else {
            return;
        };
        if let Ok(calibration) = from_text(&text, &options) {
            for images in [ImageState::Rectified, ImageState::Auto] {
                let options = RigOptions {
                    images,
                    alpha: None,
                };
                if let Ok(rig) = CalibratedRig::new(&calibration, [16, 9], options) {
                    assert!(rig.rig().baseline_m > 0.0);
                }
            }
        }
        format::parse(&[&text, &texts[1]], &[], &options).ok();
    });
}

#[test]
fn every_example_of_the_page_about_formats_is_read() {
    let examples = examples();
    for (title, text) in &examples {
        let (title, text) = (*title, *text);
        let rig = match title {
            // The page shows the right camera's file.
            "ROS" | "EuRoC" => {
                let left = text.replace("-256.0", "0.0").replace("0, 0.8,", "0, 0,");
                assert_ne!(left, text, "{title}");
                let calibration = pair(&left, text).unwrap();
                let options = RigOptions::default();
                *CalibratedRig::new(&calibration, [640, 360], options)
                    .unwrap()
                    .rig()
            }
            _ => rig_of(text, [640, 360]),
        };
        // In ZED's file the images are half of the resolution's size.
        if title == "ZED" {
            assert_eq!((rig.focal_px(), rig.baseline_m), (320.0, 0.8));
        } else {
            assert_plain(&rig);
        }
    }
    // RealSense has two.
    assert_eq!(examples.len(), known().count() + 1);
}
