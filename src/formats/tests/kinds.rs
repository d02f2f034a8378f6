//! Files as people really have them, kind by kind, with the right values.

use super::*;
use crate::geometry::PixelBox;
use crate::imaging::{jpeg_bytes, load_rgb};

const SIZE: [u32; 2] = [96, 64];

/// The box of an object at 0.5 0.5 0.5 0.5 in an image of [`SIZE`].
const MIDDLE: PixelBox = PixelBox {
    x_min: 24.0,
    y_min: 16.0,
    x_max: 72.0,
    y_max: 48.0,
};

fn default_import(format: &str, place: &Place, source: &str) -> Result<ImportReport> {
    let options = ImportOptions::default();
    import(
        format,
        &place.path(source),
        &options,
        &place.target("out"),
        &Silent,
    )
}

/// Boxes of all frames.
fn boxes(dataset: &StereoDataset) -> Vec<Vec<PixelBox>> {
    let of = |frame: &crate::dataset::Frame| {
        let labels = frame.left.labels.iter();
        labels.map(|label| label.box_pixel).collect()
    };
    dataset.frames.iter().map(of).collect()
}

/// A JPEG file with an Exif orientation, its left half black as it is stored.
fn turned(place: &Place, name: &str, orientation: u8, [width, height]: [u32; 2]) {
    let path = place.path(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let half = RgbImage::from_fn(width, height, |x, _| {
        Rgb([if x < width / 2 { 0 } else { 255 }; 3])
    });
    let jpeg = jpeg_bytes(&path, &half).unwrap();
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut bytes = jpeg[..2].to_vec();
    bytes.extend([0xFF, 0xE1, 0, exif.len() as u8 + 2]);
    bytes.extend(exif);
    bytes.extend(&jpeg[2..]);
    fs::write(path, bytes).unwrap();
}

#[test]
fn boxes_of_yolo_on_turned_photos_count_in_the_picture_as_it_is_shown() {
    let place = Place::new();
    place.write("yolo/data.yaml", "train: images\nnames: [car]\n");
    for orientation in 1..=8 {
        // As shown, all are 48 wide and 96 high.
        let size = if orientation < 5 { [48, 96] } else { [96, 48] };
        turned(
            &place,
            &format!("yolo/images/{orientation}.jpg"),
            orientation,
            size,
        );
        place.write(
            &format!("yolo/labels/{orientation}.txt"),
            "0 0.25 0.125 0.5 0.25",
        );
    }
    default_import("yolo", &place, "yolo").unwrap();
    let dataset = place.open("out");
    let camera = dataset.rig().left;
    assert_eq!((camera.width, camera.height), (48, 96));
    for (orientation, frame) in (1..).zip(&dataset.frames) {
        let area = frame.left.labels[0].box_pixel;
        assert_eq!(area, PixelBox::new(0.0, 0.0, 24.0, 24.0), "{orientation}");
        let image = frame.left.load(&camera).unwrap();
        // A place in the dark half as it is shown.
        let [x, y] = match orientation {
            1 | 4 => [12, 48],
            2 | 3 => [36, 48],
            5 | 6 => [24, 24],
            _ => [24, 72],
        };
        assert!(image.get_pixel(x, y).0[0] < 40, "{orientation}");
        assert!(
            image.get_pixel(47 - x, 95 - y).0[0] > 215 || x == 24,
            "{orientation}"
        );
    }
    assert_sound(&place.path("out"));
}

#[test]
fn boxes_of_coco_count_in_the_pixels_of_the_size_that_the_file_says() {
    let place = Place::new();
    for name in ["shown", "stored", "unsaid", "wrong"] {
        turned(&place, &format!("coco/images/{name}.jpg"), 6, [96, 48]);
    }
    let json = r#"{"images": [
        {"id": 1, "file_name": "shown.jpg", "width": 48, "height": 96},
        {"id": 2, "file_name": "stored.jpg", "width": 96, "height": 48},
        {"id": 3, "file_name": "unsaid.jpg"},
        {"id": 4, "file_name": "wrong.jpg", "width": 95, "height": 48}],
        "annotations": [
        {"id": 1, "image_id": 1, "category_id": 1, "bbox": [0, 0, 24, 24]},
        {"id": 2, "image_id": 2, "category_id": 1, "bbox": [0, 24, 24, 24]},
        {"id": 3, "image_id": 3, "category_id": 1, "bbox": [0, 0, 24, 24]}],
        "categories": [{"id": 1, "name": "car"}]}"#;
    place.write("coco/annotations/instances_train.json", json);
    let report = default_import("coco", &place, "coco").unwrap();
    assert_eq!(report.frames(), 3);
    assert!(reasons(&report).contains("has 48x96 pixels and the annotations say 95x48"));
    let dataset = place.open("out");
    // One canvas for all: 96 x 96.
    let edges = |b: &PixelBox| [b.x_min, b.y_min, b.x_max, b.y_max];
    let found: Vec<_> = boxes(&dataset).iter().map(|b| edges(&b[0])).collect();
    let upper = [0.0, 0.0, 24.0, 24.0];
    assert_eq!(found, [upper, [0.0, 24.0, 24.0, 48.0], upper]);
    // The dark half is on top as it is shown, on the left as it is stored.
    for (frame, [x, y]) in dataset.frames.iter().zip([[36, 24], [12, 36], [36, 24]]) {
        let image = load_rgb(&frame.left.path).unwrap();
        assert_eq!(image.dimensions(), (96, 96));
        assert!(image.get_pixel(x, y).0[0] < 40);
    }
    assert!(
        load_rgb(&dataset.frames[1].left.path)
            .unwrap()
            .get_pixel(60, 12)
            .0[0]
            > 215
    );
}

