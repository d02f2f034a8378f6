//! `calibrate`: what it tells, what it writes, and what it refuses.

use std::fs;

use image::imageops;
use serde_json::Value;

use super::Workplace;

/// A few streets, large enough for features.
const STREETS: &str = "
frames = 4
frames_per_scene = 1
vehicles = 2
width = 400
height = 225
samples_per_pixel = 4
";

fn with_streets() -> Workplace {
    let place = Workplace::new();
    place.write("streets.toml", STREETS);
    place
        .line("generate --config streets.toml --out data")
        .success();
    place
}

const PAIRS: &str = "calibrate data/frames/left_%05d.png data/frames/right_%05d.png";

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).unwrap().as_f64().unwrap()
}

#[test]
fn a_rendered_rig_is_told_to_be_good_and_its_calibration_can_be_used() {
    let place = with_streets();
    let told = place
        .line("calibrate --data data --out rig.toml --picture rows.svg")
        .success();
    for words in ["4 pairs", "rows, middle", "roll", "--distances finds it"] {
        assert!(told.contains(words), "{told}");
    }
    assert!(
        fs::read_to_string(place.path("rows.svg"))
            .unwrap()
            .starts_with("<svg")
    );

    let again = place.line(&format!("{PAIRS} --calib rig.toml --json"));
    assert!(again.stderr.contains("measured anew"), "{}", again.stderr);
    let json: Value = serde_json::from_str(&again.success()).unwrap();
    assert_eq!(json["pairs"], 4);
    assert_eq!(json["constant"]["known_from"], Value::Null);
    for name in ["row_offset_px", "roll_deg", "yaw_deg", "focal_percent"] {
        let value = number(&json, &format!("/rectification/{name}/value"));
        let std = number(&json, &format!("/rectification/{name}/std"));
        assert!(
            value.abs() < 4.0 * std && std > 0.0,
            "{name} {value} ± {std}"
        );
    }
    assert_eq!(json["written"]["right_camera_is_turned"], false);
}

#[test]
fn rows_that_are_off_by_two_are_mended_by_the_written_calibration() {
    let place = with_streets();
    place
        .line("calibrate --data data --out good.toml")
        .success();
    for entry in fs::read_dir(place.path("data/frames")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with("right") && name.ends_with("png") {
            let image = image::open(&path).unwrap().to_rgb8();
            let mut lower = image.clone();
            imageops::replace(&mut lower, &image, 0, 2);
            lower.save(&path).unwrap();
        }
    }
    let told = place
        .line(&format!("{PAIRS} --calib good.toml --out mended.toml"))
        .success();
    assert!(told.contains("the right image is lower"), "{told}");
    assert!(told.contains("turns the right camera"), "{told}");
    let again = place
        .line(&format!("{PAIRS} --calib mended.toml --json"))
        .success();
    let json: Value = serde_json::from_str(&again).unwrap();
    assert!(number(&json, "/rectification/rows_off_px") < 0.3, "{again}");
}

#[test]
fn what_cannot_be_calibrated_is_refused_by_name() {
    let place = with_streets();
    place.line("calibrate --data data --out rig.toml").success();
    place.write("known.csv", "image,x,y,distance_m\n00001,50,60,-3\n");
    place.write("other.csv", "image,x,y,distance_m\nnowhere,50,60,8\n");
    let exchanged =
        "calibrate data/frames/right_%05d.png data/frames/left_%05d.png --calib rig.toml";
    for (line, words) in [
        (PAIRS.to_owned(), "--calib"),
        (exchanged.to_owned(), "look exchanged"),
        (
            "calibrate data/frames/left_%05d.png data/frames/left_%05d.png --calib rig.toml"
                .to_owned(),
            "are the same",
        ),
        (
            format!("{PAIRS} --calib rig.toml --distances known.csv"),
            "line 2",
        ),
        (
            format!("{PAIRS} --calib rig.toml --distances other.csv"),
            "nowhere",
        ),
        (
            format!("{PAIRS} --calib rig.toml --out rig.toml"),
            "is read",
        ),
        (
            format!("{PAIRS} --calib rig.toml --picture data"),
            "is a folder",
        ),
        ("calibrate --data nowhere".to_owned(), "nowhere"),
    ] {
        let refused = place.line(&line).error();
        assert!(refused.contains(words), "{line}: {refused}");
    }
}
