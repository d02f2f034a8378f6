//! Damaged and foreign input: named, left out, and an error only where nothing is left.

use super::*;

const SIZE: [u32; 2] = [64, 48];
const CALIBRATION: &str = "P2: 50 0 32 0 0 50 24 0 0 0 1 0\nP3: 50 0 32 -25 0 50 24 0 0 0 1 0\n";
const CAR: &str = "Car 0 0 0 20 20 40 30 1.5 1.6 4 0 1.7 12 0";

/// Two sound frames and one that `spoil` makes of a sound one.
fn kitti_with(spoil: impl FnOnce(&Place)) -> (Place, Result<ImportReport>) {
    let place = Place::new();
    for id in 0..3 {
        for folder in ["image_2", "image_3"] {
            place.image(
                &format!("kitti/training/{folder}/{id:06}.png"),
                SIZE,
                id + 1,
            );
        }
        place.write(&format!("kitti/training/calib/{id:06}.txt"), CALIBRATION);
        place.write(&format!("kitti/training/label_2/{id:06}.txt"), CAR);
    }
    spoil(&place);
    let options = (place.path("kitti"), ImportOptions::default());
    let report = import(
        "kitti",
        &options.0,
        &options.1,
        &place.target("out"),
        &Silent,
    );
    (place, report)
}

#[test]
fn a_damaged_frame_of_kitti_is_left_out_with_its_reason() {
    type Spoil = fn(&Place);
    let cases: [(&str, Spoil); 8] = [
        ("label_2/000001.txt line 1: has 9 words", |p| {
            p.write(
                "kitti/training/label_2/000001.txt",
                "Car 0 0 0 20 20 40 30 1.5",
            );
        }),
        ("y is NaN", |p| {
            p.write(
                "kitti/training/label_2/000001.txt",
                &CAR.replace("1.7", "nan"),
            );
        }),
        ("not positive", |p| {
            p.write(
                "kitti/training/label_2/000001.txt",
                &CAR.replace("1.6", "-1.6"),
            );
        }),
        ("calibration: cannot read", |p| {
            fs::remove_file(p.path("kitti/training/calib/000001.txt")).unwrap();
        }),
        ("P3: is missing", |p| {
            p.write(
                "kitti/training/calib/000001.txt",
                &CALIBRATION.replace("P3", "P1"),
            );
        }),
        ("to the left of the left one", |p| {
            p.write(
                "kitti/training/calib/000001.txt",
                &CALIBRATION.replace("-25", "25"),
            );
        }),
        ("has no image in image_3", |p| {
            fs::remove_file(p.path("kitti/training/image_3/000001.png")).unwrap();
        }),
        ("truncated or damaged", |p| {
            let path = p.path("kitti/training/image_3/000001.png");
            let bytes = fs::read(&path).unwrap();
            fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        }),
    ];
    for (reason, spoil) in cases {
        let (place, report) = kitti_with(spoil);
        let report = report.unwrap();
        assert_eq!(report.frames(), 2, "{reason}");
        let found = reasons(&report);
        assert!(
            found.contains("000001: ") && found.contains(reason),
            "{reason}: {found}"
        );
        let dataset = place.open("out");
        assert_eq!((dataset.frames.len(), dataset.problems.len()), (2, 0));
    }
}

#[test]
fn without_a_usable_frame_an_import_fails_and_says_why() {
    let (_, report) = kitti_with(|place| {
        for id in 0..3 {
            place.write(&format!("kitti/training/label_2/{id:06}.txt"), "what");
        }
    });
    let message = report.unwrap_err().to_string();
    assert!(
        message.contains("no usable frame") && message.contains("1 words"),
        "{message}"
    );
    let place = Place::new();
    fs::create_dir(place.path("empty")).unwrap();
    let target = place.target("out");
    let options = (place.path("empty"), ImportOptions::default());
    let message = import("kitti", &options.0, &options.1, &target, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("training/image_2"), "{message}");
    let options = ImportOptions {
        least_visible: 0.2,
        ..ImportOptions::default()
    };
    let source = place.path("empty");
    let message = import("vkitti2", &source, &options, &target, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("Scene01"), "{message}");
}

#[test]
fn what_is_no_data_yaml_and_no_coco_is_refused_by_name() {
    let place = Place::new();
    let options = ImportOptions::default();
    for (text, why) in [
        ("- a\n- b\n", "is no data.yaml"),
        ("train: [\n", "is no data.yaml"),
        ("names: [car]\n", "names no images"),
        ("train: nowhere\nnames: [car]\n", "nowhere"),
        (
            "names: 7\ntrain: images\n",
            "is no data.yaml: `names` is neither",
        ),
    ] {
        place.write("yolo/data.yaml", text);
        let source = place.path("yolo");
        let result = import("yolo", &source, &options, &place.target("out"), &Silent);
        let message = result.unwrap_err().to_string();
        assert!(message.contains(why), "{text}: {message}");
    }
    for text in [
        "",
        "[]",
        "{\"images\": 3}",
        "{\"images\": [], \"annotations\": []}",
        "\u{0}",
    ] {
        place.write("a.json", text);
        let source = place.path("a.json");
        let result = import("coco", &source, &options, &place.target("out"), &Silent);
        let message = result.unwrap_err().to_string();
        assert!(message.contains("is not COCO's"), "{text}: {message}");
    }
    assert!(!place.path("out").exists());
}

