//! Files that say nothing usable are refused by name, and never take the program down.

use std::fs;

use super::*;

/// The sample with one piece of it replaced; fails where that piece is not there.
fn changed(from: &str, to: &str) -> String {
    assert!(OPENCV.contains(from), "{from}");
    OPENCV.replace(from, to)
}

#[test]
fn wrong_entries_are_refused_by_their_names() {
    for (text, words) in [
        (
            changed("5.3e+02, 0., 3.22e+02", "0., 0., 3.22e+02"),
            ["M1", "singular"],
        ),
        (
            changed("5.3e+02, 0., 3.22e+02", "-5.3e+02, 0., 3.22e+02"),
            ["-530", "positive"],
        ),
        (
            changed("5.3e+02, 0., 3.22e+02", ".Nan, 0., 3.22e+02"),
            ["M1", "no finite numbers"],
        ),
        (
            changed("5.3e+02, 0., 3.22e+02", "5.3e+02, 40., 3.22e+02"),
            ["M1", "skew"],
        ),
        (
            changed("5.3e+02, 0., 3.22e+02", "5.3e+02, 0., 9.22e+02"),
            ["922.5", "outside"],
        ),
        (
            changed("2.38e+02, 0., 0., 1. ]", "2.38e+02, 0., 0. ]"),
            ["M1", "8 numbers"],
        ),
        (
            changed("2.38e+02, 0., 0., 1. ]", "2.38e+02, 0., 0., one ]"),
            ["M1", "\"one\""],
        ),
        (
            changed(
                "[ -2.8e-01, 8.0e-02, 1.2e-03, -1.0e-04, 0. ]",
                "[ .Inf, 0, 0, 0, 0 ]",
            ),
            ["line 16", "finite"],
        ),
        (changed("D1:", "F1:"), ["D2", "only one camera"]),
        (changed("M2:", "M3:"), ["camera matrices", "M3"]),
        (changed("T:", "W:"), ["R and T", "extrinsics.yml"]),
        (changed("\nR:", "\nW:"), ["R", "missing"]),
        (
            changed("[ -1.2e-01, 1.0e-03, -5.0e-04 ]", "[ 0., 0., 0. ]"),
            ["baseline of 0", "one place"],
        ),
        (
            changed("[ -1.2e-01, 1.0e-03, -5.0e-04 ]", "[ 1.2e-01, 0., 0. ]"),
            ["swapped", "swap them"],
        ),
        (
            changed("[ -1.2e-01, 1.0e-03, -5.0e-04 ]", "[ 0., -1.2e-01, 0. ]"),
            ["T", "above the other"],
        ),
        (
            changed("[ -1.2e-01, 1.0e-03, -5.0e-04 ]", "[ -120., 1., 0. ]"),
            ["120", "millimetres"],
        ),
        (
            changed("[ 0.99995, 0., 0.01, 0., 1.", "[ 0.5, 0., 0.01, 0., 1."),
            ["rotation R", "no rotation"],
        ),
        (
            changed("image_width: 640", "image_width: 64000"),
            ["64000", "size"],
        ),
        (
            changed("image_width: 640", "image_width: -640"),
            ["image_width", "size"],
        ),
        (
            changed("image_width: 640", "distortion_model: equidistant"),
            ["equidistant", "pinhole"],
        ),
        (
            changed("image_width: 640", "fisheye: 1\nfisheye_model: true"),
            ["fisheye", "pinhole"],
        ),
        (changed("image_width: 640", "M_1: [1, 2]"), ["M_1", "twice"]),
    ] {
        let message = refusal(&text);
        for word in words {
            assert!(message.contains(word), "{message} should contain {word}");
        }
    }
}

#[test]
fn lenses_with_more_coefficients_are_refused_unless_those_are_zero() {
    let fourteen = |last: &str| {
        let mut numbers = vec!["-0.28", "0.08", "0.0012", "-0.0001"];
        numbers.extend(["0."; 9]);
        numbers.push(last);
        let matrix = format!("cols: 14\n   dt: d\n   data: [ {} ]", numbers.join(", "));
        let five = "cols: 5\n   dt: d\n   data: [ -2.8e-01, 8.0e-02, 1.2e-03, -1.0e-04, 0. ]";
        changed(five, &matrix)
    };
    assert_eq!(read(&fourteen("0.")), read(OPENCV));
    let message = refusal(&fourteen("0.01"));
    for word in ["D1", "14 coefficients", "4, 5 or 8"] {
        assert!(message.contains(word), "{message}");
    }
}

#[test]
fn wrong_kitti_files_are_refused_by_line() {
    let good = "P2: 700 0 600 42 0 700 170 0 0 0 1 0\nP3: 700 0 600 -308 0 700 170 0 0 0 1 0\n";
    read(good);
    for (text, words) in [
        (good.replace("P3: 700", "P3: x"), ["P3, line 2", "'x'"]),
        (good.replace("P3: 700", "P3: inf"), ["P3, line 2", "finite"]),
        (good.replace("P3: 700", "P3:"), ["P3", "11 numbers"]),
        (good.replace("P3", "P1"), ["P3", "missing"]),
        (good.replace("-308", "308"), ["swapped", "swap"]),
        (good.replace("-308", "42"), ["baseline of 0", "one place"]),
        (
            good.replace("-308 0 700 170 0", "-308 0 700 170 70"),
            ["P2 and P3", "rectified pair"],
        ),
        (
            good.replace("P2: 700 0 600 42", "P2: -700 0 600 42"),
            ["-700", "focal"],
        ),
    ] {
        let message = refusal(&text);
        for word in words {
            assert!(message.contains(word), "{message} should contain {word}");
        }
    }
}