/// A YOLO folder of two training images and one to validate, with these lines.
fn yolo_folder(place: &Place, yaml: &str, lines: &str) {
    for (number, split) in (0..).zip(["train", "train", "val"]) {
        place.image(
            &format!("yolo/images/{split}/im{number}.png"),
            SIZE,
            number + 1,
        );
        place.write(&format!("yolo/labels/{split}/im{number}.txt"), lines);
    }
    let yaml = format!("path: .\ntrain: images/train\nval: images/val\n{yaml}\n");
    place.write("yolo/data.yaml", &yaml);
}

#[test]
fn key_points_of_yolo_are_not_read_as_a_polygon() {
    let place = Place::new();
    let line = "0 0.5 0.5 0.5 0.5 0.45 0.45 0.55 0.45 0.55 0.55 0.45 0.55";
    yolo_folder(&place, "kpt_shape: [4, 2]\nnames: {0: car}", line);
    default_import("yolo", &place, "yolo").unwrap();
    assert_eq!(boxes(&place.open("out")), vec![vec![MIDDLE]; 3]);
}

#[test]
fn a_confidence_of_yolo_is_no_distance_and_the_report_says_so() {
    let place = Place::new();
    yolo_folder(&place, "names: [car]", "0 0.5 0.5 0.5 0.5 0.873");
    let report = default_import("yolo", &place, "yolo").unwrap();
    assert_eq!((report.vehicles, report.with_distance), (3, 0));
    let found = reasons(&report);
    assert!(
        found.contains("im0.png: a sixth number is taken for a confidence"),
        "{found}"
    );
    assert!(found.contains("--distance-column"), "{found}");
    let options = ImportOptions {
        distance_column: true,
        ..ImportOptions::default()
    };
    let source = place.path("yolo");
    let report = import("yolo", &source, &options, &place.target("told"), &Silent).unwrap();
    assert_eq!((report.with_distance, report.left_out.len()), (3, 0));
    assert_eq!(
        place.open("told").frames[0].left.labels[0].distance_m,
        Some(0.873)
    );
}

#[test]
fn labels_of_yolo_that_lie_elsewhere_are_an_error_that_says_where_they_were_looked_for() {
    let place = Place::new();
    place.image("yolo/images/train/a.png", SIZE, 1);
    place.write("yolo/annot/train/a.txt", "0 0.5 0.5 0.5 0.5");
    place.write("yolo/data.yaml", "train: images/train\nnames: [car]\n");
    let message = default_import("yolo", &place, "yolo")
        .unwrap_err()
        .to_string();
    for words in [
        "any of the 1 images of images/train",
        "labels/train",
        "--background",
    ] {
        assert!(message.contains(words), "{message}");
    }
    assert!(!place.path("out").exists());
    let options = ImportOptions {
        background: true,
        ..ImportOptions::default()
    };
    let source = place.path("yolo");
    let report = import("yolo", &source, &options, &place.target("out"), &Silent).unwrap();
    assert_eq!(
        (report.frames(), report.vehicles, report.unlabelled),
        (1, 0, 1)
    );
}

