//! `import(export(x))` is `x` as far as the format can hold it.

use super::*;
use crate::dataset::fixture::Fixture;
use crate::dataset::{Frame, FrameRow, Label};

/// The labels of one kind, by id, of each image of a frame.
fn labels(frame: &Frame, kind: BoxKind) -> Vec<Vec<Label>> {
    let of = |(_, image): (_, &crate::dataset::FrameImage)| {
        let mut labels: Vec<Label> = image.labels_of(kind).cloned().collect();
        labels.sort_by_key(|label| label.id);
        labels
    };
    frame.images().map(of).collect()
}

fn assert_same_pixels(a: &StereoDataset, b: &StereoDataset) {
    for (a_frame, b_frame) in a.frames.iter().zip(&b.frames) {
        assert!(a_frame.load(a.rig()).unwrap() == b_frame.load(b.rig()).unwrap());
    }
}

/// Labels as they are after `change`.
fn changed(labels: Vec<Vec<Label>>, change: impl Fn(&mut Label)) -> Vec<Vec<Label>> {
    let of = |mut label: Label| {
        change(&mut label);
        label
    };
    labels
        .into_iter()
        .map(|side| side.into_iter().map(&of).collect())
        .collect()
}

#[test]
fn coco_holds_everything_of_one_kind_of_box() {
    for kind in [BoxKind::Sphere, BoxKind::Tight] {
        let (fixture, place) = (Fixture::lawful(10), Place::new());
        let dataset = fixture.open();
        let report = coco::export(&dataset, kind, &place.path("coco"), &Silent).unwrap();
        assert_eq!((report.images, report.boxes), (20, 40));
        let target = place.target("back");
        let source = place.path("coco");
        let options = ImportOptions::default();
        import("coco", &source, &options, &target, &Silent).unwrap();
        let back = place.open("back");
        assert_eq!(back.info.rig, dataset.info.rig);
        assert_eq!(back.info.classes, dataset.info.classes);
        assert_eq!(back.info.label_kinds, [kind]);
        assert_eq!(back.frames.len(), 10);
        for (a, b) in dataset.frames.iter().zip(&back.frames) {
            assert_eq!(a.row, b.row);
            assert_eq!(labels(a, kind), labels(b, kind));
        }
        assert_same_pixels(&dataset, &back);
        assert_sound(&back.folder);
    }
}

#[test]
fn yolo_holds_boxes_classes_splits_and_with_a_sixth_number_distances() {
    for (distance, kind) in [
        (true, BoxKind::Tight),
        (false, BoxKind::Tight),
        (true, BoxKind::Sphere),
    ] {
        let (fixture, place) = (Fixture::lawful(10), Place::new());
        let dataset = fixture.open();
        let report = yolo::export(&dataset, kind, distance, &place.path("yolo"), &Silent).unwrap();
        assert_eq!((report.images, report.boxes), (20, 34));
        // The second vehicle of every third frame, in both images.
        assert_eq!(report.left_out.len(), 6);
        let options = ImportOptions::default();
        let source = place.path("yolo");
        import("yolo", &source, &options, &place.target("back"), &Silent).unwrap();
        let back = place.open("back");
        assert_eq!(back.info.rig, dataset.info.rig);
        assert_eq!(back.info.label_kinds, [kind]);
        for (a, b) in dataset.frames.iter().zip(&back.frames) {
            assert_eq!((a.row.stamp, a.row.split), (b.row.stamp, b.row.split));
            let mut expected = labels(a, kind);
            for side in &mut expected {
                side.retain(|label| !label.ignored);
            }
            let expected = changed(expected, |label| {
                label.visible = None;
                if !distance {
                    label.distance_m = None;
                }
            });
            for (expected, found) in expected.iter().zip(labels(b, kind)) {
                assert_eq!(expected.len(), found.len());
                for (expected, found) in expected.iter().zip(found) {
                    // Both images agree which vehicle is which; boxes keep four decimals.
                    let iou = expected.box_pixel.iou(&found.box_pixel);
                    assert!(iou > 0.9999, "{expected:?} {found:?}");
                    assert_eq!(expected.distance_m, found.distance_m);
                    assert_eq!((expected.id, expected.class), (found.id, found.class));
                }
            }
        }
        assert_same_pixels(&dataset, &back);
        if distance {
            assert_sound(&back.folder);
        }
    }
}