#[test]
fn wrong_lines_and_tables_are_refused_by_place() {
    let matrix = "754.6 0 489.3 0 754.6 265.8 0 0 1";
    for (text, words) in [
        (matrix.to_owned(), ["baseline is missing", "--calib-baseline"]),
        (format!("{matrix}\n63\n"), ["63 m", "millimetres"]),
        (format!("{matrix}\n-0.063\n"), ["left of the left", "swapped"]),
        (format!("{matrix}\n0.06 0.07\n"), ["line 2", "one baseline"]),
        (format!("{matrix} 4\n0.06\n"), ["line 1", "10 numbers"]),
        (format!("{matrix}\n0.06\n7\n8\n"), ["4 lines", "two lines"]),
        (format!("{matrix}\nabc\n"), ["line 2", "'abc'"]),
        ("1 2 3".to_owned(), ["line 1", "3 numbers"]),
        (
            "width = 640\nheight = 360\nhfov_deg = 90.0".to_owned(),
            ["baseline_m", "missing"],
        ),
        (
            "width = 640\nheight = 360\nhfov_deg = 190.0\nbaseline_m = 1.0".to_owned(),
            ["190", "field of view"],
        ),
        (
            "width = 640\nheight = 360\nhfov = 90.0\nbaseline_m = 1.0".to_owned(),
            ["hfov", "line 3"],
        ),
        (
            "width = 0\nheight = 360\nhfov_deg = 90.0\nbaseline_m = 1.0".to_owned(),
            ["left camera", "0"],
        ),
        (
            "width = 640\nheight = 360\nbaseline_m = 1.0".to_owned(),
            ["cameras", "hfov_deg or both"],
        ),
        (
            "width = 640\nheight = 360\nhfov_deg = 90.0\nbaseline_m = 1.0\ntranslation_m = [-1.0, 0.0, 0.0]".to_owned(),
            ["translation_m", "twice"],
        ),
        (
            "width = 640\nheight = 360\nhfov_deg = 90.0\nbaseline_m = nan".to_owned(),
            ["T = NaN", "not finite"],
        ),
    ] {
        let message = refusal(&text);
        for word in words {
            assert!(message.contains(word), "{message} should contain {word}");
        }
    }
}

#[test]
fn what_is_no_calibration_is_refused_with_the_known_forms() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.yml");
    for (bytes, word) in [
        (&b""[..], "empty"),
        (b"\n\n# nothing\n", "empty"),
        (b"hello world", "no calibration"),
        (b"<?xml version=\"1.0\"?><opencv_storage/>", "XML"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "no text"),
        (b"%YAML:1.0\n---\nM1: [1, 2", "YAML"),
        (b"a: &a [*a, *a]\n", "YAML"),
        (b"- 1\n- 2: 3\n", "camera matrices"),
        (b"x: 1\n", "camera matrices"),
        (b"x = \n", "TOML"),
        (b"{ \"M1\": 3 }", "camera matrices"),
    ] {
        fs::write(&path, bytes).unwrap();
        let message = load(&[&path], &LoadOptions::default())
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("calibration ")
                && message.contains("c.yml")
                && message.contains(word),
            "{message}"
        );
    }
    let message = load(&[folder.path().join("none.yml")], &LoadOptions::default());
    assert!(message.unwrap_err().to_string().contains("check the path"));
    assert!(load(&[folder.path()], &LoadOptions::default()).is_err());
    assert!(load::<&str>(&[], &LoadOptions::default()).is_err());
    fs::write(&path, OPENCV).unwrap();
    for count in [3, 5] {
        assert!(load(&vec![&path; count], &LoadOptions::default()).is_err());
    }
}

#[test]
fn enormous_files_and_endless_devices_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.yml");
    let file = fs::File::create(&path).unwrap();
    file.set_len(1 << 40).unwrap();
    let message = load(&[&path], &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(message.contains("1 MiB"), "{message}");
    if std::path::Path::new("/dev/zero").exists() {
        assert!(load(&["/dev/zero"], &LoadOptions::default()).is_err());
    }
    // Deep nesting must not exhaust the stack.
    fs::write(&path, "[".repeat(500_000)).unwrap();
    assert!(load(&[&path], &LoadOptions::default()).is_err());
    fs::write(&path, format!("a: {}", "[".repeat(500_000))).unwrap();
    assert!(load(&[&path], &LoadOptions::default()).is_err());
    fs::write(&path, format!("a: {}", "{b: ".repeat(200_000))).unwrap();
    assert!(load(&[&path], &LoadOptions::default()).is_err());
    fs::write(&path, format!("a = {}", "[".repeat(500_000))).unwrap();
    assert!(load(&[&path], &LoadOptions::default()).is_err());
}

#[test]
fn no_cut_or_swapped_byte_takes_the_program_down() {
    let texts = [
        OPENCV.to_owned(),
        "P2: 700 0 600 42 0 700 170 0 0 0 1 0\nP3: 700 0 600 -308 0 700 170 0 0 0 1 0\n".to_owned(),
        "754.6 0 489.3 0 754.6 265.8 0 0 1\n0.06\n".to_owned(),
        "width = 640\nheight = 360\nhfov_deg = 90.0\nbaseline_m = 1.0\n".to_owned(),
    ];
    for text in texts {
        for at in 0..text.len() {
            let accepted = |text: &str| {
                if let Ok(calibration) = from_text(text, &LoadOptions::default()) {
                    CalibratedRig::new(&calibration, [16, 12], RigOptions::default()).ok();
                }
            };
            accepted(&text[..at]);
            for replacement in ["9", "-", "e", ":", "]", "\n"] {
                let mut swapped = text.clone();
                swapped.replace_range(at..=at, replacement);
                accepted(&swapped);
            }
        }
    }
}