#[test]
fn test_images_of_yolo_without_labels_are_left_out_and_single_ones_show_nothing() {
    let place = Place::new();
    yolo_folder(
        &place,
        "test: images/test\nnames: [car]",
        "0 0.5 0.5 0.5 0.5",
    );
    place.image("yolo/images/test/t.png", SIZE, 9);
    place.image("yolo/images/train/empty.png", SIZE, 8);
    let report = default_import("yolo", &place, "yolo").unwrap();
    assert_eq!((report.frames(), report.unlabelled), (4, 1));
    let found = reasons(&report);
    assert!(
        found.contains("1 images of images/test: have no label files in"),
        "{found}"
    );
}

#[test]
fn images_of_all_kinds_are_imported_and_what_is_left_out_is_named() {
    let place = Place::new();
    let expected = RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| Rgb([x as u8, y as u8, 9]));
    for name in ["a.png", "b.bmp", "c.webp", "d.tif", "e.JPEG", "f.TIFF"] {
        let path = place.path(&format!("yolo/images/{name}"));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        expected.save(&path).unwrap();
        let label = Path::new(name).with_extension("txt");
        place.write(
            &format!("yolo/labels/{}", label.display()),
            "0 0.5 0.5 0.5 0.5",
        );
    }
    place.write("yolo/images/g.heic", "ftypheic");
    place.write("yolo/images/notes.txt", "of no concern");
    place.write("yolo/data.yaml", "train: images\nnames: [car]\n");
    let report = default_import("yolo", &place, "yolo").unwrap();
    assert_eq!(report.frames(), 6);
    let found = reasons(&report);
    assert_eq!(
        found,
        "images/g.heic: is not a PNG, JPEG, BMP, WebP or TIFF image"
    );
    let dataset = place.open("out");
    assert_eq!(boxes(&dataset), vec![vec![MIDDLE]; 6]);
    let endings: Vec<_> = dataset
        .frames
        .iter()
        .map(|frame| frame.left.path.extension().unwrap().to_owned())
        .collect();
    assert_eq!(endings, ["png", "png", "png", "png", "jpg", "png"]);
    for frame in dataset.frames.iter().filter(|frame| frame.row.stamp != 5) {
        assert_eq!(frame.left.load(&dataset.rig().left).unwrap(), expected);
    }
}

#[test]
fn strict_and_loose_lines_of_yolo_become_the_same_boxes() {
    let place = Place::new();
    let lines = "0.0 5.0e-1 5.0e-1 5.000e-01 0.5\n\
                 1.000000000000000000e+00 0.97 0.5 0.2 0.5\n0 0.5 0.5 0.0 0.1\n";
    yolo_folder(&place, "names:\n  0: car\n  1: 7", lines);
    let report = default_import("yolo", &place, "yolo").unwrap();
    assert_eq!((report.frames(), report.vehicles), (3, 6));
    assert!(reasons(&report).contains("im0.png: a box has no size"));
    let dataset = place.open("out");
    assert_eq!(dataset.classes(), ["car", "7"]);
    for found in boxes(&dataset) {
        assert_eq!(found[0], MIDDLE);
        // Cut off at the right border.
        assert_eq!(found[1].x_max, 96.0);
        assert!((found[1].x_min - 83.52).abs() < 1e-9);
    }
}

#[test]
fn paths_of_other_machines_in_data_yaml_and_lists_lead_to_the_images_here() {
    let place = Place::new();
    yolo_folder(&place, "names: [car]", "0 0.5 0.5 0.5 0.5");
    let lists = "C:\\data\\set\\images\\train\\im0.png\n/content/set/images/train/im1.png\n\
                 ./images/val/im2.png\n/content/gone.png\n";
    place.write("yolo/list.txt", lists);
    for (name, yaml) in [
        ("list", "train: list.txt"),
        (
            "folders",
            "path: /content/set\ntrain: [/content/set/images/train, images\\val]",
        ),
    ] {
        place.write("yolo/data.yaml", &format!("{yaml}\nnames: [car]\n"));
        let options = ImportOptions::default();
        let source = place.path("yolo");
        let report = import("yolo", &source, &options, &place.target(name), &Silent).unwrap();
        assert_eq!((report.frames(), report.vehicles), (3, 3), "{name}");
        let found = reasons(&report);
        assert_eq!(
            found.contains("/content/gone.png: the image is not there"),
            name == "list"
        );
    }
}

