//! Foreign datasets, checks and pictures of datasets.

use super::{Workplace, with_dataset};

#[test]
fn a_generated_dataset_is_sound_is_shown_and_goes_out_and_comes_back() {
    let place = with_dataset();
    let checked = place.line("validate data").success();
    assert!(checked.contains("nothing wrong"), "{checked}");
    let shown = place.line("inspect data --out look").success();
    assert!(shown.contains("inspect.png") && place.path("look/inspect.html").exists());
    for (format, classes) in [("coco", ""), ("yolo", ""), ("kitti", " --classes car")] {
        let exported = place
            .line(&format!("export {format} data --out {format}"))
            .success();
        assert!(
            exported.starts_with(&format!("export {format}: 16 images")),
            "{exported}"
        );
        place
            .line(&format!(
                "import {format} {format}{classes} --out {format}-back"
            ))
            .success();
    }
    // COCO and KITTI hold the distances.
    for format in ["coco", "kitti"] {
        place.line(&format!("validate {format}-back")).success();
    }
    let rows = |name: &str| std::fs::read_to_string(place.path(name)).unwrap();
    assert_eq!(rows("data/frames.csv"), rows("coco-back/frames.csv"));
}

#[test]
fn findings_are_printed_and_counted_and_make_the_exit_code_1() {
    let place = with_dataset();
    place.write("data/frames/notes.txt", "x");
    let outcome = place.line("validate data");
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    assert!(
        outcome.stdout.contains("leftover: frames/notes.txt"),
        "{}",
        outcome.stdout
    );
    assert!(
        outcome.stdout.contains("1 findings: 1 leftover"),
        "{}",
        outcome.stdout
    );
    let outcome = place.line("validate data --json");
    assert_eq!(outcome.code, Some(1));
    let json: serde_json::Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!(json["counts"]["leftover"], 1);
    assert_eq!(json["findings"][0]["subject"], "frames/notes.txt");
    place
        .line("validate nowhere")
        .error_says(&["nowhere", "is no folder"]);
}

#[test]
fn a_detector_is_trained_and_its_data_refused_where_distances_are_to_be_learnt() {
    let place = with_dataset();
    place.line("export yolo data --out yolo").success();
    place
        .line("import yolo yolo --single --out single")
        .success();
    let toml = std::fs::read_to_string(place.path("single/dataset.toml")).unwrap();
    assert!(
        toml.contains("stereo = false") && !toml.contains("baseline"),
        "{toml}"
    );
    let settings = "--config training.toml --data single";
    place
        .line(&format!("train {settings} --run r --box-kind tight"))
        .error_says(&["single images", "train detector"]);
    place
        .line(&format!("train detector {settings} --run r"))
        .error_says(&["no sphere boxes", "--box-kind tight"]);
    place
        .line(&format!(
            "train detector {settings} --run r --box-kind tight"
        ))
        .success();
}

#[test]
fn what_an_import_leaves_out_is_counted_and_named_and_metres_are_taken_where_they_are_meant() {
    let place = Workplace::new();
    place.write("set/data.yaml", "train: images\nnames: [car]\n");
    place.write("set/images/c.heic", "ftypheic");
    for (name, line) in [("a", "0 0.5 0.5 0.2 0.2 12.5"), ("b", "0 0.5 0.5 0 0.2")] {
        place.write_image(&format!("set/images/{name}.png"), 64, 48);
        place.write(&format!("set/labels/{name}.txt"), line);
    }
    place.write_image("set/images/d.png", 64, 48);
    let outcome = place.line("import auto set --out plain");
    for words in [
        "left out images/a.png: a sixth number is taken for a confidence",
        "left out images/b.png: a box has no size",
        "left out images/c.heic: is not a PNG, JPEG, BMP, WebP or TIFF image",
    ] {
        assert!(outcome.stderr.contains(words), "{}", outcome.stderr);
    }
    let said = outcome.success();
    assert!(
        said.contains("3 frames") && said.contains("1 vehicles"),
        "{said}"
    );
    assert!(said.contains("1 images without a label file"), "{said}");
    let metres = "import yolo set --distance-column --out metres";
    let said = place.line(metres).success();
    assert!(!said.contains("with a distance"), "{said}");
    let label = std::fs::read_to_string(place.path("metres/frames/left_00001.txt")).unwrap();
    assert!(label.contains(" 12.5 "), "{label}");
}

#[test]
fn what_cannot_be_imported_or_exported_is_an_error_with_a_remedy() {
    let place = Workplace::new();
    place.write("empty/readme.txt", "");
    for (line, words) in [
        ("import kitti empty --out o", ["training/image_2", "empty"]),
        ("import vkitti2 empty --out o", ["Scene01", "empty"]),
        ("import yolo empty --out o", ["data.yaml", "empty"]),
        ("import coco empty --out o", ["JSON", "empty"]),
        (
            "import coco nowhere.json --out o",
            ["nowhere.json", "check the path"],
        ),
        (
            "import kitti empty --classes car= --out o",
            ["names no class", "car=Car+Van"],
        ),
        ("export yolo empty --out o", ["dataset.toml", "empty"]),
        (
            "export kitti empty --distance --out o",
            ["--distance", "yolo"],
        ),
        ("inspect empty", ["dataset.toml", "empty"]),
        (
            "import auto empty --out o",
            ["known are", "docs/formats.md"],
        ),
        (
            "import yolo empty --out o",
            ["known are", "docs/formats.md"],
        ),
    ] {
        place.line(line).error_says(&words);
    }
}