#[test]
fn kitti_holds_places_boxes_splits_and_what_is_ignored() {
    for kind in [BoxKind::Tight, BoxKind::Sphere] {
        let (fixture, place) = (Fixture::lawful(10), Place::new());
        let dataset = fixture.open();
        kitti::export(&dataset, kind, &place.path("kitti"), &Silent).unwrap();
        let mut target = place.target("back");
        target.classes = Some(ClassMap::identity(dataset.info.classes.clone()));
        let options = (place.path("kitti"), ImportOptions::default());
        let report = import("kitti", &options.0, &options.1, &target, &Silent).unwrap();
        assert_eq!((report.vehicles, report.ignored), (20, 3));
        let back = place.open("back");
        assert!((back.rig().baseline_m - dataset.rig().baseline_m).abs() < 1e-9);
        assert!((back.rig().focal_px() - dataset.rig().focal_px()).abs() < 1e-9);
        // Whatever kind was exported, KITTI's boxes are those of the visible vehicle.
        assert_eq!(back.info.label_kinds, [BoxKind::Tight]);
        for (a, b) in dataset.frames.iter().zip(&back.frames) {
            assert_eq!((a.row.stamp, a.row.split), (b.row.stamp, b.row.split));
            let found = labels(b, BoxKind::Tight);
            for (expected, found) in labels(a, kind).iter().flatten().zip(found.iter().flatten()) {
                assert_eq!((expected.id, expected.class), (found.id, found.class));
                assert_eq!(expected.ignored, found.ignored);
                assert!(expected.box_pixel.iou(&found.box_pixel) > 0.9999);
                let [expected_m, found_m] = [expected, found].map(|l| l.distance_m.unwrap());
                assert!(
                    (expected_m - found_m).abs() < 2e-4,
                    "{expected_m} {found_m}"
                );
                for i in 0..2 {
                    let apart = expected.center_pixel[i] - found.center_pixel[i];
                    assert!(apart.abs() < 2e-4, "{apart}");
                }
            }
        }
        assert_same_pixels(&dataset, &back);
        assert_sound(&back.folder);
    }
}

#[test]
fn single_images_go_out_and_come_back_and_train_no_distance() {
    let (fixture, place) = (Fixture::lawful(5), Place::new());
    let dataset = fixture.open();
    yolo::export(&dataset, BoxKind::Tight, true, &place.path("yolo"), &Silent).unwrap();
    let options = ImportOptions {
        single: true,
        ..ImportOptions::default()
    };
    let source = place.path("yolo");
    let report = import("yolo", &source, &options, &place.target("single"), &Silent).unwrap();
    assert_eq!(report.frames(), 10);
    let single = place.open("single");
    assert!(!single.info.stereo);
    assert_eq!(single.frames[0].images().count(), 1);
    assert!(
        single
            .frames
            .iter()
            .all(|frame| frame.vehicles(BoxKind::Tight).is_empty())
    );
    assert!(kitti::export(&single, BoxKind::Tight, &place.path("k"), &Silent).is_err());
    for (format, name) in [("coco", "coco2"), ("yolo", "yolo2")] {
        let (out, back) = (place.path(name), format!("{name}-back"));
        let (target, options) = (place.target(&back), ImportOptions::default());
        if format == "coco" {
            coco::export(&single, BoxKind::Tight, &out, &Silent).unwrap();
            import("coco", &out, &options, &target, &Silent).unwrap();
        } else {
            yolo::export(&single, BoxKind::Tight, true, &out, &Silent).unwrap();
            import("yolo", &out, &options, &target, &Silent).unwrap();
        }
        let back = place.open(&back);
        assert!(!back.info.stereo);
        let rows = |d: &StereoDataset| -> Vec<FrameRow> {
            d.frames.iter().map(|frame| frame.row.clone()).collect()
        };
        assert_eq!(rows(&single), rows(&back));
        let distances = |d: &StereoDataset| -> Vec<_> {
            let frames = d.frames.iter().flat_map(|f| f.left.labels.clone());
            frames
                .map(|label| (label.distance_m, label.class))
                .collect()
        };
        assert_eq!(distances(&single), distances(&back));
    }
}
