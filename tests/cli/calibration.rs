//! `predict --calib`: other cameras than those that a run was trained for.

use std::fs;

use serde_json::Value;

use super::{Workplace, with_dataset};

/// The rig of `with_dataset` as OpenCV would write it, with 0.8 m between the cameras.
const SAME: &str = "%YAML:1.0
---
image_width: 128
image_height: 72
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 64., 0., 63.5, 0., 64., 35.5, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 64., 0., 63.5, 0., 64., 35.5, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -8.0e-01, 0., 0. ]
";

const PAIR: &str = "data/frames/left_00001.png data/frames/right_00001.png";

/// Fails unless two predictions hold the same vehicles; roundings of the focal length may differ.
fn assert_alike(prediction: &str, expected: &str) {
    let distances = |text: &str| -> Vec<f64> {
        let prediction: Value = serde_json::from_str(text).unwrap();
        let vehicles = prediction["vehicles"].as_array().unwrap();
        vehicles
            .iter()
            .map(|vehicle| vehicle["distance_m"].as_f64().unwrap())
            .collect()
    };
    let (found, expected) = (distances(prediction), distances(expected));
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(&expected) {
        assert!((a - b).abs() <= 1e-5 * b.abs(), "{a} is not {b}");
    }
}

#[test]
fn a_calibration_changes_the_rig_and_the_notes_say_what_is_done() {
    let place = with_dataset();
    place
        .line("train --config training.toml --data data --run r")
        .success();
    // The lowest confidence, so that even this network sees something.
    let predict = |more: &str| {
        place.line(&format!(
            "predict --run r {PAIR} --confidence 0.0001 --pairing detect {more}"
        ))
    };
    let plain = predict("");
    assert_eq!(plain.stderr, "", "nothing to note about the trained rig");
    let plain = plain.success();

    place.write("same.yml", SAME);
    let same = predict("--calib same.yml");
    assert_eq!(same.stderr, "", "the same rig by another name");
    assert_alike(&same.success(), &plain);
    // A dataset is a calibration, too.
    assert_eq!(predict("--calib data/dataset.toml").success(), plain);

    // The same in millimetres.
    place.write("mm.yml", SAME.replace("-8.0e-01", "-800."));
    predict("--calib mm.yml").error_says(&["mm.yml", "millimetres", "--calib-baseline"]);
    let metres = predict("--calib mm.yml --calib-baseline 0.8").success();
    assert_alike(&metres, &plain);

    // Other cameras: notes on standard error, unless it is to be quiet.
    place.write("other.txt", "96 0 63.5 0 96 35.5 0 0 1\n0.2\n");
    let other = predict("--calib other.txt");
    for words in [
        "note: the cameras see 67.4 degrees",
        "90.0",
        "0.200 m apart",
    ] {
        assert!(other.stderr.contains(words), "{}", other.stderr);
    }
    let prediction: Value = serde_json::from_str(&other.success()).unwrap();
    assert!(prediction["vehicles"].is_array());
    assert_eq!(predict("--quiet --calib other.txt").stderr, "");

    // Cameras with lenses: the pair is rectified, and the picture is of that.
    let bent = SAME.replace("[ 0., 0., 0., 0., 0. ]", "[ -0.2, 0.05, 0.001, 0., 0. ]");
    place.write("bent.yml", bent);
    predict("--calib bent.yml --annotate bent.png").success();
    predict("--calib same.yml --annotate same.png").success();
    assert_ne!(
        fs::read(place.path("bent.png")).unwrap(),
        fs::read(place.path("same.png")).unwrap()
    );
    predict("--calib bent.yml --calib-rectified").error_says(&["bent.yml", "P1 and P2"]);

    // Images of another shape than the calibrated ones.
    place.write_image("wide_l.png", 200, 40);
    place.write_image("wide_r.png", 200, 40);
    place
        .line("predict --run r wide_l.png wide_r.png --calib same.yml")
        .error_says(&["same.yml", "200x40", "128x72"]);
    let unknown = place.line("predict --run r wide_l.png wide_r.png");
    assert!(
        unknown.stderr.contains("give --calib"),
        "{}",
        unknown.stderr
    );
}

#[test]
fn hostile_calibrations_are_refused_by_file_before_anything_is_computed() {
    let place = Workplace::new();
    place.write_image("l.png", 128, 72);
    place.write_image("r.png", 128, 72);
    for (name, text, words) in [
        ("zero.yml", SAME.replace("-8.0e-01", "0."), "one place"),
        ("swapped.yml", SAME.replace("-8.0e-01", "0.8"), "swapped"),
        (
            "negative.yml",
            SAME.replace("data: [ 64.", "data: [ -64."),
            "focal length -64",
        ),
        (
            "singular.yml",
            SAME.replace("data: [ 64.", "data: [ 0."),
            "singular",
        ),
        ("nan.yml", SAME.replace("-8.0e-01", ".nan"), "finite"),
        (
            "size.yml",
            SAME.replace("image_width: 128", "image_width: 640"),
            "128x72",
        ),
        (
            "bent.yml",
            SAME.replace("1., 0., 0., 0., 1.", "1., 0., 0., 0., 2."),
            "no rotation",
        ),
        ("empty.yml", String::new(), "empty"),
        ("prose.yml", "cameras unknown".to_owned(), "no calibration"),
    ] {
        place.write(name, text);
        place
            .line(&format!("predict --run nowhere l.png r.png --calib {name}"))
            .error_says(&[name, words]);
    }
    let predict = "predict --run nowhere l.png r.png";
    place
        .line(&format!("{predict} --calib missing.yml"))
        .error_says(&["missing.yml", "check the path"]);
    place.write("same.yml", SAME);
    for baseline in ["0", "-1", "nan", "inf", "x"] {
        place
            .line(&format!(
                "{predict} --calib same.yml --calib-baseline={baseline}"
            ))
            .error_says(&["--calib-baseline", "above 0"]);
    }
    place
        .line(&format!("{predict} --calib-baseline 0.1"))
        .error_says(&["--calib <FILE>"]);
}