const CATEGORIES: &str = r#""categories": [{"id": 1, "name": "car"}]"#;

/// A COCO folder of three images whose file says this of each.
fn coco_folder(place: &Place, image: impl Fn(u32) -> String, annotation: impl Fn(u32) -> String) {
    for number in 0..3 {
        place.image(&format!("coco/images/im{number}.jpg"), SIZE, number + 1);
    }
    let list = |of: &dyn Fn(u32) -> String| (0..3).map(of).collect::<Vec<_>>().join(", ");
    let text = format!(
        "{{\"images\": [{}], \"annotations\": [{}], {CATEGORIES}}}",
        list(&image),
        list(&annotation)
    );
    place.write("coco/annotations/instances_train.json", &text);
}

#[test]
fn coco_is_read_however_its_numbers_are_written() {
    let plain_image =
        |n: u32| format!(r#"{{"id": {n}, "file_name": "im{n}.jpg", "width": 96, "height": 64}}"#);
    let plain = |n: u32| {
        format!(
            r#"{{"id": {n}, "image_id": {n}, "category_id": 1, "bbox": [24, 16, 48, 32], "area": 1, "iscrowd": 0}}"#
        )
    };
    let changed = |from: &'static str, to: &'static str| move |n: u32| plain(n).replace(from, to);
    let image_changed =
        |from: &'static str, to: &'static str| move |n: u32| plain_image(n).replace(from, to);
    type Text = Box<dyn Fn(u32) -> String>;
    let cases: Vec<(Text, Text)> = vec![
        (Box::new(plain_image), Box::new(plain)),
        (
            Box::new(move |n| {
                plain_image(n).replacen(&format!("\"id\": {n}"), &format!("\"id\": {n}.0"), 1)
            }),
            Box::new(changed("\"category_id\": 1", "\"category_id\": 1.0")),
        ),
        (
            Box::new(move |n| {
                plain_image(n).replacen(&format!("\"id\": {n}"), &format!("\"id\": \"{n}\""), 1)
            }),
            Box::new(move |n| {
                plain(n).replace(
                    &format!("\"image_id\": {n}"),
                    &format!("\"image_id\": \"{n}\""),
                )
            }),
        ),
        (
            Box::new(plain_image),
            Box::new(changed("\"iscrowd\": 0", "\"iscrowd\": null")),
        ),
        (
            Box::new(plain_image),
            Box::new(changed("\"iscrowd\": 0", "\"iscrowd\": false")),
        ),
        (
            Box::new(plain_image),
            Box::new(changed("\"iscrowd\": 0", "\"iscrowd\": 0.0")),
        ),
        (
            Box::new(plain_image),
            Box::new(changed("\"area\": 1", "\"area\": NaN")),
        ),
        (
            Box::new(plain_image),
            Box::new(changed("[24, 16, 48, 32]", "[\"24\", 16.0, 48, 32]")),
        ),
        (
            Box::new(image_changed(", \"width\": 96, \"height\": 64", "")),
            Box::new(plain),
        ),
        (
            Box::new(image_changed("\"width\": 96", "\"width\": null")),
            Box::new(plain),
        ),
        (
            Box::new(image_changed("\"height\": 64", "\"height\": \"64\"")),
            Box::new(plain),
        ),
        (
            Box::new(image_changed("\"im", "\"C:\\\\data\\\\images\\\\im")),
            Box::new(plain),
        ),
        (
            Box::new(image_changed("\"im", "\"/home/me/set/im")),
            Box::new(plain),
        ),
    ];
    for (number, (image, annotation)) in cases.into_iter().enumerate() {
        let place = Place::new();
        coco_folder(&place, image, annotation);
        let report = default_import("coco", &place, "coco").unwrap();
        let found = (report.frames(), report.vehicles, report.ignored);
        assert_eq!(found, (3, 3, 0), "case {number}: {}", reasons(&report));
        assert_eq!(boxes(&place.open("out")), vec![vec![MIDDLE]; 3], "{number}");
    }
    let place = Place::new();
    coco_folder(
        &place,
        plain_image,
        changed("\"iscrowd\": 0", "\"iscrowd\": true"),
    );
    assert_eq!(default_import("coco", &place, "coco").unwrap().ignored, 3);
}

#[test]
fn boxes_of_coco_without_size_are_left_out_and_their_images_stay() {
    let place = Place::new();
    let image = |n: u32| format!(r#"{{"id": {n}, "file_name": "im{n}.jpg"}}"#);
    let annotation = |n: u32| {
        let bbox = ["24, 16, 48, 32", "24, 16, 0, 32", "200, 16, 48, 32"][n as usize];
        format!(r#"{{"id": {n}, "image_id": {n}, "category_id": 1, "bbox": [{bbox}]}}"#)
    };
    coco_folder(&place, image, annotation);
    let report = default_import("coco", &place, "coco").unwrap();
    assert_eq!((report.frames(), report.vehicles), (3, 1));
    let found = reasons(&report);
    assert!(found.contains("im1.jpg: a box has no size"), "{found}");
    assert!(
        found.contains("im2.jpg: a box lies outside of the image"),
        "{found}"
    );
}

#[test]
fn coco_beside_its_images_in_a_folder_a_split_is_read_as_roboflow_writes_it() {
    let place = Place::new();
    for (split, count) in [("train", 2), ("valid", 1), ("test", 1)] {
        let list = |item: &dyn Fn(u32) -> String| -> String {
            (0..count).map(item).collect::<Vec<_>>().join(", ")
        };
        let images = list(&|n| {
            format!(r#"{{"id": {n}, "file_name": "im{n}.jpg", "width": 96, "height": 64}}"#)
        });
        let annotations = list(&|n| {
            format!(r#"{{"id": {n}, "image_id": {n}, "category_id": 1, "bbox": [24, 16, 48, 32]}}"#)
        });
        for n in 0..count {
            place.image(&format!("set/{split}/im{n}.jpg"), SIZE, n + 1);
        }
        let text =
            format!("{{\"images\": [{images}], \"annotations\": [{annotations}], {CATEGORIES}}}");
        place.write(&format!("set/{split}/_annotations.coco.json"), &text);
    }
    let report = default_import("coco", &place, "set").unwrap();
    let counts = report.counts;
    assert_eq!((counts.train, counts.val, counts.test), (2, 1, 1));
    assert_eq!(boxes(&place.open("out")), vec![vec![MIDDLE]; 4]);
}

const CAR: &str = "Car 0.00 0 -1.57 130.00 50.00 190.00 80.00 1.50 1.70 4.20 0.50 1.60 15.00 -1.57";

const CALIBRATION: &str = "P2: 200 0 160 12 0 200 60 0 0 0 1 0\nP3: 200 0 160 -96 0 200 60 0 0 0 1 0\n\
                           R_rect 1 0 0 0 1 0 0 0 1\n";

#[test]
fn tracks_of_kitti_are_pairs_with_their_sequences_kept_apart() {
    let place = Place::new();
    for sequence in ["0000", "0007"] {
        let mut labels = String::new();
        for frame in 0..3 {
            for (camera, folder) in [(1, "image_02"), (2, "image_03")] {
                let name = format!("kitti/training/{folder}/{sequence}/{frame:06}.png");
                let seed = camera * 10 + frame + u32::from(sequence == "0007") * 5;
                place.image(&name, [320, 120], seed);
            }
            labels += &format!(
                "{frame} 4 {CAR}\n{frame} -1 DontCare -1 -1 -10 10 40 30 55 -1 -1 -1 -1000 -1000 \
                 -1000 -10\n{frame} 2 Pedestrian 0 0 0.2 200 40 210 80 1.8 0.5 0.5 3 1.6 12 0.1\n"
            );
        }
        place.write(&format!("kitti/training/calib/{sequence}.txt"), CALIBRATION);
        place.write(&format!("kitti/training/label_02/{sequence}.txt"), &labels);
    }
    let mut target = place.target("out");
    target.splits.val_fraction = 0.5;
    let options = ImportOptions::default();
    let report = import("kitti", &place.path("kitti"), &options, &target, &Silent).unwrap();
    assert_eq!((report.counts.train, report.counts.val), (3, 3));
    assert_eq!(
        (report.vehicles, report.ignored, report.with_distance),
        (12, 6, 6)
    );
    let dataset = place.open("out");
    assert!((dataset.rig().baseline_m - 0.54).abs() < 1e-9);
    for (index, frame) in dataset.frames.iter().enumerate() {
        assert_eq!(frame.row.scene, Some(1 + index as u32 / 3));
        let [vehicle] = &frame.vehicles(BoxKind::Tight)[..] else {
            panic!("one car counts");
        };
        // The rig's middle is 21 cm right of the reference; the centre is 75 cm above the bottom.
        let expected_m = ((0.5 - 0.21_f64).powi(2) + 0.85_f64.powi(2) + 225.0).sqrt();
        assert!((vehicle.distance_m - expected_m).abs() < 1e-4);
        assert_eq!(vehicle.id, 4);
        assert_eq!(
            vehicle.left.box_pixel,
            PixelBox::new(130.5, 50.5, 190.5, 80.5)
        );
    }
    let splits = |scene| -> Vec<Split> {
        let of_scene = dataset.frames.iter().filter(|f| f.row.scene == Some(scene));
        of_scene.map(|frame| frame.row.split).collect()
    };
    for scene in [1, 2] {
        let splits = splits(scene);
        assert!(splits.iter().all(|split| *split == splits[0]), "{splits:?}");
    }
    assert_sound(&place.path("out"));
    // The left images alone, of which the sequences stay apart as well.
    fs::remove_dir_all(place.path("kitti/training/image_03")).unwrap();
    target.out = place.path("left");
    let report = import("kitti", &place.path("kitti"), &options, &target, &Silent).unwrap();
    assert_eq!((report.counts.train, report.counts.val), (3, 3));
    assert_eq!((report.vehicles, report.with_distance), (12, 0));
    let left = place.open("left");
    assert!(!left.info.stereo);
    let scenes: Vec<_> = left.frames.iter().map(|frame| frame.row.scene).collect();
    assert_eq!(scenes, [1, 1, 1, 2, 2, 2].map(Some));
}

#[test]
fn kitti_with_boxes_in_the_image_alone_becomes_single_images() {
    let unknown = "car 0.00 0 0.00 130 50 190 80 0.00 0.00 0.00 0.00 0.00 0.00 0.00";
    for (line, folders) in [
        (unknown, &["image_2"][..]),
        ("Car 0 0 0 130 50 190 80", &["image_2"]),
        (CAR, &["image_2"]),
        (unknown, &["image_2", "image_3"]),
    ] {
        let place = Place::new();
        for id in 0..3 {
            for (number, folder) in folders.iter().enumerate() {
                let name = format!("kitti/training/{folder}/{id:06}.png");
                place.image(&name, [320, 120], id * 2 + number as u32);
            }
            if folders.len() == 2 {
                place.write(&format!("kitti/training/calib/{id:06}.txt"), CALIBRATION);
            }
            let lines =
                format!("{line}\nDontCare -1 -1 -10 1 1 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n");
            place.write(&format!("kitti/training/label_2/{id:06}.txt"), &lines);
        }
        let report = default_import("kitti", &place, "kitti").unwrap();
        assert_eq!(
            (report.frames(), report.vehicles, report.ignored),
            (3, 6, 3),
            "{line}"
        );
        assert!(reasons(&report).contains("single images, for a detector"));
        let dataset = place.open("out");
        assert!(!dataset.info.stereo);
        let labels = &dataset.frames[0].left.labels;
        assert_eq!(labels[0].box_pixel, PixelBox::new(130.5, 50.5, 190.5, 80.5));
        assert!(!labels[0].ignored && labels[1].ignored);
        assert_eq!(labels[0].distance_m, None);
    }
}

#[test]
fn the_format_is_told_by_the_content_and_errors_list_those_that_are_known() {
    let place = Place::new();
    yolo_folder(&place, "names: [car]", "0 0.5 0.5 0.5 0.5");
    assert_eq!(default_import("auto", &place, "yolo").unwrap().frames(), 3);
    let message = default_import("coco", &place, "yolo")
        .unwrap_err()
        .to_string();
    for words in ["it looks like YOLO: import yolo", "docs/formats.md"] {
        assert!(message.contains(words), "{message}");
    }
    fs::create_dir(place.path("empty")).unwrap();
    for format in ["auto", "kitti", "vkitti2", "yolo", "coco"] {
        let message = default_import(format, &place, "empty")
            .unwrap_err()
            .to_string();
        for known in known() {
            assert!(message.contains(known.layout), "{format}: {message}");
        }
    }
    let message = default_import("auto", &place, "gone")
        .unwrap_err()
        .to_string();
    assert!(message.contains("check the path"), "{message}");
}