#[test]
fn damaged_labels_of_yolo_and_coco_leave_their_images_out() {
    let place = Place::new();
    for (i, label) in [
        "0 0.5 0.5 0.2 0.2",
        "0 0.5",
        "9 0.5 0.5 0.2 0.2",
        "0 nan 0.5 0.2 0.2",
    ]
    .into_iter()
    .enumerate()
    {
        place.image(&format!("yolo/images/{i}.png"), SIZE, i as u32 + 1);
        place.write(&format!("yolo/labels/{i}.txt"), label);
    }
    place.write("yolo/data.yaml", "train: images\nnames: {0: car}\n");
    let options = ImportOptions::default();
    let source = place.path("yolo");
    let report = import("yolo", &source, &options, &place.target("out"), &Silent).unwrap();
    assert_eq!(report.frames(), 1);
    let found = reasons(&report);
    for why in ["1.txt line 1: has 1 numbers", "class 9 has no name", "NaN"] {
        assert!(found.contains(why), "{found}");
    }
    let json = r#"{"images": [
        {"id": 1, "file_name": "0.png", "width": 64, "height": 48},
        {"id": 2, "file_name": "1.png", "width": 64, "height": 48},
        {"id": 3, "file_name": "2.png", "width": 640, "height": 48},
        {"id": 4, "file_name": "gone.png", "width": 64, "height": 48}],
        "annotations": [{"id": 1, "image_id": 2, "category_id": 1, "bbox": [1, 2, -3, 4]}],
        "categories": [{"id": 1, "name": "car"}]}"#;
    place.write("a.json", json);
    let images = place.path("yolo/images");
    let target = place.target("coco");
    let options = ImportOptions {
        images: Some(images),
        ..options
    };
    let report = import("coco", &place.path("a.json"), &options, &target, &Silent);
    let report = report.unwrap();
    assert_eq!(report.frames(), 1);
    let found = reasons(&report);
    for why in ["empty or inverted", "annotations say 640x48", "not there"] {
        assert!(found.contains(why), "{found}");
    }
}

#[test]
fn unknown_classes_and_pairs_without_a_rig_are_errors_that_say_what_to_do() {
    let place = Place::new();
    for side in ["left", "right"] {
        place.image(&format!("yolo/images/{side}/1.png"), SIZE, 5);
        place.write(
            &format!("yolo/labels/{side}/1.txt"),
            "0 0.5 0.5 0.2 0.2 12.5",
        );
    }
    place.write("yolo/data.yaml", "train: images\nnames: {0: car}\n");
    let source = place.path("yolo");
    let mut target = place.target("out");
    let mut options = ImportOptions::default();
    let message = import("yolo", &source, &options, &target, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("--baseline-m and --hfov-deg"), "{message}");
    target.classes = Some("truck".parse().unwrap());
    let message = import("yolo", &source, &options, &target, &Silent)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("no class 'truck'") && message.contains("car"),
        "{message}"
    );
    target.classes = None;
    (options.baseline_m, options.hfov_deg) = (Some(0.5), Some(60.0));
    options.distance_column = true;
    import("yolo", &source, &options, &target, &Silent).unwrap();
    let dataset = place.open("out");
    assert_eq!(
        dataset.frames[0].vehicles(BoxKind::Tight)[0].distance_m,
        12.5
    );
    // The folder now holds a dataset, which nothing overwrites.
    let message = import("yolo", &source, &options, &target, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("never overwritten"), "{message}");
    let export = coco::export(&dataset, BoxKind::Tight, &place.path("out"), &Silent);
    assert!(export.unwrap_err().to_string().contains("not empty"));
    let export = coco::export(&dataset, BoxKind::Sphere, &place.path("x"), &Silent);
    assert!(export.unwrap_err().to_string().contains("no sphere boxes"));
}

#[test]
fn frames_that_a_table_does_not_list_and_tables_without_sense_are_named() {
    let (place, _) = kitti_with(|_| ());
    let options = (place.path("kitti"), ImportOptions::default());
    let import = |name: &str, table: &str| {
        place.write("table.csv", table);
        let mut target = place.target(name);
        target.splits.table = Some(place.path("table.csv"));
        import("kitti", &options.0, &options.1, &target, &Silent)
    };
    let report = import("part", "id,split\n0,val\n000001,train\n").unwrap();
    assert_eq!((report.counts.train, report.counts.val), (1, 1));
    assert!(reasons(&report).contains("000002: is not listed"));
    for (table, why) in [
        ("a,b\n1,2\n", "names no frames"),
        ("id,b\n1,2\n", "neither groups nor splits"),
        ("id,split\n1,often\n", "'often' is none of train"),
    ] {
        let message = import("never", table).unwrap_err().to_string();
        assert!(message.contains(why), "{message}");
    }
}
