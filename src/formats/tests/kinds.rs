//! Files as people really have them, kind by kind, with the right values.

use super::*;
use crate::geometry::PixelBox;
use crate::imaging::jpeg_bytes;

pub(super) const SIZE: [u32; 2] = [96, 64];

/// The box of an object at 0.5 0.5 0.5 0.5 in an image of [`SIZE`].
pub(super) const MIDDLE: PixelBox = PixelBox {
    x_min: 24.0,
    y_min: 16.0,
    x_max: 72.0,
    y_max: 48.0,
};

pub(super) fn default_import(format: &str, place: &Place, source: &str) -> Result<ImportReport> {
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
pub(super) fn boxes(dataset: &StereoDataset) -> Vec<Vec<PixelBox>> {
    let of = |frame: &crate::dataset::Frame| {
        let labels = frame.left.labels.iter();
        labels.map(|label| label.box_pixel).collect()
    };
    dataset.frames.iter().map(of).collect()
}

/// A JPEG file with an Exif orientation, its left half black as it is stored.
pub(super) fn turned(place: &Place, name: &str, orientation: u8, [width, height]: [u32; 2]) {
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
