//! COCO's files as people really have them.

use super::kinds::{MIDDLE, SIZE, boxes, default_import, turned};
use super::*;
use crate::geometry::PixelBox;
use crate::imaging::load_rgb;

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

/// What a file says of each image, or annotation.
type Text = Box<dyn Fn(u32) -> String>;

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
